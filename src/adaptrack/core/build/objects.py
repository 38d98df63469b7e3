"""What an object file or a library leaves to others: the functions that it calls and does not have.

Formats: ELF, little-endian (System V Application Binary Interface, chapter 4), WebAssembly (Core Specification
2.0, section 5.5), COFF and PE (Microsoft, PE Format) and Mach-O (Apple, mach-o/loader.h and nlist.h).
"""

from __future__ import annotations

import struct

_SYMBOLS = (2, 11)  # sections of type SHT_SYMTAB and SHT_DYNSYM
_LINKERS_OWN = "_GLOBAL_OFFSET_TABLE_"


def undefined(content: bytes) -> list[str]:
    """The names that a file leaves undefined; of WebAssembly the functions, of a DLL the libraries that it imports.

    Raises ValueError for another format.
    """
    if content.startswith((b"\x7fELF\x01\x01", b"\x7fELF\x02\x01")):
        return sorted(_elf_symbols(content) - {_LINKERS_OWN})
    if content.startswith(b"\0asm"):
        return sorted(_wasm_symbols(content))
    if content.startswith(b"\xcf\xfa\xed\xfe"):
        return sorted(_mach_o_symbols(content))
    if content.startswith(b"\x64\x86"):
        return sorted(_coff_symbols(content))
    if content.startswith(b"MZ"):
        return sorted(_dll_symbols(content))
    raise ValueError("neither ELF nor WebAssembly, COFF, PE or Mach-O.")


def _text(content: bytes, at: int) -> str:
    return content[at : content.index(b"\0", at)].decode()


def _elf_symbols(content: bytes) -> set[str]:
    long = content[4] == 2  # of 64 bits
    (start,) = struct.unpack_from("<Q", content, 0x28) if long else struct.unpack_from("<I", content, 0x20)
    size, count = struct.unpack_from("<HH", content, 0x3A if long else 0x2E)
    row = "<IIQQQQIIQQ" if long else "<10I"
    sections = [struct.unpack_from(row, content, start + size * i) for i in range(count)]
    undefined_names = set()
    for section in sections:
        if section[1] in _SYMBOLS:
            names, symbols = sections[section[6]][4], content[section[4] : section[4] + section[5]]
            for symbol in struct.iter_unpack("<IBBHQQ" if long else "<IIIBBH", symbols):
                name, home = symbol[0], symbol[3] if long else symbol[5]
                if home == 0 and name != 0:
                    undefined_names.add(_text(content, names + name))
    return undefined_names


def _coff_symbols(content: bytes) -> set[str]:
    start, count = struct.unpack_from("<II", content, 8)
    names, at, symbols = start + 18 * count, start, set()
    while at < names:
        name, value, home, _, kind, auxiliary = struct.unpack_from("<8sIhHBB", content, at)
        if kind == 2 and home == 0 and value == 0:  # of an external symbol
            short, offset = struct.unpack("<II", name)
            symbols.add(name.rstrip(b"\0").decode() if short else _text(content, names + offset))
        at += 18 * (1 + auxiliary)
    return symbols


def _dll_symbols(content: bytes) -> set[str]:
    (start,) = struct.unpack_from("<I", content, 0x3C)
    count, optional = struct.unpack_from("<H12xH", content, start + 6)
    (imports,) = struct.unpack_from("<I", content, start + 24 + 120)
    sections = [struct.unpack_from("<IIII", content, start + 24 + optional + 40 * i + 8) for i in range(count)]

    def place(address: int) -> int:
        return next(raw + address - begin for size, begin, _, raw in sections if begin <= address < begin + size)

    symbols, at = set(), place(imports) if imports else 0
    while at and (name := struct.unpack_from("<I", content, at + 12)[0]):
        symbols.add(_text(content, place(name)))
        at += 20
    return symbols


def _mach_o_symbols(content: bytes) -> set[str]:
    (count,) = struct.unpack_from("<I", content, 16)
    at, undefined_names = 32, set()
    for _ in range(count):
        command, size, start, symbols, names, _ = struct.unpack_from("<6I", content, at)
        if command == 2:  # LC_SYMTAB
            for i in range(symbols):
                name, kind, _, _, value = struct.unpack_from("<IBBHQ", content, start + 16 * i)
                if kind & 0x0F == 1 and value == 0:  # N_UNDF | N_EXT
                    undefined_names.add(_text(content, names + name).removeprefix("_"))
        at += size
    return undefined_names


class Reader:
    """Reader of the parts of a WebAssembly file in their order."""

    def __init__(self, content: bytes, at: int = 0) -> None:
        self.content, self.at = content, at

    def byte(self) -> int:
        self.at += 1
        return self.content[self.at - 1]

    def number(self) -> int:
        """An unsigned integer of seven bits a byte, the lowest first (LEB128)."""
        value = shift = 0
        while True:
            byte = self.content[self.at]
            self.at, value, shift = self.at + 1, value | (byte & 0x7F) << shift, shift + 7
            if byte < 0x80:
                return value

    def signed(self) -> int:
        """Read a signed LEB128 number."""
        begin = self.at
        value = self.number()
        bits = 7 * (self.at - begin)
        return value - 2**bits if value >> (bits - 1) else value

    def sized(self) -> bytes:
        """So many as the number says that stands before them."""
        size = self.number()
        self.at += size
        return self.content[self.at - size : self.at]

    def remainder(self) -> bytes:
        """All from here on."""
        return self.content[self.at :]


def _wasm_symbols(content: bytes) -> set[str]:
    sections, symbols = Reader(content[8:]), set()
    while sections.at < len(sections.content):
        kind, section = sections.number(), Reader(sections.sized())
        if kind != 2:
            continue
        for _ in range(section.number()):
            section.sized()
            name, kind_code = section.sized().decode(), section.number()
            if kind_code == 0:  # a function, of a type
                symbols.add(name)
                section.number()
            elif kind_code == 3:  # a global: its type, and whether it varies
                section.at += 2
            else:  # a table (of a type) or the memory: limits
                section.at += 1 if kind_code == 1 else 0
                for _ in range(1 + (section.number() & 1)):
                    section.number()
    return symbols
