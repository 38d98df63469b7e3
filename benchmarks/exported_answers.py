"""Arrays that what a checkout exports gives on fixed work: C, units of FMUs, the page; and environments, speed control.

`answers.py` has them among its workloads. What a machine lacks (gcc, Node, Gymnasium) is an answer of its own.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Named = Iterator[tuple[str, Any]]

MISSING = np.array([math.nan])
"""The answer of a program that is not installed."""
STOP = 180.0
"""m, where the cars stop."""
RECORDED = "adaptrack_recorded.h"
SPEED_PROFILES = ("road", "production", "production-bus")
PAGE_ENGINE = Path(__file__).resolve().parents[1] / "tests/processors/page.mjs"
SETUPS = {
    "two laws": {"car": {"name": "van"}, "road": {"name": "town"}, "speed": {"lateral": 2.5}, "profile": "production",
                 "controllers": [{"kind": "lqr"}, {"kind": "learning", "knows": "sheet"}]},
    "speed control": {"car": {"name": "midsize-sedan"}, "road": {"name": "mountain"}, "speed": {"lateral": 3.0},
                      "profile": "road", "truth": {"friction": 0.5, "mass": 1.2},
                      "controllers": [{"kind": "informed", "speed_control": {"friction": [0.4, 0.9]}}]},
    "networks": {"car": {"name": "paper"}, "road": {"test": "triple-lane-change"}, "speed": {}, "profile": "paper",
                 "controllers": [{"kind": "published"}, {"kind": "published-nn"}]},
}  # fmt: skip
"""Drives of the page."""


def _controllers(at: Any, car: Any, profile: str) -> dict[str, Any]:
    return {
        "informed": at.MPC(car, profile=profile), "learning": at.MPC(car, profile=profile, learning=at.Learning()),
        "stanley": at.Stanley(car, period=at.MPC(car, profile=profile).period, preview=True),
    }  # fmt: skip


def numbers_of(answer: Any) -> list[float]:
    """The numbers of an answer in their order; of a text or a member of an enumeration the sum of its bytes."""
    if isinstance(answer, tuple | list | frozenset | set):
        parts = sorted(answer, key=str) if isinstance(answer, frozenset | set) else answer
        return [number for part in parts for number in numbers_of(part)]
    if isinstance(answer, int | float | np.floating | np.integer):
        return [float(answer)]
    return [math.nan if answer is None else float(zlib.crc32(str(answer).encode()))]


def padded(rows: Sequence[Sequence[float]]) -> np.ndarray:
    """(n, .) rows of different lengths, NaN behind their ends."""
    width = max(map(len, rows))
    return np.array([[*row, *[math.nan] * (width - len(row))] for row in rows])


def trace(run: Any) -> np.ndarray:
    """(n, .) all columns of a trajectory but the times that its steps took."""
    return np.column_stack([values.astype(float) for name, values in run.columns().items() if name != "step_time"])


def _road(at: Any) -> Any:
    return at.generate_road("country", seed=4, length=400.0).replace(friction=0.6, grade=0.03)


def speed_controls(at: Any) -> Named:
    """Drives with stop, slope and little friction by speed control and by a guarded driver, late and missing samples.

    The tracker gets the same samples late, in jumps of time, without pose or speed, and while a driver has the pedals.
    """
    car, road = at.load_vehicle("midsize-sedan"), _road(at)
    plan = at.plan_speed(road, car, stops=[at.road.Stop(STOP, 1.0)])
    control = at.SpeedControl(car, friction=(0.4, 0.9))
    drivers = {"speed control": control, "guarded": at.Driver(guard=0.7)}
    gaps = {"missing": 0.05, "dropout_pause": 3.0, "dropout_least": 0.3, "dropout_most": 1.5}
    for profile in SPEED_PROFILES:
        world = at.load_profile(profile)
        for change in ("", "gaps") if profile.startswith("production") else ("",):
            for name, controller in _controllers(at, car, profile).items():
                for driver_name, driver in drivers.items():
                    run = at.simulate(
                        at.DualTrack(car), controller, at.RoadDrive(road, plan), driver=driver, seed=5,
                        profile=world.replace(**gaps) if change else world,
                    )  # fmt: skip
                    yield f"{profile} {change}, {name}, {driver_name}", trace(run)
    for name, controller in _controllers(at, car, "road").items():
        tracker = at.Tracker(controller, road, plan=plan, speed=control)
        rng, time, station, speed, rows = np.random.default_rng(7), 0.0, 0.0, 5.0, []
        for k in range(1200):
            time += 0.05 if k % 90 else 0.21
            x, y, yaw, curvature = (float(part) for part in road.at(station)[:4])
            lost, late = rng.random() < 0.05 or 300 < k < 330, 0.1 * (rng.random() < 0.2)
            pose = (math.nan,) * 3 if lost else (x + 0.05 * rng.normal(), y + 0.05 * rng.normal(), yaw)
            measured = math.nan if rng.random() < 0.05 else max(speed + 0.02 * rng.normal(), 0.0)
            answer = tracker.step(
                time - late, *pose, measured, speed * curvature, now=time, driver=400 < k < 430, grade=0.03
            )
            rows.append(numbers_of(answer))
            push = answer.longitudinal.acceleration
            speed = max(speed + 0.05 * (push if math.isfinite(push) else 0.0), 0.0)
            station = min(station + 0.05 * speed, road.length)
        yield f"tracker, {name}", padded(rows)


def environments(at: Any) -> Named:
    """Episodes of both environments with fixed actions, alone and eight at once."""
    try:
        from adaptrack import gym
    except ImportError:
        yield "Gymnasium", MISSING
        return
    for name, task in {
        "steering": {"road": "mountain:2", "length": 150.0, "profile": "production"},
        "steering, driver": {"road": "lap:1", "driver": at.Driver(), "profile": "road"},
    }.items():
        single, several = gym.PathTrackingEnv(**task), gym.PathTrackingVectorEnv(8, **task)
        yield name, _episodes(single, lambda row: [float(np.clip(-0.02 * row[0] - 0.3 * row[1], -0.4, 0.4))])
        observation, _ = several.reset(seed=3)
        rows = []
        for _ in range(150):
            action = np.clip(-0.02 * observation[:, :1] - 0.3 * observation[:, 1:2], -0.4, 0.4)
            observation, reward, *_ = several.step(np.nan_to_num(action).astype(several.action_space.dtype))
            rows.append(np.column_stack([observation, reward]))
        yield f"{name}, eight", np.array(rows)
    yield "tuning", _episodes(gym.MPCTuningEnv(road="country:3", length=150.0), lambda row: [-0.3, -0.5, 0.1])


def _episodes(env: Any, act: Any) -> np.ndarray:
    rows, over = [], True
    for k in range(200):
        if over:
            observation, _ = env.reset(seed=k)
        action = np.nan_to_num(np.array(act(observation))).astype(env.action_space.dtype)
        observation, reward, ended, cut, _ = env.step(action)
        over = ended or cut
        rows.append([*observation, reward, ended, cut])
    return np.array(rows, float)


def c_library(at: Any) -> Named:
    """The recorded minutes of C exports, their constants, and how many of the answers of gcc's program differ."""
    car, road = at.load_vehicle("midsize-sedan"), at.generate_road("country", seed=4, length=400.0)
    plan = at.plan_speed(road, car, stops=[at.road.Stop(STOP, 1.0)])
    for name, controller in {
        **_controllers(at, car, "road"), "unknown": at.MPC(car, belief="unknown", learning=at.Learning()),
        "scheduled": at.published_mpc(car, scheduler=at.load_scheduler("road-nn"), period=0.05, preview=True),
    }.items():  # fmt: skip
        for speed in (None, at.SpeedControl(car, friction=(0.4, 0.9))):
            with tempfile.TemporaryDirectory() as folder:
                parts = {} if speed is None else {"road": road, "plan": plan, "speed": speed}
                at.export_c(controller, folder, **parts)
                where = f"{name}{'' if speed is None else ', speed control'}"
                text = (Path(folder) / RECORDED).read_text()
                found = re.findall(r"0x[0-9a-fA-F]+|-?\d+\.?\d*(?:e-?\d+)?", text)
                yield f"{where}: recorded", np.array([float(zlib.crc32(number.encode())) for number in found])
                if shutil.which("gcc") is None:
                    yield f"{where}: check", MISSING
                    continue
                done = subprocess.run(["make", "-C", folder, "check"], capture_output=True, text=True, check=False)
                yield f"{where}: check", np.array([float(done.returncode)])


