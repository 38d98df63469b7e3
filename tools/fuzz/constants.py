"""Constants of an exported C library, changed and with a right checksum: loaded and driven in a process apart.

`search_constants` draws changes from a seed. The process that drives one may crash or hang, which is counted. Otherwise
the constants must be refused, or every command be finite and the memory around the tracker stay as it was.

`unnoticed` changes one number after the other by 1 % and drives the recorded minute of the folder.
"""

from __future__ import annotations

import ctypes
import math
import mmap
import os
import signal
import struct
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import LQR, MPC, Controller, Learning, PurePursuit, Stanley, published_mpc
from adaptrack.control.scheduling import load_scheduler
from adaptrack.core.tracker.signals import TRACKED, TRACKER_SAMPLE
from adaptrack.export.c_library import export_c
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.memory import FILE_HEAD
from adaptrack.export.tracking import tracking_memory

CAR = "midsize-sedan"
CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "informed": lambda: MPC(load_vehicle(CAR), profile="road"),
    "learning": lambda: MPC(load_vehicle(CAR), profile="road", learning=Learning()),
    "as-written": lambda: published_mpc(load_vehicle(CAR)),
    "road-nn": lambda: published_mpc(load_vehicle("paper"), scheduler=load_scheduler("road-nn")),
    "road-anfis": lambda: published_mpc(load_vehicle("paper"), scheduler=load_scheduler("road-anfis")),
    "lqr": lambda: LQR(load_vehicle(CAR)),
    "stanley": lambda: Stanley(load_vehicle(CAR)),
    "pure-pursuit": lambda: PurePursuit(load_vehicle(CAR)),
}
STEPS = 150
"""Calls after each change."""
TIME_LIMIT = 2.0
"""s of processor time for a change: a right library needs 10 ms."""
MARGIN = 64
"""Words before and behind the tracker, which nothing may write to."""
CANARY = 0xA5A5A5A5A5A5A5A5
ACCEPTED = ("driven", "refused")
OUTCOMES = (*ACCEPTED, "wrong", "crashed", "hung")
CHECKED_FROM = 24
"""Byte of a file of constants from which on its checksum counts."""
SPECIAL = (0, 1, 2, 3, 8, 100, 1 << 31, 1 << 40, 1 << 62, (1 << 64) - 1, (1 << 64) - 100)
"""Words that are counts, places or flags of nothing."""
FACTORS = (1.01, 2.0, 10.0, -1.0, 1e6, 1e-6)
NUMBERS = (0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 1e300, -1e300, 5e-324)


