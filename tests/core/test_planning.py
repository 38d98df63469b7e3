"""The kernels that make a drive of a road: the same plan and samples from anywhere, and true ones."""

import itertools
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.planning import speed as kernel
from adaptrack.core.planning.cells import PLAN, plan_places
from adaptrack.core.planning.drive import RoadDriveRecord as Drive
from adaptrack.core.planning.drive import complete_samples, drive_periods, drive_samples, drive_start
from adaptrack.core.planning.station_table import AlongRecord, Route
from adaptrack.core.roads import path
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.core.speed.plan import SpeedPlanRecord
from adaptrack.drive.world import World
from adaptrack.road import Along as PythonAlong
from adaptrack.road import Arc, Comfort, Line, Stop
from adaptrack.road.road import DRY_FRICTION
from adaptrack.road.speed import cornering_limit, packed

pytestmark = pytest.mark.kernels
CAR = at.load_vehicle("midsize-sedan")
TURNS = np.linspace(0.0, 2.0 * math.pi, 14, endpoint=False)
OVAL = np.stack([90.0 * np.cos(TURNS), 50.0 * np.sin(TURNS)], axis=-1)
BENDS = np.stack([60.0 * np.linspace(0.0, 5.0, 24), 25.0 * np.sin(np.linspace(0.0, 5.0, 24))], axis=-1)
NONE, NOWHERE = np.zeros(0), AlongRecord(np.zeros(0), np.zeros(0), 0)
BOUNDS = kernel.SpeedBounds(
    3.0, 2.0, 3.0, math.inf, 10.0, 0.9, math.nan, math.nan, math.nan, 27.0, 100.0, math.nan, 1.0
)


def constant(value):
    return AlongRecord(np.zeros(1), np.array([value]), 0)


def line_through(points, closed):
    memory = np.zeros(path.path_words(points, closed))
    status, _ = path.path_through(points, closed, 0.0, memory)
    assert status == path.OK
    return path.line_in(memory)[0]


def to_plan(line, car=None, friction=0.9, bounds=BOUNDS, **along):
    """A plan to be made as another program has it: no road but its pieces, no car but its numbers."""
    route = Route(
        line, constant(friction), constant(along.get("bank", 0.0)), NOWHERE, constant(along.get("grade", 0.0))
    )
    table = np.full((len(PLAN), plan_places(line.start, bounds.spacing, NONE, NONE)), np.nan)
    plant = NONE if car is None else packed(car)
    return kernel.Planning(route, bounds, plant, NONE, NONE, NONE, np.zeros((0, 0)), table)


def plan_of(planning):
    status, _, _, duration = kernel.plan_along_road(planning)
    assert status == kernel.OK
    rows = (planning.table[row] for row in (PLAN.s, PLAN.speed, PLAN.time))
    return SpeedPlanRecord(*rows, duration, int(planning.route.line.numbers[1]))


# -- the same from anywhere -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("car", [None, CAR])
@pytest.mark.parametrize(("points", "closed"), [(OVAL, True), (BENDS, False)])
def test_a_program_with_points_alone_gets_the_plan_and_the_drive_of_python_to_the_bit(points, closed, car):
    bounds = BOUNDS._replace(domain_speed=27.0 if car is None else car.domain.speed[1])
    planning = to_plan(line_through(points, closed), car, friction=DRY_FRICTION.value[0], bounds=bounds)
    plan, road = plan_of(planning), at.road_through(points, closed=closed)
    plan_in_python = at.plan_speed(road, car)
    np.testing.assert_array_equal(
        planning.table[[PLAN.s, PLAN.speed, PLAN.time]], [plan_in_python.s, plan_in_python.speed, plan_in_python.time]
    )
    np.testing.assert_array_equal(planning.table[PLAN.binding, :-1], plan_in_python.binding)
    assert plan.duration == plan_in_python.duration

    drive, laps = (
        at.RoadDrive(road, plan_in_python, laps=2 if closed else 1, reference=0.4, wind=[1.0, -3.0]),
        2 if closed else 1,
    )
    world = World.of(at.DualTrack(CAR), at.MPC(CAR, period=0.05), "paper", None, None, None)
    expected = world.samples(drive.sample(0.05), 0)
    count = drive_periods(plan.duration, laps, 0.05)
    samples, pose = np.full((len(SIGNAL), count + 1), np.nan), np.zeros(3)
    drive_in_c = Drive(planning.route, plan, 0.05, np.array([0.4]), np.array([1.0]), np.array([-3.0]))
    drive_samples(drive_in_c, samples)
    np.testing.assert_array_equal(samples, expected)
    drive_start(planning.route.line, 0.4, 0.0, pose)
    assert tuple(pose) == drive.start_pose()


