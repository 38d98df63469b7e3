"""Arguments: what is no number is refused in one short sentence, and every bound has a row beyond which it refuses."""

from __future__ import annotations

import decimal
import enum
import fractions
import functools
import inspect
import math
import re
import sys
import typing
from collections.abc import Callable, Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from pydantic import BaseModel
from pydantic.fields import FieldInfo

import adaptrack as at
from adaptrack.base import checked as checks
from adaptrack.base.checked import real, reals, whole_number
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.base.limits import RequestLimit
from adaptrack.road import Line, Road, fit_road, road_through

CAR = at.load_vehicle("compact-ev")
ROAD = Road.from_segments([Line(length=50.0)])
NO_NUMBERS: tuple[Any, ...] = (
    "abcd", b"ab", object(), {"a": 1}, 1j, [1j] * 4, ["a"] * 4, [object()] * 4, [None] * 4, [[1.0, 2.0], [3.0]],
    [["a", "b"]] * 10,
)  # fmt: skip
"""Neither one number nor a row or table of them."""
TOO_LARGE: tuple[Any, ...] = (10**400, -(10**400), 10**5000, fractions.Fraction(10**400, 3))


def refusal(call: Any, *arguments: Any) -> str:
    """The sentence by which something is refused."""
    with pytest.raises(InvalidInput) as refused:
        call(*arguments)
    return str(refused.value)