# -- what is changed --------------------------------------------------------------------------------------------------
def changed(content: bytes, rng: np.random.Generator) -> bytes:
    """A copy with one or two words of the numbers or of the head changed, and the checksum of that."""
    copy = bytearray(content)
    for _ in range(1 if rng.random() < 0.8 else 2):
        is_number = rng.random() < 0.9
        first, end = (FILE_HEAD.size, len(copy)) if is_number else (CHECKED_FROM, FILE_HEAD.size)
        _put(copy, "<Q", first + 8 * int(rng.integers((end - first) // 8)), rng)
    return sealed(copy)


def sealed(content: bytearray) -> bytes:
    """Constants with the checksum of their content."""
    content[16:24] = struct.pack("<Q", zlib.crc32(bytes(content[CHECKED_FROM:])))
    return bytes(content)


def _put(content: bytearray, kind: str, place: int, rng: np.random.Generator) -> None:
    """Write another word at a place."""
    bits = 8 * struct.calcsize(kind)
    (word,) = struct.unpack_from(kind, content, place)
    way = rng.integers(6)
    if way == 0:
        word = int(rng.choice(np.array(SPECIAL, np.uint64)))
    elif way == 1:
        word ^= 1 << int(rng.integers(bits))
    elif way == 2:
        word += int(rng.choice([-2, -1, 1, 2, 8]))
    elif way == 3:
        word = int(rng.integers(1 << 63)) * 2 + 1
    elif bits == 64:
        (number,) = struct.unpack("<d", struct.pack("<Q", word))
        number = float(rng.choice(NUMBERS)) if way == 4 else number * float(rng.choice(FACTORS))
        (word,) = struct.unpack("<Q", struct.pack("<d", number))
    else:
        word += int(rng.integers(-1000, 1000))
    struct.pack_into(kind, content, place, word % (1 << bits))


# -- what drives ------------------------------------------------------------------------------------------------------
class Library:
    """An export, linked into a shared library of this process, with a path and what was measured along it.

    compiled: gives the objects of the C sources in a folder; without it they are compiled here.
    """

    def __init__(self, controller: Controller, folder: Path, compiled: Callable[[Path], Any] | None = None) -> None:
        export_c(controller, folder)
        self.controller = controller
        self.constants = (folder / "constants.bin").read_bytes()
        program = folder / "tracker.so"
        parts = sorted((folder / "src").glob("*.c")) if compiled is None else compiled(folder)
        sources = [*parts, folder / "main.c"]
        includes = [f"-I{folder}/include", f"-I{folder}"]
        words = ["-shared", "-fPIC", "-O1", *EXACT_OPTIONS, *includes, *map(str, sources), "-o", str(program)]
        run = subprocess.run(["cc", *words], capture_output=True, text=True)
        if run.returncode != 0:
            raise InvalidInput(f"cc does not link {folder}: {run.stderr}")
        self.c = ctypes.CDLL(str(program))
        self.c.adaptrack_size.restype = self.c.adaptrack_path_size.restype = ctypes.c_size_t
        along = np.arange(0.0, 300.0, 5.0)
        self.points = np.stack([along, 12.0 * (1.0 - np.cos(along / 45.0))], axis=-1)
        size = self._path_size()
        self.path = np.zeros(size // 8 + 1)
        self._call("path", self.points, self._count, ctypes.c_int(0), self.path, ctypes.c_size_t(size), None)
        self.size = self.c.adaptrack_size(self.constants, ctypes.c_size_t(len(self.constants)))
        self.raw = np.full(self.size // 8 + 2 * MARGIN, CANARY, np.uint64)
        self.tracker = self.raw[MARGIN:]

    _count = ctypes.c_size_t(60)

    def _path_size(self) -> int:
        return int(self.c.adaptrack_path_size(self.points.ctypes.data_as(ctypes.c_void_p), self._count, 0))

    def _call(self, name: str, *words: Any) -> int:
        arguments = [word.ctypes.data_as(ctypes.c_void_p) if isinstance(word, np.ndarray) else word for word in words]
        return int(getattr(self.c, f"adaptrack_{name}")(*arguments))

    def _begin(self, constants: bytes) -> int:
        size = ctypes.c_size_t(self.size)
        error = self._call("init", self.tracker, size, constants, ctypes.c_size_t(len(constants)))
        nan = ctypes.c_double(math.nan)
        return error or self._call("follow", self.tracker, self.path, nan, None)

    def replay(self, constants: bytes) -> tuple[int, int]:
        """The error of the recorded minute under constants, and how many of its steps differ."""
        differ, answer = ctypes.c_int(0), np.zeros(len(TRACKED))
        place = answer.ctypes.data_as(ctypes.c_void_p)
        error = self.c.drive_recorded(constants, ctypes.c_size_t(len(constants)), ctypes.byref(differ), place)
        return int(error), differ.value

    def outcome(self, constants: bytes, under_way: bool) -> str:
        """What becomes of constants that a tracker begins with, or gets under way."""
        self.raw[:] = CANARY
        sample, answer, first = np.full(len(TRACKER_SAMPLE), math.nan), np.zeros(len(TRACKED)), 0
        if under_way:
            self._begin(self.constants)
            first = 20
            self._drive(sample, answer, 0, first)
            error = self._call("load", self.tracker, constants, ctypes.c_size_t(len(constants)))
        else:
            error = self._begin(constants)
        finite = True if error else self._drive(sample, answer, first, STEPS)
        whole = all((margin == CANARY).all() for margin in (self.raw[:MARGIN], self.raw[-MARGIN:]))
        return "wrong" if not (finite and whole) else "refused" if error else "driven"

    def _drive(self, sample: Any, answer: Any, first: int, last: int) -> bool:
        """Whether all commands of some calls are finite."""
        finite = True
        for k in range(first, last):
            x = 0.6 * k
            yaw = math.atan(12.0 / 45.0 * math.sin(x / 45.0))
            sample[:10] = 0.05 * k, 0.05 * k, x, 12.0 * (1.0 - math.cos(x / 45.0)) + 0.1, yaw, 12.0, 0.0, 0.0, 0.0, 0.0
            error = self._call("step", self.tracker, sample, answer)
            finite = finite and (error != 0 or math.isfinite(answer[0]))
        return finite


# -- counts -----------------------------------------------------------------------------------------------------------
def change_of(library: Library, seed: int, number: int) -> bytes:
    """The constants of a change."""
    return changed(library.constants, np.random.default_rng([seed, number]))


def search_constants(library: Library, count: int, seed: int) -> list[str]:
    """The outcome of each of so many changes."""
    outcomes = mmap.mmap(-1, count + 1)
    number = 0
    while number < count:
        _in_a_child(library, seed, number, count, outcomes)
        while number < count and outcomes[number]:
            number += 1
    return [OUTCOMES[outcomes[k] - 1] for k in range(count)]


def _in_a_child(library: Library, seed: int, first: int, count: int, outcomes: mmap.mmap) -> None:
    """Go through changes in a process apart, up to the first at which it crashes or hangs."""
    child = os.fork()
    if child == 0:
        for number in range(first, count):
            signal.setitimer(signal.ITIMER_VIRTUAL, TIME_LIMIT)  # its signal ends a process
            outcome = library.outcome(change_of(library, seed, number), number % 2 == 1)
            outcomes[number] = 1 + OUTCOMES.index(outcome)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        reached = next(k for k in range(first, count) if not outcomes[k])
        hung = os.WTERMSIG(status) == signal.SIGVTALRM
        outcomes[reached] = 1 + OUTCOMES.index("hung" if hung else "crashed")


# -- what the recorded minute notices ---------------------------------------------------------------------------------
NOT_READ, TOO_WEAK = "not read in this configuration", "read, but 1 % changes no decision"
STRONG = (-37.0, 1e-3, 1e3)
"""Factors on a constant: one that changes no answer under any that is accepted is not read in this configuration."""


def unnoticed(library: Library, every: int = 1) -> tuple[int, dict[str, str]]:
    """Check every so many constants: how many, and those that may change by 1 % unnoticed, each with the reason."""
    misses, count = {}, 0
    memory = tracking_memory(library.controller)
    numbers = [(f"{name} {number.name}", number) for name, part in memory.numbers.items() for number in part]
    for word, (name, number) in list(enumerate(numbers, FILE_HEAD.size // 8))[::every]:
        (value,) = struct.unpack_from("<d", memory.content, 8 * word)
        if number.bounds.rule == "EXACT" or value == 0.0 or not math.isfinite(value):
            continue
        count += 1
        if library.replay(scaled(memory.content, word, 1.01)) == (0, 0):
            is_read = any(library.replay(scaled(memory.content, word, factor))[1] for factor in STRONG)
            misses[name] = TOO_WEAK if is_read else NOT_READ
    return count, misses


def scaled(content: bytes, word: int, factor: float) -> bytes:
    """The constants with a number times a factor."""
    copy = bytearray(content)
    (value,) = struct.unpack_from("<d", copy, 8 * word)
    struct.pack_into("<d", copy, 8 * word, value * factor)
    return sealed(copy)
