"""What Python writes into the page: how the kernels' records lie in memory, and what is data, never a formula.

Of JSON alone; what it has no number for is text ("NaN", "Infinity", "-Infinity"), arrays are base64.

    layouts     of each record its 8-byte words: {"words": count, "fields": {name: [first word, kind, more]}}
    calls       of each kernel its arguments and what it returns, a letter or a digit each
    image       a record with all that it holds, as numbers of JSON and arrays of base64

Kind of a field: "f" a float64, "i" an int64, "F" and "I" an array of these (more: its dimensions; its words are the
place and the sizes), "R" an array of rows (more: the record), "W" so many float64 in a row (more: their count),
"r" a record (more: which), "S" so many records in a row (more: [which, count]).

The numbers of controllers and worlds are copies, without formulas. Python writes them once, per profile
(`world_numbers`) and kind of controller (`controller_numbers`); of the car there is what a user gives. A row of a
record is a table by the names of its fields; an unknown number is NaN. The program lays rows in its memory (`numbers by
name`), copies into them what is named here, and calls, in this order:

**A car.** Its numbers by name are the keys of a car file, those left out with the defaults of `page_inputs.car_fields`.

1. From a sheet: a row of `models.car.CarRow` with ``mass`` and what else the sheet says, NaN elsewhere, an empty
   `synthesis.car.KnownWithinRow`; ``complete_car(wheelbase, load, truck, car, within)``. Every other number has its
   default; the tyre is that of the default. From a file: `KnownWithinRow` is a copy of the section ``known_within``
   with ``is_given = 1``, or all NaN with ``is_given = 0`` where there is none.
2. `CarRow` is a copy by name; ``car_flaw(car)`` must answer `OK`. So are `synthesis.plant.TyreRow` (``linear`` and
   ``stiffness_load`` are numbers: the places of the words in `page_inputs.car_fields`; ``shape_factor`` is the file's
   ``shape``) and `BodyRow`. ``outline_of(body, car, outline)`` must answer `OK`.

**A world.** The profile's `world_numbers`.

1. ``plant_parameters(car, tyre, actuator, parameters)``; ``plant_law(tyre)`` chooses among ``plants`` which
   functions the `plants.contract.Vehicles` hold.
2. ``plant_substeps(car, tyre, 1, period, top speed of the drive)`` -> ``substeps`` of `simulation.world.LoopSettings`;
   ``dead_periods(delay, actuator.dead_time, period)`` -> ``dead_whole``, ``dead_share``. The rest of Settings are
   copies: of ``settings``, of the actuator (``steering_lag``, ``steering_limit``, ``steering_bias``), of the car
   (``mass``, ``engine_power``, ``traction_limit``, ``brake_limit``) and of the domain (``failure_distance``).
3. ``drive_start(line, offset, turned, pose)`` of `core.planning.drive`, then the speed there: the first four of the 12
   entries of ``start``; the others are zero.

When the truth changes while it drives, 1 and 2 are called again with a changed actuator.

**An informed MPC** (`informed`, `learning`): from ``order`` of `controller_numbers`.

1. Into the row of `synthesis.mpc.Order`: ``car`` and ``within`` of the car; ``file``: lag, dead_time, rate and
   limit of the section ``steering``, NaN where it has none; ``caller``: what a caller believes of lag and dead time.
2. ``informed_numbers(order, numbers)`` must answer `OK`; it writes a row of `synthesis.mpc.MPCNumbers`: tuning, model,
   states, turning, estimator, learner of the `Mpc`. A tuning of the caller's then takes the place of ``tuning``.
   ``learner_memory`` writes ``fresh``, as many numbers as ``learned``.
3. ``settings`` of `controller_numbers` go into ``numbers.settings``; ``longest_horizon`` and ``most_moves`` are those
   of ``settings``, or Np and Nc where these are larger.
4. ``learns`` is ``settings.learns``; on a road ``curved`` and ``feeds_forward`` are 1. ``functions`` names the members.

**The published MPC** (`published`, and with a schedule): ``published_numbers(car, period, numbers)``; there is no
turning, estimator or learner. On a road ``curved`` is 1 and ``feeds_forward`` 0.

**A speed control**: `speed_numbers`.

1. ``settings`` in a row of `speed_control.SpeedSettings`, completed by the period, the car and what ``resistance``
   and ``usable_friction`` answer.
2. ``write_speed_path`` of the plan, then a `core.tracker.longitudinal.Longitudinal` with ``bank`` hypotheses each of
   drive and brakes and ``speed_requests``; ``horizon_cells`` counts the cells ahead. ``top_speed`` of its sample is
   inf, or ``first_top_speed`` of a learner. Its estimate of the friction has no hypotheses without an informed MPC;
   otherwise ``plant_parameters`` of the steering that this assumes, and of ``sensor_variances`` those of ``sensors``.
   ``longitudinal_begin``.
3. ``prescribed_speed`` of the run is ``external_forces``, `control_planned_speed` its ``control_speed``, and there is
   room for ``speeds_ahead`` in ``speeds``. `roll_on` drives; what is seen is in ``frames``, by `show_period`.

**A planner**: `tracker_numbers`, and of `controller_numbers` ``takes_late``, ``position_noise`` and ``patience``. The
run has no controller and asks its caller (`features.asks`), which is a `core.tracker.step.Tracking` with the controller
and the speed control; `page/planner.js` has the order of the calls.

**A law** (`pure-pursuit`, `stanley`, `lqr`): ``common`` is a row of `synthesis.laws.Common`; ``size`` numbers are made
by the kernel that ``made_by`` names, from car and common, of the LQR from its first three tuning entries as well; of
``tuning`` the entry that is NaN is ``steering_delay(file)``.
"""

