"""The memory of an exported controller as structs of C; its constants as an initialiser and as a file.

The memory is a head, the record of the kernels as `core.kernel.Resident` lays it, the constants and the state:

    constants   numbers of the record, and arrays that do not change or begin as constants
    state       all arrays that change; a saved state is these

All are words of 8 bytes. A file holds the words of the constants, little-endian, and begins with `FILE_HEAD`. Constants
of different controllers fit the same program if their layout is the same: names, sizes, whole numbers, and which
numbers are unknown. The other numbers have the bounds of their fields.
"""

from __future__ import annotations

import math
import struct
import textwrap
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.core import library
from adaptrack.core.build.c_types import RecordOf, c_identifier, field_remarks, field_type
from adaptrack.core.build.scopes import comment_after
from adaptrack.core.kernel import EXPORTED, INTERPRETED, Array, Field, Scalar, int64, size_of

MAGIC, FILE_FORMAT = b"ADTRACK\0", 2
FILE_HEAD = struct.Struct("<8s5Q")
"""magic, format, CRC-32 of what follows, `kernels_number`, CRC-32 of the layout, words that follow the head"""
MEMORY_HEAD_WORDS = 8
"""Words of `adaptrack_head` in C."""
CACHE_LINE_WORDS = 8
"""Words: an array of so many or more begins at a multiple of it, a cache line, in a memory that begins at one."""
SHARED = ("period", "angle_min", "angle_max", "move_min", "move_max", "mass", "lf", "lr", "wheelbase")
"""Names of numbers that are the same wherever they stand among constants."""
LARGEST_NUMBER = 2**31
"""A whole number of a record beyond it is no count, no flag: it is an address."""
WRAP_WIDTH = 118


# -- the members of a record ------------------------------------------------------------------------------------------
class Member(NamedTuple):
    """An array of a record, a record of numbers in it, or a number."""

    name: str
    """dotted, from the record on"""
    kind: Any
    values: NDArray[Any]
    kernel: str = ""
    """whose address the number is"""

    @property
    def c_name(self) -> str:
        return self.name.replace(".", "_")

    @property
    def place(self) -> str:
        """Where the record has it, in C."""
        return ".".join(map(c_identifier, self.name.split(".")))

    @property
    def is_array(self) -> bool:
        return isinstance(self.kind, Array)

    @property
    def number_kind(self) -> Any:
        """The type of its numbers: a scalar or a record of numbers."""
        return self.kind.of if self.is_array else self.kind

    @property
    def words(self) -> NDArray[np.uint64]:
        return np.frombuffer(self.values.tobytes(), np.uint64)

    def is_among(self, names: Sequence[str]) -> bool:
        """Return whether its dotted name, or that of a record that it is in, is among names."""
        return f"{self.name}.".startswith(tuple(f"{name}." for name in names))

    @property
    def declaration(self) -> str:
        """The member of a struct."""
        kind = self.number_kind
        c = field_type(kind).c if isinstance(kind, Scalar) else RecordOf(kind).c
        return f"    {c} {self.c_name}{f'[{self.values.size}]' if self.is_array else ''};"


def members_of(record: Any, before: str = "") -> Iterator[Member]:
    """The members of a record in order, those of records with arrays or addresses one by one.

    Raises InvalidInput when kernels are interpreted, or the record holds a function that is none of the package's
    kernels.
    """
    if INTERPRETED:
        raise InvalidInput("export: the kernels are interpreted (ADAPTRACK_KERNELS); what is exported is compiled.")
    kernels = kernel_names()
    for (name, kind), value in zip(record.kinds.items(), record, strict=True):
        full = f"{before}{name}"
        if isinstance(kind, Array):
            yield Member(full, kind, value)
        elif isinstance(kind, Scalar) and value in kernels:
            yield Member(full, kind, np.zeros((), np.int64), kernels[value])
        elif isinstance(kind, Scalar):
            if kind == int64 and abs(value) >= LARGEST_NUMBER:
                raise InvalidInput(f"export: {full} is a function of your own, and only the package's are compiled.")
            yield Member(full, kind, np.array(value, kind.name))
        elif kind.dtype is None or any(isinstance(number, int) and abs(number) >= LARGEST_NUMBER for number in value):
            yield from members_of(value, f"{full}.")
        else:
            yield Member(full, kind, np.array(tuple(value), kind.dtype))


def kernel_names() -> dict[int, str]:
    """The names of the kernels that have an address in this process, by it."""
    return {kernel.address: name for name, kernel in EXPORTED.items() if "address" in vars(kernel)}


