"""Which numbers of this tree are those of another checkout to the bit, and by how much do the others differ?

    python benchmarks/against_release.py CHECKOUT [--only reproduce] [--only arrays/trackers] [--folder FOLDER]
    python benchmarks/against_release.py --compare FOLDER FOLDER

CHECKOUT: another state of the repository, its kernels compiled; it runs in its own `.venv`, or, where it has none, in
this interpreter. Both answer the same questions, each in a folder of its own: `COMMANDS` with `--json`, and the
workloads of `answers.py`, which are called `arrays`. An answer that is already in the folder is not computed again. A
command that the other state does not have differs. The exit code is 1 where anything differs.
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

sys.path.append(str(Path(__file__).resolve().parent))
from answers import WORKLOADS

NOT_COMPARED = ("seconds", "step us", "versions", "adaptrack", "path", "page", "dataset", "command", "verdict")
"""Parts of keys of what differs from run to run or is text."""
ARRAYS = "arrays"
"""The group of the workloads."""


SCHEDULERS = ("road-nn", "road-anfis", "road-best-constant", "road-look-up")

COMMANDS: Mapping[str, Mapping[str, str]] = {
    "reproduce": {"paper": "paper reproduce --out paper"},
    "compare": {"quick": "compare --config quick --out compared",
                "lane-change": "compare --lane-change iso3888-2 --vehicle compact-ev --budget 0"},
    "evaluate": {
        "as-written": "paper evaluate --operating-points 100 --drives 200 --tests",
    },
    "certify": {
        **{name: f"certify {name}" for name in SCHEDULERS},
        "default": "certify",
        "sedan": "certify --vehicle midsize-sedan --mismatch --speed 10 25",
        "standard": "certify --controller standard --profile paper",
        "feasible": "certify --feasible --speed 10 20 --friction 0.5 0.9",
    },
    "tune": {
        "sedan": "tune midsize-sedan --road mountain --road town --length 600 --runs 160 --out sedan",
        "van-lqr": "tune van --road country --length 600 --controller lqr --runs 160 --out van",
        "compact-ev": "tune compact-ev --out compact",
    },
    "scenarios": {
        "paper": "drive triple-lane-change general-trajectory --controller standard --allow-failed",
        "as-released": "drive triple-lane-change --controller as-released",
        "informed": "drive triple-lane-change random-drive double-lane-change --profile road",
        "production": "drive random-drive -o seed=3 --profile production --vehicle compact-ev --learn",
        "scheduled": "drive random-drive -o seed=1 --profile road --scheduler road-nn",
        "tuned": "drive lane-change --profile road --np 30 --nc 10 --q 1 --r 3000 --solver hildreth",
        **{name: f"drive random-drive --profile road --vehicle midsize-sedan --controller {name}"
           for name in ("lqr", "pure-pursuit", "stanley", "preview-lqr", "kinematic-mpc")},
        "single-track": "drive sine --plant single-track --tyre constant-stiffness",
    },
    "drive": {
        "mountain": "drive mountain --road-seed 2 --vehicle midsize-sedan",
        "prescribed": "drive mountain --road-seed 2 --vehicle midsize-sedan --prescribed-speed",
        "speed-control": "drive mountain --road-seed 2 --vehicle midsize-sedan --profile production --speed-control "
                         "--stop 300:3 --start 0 --assumed-friction 0.65:0.9 --learn",
        "town-learning": "drive town --vehicle van --profile production --learn",
        "lap": "drive lap --laps 2 --vehicle sports-car --lateral-acceleration 5",
        "points": "drive {track} --vehicle compact-ev --controller preview-lqr",
        "windy": "drive country --wind 8 --start-offset 0.5 --controller lqr --allow-failed",
        "sheet": "drive motorway --vehicle {sheet} --learn",
    },
    "identify": {"drive": "identify {log} --car {sheet} --out found.toml",
                 "little": "identify {log} --mass 1500 --wheelbase 2.7 --out found.toml"},
    "road": {**{kind: f"road check {kind} --road-seed 3"
                for kind in ("motorway", "country", "town", "mountain", "lap")},
             "points": "road check {track} --vehicle van",
             "noisy": "road check {noisy}"},
    "learning": {"train-nn": "paper train --data paper-grid --model nn --out nn.json",
                 "describe": "paper campaign road-sobol"},
    "lists": {"car": "car --mass 1450 --wheelbase 2.65 --out my-car.toml"},
}  # fmt: skip
"""Commands by group and name."""


class Tree(NamedTuple):
    """A checkout that answers."""

    checkout: Path
    folder: Path
    """for its answers"""

    def run(self, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run the interpreter of the checkout with its package."""
        python = self.checkout / ".venv/bin/python"
        paths = os.pathsep.join([str(self.checkout / "src"), str(self.checkout)])
        return subprocess.run(
            [str(python if python.exists() else sys.executable), *arguments],
            capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": paths, "COLUMNS": "200"},
            cwd=folder,
        )  # fmt: skip


