"""A controller with its tracker as a block: what of it is constant, what is state, and who cannot be exported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import LQR, MPC, Controller, PurePursuit, Stanley
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.speed_control import SpeedControl, SpeedStart, longitudinal_of, patience_of, speed_path
from adaptrack.control.tracking import tracking_of
from adaptrack.core.kernel import Resident, direct, record
from adaptrack.core.speed_control import SpeedPath
from adaptrack.core.tracker.longitudinal import Longitudinal
from adaptrack.core.tracker.records import LawTracking, Tracking
from adaptrack.core.tracker.step import driver_step, driver_step_law, tracker_step, tracker_step_law
from adaptrack.export.block import ArrayRole, ArrayStart, Block, pack
from adaptrack.road import Road, SpeedPlan

ROLES = {
    "tracker.settings": ArrayRole.FIXED,
    "tracker.check.settings": ArrayRole.FIXED,
    "scheduling.schedule.settings": ArrayRole.FIXED,
    "scheduling.schedule.integers": ArrayRole.FIXED,
    "scheduling.schedule.numbers": ArrayRole.FIXED,
    "scheduling.first": ArrayRole.FIXED,
    # of an MPC
    "step.mpc.states": ArrayRole.FIXED,
    "step.mpc.informed.fresh": ArrayRole.FIXED,
    "step.mpc.informed.learner": ArrayRole.FIXED,
    "step.mpc.ws.moves": ArrayRole.FIXED,
    "step.mpc.model": ArrayRole.RENEWED,
    "step.mpc.parameters": ArrayRole.RENEWED,
    "step.mpc.feed.turning": ArrayRole.RENEWED,
    "step.mpc.informed.estimator": ArrayRole.RENEWED,
    "step.mpc.ws.rows": ArrayRole.RENEWED,
    "step.tuning": ArrayRole.RENEWED,
    # of a law
    "law.parameters": ArrayRole.FIXED,
    "tuning": ArrayRole.RENEWED,
}
"""Of `Tracking` and `LawTracking`; all else is kept."""
SPEED_ROLES = dict.fromkeys(("longitudinal.friction.car", "longitudinal.friction.variances"), ArrayRole.FIXED)
"""Of a speed control behind them."""
STARTS = (ArrayStart("step.mpc.informed.learned", "step.mpc.informed.fresh"),)
RESETS = {"step.mpc.memory": {"speed": math.nan}}
"""The model, and all that follows from it, is formed anew."""
OUTSIDE = ("tracker.path", "tracker.plan")
Room = tuple[int, int]
SpeedTracking = record("SpeedTracking", (*Tracking.kinds.items(), ("longitudinal", Longitudinal)))
SpeedLawTracking = record("SpeedLawTracking", (*LawTracking.kinds.items(), ("longitudinal", Longitudinal)))
"""`Tracking` and `LawTracking` with a speed control behind them."""
REQUESTS = ("acceleration", "force", "hold", "target_speed", "grip_used", "state", "limited_by")
"""Fields of `core.speed_control.SPEED_MEMORY` that an exported speed control returns."""


class SpeedPart(NamedTuple):
    """Speed control of an export."""

    control: SpeedControl
    start: SpeedStart


def speed_part(control: SpeedControl, controller: Controller, plan: SpeedPlan, top_speed: float = 0.0) -> SpeedPart:
    """The speed control behind a tracker with a controller, for plans up to that of `plan` or a top speed (m/s)."""
    fastest = max(float(plan.speed.max()), top_speed)
    return SpeedPart(control, SpeedStart(plan.comfort, fastest, patience_of(controller)))


def kind_of(controller: Controller, speed: SpeedPart | None = None) -> Any:
    """The kind of record of an export."""
    if speed is None:
        return Tracking if isinstance(controller, MPC) else LawTracking
    return SpeedTracking if isinstance(controller, MPC) else SpeedLawTracking


def step_kernel(kind: Any) -> str:
    """The kernel of a whole call with a controller, by the kind of its record."""
    name = "driver_step" if "longitudinal" in kind.kinds else "tracker_step"
    return name if "step" in kind.kinds else f"{name}_law"


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
    if controller.vehicle is None:
        raise InvalidInput(f"export: {name!r} has a model of your own, and only the package's are compiled ahead.")
    scheduler = controller.scheduler
    if not (scheduler is None or isinstance(scheduler, CompiledScheduler)):
        raise InvalidInput(
            f"export: scheduler {scheduler!r} of {name!r} is Python: give one of a file (Schedule.save)."
        )
    if isinstance(controller, MPC) and not controller.runs_in_kernel:
        raise InvalidInput(f"export: QP solver {controller.solver.name!r} of {name!r} is Python's: use 'active-set'.")


def room_of(controller: MPC, room: Room | None = None) -> Room:
    """Largest Np and Nc for which there is memory: by default what tuning and schedule ask for.

    Raises
    ------
    InvalidInput
        When that is less than they ask for, or more than the controller was made for.
    """
    tuning = controller.tuning
    needed = [(tuning.Np, tuning.Nc)]
    if isinstance(controller.scheduler, CompiledScheduler):
        needed.append(controller.scheduler.largest)
    least = max(value for value, _ in needed), max(value for _, value in needed)
    most = controller.longest_horizon, controller.most_moves
    horizons = (min(least[0], most[0]), min(least[1], most[1])) if room is None else room
    if room is not None and not (least[0] <= room[0] <= most[0] and least[1] <= room[1] <= most[1]):
        raise InvalidInput(
            f"export: room for Np = {room[0]}, Nc = {room[1]}: must be between {least} of the tuning and {most} of the "
            "controller (longest_horizon, most_moves)."
        )
    return horizons


def tracking_block(
    controller: Any, room: Room | None = None, furthest: float = 10.0, speed: SpeedPart | None = None
) -> Block:
    """The block of a controller behind a tracker, with what it has learned so far; the controller stays as it is.

    room: of an MPC the largest Np and Nc that constants which are loaded later may have; furthest: m, from the path;
    speed: the speed control behind the tracker. It learns drive, brakes and friction from `adaptrack_init` on.

    Raises
    ------
    InvalidInput
        When it cannot be exported.
    """
    refuse(controller)
    none: Any = None  # the C program gives path and plan
    record = small_record_of(controller, none, None, furthest, room)
    kind, outside = kind_of(controller, speed), list(OUTSIDE)
    if speed is not None:
        path = SpeedPath(*(np.zeros(0) for _ in range(6)), 0.0, 0.0, 0)
        longitudinal = longitudinal_of(speed.control, controller.period, speed.start, path, controller)
        banks, friction = longitudinal.banks, longitudinal.friction
        for rows in (banks.drive, banks.brakes, friction.bank, friction.memory):
            rows[:] = np.zeros_like(rows)
        record = kind(*record, longitudinal)
        outside.append("longitudinal.path")
    return pack(record, kind.__name__, ROLES | SPEED_ROLES, STARTS, RESETS, outside)


def record_of(controller: Any, path: Road, plan: SpeedPlan | None = None, furthest: float = 10.0) -> Any:
    """A tracker with a controller at its start, with what that has learned so far; see `tracking_of`."""
    record = tracking_of(controller, path, plan, furthest)
    if isinstance(controller, MPC):
        record = record._replace(step=record.step._replace(mpc=_with_learned(controller, controller.settings())))
    return record


def small_record_of(
    controller: Any, path: Road, plan: SpeedPlan | None = None, furthest: float = 10.0, room: Room | None = None
) -> Any:
    """`record_of`, of an MPC with memory for no longer horizons than it needs (`room_of`)."""
    record = record_of(controller, path, plan, furthest)
    if isinstance(controller, MPC):
        longest, most = room_of(controller, room)
        small = controller.settings(longest + _room_for_lag(controller), most, residuals=False)
        record = record._replace(step=record.step._replace(mpc=_with_learned(controller, small)))
    return record


def _room_for_lag(controller: MPC) -> int:
    """Instants by which the road ahead has to be known further: the lag may be learned to be longer than assumed."""
    if controller.learner is None:
        return 0
    longer = controller.learner.limits.lag[1] - controller.learner.ranges.lag[0]
    return math.ceil(longer / controller.period)


def _with_learned(controller: MPC, settings: Any) -> Any:
    """The MPC under some settings."""
    mpc = controller.batch(1, settings, curved=True)
    if controller.learner is not None:
        learned = controller.learner.restart_memory(controller._mpc.informed.learned[0])
        mpc.informed.fresh[:] = learned
        mpc.informed.learned[0] = learned
    return mpc


class Twin:
    """The calls of an exported controller, made by the same kernels in this process; used to verify exports."""

    def __init__(
        self,
        controller: Controller,
        path: Road,
        plan: Any = None,
        furthest: float = 10.0,
        speed: SpeedPart | None = None,
    ) -> None:
        refuse(controller)
        record = record_of(controller, path, plan, furthest)
        self._sample, self._tracked = record.tracker.sample, record.tracker.tracked
        is_mpc, self._longitudinal = isinstance(controller, MPC), None
        if speed is None:
            self._run = direct(tracker_step if is_mpc else tracker_step_law, record)
        else:
            way = speed_path(path, plan, speed.control.stop_at_end)
            start = speed.start._replace(top_speed=float(max(plan.speed)))
            self._longitudinal = longitudinal_of(speed.control, controller.period, start, way, controller)
            step = driver_step if is_mpc else driver_step_law
            self._run = partial(step, Resident(record), Resident(self._longitudinal))

    def call(self, sample: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return one call's result: a row of `core.tracker.records.TRACKED`.

        With a speed control `REQUESTS` and the interval of the friction follow. sample: start of a `SAMPLE` row.
        """
        self._sample[:] = math.nan
        self._sample[: len(sample)] = sample
        self._run()
        if self._longitudinal is None:
            return self._tracked.copy()
        requests, friction = self._longitudinal.memory[0], self._longitudinal.friction.memory[0]
        return np.array([*self._tracked, *(float(requests[name]) for name in REQUESTS), friction.low, friction.high])
