"""Every bound of every public argument has a row: what lies just beyond it is refused by name, and it is not."""

from __future__ import annotations

import functools
import inspect
import math
import re
import sys
import typing
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import adaptrack as at
from adaptrack.base import checked as checks
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.base.limits import RequestLimit
from adaptrack.road import Line

CAR = at.load_vehicle("paper")
STRAIGHT = at.Road.from_segments([Line(length=50.0)])

BOUNDS = {
    "Body": "length (0, 30]; width (0, 10]; front_overhang rear_overhang [0, 10]",
    "Domain": "wind [0, 100]; lane_width (0, 20]; failure_distance (0, 100]",
    "Drifts": "vy yaw yaw_rate y wheel_angle side turn wind yaw_rate_offset sliding grip [0, inf);"
    "sliding_time least_spare (0, inf)",
    "Driver": "preview guard (0, inf); integral [0, inf)",
    "DualTrack": "steps [1, inf)",
    "FailureLimits": "distance sideslip (0, inf)",
    "FrictionWindEstimator": "period noise_vy noise_yaw_rate noise_acceleration (0, inf)",
    "KalmanFilter": "bound settling distrust trust window[0] window[1] friction (0, inf); oldest [0, 2];"
    "spread[0] spread[1] patience [0, inf); shape_factor (1, 2); longest [0, 5]",
    "KnownWithin": "mass yaw_inertia stiffness_front stiffness_rear load_transfer_time frontal_area air_density"
    " drag_coefficient side_force_slope yaw_moment_slope wind_angle_limit rolling_resistance engine_power"
    " traction_limit brake_limit steering_rate steering_limit steering_ratio [1, 10];"
    "lf track_front track_rear cg_height width front_overhang rear_overhang [0, 5]; length [0, 10];"
    "drive_front brake_front steering_lag steering_dead_time [0, 1]",
    "LQR": "q_e q_heading r (0, inf)",
    "LearnedCar": "lag lag_sigma dead_time dead_time_sigma delay_sigma stiffness_sigma balance_sigma [0, 10];"
    "stiffness balance (0, 100]; bias [-1, 1]; bias_sigma [0, 1]; seconds [0, inf)",
    "Learning": "lags dead_times [1, 12]; bias [0, inf); balance [1, inf)",
    "Limits": "output_weight error (0, inf); ahead [0, inf)",
    "MPC": "computation [0, 1]; period speed_floor (0, inf); longest_horizon [1, 1000]; most_moves [1, 200]",
    "Moves": "pole [0, 1); terms [1, 200]",
    "PathModel": "period (0, inf); lag dead_time [0, inf)",
    "Perception": "noise delay nominal_friction seed [0, inf); friction (0, inf)",
    "Profile": "period (0, 10]; noise_speed [0, 1]; missing [0, 1); dropout_least dropout_most [0, 60];"
    "delay noise_vy noise_yaw noise_yaw_rate noise_y noise_wheel_angle noise_lateral_acceleration bias_yaw_rate"
    " bias_wheel_angle dropout_pause move_weight [0, inf); speed_resolution speed_dead_zone [0, 5];"
    "pose_age pose_age_spread motion_age motion_age_spread station_age speed_age [0, 2];"
    "noise_station [0, 100]; noise_speed_floor [0, 10]",
    "PurePursuit": "lookahead_time [0, inf); lookahead_min (0, inf)",
    "RoadDrive": "laps [1, inf); start_heading (-pi/2, pi/2)",
    "RoadDrive.sample": "period (0, inf)",
    "Scenario": "duration (0, inf)",
    "Scenario.sample": "period (0, inf)",
    "SensorNoise": "vy yaw yaw_rate y wheel_angle lateral_acceleration yaw_rate_offset [0, inf)",
    "SingleTrack": "steps [1, inf)",
    "SingleTrackModel": "period (0, inf)",
    "SpeedControl": "gain [0.1, 10]; governor guard [0.1, 1]; stop_jerk [0.1, 20]; emergency [1, 15]",
    "Steering": "lag dead_time [0, 10]; rate ratio (0, 100]; limit (0, pi/2]",
    "SteeringActuator": "lag dead_time [0, 10]; rate (0, inf); limit (0, pi/2]; bias [-pi/4, pi/4]",
    "SteeringTest": "angle [0.02, 0.15]",
    "Tracker": "furthest (0, inf)",
    "Trajectory": "period (0, inf)",
    "Tyre": "stiffness_front stiffness_rear (0, 1e7]; nominal_load (0, 1e6]; digressive_load_ratio (0, 100];"
    "shape [0.5, 2]; curvature [-20, 1]; friction_load_sensitivity [0, 1]; relaxation_length [0, 10]",
    "Uncertainty": "lag dead_time [0, 1]; stiffness [1, 4]; mass [0, 0.9]",
    "UserModel": "period (0, inf)",
    "UserPlant": "mass longest_step engine_power traction_limit brake_limit (0, inf); steps [1, inf)",
    "Vehicle": "mass (0, 1e5]; yaw_inertia stiffness_front stiffness_rear engine_power (0, 1e7]; lf lr (0, 20];"
    "track_front track_rear load_transfer_time (0, 10]; cg_height [0, 5]; frontal_area [0, 50];"
    "air_density drag_coefficient [0, 10]; side_force_slope yaw_moment_slope [0, 100]; wind_angle_limit (0, pi/2];"
    "rolling_resistance drive_front brake_front [0, 1]; traction_limit brake_limit (0, 1e6]",
    "check_plant": "period (0, inf)",
    "compute_metrics": "move_weight [0, inf)",
    "export_fmu": "period furthest (0, inf)",
    "fit_road": "max_deviation (0, inf)",
    "generate_road": "seed [0, inf); length [100, 1e5]",
    "identify": "mass [1, 1e5]; wheelbase [0.1, 20]; computation [0, 1)",
    "path_metrics": "lane_width steering_ratio (0, inf)",
    "plan_speed": "start end [0, inf); top_speed (0, 100]; spacing [0.01, 100]",
    "random_drive": "seed wind [0, inf); duration (0, 86400]; speed[0] speed[1] lane_width (0, inf);"
    "friction[0] friction[1] (0, 3]; demand[0] demand[1] (0, 1]; heading (0, 0.5]",
    "road_through": "noise [0, inf)",
    "rollout": "seed [0, 2**63)",
    "shadow": "computation [0, 1)",
    "simulate": "seed [0, 2**63)",
    "vehicle_from_data_sheet": "mass [600, 3500]; wheelbase [1.7, 5]; load [0, inf)",
}
"""Intervals of the arguments of each public call whose annotations have bounds."""


