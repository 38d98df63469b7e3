"""Trackers as records that the kernels take: around any controller, and whole with a compiled one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.inputs import MOST_WHEEL_ANGLE
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.estimation import Perception
from adaptrack.control.input_check import InputCheck
from adaptrack.core.controllers.part import COMMON_ANSWER, ControllerPart, ControllerSizes
from adaptrack.core.estimators.learning import BELIEF_NAMES
from adaptrack.core.kernel import address_of
from adaptrack.core.layout import allocate
from adaptrack.core.member import CallBack
from adaptrack.core.tracker import records
from adaptrack.core.tracker.longitudinal import longitudinal_step, narrow_tracked_friction, no_speed_control
from adaptrack.core.tracker.step import Tracking
from adaptrack.core.tracker.take_call import tracker_engage
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.road_ahead import stacked


def input_check_of(controller: Any) -> InputCheck:
    """The check of the inputs of a controller, for the noise that its filter assumes.

    It tests the delay of the steering that is specified and not learned.
    """
    is_specified = controller.belief is not None and controller.learner is None
    delay = controller.model.lag + controller.model.dead_time if is_specified else math.inf
    return InputCheck(controller.vehicle, float(controller.period), delay, controller.position_noise)


def tracker_of(controller: Any, path: Road, plan: SpeedPlan | None, furthest: float, check: InputCheck) -> Any:
    """A tracker around any controller before it engages (`core.tracker.records.TrackerRecord`)."""
    return records.tracker(_settings(controller, furthest), stacked(path), packed_plan(plan), check.check)


def packed_plan(plan: SpeedPlan | None) -> Any:
    """A plan of the speed as the kernels take it (`core.tracker.records.PlanRecord`)."""
    both = (np.zeros(0),) * 2 if plan is None else (plan.s, plan.speed)
    return records.PlanRecord(*(np.ascontiguousarray(column, float) for column in both))


def _settings(controller: Any, furthest: float) -> Any:
    """A tracker's settings, see `core.tracker.records.TRACKER_SETTINGS`."""
    car, limits, period = controller.vehicle, controller.limits, float(controller.period)
    low, high = (-math.inf, math.inf) if limits is None else limits.angle
    has_car = car is not None
    return records.TRACKER_SETTINGS.new(
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


def tracking_of(
    controller: Controller, path: Road, plan: SpeedPlan | None = None, furthest: float = 10.0, part: Any = None,
    longitudinal: Any = None,
) -> Any:  # fmt: skip
    """A tracker with a compiled controller at its start, engaged (`core.tracker.step.Tracking`).

    part: the controller as a part of loops, by default a fresh one; longitudinal: the speed control behind the tracker
    (`core.tracker.longitudinal.Longitudinal`), None: none. The controller stays as it is.

    Raises
    ------
    InvalidInput
        When a part of the controller is not compiled.
    """
    scheduler = controller.scheduler
    if not (scheduler is None or isinstance(scheduler, CompiledScheduler)):
        raise InvalidInput(f"tracking_of: scheduler {scheduler!r} is not compiled: give a scheduler of files.")
    tracker = tracker_of(controller, path, plan, furthest, input_check_of(controller))
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


def python_part(controller: Controller | None, step: CallBack | None, request: CallBack | None = None) -> Any:
    """A controller in Python as a part of compiled loops, for one slot.

    Its answer says what it has learned, if it learns. controller, step: None if the caller of the loop is the
    controller.
    """
    learns = controller is not None and controller.learner is not None
    (sizes,) = ControllerSizes.new(1, slots=1, answer=len(COMMON_ANSWER) + (len(BELIEF_NAMES) if learns else 0))
    sizes.mpc.slots = 1
    part = allocate(
        ControllerPart, sizes, request=address_of(request), step=address_of(step), takes_late=-1,
        beliefs=len(COMMON_ANSWER) if learns else 0,
    )  # fmt: skip
    if controller is None:
        return part
    informed = part.mpc.informed._replace(learned=controller.learner_memory[None])
    return part._replace(mpc=part.mpc._replace(informed=informed))
