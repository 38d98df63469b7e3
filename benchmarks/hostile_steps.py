"""Steps of random controllers on samples good and bad: what raises, what is answered, and with which command.

    python benchmarks/hostile_steps.py [--steps 2000000]

Controllers have random horizons, weights, moves, limits, solvers and policies for answers without a certificate, and
are warm: a bad sample comes among good ones. Bad is a NaN or an infinity in state, speed or reference, a short array or
a read-only one. Counted are exceptions other than `InvalidInput`, bad data answered as solved, and commands outside the
limits of angle and move; the exit code is 1 when there is any.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.controllers import Limits, Moves
from adaptrack.errors import InvalidInput
from adaptrack.qp import QPStatus, get_qp_solver

NOT_FINITE = (np.nan, np.inf, -np.inf)
STEPS_EACH = 2000
"""Of one controller."""


def random_controller(rng: np.random.Generator) -> Any:
    """An MPC."""
    longest = int(rng.integers(1, 61))
    moves = Moves("laguerre", float(rng.uniform(0.0, 0.95)), int(rng.integers(1, 9))) if rng.random() < 0.3 else Moves()
    tuning = at.Tuning(longest, int(rng.integers(1, min(longest, 20) + 1)), float(10 ** rng.uniform(-2, 2)),
                       float(10 ** rng.uniform(-4, 5)))  # fmt: skip
    policy = rng.choice(["exact", "hold"])
    solver = get_qp_solver("hildreth", on_uncertified=policy) if rng.random() < 0.3 else "active-set"
    angle = float(rng.uniform(0.05, 0.6))
    move = float(rng.uniform(0.005, 0.3))
    limits = Limits(move=(-move, move), angle=(-angle, angle))
    return at.published_mpc(
        at.load_vehicle("paper"), tuning, period=float(rng.choice([0.05, 0.1])), limits=limits, moves=moves,
        preview=bool(rng.random() < 0.5), solver=solver,
    )  # fmt: skip


def spoil(
    rng: np.random.Generator, state: Any, reference: Any, ahead: tuple[int, int]
) -> tuple[Any, float | None, Any, bool]:
    """(state, speed or None for the same, reference, whether the data are not finite)."""
    kind, value = int(rng.integers(6)), float(rng.choice(NOT_FINITE))
    if kind == 0:
        state[rng.integers(4)] = value
    elif kind == 1:
        return state, value, reference, True
    elif kind == 2:
        reference[rng.integers(*ahead)] = value
    elif kind == 3:
        return state[: rng.integers(4)], None, reference, False
    elif kind == 4:
        return state, None, reference[:0], False
    else:
        state.flags.writeable = reference.flags.writeable = False
    return state, None, reference, kind in (0, 2)


def drive(rng: np.random.Generator, steps: int, found: Counter[str]) -> None:
    """One controller, `steps` samples, one in four of them bad."""
    mpc = random_controller(rng)
    (least, most), (down, up) = mpc.limits.angle, mpc.limits.move
    ahead = (1, min(mpc.tuning.Np, 59) + 1) if mpc.preview else (0, 1)  # the samples that it reads
    scale = [0.3, 0.05, 0.1, 1.0] if rng.random() < 0.8 else 10.0 ** rng.uniform(0, 8, 4)
    states, speeds = rng.normal(size=(steps, 4)) * scale, rng.uniform(-1.0, 35.0, steps)
    references, bad = rng.uniform(-5, 5, (steps, 60)), rng.random(steps) < 0.25
    last = 0.0
    for k in range(steps):
        state, speed, reference, hostile = states[k], speeds[k], references[k], False
        if bad[k]:
            state, changed, reference, hostile = spoil(rng, state, reference, ahead)
            speed = speed if changed is None else changed
            found["bad samples"] += 1
        found["steps"] += 1
        try:
            answer = mpc.step(state, speed, reference)
        except InvalidInput:
            found["refused"] += 1
            continue
        except Exception as error:  # what is looked for
            found[f"FAULT raised {type(error).__name__}"] += 1
            continue
        found[f"answered {answer.status.name}"] += 1
        found["held"] += bool(answer.held)
        found["FAULT not finite and solved"] += hostile and answer.status is QPStatus.SOLVED
        within = least - 1e-12 <= answer.angle <= most + 1e-12 and down - 1e-9 <= answer.angle - last <= up + 1e-9
        found["FAULT command outside its limits"] += not within
        last = answer.angle


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=2_000_000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    rng, found, begun = np.random.default_rng(chosen.seed), Counter[str](), time.monotonic()
    while found["steps"] < chosen.steps:
        drive(rng, min(STEPS_EACH, chosen.steps - found["steps"]), found)
        if found["steps"] % (100 * STEPS_EACH) == 0:
            left = (time.monotonic() - begun) * (chosen.steps / found["steps"] - 1.0)
            print(f"{found['steps']:,} of {chosen.steps:,} steps, about {left:.0f} s left", file=sys.stderr, flush=True)
    for name, count in sorted(found.items()):
        print(f"{count:10,} {name}")
    return int(any(count for name, count in found.items() if name.startswith("FAULT")))


if __name__ == "__main__":
    sys.exit(main())