def questions(only: Sequence[str]) -> Iterator[tuple[str, str]]:
    """(group, name) of every question, or of those of some groups, or of some `group/name`."""
    for group, names in {**COMMANDS, ARRAYS: WORKLOADS}.items():
        yield from ((group, name) for name in names if not only or {group, f"{group}/{name}"} & set(only))


def answer(tree: Tree, group: str, name: str) -> None:
    """Write the answer of a tree to its folder, unless it is there."""
    file = answer_file(tree.folder, group, name)
    if file.exists():
        return
    begun = time.monotonic()
    folder = tree.folder / group / name
    folder.mkdir(parents=True, exist_ok=True)
    if group == ARRAYS:
        script = str(Path(__file__).resolve().with_name("answers.py"))
        process = tree.run(folder, script, name, "--record", str(file))
        if process.returncode:
            print(f"{group}/{name} of {tree.checkout}: {process.stderr[-2000:]}", file=sys.stderr, flush=True)
    else:
        file.write_text(json.dumps(ask(tree, folder, COMMANDS[group][name])))
    print(f"{group}/{name}: {time.monotonic() - begun:.0f} s in {tree.folder}", file=sys.stderr, flush=True)


def answer_file(folder: Path, group: str, name: str) -> Path:
    """The file of an answer."""
    return folder / f"{group}-{name}{'.npz' if group == ARRAYS else '.json'}"


def ask(tree: Tree, folder: Path, command: str) -> dict[str, Any]:
    """Exit code and JSON of a command; of one that is refused what it says."""
    files = {key: str(path) for key, path in write_inputs(tree).items()}
    arguments = shlex.split(command.format_map(files))
    process = tree.run(folder, "-m", "adaptrack", *arguments, "--json")
    try:
        return {"exit code": process.returncode, "answer": json.loads(process.stdout)}
    except ValueError:
        return {"exit code": process.returncode, "refused": process.stderr[-2000:] or f"no JSON of {command}"}


SHEET = "car --mass 1500 --wheelbase 2.7 --out sheet.toml"
LOG = "drive random-drive --profile road --vehicle midsize-sedan --out drive"


def write_inputs(tree: Tree) -> dict[str, Path]:
    """Files that the commands read, written once: a road with and without noise, a data sheet and a log.

    The tree itself makes data sheet and log: where its runs differ, the answers differ too.
    """
    folder = tree.folder / "inputs"
    names = {"track": "track.csv", "noisy": "noisy.csv", "sheet": "sheet.toml",
             "log": "drive/random-drive-informed.parquet"}  # fmt: skip
    paths = {key: folder / name for key, name in names.items()}
    if folder.exists():
        return paths
    folder.mkdir(parents=True)
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    points = np.column_stack([220.0 * np.sin(angle) + 25.0 * np.sin(3.0 * angle), 130.0 * np.cos(angle)])
    noise = np.random.default_rng(1).normal(0.0, 0.1, points.shape)
    for name, track in (("track", points), ("noisy", points + noise)):
        np.savetxt(paths[name], track, delimiter=",", header="x,y", comments="", fmt="%.4f")
    for command in (SHEET, LOG):
        process = tree.run(folder, "-m", "adaptrack", *shlex.split(command))
        if process.returncode:
            sys.exit(f"adaptrack {command}: code {process.returncode}\n{process.stderr[-2000:]}")
    return paths