# -- true speeds ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("friction", "bank"), [(0.9, 0.0), (0.25, 0.0), (0.9, 0.05)])
def test_a_circle_is_driven_at_the_root_of_what_is_felt_times_the_radius(friction, bank):
    road = at.Road.from_segments([Arc(length=80.0 * math.pi, curvature=1.0 / 40.0)], closed=True)
    planning = to_plan(road.packed(), friction=friction, bank=bank)
    plan = plan_of(planning)
    felt = min(3.0, 0.9 * friction * GRAVITY * math.cos(bank)) + GRAVITY * math.sin(bank)
    np.testing.assert_allclose(plan.speed**2, 40.0 * felt, rtol=1e-12)


def test_a_straight_road_is_driven_at_the_top_speed():
    line = at.Road.from_segments([Line(length=900.0)]).packed()
    for top, speed in ((math.nan, 27.0), (41.0, 41.0)):
        assert (plan_of(to_plan(line, bounds=BOUNDS._replace(top_speed=top))).speed == speed).all()


@pytest.mark.parametrize(
    ("name", "grade"),
    [*((name, 0.0) for name in at.list_vehicles()), ("midsize-sedan", 0.12), ("midsize-sedan", -0.12)],
)
def test_nowhere_is_more_asked_of_tyres_engine_and_brakes_than_they_have(name, grade):
    # at both ends of every cell, with the car's own numbers and the formulas of the textbook
    car, road = at.load_vehicle(name), at.generate_road("mountain", seed=5, length=700.0, grade=grade)
    comfort = Comfort(lateral=20.0, accelerate=20.0, brake=20.0, lateral_jerk=math.inf)
    plan = at.plan_speed(road, car, comfort, start=2.0, top_speed=60.0)
    first, last = road.table.at(plan.s[:-1], 1).curvature, road.table.at(plan.s[1:], -1).curvature
    bend = np.maximum(np.abs(first), np.abs(last))
    weight = GRAVITY * math.cos(math.atan(grade))
    grip = 0.9 * np.minimum(0.9 * GRAVITY, cornering_limit(car, bend, np.full(bend.shape, 0.9))) * weight / GRAVITY
    along = plan.acceleration + GRAVITY * math.sin(math.atan(grade))  # by tyres and air
    for v in (plan.speed[:-1], plan.speed[1:]):
        slowed = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient * v**2 / car.mass
        slowed += car.rolling_resistance * weight
        tyres = np.where(along >= 0.0, along + slowed, np.maximum(-along, 0.0))
        carried = 1.0 - tyres * car.cg_height / (weight * np.where(along >= 0.0, car.lr, car.lf))
        used = np.hypot(tyres, v**2 * bend / carried) / grip
        gains = plan.acceleration > 1e-9
        assert used[gains].max() < 1.0 + 1e-6
        assert used[along < -1e-9].max(initial=0.0) < 1.0 + 1e-6
        force = car.mass * (along + slowed)[gains]
        assert (force <= np.minimum(car.traction_limit, car.engine_power / np.maximum(v[gains], 1e-3)) + 1e-6).all()
        assert (-along <= car.brake_limit / car.mass + slowed + 1e-9).all()


# -- slopes -----------------------------------------------------------------------------------------------------------
def test_a_truck_at_full_power_climbs_at_the_speed_at_which_its_power_is_used_up():
    truck = at.load_vehicle("van").replace(engine_power=40e3)
    road = at.Road.from_segments([Line(length=9000.0)], grade=([400.0, 401.0], [0.0, 0.05]))
    plan, theta = at.plan_speed(road, truck, start=20.0), math.atan(0.05)
    v = plan.speed[-1]
    air = 0.5 * truck.air_density * truck.frontal_area * truck.drag_coefficient * v**2
    load = truck.mass * GRAVITY * (math.sin(theta) + truck.rolling_resistance * math.cos(theta))
    assert v * (load + air) == pytest.approx(40e3, rel=1e-4)
    assert v < 0.9 * plan.at(400.0)
    assert plan.stretches[-1].limit == "power"


@pytest.mark.parametrize("grade", [0.1, -0.1])
def test_brakes_and_tyres_stop_a_car_on_a_slope_in_the_distance_of_the_textbook(grade):
    line, friction = at.Road.from_segments([Line(length=300.0)]).packed(), 0.2  # the tyres bound it, not comfort
    plan = plan_of(to_plan(line, friction=friction, bounds=BOUNDS._replace(end=0.0), grade=grade))
    theta = math.atan(grade)
    deceleration = GRAVITY * (0.9 * friction * math.cos(theta) + math.sin(theta))
    braking = plan.speed < 27.0 - 1e-9
    braking[:200] = False
    np.testing.assert_allclose(plan.speed[braking] ** 2, 2.0 * deceleration * (300.0 - plan.s[braking]), atol=1e-9)
    assert braking.sum() > 80


