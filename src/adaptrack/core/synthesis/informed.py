"""The parts of the MPC that knows, or learns, its car, and all of its numbers at once."""

from __future__ import annotations

import math

from ..controllers.feed_forward import TurnIn, turning_of
from ..controllers.mpc import MPCSettings
from ..estimators import kalman, learning
from ..estimators.learning_method import MAX_HYPOTHESES, LearningMethod
from ..kernel import (
    OK,
    Place,
    Row,
    copier,
    exported,
    float64,
    inlined,
    int64,
    int_vector,
    record,
    rows,
    several,
    size_of,
    vector,
)
from ..maths.exponential import hypot
from ..models import path
from ..models.car import CarRow, LearnedRow, SteeringRow
from ..models.contract import MEASUREMENT
from .belief import (
    FROM_EARLIER_DRIVE,
    MAX_DELAY,
    MAX_MASS,
    MAX_STIFFNESS,
    MEDIAN_TO_LEARN,
    SLOW_ASSUMED,
    BeliefRow,
    CommandBounds,
    UncertaintyRow,
    believe_steering,
    bound_commands,
    caution_of,
    delay_margin,
    is_cautious,
    uncertainty_of_car,
    widen_drifts,
)  # fmt: skip
from .car import KnownWithinRow, relaxation_delay
from .filter import DEFAULT_DRIFTS, Filter, filter_numbers, filter_periods, filter_size, sensor_noise
from .learner import (
    UNKNOWN_CAR_ROW,
    LearnerRow,
    begin_learner,
    learner_memory,
    learner_numbers,
    learner_size,
)  # fmt: skip
from .tuning import ASSUMED_DELAY_CAUTION, ControllerWorld, tune_informed

NEVER, UNLESS_SAID, ALWAYS = range(3)
"""Whether a controller learns: not; where nobody says lag or dead time; always."""
Order = record(
    "Order",
    (
        ("car", CarRow), ("within", KnownWithinRow),
        # by the caller, the car's file, the profile
        ("caller", SteeringRow), ("file", SteeringRow), ("actuator", SteeringRow),
        ("world", ControllerWorld),
        ("unsure", UncertaintyRow), "unsure_given",  # 1: the caller says it
        "learning",  # `NEVER`, ...
        "filter_given",  # 1: the filter is the caller's, 0: it is made of `world`
        "longest_horizon", "most_moves",  # Np and Nc at most
        ("method", LearningMethod), ("start", LearnedRow),
    ),
    integers=("unsure_given", "learning", "filter_given", "longest_horizon", "most_moves"),
)  # fmt: skip
"""What is known of a car and its loop, and what is wanted."""
InformedParts = record(
    "InformedParts",
    (
        ("belief", BeliefRow),
        ("unsure", UncertaintyRow),
        ("bounds", CommandBounds),
        ("filter", Filter),
        ("learner", LearnerRow),
        ("tuning", (float64, 4)),
        "lag", "dead_time",  # s, of the prediction model; the dead time with the computation
        "learns",  # 1: the car is learned
    ),
    integers=("learns",),
)  # fmt: skip
"""What an informed MPC is made of; its filter is given where `Order.filter_given`, the usual one else."""
Constants = record(
    "Constants",
    (
        ("settings", rows(MPCSettings)),  # (1,): those of the loop are written, of horizons and solver they stay
        ("tuning", vector),  # (4,)
        ("model", vector),  # (7,) `models.path.Parameters`
        ("states", int_vector),  # (5,)
        ("turning", vector),  # (7,) `controllers.feed_forward.Turning`
        ("estimator", vector),  # `kalman.FilterParameters`
        ("learner", vector),  # `learning.LearnerParameters`; may be empty where nothing is learned
        ("fresh", vector),  # the learner's memory before the first sample, likewise
    ),
)
"""The numbers of an `Mpc`, in memory of the caller's."""

_copy_uncertainty, _copy_model = copier(UncertaintyRow), copier(path.Parameters)
_FILTER, _MODEL, _TURNING, _LEARNER = map(
    size_of, (kalman.FilterParameters, path.Parameters, TurnIn, learning.LearnerParameters)
)
MOST_TIME, MIN_POSITIVE = 10.0, 1e-300
"""s, of a lag, a dead time or an age; the least that is more than nothing."""
CAR_WRONG, LOOP_WRONG, STEERING_WRONG, UNCERTAINTY_WRONG, METHOD_WRONG, MEMORY_TOO_SMALL = range(1, 7)
"""What `informed_parts` and `informed_constants` answer."""
UNEXPLAINED = (1.0, 0.6)
"""m/s^2, rad/s^2: what wheels that nobody has aligned push and turn a car before their bias is learned. With the
filter's own spread, .3 and .3, the first minute of 40 unknown cars costs 1.28 instead of 1.26 in `road`."""
LARGEST_CORRECTION = 0.25
"""m, lateral error that is corrected at once: a larger one would ask the tyres for more than they have."""


