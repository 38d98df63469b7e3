"""Car and controller as FMUs: driven by FMPy, they are those of `simulate` and of `Tracker`, to the bit."""

import json
import math
import os
import sys
import zipfile
import zlib
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest

import adaptrack as at
import adaptrack.export
from adaptrack import cli
from adaptrack.control.speed_control import SpeedLimit, SpeedState
from adaptrack.control.tracker import tracking_of
from adaptrack.core.kernel import Resident, direct
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.core.tracker.step import tracker_step
from adaptrack.core.units import car as kernel
from adaptrack.core.units import controller as controller_kernel
from adaptrack.export import fmu_build
from adaptrack.export.fmu import constants, write_fmu
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.units import car_unit, controller_unit
from adaptrack.road import Arc, Stop
from exported import STRICT
from fmus import Instance, Signals, needed
from programs import EMULATORS, run_program
from small_controllers import Scripted

pytestmark = [pytest.mark.compiled, needed]
SOURCES = Path(adaptrack.export.__file__).parent
TRUE = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
MEASURED = (
    "measured_vy", "measured_heading_error", "measured_yaw_rate", "measured_offset", "measured_wheel_angle",
    "measured_lateral_acceleration", "measured_pose_age", "measured_motion_age",
)  # fmt: skip
CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR)


@cache
def country():
    road = at.load_road("country", seed=3, length=180.0)
    return at.RoadDrive(road, at.plan_speed(road, CAR), wind=4.0)


@cache
def lane_change():
    return at.load_scenario("lane-change")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fmus")


def car(folder, version="3.0", route=None, profile="road", driver=None, period=None, plant=PLANT):
    name = f"car-{version[0]}-{getattr(route, 'name', 'none')}-{profile}-{plant.name}-{driver is not None}-{period}"
    path = folder / f"{name}.fmu"
    if not path.exists():
        write_fmu(car_unit(plant, route, profile=profile, driver=driver, period=period), path, version)
    return path


def same(a, b):
    return np.array(a, float).tobytes() == np.array(b, float).tobytes()


def differing(instance, plant, controller, route, profile, driver, seed, late=0):
    """Instants at which the FMU differs from `simulate` under its commands: in the true state, or as measured.

    late: periods by which the commands come later.
    """
    run = at.simulate(plant, controller, route, profile=profile, driver=driver, seed=seed)
    assert run.failed is None
    signals = Signals(plant, controller, route, profile, driver)
    loop, difference = signals.loop(seed), 0
    states = np.stack([run.X, run.Y, run.psi, run.vx, run.vy, run.yaw_rate], axis=-1)
    for k in range(signals.signals.n):
        sample = loop.sensed
        sensed = [*sample.measured[:8], sample.speed, loop.run.memory.drives["speed_age"][0]]
        measured = instance.get(*MEASURED, "measured_speed", "measured_speed_age")
        difference += not (same(instance.get(*TRUE), states[k]) and same(measured, sensed))
        command = run.command[k - late] if k >= late else 0.0
        instance.step(command=command, **signals.at(k, instance.get("station")))
        loop.send(float(run.command[k]))
    return difference


LOOPS = {
    "published": (lambda: at.published_mpc(CAR), "paper", None, lane_change),
    "informed": (lambda: at.MPC(CAR, profile="road", preview=True), "road", at.Driver(), lane_change),
    "learning": (lambda: at.MPC(CAR, profile="production", learning=at.Learning()), "production", None, country),
    "stanley": (lambda: at.Stanley(CAR, period=0.05), "road", at.Driver(), country),
    "lqr": (lambda: at.LQR(CAR, period=0.05), "production-bus", None, country),
}
"""Controllers and what they drive in: profile, driver, route."""


# -- the car ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("loop", "version"), [*((loop_name, "3.0") for loop_name in LOOPS), ("informed", "2.0")])
def test_a_loop_over_fmpys_calls_is_a_drive_of_simulate_to_the_bit(loop, version, folder):
    make, profile, driver, route = LOOPS[loop]
    controller = make()
    instance = Instance(car(folder, version, route(), profile, driver, controller.period), folder, seed=11)
    assert differing(instance, PLANT, controller, route(), profile, driver, 11) == 0
    instance.free()


