"""Which numbers of this tree are those of another checkout to the bit, and by how much do the others differ?

    python benchmarks/against_release.py CHECKOUT [--only drive] [--folder results/against-release]
    python benchmarks/against_release.py --compare FOLDER FOLDER

CHECKOUT: another state of the repository, its kernels compiled; it runs in its own `.venv`, or, where it has none, in
this interpreter. Both answer the same questions, `COMMANDS` with `--json`, each in a folder of its own, and `ARRAYS`
from Python. An answer that is already in the folder is not sought again; the answers of two folders are compared value
by value. The exit code is 1 where anything differs.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

RENAMED: Mapping[str, str] = {
    "mean_offset": "mean_error", "rms_offset": "rms_error", "p95_offset": "p95_error", "max_offset": "max_abs_error",
    "rms_heading": "heading_rms", "max_heading": "heading_max", "max_yaw_rate": "yaw_rate_max",
    "rms_wheel_angle": "wheel_angle_rms", "rms_command_rate": "steering_rate_rms",
    "rms_acceleration": "lateral_acceleration_rms", "max_acceleration": "lateral_acceleration_max",
    "max_acceleration_r79": "lateral_acceleration_r79", "rms_jerk": "jerk_rms", "max_jerk": "jerk_max",
    "max_jerk_r79": "jerk_r79",
}  # fmt: skip
"""Keys of the other checkout's JSON, and columns of its data sets, by what they became."""
NOT_COMPARED = ("seconds", "step us", "versions", "adaptrack", "path", "page", "dataset", "command", "verdict")
"""Parts of keys of what differs from run to run or is text."""

CAMPAIGN = """\
vehicle = "paper"
profile = "{profile}"
scenario = "{scenario}"
{more}
seed = 1
[operating_points]
{points}
[search]
{search}
[swarm]
particles = 20
generations = 15
[library]
size = 40
seed = 1
[failure]
distance = 1000.0
sideslip = inf
"""
PAPER = {
    "profile": "paper", "scenario": "step", "more": "duration = 18.0",
    "points": 'kind = "grid"\nspeed = [3, 15, 27]\ny_ref = [-10, 2, 8]\nfriction = [0.5, 0.9]\nwind = [-30, 0]',
    "search": "Np = [1, 55]\nNc = [1, 18]\nQ = [0.1, 10.0]\nR = [0.001, 0.1]",
}  # fmt: skip
ROAD = {
    "profile": "road", "scenario": "lane-change",
    "more": 'duration = 8.0\nnoise_seeds = [1, 2, 3]\nchunk = 8',
    "points": 'kind = "sobol"\nn = 24\nseed = 2\nbox = { speed = [3.0, 30.0], y_ref = [-7.0, 7.0], '
              "friction = [0.3, 1.0], wind = [-30.0, 30.0] }",
    "search": "Np = [5, 60]\nNc = [1, 18]\nQ = [1.0, 1.0]\nR = [1.0, 1.0e6]\ndecades = true",
}  # fmt: skip
SMALL_CAMPAIGN = """\
profile = "road"
scenario = "lane-change"
noise_seeds = [1]
seed = 2
[operating_points]
kind = "sobol"
n = 24
seed = 2
box = { speed = [8.0, 25.0], y_ref = [-4.0, 4.0], friction = [0.5, 1.0], wind = [-15.0, 15.0] }
[search]
Np = [10, 40]
Nc = [1, 10]
Q = [1.0, 1.0]
R = [1.0, 1.0e6]
decades = true
[swarm]
particles = 4
generations = 2
[library]
tunings = [[25, 5, 1, 300], [30, 5, 1, 3000], [30, 8, 1, 10000], [35, 5, 1, 100000]]
"""
SMALL_ADAPTATION = """\
campaign = "small-campaign.toml"
[learning]
inputs = ["speed", "friction"]
rounds = 2
operating_points = 16
drives = 8
hard_drives = 8
rules = 4
[learning.domain]
speed = [3.0, 30.0]
friction = [0.3, 1.0]
[method.runs]
held_out_points = 8
held_out_drives = 2
[method.constants]
evaluations = 20
[method.recipe]
nn_epochs = 20
anfis_epochs = 2
[evaluation]
operating_points = 8
drives = 8
known_as = ["exact"]
"""


