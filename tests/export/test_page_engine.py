"""The engine of the page, run by Node on the kernels for WebAssembly: its drives are Python's to the last bit."""

import functools
import json
import os
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
import page_drives
from adaptrack.cars.vehicle import pack_plant
from adaptrack.control.controllers.base import Room
from adaptrack.core import library
from adaptrack.core.kernel import Resident
from adaptrack.core.plants.contract import PLANT_STATE, SLOTS
from adaptrack.core.simulation import run as kernel
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.core.synthesis.plant import dead_periods
from adaptrack.drive.batch import Batch
from adaptrack.export import page_setup
from pages import differing
from programs import find_program, run_program

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(library.WAY != "library", reason="needs the kernels' library")]
DRIVER = Path(__file__).parents[1] / "processors" / "page.mjs"


@functools.cache
def parts():
    """Worker, kernels and data of the page; skips where they are not there."""
    find_program("node")
    from adaptrack.export.page_data import page_data
    from adaptrack.export.page_file import ENGINE, _together, page_kernels

    try:
        return _together(ENGINE), page_kernels(), json.dumps(page_data(), allow_nan=False)
    except at.AdaptrackError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def ask(tmp_path_factory):
    """A function that hands messages to a fresh engine and gives its answers, typed arrays as NumPy's."""
    home = tmp_path_factory.mktemp("page")
    worker, kernels, data = parts()
    (home / "worker.js").write_text(worker)
    (home / "kernels.wasm").write_bytes(kernels)
    (home / "data.json").write_text(data)

    def answers(*messages):
        folder = tmp_path_factory.mktemp("answers")
        (folder / "requests").write_text(json.dumps(messages))
        files = [home / name for name in ("worker.js", "kernels.wasm", "data.json")]
        run_program("node", DRIVER, *files, folder / "requests", folder, timeout=300)
        return [_answer(folder, k) for k in range(len(list(folder.glob("*.json"))))]

    return answers


def _answer(folder, k):
    content = (folder / f"{k}.bin").read_bytes()

    def typed(value):
        if set(value) != {"at", "count", "kind"}:
            return value
        kind = {"Float64Array": "<f8", "Float32Array": "<f4"}[value["kind"]]
        return np.frombuffer(content, kind, value["count"], value["at"])

    return json.loads((folder / f"{k}.json").read_text(), object_hook=typed)


def drive(setup, periods=4000, chunk=700):
    """The messages of a drive from its start on."""
    return [{"type": "start", "id": 1, "setup": setup},
            *({"type": "advance", "id": 1, "periods": chunk} for _ in range(-(-periods // chunk)))]  # fmt: skip


def frames(answers):
    """Of each car of a drive its frames, by the names of their columns."""
    started = next(answer for answer in answers if answer["type"] == "started")
    columns = []
    for k, car in enumerate(started["cars"]):
        rows = [
            answer["cars"][k]["numbers"].reshape(-1, len(car["columns"]))
            for answer in answers
            if answer["type"] == "frames"
        ]
        columns.append(dict(zip(car["columns"], np.concatenate(rows).T, strict=True)))
    return columns


def refusals_of(answers):
    return [(answer["where"], answer["message"]) for answer in answers if answer["type"] == "refused"]


CALLS = int(os.environ.get("ADAPTRACK_TEST_STEPS", "0"))
FEW = "informed", "sheet", "speed control", "speed control, heavy"
"""Drives that are always compared; all of them where there is time."""


@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in page_drives.SETUPS]
)
def test_a_drive_of_the_page_is_the_drive_of_the_package(name, ask):
    answers = ask(*drive(page_drives.SETUPS[name]))
    assert refusals_of(answers) == []
    cars, expected = frames(answers), page_drives.drive_columns(name)
    assert len(cars) == len(expected)
    assert [differing(car, there) for car, there in zip(cars, expected, strict=True)] == [{}] * len(cars)
    assert [len(car["x"]) for car in cars] == [len(there["x"]) for there in expected]


def test_a_drive_begins_with_what_its_controller_assumes_of_the_steering(ask):
    setup = page_drives.SETUPS["informed"]
    _, started = ask(drive(setup)[0])
    controller = page_drives.controller_of(
        setup["controllers"][0], page_drives.car_of(setup["car"]), at.load_profile(setup["profile"])
    )  # fmt: skip
    assumed = {name: controller.belief.steering[name] for name in ("lag", "dead_time")}
    assert started["cars"][0]["belief"] == assumed


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in page_drives.SETUPS if name.startswith("speed control")])
def test_drives_by_a_speed_control_are_those_of_the_package_from_every_seed(name, ask):
    """As many instants of all cars as ADAPTRACK_TEST_STEPS says."""
    seed, instants = 100, 0
    while instants < max(CALLS, 1):
        setup = {**page_drives.SETUPS[name], "seed": seed}
        cars = frames(ask(*drive(setup)))
        expected = [page_drives.columns_of(run) for run in page_drives.simulate_setup(setup)]
        assert [differing(car, there) for car, there in zip(cars, expected, strict=True)] == [{}] * len(cars)
        instants += sum(len(there["x"]) for there in expected)
        seed += 1
    assert instants > 500


