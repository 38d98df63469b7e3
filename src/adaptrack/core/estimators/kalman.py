"""A Kalman filter on the path model: its state, two disturbances and the yaw-rate sensor's offset, behind a dead time.

    z = [x, d_y, d_r, b],   x(k+1) = A x(k) + B u(k) + G d(k) + noise,   d and b: random walks

x = [v_y, psi, r, delta, y], see `models.path`; without lag delta is the command itself. The filter is that of
`extended_kalman`; here stand its model and its sensors.

The command of instant j acts from T_d = (m + s) T after it (m whole periods, a share s of one more). Between two
instants the filter carries z along with the commands that acted; what it hands to the controller is x at the time when
the new command begins to act, carried on through the commands already sent.

Each sensor is taken in by itself, as value = h z + noise, so one that is missing (not finite) is left out. A sample of
a known age belongs to a control instant: the filter keeps z of `late` periods ago and goes through the instants since
then anew at every step, with all that has arrived of them. A pose belongs to the nearest instant. What was taken a
little before or after it is compared with z carried there, psi - tau r and y - tau (v_y + v psi) + tau^2/2 v r. A
motion sample belongs to the instant after it: it is compared with h z there, less the share tau/T of the predicted
change of h z in that period. A lateral acceleration counts the less the later it is: its standard deviation is
multiplied by 1 plus the whole periods of its age. A sample that repeats the one before to the last bit, from a sensor
that has noise, is an old one and left out; not so a heading or position against a path that has turned since: the car
has turned with it.

A sensor that is stuck behind its own noise disagrees: the mean of its squared innovations over their variance, 1 for a
filter that is right, grows. Beyond `distrust` the sensor that disagrees the most is left out until it agrees again, one
at a time; the pose never, for nothing else says where the car is.

What a tyre slides away is not in the model: v_y and r drift by it, and an accelerometer disagrees. So the harder the
driving, the less of what the model cannot explain is called a push; and a push is no larger than what the tyres can
still answer, `grip` less what they pull in the model.

The offsets of an accelerometer (the pull of a banked road is one to it) and of the wheel-angle sensor are slow averages
of their innovations. Without a position for longer than `patience`, or with one that stays the same and disagrees with
the estimate by more than `bound` times its noise, the estimate is not finite: the controller holds.
"""

from __future__ import annotations

import math

from ..kernel import (
    Field,
    columns,
    exported,
    float64,
    inlined,
    int64,
    local,
    record,
    shaped,
    size_of,
    vector,
    viewer,
    void,
)
from ..maths.bits import whole
from ..maths.exact import floor, sqrt, square
from ..maths.vectors import VECTOR_WIDTH, add, load, mul, splat, store, sub, total, zeros
from ..models import path
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from . import extended_kalman
from .extended_kalman import ESTIMATE

FILTER_STATE = columns(*path.PATH_STATE._fields, "offset")
"""Places in z, whether the model has a lag or not."""
FILTER_STATES = len(FILTER_STATE)
SENSOR_COUNT = 6
"""The first of `MEASUREMENT`; their ages follow."""
FILTER_SAMPLE = columns(*MEASUREMENT._fields[:SENSOR_COUNT], "earlier", "turned")
"""Samples that belong to an instant; s, by which the pose was taken before it; rad, by which the path has turned in the
period before it."""
READS = (FILTER_STATE.vy, FILTER_STATE.yaw, FILTER_STATE.yaw_rate, FILTER_STATE.y, FILTER_STATE.wheel_angle)
"""Which state a sensor reads, each but the accelerometer."""
UNKNOWN_VARIANCE = 1e2
"""Variance of a state of which the first sample says nothing."""
MAX_OUTLIER_DISTANCE, MAX_OUTLIER_TURN, RESTART_OUTLIERS = 100.0, 10.0, 10
"""m, rad, by which a position or a heading is no outlier but the estimate wrong, when so many follow each other."""
LEAST_NOISE = (0.005, 0.0002, 0.001, 0.002, 0.0005, 0.02)
"""Of the sensors: with better ones the model's own errors limit the filter."""

