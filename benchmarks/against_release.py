"""Which numbers of this tree are those of a release to the bit, and by how much do the others differ?

    python benchmarks/against_release.py CHECKOUT [--only rollouts] [--folder against]

CHECKOUT: a checkout of the release with its own environment in `.venv`. Measured in both, same machine: `reproduce`,
`evaluate` on 200 operating points, 100 drives and the tests, 20,000 runs of `rollout_batch` and 20,000 single commands
in two profiles, and the data sets of two small campaigns. What is already in the folder is not measured again.
"""

from __future__ import annotations

import argparse
import inspect
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

RENAMED = {"conditions": "operating points", "told": "known_as", "astray": "off_reference", "move_price": "move_weight",
           "nearness": "modulus_margin", "scheduler": "contender", "lost": "failed", "rung": "contender",
           "rungs": "contenders", "ladders": "comparisons"}  # fmt: skip
"""Keys of a release's JSON and columns by what they became."""
NOT_COMPARED = ("seconds", "step_us", "versions", "adaptrack", "path", "page", "dataset", "command", "verdict")
"""Parts of keys of what differs from run to run or is text."""

CAMPAIGN = """\
vehicle = "paper"
profile = "{profile}"
scenario = "{scenario}"
{more}
seed = 1
[{rows}]
{points}
[search]
{search}
[swarm]
particles = 20
generations = 15
[library]
size = 40
seed = 1
"""
NEVER_FAILED = "[failure]\ndistance = 1000.0\nsideslip = inf\n"
"""The release had no rule for a failed run in campaigns."""
PAPER = {
    "profile": "paper", "scenario": "step", "more": "duration = 18.0",
    "points": 'kind = "grid"\nspeed = [3, 15, 27]\ny_ref = [-10, 2, 8]\nfriction = [0.5, 0.9]\nwind = [-30, 0]',
    "search": "Np = [1, 55]\nNc = [1, 18]\nQ = [0.1, 10.0]\nR = [0.001, 0.1]",
}  # fmt: skip
ROAD = {
    "profile": "road", "scenario": "lane-change", "more": "duration = 8.0\nnoise_seeds = [1, 2, 3]\nchunk = 8",
    "points": 'kind = "sobol"\nn = 24\nseed = 2\nbox = { speed = [3.0, 30.0], y_ref = [-7.0, 7.0], '
              "friction = [0.3, 1.0], wind = [-30.0, 30.0] }",
    "search": "Np = [5, 60]\nNc = [1, 18]\nQ = [1.0, 1.0]\nR = [1.0, 1.0e6]\ndecades = true",
}  # fmt: skip


class Tree(NamedTuple):
    """A checkout to be measured."""

    python: Path
    is_release: bool
    folder: Path
    """where its results go"""

    def run(self, *arguments: str) -> str:
        """Standard output of its interpreter."""
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH" or not self.is_release}
        done = subprocess.run(
            [str(self.python), *arguments], stdout=subprocess.PIPE, text=True, check=True, env=environment,
            cwd=self.folder,
        )  # fmt: skip
        return done.stdout


# -- measurements -----------------------------------------------------------------------------------------------------
def reproduce(tree: Tree) -> dict[str, Any]:
    """Every number of `reproduce --json`."""
    return json.loads(tree.run("-m", "adaptrack", "reproduce", "--out", "reproduce", "--json"))


def evaluate(tree: Tree) -> dict[str, Any]:
    """Every number of `evaluate --json` about the paper's controller; contenders by their kind, as the release."""
    points = "--conditions" if tree.is_release else "--operating-points"
    asked = ["evaluate", "--config", "road", points, "sobol:200", "--drives", "100", "--tests", "--json"]
    found = json.loads(tree.run("-m", "adaptrack", *asked))
    for row in found["rows"]:
        row["contender"] = row.pop("kind", "") or row["contender"]
    return found


