"""The task of learning schedules: car, plant and controller of a campaign, and the runs to learn from.

No run and no noise seed is in two of these parts: learning, choice of the round (held out), evaluation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.stability import linear_twin
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.control.controllers import MPC, Tuning
from adaptrack.drive.failure import FailureLimits
from adaptrack.paper.campaign_config import CampaignConfig, CampaignPlan, Sobol
from adaptrack.paper.evaluator import tuned_mpc
from adaptrack.paper.improvement import LEARNING_ROUNDS, Training
from adaptrack.paper.operating_points import sobol
from adaptrack.tuning.runs import RunSet, operating_point_runs, random_drive_runs

Array = NDArray[np.float64]

LEARNING_SEED = 1
"""Of all random numbers of the learning; the shipped schedules have it."""
LEARNED_INPUTS = ("speed", "change", "acceleration", "friction")
"""Scheduling variables of the learned schedules. The wind gains nothing on drives, and cars do not measure it."""
CHANGE, ACCELERATION = (0.0, 12.0), (0.0, 3.5)
"""Domain of the reference preview: m, m/s^2. That of speed and friction is the campaign's box."""
START = Tuning(29, 5, 1.0, 4000.0)
"""Tuning before the first round: it fails in few runs, and a failed run shows no slope."""

TRAINING_POINTS, HELD_OUT_POINTS = 100 + LEARNING_SEED, 200 + LEARNING_SEED
"""Seeds of the Sobol points to learn from and held out; those of evaluations begin at 10,000."""
TRAINING_DRIVES, HARD_DRIVES, HELD_OUT_DRIVES = 1_000_000, 1_500_000, 2_000_000
"""Number of the first drive of each part; those of evaluations begin at 3,000,000."""
TRAINING_DURATION, HELD_OUT_DURATION = 30.0, 60.0
"""s, of a drive. Long drives are held out because evaluations drive 60 s."""
HARD_DRIVE_SPEED, HARD_DRIVE_DEMAND = (17.0, 29.0), (0.2, 0.35)
"""m/s and share of the grip of the hard drives, on which a car is lost if the tuning is wrong."""
SEGMENT = 2.0
"""s, length of the segments of a drive, and how long before a segment the cause of its cost may lie."""
DRIVE_STRIDE, POINT_STRIDE = 20, 8
"""Periods between two samples of the inputs, on drives and on lane changes (8 s)."""
FAILURE = FailureLimits(5.0, 0.7853981633974483)
"""A run fails 5 m off the reference or with 45 degrees of sideslip."""


class Effort(NamedTuple):
    """Numbers of runs and rounds; the shipped schedules have the defaults."""

    rounds: int = LEARNING_ROUNDS
    operating_points: int = 2048
    """lane changes in a gust to learn from"""
    drives: int = 1024
    hard_drives: int = 4096
    held_out_points: int = 512
    held_out_drives: int = 512
    round_runs: tuple[int, int, int] = (512, 256, 128)
    """lane changes, drives and hard drives of one round"""
    constant_tunings: int = 300
    """tunings that the search for a constant tries"""


