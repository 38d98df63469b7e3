"""All numbers of an MPC: of one that knows, or learns, its car, and of the paper's."""

from __future__ import annotations

import math

from ..controllers.mpc import PAPER_TUNING, MPCSettings, MPCTuning
from ..estimators import kalman
from ..estimators.learning_method import MAX_HYPOTHESES, LearningMethod
from ..kernel import OK, Row, bounds_checker, copier, exported, float64, inlined, int64, record
from ..maths.exponential import hypot
from ..models import path
from ..models.car import ACTUATOR, SINGLE_TRACK, WIND, CarRow, LearnedRow, SingleTrackCar, SteeringRow
from ..models.contract import MEASURED_MOTION, MEASUREMENT
from . import belief
from . import filter as sensing
from .car import KnownWithinRow, relaxation_delay
from .learner import UNKNOWN_CAR_ROW, LearnerRow, begin_learner, learner_size
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
        ("unsure", belief.UncertaintyRow), "unsure_given",  # 1: the caller says it
        "learning",  # `NEVER`, ...
        "filter_given",  # 1: the filter is the caller's, 0: it is made of `world`
        "longest_horizon", "most_moves",  # Np and Nc at most
        ("method", LearningMethod), ("start", LearnedRow),
    ),
    integers=("unsure_given", "learning", "filter_given", "longest_horizon", "most_moves"),
)  # fmt: skip
"""What is known of a car and its loop, and what is wanted."""
MPCNumbers = record(
    "MPCNumbers",
    (
        ("belief", belief.BeliefRow),
        ("unsure", belief.UncertaintyRow),
        ("bounds", belief.CommandBounds),
        ("filter", sensing.Filter),
        ("learner", LearnerRow),  # not written where nothing is learned
        "lag", "dead_time",  # s, of the prediction model; the dead time with the computation
        ("settings", MPCSettings),  # those of the loop are written, of horizons and solver they stay
        ("tuning", (float64, len(MPCTuning._fields))),
        ("model", path.Parameters),
        ("states", (float64, path.PATH_STATES)),  # places of the states among what is measured
        ("turning", path.Turning),
        ("estimator", kalman.FilterParameters),
        "state_count", "remembered", "learned",  # states; numbers that filter and learner remember
    ),
    integers=("state_count", "remembered", "learned"),
)  # fmt: skip
"""The numbers of an MPC, and what they follow from. The paper's has settings, tuning, model and states alone."""

_copy_uncertainty, _copy_model = copier(belief.UncertaintyRow), copier(path.Parameters)
_copy_single_track = copier(SingleTrackCar)
_PAPER_TUNING = tuple(map(float, PAPER_TUNING))
_is_car, _is_windy_car = bounds_checker(SINGLE_TRACK), bounds_checker(WIND)
_is_steering, _is_uncertainty = bounds_checker(ACTUATOR[:-1], optional=True), bounds_checker(belief.UNCERTAINTY)
_are_sensors = bounds_checker(MEASURED_MOTION)
MOST_TIME = 10.0
"""s, of a computation or an age."""
CAR_WRONG, LOOP_WRONG, STEERING_WRONG, UNCERTAINTY_WRONG, METHOD_WRONG = range(1, 6)
ORDER_FAULTS = {
    CAR_WRONG: "a number of the car is not positive and finite: correct its file.",
    LOOP_WRONG: "a number of the profile is negative or not finite: correct its file.",
    STEERING_WRONG: "a number of the steering is impossible: correct belief, car file or profile.",
    UNCERTAINTY_WRONG: "the uncertainty is beyond its bounds: give a smaller one.",
    METHOD_WRONG: f"need 1 to {MAX_HYPOTHESES} hypotheses of lag and of dead time.",
}
"""Sentences for the statuses of `informed_numbers` and `published_numbers`."""
UNEXPLAINED = (1.0, 0.6)
"""m/s^2, rad/s^2: what wheels that nobody has aligned push and turn a car before their bias is learned. With the
filter's own spread, .3 and .3, the first minute of 40 unknown cars costs 1.28 instead of 1.26 in `road`."""
LARGEST_CORRECTION = 0.25
"""m, lateral error that is corrected at once: a larger one would ask the tyres for more than they have."""


