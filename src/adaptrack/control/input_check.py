"""Which inputs of a loop contradict each other: sign, unit, frame, clock; and whether the car slides.

The comparisons are kernels, `core.input_check.call`; their words are those of `core.input_check.hypotheses`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.input_check import record as kernel
from adaptrack.core.input_check.call import begin_check, check_call
from adaptrack.core.input_check.hypotheses import COMPARED, COMPARISON_TABLE, MISTAKE_TABLE, MISTAKES, SUBJECT_OF
from adaptrack.core.kernel import Resident, row_of
from adaptrack.core.models.car import CarRow


class InputCheck:
    """Compares the inputs of a loop with each other as they come.

    vehicle: the car as believed; without one only signs and units are compared that need no car. period: s, of the
    loop, for the unit of its time; NaN: not known. delay: s, specified lag and dead time of the steering, computation
    included; infinite: not specified, or learned. position_noise: m, standard deviation of x and y.
    """

    def __init__(
        self, vehicle: Vehicle | None = None, period: float = math.nan, delay: float = math.inf,
        position_noise: float = 0.0,
    ) -> None:  # fmt: skip
        self.vehicle = vehicle
        self.mistakes: list[int] = []
        """reported mistakes (places in `MISTAKES`)"""
        self.suspect: tuple[str, ...] = ()
        """their sentences"""
        self.check = kernel.Check(np.zeros(kernel.SETTINGS_SIZE), np.zeros(kernel.MEMORY_SIZE))
        car = row_of(CarRow) if vehicle is None else vehicle.numbers
        kernel.check_settings(car, period, delay, position_noise, self.check.settings)
        begin_check(self.check)
        self._resident, self._sample, self._bits = Resident(self.check), np.empty(len(kernel.SAMPLE)), 0

    @property
    def _memory(self) -> Any:
        """`core.input_check.record.Memory`, a view."""
        return kernel.memory_of(self.check.memory, 0)

    @property
    def sliding(self) -> bool:
        """Whether the car slides."""
        return bool(self._memory.sliding)

    @property
    def compared(self) -> Iterator[tuple[str, float, bool]]:
        """Yield compared signals, driving time (s) in which they could be compared, and whether a mistake is found."""
        for comparison in COMPARISON_TABLE:
            if comparison.signals and (self.vehicle or not comparison.needs_car):
                place = getattr(COMPARED, comparison.name)
                yield comparison.signals, float(self._memory.seconds[place]), bool(self._memory.label[place])

    def add(
        self, t: float, now: float, pose: tuple[float, float, float], speed: float, yaw_rate: float = math.nan,
        vy: float = math.nan, pull: float = math.nan, wheel: float = math.nan, command: float = math.nan,
        forward: float = math.nan,
    ) -> tuple[str, ...]:  # fmt: skip
        """Take in a call, arguments as in `Tracker.step`; sentences that are new.

        command: rad, in force from now on.
        """
        self._sample[:] = t, now, *pose, speed, yaw_rate, vy, pull, wheel, forward
        return self.say(check_call(self._sample, command, self._resident))

    def forget(self) -> None:
        """Begin anew."""
        begin_check(self.check)
        self.mistakes, self.suspect, self._bits = [], (), 0

    def say(self, bits: int) -> tuple[str, ...]:
        """Sentences that are new, on the mistakes of these bits (`MISTAKES`)."""
        if bits == self._bits:
            return ()
        mistakes = [mistake for mistake in range(len(MISTAKES)) if (bits & ~self._bits) >> mistake & 1]
        sentences = tuple(map(self.sentence, mistakes))
        self._bits, self.mistakes, self.suspect = bits, [*self.mistakes, *mistakes], self.suspect + sentences
        return sentences

    def sentence(self, mistake: int, for_log: bool = False, steered: str = "command") -> str:
        """A reported mistake (place in `MISTAKES`) in words.

        for_log: with the options of commands that read logs; steered: name of the steering signal
        """
        words, numbers = MISTAKE_TABLE[mistake], self._memory.measured[SUBJECT_OF[mistake]]
        return words.says(words.evidence, for_log).format(*numbers, steered=steered)
