"""A WebAssembly module of one object file, without a linker: none is small, and a page needs no more than this.

An object (WebAssembly tool conventions, Linking.md) that imports no function keeps the numbers of its functions, types,
tables and globals when it becomes a module. What remains: its data lie behind a stack, addresses in code and data grow
by as much, and what it imports (memory, table, stack pointer) is defined and exported. The stack grows down to address
0: one that is too small ends in a trap, not in data that are overwritten.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from .objects import Reader

STACK = 2**18
"""bytes"""
MEMORY_PAGE = 2**16
"""bytes of a page of memory"""
TYPE, IMPORT, FUNCTION, TABLE_SECTION, MEMORY, GLOBAL, EXPORT, _START, ELEMENT, CODE, DATA, DATA_COUNT = range(1, 13)
"""Sections of a module (Core Specification 2.0, section 5.5.2)."""
_ORDER = (TYPE, FUNCTION, TABLE_SECTION, MEMORY, GLOBAL, EXPORT, DATA_COUNT, CODE, DATA)
_KEPT = {0, 6, 7, 20}
"""Relocations of numbers that stay: of functions, types, globals, tables."""
_ADDRESSES = {3: 5, 4: 5, 5: 4}
"""Relocations of addresses: the bytes that each has, unsigned, signed, or as they are."""
_I32, _FUNCREF, _MUTABLE, _CONST, _END = 0x7F, 0x70, 0x01, 0x41, 0x0B
_IMPORTED = {"__linear_memory": 2, "__indirect_function_table": 1, "__stack_pointer": 3}


class _Symbol(NamedTuple):
    kind: int
    name: str
    exported: bool
    number: int
    """of the function, or of the segment in which data lie"""
    offset: int = 0
    """of data in their segment"""


def linked(content: bytes, stack: int = STACK) -> bytes:
    """The module of an object file: memory, table and global functions are exported under their names.

    Raises ValueError for an object that needs more than memory, table and stack pointer, or a relocation of another
    kind.
    """
    sections = list(_sections(content))
    numbered = {kind: section for kind, _, section in sections if kind != 0}
    custom = {name: section for kind, name, section in sections if kind == 0}
    _refuse_imports(numbered[IMPORT])
    if ELEMENT in numbered:
        raise ValueError("an object with a table of functions: only records hold their addresses")
    symbols = list(_symbols(custom["linking"]))
    code, data = (bytearray(numbered.get(kind, b"")) for kind in (CODE, DATA))
    places, end = _places(bytes(data), stack)
    for name, section in (("reloc.CODE", code), ("reloc.DATA", data)):
        if name in custom:
            _relocate(section, Reader(custom[name]), symbols, places)
    global_section = Reader(numbered.get(GLOBAL, b"\0"))
    pointer = bytes([_I32, _MUTABLE, _CONST]) + _signed(stack) + bytes([_END])
    numbered |= {
        TABLE_SECTION: bytes([1, _FUNCREF, 0, 1]),  # entry 0 stays empty
        MEMORY: bytes([1, 0]) + _unsigned(-(-end // MEMORY_PAGE)),
        GLOBAL: _unsigned(1 + global_section.number()) + pointer + global_section.remainder(),
        EXPORT: _exports(symbols),
        CODE: bytes(code),
    }
    if places:
        numbered[DATA] = _moved(bytes(data), places)
    return content[:8] + b"".join(bytes([kind]) + _sized(numbered[kind]) for kind in _ORDER if kind in numbered)


def _sections(content: bytes) -> Iterator[tuple[int, str, bytes]]:
    """Kind, name (of custom ones) and content of each."""
    if not content.startswith(b"\0asm\1\0\0\0"):
        raise ValueError("not an object file of WebAssembly")
    reader = Reader(content, 8)
    while reader.at < len(content):
        kind, section = reader.byte(), reader.sized()
        section_reader = Reader(section)
        name = section_reader.sized().decode() if kind == 0 else ""
        yield kind, name, section_reader.remainder()


def _refuse_imports(content: bytes) -> None:
    reader = Reader(content)
    for _ in range(reader.number()):
        reader.sized()
        name, kind = reader.sized().decode(), reader.byte()
        if _IMPORTED.get(name) != kind:
            raise ValueError(f"an object that needs {name}")
        if kind == 3:
            reader.at += 2
            continue
        reader.at += 1 if kind == 1 else 0
        for _ in range(1 + (reader.number() & 1)):
            reader.number()


def _symbols(content: bytes) -> Iterator[_Symbol]:
    """Those of the linking section, in their order."""
    reader = Reader(content)
    if reader.number() != 2:
        raise ValueError("an object with another version of linking metadata than 2")
    while reader.at < len(content):
        kind, table = reader.byte(), Reader(reader.sized())
        if kind != 8:
            continue
        for _ in range(table.number()):
            yield _symbol(table)


def _symbol(table: Reader) -> _Symbol:
    kind, flags = table.byte(), table.number()
    undefined, local, hidden, is_named = flags & 0x10, flags & 0x02, flags & 0x04, flags & 0x40
    if kind == 1:
        name = table.sized().decode()
        if undefined:
            raise ValueError(f"an object that needs {name}")
        segment, offset, _ = table.number(), table.number(), table.number()
        return _Symbol(kind, name, False, segment, offset)
    index = table.number()
    name = table.sized().decode() if kind != 3 and (not undefined or is_named) else ""
    return _Symbol(kind, name, kind == 0 and not (undefined or local or hidden), index)


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Where each segment of data lies, and what it holds."""
    reader = Reader(data)
    for _ in range(reader.number() if data else 0):
        if reader.byte() != 0 or reader.byte() != _CONST:
            raise ValueError("a segment of data that does not lie at an address")
        place = reader.number()  # below 2^31
        if reader.byte() != _END:
            raise ValueError("a segment of data at an address that is computed")
        yield place, reader.sized()


