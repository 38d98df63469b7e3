"""TOML files in and out: read with evidence, validated as a whole, written atomically.

A file that cannot be used gives *one* `ConfigError`, which names the file and, for every problem in it, the key, the
value found, what is allowed and, for a misspelt key, the nearest right one.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import tomli_w
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from adaptrack.errors import ConfigError, InvalidInput, StorageError, did_you_mean

Model = TypeVar("Model", bound=BaseModel)

_LONGEST_VALUE = 80  # characters of a rejected value that a message quotes


class Record(BaseModel):
    """A frozen, validated set of named values: unknown keys, wrong types, NaN and infinity are refused.

    A whole number is accepted where a real one is asked for; text and truth values are not.

    Raises
    ------
    InvalidInput
        When built from Python with a value that is not allowed; `build` raises `ConfigError` for files.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, ser_json_inf_nan="constants"
    )

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            name = type(self).__name__
            raise InvalidInput(_report(name, problems(error, type(self), values))) from None

    # Tells pydantic that this is still its own initialiser, so that validating from a file does not pass through it.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def replace(self, **changes: Any) -> Self:
        """A copy with some values changed, validated like a new one (pydantic's own `model_copy` does not validate)."""
        return type(self)(**{**dict(self), **changes})

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the values as TOML, each with its meaning and unit behind it; the file appears whole or not at all.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        meanings = {name: field.description or "" for name, field in type(self).model_fields.items()}
        write_toml(path, self.model_dump(), meanings)


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The contents of a TOML file.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not UTF-8 or not TOML; the message holds the line.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise StorageError(f"{path}: cannot be read: {error.strerror or error}.") from error
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}, line {line}: not UTF-8 text; save the file as UTF-8.") from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_syntax_report(path, text, str(error))) from error


