"""Files in and out (TOML, JSON, Parquet) and their names: read with evidence, validated, written atomically.

A configuration that cannot be used gives *one* `ConfigError`, which names the file and, for every problem in it, the
key, the value found, what is allowed and, for a misspelt key, the nearest right one. A Parquet file of ours proves its
own content by a checksum.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import secrets
import tomllib
import typing
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, field_validator
from pydantic.fields import FieldInfo

from adaptrack.base.checked import allowed
from adaptrack.base.errors import ConfigError, InvalidInput, StorageError, did_you_mean, format_value
from adaptrack.base.text import printable as printable

Model = TypeVar("Model", bound=BaseModel)
SHIPPED = Path(__file__).parents[1] / "data"
"""The folder of the files that come with the package, a folder a kind."""

_LONGEST_NAME = 80  # characters of a file name without its suffix; most file systems allow 255 bytes in all
_DEEPEST = 64  # tables within tables
MAX_NUMBERS = 500_000_000
"""Numbers in a table that is read, 4 GB; a constant column takes some bytes in a file, however long it is."""
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}


class Damaged(StorageError):
    """A file that is torn, was edited, or cannot be read as what its name says."""


# -- names ------------------------------------------------------------------------------------------------------------
def safe_name(name: str) -> str:
    """`name` as the name of a file, without a suffix: ASCII letters, digits, ``.``, ``_`` and ``-``, 1 to 80 of them.

    It is never empty, a path, a hidden file, an option or a device of any system. A harmless name stays as it is;
    another ends in eight digits of its SHA-256, so that two names that look alike get two files.
    """
    ascii_only = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", ascii_only).strip("-._")
    if plain.split(".")[0].lower() in _DEVICES:
        plain = f"name-{plain}"
    if plain and plain == name and len(plain) <= _LONGEST_NAME:
        return plain
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{plain[: _LONGEST_NAME - 9].strip('-._') or 'unnamed'}-{digest}"


def safe_names(names: Iterable[str]) -> list[str]:
    """`safe_name` of each; those equal to a file system that ignores case are numbered: ``a``, ``a-2``, ``a-3``."""
    used_names: set[str] = set()
    file_names = []
    for name in map(safe_name, names):
        numbered, n = name, 1
        while numbered.lower() in used_names:
            n += 1
            numbered = f"{name}-{n}"
        used_names.add(numbered.lower())
        file_names.append(numbered)
    return file_names


def is_text(text: str) -> bool:
    """Whether files can hold it: no NUL, and no half of a surrogate pair."""
    return not re.search("[\0\ud800-\udfff]", text)


def check_texts(where: str, data: Any) -> None:
    """Refuse tables with a key or a value that is no text, see `is_text`, or with more than 64 tables in one another.

    Raises
    ------
    ConfigError
        With `where` (a file, usually) and the key.
    """
    waiting: list[tuple[str, Any, int]] = [("", data, 0)]
    while waiting:  # not recursive: the depth is what is to be found
        key, value, depth = waiting.pop()
        if depth > _DEEPEST:
            raise ConfigError(
                f"{where}: {format_value(key)}: more than {_DEEPEST} tables in one another; flatten them."
            )
        if isinstance(value, Mapping):
            for name, inner in value.items():
                if isinstance(name, str) and not is_text(name):
                    raise ConfigError(f"{where}: key {format_value(name)}: holds a NUL or half a character; rename it.")
                waiting.append((f"{key}.{name}" if key else str(name), inner, depth + 1))
        elif isinstance(value, list | tuple):
            waiting += [(f"{key}[{i}]", inner, depth + 1) for i, inner in enumerate(value)]
        elif isinstance(value, str) and not is_text(value):
            raise ConfigError(f"{where}: {key} = {format_value(value)}: holds a NUL or half a character; remove it.")


# -- configurations ---------------------------------------------------------------------------------------------------


class Record(BaseModel):
    """A frozen, validated set of named values: unknown keys, wrong types, NaN and infinity are refused.

    A whole number is accepted for a real one; text and truth values are not.

    Raises
    ------
    InvalidInput
        When built from Python with a value that is not allowed; `build` raises `ConfigError` for files.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, ser_json_inf_nan="constants"
    )

    @field_validator("*")
    @classmethod
    def _is_text(cls, value: Any) -> Any:
        if isinstance(value, str) and not is_text(value):
            raise ValueError("holds a NUL or half a character; remove it.")
        return value

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
        write_toml(path, self.model_dump(), meanings(self))


