"""Which inputs of a loop contradict each other: sign, unit, frame, clock; and whether the car slides.

The comparisons are kernels, `core.input_check.call`; here is what they are called, and what their mistakes mean.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.input_check import record as kernel
from adaptrack.core.input_check.call import begin_check, check_call
from adaptrack.core.kernel import Resident, row_of
from adaptrack.core.models.car import CarRow


class Finding(NamedTuple):
    """Result of one comparison of inputs."""

    compared: str
    seconds: float
    """of driving that could be compared"""
    label: str
    """the mistake (`MISTAKES`) that explains best what was measured; empty: an honest value does, or too little was
    measured"""


NAMES = {
    "way": "positions and speed",
    "course": "positions and yaw",
    "turn": "yaw and yaw rate",
    "pull": "lateral acceleration, speed and yaw rate",
    "wheel": "command and wheel angle",
    "steering": "command and turning",
    "point": "positions and yaw rate",
    "lateral": "positions and lateral velocity",
    "forward": "longitudinal acceleration and change of the speed",
}
"""The comparisons (`COMPARED`)."""
NEED_A_CAR = frozenset({"point", "lateral"})

_CLOCK = "t: calls are {0:.3g} s apart by it, and the car moves {1:.2g} m at {2:.3g} m/s: the time is in "
_SPEED = "speed: the positions move {0:.2f} times as fast: "
_FRAME = "yaw and x, y: the positions move {0:.0f} degrees beside the yaw: "
_RATE = "yaw_rate: over half a second yaw changes by {0:.2g} rad where it says {1:.2g}: "
_POINT = "x, y: they move sideways in bends as the {} does: give those of the centre of mass, {{{}:.2f}} m {} it."
_PULL = "lateral_acceleration: it is {0:.2g} m/s^2 where speed times yaw_rate is {1:.2g}: "
_FORWARD = "longitudinal_acceleration: over seconds it is {0:.2g} m/s^2 where the speed changes by {1:.2g} m/s^2: "
_WHEEL = "wheel_angle: it is {0:.2g} rad at a command of {1:.2g}: "
_LATE = "{} are of clocks that are some 0.2 s apart, one of them is late: give each the time at which it was taken."
_SIGN = "its sign is wrong; give it positive to the left."
_LATE_STEERING = (
    "command: the car turns {0:.2f} s after it, later than the specified steering delay of {1:.2f} s explains: learn "
    "the delay, MPC(..., learning=Learning()), or specify the true one."
)
_COMMAND = "; give the actuator radians at the road wheels."
SENTENCES = type(kernel.MISTAKES)(*[
    _CLOCK + "milliseconds; give it in seconds.",
    _CLOCK + "microseconds; give it in seconds.",
    _CLOCK + "nanoseconds; give it in seconds.",
    "speed: {0:.3g} is no speed of a car in m/s: km/h? Give it in m/s.",
    _SPEED + "it is in km/h; give m/s.",
    _SPEED + "it is in miles per hour; give m/s.",
    _SPEED + "check its unit; give m/s, along the car.",
    _LATE.format("speed and positions"),
    _FRAME + "yaw is in degrees; give it in radians.",
    _FRAME + "y is mirrored against yaw (a left-handed frame, such as NED?); give x, y, yaw and yaw_rate in axes with "
    "y and angles positive to the left.",
    _FRAME + "yaw is counted clockwise from north (y); give it anticlockwise from x: pi/2 - yaw.",
    _FRAME + "yaw is counted clockwise from north, in degrees; give pi/2 - yaw pi/180.",
    _FRAME + "yaw is a quarter of a turn too large; count it from x.",
    _FRAME + "yaw is a quarter of a turn too small; count it from x.",
    _FRAME + "yaw is half a turn off; give the direction of the car's front.",
    _FRAME + "their frames differ; yaw must be counted from x towards y, in radians.",
    "yaw: it changes 57 times as much as yaw_rate says: yaw is in degrees; give it in radians.",
    _LATE.format("yaw and yaw_rate"),
    _RATE + _SIGN,
    _RATE + "yaw_rate is in degrees per second; give rad/s.",
    _RATE + "check its unit; give rad/s.",
    _RATE + "yaw_rate is taken for degrees per second; it is in rad/s.",
    "lateral_velocity: the positions move to the other side: give it positive to the left.",
    _POINT.format("rear axle", 0, "ahead of"),
    _POINT.format("front axle", 1, "behind"),
    _PULL + _SIGN,
    _PULL + "it is in g; give m/s^2.",
    _WHEEL + "the steering takes the command with the other sign, or wheel_angle has it; both are positive to the "
    "left.",
    _WHEEL + "it is in degrees; give rad.",
    _WHEEL + "it is the angle of the steering wheel; give that of the road wheels.",
    "command: the car turns to the other side: the steering takes it with the other sign, or x, y, yaw, yaw_rate and "
    "the path are of a left-handed frame (such as NED). Commands and angles are positive to the left.",
    "command: the car hardly turns, as if it were taken in degrees or not at all" + _COMMAND,
    "command: the car turns many times as much, as if it were sent in degrees, or at the steering wheel" + _COMMAND,
    "x, y: within seconds they moved {0:.2g} m away from where speed and yaw lead: the position drifts or has jumped; "
    "check the localisation.",
    "yaw: within seconds it changed by {0:.2g} rad more than yaw_rate says: it drifts or has jumped; check the "
    "localisation.",
    _LATE_STEERING,
    _FORWARD + "its sign is wrong; give it positive forward.",
    _FORWARD + "it is in g; give m/s^2.",
    _FORWARD + "on slopes it contains gravity; give dv/dt, without gravity.",
])  # fmt: skip
"""What each mistake is said as, with what was measured."""


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
        self.suspect: tuple[str, ...] = ()
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
    def findings(self) -> tuple[Finding, ...]:
        """Results of all comparisons."""
        memory, names = self._memory, ("", *kernel.MISTAKES._fields)
        return tuple(
            Finding(words, float(memory.seconds[i]), names[memory.label[i]])
            for name, words in NAMES.items()
            if (i := kernel.COMPARED._fields.index(name)) >= 0 and (self.vehicle or name not in NEED_A_CAR)
        )

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
        self.suspect, self._bits = (), 0

    def say(self, bits: int) -> tuple[str, ...]:
        """Sentences that are new, on the mistakes of these bits (`MISTAKES`)."""
        if bits == self._bits:
            return ()
        new = tuple(self._sentence(i) for i in range(len(kernel.MISTAKES)) if (bits & ~self._bits) >> i & 1)
        self._bits, self.suspect = bits, self.suspect + new
        return new

    def _sentence(self, mistake: int) -> str:
        """A mistake in words."""
        (subject,) = (i for i, bits in enumerate(kernel.ABOUT) if bits >> mistake & 1)
        return SENTENCES[mistake].format(*self._memory.measured[subject])
