"""How exact is each QP solver? First-move error against a verified reference, on problems that are drawn hard.

    python benchmarks/qp_accuracy.py                      # 50,000 problems, a few minutes on 2 cores
    python benchmarks/qp_accuracy.py --count 2000 --solver active-set --solver piqp --json

The paper's MPC (single track, zero-order hold, eqs. 9-17) at random speed
1..30 m/s, Ts 0.05..0.1 s, Np 1..55, Nc 1..18, Q 0.1..10, R 0.001..0.1, states up to absurd ones, limits +-pi/12 on
the moves and +-pi/6 on the angle; pulses or Laguerre moves; one in five with soft limits on y. Those of
closed loops: `qp_corpus.py`.

The reference (tests/references/qp_exact.py) proves each of its solutions in exact integer arithmetic. A problem counts
as *missed* when x[0] is off by more than 1e-6 rad and by more than the data allow: the first-order change of x[0] when
every entry of E, K, M and gamma moves by half a unit in its last place ("bound" in the table).
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from importlib import metadata
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests")]

from adaptrack.control.qp import QP, QPStatus, get_qp_solver  # noqa: E402
from references.qp_exact import reference_solve  # noqa: E402
from references.qp_problems import drawn_mpc_problem  # noqa: E402

GOAL = 1e-6  # rad
CHUNK = 500
SOLVERS = {
    "active-set": ("active-set", {}),
    "hildreth": ("hildreth", {"on_uncertified": "apply"}),  # as the paper's authors run it
    "hildreth+exact": ("hildreth", {}),
    "daqp": ("daqp", {"on_uncertified": "hold"}),  # each by itself
    "piqp": ("piqp", {"on_uncertified": "hold"}),
    "clarabel": ("clarabel", {"on_uncertified": "hold"}),
    "osqp": ("osqp", {"on_uncertified": "hold", "max_iter": 20_000}),
}
SHARES = ("solved", "capped", "failed", "within_goal", "limits_active")
DEFAULT_SOLVERS = ("active-set", "hildreth", "hildreth+exact", "daqp")


def drawn_qps(count: int, seed: int) -> Iterator[QP]:
    """Hard problems with the structure of the paper's MPC."""
    rng = np.random.default_rng([20240607, seed])
    for _ in range(count):
        yield QP(*drawn_mpc_problem(rng))


