"""A record of the core as bytes that a C program lays into its own memory: the constants of what is exported.

Everything is little-endian; nothing is an address. A block is

    magic, format version, CRC-32 of all behind it, hash of the kernels, size, `Header`
    places    (word of an address, word that it points to)
    links     (word of an address, CRC-32 of the name of the function that it points to)
    starts    (first word, count, first word of what they begin with), see `ArrayStart`
    runs      (first word, count) of the words that are not zero
    resets    (word, its value) when constants are replaced under way
    the words of the runs, one behind the other

and describes a memory of 8-byte words: the record as `core.kernel.Resident` lays it, then its arrays, ordered by
`ArrayRole`. `src/adaptrack_block.c` is the reader.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.core import library
from adaptrack.core.kernel import EXPORTED, INTERPRETED, Array, float64

MAGIC, BLOCK_FORMAT = b"ADTRACK\0", 1
PRELUDE = struct.Struct("<8sII")
"""magic, format, CRC-32 of what follows"""
BLOCK_HEADER = struct.Struct("<Q12I")
CACHE_LINE_WORDS = 8
"""Words: an array of so many or more begins at a multiple of it, a cache line, in a memory that begins at one."""
BEFORE_MEMORY, BEFORE_STATE = 64, 48
"""Bytes that the C sources keep before a memory (`adaptrack_head`) and before the words of a saved state."""
LARGEST_NUMBER = 2**31
"""An int64 of a record beyond it is no count, no flag: it is an address."""


class ArrayRole(IntEnum):
    """Treatment of an array when constants are replaced under a running controller and when its state is saved.

    The order is that of the memory.
    """

    FIXED = 0
    """constant: taken from the block, not part of a saved state"""
    RENEWED = 1
    """follows from constants, and is written to: taken from the block, saved"""
    KEPT = 2
    """state, or what is kept from one step to the next: stays, saved"""


class ArrayStart(NamedTuple):
    """An array that begins as another one does: with other constants it begins anew where that one is another."""

    of: str
    """name of the array, which is `Role.KEPT`"""
    like: str
    """name of the one that it begins with, which is `Role.FIXED`"""


class Header(NamedTuple):
    """Numbers of a block behind its prelude."""

    kernels: int
    """first 64 bits of `core.library.kernels_hash`"""
    size: int
    """bytes of the block"""
    kind: int
    """CRC-32 of the record's name"""
    layout: int
    """CRC-32 of sizes, places and links: blocks that share it may be exchanged under a running controller"""
    words: int
    """of the memory"""
    record: int
    """words of the record, with which the memory begins"""
    first_renewed: int
    """word of the RENEWED arrays"""
    first_kept: int
    """word of the KEPT arrays"""
    places: int
    links: int
    starts: int
    runs: int
    resets: int


class ArrayLayout(NamedTuple):
    """An array of a record, as the C sources check it."""

    name: str
    word: int
    """of the record, of its address; its sizes follow"""
    sizes: tuple[int, ...]
    entry: int
    """words of an entry"""
    kind: str
    """``f`` of float64, ``i`` of int64, ``V`` of rows"""
    role: ArrayRole
    values: NDArray[np.uint64]
    """the words before the first step"""


@dataclass(frozen=True)
class Block:
    """A record as bytes."""

    content: bytes
    header: Header
    functions: tuple[str, ...]
    """names of the kernels whose addresses it holds"""
    links: dict[int, str]
    """the kernel whose address each of these words of the record holds"""
    arrays: tuple[ArrayLayout, ...] = field(repr=False)
    """in the order of the record"""
    record: tuple[int, ...] = field(repr=False)
    """its words, those of numbers signed"""
    words: dict[str, int] = field(repr=False)
    """the word at which each field lies: a number itself, of an array its first entry"""

    @property
    def checksum(self) -> int:
        """CRC-32, by which constants are known again."""
        return int(PRELUDE.unpack_from(self.content)[2])

    @property
    def memory_size(self) -> int:
        """Bytes of the memory, without what the C side keeps before it."""
        return 8 * self.header.words

    @property
    def laid_size(self) -> int:
        """Bytes that a C program reserves for it."""
        return BEFORE_MEMORY + self.memory_size

    @property
    def state_size(self) -> int:
        """Bytes of it that a saved state holds."""
        return 8 * (self.header.words - self.header.first_renewed)

    @property
    def saved_size(self) -> int:
        """Bytes of a saved state."""
        return BEFORE_STATE + self.state_size


