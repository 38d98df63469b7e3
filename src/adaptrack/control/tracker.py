"""A controller in anybody's loop: samples with time stamps in, steering commands out.

The controller runs at instants of its own, one period apart. A call at any time belongs to the nearest of them, and an
instant to the nearest call. A Kalman filter is given the age of a sample and takes it in where it belongs; what it
cannot take, and what any other controller is given, is carried to the instant by the car's own motion (speed and yaw
rate). Instants without a call are gone through on the estimate, with the command that was held.
"""

from __future__ import annotations

import inspect
import logging
import math
import os
import time
import weakref
from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Bound, Finite, Hint, checked, real, reals
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.control.controllers import BeliefState, Controller
from adaptrack.control.controllers.base import CalledController, python_part
from adaptrack.control.controllers.belief import SourcedValue
from adaptrack.control.controllers.inputs import MOST_WHEEL_ANGLE
from adaptrack.control.controllers.learned_car import bounded_quantity
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.estimation import Perception
from adaptrack.control.following import DRIVERS, CarPoint, DrivenBy, Following, PlannerFollower, Verdict, arm_of
from adaptrack.control.input_check import InputCheck
from adaptrack.control.recording import Recorder
from adaptrack.control.speed_control import SpeedCommand, SpeedControl, SpeedController, patience_of
from adaptrack.core.controllers.part import APPLY, REQUEST, STEP
from adaptrack.core.kernel import Resident, address_of, direct, fields_of
from adaptrack.core.layout import empty
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import CallBack
from adaptrack.core.planned.clock import MAX_STAMP_LEAD
from adaptrack.core.planned.records import FALLBACK, PLANNER, Planned
from adaptrack.core.tracker import records
from adaptrack.core.tracker.longitudinal import longitudinal_step, narrow_tracked_friction, no_speed_control
from adaptrack.core.tracker.planner import begin_trajectory, leave_planner, watch_planner
from adaptrack.core.tracker.signals import NO_BELIEF, STATUS, TRACKER_SAMPLE
from adaptrack.core.tracker.step import Tracking, tracker_apply, tracker_step
from adaptrack.core.tracker.take_call import tracker_engage, tracker_follow
from adaptrack.road import Road, SpeedPlan, Stop
from adaptrack.road.planned_trajectory import PlannedTrajectory
from adaptrack.road.road_ahead import RoadAhead, pack_roads, stacked

_log = logging.getLogger("adaptrack")

AT_STOP = 0.25
"""m, of a standing car from a stop that counts as reached; and how far ahead of a stop a car looks that leaves it."""
OVERSHOT = 3.0
"""m, of a car that is stopping already from the stop of another plan that counts as the same stop."""
RELOCATION = 20.0
"""m, beyond the last and the next stop, from which on the car has been moved rather than driven."""


class Status(StrEnum):
    """Kind of a step."""

    OK = "ok"
    ESTIMATED = "estimated"
    HELD = "held"
    STANDING = "standing"
    REVERSE = "reverse"
    OFF_PATH = "off-path"
    END = "end"
    SLIDING = "sliding"
    REPEATED = "repeated"


_STATUSES = tuple(Status)
"""In the order of `core.tracker.signals.STATUS`, which has their meanings."""
_STATUS_LINES = (f"- `{status}`: {field.meaning}" for status, field in zip(_STATUSES, fields_of(STATUS), strict=False))
Status.__doc__ = "\n".join(["Kind of a step.", "", *_STATUS_LINES])


class Tracked(NamedTuple):
    """Result of one call of a tracker."""

    command: float
    """rad, angle of the road wheels to ask for, positive to the left"""
    status: Status
    offset: float
    """m, of the car from the path, positive to the left; NaN where there is no position to go by"""
    heading_error: float
    """rad, the car's heading less the path's; likewise"""
    station: float
    """m, arc length of the car's foot on the path, over all laps; likewise"""
    belief: BeliefState | None = None
    """how far what the controller learns can be trusted; None where nothing is learned"""
    suspect: tuple[str, ...] = ()
    """sentences on inputs that contradict each other, since the tracker engaged; see `control.input_check`"""
    target_speed: float = math.nan
    """m/s, planned one period ahead, and 0 at a stop until its time is over; NaN without a plan or a position"""
    longitudinal: SpeedCommand | None = None
    """requests of the speed control: acceleration, force, hold pressure; None without one"""
    first_top_speed: float = math.inf
    """m/s, below which to drive until the controller has learned its car; then, and without learning, infinite"""
    late: float = math.nan
    """s, lateness relative to the planned trajectory, negative: early; NaN without a trajectory"""
    driven_by: DrivenBy = DrivenBy.NOBODY
    """planner, fallback or stop that decides where the car goes and how fast"""


