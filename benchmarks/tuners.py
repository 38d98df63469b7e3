"""Tuners against tuners: what a search for a controller's constant finds with so many closed loops, on unseen roads.

    python benchmarks/tuners.py [--seeds 5] [--budgets 50 200 1000] [--problems ...] [--methods ...] [--rows FILE]

Problems: the informed MPC on the saloon, LQR on the van, Stanley on the paper's car, all in `road`, and the paper's MPC
on the paper's car there. Each tuning drives two training roads with one noise seed; budgets count closed loops. What is
found is judged on six other roads with two other noise seeds. Lost: searches whose tuning fails a drive there. Regret:
the cost there over the lowest that any search of any method found for the problem, geometric mean over the problems and
seeds whose search is not lost, with its 95 % interval (bootstrap over them). Over the swarm: the cost over that of the
improved swarm's tuning, pair by pair where neither is lost. Training: the regret on the training roads, over all.

Methods, all on the same box, in decades where the space says so, every one by its own rules: the paper's improved swarm
(with about the square root of the tunings as particles), the classic swarm, CMA-ES (cma, sigma 0.3 of the box, from its
middle), CMA-ES from the controller's own tuning (sigma 0.15), differential evolution (scipy, five members per
dimension), TPE (optuna), Bayesian optimisation with expected improvement (bayesian-optimization; Gaussian processes), a
Sobol sequence (scipy). The controller's own tuning is always among what is tried.

Every search is written to the file of `--rows` (a JSON object a line) as it ends; the same command goes on from there.
Needs the extra `bench`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import platform
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from adaptrack.comparison.config import load_drive, load_setting
from adaptrack.control.controllers import MPC
from adaptrack.tuning.constant import mean_costs
from adaptrack.tuning.pso import Swarm, SwarmSettings
from adaptrack.tuning.runs import RunSet
from adaptrack.tuning.spaces import search_space

PROBLEMS = {
    "informed, saloon": ("informed", "midsize-sedan"),
    "lqr, van": ("lqr", "van"),
    "stanley, paper": ("stanley", "paper"),
    "as-written, paper": ("as-written", "paper"),
}
TRAINING = ("country:101", "mountain:101")
JUDGED = ("country:1", "country:2", "mountain:1", "mountain:2", "town:1", "random-drive:1")
LENGTH, DURATION = 700.0, 40.0
TRAINING_SEEDS, SEEDS = (1000,), (0, 1)
EACH = len(TRAINING) * len(TRAINING_SEEDS)
"""Closed loops of a tuning."""


class Spent(Exception):
    """The budget is used up."""


@dataclass
class Problem:
    """A controller whose constant is sought."""

    name: str
    budget: int = 0
    """tunings"""
    tried: list[np.ndarray] = field(default_factory=list)
    costs: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        name, car = PROBLEMS[self.name]
        setting = load_setting(car, "road")
        self.controller: Any = setting.controller(name)
        mpc = MPC(setting.car, profile=setting.profile, preview=True)
        self.training, self.judged = (
            RunSet(
                setting.plant, mpc, [load_drive(road, setting.car, LENGTH, DURATION) for road in roads], setting.profile
            )
            for roads in (TRAINING, JUDGED)
        )
        self.space = search_space(self.controller)
        packed = self.space.packed()
        self.low, self.high = packed[0], packed[1]
        self.free = np.flatnonzero(self.low < self.high)
        self.known: dict[bytes, float] = {}

    @property
    def dims(self) -> int:
        """Free dimensions."""
        return len(self.free)

    def decoded(self, unit: np.ndarray) -> np.ndarray:
        """(n, entries) tunings of positions (n, dims) in the unit cube."""
        rows = np.tile(self.low, (len(unit), 1))
        rows[:, self.free] += np.clip(unit, 0.0, 1.0) * (self.high - self.low)[self.free]
        values = self.space.values(rows)
        for name in self.space.whole:
            i = self.space.names.index(name)
            values[:, i] = np.round(values[:, i])
        if self.space.ordered is not None:
            small, large = (self.space.names.index(name) for name in self.space.ordered)
            values[:, small] = np.minimum(values[:, small], values[:, large])
        return values

    def encoded(self, tuning: np.ndarray) -> np.ndarray:
        """(dims,) the position of a tuning."""
        decades = np.array([name in self.space.decades for name in self.space.names])
        rows = np.where(decades, np.log10(np.maximum(tuning, 1e-300)), tuning)
        return np.clip(((rows - self.low)[self.free]) / (self.high - self.low)[self.free], 0.0, 1.0)

    def begin(self, budget: int) -> None:
        """A search of so many tunings; the controller's own is the first."""
        self.budget, self.tried, self.costs = budget, [], []
        self.of_values(self.controller.packed_tuning()[None])

    def of_values(self, values: np.ndarray) -> np.ndarray:
        """Costs of tunings (n, entries); raises `Spent` when the budget is used up before them."""
        left = self.budget - len(self.costs)
        if left <= 0:
            raise Spent
        costs = mean_costs(self.training, self.controller, values[:left], TRAINING_SEEDS)
        self.tried += list(values[:left])
        self.costs += costs.tolist()
        if len(values) > left:
            raise Spent
        return costs

    def of(self, unit: np.ndarray) -> np.ndarray:
        """Costs of positions (n, dims)."""
        return self.of_values(self.decoded(np.atleast_2d(unit)))

    def judge(self, tuning: np.ndarray) -> float:
        """m^2, of a tuning on the unseen roads."""
        key = tuning.tobytes()
        if key not in self.known:
            self.known[key] = float(mean_costs(self.judged, self.controller, tuning[None], SEEDS)[0])
        return self.known[key]

    def loses(self, tuning: np.ndarray) -> bool:
        """Whether a drive on the unseen roads fails."""
        return self.judge(tuning) >= self.judged.failed_cost / (len(JUDGED) * len(SEEDS))


