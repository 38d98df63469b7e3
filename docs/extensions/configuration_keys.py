"""The directive `configuration-keys`: tables of the keys of files, made from the classes that read them."""

from __future__ import annotations

import importlib
import types
import typing
from collections.abc import Iterator

from docutils import nodes
from docutils.statemachine import StringList
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


class ConfigurationKeys(SphinxDirective):
    """The keys of the class named by the argument, and those of its sections below it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The tables."""
        module, name = self.arguments[0].rsplit(".", 1)
        box = nodes.container()
        self.state.nested_parse(StringList(tables(getattr(importlib.import_module(module), name))), 0, box)
        return box.children


def tables(model: type[BaseModel], section: str = "") -> list[str]:
    """Markdown: one table of a class, then those of its sections, of whatever depth."""
    lines = [f"`[{section}]`", ""] if section else []
    lines += ["| key | default | meaning |", "|---|---|---|"]
    inner: list[str] = []
    for name, field in model.model_fields.items():
        sections = [each for each in _models(field.annotation) if each.model_fields]
        lines.append(f"| `{name}` | {_default(field, bool(sections))} | {_cell(field.description or '')} |")
        for each in sections:
            inner += ["", *tables(each, f"{section}.{name}" if section else name)]
    return [*lines, *inner, ""]


def _models(annotation: object) -> Iterator[type[BaseModel]]:
    """The classes of a section: one, or each of several kinds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif typing.get_origin(annotation) in (typing.Union, types.UnionType, typing.Annotated):
        for part in typing.get_args(annotation):
            yield from _models(part)


def _default(field: FieldInfo, is_section: bool) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if is_section or value is None or value == "":
        return "–"
    return f"`{_cell(str(list(value) if isinstance(value, tuple) else value))}`"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", r"\|").split())


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the directive known."""
    app.add_directive("configuration-keys", ConfigurationKeys)
    return {"parallel_read_safe": True}