def test_what_is_no_array_of_numbers_is_refused_in_a_short_sentence():
    plant, friction = at.SingleTrack(CAR), at.FrictionWindEstimator(CAR, period=0.05)
    still, around = plant.initial_state([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), [0.9] * 4 + [0.0] * 2
    calls = {
        "reals": lambda value: reals("numbers", value), "through": road_through, "from_points": fit_road,
        "at": ROAD.at, "project": lambda value: ROAD.project(value, 0.0),
        "ahead": lambda value: at.RoadAhead(ROAD, 0.0, value), "yaw_of": at.yaw_of,
        "initial_state": plant.initial_state, "derivative": lambda value: plant.derivative(still, value, around),
        "friction": lambda value: friction.step(value, 10.0, 0.0),
        "scenario": lambda value: at.Scenario.from_arrays([0.0, 1.0], value, 10.0, 0.9),
        "log": lambda value: at.identify({"time": value}, CAR),
    }  # fmt: skip
    for name, call in calls.items():
        for value in (None, *NO_NUMBERS):
            sentence = refusal(call, value)
            assert len(sentence) < 200, name
            assert "\n" not in sentence, name


CALLS = {name: getattr(at, name) for name in at.__all__ if callable(getattr(at, name))}
RESULTS = {"Identification", "Metrics", "PathMetrics", "RandomCar", "Shadow", "Solution", "TunedCar"}
"""Records that only this package makes."""
BY_HAND = {"CFunction", "Contender", "Road", "RoadAhead", "Schedule", "check_controller"}
"""Calls that check their arguments themselves, or of which the core knows no errors of ours."""


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


@pytest.mark.parametrize("name", sorted(set(CALLS) - RESULTS - BY_HAND))
def test_an_object_of_a_wrong_kind_is_refused_by_every_public_call(name):
    call = CALLS[name]
    if isinstance(call, type) and (call.__init__ is object.__init__ or issubclass(call, Exception | enum.Enum)):
        return
    classes = [name for name, kind in annotations_of(call).items() if checks._with_classes(kind) is not kind]
    for argument in classes:
        with pytest.raises(at.AdaptrackError) as refused:
            call(**{argument: object()})
        assert argument in str(refused.value)


def test_swapped_arguments_are_named_with_what_they_must_be():
    run = at.simulate(at.SingleTrack(CAR), at.PurePursuit(CAR), at.load_scenario("step", duration=1.0))
    assert "plan_speed: road = Vehicle(" in refusal(at.plan_speed, CAR, ROAD)
    assert refusal(at.plan_speed, CAR, ROAD).endswith(": must be a Road.")
    assert refusal(at.compute_metrics, ROAD).endswith("50 m>: must be a Trajectory.")
    assert refusal(lambda: at.compute_metrics(run, failure=CAR)).endswith(": must be a FailureLimits or None.")
    assert refusal(at.check_road, CAR, ROAD).endswith(": must be a Road.")
    assert refusal(at.Tracker, ROAD, at.MPC(CAR)).endswith(": must be a Controller; such as MPC(car).")
    assert refusal(at.DualTrack, ROAD).endswith(": must be a Vehicle; load_vehicle(name) gives one.")
    assert refusal(at.load_road, ROAD).endswith(": must be text or a path.")
    assert refusal(lambda: at.tune(CAR, plant=ROAD)).endswith("must be a Plant or a SteppedPlant or text or None.")
    assert refusal(at.register_plant, "mine", 3).endswith("must be a function or text.")


def test_what_is_no_number_or_too_large_for_one_is_refused_in_a_short_sentence():
    tracker = at.Tracker(at.PurePursuit(CAR, period=0.05), ROAD)
    calls = {
        "real": lambda value: real("here", "x", value), "station": lambda value: at.RoadAhead(ROAD, value, [1.0]),
        "width": lambda value: ROAD.replace(width_left=value),
        "tracker": lambda value: tracker.step(0.0, value, 0.0, 0.0, 10.0), "driver": at.Driver,
        "amplitude": lambda value: at.load_scenario("step", amplitude=value),
        "constant": lambda value: at.load_scenario("step").replace(reference=value),
        "tuning": lambda value: at.Tuning(10, 2, value, 1.0),
        "mass": lambda value: at.identify({}, mass=value, wheelbase=2.7),
    }  # fmt: skip
    for name, call in calls.items():
        for no_number in (*NO_NUMBERS, *TOO_LARGE):
            assert len(refusal(call, no_number)) < 400, name
    for value in (None, *NO_NUMBERS, -(10**5000), 1.5):
        refusal(whole_number, "here", "n", value)


def test_numbers_too_large_for_one_are_refused_where_they_must_be_finite():
    for value in TOO_LARGE:
        assert "finite" in refusal(at.yaw_of, [value] * 4)
        assert "finite" in refusal(at.RoadAhead, ROAD, 0.0, [value])
        assert "finite" in refusal(road_through, [[value, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])


@pytest.mark.parametrize("make", [at.LQR, at.PurePursuit, at.MPC, at.published_mpc])
def test_what_is_no_road_ahead_is_refused_and_moves_no_command(make):
    controller = make(CAR, period=0.05)
    for value in ("text", ROAD, 3.0, {}, [ROAD], object()):
        assert "RoadAhead" in refusal(lambda road: controller.step([0.0] * 4, 10.0, [1.0], road=road), value)
    assert controller.angle == 0.0


def test_numbers_of_every_kind_are_read_and_what_is_masked_is_not_a_number():
    numbers = [
        1, 2.5, np.float32(0.5), np.int8(-3), decimal.Decimal("0.25"), fractions.Fraction(3, 4), 10**400, -(2**70),
    ]  # fmt: skip
    assert_array_equal(reals("x", numbers), [1.0, 2.5, 0.5, -3.0, 0.25, 0.75, math.inf, -(2.0**70)])
    assert_array_equal(reals("x", np.ma.masked_array([1.0, 2.0], [False, True])), [1.0, math.nan])
    assert reals("x", 3).shape == ()
    row = np.arange(3.0)
    assert reals("x", row) is row


def test_a_value_in_a_message_is_short_whatever_it_is():
    class Broken:
        def __repr__(self) -> str:
            raise RuntimeError

    assert format_value("a") == "'a'"
    assert format_value(10**5000) == "<int>"
    assert format_value(Broken()) == "<Broken>"
    assert len(format_value(list(range(1000)))) <= 80


# -- bounds -----------------------------------------------------------------------------------------------------------
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
    "KinematicMPC": "stages [1, 100]; step period (0, inf); computation [0, 1]",
    "KnownWithin": "mass yaw_inertia stiffness_front stiffness_rear load_transfer_time frontal_area air_density"
    " drag_coefficient side_force_slope yaw_moment_slope wind_angle_limit rolling_resistance engine_power"
    " traction_limit brake_limit steering_rate steering_limit steering_ratio [1, 10];"
    "lf track_front track_rear cg_height width front_overhang rear_overhang [0, 5]; length [0, 10];"
    "drive_front brake_front steering_lag steering_dead_time [0, 1]",
    "Following": "silence oldest (0, 60]; fallback_age (0, 600]; catch_up [0, 1]; speed_limit (0, 100]",
    "LQR": "q_e q_heading r (0, inf)",
    "LearnedCar": "lag lag_sigma dead_time dead_time_sigma delay_sigma stiffness_sigma balance_sigma [0, 10];"
    "stiffness balance (0, 100]; bias [-1, 1]; bias_sigma [0, 1]; seconds [0, inf)",
    "Learning": "lags dead_times [1, 12]; bias [0, inf); balance [1, inf)",
    "Limits": "output_weight error (0, inf); ahead [0, inf)",
    "MPC": "computation [0, 1]; period speed_floor (0, inf); longest_horizon [1, 1000]; most_moves [1, 200]",
    "Moves": "pole [0, 1); terms [1, 200]",
    "PathModel": "period (0, inf); lag dead_time [0, inf)",
    "Perception": "noise delay nominal_friction seed [0, inf); friction (0, inf)",
    "PreviewLQR": "period (0, inf); computation [0, 1]",
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
    "Tuning": "Np [1, 1000]; Nc [1, 200]; Q [0, inf); R (0, inf)",
    "Tyre": "stiffness_front stiffness_rear (0, 1e7]; nominal_load (0, 1e6]; digressive_load_ratio (0, 100];"
    "shape [0.5, 2]; curvature [-20, 1]; friction_load_sensitivity [0, 1]; relaxation_length [0, 10]",
    "Uncertainty": "lag dead_time [0, 1]; stiffness [1, 4]; mass [0, 0.9]",
    "UserController": "memory_size [0, inf)",
    "UserModel": "period (0, inf)",
    "UserPlant": "mass longest_step engine_power traction_limit brake_limit (0, inf); steps [1, inf)",
    "Vehicle": "mass (0, 1e5]; yaw_inertia stiffness_front stiffness_rear engine_power (0, 1e7]; lf lr (0, 20];"
    "track_front track_rear load_transfer_time (0, 10]; cg_height [0, 5]; frontal_area [0, 50];"
    "air_density drag_coefficient [0, 10]; side_force_slope yaw_moment_slope [0, 100]; wind_angle_limit (0, pi/2];"
    "rolling_resistance drive_front brake_front [0, 1]; traction_limit brake_limit (0, 1e6]",
    "check_estimator": "steps [1, inf)",
    "check_plant": "period (0, inf)",
    "check_scheduler": "samples [1, inf); seed [0, inf)",
    "compute_metrics": "move_weight [0, inf)",
    "export_fmu": "period furthest (0, inf); trajectory_points [2, 1000]",
    "fit_road": "max_deviation (0, inf)",
    "generate_road": "seed [0, inf); length [100, 1e5]",
    "identify": "mass [1, 1e5]; wheelbase [0.1, 20]; computation [0, 1)",
    "path_metrics": "lane_width steering_ratio (0, inf)",
    "plan_speed": "start end [0, inf); top_speed (0, 100]; spacing [0.01, 100]",
    "random_drive": "seed wind [0, inf); duration (0, 86400]; speed[0] speed[1] lane_width (0, inf);"
    "friction[0] friction[1] (0, 3]; demand[0] demand[1] (0, 1]; heading (0, 0.5]",
    "road_through": "noise [0, inf)",
    "rollout": "seed [0, 2**63)",
    "rollout_batch": "threads [1, inf)",
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
    "KinematicMPC": (lambda **options: at.KinematicMPC(CAR, **options),
                     "cutoff [0, inf)"),
    "LQR": (lambda **options: at.LQR(CAR, **options), "preview_time [0, inf); period (0, inf)"),
    "PreviewLQR": (lambda **options: at.PreviewLQR(CAR, **options),
                   "q_e q_heading r (0, inf); ahead (-inf, 10]"),
    "PurePursuit": (lambda **options: at.PurePursuit(CAR, **options), "period (0, inf)"),
    "Reading": (at.Reading, "steering_ratio [0.1, 100]"),
    "RoadDrive": (lambda speed: at.RoadDrive(ROAD, speed), "speed (0, 100]"),
    "SpeedControl": (lambda **options: at.SpeedControl(CAR, **options), "tyre_shape [1.05, 2]"),
    "Stanley": (lambda **options: at.Stanley(CAR, **options),
                "gain softening yaw_rate_gain dead_time [0, inf); period (0, inf)"),
    "UserController": (lambda **options: at.UserController(steer_straight, **options), "period (0, inf)"),
    "check_estimator": (lambda speed: at.check_estimator(at.KalmanFilter(), at.PathModel(CAR, 0.1), speed=speed),
                        "speed (0, inf)"),
    "check_road": (lambda speed: at.check_road(ROAD, CAR, speed=speed), "speed (0, inf)"),
    "get_model": (lambda period: at.get_model("single-track", CAR, period), "period (0, inf)"),
    "published_mpc": (lambda period: at.published_mpc(CAR, period=period), "period (0, inf)"),
    "tune": (lambda seed: at.tune(CAR, seed=seed, progress=stop), "seed [0, inf)"),
}  # fmt: skip
"""Calls with all other arguments, and intervals that function bodies check."""

UNBOUNDED = {
    "KinematicMPC": {"weights"}, "RoadAhead": {"station"}, "RoadDrive": {"reference"}, "Trajectory": {"failed_at"},
    "UserEstimator": {"memory_size"}, "export_c": {"furthest"},
    "export_page": {"speed", "lateral_acceleration", "seed"},
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
        integer = int(self.value) + (0 if is_open else -1 if is_low else 1)
        return [math.nan, beyond, *([integer] if float(self.value).is_integer() else [])]

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
    calls = dict(CALLS)
    for name, call in CALLS.items():
        if isinstance(call, type):
            methods = {method: getattr(call, method) for method in vars(call) if not method.startswith("_")}
            calls |= {f"{name}.{method}": member for method, member in methods.items() if inspect.isfunction(member)}
    return calls


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
def test_every_bound_in_an_annotation_has_a_row(name):
    annotations = annotations_of(public_calls()[name])
    bounds = {bound for argument, kind in annotations.items() for bound in bounds_in(kind, argument)}
    assert bounds == read_row(BOUNDS.get(name, ""))


@pytest.mark.parametrize("name", sorted({name for name in public_calls() if "." not in name} - RECORDS))
def test_every_number_without_a_bound_in_its_annotation_has_a_row(name):
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
def test_what_lies_just_beyond_a_bound_is_refused_and_the_bound_is_not(call, bound):
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