from __future__ import annotations

import base64
import inspect
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, MAX_SPEED, PREDICTION_HORIZON
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import SteeringActuator, Vehicle, list_vehicles, load_vehicle
from adaptrack.control.controllers import LQR, MPC, Learning, PurePursuit, Stanley, published_mpc
from adaptrack.control.controllers.base import Controller
from adaptrack.control.controllers.informed import order_of
from adaptrack.control.controllers.inputs import MOST_WHEEL_ANGLE
from adaptrack.control.following import DRIVERS, Following, PlannerFollower
from adaptrack.control.scheduling import load_scheduler
from adaptrack.control.speed_control import (
    ASSUMED_KNOWLEDGE,
    FRICTION_COUNT,
    FRICTION_SENSORS,
    LONGEST_STEERING_DELAY,
    SpeedControl,
    patience_of,
    speed_banks,
)
from adaptrack.control.tracker import Tracker, input_check_of, tracker_of
from adaptrack.core.build.units import PAGE_CALLS
from adaptrack.core.controllers import mpc
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.estimators import learning
from adaptrack.core.input_check.record import MEMORY_SIZE, SETTINGS_SIZE, Check
from adaptrack.core.kernel import EXPORTED, OK, Array, Field, Scalar, columns, fields_of, float64, int64, size_of
from adaptrack.core.maths.portable import FUNCTION_NAMES
from adaptrack.core.models.car import PLANT_PARAMETERS, CarRow, SingleTrackCar, SteeringRow
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.tyre import TYRE_NAMES
from adaptrack.core.planned.clock import VERDICT
from adaptrack.core.planned.condition import REVERSE_AHEAD
from adaptrack.core.planning import drive, speed, station_table
from adaptrack.core.planning.cells import PLAN
from adaptrack.core.plants.contract import PLANT_INPUT, PLANT_STATE, PLANT_STATES, SLOTS
from adaptrack.core.roads import path, road  # noqa: F401 (kernels that the page calls)
from adaptrack.core.scheduling.schedule import no_schedule
from adaptrack.core.simulation import run
from adaptrack.core.simulation.frame import FRAME, SPEED_FRAME
from adaptrack.core.simulation.world import EXTERNAL_FORCES, SIGNAL
from adaptrack.core.speed import path as speed_path
from adaptrack.core.speed.friction import CERTAIN_RESERVE
from adaptrack.core.speed.plan import SpeedPlanRecord
from adaptrack.core.synthesis import car, laws, plant
from adaptrack.core.synthesis.mpc import ORDER_FAULTS, MPCNumbers, Order
from adaptrack.core.tracker.longitudinal import Longitudinal
from adaptrack.core.tracker.planner import Arrival
from adaptrack.core.tracker.signals import TRACKED, TRACKER_SAMPLE
from adaptrack.core.tracker.step import Tracking
from adaptrack.drive.closed_loop import LONGEST_SPEEDS_AHEAD
from adaptrack.drive.planner import BACKWARD_LENGTH, PAUSE_DISTANCE, PAUSE_SPEED, SHORTEST_MERGE, SimulatedPlanner
from adaptrack.drive.world import MAX_REQUESTED_SPEED, World
from adaptrack.export.memory import kernel_names
from adaptrack.export.page_inputs import car_fields, page_car, plain
from adaptrack.export.page_setup import GENERATED, PAGE_ROADS, PAPER_ROADS, page_road
from adaptrack.road import Comfort, Line, Road
from adaptrack.road.road_ahead import pack_roads
from adaptrack.road.speed import PLAN_SPACING
from adaptrack.scenario import load_scenario
from adaptrack.scenario.profile import Profile, list_profiles, load_profile