class Question(NamedTuple):
    """A command whose JSON is an answer."""

    command: str
    """what follows `adaptrack`, as this tree spells it; {log}, {track}, ...: what `given_files` wrote"""
    formerly: str = ""
    """the same as the other checkout spells it, where it differs"""


def scenario_question(words: str) -> Question:
    """A drive of scenarios, which other checkouts call simulate."""
    return Question(f"drive {words}", f"simulate {words}")


SCHEDULERS = ("road-nn", "road-anfis", "road-best-constant", "road-look-up")

COMMANDS: Mapping[str, Mapping[str, Question]] = {
    "reproduce": {"paper": Question("reproduce --out paper")},
    "compare": {"quick": Question("compare --config quick --out compared", "compare --quick --out compared"),
                "lane-change": Question("compare --lane-change iso3888-2 --vehicle compact-ev --budget 0",
                                        "manoeuvre obstacle-avoidance --vehicle compact-ev --no-tune")},
    "evaluate": {
        "as-written": Question(
            "evaluate-schedules --operating-points sobol:100 --drives 200 --tests",
            "evaluate-schedules --controller as-written --operating-points sobol:100 --drives 200 --tests"),
        "noisy": Question(
            "evaluate-schedules --drives 40 --known-as noisy --known-as withheld",
            "evaluate-schedules --controller as-written --drives 40 --known-as noisy --known-as withheld"),
    },
    "certify": {
        **{name: Question(f"certify {name}") for name in SCHEDULERS},
        "default": Question("certify"),
        "sedan": Question("certify --vehicle midsize-sedan --mismatch --speed 10 25"),
        "standard": Question("certify --controller standard --profile paper"),
        "feasible": Question("certify --feasible --speed 10 20 --friction 0.5 0.9"),
    },
    "tune": {
        "sedan": Question(
            "tune midsize-sedan --road mountain --road town --length 600 --runs 160 --out sedan",
            "tune mountain town --vehicle midsize-sedan --length 600 --runs 160 --out sedan.toml"),
        "van-lqr": Question(
            "tune van --road country --length 600 --controller lqr --runs 160 --out van",
            "tune country --vehicle van --length 600 --controller lqr --runs 160 --out van.toml"),
        "compact-ev": Question("tune compact-ev --out compact", "adapt compact-ev --out compact"),
    },
    "adapt": {
        "config": Question("adaptation {adaptation} --out chain", "adapt --config {adaptation} --out chain"),
    },
    "scenarios": {
        "paper": scenario_question("triple-lane-change general-trajectory --controller standard --allow-failed"),
        "as-released": scenario_question("triple-lane-change --controller as-released"),
        "informed": scenario_question("triple-lane-change random-drive double-lane-change --profile road"),
        "production": scenario_question("random-drive -o seed=3 --profile production --vehicle compact-ev --learn"),
        "scheduled": scenario_question("random-drive -o seed=1 --profile road --scheduler road-nn"),
        "tuned": scenario_question("lane-change --profile road --np 30 --nc 10 --q 1 --r 3000 --solver hildreth"),
        **{name: scenario_question(f"random-drive --profile road --vehicle midsize-sedan --controller {name}")
           for name in ("lqr", "pure-pursuit", "stanley", "preview-lqr", "kinematic-mpc")},
        "single-track": scenario_question("sine --plant single-track --tyre constant-stiffness --driver"),
    },
    "drive": {
        "mountain": Question("drive mountain --road-seed 2 --vehicle midsize-sedan"),
        "town-learning": Question("drive town --vehicle van --profile production --learn"),
        "lap": Question("drive lap --laps 2 --vehicle sports-car --lateral-acceleration 5"),
        "points": Question("drive {track} --vehicle compact-ev --controller preview-lqr"),
        "windy": Question("drive country --wind 8 --start-offset 0.5 --driver --controller lqr --allow-failed"),
        "sheet": Question("drive motorway --vehicle {sheet} --learn"),
    },
    "identify": {"drive": Question("identify {log} --car {sheet} --out found.toml"),
                 "little": Question("identify {log} --mass 1500 --wheelbase 2.7 --out found.toml")},
    "road": {**{kind: Question(f"road check {kind} --road-seed 3")
                for kind in ("motorway", "country", "town", "mountain", "lap")},
             "points": Question("road check {track} --vehicle van"),
             "noisy": Question("road check {noisy}")},
    "learning": {"train-nn": Question("train --data paper-grid --model nn --out nn.json"),
                 "describe": Question("dataset describe road-sobol")},
    "lists": {"names": Question("list"),
              "datasets": Question("dataset list"),
              "car": Question("car --mass 1450 --wheelbase 2.65 --out my-car.toml")},
}  # fmt: skip
"""Commands by group and name."""
CAMPAIGN_COMMAND = Question(
    "campaign {name}.toml --out campaign-{name} --json", "tune --config {name}.toml --out campaign-{name} --json"
)
ARRAYS = ("rollouts", "campaigns")
"""What is measured from Python and in data sets."""


