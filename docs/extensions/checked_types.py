"""For autodoc: the types by which arguments are checked, by their names, with bounds and unit: ``Positive['m/s']``.

Sphinx would write out what pydantic makes of them.
"""

from __future__ import annotations

import sys
import typing
from typing import Annotated, Any

from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util import typing as sphinx_typing

from adaptrack.base import checked
from adaptrack.base.limits import RequestLimit

_stringify = sphinx_typing.stringify_annotation
_SIGNS = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
_TYPES = {name: typing.get_args(each) for name, each in vars(checked).items() if typing.get_origin(each) is Annotated}


def _text(annotation: Any, /, *args: Any, **options: Any) -> str:
    """`stringify_annotation` of Sphinx, for our types as well."""
    if typing.get_origin(annotation) is not Annotated:
        return _stringify(annotation, *args, **options)
    parts = typing.get_args(annotation)
    names = [name for name, known in _TYPES.items() if parts[: len(known)] == known]
    beside = ", ".join(_words(parts[len(_TYPES[names[0]]) :] if names else parts[1:]))
    if names:
        return f"{names[0]}[{beside!r}]" if beside else names[0]
    base = _text(parts[0], *args, **options)
    return f"Annotated[{base}, {beside!r}]" if beside else base


def _words(metadata: tuple[Any, ...]) -> list[str]:
    """Bounds and unit."""
    found = []
    for each in metadata:
        if isinstance(each, FieldInfo):
            found += [
                f"{sign} {getattr(bound, name):.6g}"
                for bound in each.metadata
                for name, sign in _SIGNS
                if getattr(bound, name, None) is not None
            ]
        elif isinstance(each, RequestLimit):
            found.append(f"<= {each.most:,}")
    return found + [each for each in metadata if isinstance(each, str)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Let everything of Sphinx that writes a type use ours."""
    app.setup_extension("sphinx.ext.autodoc")
    for name, module in list(sys.modules.items()):
        if name.startswith("sphinx") and getattr(module, "stringify_annotation", None) is _stringify:
            module.stringify_annotation = _text  # type: ignore[attr-defined]
    return {"parallel_read_safe": True}
