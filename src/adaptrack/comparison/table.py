"""The table of a comparison: one cell for each contender, car, road and noise seed, and its statistics.

Everything that compares contenders fills such a table, and says from it who is better, by how much, and how sure that
is: a mean over the noise seeds, a geometric mean of ratios over cars and roads, and an interval that draws these anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.base.statistics import Ratio, geometric_mean, ratio, regret_percentiles
from adaptrack.drive.failure import Failure

Array = NDArray[np.float64]

CELL_AXES = ("car", "road", "seed")
"""Of the cells of one contender."""


@dataclass(frozen=True)
class ContenderRole:
    """Controller and kind of a contender, for tables."""

    controller: str = "mpc"
    adapts: bool = True
    hindsight: bool = False
    tuning: str = ""
    """default, tuned, scheduled, or the file of a tuning"""


def check_names(contenders: Sequence[str], reference: str) -> None:
    """Refuse contenders of one name, and a reference that is none of them.

    Raises
    ------
    InvalidInput
        With the names.
    """
    if len(set(contenders)) < len(contenders):
        raise InvalidInput(f"contenders: {', '.join(contenders)}: two have the same name.")
    if reference not in contenders:
        raise InvalidInput(f"reference: {reference!r} is not among the contenders {', '.join(contenders)}.")


def label_of(contender: str, tuning: str) -> str:
    """The label of a contender with a tuning: default, tuned, scheduled, or the file of a tuning."""
    return contender if tuning == "scheduled" else f"{contender}, {tuning}"


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs of contenders on the same cars and roads with the same noise, in one profile."""

    contenders: tuple[str, ...]
    cars: tuple[str, ...]
    roads: tuple[str, ...]
    """roads, scenarios, operating points or random drives; two may have one name"""
    seeds: tuple[int, ...]
    """of the noise"""
    cells: Mapping[str, NDArray[Any]]
    """by measure, (contenders, cars, roads, seeds); NaN where nothing was driven or could be measured. In any case:
    `cost` (m^2, J; a failed run as the square of the distance at which it fails) and `failed` (0 or 1, or the share of
    seeds that are not distinguished). Of runs measured in full also those of `measures.RUN`."""
    reference: str
    """the contender that ratios are taken to"""
    roles: Mapping[str, ContenderRole] = field(default_factory=dict)
    """by contender"""
    overall: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """by contender, what is measured over the steps of all its runs: shares in which a schedule's inputs were clipped,
    its guard stepped in, ...; `measures.OVERALL`"""
    where: Array = field(default_factory=lambda: np.empty((0, 0)))
    """(roads, k) numbers that tell the roads apart: operating points, or the numbers of drives"""
    over: tuple[str, ...] = ("road",)
    """the axes that an interval draws; a measure is averaged over the others first"""
    failure: Failure = field(default_factory=Failure)
    """when a run has failed"""
    _tables: dict[tuple[str, str], Array] = field(default_factory=dict, init=False, repr=False)
    _ratios: dict[tuple[str, str, str], Ratio] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        check_names(self.contenders, self.reference)

    # -- made of ------------------------------------------------------------------------------------------------------
    @classmethod
    def from_runs(
        cls, runs: Mapping[str, Mapping[str, ArrayLike]], reference: str, *, car: str = "",
        roads: Sequence[str] | None = None, seeds: Sequence[int] | None = None, where: ArrayLike | None = None,
        roles: Mapping[str, ContenderRole] | None = None, overall: Mapping[str, Mapping[str, float]] | None = None,
        over: tuple[str, ...] = ("road",), failure: Failure | None = None,
    ) -> Comparison:  # fmt: skip
        """Make a comparison on one car; runs: by contender and measure, (roads, seeds) or (roads,).

        roads, seeds: by default their numbers; where: by default the numbers of the roads; the rest: see the fields.
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
            failure or Failure(),
        )  # fmt: skip

    @classmethod
    def from_columns(cls, columns: Mapping[str, NDArray[Any]], preferred: Sequence[str] = ()) -> Comparison:
        """Make a comparison from rows of runs; columns: (runs,): contender, tuning, car, road, seed, measures.

        preferred: the first of these that drove is the reference, else the first contender.
        """
        pairs = list(zip(columns["contender"].tolist(), columns["tuning"].tolist(), strict=True))
        roles = {
            label_of(contender, tuning): ContenderRole(contender, tuning == "scheduled", tuning=tuning)
            for contender, tuning in dict.fromkeys(pairs)
        }
        positions = {(role.controller, role.tuning): i for i, role in enumerate(roles.values())}
        labels, at = {}, [np.array([positions[pair] for pair in pairs])]
        for axis in CELL_AXES:
            labels[axis], places = np.unique(columns[axis], return_inverse=True)
            at.append(places)
        shape = (len(roles), *(len(labels[axis]) for axis in CELL_AXES))
        cells = {}
        for name in set(columns) - {"contender", "tuning", "profile", *CELL_AXES}:
            texts = columns[name].dtype.kind == "U"
            cells[name] = np.full(shape, "", columns[name].dtype) if texts else np.full(shape, np.nan)
            cells[name][tuple(at)] = columns[name]
        reference = next((label for label in preferred if label in roles), next(iter(roles), ""))
        cars, roads, seeds = (labels[axis].tolist() for axis in CELL_AXES)
        over = ("seed",) if len(cars) * len(roads) == 1 else ("car", "road")
        return cls(tuple(roles), tuple(cars), tuple(roads), tuple(map(int, seeds)), cells, reference, roles, over=over)

    # -- statistics ---------------------------------------------------------------------------------------------------
    def of(self, name: str, measure: str) -> NDArray[Any]:
        """(cars, roads, seeds) a measure of a contender's runs."""
        return np.asarray(self.cells[measure][self.contenders.index(name)])

    def table(self, name: str, measure: str = "cost") -> Array:
        """A measure of a contender along the axes `over`, mean over the others; NaN where it did not drive.

        Of an error (m) a failed run counts as the distance at which it fails.
        """
        if (name, measure) not in self._tables:
            values = self.of(name, measure)
            if measure not in ("cost", "failed"):
                values = np.where(self.of(name, "failed") > 0.0, self.failure.distance, values)
            there = np.isfinite(values)
            total, count = np.where(there, values, 0.0), there.astype(float)
            for axis in reversed(range(len(CELL_AXES))):
                if CELL_AXES[axis] not in self.over:
                    total, count = total.sum(axis=axis), count.sum(axis=axis)
            self._tables[name, measure] = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0.0)
        return self._tables[name, measure]

    @property
    def costs(self) -> dict[str, Array]:
        """By contender, m^2, `table` of the cost."""
        return {name: self.table(name) for name in self.contenders}

    @property
    def failures(self) -> dict[str, Array]:
        """By contender, the share of the noise seeds with which it failed."""
        return {name: self.table(name, "failed") for name in self.contenders}

    def regret(self, name: str) -> Array:
        """The cost over the reference's."""
        return self.table(name) / self.table(self.reference)

    def ratio(self, name: str, other: str, measure: str = "cost") -> Ratio:
        """The geometric mean of a measure over another contender's, where both drove, and its 95 % interval.

        Raises
        ------
        InvalidInput
            When they drove nothing in common.
        """
        key = name, other, measure
        if key not in self._ratios:
            self._ratios[key] = ratio(self.table(name, measure), self.table(other, measure))
        return self._ratios[key]

    def mean_ratio(self, name: str, other: str) -> float:
        """That of the cost without the interval."""
        return geometric_mean(_finite_values(self.table(name) / self.table(other)))

    def ranks(self, measure: str = "rms_error") -> dict[str, int]:
        """1 + the number of others that are better with an interval below 1; equal ranks are level."""
        return {
            name: 1 + sum(self.ratio(other, name, measure).high < 1.0 for other in self.contenders if other != name)
            for name in self.contenders
        }

    # -- who ----------------------------------------------------------------------------------------------------------
    def role(self, name: str) -> ContenderRole:
        """Controller and kind of a contender."""
        return self.roles.get(name, ContenderRole())

    @property
    def adaptive(self) -> list[str]:
        """The contenders whose tuning changes, and not by hindsight."""
        return [name for name in self.contenders if self.role(name).adapts and not self.role(name).hindsight]

    # -- rows ---------------------------------------------------------------------------------------------------------
    def rows(self) -> list[dict[str, Any]]:
        """One row for each contender: cost, regret and its spread, a 95 % bootstrap interval of its mean, failures.

        `views` has what tables of other kinds show.
        """
        return [self._row(name) for name in self.contenders]

    def _row(self, name: str) -> dict[str, Any]:
        over, costs = self.ratio(name, self.reference), _finite_values(self.table(name))
        return {
            "contender": name,
            "controller": self.role(name).controller,
            "runs": len(costs),
            "cost_geomean": geometric_mean(costs),
            "regret_geomean": over.mean,
            "regret_low": over.low,
            "regret_high": over.high,
            **{f"regret_{key}": value for key, value in regret_percentiles(_finite_values(self.regret(name))).items()},
            "failures": int((self.table(name, "failed") > 0.0).sum()),
            **self.overall.get(name, {}),
        }

    def __repr__(self) -> str:
        return f"<Comparison of {len(self.contenders)} contenders on {self.table(self.reference).size} runs>"

    def plot(self) -> Any:
        """Each contender's cost over the reference's with its 95 % interval, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The comparison in a notebook."""
        return html_of(self)


def _finite_values(values: Array) -> Array:
    """(n,) those that are there."""
    return values[np.isfinite(values)]


def _plain(values: Any) -> Any:
    """Nested lists for strict JSON: NaN as None."""
    if isinstance(values, list):
        return [_plain(value) for value in values]
    return None if isinstance(values, float) and not math.isfinite(values) else values


def finite(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows ready for strict JSON."""
    return [{key: _plain(value) for key, value in row.items()} for row in rows]
