"""Security policy of all HTML pages: which scripts may run and what may be loaded."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterable


def content_policy(scripts: Iterable[str], script_sources: str = "", *directives: str) -> str:
    """Return the Content-Security-Policy of a page that runs these inline scripts only and loads nothing.

    Parameters
    ----------
    scripts
        Text of each inline script.
    script_sources
        Additional sources of scripts, separated by blanks.
    directives
        Additional directives of the policy.
    """
    hashes = [f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts]
    sources = " ".join([*hashes, *script_sources.split()]) or "'none'"
    always = "style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'"
    return "; ".join(["default-src 'none'", f"script-src {sources}", *directives, always])