def rollouts(tree: Tree) -> dict[str, Any]:
    """Runs and single commands, computed by `measure_rollouts` in the tree's interpreter."""
    tree.run(str(Path(__file__).resolve()), "--measure", "rollouts.npz")
    with np.load(tree.folder / "rollouts.npz") as arrays:
        return {name: arrays[name].tolist() for name in arrays.files}


def campaigns(tree: Tree) -> dict[str, Any]:
    """The columns of two small data sets."""
    import pyarrow.parquet

    found = {}
    for name, settings in (("paper", PAPER), ("road", ROAD)):
        rows = "conditions" if tree.is_release else "operating_points"
        rule = "" if tree.is_release else NEVER_FAILED
        (tree.folder / f"{name}.toml").write_text(CAMPAIGN.format(rows=rows, **settings) + rule)
        tree.run("-m", "adaptrack", "tune", "--config", f"{name}.toml", "--out", f"campaign-{name}", "--json")
        table = pyarrow.parquet.read_table(tree.folder / f"campaign-{name}" / "dataset.parquet")
        found[name] = table.to_pydict()
    return found


MEASUREMENTS: Mapping[str, Callable[[Tree], dict[str, Any]]] = {
    "reproduce": reproduce, "evaluate": evaluate, "rollouts": rollouts, "campaigns": campaigns,
}  # fmt: skip


def measure_rollouts(file: str) -> None:
    """With the package of this interpreter: 20,000 runs, 40 recorded ones, and 20,000 commands of controllers."""
    import adaptrack as at

    rng, found = np.random.default_rng(5), {}
    car = at.load_vehicle("paper")
    published = getattr(at, "published_mpc", at.MPC)  # the release knows no other
    options: dict[str, Any] = {"lost_beyond": 1000.0}
    if "failure" in inspect.signature(at.rollout_batch).parameters:
        options = {"failure": at.Failure(distance=1000.0, sideslip=math.pi)}
    for profile, period, preview in (("paper", 0.1, False), ("road", 0.05, True)):
        plant, scenarios, tunings = at.DualTrack(car, "magic-formula"), *_drawn(at, rng, profile)

        def controller(tuning: Any, period: float = period, preview: bool = preview) -> Any:
            chosen = at.Tuning(int(tuning[0]), int(tuning[1]), float(tuning[2]), float(tuning[3]))
            return published(car, chosen, period=period, preview=preview)

        batch = at.rollout_batch(
            plant, published(car, period=period, preview=preview), scenarios, tunings,
            which=np.repeat(np.arange(500), 20), profile=profile, seeds=np.arange(10_000), **options,
        )  # fmt: skip
        for name in ("mse", "mean_squared_move", "max_abs_error", "steps", "qp_capped", "qp_failed", "held"):
            found[f"{profile} {name}"] = np.asarray(getattr(batch, name))
        for k in range(20):
            run = at.simulate(plant, controller(tunings[37 * k]), scenarios[11 * k], profile=profile, seed=k, **options)
            for name in ("X", "Y", "psi", "vx", "vy", "yaw_rate", "steering", "command", "lateral_acceleration"):
                found[f"{profile} run {k} {name}"] = getattr(run, name)
        found[f"{profile} commands"] = _commands(rng, [controller(tunings[41 * k]) for k in range(10)])
    np.savez(file, **found)


def _drawn(at: Any, rng: np.random.Generator, profile: str) -> tuple[list[Any], np.ndarray]:
    """500 scenarios and 10,000 tunings."""
    between = rng.uniform
    if profile == "paper":
        scenarios = [
            at.load_scenario("step", amplitude=between(-15, 15), speed=between(3, 27), friction=between(0.5, 0.9),
                             wind=between(-30, 30)) for _ in range(500)
        ]  # fmt: skip
        weights = between(0.1, 10, 10_000), between(0.001, 0.1, 10_000)
    else:
        scenarios = [
            at.load_scenario("lane-change", amplitude=between(-7, 7), speed=between(5, 27), friction=between(0.5, 0.9),
                             gust=between(-30, 30)) for _ in range(500)
        ]  # fmt: skip
        weights = np.ones(10_000), 10 ** between(2, 5, 10_000)
    tunings = np.column_stack([rng.integers(10, 56, 10_000), rng.integers(1, 19, 10_000), *weights])
    tunings[:, 1] = np.minimum(tunings[:, 0], tunings[:, 1])
    return scenarios, tunings


