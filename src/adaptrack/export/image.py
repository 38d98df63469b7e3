"""A record with all its arrays as the image of a memory: what the constants of an FMU are.

The library of FMUs holds every unit, and sizes depend on the road, so an FMU cannot have structs as the export to C
does. Its file (`memory.file_of`) holds counts, then where addresses go, then the words of the memory: the record as
`core.kernel.Resident` lays it, the arrays that do not change, and all others, which a saved state holds.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.export.memory import CACHE_LINE_WORDS, Member, file_of, members_of


@dataclass(frozen=True)
class Image:
    """A record as a file.

    state_words: of the memory that change; functions: the kernels whose addresses it has.
    """

    content: bytes
    state_words: int
    functions: tuple[str, ...]


def unit_number(name: str) -> int:
    """The number of a unit by the name of its record."""
    return zlib.crc32(name.encode())


def image_of(record: Any, constants: Sequence[str], functions: Sequence[str]) -> Image:
    """The image of a record.

    constants: dotted names of arrays, or of records of them, that do not change; functions: the kernels of the library,
    which the file knows by their places in this list.

    Raises
    ------
    InvalidInput
        When kernels are interpreted, or the record has a function that is none of these.
    """
    words: list[NDArray[np.uint64]] = []
    arrays: list[tuple[int, Member]] = []
    links: list[tuple[int, str]] = []
    size = 0
    for member in members_of(record):
        arrays += [(size, member)] if member.is_array else []
        links += [(size, member.kernel)] if member.kernel else []
        words.append(np.array((0, *member.values.shape), np.uint64) if member.is_array else member.words)
        size += words[-1].size
    unknown = sorted({kernel for _, kernel in links} - set(functions))
    if unknown:
        raise InvalidInput(
            f"export fmu: {', '.join(unknown)}: not among the kernels of an FMU; a plant is single-track or dual-track."
        )
    arrays.sort(key=lambda array: not array[1].is_among(constants))
    places, state = list[int](), size
    for word, member in arrays:
        gap = -size % CACHE_LINE_WORDS
        words += [np.zeros(gap, np.uint64), member.words]
        places += [word | (size + gap) << 32] if member.values.size else []
        size += gap + words[-1].size
        state = size if member.is_among(constants) else state
    fixes = [*places, *(word | functions.index(kernel) << 32 for word, kernel in links)]
    head = np.array([size, state, len(places), len(links), *fixes], np.uint64)
    content = file_of(unit_number(type(record).__name__), np.concatenate([head, *words]))
    return Image(content, size - state, tuple(sorted({kernel for _, kernel in links})))
