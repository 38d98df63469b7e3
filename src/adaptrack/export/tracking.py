"""A controller with its tracker as a memory in C: what of it is constant, what is state, and who cannot be exported."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import Room
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.following import Following, PlannerFollower
from adaptrack.control.speed_control import SpeedControl, SpeedStart, longitudinal_of, patience_of, speed_path
from adaptrack.control.tracker import tracking_of
from adaptrack.core.controllers import lqr, pure_pursuit, stanley
from adaptrack.core.estimators import kalman, learning
from adaptrack.core.input_check.record import Settings as CheckSettings
from adaptrack.core.kernel import direct
from adaptrack.core.models import path
from adaptrack.core.models.car import SingleTrackCar
from adaptrack.core.speed.path import speed_path_words
from adaptrack.core.speed.speed_control import SPEED_REQUEST, SpeedPath
from adaptrack.core.tracker import planner
from adaptrack.core.tracker.longitudinal import write_requests
from adaptrack.core.tracker.step import tracker_step
from adaptrack.export.memory import ArrayRoles, CMemory, kernel_names
from adaptrack.road import Road, SpeedPlan

ROLES = ArrayRoles(
    fixed=(
        "tracker.settings", "tracker.check.settings", "controller.first_tuning", "controller.law.parameters",
        "controller.mpc.informed.fresh", "controller.mpc.informed.learner", "controller.mpc.states",
        "controller.schedule.integers", "controller.schedule.numbers", "controller.schedule.settings",
        "longitudinal.friction.car", "longitudinal.friction.variances", "tracker.planned.settings",
    ),
    renewed={
        "controller.tuning": "controller.first_tuning",
        **{name: name for name in (
            "controller.mpc.feed.turning", "controller.mpc.informed.estimator", "controller.mpc.parameters",
        )},
    },
    outside=("tracker.path", "tracker.plan", "longitudinal.path", "tracker.planned.speeds", "tracker.planned.points"),
    unknown=("controller.schedule.numbers",),
)  # fmt: skip
"""Of `Tracking`. What an MPC and a tracker write before the first step is no constant: the C program lets them."""
_LAWS = {"lqr": lqr.Parameters, "stanley": stanley.Parameters, "pure_pursuit": pure_pursuit.Parameters}
_MODELS = {"discretise_path": path.Parameters, "discretise_single_track": SingleTrackCar}


def _views(record: Any) -> dict[str, Sequence[Any]]:
    """The kinds of the numbers of vectors that are constants, see `CMemory`."""
    kernels, mpc, law = kernel_names(), record.controller.mpc, record.controller.law
    views: dict[str, Sequence[Any]] = {"tracker.check.settings": (CheckSettings,)}
    if law.parameters.size:
        views["controller.law.parameters"] = (_LAWS[kernels[law.function]],)
    if mpc.parameters.size:
        views["controller.mpc.parameters"] = (_MODELS[kernels[record.controller.functions.discretise]],)
    if mpc.feed.turning.size:
        views["controller.mpc.feed.turning"] = (path.Turning,)
    if mpc.informed.estimator.size:
        views["controller.mpc.informed.estimator"] = (kalman.FilterParameters,)
    if mpc.informed.learner.size:
        learner = learning.parameters_of(mpc.informed.learner, 0)
        remembered = (None,) * int(learner.commands), (learning.Hypothesis,) * int(learner.hypotheses)
        views["controller.mpc.informed.learner"] = (learning.LearnerParameters,)
        views["controller.mpc.informed.fresh"] = (learning.Memory, *remembered[0], *remembered[1])
    return views


class SpeedPart(NamedTuple):
    """Speed control of an export."""

    control: SpeedControl
    start: SpeedStart


def speed_part(
    control: SpeedControl, controller: Controller, plan: Any, top_speed: float = 0.0, following: Following | None = None
) -> SpeedPart:
    """The speed control behind a tracker with a controller, for plans up to that of `plan` or a top speed (m/s).

    Its comfort is that of `following`, or else of the plan.
    """
    comfort = plan.comfort if following is None else following.comfort
    return SpeedPart(control, SpeedStart(comfort, max(float(plan.speed.max()), top_speed), patience_of(controller)))


def trajectory_words(points: int, has_speed: bool) -> tuple[int, int]:
    """Words for a trajectory of at most so many points, and for its plan with a speed control."""
    words = planner.trajectory_words(points, planner.KEPT_POINTS, planner.TRAJECTORY_LENGTH)
    longest = planner.TRAJECTORY_LENGTH + planner.LENGTH_ROOM
    return words, speed_path_words(longest, 0, points + 2) if has_speed else 0


def refuse(controller: Any) -> None:
    """Refuse a controller that is not compiled ahead of time, or has a part that is not: InvalidInput."""
    name = getattr(controller, "name", type(controller).__name__)
    if not getattr(controller, "is_exportable", False):
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
    if not controller.runs_in_kernel:
        solver: Any = getattr(controller, "solver", None)
        raise InvalidInput(f"export: QP solver {solver.name!r} of {name!r} is Python's: use 'active-set'.")


def room_of(controller: Any, room: tuple[int, int] | None = None) -> Room:
    """Largest Np and Nc for which there is memory: by default what tuning and schedule ask for.

    Raises InvalidInput when that is less than they ask for, or more than the controller was made for.
    """
    needed = controller.room_for(controller.packed_tuning()[None], controller.scheduler)
    if room is None or not controller.has_horizons:
        return needed
    most = controller.longest_horizon, controller.most_moves
    if not (needed.longest <= room[0] <= most[0] and needed.most <= room[1] <= most[1]):
        raise InvalidInput(
            f"export: room for Np = {room[0]}, Nc = {room[1]}: must be between {needed.longest:.0f}, "
            f"{needed.most:.0f} of the tuning and {most} of the controller (longest_horizon, most_moves)."
        )
    return Room(*room, residuals=False)


def tracking_memory(
    controller: Any, room: tuple[int, int] | None = None, furthest: float = 10.0, speed: SpeedPart | None = None,
    following: Following | None = None,
) -> CMemory:  # fmt: skip
    """The memory of a controller behind a tracker, with what it has learned so far; the controller stays as it is.

    room: of an MPC the largest Np and Nc that constants which are loaded later may have; furthest: m, from the path;
    speed: the speed control behind the tracker. It learns drive, brakes and friction from `adaptrack_init` on.
    following: how a planner is followed; None: it is not. Raises InvalidInput when the controller cannot be exported.
    """
    refuse(controller)
    none: Any = None  # the C program gives path and plan
    longitudinal = None
    if speed is not None:
        no_path = SpeedPath(*(np.zeros(0) for _ in range(6)), 0.0, 0.0, 0)
        longitudinal = longitudinal_of(speed.control, controller.period, speed.start, no_path, controller)
    planned = None if following is None else PlannerFollower(following, controller).planned
    record = small_record_of(controller, none, None, furthest, room, longitudinal, planned)
    return CMemory(record, ROLES, _views(record))


def small_record_of(
    controller: Any, road: Any, plan: SpeedPlan | None = None, furthest: float = 10.0,
    room: tuple[int, int] | None = None, longitudinal: Any = None, planned: Any = None,
) -> Any:  # fmt: skip
    """A tracker with a controller at its start, with what that has learned so far; see `tracking_of`.

    An MPC has memory for no longer horizons than it needs (`room_of`).
    """
    part = controller.part_with_learned(room_of(controller, room))
    return tracking_of(controller, road, plan, furthest, part, longitudinal, planned)


class Twin:
    """The calls of an exported controller, made by the same kernels in this process; used to verify exports."""

    def __init__(
        self,
        controller: Controller,
        road: Road,
        plan: Any = None,
        furthest: float = 10.0,
        speed: SpeedPart | None = None,
    ) -> None:
        refuse(controller)
        self._longitudinal = None
        if speed is not None:
            way = speed_path(road, plan, speed.control.stop_at_end)
            start = speed.start._replace(top_speed=float(max(plan.speed)))
            self._longitudinal = longitudinal_of(speed.control, controller.period, start, way, controller)
        part = controller.part_with_learned(Room())
        record = tracking_of(controller, road, plan, furthest, part, self._longitudinal)
        self._sample, self._tracked = record.tracker.sample, record.tracker.tracked
        self._run = direct(tracker_step, record)

    def call(self, sample: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return one call's result: a row of `TRACKED`, with a speed control one of `SPEED_REQUEST` behind it.

        sample: the start of a row of `TRACKER_SAMPLE`.
        """
        self._sample[:] = math.nan
        self._sample[: len(sample)] = sample
        self._run()
        if self._longitudinal is None:
            return self._tracked.copy()
        answer = np.append(self._tracked, np.zeros(len(SPEED_REQUEST)))
        write_requests(self._longitudinal, answer, len(self._tracked))
        return answer