FilterParameters = record(
    "FilterParameters",
    [
        PERIOD_FIELD,
        Field("periods", "", 0.0, "dead time in whole periods m, and", "[0, longest]"),
        Field("share", "", 0.0, "the share s of one more", "[0, 1)"),
        Field("longest", "", 0, "whole periods of the longest dead time that there may be: so many commands are kept"),
        Field("late", "", 0, "periods that are gone through anew at every step"),
        "bias",  # rad, by which the wheels turn beyond the command
        "bound",  # standard deviations up to which an innovation counts
        "patience",  # periods without a position after which there is no estimate
        "distrust", "trust",  # mean of squared innovations over their variance: left out beyond, taken back below
        "forgetting", "regaining",  # shares by which that mean moves with a sample, taken in or left out
        "settling",  # share of an innovation by which a sensor's offset moves
        ("variance", (float64, SENSOR_COUNT)),  # of the sensors' noise; inf: no such sensor
        ("drift", (float64, FILTER_STATES)),  # variances that a period adds
        "drift_both",  # likewise, the covariance of d_y and d_r
        "sliding",  # s, squared, of what the tyres' sliding makes uncertain of each axle's force, over F^2/F_z
        "sliding_time",  # s, how long the model gets a force wrong at a time, as far as an accelerometer is concerned
        "grip", "least_spare",  # m/s^2, what tyres can pull at most, and what a disturbance may always be
        "friction", "shape_factor",  # of the tyres, by which they pull less in a bend than linear ones
        "spread_side", "spread_turn", "spread_offset",  # variances of d_y, d_r and b before the first sample
        ("model", path.Parameters),
    ],
)  # fmt: skip
"""The parameters; a state that the model or the sensors do not have neither drifts nor spreads."""
parameters_of = viewer(FilterParameters)

Memory = record(
    "Memory",
    [
        "steps",
        "speed",  # m/s, of the matrices
        "blind",  # periods since a position was taken in
        "outliers",  # positions in a row that are `MAX_OUTLIER_DISTANCE` from the estimate
        "excluded",  # 1 + the sensor that is left out, 0: none
        "saturation",  # m/s^2, what the tyres pull less than linear ones in the bend at hand
        "spare",  # m/s^2, what the tyres can still answer
        "felt_error",  # variance of the predicted lateral acceleration, by forces that the model gets wrong
        ("felt", (float64, FILTER_STATES)),  # h of the accelerometer
        ("F", (float64, path.PATH_STATES, FILTER_STATES)),  # z(k+1) = F z(k) + b u(k), of the states of the model
        ("b", (float64, FILTER_STATES)),
        ("b_older", (float64, FILTER_STATES)),  # of the command that acts first in a period
        ("b_newer", (float64, FILTER_STATES)),  # of the one that acts then
        ("F_share", (float64, path.PATH_STATES, FILTER_STATES)),  # over the share s of a period
        ("b_share", (float64, FILTER_STATES)),
        ("z", (float64, FILTER_STATES)),
        ("P", (float64, FILTER_STATES, FILTER_STATES)),  # covariance of z
        ("past_z", (float64, FILTER_STATES)),  # z and P of `late` periods before the last instant
        ("past_P", (float64, FILTER_STATES, FILTER_STATES)),
        ("last", (float64, SENSOR_COUNT)),  # samples of the step before, to tell repeated ones
        ("offset", (float64, SENSOR_COUNT)),  # of the sensors
        ("disagreement", (float64, SENSOR_COUNT)),  # mean of their squared innovations over their variance
    ],
)
"""Head of the memory; rows of `FILTER_SAMPLE` follow, then by how much the motion was sampled before each instant (s),
then the commands that were sent, each the latest first."""
memory_of = viewer(Memory)
_AFTER = size_of(Memory)
_state, _rows = local(FILTER_STATES), local(path.PATH_STATES, FILTER_STATES)


def memory_size(longest: int, late: int) -> int:
    """Numbers that the filter remembers, for a dead time of at most `longest` periods and a share."""
    return _AFTER + (VECTOR_WIDTH + 1) * (late + 1) + longest + late + 2


