"""What every page allows itself to load."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable


def content_policy(scripts: Iterable[str], script_sources: str = "", *directives: str) -> str:
    """Content-Security-Policy of a page: only these inline scripts run, and nothing is loaded from anywhere.

    script_sources: further sources of scripts; others: further directives.
    """
    hashes = [f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts]
    sources = " ".join([*hashes, *script_sources.split()]) or "'none'"
    always = "style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'"
    return "; ".join(["default-src 'none'", f"script-src {sources}", *directives, always])
