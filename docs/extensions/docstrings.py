"""For autodoc: what our docstrings mean.

They are prose with names in single backticks and, where it helps, sections as in NumPy's. A bar is an absolute value
and no substitution of reStructuredText; what stands under an attribute is its meaning, whatever colons it has. Classes
that read files (pydantic's) list their keys.
"""

from __future__ import annotations

import re
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring

_SECTIONS = Config(napoleon_use_param=False, napoleon_use_rtype=False)
"""The types of parameters are shapes, and no names to link to."""
_CODE = re.compile(r"(``.*?``|`[^`]*`)", re.DOTALL)
_LONG_TYPES = (
    (re.compile(r"[~.\w]*ndarray\[[~.\w]*tuple\[[~.\w]*Any, \.\.\.\], [~.\w]*dtype\[([^\]]*)\]\]"), r"NDArray[\1]"),
    (re.compile(r"TypeAliasForwardRef\('(\w+)'\)"), r"\1"),
)


def _read(app: Sphinx, what: str, name: str, member: object, options: Any, lines: list[str]) -> None:
    lines[:] = _plain("\n".join(lines)).split("\n")
    if what not in ("attribute", "property", "data"):
        lines[:] = NumpyDocstring(lines, _SECTIONS, app, what, name, member, options).lines()
    lines += ["", *_keys(member), ""]


def _plain(text: str) -> str:
    """The text with bars and underscores at the ends of words escaped, but not in code."""
    parts = _CODE.split(text)
    parts[::2] = [re.sub(r"\||(?<=\w)_(?=\W|$)", r"\\\g<0>", part) for part in parts[::2]]
    return "".join(parts)


def _keys(member: object) -> list[str]:
    """A line for each key of a class that reads files."""
    if not (isinstance(member, type) and issubclass(member, BaseModel)):
        return []
    return [
        f"- ``{key}``{_default(field)}" + (f": {_plain(field.description)}" if field.description else "")
        for key, field in member.model_fields.items()
    ]


def _default(field: FieldInfo) -> str:
    """What stands behind the name of a key."""
    if field.is_required():
        return " (required)"
    value = field.get_default(call_default_factory=True)
    return "" if value in (None, "") or isinstance(value, BaseModel) else f" = ``{value!r}``"


def _signature(
    app: Sphinx, what: str, name: str, member: object, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Keys are keywords, listed with what they mean; other types by their short names."""
    return ("(**keys)", None) if _keys(member) else (_short(signature), _short(returned))


def _short(signature: str | None) -> str | None:
    for long, short in _LONG_TYPES:
        signature = signature and long.sub(short, signature)
    return signature


def _skipped(app: Sphinx, what: str, name: str, member: object, skip: bool, options: Any) -> bool | None:
    """What pydantic and scikit-learn give our classes is theirs to describe."""
    home = getattr(member, "__module__", None) or "adaptrack"
    return True if name.startswith("model_") or home.startswith(("pydantic", "sklearn")) else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to autodoc."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _read)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-skip-member", _skipped)
    return {"parallel_read_safe": True}
