"""The configuration files of an adaptation to any car: what follows from the car, its domain and a tuned constant."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, NamedTuple

from adaptrack.base.files import write_toml
from adaptrack.cars.domain import Domain
from adaptrack.cars.vehicle import GRAVITY
from adaptrack.control.controllers import Tuning
from adaptrack.learning.adaptation.config import around

CHANGE = 12.0 / 3.5
"""Widest change of the reference that is learned from, in lanes."""
HARD_SPEEDS, HARD_DEMAND = 0.57, (0.2, 0.35)
"""Share of the range of speeds above which hard drives are; share of the grip that their roads ask for."""
HORIZONS = ((0.6, 0.5), (1.0, 0.5), (1.0, 1.0), (1.3, 1.4))
"""Of a campaign's library, as shares of those of the constant."""
RATIOS = (0.03, 0.1, 0.3, 0.6, 1.0, 1.8, 3.0, 6.0, 10.0, 30.0)
"""Of its R/Q, likewise."""

WORK: dict[str, dict[str, Any]] = {
    "full": {
        "judged_costly": (100, 100, 8),
        "points": 320, "swarm": (20, 15), "noise": [1, 2], "rounds": 8, "learned": (384, 192, 192), "rules": 20,
        "held_out": (128, 64), "round": (192, 96, 48), "search": (100, 128), "fallback": (16, 8),
        "neighbours": (12, 24), "judged": (500, 500, 8), "known_as": ["exact", "estimated", "withheld"],
        "epochs": (1000, 50),
    },
    "quick": {
        "judged_costly": (16, 10, 1),
        "points": 48, "swarm": (8, 5), "noise": [1], "rounds": 3, "learned": (48, 24, 24), "rules": 6,
        "held_out": (24, 12), "round": (32, 16, 8), "search": (20, 12), "fallback": (6, 3), "neighbours": (6, 10),
        "judged": (48, 40, 2), "known_as": ["exact"], "epochs": (200, 10),
    },
}  # fmt: skip
"""How much is done: operating points of the campaign, its swarms (particles, generations) and noise seeds; rounds of
learning, lane changes, drives and hard drives to learn from, rules of a fuzzy system; points and drives held out; runs
of a round; tunings and runs of the search for constants; hard drives and candidates of the fallback; neighbours of the
look-up tables; operating points, drives and noise seeds of the evaluation, also on a costly plant; epochs of the
paper's recipe."""


class DrivenSetup(NamedTuple):
    """What is driven, as a configuration names it."""

    plant: str = "dual-track"
    """registered name"""
    plugin: tuple[str, ...] = ()
    """modules that register it"""
    costly: bool = False
    """as `Plant.costly`"""


USUAL = DrivenSetup()


def hard_speeds(domain: Domain) -> tuple[float, float]:
    """Lowest and highest speed (m/s) of the hard drives in a domain."""
    slow, fast = domain.speed
    return slow + HARD_SPEEDS * (fast - slow), fast


def write_configuration(
    folder: Path, vehicle: str | os.PathLike[str], profile: str, domain: Domain, constant: Tuning, *,
    quick: bool = False, driven: DrivenSetup = USUAL,
) -> Path:  # fmt: skip
    """Write ``adaptation.toml`` and ``campaign.toml`` to a folder; the path of the first, for `load_adaptation`.

    vehicle: name or file; domain: what is learned from is within it; constant: where searches and learning begin;
    driven: the plant.

    Raises
    ------
    StorageError
        When a file cannot be written.
    """
    work = dict(WORK["quick" if quick else "full"])
    if driven.costly:
        work["judged"] = work["judged_costly"]
    car, world = _where(vehicle), _where(profile)
    where = f"{_range(domain.speed)} m/s, friction {_range(domain.friction)}, wind up to {domain.wind:g} m/s"
    title = f"{Path(car).stem} in {Path(world).stem}, {where}"
    campaign = _campaign(car, world, domain, constant, work, title)
    named = {"plant": driven.plant, **({"plugin": list(driven.plugin)} if driven.plugin else {})}
    write_toml(folder / "campaign.toml", named | campaign)
    file = folder / "adaptation.toml"
    write_toml(file, _adaptation(Path(car).stem, domain, constant, work, title))
    return file