@inlined
def _set_fixed_belief(order, mpc):
    """Make the parts of a controller that does not learn: it assumes a high quantile of the delay.

    Where the lateral velocity is not measured the model's dead time includes `relaxation_delay`: without it the loop of
    a heavy car is unstable at speed. With that sensor the loop is stable without it.
    """
    unsure, world, steering = mpc.unsure, order.world, mpc.belief.steering
    if order.unsure_given == 0:
        belief.uncertainty_of_car(order.within, mpc.belief, unsure)
    steering.lag += belief.delay_margin(unsure.lag)
    steering.dead_time += belief.delay_margin(unsure.dead_time)
    tune_informed(world, belief.caution_of(unsure), order.longest_horizon, order.most_moves, mpc.tuning)
    if belief.is_cautious(mpc.belief):
        mpc.tuning[3] *= ASSUMED_DELAY_CAUTION
    if order.filter_given == 0:
        belief.widen_drifts(unsure, 1 if world.noise_vy < math.inf else 0, mpc.filter.drifts)
    belief.bound_commands(mpc.belief, world.period, mpc.bounds)
    mpc.lag, mpc.dead_time = steering.lag, mpc.belief.computation + steering.dead_time
    if world.noise_vy == math.inf:
        mpc.dead_time += relaxation_delay(order.car)


@inlined
def _widen_unknown_delay(mpc):
    """Widen the uncertainty of an unknown lag or dead time that is declared certain."""
    source, unsure = mpc.belief.source, mpc.unsure
    if source.lag == belief.SLOW_ASSUMED and unsure.lag == 0.0:
        unsure.lag = UNKNOWN_CAR_ROW.lag
    if source.dead_time == belief.SLOW_ASSUMED and unsure.dead_time == 0.0:
        unsure.dead_time = UNKNOWN_CAR_ROW.dead_time


@inlined
def _source_at_start(source, learned_before):
    """The source of a delay with which a controller that learns begins."""
    if learned_before:
        return belief.FROM_EARLIER_DRIVE
    return belief.MEDIAN_TO_LEARN if source == belief.SLOW_ASSUMED else source


@inlined
def _set_learner(order, mpc):
    """Make the parts of a controller that learns its car."""
    learner, filtering, world = mpc.learner, mpc.filter, order.world
    _widen_unknown_delay(mpc)
    begin_learner(order, mpc)
    lag, dead_time = learner.first.used_lag, learner.first.used_dead_time
    if order.filter_given == 0:
        filtering.spread[0], filtering.spread[1] = UNEXPLAINED
    wheel_drift = order.method.wheel_drift_rate * learner.first.belief_delay_sigma / order.method.sigma_inflation
    filtering.drifts.wheel_angle = hypot(sensing.DEFAULT_DRIFTS.wheel_angle, wheel_drift)
    filtering.longest = learner.longest
    tune_informed(world, 1.0, order.longest_horizon, order.most_moves, mpc.tuning)
    learned_before = not math.isnan(order.start.lag)
    steering, source = mpc.belief.steering, mpc.belief.source
    source.lag = _source_at_start(source.lag, learned_before)
    source.dead_time = _source_at_start(source.dead_time, learned_before)
    belief.bound_commands(mpc.belief, world.period, mpc.bounds)
    steering.lag, steering.dead_time = lag, dead_time
    mpc.lag, mpc.dead_time = lag, dead_time + mpc.belief.computation


@inlined
def _order_status(order):
    """`OK`, or the part of an order that makes no controller."""
    world, method = order.world, order.method
    if not (_is_car(order.car) and _is_windy_car(order.car)):
        return CAR_WRONG
    times = 0.0 < world.period < math.inf and 0.0 <= world.computation <= MOST_TIME and 0.0 <= world.oldest <= MOST_TIME
    if not (times and _are_sensors(world) and 0.0 <= world.move_weight < math.inf):
        return LOOP_WRONG
    if not (_is_steering(order.caller) and _is_steering(order.file) and _is_steering(order.actuator)):
        return STEERING_WRONG
    if order.unsure_given > 0 and not _is_uncertainty(order.unsure):
        return UNCERTAINTY_WRONG
    if not (1.0 <= method.lags <= MAX_HYPOTHESES and 1.0 <= method.dead_times <= MAX_HYPOTHESES):
        return METHOD_WRONG
    return OK