def test_truth_and_assumption_changed_before_the_first_instant_are_those_of_a_setup(ask):
    setup = page_drives.SETUPS["speed control, heavy"]
    level = {**setup, "truth": {}, "controllers": [{**setup["controllers"][0], "speed_control": {"friction": 0.5}}]}
    start, *advances = drive(level)
    truth = {name: value for name, value in setup["truth"].items() if value is not None}
    answers = ask(start, change_message({"truth": truth, "speed_control": {"friction": [0.6, 1.0]}}), *advances)
    assert refusals_of(answers) == []
    assert differing(*frames(answers), page_drives.drive_columns("speed control, heavy")[0]) == {}


# -- what is touched while it drives ----------------------------------------------------------------------------------
TOUCHED = page_drives._setup(page_drives.SEDAN, {"name": "mountain"}, {"lateral": 2.5}, "road", "informed", seed=5)


def change_message(change, car=None):
    return {"type": "change", "id": 1, "car": car, "what": change}


def advance_message(periods):
    return {"type": "advance", "id": 1, "periods": periods}


def by_python(before, touch, after):
    """States of `TOUCHED` driven by the package's kernels, with a touch of its run between two stretches."""
    car, profile = page_drives.car_of(TOUCHED["car"]), at.load_profile("road")
    road_drive, controller = (
        page_drives.drive_of(TOUCHED, car),
        page_drives.controller_of(TOUCHED["controllers"][0], car, profile),
    )
    batch = Batch(at.DualTrack(car), controller, [road_drive], profile)
    run = batch.run_record(1, int(batch.substeps[0]), Room())
    run.inputs.seeds[:], run.vehicles.start[:] = TOUCHED["seed"], batch.starts[0]
    run.controller.tuning[:] = batch.tuning
    run = run._replace(memory=run.memory._replace(sent=np.zeros((1, 40))))  # room for a longer dead time
    states = []
    kernel.begin(1, Resident(run))
    for count in (before, after):
        for _ in range(count):
            states.append([run.vehicles.block[j * SLOTS] for j in range(6)])
            kernel.roll_on(1, 1, Resident(run))
        if touch is not None:
            run, touch = touch(run, batch), None
    return np.array(states)


def slower(run, batch):
    actuator = batch.world.steering.replace(lag=0.3, dead_time=0.11, bias=0.01)
    run.vehicles.parameters[:] = pack_plant(batch.world.plant.vehicle, batch.world.plant.tyre, actuator)
    periods, share = dead_periods(batch.world.profile.delay, actuator.dead_time, batch.world.period)
    noises = "noise_vy", "noise_yaw", "noise_yaw_rate", "noise_y"
    return run._replace(settings=run.settings._replace(
        dead_whole=periods, dead_share=share, steering_lag=0.3, steering_bias=0.01,
        **{name: 3.0 * getattr(run.settings, name) for name in noises}))  # fmt: skip


def tuned_and_pushed(run, batch):
    run.controller.tuning[:] = [20, 5, 1.0, 50.0]
    run.vehicles.block[PLANT_STATE.vy * SLOTS] += 0.5
    run.vehicles.block[PLANT_STATE.yaw_rate * SLOTS] -= 0.1
    return run


def blind(run, batch):
    return run._replace(settings=run.settings._replace(noise_vy=np.inf, noise_y=np.inf))


def believing(run, batch):
    car = page_drives.car_of(TOUCHED["car"])
    other = at.MPC(car, profile="road", belief=at.Steering(lag=0.3, dead_time=0.1))
    mpc = other.batch(1, other.settings(), curved=True)
    before = run.controller.mpc
    old = before.memory[0]
    mpc.memory["command"], mpc.memory["reference"] = old.command, old.reference
    mpc.memory["planned"], mpc.memory["age"] = old.planned, old.age
    mpc.plan[0, : before.plan.shape[1]] = before.plan[0]
    return run._replace(controller=run.controller._replace(mpc=mpc))