@exported(void(vector, int64, float64, float64))
def move_path(memory, late, heading, offset):
    """Let heading (rad) and offset (m) of all that is remembered grow by so much: another path lies under the car."""
    m = memory_of(memory, 0)
    for z in (m.z, m.past_z):
        z[FILTER_STATE.yaw] += heading
        z[FILTER_STATE.y] += offset
    m.last[MEASUREMENT.yaw] += heading
    m.last[MEASUREMENT.y] += offset
    for k in range(late + 1):
        row = _AFTER + VECTOR_WIDTH * k
        memory[row + MEASUREMENT.yaw] += heading
        memory[row + MEASUREMENT.y] += offset


@inlined
def forget_speed(memory):
    """Let everything that depends on the speed, and on what the model believes, be formed anew."""
    memory_of(memory, 0).speed = math.nan


@inlined
def shift_bias(change, side, turn, memory):
    """Explain so much (rad) of the disturbances by a bias: per rad it pushes by `side` (m/s^2) and `turn` (rad/s^2)."""
    m = memory_of(memory, 0)
    for z in (m.z, m.past_z):
        z[FILTER_STATE.wheel_angle] += change
        z[FILTER_STATE.side] -= side * change
        z[FILTER_STATE.turn] -= turn * change


@inlined
def _move(f, z):
    """z = F z: the states follow the rows of F, the disturbances stay."""
    before = load(z, 0)
    for i in range(path.PATH_STATES):
        z[i] = total(mul(load(f, i, 0), before))


@inlined
def _form(speed, p, m):
    """Write everything that depends on the speed alone."""
    path.discretise_disturbed(speed, p.period, p.model, m.F, m.b)
    if p.share > 0.0:
        f = _rows()
        path.discretise_disturbed(speed, p.share * p.period, p.model, m.F_share, m.b_share)
        path.discretise_disturbed(speed, (1.0 - p.share) * p.period, p.model, f, m.b_newer)
        store(m.b_older, 0, load(m.b_share, 0))
        _move(f, m.b_older)
    else:
        store(m.b_older, 0, zeros())
        store(m.b_newer, 0, load(m.b, 0))
    path.lateral_acceleration_row(speed, p.model, m.felt)
    m.speed = speed


@inlined
def _steer(b, angle, z):
    """z += b u."""
    store(z, 0, add(load(z, 0), mul(load(b, 0), splat(angle))))


@inlined
def _copy(z, covariance, to_z, to_covariance):
    """Keep z and its covariance elsewhere."""
    store(to_z, 0, load(z, 0))
    for i in range(FILTER_STATES):
        store(to_covariance, i, 0, load(covariance, i, 0))


@inlined
def _begin(measured, command, p, m, samples, advances, commands):
    """z and its covariance from the first sample."""
    store(m.z, 0, zeros())
    for i in range(FILTER_STATES):
        store(m.P, i, 0, zeros())
    for i in range(path.PATH_STATES):
        m.P[i, i] = UNKNOWN_VARIANCE
    for sensor in range(SENSOR_COUNT):
        value, variance = measured[sensor], p.variance[sensor]
        m.last[sensor] = value
        if sensor < len(READS) and variance < math.inf and math.isfinite(value):
            m.z[READS[sensor]], m.P[READS[sensor], READS[sensor]] = value, variance
    m.z[FILTER_STATE.wheel_angle] = command
    m.P[FILTER_STATE.wheel_angle, FILTER_STATE.wheel_angle] = p.drift[FILTER_STATE.wheel_angle]
    m.P[FILTER_STATE.side, FILTER_STATE.side], m.P[FILTER_STATE.turn, FILTER_STATE.turn] = p.spread_side, p.spread_turn
    m.P[FILTER_STATE.offset, FILTER_STATE.offset] = p.spread_offset
    m.P[FILTER_STATE.yaw_rate, FILTER_STATE.yaw_rate] += p.spread_offset
    for i in range(whole(p.longest) + whole(p.late) + 2):
        commands[i] = command
    for i in range(whole(p.late) + 1):
        store(samples, i, 0, splat(math.nan))
        samples[i, FILTER_SAMPLE.turned], advances[i] = 0.0, 0.0
    _copy(m.z, m.P, m.past_z, m.past_P)