class Timing(NamedTuple):
    """Medians over `TIMED_STEPS` control steps."""

    sample_age: float
    """s, from a sample to its call; the tracker accounts for it"""
    computation: float
    """s, from a call to its command"""


TIMED_STEPS = 50
"""Control steps after which their times are compared with the computation time that the controller assumes."""
_NOT_COPIED = ("_resident", "_part", "_python", "_calls_back", "_calls")
"""Of a tracker, by a copy of it: see `Tracker._load`."""
PERIOD_TOLERANCE = 0.4
"""Control periods, difference of the two from which it is reported."""
DOUBTFUL = {
    BeliefState.AT_BOUND: "a learned quantity is at the end of its range: the car may differ from its model",
    BeliefState.CONTRADICTORY: "measurements match no car in the prior range",
}
"""States of the belief that are warned of, once each."""


class Tracker:
    """Makes a car follow a path, called whenever a sample comes.

    Parameters
    ----------
    controller : Controller
        An MPC or any other, without a scheduler, of this tracker alone: another tracker takes a copy. A filter that
        takes late samples in (``KalmanFilter(oldest=...)``, as for profile `production`) uses what comes late best. One
        without a filter is given the v_y of a steady turn where none is measured.
    path : Road, optional
        From points, OpenDRIVE or segments, of the tracked point of `following`. On one that crosses itself the car
        begins on the branch in its direction. Without one the car stands until `follow` brings a path or a trajectory.
    plan : SpeedPlan, optional
        The speed that is planned along it; without one the present speed is expected to stay.
    speed : SpeedControl, optional
        Controls the speed along the plan: `Tracked.longitudinal` then requests acceleration and force. The status
        decides whether the car follows the plan or stops, see `control.speed_control.SPEED_ACTIONS`.
    following : Following, optional
        Settings for following: the point of the car that paths are for, by default the centre of mass, and how the
        trajectories of a planner are followed.
    sample_point : str
        Point of the car whose x and y samples have: "centre of mass", "rear axle" or "front axle".
    furthest : float
        From the path, beyond which the status says so.
    record : path, optional
        A file, .parquet or .csv, to which samples and commands are written as they come: a log that `identify`,
        `shadow` and `check-loop` read. `close`, or the end of a ``with`` block, completes it.

    Raises
    ------
    InvalidInput
        When the controller has a scheduler, or the plan is not of this path, or the record has another suffix.
    StorageError
        When the record cannot be written.
    """

    @checked
    def __init__(
        self,
        controller: Annotated[Controller, Hint("such as MPC(car)")],
        path: Road | None = None,
        *,
        plan: SpeedPlan | None = None,
        speed: SpeedControl | None = None,
        following: Following | None = None,
        sample_point: CarPoint = "centre of mass",
        furthest: Annotated[Bound, "m"] = 10.0,
        record: str | os.PathLike[str] | None = None,
    ) -> None:
        if controller.scheduler is not None:
            raise InvalidInput(
                "Tracker: the controller has a scheduler, and nobody here knows its scheduling variables: give a "
                "controller with a constant tuning."
            )
        self.controller: Any = controller
        self._called = CalledController(controller)
        self._warned: set[object] = set()
        self._times: list[tuple[float, float]] = []
        self.timing: Timing | None = None
        """of the loop; None before `TIMED_STEPS` control steps"""
        self._speed: SpeedController | None = None
        if speed is not None and plan is None and path is not None:
            raise InvalidInput("Tracker: speed: a speed control follows a plan; give plan=plan_speed(path, car).")
        self._planner: PlannerFollower | None = None
        if following is not None or path is None:
            self._planner = PlannerFollower(following or Following(), controller)
        if path is not None or plan is not None:
            path, plan = self._set_path(path, plan)
        if speed is not None:
            way: Any = (path, plan) if self._planner is None or plan is not None else self._planner.standing_plan()
            self._speed = SpeedController(
                speed, way[0], way[1], self.period, stop_at_end=speed.stop_at_end, patience=patience_of(controller)
            )
            self._speed.estimate_friction(controller)
        self._check = input_check_of(controller)
        planned = None if self._planner is None else self._planner.planned
        kernel = tracker_of(controller, path, plan, furthest, self._check, planned)
        kernel.settings["sample_arm"] = arm_of("sample_point", sample_point, controller.vehicle)
        self._load(kernel)
        self._recorder = None if record is None else Recorder(record)
        if self._recorder is not None:
            weakref.finalize(self, self._recorder.close)
        self.engage()

    path: Any = None
    """`Road` that the centre of mass follows, the base of all stations and offsets; None: none yet"""
    plan: Any = None
    """`SpeedPlan` along it, of a trajectory a `FollowedPlan`; None: none"""

    def _set_path(self, path: Any, plan: SpeedPlan | None) -> tuple[Road, SpeedPlan | None]:
        """Check a path of the tracked point and its plan, and follow that of the centre of mass; return both."""
        if not isinstance(path, Road):
            raise InvalidInput(f"Tracker: path = {path!r}: must be a Road; fit_road(...) makes one.")
        if plan is not None and (not isinstance(plan, SpeedPlan) or abs(plan.s[-1] - path.length) > 1e-6):
            raise InvalidInput("Tracker: plan: must be a SpeedPlan of this path; plan_speed(path, ...) makes one.")
        if self._planner is not None:
            path, plan = self._planner.convert_path(path, plan)
        self.path, self.plan = path, plan
        return path, plan

    def _load(self, kernel: Any) -> None:
        """Let the kernels work on this record, with the controller and the speed control as they are now."""
        self._kernel, self._resident, self._part = kernel, Resident(kernel), self.controller.own_part
        self._calls_back: tuple[CallBack, ...] = ()
        part = self._part
        if part is None:
            self._calls_back = CallBack(self._control, STEP), CallBack(self._do_requests, APPLY)
            part = self._python = python_part(self.controller, *self._calls_back)
        tracking = join(kernel, part, None if self._speed is None else self._speed.record)
        self._calls = {kernel: direct(kernel, tracking) for kernel in (tracker_step, tracker_apply)}

    def _call(self, kernel: Any) -> None:
        """Call a kernel, raise what a controller in Python has raised, and let a compiled one know its command."""
        if self._part is not self.controller.own_part:  # it has been reset
            self._load(self._kernel)
        self._calls[kernel]()
        for called_back in self._calls_back:
            called_back.raise_error()
        if self._part is not None:
            self.controller.applied(float(self._kernel.memory[0].command))

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name not in _NOT_COPIED}
        return {**state, "_recorder": None, "_warned": self._warned.copy()}  # two recorders would write one file

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._load(self._kernel)

    def __repr__(self) -> str:
        planned = "planned speed" if self.plan is not None else "no plan of the speed"
        return f"<Tracker of {self.path!r}, {planned}, by {self.controller!r}>"

    @property
    def period(self) -> float:
        """Control period (s)."""
        return float(self.controller.period)

    @property
    def furthest(self) -> float:
        """m, from the path, beyond which the status says so."""
        return float(self._kernel.settings[0].furthest)

    @property
    def blind_top_speed(self) -> float:
        """m/s, up to which a car that loses its position can stand before the steering loses its estimate.

        inf without a speed control; see `control.speed_control.SpeedController.blind_top_speed`.
        """
        return math.inf if self._speed is None else self._speed.blind_top_speed

    @checked
    def engage(self, wheel_angle: Annotated[Finite, "rad"] = 0.0, near: Annotated[Finite, "m"] | None = None) -> None:
        """Begin anew, from the angle that the wheels have: the first command is near it.

        near: arc length; the car is looked for within 400 m of it, without one on the whole path. What a controller has
        learned of its car stays; what was said of the inputs is forgotten.
        """
        self._user = self.controller.user = object()
        self._check.forget()
        self._target = SpeedTarget(self.plan) if isinstance(self.plan, SpeedPlan) else None
        tracker_engage(wheel_angle, math.nan if near is None else near, self._resident)
        self._call(tracker_apply)

    def close(self) -> None:
        """Complete the record; nothing where there is none.

        Raises
        ------
        StorageError
            When it cannot be written.
        """
        if self._recorder is not None:
            self._recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @checked
    def follow(
        self,
        path: Road | PlannedTrajectory,
        plan: SpeedPlan | None = None,
        near: Annotated[Finite, "m"] | None = None,
        *,
        fallback: PlannedTrajectory | None = None,
        now: Annotated[Finite, "s"] | None = None,
    ) -> Verdict | None:
        """Follow a path with its plan, or a planner's trajectory, from now on; the learned state of the car stays.

        A path had better begin behind the car, by the age of the oldest samples at least. near: as in `engage`.

        A trajectory is joined to the followed line, wherever it begins, and followed by its times. The result is a
        verdict. now: s, time of arrival on the clock of `step`; by default the time of the last call. fallback: a
        trajectory that ends at rest, followed when the planner falls silent; it is valid until a newer one is accepted.
        See docs/planner.md.

        Raises
        ------
        InvalidInput
            When the argument is no path, or the trajectory is impossible: the car goes on as before.
        """
        if isinstance(path, PlannedTrajectory):
            if plan is not None or near is not None:
                raise InvalidInput("Tracker.follow: plan and near belong to a path, and this is a trajectory.")
            return self._follow_planner(path, fallback, float(self._kernel.memory[0].last) if now is None else now)
        if fallback is not None or now is not None:
            raise InvalidInput("Tracker.follow: fallback and now belong to a trajectory, and this is a path.")
        if self._speed is not None and plan is None:
            raise InvalidInput("Tracker.follow: the speed control follows a plan; give plan=plan_speed(path, car).")
        path, plan = self._set_path(path, plan)
        if self._planner is not None:
            self._start_planner(self._planner.following)
        if plan is None or self._target is None:
            self._target = None if plan is None else SpeedTarget(plan)
        else:
            self._target.follow(plan)
        if self._speed is not None:
            self._speed.follow(path, plan)
        self._load(self._kernel._replace(path=stacked(path), plan=packed_plan(plan)))
        tracker_follow(math.nan if near is None else near, self._resident)
        self._call(tracker_apply)
        return None

    def _start_planner(self, following: Following) -> PlannerFollower:
        """Start to follow a planner, with no trajectory yet."""
        planner = self._planner = PlannerFollower(following, self.controller)
        self._load(self._kernel._replace(planned=planner.planned))
        leave_planner(self._resident)
        return planner

    def _follow_planner(
        self, trajectory: PlannedTrajectory, fallback: PlannedTrajectory | None, arrival_time: float
    ) -> Verdict:
        """Follow a trajectory of a planner that arrives at a time (s), and store its fallback."""
        planner = self._planner or self._start_planner(Following())
        if not math.isfinite(arrival_time):
            raise InvalidInput("Tracker.follow: now: give the time (s) of arrival before the first call of step.")
        if fallback is not None:
            planner.check_fallback(fallback)
        verdict = self._follow_trajectory(planner, trajectory, arrival_time, PLANNER)
        if fallback is not None and verdict in (Verdict.TAKEN, Verdict.SAME):
            planner.fallback = fallback, arrival_time
        offset = float(self._kernel.planned.memory[0].clock_offset)
        if abs(offset) > MAX_STAMP_LEAD:
            self._warn_once("clock", "the clock of the planner differs: %.3g s are added to its stamps.", offset)
        if verdict in (Verdict.STALE, Verdict.EARLY, Verdict.OLDER):
            self._warn_once(verdict, "a trajectory was refused, it is %s: its stamp is %.3f s, it arrived at %.3f s; "
                            "see docs/planner.md.", verdict, trajectory.stamp, arrival_time)  # fmt: skip
        return verdict

    def _follow_trajectory(
        self, planner: PlannerFollower, trajectory: PlannedTrajectory, arrival_time: float, role: int
    ) -> Verdict:
        """Follow a trajectory if its verdict is `Verdict.TAKEN`; role: `PLANNER` or `FALLBACK`."""
        low = math.nan if self._speed is None else self._speed.command.friction_low
        answer = planner.take(trajectory, arrival_time, role, low, self._resident)
        if answer.road is not None:
            self.path, self.plan, self._target = answer.road, answer.plan, None
            if self._speed is not None:
                self._speed.follow(answer.road, answer.plan, stop_at_end=False)
            self._load(self._kernel._replace(
                path=pack_roads([answer.road]), plan=packed_plan(answer.plan), planned=planner.planned,
            ))  # fmt: skip
            begin_trajectory(answer.arrival, self._resident)
            self._call(tracker_apply)
        return answer.verdict

    def _follow_fallback(self, planner: PlannerFollower, call_time: float) -> None:
        """Follow the fallback of a planner that has fallen silent; if none fits, the car stops."""
        silence, reason = planner.following.silence, "it has left no fallback that is fresh enough"
        if (fallback := planner.fresh_fallback(call_time)) is not None:
            reason = "its fallback does not begin at the car, or asks for more grip than is assumed"
            try:
                verdict = self._follow_trajectory(planner, fallback, call_time, FALLBACK)
            except InvalidInput as error:  # a step never fails because of a trajectory
                verdict, reason = Verdict.UNFIT, str(error)
            if verdict is Verdict.TAKEN:
                _log.warning("adaptrack: no trajectory for %.2g s: the car follows the fallback.", silence)
                return
        _log.warning("adaptrack: no trajectory for %.2g s: the car stops along the last one, %s.", silence, reason)

    def release(self) -> None:
        """Let the car leave the stop at which it stands, whatever its time; at the end of a path it stays.

        Nothing without a speed control, or where the car does not stand at a stop.
        """
        if self._speed is not None:
            self._speed.release()

    def acknowledge_fault(self) -> None:
        """End a fault that the speed control reports, as a call with ``driver=True`` does: the car drives on.

        Call it only when you know that brakes, drive and speed sensor are in order. Nothing without a speed control.
        """
        if self._speed is not None:
            self._speed.acknowledge_fault()

    def step(
        self,
        t: float,
        x: float,
        y: float,
        yaw: float,
        speed: float,
        yaw_rate: float = math.nan,
        *,
        lateral_velocity: float = math.nan,
        lateral_acceleration: float = math.nan,
        wheel_angle: float | None = None,
        now: float | None = None,
        motion_time: float | None = None,
        longitudinal_acceleration: float = math.nan,
        driver: bool = False,
        grade: float = math.nan,
    ) -> Tracked:
        """Process one sample and return the steering command for the current instant.

        t: s, when the sample was taken; x, y: m, of the centre of mass; yaw: rad, wrapped or not; speed: m/s, negative
        backwards; yaw_rate: rad/s; lateral_velocity: m/s; lateral_acceleration: m/s^2, without the pull of a bank;
        wheel_angle: rad, of the road wheels: where it is given, the first command is near it; now: s, on the same
        clock, when later than t; motion_time: s, on the same clock, when speed, yaw rate, lateral velocity and
        acceleration and wheel angle were taken, if not at t: then t is the time of x, y and yaw;
        longitudinal_acceleration: m/s^2, dv/dt without gravity; driver: whether a driver uses the pedals: the speed
        control then learns nothing, and its requests follow the motion of the car; grade: dz/ds measured under the
        car, positive uphill: it replaces that of the path in the requests of the speed control. What is not known is
        NaN; a call without a position is one as well. What no car can have, and all but the speed of a sample that is
        2 s old, counts as not known (`core.tracker.signals`).

        Raises
        ------
        InvalidInput
            When an argument is no number, neither t nor now is finite, or a newer tracker or simulation uses the
            controller.
        """
        signals = locals()  # the arguments by the names of TRACKER_SAMPLE
        if self.controller.user is not self._user:
            raise InvalidInput(
                "Tracker.step: a newer tracker or simulation uses this controller, which has forgotten this drive: "
                "give each its own, such as copy.copy(controller), or call engage() to begin again."
            )
        kernel = self._kernel
        call_start = time.perf_counter()
        row = [_number(name, signals.get(name)) for name in TRACKER_SAMPLE._fields]
        at = row[TRACKER_SAMPLE.t if now is None else TRACKER_SAMPLE.now]
        if not math.isfinite(at):
            raise InvalidInput(f"Tracker.step: t = {t!r}, now = {now!r}: the time of the call must be finite.")
        if self._planner is not None and watch_planner(at, self._resident):
            self._follow_fallback(self._planner, at)
            kernel = self._kernel
        kernel.sample[:] = row
        self._call(tracker_step)
        memory = kernel.memory[0]
        tracked = self._answer(at)
        if not math.isnan(age := float(kernel.request[REQUEST.late])):
            self._warn_of_late_samples(age)
        if memory.speed > tracked.first_top_speed:
            self._warn_once(
                "speed",
                "the car drives %.3g m/s before the controller has learned it: drive below %.3g m/s until "
                "Tracked.belief is settled, or give a narrower range of the steering bias, Learning(bias=...).",
                memory.speed, tracked.first_top_speed,
            )  # fmt: skip
        if memory.answered and memory.started:
            self._take_times(at - row[TRACKER_SAMPLE.t], time.perf_counter() - call_start)
        if self._recorder is not None and tracked.status is not Status.REPEATED:
            self._recorder.add(kernel.sample, tracked.command, tracked.offset)
        return tracked

    def _answer(self, time: float) -> Tracked:
        """Convert a kernel row to the result of a call."""
        (command, status, offset, heading_error, station, belief, bound, suspect, top, late, driven_by) = (
            self._kernel.tracked.tolist()
        )
        for sentence in self._check.say(int(suspect)):
            _log.warning("adaptrack: inputs contradict each other. %s", sentence)
        state = None if belief == NO_BELIEF else BeliefState(int(belief))
        if state in DOUBTFUL:
            quantity = bounded_quantity(bound)
            self._warn_once(
                state, "the belief about the car is in doubt: %s%s; drive slower, see docs/learning.md.",
                DOUBTFUL[state], f" ({quantity.replace('_', ' ')})" if quantity else "",
            )  # fmt: skip
        speed, target = float(self._kernel.memory[0].speed), math.nan
        if driven_by > 0.0:
            target = float(self._kernel.planned.memory[0].target_speed)
        elif self._target is not None:
            target = self._target.at(time, station, speed, self.period)
        suspects = self._check.suspect
        kind = _STATUSES[int(status)]
        requests = None if self._speed is None else self._speed.command
        return Tracked(
            command, kind, offset, heading_error, station, state, suspects, target, requests, top,
            late if math.isfinite(late) else math.nan, DRIVERS[int(driven_by)],
        )  # fmt: skip

    def _do_requests(self, *_: Any) -> None:
        """Apply the requests of the kernels to a controller in Python."""
        is_restart, is_path_change, turn, shift, _ = self._kernel.request.tolist()
        if is_restart:
            self._called.restart()
        if is_path_change:
            self.controller.change_path(turn, shift)

    def _control(self, *_: Any) -> None:
        """One step of a controller in Python."""
        kernel, called = self._kernel, self._called
        speed = max(float(kernel.memory[0].speed), 0.0)
        road = {"road": self._road_ahead()} if self.controller.sees_road else {}
        if self._speed is not None:
            self._speed.narrow_behind(self._resident)
        before = float(kernel.memory[0].command)
        reference = np.array([float(kernel.memory[0].aside)])
        answered = called.step(before, kernel.measured.copy(), speed, reference, **road)
        called.write(answered, before, self._python.answer[0])

    def _road_ahead(self) -> RoadAhead:
        """The path ahead of the car at its last control instant, with the speeds that are expected."""
        kernel = self._kernel
        count = len(kernel.speeds) if kernel.plan.s.size > 1 else 1
        return RoadAhead(self.path, float(kernel.memory[0].station), kernel.speeds[:count].copy())

    def _warn_once(self, subject: object, message: str, *values: object) -> None:
        """Log a warning unless there was one about the subject."""
        if subject not in self._warned:
            self._warned.add(subject)
            _log.warning(f"adaptrack: {message}", *values)

    def _take_times(self, age: float, computation: float) -> None:
        """Take in the age of a sample (s) and the time (s) of the call; report what contradicts the controller."""
        self._times.append((age if math.isfinite(age) else 0.0, computation))
        if len(self._times) < TIMED_STEPS:
            return
        self.timing = Timing(*np.median(self._times, axis=0).tolist())
        self._times.clear()
        if self.controller.belief is not None:
            self._compare_computation(self.timing, self.controller.belief.computation)

    def _compare_computation(self, timing: Timing, assumed: SourcedValue) -> None:
        """Warn where calls take longer or shorter than the controller assumes."""
        if abs(timing.computation - assumed.value) > PERIOD_TOLERANCE * self.period:
            self._warn_once(
                "computation",
                "the controller assumes a computation time of %.3g s (%s), but Tracker.step returns its command "
                "after %.2g s: if your loop sends the command at once, give the controller computation=%.3g. The "
                "tracker accounts for the age of the samples, %.2g s, separately.",
                assumed.value, assumed.source, timing.computation, round(timing.computation, 3), timing.sample_age,
            )  # fmt: skip

    def _warn_of_late_samples(self, age: float) -> None:
        late = int(self._kernel.settings[0].late)
        self._warn_once(
            "late samples",
            "a sample is %.3g s late; the controller accepts at most %.3g s, so the position is "
            "extrapolated by speed and yaw rate. To accept it, give the MPC "
            "estimator=dataclasses.replace(KalmanFilter.from_profile(profile), oldest=%.2g).",
            age, (late + 1) * self.period, 1.5 * age,
        )  # fmt: skip

    def predicted_path(self) -> Array:
        """(Np, 2) m: where the MPC expects the car at the instants from behind its dead time on, as of its last step.

        (0, 2) before the first step on a path, and if the last step found no solution.

        Raises
        ------
        InvalidInput
            When the controller predicts nothing: it is no `MPC`.
        """
        if type(self.controller).predicted_path is Controller.predicted_path:
            raise InvalidInput(f"Tracker.predicted_path: {self.controller.name} does not predict: give an MPC.")
        if not self._kernel.memory[0].predicted:
            return np.zeros((0, 2))
        return np.asarray(self.controller.predicted_path(self._road_ahead()))