SAMPLES = {
    "x": "measured_x", "y": "measured_y", "yaw": "measured_yaw", "speed": "measured_speed",
    "yaw_rate": "measured_yaw_rate", "wheel_angle": "measured_wheel_angle", "age": "measured_pose_age",
    "motion_age": "measured_motion_age",
}  # fmt: skip
"""What connects the units of an FMU: the controller's input, the car's output."""


class _Unit:
    """A unit of co-simulation, its kernels called as an FMU calls them."""

    def __init__(self, unit: Any) -> None:
        from adaptrack.core.kernel import Resident
        from adaptrack.core.units import car, controller

        module, name = (car, "car") if unit.name == "car" else (controller, "steering")
        law = "law_" if "Law" in type(unit.record).__name__ else ""  # releases that had a kernel for each kind
        steps = [f"{name}_step"] if hasattr(module, f"{name}_step") and not law else []
        steps = [f"{law}speed_{name}_step"] if hasattr(module, f"{law}speed_{name}_step") else steps
        self.values, self._record = unit.record.values, Resident(unit.record)
        self._places = {value.name: i for i, value in enumerate(unit.values)}
        self._step = getattr(module, steps[0])
        getattr(module, f"{law}{name}_begin")(self._record)

    def get(self, name: str) -> float:
        return float(self.values[self._places[name]])

    def step(self, **values: float) -> None:
        for name, value in values.items():
            self.values[self._places[name]] = value
        self._step(self._record)