@exported(int64(Row(Order), Row(MPCNumbers)))
def informed_numbers(order, mpc):
    """Write all numbers of an informed MPC; mpc.filter is the caller's where `Order.filter_given`.

    Answers `OK`, or what of the order is wrong: then nothing is written. `learner_memory` of mpc.learner and mpc.filter
    writes the mpc.learned numbers that are remembered before the first sample.
    """
    status = _order_status(order)
    if status != OK:
        return status
    _copy_uncertainty(order.unsure, mpc.unsure)
    belief.believe_steering(order.caller, order.file, order.actuator, order.world.computation, mpc.belief)
    if order.filter_given == 0:
        sensing.set_filter_defaults(mpc.filter)
        sensing.sensor_noise(order.world, mpc.filter.noise)
        mpc.filter.oldest = order.world.oldest
    is_unknown = belief.is_cautious(mpc.belief)
    if order.learning == ALWAYS or (order.learning == UNLESS_SAID and is_unknown):
        _set_learner(order, mpc)
        _write_numbers(order, mpc.learner.car, mpc)
        mpc.settings.learns, mpc.learned = 1, learner_size(mpc.learner)
    else:
        _set_fixed_belief(order, mpc)
        _write_numbers(order, order.car, mpc)
        mpc.settings.learns, mpc.learned = 0, 0
    return OK


@inlined
def _write_numbers(order, car, mpc):
    """Write what follows from the parts of an MPC, the learner excepted; car: as its model knows it."""
    world, bounds, s = order.world, mpc.bounds, mpc.settings
    s.period, s.preview, s.delay, s.informed = world.period, world.preview, mpc.dead_time / world.period, 1
    s.move_min, s.move_max, s.ahead = -bounds.move, bounds.move, bounds.ahead
    s.angle_min, s.angle_max, s.error_max = -bounds.angle, bounds.angle, LARGEST_CORRECTION
    _write_states(mpc.lag > 0.0, mpc)
    sensing.filter_numbers(mpc.filter, car, world.period, mpc.lag, mpc.dead_time, mpc.estimator)
    longest, late_periods = sensing.filter_periods(mpc.filter, world.period, mpc.dead_time)
    mpc.remembered = sensing.filter_size(longest, late_periods)
    _copy_model(mpc.estimator.model, mpc.model)
    path.turn_in(mpc.model, mpc.turning)
    mpc.turning.friction, mpc.turning.shape_factor = mpc.filter.friction, mpc.filter.shape_factor


@inlined
def _write_states(has_lag, mpc):
    """Write the places of the states among what is measured; only behind a lag is the wheel angle one of them."""
    states = mpc.states
    states[0], states[1], states[2] = MEASUREMENT.vy, MEASUREMENT.yaw, MEASUREMENT.yaw_rate
    if has_lag:
        states[3] = MEASUREMENT.wheel_angle
    mpc.state_count = path.PATH_STATES if has_lag else path.PATH_STATES - 1
    states[mpc.state_count - 1] = MEASUREMENT.y


@exported(int64(Row(CarRow), float64, Row(MPCNumbers)))
def published_numbers(car, period, mpc):
    """Write tuning and limits of the paper's table, and its model of a car; period: s.

    `OK`, or what is wrong: then nothing is written.
    """
    if not _is_car(car):
        return CAR_WRONG
    if not 0.0 < period < math.inf:
        return LOOP_WRONG
    s = mpc.settings
    s.period, s.delay, s.ahead, s.error_max = period, 0.0, 0.0, math.inf
    s.move_min, s.move_max, s.angle_min, s.angle_max = -belief.MOVE, belief.MOVE, -belief.ANGLE, belief.ANGLE
    s.informed, s.learns, mpc.learned, mpc.remembered = 0, 0, 0, 0
    for i in range(len(_PAPER_TUNING)):
        mpc.tuning[i] = _PAPER_TUNING[i]
    _copy_single_track(car, mpc.model)
    _write_states(False, mpc)
    return OK