def test_a_bend_on_a_descent_leaves_the_tyres_what_holds_the_speed():
    line, theta = at.Road.from_segments([Arc(length=200.0, curvature=1.0 / 60.0)]).packed(), math.atan(0.12)
    grip, slope = 0.9 * 0.25 * GRAVITY * math.cos(theta), GRAVITY * math.sin(theta)
    down, up = (plan_of(to_plan(line, friction=0.25, grade=grade)) for grade in (-0.12, 0.12))
    np.testing.assert_allclose(down.speed**2, 60.0 * math.sqrt(grip**2 - slope**2), rtol=1e-9)
    # uphill the tyres drive: the same circle of friction bounds the steady speed
    np.testing.assert_allclose(up.speed**2, 60.0 * math.sqrt(grip**2 - slope**2), rtol=1e-6)


def test_a_run_up_carries_a_car_over_a_short_ramp_that_stops_it_from_standstill():
    grade = AlongRecord(np.array([0.0, 100.0, 120.0]), np.array([0.0, 0.3, 0.0]), 1)
    line = at.Road.from_segments([Line(length=200.0)]).packed()
    for start, status in ((15.0, kernel.OK), (5.0, kernel.TOO_SLIPPERY)):
        planning = to_plan(line, friction=0.2, bounds=BOUNDS._replace(start=start, top_speed=max(start, 5.0)))
        planning = planning._replace(route=planning.route._replace(grade=grade))
        code, place, force, _ = kernel.plan_along_road(planning)
        assert code == status
    assert 100.0 <= planning.table[PLAN.s, place] < 120.0
    assert force == pytest.approx(0.9 * 0.2 * GRAVITY * math.cos(math.atan(0.3)))


@pytest.mark.parametrize(
    ("grade", "changes", "message"),  # where a climb ends a run-up of 8 m/s: v^2/2 over what is lacking
    [
        (0.3, {"traction_limit": 2000.0}, "s = 79 m .* climbing the grade of 0.3 asks for 2.82 .* the drive gives"),
        (-0.3, {"brake_limit": 2000.0}, "s = 50 m .* descending the grade of -0.3 asks for 2.82 .* the brakes give"),
        (0.3, {"friction": 0.2}, "s = 75 m .* climbing .* the tyres give 1.69 m/s"),
        (-0.3, {"friction": 0.2}, "s = 50 m .* descending .* the tyres give 1.69 m/s"),
    ],
)
def test_a_grade_on_which_a_car_cannot_go_on_is_refused_with_its_place(grade, changes, message):
    numbers = dict(changes)
    road = at.Road.from_segments(
        [Line(length=900.0)], grade=PythonAlong(s=(0.0, 50.0), value=(0.0, grade), kind="steps"),
        friction=numbers.pop("friction", 0.9), speed_limit=8.0,
    )  # fmt: skip
    with pytest.raises(at.InvalidInput, match=message):
        at.plan_speed(road, CAR.replace(**numbers))


def test_a_climb_takes_from_the_drive_what_a_descent_adds():
    line = at.Road.from_segments([Line(length=60.0)]).packed()
    bounds = BOUNDS._replace(accelerate=20.0, start=0.0, top_speed=60.0)
    up, down = (plan_of(to_plan(line, bounds=bounds, friction=0.3, grade=grade)) for grade in (0.1, -0.1))
    theta = math.atan(0.1)
    tyres, slope = 0.9 * 0.3 * GRAVITY * math.cos(theta), GRAVITY * math.sin(theta)
    np.testing.assert_allclose(up.speed**2, 2.0 * (tyres - slope) * up.s, atol=1e-9)
    np.testing.assert_allclose(down.speed**2, 2.0 * (tyres + slope) * down.s, atol=1e-9)


def test_a_lap_is_periodic_and_no_other_lap_is_faster():
    line = line_through(OVAL, True)
    plan = plan_of(to_plan(line, CAR))
    assert plan.speed[0] == plan.speed[-1]
    # the same line with its seam elsewhere: the same speeds
    turned = plan_of(to_plan(line_through(np.roll(OVAL, 5, axis=0).copy(), True), CAR))
    assert turned.duration == pytest.approx(plan.duration, rel=2e-3)
    assert turned.speed.min() == pytest.approx(plan.speed.min(), rel=2e-3)