def steer_straight(situation, reference, road, tuning, parameters, memory, answer):
    """A law that asks nothing."""
    answer[0] = 0.0


def stop(*_):
    """End a call as soon as it begins to work."""
    raise TypeError("at work")


IN_BODIES: dict[str, tuple[Callable[..., Any], str]] = {
    "KinematicMPC": (lambda **given: at.KinematicMPC(CAR, **given),
                     "cutoff [0, inf); stages [1, 100]; step period (0, inf); computation [0, 1]"),
    "LQR": (lambda **given: at.LQR(CAR, **given), "preview_time [0, inf); period (0, inf)"),
    "PreviewLQR": (lambda **given: at.PreviewLQR(CAR, **given),
                   "q_e q_heading r period (0, inf); ahead (-inf, 10]; computation [0, 1]"),
    "PurePursuit": (lambda **given: at.PurePursuit(CAR, **given), "period (0, inf)"),
    "Reading": (at.Reading, "steering_ratio [0.1, 100]"),
    "RoadDrive": (lambda speed: at.RoadDrive(STRAIGHT, speed), "speed (0, 100]"),
    "Stanley": (lambda **given: at.Stanley(CAR, **given),
                "gain softening yaw_rate_gain dead_time [0, inf); period (0, inf)"),
    "Tuning": (at.Tuning, "Np [1, 1000]; Nc [1, 200]; Q [0, inf); R (0, inf)"),
    "UserController": (lambda **given: at.UserController(steer_straight, **given), "period (0, inf)"),
    "check_estimator": (lambda speed: at.check_estimator(at.KalmanFilter(), at.PathModel(CAR, 0.1), speed=speed),
                        "speed (0, inf)"),
    "check_road": (lambda speed: at.check_road(STRAIGHT, CAR, speed=speed), "speed (0, inf)"),
    "get_model": (lambda period: at.get_model("single-track", CAR, period), "period (0, inf)"),
    "published_mpc": (lambda period: at.published_mpc(CAR, period=period), "period (0, inf)"),
    "tune": (lambda seed: at.tune(CAR, seed=seed, progress=stop), "seed [0, inf)"),
}  # fmt: skip
"""Calls with all other arguments, and intervals that function bodies check."""

UNBOUNDED = {
    "KinematicMPC": {"weights"}, "RoadAhead": {"station"}, "RoadDrive": {"reference"}, "Trajectory": {"failed_at"},
    "UserController": {"memory_size"}, "UserEstimator": {"memory_size"}, "check_estimator": {"steps"},
    "check_scheduler": {"samples", "seed"}, "export_c": {"furthest"},
    "export_page": {"speed", "lateral_acceleration", "seed"}, "rollout_batch": {"threads"},
}  # fmt: skip
"""Numbers in signatures of public calls that have no interval, or one that depends on other arguments."""
PLACES = {"-pi/2": -math.pi / 2, "-pi/4": -math.pi / 4, "pi/4": math.pi / 4, "pi/2": math.pi / 2, "2**63": 2**63}
"""Numbers by what the rows call them."""
RECORDS = {"Identification", "Metrics", "PathMetrics", "PathRecord", "Road"}
"""What only this package makes."""


