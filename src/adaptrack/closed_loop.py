"""What surrounds the controller in one run, period by period: the car senses, is sent a command, and moves on.

The pieces of the control period are those of `core.loop`, which compiled runs call as well, in the same order.
Whoever decides stands outside: a controller in `simulate`, a learning agent in `gym`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.errors import InvalidInput
from adaptrack.estimation import FrictionWindEstimator
from adaptrack.plant import Plant, SteppedPlant
from adaptrack.road.ahead import RoadAhead, pack_roads
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scheduling.variables import SchedulingVariables
from adaptrack.world import World, reason_of

Array = NDArray[np.float64]

LONGEST_PREVIEW = 400
"""Control instants for which a controller in Python is told the speed ahead."""


class _CompiledVehicle:
    """A compiled plant in slot 0 of a block."""

    def __init__(self, world: World, start: Array) -> None:
        from adaptrack.core.plants.contract import place, vehicle_batch

        assert isinstance(world.plant, Plant)
        self._compiled = world.plant.compiled
        self._arrays = vehicle_batch(self._compiled, world.plant.packed(), start[None])
        self.block = self._arrays.block
        place(1, self._arrays.start, self.block, self._arrays.states)

    def observe(self, seen: Array) -> None:
        """Write lateral acceleration and front-wheel angle under the present input."""
        v = self._arrays
        self._compiled.observe(v.member, v.parameters, v.block, v.states, v.work, 0, seen)

    def advance(self, steps: int, h: float) -> None:
        """Move on by so many steps of h (s)."""
        v = self._arrays
        self._compiled.advance(v.member, v.parameters, v.block, v.states, v.work, 1, steps, h)


class _SteppedVehicle:
    """A stepped plant behind the loop's steering actuator; its motion is kept in slot 0 of a block."""

    def __init__(self, world: World, start: Array) -> None:
        from adaptrack.core.plants import contract

        assert isinstance(world.plant, SteppedPlant)
        self._plant, self._steering = world.plant, world.steering
        self._mass = world.plant.powertrain["mass"]
        self._contract = contract
        self.block = np.zeros(contract.BLOCK)
        self._state = self.block[: contract.STATES * contract.SLOTS : contract.SLOTS]
        self._input = self.block[contract.STATES * contract.SLOTS :: contract.SLOTS]
        self._lateral = 0.0
        self._state[:6] = start
        world.plant.reset(start.copy())

    def observe(self, seen: Array) -> None:
        """Lateral acceleration over the last steps, and the front-wheel angle under the present input."""
        seen[0], seen[1] = self._lateral, self._angle(0.0)

    def _angle(self, time: float) -> float:
        """The front-wheel angle (rad) after a time (s) under the present command."""
        command = float(np.clip(self._input[0], -self._steering.limit, self._steering.limit))
        angle = float(self._state[self._contract.STATE.steering])
        if self._steering.lag <= 0.0:
            return command
        gap, limited = command - angle, 0.0
        if abs(gap) > self._steering.rate * self._steering.lag:  # at the rate limit until the gap is small enough
            limited = min(time, abs(gap) / self._steering.rate - self._steering.lag)
            gap -= math.copysign(self._steering.rate * limited, gap)
        return command - gap * math.exp((limited - time) / self._steering.lag)

    def advance(self, steps: int, h: float) -> None:
        """Move on by so many steps of h (s)."""
        names = self._contract.INPUT
        force, acceleration = self._input[names.force], self._input[names.acceleration]
        wanted = force / self._mass if math.isnan(acceleration) else acceleration
        environment = self._input[names.friction_front_left :].copy()
        before = self._state[:6].copy()
        for _ in range(steps):
            middle, after = self._angle(0.5 * h), self._angle(h)
            motion = np.asarray(self._plant.step(h, middle, float(wanted), environment), dtype=np.float64)
            if motion.shape != (6,):
                raise InvalidInput(f"plant {self._plant.name!r}: step() gave {motion!r}: must be six numbers.")
            self._state[:6] = motion
            self._state[self._contract.STATE.steering] = after if self._steering.lag > 0.0 else 0.0
        turn = 0.5 * (before[3] * before[5] + self._state[3] * self._state[5])
        self._lateral = (self._state[4] - before[4]) / (steps * h) + turn - self._input[names.bank]


@dataclass(frozen=True, slots=True)
class Sensed:
    """What is known at a control instant."""

    measured: Array
    """`core.models.contract.MEASURED`; the same array at every instant"""
    speed: float
    """m/s, as measured"""
    reference: Array
    """m, y_ref now and at the instants that follow"""
    variables: SchedulingVariables


