"""A controller of ten lines and a plant of ten lines, registered once each, take part everywhere."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars import plant as plants
from adaptrack.control.controllers import registry as controllers

MODULE = """
import math
import numpy as np
import adaptrack as at

class Heading(at.Controller):
    name, tuning_bounds = "heading law", {"gain": (0.02, 0.5)}

    def __init__(self, vehicle, period):
        self.period, self.length, self.tuning = period, vehicle.wheelbase, {"gain": 0.08}

    def step(self, state, speed, reference, variables=None, road=None):
        bend = 0.0 if road is None else float(road.road.at(road.station).curvature)
        angle = self.length * bend + self.tuning["gain"] * (reference[0] - state[3]) - state[1]
        return min(max(angle, -0.5), 0.5) if math.isfinite(angle) else 0.0

class Bicycle(at.SteppedPlant):
    def __init__(self, vehicle, tyre=None):
        self.vehicle = vehicle

    def reset(self, motion):
        self.motion = np.array(motion, dtype=float)

    def step(self, dt, steering, acceleration, environment):
        x, y, yaw, v, _, _ = self.motion
        rate = v * math.tan(steering) / self.vehicle.wheelbase
        self.motion = np.array([x + dt * v * math.cos(yaw), y + dt * v * math.sin(yaw), yaw + dt * rate,
                                v + dt * acceleration, 0.0, rate])
        return self.motion

at.register_controller("heading-law", Heading, words="steers against offset and heading")
at.register_plant("bicycle", Bicycle)
"""
ROAD = ("town", "--length", "120")
OWN = ("--plugin", "newcomers_module", "--plant", "bicycle")


@pytest.fixture
def run(answer_of, tmp_path, monkeypatch):
    """Run a command in a folder that holds the module; its JSON."""
    (tmp_path / "newcomers_module.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(controllers._registry, "factories", dict(controllers._registry.factories))
    monkeypatch.setattr(controllers, "_descriptions", dict(controllers._descriptions))
    monkeypatch.setattr(plants._registry, "factories", dict(plants._registry.factories))
    yield answer_of
    sys.modules.pop("newcomers_module", None)


def test_a_newcomers_controller_and_plant_are_admitted_and_drive(run):
    both = ("--controller", "heading-law", "--controller", "pure-pursuit")
    first, _ = run("drive", *ROAD, *OWN, *both, "--out", "page")["rows"]
    assert not first["failed"]
    assert first["rms_error"] < 1.0
    assert "heading-law" in Path("page/index.html").read_text(encoding="utf-8")
    (row,) = run("drive", "lane-change", *OWN, "--controller", "heading-law")["rows"]
    assert not row["failed"]
    car = at.load_vehicle("paper")
    at.check_controller(at.get_controller("heading-law", car, optional={"period": 0.05}))
    at.check_plant(at.get_plant("bicycle", car))


def test_it_is_tuned_within_its_bounds_and_compared_with_others(run):
    result = run("tune", "paper", "--road", *ROAD, *OWN, "--controller", "heading-law", "--runs", 20, "--out", "tuned")
    assert 0.02 <= result["entries"]["gain"] <= 0.5
    assert result["cost"] <= result["default_cost"]
    rows = run("compare", *ROAD, "--vehicle", "paper/bicycle", "--plugin", "newcomers_module", "--controller",
               "informed", "--controller", "heading-law", "--tuning", "tuned/tuning.toml",
               "--seeds", 1)["profiles"]["road"]  # fmt: skip
    labels = {"informed, default", "heading-law, default", "heading-law, tuned/tuning.toml"}
    assert {row["label"] for row in rows} == labels
    assert all(np.isfinite(row["rms_error"]) for row in rows)
    (row,) = run("drive", *ROAD, *OWN, "--tuning", "tuned/tuning.toml")["rows"]
    assert row["controller"] == "heading-law, tuning"


def test_its_plant_is_steered_by_its_controller_in_an_environment(run):
    gymnasium = pytest.importorskip("gymnasium")
    import adaptrack.gym  # noqa: F401 - registers the environments
    from adaptrack.cli.options import load_plugins

    load_plugins(["newcomers_module"])
    env = gymnasium.make("adaptrack/PathTracking-v0", car="paper/bicycle", road="town:0", length=120.0)
    law = at.get_controller("heading-law", at.load_vehicle("paper"), optional={"period": 0.05})
    observation, _ = env.reset(seed=1)
    names, over = list(env.unwrapped.names), False
    while not over:
        values = dict(zip(names, observation.tolist(), strict=True))
        angle = law.step([0.0, values["heading_error"], values["yaw_rate"], values["offset"]], values["speed"], [0.0])
        observation, _, terminated, truncated, info = env.step([angle + law.length * values["curvature_5m"]])
        over = terminated or truncated
    assert info["failed"] == ""
    assert np.isfinite(info["J"])