def record_words(kind: Any) -> int:
    """Words of a record as `core.kernel.Resident` lays it."""
    parts = kind.kinds.values()
    return sum(1 + part.ndim if isinstance(part, Array) else record_words(part) if hasattr(part, "kinds") else 1
               for part in parts)  # fmt: skip


def kernels_number() -> int:
    """The hash of the kernels as a word."""
    return int(library.kernels_hash()[:16], 16)


def file_of(layout: int, words: NDArray[np.uint64]) -> bytes:
    """The file of some words."""
    behind = struct.pack("<3Q", kernels_number(), layout, words.size) + words.astype("<u8").tobytes()
    return struct.pack("<8s2Q", MAGIC, FILE_FORMAT, zlib.crc32(behind)) + behind


# -- the numbers of constants -----------------------------------------------------------------------------------------
class Bounds(NamedTuple):
    """Bounds of a word of the constants."""

    rule: str
    """EXACT: as exported; ANY; NUMBER: any but NaN; BETWEEN: least to most; SAME: as another word"""
    least: float = 0.0
    most: float = 0.0
    twin: int = 0
    """the other word"""


class ConstantWord(NamedTuple):
    """A word of the constants."""

    name: str
    text: str
    """in C"""
    bounds: Bounds
    remark: str = ""


def _number(
    name: str, value: Any, free: str, setting: Field | None = None, row: Any = None, remark: str = ""
) -> ConstantWord:
    """A number of a row; free: the rule where its field has no bounds."""
    if isinstance(value, np.integer):
        return ConstantWord(name, str(value), Bounds("EXACT"), remark)
    default = np.ravel(setting.default)[0] if setting else 0.0
    if isinstance(default, np.integer):
        bounds = Bounds("EXACT")
    elif free == "ANY" or (math.isnan(default) and setting is not None and not setting.bounds):
        bounds = Bounds("ANY")
    elif math.isnan(value):
        bounds = Bounds("EXACT")
    else:
        bounds = _between(setting, row) if setting and setting.bounds else Bounds(free)
    return ConstantWord(name, c_number(float(value)), bounds, remark)


def _between(setting: Field, row: Any) -> Bounds:
    """The bounds of a field, of which each is a number or the name of another field of the row."""
    low, high = (
        float(row[end] if end in row.dtype.names else end) for end in setting.bounds[1:-1].replace(" ", "").split(",")
    )
    low = low if setting.bounds[0] == "[" else math.nextafter(low, math.inf)
    high = high if setting.bounds[-1] == "]" else math.nextafter(high, -math.inf)
    return Bounds("BETWEEN", low, high)


def _row_numbers(before: str, row: Any, kind: Any, free: str) -> Iterator[ConstantWord]:
    """The numbers of a row by their designators in C, those of rows within it included."""
    remarks = field_remarks(kind)
    for name, of in kind.kinds.items():
        count = math.prod(of[1:]) if type(of) is tuple else 0
        entry_kind = of[0] if count else of
        for i, entry in enumerate(np.ravel(row[name]) if count else [row[name]]):
            full = f"{before}{c_identifier(name)}{f'[{i}]' if count else ''}"
            if isinstance(entry_kind, Scalar):
                yield _number(full, entry, free, kind.field_settings.get(name), row, remarks.get(name, ""))
            else:
                yield from _row_numbers(f"{full}.", entry, entry_kind, free)


def c_number(value: float) -> str:
    """A double in C, exact; NaN is the one of `math.h`."""
    if math.isnan(value):
        return "NAN"
    return f"{'-' if value < 0 else ''}HUGE_VAL" if math.isinf(value) else repr(value)


# -- the memory -------------------------------------------------------------------------------------------------------
class ArrayRoles(NamedTuple):
    """The arrays of a record that are not only state, by dotted names of arrays or of records of them."""

    fixed: Sequence[str]
    """arrays that are constants"""
    renewed: Mapping[str, str]
    """state that begins as a constant, and does so again when constants are replaced: the name of that constant"""
    outside: Sequence[str]
    """the program gives them: they have no words"""
    unknown: Sequence[str]
    """constants that may be NaN"""


