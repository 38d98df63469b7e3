"""What an object file or a library leaves to others: the functions that it calls and does not have.

Formats: ELF-64, little-endian (System V Application Binary Interface, chapter 4), and WebAssembly (Core Specification
2.0, section 5.5).
"""

from __future__ import annotations

import struct

_SYMBOLS = (2, 11)  # sections of type SHT_SYMTAB and SHT_DYNSYM
_LINKERS_OWN = "_GLOBAL_OFFSET_TABLE_"


def undefined(content: bytes) -> list[str]:
    """The names that a file leaves undefined; of WebAssembly the functions that it imports.

    Raises ValueError for another format.
    """
    if content.startswith(b"\x7fELF\x02\x01"):
        return sorted(_of_elf(content) - {_LINKERS_OWN})
    if content.startswith(b"\0asm"):
        return sorted(_of_wasm(content))
    raise ValueError("neither ELF-64 nor WebAssembly.")


def _of_elf(content: bytes) -> set[str]:
    (start,) = struct.unpack_from("<Q", content, 0x28)
    size, count = struct.unpack_from("<HH", content, 0x3A)
    sections = [struct.unpack_from("<IIQQQQIIQQ", content, start + size * i) for i in range(count)]
    found = set()
    for section in sections:
        if section[1] in _SYMBOLS:
            names = sections[section[6]][4]
            for name, _, _, home, _, _ in struct.iter_unpack("<IBBHQQ", content[section[4] : section[4] + section[5]]):
                if home == 0 and name != 0:
                    found.add(content[names + name : content.index(b"\0", names + name)].decode())
    return found


class _Reader:
    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 0

    def number(self) -> int:
        """An unsigned integer of seven bits a byte, the lowest first (LEB128)."""
        value = shift = 0
        while True:
            byte = self.content[self.at]
            self.at, value, shift = self.at + 1, value | (byte & 0x7F) << shift, shift + 7
            if byte < 0x80:
                return value

    def bytes(self) -> bytes:
        size = self.number()
        self.at += size
        return self.content[self.at - size : self.at]


def _of_wasm(content: bytes) -> set[str]:
    sections, found = _Reader(content[8:]), set()
    while sections.at < len(sections.content):
        kind, body = sections.number(), _Reader(sections.bytes())
        if kind != 2:
            continue
        for _ in range(body.number()):
            body.bytes()
            name, what = body.bytes().decode(), body.number()
            if what == 0:  # a function, of a type
                found.add(name)
                body.number()
            elif what == 3:  # a global: its type, and whether it varies
                body.at += 2
            else:  # a table (of a type) or the memory: limits
                body.at += 1 if what == 1 else 0
                for _ in range(1 + (body.number() & 1)):
                    body.number()
    return found
