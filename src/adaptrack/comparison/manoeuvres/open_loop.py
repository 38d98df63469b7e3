"""A plant under a given angle of the front wheels over time: what the open-loop tests of the standards drive.

The wheels follow the angle at once: a standard prescribes what the steering does, not its command.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import DURATION, SPEED, check_limit
from adaptrack.cars.plant import Plant, SteppedPlant, steps_in
from adaptrack.cars.vehicle import SteeringActuator, Vehicle
from adaptrack.core.plants.contract import INPUT, INPUTS, SLOTS, STATES, place, vehicle_batch
from adaptrack.drive.path_metrics import STEERING_RATIO

Array = NDArray[np.float64]

FRICTION = 0.9
"""Of the dry road that the standards ask for, where nothing else is said."""
PERIOD = 0.005
"""s, between samples; the angle is held in between."""
DEGREE = math.pi / 180.0
STANDARD_SPEED = 80.0 / 3.6
"""m/s, 80 km/h: the speed of ISO 7401 and of the sine with dwell."""

Steer = Callable[[Array], Array]
"""steer(t (n,) s) -> front-wheel angles (runs, n) or (n,), rad."""


@dataclass(frozen=True)
class Surroundings:
    """How the plant of an open-loop test is driven.

    Raises
    ------
    InvalidInput
        When the friction or the period is not possible.
    """

    friction: float = FRICTION
    """of all wheels, above 0 and at most 3"""
    hold_speed: bool = True
    """hold v_x exactly; else the car coasts: no force at the wheels but resistance"""
    period: float = PERIOD
    """s"""

    def __post_init__(self) -> None:
        if not 0.0 < real("Surroundings", "friction", self.friction) <= 3.0:
            raise InvalidInput(f"friction = {self.friction!r}: must be above 0 and at most 3.")
        if not 0.0 < real("Surroundings", "period", self.period) <= 0.1:
            raise InvalidInput(f"period = {self.period!r} s: must be above 0 and at most 0.1.")


@dataclass(frozen=True, eq=False)
class Motion:
    """What runs did, arrays (runs, n) at the times t; ISO 8855, positive to the left."""

    t: Array
    """(n,) s"""
    wheel_angle: Array
    """rad"""
    x: Array
    """m"""
    y: Array
    """m"""
    yaw: Array
    """rad"""
    vx: Array
    """m/s"""
    vy: Array
    """m/s"""
    yaw_rate: Array
    """rad/s"""
    lateral_acceleration: Array
    """m/s^2, at the centre of mass"""

    @property
    def sideslip(self) -> Array:
        """rad, atan2(v_y, v_x)."""
        return np.arctan2(self.vy, self.vx)


def drive_open_loop(
    plant: Plant | SteppedPlant,
    steer: Steer,
    speed: ArrayLike,
    duration: float,
    surroundings: Surroundings | None = None,
) -> Motion:
    """Drive a plant straight ahead from the origin, under front-wheel angles.

    Parameters
    ----------
    steer
        The angles (runs, n), or (n,) for one run, at times (n,); over a sample's period its value in the middle is
        held.
    speed
        m/s at the start, of all runs or (runs,).
    duration
        s

    Returns
    -------
    Motion
        A run that spins wildly may end in NaN.

    Raises
    ------
    InvalidInput
        When speed, duration or the shape of the angles are not possible.
    """
    given = surroundings or Surroundings()
    if not real("drive_open_loop", "duration", duration) > 0.0:
        raise InvalidInput(f"drive_open_loop: duration = {duration!r} s: must be positive.")
    check_limit("duration", duration, DURATION)
    t: Array = given.period * np.arange(max(2, round(duration / given.period) + 1), dtype=np.float64)
    steered = np.atleast_2d(np.asarray(steer(t), dtype=np.float64))
    held = np.atleast_2d(np.asarray(steer(t[:-1] + 0.5 * given.period), dtype=np.float64))
    runs = steered.shape[0]
    if steered.shape != (runs, t.size) or held.shape != (runs, t.size - 1) or not np.isfinite(steered).all():
        raise InvalidInput(
            f"drive_open_loop: steer gave {steered.shape} for {t.size} times: must be finite, (runs, n) or (n,)."
        )
    speeds = np.broadcast_to(np.asarray(speed, dtype=np.float64), (runs,))
    if not (np.isfinite(speeds) & (speeds > 0.0)).all():
        raise InvalidInput(f"drive_open_loop: speed = {speed!r} m/s: must be positive and finite.")
    check_limit("speed", float(speeds.max()), SPEED)
    with np.errstate(invalid="ignore", over="ignore"):
        if isinstance(plant, SteppedPlant):
            states, felt = _drive_stepped(plant, held, speeds, given)
        else:
            states, felt = _drive_compiled(plant, (steered, held), speeds, given)
    x, y, yaw, vx, vy, yaw_rate = np.moveaxis(states, -1, 0)
    return Motion(t, steered, x, y, yaw, vx, vy, yaw_rate, felt)


def _drive_compiled(
    plant: Plant, angles: tuple[Array, Array], speeds: Array, given: Surroundings
) -> tuple[Array, Array]:
    """The motion (runs, n, 6) and the lateral acceleration (runs, n) of a compiled plant, a slot for each run.

    angles: at the instants (runs, n), and held between them (runs, n - 1).
    """
    still = plant.with_steering(SteeringActuator.ideal())
    now, held = angles
    runs, n = now.shape
    states, felt, observed = np.empty((runs, n, 6)), np.empty((runs, n)), np.empty(2)
    substeps = still.substeps(given.period, float(speeds.max()))
    h = given.period / substeps
    for first in range(0, runs, SLOTS):
        count = min(SLOTS, runs - first)
        starts = [still.initial_state([0.0, 0.0, 0.0, v, 0.0, 0.0]) for v in speeds[first : first + count]]
        v = vehicle_batch(still.compiled, still.packed(), np.stack(starts))
        place(count, v.start, v.block, v.states)
        rows = v.block.reshape(STATES + INPUTS, SLOTS)
        rows[STATES + INPUT.acceleration] = 0.0 if given.hold_speed else math.nan
        rows[STATES + INPUT.friction_front_left : STATES + INPUT.friction_front_left + 4] = given.friction
        for k in range(n):
            states[first : first + count, k] = rows[:6, :count].T
            rows[STATES + INPUT.command, :count] = now[first : first + count, k]
            for slot in range(count):
                still.compiled.observe(v.member, v.parameters, v.block, v.states, v.work, slot, observed)
                felt[first + slot, k] = observed[0]
            if k < n - 1:
                rows[STATES + INPUT.command, :count] = held[first : first + count, k]
                still.compiled.advance(v.member, v.parameters, v.block, v.states, v.work, count, substeps, h)
    return states, felt


def _drive_stepped(plant: SteppedPlant, held: Array, speeds: Array, given: Surroundings) -> tuple[Array, Array]:
    """The same of a stepped plant; its acceleration is the slope of v_y, and v_x times the yaw rate."""
    runs, n = held.shape[0], held.shape[1] + 1
    states, environment = np.empty((runs, n, 6)), np.array([*[given.friction] * 4, 0.0, 0.0, 0.0])
    substeps = steps_in(given.period, plant)
    for run in range(runs):
        states[run, 0] = 0.0, 0.0, 0.0, speeds[run], 0.0, 0.0
        plant.reset(states[run, 0].copy())
        for k in range(n - 1):
            wanted = (speeds[run] - states[run, k, 3]) / given.period if given.hold_speed else 0.0
            for _ in range(substeps):
                motion = plant.step(given.period / substeps, float(held[run, k]), float(wanted), environment.copy())
            states[run, k + 1] = motion
    slope = np.gradient(states[..., 4], given.period, axis=1)
    return states, slope + states[..., 3] * states[..., 5]


# -- steady turns -----------------------------------------------------------------------------------------------------
SETTLING = 6.0
"""s, until a turn counts as steady."""
STEADY = 2e-3
"""Largest change, relative, of the yaw rate over the last half second of a steady turn."""
TRIES, CLOSE = 15, 1e-6
"""Steps of the secant method at most, and the relative error at which it ends."""
LARGEST_ANGLE = 0.7
"""rad, of the wheels, that is looked for."""


@dataclass(frozen=True, eq=False)
class SteadyTurns:
    """Steady turns, arrays (m,); NaN where there is none."""

    speed: Array
    """m/s, v_x"""
    wheel_angle: Array
    """rad"""
    lateral_acceleration: Array
    """m/s^2, at the centre of mass"""
    yaw_rate: Array
    """rad/s"""
    sideslip: Array
    """rad"""
    curvature: Array
    """1/m, of the path of the centre of mass"""


def turns_under(
    plant: Plant | SteppedPlant, speed: ArrayLike, wheel_angle: ArrayLike, surroundings: Surroundings
) -> SteadyTurns:
    """The turns in which wheel angles (m,) rad at speeds (m,) m/s settle; NaN where they do not.

    Raises
    ------
    InvalidInput
        As `drive_open_loop`.
    """
    angle = np.atleast_1d(np.asarray(wheel_angle, dtype=np.float64))

    def ramp(t: Array) -> Array:
        return angle[:, None] * np.clip(t / 1.0, 0.0, 1.0)

    end = drive_open_loop(plant, ramp, speed, 1.0 + SETTLING, surroundings)
    before, last = end.yaw_rate[:, -1 - round(0.5 / surroundings.period)], end.yaw_rate[:, -1]
    with np.errstate(invalid="ignore"):
        settled = np.abs(last - before) <= STEADY * np.abs(last)
        settled &= np.abs(end.sideslip[:, -1]) < 0.5
    course = np.hypot(end.vx[:, -1], end.vy[:, -1])
    found = (end.vx[:, -1], angle, end.lateral_acceleration[:, -1], last, end.sideslip[:, -1], last / course)
    return SteadyTurns(*(np.where(settled, each, np.nan) for each in found))


def find_turns(
    car: Vehicle,
    plant: Plant | SteppedPlant,
    speed: ArrayLike,
    lateral_acceleration: ArrayLike,
    surroundings: Surroundings,
    radius: float | None = None,
) -> SteadyTurns:
    """The steady turns at speeds with given lateral accelerations (m/s^2), or on a circle, by the secant method.

    car: its linear model gives the first angle. With a `radius` (m) the turns have it, and lateral accelerations are
    not looked for. The result is NaN where no angle was found.

    Raises
    ------
    InvalidInput
        As `drive_open_loop`.
    """
    v, wanted = np.broadcast_arrays(
        np.atleast_1d(np.asarray(speed, dtype=np.float64)), np.asarray(lateral_acceleration, dtype=np.float64)
    )

    def missing(turns: SteadyTurns) -> Array:
        return turns.lateral_acceleration / wanted - 1.0 if radius is None else turns.curvature * radius - 1.0

    with np.errstate(divide="ignore", over="ignore"):  # so slow that no number holds the square of the speed
        angle = np.clip(wanted * (car.wheelbase / v**2 + car.understeer_gradient), 1e-4, LARGEST_ANGLE)
    turns = turns_under(plant, v, angle, surroundings)
    before, error = np.zeros_like(angle), missing(turns)
    error_before = np.full_like(angle, -1.0)  # without steering there is neither acceleration nor curvature
    for _ in range(TRIES):
        done, unsteady = np.abs(error) <= CLOSE, np.isnan(error)
        if done.all():
            break
        with np.errstate(invalid="ignore", divide="ignore"):
            step = np.nan_to_num(-error * (angle - before) / (error - error_before), nan=0.0)
        moved = np.clip(angle + np.clip(step, -0.3 * angle, 0.3 * angle), 1e-6, LARGEST_ANGLE)
        halfway = 0.5 * (angle + before)  # back towards the last angle with a steady turn
        known = ~(done | unsteady)
        before, error_before = np.where(known, angle, before), np.where(known, error, error_before)
        angle = np.where(done, angle, np.where(unsteady, halfway, moved))
        turns = turns_under(plant, v, angle, surroundings)
        error = missing(turns)
    reached = np.abs(error) <= 100.0 * CLOSE
    return SteadyTurns(*(np.where(reached, each, np.nan) for each in vars(turns).values()))


def steering_ratio_of(car: Vehicle) -> float:
    """Angle of the steering wheel over that of the road wheels: the car file's, else `STEERING_RATIO`."""
    known = car.steering.ratio if car.steering is not None else None
    return STEERING_RATIO if known is None else known