class CMemory:
    """The memory of a record whose arrays are as they shall be before the first step.

    views: kinds of the first numbers of vectors, by their names: records of numbers, None for a number.

    Raises
    ------
    InvalidInput
        See `members_of`.
    """

    def __init__(self, record: Any, roles: ArrayRoles, views: Mapping[str, Sequence[Any]]) -> None:
        self.record, self.roles, self.views = record, roles, views
        self.members = [member for member in members_of(record) if not member.is_among(roles.outside)]
        self.arrays = [member for member in self.members if member.is_array]
        self.links = [member for member in self.members if member.kernel]
        self.functions = sorted({member.kernel for member in self.links})
        self.constants = [member for member in self.members if self._is_constant(member)]
        state = (member for member in self.arrays if member.values.size and not member.is_among(roles.fixed))
        self.state = sorted(state, key=lambda member: (member.words.size % CACHE_LINE_WORDS != 0, member.words.size))

    def _is_constant(self, member: Member) -> bool:
        if not member.is_array:  # numbers of a part that the controller lacks are zero
            return bool(member.words.any())
        is_own = self.roles.renewed.get(member.name) == member.name
        return member.values.size > 0 and (is_own or member.is_among(self.roles.fixed))

    # -- sizes --------------------------------------------------------------------------------------------------------
    def placed_state(self) -> Iterator[tuple[int, Member]]:
        """The word of the state at which each member begins: large ones at a cache line."""
        end = 0
        for member in self.state:
            count = member.words.size
            begin = end + (-end % CACHE_LINE_WORDS if count >= CACHE_LINE_WORDS else 0)
            yield begin, member
            end = begin + count

    @cached_property
    def _state_words(self) -> int:
        return max(begin + member.words.size for begin, member in self.placed_state())

    @property
    def _gap_before_state(self) -> int:
        """Words before the state, which begins at a cache line."""
        return -(MEMORY_HEAD_WORDS + record_words(type(self.record)) + len(self.content) // 8) % CACHE_LINE_WORDS

    @property
    def size(self) -> int:
        """Bytes that a C program reserves."""
        words = MEMORY_HEAD_WORDS + record_words(type(self.record)) + self._gap_before_state + self._state_words
        return 8 * words + len(self.content)

    @property
    def state_size(self) -> int:
        """Bytes of a saved state."""
        return FILE_HEAD.size + 8 * self._state_words

    # -- constants ----------------------------------------------------------------------------------------------------
    @cached_property
    def numbers(self) -> dict[str, list[ConstantWord]]:
        """The words of each member of the constants."""
        numbers: dict[str, list[ConstantWord]] = {}
        first: dict[tuple[str, str], int] = {}
        word = FILE_HEAD.size // 8
        for member in self.constants:
            numbers[member.name] = part = list(self._numbers_of(member))
            for i, number in enumerate(part):
                key = number.name.rpartition(".")[2], number.text
                if key in first:
                    part[i] = number._replace(bounds=Bounds("SAME", twin=first[key]))
                elif key[0] in SHARED:
                    first[key] = word
                word += 1
        return numbers

    def _numbers_of(self, member: Member) -> Iterator[ConstantWord]:
        kind, free = member.number_kind, "ANY" if member.name in self.roles.unknown else "NUMBER"
        flat, at = member.values.ravel(), 0
        if not isinstance(kind, Scalar):
            for i, row in enumerate(flat):
                yield from _row_numbers(f"[{i}]." if member.is_array else ".", row, kind, free)
            return
        for view in self.views.get(member.name, ()):
            count = 1 if view is None else size_of(view)
            if view is not None:
                yield from _row_numbers("", flat[at : at + count].view(view.dtype)[0], view, free)
            else:
                yield _number(f"[{at}]", flat[at], free)
            at += count
        yield from (_number(f"[{i}]", flat[i], free) for i in range(at, flat.size))

    @cached_property
    def layout(self) -> int:
        """CRC-32 of names, sizes, whole numbers, and which numbers are unknown or the same."""
        shapes = [(member.name, member.kernel, member.values.shape) for member in self.members]
        exact = [(name, i, number.text) for name, numbers in self.numbers.items()
                 for i, number in enumerate(numbers) if number.bounds.rule == "EXACT"]  # fmt: skip
        twins = [number.bounds.twin for numbers in self.numbers.values() for number in numbers]
        return zlib.crc32(repr((shapes, exact, twins)).encode())

    @cached_property
    def content(self) -> bytes:
        """The constants as a file."""
        return file_of(self.layout, np.concatenate([member.words for member in self.constants]))

    # -- texts --------------------------------------------------------------------------------------------------------
    def structs(self) -> str:
        """The structs in C."""
        state: list[str] = []
        end = 0
        for begin, member in self.placed_state():
            state += [f"    uint64_t before_{member.c_name}[{begin - end}];"] if begin > end else []
            state.append(member.declaration)
            end = begin + member.words.size
        gap = self._gap_before_state
        return "\n".join([
            "/* Numbers that do not change while the car drives; a file of constants holds the same words. */",
            "struct adaptrack_constants {", "    uint64_t magic, format, checksum, kernels, layout, words;",
            *(member.declaration for member in self.constants), "};", "",
            "/* All that changes: a saved state. */", "struct adaptrack_state {", *state, "};", "",
            "/* A tracker. */", "struct adaptrack_memory {", "    adaptrack_head head;",
            f"    {RecordOf(type(self.record)).c} record;", "    struct adaptrack_constants constants;",
            *([f"    uint64_t before_state[{gap}];"] if gap else []), "    struct adaptrack_state state;", "};",
            f"typedef char adaptrack_memory_has_its_size[sizeof(struct adaptrack_memory) == {self.size} ? 1 : -1];",
        ])  # fmt: skip

    def connections(self) -> str:
        """The functions in C that give the record its arrays and kernels, and the numbers of the constants."""
        state = {member.name: member for member in self.state}
        connected = [
            *(f"r->{member.place} = {self._array(member)};" for member in self.arrays),
            *(f"r->{member.place} = (int64_t)(intptr_t)adaptrack_{member.kernel};" for member in self.links),
        ]
        renewed = [f"r->{member.place} = c->{member.c_name};" for member in self.constants if not member.is_array]
        for name, source in self.roles.renewed.items():
            if name in state:
                copied = f"s->{state[name].c_name}[i] = c->{source.replace('.', '_')}[i];"
                renewed.append(f"for (int i = 0; i < {state[name].values.size}; i++) {copied}")
        declared = "\n".join(f"extern void adaptrack_{name}(void);" for name in self.functions)
        record = f"    {RecordOf(type(self.record)).c} *r = &m->record;"
        return f"""{declared}

void adaptrack_connect(struct adaptrack_memory *m) {{
{record}
    struct adaptrack_constants *c = &m->constants;
    struct adaptrack_state *s = &m->state;
{_indented(connected)}
}}

void adaptrack_renew(struct adaptrack_memory *m) {{
{record}
    const struct adaptrack_constants *c = &m->constants;
    struct adaptrack_state *s = &m->state;
{_indented(renewed)}
}}
"""

    def _array(self, member: Member) -> str:
        """An array as the record has it."""
        home = "0"
        if member.values.size:
            home = f"{'c' if member.is_among(self.roles.fixed) else 's'}->{member.c_name}"
        return f"{field_type(member.kind).name}_of({', '.join([home, *map(str, member.values.shape)])})"

    def initialiser(self) -> str:
        """The constants in C."""
        _, version, *hashes, words = FILE_HEAD.unpack_from(self.content)
        head = [f"{number:#x}u" for number in (int.from_bytes(MAGIC, "little"), version, *hashes)]
        lines = [f"    {', '.join(head)}, {words},"]
        for member in self.constants:
            numbers = self.numbers[member.name]
            if isinstance(member.kind, Scalar):
                lines.append(f"    .{member.c_name} = {numbers[0].text},")
                continue
            lines += [f"    .{member.c_name} = {{", *self._lines_of(member), "    },"]
        return "\n".join(["static const struct adaptrack_constants CONSTANTS = {", *lines, "};"])

    def _lines_of(self, member: Member) -> Iterator[str]:
        """The numbers of a member in an initialiser; zeros in rows within rows are left out."""
        numbers = self.numbers[member.name]
        if not isinstance(member.number_kind, Scalar):
            for number in numbers:
                if float(number.text.replace("HUGE_VAL", "inf")) != 0.0 or number.name.count("].") <= member.is_array:
                    yield f"        {number.name} = {number.text},{comment_after(number.remark)}"
            return
        for is_plain, part in groupby(numbers, lambda number: number.name.startswith("[")):
            if is_plain:
                yield _indented([f"{', '.join(number.text for number in part)},"], 8)
            else:
                for number in part:
                    remark = ": ".join(filter(None, (number.name, number.remark)))
                    yield f"        {number.text},{comment_after(remark)}"

    def bounds(self) -> str:
        """The bounds of each word behind the head in C, a row for words in a row that have the same."""
        lines, first = [], FILE_HEAD.size // 8
        numbers = [(name, number) for name, part in self.numbers.items() for number in part]
        for (rule, least, most, twin), part in groupby(numbers, lambda pair: pair[1].bounds):
            group = list(part)
            name, number = group[0]
            ends = f"{c_number(least)}, {c_number(most)}"
            lines.append(f"    {{{first}, {len(group)}, {rule}, {twin}, {ends}}}, /* {name}: {number.name} */")
            first += len(group)
        return "\n".join(["const adaptrack_bounds adaptrack_words[] = {", *lines, "};"])


def _indented(lines: Iterable[str], indent: int = 4) -> str:
    """Lines of C, broken where they are too long."""
    before = " " * indent
    return "\n".join(
        textwrap.fill(
            line, WRAP_WIDTH, initial_indent=before, subsequent_indent=before + "    ", break_long_words=False
        )
        for line in lines
    )
