"""Scenarios: the signals are what the paper, the formulas and the files say, and bad ones are refused with a remedy."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import adaptrack as at
from adaptrack.scenario import Patch, Signals, Wind, scenario_options, shapes

POINTS = ((0.0, 1.0), (1.0, 3.0), (2.5, 2.0), (4.0, 2.0), (5.0, -1.0))

ONE_OF_EACH: list[shapes.Shape] = [
    shapes.Constant(value=2.5),
    shapes.Knots(points=POINTS),
    shapes.Knots(points=POINTS, method="pchip"),
    shapes.Knots(points=POINTS, method="cubic"),
    shapes.Knots(points=((1.0, 2.0),)),
    shapes.Step(before=1.0, after=-2.0, time=2.0),
    shapes.LaneChange(amplitude=-3.5, start=1.0, duration=3.0),
    shapes.TanhSteps(steps=((4.0, 1.0, 0.5), (-3.0, 4.0, 1.5))),
    shapes.Sine(amplitude=2.0, frequency=0.3, phase=0.4, start=0.5),
    shapes.Gust(peak=20.0, start=1.0, duration=2.0),
    shapes.Sum(terms=(shapes.Constant(value=1.0), shapes.Gust(peak=5.0, start=1.0, duration=2.0))),
]
NAMES = [
    "triple-lane-change", "general-trajectory", "accelerating-trajectory", "accelerating-double-lane-change", "step",
    "lane-change", "double-lane-change", "sine", "random-drive",
]  # fmt: skip


def scenario(**changes: object) -> at.Scenario:
    fields: dict[str, object] = {"name": "test", "duration": 10.0, "reference": 1.0, "speed": 15.0, "friction": 0.8}
    return at.Scenario(**(fields | changes))


# ---- shapes


def derivative(function, t: np.ndarray, h: float = 1e-6) -> np.ndarray:
    """Central difference of a function of time, per second."""
    return (function(t + h) - function(t - h)) / (2.0 * h)


def test_a_shape_keeps_the_form_of_its_times_scales_and_survives_its_table():
    assert {shape.kind for shape in ONE_OF_EACH} == set(shapes.SHAPE_TYPES)
    t = np.linspace(-1.0, 7.0, 12)
    for shape in ONE_OF_EACH:
        values = shape.at(t)
        assert values.dtype == np.float64
        assert_array_equal(shape.at(t.reshape(3, 4)), values.reshape(3, 4))
        assert_array_equal([shape.at(time) for time in t], values)
        assert_allclose(shape.scaled(-1.8).at(t), -1.8 * values, rtol=1e-14, atol=1e-14)
        assert shape.scaled(-1.0).scaled(-1.0) == shape
        assert shapes.as_shape(shape.table()) == shape


def test_smooth_knots_agree_with_scipy_and_hold_the_outer_values():
    interpolate = pytest.importorskip("scipy.interpolate")
    t, y = np.array(POINTS).T
    fine = np.linspace(0.0, 5.0, 503)
    for n in (2, 3, 5):
        points = POINTS[:n]
        inside = fine[fine <= t[n - 1]]
        natural = interpolate.CubicSpline(t[:n], y[:n], bc_type="natural")
        monotone = interpolate.PchipInterpolator(t[:n], y[:n])
        linear = interpolate.make_interp_spline(t[:n], y[:n], k=1)
        for method, oracle in (("cubic", natural), ("pchip", monotone), ("linear", linear)):
            shape = shapes.Knots(points=points, method=method)
            assert_allclose(shape.at(inside), oracle(inside), atol=1e-13)
            assert_array_equal(shape.at([-3.0, 9.0]), y[[0, n - 1]])


def test_a_lane_change_is_smooth_and_has_the_stated_extremes():
    shape = shapes.LaneChange(amplitude=3.5, start=1.0, duration=4.0)
    assert_allclose(shape.at([0.0, 1.0, 3.0, 5.0, 9.0]), [0.0, 0.0, 1.75, 3.5, 3.5], rtol=1e-15)
    t = np.linspace(1.0, 5.0, 40_001)
    rate = np.gradient(shape.at(t), t)
    assert rate.max() == pytest.approx(1.875 * 3.5 / 4.0, rel=1e-7)
    assert np.abs(np.gradient(rate, t)).max() == pytest.approx(10.0 / math.sqrt(3.0) * 3.5 / 16.0, rel=1e-5)


def test_steps_gusts_sums_and_sines_have_the_values_of_their_formulas():
    assert_array_equal(shapes.Step(after=2.0, time=1.0).at([0.999, 1.0]), [0.0, 2.0])
    gust = shapes.Gust(peak=20.0, start=3.0, duration=2.0)
    assert_allclose(gust.at([3.0, 3.5, 4.0, 4.5, 5.0]), [0, 10, 20, 10, 0], atol=1e-14)
    assert_allclose((shapes.Constant(value=5.0) + gust + 1).at([4.0, 6.0]), [26.0, 6.0])
    signals = at.load_scenario("sine", amplitude=1.5, frequency=0.25).sample(0.01)
    assert (signals.y_ref.min(), signals.y_ref.max()) == pytest.approx((-1.5, 1.5), abs=1e-4)
    assert (signals.y_ref[:101] == 0.0).all()


# ---- the paper's signals


def test_the_triple_lane_change_has_the_published_signals():
    test = at.load_scenario("triple-lane-change")
    t = np.array([0.0, 13.543, 20.0, 28.0])
    steps = [(4.201, 13.543, 3.508), (4.328, 26.321, 2.601), (-4.773, 35.876, 2.206)]
    expected = sum(a / 2.0 * (1.0 + np.tanh((t - t0) / tau)) for a, t0, tau in steps)
    assert_allclose(test.reference_at(t), expected, rtol=1e-14)
    assert_allclose(test.speed_at([0.0, 6.0, 13.0, 20.0, 46.0]), [0.05, 19.15, (17.9 + 23.45) / 2, 17.55, 17.55])
    assert_allclose(test.friction_at([0.0, 15.8, 21.1, 40.0])[:, 0], [0.9, 0.501, 0.736, 0.8])
    assert_allclose(test.wind_at([0.0, 13.2, 28.0])[:, 1], 1.8 * np.array([0.0, 28.2, -22.0]))
    assert_array_equal(test.wind_at(np.linspace(0, 46, 50))[:, 0], 0.0)
    assert test.initial_y == 0.0


def test_the_triple_lane_change_has_two_windows_and_a_gain():
    assert at.load_scenario("triple-lane-change").sample().n == 280
    full = at.load_scenario("triple-lane-change", window="full", wind_gain=1.0)
    assert full.sample().n == 460
    assert full == at.load_scenario("triple-lane-change", wind_gain=1.0).with_window("full")
    assert_allclose(
        full.sample().wind[:, 1] * 1.8, at.load_scenario("triple-lane-change", duration=46.0).sample().wind[:, 1]
    )


def test_the_general_trajectory_has_the_published_signals():
    test = at.load_scenario("general-trajectory")
    assert test.sample().n == 2000
    assert_array_equal(test.reference_at([0.0, 10.0, 49.0, 159.0, 200.0]), [0.0, 2.52, 56.11, 154.9, 103.84])
    assert_allclose(test.speed_at([0.0, 17.5, 147.0, 200.0]), [0.2, 7.1, 24.0, 24.0 - 6.0 * 2.0 / 30.0])
    assert_allclose(test.wind_at([0.0, 82.0, 181.0, 200.0])[:, 1], [5.0, 28.5, -25.0, -25.0])
    assert_allclose(test.friction_at([0.0, 50.0, 164.0, 200.0])[:, 3], [0.95, 0.631, 0.55, 0.96])


def test_the_general_trajectory_is_as_steep_as_the_original_and_smooth():
    test = at.load_scenario("general-trajectory")
    rate = derivative(test.reference_at, np.arange(0.01, 199.99, 0.01))
    assert np.abs(rate).max() == pytest.approx(2.6, abs=0.05)
    assert np.abs(np.diff(rate)).max() < 0.25 * 0.01  # no kink: lateral acceleration stays below 0.25 m/s^2


# ---- manoeuvres


def test_every_name_loads_and_is_described_also_without_docstrings(monkeypatch):
    from adaptrack.scenario import library, random_drives

    listed = at.list_scenarios()
    assert list(listed) == NAMES
    for make in (library.step, library.lane_change, library.double_lane_change, library.sine, library.random_drive):
        assert listed[make.__name__.replace("_", "-")] == str(make.__doc__).partition("\n")[0]
        monkeypatch.setattr(make, "__doc__", None)  # as ``python -OO`` leaves it
    monkeypatch.setattr(random_drives.random_drive, "__doc__", None)
    assert at.list_scenarios() == listed
    for name, description in listed.items():
        assert (at.load_scenario(name).name, at.load_scenario(name).description) == (name, description)


def test_the_step_is_the_tuning_test_of_the_paper():
    signals = at.load_scenario("step", amplitude=-7.0, speed=22.0, friction=0.6, wind=-18.0).sample()
    assert signals.n == 180
    for values, constant in ((signals.y_ref, -7.0), (signals.speed, 22.0), (signals.friction, 0.6)):
        assert_array_equal(values, constant)
    assert_array_equal(signals.wind, np.tile([0.0, -18.0], (181, 1)))
    assert at.load_scenario("step", amplitude=-7.0).initial_y == 0.0


def test_the_lane_change_uses_35_percent_of_the_lowest_friction():
    for amplitude, friction in ((7.0, 0.5), (-7.0, 0.9), (0.5, 0.9)):
        test = at.load_scenario("lane-change", amplitude=amplitude, friction=friction, gust=25.0)
        assert isinstance(test.reference, shapes.LaneChange)
        duration = max(2.0, math.sqrt(5.77 * abs(amplitude) / (0.35 * friction * 9.80665)))
        assert test.reference.duration == pytest.approx(duration, rel=1e-3)
        signals = test.sample(0.05)
        assert signals.y_ref[[0, -1]] == pytest.approx([0.0, amplitude], abs=1e-12)
        assert signals.wind[:, 1].max() == pytest.approx(25.0)
    split = at.load_scenario("lane-change", friction=[0.9, {"shape": "step", "before": 0.9, "after": 0.4, "time": 2.0}])
    assert split.reference == at.load_scenario("lane-change", friction=0.4).reference


def test_a_slow_lane_change_heads_at_most_a_quarter_radian_off_the_road():
    test = at.load_scenario("lane-change", amplitude=5.0, friction=0.9, speed=4.0, duration=20.0)
    times = np.linspace(0.0, 20.0, 4001)
    assert np.abs(derivative(test.reference_at, times)).max() / 4.0 == pytest.approx(0.25, rel=1e-3)


def test_the_double_lane_change_keeps_to_the_sections_of_the_track():
    speed = 16.0
    test = at.load_scenario("double-lane-change", speed=speed, approach=0.5)

    def offset_at(metres: float) -> float:
        return float(test.reference_at(0.5 + metres / speed))

    assert [offset_at(x) for x in (0.0, 15.0, 45.0, 70.0, 95.0, 125.0)] == pytest.approx(
        [0, 0, 3.5, 3.5, 0, 0], abs=1e-12
    )
    assert test.duration == pytest.approx(0.5 + 125.0 / speed + 2.0)


def test_every_scenario_takes_the_common_options_and_has_the_defaults_that_are_listed():
    for name in NAMES:
        test = at.load_scenario(name, speed=12.0, friction=[0.9, 0.4], wind={"x": -5.0}, duration=3.0, start_y=0.25)
        signals = test.sample()
        assert signals.n == 30
        assert_array_equal(signals.speed, 12.0)
        assert_array_equal(signals.friction, np.tile([0.9, 0.4, 0.9, 0.4], (31, 1)))
        assert_allclose(signals.wind, np.tile([-5.0 * test.wind_gain, 0.0], (31, 1)))
        assert test.initial_y == 0.25
        assert at.load_scenario(name, **scenario_options(name)) == at.load_scenario(name)
    assert scenario(reference=4.0).initial_y == 4.0  # a car starts on the reference


# ---- samples


@pytest.mark.parametrize("period", [0.1, 0.03])
def test_samples_are_the_functions_at_the_control_instants(period):
    for test in map(at.load_scenario, NAMES):
        signals = test.sample(period)
        n = round(test.duration / period)
        assert signals.n == n
        assert_allclose(signals.t, np.arange(n + 1) * period, rtol=1e-14)
        functions = {"y_ref": "reference_at", "speed": "speed_at", "friction": "friction_at", "wind": "wind_at"}
        for field, function in functions.items():
            values = getattr(signals, field)
            assert_array_equal(values, getattr(test, function)(signals.t), strict=True)
            assert values.flags.c_contiguous


def test_instants_are_the_nearest_numbers_to_the_decimal_ones():
    assert at.load_scenario("step").sample(0.1).t[3] == 0.3
    assert scenario(reference=shapes.Step(after=2.0, time=0.7)).sample(0.1).y_ref[7] == 2.0


GOOD_ARRAYS: dict[Any, dict[str, Any]] = {
    Signals: dict(
        period=0.1, t=[0.0, 0.1, 0.2], y_ref=np.zeros(3), speed=np.ones(3), friction=np.ones((3, 4)),
        wind=np.zeros((3, 2)),
    ),
    at.Scenario.from_arrays: dict(t=[0.0, 1.0, 2.0], y_ref=[0.0, 1.0, 2.0], speed=9.0, friction=0.8),
}  # fmt: skip


@pytest.mark.parametrize(("make", "changes", "message"), [
    (Signals, {"period": 0.0}, "period"),
    (Signals, {"t": [0.0, 0.1, 0.3]}, r"t\[2\] = 0.3 s; it must be 2 periods"),
    (Signals, {"y_ref": [0.0, math.inf, 0.0]}, "y_ref is inf at t = 0.1 s: must be finite"),
    (Signals, {"y_ref": [0.0, 0.0]}, r"y_ref has shape \(2,\); with 3 instants it must be \(3,\)"),
    (Signals, {"speed": [0.0, 1.0, -1.0]}, "speed is -1.0 at t = 0.2 s"),
    (Signals, {"friction": np.ones((3, 2))}, r"friction has shape \(3, 2\)"),
    (Signals, {"friction": np.full((3, 4), 80.0)}, "a coefficient such as 0.8"),
    (at.Scenario.from_arrays, {"t": [0.0, 1.0, 1.0]}, r"t\[2\] = 1.0 s does not come after"),
    (at.Scenario.from_arrays, {"t": [0.0, math.nan, 1.0]}, r"t\[1\] is not finite"),
    (at.Scenario.from_arrays, {"t": 3.0}, "at least two times"),
    (at.Scenario.from_arrays, {"y_ref": [0.0, math.nan, 1.0]}, r"y_ref\[1\] is not finite"),
    (at.Scenario.from_arrays, {"y_ref": [0.0, 1.0]}, r"y_ref has shape \(2,\); with 3 times it must be \(3,\)"),
    (at.Scenario.from_arrays, {"friction": np.ones((3, 3))}, r"must be \(3,\), \(3, 2\), \(3, 4\)"),
    (at.Scenario.from_arrays, {"speed": [1.0, -1.0, 1.0]}, "speed is -"),
])  # fmt: skip
def test_arrays_that_no_simulation_can_use_are_refused(make, changes, message):
    make(**GOOD_ARRAYS[make])
    with pytest.raises(at.InvalidInput, match=message):
        make(**(GOOD_ARRAYS[make] | changes))


def test_signals_keep_their_own_copy_and_need_a_period_between_bounds():
    y_ref = np.zeros(3)
    signals = Signals(**(GOOD_ARRAYS[Signals] | {"y_ref": y_ref}))
    y_ref[:] = 7.0
    assert_array_equal(signals.y_ref, 0.0)
    for period in (0.0, math.nan, 100.0, 1e-320):
        with pytest.raises(at.InvalidInput, match="period"):
            scenario().sample(period)


# ---- friction and wind


def test_friction_may_differ_by_side_and_by_wheel_and_wind_has_three_spellings_and_a_gain():
    for friction, wheels in ((0.8, [0.8] * 4), ([0.8, 0.3], [0.8, 0.3] * 2), ([0.8, 0.7, 0.6, 0.5],) * 2):
        assert_array_equal(scenario(friction=friction).friction_at(1.0), wheels)
    lateral = scenario(wind=3.0)
    assert_array_equal(lateral.wind_at(0.0), [0.0, 3.0])
    for wind in ([0.0, 3.0], {"y": 3.0}, Wind(y=shapes.as_shape(3.0))):
        assert scenario(wind=wind) == lateral
    assert_array_equal(scenario(wind=[1.0, 3.0], wind_gain=2.0).wind_at(0.0), [2.0, 6.0])


def test_the_last_patch_counts_while_it_lasts():
    patches = (Patch(start=1.0, end=3.0, friction=0.5), Patch(start=2.0, end=4.0, friction=0.2, wheels="right"))
    friction = scenario(friction_patches=patches).friction_at([0.9, 1.0, 2.0, 3.0, 4.0])
    assert_array_equal(friction[:, 0], [0.8, 0.5, 0.5, 0.8, 0.8])
    assert_array_equal(friction[:, 1], [0.8, 0.5, 0.2, 0.2, 0.8])
    assert_array_equal(friction[:, 2:], friction[:, :2])


# ---- variants

RICH = scenario(
    reference=shapes.LaneChange(amplitude=2.0, start=1.0, duration=3.0) + 1.0,
    friction=[0.9, 0.8, 0.7, shapes.Knots(points=((1.0, 0.6), (3.0, 0.5)))],
    friction_patches=[Patch(start=1.0, end=2.0, friction=0.3, wheels="front-left")],
    wind=Wind(x=shapes.as_shape(5.0), y=shapes.Sine(amplitude=1.0, frequency=0.1)), wind_gain=1.2,
    start_y=0.5, start_heading=0.1, windows={"short": 3.0},
)  # fmt: skip


def test_mirroring_exchanges_left_and_right_and_twice_is_identity():
    for test in (RICH, *map(at.load_scenario, NAMES)):
        mirrored = test.mirrored()
        signals, mirror_image = test.sample(), mirrored.sample()
        assert_array_equal(mirror_image.y_ref, -signals.y_ref)
        assert_array_equal(mirror_image.speed, signals.speed)
        assert_array_equal(mirror_image.friction, signals.friction[:, [1, 0, 3, 2]])
        assert_array_equal(mirror_image.wind, signals.wind * [1.0, -1.0])
        assert (mirrored.initial_y, mirrored.start_heading) == (-test.initial_y, -test.start_heading)
        assert mirrored.name != test.name
        assert mirrored.mirrored() == test
    assert at.load_scenario("sine", mirrored=True) == at.load_scenario("sine").mirrored()


def test_another_duration_leaves_the_signals_alone():
    short, long = RICH.sample(), RICH.with_duration(20.0).sample()
    assert long.n == 200
    assert_array_equal(long.friction[: short.n + 1], short.friction)


# ---- arrays and files


def test_arrays_become_signals_that_pass_through_them():
    t = np.array([5.0, 6.0, 8.0, 9.0])
    test = at.Scenario.from_arrays(
        t, y_ref=[0.0, 1.0, 1.0, 4.0], speed=10.0, friction=np.array([[0.9, 0.5]] * 4),
        wind=np.array([[1.0, 2.0]] * 4), reference_method="cubic", start_y=0.0,
    )  # fmt: skip
    assert test.duration == 4.0
    assert_array_equal(test.reference_at(t - 5.0), [0.0, 1.0, 1.0, 4.0])
    assert_array_equal(test.friction_at(1.5), [0.9, 0.5, 0.9, 0.5])
    assert_array_equal(test.wind_at(1.5), [1.0, 2.0])
    assert_array_equal(test.speed_at(1.5), 10.0)


def test_a_scenario_survives_its_file_which_has_one_point_per_line(tmp_path):
    path = tmp_path / "mine.toml"
    knots = scenario(name="mine", reference=shapes.Knots(points=POINTS), description="of [ 1, 2 ] things")
    for test in (RICH, *map(at.load_scenario, NAMES), knots):
        test.to_toml(path)
        assert at.load_scenario(path) == test
    assert "    [2.5, 2.0],\n" in path.read_text()
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_may_use_numbers_and_shapes(tmp_path):
    path = tmp_path / "my-road.toml"
    path.write_text(
        """
        duration = 2.0
        speed = 12
        friction = [0.9, { shape = "step", after = 0.4, time = 0.0 }]
        reference = { shape = "knots", points = [[0, 0], [1, 2], [2, 2]] }
        [wind]
        shape = "sum"
        terms = [5.0, { shape = "gust", peak = 10.0, start = 0.0, duration = 2.0 }]
        [[friction_patches]]
        start = 1.0
        end = 1.5
        friction = 0.2
        """
    )
    test = at.load_scenario(path)
    assert test.name == "my-road"
    assert_array_equal(test.reference_at([0.5, 1.0, 1.5]), [1.0, 2.0, 2.0])
    assert_allclose(test.wind_at(1.0), [0.0, 15.0])
    assert_array_equal(test.friction_at([0.5, 1.0])[:, :2], [[0.9, 0.4], [0.2, 0.2]])


CSV = "t,y_ref,speed,friction,wind_y\n0,0,10,0.8,3\n0.5,1,11,0.7,4\n2,1,12,0.7,5\n"


def test_a_csv_file_becomes_a_scenario(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("\ufeff# recorded in the rain\n" + CSV + "\n", encoding="utf-8")
    test = at.load_scenario(path, wind_gain=2.0)
    assert test.name == "drive"
    assert test.duration == 2.0
    assert_allclose(test.reference_at([0.25, 0.5, 2.0]), [0.5, 1.0, 1.0])
    assert_allclose(test.wind_at([0.0, 2.0]), [[0.0, 6.0], [0.0, 10.0]])
    assert_allclose(test.friction_at(0.0), 0.8)


def test_a_csv_file_may_split_friction_and_wind(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text("t,y_ref,speed,friction_right,friction_left,wind_x,wind_y\n0,0,9,0.3,0.8,1,2\n1,0,9,0.3,0.8,1,2\n")
    test = at.Scenario.from_csv(path)
    assert_allclose(test.friction_at(0.5), [0.8, 0.3, 0.8, 0.3])
    assert_allclose(test.wind_at(0.5), [1.0, 2.0])


PATCH = "0.8\nfriction_patches = [{{ start = 2.0, end = {}, friction = 0.3{} }}]"
GOOD_FILES = {"drive.csv": CSV, "road.toml": "duration = 5.0\nreference = 1.0\nspeed = 10.0\nfriction = 0.8\n"}


@pytest.mark.parametrize(("name", "old", "new", "message"), [
    ("drive.csv", "2,1,12", "0.5,1,12", r"line 4: t = 0.5 does not come after t = 0.5 in line 3; sort the rows"),
    ("drive.csv", "0.5,1,11", "0.5,nan,11", r"line 3: y_ref = 'nan' is not a finite number; correct it"),
    ("drive.csv", "0.5,1,11", "0.5,fast,11", r"line 3: y_ref = 'fast'"),
    ("drive.csv", "0.5,1,11", "0.5,11", r"line 3: 4 cells, but the header has 5 columns"),
    ("drive.csv", "1,11", "1,-11", r"line 3: speed = '-11' must be >= 0"),
    ("drive.csv", "0.8", "80", r"line 2: friction = '80' must be a coefficient such as 0.8"),
    ("drive.csv", "y_ref", "yref", r"line 1: unknown column 'yref'. Did you mean 'y_ref'\?"),
    ("drive.csv", "friction,", "friction_left,", r"line 1: column 'friction_right' is missing"),
    ("drive.csv", "speed,friction", "friction_left,friction", r"line 1: the friction is given twice"),
    ("drive.csv", ",wind_y\n", "\n", r"line 1: column 'wind_y' is missing"),
    ("drive.csv", ",", ";", r"line 1: the columns are separated by ';'"),
    ("drive.csv", CSV, "", "empty"),
    ("drive.csv", CSV.partition("\n")[2], "", "at least two rows"),
    ("road.toml", "duration = 5.0", "", "duration: missing"),
    ("road.toml", "duration = 5.0", "duration = 0.0", "duration = 0.0: must be a finite number > 0"),
    ("road.toml", "10.0", "-10.0", "speed is -10.0 at t = 0 s: must be >= 0"),
    ("road.toml", "10.0", "'fast'", "speed = 'fast': give a number, or a table"),
    ("road.toml", "10.0", "{ shape = 'setp', after = 3.0 }", "unknown shape 'setp'. Did you mean 'step'"),
    ("road.toml", "10.0", "{ after = 3.0 }", "no key 'shape'; give one of 'constant'"),
    ("road.toml", "10.0", "{ shape = 'step', after = 3.0, tmie = 2.0 }", "tmie: unknown key. Did you mean 'time'"),
    ("road.toml", "10.0", "{ shape = 'knots', points = [[0, 1], [0, 2]] }", "the times must increase"),
    ("road.toml", "0.8", "[0.8, 0.8, 0.8]", "one value, .left, right., or"),
    ("road.toml", "0.8", "0.8\nwind = [1, 2, 3]", "the pair"),
    ("road.toml", "0.8", PATCH.format(1.0, ""), "must end after its start"),
    ("road.toml", "0.8", PATCH.format(3.0, ", wheels = 'l'"), "'left'"),
    ("road.toml", "= 5.0", "5.0", "line 1"),
])  # fmt: skip
def test_a_bad_file_is_refused_with_its_place_and_remedy(tmp_path, name, old, new, message):
    (tmp_path / name).write_text(GOOD_FILES[name])
    at.load_scenario(tmp_path / name)
    (tmp_path / name).write_text(GOOD_FILES[name].replace(old, new))
    with pytest.raises(at.ConfigError, match=rf"(?s){re.escape(name)}.*{message}"):
        at.load_scenario(tmp_path / name)


@pytest.mark.parametrize(("name", "options", "error", "words"), [
    ("none.toml", {}, at.StorageError, "none.toml"),
    ("none.csv", {}, at.StorageError, "none.csv"),
    ("tripel-lane-change", {}, at.UnknownName, "Did you mean 'triple-lane-change'"),
    ("sine", {"freqency": 1.0}, at.UnknownName, "'sine' has no option 'freqency'. Did you mean 'frequency'"),
    ("triple-lane-change", {"windgain": 1.0}, at.UnknownName, "Did you mean 'wind_gain'"),
    ("triple-lane-change", {"window": "ful"}, at.InvalidInput, "no window 'ful'. Did you mean 'full'"),
    ("triple-lane-change", {"window": "full", "duration": 3.0}, at.InvalidInput, "window and duration are both given"),
    ("triple-lane-change", {"window": 28.0}, at.InvalidInput, "window"),
    ("double-lane-change", {"speed": 0.0}, at.InvalidInput, "one constant speed"),
    ("double-lane-change", {"speed": {"shape": "constant", "value": 3.0}}, at.InvalidInput, "speed"),
    ("lane-change", {"amplitude": "3"}, at.InvalidInput, "amplitude"),
    ("lane-change", {"amplitude": math.nan}, at.InvalidInput, "amplitude"),
    ("lane-change", {"change_time": -1.0}, at.InvalidInput, "duration"),
    ("lane-change", {"friction": 0.0}, at.InvalidInput, "friction"),
    ("sine", {"frequency": -1.0}, at.InvalidInput, "frequency"),
    ("step", {"mirrored": "no"}, at.InvalidInput, "mirrored"),
])  # fmt: skip
def test_unknown_names_and_impossible_options_are_refused(name, options, error, words):
    with pytest.raises(error, match=words):
        at.load_scenario(name, **options)