def test_fmpys_own_simulation_is_a_drive_of_simulate_to_the_bit(folder):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    controller, route = at.MPC(CAR, profile="road", preview=True), lane_change()
    run = at.simulate(PLANT, controller, route, profile="road", seed=5)
    signals = Signals(PLANT, controller, route, "road", None)
    rows = [{"time": k * 0.05, "command": run.command[k], **signals.at(k, 0.0)} for k in range(signals.signals.n)]
    rows = [{**row, "on_plan": False, "plan_station": 0.0} for row in rows]
    table = np.array([tuple(row.values()) for row in rows], [(name, float) for name in rows[0]])
    for version in ("2.0", "3.0"):
        result = fmpy.simulate_fmu(
            str(car(folder, version, route)), stop_time=rows[-1]["time"], output_interval=0.05, input=table,
            start_values={"seed": 5}, output=TRUE,
        )  # fmt: skip
        names = ("X", "Y", "psi", "vx", "vy", "yaw_rate")
        assert all(same(result[a], getattr(run, b)[: len(result)]) for a, b in zip(TRUE, names, strict=True))
        assert len(result) == len(rows)


def test_both_descriptions_are_valid(folder):
    validation = pytest.importorskip("fmpy.validation", reason="FMPy is not installed")
    for version in ("2.0", "3.0"):
        for path in (car(folder, version), pilot(folder, "informed", version)):
            assert validation.validate_fmu(str(path)) == []


def test_a_step_of_several_periods_is_several_steps(folder):
    first, other = (Instance(car(folder), folder, name) for name in ("one", "other"))
    first.step(4, command=0.02)
    for _ in range(4):
        other.step(command=0.02)
    assert same(first.get(*TRUE), other.get(*TRUE))
    assert first.get("time") == other.get("time") == 4 * 0.05


# -- the controller ---------------------------------------------------------------------------------------------------
SAMPLES = {
    "x": "measured_x", "y": "measured_y", "yaw": "measured_yaw", "speed": "measured_speed",
    "yaw_rate": "measured_yaw_rate", "wheel_angle": "measured_wheel_angle", "age": "measured_pose_age",
    "motion_age": "measured_motion_age",
}  # fmt: skip
"""What is connected: the controller's input, the car's output."""


@cache
def controller_of(name):
    return LOOPS[name][0]()


def pilot(folder, name, version="3.0"):
    path = folder / f"controller-{name}-{version[0]}.fmu"
    if not path.exists():
        write_fmu(controller_unit(controller_of(name), country().road, country().plan), path, version)
    return path


def drive(folder, name, parallel=False, version="3.0", periods=120, watch=None, has_motion_age=True):
    """The car's true states with a controller in a loop; parallel: both step from what the other gave before."""
    _, profile, driver, _ = LOOPS[name]
    vehicle = car(folder, version, country(), profile, driver, controller_of(name).period)
    body = Instance(vehicle, folder, seed=2, parallel_exchange=parallel)
    mind = Instance(pilot(folder, name, version), folder, wheel_angle_known=True, motion_age_known=has_motion_age)
    signals, states = Signals(PLANT, controller_of(name), country(), profile, driver), []
    for k in range(periods):
        states.append(body.get(*TRUE))
        sample = {name: body.get(output) for name, output in SAMPLES.items()}
        plan = signals.at(k, body.get("station"))
        before = mind.get("command")
        mind.step(**sample)
        body.step(command=before if parallel else mind.get("command"), **plan)
        if watch is not None:
            watch(k, sample, mind)
    return states


