"""The likelihood of a log, and the quantities that maximise it.

With innovations e_i and variances S_i of a filter (`core.identification.steering`), and a standard normal prior on z,

    -ln p = 1/2 sum(e_i^2/S_i + ln S_i) + 1/2 |z|^2

Fisher scoring with Levenberg's damping: gradient sum(e e'/S + (1 - e^2/S) S'/(2 S)) + z, information
sum(e' e'^T/S + S' S'^T/(2 S^2)) + I, derivatives by differences (L. Ljung, *System Identification*, 2nd ed., sections
7.4 and 10.2; N. K. Gupta and R. K. Mehra, IEEE Trans. Automatic Control 19 (1974) 774-783).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.identification import steering as kernel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.identification.log import Log, segment_starts, window_mean
from adaptrack.identification.quantities import (
    INDEX,
    PUSH_TIME,
    QUANTITIES,
    SHAPE,
    Prior,
    Quantity,
    Reported,
    report_delay,
    report_quantity,
    understeer,
    values_of,
)
from adaptrack.road.smoothing import Smoother

MEASURED_OUTPUTS = ("yaw_rate", "vy", "acceleration", "yaw", "wheel")
DIFFERENCE_STEP, MOST_STEPS, ENOUGH, NEARLY = 1e-4, 25, 0.02, 0.5
"""Of the differences, in spreads; iterations; fall of the objective at which they end, and nearly."""
SETTLING = 1.0
"""s at the beginning of each segment whose innovations do not count: commands before it are unknown."""
GUST_WINDOW, LEAST_GUSTS = 3.0, 0.01
"""s to either side over which the changes of the wind are averaged; least share of their mean square."""
WIDER = 2.0
"""Factor on the most likely spread of the gusts."""
LEAST_OF_SPLINE = 20
"""Samples of a segment whose measured wheel angle is smoothed."""
SHORTEST_SMOOTHING, LONGEST_SMOOTHING, RELAXATION_LENGTHS = 2.0, 5.0, 25
"""Smoothing lengths that are tried, in samples; s; how many."""
ALSO_REPORTED = (
    "lateness", "rate", "offset", "vy_ahead", "push_mean", "gyro_offset", "acceleration_offset", "wheel_offset",
    "relaxation", "noise_yaw_rate", "noise_vy", "noise_acceleration", "noise_yaw", "noise_wheel",
)  # fmt: skip
"""Quantities that are reported as they are where they are estimated."""
STRETCH = 10.0
"""s, of the stretches whose estimates are compared: longer than what innovations may be correlated."""


class InnovationLikelihood(ABC):
    """Likelihood of the innovations of a filter along a log, at points z of a standard normal prior.

    time: (n,) s, of the samples; begins: (n,) whether a segment begins; beliefs: by the names of `quantities`
    """

    quantities: tuple[Quantity, ...] = QUANTITIES
    """entries of z"""
    counts: NDArray[np.bool_]
    """(..., n) innovations that count"""
    tightest = 0.0
    """rad, angle of the road wheels in tight bends"""

    def __init__(self, time: Array, begins: NDArray[np.bool_], beliefs: Mapping[str, Prior]) -> None:
        self.time = time
        self.median, self.spread = np.array([beliefs[quantity.name] for quantity in self.quantities]).T.copy()
        self.free = np.flatnonzero(self.spread > 0.0)
        """entries of z that are estimated"""
        self.settled = time - time[segment_starts(begins)] >= SETTLING

    def values(self, z: Array) -> Array:
        """The quantities at a point z, in their units and order."""
        return values_of(z, self.median, self.spread, self.quantities)

    @abstractmethod
    def innovations(self, z: Array) -> tuple[Array, Array]:
        """All innovations and variances, shaped as `counts`, NaN where nothing is measured."""

    @property
    @abstractmethod
    def reported(self) -> list[Reported]:
        """Quantities that are reported."""

    def counted(self, z: Array) -> tuple[Array, Array]:
        """Innovations and variances that count, flat."""
        e, s = self.innovations(z)
        return e[self.counts], s[self.counts]

    def objective(self, z: Array) -> float:
        """-ln p, up to a constant; infinite where the filter is not finite."""
        return _objective(*self.counted(z), z)

    def scored(self, z: Array) -> Scored:
        """Objective, gradient and information at a point; `InvalidInput` where they are not finite."""
        e, s = self.counted(z)
        de, ds = np.empty((self.free.size, e.size)), np.empty((self.free.size, e.size))
        for i, place in enumerate(self.free):
            there = z.copy()
            there[place] += DIFFERENCE_STEP
            e_up, s_up = self.counted(there)
            de[i], ds[i] = (e_up - e) / DIFFERENCE_STEP, (s_up - s) / DIFFERENCE_STEP
        with np.errstate(all="ignore"):  # what comes of it is looked at
            scores = de * (e / s) + ds * ((1.0 - e * e / s) / (2.0 * s))
            by_error, by_size = de / np.sqrt(s), ds / (np.sqrt(2.0) * s)
            information = _squares(by_error) + _squares(by_size) + np.eye(self.free.size)
        if not (np.isfinite(information).all() and np.isfinite(scores).all()):
            raise InvalidInput(
                "identify: what the log tells is not finite: a signal is off by orders of magnitude; check columns and "
                "units (--columns, --units)."
            )
        return Scored(_objective(e, s, z), scores.sum(axis=1) + z[self.free], information, scores, by_error, by_size)

    def fit(self, z: Array, enough: float = ENOUGH) -> tuple[Array, Scored]:
        """The most likely point from a start, and what is known there."""
        current, damping = self.scored(z), 1e-3
        for _ in range(MOST_STEPS):
            moved = z.copy()
            scaled = current.information + damping * np.diag(np.diag(current.information))
            moved[self.free] -= np.clip(portable.solve(scaled, current.gradient), -1.5, 1.5)
            there = self.objective(moved)
            if there < current.objective:
                fell = current.objective - there
                z, damping = moved, max(0.2 * damping, 1e-6)
                current = self.scored(z)
                if fell < enough:
                    break
            else:
                damping = max(10.0 * damping, 1e-3)
                if damping > 1e6:
                    break
        return z, current

    def fit_best(self, starts: Iterable[Array], enough: float = ENOUGH) -> tuple[Array, Scored]:
        """Fit from several starts: the most likely point, and its scores."""
        return min((self.fit(z, enough) for z in starts), key=lambda fit: fit[1].objective)

    def fit_over(self, names: Collection[str], z: Array) -> Array:
        """Fit only the quantities of these names from a start, nearly to the most likely point."""
        free = self.free
        self.free = np.array([place for place in free if self.quantities[place].name in names])
        try:
            return self.fit(z, NEARLY)[0]
        finally:
            self.free = free

    def covariance(self, at: Scored, slopes: Array | None = None) -> Array:
        """Covariance of z where it is free: the inverse information, wider where stretches of the log disagree.

        slopes: derivatives over the free entries of as many quantities, each of which is widened by itself; by default
        the entries

        The scatter of the estimates that leave out one stretch each holds whatever the noise is, and what differs from
        stretch to stretch (the delete-one jackknife in its linear form, CR3 of J. G. MacKinnon, M. O. Nielsen and M. D.
        Webb, J. Econometrics 232 (2023) 272-299). The variance of these quantities is never less than the information
        says, nor more than was believed before.
        """
        inverse = portable.inverse(at.information)
        stretch = np.broadcast_to(np.floor(self.time / STRETCH).astype(np.int64), self.counts.shape)[self.counts]
        scatter = product(inverse, inverse)  # of the prior
        for number in np.unique(stretch):
            rows = stretch == number
            its = _squares(at.by_error[:, rows]) + _squares(at.by_size[:, rows])
            moved = portable.solve(at.information - its, at.scores[:, rows].sum(axis=1))
            scatter += np.outer(moved, moved)
        slopes = np.eye(self.free.size) if slopes is None else slopes
        least, observed = (np.sum(product(slopes, matrix) * slopes, axis=1) for matrix in (inverse, scatter))
        widened = np.sqrt(np.clip(observed, least, np.sum(slopes * slopes, axis=1)) / least)
        change = portable.solve(slopes, widened[:, None] * slopes)
        return product(product(change, inverse), change.T)


class Likelihood(InnovationLikelihood):
    """Likelihood of a log: innovations and objective at any point z."""

    def __init__(
        self, log: Log, car: Vehicle, beliefs: Mapping[str, Prior], used: Array | float = 1.0,
        gusts: Array | float = 1.0,
    ) -> None:  # fmt: skip
        """used: (n,) 1 where a sample is taken in and counts; gusts: (n,) factor on the spread of the wind's noise."""
        super().__init__(log.time, log.begins, beliefs)
        self.log, self.car, self.tightest = log, car, log.tightest
        rows = np.zeros((len(kernel.LOG_ROW), log.samples))
        for name in ("time", "command", "speed", *MEASURED_OUTPUTS):
            rows[kernel.LOG_ROW._fields.index(name)] = getattr(log, name)
        rows[kernel.LOG_ROW.begins] = log.begins
        rows[kernel.LOG_ROW.used], rows[kernel.LOG_ROW.gusts] = used, gusts
        self._rows, self._gusts = rows, rows[kernel.LOG_ROW.gusts]
        self._answer = np.empty((kernel.IDENTIFICATION_ANSWER, log.samples))
        self.present = {name: bool(np.isfinite(getattr(log, name)).any()) for name in MEASURED_OUTPUTS}
        measured = np.isfinite(rows[kernel.LOG_ROW.yaw_rate : kernel.LOG_ROW.yaw_rate + len(MEASURED_OUTPUTS)])
        self.counts = measured & (rows[kernel.LOG_ROW.used] > 0.0) & self.settled
        self.free = np.flatnonzero((self.spread > 0.0) & self._has_a_say())

    def _has_a_say(self) -> NDArray[np.bool_]:
        """Which quantities can change what is predicted."""
        silent = set()
        for output, names in (
            ("vy", ("noise_vy", "vy_ahead", "vy_turned")),
            ("acceleration", ("noise_acceleration", "acceleration_offset")),
            ("yaw", ("noise_yaw",)), ("wheel", ("noise_wheel", "wheel_offset")),
        ):  # fmt: skip
            if not self.present[output]:
                silent |= set(names)
        if not self.log.commanded:
            silent |= {"delay", "lag_share", "rate"}
        elif not self.present["wheel"]:
            silent |= {"lateness"}
        return np.array([quantity.name not in silent for quantity in QUANTITIES])

    def packed(self, values: Array) -> Array:
        """The kernel's vector of quantities."""
        value = {name: values[i] for name, i in INDEX.items()}
        car, wheelbase = self.car, self.car.wheelbase
        air = 0.5 * car.air_density * car.frontal_area
        # Gusts of a kept spread must not shrink by a larger inertia: their moment over it is that of the believed one.
        heavier = value["yaw_inertia"] / self.median[INDEX["yaw_inertia"]]
        delayed = value["delay"] if self.log.commanded else 0.0
        derived = {
            "lag": value["lag_share"] * delayed, "dead_time": (1.0 - value["lag_share"]) * delayed,
            "wheel_gain": 1.0 if self.log.ratio_unknown else value["gain"],
            "lf": value["front_share"] * wheelbase, "lr": (1.0 - value["front_share"]) * wheelbase,
            "shape_factor": SHAPE,
            "side": air * car.side_force_slope, "moment": air * car.yaw_moment_slope * wheelbase * heavier,
            "wind_angle_limit": car.wind_angle_limit,
            "push_time": PUSH_TIME, "wind_rise": value["wind_smoothness"] * value["wind_time"],
        }  # fmt: skip
        values_by_name = value | derived
        return np.array([values_by_name[name] for name in kernel.Quantities._fields])

    @property
    def reported(self) -> list[Reported]:
        """Quantities that are reported of a log."""
        wheelbase, log = self.car.wheelbase, self.log

        def gradient(v: Array) -> float:
            return understeer(v[INDEX["front"]], v[INDEX["rear"]], v[INDEX["mass"]], wheelbase, v[INDEX["front_share"]])

        delayed = "lag and dead time together, from the command to the wheels"
        if not self.present["wheel"]:
            delayed = "from the command to the logged yaw rate: lag and dead time of the wheels, and how late a gyro is"
        rows: list[Reported] = []
        if log.commanded:
            rows.append(report_quantity(QUANTITIES, "delay", delayed))
            rows += report_delay(QUANTITIES, "", "time constant of the steering", "until the wheels begin to move")
        steady, place = "steering per lateral acceleration in a steady bend", "centre of gravity to front axle"
        rows += [
            Reported("understeer_gradient", "rad s^2/m", steady, False, gradient),
            report_quantity(QUANTITIES, "front"), report_quantity(QUANTITIES, "rear"),
            Reported("lf", "m", place, True, lambda v: float(v[INDEX["front_share"]] * wheelbase)),
        ]  # fmt: skip
        if log.ratio_unknown:
            meaning = "logged steering angle over road wheels"
            rows.append(Reported("ratio", "-", meaning, True, lambda v: log.ratio / float(v[INDEX["gain"]])))
        elif self.spread[INDEX["gain"]] > 0.0:
            meaning = "logged steering angle over that of yaw rate, speed and wheelbase"
            rows.append(Reported("angle_scale", "-", meaning, True, lambda v: 1.0 / float(v[INDEX["gain"]])))
        free = {QUANTITIES[i].name for i in self.free}
        return rows + [report_quantity(QUANTITIES, name) for name in ALSO_REPORTED if name in free]

    def innovations(self, z: Array) -> tuple[Array, Array]:
        """All innovations and variances, each (len(MEASURED_OUTPUTS), n), NaN where nothing is measured."""
        kernel.innovations(self.packed(self.values(z)), self._rows, self._answer)
        count = len(MEASURED_OUTPUTS)
        return self._answer[:count].copy(), self._answer[count : 2 * count].copy()

    def filter_results(self, z: Array) -> dict[str, Array]:
        """Filter results at each sample, by the names of the kernel's `FOUND`."""
        self.innovations(z)
        return dict(zip(kernel.FOUND._fields, self._answer[2 * len(MEASURED_OUTPUTS) :].copy(), strict=True))

    def using(self, used: Array) -> Likelihood:
        """A likelihood with these beliefs and gusts, and a selection of samples; used: (n,) 1 where one counts."""
        return Likelihood(self.log, self.car, self.beliefs, used, self._gusts)

    def widen_gusts(self, z: Array) -> Array:
        """Keep the wind's spread at `WIDER` times that of a point; the point there.

        Gusts have longer tails than a Gaussian process. One that is as likely as can be shrinks them, and leaves the
        driver's answer to them to the tyres: in closed loop cars then seem to understeer more than they do.
        """
        place = INDEX["wind_spread"]
        self.median[place] = WIDER * self.values(z)[place]
        self.spread[place] = 0.0
        self.free = self.free[self.free != place]
        return np.where(np.arange(z.size) == place, 0.0, z)

    def follow_gusts(self, z: Array) -> None:
        """Let the spread of the wind's noise follow how much the wind changes along the log."""
        wind, time, begins = self.filter_results(z)["wind"], self.log.time, self.log.begins
        change = np.zeros_like(wind)
        change[1:] = np.where(begins[1:], 0.0, np.diff(wind) / np.maximum(np.diff(time), 1e-6))
        power = window_mean(time, change * change, GUST_WINDOW)
        level = power / max(float(np.mean(power)), 1e-12)
        self._gusts[:] = np.sqrt(np.maximum(level, LEAST_GUSTS))

    @property
    def beliefs(self) -> dict[str, Prior]:
        """Current prior of every quantity."""
        pairs = zip(self.median, self.spread, strict=True)
        return {quantity.name: Prior(*map(float, pair)) for quantity, pair in zip(QUANTITIES, pairs, strict=True)}

    def part(self, rows: slice) -> Likelihood:
        """The likelihood of a stretch of the log, with the beliefs and gusts that are here."""
        begins = self.log.begins[rows].copy()
        begins[0] = True
        return Likelihood(self.log.at(rows, begins), self.car, self.beliefs, gusts=self._gusts[rows])


