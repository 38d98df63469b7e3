"""Calls of kernels with all their arguments, as data that a small program on any processor can run.

An image is 64-bit words, little-endian: how many words, places, functions and instructions there are; the words of a
memory; pairs (word, other word) where the first is to hold the address of the second; pairs (word, function) where it
is to hold that of a function; instructions of five words each. `driver.c`, `driver.mjs` and `run` do the same.
"""

import ctypes
import struct

import numpy as np

from adaptrack.core.controllers.mpc_step import step as mpc_step
from adaptrack.core.kernel import EXPORTED, Array, float64
from adaptrack.core.maths.portable import elementary_values
from adaptrack.core.simulation.run import begin as begin_runs
from adaptrack.core.simulation.run import roll_on
from adaptrack.core.synthesis.laws import LQR_NUMBERS, lqr_parameters
from adaptrack.core.synthesis.mpc import informed_numbers

ELEMENTARY, COPY, STEP, BEGIN, DRIVE, TELL, MAKE, GAINS = range(8)


class Image:
    """Arrays and records are put into it, then instructions."""

    def __init__(self):
        self.size, self.parts, self.places, self.links, self.code = 0, [], [], [], []
        self.functions = []
        self._known = {}

    def put(self, values):
        """The word at which an array lies; one that is there already is not put again."""
        place = self._known.get((values.ctypes.data, values.nbytes)) if values.nbytes else None
        if place is None:
            raw = np.frombuffer(values.tobytes() + bytes(-values.nbytes % 64 or (0 if values.nbytes else 64)), np.int64)
            place, self.size = self.size, self.size + raw.size
            self.parts.append((raw, values))  # which lives on, so that its address is its own
            self._known[values.ctypes.data, values.nbytes] = place
        return place

    def record(self, record):
        """The word at which a record lies, as `kernel.Resident` lays it."""
        words, arrays, functions = [], [], []
        self._lay(record, words, arrays, functions)
        place = self.put(np.array(words, np.int64))
        self.places += [(place + at, self.put(values)) for at, values in arrays]
        self.links += [(place + at, number) for at, number in functions]
        return place

    def _lay(self, record, words, arrays, functions):
        addresses = {kernel.address: name for name, kernel in EXPORTED.items() if "address" in vars(kernel)}
        for kind, value in zip(record.kinds.values(), record, strict=True):
            if isinstance(value, tuple):
                self._lay(value, words, arrays, functions)
            elif isinstance(kind, Array):
                arrays.append((len(words), value))
                words += (0, *value.shape)
            elif kind is float64:
                words.append(bits(value))
            elif value in addresses:
                name = addresses[value]
                self.functions += [] if name in self.functions else [name]
                functions.append((len(words), self.functions.index(name)))
                words.append(0)
            else:
                words.append(int(value))

    def do(self, *instruction):
        self.code.append((*instruction, 0, 0, 0, 0)[:5])

    def words(self):
        head = [self.size, len(self.places), len(self.links), len(self.code)]
        tail = [number for table in (self.places, self.links, self.code) for row in table for number in row]
        return np.concatenate([np.array(head), *(raw for raw, _ in self.parts), np.array(tail, np.int64)])


def bits(value):
    """Of a float, as a signed integer."""
    return struct.unpack("<q", struct.pack("<d", value))[0]


def run(image, library):
    """What the instructions tell, as words, done here by a library that is loaded."""

    def kernel(exported):
        return exported.signature.prototype(address(exported.name))

    def address(name):
        return ctypes.cast(getattr(library, f"adaptrack_{name}"), ctypes.c_void_p).value

    size = image.size
    memory = image.words()[4 : 4 + size].copy()
    base = memory.ctypes.data
    for word, other in image.places:
        memory[word] = base + 8 * other
    for word, number in image.links:
        memory[word] = address(image.functions[number])
    elementary, step, begin, drive = map(kernel, (elementary_values, mpc_step, begin_runs, roll_on))
    make, gains = map(kernel, (informed_numbers, lqr_parameters))
    answers = []
    for operation, a, b, c, d in image.code:
        if operation == ELEMENTARY:
            elementary(a, base + 8 * b, 3, c, base + 8 * d, c)
        elif operation == COPY:
            memory[b : b + c] = memory[a : a + c]
        elif operation == STEP:
            step(base + 8 * a)
        elif operation == BEGIN:
            begin(a, base + 8 * b)
        elif operation == DRIVE:
            drive(a, b, base + 8 * c)
        elif operation == MAKE:
            make(base + 8 * a, base + 8 * b)
        elif operation == GAINS:
            gains(base + 8 * a, base + 8 * b, base + 8 * c, 4, base + 8 * d, LQR_NUMBERS)
        else:
            answers.append(memory[a : a + b].copy())
    return np.concatenate(answers)