RECORDS = (
    run.RunRecord, run.RunSizes, road.Centreline, station_table.AlongRecord, speed.Planning,
    drive.RoadDriveRecord, Order, MPCNumbers, laws.Common, CarRow, car.KnownWithinRow,
    SteeringRow, plant.TyreRow, plant.Actuator, plant.BodyRow, plant.OutlineRow, Longitudinal,
    speed_path.PlanArrays, SpeedPlanRecord, Tracking, Arrival,
)  # fmt: skip
"""What the engine lays into memory."""
CONTROLLER_KINDS = (
    "informed", "learning", "published", "published-nn", "published-anfis", "pure-pursuit", "stanley", "lqr",
)  # fmt: skip
"""Names of the controllers on the page."""
INPUTS = columns(
    Field("lag", "s", 0.0, "The true lag", "[0, 1]"),
    Field("dead_time", "s", 0.0, "The true dead time", "[0, 1]"),
    Field("bias", "rad", 0.0, "The true bias", "[-0.1, 0.1]"),
    Field("noise", "", 1.0, "The factor on the noise", "[0, 20]"),
    Field("friction", "", 1.0, "The friction", "[0.05, 1.5]"),
    Field("wind", "m/s", 0.0, "The wind", "[-40, 40]"),
    Field("vy", "m/s", 0.0, "The push to the side", "[-10, 10]"),
    Field("yaw_rate", "rad/s", 0.0, "The push that turns", "[-3, 3]"),
    Field("angle", "rad", 0.0, "The pull of the wheel", "[-0.3, 0.3]"),
    Field("duration", "s", 0.0, "How long the wheel is pulled", "[0, 10]"),
    Field("constant", "m/s", 0.0, "The speed", "[1, 60]"),
    Field("lateral", "m/s²", 0.0, "The lateral acceleration", "[0.5, 12]"),
    Field("road_length", "m", 0.0, "", "[10, 100000]"),
    Field("assumed_friction", "", 1.0, "The friction that the speed control assumes", "[0.05, 1.5]"),
    Field("brake_lag", "s", 0.0, "The lag of the brakes", "[0.01, 1]"),
    Field("slope", "", 0.0, "The slope of the road", "[-0.15, 0.15]"),
    Field("mass", "", 1.0, "The factor on the mass", "[0.5, 2]"),
    Field("planner_period", "s", 0.1, "The period of the planner", "[0.02, 2]"),
    Field("planner_delay", "s", 0.0, "The delay of the planner", "[0, 2]"),
    Field("planner_noise", "m", 0.0, "The noise of the planner's points", "[0, 0.5]"),
)
"""What is set on the page, with its bounds."""
MADE_BY = {
    "pure-pursuit": (PurePursuit, laws.pure_pursuit_parameters, laws.PURSUIT),
    "stanley": (Stanley, laws.stanley_parameters, laws.STANLEY),
    "lqr": (LQR, laws.lqr_parameters, laws.LQR_NUMBERS),
}
"""Laws by kind: the controller, the kernel that makes its parameters, and how many these are."""
CAR_FIELDS, DRIVE_FIELDS = ("car", "within", "caller", "file"), ("substeps", "dead_whole", "dead_share")
_WRITTEN = (
    "period", "delay", "ahead", "error_max", "move_min", "move_max", "angle_min", "angle_max", "informed", "learns",
    "curved", "feeds_forward",
)  # fmt: skip
"""Of the settings of an MPC, what kernels write, or the road decides."""
FURTHEST = inspect.signature(Tracker).parameters["furthest"].default
CORE_PACKAGE = "adaptrack.core."
_LETTERS = {"float64": "f", "int64": "i", "boolean": "i", "void": ""}


