"""Mistakes that a log may hold: one table of hypotheses, and the engine that evaluates them.

The model of a hypothesis compares signals and returns numbers. Each of its cases says what a range of a number means:
a mistake that a running loop may make, too (`core.input_check.hypotheses`), or words of its own, with the option that
mends it. To add a hypothesis, add an entry to `LOG_HYPOTHESES`, and a test.

In slow bends yaw rate and road-wheel angle obey r = v delta/(L + K v^2) (R. Rajamani, *Vehicle Dynamics and Control*,
2nd ed., section 3.3), lateral acceleration a_y = v r. A factor between both sides tells the wrong unit. The check of a
loop (`core.input_check`) compares half seconds; here the mean of many bends also shows it without positions and a car.

Along the road, over windows of a second, dv/dt is compared with the signal of a delay ago, with resistance
c_0 + c_2 v^2 removed from both. An accelerometer reads gravity on a slope: a slow difference from dv/dt is a possible
sign of it.

Computed columns agree with their source to the rounding of the table: an acceleration that is v r, a wheel that is the
delayed command, a heading that is the sum of the yaw rate. A sensor deviates more, by its noise and by effects that the
formula neglects. Identification must not take such a column for a measurement: a_y = v r would state with certainty
that the lateral velocity is constant, so that the rear axle does not slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Literal, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.core.input_check.hypotheses import MISTAKE_NAMED
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.log import Log, log_of, shorten_log, unwrapped, window_mean
from adaptrack.identification.reading import Columns

Measurements = Mapping[str, Any]
"""Measurements by name (NaN: unknown), and words for sentences."""

ColumnModel = Callable[[Mapping[str, Array]], Measurements]
"""Model that computes numbers of columns by name, (n,) each."""
INF = math.inf
STEERING_DELAYS = np.arange(0.0, 1.01, 0.1)
GRADIENTS = (0.003, 0.002, 0.005, 0.001, 0.0, 0.008, -0.001, -0.002, 0.012, 0.018, 0.026, 0.036, 0.05)
"""s, between command and yaw rate; rad s^2/m, understeer: all that are tried, usual ones first."""
BETTER = 0.9
"""Share of what a more usual gradient leaves unexplained that another may leave: at an even speed all fit alike."""
MEAN_WINDOW = 0.5
"""s to either side, over which signals are averaged before they are compared."""
LEAST_BOTH = 100
"""Samples in which two signals must be measured before they are compared."""
LARGEST_RATIO = 100.0
"""-, of steering wheel over road wheels."""
CLEAR = 0.6
"""Least correlation of two signals from which anything is concluded."""
LEADS, FOLLOWS, QUICK = np.arange(-0.5, -0.09, 0.05), np.arange(0.0, 1.01, 0.05), 0.15
"""s, by which a yaw rate is tried to run ahead of the steering, and behind; to either side, over which signals are
smoothed for it."""
CLOCK_SHIFTS = np.arange(-1.0, 1.01, 0.02)
"""s, between two signals of one motion."""
AHEAD = 0.85
"""Share of what is unexplained behind the steering that a yaw rate ahead of it must leave at most."""
LATE = 0.08
"""s, from which the yaw rate does not belong to the yaw. Lateral acceleration shows no clock: what the lateral velocity
adds parts it from v r by up to 0.3 s."""
MENDED = 0.5
"""Share of what is unexplained that a shift of clocks must leave at most."""
FASTEST_CAR, FASTEST_TURN = 75.0, 3.0
"""m/s, rad/s: no car drives or turns so fast for long."""
LONGITUDINAL_DELAYS = np.arange(0.0, 1.21, 0.1)
"""s, between a command and the change of speed."""
LEAST_LONGITUDINAL_SPEED = 2.0
"""m/s, below which nothing is compared: the car creeps or is held."""
LEAST_SPEED_CHANGE = 0.1
"""m/s^2, standard deviation of dv/dt below which the car keeps its speed."""
SLOPE_WINDOW, LEAST_SLOPE = 2.5, 0.12
"""s to either side of the mean of a difference that a slope makes; m/s^2, its standard deviation."""
EXACT = 1e-3
"""Difference of two equal signals, over their spread. The lateral velocity changes a_y from v r by 1 % or more."""
MOST_ROUNDING = 0.02
"""Largest rounding of a table that allows a conclusion, over the spread of the signal."""
LONGEST_DELAY = 0.6
"""s, of a wheel column that is the delayed command."""


class Case(NamedTuple):
    """A range of a number, and the sentence that says what it means."""

    number: str
    low: float
    """not in the range"""
    high: float
    words: str
    """format of the sentence, with the numbers by their names; empty where nothing is wrong"""
    mistake: str = ""
    """name of the mistake in `MISTAKE_NAMED`, where a loop may make it, too"""


class LogHypothesis(NamedTuple):
    """A comparison of signals, and the mistakes that it may show."""

    stage: Literal["positions", "gyro", "columns", "signals", "speed", "pedals"]
    """when it is evaluated: ``signals`` with a cleaned `Log`, the others with raw columns"""
    subject: str
    """compared signals"""
    needs: tuple[str, ...]
    """columns without which it is not evaluated"""
    model: Callable[[Evidence], Measurements]
    cases: tuple[Case, ...]
    """contradictions: the first whose number lies in its range counts"""
    possible: tuple[Case, ...] = ()
    """mistakes that are possible, but not certain, where nothing contradicts"""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Signals of a log, and what is known of its car."""

    values: Mapping[str, Array] = field(default_factory=dict)
    """raw columns in SI units, (n,) each"""
    wheelbase: float = math.nan
    """of the car (m)"""
    mass: float = math.nan
    """of the car (kg), for a force"""
    cleaned: Log | None = None

    @property
    def log(self) -> Log:
        """The cleaned log."""
        assert self.cleaned is not None
        return self.cleaned

    @property
    def steered(self) -> str:
        """Name of the steering column."""
        if self.cleaned is not None:
            return "command" if self.cleaned.commanded else "wheel"
        return "command" if "command" in self.values else "wheel"

    @cached_property
    def turning(self) -> Slope:
        """Yaw rate over that of a steady turn."""
        return fit_turning(self.log, self.wheelbase)


