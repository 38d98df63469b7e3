"""Text without characters that a terminal or a page would interpret."""

from __future__ import annotations

import unicodedata


def printable(text: str, keep: str = "") -> str:
    r"""Return text in which unprintable characters are replaced by escapes such as ``\x1b``.

    Parameters
    ----------
    text
        Any text.
    keep
        Control characters that are not replaced, such as line ends.
    """
    if text.isprintable():
        return text
    return "".join(c if c in keep or not _is_control(c) else ascii(c)[1:-1] for c in text)


def _is_control(character: str) -> bool:
    """Whether a character is unprintable: a control, format, surrogate, private, unassigned or line-end character."""
    return unicodedata.category(character) in {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