def page_data() -> dict[str, Any]:
    """All of it."""
    return plain({
        "layouts": layouts(RECORDS), "calls": calls(PAGE_CALLS), "sizes": _sizes(),
        "bounds": {field.name: field.ends for field in fields_of(INPUTS)},
        "words": _words(),
        "cars": {name: page_car(load_vehicle(name)) for name in list_vehicles()}, "inputs": car_fields(),
        "ideal": SteeringActuator.ideal().model_dump(), "comfort": _comfort(),
        "road_defaults": _along(Road.from_segments([Line(length=10.0)])),
        "frame": list(FRAME._fields), "speed_frame": list(SPEED_FRAME._fields), "speed_control": speed_numbers(),
        "tracker": tracker_numbers(),
        "answer": list(mpc.MPC_ANSWER._fields), "beliefs": list(learning.BELIEF_NAMES),
        "no_schedule": image(no_schedule()),
        "profiles": {name: world_numbers(name) for name in list_profiles()},
        "controllers": {
            kind: {name: controller_numbers(kind, name) for name in list_profiles()} for kind in CONTROLLER_KINDS
        },
        "schedules": {name: image(load_scheduler(name).plan(1)) for name in ("road-nn", "road-anfis")},
        "roads": {name: _road(name) for name in PAGE_ROADS}, "tests": {name: _test(name) for name in PAPER_ROADS},
        "places": {"signal": SIGNAL._asdict(), "state": PLANT_STATE._asdict(), "input": PLANT_INPUT._asdict(),
                   "plan": PLAN._asdict(), "measured": MEASUREMENT._asdict(), "tracked": TRACKED._asdict(),
                   "slots": SLOTS, "states": PLANT_STATES},
    })  # fmt: skip


def _sizes() -> dict[str, int]:
    return {
        "parameters": len(PLANT_PARAMETERS), "own_states": len(PLANT_STATE) - 1, "measured": len(MEASUREMENT),
        "common_answer": len(COMMON_ANSWER), "road_numbers": len(road.LINE_NUMBERS), "piece": road.PIECE_COLUMNS,
        "signals": len(SIGNAL), "plan": len(PLAN),
        "published_model": size_of(SingleTrackCar), "most_Np": min(150, int(PREDICTION_HORIZON.most)),
        "most_Nc": min(40, int(CONTROL_HORIZON.most)),
    }  # fmt: skip


def _comfort() -> dict[str, float]:
    """Bounds of a speed plan besides road and car (`core.planning.speed.SpeedBounds`)."""
    unknown = dict.fromkeys(("start", "end", "top_speed"), math.nan)
    return {**Comfort().model_dump(), **unknown, "no_limit": MAX_SPEED.most, "spacing": PLAN_SPACING}


def _along(road: Road) -> dict[str, float]:
    """Signals along a level road of one width, speed limit and friction."""
    names = ("width_left", "width_right", "friction")
    limit = math.inf if road.speed_limit is None else float(road.speed_limit.value[0])
    return {**{key: float(getattr(road, key).value[0]) for key in names}, "speed_limit": limit}


def _road(name: str) -> dict[str, Any]:
    road = page_road(name)
    packed_road = pack_roads([road])
    return {
        "numbers": packed(packed_road.numbers[0]), "start": packed(packed_road.start),
        "pieces": packed(packed_road.pieces), "closed": road.closed, "length": road.length,
        "generated": GENERATED.get(name), **_along(road),
    }  # fmt: skip


def _test(name: str) -> dict[str, Any]:
    """A test of the paper, sampled; x is where a car at the test's speed would be."""
    scenario, period = load_scenario(name), 0.05
    signals = scenario.sample(period)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (signals.speed[1:] + signals.speed[:-1]) * period)])
    unread = signals.wind[:, 0], signals.bank, signals.grade
    if not (np.ptp(signals.friction, axis=1) == 0.0).all() or any(map(np.any, unread)):
        raise InvalidInput(f"test {name!r}: has more than the page knows of.")
    return {
        "period": period, "samples": signals.t.size, "y_ref": packed(signals.y_ref), "speed": packed(signals.speed),
        "friction": packed(signals.friction[:, 0]), "wind": packed(signals.wind[:, 1]),
        "start": list(scenario.start_pose()), "x": packed(x[::10]), "y": packed(signals.y_ref[::10]),
        "width_left": 1.75, "width_right": 1.75, "duration": scenario.duration,
    }  # fmt: skip