@pytest.mark.parametrize(("name", "has_motion_age"), [
    *((name, True) for name in ("published", "informed", "learning", "stanley", "lqr")), ("learning", False),
])  # fmt: skip
def test_the_controller_is_the_tracker_to_the_bit(name, has_motion_age, folder):
    tracker, differ = at.Tracker(LOOPS[name][0](), country().road, plan=country().plan), []
    names = ("command", "offset", "heading_error", "station")

    def watch(k, sample, mind):
        instant = k * mind.period
        place = [sample[name] for name in ("x", "y", "yaw", "speed", "yaw_rate")]
        motion_time = instant - sample["motion_age"] if has_motion_age else None
        answer = tracker.step(
            instant - sample["age"], *place, wheel_angle=sample["wheel_angle"], now=instant, motion_time=motion_time
        )
        status = list(at.Status).index(answer.status)
        differ.append(
            not same([getattr(answer, name) for name in names], mind.get(*names)) or status != mind.get("status")
        )

    states = drive(folder, name, watch=watch, has_motion_age=has_motion_age)
    assert sum(differ) == 0
    assert states[-1][0] != states[0][0]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_controller_predicts_the_path_of_the_tracker_to_the_bit(version, folder):
    tracker, horizon = at.Tracker(LOOPS["learning"][0](), country().road, plan=country().plan), 30
    assert tracker.controller.tuning.Np == horizon

    def watch(k, sample, mind):
        instant = k * mind.period
        tracker.step(
            instant - sample["age"], *(sample[name] for name in ("x", "y", "yaw", "speed", "yaw_rate")),
            wheel_angle=sample["wheel_angle"], now=instant, motion_time=instant - sample["motion_age"],
        )  # fmt: skip
        path, first = tracker.predicted_path(), tracker.controller.predicted_output()[0][0]
        assert mind.get("predicted_count") == len(path) == horizon
        assert same(mind.get("predicted_delay"), first)
        assert same([mind.get_array(name, horizon) for name in ("predicted_x", "predicted_y")], path.T)

    drive(folder, "learning", version=version, periods=40, watch=watch)


def test_where_nothing_is_predicted_the_arrays_are_nan_and_laws_have_none(folder):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    for version in ("2.0", "3.0"):
        mind = Instance(pilot(folder, "informed", version), folder)
        assert mind.get("predicted_count") == 0
        assert np.isnan(mind.get_array("predicted_x", 30)).all()
    for length in (1, 29, 31):
        with pytest.raises(fmpy.fmi1.FMICallException):
            mind.get_array("predicted_x", length)
    assert not any(name.startswith("predicted") for name in Instance(pilot(folder, "stanley"), folder).variables)


def test_a_schedule_is_given_friction_and_wind_that_are_known(folder):
    controller = at.published_mpc(CAR, scheduler=at.load_scheduler("road-nn"))
    tracking = tracking_of(controller, country().road, country().plan)
    step, mind = direct(tracker_step, tracking), Instance(
        write_fmu(controller_unit(controller, country().road, country().plan), folder / "schedule.fmu"), folder,
        friction_known=True,
    )  # fmt: skip
    place = country().road.at(np.arange(30) * 1.2)
    for k in range(30):
        sample = {"x": float(place.x[k]), "y": float(place.y[k]) + 0.2, "yaw": float(place.heading[k]), "speed": 12.0}
        sample |= {"yaw_rate": 0.0, "friction": 0.3 + 0.02 * k}
        mind.step(**sample)
        tracking.tracker.sample[:] = math.nan
        for name, value in (sample | {"t": k * 0.1, "now": k * 0.1}).items():
            tracking.tracker.sample[TRACKER_SAMPLE._fields.index(name)] = value
        step()
        assert same(mind.get("command", "offset", "station"), tracking.tracker.tracked[[0, 2, 4]])
    assert len(np.unique(tracking.controller.tuning)) > 1


def test_the_two_drive_a_planned_road_by_themselves(folder):
    driver = at.Driver()
    vehicle = car(folder, "3.0", country(), "road", driver, 0.05)
    path = folder / "alone.fmu"
    unit = controller_unit(controller_of("informed"), country().road, country().plan, speed_preview=driver.preview)
    body, mind = Instance(vehicle, folder), Instance(write_fmu(unit, path), folder, wheel_angle_known=True)
    assert mind.get("planned_speed") == country().plan.speed[0]
    for _ in range(120):
        mind.step(**{name: body.get(output) for name, output in SAMPLES.items()})
        command, speed, ahead = mind.get("command", "planned_speed", "planned_speed_ahead")
        body.step(command=command, speed=speed, speed_ahead=ahead)
        assert abs(body.get("offset")) < 0.3
    assert speed == pytest.approx(country().plan.at(mind.get("station")), rel=1e-12)
    assert body.get("vx") == pytest.approx(speed, abs=0.5)


