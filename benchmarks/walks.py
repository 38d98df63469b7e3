"""How far is it from one end of the program to the other? `python benchmarks/walks.py CHECKOUT... [--json]`.

Two walks, each driven once with the profiler of the interpreter on every call of the package:

- *road*: from a road's CSV file to the steering angles along 30 m of it: `load_road`, `plan_speed`, `RoadDrive`,
  `simulate` with the default MPC, kernels interpreted;
- *row*: from the rows of a small campaign to a schedule: `run_campaign`, `load_dataset`, `train`, `trained_schedule`,
  kernels from the library of each checkout.

What is walked is followed by identity. It begins with the file's name (the campaign's settings). A function that is
given it, or something made of it, hands it on with what it returns, and a constructor with the object that it makes;
arrays, tuples and objects count, plain numbers, texts and switches do not. Three things are counted:

- *files*: those whose functions are given what is walked;
- *steps back*: pairs of files between which such a call goes against the order of the rooms (`code_figures.ROOMS`),
  from a room to one that comes later: what a reader must look up further down than where he reads;
- *names*: distinct names of parameters under which it passes, `self` left out.

Beside them stand the files of all functions that are called on the walk, and their steps back. What is read from an
attribute, or written into an array that a function was given, is not followed. A file that is never entered on the walk
does not count, and a name counts once however often it is used.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FrameType
from typing import Any

import code_figures
import numpy as np

SHORT = 64
"""Longest list or tuple whose parts are looked at."""
GENERATED = "<generated>"
CHECKING = "base.checked"
"""Stands between a call and its function, as a decorator: passed over."""
PLAIN = (bool, int, float, complex, str, bytes, type(None), type, type(sys), type(len), type(lambda: None))
CONSTRUCTORS = ("__init__", "__post_init__")
CAMPAIGN = """\
profile = "road"
scenario = "lane-change"
noise_seeds = [1]
duration = 2.0
[operating_points]
kind = "grid"
speed = [10.0, 15.0, 20.0]
y_ref = [2.0, 3.0]
friction = [0.6, 0.9]
wind = [0.0]
[search]
Np = [5, 8]
Nc = [1, 3]
Q = [1.0, 1.0]
R = [100.0, 1.0e4]
decades = true
[swarm]
particles = 2
generations = 1
[library]
tunings = [[5, 2, 1, 1000]]
"""


class Walk:
    """Follows some objects through the calls of a package whose folder is `root`."""

    def __init__(self, root: Path, *beginning: Any) -> None:
        self.root = str(root) + os.sep
        self.kept = {id(each): each for each in beginning}  # held, so that no identity is used again
        self.files: set[str] = set()
        self.steps: set[tuple[str, str]] = set()
        self.names: set[tuple[str, str]] = set()  # (module, name)
        self.called: set[str] = set()  # modules of all functions that are called
        self.called_back: set[tuple[str, str]] = set()  # pairs of them, against the order

    def __call__(self, frame: FrameType, event: str, result: Any) -> None:
        """What `sys.setprofile` calls at every call and return."""
        place = self.place(frame)
        if event not in ("call", "return") or not place:
            return
        given = {name: value for name, value in parameters(frame).items() if self.walked(value)}
        if event == "return":
            if given or self.walked(result):
                self.hand_on(frame.f_locals.get("self") if frame.f_code.co_name in CONSTRUCTORS else result)
        elif place != GENERATED:
            self.count(frame, place, given)

    def place(self, frame: FrameType) -> str:
        """The module of a frame within the package; `GENERATED` for the constructor of a record; else empty."""
        file = frame.f_code.co_filename
        if file == "<string>" and frame.f_code.co_name in (*CONSTRUCTORS, "<lambda>"):  # a named tuple's is a lambda
            return GENERATED
        inside = file.removeprefix(self.root) if file.startswith(self.root) else ""
        place = inside.removesuffix(".py").removesuffix("/__init__").replace(os.sep, ".")
        return "" if place.endswith(CHECKING) else place

    def walked(self, value: Any) -> bool:
        """Whether this, or a part of a short list, a tuple or a dictionary, is what is walked."""
        if id(value) in self.kept:
            return True
        if type(value) in (list, tuple) and len(value) <= SHORT:
            return any(id(each) in self.kept for each in value)
        return type(value) is dict and any(id(each) in self.kept for each in value.values())

    def hand_on(self, made: Any) -> None:
        """What a function returns, or a constructor makes, of what is walked is walked on."""
        for each in [made, *(made if type(made) in (list, tuple) and len(made) <= SHORT else ())]:
            if not isinstance(each, PLAIN) and not (isinstance(each, tuple) and not each):
                self.kept[id(each)] = each

    def count(self, frame: FrameType, place: str, given: Mapping[str, Any]) -> None:
        """A function of this module is called, and given what is walked under these names."""
        above = frame.f_back
        while above is not None and self.place(above) in ("", GENERATED):
            above = above.f_back
        back = {(self.place(above), place)} if above is not None and rank(self.place(above)) < rank(place) else set()
        self.called.add(place)
        self.called_back |= back
        if given:
            self.files.add(place)
            self.steps |= back
            self.names |= {(place, name) for name in given if name not in ("self", "cls") and name.isidentifier()}

    def counts(self) -> dict[str, Any]:
        """What is counted."""
        steps, called_back = (
            sorted(f"{one} -> {other}" for one, other in pairs) for pairs in (self.steps, self.called_back)
        )
        return {
            "files": sorted(self.files),
            "files outside the core": sorted(filter(outside_core, self.files)),
            "steps back": steps,
            "names": sorted({name for _, name in self.names}),
            "files of all calls": sorted(self.called),
            "steps back of all calls": called_back,
        }


def parameters(frame: FrameType) -> dict[str, Any]:
    """What a function was given, by name."""
    code, known = frame.f_code, frame.f_locals
    extra = bool(code.co_flags & inspect.CO_VARARGS) + bool(code.co_flags & inspect.CO_VARKEYWORDS)
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount + extra]
    return {name: known[name] for name in names if name in known}


def rank(place: str) -> int:
    """The place of a module's room in the order of the rooms."""
    return code_figures._rank(f"{code_figures.PACKAGE}.{place}")