def build(model_class: type[Model], data: Mapping[str, Any], where: str | os.PathLike[str]) -> Model:
    """The validated `model_class` that `data` describes; `where` (a file, usually) opens every message.

    Raises
    ------
    ConfigError
        With all problems of `data`, each with its key, the value found and what is allowed.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{os.fspath(where)}: expected a table of keys, got {_quote(data)}.")
    try:
        return model_class.model_validate(dict(data))
    except ValidationError as error:
        raise ConfigError(_report(os.fspath(where), problems(error, model_class, data))) from None


def write_toml(
    path: str | os.PathLike[str], data: Mapping[str, Any], comments: Mapping[str, str] | None = None
) -> None:
    """Write `data` as TOML: the file appears whole or not at all.

    `comments` maps a top-level key to a remark that is written behind its value (units, for instance).
    A value of `None` is left out: TOML has no word for it.

    Raises
    ------
    StorageError
        When the file cannot be written; an older file at `path` is then untouched.
    """
    write_atomically(path, dump_toml(data, comments).encode())


def dump_toml(data: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """The TOML text of `data`, see `write_toml`."""
    remarks = comments or {}
    values = _without_none(dict(data))
    plain = {key: value for key, value in values.items() if not _is_table(value)}  # TOML wants these first
    lines = []
    for key, value in plain.items():
        line = tomli_w.dumps({key: value}).rstrip("\n")
        remark = " ".join(remarks.get(key, "").split())
        lines.append(f"{line}  # {remark}" if remark and "\n" not in line else line)
    tables = tomli_w.dumps({key: value for key, value in values.items() if key not in plain})
    return "\n".join([*lines, ""]) + ("\n" + tables if lines and tables else tables)


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to a temporary neighbour of `path`, then move it there in one step.

    Raises
    ------
    StorageError
        When that fails; the temporary file is removed and an older file at `path` is untouched.
    """
    target = Path(os.path.realpath(path))
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(6)}.tmp")
    try:
        with open(temporary, "xb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise StorageError(f"{os.fspath(path)}: cannot be written: {error.strerror or error}.") from error
    finally:
        with contextlib.suppress(OSError):  # moved away already, or never there
            temporary.unlink()


def problems(error: ValidationError, model_class: type[BaseModel], data: Mapping[str, Any]) -> list[str]:
    """One sentence per problem that pydantic found in `data`: key, value, what is allowed."""
    return [_problem(dict(detail), model_class, data) for detail in error.errors(include_url=False)]


def _report(where: str, found: list[str]) -> str:
    if len(found) == 1:
        return f"{where}: {found[0]}"
    return f"{where}: {len(found)} problems:" + "".join(f"\n  {sentence}" for sentence in found)


def _problem(detail: dict[str, Any], model_class: type[BaseModel], data: Mapping[str, Any]) -> str:
    location: tuple[int | str, ...] = detail["loc"]
    kind: str = detail["type"]
    key = _key_in_file(location, data)
    field, known = _walk(model_class, location)
    if kind == "extra_forbidden":
        return f"{key}: unknown key. {did_you_mean(str(location[-1]), known)}"
    allowed = _allowed(field) if field is not None else ""
    meaning = f" ({field.description})" if field is not None and field.description else ""
    if kind == "missing":
        return f"{key}: missing; give {allowed or 'a value'}{meaning}."
    if kind == "union_tag_invalid":  # "kind", which selects the shape of a table, has an unknown value
        known = re.findall(r"'([^']*)'", detail["ctx"]["expected_tags"])
        selector = detail["ctx"]["discriminator"].strip("'")
        return f"{key}.{selector} = {detail['ctx']['tag']!r}: unknown. {did_you_mean(detail['ctx']['tag'], known)}"
    if kind == "union_tag_not_found":
        selector = detail["ctx"]["discriminator"].strip("'")
        return f"{key}.{selector}: missing; it says which shape this table describes."
    if kind in ("value_error", "assertion_error"):  # our own validators: their sentence says it all
        sentence = str(detail["ctx"]["error"])
        if not key:
            return sentence
        return f"{key}: {sentence}" if detail["input"] is None else f"{key} = {_quote(detail['input'])}: {sentence}"
    must = f"must be {allowed}" if allowed else detail["msg"].replace("Input should be", "must be")
    return f"{key or 'value'} = {_quote(detail['input'])}: {must}{meaning}."


def _quote(value: Any) -> str:
    text = repr(value)
    if len(text) <= _LONGEST_VALUE:
        return text
    return text[: _LONGEST_VALUE // 2 - 3] + "..." + text[-_LONGEST_VALUE // 2 :]  # a path ends with what matters


def _key_in_file(location: tuple[int | str, ...], data: Any) -> str:
    """`location` as it stands in the file; pydantic's own marks in it (which member of a union) are left out."""
    key = ""
    for position, part in enumerate(location):
        inside = (isinstance(data, Mapping) and part in data) or (
            isinstance(data, list | tuple) and isinstance(part, int) and part < len(data)
        )
        if inside:
            data = data[part]
        elif not (isinstance(data, Mapping) and position == len(location) - 1):
            continue
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else str(part)
    return key


def _walk(model_class: type[BaseModel], location: tuple[int | str, ...]) -> tuple[FieldInfo | None, list[str]]:
    """The field at `location`, if there is one, and the key names that are known beside it."""
    models: list[type[BaseModel]] = [model_class]
    field: FieldInfo | None = None
    known: list[str] = []
    for part in location:
        known = [name for model in models for name in _field_names(model)]
        fields = [_field_names(model)[part] for model in models if part in _field_names(model)]
        if fields:
            field = fields[0]
            models = [inner for each in fields for inner in _models_in(each.annotation)]
        elif isinstance(part, int):
            field = None if models else field
        else:
            tagged = [model for model in models if part == model.__name__ or part in _literals(model)]
            models = tagged or models
            field = None
    return field, known


def _field_names(model: type[BaseModel]) -> dict[Any, FieldInfo]:
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _literals(model: type[BaseModel]) -> set[Any]:
    return {
        word
        for field in model.model_fields.values()
        if typing.get_origin(field.annotation) is Literal
        for word in typing.get_args(field.annotation)
    }


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in typing.get_args(annotation):
        yield from _models_in(argument)


def _allowed(field: FieldInfo) -> str:
    """What `field` accepts, in words; empty when it is too rich for a phrase."""
    annotation: Any = field.annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        rest = [each for each in typing.get_args(annotation) if each is not type(None)]
        annotation = rest[0] if len(rest) == 1 else None
    if typing.get_origin(annotation) is Literal:
        return "one of " + ", ".join(repr(word) for word in typing.get_args(annotation))
    infinite = any(getattr(each, "allow_inf_nan", False) for each in field.metadata)
    noun = {
        float: "a number" if infinite else "a finite number",
        int: "a whole number",
        str: "text",
        bool: "true or false",
    }
    if annotation not in noun:
        return ""
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    bounds = [
        f"{sign} {getattr(each, name):.6g}"
        for name, sign in signs
        for each in field.metadata
        if getattr(each, name, None) is not None
    ]
    return " ".join([noun[annotation], " and ".join(bounds)]).strip()


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(inner) for key, inner in value.items() if inner is not None}
    if isinstance(value, list | tuple):
        return [_without_none(inner) for inner in value]
    return value


def _is_table(value: Any) -> bool:
    tables = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(each, Mapping) for each in value)
    return isinstance(value, Mapping) or tables


def _syntax_report(path: Path, text: str, message: str) -> str:
    """A TOML syntax error with the line that holds it."""
    found = re.search(r"\(at line (\d+), column (\d+)\)", message)
    if found is None:
        return f"{path}: not valid TOML: {message}."
    number = int(found[1])
    reason = message[: found.start()].strip()
    line = text.splitlines()[number - 1].strip() if number <= len(text.splitlines()) else ""
    return f"{path}, line {number}, column {found[2]}: not valid TOML: {reason}: {_quote(line)}."