class Agreement(NamedTuple):
    """How two signals of a log fit together."""

    compared: str
    clear: bool
    """whether they are correlated enough to conclude anything"""
    contradiction: str
    """a sentence that names the mistake and the option that mends it; empty where they agree"""
    possibility: str
    """a sentence on a mistake that is possible, but not certain; empty where they agree or contradict"""
    mistake: str
    """name of either in `MISTAKE_NAMED`; empty: no loop can make it"""


class Slope(NamedTuple):
    """Factor of one signal over another, and their correlation."""

    factor: float
    correlation: float

    @property
    def numbers(self) -> dict[str, Any]:
        """The factor where it is clear."""
        is_clear = abs(self.correlation) >= CLEAR
        return {"clear": is_clear, "factor": self.factor if is_clear else math.nan}


# -- engine -----------------------------------------------------------------------------------------------------------
def find_cases(cases: Iterable[Case], numbers: Measurements) -> Iterator[Case]:
    """Yield the cases whose number lies in its range, with their sentences in words."""
    for case in cases:
        if case.low < numbers.get(case.number, math.nan) <= case.high:
            yield case._replace(words=case.words.format(**numbers))


def compare(evidence: Evidence, *stages: str) -> list[Agreement]:
    """Evaluate the hypotheses of some stages, without those whose columns are not logged."""
    agreements = []
    for hypothesis in LOG_HYPOTHESES:
        is_due = hypothesis.stage in stages and (hypothesis.stage != "signals" or evidence.cleaned is not None)
        if is_due and evidence.values.keys() >= set(hypothesis.needs):
            numbers = hypothesis.model(evidence)
            certain = next(find_cases(hypothesis.cases, numbers), _AGREES)
            possible = _AGREES if certain.words else next(find_cases(hypothesis.possible, numbers), _AGREES)
            mistake = certain.mistake or possible.mistake
            agreements.append(Agreement(hypothesis.subject, numbers["clear"], certain.words, possible.words, mistake))
    return agreements


def refuse_contradictions(evidence: Evidence, stage: str) -> None:
    """Raise `InvalidInput` where signals contradict each other at a stage; it names the option that mends it."""
    for agreement in compare(evidence, stage):
        if agreement.contradiction:
            raise InvalidInput(f"log: {agreement.contradiction}")


