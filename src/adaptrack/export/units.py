"""Units of co-simulation (see `core.units`) as an export describes them: their values by name, and the record."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Bound, NotNegative, Positive, Whole, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import python_part
from adaptrack.control.following import Following, PlannerFollower
from adaptrack.control.speed_control import SpeedControl, horizon_cells, longitudinal_of, speed_path
from adaptrack.core.kernel import Field
from adaptrack.core.planned.records import PLANNED_MEMORY, POINT
from adaptrack.core.plants.contract import place, vehicle_batch
from adaptrack.core.simulation.run import RunInputs
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.core.tracker.followed import FOLLOWED_MEMORY, Followed
from adaptrack.core.tracker.planner import PARTS
from adaptrack.core.units import car, controller, follower
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.world import Driver, World
from adaptrack.export.tracking import ROLES, refuse, room_of, small_record_of, speed_part, trajectory_words
from adaptrack.road import Road, SpeedPlan
from adaptrack.road.road_ahead import pack_roads
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import Profile, load_profile

REAL, WHOLE_VALUE, TRUTH, PARAMETER, INPUT_VALUE, CONSTANT_VALUE, ELEMENT = 0, 1, 2, 4, 8, 16, 32
"""What a value is, as `fmu.h` numbers it: its type and its role, an output without one; then whether it belongs to the
array of the value before."""
ENDLESS = 2**62
"""Control periods of a drive without an end."""
MAX_FREE_SPEED = 70.0
"""m/s, to which a car is integrated where no drive says how fast it goes."""
TrajectoryPoints = Annotated[Whole, within(2, 1000)]
"""Points that a trajectory has at most: the length of the arrays of its inputs."""
DEFAULT_TRAJECTORY_POINTS = 100


@dataclass(frozen=True)
class UnitValue:
    """One of the numbers of a unit; its place is its reference."""

    name: str
    kind: int
    """type and role, see `REAL`"""
    unit: str
    """empty for a pure number"""
    description: str
    start: float = 0.0
    least: float = -math.inf
    most: float = math.inf

    @property
    def type(self) -> int:
        """`REAL`, `WHOLE_VALUE` or `TRUTH`."""
        return self.kind & 3

    @property
    def role(self) -> int:
        """`PARAMETER`, `INPUT_VALUE`, `CONSTANT_VALUE`, or 0 of an output."""
        return self.kind & (PARAMETER | INPUT_VALUE | CONSTANT_VALUE)


@dataclass(frozen=True)
class Unit:
    """A unit before its first instant."""

    name: str
    title: str
    record: Any
    values: tuple[UnitValue, ...]
    """beginning with the constants"""
    constants: tuple[str, ...]
    """dotted names of arrays, or of records of them, that do not change"""

    @property
    def follows(self) -> bool:
        """Whether trajectories are inputs."""
        return isinstance(self.record, follower.FollowerUnit)

    @property
    def period(self) -> float:
        """s, of a step."""
        return next(value.start for value in self.values if value.name == "period")


def unit_values(
    groups: Mapping[int, Iterable[Field]], starts: Mapping[str, float], **lengths: int
) -> tuple[UnitValue, ...]:
    """The values of a unit by their fields.

    groups: constants, parameters, inputs and outputs by their role (`CONSTANT_VALUE`, `PARAMETER`, `INPUT_VALUE`, 0);
    starts: where they are not the defaults; lengths: of those that are arrays, which become values
    ``name[1]``, ``name[2]``, .... Closed bounds are limits; what is beyond open ones counts as not measured.
    """
    values = []
    for role, fields in groups.items():
        for field in fields:
            kind = TRUTH if field.is_truth else WHOLE_VALUE if isinstance(field.default, int) else REAL
            start = starts.get(field.name, np.nan_to_num(field.default))
            limits = field.ends if field.bounds.startswith("[") else ()
            names = [f"{field.name}[{i + 1}]" for i in range(lengths.get(field.name, 0))] or [field.name]
            values += [
                UnitValue(name, kind | role | (ELEMENT if i else 0), field.unit, field.meaning, float(start), *limits)
                for i, name in enumerate(names)
            ]
    return tuple(values)


@checked
def car_unit(
    plant: Plant,
    route: Scenario | RoadDrive | None = None,
    *,
    profile: str | Profile = "paper",
    driver: Driver | SpeedControl | None = None,
    period: Positive | None = None,
) -> Unit:
    """A car of the simulated world as a unit: what `simulate` puts around a controller, without plan and environment.

    route: where it starts and how fast, and the road from which its offset counts; None: at the origin, at 20 m/s;
    driver: with a `SpeedControl` the inputs ``force`` and ``hold`` move the car through its drive and brakes. Raises
    InvalidInput when the plant is none of the package's own, or the driver looks ahead by less than a period.
    """
    world = _world(plant, profile, driver, period)
    road = getattr(route, "road", None)
    if route is None:
        pose, speed, fastest = (0.0, 0.0, 0.0), 20.0, MAX_FREE_SPEED
    else:
        signals = route.sample(world.period)
        pose, speed, fastest = route.start_pose(), float(signals.speed[0]), float(signals.speed.max())
    ahead = driver.preview if isinstance(driver, Driver) else world.period
    if ahead < world.period:
        raise InvalidInput(f"driver: preview = {ahead:g} s: must be a control period at least, {world.period:g} s.")
    samples = math.floor(ahead / world.period) + 2
    motion = np.array([*pose, speed, 0.0, 0.0])
    vehicles = vehicle_batch(world.plant.compiled, world.plant.packed(), world.plant.initial_state(motion)[None])  # type: ignore[union-attr]
    place(1, vehicles.start, vehicles.block, vehicles.states)
    inputs = RunInputs(
        np.zeros((1, len(SIGNAL), samples)), pack_roads([road]), np.zeros(1, np.int64), np.zeros(1, np.int64),
        np.array([ENDLESS]),
    )  # fmt: skip
    settings = world.settings(world.substeps(fastest))
    run = world.run(inputs, vehicles, settings, python_part(None, None), needs_variables=False, asks=True)
    run = run._replace(features=run.features._replace(window=1))
    starts = {
        "period": world.period, "speed_preview": ahead,
        **dict(zip(("start_x", "start_y", "start_yaw"), pose, strict=True)),
        **dict.fromkeys(("start_speed", "speed", "speed_ahead"), speed),
    }  # fmt: skip
    groups = {
        CONSTANT_VALUE: car.CAR_CONSTANTS,
        PARAMETER: car.PARAMETERS,
        INPUT_VALUE: car.CAR_INPUTS,
        0: car.CAR_OUTPUTS,
    }
    values = unit_values(groups, starts)
    record = car.CarUnit(*_columns(values), run=run)
    title = f"car {(getattr(plant, 'vehicle', None) or plant).name}, {plant.name}, profile {world.profile.name}"
    return Unit("car", title, record, values, (*UNIT_CONSTANTS, "run.vehicles.parameters", "run.inputs.roads"))


@checked
def controller_unit(
    built_controller: Controller,
    path: Road | None = None,
    plan: SpeedPlan | None = None,
    *,
    furthest: Annotated[Bound, "m"] = 10.0,
    speed_preview: Annotated[NotNegative, "s"] | None = None,
    speed: SpeedControl | None = None,
    following: Following | None = None,
    trajectory_points: TrajectoryPoints = DEFAULT_TRAJECTORY_POINTS,
) -> Unit:
    """A controller with its tracker on a path as a unit: what `Tracker.step` does, once a period.

    plan, furthest: as of `Tracker`; speed_preview: how far ahead the driven car needs its planned speed, by default a
    period; speed: the speed control behind the tracker, for which the plan counts; the grade is that of the path, under
    the car the input ``grade`` where it is known; following: how trajectories are followed, which are inputs then, of
    at most `trajectory_points` points. Without a path the car stands until the first one. The comfort of a speed
    control is that of `following`. What the controller has learned so far travels along; it stays as it is.

    Raises InvalidInput when the controller, or a part of it, is not compiled ahead of time, or a speed control has no
    plan, or there is neither a path nor `following`.
    """
    refuse(built_controller)
    if path is None and following is None:
        raise InvalidInput("controller_unit: path: give a Road, or following=Following() for a planner's trajectories.")
    if speed is not None and plan is None and path is not None:
        raise InvalidInput("controller_unit: speed: a speed control follows a plan; give plan=plan_speed(path, car).")
    planner_part = None if following is None else PlannerFollower(following, built_controller)
    cells, longitudinal, title = 0, None, f"controller {built_controller.name}"
    if path is not None:
        title = f"{title} on {path.name}"
    if speed is not None:
        longitudinal, cells = _speed_control(speed, built_controller, path, plan, planner_part)
        title = f"{title}, with speed control"
    planned = None if planner_part is None else planner_part.planned
    tracking = small_record_of(built_controller, path, plan, furthest, longitudinal=longitudinal, planned=planned)
    first = 0.0 if plan is None else float(plan.speed[0])
    ahead = built_controller.period if speed_preview is None else speed_preview
    expected = getattr(built_controller.model, "dead_time", 0.0)
    starts = {
        "period": built_controller.period, "expected_delay": expected, "speed_preview": ahead,
        **dict.fromkeys(("pose_known", "yaw_rate_known"), 1.0),
        **dict.fromkeys(("planned_speed", "planned_speed_ahead"), first),
    }  # fmt: skip
    horizon = int(room_of(built_controller).longest) if tracking.controller.plans else 0
    groups = {
        CONSTANT_VALUE: controller.STEERING_CONSTANTS, PARAMETER: controller.PARAMETERS,
        INPUT_VALUE: controller.STEERING_INPUTS,
        0: controller.STEERING_OUTPUTS + (() if speed is None else controller.SPEED_OUTPUTS)
           + (controller.PREDICTION_OUTPUTS if horizon else ()),
    }  # fmt: skip
    values = unit_values(groups, starts, predicted_x=horizon, predicted_y=horizon)
    constants = (*UNIT_CONSTANTS, *(f"tracking.{name}" for name in (*ROLES.fixed, *ROLES.outside)))
    if following is None:
        record = controller.SteeringUnit(*_columns(values), tracking=tracking, points=np.zeros(2 * horizon))
        return Unit("controller", title, record, values, constants)
    all_values = values + _follower_values(trajectory_points, speed is not None)
    words, plan_words = trajectory_words(trajectory_points, speed is not None)
    room = trajectory_points, len(POINT)
    followed = Followed(
        FOLLOWED_MEMORY.new(1, half=-1), np.zeros((2, words)), np.zeros((2, len(PARTS)), np.int64),
        np.zeros((2, plan_words)), np.zeros(cells), np.zeros(1, np.int64), np.zeros(room), PLANNED_MEMORY.new(1),
    )  # fmt: skip
    record = follower.FollowerUnit(
        *_columns(all_values), tracking=tracking, points=np.zeros(2 * horizon), first=len(values),
        followed=followed, trajectory=np.zeros(room), fallback=np.zeros(room), handed_over=np.zeros(2),
    )  # fmt: skip
    return Unit("controller", f"{title}, follows trajectories", record, all_values, (*constants, "followed.road"))


def _speed_control(
    control: SpeedControl, built_controller: Controller, path: Any, plan: Any, planner_part: PlannerFollower | None
) -> tuple[Any, int]:
    """A speed control at its start, and how many cells it looks ahead along the fastest trajectory.

    planner_part: with one trajectories may be as fast as the highest speed of the car's domain.
    """
    following, top_speed = None, 0.0
    if planner_part is not None:
        following, top_speed = planner_part.following, control.car.domain.speed[1]
        path, plan = planner_part.standing_plan() if path is None else (path, plan)
    start = speed_part(control, built_controller, plan, top_speed, following).start
    way = speed_path(path, plan, control.stop_at_end)
    longitudinal = longitudinal_of(control, built_controller.period, start, way, built_controller)
    ahead = longitudinal.ahead[: horizon_cells(float(plan.speed.max()), longitudinal.settings)]
    return longitudinal._replace(ahead=ahead), longitudinal.ahead.size


def _follower_values(points: int, has_speed: bool) -> tuple[UnitValue, ...]:
    """The values of a unit for trajectories of at most so many points."""
    counted = (field._replace(bounds=f"[0, {points}]") if field.name.endswith("count") else field
               for field in follower.FOLLOWER_INPUTS)  # fmt: skip
    arrays = follower.FOLLOWER_ARRAYS
    inputs = unit_values({INPUT_VALUE: (*counted, *arrays)}, {}, **{field.name: points for field in arrays})
    outputs = (*(() if has_speed else (follower.TARGET_OUTPUT,)), *follower.FOLLOWER_OUTPUTS)
    return inputs + unit_values({0: outputs}, {})


UNIT_CONSTANTS = ("kinds", "least", "most")
"""Constant arrays of every unit."""


def _columns(values: tuple[UnitValue, ...]) -> tuple[NDArray[Any], ...]:
    """Values, kinds, least and most as the kernels read them."""
    kinds = np.array([value.kind for value in values], np.int64)
    return (np.array([value.start for value in values]), kinds, np.array([value.least for value in values]),
            np.array([value.most for value in values]))  # fmt: skip


def _world(plant: Plant, profile: str | Profile, driver: Driver | SpeedControl | None, period: float | None) -> World:
    """The world of a car alone: it has no reference, from which it could come away."""
    world = load_profile(profile)
    if getattr(plant, "steering", None) is None:
        plant = plant.with_steering(world.steering)
    rule = FailureLimits(distance=math.inf, sideslip=FailureLimits.of(plant).sideslip)
    return World(plant, world, world.period if period is None else period, driver, None, rule)
