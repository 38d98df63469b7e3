"""The parts of the informed MPC: a model with the steering, a filter for the sensors, a constant tuning."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from adaptrack.base.checked import Hint, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers.belief import (
    Belief,
    GivenSteering,
    SourcedValue,
    Uncertainty,
    assumed_computation,
    belief_of,
    limits_of,
    steering_rows,
)
from adaptrack.control.controllers.learned_car import Learner, Learning
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.controllers.tuning import ENTRIES, Tuning
from adaptrack.control.estimation import Estimator
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel, PredictionModel
from adaptrack.core.kernel import row_of
from adaptrack.core.maths import portable
from adaptrack.core.models.car import LearnedRow
from adaptrack.core.synthesis import mpc as kernel
from adaptrack.core.synthesis.car import KnownWithinRow
from adaptrack.core.synthesis.tuning import HORIZON_DURATION as HORIZON_DURATION
from adaptrack.core.synthesis.tuning import tune_informed
from adaptrack.scenario.profile import Profile, load_profile

AUTO: Literal["auto"] = "auto"
"""As `learning`: learn where lag or dead time of the steering is unknown."""
DEFAULT_LEARNING = Learning(dead_times=4)
"""How an MPC learns by default. Behind a steering that follows at once two hypotheses of the dead time are both far too
long, and the car may leave the road before they have come down: in 41 of 400 drives of four cars, with four in none."""
GivenLearning = Learning | Literal["auto"] | None
_MOST = int(PREDICTION_HORIZON.most), int(CONTROL_HORIZON.most)
DEFAULT_PROFILE = "road"
"""Profile of period, preview and sensors where the caller names none."""


def _check_period(period: float) -> float:
    if not 0.0 < period * period < math.inf:
        raise InvalidInput(f"MPC: period = {period!r} s: its square must be positive and finite.")
    return period


@checked
def informed_tuning(
    profile: str | Profile = "road",
    period: Annotated[Positive, "s"] | None = None,
    uncertainty: Annotated[Uncertainty, Hint("Uncertainty(lag=..., dead_time=...)")] | None = None,
) -> Tuning:
    """The constant tuning in a profile; period: control period, by default the profile's.

    R/Q is the weight that the profile itself gives to squared moves, times the caution of an uncertainty, and
    `core.synthesis.tuning.UNSEEN` times that without a sensor of the lateral velocity.
    """
    world = load_profile(profile)
    step = _check_period(world.period if period is None else period)
    entries = np.zeros(len(ENTRIES))
    tune_informed(world.controller_world(step), (uncertainty or Uncertainty()).caution, *_MOST, entries)
    return Tuning.of(entries.tolist())


class MPCParts(NamedTuple):
    """The parts of an MPC: tuning, model, estimator, limits and what it learns."""

    tuning: Tuning
    model: PredictionModel
    estimator: Estimator
    limits: Limits
    preview: bool
    belief: Belief | None = None
    """about the steering; None where the model was given"""
    learner: Learner | None = None
    learns: str = ""
    """whether it learns, why, and within what; empty where the model was given"""
    late_signals: str = ""
    """which signals are late in the profile, and how they are used; empty if none is late"""


def informed_parts(
    vehicle: Vehicle, profile: str | Profile | None, knowledge: tuple[GivenSteering, Uncertainty | None, GivenLearning],
    period: float | None, estimator: KalmanFilter | None, preview: bool | None = None, computation: float | None = None,
) -> MPCParts:  # fmt: skip
    """The parts of an MPC that knows its car; arguments as for `MPC`, knowledge: belief, uncertainty and learning.

    Raises InvalidInput for arguments that make no controller.
    """
    order, world, method, computation_time = order_of(
        vehicle, profile, knowledge, period, estimator, preview, computation
    )
    car, step = vehicle, float(order.world.period)
    rows = kernel.MPCNumbers.new(1)
    if estimator is not None:
        rows["filter"] = estimator.row
    parts = rows[0]
    if flaw := kernel.informed_numbers(order, parts):
        raise InvalidInput(f"MPC: {kernel.ORDER_FAULTS[flaw]}")
    filtering = KalmanFilter.from_row(parts.filter)
    learner = Learner(method, car, filtering, parts.learner) if parts.settings.learns else None
    seconds = 0.0 if method.start is None else method.start.seconds
    belief = belief_of(parts.belief, car, world, computation_time, seconds)
    learns = "" if learner is None else f": {_learned_ranges(learner)}"
    return MPCParts(
        tuning=Tuning.of(parts.tuning.tolist()),
        model=PathModel(car if learner is None else learner.car, step, float(parts.lag), float(parts.dead_time)),
        estimator=filtering,
        limits=replace(limits_of(parts.bounds), error=kernel.LARGEST_CORRECTION),
        preview=world.preview,
        belief=belief,
        learner=learner,
        learns=f"{'does not learn' if learner is None else 'learns'}, {_learning_reason(order, knowledge[2])}{learns}",
        late_signals=_late_signals(world, filtering, step),
    )


def _late_signals(world: Profile, filtering: KalmanFilter, period: float) -> str:
    """Which signals are late in a profile, and how a filter with this period (s) uses them; empty if none is late."""
    noise = filtering.noise
    motion = {"yaw rate": noise.yaw_rate, "lateral velocity": noise.vy, "wheel angle": noise.wheel_angle,
              "lateral acceleration": noise.lateral_acceleration}  # fmt: skip
    groups = ((["position", "yaw"], world.pose_age),
              ([name for name, sigma in motion.items() if sigma < math.inf], world.motion_age))  # fmt: skip
    sentences = []
    for names, age in groups:
        if age > filtering.oldest + 0.5 * period:
            use = f"not used, the filter takes in none older than {filtering.oldest:.3g} s"
        elif age > 0.0 and "lateral acceleration" in names:
            factor = 1 + math.floor(age / period + 1e-9)
            use = f"used at their time, lateral acceleration with {factor} times its noise"
        else:
            use = "used at their time"
        if age > 0.0 and names:
            sentences.append(f"{', '.join(names)} {age:.3g} s ({use})")
    return "; ".join(sentences)


def order_of(
    vehicle: Vehicle, profile: str | Profile | None, knowledge: tuple[GivenSteering, Uncertainty | None, GivenLearning],
    period: float | None, estimator: KalmanFilter | None, preview: bool | None = None, computation: float | None = None,
) -> tuple[Any, Profile, Learning, SourcedValue]:  # fmt: skip
    """A row of `core.synthesis.mpc.Order`, its profile, the method of learning, and the computation time (s).

    Arguments and errors are those of `informed_parts`.
    """
    car, world = vehicle, load_profile(DEFAULT_PROFILE if profile is None else profile)
    world = world.replace(preview=True) if preview else world  # a reference that is known ahead is tuned for
    step = _check_period(world.period if period is None else period)
    steering, uncertainty, learning = knowledge
    if learning is not None:
        _check_same_car(car, learning)
    method = DEFAULT_LEARNING if learning is None or learning == AUTO else learning
    uses_actuator = profile is not None and not isinstance(learning, Learning)
    computation_time = assumed_computation(computation, world, step, uses_actuator=profile is not None)
    loop = world.controller_world(step)
    loop.computation = computation_time.value
    caller, file, actuator = steering_rows(car, steering, world, uses_actuator)
    (longest, most), within = _MOST, car.known_within
    orders = kernel.Order.new(
        1, car=car.numbers, within=row_of(KnownWithinRow, within, is_given=within is not None),
        caller=caller, file=file, actuator=actuator, world=loop,
        unsure=(uncertainty or Uncertainty()).row, unsure_given=uncertainty is not None,
        learning=kernel.NEVER if learning is None else kernel.UNLESS_SAID if learning == AUTO else kernel.ALWAYS,
        filter_given=estimator is not None, longest_horizon=longest, most_moves=most,
        method=method.row, start=row_of(LearnedRow, method.start),
    )  # fmt: skip
    return orders[0], world, method, computation_time


def _check_same_car(car: Vehicle, learning: Learning | Literal["auto"]) -> None:
    """Refuse a start that was learned on a different car."""
    start = learning.start if isinstance(learning, Learning) else None
    if start is not None and start.car not in ("", car.name):
        raise InvalidInput(
            f"Learning: start: learned on car {start.car!r}, but the controller drives {car.name!r}: start without it; "
            "if it is the same car, set car = '' (in its file, or in Python LearnedCar(..., car=''))."
        )


def _learning_reason(order: Any, learning: GivenLearning) -> str:
    """Why a controller learns or not."""
    if learning != AUTO:
        return "as given"
    sources = (order.caller, order.file, order.actuator)
    unknown = [name for name in ("lag", "dead_time") if all(math.isnan(steering[name]) for steering in sources)]
    return f"unknown {' and '.join(unknown).replace('_', ' ')}" if unknown else "known lag and dead time"


def _learned_ranges(learner: Learner) -> str:
    """The ranges of what a controller learns, in words."""
    (short, long), (soon, late) = learner.ranges
    factor = portable.exp(learner.stiffness)
    first = f"lag {short:.3g} to {long:.3g} s, dead time {soon:.3g} to {late:.3g} s"
    (least, most), (_, latest) = learner.limits
    beyond = f" (hard limits: lag {least:.3g} to {most:.3g} s, dead time {latest:.3g} s)"
    limits = "" if learner.limits == learner.ranges else beyond
    top = f"; drive below {learner.first_top_speed:.3g} m/s first" if learner.first_top_speed < math.inf else ""
    return f"{first}{limits}, stiffness x or / {factor:.3g}{top}"