# -- methods: each searches until the problem is spent ----------------------------------------------------------------
def swarm(problem: Problem, seed: int, kind: str = "improved") -> None:
    """A particle swarm, eqs. (18)-(20) of the paper or the classic one."""
    tunings = problem.budget - 1
    particles = min(20, max(5, round(tunings**0.5)))
    settings = SwarmSettings(kind=kind, particles=particles, generations=max(1, tunings // particles))  # type: ignore[arg-type]
    search = Swarm(problem.space, settings, seed=seed)
    while not search.done:
        search.tell(problem.of_values(search.ask()))


def cma_es(problem: Problem, seed: int, own: bool = False) -> None:
    """CMA-ES, restarted with twice the population when it stops."""
    import cma

    start = problem.encoded(problem.controller.packed_tuning()) if own else np.full(problem.dims, 0.5)
    factor, sigma = 1, 0.15 if own else 0.3
    while True:
        options = {
            "bounds": [0.0, 1.0], "seed": seed * 100 + factor, "verbose": -9,
            "popsize": factor * (4 + int(3 * np.log(problem.dims))),
        }  # fmt: skip
        search = cma.CMAEvolutionStrategy(start, sigma, options)
        while not search.stop():
            asked = search.ask()
            search.tell(asked, problem.of(np.array(asked)).tolist())
        factor, start, sigma = 2 * factor, np.full(problem.dims, 0.5), 0.3


def evolution(problem: Problem, seed: int) -> None:
    """Differential evolution."""
    differential_evolution(
        lambda x: problem.of(x.T), [(0.0, 1.0)] * problem.dims, rng=seed, popsize=5, maxiter=10_000, tol=0.0,
        polish=False, vectorized=True, updating="deferred",
    )  # fmt: skip


def tpe(problem: Problem, seed: int) -> None:
    """Tree-structured Parzen estimator."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True))
    while True:
        trial = study.ask()
        x = np.array([trial.suggest_float(f"x{i}", 0.0, 1.0) for i in range(problem.dims)])
        study.tell(trial, float(np.log(problem.of(x)[0])))


def bayes(problem: Problem, seed: int) -> None:
    """Gaussian processes and expected improvement, on the logarithm of the cost."""
    from bayes_opt import BayesianOptimization
    from bayes_opt.acquisition import ExpectedImprovement

    names = [f"x{i}" for i in range(problem.dims)]
    search = BayesianOptimization(
        None, dict.fromkeys(names, (0.0, 1.0)), acquisition_function=ExpectedImprovement(xi=0.01), random_state=seed,
        verbose=0, allow_duplicate_points=True,
    )  # fmt: skip
    for x in qmc.Sobol(problem.dims, rng=seed).random(8):
        search.register(dict(zip(names, x.tolist(), strict=True)), -float(np.log(problem.of(x)[0])))
    while True:
        asked = search.suggest()
        x = np.array([asked[name] for name in names])
        search.register(asked, -float(np.log(problem.of(x)[0])))


def sobol(problem: Problem, seed: int) -> None:
    """A scrambled Sobol sequence."""
    points = qmc.Sobol(problem.dims, rng=seed)
    while True:
        problem.of(points.random(16))


METHODS: dict[str, Callable[[Problem, int], None]] = {
    "swarm": swarm,
    "classic swarm": lambda problem, seed: swarm(problem, seed, "classic"),
    "cma-es": cma_es,
    "cma-es, own start": lambda problem, seed: cma_es(problem, seed, True),
    "differential evolution": evolution,
    "tpe": tpe,
    "bayes": bayes,
    "sobol": sobol,
}
ANYTIME = {"cma-es", "cma-es, own start", "differential evolution", "tpe", "bayes", "sobol"}
"""Methods that do not know their budget: one search serves all."""
DEAR = {"bayes": 250}
"""Most tunings of methods whose own time grows with the cube of their number."""


def measure(problem: Problem, method: str, budgets: list[int], seed: int) -> list[dict[str, Any]]:
    """What a method finds within each budget of closed loops."""
    tunings = [max(2, budget // EACH) for budget in budgets]
    rows = []
    for group in [tunings] if method in ANYTIME else [[count] for count in tunings]:
        most = max(group)
        begun = time.process_time()
        problem.begin(most)
        with contextlib.suppress(Spent):
            METHODS[method](problem, seed)
        seconds = time.process_time() - begun
        for count in group:
            best = int(np.argmin(problem.costs[:count]))
            rows.append(
                {
                    "problem": problem.name, "method": method, "seed": seed, "budget": budgets[tunings.index(count)],
                    "training": problem.costs[best], "unseen": problem.judge(problem.tried[best]),
                    "lost": problem.loses(problem.tried[best]),
                    "cpu_seconds": seconds * count / most,
                }
            )  # fmt: skip
    return rows


def table(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Regret by method and budget, on the unseen roads and in training."""
    made, rng = [], np.random.default_rng(0)

    def mean(logs: list[float]) -> dict[str, float]:
        logs = logs or [math.nan]  # all searches are lost
        draws = np.exp(rng.choice(logs, (2000, len(logs))).mean(axis=1))
        low, high = np.quantile(draws, (0.025, 0.975)).tolist()
        return {"mean": float(np.exp(np.mean(logs))), "low": low, "high": high}

    swarms = {(row["problem"], row["seed"], row["budget"]): row for row in rows if row["method"] == "swarm"}
    best = {
        (name, key): min(row[key] for row in rows if row["problem"] == name)
        for name in PROBLEMS
        for key in ("unseen", "training")
        if any(row["problem"] == name for row in rows)
    }
    for budget in sorted({row["budget"] for row in rows}):
        for method in METHODS:
            kept = [row for row in rows if row["method"] == method and row["budget"] == budget]
            if not kept:
                continue
            pairs = [(row, swarms.get((row["problem"], row["seed"], budget))) for row in kept if not row["lost"]]
            against = [np.log(row["unseen"] / other["unseen"]) for row, other in pairs if other and not other["lost"]]
            made.append(
                {
                    "budget": budget, "method": method,
                    "regret": mean([np.log(row["unseen"] / best[row["problem"], "unseen"]) for row, _ in pairs]),
                    "over_swarm": mean(against),
                    "lost": sum(row["lost"] for row in kept), "searches": len(kept),
                    "training": mean([np.log(row["training"] / best[row["problem"], "training"]) for row in kept]),
                    "cpu_seconds": float(np.mean([row["cpu_seconds"] for row in kept])),
                }
            )  # fmt: skip
    return made


def main() -> None:
    """Print the table."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=5)
    ask.add_argument("--budgets", nargs="+", type=int, default=[50, 200, 1000])
    ask.add_argument("--problems", nargs="+", default=list(PROBLEMS), choices=list(PROBLEMS))
    ask.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    ask.add_argument("--rows", type=Path, default=Path("tuners.jsonl"))
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    warnings.simplefilter("ignore")
    rows = [json.loads(line) for line in given.rows.read_text().splitlines()] if given.rows.exists() else []
    done = {(row["problem"], row["method"], row["seed"], row["budget"]) for row in rows}
    searches = [
        (name, method, seed) for seed in range(given.seeds) for name in given.problems for method in given.methods
    ]
    problems = {name: Problem(name) for name in given.problems}
    begun = time.monotonic()
    for i, (name, method, seed) in enumerate(searches):
        most = DEAR.get(method, math.inf)
        left = [
            budget for budget in given.budgets if (name, method, seed, budget) not in done and budget // EACH <= most
        ]
        if left:
            found = measure(problems[name], method, left, seed)
            rows += found
            with given.rows.open("a") as kept:
                kept.writelines(json.dumps(row) + "\n" for row in found)
        print(f"{i + 1} of {len(searches)} searches, {time.monotonic() - begun:.0f} s", end="\r", file=sys.stderr)
    made = table(rows)
    if given.json:
        print(json.dumps({"machine": platform.platform(), "rows": rows, "table": made}))
        return
    print(f"{platform.machine()}, {given.seeds} searches of each of {len(given.problems)} problems")
    for row in made:
        regret, over, training = (
            f"{row[key]['mean']:.3f} [{row[key]['low']:.2f}, {row[key]['high']:.2f}]"
            for key in ("regret", "over_swarm", "training")
        )
        print(
            f"{row['budget']:5d} loops  {row['method']:24s} regret {regret}  over the swarm {over}  "
            f"lost {row['lost']} of {row['searches']}  training {training}  {row['cpu_seconds']:.1f} CPU s"
        )


if __name__ == "__main__":
    main()
