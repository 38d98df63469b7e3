"""A controller with its tracker as a block: what of it is constant, what is state, and who cannot be exported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import LQR, MPC, Controller, PurePursuit, Stanley
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.tracking import tracking_of
from adaptrack.core.tracker.records import LawTracking, Tracking
from adaptrack.export.block import Block, Role, Start, pack

ROLES = {
    "tracker.settings": Role.FIXED,
    "scheduling.schedule.settings": Role.FIXED,
    "scheduling.schedule.integers": Role.FIXED,
    "scheduling.schedule.numbers": Role.FIXED,
    "scheduling.first": Role.FIXED,
    # of an MPC
    "step.mpc.states": Role.FIXED,
    "step.mpc.informed.fresh": Role.FIXED,
    "step.mpc.informed.learner": Role.FIXED,
    "step.mpc.ws.moves": Role.FIXED,
    "step.mpc.model": Role.RENEWED,
    "step.mpc.parameters": Role.RENEWED,
    "step.mpc.feed.turning": Role.RENEWED,
    "step.mpc.informed.estimator": Role.RENEWED,
    "step.mpc.ws.rows": Role.RENEWED,
    "step.tuning": Role.RENEWED,
    # of a law
    "law.parameters": Role.FIXED,
    "tuning": Role.RENEWED,
}
"""Of `Tracking` and `LawTracking`; all else is kept."""
STARTS = (Start("step.mpc.informed.learned", "step.mpc.informed.fresh"),)
RESETS = {"step.mpc.memory": {"speed": math.nan}}
"""The model, and all that follows from it, is formed anew."""
OUTSIDE = ("tracker.path", "tracker.plan")
MPC_STEP, LAW_STEP = "tracker_step", "tracker_step_law"
"""The kernels of a whole call."""
Room = tuple[int, int]


def step_kernel(controller: Controller) -> str:
    """The kernel of a whole call with a controller."""
    return MPC_STEP if isinstance(controller, MPC) else LAW_STEP


def refuse(controller: Any) -> None:
    """Refuse what cannot be exported.

    Raises
    ------
    InvalidInput
        For a controller of another kind, or a part of one, that is not compiled ahead of time.
    """
    name = getattr(controller, "name", type(controller).__name__)
    if not isinstance(controller, MPC | LQR | Stanley | PurePursuit):
        raise InvalidInput(
            f"export: controller {name!r} is none that is compiled ahead of time: informed, its learning kin, the "
            "paper's with their schedules, lqr, stanley and pure-pursuit are."
        )
    scheduler = controller.scheduler
    if not (scheduler is None or isinstance(scheduler, CompiledScheduler)):
        raise InvalidInput(
            f"export: scheduler {scheduler!r} of {name!r} is Python: give one of a file (save_scheduler)."
        )
    if isinstance(controller, MPC) and not controller.in_kernel:
        raise InvalidInput(f"export: QP solver {controller.solver.name!r} of {name!r} is Python's: use 'active-set'.")


def room_of(controller: MPC, room: Room | None = None) -> Room:
    """Largest Np and Nc for which there is memory: by default what tuning and schedule ask for.

    Raises
    ------
    InvalidInput
        When that is less than they ask for, or more than the controller was made for.
    """
    tuning = controller.tuning
    asked = [(tuning.Np, tuning.Nc)]
    if isinstance(controller.scheduler, CompiledScheduler):
        asked.append(controller.scheduler.largest)
    least = max(each for each, _ in asked), max(each for _, each in asked)
    most = controller.longest_horizon, controller.most_moves
    found = (min(least[0], most[0]), min(least[1], most[1])) if room is None else room
    if room is not None and not (least[0] <= room[0] <= most[0] and least[1] <= room[1] <= most[1]):
        raise InvalidInput(
            f"export: room for Np = {room[0]}, Nc = {room[1]}: must be between {least} of the tuning and {most} of the "
            "controller (longest_horizon, most_moves)."
        )
    return found


def tracking_block(controller: Any, room: Room | None = None, furthest: float = 10.0) -> Block:
    """The block of a controller behind a tracker, with what it has learned so far; the controller stays as it is.

    room: of an MPC the largest Np and Nc that constants which are loaded later may have; furthest: m, from the path.

    Raises
    ------
    InvalidInput
        When it cannot be exported.
    """
    refuse(controller)
    none: Any = None  # the C program gives path and plan
    record = tracking_of(controller, none, furthest=furthest)
    record = with_room(controller, record, room)
    kind = Tracking if isinstance(controller, MPC) else LawTracking
    return pack(record, kind.__name__, ROLES, STARTS, RESETS, OUTSIDE)


def with_room(controller: Any, record: Any, room: Room | None = None) -> Any:
    """The record of a tracker with a controller, of an MPC with memory for no longer horizons than it needs."""
    if not isinstance(controller, MPC):
        return record
    return record._replace(step=record.step._replace(mpc=_small(controller, room_of(controller, room))))


def _small(controller: MPC, room: Room) -> Any:
    """The MPC with memory for horizons so long, with what it has learned."""
    mpc = controller.batch(1, controller.settings(*room, residuals=False), curved=True)
    if controller.learner is not None:
        learned = controller.learner.again(controller._mpc.informed.learned[0])
        mpc.informed.fresh[:] = learned
        mpc.informed.learned[0] = learned
    return mpc


def names_of(blocks: Sequence[Block]) -> list[str]:
    """The kernels whose addresses blocks hold."""
    return sorted({name for each in blocks for name in each.functions})
