"""C sources of an export, compiled and called from the tests."""

import ctypes
import hashlib
import math
import os
import re
import shutil
import struct
import zlib

import numpy as np

from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from programs import run_program

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wpedantic", "-Werror"]
(OK, BAD_ARGUMENT, TOO_SMALL, NOT_READY, BUSY, DAMAGED, OTHER_VERSION, OTHER_KIND, OTHER_SIZES, OTHER_CONSTANTS,
 OTHER_PATH, ARITHMETIC, BAD_PATH, OUT_OF_ORDER) = range(14)  # fmt: skip


def sealed(content):
    """Constants or a saved state with the checksum of their content."""
    copy = bytearray(content)
    copy[16:24] = struct.pack("<Q", zlib.crc32(bytes(copy[24:])))
    return bytes(copy)


def with_word(content, word, value, kind="<d"):
    """A file with another word, and the checksum of that."""
    copy = bytearray(content)
    struct.pack_into(kind, copy, 8 * word, value)
    return sealed(copy)


class Sample(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_double) for name in TRACKER_SAMPLE._fields)


class Answer(ctypes.Structure):
    _fields_ = (("command", ctypes.c_double), ("offset", ctypes.c_double), ("heading_error", ctypes.c_double),
                ("station", ctypes.c_double), ("status", ctypes.c_int), ("belief", ctypes.c_int),
                ("at_bound", ctypes.c_int), ("suspect", ctypes.c_uint64),
                ("first_top_speed", ctypes.c_double), ("late", ctypes.c_double),
                ("driven_by", ctypes.c_int))  # fmt: skip


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


def compile_export(folder, level="-Og"):
    """The objects of an export's C sources; what exports of this session have in common is compiled once.

    level: -O0 compiles twice as fast, for sources that no other export has. Those of all informed MPCs are the
    same, and so are those with a speed control.
    """
    options = [*STRICT, level, *EXACT_OPTIONS, "-fPIC", f"-I{folder}/include"]
    session = next((parent for parent in folder.parents if re.fullmatch(r"pytest-\d+", parent.name)), folder)
    objects = []
    for source in sorted((folder / "src").glob("*.c")):
        text = text_with_headers(source, (folder / "src", folder / "include"))
        objects.append(session / f"{hashlib.sha256((level + text).encode()).hexdigest()}.o")
        if not objects[-1].exists():
            part = folder / f"{source.stem}.o"
            run_program("gcc", *options, "-c", source, "-o", part)
            os.replace(part, objects[-1])  # other processes compile it, too
    return objects


def link_export(folder, level="-Og"):
    """A shared library of an export."""
    library = folder / "tracker.so"
    run_program("gcc", "-shared", *compile_export(folder, level), "-o", library)
    return library


def run_cpp(export, text, place):
    """Compile a program of C++ with the library of an export, without exceptions, and run it."""
    (place / "drive.cpp").write_text(text)
    export.make("lib")
    options = ["-std=c++17", "-fno-exceptions", "-fno-rtti", *STRICT[1:], f"-I{export.folder}/include"]
    archive = export.folder / "build" / "libadaptrack.a"
    run_program("g++", *options, place / "drive.cpp", archive, "-o", place / "drive")
    run_program(str(place / "drive"))


class Exported:
    """An export, linked into a shared library."""

    def __init__(self, folder, controller, level="-Og"):
        self.folder, self.controller, self.level = folder, controller, level
        self.c = ctypes.CDLL(str(link_export(folder, level)))
        for name in ("size", "path_size", "state_size"):
            getattr(self.c, f"adaptrack_{name}").restype = ctypes.c_size_t
        self.constants = (folder / "constants.bin").read_bytes()

    def make(self, *words):
        """Run `make` in the folder; the objects of its sources are there."""
        (self.folder / "build").mkdir(exist_ok=True)
        sources = sorted((self.folder / "src").glob("*.c"))
        for source, part in zip(sources, compile_export(self.folder, self.level), strict=True):
            shutil.copy(part, self.folder / "build" / f"{source.stem}.o")
        return run_program("make", "-C", self.folder, *words, f"CFLAGS={self.level} -Werror")

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

    def predicted_path(self, room=200):
        """Error, points (count, 2) and the time to the first one; the count where they do not fit."""
        points, count, first = np.full((room, 2), math.nan), ctypes.c_size_t(0), ctypes.c_double(math.nan)
        error = self.c.adaptrack_predicted_path(
            self.place, ctypes.c_void_p(points.ctypes.data), ctypes.c_size_t(room), ctypes.byref(count),
            ctypes.byref(first),
        )  # fmt: skip
        return error, count.value if error == TOO_SMALL else points[: count.value], first.value

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