class UnitOfKernels:
    """A unit behind the interface of `Instance`, called without an FMU around it."""

    def __init__(self, unit):
        module, name = (kernel, "car") if unit.name == "car" else (controller_kernel, "steering")
        self._values, self._record = unit.record.values, Resident(unit.record)
        self._names = {value.name: i for i, value in enumerate(unit.values)}
        self._step = getattr(module, f"{name}_step")
        assert getattr(module, f"{name}_begin")(self._record) == 0

    def get(self, *names):
        values = [self._values[self._names[name]] for name in names]
        return values if len(names) > 1 else values[0]

    def step(self, **values):
        for name, value in values.items():
            self._values[self._names[name]] = value
        assert self._step(self._record) == 0


@pytest.mark.parametrize("profile", ["paper", "production"])
def test_a_car_that_begins_in_a_bend_drives_as_in_simulate(profile):
    bend = at.Road.from_segments([Arc(length=100.0, curvature=1 / 30)], name="bend")
    route, controller = at.RoadDrive(bend, 9.0), at.MPC(CAR, profile=profile)
    run = at.simulate(PLANT, controller, route, profile=profile)
    body = UnitOfKernels(car_unit(PLANT, route, profile=profile, period=controller.period))
    assert run.yaw_rate[0] == 9.0 / 30.0
    for k in range(100):
        assert same(body.get(*TRUE), [values[k] for values in (run.X, run.Y, run.psi, run.vx, run.vy, run.yaw_rate)])
        plan = {"speed": 9.0, "speed_ahead": 9.0, "on_plan": 1.0, "plan_station": 9.0 * k * controller.period}
        body.step(command=run.command[k], **plan)


SPEED_PARTS = {
    "informed": lambda: at.MPC(CAR, profile="road"),
    "learning": lambda: at.MPC(CAR, profile="production", learning=at.Learning()),
    "pure-pursuit": lambda: at.PurePursuit(CAR, period=0.05),
}
REQUESTED = ("acceleration", "force", "hold", "target_speed", "grip_used", "friction_low", "friction_high",
             "friction_age")  # fmt: skip
