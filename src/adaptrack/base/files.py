"""Reading and writing of TOML, JSON and Parquet files: validation of content, checksums, atomic writing, file names.

An invalid configuration file raises *one* `ConfigError`, which names the file and lists every problem: the key, its
value and the accepted values, or for a misspelt key the most similar valid key. A Parquet file written by this package
contains a checksum of its content, which is verified on reading.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import io
import json
import math
import os
import re
import secrets
import stat
import tomllib
import typing
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, TypeVar

import numpy as np
import tomli_w
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, field_validator
from pydantic.fields import FieldInfo

from adaptrack.base.checked import allowed, checked
from adaptrack.base.errors import ConfigError, InvalidInput, StorageError, did_you_mean, format_value, nearest
from adaptrack.base.limits import TABLE_ROWS, check_limit
from adaptrack.base.presentation import printable as printable

Model = TypeVar("Model", bound=BaseModel)
SHIPPED = Path(__file__).parents[1] / "data"
"""Folder of the files that come with the package, with one subfolder for each kind of file."""

_LONGEST_NAME = 80  # characters of a file name without its suffix; most file systems allow 255 bytes in all
_DEEPEST = 64  # levels of nested tables
_TOO_DEEP = f"more than {_DEEPEST} levels of nested tables; flatten them"
MAX_NUMBERS = 500_000_000
"""Largest number of values in a table that is read (4 GB).

The size of the file is no protection: a constant column of any length is compressed to a few bytes.
"""
MAX_FILE_SIZE = 1_000_000_000
"""Bytes of the largest file that is read, except data sets and trajectories."""
PAGE_FILE = "index.html"
"""Name of a page in its folder."""
_OWN_PAGES = (b'<p class="made">adaptrack ', "· adaptrack</title>".encode())
"""Marks of the pages of this package."""
_REMARKS = ("#", "%", "//")
_NO_PLAIN_FILE = "it is no plain file"
_NOT_TEXT = "contains a NUL or an unpaired surrogate"
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}


class Damaged(StorageError):
    """A file that is truncated or was edited, or whose content does not match its file type."""


# -- names ------------------------------------------------------------------------------------------------------------
def safe_name(name: str) -> str:
    """Return a file name without suffix for any text: 1 to 80 ASCII letters, digits, ``.``, ``_`` and ``-``.

    The result is never a path, a hidden file, a command-line option or a device name of any operating system. A text
    that is already such a name is returned unchanged. Any other result ends in eight digits of the SHA-256 of the text,
    so that similar texts get different files.
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
    """Return `safe_name` of each text; repeated names, ignoring case, are numbered: ``a``, ``A-2``, ``a-3``."""
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
    """Whether a string can be stored in a file: it contains no NUL and no unpaired surrogate."""
    return not re.search("[\0\ud800-\udfff]", text)


def check_texts(where: str, data: Any) -> None:
    """Refuse nested tables with a string that cannot be stored (see `is_text`), or with more than 64 levels.

    The ConfigError begins with `where` (usually a file) and names the key.
    """
    waiting: list[tuple[str, Any, int]] = [("", data, 0)]
    while waiting:  # no recursion, since the number of levels may exceed Python's limit
        key, value, depth = waiting.pop()
        if depth > _DEEPEST:
            raise ConfigError(f"{where}: {format_value(key)}: {_TOO_DEEP}.")
        if isinstance(value, Mapping):
            for name, inner in value.items():
                if isinstance(name, str) and not is_text(name):
                    raise ConfigError(f"{where}: key {format_value(name)}: {_NOT_TEXT}; rename it.")
                waiting.append((f"{key}.{name}" if key else str(name), inner, depth + 1))
        elif isinstance(value, list | tuple):
            waiting += [(f"{key}[{i}]", inner, depth + 1) for i, inner in enumerate(value)]
        elif isinstance(value, str) and not is_text(value):
            raise ConfigError(f"{where}: {key} = {format_value(value)}: {_NOT_TEXT}; remove it.")


# -- configurations ---------------------------------------------------------------------------------------------------