@inlined
def _is_of_pose(sensor):
    return sensor == MEASUREMENT.yaw or sensor == MEASUREMENT.y


@inlined
def is_repeated(sensor, last, variance, measured):
    """Whether a sample of a sensor is the one before, by its value."""
    moved = _is_of_pose(sensor) and measured[MEASUREMENT.turned] != 0.0
    return measured[sensor] == last and variance > square(LEAST_NOISE[sensor]) and not moved


@inlined
def _age_of(sensor, measured):
    """Age (s) of a sensor's sample."""
    age = measured[MEASUREMENT.pose_age] if _is_of_pose(sensor) else measured[MEASUREMENT.motion_age]
    return age if math.isfinite(age) else 0.0


@inlined
def _motion_instant(measured, p):
    """The first instant after the motion samples, in periods before the present one."""
    return max(floor(_age_of(MEASUREMENT.yaw_rate, measured) / p.period + 1e-9), 0.0)


@inlined
def _sort_in(measured, p, m, samples, advances):
    """Add the samples that have arrived to the instants at which they were taken."""
    for i in range(whole(p.late), 0, -1):
        store(samples, i, 0, load(samples, i - 1, 0))
        advances[i] = advances[i - 1]
    store(samples, 0, 0, splat(math.nan))
    advances[0] = 0.0
    samples[0, FILTER_SAMPLE.turned] = measured[MEASUREMENT.turned]
    m.blind += 1.0
    for sensor in range(SENSOR_COUNT):
        value, variance = measured[sensor], p.variance[sensor]
        repeated = is_repeated(sensor, m.last[sensor], variance, measured)
        m.last[sensor] = value
        age = _age_of(sensor, measured)
        instants = floor(age / p.period + 0.5) if _is_of_pose(sensor) else _motion_instant(measured, p)
        if not (math.isfinite(value) and variance < math.inf and 0.0 <= instants <= p.late):
            continue
        if sensor == MEASUREMENT.y and (not repeated or abs(value - m.z[FILTER_STATE.y]) <= p.bound * sqrt(variance)):
            m.blind = 0.0
        if repeated:
            continue
        samples[whole(instants), sensor] = value
        if _is_of_pose(sensor):
            samples[whole(instants), FILTER_SAMPLE.earlier] = age - instants * p.period
        else:
            advances[whole(instants)] = age - instants * p.period


@inlined
def _predict(turned, older, newer, p, m):
    """z = F z + b u and P = F P F' + Q over a period in which the path turns evenly, by so much (rad).

    older, newer: the commands (rad) that act in it one after the other.
    """
    side = m.z[FILTER_STATE.side]
    m.saturation = path.saturation(m.speed * turned / p.period, p.friction, p.shape_factor) if turned != 0.0 else 0.0
    m.z[FILTER_STATE.side] += m.saturation
    _move(m.F, m.z)
    m.z[FILTER_STATE.side] = side
    _steer(m.b_older, older + p.bias, m.z)
    _steer(m.b_newer, newer + p.bias, m.z)
    if turned != 0.0:  # heading and offset count from the path
        m.z[FILTER_STATE.yaw] -= turned
        m.z[FILTER_STATE.y] -= 0.5 * m.speed * p.period * turned
    ones, scratch = _state(), _rows()
    store(ones, 0, splat(1.0))
    extended_kalman.carry(m.F, ones, m.P, scratch)
    _add_drifts(p, m)


@inlined
def _add_drifts(p, m):
    """P += Q; what the tyres can still answer, and how well an accelerometer is predicted."""
    for i in range(FILTER_STATES):
        m.P[i, i] += p.drift[i]
    m.P[FILTER_STATE.side, FILTER_STATE.turn] += p.drift_both
    m.P[FILTER_STATE.turn, FILTER_STATE.side] += p.drift_both
    pull, of_vy, of_r, of_both = path.sliding(
        m.speed, m.z[FILTER_STATE.vy], m.z[FILTER_STATE.yaw_rate], m.z[FILTER_STATE.wheel_angle], p.model
    )
    share = p.sliding * p.period
    m.P[FILTER_STATE.vy, FILTER_STATE.vy] += share * of_vy
    m.P[FILTER_STATE.yaw_rate, FILTER_STATE.yaw_rate] += share * of_r
    m.P[FILTER_STATE.vy, FILTER_STATE.yaw_rate] += share * of_both
    m.P[FILTER_STATE.yaw_rate, FILTER_STATE.vy] += share * of_both
    m.spare = max(p.least_spare, p.grip - pull)
    m.felt_error = p.sliding / (2.0 * p.sliding_time) * of_vy


