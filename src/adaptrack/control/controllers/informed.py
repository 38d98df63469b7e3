"""The parts of the MPC that knows its car: a model with its steering, a filter for its sensors, a constant tuning."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal, NamedTuple

from pydantic import InstanceOf

from adaptrack.base.checked import Hint, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers.base import known_vehicle
from adaptrack.control.controllers.belief import (
    ASSUMED,
    TO_LEARN,
    Belief,
    GivenSteering,
    Said,
    Uncertainty,
    believed,
)
from adaptrack.control.controllers.learned import UNKNOWN_CAR, Learner, Learning
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.controllers.tuning import Tuning
from adaptrack.control.estimation import Estimator
from adaptrack.control.kalman import Drifts, KalmanFilter
from adaptrack.control.models import PathModel, PredictionModel
from adaptrack.core.estimators.learning import memory_of
from adaptrack.scenario.profile import Profile, load_profile

AUTO: Literal["auto"] = "auto"
"""As `learning`: learn where nobody says lag or dead time of the steering."""
UNASKED = Learning(dead_times=4)
"""How an MPC learns unasked. Behind a steering that follows at once two hypotheses of the dead time are both far too
long, and the car may leave the road before they have come down: in 41 of 400 drives of four cars, with four in none."""
GivenLearning = Learning | Literal["auto"] | None
WITHIN_DEAD_TIME = "no profile says it: learned with the dead time"
"""The source of a computation that nobody says, in a loop of one's own."""
UNNAMED = "road"
"""The profile whose period, preview and sensors are taken where none is named."""
UNSEEN = 3.0
"""Factor on R where the lateral velocity is not measured: what the filter makes of it is less sure. On seven cars
random drives in `production` cost a quarter less, half on the van and the electric car, a fifth more on the paper's."""
CAUTION = 10.0
"""Factor on R where the delay of the steering is assumed."""
UNEXPLAINED = 1.0, 0.6
"""m/s^2, rad/s^2: what wheels that nobody has aligned push and turn a car before their bias is learned. With the
filter's own spread, .3 and .3, the first minute of 40 unknown cars costs 1.28 instead of 1.26 in `road`."""
LARGEST_CORRECTION = 0.25
"""m, lateral error that is corrected at once: a larger one would ask the tyres for more than they have."""

HORIZON, MOVES = 1.5, 0.5
"""s, over which the outputs are predicted and the command may change, with preview."""
BLIND_HORIZON, BLIND_MOVES = 3.5, 0.8
"""s, the same without preview, as in the paper's table: a reference that is held is followed too eagerly in less."""
BLIND_MOVE_WEIGHT = 1e-5
"""s^2, R/Q times the squared control period where the profile gives them none and the reference is not known ahead:
that of the paper's table."""
LEAST_MOVE_WEIGHT = 1e-2
"""s^2, the same where it is known ahead. On six cars and twelve roads in `paper`: J 4e-6 m^2, none of 72 runs failed;
with weight and horizons as without preview 3e-4 m^2, and 7 failed."""


def _checked(period: float) -> float:
    if not 0.0 < period * period < math.inf:
        raise InvalidInput(f"MPC: period = {period!r} s: its square must be positive and finite.")
    return period


@checked
def informed_tuning(
    profile: str | Profile = "road",
    period: Annotated[Positive, "s"] | None = None,
    uncertainty: Annotated[InstanceOf[Uncertainty], Hint("Uncertainty(lag=..., dead_time=...)")] | None = None,
) -> Tuning:
    """The constant tuning in a profile; period: control period, by default the profile's.

    R/Q is the weight that the profile itself gives to squared moves, times the caution of an uncertainty, and
    `UNSEEN` times that without a sensor of the lateral velocity.
    """
    world = load_profile(profile)
    step = _checked(world.period if period is None else period)
    least = LEAST_MOVE_WEIGHT if world.preview else BLIND_MOVE_WEIGHT
    weight = max(world.move_weight * world.period**2, least) / step**2
    weight *= Uncertainty.declared(uncertainty).caution * (UNSEEN if math.isinf(world.noise_vy) else 1.0)
    ahead, free = (HORIZON, MOVES) if world.preview else (BLIND_HORIZON, BLIND_MOVES)
    horizon = min(max(2, round(ahead / step)), int(PREDICTION_HORIZON.most))
    moves = min(max(1, round(free / step)), int(CONTROL_HORIZON.most))
    return Tuning(horizon, moves, 1.0, float(f"{weight:.6g}"))


class Parts(NamedTuple):
    """What an MPC is made of, beside its vehicle, its moves and its solver."""

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