class Tree(NamedTuple):
    """A checkout that answers."""

    checkout: Path
    is_other: bool
    folder: Path
    """where its answers go"""

    def run(self, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Of its interpreter; it finds the package of its checkout."""
        own = self.checkout / ".venv/bin/python"
        environment = os.environ | {"PYTHONPATH": str(self.checkout / "src"), "COLUMNS": "200"}
        return subprocess.run(
            [str(own if own.exists() else sys.executable), *arguments],
            capture_output=True, text=True, check=False, env=environment, cwd=folder,
        )  # fmt: skip


def ask(tree: Tree, group: str, name: str) -> dict[str, Any]:
    """The answer of a tree to a question: exit code and JSON of a command, or arrays as lists."""
    folder = tree.folder / group / name
    folder.mkdir(parents=True, exist_ok=True)
    if group == "arrays":
        return {"rollouts": rollouts, "campaigns": campaigns}[name](tree, folder)
    question = COMMANDS[group][name]
    given = {key: str(path) for key, path in given_files(tree).items()}
    arguments = shlex.split(spelled(tree, question).format_map(given))
    done = tree.run(folder, "-m", "adaptrack", *arguments, "--json")
    try:
        found = json.loads(done.stdout)
    except ValueError:
        sys.exit(f"adaptrack {shlex.join(arguments)}: code {done.returncode}, no JSON\n{done.stderr[-2000:]}")
    return {"exit code": done.returncode, "answer": found}


def spelled(tree: Tree, question: Question) -> str:
    """The command as a tree knows it."""
    return (question.formerly if tree.is_other else "") or question.command


def controller_key(tree: Tree) -> str:
    """The key of a campaign that other checkouts need to tune the paper's controller."""
    return 'controller = "as-written"\n' if tree.is_other else ""


def given_files(tree: Tree) -> dict[str, Path]:
    """What the commands read, made once: a road with and without noise, a data sheet, a log, a small adaptation.

    Data sheet and log are made by the tree itself: where its runs differ, so do the answers.
    """
    given = tree.folder / "given"
    names = {"track": "track.csv", "noisy": "noisy.csv", "sheet": "sheet.toml", "adaptation": "small.toml",
             "log": "drive/random-drive-informed.parquet"}  # fmt: skip
    paths = {key: given / name for key, name in names.items()}
    if given.exists():
        return paths
    given.mkdir(parents=True)
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    points = np.column_stack([220.0 * np.sin(angle) + 25.0 * np.sin(3.0 * angle), 130.0 * np.cos(angle)])
    noise = np.random.default_rng(1).normal(0.0, 0.1, points.shape)
    for name, track in (("track", points), ("noisy", points + noise)):
        np.savetxt(paths[name], track, delimiter=",", header="x,y", comments="", fmt="%.4f")
    (given / "small-campaign.toml").write_text(controller_key(tree) + SMALL_CAMPAIGN)
    paths["adaptation"].write_text(SMALL_ADAPTATION)
    sheet = "car --mass 1500 --wheelbase 2.7 --out sheet.toml"
    verb = "simulate" if tree.is_other else "drive"
    log = f"{verb} random-drive --profile road --vehicle midsize-sedan --out drive"
    for command in (sheet, log):
        done = tree.run(given, "-m", "adaptrack", *shlex.split(command))
        if done.returncode:
            sys.exit(f"adaptrack {command}: code {done.returncode}\n{done.stderr[-2000:]}")
    return paths


# -- arrays -----------------------------------------------------------------------------------------------------------
def rollouts(tree: Tree, folder: Path) -> dict[str, Any]:
    """Runs and single commands, computed by `measure_rollouts` in the tree's interpreter."""
    done = tree.run(folder, str(Path(__file__).resolve()), "--measure", "rollouts.npz")
    if done.returncode:
        sys.exit(done.stderr[-2000:])
    with np.load(folder / "rollouts.npz") as arrays:
        return {name: arrays[name].tolist() for name in arrays.files}


def campaigns(tree: Tree, folder: Path) -> dict[str, Any]:
    """The columns of two small data sets."""
    import pyarrow.parquet

    found = {}
    for name, settings in (("paper", PAPER), ("road", ROAD)):
        (folder / f"{name}.toml").write_text(controller_key(tree) + CAMPAIGN.format(**settings))
        done = tree.run(folder, "-m", "adaptrack", *shlex.split(spelled(tree, CAMPAIGN_COMMAND).format(name=name)))
        if done.returncode:
            sys.exit(done.stderr[-2000:])
        table = pyarrow.parquet.read_table(folder / f"campaign-{name}" / "dataset.parquet")
        found[name] = {column: values for column, values in table.to_pydict().items() if column not in NOT_COMPARED}
    return found


def measure_rollouts(file: str) -> None:
    """With the package of this interpreter: 20,000 runs, 40 recorded ones, and 20,000 commands of controllers."""
    import adaptrack as at

    rng, found = np.random.default_rng(5), {}
    car = at.load_vehicle("paper")
    failure = at.Failure(distance=1000.0, sideslip=np.pi)
    for profile, period, preview in (("paper", 0.1, False), ("road", 0.05, True)):
        plant, scenarios, tunings = at.DualTrack(car, "magic-formula"), *_drawn(at, rng, profile)

        def controller(tuning: Any, period: float = period, preview: bool = preview) -> Any:
            chosen = at.Tuning(int(tuning[0]), int(tuning[1]), float(tuning[2]), float(tuning[3]))
            return at.published_mpc(car, chosen, period=period, preview=preview)

        batch = at.rollout_batch(
            plant, at.published_mpc(car, period=period, preview=preview), scenarios, tunings,
            which=np.repeat(np.arange(500), 20), profile=profile, seeds=np.arange(10_000), failure=failure,
        )  # fmt: skip
        for name in ("mse", "mean_squared_move", "max_abs_error", "steps", "qp_capped", "qp_failed", "held"):
            found[f"{profile} {name}"] = np.asarray(getattr(batch, name))
        for k in range(20):
            run = at.simulate(
                plant, controller(tunings[37 * k]), scenarios[11 * k], profile=profile, seed=k, failure=failure
            )
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


def compare(other: Any, here: Any) -> Iterator[str]:
    """One line on what is identical, then one for each key whose values differ or that only one side has."""
    old, new = (
        {path: value for path, value in leaves(side) if not any(part in path for part in NOT_COMPARED)}
        for side in (other, here)
    )
    common = old.keys() & new.keys()
    differing = {path for path in common if not _same(old[path], new[path])}
    yield f"{len(common) - len(differing):,} of {len(old):,} values are identical to the bit"
    groups: dict[str, list[str]] = {}
    for path in differing:
        groups.setdefault(_kind(path), []).append(path)
    for name, paths in sorted(groups.items()):
        yield f"  {name}: {len(paths):,} differ, {_difference([(old[p], new[p]) for p in sorted(paths)])}"
    for side, paths in (("the other", old.keys() - new.keys()), ("this tree", new.keys() - old.keys())):
        yield from (f"  {name}: only in {side}" for name in sorted({_kind(path) for path in paths}))


def _kind(path: str) -> str:
    """A path without its places in lists."""
    return "/".join("*" if part.isdigit() else part for part in path.split("/"))


def _same(one: Any, other: Any) -> bool:
    return type(one) is type(other) and (one == other or (one != one and other != other))


def _difference(pairs: Sequence[tuple[Any, Any]]) -> str:
    numbers = [(a, b) for a, b in pairs if isinstance(a, int | float) and isinstance(b, int | float)]
    if len(numbers) < len(pairs):
        return f"for instance {pairs[0][0]!r} and {pairs[0][1]!r}"
    away = max(abs(a - b) for a, b in numbers)
    relative = max(abs(a - b) / (max(abs(a), abs(b)) or 1.0) for a, b in numbers)
    return f"by at most {away:.2g}, relative {relative:.2g}"


def questions(only: Sequence[str]) -> Iterator[tuple[str, str]]:
    """(group, name) of every question, or of those of some groups, or of some `group/name`."""
    for group, names in {**COMMANDS, "arrays": ARRAYS}.items():
        yield from ((group, name) for name in names if not only or {group, f"{group}/{name}"} & set(only))


def answer(tree: Tree, group: str, name: str) -> Any:
    """Of a question: the one in the folder, or the one that is sought now and kept there."""
    file = tree.folder / f"{group}-{name}.json"
    if not file.exists():
        begun = time.monotonic()
        found = ask(tree, group, name)
        file.write_text(json.dumps(found))
        print(f"{group}/{name}: {time.monotonic() - begun:.0f} s in {tree.folder}", file=sys.stderr, flush=True)
    return json.loads(file.read_text())


def report(old: Path, new: Path, chosen: Sequence[tuple[str, str]]) -> int:
    """Print the comparison of the answers in two folders; how many of them differ."""
    differing = 0
    for group, name in chosen:
        files = [folder / f"{group}-{name}.json" for folder in (old, new)]
        missing = [str(file) for file in files if not file.exists()]
        lines = [f"no {' and no '.join(missing)}"] if missing else list(compare(*map(_read, files)))
        differing += bool(missing) or len(lines) > 1
        print(f"{group}/{name}:", *lines, sep="\n" if len(lines) > 1 else " ", flush=True)
    return differing


def _read(file: Path) -> Any:
    return json.loads(file.read_text())


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", type=Path, nargs="?", help="the other state, its kernels compiled")
    parser.add_argument("--only", action="append", metavar="GROUP[/NAME]", help=", ".join([*COMMANDS, "arrays"]))
    parser.add_argument("--folder", type=Path, default=Path("results/against-release"), help="for the answers")
    parser.add_argument("--compare", type=Path, nargs=2, metavar="FOLDER", help="of answers: measure nothing")
    parser.add_argument("--side", choices=["other", "here"], help="measure this side alone, compare nothing")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure is not None:
        return measure_rollouts(given.measure)
    chosen = list(questions(given.only or ()))
    if not chosen:
        parser.error(f"--only: one of {', '.join([*COMMANDS, 'arrays'])}, or one of their names: {given.only}")
    folder = given.folder.resolve()
    if not given.compare:
        if given.checkout is None:
            parser.error("name the checkout of the other state")
        trees = {
            "other": Tree(given.checkout.resolve(), True, folder / "other"),
            "here": Tree(Path(__file__).resolve().parent.parent, False, folder / "here"),
        }
        for group, name in chosen:
            for side, tree in trees.items():
                if given.side in (None, side):
                    answer(tree, group, name)
        if given.side:
            return None
    old, new = given.compare or (folder / "other", folder / "here")
    sys.exit(1 if report(old, new, chosen) else 0)


if __name__ == "__main__":
    main()
