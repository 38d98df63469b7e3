"""The world around a controller: plant, profile, driver, what is known of friction and wind, when a run has failed.

Runs from Python and compiled ones share it, and so they share what the kernels' control period (`core.period`) needs.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant, steps_in
from adaptrack.cars.vehicle import SteeringActuator
from adaptrack.control.controllers import MPC, Controller
from adaptrack.control.estimation import FrictionWindEstimator, Perception
from adaptrack.core import loop as loop_kernel
from adaptrack.core import period as period_kernel
from adaptrack.core.layout import room
from adaptrack.core.loop import SIGNAL
from adaptrack.core.planning.drive import complete_samples
from adaptrack.core.synthesis.plant import dead_periods
from adaptrack.drive.failure import Failure, Reason
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scenario.profile import SENSOR_FIELDS, Profile, load_profile

Array = NDArray[np.float64]
_log = logging.getLogger("adaptrack")
KnownAs = Perception | FrictionWindEstimator | None
"""How a scheduler knows friction and wind: exactly (None), with errors, or as an estimator finds them."""


@checked
@dataclass(frozen=True)
class Driver:
    """Longitudinal driver: asks for the acceleration that reaches the profile's speed a preview time ahead.

    dv = (v_ref(t + preview) - v_x)/preview + integral * (integral of v_ref - v_x), times the mass, within engine
    power, traction and brakes.
    """

    preview: Annotated[Positive, "s"] = 0.5
    integral: Annotated[NotNegative, "1/s^2"] = 0.2


@dataclass(frozen=True, eq=False)
class World:
    """Everything around the controller that all runs of a batch share."""

    plant: Plant | SteppedPlant
    """behind its steering"""
    profile: Profile
    period: float
    """s, of the controller"""
    driver: Driver | None
    known_as: KnownAs
    failure: Failure

    @classmethod
    def of(
        cls, plant: Plant | SteppedPlant, controller: Controller, profile: str | Profile, driver: Driver | None,
        known_as: KnownAs, failure: Failure | None,
    ) -> World:  # fmt: skip
        """The world of a controller.

        Raises
        ------
        InvalidInput
            When the parts do not fit each other.
        """
        if not isinstance(plant, Plant | SteppedPlant):
            raise InvalidInput(f"plant = {plant!r}: must be a Plant, such as DualTrack(load_vehicle('paper')).")
        if not isinstance(controller, Controller):
            raise InvalidInput(
                f"controller = {controller!r}: must be a Controller, such as MPC(load_vehicle('paper')); derive one of "
                "your own from adaptrack.Controller."
            )
        profile = load_profile(profile)
        if isinstance(plant, Plant) and getattr(plant, "steering", None) is None:
            plant = plant.with_steering(profile.steering)
        if failure is not None and not isinstance(failure, Failure):
            raise InvalidInput(f"failure = {failure!r}: must be a Failure(distance=..., sideslip=...).")
        if isinstance(known_as, FrictionWindEstimator) and not math.isclose(known_as.period, controller.period):
            raise InvalidInput(
                f"known_as: the estimator's period is {known_as.period!r} s, the controller's {controller.period!r} s: "
                "both run at the same instants."
            )
        _refuse_missing_sensors(controller, profile)
        world = cls(plant, profile, controller.period, driver, known_as, failure or Failure.of(plant))
        if isinstance(controller, MPC):
            controller.warn_of(controller.scheduler, profile.name, plant)
        world.warn_of_different_delay(controller)
        return world

    def warn_of_different_delay(self, controller: Controller) -> None:
        """Warn where the simulated delay differs from the controller's by its computation time, or is longer.

        With a delay assumed too short it may lose the car, with one too long it steers worse. A controller that learns
        finds a longer delay, and none that is shorter than its computation time.
        """
        belief, tolerance = controller.belief, 0.4 * self.period
        if belief is None:
            return
        believed, actual = belief.lag.value + belief.delay, self.steering.lag + sum(self.dead_periods) * self.period
        computation = self.profile.delay * self.period
        computation_error = computation - belief.computation.value
        delay_error = actual - believed if controller.learner is None else min(computation_error, 0.0)
        if abs(computation_error) > tolerance and delay_error * math.copysign(1.0, computation_error) > tolerance:
            _warn(
                f"adaptrack: the controller assumes a computation time of {belief.computation.value:.3g} s "
                f"({belief.computation.source}), profile {self.profile.name!r} simulates {computation:.3g} s: give the "
                f"controller profile={self.profile.name!r} or computation={computation:.3g}."
            )
        elif delay_error > tolerance:
            _warn(
                f"adaptrack: in profile {self.profile.name!r} the wheels follow a command {actual:.3g} s late, the "
                f"controller believes {believed:.3g} s: MPC(car, profile={self.profile.name!r}), or "
                "belief=Steering(...) of the car, tells it; with learning=Learning() it finds out."
            )

    @property
    def steering(self) -> SteeringActuator:
        """The actuator between command and wheels."""
        return getattr(self.plant, "steering", None) or self.profile.steering

    def substeps(self, top_speed: float) -> int:
        """Integration steps per control period up to a speed (m/s)."""
        if isinstance(self.plant, SteppedPlant):
            return steps_in(self.period, self.plant)
        return self.plant.substeps(self.period, top_speed)

    def settings(self, substeps: int) -> Any:
        """`core.loop.LoopSettings`; without a driver the speed follows its profile exactly."""
        profile, driver, steering = self.profile, self.driver, self.steering
        return loop_kernel.LoopSettings(
            period=self.period,
            substeps=substeps,
            prescribed_speed=driver is None,
            dead_whole=self.dead_periods[0],
            dead_share=self.dead_periods[1],
            **{name: getattr(profile, name) for name in SENSOR_FIELDS},
            steering_lag=steering.lag,
            steering_limit=steering.limit,
            steering_bias=steering.bias,
            driver_preview=driver.preview if driver else 1.0,
            driver_integral=driver.integral if driver else 0.0,
            **self.plant.powertrain,
            failure_distance=self.failure.distance,
            failure_sideslip=self.failure.sideslip,
        )

    @property
    def dead_periods(self) -> tuple[int, float]:
        """From an instant until its command acts: whole control periods, and the share of one more."""
        periods, share = dead_periods(self.profile.delay, self.steering.dead_time, self.period)
        return periods, share

    @property
    def remembered(self) -> int:
        """Instants whose samples are kept because they come late; 0 where all sensors are prompt."""
        return int(loop_kernel.instants_back(self.profile.oldest, self.period))

    def loop(
        self, inputs: Any, vehicles: Any, settings: Any, *, variables: bool, trace: Any = None, segments: int = 0
    ) -> Any:  # fmt: skip
        """Runs before their first instant (`core.period.RunLoop`), one for each of the vehicles.

        given: `core.period.Given`; variables: whether somebody looks at the scheduling variables; trace: as
        `core.period.traces`, None for none; segments: of each run.
        """
        past = self.remembered
        estimator = self.known_as if variables and isinstance(self.known_as, FrictionWindEstimator) else None
        counts = period_kernel.LoopCounts(**dict.fromkeys(period_kernel.LoopCounts._fields, 0))
        counts = counts._replace(
            slots=len(vehicles.start), dead_whole=self.dead_periods[0], past=past, segments=segments
        )  # fmt: skip
        loop = room(period_kernel.RunLoop, period_kernel.put_sizes, counts)
        loop.ceiling[:] = np.nan
        return loop._replace(
            settings=settings,
            features=period_kernel.Features(
                late=past > 0, variables=variables, estimates=estimator is not None, traces=trace is not None, law=0
            ),
            vehicles=vehicles,
            given=inputs,
            perceiving=loop.perceiving if estimator is None else estimator.packed_for(len(vehicles.start)),
            trace=loop.trace if trace is None else trace,
        )

    def samples(self, signals: Signals, number: int) -> Array:
        """A scenario's samples as the kernels read them, (`core.loop.SIGNAL`, n + 1).

        number: of the scenario in its batch, from which errors of perception are drawn.
        """
        rows = np.empty((len(SIGNAL), signals.n + 1))
        samples = {
            "y_ref": signals.y_ref, "speed": signals.speed, "wind_x": signals.wind[:, 0], "wind_y": signals.wind[:, 1],
            "bank": signals.bank, "acceleration": signals.curvature, "station": signals.station,
        }  # fmt: skip
        for name, values in samples.items():
            rows[getattr(SIGNAL, name)] = values
        rows[SIGNAL.friction_front_left : SIGNAL.friction_rear_right + 1] = signals.friction.T
        complete_samples(signals.period, rows)
        if isinstance(self.known_as, Perception):
            friction, wind = rows[SIGNAL.known_friction].copy(), rows[SIGNAL.known_wind].copy()
            rows[SIGNAL.known_friction], rows[SIGNAL.known_wind] = self.known_as.perceive(
                friction, wind, signals.period, number
            )
        return rows

    def start(self, scenario: Scenario | RoadDrive, signals: Signals) -> Array:
        """All states of the plant at the start (n,): in equilibrium at the speed of the scenario."""
        motion = np.array([*scenario.start_pose(), signals.speed[0], 0.0, 0.0])
        return motion if isinstance(self.plant, SteppedPlant) else self.plant.initial_state(motion)


@cache
def _warn(text: str) -> None:
    """Once in a process."""
    _log.warning(text)


def _refuse_missing_sensors(controller: Controller, profile: Profile) -> None:
    """The paper's increments need the whole state measured."""
    if not isinstance(controller, MPC) or controller.estimator.function is not None:
        return
    lacking = [name for name in controller.model.states if math.isinf(getattr(profile, f"noise_{name}"))]
    if lacking:
        raise InvalidInput(
            f"profile {profile.name!r} does not measure {', '.join(lacking)}, and this MPC takes its state as it is "
            "measured (estimator 'deadbeat'): take the informed controller, which estimates it (--controller informed; "
            "in Python MPC(car, profile=...))."
        )


def reason_of(ended: int) -> str | None:
    """The name of what ended a run early; None for a run that came to its end, or that was stopped for its cost."""
    return {
        loop_kernel.OFF_ROAD: Reason.OFF_ROAD.value,
        loop_kernel.NEVER_ARRIVED: Reason.OFF_ROAD.value,
        loop_kernel.SPUN: Reason.SPUN.value,
        loop_kernel.STATE_NOT_FINITE: Reason.NOT_FINITE.value,
    }.get(ended)