class Bound(NamedTuple):
    """An end of the interval in which an argument lies, or an entry of a pair."""

    argument: str
    """with the number of the entry in brackets"""
    sign: str
    value: float

    def __str__(self) -> str:
        return f"{self.argument} {self.sign} {self.value:.6g}"

    def refused(self) -> list[Any]:
        """No number, and what is next to the end on its wrong side: a float and, at a whole number, an int."""
        is_low, is_open = self.sign[0] == ">", len(self.sign) == 1
        beyond = self.value if is_open else math.nextafter(self.value, -math.inf if is_low else math.inf)
        whole = int(self.value) + (0 if is_open else -1 if is_low else 1)
        return [math.nan, beyond, *([whole] if float(self.value).is_integer() else [])]

    def arguments(self, value: Any) -> dict[str, Any]:
        """The argument with this value, the other entry of a pair within its bounds."""
        name, _, entry = self.argument.partition("[")
        return {name: value if not entry else (value, 0.5) if entry == "0]" else (0.5, value)}


def read_row(text: str) -> set[Bound]:
    """The bounds of a row: names and the interval of them all, such as "lag dead_time [0, 10]; rate (0, inf)"."""
    bounds = set()
    for names, opening, low, high, closing in re.findall(r"([\w\[\] ]+) ([(\[])([^,;]+), ([^;]+)([)\]])", text):
        for name in names.split():
            ends = ((">" if opening == "(" else ">=", low), ("<" if closing == ")" else "<=", high))
            bounds |= {Bound(name, sign, PLACES.get(end) or float(end)) for sign, end in ends if "inf" not in end}
    return bounds


@functools.cache
def public_calls() -> dict[str, Any]:
    """Public functions and classes, and the public methods of classes."""
    calls = {name: getattr(at, name) for name in at.__all__ if callable(getattr(at, name))}
    for name, call in list(calls.items()):
        if isinstance(call, type):
            methods = {method: getattr(call, method) for method in vars(call) if not method.startswith("_")}
            calls |= {f"{name}.{method}": member for method, member in methods.items() if inspect.isfunction(member)}
    return calls


def annotations_of(call: Any) -> dict[str, Any]:
    """The annotations of the arguments of a call."""
    if isinstance(call, type) and issubclass(call, BaseModel):
        return {name: Annotated[field.annotation, field] for name, field in call.model_fields.items()}
    target = inspect.unwrap(call.__init__ if isinstance(call, type) else call)
    if not inspect.isfunction(target):
        return {}
    space = vars(sys.modules[target.__module__])
    annotations = inspect.get_annotations(target, locals=checks._Names([space]), eval_str=True)
    return {name: annotation for name, annotation in annotations.items() if name != "return"}


def bounds_in(annotation: Any, name: str) -> Iterator[Bound]:
    """The bounds that an annotation states."""
    field = FieldInfo.from_annotation(checks._without_none(annotation))
    for constraint in field.metadata:
        if isinstance(constraint, RequestLimit):
            yield Bound(name, "<=", constraint.most)
        for attribute, sign in (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<=")):
            value = getattr(constraint, attribute, None)
            if value is not None and math.isfinite(value):
                yield Bound(name, sign, value)
    inner = checks._without_none(field.annotation)
    if typing.get_origin(inner) is tuple and ... not in typing.get_args(inner):
        for i, part in enumerate(typing.get_args(inner)):
            yield from bounds_in(part, f"{name}[{i}]")


@pytest.mark.parametrize("name", sorted(public_calls()))
def test_every_bound_in_an_annotation_has_a_row(name: str) -> None:
    annotations = annotations_of(public_calls()[name])
    bounds = {bound for argument, kind in annotations.items() for bound in bounds_in(kind, argument)}
    assert bounds == read_row(BOUNDS.get(name, ""))


@pytest.mark.parametrize("name", sorted({name for name in public_calls() if "." not in name} - RECORDS))
def test_every_number_without_a_bound_in_its_annotation_has_a_row(name: str) -> None:
    annotations = annotations_of(public_calls()[name])
    plain = {argument for argument, kind in annotations.items() if {int, float} & set(checks._parts(kind))}
    rows = {bound.argument for bound in read_row(IN_BODIES[name][1] if name in IN_BODIES else "")}
    assert plain == rows | UNBOUNDED.get(name, set())


CHECKED = {name: (public_calls()[name], row) for name, row in BOUNDS.items()}
ROWS = [
    (name, functools.partial(call, None) if "." in name else call, bound)
    for name, (call, row) in [*CHECKED.items(), *IN_BODIES.items()]
    for bound in sorted(read_row(row))
]


@pytest.mark.parametrize(("call", "bound"), [row[1:] for row in ROWS], ids=[f"{row[0]} {row[2]}" for row in ROWS])
def test_what_lies_just_beyond_a_bound_is_refused_and_the_bound_is_not(call: Any, bound: Bound) -> None:
    name = re.escape(bound.argument).replace("_", "[_ ]")
    for value in bound.refused():
        with pytest.raises(InvalidInput, match=rf"{name}.*{re.escape(format_value(value))}"):
            call(**bound.arguments(value))
    if len(bound.sign) == 2:
        refusal = ""
        try:
            call(**bound.arguments(int(bound.value) if bound.value.is_integer() else bound.value))
        except (InvalidInput, TypeError) as error:  # others are missing, or it is at work
            refusal = str(error)
        assert not re.search(rf"{re.escape(bound.argument)} = [^:]*: (must be|at most)", refusal)