def drop_computed_columns(values: Mapping[str, Array], wheelbase: float) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return the measured signals of a log, and a note on each computed one.

    values: raw columns in SI units by their signals, (n,) each. Raises InvalidInput when the yaw rate is computed from
    steering and speed: nothing was measured.
    """
    columns = {name: np.asarray(column, dtype=np.float64) for name, column in values.items()}
    evidence = Evidence(columns, wheelbase)
    if not {"time", "speed", "yaw_rate", evidence.steered} <= columns.keys():
        return columns, ()
    refuse_contradictions(evidence, "gyro")
    reasons = {
        agreement.compared: agreement.contradiction
        for agreement in compare(evidence, "columns") if agreement.contradiction
    }  # fmt: skip
    measured = {name: column for name, column in columns.items() if name not in reasons}
    return measured, tuple(f"{name} {reason}: it is left out" for name, reason in reasons.items())


def guessed_ratio(log: Log, wheelbase: float) -> float:
    """First guess of the steering ratio (-) of a log whose `command` is an angle of the steering wheel.

    It is the slope over the measured angle of the road wheels, or what yaw rate and speed make of it. Raises
    InvalidInput when neither follows the steering, or the angle is in degrees.
    """
    both = np.isfinite(log.wheel)
    if both.sum() >= LEAST_BOTH:
        slope = _slope(window_mean(log.time, log.command)[both], window_mean(log.time[both], log.wheel[both]))
    else:
        slope = fit_turning(log, wheelbase)
    ratio = 1.0 / abs(slope.factor)
    for case in find_cases(GUESSED_RATIO_CASES, {"unclear": not slope.numbers["clear"], "ratio": ratio}):
        raise InvalidInput(f"log: {case.words}")
    return ratio


def cleaned_log(columns: Columns, wheelbase: float, ratio: float | None = None) -> Log:
    """The log of columns, cleaned and shortened, with angles of the road wheels.

    ratio: of steering wheel over road wheels, where it is to be found; by default `guessed_ratio`. Errors as `log_of`
    and `guessed_ratio`.
    """
    log = shorten_log(log_of(columns.values, wheelbase, columns.notes, columns.commanded))
    if not columns.ratio_unknown:
        return replace(log, ratio=columns.ratio)
    ratio = ratio or guessed_ratio(log, wheelbase)
    return replace(log, command=log.command / ratio, ratio=ratio, ratio_unknown=True)


# -- models of positions and signals ----------------------------------------------------------------------------------
def _positions(evidence: Evidence) -> Measurements:
    """Distance by the positions over distance by the speed."""
    values = evidence.values
    if not {"time", "speed", "x", "y"} <= values.keys():
        return {"clear": False}
    present = np.isfinite(values["time"]) & np.isfinite(values["x"]) & np.isfinite(values["y"])
    time, first = np.unique(values["time"][present], return_index=True)
    speed = values["speed"]
    drives = np.isfinite(values["time"]) & np.isfinite(speed) & (np.abs(speed) > 3.0)
    if time.size < LEAST_BOTH or drives.sum() < LEAST_BOTH:
        return {"clear": False}
    instants = values["time"][drives]
    x, y = (
        np.interp(instants + MEAN_WINDOW, time, place) - np.interp(instants - MEAN_WINDOW, time, place)
        for place in (values["x"][present][first], values["y"][present][first])
    )
    ratios = portable.hypot(x, y) / (2.0 * MEAN_WINDOW * np.abs(speed[drives]))
    return {"clear": True, "factor": float(np.median(ratios))}


def _lateral_acceleration(evidence: Evidence) -> Measurements:
    """Lateral acceleration over speed times yaw rate."""
    log, turning = evidence.log, evidence.turning
    both = np.isfinite(log.acceleration) & np.isfinite(log.yaw_rate)
    if both.sum() < LEAST_BOTH:
        return {"clear": False}
    yaw_rate, acceleration = (window_mean(log.time[both], signal[both]) for signal in (log.yaw_rate, log.acceleration))
    numbers = _slope(log.speed[both] * yaw_rate, acceleration).numbers
    flipped = "yaw_rate" if turning.factor < 0.0 and turning.numbers["clear"] else "acceleration"
    return numbers | {f"factor_of_{flipped}": numbers["factor"]}


def _yaw_clock(evidence: Evidence) -> Measurements:
    """Time (s) by which the yaw rate is later than the yaw says."""
    log = evidence.log
    both = np.isfinite(log.yaw) & np.isfinite(log.yaw_rate) & ~log.begins
    if both.sum() < LEAST_BOTH:
        return {"clear": False}
    rate = np.gradient(log.yaw[both], log.time[both])
    late, correlation = _lateness(log.time[both], window_mean(log.time[both], rate), log.yaw_rate[both])
    return {"clear": abs(late) > LATE or correlation >= CLEAR, "late": late, "later": abs(late), "earlier": -late}


def _lead(evidence: Evidence) -> Measurements:
    """Whether the yaw rate runs ahead of the steering."""
    ahead, behind = (fit_turning(evidence.log, evidence.wheelbase, delays, QUICK) for delays in (LEADS, FOLLOWS))
    leads = ahead.correlation >= CLEAR and 1.0 - ahead.correlation < AHEAD * (1.0 - abs(behind.correlation))
    return {"clear": evidence.turning.numbers["clear"], "leads": leads, "steered": evidence.steered}


def _turning(evidence: Evidence) -> Measurements:
    """Yaw rate over that of a steady turn."""
    log, numbers = evidence.log, evidence.turning.numbers
    ratio = 1.0 / numbers["factor"]
    if numbers["factor"] > 0.0:
        numbers["fastest_turn"] = float(np.percentile(np.abs(log.yaw_rate[np.isfinite(log.yaw_rate)]), 99))
    return numbers | {
        "fastest": float(np.percentile(log.speed, 99)), "ratio": ratio, "in_degrees": math.radians(ratio),
        "ratio_option": f" --steering-ratio {ratio:.0f}" if ratio > 8.0 else "",
        "steered": evidence.steered, "wheelbase": evidence.wheelbase,
    }  # fmt: skip


def fit_turning(log: Log, wheelbase: float, delays: Array = STEERING_DELAYS, half: float = MEAN_WINDOW) -> Slope:
    """Yaw rate against v delta/(L + K v^2), at the delay (s) and gradient where they agree best."""
    present = np.isfinite(log.yaw_rate)
    if present.sum() < LEAST_BOTH:
        return Slope(math.nan, 0.0)
    yaw_rate = window_mean(log.time[present], log.yaw_rate[present], half)
    steering = window_mean(log.time, log.command, half)
    steps = np.unique(np.round(delays / log.period).astype(int))
    late = [steering[np.clip(np.arange(steering.size) - step, 0, steering.size - 1)] for step in steps]
    best = Slope(math.nan, 0.0)
    for gradient in GRADIENTS:
        turn = log.speed / np.maximum(wheelbase + gradient * portable.square(log.speed), 0.3 * wheelbase)
        slopes = [_slope((turn * (angle - np.median(angle)))[present], yaw_rate) for angle in late]
        slope = max(slopes, key=lambda slope: abs(slope.correlation))
        if 1.0 - abs(slope.correlation) < BETTER * (1.0 - abs(best.correlation)):
            best = slope
    return best


def _lateness(time: Array, reference: Array, signal: Array) -> Slope:
    """s by which a signal of a motion is later than a smoothed reference, and their correlation there.

    0 where no shift explains much more than none does.
    """
    stretches = np.split(np.arange(time.size), np.flatnonzero(np.diff(time) > 1.0) + 1)
    rows = max(stretches, key=lambda rows: time[rows[-1]] - time[rows[0]])  # of the longest stretch
    time, reference, signal = time[rows], reference[rows], signal[rows]
    if time.size < LEAST_BOTH or time[-1] - time[0] < 10.0:
        return Slope(0.0, 0.0)
    signal = window_mean(time, signal)
    inside = (time > time[0] + 1.0) & (time < time[-1] - 1.0)
    fits = [
        _slope(reference[inside], np.interp(time[inside] + shift, time, signal)).correlation for shift in CLOCK_SHIFTS
    ]  # fmt: skip
    best, none = int(np.argmax(fits)), int(np.argmin(np.abs(CLOCK_SHIFTS)))
    if fits[best] < 0.9 or 1.0 - fits[best] > MENDED * (1.0 - fits[none]):
        return Slope(0.0, fits[none])
    return Slope(float(CLOCK_SHIFTS[best]), fits[best])


def _slope(x: Array, y: Array) -> Slope:
    """y over x: the geometric mean of both regressions, so that noise in either does not flatten it."""
    x, y = x - x.mean(), y - y.mean()
    sizes = math.sqrt(float(product(x, x))), math.sqrt(float(product(y, y)))
    if min(sizes) <= 0.0:
        return Slope(math.nan, 0.0)
    correlation = float(product(x, y)) / (sizes[0] * sizes[1])
    return Slope(math.copysign(sizes[1] / sizes[0], correlation), correlation)


# -- models along the road --------------------------------------------------------------------------------------------
def _change_of_speed(name: str, evidence: Evidence) -> Measurements:
    """Change of speed over a signal, of a command at the delay where they agree best, and their slow difference."""
    values, scale = evidence.values, evidence.mass if name == "force_command" else 1.0
    rows = np.flatnonzero(np.all([np.isfinite(values[column]) for column in ("time", "speed", name)], axis=0))
    if rows.size < LEAST_BOTH:
        return {"clear": False}
    time, first = np.unique(values["time"][rows], return_index=True)
    speed, signal = window_mean(time, values["speed"][rows[first]], 0.1), values[name][rows[first]] / scale
    after, before = (np.interp(time + shift, time, speed) for shift in (MEAN_WINDOW, -MEAN_WINDOW))
    change = (after - before) / (2.0 * MEAN_WINDOW)
    compared = np.minimum(after, before) > LEAST_LONGITUDINAL_SPEED
    compared &= (time > time[0] + LONGITUDINAL_DELAYS[-1] + MEAN_WINDOW) & (time < time[-1] - MEAN_WINDOW)
    if compared.sum() < LEAST_BOTH:
        return {"clear": False}
    is_measured, best = name == "longitudinal_acceleration", Slope(1.0, 0.0)
    if float(np.std(change[compared])) >= LEAST_SPEED_CHANGE:
        nuisance = np.column_stack([np.ones(time.size), speed * speed])[compared]
        for delay in LONGITUDINAL_DELAYS[: 1 if is_measured else None]:
            row = np.searchsorted(time, time - delay + 1e-9, side="right") - 1
            late = window_mean(time, signal[np.maximum(row, 0)])
            fit = _partial_slope(late[compared], change[compared], nuisance)
            best = max(best, fit, key=lambda fit: abs(fit.correlation))
    difference = window_mean(time[compared], (window_mean(time, signal) - change)[compared], SLOPE_WINDOW)
    slow = float(np.std(difference)) if is_measured else math.nan
    return best.numbers | {"name": name, "slow": slow, "slope": 100.0 * slow / GRAVITY}


def _partial_slope(x: Array, y: Array, nuisance: Array) -> Slope:
    """Slope of y over x, and their correlation, with other regressors (columns) removed from both."""
    x, y = (signal - product(nuisance, portable.least_squares(nuisance, signal)) for signal in (x, y))
    power, common = float(product(x, x)), float(product(x, y))
    size = math.sqrt(power * float(product(y, y)))
    return Slope(common / power, common / size) if size > 0.0 else Slope(1.0, 0.0)


def _pedals(evidence: Evidence) -> Measurements:
    """Farthest that a pedal is beyond 0 to 1."""
    pedals = np.array([evidence.values[name] for name in ("throttle", "brake")])
    low, high = float(np.nanmin(pedals)), float(np.nanmax(pedals))
    return {"clear": True, "beyond": max(-low, high - 1.0), "low": low, "high": high}


# -- models of computed columns ---------------------------------------------------------------------------------------
def _kinematic_yaw_rate(evidence: Evidence) -> Measurements:
    """Whether the yaw rate is that of the kinematic model, v tan(delta)/L."""
    values, steered = evidence.values, evidence.steered
    model = values["speed"] * portable.tan(np.clip(values[steered], -1.5, 1.5)) / evidence.wheelbase
    is_equal = any(_are_equal(values["yaw_rate"], _delay(model, rows), 0.0, scaled=True) for rows in (0, 1))
    return {"clear": True, "computed": is_equal, "steered": steered}


def _column(name: str, model: ColumnModel, evidence: Evidence) -> Measurements:
    """Value of a constant column, and the numbers of a model of its computation from other columns."""
    finite = evidence.values[name][np.isfinite(evidence.values[name])]
    is_constant = finite.size and float(np.ptp(finite)) <= 1e-9 * max(1.0, float(np.abs(finite).max()))
    return {"clear": False, "constant": finite[0] if is_constant else math.nan, **model(evidence.values)}


def _computed_acceleration(values: Mapping[str, Array]) -> Measurements:
    speed, yaw_rate = values["speed"], values["yaw_rate"]
    rounding = portable.hypot(_rounding(yaw_rate) * _size(speed), _rounding(speed) * _size(yaw_rate))
    delayed = (_delay(speed * yaw_rate, rows) for rows in (0, 1, -1))
    return {"turn": any(_are_equal(values["acceleration"], signal, rounding) for signal in delayed)}


def _computed_vy(values: Mapping[str, Array]) -> Measurements:
    vy, speed, yaw_rate = values["vy"], values["speed"], values["yaw_rate"]
    steering = {name: values[name] for name in ("command", "wheel") if name in values}
    numbers = {name: _are_equal(vy, speed * angle, 0.0, scaled=True) for name, angle in steering.items()}
    return numbers | {"turn": _are_equal(vy, yaw_rate, _rounding(yaw_rate), scaled=True)}


def _computed_yaw(values: Mapping[str, Array]) -> Measurements:
    """Whether steps of the yaw are the yaw rate times steps of time, by any common difference formula."""
    yaw_rate, heading = values["yaw_rate"], unwrapped(values["yaw"])
    step, span, rounding = np.diff(heading), np.diff(values["time"]), _rounding(heading)
    sums = (yaw_rate[:-1] * span, yaw_rate[1:] * span, 0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * span)
    sum_rounding = float(portable.hypot(rounding, _rounding(yaw_rate) * float(np.nanmedian(span))))
    is_sum = any(_are_equal(step, angle, sum_rounding) for angle in sums)
    return {"sum": is_sum or _are_equal(step[1:] + step[:-1], yaw_rate[1:-1] * (span[1:] + span[:-1]), rounding)}


def _computed_wheel(values: Mapping[str, Array]) -> Measurements:
    """Delay (s) at which the wheel is the scaled command."""
    command, period = values["command"], float(np.nanmedian(np.diff(values["time"])))
    for rows in range(round(LONGEST_DELAY / period) + 1):
        if _are_equal(values["wheel"], _delay(command, rows), _rounding(command), scaled=True):
            return {"delay": rows * period}
    return {}


def _delay(x: Array, rows: int) -> Array:
    """Return a signal delayed by a number of rows."""
    out = np.full(x.size, np.nan)
    if rows >= 0:
        out[rows:] = x[: x.size - rows]
    else:
        out[:rows] = x[-rows:]
    return out


def _are_equal(x: Array, y: Array, rounding: float, scaled: bool = False) -> bool:
    """Return whether x is y (scaled: a multiple of y) plus a constant, to their rounding; rounding: of y."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_BOTH:
        return False
    x, y = x[both], y[both]
    x, y = x - np.median(x), y - np.median(y)
    spread = float(np.std(x))
    if scaled:
        power = float(product(y, y))
        factor = float(product(x, y)) / power if power > 0.0 else 0.0
        y, rounding = factor * y, abs(factor) * rounding
    allowed = portable.hypot(_rounding(x), rounding) / math.sqrt(12.0)
    allowed = min(allowed, MOST_ROUNDING * spread) + EXACT * spread
    return spread > 0.0 and float(np.quantile(np.abs(x - y), 0.9)) <= 1.645 * allowed