def _words() -> dict[str, Any]:
    """Messages for the status codes of kernels, by number."""
    return {
        "plan": ["", "At s = {s} m the road is tighter than this car can turn: choose another road or car.",
                 "At s = {s} m the bank alone pushes with {value} m/s².", "The speed at the start is too high.",
                 "The speed at the end is too high.", "No car can brake in time from the start: start slower.",
                 "No speed can be planned on this road.", "What bounds the speed must be numbers above 0.",
                 "At s = {s} m the grade is too steep for this car.",
                 "At s = {s} m the grade is too steep for this friction."],
        "named": {field.name: field.meaning + (f" ({field.unit})" if field.unit else "")
                  for field in fields_of(INPUTS) if field.meaning},
        "controller": ["", *(f"The controller cannot be made: {fault}" for fault in ORDER_FAULTS.values())],
    }  # fmt: skip


# -- controllers and worlds -------------------------------------------------------------------------------------------
def world_numbers(profile: str | Profile) -> dict[str, Any]:
    """A profile for a program without Python, see the module.

    ``period`` (s), ``delay`` (periods), ``actuator`` (`synthesis.plant.Actuator`), ``settings``
    (`simulation.world.LoopSettings`, all that is not of car or drive), ``remembered`` (instants whose samples are
    kept), ``requested`` (forces that are remembered), ``speed_requests`` (those of a speed control) and ``plants``, the
    names of the functions for each answer of ``plant_law``.
    """
    profile_world, car = load_profile(profile), _any_car()
    world = World.of(DualTrack(car), MPC(car, profile=profile_world), profile_world, None, None, None)
    settings = world.settings(1)._asdict()
    requested = 2 * (2 + max(settings["drive_whole"], settings["brake_whole"]))
    speed = SpeedControl(car).settings(world.period, Comfort())
    theirs = (*DRIVE_FIELDS, "failure_distance", *(key for key in settings if key.startswith("steering_")))
    for key in (*theirs, *world.plant.powertrain):
        del settings[key]
    plants = [
        {member: f"dual_track_{tyre}_{member}" for member in ("advance", "observe")} for tyre in TYRE_NAMES.values()
    ]
    return {
        "period": profile_world.period, "delay": profile_world.delay, "actuator": profile_world.steering.model_dump(),
        "settings": settings, "remembered": world.remembered, "plants": plants, "requested": requested,
        "speed_requests": speed_banks(speed, world.period).requests.size,
    }  # fmt: skip


def speed_numbers() -> dict[str, Any]:
    """A speed control for a program without Python, see the module; all that is not of car, plan or period."""
    settings = SpeedControl(_any_car()).settings(1.0, Comfort())
    names = ("accelerate", "brake", "emergency", "stop_jerk", "governor", "guard", "gain", "patience")
    return {
        "settings": {name: getattr(settings, name) for name in names}, "bank": speed_banks(settings, 1.0).drive.size,
        "speeds_ahead": LONGEST_SPEEDS_AHEAD, "spacing": speed_path.PLACE_SPACING, "external_forces": EXTERNAL_FORCES,
        "knowledge": ASSUMED_KNOWLEDGE, "frictions": FRICTION_COUNT, "sensors": FRICTION_SENSORS,
        "longest_delay": LONGEST_STEERING_DELAY, "reserve": CERTAIN_RESERVE,
    }  # fmt: skip