def smooth_wheel(log: Log) -> Array:
    """(n,) the measured wheel angle without its noise and steps, which would pass for steering.

    Splines of each segment, as smooth as cross-validation finds best (`road.smoothing`).
    """
    out = log.command.copy()
    for rows in np.split(np.arange(log.samples), np.flatnonzero(log.begins)[1:]):
        if rows.size > LEAST_OF_SPLINE and np.ptp(log.command[rows]) > 0.0:
            time = log.time[rows] - log.time[rows[0]]
            values, spacing = log.command[rows][:, np.newaxis], float(np.median(np.diff(time)))
            smoother = Smoother(values, time, float(time[-1]), False, spacing)
            lengths = portable.geomspace(
                SHORTEST_SMOOTHING * spacing, max(LONGEST_SMOOTHING, 3.0 * spacing), RELAXATION_LENGTHS
            )
            out[rows] = smoother.fitted(float(lengths[smoother.best_scale(lengths)]))[:, 0]
    return out


@dataclass(frozen=True)
class Scored:
    """The objective and its derivatives at a point, with respect to the free entries of z."""

    objective: float
    gradient: Array
    information: Array
    scores: Array
    """(free, innovations that count): terms of the gradient, without the prior's"""
    by_error: Array
    """(free, innovations that count), whose squares, with those of `by_size`, make the information"""
    by_size: Array


AnyLikelihood = TypeVar("AnyLikelihood", bound=InnovationLikelihood)


class Fit(NamedTuple, Generic[AnyLikelihood]):
    """The most likely point of a log."""

    likelihood: AnyLikelihood
    z: Array
    covariance: Array
    """of the free entries of z"""
    rivals: tuple[Array, ...] = ()
    """points that are as likely, between which z lies; empty where there is one"""


def _squares(rows: Array) -> Array:
    """rows rows'."""
    return product(rows, rows.T)


def _objective(e: Array, s: Array, z: Array) -> float:
    if not (np.isfinite(e).all() and np.isfinite(s).all()) or (s <= 0.0).any():
        return np.inf
    with np.errstate(over="ignore"):
        return float(0.5 * np.sum(e * e / s + portable.log(s)) + 0.5 * np.sum(z * z))
