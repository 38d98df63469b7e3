"""What an adaptation is made of, and its data: runs to learn from, runs held out, runs to be judged by.

No run and no noise seed is in two of these parts.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.stability import linear_twin
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.control.controllers import MPC
from adaptrack.learning.adaptation.config import AdaptationConfig, Evaluation, campaign_of
from adaptrack.learning.adaptation.method import Method
from adaptrack.paper.campaign_config import Box, CampaignConfig, Plan, Sobol
from adaptrack.paper.evaluator import tuned_mpc
from adaptrack.paper.operating_points import sobol
from adaptrack.tuning.runs import RunSet, operating_point_runs, random_drive_runs

Array = NDArray[np.float64]

Training = list[tuple[RunSet, int]]
"""Run sets to learn from, each with the number of its runs that a round drives."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """An adaptation ready to run: its files read, its plant and its controller built."""

    config: AdaptationConfig
    campaign: CampaignConfig
    plan: Plan
    """of the campaign"""
    plant: Plant | SteppedPlant
    """what is tuned and learned on: the campaign's, or the car's twin where that one is costly"""
    mpc: MPC
    """the paper's controller, with the constant that the search begins with; the contenders choose its tuning"""
    driven: Plant | SteppedPlant
    """what an evaluation drives: the campaign's, unless `driving` says otherwise"""

    @classmethod
    def of(cls, config: AdaptationConfig) -> SetUp:
        """The set-up of a configuration.

        Raises
        ------
        InvalidInput
            When the campaign's operating points are not a Sobol sample of a box; when it tunes on other runs than lane
            changes of the usual length and weight, which are what is learned from and judged by; or when a run would
            be both learned from and held out or judged by.
        """
        campaign = campaign_of(config)
        _check_campaign(campaign)
        _check_drives(config)
        plan = Plan.of(campaign)
        mpc = tuned_mpc(plan.setup, config.method.constants.tuning)
        return cls(config, campaign, plan, plan.setup.searched_on, mpc, plan.setup.plant())

    def driving(self, name: str) -> SetUp:
        """The same with a registered plant to be judged on.

        Raises
        ------
        UnknownName
            When no plant has this name.
        """
        return replace(self, driven=self.plan.setup.plant(name))

    @property
    def believed(self) -> SingleTrack | DualTrack:
        """What an estimator of friction and wind believes in: the plant, or the car as a dual track."""
        setup = self.plan.setup
        return self.plant if isinstance(self.plant, SingleTrack | DualTrack) else DualTrack(setup.vehicle, setup.tyre)

    @property
    def linear(self) -> Plant:
        """What stands for the plant in linear analysis, see `stability.linear_twin`."""
        box, car = self.box, self.plan.setup.vehicle
        return linear_twin(self.plant, car, car.domain.replace(speed=box["speed"], friction=box["friction"]))

    @property
    def roads(self) -> dict[str, Any]:
        """The domain in which drives are drawn, whatever plant drives the car."""
        return self.plan.setup.vehicle.domain.drive_options

    @property
    def method(self) -> Method:
        """How it learns."""
        return self.config.method

    @property
    def evaluation(self) -> Evaluation:
        """How it is judged."""
        return self.config.evaluation

    @property
    def profile(self) -> str:
        """The name of the profile, or its file."""
        return self.campaign.profile

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """The operating domain."""
        box: Box = _points(self.campaign).box
        return {"speed": box.speed, "y_ref": box.y_ref, "friction": box.friction, "wind": box.wind}


def _points(campaign: CampaignConfig) -> Sobol:
    assert isinstance(campaign.operating_points, Sobol)
    return campaign.operating_points


def _check_campaign(campaign: CampaignConfig) -> None:
    if not isinstance(campaign.operating_points, Sobol):
        raise InvalidInput(f"campaign {campaign.name!r}: its operating points must be a Sobol sample of a box.")
    usual = campaign.replace(scenario="lane-change", duration=None, move_weight=None).settled()
    for key in ("scenario", "duration", "move_weight"):
        if getattr(campaign.settled(), key) != getattr(usual, key):
            raise InvalidInput(
                f"campaign {campaign.name!r}: {key} = {getattr(campaign.settled(), key)!r}: must be "
                f"{getattr(usual, key)!r}, as in what schedulers learn from and are judged by."
            )