def tracker_numbers() -> dict[str, Any]:
    """A tracker that follows a planner, and the constants of its simulated planner, for a program without Python.

    ``record`` is the image of a `core.tracker.records.TrackerRecord` with the default settings of a planner; the
    program writes those of car and controller.
    """
    controller, planner = MPC(_any_car(), profile="road"), SimulatedPlanner()
    planned = PlannerFollower(Following(), controller).planned
    record = tracker_of(controller, None, None, FURTHEST, input_check_of(controller), planned)
    return {
        "record": image(record._replace(check=Check(np.zeros(SETTINGS_SIZE), np.zeros(MEMORY_SIZE)))),
        "sample": list(TRACKER_SAMPLE._fields), "widest": MOST_WHEEL_ANGLE, "drivers": list(DRIVERS),
        "taken": VERDICT.taken, "accepted": [OK, REVERSE_AHEAD], "functions": FUNCTION_NAMES,
        "top_speed": MAX_REQUESTED_SPEED,
        "planner": {
            "spacing": planner.spacing, "horizon": planner.horizon, "merge": planner.merge, "behind": BACKWARD_LENGTH,
            "shortest_merge": SHORTEST_MERGE, "pause_distance": PAUSE_DISTANCE, "pause_speed": PAUSE_SPEED,
        },
    }  # fmt: skip


def controller_numbers(kind: str, profile: str) -> dict[str, Any]:
    """A controller of `CONTROLLER_KINDS` in a profile for a program without Python, see the module.

    ``refused``: the sentence why there is none. Otherwise the constants, those of its filter, the name of its
    ``schedule``, its ``diagnostics``, its ``tuning_names`` and its default tuning, ``usual``.
    """
    base, _, scheduled = kind.partition("-")
    world, is_published = load_profile(profile), base == "published"
    if is_published and not math.isfinite(world.noise_vy):
        return {
            "refused": f"The profile “{profile}” has no sensor for the lateral velocity, which the paper's MPC needs: "
            "choose the informed MPC."
        }
    controller = page_controller(base if is_published else kind, _any_car(), world)
    numbers = _law_numbers(kind, controller) if kind in MADE_BY else _mpc_numbers(kind, controller, world)
    return {
        **numbers, "takes_late": controller.takes_late, "position_noise": controller.position_noise,
        "patience": patience_of(controller), "schedule": f"road-{scheduled}" if is_published and scheduled else None,
        "diagnostics": list(controller.diagnostic_names), "tuning_names": list(controller.tuning_names),
        "usual": dict(zip(controller.tuning_names, controller.packed_tuning().tolist(), strict=True)),
    }  # fmt: skip


def page_controller(kind: str, car: Vehicle, profile: Profile) -> Controller:
    """A controller of the page by its name (`CONTROLLER_KINDS`), with its default tuning, for a car in a profile."""
    loop: dict[str, Any] = {"period": profile.period, "preview": profile.preview}
    base, _, scheduled = kind.partition("-")
    if kind in MADE_BY:
        return MADE_BY[kind][0](car, **loop)
    if base == "published":
        return published_mpc(car, scheduler=load_scheduler(f"road-{scheduled}") if scheduled else None, **loop)
    return MPC(car, profile=profile, learning=Learning() if kind == "learning" else "auto")


def _any_car() -> Vehicle:
    """A car none of whose numbers is read."""
    return load_vehicle("paper")


def _mpc_numbers(kind: str, mpc: Any, profile: Profile) -> dict[str, Any]:
    settings, functions = mpc.settings()._asdict(), _functions(mpc)
    for name in _WRITTEN:
        del settings[name]
    if mpc.is_published:
        return {"settings": settings, "functions": functions}
    del settings["preview"]
    learning: Any = Learning() if kind == "learning" else "auto"
    order = _row(order_of(mpc.vehicle, profile, (None, None, learning), None, None, profile.preview)[0])
    for part in CAR_FIELDS:
        del order[part]
    return {"order": order, "settings": settings, "functions": functions}


def _functions(mpc: MPC) -> dict[str, str | None]:
    """The names of the members whose addresses `core.controllers.mpc.Functions` holds."""
    return {"discretise": _name(mpc.model.function), "estimate": _name(mpc.estimator.function)}


def _name(function: Any) -> str | None:
    return None if function is None else getattr(function, "name", function.__name__)