def measure(count: int, seed: int, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Solve ``count`` problems with every solver: arrays of status and first-move error (NaN where there is no x)."""
    solvers = {name: get_qp_solver(SOLVERS[name][0], **SOLVERS[name][1]) for name in names}
    propose = get_qp_solver("active-set")
    facts: dict[str, list[float]] = {key: [] for key in ("condition", "active", "bound", "fallback")}
    for name in names:
        facts[f"{name} status"], facts[f"{name} error"] = [], []
    for qp in drawn_qps(count, seed):
        reference = reference_solve(qp.E, qp.K, qp.M, qp.gamma, np.flatnonzero(propose.solve(qp).lam > 0.0))
        facts["condition"].append(float(np.linalg.cond(qp.E)))
        facts["active"].append(len(reference.active))
        facts["bound"].append(reference.bound)
        facts["fallback"].append(reference.exact)
        for name, solver in solvers.items():
            solution = solver.solve(qp)
            facts[f"{name} status"].append(int(solution.status))
            facts[f"{name} error"].append(abs(solution.x[0] - reference.x[0]))
    return {key: np.array(value, dtype=float) for key, value in facts.items()}


def run(count: int, names: tuple[str, ...], workers: int) -> dict[str, dict[str, np.ndarray]]:
    """All problems, in parallel."""
    with ProcessPoolExecutor(workers) as pool:
        jobs = [pool.submit(measure, min(CHUNK, count - start), start // CHUNK, names)
                for start in range(0, count, CHUNK)]  # fmt: skip
        parts = []
        for done, job in enumerate(jobs, 1):
            parts.append(job.result())
            if sys.stderr.isatty():
                print(f"\r{done * CHUNK:,} of {count:,}", end="\n" * (done == len(jobs)), file=sys.stderr)
    return {"drawn": {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}}


def summarise(results: dict[str, dict[str, np.ndarray]], names: tuple[str, ...]) -> list[dict[str, object]]:
    """One row per half and solver."""
    rows: list[dict[str, object]] = []
    for source, facts in results.items():
        for name in names:
            status, error = facts[f"{name} status"], facts[f"{name} error"]
            there = error[np.isfinite(error)]
            missed = ~(error <= np.maximum(GOAL, facts["bound"]))  # true for NaN
            p50, p99, largest = np.percentile(there, [50, 99, 100]) if there.size else [float("nan")] * 3
            rows.append({
                "problems": source, "solver": name, "count": len(status),
                "solved": float(np.mean(status == QPStatus.SOLVED)),
                "capped": float(np.mean(status == QPStatus.CAPPED)),
                "failed": float(np.mean(status > QPStatus.CAPPED)),
                "error_p50": float(p50), "error_p99": float(p99), "error_max": float(largest),
                "within_goal": float(np.mean(error <= GOAL)),
                "missed": int(missed.sum()),
                "missed_though_solved": int((missed & (status == QPStatus.SOLVED)).sum()),
            })  # fmt: skip
    return rows


def describe(results: dict[str, dict[str, np.ndarray]]) -> list[dict[str, object]]:
    """What the problems are like."""
    return [
        {
            "problems": source,
            "count": len(facts["active"]),
            "limits_active": float(np.mean(facts["active"] > 0)),
            "active_rows_p50": float(np.median(facts["active"])),
            "condition_p50": float(np.median(facts["condition"])),
            "condition_p99": float(np.percentile(facts["condition"], 99)),
            "condition_max": float(facts["condition"].max()),
            "bound_p50": float(np.median(facts["bound"])),
            "bound_p99": float(np.percentile(facts["bound"], 99)),
            "bound_max": float(facts["bound"].max()),
            "bound_above_goal": int((facts["bound"] > GOAL).sum()),
            "reference_by_mpmath": int(facts["fallback"].sum()),
        }
        for source, facts in results.items()
    ]


def machine() -> dict[str, object]:
    """Where and with what this ran."""
    model = next(
        (line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line),
        platform.processor(),
    ) if Path("/proc/cpuinfo").exists() else platform.processor()  # fmt: skip
    packages = ("numba", "numpy", "scipy", "daqp", "osqp", "piqp", "clarabel", "mpmath")
    return {"cpu": model, "cores": os.cpu_count(), "python": platform.python_version()} | {
        name: metadata.version(name) for name in packages if _installed(name)
    }


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True


def table(rows: list[dict[str, object]]) -> str:
    """A Markdown table."""

    def show(head: str, value: object) -> str:
        if head in SHARES and isinstance(value, float):
            return f"{100.0 * value:.4g} %"
        if isinstance(value, float):
            return "0" if value == 0.0 else f"{value:.1e}" if value < 1e-2 or value > 1e4 else f"{value:.3g}"
        return f"{value:,}" if isinstance(value, int) else str(value)

    heads = list(rows[0])
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    lines += ["| " + " | ".join(show(head, row[head]) for head in heads) + " |" for row in rows]
    return "\n".join(lines)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=50_000, help="problems")
    parser.add_argument("--solver", action="append", choices=SOLVERS, help="may be repeated")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    names = tuple(options.solver or DEFAULT_SOLVERS)
    start = time.perf_counter()
    results = run(options.count, names, options.workers)
    report = {
        "rows": summarise(results, names), "problems": describe(results), "machine": machine(),
        "seconds": round(time.perf_counter() - start, 1), "goal_rad": GOAL,
    }  # fmt: skip
    if options.json:
        print(json.dumps(report, indent=1))
        return
    print(table(report["rows"]), table(report["problems"]), sep="\n\n")
    print("\n" + ", ".join(f"{key} {value}" for key, value in report["machine"].items()) + f"; {report['seconds']} s")


if __name__ == "__main__":
    main()
