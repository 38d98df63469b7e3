"""Table of a comparison, with one entry for each contender, car, road and noise seed, and its statistics.

Contenders are compared in three steps: the mean of a measure over the noise seeds, the geometric mean of the ratio to a
reference contender over cars and roads, and a bootstrap interval that resamples cars and roads.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.base.statistics import Ratio, geometric_mean, ratio, regret_percentiles
from adaptrack.core.maths.portable import Array
from adaptrack.drive.failure import FailureLimits

WITH = " + "
"""Text between the names of a controller and its driver."""
CELL_AXES = ("car", "road", "seed")
"""Axes of the entries of one contender."""


@dataclass(frozen=True)
class ContenderRole:
    """Properties of a contender, for tables."""

    controller: str = "mpc"
    """Name of the controller."""
    adapts: bool = True
    """As `Contender.adapts`."""
    hindsight: bool = False
    """As `Contender.hindsight`."""
    tuning: str = ""
    """Kind of tuning: "default", "tuned", "scheduled", or the file of a tuning."""


def check_names(contenders: Sequence[str], reference: str) -> None:
    """Raise `InvalidInput` for equal names of contenders, and for a reference that is no contender."""
    if len(set(contenders)) < len(contenders):
        raise InvalidInput(f"contenders: {', '.join(contenders)}: two have the same name.")
    if reference not in contenders:
        raise InvalidInput(f"reference: {reference!r} is not among the contenders {', '.join(contenders)}.")


def label_of(contender: str, tuning: str) -> str:
    """Return the label of a contender with a kind of tuning, see `ContenderRole.tuning`."""
    return contender if tuning == "scheduled" else f"{contender}, {tuning}"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs of contenders on the same cars and roads with the same noise, in one profile."""

    contenders: tuple[str, ...]
    cars: tuple[str, ...]
    roads: tuple[str, ...]
    """Names of roads, scenarios, operating points or random drives; they may repeat."""
    seeds: tuple[int, ...]
    """Seeds of the sensor noise."""
    cells: Mapping[str, NDArray[Any]]
    """Entries by measure, (contenders, cars, roads, seeds), with NaN for missing runs or measures.

    - `cost`: J (m^2); for a failed run the failure distance squared.
    - `failed`: 0 or 1, or the share of failed seeds if the seeds are not separate.
    - Optionally the measures of `compare.RUN`.
    """
    reference: str
    """Contender that ratios refer to."""
    roles: Mapping[str, ContenderRole] = field(default_factory=dict)
    """Properties by contender."""
    overall: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Shares of all control steps by contender and counter, such as those in which a guard changed the tuning."""
    where: Array = field(default_factory=lambda: np.empty((0, 0)))
    """Coordinates of the roads, (roads, k): operating points, or the numbers of the drives."""
    over: tuple[str, ...] = ("road",)
    """Axes that the bootstrap resamples. A measure is first averaged over the other axes."""
    failure: FailureLimits = field(default_factory=FailureLimits)
    """Rule by which a run fails."""
    _tables: dict[tuple[str, str], Array] = field(default_factory=dict, init=False, repr=False)
    _ratios: dict[tuple[str, str, str], Ratio] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        check_names(self.contenders, self.reference)

    # -- constructors -------------------------------------------------------------------------------------------------
    @classmethod
    def from_runs(
        cls, runs: Mapping[str, Mapping[str, ArrayLike]], reference: str, *, car: str = "",
        roads: Sequence[str] | None = None, seeds: Sequence[int] | None = None, where: ArrayLike | None = None,
        roles: Mapping[str, ContenderRole] | None = None, overall: Mapping[str, Mapping[str, float]] | None = None,
        over: tuple[str, ...] = ("road",), failure: FailureLimits | None = None,
    ) -> Comparison:  # fmt: skip
        """Return a comparison on one car from entries by contender and measure, each (roads, seeds) or (roads,).

        The other arguments are the fields of these names. Roads, seeds and coordinates `where` are indices by default.
        """
        arrays = {
            contender: {name: np.asarray(values) for name, values in measures.items()}
            for contender, measures in runs.items()
        }
        names = dict.fromkeys(name for measures in arrays.values() for name in measures)
        cells = {
            name: np.stack([np.atleast_2d(measures[name].T).T for measures in arrays.values()])[:, None]
            for name in names
        }
        n, m = cells["cost"].shape[2:]
        return cls(
            tuple(runs), (car,), tuple(map(str, range(n) if roads is None else roads)),
            tuple(range(m) if seeds is None else map(int, seeds)), cells, reference, roles or {}, overall or {},
            np.arange(n, dtype=float)[:, None] if where is None else np.asarray(where, dtype=float), over,
            failure or FailureLimits(),
        )  # fmt: skip

    @classmethod
    def from_columns(cls, columns: Mapping[str, NDArray[Any]], preferred: Sequence[str] = ()) -> Comparison:
        """Return a comparison from columns "contender", "tuning", "car", "road", "seed" and measures, each (runs,).

        The reference is the first of the `preferred` labels among the contenders, otherwise the first contender.
        """
        pairs = list(zip(columns["contender"].tolist(), columns["tuning"].tolist(), strict=True))
        roles = {
            label_of(contender, tuning): ContenderRole(contender, tuning == "scheduled", tuning=tuning)
            for contender, tuning in dict.fromkeys(pairs)
        }
        positions = {(role.controller, role.tuning): i for i, role in enumerate(roles.values())}
        labels, indices = {}, [np.array([positions[pair] for pair in pairs])]
        for axis in CELL_AXES:
            labels[axis], axis_indices = np.unique(columns[axis], return_inverse=True)
            indices.append(axis_indices)
        shape = (len(roles), *(len(labels[axis]) for axis in CELL_AXES))
        cells = {}
        for name in set(columns) - {"contender", "tuning", "profile", *CELL_AXES}:
            is_text = columns[name].dtype.kind == "U"
            cells[name] = np.full(shape, "", columns[name].dtype) if is_text else np.full(shape, np.nan)
            cells[name][tuple(indices)] = columns[name]
        reference = next((label for label in preferred if label in roles), next(iter(roles), ""))
        cars, roads, seeds = (labels[axis].tolist() for axis in CELL_AXES)
        over = ("seed",) if len(cars) * len(roads) == 1 else ("car", "road")
        return cls(tuple(roles), tuple(cars), tuple(roads), tuple(map(int, seeds)), cells, reference, roles, over=over)

    # -- statistics ---------------------------------------------------------------------------------------------------
    def of(self, name: str, measure: str) -> NDArray[Any]:
        """Return a measure of a contender's runs, (cars, roads, seeds)."""
        return np.asarray(self.cells[measure][self.contenders.index(name)])

    def table(self, name: str, measure: str = "cost") -> Array:
        """Return a measure of a contender along the axes `over`, averaged over the other axes.

        Missing runs are NaN. Measures other than `cost` and `failed` are set to the failure distance in failed runs.
        """
        if (name, measure) not in self._tables:
            values = self.of(name, measure)
            if measure not in ("cost", "failed"):
                values = np.where(self.of(name, "failed") > 0.0, self.failure.distance, values)
            present = np.isfinite(values)
            total, count = np.where(present, values, 0.0), present.astype(float)
            for axis in reversed(range(len(CELL_AXES))):
                if CELL_AXES[axis] not in self.over:
                    total, count = total.sum(axis=axis), count.sum(axis=axis)
            self._tables[name, measure] = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0.0)
        return self._tables[name, measure]

    @property
    def costs(self) -> dict[str, Array]:
        """The `table` of the cost (m^2) by contender."""
        return {name: self.table(name) for name in self.contenders}

    @property
    def failures(self) -> dict[str, Array]:
        """The share of noise seeds with a failure, by contender."""
        return {name: self.table(name, "failed") for name in self.contenders}

    def regret(self, name: str) -> Array:
        """Return the cost of a contender divided by that of the reference, along the axes `over`."""
        return self.table(name) / self.table(self.reference)

    def ratio(self, name: str, other: str, measure: str = "cost") -> Ratio:
        """Return the geometric mean of the ratio of a measure to that of another contender, with its 95 % interval.

        Raises
        ------
        InvalidInput
            When the contenders have no run in common.
        """
        key = name, other, measure
        if key not in self._ratios:
            self._ratios[key] = ratio(self.table(name, measure), self.table(other, measure))
        return self._ratios[key]

    def mean_ratio(self, name: str, other: str) -> float:
        """Return the geometric mean of the ratio of the cost to that of another contender."""
        return geometric_mean(_finite_values(self.table(name) / self.table(other)))

    def ranks(self, measure: str = "rms_error") -> dict[str, int]:
        """Return the rank of each contender: 1 + number of contenders that are better with 95 % confidence.

        A contender is better if the interval of its ratio to the ranked one lies below 1. Several may share a rank.
        """
        return {
            name: 1 + sum(self.ratio(other, name, measure).high < 1.0 for other in self.contenders if other != name)
            for name in self.contenders
        }

    # -- contenders ---------------------------------------------------------------------------------------------------
    def role(self, name: str) -> ContenderRole:
        """Return the properties of a contender."""
        return self.roles.get(name, ContenderRole())

    @property
    def adaptive(self) -> list[str]:
        """The names of the contenders that adapt and were not optimised in hindsight."""
        return [name for name in self.contenders if self.role(name).adapts and not self.role(name).hindsight]

    # -- rows ---------------------------------------------------------------------------------------------------------
    def rows(self) -> list[dict[str, Any]]:
        """Return one row for each contender: cost, regret with its 95 % interval and percentiles, and failures."""
        return [self._row(name) for name in self.contenders]

    def _row(self, name: str) -> dict[str, Any]:
        regret, costs = self.ratio(name, self.reference), _finite_values(self.table(name))
        return {
            "contender": name,
            "controller": self.role(name).controller,
            "runs": len(costs),
            "cost_geomean": geometric_mean(costs),
            "regret_geomean": regret.mean,
            "regret_low": regret.low,
            "regret_high": regret.high,
            **{f"regret_{key}": value for key, value in regret_percentiles(_finite_values(self.regret(name))).items()},
            "failures": int((self.table(name, "failed") > 0.0).sum()),
            **self.overall.get(name, {}),
        }

    def __repr__(self) -> str:
        return f"<Comparison of {len(self.contenders)} contenders on {self.table(self.reference).size} runs>"

    def plot(self) -> Any:
        """Return a matplotlib figure of the cost ratio of each contender to the reference, with 95 % intervals."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """Return the HTML form of the comparison for a notebook."""
        return html_of(self)


def _finite_values(values: Array) -> Array:
    """Return the finite values, (n,)."""
    return values[np.isfinite(values)]


# -- rows of all measures ---------------------------------------------------------------------------------------------
def standing_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one row for each contender, sorted by the rank of its RMS error.

    A row contains, over all runs of the contender:

    - the rank (see `Comparison.ranks`), and the ratios of RMS error and cost to the reference with their intervals;
    - the RMS of the RMS errors, the median of the 95th percentiles of the error and the largest corner error (m);
    - the RMS steering rate (rad/s);
    - the 95th percentiles of lateral acceleration (m/s^2) and jerk (m/s^3);
    - the numbers of runs and failures.
    """
    ranks = comparison.ranks()
    rows = [_standing(comparison, name, ranks[name]) for name in comparison.contenders]
    return sorted(rows, key=lambda row: (row["rank"], row["rms_ratio"]))


