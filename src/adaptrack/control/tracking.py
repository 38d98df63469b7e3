"""Trackers as records that the kernels take: around any controller, and whole with a compiled one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import MPC, Controller
from adaptrack.control.controllers.base import CompiledController
from adaptrack.control.controllers.inputs import MOST_WHEEL_ANGLE
from adaptrack.control.controllers.mpc import CompiledScheduler
from adaptrack.control.estimation import Perception
from adaptrack.control.input_check import InputCheck
from adaptrack.control.kalman import KalmanFilter
from adaptrack.core.controllers.mpc_step import STEP_INPUT, MPCStep
from adaptrack.core.rollout import law_batch
from adaptrack.core.schedule import no_schedule
from adaptrack.core.tracker import records
from adaptrack.core.tracker.take_call import tracker_engage
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.road_ahead import stacked


def input_check_of(controller: Any) -> InputCheck:
    """The check of the inputs of a controller, for the noise that its filter assumes.

    It tests the delay of the steering that is specified and not learned.
    """
    is_specified = isinstance(controller, MPC) and controller.belief is not None and controller.learner is None
    delay = controller.model.lag + controller.model.dead_time if is_specified else math.inf
    is_filtered = isinstance(controller, MPC) and isinstance(controller.estimator, KalmanFilter)
    noise = controller.estimator.noise.y if is_filtered else 0.0
    return InputCheck(controller.vehicle, float(controller.period), delay, noise)


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
    filtered = isinstance(controller, MPC) and isinstance(controller.estimator, KalmanFilter)
    low, high = (-math.inf, math.inf) if limits is None else limits.angle
    has_car = car is not None
    learner = controller.learner if isinstance(controller, MPC) else None
    return records.TRACKER_SETTINGS.new(
        period=period,
        angle_min=max(low, -MOST_WHEEL_ANGLE),
        angle_max=min(high, MOST_WHEEL_ANGLE),
        move=0.5 * period if limits is None else limits.move[1],
        furthest=furthest,
        late=controller.estimator.late(controller.model) if filtered else 0,
        filtered=filtered,
        drift_arm=car.lr if has_car else 0.0,
        drift_load=car.mass * car.lf if has_car else 0.0,
        drift_stiffness=2.0 * car.stiffness_rear * car.wheelbase if has_car else 1.0,
        nominal_friction=Perception().nominal_friction,
        first_top_speed=math.inf if learner is None else learner.first_top_speed,
    )


def tracking_of(controller: Controller, path: Road, plan: SpeedPlan | None = None, furthest: float = 10.0) -> Any:
    """A tracker with a compiled controller at its start, engaged: `core.tracker.records.Tracking` or `LawTracking`.

    The controller stays as it is. A whole call is `core.tracker.step.tracker_step` or `tracker_step_law`.

    Raises
    ------
    InvalidInput
        When a part of the controller is not compiled.
    """
    scheduler = controller.scheduler
    if not (scheduler is None or isinstance(scheduler, CompiledScheduler)):
        raise InvalidInput(f"tracking_of: scheduler {scheduler!r} is not compiled: give a scheduler of files.")
    tuning = controller.packed_tuning()
    plans = records.scheduling(no_schedule() if scheduler is None else scheduler.plan(1), tuning)
    tracker = tracker_of(controller, path, plan, furthest, input_check_of(controller))
    tracker_engage(0.0, math.nan, tracker)
    if isinstance(controller, MPC):
        if not controller.runs_in_kernel:
            raise InvalidInput(f"tracking_of: solver {controller.solver.name!r} is not compiled: use 'active-set'.")
        mpc = controller.batch(1, controller.settings(), curved=True)
        step = MPCStep(mpc, controller.functions, np.zeros(len(STEP_INPUT)), np.zeros(1), tuning.copy())
        return records.Tracking(tracker, step, plans)
    if not isinstance(controller, CompiledController):
        raise InvalidInput(f"tracking_of: controller {controller.name!r} is not compiled.")
    return records.LawTracking(tracker, law_batch(1, controller), tuning.copy(), plans)