class _Part(NamedTuple):
    """An array of the record."""

    name: str
    word: int
    """of its address"""
    values: NDArray[Any]
    role: ArrayRole

    @property
    def first(self) -> int:
        return int(self.values.__array_interface__["data"][0])

    @property
    def last(self) -> int:
        return self.first + self.values.nbytes

    def layout(self) -> ArrayLayout:
        """The array as the C sources check it."""
        return ArrayLayout(
            self.name, self.word, self.values.shape, self.values.itemsize // 8, self.values.dtype.kind, self.role,
            np.frombuffer(self.values.tobytes(), np.uint64),
        )  # fmt: skip


def pack(
    record: Any,
    name: str,
    roles: Mapping[str, ArrayRole],
    starts: Sequence[ArrayStart] = (),
    resets: Mapping[str, Mapping[str, float]] | None = None,
    outside: Sequence[str] = (),
) -> Block:
    """The block of a record whose arrays are as they shall be before the first step.

    name: of the kind of record, which the reader must expect; roles: by dotted names of arrays or of records of them
    (``mpc.ws``), the longest one that fits counts, `Role.KEPT` where none does; resets: array of rows -> field ->
    value that it gets when constants are replaced (of arrays that there are, like `starts`); outside: arrays that the
    C program gives, so that they have no words here.

    Raises
    ------
    InvalidInput
        When kernels are interpreted, or the record holds a function that is none of the package's kernels.
    """
    if INTERPRETED:
        raise InvalidInput("export: the kernels are interpreted (ADAPTRACK_KERNELS); what is exported is compiled.")
    laid = _Laid(roles, tuple(outside))
    laid.lay("", record)
    memory = laid.settle()
    home = {part.name: place for part, place in laid.placed}
    changes = [
        (home[rows] + _offset(laid.part(rows).values, name), _bits(value))
        for rows, fields in (resets or {}).items()
        if rows in home
        for name, value in fields.items()
    ]
    begins = [
        (home[start.of], laid.part(start.of).values.nbytes // 8, home[start.like])
        for start in starts
        if start.of in home and laid.part(start.of).values.size
    ]
    places = [(part.word, place) for part, place in laid.placed]
    links = [(word, _number(function)) for word, function in laid.links]
    runs = _runs(memory)
    shape = repr((name, len(memory), places, links, begins, laid.shapes, laid.outside)).encode()
    tables = [*places, *links, *begins, *runs]
    remainder = b"".join(struct.pack(f"<{len(row)}I", *row) for row in tables)
    remainder += bytes(-len(remainder) % 8)
    remainder += b"".join(struct.pack("<QQ", word, value) for word, value in changes)
    remainder += b"".join(memory[first : first + count].tobytes() for first, count in runs)
    header = Header(
        int(library.kernels_hash()[:16], 16), PRELUDE.size + BLOCK_HEADER.size + len(remainder), _number(name),
        zlib.crc32(shape), len(memory), len(laid.words), laid.first[ArrayRole.RENEWED], laid.first[ArrayRole.KEPT],
        len(places), len(links), len(begins), len(runs), len(changes),
    )  # fmt: skip
    behind = BLOCK_HEADER.pack(*header) + remainder
    content = PRELUDE.pack(MAGIC, BLOCK_FORMAT, zlib.crc32(behind)) + behind
    functions = tuple(sorted({function for _, function in laid.links}))
    if len({_number(name) for name in functions}) < len(functions):
        raise InvalidInput(f"export: two of {', '.join(functions)} have one CRC-32: rename one.")
    arrays = tuple(part.layout() for part, _ in laid.placed)
    return Block(content, header, functions, dict(laid.links), arrays, tuple(laid.words), laid.numbers | home)


def _number(name: str) -> int:
    return zlib.crc32(name.encode())


def _bits(value: float) -> int:
    return int(struct.unpack("<Q", struct.pack("<d", value))[0])


def _offset(rows: NDArray[Any], name: str) -> int:
    """The word at which a field lies in the first of some rows."""
    assert rows.dtype.fields is not None
    return int(rows.dtype.fields[name][1]) // 8


def _runs(memory: NDArray[np.uint64]) -> list[tuple[int, int]]:
    """Stretches of words that are not zero; a single zero within is cheaper than another run."""
    filled = np.flatnonzero(memory)
    if not filled.size:
        return []
    breaks = np.flatnonzero(np.diff(filled) > 2)
    firsts = np.concatenate([filled[:1], filled[breaks + 1]])
    lasts = np.concatenate([filled[breaks], filled[-1:]])
    return [(int(a), int(b - a + 1)) for a, b in zip(firsts, lasts, strict=True)]


class _Laid:
    """A record on its way into a memory."""

    def __init__(self, roles: Mapping[str, ArrayRole], outside: tuple[str, ...]) -> None:
        self.words: list[int] = []
        self.numbers: dict[str, int] = {}
        self.links: list[tuple[int, str]] = []
        self.shapes: list[tuple[int, ...]] = []
        self.outside, self._roles = outside, roles
        self.placed: list[tuple[_Part, int]] = []
        """arrays and where they lie"""
        self.first: dict[ArrayRole, int] = {}
        self._parts: list[_Part] = []
        self._kernels = {kernel.address: name for name, kernel in EXPORTED.items() if "address" in vars(kernel)}

    def part(self, name: str) -> _Part:
        return next(part for part in self._parts if part.name == name)

    def lay(self, before: str, record: Any) -> None:
        """The words of a record, as `core.kernel.Resident` has them."""
        for (name, kind), value in zip(record.kinds.items(), record, strict=True):
            full = f"{before}{name}"
            if isinstance(value, tuple):
                self.lay(f"{full}.", value)
                continue
            self.numbers[full] = len(self.words)
            if isinstance(kind, Array):
                self._lay_array(full, value)
            elif kind is float64:
                self.words.append(_bits(float(value)))
            else:
                self.words.append(self._integer_word(full, int(value)))

    def _lay_array(self, name: str, values: NDArray[Any]) -> None:
        if name.startswith(tuple(f"{prefix}." for prefix in self.outside)) or name in self.outside:
            self.words += [0] * (1 + values.ndim)
            return
        self._parts.append(_Part(name, len(self.words), values, self._role(name)))
        self.shapes.append(values.shape)
        self.words += (0, *values.shape)

    def _role(self, name: str) -> ArrayRole:
        fits = [prefix for prefix in self._roles if name == prefix or name.startswith(f"{prefix}.")]
        return self._roles[max(fits, key=len)] if fits else ArrayRole.KEPT

    def _integer_word(self, name: str, value: int) -> int:
        if value in self._kernels:
            self.links.append((len(self.words), self._kernels[value]))
            return 0
        if abs(value) >= LARGEST_NUMBER:
            raise InvalidInput(f"export: {name} is a function of your own, and only the package's are compiled ahead.")
        return value % 2**64

    def settle(self) -> NDArray[np.uint64]:
        """Give every array its place; the memory with all of them in it. Arrays that share memory keep sharing it."""
        filled = [part for part in self._parts if part.values.size]
        size, stretches = len(self.words), sorted(_stretches(filled), key=_order)
        self.placed = [(part, 0) for part in self._parts if not part.values.size]
        laid: list[tuple[int, NDArray[np.uint64]]] = []
        for role in ArrayRole:
            size += -size % CACHE_LINE_WORDS
            self.first[role] = size
            for stretch_role, parts in stretches:
                if stretch_role is not role:
                    continue
                first, last = min(part.first for part in parts), max(part.last for part in parts)
                count = (last - first) // 8
                size += -size % CACHE_LINE_WORDS if count >= CACHE_LINE_WORDS else 0
                for part in parts:
                    self.placed.append((part, size + (part.first - first) // 8))
                    laid.append((self.placed[-1][1], np.frombuffer(part.values.tobytes(), np.uint64)))
                size += count
        memory = np.zeros(size, np.uint64)
        memory[: len(self.words)] = self.words
        for place, words in laid:
            memory[place : place + words.size] = words
        self.placed.sort(key=lambda placed: placed[0].word)
        return memory


def _order(stretch: tuple[ArrayRole, list[_Part]]) -> int:
    """Order the parts independently of their addresses, which differ between processes."""
    return min(part.word for part in stretch[1])


def _stretches(parts: Sequence[_Part]) -> Iterator[tuple[ArrayRole, list[_Part]]]:
    """Arrays that overlap, together; the most lasting of their roles counts."""
    end, group = 0, list[_Part]()
    for part in sorted(parts, key=lambda part: (part.first, part.last)):
        if group and part.first >= end:
            yield max(member.role for member in group), group
            group = []
        end = max(end, part.last) if group else part.last
        group.append(part)
    if group:
        yield max(member.role for member in group), group
