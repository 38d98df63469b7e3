"""C sources of an export, compiled and called from the tests."""

import ctypes
import hashlib
import math
import os
import re
import subprocess
import zlib
from functools import cache
from pathlib import Path

import numpy as np

import adaptrack.export
from adaptrack.core.kernel import EXPORTED
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.export.kernel_sources import EXACT_OPTIONS
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
def _library(folder, options):
    shared_object = Path(folder) / f"block{''.join(options)}.so"
    source = SOURCES / "adaptrack_block.c"
    command = [find_program("gcc"), *STRICT, *options, "-shared", "-fPIC", str(source), "-o", str(shared_object)]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(shared_object))
    library.adaptrack_block_state_size.restype = library.adaptrack_block_memory.restype = ctypes.c_size_t
    library.adaptrack_block_record.restype = ctypes.c_void_p
    return library


class Memory:
    """A block laid by the C sources into memory of this process, its functions those of the process.

    options: of the compiler.
    """

    def __init__(self, block, folder, size=None, options=("-O1",)):
        self.library, self.block = _library(str(folder), options), block
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


class Sample(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_double) for name in TRACKER_SAMPLE._fields)


class Answer(ctypes.Structure):
    _fields_ = (("command", ctypes.c_double), ("offset", ctypes.c_double), ("heading_error", ctypes.c_double),
                ("station", ctypes.c_double), ("status", ctypes.c_int), ("belief", ctypes.c_int),
                ("at_bound", ctypes.c_int), ("suspect", ctypes.c_uint64),
                ("first_top_speed", ctypes.c_double))  # fmt: skip


class Plan(ctypes.Structure):
    _fields_ = (("s", ctypes.c_void_p), ("speed", ctypes.c_void_p), ("count", ctypes.c_size_t))


def text_with_headers(source, folder):
    """The text of a C source and of all headers of its export that it includes."""
    texts, names = [], [source]
    for path in names:
        texts.append(path.read_text())
        places = [place / name for name in re.findall(r'#include "(.+)"', texts[-1]) for place in folder]
        names += [place for place in places if place.exists() and place not in names]
    return "\0".join(texts)


def compile_export(folder):
    """The objects of an export's C sources; what exports of this session have in common is compiled once."""
    command = [find_program("gcc"), *STRICT, "-O0", *EXACT_OPTIONS, "-fPIC", f"-I{folder}/include"]
    session = next((parent for parent in folder.parents if re.fullmatch(r"pytest-\d+", parent.name)), folder)
    objects = []
    for source in sorted((folder / "src").glob("*.c")):
        text = text_with_headers(source, (folder / "src", folder / "include"))
        objects.append(session / f"{hashlib.sha256(text.encode()).hexdigest()}.o")
        if not objects[-1].exists():
            part = folder / f"{source.stem}.o"
            process = subprocess.run([*command, "-c", source, "-o", part], capture_output=True, text=True)
            assert process.returncode == 0, process.stderr
            os.replace(part, objects[-1])  # other processes compile it, too
    return objects


def link_export(folder):
    """A shared library of an export."""
    library = folder / "tracker.so"
    subprocess.run([find_program("gcc"), "-shared", *compile_export(folder), "-o", library], check=True)
    return library


class Exported:
    """An export, linked into a shared library."""

    def __init__(self, folder, controller):
        self.folder, self.controller = folder, controller
        self.c = ctypes.CDLL(str(link_export(folder)))
        for name in ("size", "path_size", "state_size"):
            getattr(self.c, f"adaptrack_{name}").restype = ctypes.c_size_t
        self.constants = (folder / "constants.bin").read_bytes()

    def path(self, points, closed=False):
        return CPath(self.c, points, closed)


class CPath:
    def __init__(self, c, points, closed=False, surplus=0, noise=math.nan):
        self.points = np.ascontiguousarray(points, float)
        address = ctypes.c_void_p(self.points.ctypes.data)
        size = c.adaptrack_path_size(address, ctypes.c_size_t(len(points)), int(closed)) + surplus
        self.raw, self.flaw = np.zeros(size // 8 + 1), ctypes.c_size_t(0)
        self.place = ctypes.c_void_p(self.raw.ctypes.data)
        self.error = c.adaptrack_path(address, ctypes.c_size_t(len(points)), int(closed), ctypes.c_double(noise),
                                      self.place, ctypes.c_size_t(size), ctypes.byref(self.flaw))  # fmt: skip


class CTracker:
    """A tracker in memory of this process, with margins that nobody may write to."""

    MARGIN = 64

    def __init__(self, library, constants=None):
        self.c, self.constants = library.c, library.constants if constants is None else constants
        self.size = self.c.adaptrack_size(self.constants, ctypes.c_size_t(len(self.constants)))
        self.raw = np.full(self.size // 8 + 2 * self.MARGIN, 0xA5A5A5A5A5A5A5A5, np.uint64)
        self.place = ctypes.c_void_p(self.raw[self.MARGIN :].ctypes.data)
        self.error = self.init(self.constants)

    def init(self, constants):
        return self.c.adaptrack_init(self.place, ctypes.c_size_t(self.size), constants, ctypes.c_size_t(len(constants)))

    def load(self, constants):
        return self.c.adaptrack_load(self.place, constants, ctypes.c_size_t(len(constants)))

    def engage(self, angle=0.0, near=math.nan):
        return self.c.adaptrack_engage(self.place, ctypes.c_double(angle), ctypes.c_double(near))

    def follow(self, path, plan=None, near=math.nan):
        self._path = path, plan
        speed_plan = None
        if plan is not None:
            self._s, self._v = (np.ascontiguousarray(column, float) for column in (plan.s, plan.speed))
            speed_plan = ctypes.byref(Plan(self._s.ctypes.data, self._v.ctypes.data, self._s.size))
        return self.c.adaptrack_follow(self.place, path.place, ctypes.c_double(near), speed_plan)

    def step(self, sample):
        answer = Answer(math.nan, status=-1)
        row = Sample(*sample, *[math.nan] * (len(Sample._fields_) - len(sample)))
        error = self.c.adaptrack_step(self.place, ctypes.byref(row), ctypes.byref(answer))
        return error, answer

    def save(self):
        state = ctypes.create_string_buffer(self.c.adaptrack_state_size(self.place))
        assert self.c.adaptrack_save(self.place, state, ctypes.c_size_t(len(state))) == OK
        return state.raw

    def restore(self, state):
        return self.c.adaptrack_restore(self.place, state, ctypes.c_size_t(len(state)))

    @property
    def untouched(self):
        return all(
            (margin == 0xA5A5A5A5A5A5A5A5).all() for margin in (self.raw[: self.MARGIN], self.raw[-self.MARGIN :])
        )