def informed_parts(
    vehicle: Vehicle, profile: str | Profile | None, given: tuple[GivenSteering, Uncertainty | None, GivenLearning],
    period: float | None, estimator: KalmanFilter | None, preview: bool | None = None,
) -> Parts:  # fmt: skip
    """The parts of an MPC that knows its car; arguments as for `MPC`, given: belief, uncertainty and learning.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    car, world = known_vehicle("MPC", vehicle), load_profile(UNNAMED if profile is None else profile)
    world = world.replace(preview=True) if preview else world  # a reference that is known ahead is tuned for
    step = _checked(world.period if period is None else period)
    steering, uncertainty, learning = given
    named = profile is not None and not isinstance(learning, Learning)
    plain = believed(car, steering, world, step, named=named)
    unsaid = " and ".join(name.replace("_", " ") for name in ("lag", "dead_time") if name in plain.assumed)
    why = "as given" if learning != AUTO else f"as nobody says {unsaid}" if unsaid else "as lag and dead time are said"
    if isinstance(learning, Learning) or (learning == AUTO and unsaid):
        method = learning if isinstance(learning, Learning) else UNASKED
        to_learn = _to_learn(plain, uncertainty, alone=profile is None)
        made = _learning_parts(car, world, (*to_learn, method), step, estimator)
        return made._replace(learns=f"learns, {why}: {made.learns}")
    unsure = Uncertainty.of_car(car, plain) if uncertainty is None else Uncertainty.declared(uncertainty)
    belief = plain.later(unsure)
    tuning = informed_tuning(world, step, unsure)
    drifts = unsure.widened(KalmanFilter().drifts, math.isfinite(world.noise_vy))
    return Parts(
        tuning=replace(tuning, R=tuning.R * CAUTION) if belief.is_cautious else tuning,
        model=PathModel(car, step, belief.lag.value, belief.delay),
        estimator=KalmanFilter.of_profile(world, drifts) if estimator is None else estimator,
        limits=replace(belief.bounds(step), error=LARGEST_CORRECTION),
        preview=world.preview,
        belief=belief,
        learns=f"does not learn, {why}",
    )


def _learning_parts(
    car: Vehicle, profile: Profile, given: tuple[Belief, Uncertainty | None, Learning], period: float,
    estimator: KalmanFilter | None,
) -> Parts:  # fmt: skip
    """The parts of an MPC that learns its car; given: what is said of the steering, how far it may be wrong, method."""
    said, unsure, learning = given
    sensing = KalmanFilter.of_profile(profile) if estimator is None else estimator
    spread = UNEXPLAINED if estimator is None else sensing.spread
    learner = Learner(learning, car, said, unsure, sensing, period)
    first = memory_of(learner.fresh(), 0).beliefs
    elsewhere = learning.wandering * float(first.belief_delay_sigma) / learning.modest  # rad/s, as the kernel has it
    drifts = replace(sensing.drifts, wheel_angle=math.hypot(Drifts().wheel_angle, elsewhere))
    return Parts(
        tuning=informed_tuning(profile, period),
        model=learner.model(),
        estimator=replace(sensing, longest=learner.longest, drifts=drifts, spread=spread),
        limits=replace(said.bounds(period), error=LARGEST_CORRECTION),
        preview=profile.preview,
        belief=_begun(said, learner, (float(first.used_lag), float(first.used_dead_time))),
        learner=learner,
        learns=_within(learner),
    )


def _to_learn(said: Belief, uncertainty: Uncertainty | None, alone: bool) -> tuple[Belief, Uncertainty | None]:
    """What a controller that learns is given of the steering, and how far that may be wrong, None where nobody says.

    alone: whether no profile says the computation: a dead time that nobody says holds it. A delay that nobody says is
    never certain.
    """
    if alone and "dead_time" in said.assumed:
        said = replace(said, computation=Said(0.0, WITHIN_DEAD_TIME))
    if uncertainty is None:
        return said, None
    unsaid = [name for name in ("lag", "dead_time") if name in said.assumed and getattr(uncertainty, name) == 0.0]
    return said, replace(uncertainty, **{name: getattr(UNKNOWN_CAR, name) for name in unsaid})


def _begun(said: Belief, learner: Learner, first: tuple[float, float]) -> Belief:
    """The belief with which a controller that learns begins; first: lag and dead time (s)."""
    start = learner.own.start
    earlier = None if start is None else f"learned before, in {start.seconds:.0f} s"
    begun = {}
    for name, value in zip(("lag", "dead_time"), first, strict=True):
        source = getattr(said, name).source
        begun[name] = Said(value, earlier or (TO_LEARN if source == ASSUMED else source))
    return replace(said, **begun)


def _within(learner: Learner) -> str:
    """Within what a controller learns."""
    (short, long), (soon, late) = learner.ranges
    factor = math.exp(learner.stiffness)
    first = f"lag {short:.3g} to {long:.3g} s, dead time {soon:.3g} to {late:.3g} s"
    (least, most), (_, latest) = learner.limits
    more = "" if learner.limits == learner.ranges else f" (not beyond {least:.3g} to {most:.3g} s and {latest:.3g} s)"
    return f"{first}{more}, stiffness x or / {factor:.3g}"
