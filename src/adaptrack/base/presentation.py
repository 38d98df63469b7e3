"""Presentation of objects: figure and notebook form, printable text, and the security policy of pages."""

from __future__ import annotations

import base64
import hashlib
import importlib
import unicodedata
from collections.abc import Iterable
from typing import Any

_DRAWING_MODULE = "adaptrack.results.notebook"
"""Drawing code, which is imported when it is first used."""
UNPRINTABLE = frozenset(("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))
"""Categories of control, format, surrogate, private, unassigned and line-end characters."""


def figure_of(value: Any, *arguments: Any) -> Any:
    """Return the matplotlib figure of an object."""
    return importlib.import_module(_DRAWING_MODULE).figure_of(value, *arguments)


def html_of(value: Any) -> str:
    """Return the HTML form of an object for a notebook."""
    return str(importlib.import_module(_DRAWING_MODULE).html_of(value))


def printable(text: str, keep: str = "") -> str:
    r"""Return text in which unprintable characters, but those in `keep`, are replaced by escapes such as ``\x1b``."""
    if text.isprintable():
        return text
    return "".join(ascii(c)[1:-1] if c not in keep and unicodedata.category(c) in UNPRINTABLE else c for c in text)


def content_policy(scripts: Iterable[str], script_sources: str = "", *directives: str) -> str:
    """Return the Content-Security-Policy of a page that runs these inline scripts only and loads nothing.

    scripts: text of each inline script; script_sources: additional sources of scripts, separated by blanks;
    directives: additional directives of the policy.
    """
    hashes = [f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts]
    sources = " ".join([*hashes, *script_sources.split()]) or "'none'"
    always = "style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'"
    return "; ".join(["default-src 'none'", f"script-src {sources}", *directives, always])