# -- comparison -------------------------------------------------------------------------------------------------------
def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """(path, value) of every number and text in nested JSON."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from leaves(inner, f"{path}/{key.replace('_', ' ')}")
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


def compare_arrays(other: Mapping[str, np.ndarray], here: Mapping[str, np.ndarray]) -> Iterator[str]:
    """As `compare`, of arrays: any NaN equals any NaN, 0 and -0 differ."""
    common = [name for name in other if name in here and other[name].shape == here[name].shape]
    different = {name: different_values(other[name], here[name]) for name in common}
    count = sum(array.size for array in other.values())
    identical = sum(other[name].size - len(different[name]) for name in common)
    yield f"{identical:,} of {count:,} values are identical to the bit"
    for name, pairs in different.items():
        if pairs:
            yield f"  {name}: {len(pairs):,} of {other[name].size:,} differ, {_difference(pairs)}"
    yield from (f"  {name}: missing on one side, or of another shape" for name in sorted({*other, *here} - {*common}))


def different_values(other: np.ndarray, here: np.ndarray) -> list[tuple[float, float]]:
    """Pairs of numbers that differ in their bits."""
    a, b = np.ravel(other), np.ravel(here)
    same = (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))
    return list(zip(a[~same].tolist(), b[~same].tolist(), strict=True))


def _kind(path: str) -> str:
    """A path without its places in lists."""
    return "/".join("*" if part.isdigit() else part for part in path.split("/"))


def _same(one: Any, other: Any) -> bool:
    return type(one) is type(other) and (one == other or (one != one and other != other))


def _difference(pairs: Sequence[tuple[Any, Any]]) -> str:
    numbers = [(a, b) for a, b in pairs if isinstance(a, int | float) and isinstance(b, int | float)]
    if len(numbers) < len(pairs):
        return f"for instance {pairs[0][0]!r} and {pairs[0][1]!r}"
    largest = max(abs(a - b) for a, b in numbers)
    relative = max(abs(a - b) / (max(abs(a), abs(b)) or 1.0) for a, b in numbers)
    return f"by at most {largest:.2g}, relative {relative:.2g}"


def report(old: Path, new: Path, chosen: Sequence[tuple[str, str]]) -> int:
    """Print the comparison of the answers in two folders; return how many of them differ."""
    differing = 0
    for group, name in chosen:
        files = [answer_file(folder, group, name) for folder in (old, new)]
        missing = [str(file) for file in files if not file.exists()]
        if missing:
            lines = [f"no {' and no '.join(missing)}"]
        elif group == ARRAYS:
            lines = list(compare_arrays(*(dict(np.load(file)) for file in files)))
        else:
            lines = list(compare(*(json.loads(file.read_text()) for file in files)))
        differing += bool(missing) or len(lines) > 1
        print(f"{group}/{name}:", *lines, sep="\n" if len(lines) > 1 else " ", flush=True)
    return differing


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", type=Path, nargs="?", help="the other state, its kernels compiled")
    parser.add_argument("--only", action="append", metavar="GROUP[/NAME]", help=", ".join([*COMMANDS, ARRAYS]))
    parser.add_argument("--folder", type=Path, default=Path("results/against-release"), help="for the answers")
    parser.add_argument("--compare", type=Path, nargs=2, metavar="FOLDER", help="of answers: compute nothing")
    parser.add_argument("--side", choices=["other", "here"], help="compute the answers of this side, compare nothing")
    options = parser.parse_args()
    chosen = list(questions(options.only or ()))
    if not chosen:
        parser.error(f"--only: one of {', '.join([*COMMANDS, ARRAYS])}, or one of their names: {options.only}")
    folder = options.folder.resolve()
    if not options.compare:
        if options.checkout is None:
            parser.error("name the checkout of the other state")
        trees = {
            "other": Tree(options.checkout.resolve(), folder / "other"),
            "here": Tree(Path(__file__).resolve().parent.parent, folder / "here"),
        }
        for group, name in chosen:
            for side, tree in trees.items():
                if options.side in (None, side):
                    answer(tree, group, name)
        if options.side:
            return
    old, new = options.compare or (folder / "other", folder / "here")
    sys.exit(1 if report(old, new, chosen) else 0)


if __name__ == "__main__":
    main()
