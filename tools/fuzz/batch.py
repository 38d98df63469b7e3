"""The same search inside the kernels: millions of steps of an MPC, the claims looked at afterwards, all at once.

What an input in Python may be beside (malformed, an action before the step) is left to `search`; schedulers that lie
are tunings that change.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from adaptrack.control.controllers import MPC
from adaptrack.control.estimation import NOTHING_MEASURED
from adaptrack.control.qp import QPStatus
from adaptrack.core.tracker.records import STANDSTILL_SPEED
from tools.fuzz import inputs
from tools.fuzz.inputs import LIES, Array, Case, Rng
from tools.fuzz.search import Failed, Found
from tools.fuzz.targets import CERTIFIED, SETTLED, TINY, make_mpc

STEPS_EACH = 20_000
"""Of one case."""
CALM = (20.0, 5.0, 1.0, 10.0)
"""A tuning that solves."""


def _drawn(case: Case, rng: Rng, steps: int) -> tuple[Array, Array, Array, Array, Any]:
    """States (k, 10), speeds (k,), references (k, .), tunings (k, 4), whether all is good (k,)."""
    bad = inputs.bursts(rng, steps, inputs.choose(rng, (0.0, 0.1, 0.4)))
    share = inputs.choose(rng, (0.03, 0.2, 0.8))
    states, speeds, references = inputs.measured(rng, steps), inputs.paces(rng, steps), inputs.references(rng, steps)
    for rows in (states, references, speeds):
        inputs.spoil(rng, rows, bad, share)
    speeds[speeds == -math.inf] = math.nan  # as `MPC.step` has it
    if rng.random() < 0.5:
        states[:, 4:] = NOTHING_MEASURED[4:]
    tunings = np.tile(np.array(case.get("tuning", CALM), dtype=float), (steps, 1))
    if case["lies"]:
        lies = np.array([each for each in LIES if isinstance(each, list) and len(each) == 4 and each[0] is not True])
        tunings[bad], tunings[~bad] = lies[rng.integers(len(lies), size=int(bad.sum()))], CALM
    return states, speeds, references, tunings, ~bad


def _good_for(good: Array) -> Array:
    """How many good inputs in a row there are at each step."""
    count = np.arange(1, len(good) + 1)
    return np.asarray(count - np.maximum.accumulate(np.where(good, 0, count)))


def _broken(mpc: MPC, answers: Array, speeds: Array, states: Array, references: Array, good: Array) -> tuple[int, str]:
    """The first step at which a claim does not hold, and the claim; -1: all hold."""
    from adaptrack.core.controllers.mpc import MPC_ANSWER

    angle, move, held = (answers[:, i] for i in (MPC_ANSWER.command, MPC_ANSWER.command_change, MPC_ANSWER.held))
    status, residual = answers[:, MPC_ANSWER.qp_status], answers[:, MPC_ANSWER.qp_residual]
    (least, most), (down, up) = mpc.limits.angle, mpc.limits.move
    solved = status == QPStatus.SOLVED
    needed = np.isfinite(speeds)
    if mpc.is_published:
        needed &= np.isfinite(states[:, :4]).all(axis=1)
    needed &= np.isfinite(references).any(axis=1)
    if not mpc.is_published:
        needed |= np.abs(speeds) < STANDSTILL_SPEED
    late = solved | (_good_for(good) < SETTLED)
    claims = {
        "the command is finite": np.isfinite(angle),
        "the command is within its limits": (angle >= least - TINY) & (angle <= most + TINY),
        "held says whether the QP was solved": (held > 0.5) == ~solved,
        "what is solved is certified": ~solved | (residual <= CERTIFIED) | (np.abs(speeds) < STANDSTILL_SPEED),
        "what is not finite is not solved": ~solved | needed,
        "what is not finite leaves the command": (status != QPStatus.NON_FINITE) | (move == 0.0),
        "what is learned is finite": np.isfinite(answers[:, len(MPC_ANSWER) :]).all(axis=1),
    }
    if not mpc.limits.ahead > 0.0:
        claims["moves are within their limits"] = (move >= down - 1e-9) & (move <= up + 1e-9)
    if getattr(mpc.solver, "name", "") == "active-set":
        claims["good inputs are solved, whatever came before"] = late
    first = {claim: int(np.argmin(holds)) for claim, holds in claims.items() if not holds.all()}
    if not first:
        return -1, ""
    claim = min(first, key=lambda each: first[each])
    return first[claim], claim


def run_case(case: Case, rng: Rng, steps: int) -> Failed | None:
    """Drive one case; what fails, as inputs of the target "mpc"."""
    from adaptrack.core.controllers.mpc_step import steps as run

    mpc = make_mpc(case)
    states, speeds, references, tunings, good = _drawn(case, rng, steps)
    answers = np.full((steps, mpc._mpc.answer.shape[1]), math.nan)
    run(states.copy(), speeds, references, tunings, mpc._resident, mpc.functions, answers)
    where, claim = _broken(mpc, answers, speeds, states, references, good)
    if where < 0:
        return None
    given: list[Case] = [
        {"state": states[k], "speed": float(speeds[k]), "reference": references[k], "good": bool(good[k]),
         "answer": tunings[k].tolist()}
        for k in range(max(0, where - 2000), where + 1)
    ]  # fmt: skip
    return Failed({**case, "lies": True}, given, f"{claim}: {answers[where, :12].tolist()}")


def search_compiled(steps: int, seed: int, told: Callable[[Found], None] = lambda found: None) -> Found:
    """Drive random cases of the target "mpc" inside the kernels."""
    found, number = Found(), 0
    while found.steps["mpc, compiled"] < steps:
        rng = np.random.default_rng([seed, 0, number])
        case, count = inputs.mpc_case(rng), min(STEPS_EACH, steps - found.steps["mpc, compiled"])
        failed = run_case(case, rng, count)
        found.failed += [] if failed is None else [failed]
        found.steps["mpc, compiled"] += count
        number += 1
        told(found)
    return found