def icy(run, batch):
    signals, station = run.inputs.signals[0], run.inputs.signals[0, SIGNAL.station]
    for row in (*range(SIGNAL.friction_front_left, SIGNAL.friction_rear_right + 1), SIGNAL.known_friction):
        signals[row, (station >= 400.0) & (station <= 500.0)] = 0.4
    return run


TOUCHES = {
    "truth": (slower, {"truth": {"lag": 0.3, "dead_time": 0.11, "bias": 0.01, "noise": 3.0}}),
    "tuning and push": (
        tuned_and_pushed,
        {"tuning": {"Np": 20, "Nc": 5, "Q": 1.0, "R": 50.0}, "push": {"vy": 0.5, "yaw_rate": -0.1}},
    ),
    "sensors": (blind, {"sensors": {"vy": False, "y": False}}),
    "belief": (believing, {"belief": {"lag": 0.3, "dead_time": 0.1}}),
    "ice": (icy, {"ice": {"from": 400.0, "to": 500.0, "friction": 0.4}}),
}  # fmt: skip


# -- a planner --------------------------------------------------------------------------------------------------------
class RecordedPlanner:
    """A planner that sends the trajectories of a page's drive again, each at the instant of its arrival."""

    def __init__(self, trajectories):
        self.trajectories = trajectories

    def begin(self, road_drive):
        self.instant = -1
        return self

    def step(self, sample):
        self.instant += 1
        return [
            (at.PlannedTrajectory(*trajectory["points"].reshape(-1, 5).T, stamp=trajectory["stamp"]), None)
            for trajectory in self.trajectories
            if trajectory["at"] == self.instant
        ]


def planned_drive(ask, setup, *messages):
    """The frames of the only car of a drive behind a planner, and the trajectories that have arrived."""
    answers = ask({"type": "start", "id": 1, "setup": setup}, *messages)
    assert refusals_of(answers) == []
    arrived = [trajectory for answer in answers if answer["type"] == "frames"
               for trajectory in answer["cars"][0]["trajectories"]]  # fmt: skip
    return frames(answers)[0], arrived


SILENT_PLANNER = page_drives._planned(
    page_drives._setup(page_drives.SEDAN, {"name": "country"}, {"lateral": 2.5}, "production",
                       page_drives._assuming(0.9, "informed"), seed=3),
    period=0.1, delay=0.2, noise=0.03, start="pose",
)  # fmt: skip


def test_the_tracker_of_the_page_does_with_trajectories_what_that_of_the_package_does(ask):
    """The planner's points are noisy, it falls silent, sends again, and has other settings from then on."""
    columns, trajectories = planned_drive(
        ask, SILENT_PLANNER, advance_message(60), change_message({"planner": {"silent": True}}), advance_message(40),
        change_message({"planner": {"silent": False, "delay": 0.4, "period": 0.2, "start": "line"}}),
        advance_message(100),
    )  # fmt: skip
    assert set(columns["driven_by"]) == {1.0, 3.0}
    assert columns["driven_by"][-1] == 1.0
    road = page_drives.road_of(SILENT_PLANNER["road"])
    (first, *_) = trajectories
    x, y = first["points"].reshape(-1, 5)[:, 1:3].T
    assert 0.01 < np.std(road.project(x, y).offset) < 0.06
    (run,) = page_drives.simulate_setup({**SILENT_PLANNER, "planner": RecordedPlanner(trajectories)})
    expected = {name: values[:200] for name, values in page_drives.columns_of(run).items()}
    assert differing(columns, expected) == {}


def test_a_planner_plans_on_a_lap_as_that_of_the_package_does(ask, monkeypatch):
    circle = 20.0 * np.array([(np.sin(a), 1.0 - np.cos(a)) for a in np.arange(0.0, 2.0 * np.pi, 0.1)])
    road = {"points": np.round(circle, 6).tolist(), "closed": True, "name": "circle"}
    setup = page_drives._planned(
        page_drives._setup(page_drives.SEDAN, road, {"constant": 7.0}, "road", page_drives._assuming(0.9, "informed")),
        period=0.1, delay=0.3, start="pose",
    )  # fmt: skip
    columns, _ = planned_drive(ask, setup, advance_message(600))
    monkeypatch.setattr(page_drives, "CLOSED_ROAD_DURATION", 20.0)  # one lap
    expected = page_drives.columns_of(page_drives.simulate_setup(setup)[0])
    count = len(expected["x"])
    assert count > 300
    assert differing({name: values[:count] for name, values in columns.items()}, expected) == {}