@inlined
def _set_fixed_belief(order, parts):
    """Make the parts of a controller that does not learn: it assumes a high quantile of the delay.

    Where the lateral velocity is not measured the model's dead time includes `relaxation_delay`: without it the loop of
    a heavy car is unstable at speed. With that sensor the loop is stable without it.
    """
    belief, unsure, world = parts.belief, parts.unsure, order.world
    if order.unsure_given == 0:
        uncertainty_of_car(order.within, belief, unsure)
    steering = belief.steering
    steering.lag += delay_margin(unsure.lag)
    steering.dead_time += delay_margin(unsure.dead_time)
    tune_informed(world, caution_of(unsure), order.longest_horizon, order.most_moves, parts.tuning)
    if is_cautious(belief):
        parts.tuning[3] *= ASSUMED_DELAY_CAUTION
    if order.filter_given == 0:
        widen_drifts(unsure, 1 if world.noise_vy < math.inf else 0, parts.filter.drifts)
    bound_commands(belief, world.period, parts.bounds)
    parts.lag, parts.dead_time = steering.lag, belief.computation + steering.dead_time
    if world.noise_vy == math.inf:
        parts.dead_time += relaxation_delay(order.car)


@inlined
def _widen_unknown_delay(parts):
    """Widen the uncertainty of an unknown lag or dead time that is declared certain."""
    source, unsure = parts.belief.source, parts.unsure
    if source.lag == SLOW_ASSUMED and unsure.lag == 0.0:
        unsure.lag = UNKNOWN_CAR_ROW.lag
    if source.dead_time == SLOW_ASSUMED and unsure.dead_time == 0.0:
        unsure.dead_time = UNKNOWN_CAR_ROW.dead_time


@inlined
def _source_at_start(source, learned_before):
    """The source of a delay with which a controller that learns begins."""
    if learned_before:
        return FROM_EARLIER_DRIVE
    return MEDIAN_TO_LEARN if source == SLOW_ASSUMED else source


@inlined
def _set_learner(order, parts):
    """Make the parts of a controller that learns its car."""
    belief, learner, sensing, world = parts.belief, parts.learner, parts.filter, order.world
    _widen_unknown_delay(parts)
    begin_learner(
        order.method, order.start, order.car, order.within, belief, parts.unsure, order.unsure_given, sensing,
        world.period, learner,
    )  # fmt: skip
    lag, dead_time = learner.first.used_lag, learner.first.used_dead_time
    if order.filter_given == 0:
        sensing.spread[0], sensing.spread[1] = UNEXPLAINED
    wheel_drift = order.method.wheel_drift_rate * learner.first.belief_delay_sigma / order.method.sigma_inflation
    sensing.drifts.wheel_angle = hypot(DEFAULT_DRIFTS.wheel_angle, wheel_drift)
    sensing.longest = learner.longest
    tune_informed(world, 1.0, order.longest_horizon, order.most_moves, parts.tuning)
    learned_before = not math.isnan(order.start.lag)
    steering, source = belief.steering, belief.source
    source.lag = _source_at_start(source.lag, learned_before)
    source.dead_time = _source_at_start(source.dead_time, learned_before)
    bound_commands(belief, world.period, parts.bounds)
    steering.lag, steering.dead_time = lag, dead_time
    parts.lag, parts.dead_time = lag, dead_time + belief.computation


@inlined
def _positive(x):
    return 0.0 < x < math.inf


@inlined
def _finite(x):
    """Whether a number is finite and not negative."""
    return 0.0 <= x < math.inf


@inlined
def is_a_car(car):
    """Whether mass, inertia, axles and stiffness are those of a car."""
    shape = _positive(car.mass) and _positive(car.yaw_inertia) and _positive(car.lf) and _positive(car.lr)
    return shape and _positive(car.stiffness_front) and _positive(car.stiffness_rear)


@inlined
def _within_if_known(x, least, most):
    """Whether a number is unknown (NaN) or lies within a range."""
    return math.isnan(x) or least <= x <= most


@inlined
def _is_steering(steering):
    """Whether a steering is possible; rate and limit must be positive."""
    delays = _within_if_known(steering.lag, 0.0, MOST_TIME) and _within_if_known(steering.dead_time, 0.0, MOST_TIME)
    moves = _within_if_known(steering.rate, MIN_POSITIVE, math.inf) and _within_if_known(
        steering.limit, MIN_POSITIVE, 0.5 * math.pi
    )
    return delays and moves