def _commands(rng: np.random.Generator, controllers: list[Any]) -> np.ndarray:
    """1,000 steps of each controller on states, speeds and references that jump."""
    states = rng.normal(size=(1000, 4)) * [0.3, 0.05, 0.1, 1.0]
    speeds, references = rng.uniform(1, 30, 1000), rng.uniform(-5, 5, (1000, 60))
    return np.array([
        controller.step(*each)[0] for controller in controllers for each in zip(states, speeds, references, strict=True)
    ])  # fmt: skip


# -- comparison -------------------------------------------------------------------------------------------------------
def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, value) of every number and text in nested JSON, keys by their present names."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{path}/{RENAMED.get(key, key).replace('_', ' ')}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from leaves(inner, f"{path}/{i}")
    else:
        yield path, value


def compare(release: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[str]:
    """One line on what is identical, then one for each key whose values differ or that only one side has."""
    old, new = (
        {path: value for path, value in leaves(side) if not any(part in path for part in NOT_COMPARED)}
        for side in (release, here)
    )
    common = old.keys() & new.keys()
    differing = {path for path in common if not _same(old[path], new[path])}
    yield f"{len(common) - len(differing):,} of {len(old):,} values are identical to the bit"
    groups: dict[str, list[str]] = {}
    for path in differing:
        groups.setdefault("/".join("*" if part.isdigit() else part for part in path.split("/")), []).append(path)
    for name, paths in sorted(groups.items()):
        yield f"  {name}: {len(paths):,} differ, {_difference([(old[p], new[p]) for p in paths])}"
    for side, paths in (("the release", old.keys() - new.keys()), ("this tree", new.keys() - old.keys())):
        names = sorted({"/".join("*" if part.isdigit() else part for part in path.split("/")) for path in paths})
        yield from (f"  {name}: only in {side}" for name in names)


def _same(one: Any, other: Any) -> bool:
    return one == other or (one != one and other != other)


def _difference(pairs: list[tuple[Any, Any]]) -> str:
    numbers = [(a, b) for a, b in pairs if isinstance(a, int | float) and isinstance(b, int | float)]
    if len(numbers) < len(pairs):
        return f"for instance {pairs[0][0]!r} and {pairs[0][1]!r}"
    away = max(abs(a - b) for a, b in numbers)
    relative = max(abs(a - b) / max(abs(a), abs(b)) for a, b in numbers)
    return f"by at most {away:.2g}, relative {relative:.2g}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", type=Path, nargs="?", help="of the release, with its environment in .venv")
    parser.add_argument("--only", choices=list(MEASUREMENTS), action="append", help="by default everything")
    parser.add_argument("--folder", type=Path, default=Path("results/against-release"), help="for the results")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure is not None:
        return measure_rollouts(chosen.measure)
    if chosen.checkout is None:
        parser.error("name the checkout of the release")
    folder = chosen.folder.resolve()
    trees = [
        Tree(chosen.checkout.resolve() / ".venv/bin/python", True, folder / "release"),
        Tree(Path(sys.executable), False, folder / "here"),
    ]
    for name in chosen.only or MEASUREMENTS:
        results = [_result(tree, name) for tree in trees]
        print(f"{name}: ", end="")
        print(*compare(*results), sep="\n", flush=True)
    return None


def _result(tree: Tree, name: str) -> dict[str, Any]:
    """Of a measurement, from the folder where it is done."""
    tree.folder.mkdir(parents=True, exist_ok=True)
    file = tree.folder / f"{name}.json"
    if not file.exists():
        found = MEASUREMENTS[name](tree)
        file.write_text(json.dumps(found))
    return json.loads(file.read_text())


if __name__ == "__main__":
    main()