@pytest.mark.parametrize(("changes", "status", "value"), [
    ({"bank": 0.4}, kernel.TOO_STEEP, 3.0),
    ({"bounds": {"start": 90.0}}, kernel.START_TOO_FAST, 27.0),
    ({"bounds": {"end": 90.0}}, kernel.END_TOO_FAST, 27.0),
    ({"bounds": {"start": 20.0, "end": 0.0}}, kernel.CANNOT_BRAKE, math.sqrt(2.0 * 3.0 * 50.0)),
    ({"bounds": {"lateral": math.nan}}, kernel.NO_BOUNDS, 0.0),
])  # fmt: skip
def test_what_is_not_possible_is_a_status_with_its_number(changes, status, value):
    line = at.Road.from_segments([Line(length=50.0)]).packed()
    bounds = BOUNDS._replace(**changes.get("bounds", {}))
    code = kernel.plan_along_road(to_plan(line, bounds=bounds, bank=changes.get("bank", 0.0)))
    assert code[0] == status
    assert code[2] == pytest.approx(value)


# -- along a road -----------------------------------------------------------------------------------------------------
def test_what_lies_along_a_road_is_read_as_it_is_written():
    s, value = (0.0, 10.0, 10.5, 40.0), (1.0, 3.0, 2.0, 5.0)
    linear, steps = PythonAlong(s=s, value=value), PythonAlong(s=s, value=value, kind="steps")
    places = np.array([-5.0, 0.0, 4.0, 10.0, 10.25, 39.9, 40.0, 99.0])
    np.testing.assert_array_equal(linear.at(places), np.interp(places, s, value))
    np.testing.assert_array_equal(steps.at(places), [1.0, 1.0, 1.0, 3.0, 3.0, 2.0, 5.0, 5.0])
    assert linear.at(4.0).shape == ()
    assert linear.replace(kind="steps") == steps
    fine = np.linspace(-5.0, 50.0, 5501)
    for first, other in itertools.combinations(places.tolist(), 2):
        inside = fine[(fine >= first) & (fine <= other)]
        for along in (linear, steps):
            assert along.least(first, other)[0] == pytest.approx(along.at(inside).min(), abs=1e-9)


def test_the_edges_of_a_road_are_its_widths_away_from_it():
    road = at.generate_road("mountain", seed=1, length=200.0, width_left=([0.0, 200.0], [1.0, 3.0]), width_right=2.0)
    s = np.linspace(0.0, road.length, 41)
    left, right = road.edges(s.reshape(1, 41))
    assert left.shape == right.shape == (1, 41, 2)
    for edge, width, side in ((left, road.along("width_left", s), 1.0), (right, np.full(41, 2.0), -1.0)):
        feet = road.project(*edge[0].T, near=s)
        np.testing.assert_allclose(feet.offset, side * width, atol=1e-9)
        np.testing.assert_allclose(feet.s, s, atol=1e-6)


# -- in time ----------------------------------------------------------------------------------------------------------
def test_a_plan_in_time_is_at_its_places_when_it_says_and_stands_at_stops():
    road = at.generate_road("lap", seed=1, length=600.0)
    plan = at.plan_speed(road, CAR, stops=[Stop(50.0, 3.0), Stop(400.0, 2.0), Stop(50.0, 1.0)])
    for lap in (0, 1, 7):
        s, v = plan.motion(plan.time + lap * plan.duration)
        np.testing.assert_allclose(s - lap * road.length, plan.s, atol=1e-6)
        np.testing.assert_allclose(v, plan.speed, atol=1e-6)
    arrival = float(plan.time[np.searchsorted(plan.s, 50.0)])
    s, v = plan.motion(arrival + np.array([0.5, 2.0, 3.999]))
    np.testing.assert_allclose(s, 50.0, atol=1e-12)
    assert (v == 0.0).all()
    assert plan.motion(arrival + 4.5)[1] > 0.0
    t = np.linspace(0.0, 2.0 * plan.duration, 4001)
    middle = plan.motion(0.5 * (t[1:] + t[:-1]))[1]
    np.testing.assert_allclose(np.diff(plan.motion(t)[0]) / np.diff(t), middle, atol=0.06)  # the speed is its rate


def test_a_bank_pulls_and_a_bend_is_acceleration_ahead():
    rows = np.zeros((len(SIGNAL), 5))
    rows[SIGNAL.speed], rows[SIGNAL.bank], rows[SIGNAL.acceleration] = 20.0, -0.1, -0.01
    complete_samples(0.1, rows)
    np.testing.assert_allclose(rows[SIGNAL.bank], -GRAVITY * math.sin(0.1), rtol=1e-15)
    np.testing.assert_array_equal(rows[SIGNAL.acceleration], 4.0)
    np.testing.assert_array_equal(rows[SIGNAL.change], 0.0)