def test_a_controller_behind_a_planner_is_touched_while_it_drives(ask):
    changes = (
        {"belief": {"lag": 0.3}}, {"tuning": {"R": 30.0}}, {"speed_control": {"friction": [0.5, 0.8]}},
        {"truth": {"lag": 0.25, "slope": 0.02}}, {"sensors": {"vy": False}}, {"push": {"vy": 0.5, "yaw_rate": 0.0}},
    )  # fmt: skip
    messages = [message for change in changes for message in (change_message(change), advance_message(40))]
    columns, _ = planned_drive(ask, SILENT_PLANNER, advance_message(20), *messages, advance_message(60))
    assert len(columns["x"]) == 20 + 40 * len(changes) + 60
    assert np.abs(columns["error"]).max() < 0.6
    assert (columns["driven_by"] == 1.0).all()


def test_a_planner_whose_points_are_too_noisy_to_be_followed_ends_the_drive_with_a_sentence(ask):
    noisy = {**SILENT_PLANNER, "planner": {**SILENT_PLANNER["planner"], "noise": 0.4}}
    answers = ask({"type": "start", "id": 1, "setup": noisy}, advance_message(400))
    ((where, sentence),) = refusals_of(answers)
    assert where == "planner"
    assert "is impossible: make its points less noisy." in sentence


@pytest.mark.parametrize(("change", "where"), [
    ({"planner": {"period": 0.0, "start": "line"}}, "planner"),
    ({"planner": {"period": 0.1, "start": "anywhere"}}, "planner"),
    ({"planner": {"period": 0.1}, "controllers": [{"kind": "informed"}]}, "controller 1"),
    ({"planner": {"period": 0.1}, "controllers": [page_drives._assuming(0.9, "published-nn")]}, "controller 1"),
    ({"planner": {"period": 0.1}, "road": {"test": "triple-lane-change"}}, "planner"),
])  # fmt: skip
def test_a_planner_that_cannot_be_followed_is_refused_in_a_sentence(ask, change, where):
    ((refused_at, sentence),) = refusals_of(ask({"type": "start", "id": 1, "setup": {**SILENT_PLANNER, **change}}))
    assert refused_at == where
    assert "engine failed" not in sentence


# -- touches and the package ------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize("name", TOUCHES)
def test_what_is_touched_is_what_the_package_does_with_the_same(name, ask):
    touch, change = TOUCHES[name]
    expected = by_python(300, touch, 700)
    answers = ask(
        {"type": "start", "id": 1, "setup": TOUCHED}, advance_message(300), change_message(change), advance_message(700)
    )
    assert refusals_of(answers) == []
    (columns,) = frames(answers)
    states = np.stack([columns[column] for column in ("x", "y", "yaw", "vx", "vy", "yaw_rate")], axis=-1)
    assert (states.view(np.int64) != expected[: len(states)].view(np.int64)).sum() == 0
    assert len(states) > 400


@pytest.mark.slow
def test_a_wheel_that_is_pulled_is_let_go_again(ask):
    answers = ask({"type": "start", "id": 1, "setup": TOUCHED}, advance_message(100),
                  change_message({"pull": {"angle": 0.05, "duration": 0.5}}), advance_message(200))  # fmt: skip
    (calm,), (columns,) = frames(ask(*drive(TOUCHED, 300))), frames(answers)
    distance = np.abs(columns["wheel_angle"] - calm["wheel_angle"][:300])
    assert distance[:100].max() == 0.0
    assert distance[100:115].max() > 0.02
    assert distance[-1] < 0.01


@pytest.mark.slow
def test_ice_that_is_laid_on_a_later_lap_lies_there_and_on_the_laps_after_it(ask):
    lap = page_setup.page_road("oval").length
    setup = {**TOUCHED, "road": {"name": "oval"}, "speed": {"constant": 15.0}}
    laid = change_message({"ice": {"from": 1.99 * lap, "to": 2.02 * lap, "friction": 0.4}})
    answers = ask({"type": "start", "id": 1, "setup": setup}, advance_message(300), laid, *[advance_message(1500)] * 3)
    assert refusals_of(answers) == []
    (columns,) = frames(answers)
    within = (columns["station"] % lap > 0.995 * lap) | (columns["station"] % lap < 0.015 * lap)
    later = within & (columns["station"] > 1.9 * lap)
    assert columns["station"][-1] > 3.1 * lap
    assert (columns["friction"][later] == 0.4).all()
    assert (columns["friction"][columns["station"] < 1.9 * lap] > 0.4).all()