PERIODS = 340
DRIVES = max(1, -(-int(os.environ.get("ADAPTRACK_TEST_STEPS", "0")) // PERIODS))


def compare_with_tracker(body, mind, tracker, number):
    """Drive by force; stations (m), those of stands, and calls in which the unit and the tracker differ.

    number: of the drive; from the second on with poses and yaw rates lost and ice, every other one with a measured
    grade.
    """
    rng, stands, stations, differ = np.random.default_rng(number), [], [], 0
    for k in range(PERIODS):
        has_pose, has_rate = (rng.random(2) > 0.05) if number > 0 else (True, True)
        grade = 0.04 + 0.01 * rng.normal() if number % 2 else math.nan
        sample = {name: body.get(output) for name, output in SAMPLES.items() if name != "wheel_angle"}
        mind.step(**sample, pose_known=has_pose, yaw_rate_known=has_rate, grade_known=bool(number % 2), grade=grade)
        place = [sample[name] if has_pose else math.nan for name in ("x", "y", "yaw")]
        rate = sample["yaw_rate"] if has_rate else math.nan
        answer = tracker.step(k * 0.05 - sample["age"], *place, sample["speed"], rate, now=k * 0.05, grade=grade)
        request = answer.longitudinal
        ends = request.friction_low, request.friction_high, request.friction_age
        ours = [answer.command, answer.offset, answer.station, *request[:5], *ends]
        numbers = [list(kind).index(value) for kind, value in (
            (at.Status, answer.status), (SpeedState, request.state), (SpeedLimit, request.limited_by))]  # fmt: skip
        differ += not same(ours, mind.get("command", "offset", "station", *REQUESTED))
        differ += numbers != mind.get("status", "speed_state", "limited_by")
        friction = 0.3 if number > 0 and 90.0 < body.get("station") < 120.0 else 0.9
        wheels = {f"friction_{wheel}": friction for wheel in ("front_left", "front_right", "rear_left", "rear_right")}
        command, force, hold = mind.get("command", "force", "hold")
        body.step(command=command, force=force, hold=hold, grade=0.04, **wheels)
        stations.append(body.get("station"))
        if request.state == SpeedState.STOPPED:
            stands.append(stations[-1])
    return stations, stands, differ


@pytest.mark.parametrize("way", ["kernels", "FMPy"])
@pytest.mark.parametrize("name", SPEED_PARTS)
def test_the_two_stop_and_drive_on_by_force_with_the_requests_of_the_tracker(name, way, folder):
    """As many calls as ADAPTRACK_TEST_STEPS says."""
    road = country().road.replace(grade=0.04)
    plan, speed = at.plan_speed(road, CAR, stops=[Stop(70.0, 1.0)]), at.SpeedControl(CAR, friction=(0.4, 0.9))
    route, profile = at.RoadDrive(road, plan), "production" if name == "learning" else "road"
    for number in range(DRIVES):
        path = road.replace(grade=0.0) if number % 2 else road
        units = (
            car_unit(PLANT, route, profile=profile, driver=speed, period=0.05),
            controller_unit(SPEED_PARTS[name](), path, plan, speed=speed),
        )
        if way == "kernels":
            body, mind = map(UnitOfKernels, units)
        else:
            files = (write_fmu(unit, folder / f"speed-{name}-{number % 2}-{unit.name}.fmu") for unit in units)
            body, mind = (Instance(file, folder) for file in files)
        tracker = at.Tracker(SPEED_PARTS[name](), path, plan=plan, speed=speed)
        stations, stands, differ = compare_with_tracker(body, mind, tracker, number)
        assert differ == 0
        assert stations[-1] > 80.0
        assert number > 0 or stands[-1] == pytest.approx(70.0, abs=0.4)


def test_both_versions_drive_alike_to_the_bit(folder):
    assert same(drive(folder, "informed"), drive(folder, "informed", version="2.0"))


# -- state, instances -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_state_that_is_carried_to_another_instance_goes_on_to_the_bit(version, folder):
    first, other = (Instance(car(folder, version, country(), "production"), folder, name) for name in ("one", "other"))
    for k in range(40):
        first.step(command=0.01 * math.sin(k))
    other.restore(first.saved())
    other.steps = first.steps
    for k in range(20):
        for instance in (first, other):
            instance.step(command=0.02 * math.cos(k))
        assert same(first.get(*TRUE, *MEASURED), other.get(*TRUE, *MEASURED))


# -- what is refused --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("call", "says"), [
    (lambda car: car.step(command=math.nan), "at t = 0.05 s the value with reference 10 is nan: it must be finite"),
    (lambda car: car.step(friction_rear_left=0.0), "reference 17 is 0: it must be finite and from 0.001 to 3"),
    (lambda car: car.step(0.5), "step at t = 0.05 s is 0.025 s long: it must be a whole number of periods"),
    (lambda car: car.fmu.doStep(7.0, 0.05), "begins at t = 7 s: it must begin where the last one ended, at 0.05 s"),
    (lambda car: car.set(seed=3), "reference 3 cannot be set to 3: not after initialization"),
    (lambda car: car.set(x=1.0), "cannot be set to 1: it is computed"),
    (lambda car: car.fmu.setFloat64([3], [1.0]), "of another type"),
    (lambda car: car.fmu.getFloat64([999]), "does not exist"),
    (lambda car: car.restore(car.saved()[:-8]), "the state is of another FMU"),
    (lambda car: car.restore(flipped(car.saved(), 99)), "damaged"),
    (lambda car: car.fmu.enterInitializationMode(startTime=0.0), "reset first"),
])  # fmt: skip
def test_a_wrong_call_is_refused_and_changes_nothing(call, says, folder, capfd):
    instance = Instance(car(folder), folder)
    instance.step(command=0.01)
    before = instance.saved()
    with pytest.raises(Exception, match="failed"):
        call(instance)
    assert says in "".join(capfd.readouterr())
    instance.set(command=0.01, friction_rear_left=0.9)
    assert instance.saved() == before
    capfd.readouterr()
    instance.free()


SINCE_1970 = 1.7e9


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("adds", [True, False], ids=["t += h", "t = start + k h"])
def test_a_master_may_count_from_unix_time_as_it_rounds(adds, version, folder):
    instance = Instance(car(folder, version), folder)
    instance.fmu.terminate()
    instance.fmu.reset()
    instance.begin(start=SINCE_1970)
    time, periods = SINCE_1970, 2500
    for k in range(periods):
        instance.fmu.doStep(time, 0.05)
        time = time + 0.05 if adds else SINCE_1970 + (k + 1) * 0.05
    assert instance.get("time") == SINCE_1970 + periods * 0.05
    instance.free()