class Record(BaseModel):
    """Base class of validated, immutable sets of named values, such as the content of a configuration file.

    Unknown keys, wrong types, NaN and infinity are refused. A whole number is accepted as a real number; text and
    Booleans are not.

    Raises
    ------
    InvalidInput
        When the constructor receives an invalid value. `build` raises `ConfigError` instead, for content of files.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, ser_json_inf_nan="constants"
    )

    @field_validator("*")
    @classmethod
    def _is_text(cls, value: Any) -> Any:
        if isinstance(value, str) and not is_text(value):
            raise ValueError(f"{_NOT_TEXT}; remove it.")
        return value

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            name = type(self).__name__
            raise InvalidInput(_report(name, problems(error, type(self), values))) from None

    # With this mark pydantic validates the content of files directly instead of through this `__init__`.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some values changed. Unlike pydantic's `model_copy`, it validates the new values."""
        return type(self)(**{**dict(self), **changes})

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write the values as TOML, each followed by a comment with its meaning and unit.

        Raises
        ------
        StorageError
            When the file cannot be written; no partial file is left.
        """
        write_toml(path, self.model_dump(), meanings(self))

    @classmethod
    @checked
    def from_toml(cls, path: str | os.PathLike[str]) -> Self:
        """Read a file that `to_toml` wrote.

        Raises
        ------
        StorageError
            When the file cannot be read.
        ConfigError
            When it is not TOML, or has unknown, missing or invalid values; the message lists all of them.
        """
        return build(cls, read_toml(path), Path(path))


class FieldRecord(Record):
    """A record with an entry for each field of a table (`core.kernel.Field`), with its unit, meaning and bounds.

        class Steering(FieldRecord, fields=STEERING, optional=True):
            "A steering."

    A field without a default is required, or None where `optional` is set. The entries of the class body follow those
    of the table, except the entry `after` and those before it.
    """

    def __init_subclass__(
        cls, fields: Iterable[Any] = (), optional: bool = False, after: str = "", **options: Any
    ) -> None:
        super().__init_subclass__(**options)
        declared = inspect.get_annotations(cls)
        count = 1 + list(declared).index(after) if after else 0
        table = {}
        for field in fields:
            is_unknown = math.isnan(field.default)
            table[field.name] = float | None if is_unknown and optional else float
            setattr(cls, field.name, _entry_of(field, None if optional else ..., is_unknown))
        cls.__annotations__ = dict([*list(declared.items())[:count], *table.items(), *list(declared.items())[count:]])

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def _entry_of(field: Any, unknown: Any, is_unknown: bool) -> Any:
    """Return pydantic's description of a field; unknown: default of one without its own."""
    limits = field.limits | ({"allow_inf_nan": True} if field.bounds.endswith("inf]") else {})
    default = unknown if is_unknown else field.default
    return Field(default=default, description=f"{field.unit or '-'}, {field.meaning}", **limits)


def as_tuples(value: Any) -> Any:
    """Return nested lists and arrays as nested tuples, which immutable records need; mappings keep their keys."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: as_tuples(entry) for key, entry in value.items()}
    return tuple(as_tuples(entry) for entry in value) if isinstance(value, list | tuple) else value


LISTED = BeforeValidator(as_tuples)
"""Converter for tuple fields of a `Record`: they also accept lists, as read from a file, and arrays."""


def meanings(record: Record) -> dict[str, str]:
    """Return the description of each value by its key in the file; inside a section the key is "section.key"."""
    texts = {}
    for name, field in type(record).model_fields.items():
        texts[name] = field.description or ""
        inner = getattr(record, name)
        if isinstance(inner, Record):
            texts |= {f"{name}.{key}": meaning for key, meaning in meanings(inner).items()}
    return texts


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises StorageError when the file cannot be read, and ConfigError, with the line, when it is not UTF-8 or not TOML.
    """
    return _parsed(path, "TOML", tomllib.loads)