# -- trackers as records of the kernels: around any controller, and whole with a compiled one --------------------------
def input_check_of(controller: Any) -> InputCheck:
    """The check of the inputs of a controller, for the noise that its filter assumes.

    It tests the delay of the steering that is specified and not learned.
    """
    model, belief, delay = controller.model, controller.belief, math.inf
    if belief is not None and controller.learner is None:
        delay = belief.lag.value + belief.delay if model is None else model.lag + model.dead_time
    return InputCheck(controller.vehicle, float(controller.period), delay, controller.position_noise)


def tracker_of(
    controller: Any, path: Road | None, plan: SpeedPlan | None, furthest: float, check: InputCheck, planned: Any = None
) -> Any:
    """A tracker around any controller before it engages (`core.tracker.records.TrackerRecord`).

    planned: `core.planned.records.Planned`; None: no planner.
    """
    car, limits, period = controller.vehicle, controller.limits, float(controller.period)
    low, high = (-math.inf, math.inf) if limits is None else limits.angle
    has_car = car is not None
    settings = records.TRACKER_SETTINGS.new(
        period=period,
        angle_min=max(low, -MOST_WHEEL_ANGLE),
        angle_max=min(high, MOST_WHEEL_ANGLE),
        move=0.5 * period if limits is None else limits.move[1],
        furthest=furthest,
        late=max(controller.takes_late, 0),
        filtered=controller.takes_late >= 0,
        drift_arm=car.lr if has_car else 0.0,
        drift_load=car.mass * car.lf if has_car else 0.0,
        drift_stiffness=2.0 * car.stiffness_rear * car.wheelbase if has_car else 1.0,
        nominal_friction=Perception().nominal_friction,
        first_top_speed=math.inf if controller.learner is None else controller.learner.first_top_speed,
    )
    planned = empty(Planned) if planned is None else planned
    return records.tracker(settings, stacked(path), packed_plan(plan), check.check, planned)


