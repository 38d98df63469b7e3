"""What Python writes into the page: how the kernels' records lie in memory, and what is data, never a formula.

Of JSON alone; what it has no number for is text ("NaN", "Infinity", "-Infinity"), arrays are base64.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, MAX_SPEED, PREDICTION_HORIZON
from adaptrack.cars.vehicle import SteeringActuator, list_vehicles, load_vehicle
from adaptrack.control.scheduling import load_scheduler
from adaptrack.core.build.page import CALLED
from adaptrack.core.controllers import mpc
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.estimators import learning
from adaptrack.core.kernel import Field, columns, fields_of, size_of
from adaptrack.core.models.car import PLANT_PARAMETERS, CarRow, SingleTrackCar, SteeringRow
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.planning import drive, speed, station_table
from adaptrack.core.planning.cells import PLAN
from adaptrack.core.plants.contract import PLANT_INPUT, PLANT_STATE, PLANT_STATES, SLOTS
from adaptrack.core.roads import path, road  # noqa: F401 (kernels that the page calls)
from adaptrack.core.scheduling.schedule import no_schedule
from adaptrack.core.simulation import run
from adaptrack.core.simulation.frame import FRAME, SPEED_FRAME
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.core.speed import path as speed_path
from adaptrack.core.synthesis import car, laws, plant
from adaptrack.core.synthesis.mpc import ORDER_FAULTS, MPCNumbers, Order
from adaptrack.core.tracker.longitudinal import Longitudinal
from adaptrack.export.page_controllers import controller_numbers, speed_numbers, world_numbers
from adaptrack.export.page_inputs import car_fields, page_car, plain
from adaptrack.export.page_layout import calls, image, layouts, packed
from adaptrack.export.page_setup import GENERATED, PAGE_ROADS, PAPER_ROADS, controller_of, page_road
from adaptrack.road import Comfort, Line, Road
from adaptrack.road.road_ahead import pack_roads
from adaptrack.road.speed import PLAN_SPACING
from adaptrack.scenario import load_scenario
from adaptrack.scenario.profile import list_profiles, load_profile

RECORDS = (
    run.RunRecord, run.RunSizes, road.Centreline, station_table.AlongRecord, speed.Planning,
    drive.RoadDriveRecord, Order, MPCNumbers, laws.Common, CarRow, car.KnownWithinRow,
    SteeringRow, plant.TyreRow, plant.Actuator, plant.BodyRow, plant.OutlineRow, Longitudinal,
    speed_path.PlanArrays,
)  # fmt: skip
"""What the engine lays into memory."""
CONTROLLER_KINDS = {
    "informed": "informed MPC", "learning": "informed MPC + learning", "published": "the paper's MPC",
    "published-nn": "the paper's MPC, scheduled by networks", "published-anfis": "the paper's MPC, scheduled by ANFIS",
    "pure-pursuit": "pure pursuit", "stanley": "Stanley", "lqr": "LQR",
}  # fmt: skip
"""Descriptions of the controllers on the page, by name."""
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
)
"""What is set on the page, with its bounds."""


def page_data() -> dict[str, Any]:
    """All of it."""
    return plain({
        "layouts": layouts(RECORDS), "calls": calls(CALLED), "sizes": _sizes(),
        "bounds": {field.name: field.ends for field in fields_of(INPUTS)},
        "words": _words(),
        "cars": {name: page_car(load_vehicle(name)) for name in list_vehicles()}, "inputs": car_fields(),
        "ideal": SteeringActuator.ideal().model_dump(), "comfort": _comfort(), "road_defaults": _along(_straight()),
        "frame": list(FRAME._fields), "speed_frame": list(SPEED_FRAME._fields), "speed_control": speed_numbers(),
        "answer": list(mpc.MPC_ANSWER._fields), "beliefs": list(learning.BELIEF_NAMES),
        "no_schedule": image(no_schedule()),
        "profiles": {name: world_numbers(name) for name in list_profiles()},
        "controllers": {kind: {name: _controller(kind, name) for name in list_profiles()} for kind in CONTROLLER_KINDS},
        "schedules": {name: image(load_scheduler(name).plan(1)) for name in ("road-nn", "road-anfis")},
        "roads": {name: _road(name) for name in PAGE_ROADS}, "tests": {name: _test(name) for name in PAPER_ROADS},
        "places": {"signal": SIGNAL._asdict(), "state": PLANT_STATE._asdict(), "input": PLANT_INPUT._asdict(),
                   "plan": PLAN._asdict(), "slots": SLOTS, "states": PLANT_STATES},
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
    defaults = {
        "start": math.nan,
        "end": math.nan,
        "top_speed": math.nan,
        "no_limit": MAX_SPEED.most,
        "spacing": PLAN_SPACING,
    }
    return {**Comfort().model_dump(), **defaults}


def _straight() -> Road:
    return Road.from_segments([Line(length=10.0)])


def _along(road: Road) -> dict[str, float]:
    """Signals along a level road of one width, speed limit and friction."""
    names = ("width_left", "width_right", "friction")
    limit = math.inf if road.speed_limit is None else float(road.speed_limit.value[0])
    return {**{key: float(getattr(road, key).value[0]) for key in names}, "speed_limit": limit}


def _controller(kind: str, profile: str) -> dict[str, Any]:
    """The constants of a kind of controller in a profile, its schedule and the names of what it says."""
    base, _, scheduled = kind.partition("-")
    law = kind in ("pure-pursuit", "stanley", "lqr")
    world = load_profile(profile)
    if base == "published" and not math.isfinite(world.noise_vy):
        return {
            "refused": f"The profile “{profile}” has no sensor for the lateral velocity, which the paper's MPC needs: "
            "choose the informed MPC."
        }
    plain = kind if law else base
    controller, numbers = (
        controller_of({"kind": plain}, load_vehicle("paper"), world),
        controller_numbers(plain, profile),
    )
    return {
        **numbers, "words": CONTROLLER_KINDS[kind],
        "schedule": f"road-{scheduled}" if base == "published" and scheduled else None,
        "diagnostics": list(controller.diagnostic_names), "tuning_names": list(controller.tuning_names),
        "usual": dict(zip(controller.tuning_names, controller.packed_tuning().tolist(), strict=True)),
    }  # fmt: skip


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