def fmu_units(at: Any) -> Named:
    """All values of a car and of its controller with speed control, that drive each other by force."""
    from adaptrack.export.units import car_unit, controller_unit

    car, road = at.load_vehicle("midsize-sedan"), _road(at)
    plan = at.plan_speed(road, car, stops=[at.road.Stop(STOP, 1.0)])
    control = at.SpeedControl(car, friction=(0.4, 0.9))
    for profile in ("road", "production"):
        for name, controller in _controllers(at, car, profile).items():
            body = _Unit(
                car_unit(
                    at.DualTrack(car), at.RoadDrive(road, plan), profile=profile, driver=control,
                    period=controller.period,
                )
            )  # fmt: skip
            mind, rows = _Unit(controller_unit(controller, road, plan, speed=control)), []
            for k in range(600):
                lost = {"pose_known": float(k % 40 != 7), "yaw_rate_known": float(k % 55 != 9)}
                mind.step(**{key: body.get(output) for key, output in SAMPLES.items()}, **lost)
                body.step(**{key: mind.get(key) for key in ("command", "force", "hold")}, grade=0.03)
                rows.append([*body.values, *mind.values])
            yield f"{profile}, {name}", np.array(rows)


def page(at: Any) -> Named:
    """Frames of drives of the page, by its own scripts and kernels of WebAssembly."""
    from adaptrack.export.page_data import page_data
    from adaptrack.export.page_file import ENGINE, _together, page_kernels

    if shutil.which("node") is None:
        yield "Node", MISSING
        return
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        (home / "worker.js").write_text(_together(ENGINE))
        (home / "kernels.wasm").write_bytes(page_kernels())
        (home / "data.json").write_text(json.dumps(page_data(), allow_nan=False))
        for drive, setup in SETUPS.items():
            folder = home / drive.replace(" ", "-")
            folder.mkdir()
            messages = [{"type": "start", "id": 1, "setup": {"seed": 2, "truth": {}, **setup}}]
            messages += [{"type": "advance", "id": 1, "periods": 400}] * 2
            (folder / "requests").write_text(json.dumps(messages))
            files = [str(home / file) for file in ("worker.js", "kernels.wasm", "data.json")]
            subprocess.run(
                ["node", str(PAGE_ENGINE), *files, str(folder / "requests"), str(folder)], capture_output=True,
                check=True, timeout=600,
            )  # fmt: skip
            for k in range(1, len(messages) + 1):
                answer = json.loads((folder / f"{k}.json").read_text())
                content = (folder / f"{k}.bin").read_bytes()
                yield f"{drive} {k}: {answer['type']}", _frames(answer, content)


def _frames(answer: dict[str, Any], content: bytes) -> np.ndarray:
    """The numbers of the cars of an answer; of another answer the sum of its bytes."""
    places = [car["numbers"] for car in answer.get("cars", ()) if "at" in (car.get("numbers") or {})]
    if not places:
        return np.array([float(zlib.crc32(json.dumps(answer, sort_keys=True).encode()))])
    return np.concatenate([np.frombuffer(content, "<f8", place["count"], place["at"]) for place in places])


EXPORTED = (speed_controls, environments, c_library, fmu_units, page)
"""Workloads."""