def packed_plan(plan: Any) -> Any:
    """A plan of the speed as the kernels take it (`core.tracker.records.PlanRecord`)."""
    both = (np.zeros(0),) * 2 if plan is None else (plan.s, plan.speed)
    return records.PlanRecord(*(np.ascontiguousarray(column, float) for column in both))


def tracking_of(
    controller: Controller, path: Road, plan: SpeedPlan | None = None, furthest: float = 10.0, part: Any = None,
    longitudinal: Any = None, planned: Any = None,
) -> Any:  # fmt: skip
    """A tracker with a compiled controller at its start, engaged (`core.tracker.step.Tracking`).

    part: the controller as a part of loops, by default a fresh one; longitudinal: the speed control behind the tracker
    (`core.tracker.longitudinal.Longitudinal`), None: none; planned: as in `tracker_of`. The controller stays as it is.
    Raises InvalidInput when a part of the controller is not compiled.
    """
    scheduler = controller.scheduler
    if not (scheduler is None or isinstance(scheduler, CompiledScheduler)):
        raise InvalidInput(f"tracking_of: scheduler {scheduler!r} is not compiled: give a scheduler of files.")
    tracker = tracker_of(controller, path, plan, furthest, input_check_of(controller), planned)
    tracker_engage(0.0, math.nan, tracker)
    part = controller.part(1) if part is None else part
    if scheduler is not None:
        part = part._replace(schedule=scheduler.plan(1))
    return join(tracker, part, longitudinal)