def _places(data: bytes, base: int) -> tuple[list[int], int]:
    """Where each segment lies when the first one begins at `base`, and where all end."""
    places = [(base + place, len(content)) for place, content in _segments(data)]
    return [place for place, _ in places], max((place + size for place, size in places), default=base)


def _moved(data: bytes, places: list[int]) -> bytes:
    parts = [
        bytes([0, _CONST]) + _signed(place) + bytes([_END]) + _sized(content)
        for place, (_, content) in zip(places, _segments(data), strict=True)
    ]
    return _unsigned(len(parts)) + b"".join(parts)


def _relocate(target: bytearray, reader: Reader, symbols: list[_Symbol], segments: list[int]) -> None:
    """Write the addresses of data; what is numbered stays."""
    reader.number()  # the section
    for _ in range(reader.number()):
        kind, at, index = reader.byte(), reader.number(), reader.number()
        if kind in _KEPT:
            continue
        if kind not in _ADDRESSES:
            raise ValueError(f"a relocation of type {kind}")
        size, symbol = _ADDRESSES[kind], symbols[index]
        address = segments[symbol.number] + symbol.offset + reader.signed()
        new = struct.pack("<I", address) if kind == 5 else _unsigned(address, 5) if kind == 3 else _signed(address, 5)
        target[at : at + size] = new


def _exports(symbols: list[_Symbol]) -> bytes:
    entries = [("memory", 2, 0), ("__indirect_function_table", 1, 0)]
    entries += [(symbol.name, 0, symbol.number) for symbol in symbols if symbol.exported]
    return _unsigned(len(entries)) + b"".join(
        _sized(name.encode()) + bytes([kind]) + _unsigned(index) for name, kind, index in entries
    )


def _sized(content: bytes) -> bytes:
    return _unsigned(len(content)) + content


def _unsigned(value: int, width: int = 1) -> bytes:
    """Seven bits a byte, the lowest first (LEB128), in so many bytes at least."""
    encoded = bytearray()
    while value >= 0x80 or len(encoded) < width - 1:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def _signed(value: int, width: int = 1) -> bytes:
    """Encode a non-negative number as signed LEB128."""
    encoded = _unsigned(value, width)
    return encoded if not encoded[-1] & 0x40 else bytes([*encoded[:-1], encoded[-1] | 0x80, 0])