@inlined
def _order_status(order):
    """`OK`, or the part of an order that makes no controller."""
    car, world, unsure, method = order.car, order.world, order.unsure, order.method
    windy = _finite(car.frontal_area) and _finite(car.side_force_slope) and abs(car.yaw_moment_slope) < math.inf
    if not (is_a_car(car) and windy):
        return CAR_WRONG
    times = _positive(world.period) and 0.0 <= world.computation <= MOST_TIME and 0.0 <= world.oldest <= MOST_TIME
    sensed = world.noise_vy >= 0.0 and world.noise_yaw >= 0.0 and world.noise_yaw_rate >= 0.0 and _finite(world.noise_y)
    sensed = sensed and world.noise_wheel_angle >= 0.0 and world.noise_lateral_acceleration >= 0.0
    off = _finite(world.bias_yaw_rate) and _finite(world.bias_wheel_angle)
    if not (times and sensed and off and _finite(world.move_weight)):
        return LOOP_WRONG
    if not (_is_steering(order.caller) and _is_steering(order.file) and _is_steering(order.actuator)):
        return STEERING_WRONG
    if order.unsure_given > 0 and not (
        0.0 <= unsure.lag <= MAX_DELAY and 0.0 <= unsure.dead_time <= MAX_DELAY
        and 1.0 <= unsure.stiffness <= MAX_STIFFNESS and 0.0 <= unsure.mass <= MAX_MASS
    ):  # fmt: skip
        return UNCERTAINTY_WRONG
    if not (1.0 <= method.lags <= MAX_HYPOTHESES and 1.0 <= method.dead_times <= MAX_HYPOTHESES):
        return METHOD_WRONG
    return OK


@exported(int64(Row(Order), Row(InformedParts)))
def informed_parts(order, parts):
    """Write what an informed MPC is made of; parts.filter is that of `filter.usual_filter`, or the caller's.

    Answers `OK`, or what of the order is wrong: then nothing is written.
    """
    status = _order_status(order)
    if status != OK:
        return status
    _copy_uncertainty(order.unsure, parts.unsure)
    believe_steering(order.caller, order.file, order.actuator, order.world.computation, parts.belief)
    if order.filter_given == 0:
        sensor_noise(order.world, parts.filter.noise)
        parts.filter.oldest = order.world.oldest
    source = parts.belief.source
    unknown = source.lag == SLOW_ASSUMED or source.dead_time == SLOW_ASSUMED
    parts.learns = 1 if order.learning == ALWAYS or (order.learning == UNLESS_SAID and unknown) else 0
    if parts.learns > 0:
        _set_learner(order, parts)
    else:
        _set_fixed_belief(order, parts)
    return OK


@exported(several(int64, int64, int64)(Row(Order), Row(InformedParts)))
def informed_sizes(order, parts):
    """States of the model, numbers that the filter remembers, and those that the learner remembers."""
    longest, late_periods = filter_periods(parts.filter, order.world.period, parts.dead_time)
    learned = learner_size(parts.learner) if parts.learns > 0 else 0
    return path.PATH_STATES if parts.lag > 0.0 else path.PATH_STATES - 1, filter_size(longest, late_periods), learned


@inlined
def _write_settings(order, parts, s):
    """Write the settings that follow from the loop: period, preview, delay and limits."""
    bounds, world = parts.bounds, order.world
    s.period, s.preview, s.delay = world.period, world.preview, parts.dead_time / world.period
    s.move_min, s.move_max, s.ahead = -bounds.move, bounds.move, bounds.ahead
    s.angle_min, s.angle_max, s.error_max = -bounds.angle, bounds.angle, LARGEST_CORRECTION
    s.informed, s.learns = 1, parts.learns


@inlined
def _write_states(lag, states):
    """Places of the states among what is measured."""
    states[0], states[1], states[2] = MEASUREMENT.vy, MEASUREMENT.yaw, MEASUREMENT.yaw_rate
    if lag > 0.0:
        states[3] = MEASUREMENT.wheel_angle
    states[states.size - 1] = MEASUREMENT.y


@exported(int64(Row(Order), Row(InformedParts), Place(Constants)))
def informed_constants(order, parts, constants):
    """Write the numbers of an informed MPC of these parts; `OK`, or `MEMORY_TOO_SMALL`: then nothing is written."""
    states, _, learned = informed_sizes(order, parts)
    small = constants.tuning.size < 4 or constants.states.size != states or constants.estimator.size < _FILTER
    small = small or constants.model.size < _MODEL or constants.turning.size < _TURNING or constants.settings.size < 1
    if parts.learns > 0:
        small = small or constants.learner.size < _LEARNER or constants.fresh.size < learned
    if small:
        return MEMORY_TOO_SMALL
    period, lag, dead_time, filtering = order.world.period, parts.lag, parts.dead_time, parts.filter
    _write_settings(order, parts, constants.settings[0])
    _write_states(lag, constants.states)
    for i in range(4):
        constants.tuning[i] = parts.tuning[i]
    if parts.learns > 0:
        filter_numbers(filtering, parts.learner.car, period, lag, dead_time, constants.estimator)
        learner_numbers(parts.learner, filtering, constants.learner)
        learner_memory(parts.learner, filtering, constants.fresh)
    else:
        filter_numbers(filtering, order.car, period, lag, dead_time, constants.estimator)
    _copy_model(kalman.parameters_of(constants.estimator, 0).model, path.parameters_of(constants.model, 0))
    path.write_turning(constants.model, constants.turning)
    t = turning_of(constants.turning, 0)
    t.friction, t.shape_factor = filtering.friction, filtering.shape_factor
    return OK
