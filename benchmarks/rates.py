"""How fast are batches and steps of a checkout, and how fast beside another one?

    python benchmarks/rates.py CHECKOUT [--against OTHER] [--pairs 15] [--only published ...] [--json FILE]

Batches of the published MPC in the paper's scenario, of the informed MPC in `road` and `production` and of the learning
one in `road`, on one and two threads, and single steps called from Python on what drives had given. CPU time of the
process, all threads, per control step; of steps from Python, all but the first of each drive, median and 99.9th
percentile. A pair is two new processes, one per checkout, that take turns case by case, in the other order in the next
pair; every measurement follows a warm-up that is not counted.

The ratio is OTHER's time over CHECKOUT's: above 1 CHECKOUT is faster. Printed with it: the interval of the median by
the sign test, at least 95 % sure from 6 pairs on; with fewer it is the range, and how sure that is. What one of the two
lacks is skipped and said. Only public functions are called, which 0.1.0 had as well, or had not.
"""

from __future__ import annotations

import argparse
import gc
import inspect
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

WORKER = "--worker"
ONE_BLAS_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
TUNINGS = 20
"""of each operating point of the paper's"""
DURATION = 20.0
"""s, of a random drive"""
FIRST_DRIVE = 9_400_000
WARM_UP = 0.2
"""share of a measurement that goes before it uncounted"""


class Case(NamedTuple):
    """What is timed."""

    controller: str
    profile: str
    runs: int
    """of a batch; drives that are given again to single steps"""
    threads: int
    """0: single steps from Python"""

    @property
    def name(self) -> str:
        """How tables call it."""
        where = f"{self.controller}, {self.profile}"
        if self.threads == 0:
            return f"{where}, step from Python"
        return f"{where}, {self.runs:,} runs, {self.threads} thread{'s' * (self.threads > 1)}"


CASES = (
    *(Case("published", "paper", 3_000, threads) for threads in (1, 2)),
    Case("published", "paper", 20_000, 2),
    *(Case("informed", "road", 600, threads) for threads in (1, 2)),
    *(Case("informed", "production", 600, threads) for threads in (1, 2)),
    *(Case("learning", "road", 200, threads) for threads in (1, 2)),
    Case("published", "paper", 40, 0),
    Case("informed", "road", 20, 0),
    Case("learning", "road", 20, 0),
)


# -- in the process that has a checkout on its path -------------------------------------------------------------------
def controller(at: Any, kind: str, profile: str) -> Any:
    """A controller of the paper's car; None where this version has none."""
    car, knows_more = at.load_vehicle("paper"), hasattr(at, "published_mpc")
    if kind == "published":
        return at.published_mpc(car) if knows_more else at.MPC(car)
    if not knows_more or (kind == "learning" and not hasattr(at, "Learning")):
        return None
    return at.MPC(car, profile=profile, **({"learning": at.Learning()} if kind == "learning" else {}))


def scenarios(at: Any, case: Case, count: int) -> list[Any]:
    """Steps of the reference at random operating points of the paper's domain, or random drives."""
    if case.profile != "paper":
        return [at.random_drive(FIRST_DRIVE + number, DURATION) for number in range(count)]
    draw = np.random.default_rng(0).uniform
    return [
        at.load_scenario("step", amplitude=float(draw(-15.0, 15.0)), speed=float(draw(3.0, 27.0)),
                         friction=float(draw(0.5, 0.9)), wind=float(draw(-30.0, 30.0)))
        for _ in range(count)
    ]  # fmt: skip


def never_failed(at: Any, function: Callable[..., Any]) -> dict[str, Any]:
    """Options with which no run ends early."""
    if "lost_beyond" in inspect.signature(function).parameters:
        return {"lost_beyond": 1e6}
    return {"failure": at.Failure(distance=1e6, sideslip=math.inf)}