def join(tracker: Any, part: Any, longitudinal: Any = None) -> Any:
    """A tracker, its controller as a part and its speed control, None without one, as one record (`Tracking`)."""
    narrows = longitudinal is not None and part.plans
    return Tracking(
        tracker, part, address_of(narrow_tracked_friction if narrows else None),
        address_of(None if longitudinal is None else longitudinal_step),
        no_speed_control() if longitudinal is None else longitudinal,
    )  # fmt: skip


class SpeedTarget:
    """Target speed along a plan with its stops, for a loop that regulates the speed itself.

    It is 0 from a stop on until the car has stood there for the time of the stop. A plan is a speed at each arc length,
    and 0 at a stop alone. So a loop that looks ahead misses the stop, and a car that stands exactly there never leaves.
    A `SpeedTarget` remembers which stop is next, and since when the car stands.
    """

    def __init__(self, plan: SpeedPlan) -> None:
        self._stopping, self._since = False, math.nan  # s, since when the car has been standing at the next stop
        self.follow(plan)

    def follow(self, plan: SpeedPlan) -> None:
        """Go over to another plan; a car that is stopping for a stop of both goes on stopping."""
        self._plan, self._left, self._next = plan, math.nan, Stop(math.nan)

    def at(self, time: float, station: float, speed: float, period: float) -> float:
        """m/s, planned one period (s) ahead of the car's arc length (m), at its speed (m/s); NaN: no place to go by."""
        if not math.isfinite(station):
            return math.nan
        if not self._left - RELOCATION < station < self._next.s + RELOCATION:
            self._begin(station)
        place = station + max(speed, 0.0) * period
        stands = speed < records.STANDSTILL_SPEED and station >= self._next.s - AT_STOP
        if stands or place >= self._next.s:
            self._stopping = True
            if stands and not self._since <= time:
                self._since = time
            if not time - self._since >= self._next.seconds:
                return 0.0
            self._stopping, self._since, self._left = False, math.nan, self._next.s
            self._next = self._stop_beyond(self._left + 1e-6)
        launch = self._left + min(AT_STOP, 0.5 * (self._next.s - self._left))
        return float(self._plan.at(max(place, launch)))

    def _begin(self, station: float) -> None:
        """Look for the next stop of a car that has not been driven along this plan."""
        self._left, self._next = station, self._stop_beyond(station - (OVERSHOT if self._stopping else 0.0))
        if self._next.s > station + OVERSHOT:
            self._stopping, self._since = False, math.nan

    def _stop_beyond(self, place: float) -> Stop:
        """The first stop beyond an arc length (m) over all laps; infinitely far without one."""
        lap = float(self._plan.s[-1])
        stops = [
            stop._replace(s=stop.s + (math.floor((place - stop.s) / lap) + 1) * lap) if self._plan.closed else stop
            for stop in self._plan.stops
        ]
        return min((stop for stop in stops if stop.s > place), default=Stop(math.inf))