@pytest.mark.parametrize("start", [0.0, SINCE_1970])
def test_a_step_left_out_or_of_a_slightly_different_length_is_refused_at_once(start, folder, capfd):
    instance = Instance(car(folder), folder)
    instance.fmu.terminate()
    instance.fmu.reset()
    instance.begin(start=start)
    for _ in range(3):
        instance.step()
    end = start + 3 * 0.05
    for time, size in ((end + 0.05, 0.05), (end - 0.05, 0.05), (end + 1e-4, 0.05), (end, 0.05001), (end, 0.0499)):
        with pytest.raises(Exception, match="failed"):
            instance.fmu.doStep(time, size)
    assert f"{end:.15g}" in "".join(capfd.readouterr())
    instance.step()
    instance.free()


def flipped(content, place):
    return content[:place] + bytes([content[place] ^ 4]) + content[place + 1 :]


def test_what_is_not_compiled_ahead_of_time_is_refused_by_name(folder):
    plant = at.UserPlant(lambda x, u, environment, p, dx: None, {}, 1500.0)
    with pytest.raises(at.InvalidInput, match=r"user|of your own"):
        write_fmu(car_unit(plant), folder / "own.fmu")
    with pytest.raises(at.InvalidInput, match="none that is compiled ahead of time"):
        controller_unit(Scripted(lambda t: 0.0), country().road)
    with pytest.raises(at.InvalidInput, match=r"must end in \.fmu"):
        write_fmu(car_unit(PLANT), folder / "car.zip")


# -- the sources ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("with_headers", [False, True])
def test_the_sources_keep_to_c99_and_to_the_types_of_the_standard(with_headers, tmp_path):
    options = []
    if with_headers:
        fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
        options = ["-DADAPTRACK_STANDARD_HEADERS", "-isystem", str(Path(fmpy.__file__).parent / "c-code")]
    for source in fmu_build.FMU_SOURCES:
        if source.suffix == ".c":
            include = ["-I", str(SOURCES / "c"), "-I", str(SOURCES / "fmu_c")]
            outputs = ["-c", str(source), "-o", str(tmp_path / "made.o")]
            run_program("gcc", *STRICT, "-Wno-pedantic", *options, *include, *outputs)


# -- without FMPy -----------------------------------------------------------------------------------------------------
EMULATED = {"linux": ("gcc",), "linux-aarch64": EMULATORS["aarch64"], "windows": EMULATORS["windows"]}
"""The compiler of a program for a platform, and the command that runs it here."""


@pytest.mark.parametrize(
    "name", ["linux", *(pytest.param(name, marks=pytest.mark.slow) for name in ("linux-aarch64", "windows"))]
)
def test_each_platforms_binary_drives_as_the_kernels_do_to_the_bit(name, folder, tmp_path):
    compiler, *emulator = EMULATED[name]
    unit, driver = car_unit(PLANT, profile="production"), tmp_path / ("driver.exe" if name == "windows" else "driver")
    libraries = [] if name == "windows" else ["-ldl"]
    source = Path(__file__).parents[1] / "processors" / "fmu_driver.c"
    run_program(compiler, "-O1", source, "-o", driver, "-lm", *libraries)
    content = constants(unit)
    (tmp_path / "constants.bin").write_bytes(content)
    place = "." if name == "windows" else str(tmp_path)
    library = f"fmu.{fmu_build.PLATFORMS[name].ending}"
    (tmp_path / library).write_bytes(fmu_build.binary(name))
    library = library if name == "windows" else str(tmp_path / library)
    token = f"{{{zlib.crc32(content):08x}}}"
    arguments = [library, place, token, repr(unit.period), "200", str(kernel.CAR_VALUE.command)]
    answer = run_program(*emulator, str(driver), *arguments, cwd=tmp_path)
    resident = Resident(unit.record)
    kernel.car_begin(resident)
    for k in range(200):
        unit.record.values[kernel.CAR_VALUE.command] = (k % 41 - 20) / 512.0
        assert kernel.car_step(resident) == 0
    expected = unit.record.values[kernel.CAR_VALUE.measured_x : kernel.CAR_VALUE.ended]
    bits = [0 if math.isnan(value) else int(np.float64(value).view(np.uint64)) for value in expected]
    assert [int(word, 16) for word in answer.split()] == bits