def batch(at: Any, case: Case) -> Callable[[float], dict[str, float]]:
    """Drives a share of a batch, from sampling its scenarios on."""
    mpc, plant = controller(at, case.controller, case.profile), at.DualTrack(at.load_vehicle("paper"), "magic-formula")
    options = {**never_failed(at, at.rollout_batch), "profile": case.profile, "threads": case.threads}
    each = TUNINGS if case.profile == "paper" else 1
    driven = scenarios(at, case, case.runs // each)
    rng = np.random.default_rng(1)
    drawn = [
        rng.integers(1, 55, case.runs, endpoint=True), rng.integers(1, 18, case.runs, endpoint=True),
        rng.uniform(0.1, 10.0, case.runs), rng.uniform(0.001, 0.1, case.runs),
    ]  # fmt: skip
    tunings = np.column_stack(drawn)
    tunings[:, 1] = np.minimum(tunings[:, 0], tunings[:, 1])

    def measure(share: float) -> dict[str, float]:
        points = max(1, round(share * len(driven)))
        count = points * each
        chosen = {"tunings": tunings[:count]} if case.profile == "paper" else {}
        which, seeds = np.repeat(np.arange(points), each), np.arange(count)
        wall, cpu = time.perf_counter(), time.process_time()
        found = at.rollout_batch(plant, mpc, driven[:points], which=which, seeds=seeds, **chosen, **options)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        return {"cpu_s": cpu, "wall_s": wall, "steps": int(found.steps.sum())}

    return measure


def single_steps(at: Any, case: Case) -> Callable[[float], dict[str, float]]:
    """Gives a controller again what it was given on drives."""
    plant = at.DualTrack(at.load_vehicle("paper"), "magic-formula")
    drives: list[list[tuple[Any, ...]]] = []
    for number, scenario in enumerate(scenarios(at, case, case.runs)):
        mpc, given = controller(at, case.controller, case.profile), []
        own = mpc.step

        def recording(*arguments: Any, own: Any = own, given: Any = given, **named: Any) -> Any:
            state, speed, reference, *_ = arguments
            given.append((np.array(state), speed, np.array(reference[:128])))
            return own(*arguments, **named)

        mpc.step = recording
        at.simulate(plant, mpc, scenario, profile=case.profile, seed=number, **never_failed(at, at.simulate))
        drives.append(given)

    def measure(share: float) -> dict[str, float]:
        times, clock = [], time.thread_time_ns
        empty = float(np.median([clock() - clock() for _ in range(2000)]))
        for given in drives[: max(1, round(share * len(drives)))]:
            step = controller(at, case.controller, case.profile).step
            gc.collect()
            gc.disable()
            step(*given[0])  # makes what the others find made
            for arguments in given[1:]:
                begun = clock()
                step(*arguments)
                times.append(clock() - begun + empty)
            gc.enable()
        return {
            "p50_us": float(np.median(times)) / 1e3, "p99.9_us": float(np.percentile(times, 99.9)) / 1e3,
            "steps": len(times),
        }  # fmt: skip

    return measure


def work() -> None:
    """Answer requests for measurements, a line of JSON each, until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    import adaptrack as at

    def answer(**values: Any) -> None:
        answers.write(json.dumps(values) + "\n")
        answers.flush()

    versions = {"python": platform.python_version(), "numpy": np.__version__, "numba": _version("numba")}
    cases = [number for number, case in enumerate(CASES) if controller(at, case.controller, case.profile) is not None]
    answer(package=str(Path(at.__file__).parent), versions={"adaptrack": at.__version__, **versions}, cases=cases)
    prepared: dict[int, Callable[[float], dict[str, float]]] = {}
    for line in sys.stdin:
        number, share = json.loads(line)
        if number not in prepared:
            prepared[number] = (batch if CASES[number].threads else single_steps)(at, CASES[number])
        answer(**prepared[number](share))


def _version(package: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


# -- in the process that compares -------------------------------------------------------------------------------------
class Tree(NamedTuple):
    """A checkout, and what runs it."""

    checkout: Path
    python: str
    cache: Path

    @property
    def commit(self) -> str:
        """Short, with a + where files differ from it; empty without git."""
        asked = ["git", "-C", str(self.checkout), "describe", "--always", "--exclude=*", "--dirty=+"]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        return done.stdout.strip()


class Worker:
    """A process with a checkout on its path. Use it as a context: it ends with it."""

    def __init__(self, tree: Tree) -> None:
        environment = {
            **os.environ, **ONE_BLAS_THREAD, "PYTHONPATH": str(tree.checkout / "src"),
            "NUMBA_CACHE_DIR": str(tree.cache),
        }  # fmt: skip
        self.process = subprocess.Popen(
            [tree.python, str(Path(__file__).resolve()), WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            text=True, env=environment,
        )  # fmt: skip
        self.said = self._answer()
        if not Path(self.said["package"]).is_relative_to(tree.checkout):
            raise SystemExit(f"{tree.checkout}: adaptrack is taken from {self.said['package']} instead.")

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("a measuring process has ended; what it said is above.")
        return json.loads(line)

    def measure(self, number: int, share: float = 1.0) -> dict[str, Any]:
        """A share of a case."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps([number, share]) + "\n")
        self.process.stdin.flush()
        return self._answer()


class Progress:
    """Says on standard error how far the measurements are, and how long they will still take."""

    def __init__(self, of: int) -> None:
        self.of, self.done, self.begun, self.said = of, 0, time.monotonic(), 0.0

    def step(self, what: str) -> None:
        """One more is done."""
        self.done += 1
        now = time.monotonic()
        left = (now - self.begun) / self.done * (self.of - self.done)
        text = f"{self.done} of {self.of} measurements, {left / 60.0:.1f} min left: {what}"
        if sys.stderr.isatty():
            print(f"\r\033[K{text}", end="" if self.done < self.of else "\n", file=sys.stderr, flush=True)
        elif now - self.said > 20.0 or self.done == self.of:
            print(text, file=sys.stderr, flush=True)
            self.said = now


def measure_all(trees: list[Tree], cases: list[int], pairs: int) -> dict[int, list[list[dict[str, Any]]]]:
    """Case -> for each pair the measurement of each tree, in the order of the trees."""
    found: dict[int, list[list[dict[str, Any]]]] = {number: [] for number in cases}
    progress = Progress(pairs * len(cases) * len(trees))
    for pair in range(pairs):
        order = list(range(len(trees)))[:: -1 if pair % 2 else 1]
        workers: dict[int, Worker] = {}
        try:
            for place in order:
                workers[place] = Worker(trees[place])
            for number in cases:
                row: list[dict[str, Any]] = [{} for _ in trees]
                for place in order:
                    workers[place].measure(number, WARM_UP)
                    row[place] = workers[place].measure(number)
                    progress.step(f"pair {pair + 1}, {CASES[number].name}")
                found[number].append(row)
        finally:
            for worker in workers.values():
                worker.__exit__()
    return found


def prepare(trees: list[Tree], only: list[str]) -> tuple[list[int], list[dict[str, str]]]:
    """Compile what will be measured: the cases that all trees have, and the versions of each."""
    wanted = [number for number, case in enumerate(CASES) if not only or case.controller in only]
    versions = []
    for tree in trees:
        begun = time.monotonic()
        with Worker(tree) as worker:
            for number in sorted({*wanted} - {*worker.said["cases"]}):
                print(f"skipped, {tree.checkout} has no such controller: {CASES[number].name}", file=sys.stderr)
            wanted = [number for number in wanted if number in worker.said["cases"]]
            versions.append({**worker.said["versions"], "commit": tree.commit})
            for number in wanted:
                worker.measure(number, 0.0)
        print(f"{tree.checkout}: compiled and loaded, {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    return wanted, versions


def median_interval(values: list[float]) -> tuple[float, float, float, float]:
    """Median, bounds of its interval by the sign test (the narrowest of 95 %, else the range), how sure that is."""
    ordered, n = sorted(values), len(values)
    below = [sum(math.comb(n, i) for i in range(k)) / 2.0**n for k in range(n // 2 + 1)]
    k = max([k for k in range(1, n // 2 + 1) if below[k] <= 0.025], default=1)
    sure = 1.0 - 2.0 * below[k] if n > 1 else 0.0
    return float(np.median(ordered)), ordered[k - 1], ordered[n - k], sure


def per_step(case: Case, measured: dict[str, Any]) -> float:
    """CPU microseconds of a control step."""
    return measured["p50_us"] if case.threads == 0 else 1e6 * measured["cpu_s"] / measured["steps"]


def rows(found: dict[int, list[list[dict[str, Any]]]]) -> Iterator[dict[str, Any]]:
    """A row for each case."""
    for number, pairs in found.items():
        case = CASES[number]
        row: dict[str, Any] = {"case": case.name, **case._asdict(), "measured": pairs}
        for place, label in enumerate(("this", "other")[: len(pairs[0])]):
            mine = [pair[place] for pair in pairs]
            row[f"cpu_us_per_step_{label}"] = float(np.median([per_step(case, each) for each in mine]))
            if case.threads:
                row[f"steps_per_s_{label}"] = float(np.median([each["steps"] / each["wall_s"] for each in mine]))
            else:
                row[f"p99.9_us_{label}"] = float(np.median([each["p99.9_us"] for each in mine]))
        if len(pairs[0]) == 2:
            ratios = [per_step(case, other) / per_step(case, this) for this, other in pairs]
            row["ratios"] = ratios
            row["ratio"], row["low"], row["high"], row["sure"] = median_interval(ratios)
            row["same_steps"] = all(this["steps"] == other["steps"] for this, other in pairs)
        yield row


def table(found: list[dict[str, Any]]) -> Iterator[str]:
    """Lines for people."""
    width = max(len(row["case"]) for row in found)
    for row in found:
        text = f"{row['case']:{width}s}"
        for label in ("this", "other"):
            if f"cpu_us_per_step_{label}" in row:
                text += f"  {label}: {row[f'cpu_us_per_step_{label}']:.3f} us"
                rate, tail = row.get(f"steps_per_s_{label}"), row.get(f"p99.9_us_{label}")
                text += f" ({rate:,.0f} steps/s)" if rate else f" (p99.9 {tail:.1f} us)"
        if "ratio" in row:
            text += f"  ratio {row['ratio']:.3f} [{row['low']:.3f}, {row['high']:.3f}] ({100.0 * row['sure']:.0f} %)"
            text += "" if row["same_steps"] else "  NOT the same number of steps"
        yield text


def machine() -> dict[str, Any]:
    """Processor and cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"cpu": names[0] if names else platform.processor(), "cores": usable, "system": platform.platform()}


def main() -> None:
    """Measure, print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--python", default=sys.executable, help="runs CHECKOUT")
    parser.add_argument("--python-against", help="runs the other one; by default the same")
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument("--only", nargs="+", default=[], choices=sorted({case.controller for case in CASES}))
    parser.add_argument("--cache", type=Path, help="folder of compiled kernels, one in it per checkout; else temporary")
    parser.add_argument("--json", type=Path, help="file for every measurement")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        base = (asked.cache or Path(temporary)).resolve()
        runs = [(asked.checkout.resolve(), asked.python)]
        if asked.against is not None:
            runs.append((asked.against.resolve(), asked.python_against or asked.python))
        trees = [Tree(checkout, python, base / f"checkout-{runs.index((checkout, python))}")
                 for checkout, python in runs]  # fmt: skip
        cases, versions = prepare(trees, asked.only)
        if not cases:
            raise SystemExit("nothing to measure: no case that all checkouts have.")
        found = list(rows(measure_all(trees, cases, asked.pairs)))
    here = machine()
    print(f"{here['cpu']}, {here['cores']} cores, {here['system']}")
    for label, tree, version in zip(("this", "other"), trees, versions, strict=False):
        print(f"{label}: {tree.checkout}, " + ", ".join(f"{name} {value}" for name, value in version.items()))
    if len(trees) == 2:
        print(f"ratio: CPU time per step of other over this, median of {asked.pairs} pairs; above 1 this is faster")
    print(*table(found), sep="\n")
    if asked.json is not None:
        named = [{"checkout": str(tree.checkout), **version} for tree, version in zip(trees, versions, strict=True)]
        asked.json.write_text(json.dumps({"machine": here, "trees": named, "pairs": asked.pairs, "rows": found}))


if __name__ == "__main__":
    work() if sys.argv[1:] == [WORKER] else main()
