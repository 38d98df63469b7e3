"""Who stands where in a side-by-side: ratios to a reference with their intervals, and ranks only where these part.

A ratio is a geometric mean over cars and roads, of means over the noise seeds. Cars and roads are both drawn anew in
each resample, independently of each other (the pigeonhole bootstrap: A. B. Owen, "The pigeonhole bootstrap", Annals of
Applied Statistics 1 (2007) 386-411), so an interval says what to expect on other cars and other roads, as far as so few
can tell. A failed run counts as an error of the distance at which a run fails, and as its square in the cost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.comparison.statistics import RESAMPLES, Ratio
from adaptrack.drive.failure import DISTANCE

Array = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]


class Who(NamedTuple):
    """A contender with its default, its tuned or its scheduled tuning."""

    contender: str
    tuning: str

    @property
    def label(self) -> str:
        """For tables."""
        return self.contender if self.tuning == "scheduled" else f"{self.contender}, {self.tuning}"


@dataclass(frozen=True, eq=False)
class Standing:
    """The rows of a side-by-side in one profile."""

    columns: Columns
    """by name, (runs,): contender, tuning, car, road, seed and the measures, see `side_by_side.run_cell`"""
    reference: Who
    _ratios: dict[Any, Ratio] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if self.reference not in self.everyone:
            raise InvalidInput(f"standing: {self.reference.label} has driven nothing here.")

    @property
    def everyone(self) -> list[Who]:
        """In the order of the rows."""
        pairs = zip(self.columns["contender"].tolist(), self.columns["tuning"].tolist(), strict=True)
        return [Who(*pair) for pair in dict.fromkeys(pairs)]

    def of(self, who: Who) -> Columns:
        """The rows of one."""
        kept = (self.columns["contender"] == who.contender) & (self.columns["tuning"] == who.tuning)
        return {name: values[kept] for name, values in self.columns.items()}

    def table(self, who: Who, measure: str) -> Array:
        """(cars, roads) mean of a measure over the noise seeds; NaN where one did not drive.

        measure: "cost" (m^2), or "rms_error" (m), for which a failed run counts as `failure.DISTANCE`.
        """
        rows = self.of(who)
        values = rows[measure].astype(float)
        if measure != "cost":
            values = np.where(rows["failed"] > 0.0, DISTANCE, values)
        cars, roads = (np.unique(self.columns[name]) for name in ("car", "road"))
        where = np.searchsorted(cars, rows["car"]), np.searchsorted(roads, rows["road"])
        total, count = np.zeros((len(cars), len(roads))), np.zeros((len(cars), len(roads)))
        np.add.at(total, where, values)
        np.add.at(count, where, 1.0)
        return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0.0)

    def ratio(self, who: Who, other: Who, measure: str = "rms_error") -> Ratio:
        """A measure of one over another's on the cars and roads that both drove, with its 95 % interval.

        Raises
        ------
        InvalidInput
            When they drove none in common.
        """
        key = who, other, measure
        if key not in self._ratios:
            logs = np.log(self.table(who, measure) / self.table(other, measure))
            if not np.isfinite(logs).any():
                raise InvalidInput(f"standing: {who.label} and {other.label} drove nothing in common.")
            self._ratios[key] = pigeonhole(logs, np.random.default_rng(0x9160))
        return self._ratios[key]

    def ranks(self, measure: str = "rms_error") -> dict[Who, int]:
        """1 + the number of others that are better with an interval below 1; equal ranks are not told apart."""
        everyone = self.everyone
        return {
            who: 1 + sum(self.ratio(other, who, measure).high < 1.0 for other in everyone if other != who)
            for who in everyone
        }

    def rows(self) -> list[dict[str, Any]]:
        """One row for each, from the best RMS error to the worst; errors in m over all samples' runs."""
        ranks = self.ranks()
        made = [self._row(who, ranks[who]) for who in self.everyone]
        return sorted(made, key=lambda row: (row["rank"], row["rms_ratio"]))

    def _row(self, who: Who, rank: int) -> dict[str, Any]:
        rows = self.of(who)
        over, cost = self.ratio(who, self.reference), self.ratio(who, self.reference, "cost")
        return {
            "contender": who.contender, "tuning": who.tuning, "label": who.label, "rank": rank,
            "rms_ratio": over.mean, "rms_low": over.low, "rms_high": over.high,
            "cost_ratio": cost.mean, "cost_low": cost.low, "cost_high": cost.high,
            "rms_error": _rms(rows["rms_error"]), "p95_error": _percentile(rows["p95_error"], 50.0),
            "max_corner": _percentile(rows["max_corner"], 100.0), "steering_rate": _rms(rows["steering_rate"]),
            "acceleration": _percentile(rows["acceleration"], 95.0), "jerk": _percentile(rows["jerk"], 95.0),
            "runs": len(rows["failed"]), "failures": int(rows["failed"].sum()),
        }  # fmt: skip


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def _percentile(values: NDArray[Any], which: float) -> float:
    return float(np.nanpercentile(values, which)) if np.isfinite(values).any() else float("nan")


def pigeonhole(logs: Array, rng: np.random.Generator) -> Ratio:
    """exp of the mean of logarithms (rows, columns), and its interval; rows and columns are drawn independently.

    NaN: not there. A resample that holds nothing is left out.
    """
    there = np.isfinite(logs)
    values = np.where(there, logs, 0.0)
    shape = logs.shape
    weights = [
        rng.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).astype(float) if n > 1 else np.ones((RESAMPLES, 1))
        for n in shape
    ]
    total = np.einsum("bi,ij,bj->b", weights[0], values, weights[1])
    count = np.einsum("bi,ij,bj->b", weights[0], there.astype(float), weights[1])
    means = total[count > 0.0] / count[count > 0.0]
    low, high = np.percentile(np.exp(means), [2.5, 97.5])
    return Ratio(float(np.exp(logs[there].mean())), float(low), float(high))


def standings(columns: Columns, preferred: Sequence[Who]) -> dict[str, Standing]:
    """By profile, in the order of the rows; the reference is the first of the preferred who drove there, or anyone.

    Raises
    ------
    InvalidInput
        When there are no rows.
    """
    found = {}
    for profile in dict.fromkeys(columns["profile"].tolist()):
        kept = columns["profile"] == profile
        part = {name: values[kept] for name, values in columns.items()}
        drove = dict.fromkeys(zip(part["contender"].tolist(), part["tuning"].tolist(), strict=True))
        first = next((each for each in preferred if tuple(each) in drove), Who(*next(iter(drove))))
        found[profile] = Standing(part, first)
    if not found:
        raise InvalidInput("standings: no rows.")
    return found