def outside_core(place: str) -> bool:
    """Whether a module is not of the core."""
    return place.split(".")[0] not in ("core", "kernels")


# -- the walks --------------------------------------------------------------------------------------------------------
def road(folder: Path) -> Any:
    """From a road's CSV file to the steering angles along it."""
    import adaptrack as at

    angle = np.linspace(0.0, 0.5, 30)
    file = folder / "track.csv"
    np.savetxt(
        file, 60.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]), delimiter=",", header="x,y", comments=""
    )
    car = at.load_vehicle("paper")
    plant, mpc = at.DualTrack(car), at.MPC(car, profile="road")
    at.simulate(plant, mpc, at.load_scenario("step", duration=0.2), profile="road")  # what is made once is made

    def walk() -> Any:
        loaded = at.load_road(file)
        drive = at.RoadDrive(loaded, at.plan_speed(loaded, car))
        return at.simulate(plant, mpc, drive, profile="road").steering

    return walk, (file,)


def row(folder: Path) -> Any:
    """From the settings of a small campaign to a schedule."""
    import adaptrack as at

    try:
        from adaptrack.learning.adaptation.recipes import trained_schedule
    except ImportError:  # before the rooms
        from adaptrack.adaptation.recipes import trained_schedule
    (folder / "small.toml").write_text(CAMPAIGN)
    config = at.load_campaign(folder / "small.toml")

    def walk() -> Any:
        data = at.load_dataset(at.run_campaign(config, folder / "campaign", workers=1))
        return trained_schedule(at.train(data, "nn", epochs=20), data)

    return walk, (config,)


KERNELS = {"road": "interpreted", "row": "library"}
"""How kernels run on a walk; whole runs of a swarm would take the interpreter minutes."""
WALKS: Mapping[str, Callable[[Path], Any]] = {"road": road, "row": row}


def trace(name: str, source: Path) -> dict[str, Any]:
    """Walk with the package of this interpreter, and count."""
    with tempfile.TemporaryDirectory() as folder:
        walk, beginning = WALKS[name](Path(folder))
        counting = Walk(source / code_figures.PACKAGE, *beginning)
        threading.setprofile(counting)
        sys.setprofile(counting)
        try:
            walk()
        finally:
            sys.setprofile(None)
            threading.setprofile(None)  # type: ignore[arg-type]
    return counting.counts()


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkout", type=Path, nargs="+")
    parser.add_argument("--only", choices=list(WALKS), help="by default both")
    parser.add_argument("--json", action="store_true", help="print what is counted, too, as JSON")
    parser.add_argument("--trace", choices=list(WALKS), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.trace:
        print(json.dumps(trace(given.trace, given.checkout[0])))
        return
    found = {}
    for checkout in (each.resolve() for each in given.checkout):
        for name in [given.only] if given.only else WALKS:
            done = subprocess.run(
                [sys.executable, str(Path(__file__).resolve()), str(checkout / "src"), "--trace", name],
                stdout=subprocess.PIPE, text=True, check=True,
                env=os.environ | {"PYTHONPATH": str(checkout / "src"), "ADAPTRACK_KERNELS": KERNELS[name]},
            )  # fmt: skip
            found[f"{checkout.name}: {name}"] = counts = json.loads(done.stdout)
            if not given.json:
                shown = ", ".join(f"{len(values)} {what}" for what, values in counts.items())
                print(f"{checkout.name}, {name}: {shown}", flush=True)
    if given.json:
        print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