def _rounding(x: Array) -> float:
    """Return the least step between the values of a signal."""
    levels = np.unique(np.round(x[np.isfinite(x)], 12))
    return float(np.diff(levels).min()) if levels.size > 1 else 0.0


def _size(x: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.nanmean(x * x)))


# -- table ------------------------------------------------------------------------------------------------------------
def _case(number: str, low: float, high: float, evidence: str, meaning: str) -> Case:
    """Case of a mistake of a loop by its name, or of words; meaning: empty where both signals agree."""
    if meaning in MISTAKE_NAMED:
        return Case(number, low, high, MISTAKE_NAMED[meaning].says(evidence, for_log=True), meaning)
    return Case(number, low, high, meaning and f"{evidence}: {meaning}")


def _factor_cases(evidence: str, *meanings: tuple[float, float, str]) -> tuple[Case, ...]:
    """Cases of a factor: from, to, and what it means."""
    return tuple(_case("factor", low, high, evidence, meaning) for low, high, meaning in meanings)


def _along_road(name: str, *meanings: tuple[float, float, str]) -> LogHypothesis:
    """Hypothesis on a signal (a force: over the mass), by the factor of dv/dt over it."""
    signal, sign = name.replace("_", " "), f"{name}_sign"
    inverted = sign if sign in MISTAKE_NAMED else f"the sign of the {signal} is inverted; --flip {name}."
    factors = _factor_cases(
        f"{name}: the speed changes at {{factor:.3g}} times the signal",
        (-INF, 0.0, inverted), *meanings,
    )  # fmt: skip
    gravity = (
        f"{name} slowly departs from the change of speed, by {{slow:.2g}} m/s^2, as gravity on slopes of {{slope:.1g}} "
        "% does: possibly it contains gravity; do not use it as dv/dt."
    )
    possible = (Case("slow", LEAST_SLOPE, INF, gravity, f"{name}_with_gravity"),)
    model, needs = partial(_change_of_speed, name), ("time", "speed", name)
    return LogHypothesis("speed", f"{signal} and speed, whole log", needs, model, factors, possible)