def _law_numbers(kind: str, controller: Any) -> dict[str, Any]:
    law, kernel, size = MADE_BY[kind]
    (low, high), (least, most) = controller.limits.move, controller.limits.angle
    arguments = inspect.signature(law).parameters
    tuning = {
        name: math.nan if arguments[name].default is None else controller.tuning[name]
        for name in controller.tuning_names
    }
    return {
        "common": {
            "period": controller.period, "move_min": low, "move_max": high, "angle_min": least, "angle_max": most,
        },
        "tuning": tuning, "made_by": _name(kernel), "size": size, "function": _name(controller.function),
        "memory": controller.memory_size, "diagnostics": list(controller.diagnostic_names),
        "preview": controller.preview,
    }  # fmt: skip


def _row(row: Any) -> dict[str, Any]:
    """A row of a record as tables in one another."""
    names = row.dtype.names
    return {name: _row(row[name]) if row.dtype[name].names else row[name].tolist() for name in names}


# -- layouts ----------------------------------------------------------------------------------------------------------
def name_of(kind: Any) -> str:
    """A record by its file and its name: "loop.LoopSettings"."""
    return f"{kind.__module__.removeprefix(CORE_PACKAGE)}.{kind.__name__}"


def layouts(kinds: Iterable[Any]) -> dict[str, Any]:
    """The layouts of records and of all that lie in them, by `name_of`."""
    records: dict[str, Any] = {}
    for kind in kinds:
        _add(kind, records)
    return records


def _add(kind: Any, records: dict[str, Any]) -> int:
    """Words of a record, whose layout is then known."""
    name = name_of(kind)
    if name in records:
        return int(records[name]["words"])
    place, fields = 0, {}
    for field, field_kind in kind.kinds.items():
        letter, nested, words = _field(field_kind, records)
        fields[field] = [place, letter] if nested is None else [place, letter, nested]
        place += words
    records[name] = {"words": place, "fields": fields}
    return place


def _field(kind: Any, records: dict[str, Any]) -> tuple[str, Any, int]:
    """Letter, further say and words of a field."""
    if isinstance(kind, tuple):
        of, *shape = kind
        count = math.prod(shape)
        if isinstance(of, Scalar):
            return "W", count, count
        return "S", [name_of(of), count], count * _add(of, records)
    if isinstance(kind, Scalar):
        return _LETTERS[kind.name], None, 1
    if isinstance(kind, Array):
        if isinstance(kind.of, Scalar):
            return _LETTERS[kind.of.name].upper(), kind.ndim, 1 + kind.ndim
        _add(kind.of, records)
        return "R", name_of(kind.of), 2
    return "r", name_of(kind), _add(kind, records)


def calls(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the argument and result types of each kernel: "f", "i" numbers, "r" a record, "1" to "4" arrays."""
    signatures = {name: EXPORTED[name].signature for name in names}
    return {
        name: ["".join(map(_letter, signature.types)), "".join(map(_letter, signature.returns))]
        for name, signature in signatures.items()
    }


def _letter(kind: Any) -> str:
    if isinstance(kind, Scalar):
        return _LETTERS[kind.name]
    return str(kind.ndim) if isinstance(kind, Array) else "r"


# -- values -----------------------------------------------------------------------------------------------------------
def packed(values: Any) -> dict[str, Any]:
    """An array for JSON: its bytes in base64, and its shape; of whole numbers as such."""
    array = np.ascontiguousarray(values)
    is_integer = array.dtype.kind in "iub"
    content = array.astype(np.int64 if is_integer else np.float64, copy=False)
    return {"i8" if is_integer else "f8": base64.b64encode(content.tobytes()).decode(), "shape": list(array.shape)}


def image(record: Any) -> dict[str, Any]:
    """A record with all that it holds; what is zero throughout is given by its shape alone."""
    functions = kernel_names()
    return {field: _value(kind, getattr(record, field), functions) for field, kind in record.kinds.items()}


def _value(kind: Any, value: Any, functions: dict[int, str]) -> Any:
    if hasattr(kind, "kinds"):
        return {field: _value(inner, getattr(value, field), functions) for field, inner in kind.kinds.items()}
    if isinstance(kind, Array):
        if not value.tobytes().strip(b"\0"):
            return {"shape": list(value.shape)}
        if isinstance(kind.of, Scalar):
            return packed(value)
        return {"words": base64.b64encode(np.ascontiguousarray(value).tobytes()).decode(), "shape": list(value.shape)}
    if kind == int64 and value in functions:
        return {"function": functions[value]}
    return packed(np.array([value], np.float64)) if kind == float64 else int(value)
