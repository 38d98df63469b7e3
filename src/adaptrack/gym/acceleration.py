"""Acceleration that an agent commands in addition to the steering: its bounds, requests, observations and cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import NotNegative, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.public import (
    GRAVITY,
    HOLDING_DECELERATION,
    MIN_APPROACH_SPEED,
    PLANT_STATE,
    SIGNAL,
    SLOTS,
    STANDING_SPEED,
)
from adaptrack.drive.world import RequestedForces
from adaptrack.gym.task import Task

Array = NDArray[np.float64]

ACCELERATION_BOUNDS, PLANNED_SPEED_BOUNDS = (-100.0, 100.0), (0.0, 100.0)
"""Bounds of the last commanded acceleration (m/s^2) and of a planned speed (m/s) in an observation."""
SPEED_WEIGHT, ACCELERATION_WEIGHT = 0.01, 0.001
"""Default weights of the cost, s^2 and s^4: 1 m/s of speed error costs as much as an offset of 0.1 m."""


def task_of(acceleration: bool, options: dict[str, Any]) -> Task:
    """Return the task of an environment; if the agent commands the acceleration, no driver moves the car.

    Raises
    ------
    InvalidInput
        When a driver is given although the agent commands the acceleration.
    """
    if not acceleration:
        return Task(**options)
    if "driver" in options:
        raise InvalidInput("driver: with acceleration=True the agent commands the speed: leave the driver out.")
    return Task(**options, driver=RequestedForces())


def acceleration_bounds(task: Task) -> tuple[float, float]:
    """Return the bounds of an acceleration (m/s^2): +- the largest force of brakes or drive over the mass."""
    _, plant, _ = task.base_car()
    powertrain = plant.powertrain
    largest = max(powertrain["brake_limit"], powertrain["traction_limit"]) / powertrain["mass"]
    return -largest, largest


@checked
@dataclass(frozen=True)
class AccelerationInput:
    """Accelerations that agents command to the cars of a batch or run: requests, cost and observed columns."""

    distances: Any
    """(n,) m, preview distances of the planned speed"""
    speed_weight: Annotated[NotNegative, "s^2"] = SPEED_WEIGHT
    """of the squared speed error in the cost"""
    acceleration_weight: Annotated[NotNegative, "s^4"] = ACCELERATION_WEIGHT
    """of the squared change of the acceleration in the cost"""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns at the end of an observation."""
        return ("acceleration", *(f"planned_speed_{distance:g}m" for distance in self.distances))

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Bounds of these columns."""
        return [ACCELERATION_BOUNDS, *[PLANNED_SPEED_BOUNDS] * len(self.distances)]

    def request(self, accelerations: Array, last: Array, vehicle: Vehicle, run: Any) -> Array:
        """Request the accelerations (slots,) in m/s^2 of drive and brakes, and return the costs (slots,) in m^2.

        The force is mass times the acceleration, plus slope and driving resistance as the data sheet gives them. Where
        no driving is requested, the brakes hold a standing car. On a slope they also hold it until the drive does.

        Parameters
        ----------
        last
            Accelerations of the period before, which this method replaces.
        vehicle
            Data sheet of the cars.
        run
            Batch or run, `core.simulation.run.RunRecord`.
        """
        loop, signals = run.memory.drives, run.inputs.signals
        place = np.where(loop["located"] > 0, loop["place"], np.minimum(loop["sample"], signals.shape[2] - 1))
        grade = signals[run.inputs.scenario, SIGNAL.grade, place]
        slope = GRAVITY * grade / np.sqrt(1.0 + grade * grade)
        speed, mass = loop["speed"], run.settings.mass
        drag = 0.5 * vehicle.air_density * vehicle.frontal_area * vehicle.drag_coefficient
        rolling = vehicle.rolling_resistance * GRAVITY * np.clip(2.0 * speed, 0.0, 1.0)
        force = mass * (accelerations + rolling + slope) + drag * speed * np.abs(speed)
        stands, drives = np.abs(speed) < STANDING_SPEED, accelerations > 0.0
        holding = np.where(
            drives, mass * slope - loop["drive_force"], mass * (np.abs(slope) + HOLDING_DECELERATION - accelerations)
        )  # fmt: skip
        loop["requested_force"] = np.where(stands & ~drives, 0.0, force)
        loop["requested_hold"] = np.where(stands, np.maximum(holding, 0.0), 0.0)
        true_speed = run.vehicles.block[PLANT_STATE.vx * SLOTS :][: loop.size]
        speed_error = true_speed - self._planned_speeds(loop["station"], np.zeros(1), run)[:, 0]
        change = accelerations - last
        last[:] = accelerations
        return self.speed_weight * speed_error * speed_error + self.acceleration_weight * change * change

    def observe(self, last: Array, run: Any, observations: Array) -> None:
        """Write the last columns of the observations (slots, columns): last acceleration and planned speeds ahead."""
        first = observations.shape[1] - len(self.names)
        observations[:, first] = np.clip(last, *ACCELERATION_BOUNDS)
        speeds = self._planned_speeds(run.memory.drives["station_estimate"], self.distances, run)
        np.copyto(observations[:, first + 1 :], np.clip(speeds, *PLANNED_SPEED_BOUNDS), where=np.isfinite(speeds))

    def _planned_speeds(self, stations: Array, distances: Array, run: Any) -> Array:
        """Return the planned speeds (slots, n) in m/s at distances (n,) ahead of the cars' stations (slots,), in m.

        Without a road the plan is a function of time, and the car comes to a distance with its present speed.
        """
        loop, inputs = run.memory.drives, run.inputs
        speeds = np.empty((loop.size, len(distances)))
        for scenario in np.unique(inputs.scenario):
            cars = np.flatnonzero(inputs.scenario == scenario)
            plan = inputs.signals[scenario]
            if inputs.roads.of[scenario] >= 0:
                places, grid = stations[cars, None] + distances, plan[SIGNAL.station]
            else:
                approach = np.maximum(loop["speed"][cars], MIN_APPROACH_SPEED) * run.settings.period
                places = loop["instant"][cars, None] + distances / approach[:, None]
                grid = np.arange(plan.shape[1], dtype=np.float64)
            speeds[cars] = np.interp(places, grid, plan[SIGNAL.speed])
        return speeds