@dataclass(frozen=True, eq=False)
class LearningTask:
    """Car, plant and controller for which schedules are learned and evaluated."""

    plan: CampaignPlan
    """of the campaign"""
    plant: Plant | SteppedPlant
    """plant to learn on: the campaign's, or the car's twin if that one is costly"""
    mpc: MPC
    """the paper's controller; schedules choose its tuning"""
    box: dict[str, tuple[float, float]]
    """operating domain of the campaign"""
    effort: Effort

    @classmethod
    def of(cls, campaign: CampaignConfig, effort: Effort | None = None) -> LearningTask:
        """The task of a campaign.

        Raises
        ------
        InvalidInput
            When the operating points are not a Sobol sample of a box, or the campaign's runs are not lane changes of
            the usual length and weight, from which schedules learn.
        """
        points = campaign.operating_points
        if not isinstance(points, Sobol):
            raise InvalidInput(
                f"campaign {campaign.name!r}: schedules are learned on a Sobol sample of a box: "
                'give operating_points the kind "sobol".'
            )
        _check_runs(campaign)
        plan = CampaignPlan.of(campaign)
        setup = plan.setup
        return cls(plan, setup.searched_on, tuned_mpc(setup, START), dict(points.box), effort or Effort())

    @property
    def evaluated_plant(self) -> Plant | SteppedPlant:
        """The plant of evaluations: the campaign's."""
        return self.plan.setup.plant()

    @property
    def profile(self) -> str:
        """The name of the profile, or its file."""
        return self.plan.config.profile

    @property
    def estimated(self) -> SingleTrack | DualTrack:
        """The car model in an estimator of friction and wind."""
        setup = self.plan.setup
        return self.plant if isinstance(self.plant, SingleTrack | DualTrack) else DualTrack(setup.vehicle, setup.tyre)

    @property
    def linear(self) -> Plant:
        """The plant in linear analysis, see `stability.linear_twin`."""
        car = self.plan.setup.vehicle
        domain = car.domain.replace(speed=self.box["speed"], friction=self.box["friction"])
        return linear_twin(self.plant, car, domain)

    @property
    def domain(self) -> Array:
        """(inputs, 2) lowest and highest value of each of `LEARNED_INPUTS`."""
        ranges = {**self.box, "change": CHANGE, "acceleration": ACCELERATION}
        return np.array([ranges[name] for name in LEARNED_INPUTS])

    # -- runs ---------------------------------------------------------------------------------------------------------
    def training(self) -> Training:
        """Lane changes, drives and hard drives to learn from, each with the number that a round drives."""
        effort = self.effort
        points = sobol(effort.operating_points, self.box, seed=TRAINING_POINTS)
        hard = {"speed": HARD_DRIVE_SPEED, "demand": HARD_DRIVE_DEMAND}
        sets = (
            self.lane_changes(points),
            self._drives(TRAINING_DRIVES, effort.drives, TRAINING_DURATION),
            self._drives(HARD_DRIVES, effort.hard_drives, TRAINING_DURATION, hard),
        )
        return [(runs, min(count, len(runs))) for runs, count in zip(sets, effort.round_runs, strict=True)]

    def held_out(self) -> list[RunSet]:
        """Lane changes and drives that choose the best round."""
        points = sobol(self.effort.held_out_points, self.box, seed=HELD_OUT_POINTS)
        drives = self._drives(HELD_OUT_DRIVES, self.effort.held_out_drives, HELD_OUT_DURATION)
        return [self.lane_changes(points), drives]

    def lane_changes(self, points: Array) -> RunSet:
        """A lane change in a gust on each operating point (n, 4)."""
        return operating_point_runs(self.plant, self.mpc, points, self.profile, stride=POINT_STRIDE, failure=FAILURE)

    def _drives(
        self, first: int, count: int, duration: float, roads: dict[str, tuple[float, float]] | None = None
    ) -> RunSet:
        domain: dict[str, Any] = self.plan.setup.vehicle.domain.drive_options
        return random_drive_runs(
            self.plant, self.mpc, range(first, first + count), duration, self.profile,
            drive_options=domain | (roads or {}), segment_seconds=SEGMENT, stride=DRIVE_STRIDE, failure=FAILURE,
        )  # fmt: skip


def _check_runs(campaign: CampaignConfig) -> None:
    default = campaign.replace(scenario="lane-change", duration=None, move_weight=None).settled()
    settled = campaign.settled()
    for key in ("scenario", "duration", "move_weight"):
        if getattr(settled, key) != getattr(default, key):
            raise InvalidInput(
                f"campaign {campaign.name!r}: {key} = {getattr(settled, key)!r}: must be {getattr(default, key)!r}, as "
                "in the runs from which schedules learn."
            )
