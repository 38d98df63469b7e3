"""Any registered QP solver on the corpus of the controllers' problems: wrong first moves, infeasible ones told, effort.

    python benchmarks/qp_solvers.py --solver active-set --size 200000
    python benchmarks/qp_solvers.py --solver daqp --solver piqp --solver clarabel --size 4000

The corpus is `tools.qp_corpus`, from a seed. The truth is `tests/references/qp_exact.py`: its solutions are
proved in exact integer arithmetic (all optimality conditions to 1e-25), and what has no solution is proved so by two
opposite rows that contradict each other, exactly, or by a dual method of 80 digits. *Wrong*: the first move of an
answer that is called solved is off by more than 1e-6 rad; *beyond the data*: also by more than half a unit in the
last place of every number of the problem can do. *Missed*: no answer for a feasible problem. *Uncertified*: an answer
that may steer, with a scaled residual above 1e-6. *In the loop*: the first moves of the plans that the controllers
made of recorded problems, from warm starts and kept factors. Changes: of the active set (or the solver's own
iterations). The exit code is 1 when the first solver has wrong or uncertified answers, or calls a feasible problem
infeasible, or an infeasible one solved.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from fractions import Fraction
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "tests")]

from tools.qp_corpus import CHUNK, chunk  # noqa: E402

from adaptrack.control.qp import QP, QPStatus, get_qp_solver, list_qp_solvers  # noqa: E402
from references.qp_exact import Infeasible, Reference, reference_solve  # noqa: E402

GOAL = 1e-6
COUNTS = ("count", "solved", "wrong", "beyond the data", "missed", "infeasible", "told", "falsely told", "uncertified")


def truth(qp: QP, propose) -> Reference | None:
    """The solution, None where there is none."""
    if np.array_equal(qp.M[0], -qp.M[3]) and Fraction(float(qp.gamma[0])) + Fraction(float(qp.gamma[3])) < 0:
        return None
    try:
        return reference_solve(qp.E, qp.K, qp.M, qp.gamma, np.flatnonzero(propose.solve(qp).lam > 0.0))
    except Infeasible:
        return None


class Tally:
    """What a solver does with a class of problems."""

    def __init__(self) -> None:
        self.counts = dict.fromkeys(COUNTS, 0)
        self.errors: list[float] = []
        self.changes: list[int] = []
        self.times: list[float] = []

    def take(self, qp: QP, reference: Reference | None, solution, seconds: float) -> None:
        """One answer."""
        own = self.counts
        own["count"] += 1
        self.changes.append(solution.iterations)
        self.times.append(seconds)
        solved, told = solution.status is QPStatus.SOLVED, solution.status is QPStatus.INFEASIBLE
        own["solved"] += solved
        own["uncertified"] += bool(solution.usable and not solution.residuals.worst <= GOAL)
        if reference is None:
            own["infeasible"] += 1
            own["told"] += told
            own["wrong"] += solved
            return
        own["falsely told"] += told
        own["missed"] += not solved
        if solved:
            error = abs(float(qp.M[0] @ (solution.x - reference.x)))
            self.errors.append(error)
            own["wrong"] += error > GOAL
            own["beyond the data"] += error > max(GOAL, reference.bound * float(np.abs(qp.M[0]).sum()))

    def row(self, solver: str, kind: str) -> str:
        """Of the table."""
        p50, p99, most = np.percentile(self.changes, [50, 99, 100])
        error = max(self.errors, default=float("nan"))
        cells = [solver, kind, *(f"{value:,}" for value in self.counts.values()), f"{error:.1e}",
                 f"{p50:.0f}, {p99:.0f}, {most:.0f}", f"{1e6 * np.median(self.times):.0f}"]  # fmt: skip
        return "| " + " | ".join(cells) + " |"


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--solver", action="append", choices=list_qp_solvers(), help="may be repeated")
    parser.add_argument("--size", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="stop after so many and print what there is"
    )
    chosen = parser.parse_args()
    names = chosen.solver or ["active-set"]
    solvers = {name: get_qp_solver(name) if name == "active-set" else get_qp_solver(name, on_uncertified="hold")
               for name in names}  # fmt: skip
    propose, tallies, begun = get_qp_solver("active-set"), dict[tuple[str, str], Tally](), time.monotonic()
    loop, wrong_in_loop, most_in_loop = 0, 0, 0.0
    for number in range(-(-chosen.size // CHUNK)):
        if time.monotonic() - begun > 60.0 * chosen.minutes:
            print(f"the time is up after {number * CHUNK:,} problems")
            break
        for problem in chunk(number, chosen.seed)[: chosen.size - number * CHUNK]:
            reference = truth(problem.qp, propose)
            if problem.feasible is not None and problem.feasible != (reference is not None):
                raise AssertionError(f"a problem of class {problem.kind} is not what it was made for")
            if reference is not None and np.isfinite(problem.applied):
                error = abs(problem.applied - float(problem.qp.M[0] @ reference.x))
                loop, wrong_in_loop, most_in_loop = loop + 1, wrong_in_loop + (error > GOAL), max(most_in_loop, error)
            for name, solver in solvers.items():
                start = time.perf_counter()
                solution = solver.solve(problem.qp)
                seconds = time.perf_counter() - start
                for kind in (problem.kind, "all"):
                    tallies.setdefault((name, kind), Tally()).take(problem.qp, reference, solution, seconds)
        if number % 20 == 19:
            print(f"{(number + 1) * CHUNK:,} in {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    print("| solver | class | " + " | ".join(COUNTS) + " | largest error (rad) | changes p50, p99, max | µs p50 |")
    print("|" + "---|" * (len(COUNTS) + 5))
    for (name, kind), tally in sorted(tallies.items()):
        print(tally.row(name, kind))
    print(f"\nin the loop: {loop:,} first moves, {wrong_in_loop} wrong, largest error {most_in_loop:.1e} rad")
    own = tallies[names[0], "all"].counts
    bad = own["wrong"] + own["uncertified"] + own["falsely told"] + wrong_in_loop
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