def _tuple_of(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(value) if isinstance(value, list) else value


LISTED = BeforeValidator(_tuple_of)
"""Of a field that is a tuple: a list, as files have it, or an array is taken as well."""


def meanings(record: Record) -> dict[str, str]:
    """Return the description of each value in a file; of a value in a section, by "section.key"."""
    texts = {}
    for name, field in type(record).model_fields.items():
        texts[name] = field.description or ""
        inner = getattr(record, name)
        if isinstance(inner, Record):
            texts |= {f"{name}.{key}": meaning for key, meaning in meanings(inner).items()}
    return texts


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The contents of a TOML file.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not UTF-8 or not TOML; the message holds the line.
    """
    return _parsed(path, "TOML", tomllib.loads)


def read_json(path: str | os.PathLike[str]) -> Any:
    """The contents of a JSON file.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not UTF-8 or not JSON; the message holds the line.
    """
    return _parsed(path, "JSON", json.loads)


def _parsed(path: str | os.PathLike[str], language: str, parse: Callable[[str], Any]) -> Any:
    where, raw = os.fspath(path), read_bytes(path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{where}, line {line}: not UTF-8 text; save the file as UTF-8.") from error
    try:
        data = parse(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(_syntax_report(where, language, text, str(error))) from error
    except (json.JSONDecodeError, RecursionError) as error:
        position = _too_deep(text)  # first, as the depth that a parser can follow depends on the version of Python
        if position is None and isinstance(error, json.JSONDecodeError):
            raise ConfigError(_syntax_report(where, language, text, str(error))) from error
        line = _line(text, position or 0)
        raise ConfigError(f"{where}, line {line}: more than {_DEEPEST} tables in one another; flatten them.") from None
    except ValueError as error:  # Python's limit on the digits of a whole number
        digits = re.search(r"[0-9][0-9_]{999,}", text)
        line = _line(text, digits.start() if digits else 0)
        raise ConfigError(f"{where}, line {line}: a number with too many digits: {error}.") from None
    check_texts(where, data)
    return data


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def _too_deep(text: str) -> int | None:
    """The position at which more than `_DEEPEST` brackets outside quotes are open, or None."""
    depth = 0
    for token in re.finditer(r'"(?:\\.|[^"\\\n])*"|[\[\]{}]', text):
        depth += (token[0] in "[{") - (token[0] in "]}")
        if depth > _DEEPEST:
            return token.start()
    return None


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The contents of a file.

    Raises
    ------
    StorageError
        When it cannot be read.
    """
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise StorageError(f"{printable(os.fspath(path))}: cannot be read: {_reason(error)}.") from error


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def build(model_class: type[Model], data: Mapping[str, Any], where: str | os.PathLike[str]) -> Model:
    """The validated `model_class` that `data` describes; `where` (a file, usually) opens every message.

    Raises
    ------
    ConfigError
        With all problems of `data`, each with its key, the value found and what is allowed.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{os.fspath(where)}: expected a table of keys, got {format_value(data)}.")
    try:
        return model_class.model_validate(dict(data))
    except ValidationError as error:
        raise ConfigError(_report(os.fspath(where), problems(error, model_class, data))) from None


def write_toml(
    path: str | os.PathLike[str], data: Mapping[str, Any], comments: Mapping[str, str] | None = None
) -> None:
    """Write `data` as TOML: the file appears whole or not at all.

    `comments` maps a key, or "section.key", to a remark that is written behind its value (units, for instance).
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
    lines = [_remarked(key, value, remarks.get(key, "")) for key, value in plain.items()]
    parts = ["\n".join([*lines, ""])] if lines else []
    tables = {key: value for key, value in values.items() if key not in plain}
    inner = {
        key: {name[len(key) + 1 :]: remark for name, remark in remarks.items() if name.startswith(f"{key}.")}
        for key in tables
    }
    if other := {key: value for key, value in tables.items() if not inner[key]}:
        parts.append(tomli_w.dumps(other))
    parts += [f"[{key}]\n{dump_toml(value, inner[key])}" for key, value in tables.items() if inner[key]]
    return "\n".join(parts)


def _remarked(key: str, value: Any, remark: str) -> str:
    """A line of TOML with a remark behind its value, where there is one and it fits; a list of numbers in one line."""
    text, remark = tomli_w.dumps({key: value}).rstrip("\n"), " ".join(remark.split())
    if remark and isinstance(value, list) and not any(isinstance(element, str | list) for element in value):
        text = re.sub(r",\n\]$", "]", text).replace("[\n    ", "[").replace("\n    ", " ")
    return f"{text}  # {remark}" if remark and "\n" not in text else text


def write_json(path: str | os.PathLike[str], data: Any) -> None:
    """Write `data` as JSON, numbers that are not finite as JavaScript has them: the file appears whole or not at all.

    Raises
    ------
    StorageError
        When the file cannot be written; an older file at `path` is then untouched.
    """
    write_atomically(path, (json.dumps(data, indent=1) + "\n").encode())


def write_atomically(path: str | os.PathLike[str], content: bytes, *, through_links: bool = True) -> None:
    """Write `content` to a temporary neighbour of `path`, then move it there in one step.

    through_links: where `path` is a symbolic link, write what it points to; else the link itself is replaced.

    Raises
    ------
    StorageError
        When that fails; the temporary file is removed and an older file at `path` is untouched.
    """
    try:
        target = Path(os.path.realpath(path)) if through_links else Path(path)
        temporary = target.with_name(f".{target.name[-100:]}.{secrets.token_hex(6)}.tmp")
        try:
            with open(temporary, "xb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, target)
        finally:
            with contextlib.suppress(OSError):  # moved away already, or never there
                temporary.unlink()
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise StorageError(f"{printable(os.fspath(path))}: cannot be written: {_reason(error)}.") from error


# -- tables that prove their content ----------------------------------------------------------------------------------
class ParquetColumn(NamedTuple):
    """A column of a Parquet file."""

    name: str
    unit: str
    """SI; ``-`` for pure numbers."""
    values: NDArray[Any]
    """(n,), or (n, m) for a list of m numbers in each row."""
    meaning: str = ""


def encode_parquet(kind: str, version: int, columns: Sequence[ParquetColumn], metadata: Mapping[str, Any]) -> bytes:
    """A Parquet file (zstd) of `columns`; the same content gives the same bytes.

    kind, version: of the format; metadata: entries about the table, plain JSON. A checksum of `metadata` and
    of all names, types and numbers goes along.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields, arrays = [], []
    for name, unit, values, meaning in columns:
        array = pa.array(np.ascontiguousarray(values).reshape(-1))
        if values.ndim == 2:
            array = pa.FixedSizeListArray.from_arrays(array, values.shape[1])
        field_metadata = {"unit": unit, "meaning": meaning} if meaning else {"unit": unit}
        arrays.append(array)
        fields.append(pa.field(name, array.type, nullable=False, metadata=field_metadata))
    text = json.dumps(dict(metadata), sort_keys=True)
    proof = _checksum({column.name: column.values for column in columns}, text)
    content = io.BytesIO()
    pq.write_table(
        pa.Table.from_arrays(
            arrays,
            schema=pa.schema(
                fields, metadata={"format": kind, "format_version": str(version), "about": text, "sha256": proof}
            ),
        ),
        content,
        compression="zstd",
        compression_level=12,
        use_dictionary=[column.name for column in columns if column.values.ndim == 1],
        use_byte_stream_split=[f"{column.name}.list.element" for column in columns if column.values.ndim == 2],
        write_page_checksum=True,
    )
    return content.getvalue()


def decode_parquet(
    content: bytes, where: str | os.PathLike[str], kind: str, version: int, remedy: str, required: Iterable[str] = ()
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """The columns of a file that `encode_parquet` made, and what it says of itself; `where` opens every message.

    remedy: what to do with a file of another version; required: columns that must be there.

    Raises
    ------
    StorageError
        When it is something else, or of another version.
    Damaged
        When it is torn or was edited.
    """
    where = os.fspath(where)
    table = read_arrow_table(content, where)
    try:
        stored = {key.decode(): value.decode() for key, value in (table.schema.metadata or {}).items()}
    except UnicodeDecodeError as error:
        raise Damaged(f"{where}: damaged: its metadata are not text.") from error
    if stored.get("format") != kind:
        file_kind = printable(stored.get("format", "a table of another program"))
        raise StorageError(f"{where}: holds no {kind.removeprefix('adaptrack ')}, but {file_kind}.")
    if stored.get("format_version") != str(version):
        by = f" by adaptrack {stored['adaptrack']}" if "adaptrack" in stored else ""
        origin = printable(f"written{by} in format version {stored.get('format_version', '(unknown)')}")
        raise StorageError(f"{where}: {origin}, this adaptrack reads version {version}: {remedy}.")
    try:
        for name in required:
            if name not in table.column_names:
                raise ValueError(f"there is no column {name!r}")
        columns = {name: _array(name, table.column(name)) for name in table.column_names}
        metadata = json.loads(stored["about"])
        proof = stored["sha256"]
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise Damaged(f"{where}: damaged, or edited by another program: {printable(str(error))}.") from error
    if _checksum(columns, stored["about"]) != proof:
        raise Damaged(f"{where}: damaged, or edited by another program: the checksum of its content does not fit.")
    return columns, metadata


def read_arrow_table(content: bytes, where: str) -> Any:
    """The Arrow table of a Parquet file.

    Raises
    ------
    Damaged
        When it is no Parquet file, or torn.
    StorageError
        When it holds more than `MAX_NUMBERS` numbers.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
        size = file.metadata.num_rows * file.metadata.num_columns  # more detail of a damaged footer aborts Arrow
        if size <= MAX_NUMBERS:
            # Without threads: one of Arrow's that lets go of `content` while Python exits would abort the process.
            return file.read(use_threads=False)
    except Exception as error:  # of a damaged footer Arrow makes almost any of them
        reason = next(iter(str(error).splitlines()), type(error).__name__).rstrip(".")
        raise Damaged(f"{where}: not a Parquet file, or damaged: {printable(reason)}.") from error
    raise StorageError(f"{where}: holds {size:,} numbers, more than {MAX_NUMBERS:,}; leave out rows or columns.")


def _checksum(columns: Mapping[str, NDArray[Any]], metadata: str) -> str:
    """SHA-256 of every name, type and number, and of `metadata`."""
    digest = hashlib.sha256(metadata.encode())
    for name, values in columns.items():
        digest.update(f"{name} {values.dtype} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _array(name: str, stored: Any) -> NDArray[Any]:
    """(n,), or (n, m) of a column of lists; ValueError with the reason when it has missing values or other types."""
    import pyarrow as pa

    values = stored.combine_chunks()
    if values.null_count:
        raise ValueError(f"{values.null_count} missing values in column {name!r}")
    is_fixed_list = pa.types.is_fixed_size_list(values.type)
    array = np.asarray((values.flatten() if is_fixed_list else values).to_numpy(zero_copy_only=False))
    if array.dtype.kind not in "biuf":
        raise ValueError(f"column {name!r} holds {array.dtype}, which are no numbers")
    return array.reshape(len(values), -1) if is_fixed_list else array


# -- what is wrong with a configuration -------------------------------------------------------------------------------
def problems(error: ValidationError, model_class: type[BaseModel], data: Mapping[str, Any]) -> list[str]:
    """One sentence per problem that pydantic found in `data`: key, value, what is allowed."""
    return [_problem(dict(detail), model_class, data) for detail in error.errors(include_url=False)]


def _report(where: str, problems: list[str]) -> str:
    if len(problems) == 1:
        return f"{where}: {problems[0]}"
    return f"{where}: {len(problems)} problems:" + "".join(f"\n  {sentence}" for sentence in problems)


def _problem(detail: dict[str, Any], model_class: type[BaseModel], data: Mapping[str, Any]) -> str:
    location: tuple[int | str, ...] = detail["loc"]
    kind: str = detail["type"]
    key = _key_in_file(location, data)
    field, field_names = _walk(model_class, location)
    if kind == "extra_forbidden":
        return f"{key}: unknown key. {did_you_mean(str(location[-1]), field_names)}"
    must = allowed(field) if field is not None else ""
    meaning = f" ({field.description})" if field is not None and field.description else ""
    if kind == "missing":
        return f"{key}: missing; give {must or 'a value'}{meaning}."
    if kind == "union_tag_invalid":  # "kind", which selects the shape of a table, has an unknown value
        field_names = re.findall(r"'([^']*)'", detail["ctx"]["expected_tags"])
        selector = detail["ctx"]["discriminator"].strip("'")
        return (
            f"{key}.{selector} = {detail['ctx']['tag']!r}: unknown. {did_you_mean(detail['ctx']['tag'], field_names)}"
        )
    if kind == "union_tag_not_found":
        selector = detail["ctx"]["discriminator"].strip("'")
        return f"{key}.{selector}: missing; it says which shape this table describes."
    if kind in ("value_error", "assertion_error"):  # our own validators: their sentence says it all
        sentence = str(detail["ctx"]["error"])
        if not key:
            return sentence
        return (
            f"{key}: {sentence}" if detail["input"] is None else f"{key} = {format_value(detail['input'])}: {sentence}"
        )
    must = must or detail["msg"].removeprefix("Input should be ")
    return f"{key or 'value'} = {format_value(detail['input'])}: must be {must}{meaning}."


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
    field_names: list[str] = []
    for part in location:
        field_names = [name for model in models for name in _field_names(model)]
        fields = [_field_names(model)[part] for model in models if part in _field_names(model)]
        if fields:
            field = fields[0]
            models = [inner for model_field in fields for inner in _models_in(model_field.annotation)]
        elif isinstance(part, int):
            field = None if models else field
        else:
            tagged = [model for model in models if part == model.__name__ or part in _literals(model)]
            models = tagged or models
            field = None
    return field, field_names


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


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(inner) for key, inner in value.items() if inner is not None}
    if isinstance(value, list | tuple):
        return [_without_none(inner) for inner in value]
    return value


def _is_table(value: Any) -> bool:
    tables = (
        isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(element, Mapping) for element in value)
    )
    return isinstance(value, Mapping) or tables


def _syntax_report(where: str, language: str, text: str, message: str) -> str:
    """A syntax error with the line that holds it."""
    position = re.search(r"(?:\(at|:) line (\d+),? column (\d+)", message)
    if position is None:
        return f"{where}: not valid {language}: {message}."
    number = int(position[1])
    reason = message[: position.start()].strip()
    line = text.splitlines()[number - 1].strip() if number <= len(text.splitlines()) else ""
    return f"{where}, line {number}, column {position[2]}: not valid {language}: {reason}: {format_value(line)}."


def is_number(cell: str) -> bool:
    """Whether a cell of a table of text is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
