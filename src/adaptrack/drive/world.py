"""World: the simulated car and everything around its controller.

It has plant, profile, driver, the perception of friction and wind, and the failure limits. Runs in Python and compiled
runs both use it to build the inputs of the kernels (`core.simulation.run`).
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Protocol, runtime_checkable

import numpy as np

from adaptrack.base.checked import Bound, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.cars.plant import Plant, SteppedPlant, steps_in
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator, SteeringActuator
from adaptrack.control.controllers import Controller
from adaptrack.control.estimation import FrictionWindEstimator, Perception
from adaptrack.control.speed_control import SpeedCommand, SpeedControl
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.contract import SENSOR_FIELDS
from adaptrack.core.planning.drive import complete_samples
from adaptrack.core.simulation import run as run_kernel
from adaptrack.core.simulation import world as kernel
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.core.synthesis.plant import dead_periods
from adaptrack.drive.failure import FailureLimits
from adaptrack.road import Road, SpeedPlan
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scenario.profile import Profile, load_profile

_log = logging.getLogger("adaptrack")
PerceptionSource = Perception | FrictionWindEstimator | None
"""Friction and wind that a scheduler receives: true values (None), values with errors, or estimates."""


@checked
@dataclass(frozen=True)
class Driver:
    """Longitudinal driver: requests the force that reaches the planned speed a preview time ahead.

    The force is m ((v_plan - v_x)/preview + integral * (integral of v_plan - v_x)) plus the force of the slope. It is
    limited by engine power, traction, brakes and the guard. On a road the planned speed depends on the station, so a
    late car does not hurry; at a stop the car waits as long as planned. Without a road it depends on time.

    guard: the largest force is this share of what the driven or braked axles can transmit in addition to their lateral
    force. With inf the driver is naive: it uses the pedals in a bend as on a straight.
    """

    preview: Annotated[Positive, "s"] = 0.5
    integral: Annotated[NotNegative, "1/s^2"] = 0.2
    guard: Annotated[Bound, "-"] = 0.85
    roads_only: bool = False
    """whether a scenario without a road follows its planned speed exactly, without a driver"""


MAX_REQUESTED_SPEED = 70.0
"""m/s, up to which a plant is integrated accurately if forces are requested without a plan."""
ROAD_DRIVER = Driver(roads_only=True)
"""Default driver of commands and environments."""


class SpeedFollower(Protocol):
    """A speed controller on its way along a path."""

    def step(self, station: float, speed: float, yaw_rate: float) -> SpeedCommand:
        """Return the requests for the present period.

        station: m, of the car on its path over all laps; speed: m/s; yaw_rate: rad/s. NaN: not measured.
        """
        ...


@runtime_checkable
class SpeedDriver(Protocol):
    """Your own speed controller, as ``driver`` of `simulate`; `SpeedControl` is the one of this package."""

    def begin(self, path: Road, plan: SpeedPlan, period: float) -> SpeedFollower:
        """Begin a run along a path with its planned speeds, called once a control period (s)."""
        ...


LongitudinalDriver = Driver | SpeedControl | SpeedDriver | None
"""What moves a simulated car; None: it follows its speed reference exactly."""


@dataclass(frozen=True)
class RequestedForces:
    """Driver of a run whose caller writes the requested forces to the memory of the loop before each command."""


@dataclass(frozen=True, eq=False)
class World:
    """Simulated car and everything else around the controller; all runs of a batch share it."""

    plant: Plant | SteppedPlant
    """Simulated car including its steering actuator."""
    profile: Profile
    """Steering, sensors and computation time."""
    period: float
    """Control period of the controller (s)."""
    driver: LongitudinalDriver | RequestedForces
    """Longitudinal driver; None to follow the speed reference exactly."""
    perception: PerceptionSource
    """Friction and wind that a scheduler receives."""
    failure: FailureLimits
    """Limits beyond which a run fails."""

    @classmethod
    def of(
        cls, plant: Plant | SteppedPlant, controller: Controller, profile: str | Profile,
        driver: LongitudinalDriver | RequestedForces,
        perception: PerceptionSource, failure: FailureLimits | None,
    ) -> World:  # fmt: skip
        """Build the world of a controller from arguments of `simulate`; InvalidInput when they do not match."""
        if driver is not None and not isinstance(driver, Driver | SpeedControl | SpeedDriver | RequestedForces):
            raise InvalidInput(
                f"driver = {format_value(driver)}: must be a Driver, a SpeedControl, an object whose method "
                "`begin` takes path, plan and period, or None."
            )
        profile = load_profile(profile)
        if isinstance(plant, Plant) and getattr(plant, "steering", None) is None:
            plant = plant.with_steering(profile.steering)
        if isinstance(perception, FrictionWindEstimator) and not math.isclose(perception.period, controller.period):
            raise InvalidInput(
                f"perception: the estimator's period is {perception.period!r} s, that of the controller "
                f"{controller.period!r} s: give both the same period."
            )
        _refuse_missing_sensors(controller, profile)
        world = cls(plant, profile, controller.period, driver, perception, failure or FailureLimits.of(plant))
        controller.warn_of(controller.scheduler, profile.name, plant)
        world.warn_of_different_delay(controller)
        return world

    def warn_of_different_delay(self, controller: Controller) -> None:
        """Warn if the controller's steering model assumes a wrong delay.

        The warning has two cases:

        - the computation time differs from the simulated one, and so does the whole delay;
        - the simulated delay is longer than the assumed one, and the controller does not learn it.

        A delay assumed too short can make the loop unstable; one assumed too long costs accuracy. A learning controller
        can increase its delay, but never below its computation time.
        """
        steering_model, tolerance = controller.belief, 0.4 * self.period
        if steering_model is None:
            return
        assumed_delay = steering_model.lag.value + steering_model.delay
        simulated_delay = self.steering.lag + sum(self.dead_periods) * self.period
        computation = self.profile.delay * self.period
        computation_error = computation - steering_model.computation.value
        # a learning controller corrects all delays but a computation time that it assumes too long
        delay_error = simulated_delay - assumed_delay if controller.learner is None else min(computation_error, 0.0)
        if abs(computation_error) > tolerance and delay_error * math.copysign(1.0, computation_error) > tolerance:
            warn_once(
                f"adaptrack: the controller assumes a computation time of {steering_model.computation.value:.3g} s "
                f"({steering_model.computation.source}), but profile {self.profile.name!r} simulates "
                f"{computation:.3g} s: give the controller profile={self.profile.name!r} or "
                f"computation={computation:.3g}."
            )
        elif delay_error > tolerance:
            warn_once(
                f"adaptrack: profile {self.profile.name!r} simulates a steering delay of {simulated_delay:.3g} s, but "
                f"the controller assumes {assumed_delay:.3g} s. Give the controller profile={self.profile.name!r} or "
                "belief=Steering(...) with the right delay, or learning=Learning() to estimate it."
            )

    @property
    def steering(self) -> SteeringActuator:
        """Steering actuator between command and road wheels: that of the plant, otherwise that of the profile."""
        return getattr(self.plant, "steering", None) or self.profile.steering

    def substeps(self, top_speed: float) -> int:
        """Number of integration steps per control period for speeds up to `top_speed` (m/s)."""
        if isinstance(self.plant, SteppedPlant):
            return steps_in(self.period, self.plant)
        if isinstance(self.driver, RequestedForces):
            top_speed = max(top_speed, MAX_REQUESTED_SPEED)
        return self.plant.substeps(self.period, top_speed)

    def settings(self, substeps: int) -> Any:
        """Return the `core.simulation.world.LoopSettings` for a number of integration steps per control period."""
        profile, steering, drive, brakes = (
            self.profile,
            self.steering,
            self._actuator("drive"),
            self._actuator("brakes"),
        )
        driver = self.driver if isinstance(self.driver, Driver) else Driver(1.0, 0.0, math.inf)  # or none
        return kernel.LoopSettings(
            period=self.period,
            substeps=substeps,
            prescribed_speed=self._speed_kind,
            dead_whole=self.dead_periods[0],
            dead_share=self.dead_periods[1],
            **{field.name: getattr(profile, field.name) for field in SENSOR_FIELDS},
            steering_lag=steering.lag,
            steering_limit=steering.limit,
            steering_bias=steering.bias,
            driver_preview=driver.preview,
            driver_integral=driver.integral,
            **self.plant.powertrain,
            failure_distance=self.failure.distance,
            failure_sideslip=self.failure.sideslip,
            **self.plant.axles,
            guard=driver.guard,
            **_actuator_settings("drive", drive, self.period),
            creep=drive.creep,
            **_actuator_settings("brake", brakes, self.period),
        )

    def has_driver(self, scenario: Scenario | RoadDrive) -> bool:
        """Whether a driver moves the car, with forces; otherwise its speed is prescribed."""
        return self.driver is not None and (
            isinstance(scenario, RoadDrive) or not getattr(self.driver, "roads_only", False)
        )

    @property
    def _speed_kind(self) -> int:
        """Value of `prescribed_speed` in the `LoopSettings`: prescribed, a driver, or requested forces."""
        if self.driver is None:
            return kernel.PRESCRIBED
        if not isinstance(self.driver, Driver):
            return kernel.EXTERNAL_FORCES
        return kernel.PRESCRIBED_WITHOUT_ROAD if self.driver.roads_only else kernel.DRIVER_FORCES

    def _actuator(self, name: str) -> Any:
        """The actuator of the car file ("drive" or "brakes"), otherwise that of the profile."""
        return getattr(getattr(self.plant, "vehicle", None), name, None) or getattr(self.profile, name)

    @property
    def dead_periods(self) -> tuple[int, float]:
        """Delay from a measurement until its command acts: whole control periods, and a share of one more."""
        periods, share = dead_periods(self.profile.delay, self.steering.dead_time, self.period)
        return periods, share

    @property
    def remembered(self) -> int:
        """Number of past instants whose samples are stored because they arrive late; 0 without late samples."""
        return int(kernel.instants_back(self.profile.oldest, self.period))

    def run(
        self, inputs: Any, vehicles: Any, settings: Any, controller: Any, *, needs_variables: bool, trace: Any = None,
        segments: int = 0, asks: bool = False, **fields: Any,
    ) -> Any:  # fmt: skip
        """Allocate new runs with their controllers (`core.simulation.run.RunRecord`), one run per vehicle.

        inputs, vehicles, controller: records of the kernels; settings: the result of `settings`; needs_variables:
        whether a scheduler or an agent reads the scheduling variables; trace: memory of the recorded signals, None to
        record nothing; segments: number of segments whose cost is recorded in each run; asks: whether the caller is
        asked before each step of a controller, or is the controller; fields: other fields of the record.
        """
        slots, past = len(vehicles.start), self.remembered
        estimator = self.perception if needs_variables and isinstance(self.perception, FrictionWindEstimator) else None
        if estimator is not None:
            fields["variable_estimator"] = estimator.packed_for(slots)
        if trace is not None:
            fields["trace"] = trace
        features = run_kernel.Features(
            late=past > 0, variables=needs_variables, estimates=estimator is not None, traces=trace is not None,
            asks=asks, window=0,
        )  # fmt: skip
        sizes = {
            "slots": slots, "dead_whole": self.dead_periods[0], "past": past, "segments": segments,
            "requested": 2 * (2 + max(settings.drive_whole, settings.brake_whole)),
        }  # fmt: skip
        return run_kernel.new_run(
            sizes, settings=settings, features=features, vehicles=vehicles, inputs=inputs, controller=controller,
            cost_limit=np.full(slots, np.nan), **fields,
        )  # fmt: skip

    def samples(self, signals: Signals, number: int) -> Array:
        """Convert the samples of a scenario to the rows of the kernels (`core.simulation.world.SIGNAL`), (rows, n + 1).

        number: index of the scenario in its batch; it selects the perception errors.
        """
        if np.any(signals.grade) and not self.plant.takes_grade:
            raise InvalidInput(
                f"plant {self.plant.name!r} does not take the grade of a road, and this one climbs up to "
                f"{np.abs(signals.grade).max():.3g}: let it read the eighth entry of environment, dz/ds, and set "
                "takes_grade=True; or drive the road without its grade, road.replace(grade=0.0)."
            )
        rows = np.empty((len(SIGNAL), signals.n + 1))
        samples = {
            "y_ref": signals.y_ref, "speed": signals.speed, "wind_x": signals.wind[:, 0], "wind_y": signals.wind[:, 1],
            "bank": signals.bank, "station": signals.station, "grade": signals.grade,
            "acceleration": signals.curvature,  # complete_samples replaces the curvature by the lateral acceleration
        }  # fmt: skip
        for name, values in samples.items():
            rows[getattr(SIGNAL, name)] = values
        rows[SIGNAL.friction_front_left : SIGNAL.friction_rear_right + 1] = signals.friction.T
        complete_samples(signals.period, rows)
        if isinstance(self.perception, Perception):
            friction, wind = rows[SIGNAL.known_friction].copy(), rows[SIGNAL.known_wind].copy()
            rows[SIGNAL.known_friction], rows[SIGNAL.known_wind] = self.perception.perceive(
                friction, wind, signals.period, number
            )
        return rows

    def start(self, scenario: Scenario | RoadDrive, signals: Signals) -> Array:
        """Return all states (n,) of the plant at the start, in equilibrium at the speed of the scenario."""
        motion = np.array([*scenario.start_pose(), signals.speed[0], 0.0, 0.0])
        return motion if isinstance(self.plant, SteppedPlant) else self.plant.initial_state(motion)


def _actuator_settings(name: str, actuator: DriveActuator | BrakeActuator, period: float) -> dict[str, float]:
    """Entries of `core.simulation.world.LoopSettings` of drive or brakes."""
    whole_periods, share = dead_periods(0.0, actuator.dead_time, period)
    values = {"whole": whole_periods, "share": share, "lag": actuator.lag, "rate": actuator.rate, "gain": actuator.gain}
    return {f"{name}_{key}": value for key, value in values.items()}


@cache
def warn_once(text: str) -> None:
    """Log a warning, once per process."""
    _log.warning(text)


def _refuse_missing_sensors(controller: Controller, profile: Profile) -> None:
    """Raise InvalidInput if an MPC without an estimator needs a state that the profile does not measure."""
    if not controller.needs_whole_state:
        return
    lacking = [name for name in controller.model.states if math.isinf(getattr(profile, f"noise_{name}"))]
    if lacking:
        raise InvalidInput(
            f"profile {profile.name!r} does not measure {', '.join(lacking)}, but this MPC has no state estimator "
            "(estimator 'deadbeat'). Use the informed controller, which has one (--controller informed; in Python "
            "MPC(car, profile=...))."
        )