class ClosedLoop:
    """A run before its first period; then `sense`, `send`, (`observe`,) `advance` once per period.

    It is over when `sense` gives None: the run has failed, or has come to its end.
    """

    def __init__(self, world: World, scenario: Scenario | RoadDrive, seed: int) -> None:
        from adaptrack.core import loop
        from adaptrack.core.models.contract import MEASURED
        from adaptrack.core.plants.contract import SLOTS, STATES
        from adaptrack.core.variables import VARIABLES

        self._loop, self._kalman, self._names = loop, MEASURED, VARIABLES
        self.world, self.seed, self.instant = world, seed, 0
        self.signals = scenario.sample(world.period)
        self.road: Any = getattr(scenario, "road", None)
        self.rows = world.samples(self.signals, 0)[None]
        self.roads = pack_roads([self.road])
        self.settings = world.settings(world.substeps(float(self.signals.speed.max())))
        start = world.start(scenario, self.signals)
        stepped = isinstance(world.plant, SteppedPlant)
        self._vehicle = (_SteppedVehicle if stepped else _CompiledVehicle)(world, start)
        self._block = self._vehicle.block
        self.state = self._block[: STATES * SLOTS : SLOTS]
        self.memory = world.memory(1)
        self._own = self.memory.own[0]
        self._measured, self._look, self._felt = np.zeros(len(MEASURED)), np.zeros(len(VARIABLES)), np.zeros(2)
        self._substeps = loop.substeps_around_change(self.settings)
        self._feels = self.settings[0].noise_lateral_acceleration < math.inf
        self._estimator = world.known_as if isinstance(world.known_as, FrictionWindEstimator) else None
        if self._estimator is not None:
            self._estimator.reset()

    @property
    def command(self) -> float:
        """The last command (rad)."""
        return float(self._own.command)

    @property
    def error(self) -> float:
        """Y - y_ref (m) at the instant that was sensed last."""
        return float(self._own.offset - self.rows[0, 0, self.instant])

    @property
    def ended(self) -> bool:
        """Whether the run has failed before its end."""
        return bool(self._own.ended != self._loop.RUNNING)

    @property
    def finite(self) -> bool:
        """Whether the run has not ended in a state or a command that is not finite."""
        return bool(self._own.ended != self._loop.NOT_FINITE)

    def sense(self) -> Sensed | None:
        """Judge the run at this instant; what sensors give, None when it has failed.

        The instant at the end of the last period is not judged: a car that never came near its reference has failed.
        """
        loop, own, k = self._loop, self._own, self.instant
        loop.locate(0, self._block, self.settings, self.rows, 0, self.roads, self.memory)
        if k < self.signals.n:
            error = self.error
            own.arrived = own.arrived or abs(error) <= self.world.failure.distance
            self._end(loop.judge(error, self._block, 0, self.settings, bool(own.arrived)))
            if self.ended:
                return None
        return self.measure()

    def measure(self) -> Sensed:
        """What sensors give at this instant, once: samples that are late come in the order in which they were taken."""
        loop, own, k, measured = self._loop, self._own, self.instant, self._measured
        if self._feels:
            self._vehicle.observe(self._felt)
            measured[self._kalman.lateral_acceleration] = self._felt[0]
        speed = float(loop.sense(k, 0, self._block, self.settings, self.seed, self.memory, measured))
        loop.look(k, speed, measured, self.rows, 0, self._look)
        if self._estimator is not None:
            found = self._estimator.step(measured[:4], speed, own.command)
            self._look[self._names.friction], self._look[self._names.wind] = found.friction, found.wind
        return Sensed(measured, speed, self.rows[0, 0, k:], SchedulingVariables(*self._look.tolist()))

    def road_ahead(self, speed: float) -> RoadAhead:
        """The road ahead of a car that passes it as planned, from its present speed (m/s) on."""
        planned = self.signals.speed[self.instant :][:LONGEST_PREVIEW]
        return RoadAhead(self.road, float(self._own.station), np.maximum(planned + (speed - planned[0]), 0.0))

    def send(self, command: float) -> bool:
        """Send a command (rad); False when it is not finite, which ends the run."""
        if not math.isfinite(command):
            self._end(self._loop.NOT_FINITE)
            return False
        self._loop.actuate(self.instant, 0, command, self._block, self.settings, self.rows, 0, self.memory)
        return True

    def observe(self, seen: Array) -> None:
        """Write lateral acceleration (m/s^2) and front-wheel angle (rad) under the new command, then arc length (m),
        offset (m) and heading error (rad).
        """
        self._vehicle.observe(seen)
        own = self._own
        seen[2:] = own.station, own.offset, own.heading_error

    def advance(self) -> None:
        """Move on to the next instant."""
        (before, after), period = self._substeps, self.world.period
        share = float(self.settings[0].dead_share)
        if before:
            self._vehicle.advance(before, share * period / before)
            self._loop.change_command(1, self._block, self.settings, self.memory)
        self._vehicle.advance(after, (1.0 - share) * period / after)
        self.instant += 1

    def failure(self) -> tuple[str | None, float]:
        """Why a run that is over has failed and when (s); None and NaN when it came to its end."""
        if not self._own.arrived:
            self._own.ended, self._own.ended_at = self._loop.NEVER_ARRIVED, 0.0
        return failure_of(int(self._own.ended), float(self._own.ended_at))

    def _end(self, reason: int) -> None:
        self._own.ended = reason
        if reason != self._loop.RUNNING:
            self._own.ended_at = self.instant * self.world.period


def failure_of(ended: int, at: float) -> tuple[str | None, float]:
    """Why and when (s) a run failed, from what its loop remembers; None and NaN when it did not."""
    reason = reason_of(ended)
    return reason, at if reason is not None else math.nan
