"""Settings: frozen dataclasses whose fields, checks and documentation follow from a record of the kernels."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self, cast

import pydantic

from adaptrack.base.checked import Finite, Hint, Number, Whole, checked
from adaptrack.core.kernel import Field, defaults


class RecordSettings:
    """A frozen dataclass with a field for each setting of a record that has bounds.

        class SensorNoise(RecordSettings, record=kernel.Noise):
            "Standard deviations of the sensors."

    Fields of the class body that are not in the record come first; records within the record stand in the class body
    as well, with their own class of settings.
    """

    record: ClassVar[Any]
    defaults: ClassVar[Any]
    """the record with its default values; an experiment replaces constants in a subclass"""
    __signature__: ClassVar[inspect.Signature]

    if TYPE_CHECKING:
        __dataclass_fields__: ClassVar[dict[str, Any]]

        def __init__(self, *values: Any, **settings: Any) -> None: ...
        def __getattr__(self, name: str) -> Any: ...

    def __init_subclass__(cls, record: Any = None, **options: Any) -> None:
        super().__init_subclass__(**options)
        if record is None:
            return
        cls.record, cls.defaults = record, defaults(record)
        public = {name: setting for name, setting in record.field_settings.items() if setting.bounds}
        cls.__annotations__ = _annotations(cls, record, public)
        for name, setting in public.items():
            setattr(cls, name, None if _is_unknown(setting) else setting.default)
        text, section, errors = inspect.cleandoc(cls.__doc__ or "").partition("\n\nRaises\n")
        cls.__doc__ = "\n".join([text, "", *map(_line, public.values())]) + section + errors
        checked(dataclass(frozen=True)(cls))
        arguments = inspect.signature(cls).parameters.values()
        cls.__signature__ = inspect.Signature([argument.replace(annotation=argument.empty) for argument in arguments])

    @property
    def row(self) -> Any:
        """The settings as a row of the record."""
        values = self.defaults._asdict()
        for field in fields(self):
            if field.name in values:
                values[field.name] = _entry(getattr(self, field.name))
        return self.record.new(1, **values)[0]

    @classmethod
    def from_row(cls, row: Any) -> Self:
        """The settings of a row of the record."""
        return cls(**{field.name: _value(field.default, row[field.name]) for field in fields(cls)})


def _annotations(cls: type, record: Any, public: dict[str, Field]) -> dict[str, Any]:
    """The annotations of the fields in their order."""
    declared = inspect.get_annotations(cls)
    settings = {
        name: declared.get(name) or _annotation(public[name]) for name in record._fields if name in declared | public
    }
    return {name: declared[name] for name in declared if name not in settings} | settings


def _entry(value: Any) -> Any:
    if isinstance(value, RecordSettings):
        return value.row
    return math.nan if value is None else value


def _value(default: Any, entry: Any) -> Any:
    if isinstance(default, RecordSettings):
        return type(default).from_row(entry)
    return tuple(entry.tolist()) if isinstance(default, tuple) else entry.item()


def _is_unknown(setting: Field) -> bool:
    return isinstance(setting.default, float) and math.isnan(setting.default)


def _annotation(setting: Field) -> Any:
    """The annotation by which `checked` checks a setting."""
    number = Whole if isinstance(setting.default, int) else Number if setting.bounds.endswith("inf]") else Finite
    kind: Any = Annotated[number, pydantic.Field(**cast(Any, setting.limits))]
    if isinstance(setting.default, tuple):
        kind = cast(Any, tuple)[(kind,) * len(setting.default)]
    marks = [mark for mark in (setting.unit, setting.hint and Hint(setting.hint)) if mark]
    for mark in marks:
        kind = Annotated[kind, mark]
    return kind | None if _is_unknown(setting) else kind


def _line(setting: Field) -> str:
    """A setting in a docstring."""
    default = None if _is_unknown(setting) else setting.default
    remark = ", ".join(text for text in (setting.unit, setting.bounds, f"default {default}") if text)
    return f"- `{setting.name}` ({remark}): {setting.meaning}"
