"""A car as a unit of co-simulation is that of a closed loop."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.following import DRIVERS, VERDICTS, DrivenBy, Verdict
from adaptrack.core.kernel import Resident
from adaptrack.core.planned.records import POINT
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.core.units import car, contract, controller, follower
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World
from adaptrack.export.units import CONSTANT_VALUE, INPUT_VALUE, PARAMETER, car_unit, controller_unit

pytestmark = pytest.mark.kernels
CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR)
STEP = at.load_scenario("step", duration=2.0, speed=15.0)


NOISY_BUS = at.load_profile("production-bus").replace(noise_station=0.2)


@pytest.mark.parametrize("profile", [at.load_profile("production"), NOISY_BUS], ids=lambda profile: profile.name)
def test_a_car_and_a_closed_loop_agree_to_the_bit_at_every_instant(profile):
    law = at.Stanley(CAR, period=0.05)
    loop = ClosedLoop(World.of(PLANT, law, profile, None, None, None), STEP, 6)
    unit = car_unit(PLANT, STEP, profile=profile, period=0.05)
    values, record = unit.record.values, Resident(unit.record)
    values[car.CAR_VALUE.seed] = 6
    assert car.car_begin(record) == contract.OK
    signals = loop.signals
    for k in range(12):
        sample = loop.sensed
        measured = values[car.CAR_VALUE.measured_heading_error], values[car.CAR_VALUE.measured_offset]
        assert np.array_equal(measured, (sample.measured[1], sample.measured[3]), equal_nan=True)
        assert values[car.CAR_VALUE.measured_speed] == sample.speed
        assert (
            np.isnan(sample.measured[3])
            or values[car.CAR_VALUE.measured_x] == loop.run.memory.drives["pose_station"][0]
        )
        values[car.CAR_VALUE.command] = 0.01 * k
        values[car.CAR_VALUE.speed], values[car.CAR_VALUE.speed_ahead] = signals.speed[k : k + 2]
        values[car.CAR_VALUE.friction_front_left : car.CAR_VALUE.wind_x] = signals.friction[k]
        values[car.CAR_VALUE.wind_x : car.CAR_VALUE.bank] = signals.wind[k]
        assert car.car_step(record) == contract.OK
        loop.send(0.01 * k)
    assert values[car.CAR_VALUE.time] == 12 * 0.05


def test_a_value_out_of_its_range_is_named_by_the_status():
    unit = car_unit(PLANT, profile="road")
    values, record = unit.record.values, Resident(unit.record)
    values[car.CAR_VALUE.start_speed] = -1.0
    assert car.car_begin(record) == -1 - car.CAR_VALUE.start_speed
    values[car.CAR_VALUE.start_speed] = 10.0
    assert car.car_begin(record) == contract.OK
    values[car.CAR_VALUE.wind_y] = np.nan
    assert car.car_step(record) == -1 - car.CAR_VALUE.wind_y


def test_an_optional_input_reaches_the_tracker_only_with_its_flag():
    unit = controller_unit(at.Stanley(CAR, period=0.05), at.load_road("town", seed=1, length=150.0))
    values, sample, places = unit.record.values, unit.record.tracking.tracker.sample, controller.STEERING_VALUE
    flags = {name: "pose_known" if name in ("x", "y", "yaw") else f"{controller.INPUT_NAMES.get(name, name)}_known"
             for name in TRACKER_SAMPLE._fields}  # fmt: skip
    optional = {name: flag for name, flag in flags.items() if flag in places._fields}
    assert {"x", "yaw_rate", "lateral_velocity", "wheel_angle", "wind", "grade"} <= set(optional)
    for k, (name, flag) in enumerate(optional.items()):
        values[getattr(places, controller.INPUT_NAMES.get(name, name))] = 0.01 * (k + 1)
        for is_measured in (0.0, 1.0):
            values[getattr(places, flag)] = is_measured
            assert controller.steering_step(Resident(unit.record)) == contract.OK
            assert np.array_equal(
                sample[getattr(TRACKER_SAMPLE, name)], 0.01 * (k + 1) if is_measured else np.nan, True
            )


def test_each_value_says_what_it_is_and_in_which_unit():
    road = at.load_road("town", seed=1, length=150.0)
    units = car_unit(PLANT), controller_unit(at.Stanley(CAR, period=0.05), road)
    for unit, columns in zip(units, (car.CAR_VALUE, controller.STEERING_VALUE), strict=True):
        assert tuple(value.name for value in unit.values) == columns._fields
        assert all(len(value.description) > 8 for value in unit.values)
        plain = {value.name for value in unit.values if not value.unit and value.type == 0}
        assert all(name.startswith("friction") or name == "grade" for name in plain)
        assert {value.role for value in unit.values} == {CONSTANT_VALUE, PARAMETER, INPUT_VALUE, 0}


def test_a_unit_follows_trajectories_and_its_fallback_as_a_tracker_does_to_the_bit():
    tracker = at.Tracker(at.Stanley(CAR, period=0.05), following=at.Following())
    unit = controller_unit(at.Stanley(CAR, period=0.05), following=at.Following(), trajectory_points=8)
    values, record, places = unit.record.values, Resident(unit.record), {v.name: i for i, v in enumerate(unit.values)}
    assert follower.follower_begin(record) == contract.OK
    t, drivers, verdicts = np.linspace(0.0, 3.5, 8), [], []

    def write(name, trajectory):
        values[places[f"{name}_count"]] = len(trajectory.points)
        for column, numbers in zip(POINT._fields, trajectory.points.T, strict=True):
            first = places[f"{name}_{column}[1]"]
            values[first : first + numbers.size] = numbers

    for k in range(24):
        time, x, y = 0.05 * k, 0.4 * k, 0.2 if k < 4 else 0.1
        if k < 8 and k % 2 == 0:
            plan = at.PlannedTrajectory(t, x + 8.0 * t, 0.02 * (x + 8.0 * t) ** 2 / 10.0, stamp=time + (k == 6))
            stop = at.PlannedTrajectory(t, x + 8.0 * t - 8.0 * t**2 / 7.0, 0.0 * t)
            write("trajectory", plan)
            write("fallback", stop)
            values[places["trajectory_number"]], values[places["trajectory_stamp"]] = k + 1, plan.stamp
            verdicts.append(tracker.follow(plan, fallback=stop, now=time))
        for name, value in (("x", x), ("y", y), ("yaw", 0.01 * k), ("speed", 8.0), ("yaw_rate", 0.2)):
            values[places[name]] = value
        assert follower.follower_step(record) == contract.OK
        answer = tracker.step(time, x, y, 0.01 * k, 8.0, 0.2, now=time)
        ours = [answer.command, answer.offset, answer.station, answer.target_speed, answer.late]
        theirs = [values[places[name]] for name in ("command", "offset", "station", "target_speed", "late")]
        assert np.array_equal(ours, theirs)
        assert values[places["driven_by"]] == DRIVERS.index(answer.driven_by)
        assert VERDICTS[int(values[places["verdict"]])] is verdicts[-1]
        drivers.append(answer.driven_by)
    assert verdicts == [Verdict.TAKEN, Verdict.TAKEN, Verdict.TAKEN, Verdict.EARLY]
    assert set(drivers) == {DrivenBy.PLANNER, DrivenBy.FALLBACK}