_ARGUMENTS = inspect.signature(Tracker.step).parameters
_OPTIONAL = {name for name in TRACKER_SAMPLE._fields if name not in _ARGUMENTS or _ARGUMENTS[name].default is None}
"""Signals that may be None; those of a schedule are no arguments."""
_TRUTHS = {field.name for field in fields_of(TRACKER_SAMPLE) if field.is_truth}


def _number(name: str, value: Any) -> float:
    """Check a signal of `Tracker.step` and return it as a number; NaN for None."""
    if value is None and name in _OPTIONAL:
        return math.nan
    if name not in _TRUTHS:
        return real("Tracker.step", name, value, measured=name != "t")
    if not isinstance(value, bool | np.bool_ | int) or value not in (0, 1):
        raise InvalidInput(f"Tracker.step: {name} = {format_value(value)}: must be True or False.")
    return float(value)


def yaw_of(quaternion: Sequence[float] | ArrayLike) -> float:
    """Yaw (rad, in [-pi, pi]) of a quaternion (x, y, z, w) of any length but 0, as ROS messages hold it.

    Raises
    ------
    InvalidInput
        When it has not four finite numbers, or all are 0.
    """
    q = reals("yaw_of: quaternion", quaternion)
    if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
        raise InvalidInput(f"yaw_of: {format_value(quaternion)}: must be four finite numbers x, y, z, w, not all 0.")
    x, y, z, w = q
    return portable.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
