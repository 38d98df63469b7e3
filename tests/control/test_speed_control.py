"""Speed control: stops, governor, learning of drive and brakes, and the tracker that requests forces."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest

from adaptrack import MPC, DualTrack, Learning, PurePursuit, RoadDrive, SpeedControl, Tracker, load_vehicle, simulate
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.control import speed_control
from adaptrack.control.speed_control import SPEED_ACTIONS, SpeedAction, SpeedController, SpeedLimit, SpeedState
from adaptrack.control.tracker import Status, join
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.estimators.learning import BELIEF_COLUMNS
from adaptrack.core.kernel import Resident, direct
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.speed import speed_control as kernel
from adaptrack.core.speed.stops import STOP_TOLERANCE
from adaptrack.core.tracker.longitudinal import longitudinal_step, speed_control_step
from adaptrack.core.tracker.signals import TRACKED
from adaptrack.core.tracker.step import tracker_step
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World
from adaptrack.road import Arc, Comfort, Line, Road, Stop, generate_road, plan_speed, road_through
from point_mass import PERIOD, PointMass

CAR = load_vehicle("midsize-sedan")
COMFORT = Comfort(accelerate=1.5, brake=2.0)


def _straight(length: float, **along: object) -> Road:
    return Road.from_segments([Line(length=length)], name="straight").replace(**along)


def _controller(
    road: Road | float, control: SpeedControl | None = None, *, stop_at_end: bool = False, **plan: Any
) -> SpeedController:
    """A speed control on a road, or on a straight one of this length (m), with a plan of these options."""
    road = road if isinstance(road, Road) else _straight(road)
    plan = plan_speed(road, CAR, **({"comfort": COMFORT} | plan))
    return SpeedController(control or SpeedControl(CAR), road, plan, PERIOD, stop_at_end=stop_at_end)


class Step(NamedTuple):
    """A control period: requests, and speed (m/s) and place (m) of the car at its begin."""

    request: Any
    speed: float
    place: float


def _drive(car: PointMass, controller: SpeedController, periods: int, **faults: object) -> list[Step]:
    """Drive a car for so many control periods."""
    steps = []
    for _ in range(periods):
        steps.append(Step(controller.step(car.s, car.v, 0.0), car.v, car.s))
        car.move(steps[-1].request.force, steps[-1].request.hold, **faults)
    return steps


def test_on_the_way_to_a_stop_the_acceleration_is_the_derivative_of_the_speed() -> None:
    control = SpeedControl(CAR).settings(PERIOD, COMFORT)
    ways = np.linspace(0.001, 40.0, 40000)
    speeds, accelerations = np.array([kernel._stopping_motion(way, 0.0, control.stop_jerk, 2.0) for way in ways]).T
    slope = np.gradient(speeds**2, ways) / 2.0
    np.testing.assert_allclose(-slope[5:-5], accelerations[5:-5], atol=0.02)
    assert accelerations[0] > -0.5  # both reach 0 together
    assert accelerations.min() == -COMFORT.brake


@pytest.mark.parametrize(("mass", "slope"), [(1.0, 0.0), (1.3, 0.6), (0.9, -0.6)])
def test_a_car_whose_delays_mass_and_slope_are_not_known_stops_near_its_stop_and_drives_on(mass, slope) -> None:
    drive, brakes = DriveActuator(lag=0.3, dead_time=0.2, gain=0.95), BrakeActuator(lag=0.15, dead_time=0.15)
    road = _straight(700.0)
    plan = plan_speed(road, CAR, COMFORT, stops=[Stop(300.0, 2.0)], top_speed=14.0)
    controller = SpeedController(SpeedControl(CAR, drive=None, brakes=None), road, plan, PERIOD)
    car = PointMass(float(plan.speed[0]), CAR.mass * mass, drive, brakes, slope)
    stands, errors = [], []
    for _ in range(1500):
        request = controller.step(car.s, car.v, 0.0)
        if request.state == SpeedState.STOPPED:
            stands.append(car.s)
        elif 100.0 < car.s < 250.0:
            errors.append(car.v - float(plan.at(car.s)))
        car.move(request.force, request.hold)
        if car.s > 600.0:
            break
    assert abs(stands[-1] - 300.0) < 0.35
    assert np.ptp(stands) < 0.02
    assert np.sqrt(np.mean(np.square(errors))) < 0.25
    assert car.s > 600.0


@pytest.mark.parametrize("scale", [0.98, 1.0, 1.02])
def test_a_noisy_position_and_a_wrong_scale_of_the_speed_hardly_move_a_stop(scale) -> None:
    rng, noise = np.random.default_rng(3), 0.2
    controller = _controller(500.0, stops=[Stop(300.0, 2.0)], top_speed=14.0)
    car = PointMass(14.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.2, dead_time=0.1))
    errors = []
    for _ in range(700):
        request = controller.step(car.s + noise * rng.normal(), scale * car.v, 0.0)
        if request.state == SpeedState.STOPPED:
            break
        errors.append(abs(float(controller.record.memory[0].station) - car.s))
        car.move(request.force, request.hold)
    assert abs(car.s - 300.0) < 0.15
    assert np.quantile(errors[100:], 0.95) < 0.7 * noise  # of single positions: 1.96


def test_a_stop_does_not_depend_on_the_scale_of_the_speed_once_that_is_learned() -> None:
    stands = []
    for scale in (0.93, 1.07):
        controller = _controller(900.0, stops=[Stop(800.0, 9.0)], top_speed=14.0)
        car = PointMass(14.0, CAR.mass, DriveActuator(lag=0.3, dead_time=0.2), BrakeActuator(lag=0.25, dead_time=0.2))
        while controller.step(car.s, car.v / scale, 0.0).state != SpeedState.STOPPED:
            request = controller.command
            car.move(request.force, request.hold)
        stands.append(car.s)
    assert np.ptp(stands) < 0.05


def test_exact_positions_are_taken_as_they_are_and_jumps_are_followed_at_once() -> None:
    controller = _controller(900.0, top_speed=14.0)
    station, memory = 0.0, controller.record.memory[0]
    for k in range(600):
        station += PERIOD * (10.0 + 4.0 * math.sin(PERIOD * (k - 0.5)))
        shift = 30.0 if k >= 400 else 0.0
        controller.step(station + shift, 10.0 + 4.0 * math.sin(PERIOD * k), 0.0)
        assert memory.station == pytest.approx(station + shift, abs=0.003)


def test_a_car_of_twice_the_mass_that_slides_past_the_end_of_its_path_stops_behind_it() -> None:
    drive, brakes = DriveActuator(lag=0.2, dead_time=0.1), BrakeActuator(lag=0.1, dead_time=0.1)
    controller = _controller(100.0, SpeedControl(CAR, friction=0.5), stop_at_end=True, top_speed=14.0)
    car = PointMass(14.0, 2.0 * CAR.mass, drive, brakes)
    car.s = 80.0
    steps = _drive(car, controller, 300)
    assert 102.0 < car.s < 150.0
    assert (steps[-1].request.state, car.v) == (SpeedState.STOPPED, 0.0)


def test_a_car_does_not_roll_back_at_a_stop_on_an_ascent_of_ten_per_cent() -> None:
    drive, brakes = DriveActuator(lag=0.05, dead_time=0.05), BrakeActuator(lag=0.6, dead_time=0.4)
    control, road = SpeedControl(CAR, drive=None, brakes=None), _straight(400.0, grade=0.1)
    car = PointMass(12.0, 1.3 * CAR.mass, drive, brakes, GRAVITY * math.sin(math.atan(0.1)))
    steps = _drive(car, _controller(road, control, stops=[Stop(150.0, 2.0)], top_speed=12.0), 1200)
    places = np.array([step.place for step in steps])
    assert car.s > 300.0
    assert (np.maximum.accumulate(places) - places).max() < 0.02


def test_a_car_at_the_end_of_its_path_drives_on_once_its_place_jumps_back() -> None:
    controller = _controller(100.0, top_speed=8.0, end=0.0)
    car = PointMass(8.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.2, dead_time=0.1))
    states = []
    for k in range(1000):
        shift = 8.0 if 60 <= k < 500 else 0.0
        request = controller.step(car.s + shift, car.v, 0.0)
        states.append(request.state)
        car.move(request.force, request.hold)
    assert states[499] == SpeedState.STOPPED
    assert (states[-1], car.v) == (SpeedState.STOPPED, 0.0)
    assert abs(car.s - 100.0) < 0.1


@pytest.mark.parametrize("grade", [None, -0.2])
def test_a_car_that_starts_on_a_descent_stays_near_its_plan(grade) -> None:
    slope = kernel.slope_of(-0.2)
    road = _straight(100.0) if grade is None else _straight(100.0, grade=grade)
    comfort = Comfort(accelerate=0.5, brake=2.5)
    plan = plan_speed(road, CAR, comfort, stops=[Stop(20.0, 3.0)], top_speed=12.0, start=0.0)
    controller = SpeedController(SpeedControl(CAR), road, plan, PERIOD)
    drive, brakes = DriveActuator(lag=0.25, dead_time=0.2), BrakeActuator(lag=0.25, dead_time=0.2)
    car, excess = PointMass(0.0, CAR.mass, drive, brakes, slope), []
    while car.s < 90.0:
        request = controller.step(car.s, car.v, 0.0)
        car.move(request.force, request.hold)
        if car.s > 20.2:
            excess.append(car.v - float(plan.at(car.s)))
    assert max(excess) < 0.75


@pytest.mark.parametrize(("disturbance", "kerb"), [(4.0, 0.0), (0.0, 3.0)])
def test_a_car_that_stands_although_it_should_drive_gets_more_force_until_it_drives(disturbance, kerb) -> None:
    controller = _controller(300.0, top_speed=14.0)
    for bank in (controller.record.banks.drive, controller.record.banks.brakes):
        for hypothesis in bank:
            hypothesis.disturbance = disturbance  # m/s^2, for which brakes would hold the car
    car = PointMass(0.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.2))
    for _ in range(300):
        request = controller.step(car.s, car.v, 0.0)
        if car.v > 0.0 or request.force >= kerb * CAR.mass:  # N, over a kerb of this deceleration (m/s^2)
            car.move(request.force, request.hold)
    assert car.s > 20.0


def test_the_bank_finds_delay_and_ratio_of_drive_and_brakes() -> None:
    drive, brakes = DriveActuator(lag=0.45, dead_time=0.1, gain=0.85), BrakeActuator(lag=0.15, dead_time=0.3)
    stops = [Stop(200.0 * k, 1.0) for k in range(1, 12)]  # at rest the brakes hold: they release while the drive pulls
    controller = _controller(3000.0, SpeedControl(CAR, drive=None, brakes=None), stops=stops, top_speed=14.0)
    _drive(PointMass(14.0, CAR.mass, drive, brakes), controller, 3000)
    learned = controller.learned
    assert learned["drive"].lag + learned["drive"].dead_time == pytest.approx(0.55, abs=0.04)
    assert learned["brakes"].lag + learned["brakes"].dead_time == pytest.approx(0.45, abs=0.04)
    assert learned["drive"].ratio == pytest.approx(0.85, abs=0.02)
    assert learned["brakes"].ratio == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("closed", [False, True])
def test_a_plan_at_even_places_has_the_speed_curvature_slope_and_bank_of_its_road(closed) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    road = road_through(np.stack([60.0 * np.cos(angle), 40.0 * np.sin(angle)], axis=-1), closed=closed)
    road = road.replace(grade=((0.0, 50.0, 90.0), (0.1, -0.05, 0.02)), bank=((20.0, 70.0), (0.0, 0.1)))
    plan = plan_speed(road, CAR, COMFORT, stops=[Stop(100.0, 3.0)])
    path = speed_control.speed_path(road, plan, stop_at_end=True)
    s = np.arange(path.square.size) * path.spacing
    assert path.spacing == pytest.approx(0.5, rel=0.01)
    np.testing.assert_allclose(path.square, plan.at(s) ** 2, rtol=1e-12)
    np.testing.assert_allclose(path.curvature, road.at(np.minimum(s, road.length - 1e-9)).curvature, rtol=1e-6)
    np.testing.assert_allclose(path.slope, GRAVITY * np.sin(np.arctan(road.along("grade", s))), rtol=1e-12)
    np.testing.assert_allclose(path.bank, GRAVITY * np.sin(road.along("bank", s)), rtol=1e-12)
    assert (path.stops.tolist(), path.seconds.tolist()) == (
        ([100.0], [3.0]) if closed else ([100.0, road.length], [3.0, math.inf])
    )


def test_governed_speeds_keep_their_share_of_the_assumed_friction_and_the_braking_of_comfort() -> None:
    road = generate_road("mountain", 3, 1500.0).replace(speed_limit=None)
    plan = plan_speed(road, CAR, Comfort(lateral=20.0))
    control = SpeedControl(CAR, friction=(0.4, 0.9))
    controller = SpeedController(control, road, plan, PERIOD)
    for station in np.linspace(0.0, road.length - 150.0, 40):
        controller.step(station, float(plan.at(station)), math.nan)
        squares, spacing = controller.record.ahead, controller.record.path.spacing
        first = math.floor(station / spacing)
        places = (first + np.arange(squares.size) + 0.5) * spacing
        inside = places < road.length
        curvature = road.at(np.minimum(places, road.length - 1e-6)).curvature
        lateral = squares * np.abs(curvature)
        assert (lateral[inside] <= control.governor * 0.4 * GRAVITY + 0.3).all()  # cells of half a metre
        assert (-np.diff(squares) / (2.0 * spacing) <= plan.comfort.brake + 1e-9).all()
        assert (squares <= plan.at(places) ** 2 * 1.01 + 0.3)[inside].all()


def _governed_squares(friction: float | tuple[float, float], age: float) -> Any:
    """Governed squares of the speeds (m^2/s^2) in a long bend, behind speeds that come with an age (s)."""
    road = Road.from_segments([Arc(length=900.0, curvature=0.01)])
    controller = _controller(road, SpeedControl(CAR, friction=friction), comfort=Comfort(lateral=20.0))
    for k in range(100):
        controller.record.sample[:] = kernel.SPEED_SAMPLE.new(
            1, station=0.25 * k, station_age=age, speed=5.0, speed_age=age, yaw_rate=math.nan, acceleration=math.nan,
            is_guided=1.0, top_speed=math.inf, grade=math.nan, periods=1.0,
        )  # fmt: skip
        speed_control_step(Resident(controller.record))
    return controller.record.ahead[:50].copy()


def test_late_samples_leave_a_part_of_a_certain_friction_and_none_of_the_low_end_of_a_wide_interval() -> None:
    fresh, late = _governed_squares(0.4, 0.0), _governed_squares(0.4, 0.06)
    left = 1.0 - kernel.LATE_CAUTION * 0.06
    np.testing.assert_allclose(late, left * fresh, rtol=0.01)  # the mean age approaches the age
    np.testing.assert_array_equal(_governed_squares((0.4, 0.9), 0.06), _governed_squares((0.4, 0.9), 0.0))
    np.testing.assert_allclose(_governed_squares(0.4, 0.4), (1.0 - kernel.LARGEST_LATE_CAUTION) * fresh)


def test_a_drive_force_leaves_the_tyres_what_the_bend_asks_for_in_which_it_acts() -> None:
    road = Road.from_segments([Line(length=100.0), Arc(length=200.0, curvature=0.02)])
    drive = DriveActuator(lag=0.3, dead_time=0.2)
    forces = {}
    for place in (50.0, 97.0, 110.0):  # m: before the bend by more and by less than the way until the force acts
        controller = _controller(road, SpeedControl(CAR, friction=0.3, drive=drive), comfort=Comfort(lateral=20.0))
        forces[place] = controller.step(place, 9.0, 0.0).force
    assert forces[97.0] == pytest.approx(forces[110.0], rel=0.05)
    assert 0.0 < forces[97.0] < 0.7 * forces[50.0]


def test_the_drive_force_of_an_assumed_driven_axle_is_one_that_a_rear_axle_carries() -> None:
    assumed = SpeedControl(CAR.replace(estimated=(*CAR.estimated, "drive_front"))).settings(PERIOD, COMFORT)
    np.testing.assert_equal(assumed, SpeedControl(CAR.replace(drive_front=0.0)).settings(PERIOD, COMFORT))


def test_a_simulated_car_is_driven_by_a_speed_control_as_near_to_its_plan_as_by_a_driver() -> None:
    road = generate_road("country", 3, 800.0)
    plan = plan_speed(road, CAR)
    run = simulate(
        DualTrack(CAR), MPC(CAR, profile="road"), RoadDrive(road, plan), profile="road", driver=SpeedControl(CAR)
    )
    assert run.failed is None
    moved = run.road["station"] > 100.0
    error = run.vx[moved] - plan.at(run.road["station"][moved])
    assert np.sqrt(np.mean(error**2)) < 0.2


def _tracker(length: float, controller: Any, *, comfort: Comfort = COMFORT, **plan: Any) -> Tracker:
    """A controller with a speed control on a straight road (m), with a plan of these options."""
    road = _straight(length)
    return Tracker(controller, road, plan=plan_speed(road, CAR, comfort, **plan), speed=SpeedControl(CAR))


def _track(tracker: Tracker, car: PointMass, periods: int, has_position=lambda k: True) -> list:
    answers = []
    for k in range(periods):
        pose = (car.s, 0.0, 0.0) if has_position(k) else (math.nan,) * 3
        answers.append(tracker.step(k * PERIOD, *pose, car.v, 0.0))
        request = answers[-1].longitudinal
        car.move(request.force, request.hold)
    return answers


def test_a_tracker_stops_at_the_end_of_its_path_and_holds_the_car() -> None:
    tracker = _tracker(200.0, MPC(CAR, profile="road"), comfort=Comfort(), top_speed=10.0)
    car = PointMass(10.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1))
    answers = _track(tracker, car, 700)
    assert car.v == 0.0
    assert car.s == pytest.approx(200.0, abs=0.4)
    assert answers[-1].longitudinal.limited_by == SpeedLimit.PATH_END
    assert answers[-1].longitudinal.hold > 0.0


@pytest.mark.parametrize(("speed", "strongest"), [(2.5, 1.3 * COMFORT.brake), (4.5, 8.0)])
def test_without_a_position_a_car_stands_before_the_steering_loses_its_estimate(speed, strongest) -> None:
    tracker = _tracker(900.0, MPC(CAR, profile="road"), top_speed=speed)
    assert speed < tracker.blind_top_speed
    car = PointMass(speed, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1))
    answers = _track(tracker, car, 200, has_position=lambda k: k < 60)
    assert car.v == 0.0
    moving = [answer for answer in answers[60:] if answer.status is not Status.STANDING]
    assert {answer.status for answer in moving} == {Status.ESTIMATED}
    assert min(answer.longitudinal.acceleration for answer in answers) > -strongest
    assert answers[-1].longitudinal.limited_by == SpeedLimit.FAULT
    assert answers[-1].longitudinal.hold > 0.0


@pytest.mark.parametrize("has_position", [True, False])
@pytest.mark.parametrize("status", list(Status))
def test_the_tracker_obeys_each_row_of_the_table_of_actions(status, has_position, monkeypatch) -> None:
    tracker = _tracker(900.0, MPC(CAR, profile="road"), top_speed=5.0)
    car = PointMass(5.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1))
    before = _track(tracker, car, 40)[-1].longitudinal

    steering = join(tracker._kernel, tracker._part)

    def call_with_status() -> None:
        direct(tracker_step, steering)()
        tracker._kernel.tracked[TRACKED.status] = list(Status).index(status)
        longitudinal_step(tracker._kernel, tracker._speed.record)

    monkeypatch.setitem(tracker._calls, tracker_step, call_with_status)
    action, command = SPEED_ACTIONS[status][0 if has_position else 1], before
    for k in range(40, 40 + round((1.3 if action is SpeedAction.SLOW else 0.7) / PERIOD)):
        if action is SpeedAction.SLOW and k > 40:
            car.move(command.force, command.hold)
        else:
            car.move(before.force, 0.0)  # its speed stays, whatever is requested
        pose = (car.s, 0.0, 0.0) if has_position else (math.nan,) * 3
        command = tracker.step(k * PERIOD, *pose, car.v, 0.0).longitudinal
        if action is SpeedAction.NONE and k - 40 < 0.5 / PERIOD:
            assert command == before
        if action is SpeedAction.SLOW and k - 40 < 1.1 / PERIOD:  # a short gap
            assert command.acceleration > -1.01 * COMFORT.brake
    if action is SpeedAction.FOLLOW:
        assert command.state == SpeedState.DRIVING
        assert command.acceleration == pytest.approx(0.0, abs=0.2)
    elif action is SpeedAction.SLOW:
        brakes = tracker._speed.learned["brakes"]
        delay = brakes.lag + brakes.dead_time + kernel.BLIND_SIGMAS * brakes.delay_sigma + kernel.BLIND_MARGIN
        needed = car.v / (3.0 - 1.3 - delay)  # s: patience of the filter, time without a position
        assert command.acceleration == pytest.approx(-needed, rel=0.1)
    elif action is SpeedAction.NONE:  # the time sticks
        assert command.acceleration < -COMFORT.brake
        assert command.limited_by == SpeedLimit.FAULT
    elif action is SpeedAction.COMFORT_STOP:
        assert command.acceleration == pytest.approx(-COMFORT.brake)
        assert command.limited_by == SpeedLimit.FAULT
    elif action is SpeedAction.EMERGENCY_STOP:
        assert command.state == SpeedState.EMERGENCY
        assert command.acceleration < -2.0 * COMFORT.brake


def test_without_a_speed_the_car_makes_a_comfortable_stop() -> None:
    controller = _controller(900.0, top_speed=8.0)
    car = PointMass(8.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1))
    requests = []
    for k in range(240):
        requests.append(controller.step(car.s, car.v if k < 40 else math.nan, 0.0))
        car.move(requests[-1].force, requests[-1].hold)
    assert car.v == 0.0
    assert requests[-1].limited_by == SpeedLimit.FAULT
    assert min(request.acceleration for request in requests) > -1.3 * COMFORT.brake


@pytest.mark.parametrize("seconds", [1.0, 3.0, 5.0])
def test_a_speed_that_returns_after_it_was_missing_is_no_fault_and_the_car_drives_on(seconds) -> None:
    controller = _controller(900.0, top_speed=20.0)
    car = PointMass(20.0, CAR.mass, DriveActuator(lag=0.2, dead_time=0.1), BrakeActuator(lag=0.2, dead_time=0.1))
    missing = range(round(12.0 / PERIOD), round((12.0 + seconds) / PERIOD))
    for k in range(round(40.0 / PERIOD)):
        request = controller.step(car.s, math.nan if k in missing else car.v, 0.0)
        assert request.limited_by not in (SpeedLimit.BRAKE_FAULT, SpeedLimit.DRIVE_FAULT)
        car.move(request.force, request.hold)
    assert car.v == pytest.approx(20.0, abs=0.3)


@pytest.mark.parametrize("seed", range(4))
def test_a_loop_whose_calls_come_late_and_skip_instants_stops_at_its_end_and_reports_no_fault(seed) -> None:
    rng, stops = np.random.default_rng(seed), [Stop(150.0, 2.0), Stop(300.0, 2.0)]
    law = PurePursuit(CAR, period=PERIOD)
    tracker = _tracker(400.0, law, comfort=Comfort(brake=3.0), stops=stops, top_speed=14.0)
    car, limits = PointMass(10.0, CAR.mass, DriveActuator(lag=0.1), BrakeActuator(lag=0.05)), set()
    for k in range(1200):
        t = PERIOD * k
        late = 0.8 * PERIOD if rng.random() < 0.2 else 0.0  # s, the next call is then nearer to the next instant
        out = tracker.step(t, car.s, 0.0, 0.0, car.v + 0.02 * rng.normal(), 0.0, now=t + late)
        limits.add(out.longitudinal.limited_by)
        car.move(out.longitudinal.force, out.longitudinal.hold)
    assert not limits & {SpeedLimit.FAULT, SpeedLimit.BRAKE_FAULT, SpeedLimit.DRIVE_FAULT}
    assert car.s == pytest.approx(400.0, abs=0.2)


def test_a_driver_hands_over_without_a_bump_and_teaches_nothing() -> None:
    controller = _controller(900.0, top_speed=14.0)
    car = PointMass(10.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1), slope=0.4)

    def lasting() -> dict[str, Any]:
        """What is learned, but for what acts now."""
        still = {"speed": 0.0, "acting": 0.0, "acting_sigma": 0.0}
        return {name: belief._replace(**still) for name, belief in controller.learned.items()}

    before = lasting()
    for k in range(200):
        driver = k < 60
        request = controller.step(car.s, car.v, 0.0, driver=driver)
        force = (car._slope + 0.8) * car._mass if driver else request.force
        if driver and k > 30:
            assert (request.state, request.limited_by) == (SpeedState.OFF, SpeedLimit.DRIVER)
            assert request.acceleration == pytest.approx(0.8, abs=0.05)
            assert lasting() == before
            last = request.acceleration
        elif not driver and k < 70:
            assert abs(request.acceleration - last) < 0.3  # 5 m/s^3 and the follower's own
            last = request.acceleration
        car.move(force, request.hold)
    assert request.state == SpeedState.DRIVING
    assert car.v == pytest.approx(14.0, abs=0.2)


def test_the_speed_is_limited_until_the_delay_of_the_steering_is_learned() -> None:
    mpc = MPC(CAR, belief="unknown", learning=Learning())
    controller = _controller(900.0, top_speed=30.0)
    controller.limit_speed(mpc)
    assert controller.top_speed == mpc.learner.first_top_speed < 30.0
    car = PointMass(10.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.1))
    steps = _drive(car, controller, 400)
    assert car.v == pytest.approx(mpc.learner.first_top_speed, abs=0.1)
    assert steps[-1].request.limited_by == SpeedLimit.STEERING
    for sigma, top_speed in ((0.2, mpc.learner.first_top_speed), (0.01, math.inf)):
        loop = _loop_that_learned(mpc, sigma)
        loop.roll_on(1)
        assert loop.speed_control.top_speed == top_speed


def _loop_that_learned(mpc: MPC, sigma: float) -> ClosedLoop:
    """A run whose controller says of the delay of its steering that it knows it up to sigma (s)."""
    road = _straight(900.0)
    drive = RoadDrive(road, plan_speed(road, CAR, COMFORT, top_speed=30.0))
    world = World.of(DualTrack(CAR), mpc, "production", SpeedControl(CAR), None, None)

    def step() -> None:
        loop.answer[len(COMMON_ANSWER) + BELIEF_COLUMNS.belief_delay_sigma] = sigma

    return (loop := ClosedLoop(world, drive, 1, mpc, step))


@pytest.mark.parametrize(("lag", "dead_time"), [(0.1, 0.1), (0.4, 0.2)])
def test_brakes_without_effect_are_reported_within_a_second(lag, dead_time) -> None:
    stops = [Stop(150.0, 1.0), Stop(300.0, 1.0)]
    car = PointMass(10.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=lag, dead_time=dead_time))
    controller = _controller(900.0, SpeedControl(CAR, drive=None, brakes=None), stops=stops, top_speed=12.0)
    steps = _drive(car, controller, 450)
    assert 160.0 < car.s < 270.0
    assert steps[-1].request.limited_by is not SpeedLimit.BRAKE_FAULT
    requests = [step.request for step in _drive(car, controller, 400, has_brakes=False)]
    braking = next(k for k, request in enumerate(requests) if request.acceleration < -1.0)
    report = next(k for k, request in enumerate(requests) if request.limited_by is SpeedLimit.BRAKE_FAULT)
    assert 0.0 < (report - braking) * PERIOD <= 1.0
    assert requests[-1].limited_by is SpeedLimit.BRAKE_FAULT
    assert requests[-1].force < 0.0
    steps = _drive(car, controller, 60)  # the brakes work again
    assert steps[-1].request.limited_by is not SpeedLimit.BRAKE_FAULT


@pytest.mark.parametrize("stuck", [2.5, 4.0])
def test_a_stuck_throttle_is_braked_against_reported_and_stopped(stuck) -> None:
    car = PointMass(12.0, CAR.mass, DriveActuator(lag=0.2), BrakeActuator(lag=0.2, dead_time=0.1))
    controller = _controller(900.0, top_speed=12.0)
    _drive(car, controller, 60)
    steps = _drive(car, controller, 400, stuck_drive=stuck * CAR.mass)
    faults = {SpeedLimit.DRIVE_FAULT, SpeedLimit.BRAKE_FAULT}  # a pull that the brakes nearly balance could be either
    report = next(k for k, step in enumerate(steps) if step.request.limited_by in faults)
    assert report * PERIOD < 2.0
    assert max(step.speed for step in steps) < 14.0
    assert car.v == 0.0
    if stuck > 3.0:
        assert steps[-1].request.limited_by is SpeedLimit.DRIVE_FAULT
        _drive(car, controller, 40)
        assert car.v == 0.0  # until a driver has used the pedals
    controller.step(car.s, car.v, 0.0, driver=True)
    assert _drive(car, controller, 20)[-1].request.limited_by not in faults


def _stopping_drive(stop: Stop, *, station: float = 0.0, speed: float = 8.0) -> tuple[PointMass, SpeedController]:
    """A car at a station on a straight road with one stop, and its controller."""
    drive, brakes = DriveActuator(lag=0.2), BrakeActuator(lag=0.15, dead_time=0.1)
    car = PointMass(speed, CAR.mass, drive, brakes)
    car.s = station
    return car, _controller(400.0, SpeedControl(CAR, drive=drive, brakes=brakes), stops=[stop], top_speed=speed)


def test_a_car_stops_in_a_bend_at_friction_0_3_within_its_grip() -> None:
    radius, friction = 25.0, 0.3
    road = Road.from_segments([Line(length=60.0), Arc(length=70.0, curvature=1.0 / radius)], name="bend")
    controller = _controller(road, SpeedControl(CAR, friction=friction), stops=[Stop(110.0, 5.0)])
    car = PointMass(8.0, CAR.mass, DriveActuator(lag=0.1), BrakeActuator(lag=0.1, dead_time=0.1))
    for _ in range(500):
        curvature = 1.0 / radius if car.s > 60.0 else 0.0
        request = controller.step(car.s, car.v, car.v * curvature)
        assert math.hypot(request.acceleration, car.v**2 * curvature) < friction * GRAVITY
        if request.state is SpeedState.STOPPED:
            break
        car.move(request.force, request.hold)
    assert car.s == pytest.approx(110.0, abs=0.3)


def test_a_stop_nearer_than_comfort_reaches_is_an_emergency_and_is_reached_where_friction_allows() -> None:
    car, controller = _stopping_drive(Stop(100.0, 5.0), station=80.0, speed=12.0)
    states = [step.request.state for step in _drive(car, controller, 100)]
    assert SpeedState.EMERGENCY in states
    assert states[-1] is SpeedState.STOPPED
    assert car.s == pytest.approx(100.0, abs=1.0)


def test_a_car_dwells_at_a_stop_for_its_seconds_or_until_it_is_released() -> None:
    car, controller = _stopping_drive(Stop(60.0, 3.0))
    stands = [step.request.state is SpeedState.STOPPED for step in _drive(car, controller, 400)]
    assert sum(stands) * PERIOD == pytest.approx(3.0, abs=0.11)
    assert car.s > 70.0
    car, controller = _stopping_drive(Stop(60.0, 1e6))
    assert _drive(car, controller, 400)[-1].request.limited_by is SpeedLimit.STOP
    assert car.v == 0.0
    controller.release()
    assert _drive(car, controller, 60)[-1].request.state is SpeedState.DRIVING
    assert car.v > 1.0


def test_a_plan_that_is_replaced_on_the_way_to_a_stop_changes_neither_place_nor_braking() -> None:
    def places(replaces: bool) -> tuple[float, float]:
        car, controller = _stopping_drive(Stop(60.0, 1e6))
        path, strongest = _straight(400.0), 0.0
        plan = plan_speed(path, CAR, COMFORT, stops=[Stop(60.0, 1e6)], top_speed=8.0)
        for k in range(300):
            if replaces and k % 7 == 0 and car.s > 40.0 and car.v > 0.0:
                controller.follow(path, plan)
            (step,) = _drive(car, controller, 1)
            strongest = min(strongest, step.request.acceleration)
        return car.s, strongest

    original = places(replaces=False)
    assert original[0] == pytest.approx(60.0, abs=0.15)
    assert places(replaces=True) == pytest.approx(original, abs=0.1)


@pytest.mark.parametrize("share", [0.01, 0.015])
def test_noise_that_grows_with_the_speed_is_no_fault_of_a_car_that_leaves_stops(share) -> None:
    """Ten drives with four stops of 8 s each, and noise of the speed in proportion to it."""
    stops = [Stop(s, 8.0) for s in (100.0, 250.0, 400.0, 550.0)]
    for seed in range(10):
        controller = _controller(700.0, stops=stops, top_speed=15.0)
        car = PointMass(15.0, CAR.mass, DriveActuator(lag=0.25, dead_time=0.1), BrakeActuator(lag=0.1, dead_time=0.1))
        noise, limits = np.random.default_rng(seed), set()
        while car.s < 650.0 and not limits & {SpeedLimit.BRAKE_FAULT, SpeedLimit.DRIVE_FAULT}:
            request = controller.step(car.s, car.v * (1.0 + share * noise.standard_normal()), 0.0)
            car.move(request.force, request.hold)
            limits.add(request.limited_by)
        assert car.s >= 650.0, seed


@pytest.mark.parametrize("grade", [-0.05, 0.05])
def test_a_grade_that_is_wrong_by_5_percent_is_absorbed(grade) -> None:
    controller = _controller(600.0, top_speed=14.0)
    car = PointMass(14.0, CAR.mass, DriveActuator(lag=0.3, dead_time=0.1), BrakeActuator(lag=0.15, dead_time=0.15))
    errors = []
    for _ in range(700):
        car._slope = GRAVITY * grade * min(max((car.s - 100.0) / 20.0, 0.0), 1.0)
        (step,) = _drive(car, controller, 1)
        if 80.0 < step.place < 400.0:
            errors.append(step.speed - 14.0)
    assert len(errors) > 400
    assert np.sqrt(np.mean(np.square(errors))) < 0.3


@pytest.mark.parametrize("speed", [10.0, 16.0, 24.0])
def test_braking_that_holds_the_speed_on_an_unknown_descent_is_no_fault(speed) -> None:
    """From 8 % up to 10 % down within 50 m, with 1 % of noise of the speed."""
    controller = _controller(45.0 * speed, top_speed=speed)
    car = PointMass(speed, CAR.mass, DriveActuator(lag=0.25, dead_time=0.15), BrakeActuator(lag=0.12, dead_time=0.1))
    noise = np.random.default_rng(3)
    for _ in range(500):
        car._slope = GRAVITY * (0.08 - 0.18 * min(max((car.s - 12.0 * speed) / 50.0, 0.0), 1.0))
        request = controller.step(car.s, car.v * (1.0 + 0.01 * noise.standard_normal()), 0.0)
        assert request.limited_by not in {SpeedLimit.BRAKE_FAULT, SpeedLimit.DRIVE_FAULT}
        car.move(request.force, request.hold)
    assert request.force < -0.5 * CAR.mass
    assert car.v == pytest.approx(speed, abs=0.4)


@pytest.mark.parametrize("offset", [-0.06, 0.06])
def test_a_car_whose_speed_sensor_has_an_offset_dwells_at_its_stop_and_drives_on(offset) -> None:
    car, controller = _stopping_drive(Stop(60.0, 3.0))
    stands, hold, stood_at = 0, 0.0, 0.0
    for _ in range(600):
        request = controller.step(car.s, car.v + offset, 0.0)
        if request.state is SpeedState.STOPPED:
            stands, stood_at, hold = stands + 1, car.s, max(hold, request.hold)
        car.move(request.force, request.hold)
    assert stands * PERIOD == pytest.approx(3.0, abs=0.11)
    assert stood_at == pytest.approx(60.0, abs=0.2)
    assert hold < 3.0 * CAR.mass
    assert car.s > 70.0


def test_a_car_that_creeps_against_its_brakes_is_held_within_the_tolerance_of_its_stop() -> None:
    """A mass of 1.4 times on a descent of 10 %, both unknown: the usual hold pressure is not enough."""
    car, controller = _stopping_drive(Stop(60.0, 1e6))
    car._mass, car._slope = 1.4 * car._mass, -0.1 * GRAVITY
    places = [step.place for step in _drive(car, controller, 900) if step.request.state is SpeedState.STOPPED]
    assert len(places) > 300
    assert car.v == 0.0
    assert np.abs(np.array(places) - 60.0).max() < STOP_TOLERANCE


def test_a_measured_grade_serves_as_well_as_one_that_the_path_knows() -> None:
    """Over 8 per cent uphill and a stop on it: error of the speed, place of the stop, and rolling back."""

    def drive(path_grade: float, is_measured: bool) -> tuple[float, float, float]:
        road = _straight(600.0).replace(grade=((100.0, 120.0), (0.0, path_grade)))
        plan = plan_speed(_straight(600.0), CAR, COMFORT, stops=[Stop(250.0, 2.0)], top_speed=14.0)
        controller = SpeedController(SpeedControl(CAR), road, plan, PERIOD)
        car = PointMass(14.0, CAR.mass, DriveActuator(lag=0.3, dead_time=0.1), BrakeActuator(lag=0.15, dead_time=0.15))
        errors, stand, farthest, rolled_back = [], 0.0, 0.0, 0.0
        while car.s < 400.0:
            grade = 0.08 * min(max((car.s - 100.0) / 20.0, 0.0), 1.0)
            car._slope = GRAVITY * grade / math.hypot(1.0, grade)
            request = controller.step(car.s, car.v, 0.0, grade=grade if is_measured else math.nan)
            stand = car.s if request.state == SpeedState.STOPPED else stand
            car.move(request.force, request.hold)
            if 80.0 < car.s < 200.0:
                errors.append(car.v - float(plan.at(car.s)))
            farthest = max(farthest, car.s)
            rolled_back = max(rolled_back, farthest - car.s)
        return float(np.sqrt(np.mean(np.square(errors)))), stand, rolled_back

    with_plan, with_sensor, with_neither = drive(0.08, False), drive(0.0, True), drive(0.0, False)
    assert with_sensor[0] == pytest.approx(with_plan[0], abs=0.01)
    assert with_sensor[0] < 0.6 * with_neither[0]
    assert with_sensor[1:] == pytest.approx(with_plan[1:], abs=0.03)
    assert max(with_plan[2], with_sensor[2]) < 0.02


def test_a_measured_grade_gives_the_force_of_a_path_with_this_grade_and_an_impossible_one_is_not_used() -> None:
    plan = plan_speed(_straight(300.0), CAR, COMFORT, top_speed=10.0)

    def force(grade: float, path_grade: float = 0.0) -> float:
        road = _straight(300.0, grade=path_grade)
        tracker = Tracker(PurePursuit(CAR), road, plan=plan, speed=SpeedControl(CAR))
        return float(tracker.step(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, grade=grade).longitudinal.force)

    assert force(0.1) == pytest.approx(force(math.nan, path_grade=0.1), rel=1e-9)
    assert force(0.1) > force(math.nan) + 0.9 * CAR.mass * GRAVITY * math.sin(math.atan(0.1))
    assert force(8.0) == force(math.inf) == force(math.nan)


def test_impossible_speed_controls_are_refused_with_the_remedy() -> None:
    with pytest.raises(InvalidInput, match=r"friction = \(0.9, 0.6\): must be a value such as 0.9"):
        SpeedControl(CAR, friction=(0.9, 0.6))
    with pytest.raises(InvalidInput, match=r"give plan=plan_speed\(path, car\)"):
        Tracker(MPC(CAR, profile="road"), _straight(100.0), speed=SpeedControl(CAR))


@pytest.mark.parametrize("value", [1e-300, 1e300, math.inf, math.nan, -1.0, "2"])
@pytest.mark.parametrize("name", ["friction", "gain", "governor", "guard", "stop_jerk", "emergency"])
def test_a_setting_of_the_speed_control_that_no_car_can_use_is_refused_with_its_range(name: str, value: object) -> None:
    with pytest.raises(InvalidInput, match=rf"SpeedControl: {name} = .*(>= [0-9.]+ and <= |at least [0-9.]+ and at m)"):
        SpeedControl(CAR, **{name: value})
