"""For autodoc: what our docstrings mean.

They are prose with names in single backticks and, where it helps, sections as in NumPy's. A bar is an absolute value and
no substitution of reStructuredText, and what stands under an attribute is its meaning, whatever colons it has. Classes
that read files (pydantic's) are shown by their fields, each with its description.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config, NumpyDocstring

_SECTIONS = Config(napoleon_use_param=False, napoleon_use_rtype=False)  # types are shapes, and no names
_LONG_TYPES = (
    (re.compile(r"~?(?:numpy\.)?ndarray\[(?:~?typing\.|~?)?tuple\[~?(?:typing\.)?Any, \.\.\.\], ~?(?:numpy\.)?dtype\[([^\]]*)\]\]"), r"NDArray[\1]"),
    (re.compile(r"TypeAliasForwardRef\('(\w+)'\)"), r"\1"),
)
_CODE = re.compile(r"(``.*?``|`[^`]*`)", re.DOTALL)


def _read(app: Sphinx, what: str, name: str, member: object, options: Any, lines: list[str]) -> None:
    field = _field_of(name)
    if field is not None and field.description:
        lines[:] = [field.description]
    lines[:] = _plain("\n".join(lines)).split("\n")
    if what not in ("attribute", "property", "data"):
        lines[:] = NumpyDocstring(lines, _SECTIONS, app, what, name, member, options).lines()


def _plain(text: str) -> str:
    """The text with bars and underscores at the ends of words escaped, but not in code."""
    parts = _CODE.split(text)
    parts[::2] = [re.sub(r"\||(?<=\w)_(?=\W|$)", r"\\\g<0>", part) for part in parts[::2]]
    return "".join(parts)


def _signature(
    app: Sphinx, what: str, name: str, member: object, options: Any, signature: str, returned: str
) -> tuple[str | None, str | None]:
    """Of a class of fields keywords with their defaults; types and ranges stand with the fields."""
    if not (isinstance(member, type) and issubclass(member, BaseModel)):
        return _short(signature), _short(returned)
    words = [key if field.is_required() else f"{key}={_default(field)}" for key, field in member.model_fields.items()]
    return f"(*, {', '.join(words)})", None


def _short(signature: str | None) -> str | None:
    """Types by their short names."""
    if signature is None:
        return None
    for long, short in _LONG_TYPES:
        signature = long.sub(short, signature)
    return signature


def _default(field: FieldInfo) -> str:
    return "..." if field.default_factory is not None else repr(field.default)


def _skipped(app: Sphinx, what: str, name: str, member: object, skip: bool, options: Any) -> bool | None:
    """What pydantic and scikit-learn give our classes is theirs to describe."""
    home = getattr(member, "__module__", None) or "adaptrack"
    return True if name.startswith("model_") or home.startswith(("pydantic", "sklearn")) else None


def _field_of(name: str) -> FieldInfo | None:
    """Of ``package.Class.field``."""
    home, _, key = name.rpartition(".")
    module, _, owner = home.rpartition(".")
    try:
        model = getattr(importlib.import_module(module), owner)
    except (ImportError, AttributeError, ValueError):
        return None
    return model.model_fields.get(key) if isinstance(model, type) and issubclass(model, BaseModel) else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to autodoc."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-docstring", _read)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-skip-member", _skipped)
    return {"parallel_read_safe": True}