def read_json(path: str | os.PathLike[str]) -> Any:
    """Return the content of a JSON file.

    Raises StorageError when the file cannot be read, and ConfigError, with the line, when it is not UTF-8 or not JSON.
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
        position = _too_deep(text)  # checked first: the parser's own depth limit differs between versions of Python
        if position is None and isinstance(error, json.JSONDecodeError):
            raise ConfigError(_syntax_report(where, language, text, str(error))) from error
        line = _line(text, position or 0)
        raise ConfigError(f"{where}, line {line}: {_TOO_DEEP}.") from None
    except ValueError as error:  # Python's limit on the digits of a whole number
        digits = re.search(r"[0-9][0-9_]{999,}", text)
        line = _line(text, digits.start() if digits else 0)
        raise ConfigError(f"{where}, line {line}: a number with too many digits: {error}.") from None
    check_texts(where, data)
    return data


def _line(text: str, position: int) -> int:
    return text.count("\n", 0, position) + 1


def _too_deep(text: str) -> int | None:
    """Return the first position with more than `_DEEPEST` open brackets outside quotes, or None."""
    depth = 0
    for token in re.finditer(r'"(?:\\.|[^"\\\n])*"|[\[\]{}]', text):
        depth += (token[0] in "[{") - (token[0] in "]}")
        if depth > _DEEPEST:
            return token.start()
    return None


def read_bytes(path: str | os.PathLike[str], most: int = MAX_FILE_SIZE) -> bytes:
    """Return the content of a plain file of at most `most` bytes.

    Raises StorageError when it cannot be read; for a device, a pipe or a file that is too large, before it is read.
    """
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode) or (stat.S_ISREG(status.st_mode) and status.st_size <= most):
            return Path(path).read_bytes()
        is_plain = stat.S_ISREG(status.st_mode)
        reason = f"it has {status.st_size:,} bytes, more than {most:,}" if is_plain else _NO_PLAIN_FILE
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        hint = _similar_file(Path(path)) if isinstance(error, FileNotFoundError) else ""
        raise StorageError(f"{printable(os.fspath(path))}: cannot be read: {_reason(error)}.{hint}") from error
    raise StorageError(f"{printable(os.fspath(path))}: cannot be read: {reason}.")


def _similar_file(path: Path) -> str:
    """Return a sentence with the most similar name in the folder of a missing file; empty if none is similar."""
    with contextlib.suppress(OSError):
        name = nearest(path.name, os.listdir(path.parent))
        return f" Did you mean {printable(str(path.with_name(name)))!r}?" if name else ""
    return ""


NumberedLines = list[tuple[int, str]]
"""Lines of a text, each with its number in the file."""


def table_lines(
    where: str, content: bytes, errors: Literal["strict", "replace"]
) -> tuple[NumberedLines, NumberedLines]:
    """Return the lines of a text table, and its remarks (behind ``#``, ``%`` or ``//``) without their mark.

    Empty lines, and the line ``sep=;`` of spreadsheets at the top, are left out. Raises InvalidInput for more than
    `TABLE_ROWS` lines, and for text that is not UTF-8 if `errors` is "strict".
    """
    check_limit(f"{where}: rows", content.count(b"\n"), TABLE_ROWS)
    try:
        text = content.decode("utf-8-sig", errors=errors)
    except UnicodeDecodeError as error:
        raise ConfigError(f"{where}: not a CSV text in UTF-8: {error}.") from error
    lines: NumberedLines = []
    remarks: NumberedLines = []
    for number, line in enumerate(text.splitlines(), start=1):
        plain = line.strip()
        if plain.startswith(_REMARKS):
            remarks.append((number, plain.lstrip("#%/ \t")))
        elif plain and not (number == 1 and re.fullmatch(r'"?sep=.?"?', plain, re.IGNORECASE)):
            lines.append((number, line))
    return lines, remarks


def _reason(error: Exception) -> str:
    return str(getattr(error, "strerror", None) or error)


def build(model_class: type[Model], data: Mapping[str, Any], where: str | os.PathLike[str]) -> Model:
    """Return an object of a pydantic model with the values `data` of its fields, validated.

    Raises ConfigError with all problems of the data, each with its key, its value and the accepted values, behind
    `where`, usually a file.
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
    """Write values and nested tables by key as a TOML file, atomically: see `write_atomically`.

    None values are omitted, since TOML cannot represent them. comments: comment after a value, by key or "section.key",
    such as its unit.
    """
    write_atomically(path, dump_toml(data, comments).encode())


def dump_toml(data: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return the TOML text that `write_toml` writes."""
    remarks = comments or {}
    values = _without_none(dict(data))
    plain = {key: value for key, value in values.items() if not _is_table(value)}  # TOML requires these first
    lines = [_remarked(key, value, remarks.get(key, "")) for key, value in plain.items()]
    parts = ["\n".join([*lines, ""])] if lines else []
    tables = {key: value for key, value in values.items() if key not in plain}
    inner = {
        key: {name[len(key) + 1 :]: remark for name, remark in remarks.items() if name.startswith(f"{key}.")}
        for key in tables
    }
    if without_remarks := {key: value for key, value in tables.items() if not inner[key]}:
        parts.append(tomli_w.dumps(without_remarks))
    parts += [f"[{key}]\n{dump_toml(value, inner[key])}" for key, value in tables.items() if inner[key]]
    return "\n".join(parts)


def _remarked(key: str, value: Any, remark: str) -> str:
    """Return a TOML entry with its remark; lists of numbers, and rows of a table, are put on one line each."""
    text, remark = tomli_w.dumps({key: value}).rstrip("\n"), " ".join(remark.split())
    if remark and isinstance(value, list) and not any(isinstance(element, str) for element in value):
        text = re.sub(r"\[\s+([^\[\]]+?),\s+\]", lambda row: f"[{' '.join(row[1].split())}]", text)
    if "\n" in text:
        return f"# {remark}\n{text}" if remark else text
    return f"{text}  # {remark}" if remark else text


def write_json(path: str | os.PathLike[str], data: Any) -> None:
    """Write a JSON file atomically: see `write_atomically`.

    Numbers that are not finite become ``NaN``, ``Infinity`` or ``-Infinity``.
    """
    write_atomically(path, (json.dumps(data, indent=1) + "\n").encode())


def make_folder(path: Path) -> None:
    """Create a folder unless it exists; raises `StorageError` when that fails."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path}: cannot be created: {_reason(error)}.") from error


def write_atomically(path: str | os.PathLike[str], content: bytes, *, through_links: bool = True) -> None:
    """Write a temporary file in the folder of `path`, then rename it to `path` in one step.

    through_links: if `path` is a symbolic link, True writes the file that it points to; False replaces the link. Raises
    StorageError when the file cannot be written, see also `check_replaceable`; the temporary file is removed and an
    existing file is unchanged.
    """
    try:
        target = Path(os.path.realpath(path)) if through_links else Path(path)
        check_replaceable(target)
        temporary = target.with_name(f".{target.name[-100:]}.{secrets.token_hex(6)}.tmp")
        try:
            with open(temporary, "xb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, target)
        finally:
            with contextlib.suppress(OSError):  # already renamed, or never created
                temporary.unlink()
    except StorageError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise StorageError(f"{printable(os.fspath(path))}: cannot be written: {_reason(error)}.") from error


@contextlib.contextmanager
def keep_replaced(*paths: Path) -> Iterator[list[Path]]:
    """Keep each file that the `with` block replaces by other content, as ``NAME.bak`` beside it.

    Yields a list that holds the paths of the kept files after the block. An older ``NAME.bak`` is replaced. Raises
    StorageError when an existing file cannot be read, or its copy cannot be written.
    """
    previous = {path: read_bytes(path) for path in paths if path.is_file()}
    backups: list[Path] = []
    try:
        yield backups
    finally:
        for path, content in previous.items():
            if not path.is_file() or read_bytes(path) != content:
                backups.append(path.with_name(f"{path.name}.bak"))
                write_atomically(backups[-1], content)


def check_replaceable(path: str | os.PathLike[str]) -> None:
    """Refuse to write to what exists and is no plain file or link, and to a page ``index.html`` of another program.

    The StorageError names the file and the remedy.
    """
    file = Path(path)
    where = f"{printable(os.fspath(path))}: cannot be written"
    if not os.path.lexists(file) or file.is_symlink():
        return
    if not file.is_file():
        raise StorageError(f"{where}: {'it is a folder' if file.is_dir() else _NO_PLAIN_FILE}; give a file name.")
    if file.name == PAGE_FILE and not any(mark in read_bytes(file) for mark in _OWN_PAGES):
        raise StorageError(f"{where}: another program wrote this page; choose another folder, or remove it.")


# -- Parquet tables with a checksum -----------------------------------------------------------------------------------
class ParquetColumn(NamedTuple):
    """A column of a Parquet file."""

    name: str
    unit: str
    """SI unit; ``-`` for pure numbers."""
    values: NDArray[Any]
    """Values, (n,), or (n, m) for a list of m numbers in each row."""
    meaning: str = ""
    """Description of the quantity, stored in the file; may be empty."""


def encode_parquet(kind: str, version: int, columns: Sequence[ParquetColumn], metadata: Mapping[str, Any]) -> bytes:
    """Return the bytes of a Parquet file (zstd) with a checksum; equal content gives equal bytes.

    kind, version: name and version of the file format; metadata: entries about the table that JSON can represent.
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
    checksum = _checksum({column.name: column.values for column in columns}, text)
    content = io.BytesIO()
    pq.write_table(
        pa.Table.from_arrays(
            arrays,
            schema=pa.schema(
                fields, metadata={"format": kind, "format_version": str(version), "about": text, "sha256": checksum}
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
    """Return the columns by name and the metadata of a file that `encode_parquet` made.

    where: name of the file, at the beginning of every message; remedy: advice to the user whose file has a different
    version; required: names of columns that must be present. Raises StorageError for a different file format or
    version, and Damaged for a truncated or edited file.
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
        checksum = stored["sha256"]
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise Damaged(f"{where}: damaged, or edited by another program: {printable(str(error))}.") from error
    if _checksum(columns, stored["about"]) != checksum:
        raise Damaged(f"{where}: damaged, or edited by another program: the checksum of its content does not fit.")
    return columns, metadata


def read_arrow_table(content: bytes, where: str) -> Any:
    """Return the Arrow table of a Parquet file.

    Raises Damaged for a truncated file, or one that is no Parquet file, and StorageError for more than `MAX_NUMBERS`
    values or `TABLE_ROWS` rows.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        file = pq.ParquetFile(pa.BufferReader(content), page_checksum_verification=True)
        # Use only these two fields of the metadata: in a damaged file, reading further ones aborts the process.
        rows = file.metadata.num_rows
        size = rows * file.metadata.num_columns
        if size <= MAX_NUMBERS and rows <= TABLE_ROWS.most:
            # An Arrow thread that releases `content` while Python exits would abort the process.
            return file.read(use_threads=False)
    except Exception as error:  # Arrow raises many types of exceptions for a damaged file
        reason = next(iter(str(error).splitlines()), type(error).__name__).rstrip(".")
        raise Damaged(f"{where}: not a Parquet file, or damaged: {printable(reason)}.") from error
    if size <= MAX_NUMBERS:
        raise StorageError(f"{where}: rows = {rows:,}: {TABLE_ROWS}.")
    raise StorageError(f"{where}: holds {size:,} numbers, more than {MAX_NUMBERS:,}; leave out rows or columns.")


def _checksum(columns: Mapping[str, NDArray[Any]], metadata: str) -> str:
    """Return the SHA-256 of the metadata and of the name, type, shape and values of each column."""
    digest = hashlib.sha256(metadata.encode())
    for name, values in columns.items():
        digest.update(f"{name} {values.dtype} {values.shape}".encode())
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def _array(name: str, stored: Any) -> NDArray[Any]:
    """Return a column as an array (n,), or (n, m) for a column of lists.

    Raises ValueError for missing values, and for values that are no numbers.
    """
    import pyarrow as pa

    values = stored.combine_chunks()
    if values.null_count:
        raise ValueError(f"{values.null_count} missing values in column {name!r}")
    is_fixed_list = pa.types.is_fixed_size_list(values.type)
    array = np.asarray((values.flatten() if is_fixed_list else values).to_numpy(zero_copy_only=False))
    if array.dtype.kind not in "biuf":
        raise ValueError(f"column {name!r} contains {array.dtype} instead of numbers")
    return array.reshape(len(values), -1) if is_fixed_list else array


# -- error messages for configurations --------------------------------------------------------------------------------
def problems(error: ValidationError, model_class: type[BaseModel], data: Mapping[str, Any]) -> list[str]:
    """Return one sentence for each problem that pydantic found in `data`: key, value, accepted values."""
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
        return f"{key}.{selector}: missing; it selects the kind of this table."
    if kind in ("value_error", "assertion_error"):  # a validator of this package wrote a full sentence
        sentence = str(detail["ctx"]["error"])
        if not key:
            return sentence
        return (
            f"{key}: {sentence}" if detail["input"] is None else f"{key} = {format_value(detail['input'])}: {sentence}"
        )
    must = must or detail["msg"].removeprefix("Input should be ")
    return f"{key or 'value'} = {format_value(detail['input'])}: must be {must}{meaning}."


def _key_in_file(location: tuple[int | str, ...], data: Any) -> str:
    """Return the key of a location in the file; parts that name no key of the file are left out."""
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
    """Return the field at a location, or None, and the valid key names at its level."""
    models: list[type[BaseModel]] = [model_class]
    field: FieldInfo | None = None
    field_names: list[str] = []
    for part in location:
        field_names = [name for model in models for name in model.model_fields]
        fields = [model.model_fields[part] for model in models if part in model.model_fields]
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
    """Return the message of a syntax error with its line and column."""
    position = re.search(r"(?:\(at|:) line (\d+),? column (\d+)", message)
    if position is None:
        return f"{where}: not valid {language}: {message}."
    number = int(position[1])
    reason = message[: position.start()].strip()
    line = text.splitlines()[number - 1].strip() if number <= len(text.splitlines()) else ""
    return f"{where}, line {number}, column {position[2]}: not valid {language}: {reason}: {format_value(line)}."


def is_number(cell: str) -> bool:
    """Whether the text in a table cell is a number, which may be infinite or NaN."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def finite_number(text: str) -> float | None:
    """Return the number in a text, or None for other text, infinity and NaN."""
    return float(text) if is_number(text) and math.isfinite(float(text)) else None