def _computed(name: str, model: ColumnModel, *cases: Case, needs: tuple[str, ...] = ()) -> LogHypothesis:
    """Hypothesis on a column that is constant, or computed from other columns."""
    constant = Case("constant", -INF, INF, "is {constant:.4g} in every row")
    return LogHypothesis("columns", name, (name, *needs), partial(_column, name, model), (constant, *cases))


_AGREES = Case("", 0.0, 0.0, "")
_PEDAL, _UNIT = "it is a pedal in per cent: translate it by the map of the car's pedals", "check its unit (--units)"
_CHECK = "check the units (--units) and the wheelbase, or give"
_CLOCK = (
    "than yaw says: their clocks differ, or one is filtered. Name the column of its own times (--clock yaw_rate=COLUMN)"
    " or mend it: --late yaw_rate={late:.2f} (s), or --late yaw={earlier:.2f}."
)
_STEADY = "the yaw rate is {factor:.3g} times what the steering angle makes of a wheelbase of {wheelbase:g} m"
_OPPOSITE = "lateral acceleration and yaw rate have opposite signs"
_COMPUTED = "it is computed, not measured"
GUESSED_RATIO_CASES = (
    Case("unclear", 0.0, INF, "the steering ratio cannot be found: neither yaw rate nor road wheels follow the "
         "steering wheel. Give it, --steering-ratio R, or drive slow bends."),
    Case("ratio", LARGEST_RATIO, INF, "the steering wheel turns {ratio:.0f} times as far as the road wheels: if it is "
         "in degrees, say --units steering_wheel=deg (or command=deg)."),
)  # fmt: skip
"""Of a log whose steering ratio is to be found: its first guess."""
LOG_HYPOTHESES = (
    LogHypothesis("positions", "positions and speed, whole log", (), _positions, _factor_cases(
        "speed: the positions move at {factor:.3g} times the speed",
        (-INF, 1e-3, "x and y are degrees of latitude and longitude, or another column: --columns x=NAME,y=NAME."),
        (0.2, 0.35, "speed_in_km_h"), (0.4, 0.5, "speed_in_miles_h"), (0.7, 1.4, ""), (0.0, INF, "speed_unit"),
    )),
    LogHypothesis("gyro", "yaw_rate", (), _kinematic_yaw_rate, (Case(
        "computed", 0.0, INF,
        f"the yaw rate is speed times the tangent of {{steered}} over a length, to its rounding: {_COMPUTED}, and "
        "tells nothing of the car. Name a column that a gyro measured: --columns yaw_rate=NAME."
    ),)),
    _computed(
        "vy", _computed_vy, Case("turn", 0.0, INF, f"is the yaw rate times a constant: {_COMPUTED}"),
        Case("command", 0.0, INF, f"is speed times command times a constant: {_COMPUTED}"),
        Case("wheel", 0.0, INF, f"is speed times wheel times a constant: {_COMPUTED}"),
    ),
    _computed(
        "acceleration", _computed_acceleration,
        Case("turn", 0.0, INF, f"is speed times yaw rate to its rounding: {_COMPUTED}"),
    ),
    _computed(
        "yaw", _computed_yaw,
        Case("sum", 0.0, INF, "is the sum of the yaw rate, or the yaw rate its derivative: they are one measurement"),
    ),
    _computed(
        "wheel", _computed_wheel, Case("delay", -INF, 0.0, f"is the command: {_COMPUTED}"),
        Case("delay", 0.0, INF, f"is the command, {{delay:.3g}} s later: {_COMPUTED}"), needs=("command",),
    ),
    LogHypothesis("signals", "lateral acceleration and yaw rate, whole log", (), _lateral_acceleration, (
        _case("factor_of_acceleration", -INF, 0.0, _OPPOSITE, "lateral_acceleration_sign"),
        _case("factor_of_yaw_rate", -INF, 0.0, _OPPOSITE, "yaw_rate_sign"),
        *_factor_cases(
            "the lateral acceleration is {factor:.3g} times speed times yaw rate",
            (0.01, 0.03, "yaw_rate_in_degrees"), (0.2, 0.35, "speed_in_km_h"), (0.4, 0.5, "speed_in_miles_h"),
            (0.07, 0.15, "lateral_acceleration_in_g"),
        ),
    )),
    LogHypothesis("signals", "yaw and yaw rate, whole log", (), _yaw_clock, (
        Case("late", LATE, INF, f"yaw_rate is {{later:.2f}} s later {_CLOCK}", "yaw_late"),
        Case("late", -INF, -LATE, f"yaw_rate is {{later:.2f}} s earlier {_CLOCK}", "yaw_late"),
    )),
    LogHypothesis("signals", "clocks of steering and yaw rate", (), _lead, (Case(
        "leads", 0.0, INF,
        "the yaw rate runs ahead of {steered}: their clocks differ. Name the column of its own times, --clock "
        "{steered}=COLUMN, or by how much it is late: --late {steered}=0.3 (s)."
    ),)),
    LogHypothesis("signals", "steering and yaw rate, whole log", (), _turning, (
        _case("fastest", FASTEST_CAR, INF, "speed: no car drives at {fastest:.0f} m/s", "speed_of_no_car"),
        _case("factor", -INF, 0.0, "yaw rate and {steered} have opposite signs", "steering_sign"),
        _case("fastest_turn", FASTEST_TURN, INF, _STEADY, "angles in degrees: --units deg{ratio_option}"),
        Case("factor", 4e-4, 3e-3, f"{_STEADY}: {{steered}} is the angle of the steering wheel in degrees: --units "
             "{steered}=deg --steering-ratio {in_degrees:.0f} (or fit)", "command_too_small"),
        Case("factor", 0.008, 0.035, f"{_STEADY}: {{steered}} is in degrees: --units {{steered}}=deg",
             "command_too_small"),
        Case("factor", 0.035, 0.13, f"{_STEADY}: {{steered}} is the angle of the steering wheel: --steering-ratio "
             "{ratio:.0f}, or --steering-ratio fit", "command_too_small"),
        *_factor_cases(
            _STEADY, (0.15, 0.35, "speed_in_km_h"), (0.35, 3.5, ""), (25.0, 130.0, "yaw_rate_in_degrees"),
            (0.0, 0.5, f"{_CHECK} --steering-ratio {{ratio:.0f}}."), (0.0, INF, f"{_CHECK} the steering ratio."),
        ),
    )),
    _along_road(
        "acceleration_command", (0.0, 0.2, f"{_PEDAL}."), (0.2, 0.35, f"{_UNIT}."), (0.35, 2.4, ""),
        (2.4, 30.0, "it is in g: --units acceleration_command=g; or a pedal of 0 to 1, to be translated by its map."),
        (30.0, INF, f"{_UNIT}."),
    ),
    _along_road(
        "force_command", (0.0, 0.25, f"{_UNIT} and the mass of the car."), (0.25, 4.0, ""), (4.0, 300.0, f"{_PEDAL}."),
        (300.0, INF, "it is in kN: --units force_command=kN; or an acceleration: --columns "
         "acceleration_command=NAME."),
    ),
    _along_road(
        "longitudinal_acceleration", (0.0, 0.2, f"{_UNIT}."), (0.2, 3.5, ""),
        (3.5, 30.0, "longitudinal_acceleration_in_g"), (30.0, INF, f"{_UNIT}."),
    ),
    LogHypothesis("pedals", "throttle and brake", ("throttle", "brake"), _pedals, (Case(
        "beyond", 0.01, INF, "throttle and brake reach from {low:.3g} to {high:.3g}: they must be 0 to 1; for per cent "
        "give --units throttle=%,brake=%."
    ),)),
)  # fmt: skip
"""All hypotheses on a log, in the order in which they are evaluated at each stage."""