@pytest.mark.slow
def test_an_fmu_has_sources_and_a_binary_for_each_platform_that_is_asked_for(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    files = zipfile.ZipFile(
        at.export_fmu(PLANT, folder / "all.fmu", platforms=["linux", "windows", "macos"])
    ).namelist()
    assert [name for name in files if name.startswith("binaries/")] == [
        "binaries/x86_64-linux/adaptrack_car.so", "binaries/x86_64-windows/adaptrack_car.dll",
        "binaries/aarch64-darwin/adaptrack_car.dylib",
    ]  # fmt: skip
    assert {"sources/head.h", "sources/records.h", "sources/plants.c", "sources/fmu.c"} <= set(files)
    cached = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("fmu-*")}
    at.export_fmu(PLANT, folder / "again.fmu", platforms=["linux", "windows", "macos"])
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("fmu-*")} == cached


def test_the_exports_refuse_an_unknown_platform_and_a_missing_compiler(folder, monkeypatch):
    with pytest.raises(at.InvalidInput, match=r"platform 'linus'.*linux"):
        at.export_fmu(PLANT, folder / "no.fmu", platforms=["linus"])
    monkeypatch.setattr(fmu_build.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(at.InvalidInput, match=r"ziglang.*is not installed; run: .*adaptrack\[compile\]"):
        at.export_fmu(PLANT, folder / "no.fmu")
    assert not (folder / "no.fmu").exists()


@pytest.mark.needs("gcc")
def test_a_compiler_of_the_user_makes_the_binary_as_the_fmu_describes(folder, tmp_path):
    zipfile.ZipFile(car(folder)).extractall(tmp_path)
    (described,) = ET.parse(tmp_path / "sources/buildDescription.xml").iter("SourceFileSet")
    sources = [str(tmp_path / "sources" / file.get("name")) for file in described]
    assert described.get("compilerOptions").split() == list(EXACT_OPTIONS)
    options = ["-std=c99", "-O0", *EXACT_OPTIONS, "-Wall", "-Wextra", "-Wno-unknown-pragmas", "-Werror"]
    run_program("gcc", *options, "-shared", "-fPIC", *sources, "-o", tmp_path / "car.so")


def test_the_command_writes_both(folder, monkeypatch, capsys):
    options = ["--road", "country", "--road-seed", "3", "--fmi", "2.0", "--json", "--out", str(folder)]
    monkeypatch.setattr(sys, "argv", ["adaptrack", "export", "fmu", *options])
    assert cli.main() == 0
    report = json.loads(capsys.readouterr().out)
    assert report["fmi"] == "2.0"
    for file in report["files"]:
        assert b'fmiVersion="2.0"' in zipfile.ZipFile(file).read("modelDescription.xml")
    again = at.export_fmu(PLANT, folder / "again.fmu", country(), profile="road")
    other = at.export_fmu(PLANT, folder / "other.fmu", country(), profile="road")
    assert again.read_bytes() == other.read_bytes()


def test_in_a_parallel_exchange_the_cars_own_delay_is_a_period_shorter_to_the_bit(folder):
    controller = at.MPC(CAR, profile="road", preview=True)
    instance = Instance(car(folder, route=lane_change()), folder, seed=4, parallel_exchange=True)
    assert differing(instance, PLANT, controller, lane_change(), "road", None, 4, late=1) == 0


def test_instances_share_nothing(folder):
    alone = Instance(car(folder), folder, "alone", seed=3)
    instances = [Instance(car(folder), folder, str(seed), seed=seed) for seed in (3, 4)]
    for k in range(30):
        alone.step(command=0.01 * k)
    for k in range(30):
        for i, instance in enumerate(instances):
            instance.step(command=0.01 * k * (-1) ** i)
    assert same(alone.get(*TRUE, *MEASURED), instances[0].get(*TRUE, *MEASURED))
    assert instances[1].get("y") == pytest.approx(-alone.get("y"))


def test_an_instance_that_is_reset_begins_anew(folder):
    instance = Instance(car(folder), folder, seed=3)
    first = instance.get(*TRUE, *MEASURED)
    for _ in range(10):
        instance.step(command=0.1)
    instance.fmu.terminate()
    instance.fmu.reset()
    instance.begin(seed=3)
    assert same(first, instance.get(*TRUE, *MEASURED))
