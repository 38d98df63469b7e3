"""Text as it can be shown anywhere."""

from __future__ import annotations

import unicodedata


def printable(text: str, keep: str = "") -> str:
    r"""`text` as it can be shown anywhere: controls, marks of direction and half characters as escapes (``\x1b``).

    keep: controls that stay (line ends, for text of many lines).
    """
    if text.isprintable():
        return text
    return "".join(c if c in keep or not _is_control(c) else ascii(c)[1:-1] for c in text)


def _is_control(character: str) -> bool:
    """Controls, formats (marks of direction), surrogates, private and unassigned ones, line and paragraph ends."""
    return unicodedata.category(character) in {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