# -- bounds -----------------------------------------------------------------------------------------------------------
def _wrong(**changes):
    return {"type": "start", "id": 1, "setup": {**TOUCHED, **changes}}


KINKED, BROKEN = [[0, 0], [10, 0], [0, 0.001], [10, 0.1], [0, 5]], [[0, 0], [10, 0], [None, 3], [20, 1]]
HOSTILE = {
    "car": [{"name": "none"}, *({"sheet": {"mass": mass, "wheelbase": 2.7}} for mass in ("NaN", 10, 1e9, None)), None],
    "road": [{"name": "none"}, {"test": "none"}, {}, {"points": [[0, 0]]}, {"points": KINKED}, {"points": BROKEN},
             {"points": [[0, 0]] * 9}],
    "speed": [{"constant": 0}, {"constant": None}, {"lateral": 1e9}, {}, {"lateral": "fast"}, None],
    "profile": ["none", None],
    "truth": [{"lag": -1}, {"noise": 1e9}, {"dead_time": "x"}],
    "controllers": [
        [], [{"kind": "none"}], [{"kind": "informed", "tuning": {"Np": 10, "Nc": 20, "Q": 1, "R": 1}}],
        [{"kind": "informed", "belief": {"lag": 7}}], [{"kind": "informed"}] * 3, None,
        [{"kind": "informed", "speed_control": {"friction": [0.9, 0.8]}}], [{"kind": "informed", "speed_control": {}}],
    ],
}  # fmt: skip


def test_what_cannot_be_is_refused_in_a_sentence_and_the_engine_goes_on(ask):
    wrong_setups = [_wrong(**{name: value}) for name, values in HOSTILE.items() for value in values]
    reading = {"type": "read", "what": "csv", "text": "x"}
    requests = [change_message({"truth": {"lag": 1}}), advance_message(5), {"type": "none"}, reading]
    touches = [
        {"speed_control": {"friction": 0.5}}, {"truth": {"slope": 1}}, {"tuning": {"Np": 0}},
        {"ice": {"from": 5, "to": 1, "friction": 0.3}}, {"none": 1},
    ]  # fmt: skip
    good_requests = [{"type": "start", "id": 2, "setup": TOUCHED}, advance_message(20)]
    answers = ask(*wrong_setups, *requests, *good_requests, *map(change_message, touches), advance_message(10))
    words = refusals_of(answers)
    assert len(words) == len(wrong_setups) + len(requests) + len(touches)
    assert [text for _, text in words if "engine failed" in text or text[-1] not in ".?"] == []
    assert answers[-1]["count"] == 10


@pytest.mark.slow
def test_all_sliders_at_their_ends_neither_hang_nor_fail(ask):
    names = ("lag", "dead_time", "bias", "noise", "friction", "wind")
    names += ("brake_lag", "slope", "mass")
    least, most = (0, 0, -0.1, 0, 0.05, -40, 0.01, -0.15, 0.5), (1, 1, 0.1, 20, 1.5, 40, 1, 0.15, 2)
    mixed = (0, 1, 0, 1, 1, 0, 1, 0, 1)
    ends = [{"truth": dict(zip(names, values, strict=True))} for values in (least, most, mixed)]
    weights = (60, 20, 0, 1e-12), (1, 1, 1e9, 1e9)
    tunings = [{"tuning": dict(zip(("Np", "Nc", "Q", "R"), weights_at_end, strict=True))} for weights_at_end in weights]
    beliefs = [{"belief": {"lag": 0, "dead_time": 0}}, {"belief": {"lag": 1, "dead_time": 1}}]
    messages = [
        {"type": "start", "id": 1, "setup": {**TOUCHED, "controllers": [{"kind": "informed"}, {"kind": "learning"}]}}
    ]
    for change in [*ends, *tunings, *beliefs]:
        messages += [change_message(change), advance_message(40)]
    answers = ask(*messages)
    assert refusals_of(answers) == []
    assert sum(answer["type"] == "frames" for answer in answers) == len([*ends, *tunings, *beliefs])