def _standing(comparison: Comparison, name: str, rank: int) -> dict[str, Any]:
    rms, cost = comparison.ratio(name, comparison.reference, "rms_error"), comparison.ratio(name, comparison.reference)
    role, failed = comparison.role(name), comparison.of(name, "failed")
    return {
        "contender": role.controller, "tuning": role.tuning, "label": name, "rank": rank,
        "rms_ratio": rms.mean, "rms_low": rms.low, "rms_high": rms.high,
        "cost_ratio": cost.mean, "cost_low": cost.low, "cost_high": cost.high,
        "rms_error": _rms(comparison.of(name, "rms_error")),
        "p95_error": _percentile(comparison.of(name, "p95_error"), 50.0),
        "max_corner": _percentile(comparison.of(name, "max_corner"), 100.0),
        "steering_rate": _rms(comparison.of(name, "steering_rate")),
        "acceleration": _percentile(comparison.of(name, "acceleration"), 95.0),
        "jerk": _percentile(comparison.of(name, "jerk"), 95.0),
        "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
    }  # fmt: skip


def driver_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """Return one row for each controller with a driver, in the order of the comparison, without a rank.

    A row contains the numbers of runs and failures, and `DRIVER_SUMMARIES` of the runs that did not fail.
    """
    rows = []
    for name in comparison.contenders:
        failed, role = comparison.of(name, "failed"), comparison.role(name)
        controller, _, driver = role.controller.partition(WITH)
        row: dict[str, Any] = {
            "label": name, "controller": controller if role.tuning == "default" else label_of(controller, role.tuning),
            "driver": driver, "runs": int(np.isfinite(failed).sum()), "failures": int(np.nansum(failed)),
        }  # fmt: skip
        for measure, summary in DRIVER_SUMMARIES.items():
            values = comparison.of(name, measure)[failed == 0.0]
            row[measure] = float(summary(values[np.isfinite(values)])) if np.isfinite(values).any() else None
        rows.append(row)
    return rows


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values * values))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], percent: float) -> float:
    return float(np.nanpercentile(values, percent)) if np.isfinite(values).any() else float("nan")


DRIVER_SUMMARIES: dict[str, Callable[[NDArray[Any]], Any]] = {
    "time_lost": lambda values: round(float(np.mean(values)), 2) + 0.0,  # a control period is 0.05 s
    "way_driven": np.mean, "speed_error": _rms, "rms_error": _rms, "max_error": np.max,
    "longitudinal_jerk": partial(_percentile, percent=95.0), "used_grip": np.max, "stop_error": np.max,
}  # fmt: skip
"""Function that summarises a measure over the runs."""