@inlined
def _read(sensor, tau, turned, p, m, h):
    """Write h of a sensor, for what was taken tau (s) before its instant; what it reads beside h z and its offset."""
    if sensor == MEASUREMENT.lateral_acceleration:
        store(h, 0, load(m.felt, 0))
        return m.saturation
    h[READS[sensor]] = 1.0
    turning = turned / p.period
    if sensor == MEASUREMENT.yaw:
        h[FILTER_STATE.yaw_rate] = -tau
        return tau * turning
    if sensor == MEASUREMENT.y:
        h[FILTER_STATE.vy], h[FILTER_STATE.yaw] = -tau, -tau * m.speed
        h[FILTER_STATE.yaw_rate] = 0.5 * tau * tau * m.speed
        return -0.5 * tau * tau * m.speed * turning
    if sensor == MEASUREMENT.yaw_rate:
        h[FILTER_STATE.offset] = 1.0
    return 0.0


@inlined
def _correct(instant, arrival, advance, change, p, m, samples):
    """Take in the samples of an instant, so many before the present one.

    arrival: the instant of the motion samples that are new; advance: s, by which the motion was sampled before this
    instant; change: of z in the period before.
    """
    for sensor in range(SENSOR_COUNT):
        if not math.isfinite(samples[instant, sensor]):
            continue
        h, cross = _state(), _state()
        earlier, turned = samples[instant, FILTER_SAMPLE.earlier], samples[instant, FILTER_SAMPLE.turned]
        constant = _read(sensor, earlier, turned, p, m, h)
        expected = total(mul(load(h, 0), load(m.z, 0))) + constant + m.offset[sensor]
        if advance != 0.0 and not _is_of_pose(sensor):
            expected -= advance / p.period * total(mul(load(h, 0), load(change, 0)))
        innovation = samples[instant, sensor] - expected
        noise = p.variance[sensor]
        if sensor == MEASUREMENT.lateral_acceleration:
            noise = noise * square(1.0 + arrival) + m.felt_error  # a force that was unexpected has changed since
        variance = extended_kalman.scatter(noise, h, m.P, cross)
        is_left_out = m.excluded == sensor + 1
        if instant == p.late:  # every sample once
            disagreement = min(square(innovation) / variance, 2.0 * p.bound * p.bound)
            share = p.regaining if is_left_out else p.forgetting
            m.disagreement[sensor] += share * (disagreement - m.disagreement[sensor])
        if is_left_out:
            continue
        innovation = extended_kalman.bounded(innovation, variance, p.bound)
        extended_kalman.correct(innovation, variance, cross, m.z, m.P)
        if instant == arrival and (sensor == MEASUREMENT.lateral_acceleration or sensor == MEASUREMENT.wheel_angle):
            m.offset[sensor] += p.settling * innovation


@inlined
def _choose_left_out(p, m):
    """Leave out the redundant sensor that disagrees the most, beyond the bound; take it back once it agrees.

    Where the model is wrong the gyro disagrees at least as much as the others, and the heading does not; where the gyro
    is, the heading disagrees with it. A sensor without noise of its own is never left out: it is the model that errs.
    """
    worst, most, out = -1, p.distrust, whole(m.excluded) - 1
    for sensor in range(SENSOR_COUNT):
        disagreement = m.disagreement[sensor]
        if sensor == MEASUREMENT.yaw_rate:
            disagreement = m.disagreement[MEASUREMENT.yaw]
        elif disagreement < m.disagreement[MEASUREMENT.yaw_rate] or _is_of_pose(sensor):
            continue
        if disagreement > most and p.variance[sensor] > square(LEAST_NOISE[sensor]):
            worst, most = sensor, disagreement
    if out < 0:
        m.excluded = worst + 1.0
    elif m.disagreement[out] < p.trust:
        m.excluded = 0.0