def _where(name_or_path: str | os.PathLike[str]) -> str:
    """A name as it is; a file by its whole path, for it lies elsewhere than the configuration."""
    name = str(name_or_path)
    return str(Path(name).resolve()) if name.endswith(".toml") else name


def _range(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g} to {ends[1]:g}"


def _box(domain: Domain) -> dict[str, list[float]]:
    widest = 2.0 * domain.lane_width
    return {
        "speed": list(domain.speed), "y_ref": [-widest, widest], "friction": list(domain.friction),
        "wind": [-domain.wind, domain.wind],
    }  # fmt: skip


def _campaign(
    car: str, profile: str, domain: Domain, constant: Tuning, work: dict[str, Any], title: str
) -> dict[str, Any]:
    particles, generations = work["swarm"]
    ratio = constant.R / constant.Q
    tunings = [
        [max(5, round(far * constant.Np)), max(1, round(free * constant.Nc)), 1.0, float(f"{share * ratio:.6g}")]
        for far, free in HORIZONS
        for share in RATIOS
    ]
    return {
        "description": f"lane changes in a gust: {title}",
        "vehicle": car,
        "profile": profile,
        "controller": "informed",
        "scenario": "lane-change",
        "noise_seeds": work["noise"],
        "seed": 2,
        "chunk": 8,
        "operating_points": {"kind": "sobol", "n": work["points"], "seed": 2, "box": _box(domain)},
        "failure": {"distance": 200.0 * domain.failure_distance, "sideslip": math.inf},
        "search": {
            "Np": [5, 60], "Nc": [1, 18], "Q": [1.0, 1.0], "R": [1e-3 * ratio, 1e3 * ratio], "decades": True,
        },
        "swarm": {"particles": particles, "generations": generations},
        "library": {"tunings": tunings},
    }  # fmt: skip


def _adaptation(name: str, domain: Domain, constant: Tuning, work: dict[str, Any], title: str) -> dict[str, Any]:
    points, drives, hard = work["learned"]
    own = around(constant)
    slow, fast = domain.speed
    judged_points, judged_drives, noises = work["judged"]
    return {
        "name": name,
        "description": f"schedulers of the informed controller: {title}",
        "campaign": "campaign.toml",
        "seed": 1,
        "learning": {
            "inputs": ["speed", "change", "acceleration", "friction"],
            "rounds": work["rounds"], "operating_points": points, "drives": drives, "hard_drives": hard,
            "rules": work["rules"],
            "domain": {
                "speed": [slow, fast], "change": [0.0, CHANGE * domain.lane_width],
                "acceleration": [0.0, HARD_DEMAND[1] * domain.friction[1] * GRAVITY],
                "friction": _widened(domain.friction),
            },
        },
        "evaluation": {
            "operating_points": judged_points, "drives": judged_drives, "known_as": work["known_as"], "swarms": 1,
            "noises": noises, "swarm_noises": min(2, noises), "choice_noises": noises,
            **own["evaluation"], "hindsight_Np": [float(constant.Np)],
            "hindsight_Nc": [float(constant.Nc)],
        },
        "method": {
            "runs": {
                "held_out_points": work["held_out"][0], "held_out_drives": work["held_out"][1],
                "round_points": work["round"][0], "round_drives": work["round"][1],
                "round_hard_drives": work["round"][2],
                "hard_speed": list(hard_speeds(domain)), "hard_demand": list(HARD_DEMAND),
                "failure_distance": domain.failure_distance,
            },
            "improvement": {**own["method"]["improvement"], "check": min(5, work["rounds"])},
            "constants": {
                **own["method"]["constants"], "evaluations": work["search"][0], "runs": work["search"][1],
                "fallback_drives": work["fallback"][0], "fallback_kept": work["fallback"][1],
            },
            "look_up": {"neighbours": work["neighbours"][0], "speed_neighbours": work["neighbours"][1]},
            "recipe": {"nn_epochs": work["epochs"][0], "anfis_epochs": work["epochs"][1]},
        },
    }  # fmt: skip


def _widened(friction: tuple[float, float]) -> list[float]:
    """A schedule's input needs a range: one friction becomes a narrow one."""
    low, high = friction
    return [low, high] if low < high else [0.95 * low, 1.05 * high]
