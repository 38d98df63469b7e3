"""C sources of an export, compiled and called from the tests."""

import ctypes
import subprocess
import zlib
from functools import cache
from pathlib import Path

import numpy as np

import adaptrack.export
from adaptrack.core.kernel import EXPORTED
from programs import find_program

SOURCES = Path(adaptrack.export.__file__).parent / "c"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror"]
(OK, BAD_ARGUMENT, TOO_SMALL, NOT_READY, BUSY, DAMAGED, OTHER_VERSION, OTHER_KIND, OTHER_SIZES, OTHER_CONSTANTS,
 OTHER_PATH, ARITHMETIC, BAD_PATH, OUT_OF_ORDER) = range(14)  # fmt: skip


class Function(ctypes.Structure):
    _fields_ = (("name", ctypes.c_uint32), ("function", ctypes.c_void_p))


class Reader(ctypes.Structure):
    _fields_ = (("kernels", ctypes.c_uint64), ("kind", ctypes.c_uint32), ("functions", ctypes.POINTER(Function)),
                ("count", ctypes.c_size_t), ("check", ctypes.c_void_p))  # fmt: skip


@cache
def _library(folder):
    shared_object = Path(folder) / "block.so"
    source = SOURCES / "adaptrack_block.c"
    subprocess.run(
        [find_program("gcc"), *STRICT, "-O1", "-shared", "-fPIC", str(source), "-o", str(shared_object)], check=True
    )
    library = ctypes.CDLL(str(shared_object))
    library.adaptrack_block_state_size.restype = library.adaptrack_block_memory.restype = ctypes.c_size_t
    library.adaptrack_block_record.restype = ctypes.c_void_p
    return library


class Memory:
    """A block laid by the C sources into memory of this process, its functions those of the process."""

    def __init__(self, block, folder, size=None):
        self.library, self.block = _library(str(folder)), block
        names = block.functions
        self._functions = (Function * max(len(names), 1))(
            *[Function(zlib.crc32(name.encode()), EXPORTED[name].address) for name in names]
        )
        self.reader = Reader(block.header.kernels, block.header.kind, self._functions, len(names))
        words = (64 + block.memory_size) // 8 if size is None else size // 8
        self.raw = np.full(words + 8, 0xA5A5A5A5A5A5A5A5, np.uint64)  # dirty, and a margin behind
        self.size = 8 * words
        self.place = ctypes.c_void_p(self.raw.ctypes.data)

    def lay(self, content=None):
        content = self.block.content if content is None else content
        return self.library.adaptrack_block_lay(
            ctypes.byref(self.reader), self.place, ctypes.c_size_t(self.size), content, ctypes.c_size_t(len(content))
        )

    def renew(self, content):
        return self.library.adaptrack_block_renew(
            ctypes.byref(self.reader), self.place, content, ctypes.c_size_t(len(content))
        )

    def save(self):
        size = self.library.adaptrack_block_state_size(self.place)
        state = ctypes.create_string_buffer(size)
        assert (
            self.library.adaptrack_block_save(ctypes.byref(self.reader), self.place, state, ctypes.c_size_t(size)) == OK
        )
        return state.raw

    def restore(self, state):
        return self.library.adaptrack_block_restore(
            ctypes.byref(self.reader), self.place, state, ctypes.c_size_t(len(state))
        )

    @property
    def record(self):
        return ctypes.c_void_p(self.raw.ctypes.data + 64)

    def array(self, name, count):
        """The first numbers of an array of the record."""
        first = 8 + self.block.words[name]
        return self.raw[first : first + count].view(np.float64)