def _check_drives(config: AdaptationConfig) -> None:
    for (one, first), (other, second) in itertools.combinations(drive_numbers(config).items(), 2):
        if max(first.start, second.start) < min(first.stop, second.stop):
            raise InvalidInput(f"{one} and {other} share random drives: choose first numbers that lie further apart.")


def drive_numbers(config: AdaptationConfig) -> dict[str, range]:
    """The numbers of the random drives of each part."""
    seeds, learning, judged = config.method.seeds, config.learning, config.evaluation
    return {
        "drives to learn from": range(seeds.training_drives, seeds.training_drives + learning.drives),
        "hard drives": range(seeds.hard_drives, seeds.hard_drives + learning.hard_drives),
        "drives held out": range(seeds.held_out_drives, seeds.held_out_drives + config.method.runs.held_out_drives),
        "drives of the evaluation": evaluation_drives(judged, judged.drives, judged.seed),
    }


# -- to learn from, and held out --------------------------------------------------------------------------------------
def training_runs(setup: SetUp) -> Training:
    """Lane changes, drives and hard drives, each with how many of them a round drives."""
    config, runs, numbers = setup.config.learning, setup.method.runs, drive_numbers(setup.config)
    points = sobol(config.operating_points, setup.box, seed=setup.method.seeds.training_points + setup.config.seed)
    roads = {"speed": runs.hard_speed, "demand": runs.hard_demand}
    return [
        (_lane_changes(setup, points), min(runs.round_points, config.operating_points)),
        (
            _drives(setup, numbers["drives to learn from"], runs.training_duration),
            min(runs.round_drives, config.drives),
        ),
        (
            _drives(setup, numbers["hard drives"], runs.training_duration, roads),
            min(runs.round_hard_drives, config.hard_drives),
        ),
    ]


def held_out_runs(setup: SetUp) -> list[RunSet]:
    """Lane changes and drives that choose which round of the learning is kept."""
    runs, seeds = setup.method.runs, setup.method.seeds
    points = sobol(runs.held_out_points, setup.box, seed=seeds.held_out_points + setup.config.seed)
    return [
        _lane_changes(setup, points),
        _drives(setup, drive_numbers(setup.config)["drives held out"], runs.held_out_duration),
    ]


def _lane_changes(setup: SetUp, points: Array) -> RunSet:
    runs = setup.method.runs
    return operating_point_runs(
        setup.plant, setup.mpc, points, setup.profile, stride=runs.point_stride, failure=runs.failure
    )


def _drives(
    setup: SetUp, numbers: range, duration: float, roads: dict[str, tuple[float, float]] | None = None
) -> RunSet:
    runs = setup.method.runs
    return random_drive_runs(
        setup.plant, setup.mpc, numbers, duration, setup.profile, roads=setup.roads | (roads or {}),
        segment_seconds=runs.segment, stride=runs.drive_stride, failure=runs.failure,
    )  # fmt: skip


# -- noise ------------------------------------------------------------------------------------------------------------
def training_noise(method: Method, seed: int, k: int) -> int:
    """The noise seed of round k of a learning."""
    return seed * method.seeds.noise_block + method.seeds.training_noise + k


def held_out_noise(method: Method, seed: int) -> int:
    """The noise seed of all its scores."""
    return seed * method.seeds.noise_block + method.seeds.held_out_noise


def constants_noise(method: Method, seed: int) -> int:
    """The noise seed of the search for constants."""
    return method.seeds.constants_noise + seed % method.seeds.noise_block


# -- to be judged by --------------------------------------------------------------------------------------------------
def evaluation_points(setup: SetUp, count: int, seed: int) -> Array:
    """(count, 4) the operating points of an evaluation.

    Raises
    ------
    InvalidInput
        When the seed makes them points that something was tuned on or learned from.
    """
    first, seeds = setup.evaluation.first_points + seed, setup.method.seeds
    learned = (seeds.training_points + setup.config.seed, seeds.held_out_points + setup.config.seed)
    if first in (_points(setup.campaign).seed, *learned):
        raise InvalidInput(f"seed = {seed}: these operating points were learned from: choose another.")
    return sobol(count, setup.box, seed=first)


def evaluation_drives(evaluation: Evaluation, count: int, seed: int) -> range:
    """The numbers of the drives of an evaluation."""
    first = evaluation.first_drive + evaluation.drive_block * seed
    return range(first, first + count)
