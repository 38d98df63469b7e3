"""The command: `python -m tools.fuzz run`, `replay FILE`, `constants` or `speed`."""

from __future__ import annotations

import argparse
import logging
import sys
import tempfile
import time
from pathlib import Path

from adaptrack.base.errors import AdaptrackError, InvalidInput
from tools.fuzz import constants
from tools.fuzz.batch import search_compiled
from tools.fuzz.search import Found, load, replay, save, search, shortened
from tools.fuzz.speed import soak
from tools.fuzz.targets import TARGETS


def _run(chosen: argparse.Namespace) -> int:
    """Search, print counts, save what fails."""
    if chosen.compiled and set(chosen.target or ["mpc"]) != {"mpc"}:
        raise InvalidInput("--compiled drives MPCs alone: leave --target out, or --compiled.")
    chosen.out.mkdir(parents=True, exist_ok=True)  # before a search of hours
    begun = told_at = time.monotonic()
    known = 0

    def told(found: Found) -> None:
        nonlocal told_at, known
        for failed in found.failed[known:]:
            known += 1
            file = chosen.out / f"fuzz-{failed.case['target']}-{chosen.seed}-{known}.json"
            brief = shortened(failed)
            save(brief, file)
            print(f"FAILED {brief.claim} ({len(brief.inputs)} inputs): {file}", flush=True)
        if time.monotonic() - told_at > 20.0:
            told_at = time.monotonic()
            done = sum(found.steps.values())
            print(f"{done:,} steps, {done / (told_at - begun):,.0f} a second", file=sys.stderr, flush=True)

    if chosen.compiled:
        found = search_compiled(chosen.steps, chosen.seed, told)
    else:
        found = search(chosen.steps, chosen.seed, chosen.target or tuple(TARGETS), told)
    for name, count in found.steps.items():
        print(f"{count:12,} steps of {name}")
    print(f"{len(found.failed):12,} failed cases")
    return int(bool(found.failed))


def _replay(chosen: argparse.Namespace) -> int:
    """Go through a file; 1 when it still fails."""
    failed = load(chosen.file)
    wrong = replay(failed.case, failed.inputs)
    print(f"case: {failed.case}")
    if wrong is None:
        print(f"all {len(failed.inputs)} inputs hold; it was: {failed.claim}")
        return 0
    print(f"input {wrong[0] + 1} of {len(failed.inputs)}: {failed.inputs[wrong[0]]}\n{wrong[1]}")
    return 1


def _constants(chosen: argparse.Namespace) -> int:
    """Change the constants of exported C libraries; 1 where one is wrong, crashes or hangs."""
    failed = 0
    for name in chosen.controller or constants.CONTROLLERS:
        with tempfile.TemporaryDirectory() as folder:
            library = constants.Library(constants.CONTROLLERS[name](), Path(folder) / "export")
            outcomes = constants.search_constants(library, chosen.count, chosen.seed)
            print(
                f"{name}: {', '.join(f'{outcomes.count(outcome)} {outcome}' for outcome in constants.OUTCOMES)}",
                flush=True,
            )
            failed += sum(outcome not in constants.ACCEPTED for outcome in outcomes)
            if not chosen.unnoticed:
                continue
            count, misses = constants.unnoticed(library)
            print(f"  {len(misses)} of {count} constants may change by 1 % in the recorded minute:")
            print("".join(f"    {constant}: {why}\n" for constant, why in misses.items()), end="")
    return int(failed > 0)


def _speed(chosen: argparse.Namespace) -> int:
    """Drive the speed control; 1 where a claim does not hold."""
    if chosen.drive is not None and chosen.shorten:
        return soak.shorten(chosen.seed, chosen.drive, chosen.way)
    if chosen.drive is not None:
        return soak.trace(chosen.seed, chosen.drive, chosen.way)
    return soak.soak(chosen.steps, chosen.seed, chosen.way, chosen.show)


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description="Hostile inputs, step after step.")
    commands = parser.add_subparsers(required=True)
    run = commands.add_parser("run", help="drive random cases and save those that fail")
    run.add_argument("--steps", type=int, default=100_000, help="of each target")
    run.add_argument("--seed", type=int, default=1)
    run.add_argument("--target", action="append", choices=TARGETS, help="may be repeated; all by default")
    run.add_argument("--compiled", action="store_true", help="MPCs inside the kernels: a hundred times as many steps")
    run.add_argument("--out", type=Path, default=Path(), help="folder of the files")
    run.set_defaults(act=_run)
    again = commands.add_parser("replay", help="go through a saved case again")
    again.add_argument("file", type=Path)
    again.set_defaults(act=_replay)
    change = commands.add_parser("constants", help="change the constants of exported C libraries")
    change.add_argument("--count", type=int, default=1000, help="changes of each controller")
    change.add_argument("--seed", type=int, default=1)
    change.add_argument("--controller", action="append", choices=constants.CONTROLLERS, help="all by default")
    change.add_argument("--unnoticed", action="store_true", help="list the constants that the recorded minute misses")
    change.set_defaults(act=_constants)
    speed = commands.add_parser("speed", help="drive the speed control through faults, see tools/fuzz/speed")
    speed.add_argument("--steps", type=int, default=100_000, help="of all drives together")
    speed.add_argument("--seed", type=int, default=1)
    speed.add_argument("--way", choices=("c", "tracker", "both"), default="c", help="both: compare their bits")
    speed.add_argument("--show", type=int, default=3, help="findings of a claim and a fault that are printed")
    speed.add_argument("--drive", type=int, help="run only the drive of this number, and print its rows")
    speed.add_argument("--trace", action="store_true", help="with --drive, which always prints its rows")
    speed.add_argument("--shorten", action="store_true", help="with --drive: print the simplest drives that fail alike")
    speed.set_defaults(act=_speed)
    chosen = parser.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.CRITICAL)
    try:
        return int(chosen.act(chosen))
    except (AdaptrackError, OSError) as error:
        print(error, file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