@inlined
def _advance_to(arrival, p, m, samples, advances, commands):
    """Carry z from `late` periods before the last instant to the present one."""
    late, change = whole(p.late), _state()
    if late > 0:
        _copy(m.past_z, m.past_P, m.z, m.P)
    for instant in range(min(late, whole(m.steps) - 1), -1, -1):
        newer = whole(p.periods) + instant
        store(change, 0, load(m.z, 0))
        _predict(samples[instant, FILTER_SAMPLE.turned], commands[newer + 1], commands[newer], p, m)
        store(change, 0, sub(load(m.z, 0), load(change, 0)))
        _correct(instant, arrival, advances[instant], change, p, m, samples)
        most = m.spare / max(abs(m.z[FILTER_STATE.side]), m.spare)
        m.z[FILTER_STATE.side] *= most
        m.z[FILTER_STATE.turn] *= most
        if late > 0 and instant == late:
            _copy(m.z, m.P, m.past_z, m.past_P)
    _choose_left_out(p, m)


@inlined
def _wait(p, m, commands, z):
    """z at the time when the new command begins to act, from that of the present instant."""
    waiting = whole(p.periods)
    if p.share > 0.0:
        _move(m.F_share, z)
        _steer(m.b_share, commands[waiting] + p.bias, z)
    for i in range(waiting - 1, -1, -1):
        _move(m.F, z)
        _steer(m.b, commands[i] + p.bias, z)


@inlined
def _is_not_finite(m):
    """Whether z or a variance is not finite."""
    everything = 0.0
    for i in range(FILTER_STATES):
        everything += m.z[i] + m.past_z[i] + m.P[i, i] + m.past_P[i, i]
    return not math.isfinite(everything)


@inlined
def _is_far_off(measured, m):
    """Whether position or heading have been elsewhere for so long that bounded innovations would not bring z back."""
    y, yaw = measured[MEASUREMENT.y], measured[MEASUREMENT.yaw]
    if math.isfinite(y) and math.isfinite(yaw) and m.steps > 0.5:
        distance, turn = abs(y - m.z[FILTER_STATE.y]), abs(yaw - m.z[FILTER_STATE.yaw])
        m.outliers = m.outliers + 1.0 if distance > MAX_OUTLIER_DISTANCE or turn > MAX_OUTLIER_TURN else 0.0
    return m.outliers >= RESTART_OUTLIERS


@exported(ESTIMATE)
def kalman(speed, measured, command, a, b, parameters, memory, x, d):
    """See `contract.ESTIMATE`."""
    p, m = parameters_of(parameters, 0), memory_of(memory, 0)
    late = whole(p.late)
    after = _AFTER + VECTOR_WIDTH * (late + 1)
    samples, advances = shaped(memory[_AFTER:after], late + 1, VECTOR_WIDTH), memory[after:]
    commands = memory[after + late + 1 :]
    if _is_not_finite(m) or _is_far_off(measured, m):
        memory[:] = 0.0
        m.speed = math.nan
    if speed != m.speed and math.isfinite(speed):
        _form(speed, p, m)
    if m.steps > 0.5:
        for i in range(whole(p.longest) + late + 2):
            commands[i], command = command, commands[i]
        _sort_in(measured, p, m, samples, advances)
        _advance_to(whole(_motion_instant(measured, p)), p, m, samples, advances, commands)
    else:
        _begin(measured, command, p, m, samples, advances, commands)
    m.steps += 1.0
    z, push = _state(), _state()
    store(z, 0, load(m.z, 0))
    z[FILTER_STATE.side] += m.saturation
    push[FILTER_STATE.side], push[FILTER_STATE.turn] = z[FILTER_STATE.side], z[FILTER_STATE.turn]
    _wait(p, m, commands, z)
    _move(m.F, push)
    _steer(m.b, p.bias, push)
    is_valid = m.blind <= p.patience
    for i in range(x.size):
        state = path.state_index(i, x.size)
        x[i], d[i] = z[state] if is_valid else math.nan, push[state]
    return m.blind * p.period
