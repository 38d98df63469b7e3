"""The method: every number of the adaptation that a learned scheduler depends on, with its unit and its meaning.

It is the table `[method]` of an adaptation's configuration, and it is hashed whole into the identity of every stage:
no constant of a module changes a result. The defaults made the schedulers that ship with the package.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from adaptrack.base.files import Record
from adaptrack.control.controllers import Tuning
from adaptrack.drive.failure import Failure
from adaptrack.paper.campaign_config import Pair

Array = NDArray[np.float64]


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Reals = Annotated[tuple[float, ...], BeforeValidator(_tuples), Field(min_length=1)]
Wholes = Annotated[tuple[int, ...], BeforeValidator(_tuples), Field(min_length=1)]
Triple = Annotated[tuple[float, float, float], BeforeValidator(_tuples)]
"""Of Np, Nc and log10 R/Q."""


class Seeds(Record):
    """Where the random numbers of each part begin; no two parts share any."""

    training_drives: int = Field(default=1_000_000, ge=0, description="number of the first drive to learn from")
    hard_drives: int = Field(default=1_500_000, ge=0, description="number of the first fast drive near the limit")
    held_out_drives: int = Field(default=2_000_000, ge=0, description="number of the first drive held out")
    training_points: int = Field(default=100, ge=0, description="of the Sobol points to learn from, plus `seed`")
    held_out_points: int = Field(default=200, ge=0, description="of the Sobol points held out, plus `seed`")
    noise_block: int = Field(default=100_000, ge=1, description="noise seeds set aside for each `seed`")
    held_out_noise: int = Field(default=900, ge=0, description="in that block: noise of the runs held out")
    training_noise: int = Field(default=1000, ge=0, description="in that block: noise of round 0, then counted up")
    constants_noise: int = Field(default=700_000, ge=0, description="noise of the search for constants, plus `seed`")
    fallback_noise: int = Field(default=1, ge=0, description="noise of the choice of the fallback")


class Runs(Record):
    """The runs to learn from and those held out, and when one has failed."""

    training_duration: float = Field(default=30.0, gt=0, description="s, of a drive to learn from")
    held_out_duration: float = Field(default=60.0, gt=0, description="s, of a drive held out")
    held_out_points: int = Field(default=512, ge=1, description="operating points held out")
    held_out_drives: int = Field(default=512, ge=1, description="drives held out")
    hard_speed: Pair = Field(default=(17.0, 29.0), description="m/s, lowest and highest speed of a hard drive")
    hard_demand: Pair = Field(default=(0.2, 0.35), description="share of the grip that a hard drive's road asks for")
    round_points: int = Field(default=512, ge=1, description="operating points driven in a round")
    round_drives: int = Field(default=256, ge=1, description="drives driven in a round")
    round_hard_drives: int = Field(default=128, ge=1, description="hard drives driven in a round")
    segment: float = Field(default=2.0, gt=0, description="s, of the segments of a drive; how old causes may be")
    drive_stride: int = Field(default=20, ge=1, description="periods between two looks at the inputs, on drives")
    point_stride: int = Field(default=8, ge=1, description="periods between two looks at the inputs, on lane changes")
    failure_distance: float = Field(default=5.0, gt=0, description="m off the reference: the run has failed")
    failure_sideslip: float = Field(default=0.7853981633974483, gt=0, le=1.6, description="rad: the run has failed")

    @property
    def failure(self) -> Failure:
        """When a run has failed."""
        return Failure(self.failure_distance, self.failure_sideslip)


class Landscape(Record):
    """How the cost around a schedule becomes wished moves of its outputs Np, Nc and log10 R/Q."""

    shift: Triple = Field(default=(3.0, 1.5, 0.15), description="of each output, to look at the cost beside it")
    least_curvature: Triple = Field(
        default=(0.002, 0.005, 0.3), description="of the relative cost per squared unit: flatter counts as this curved"
    )
    least_share: float = Field(default=1e-3, ge=0, description="of a run's cost, added to each segment's for that")
    worst_segment: float = Field(default=5.0, gt=0, description="most that a segment counts, in costs of its run")
    rescues: Reals = Field(
        default=(0.25, 0.5, 1.0), description="shares of the way to the fallback that a failed run is driven again at"
    )
    before_failure: int = Field(default=2, ge=0, description="segments before the failing one that share its cause")


class ImprovementSettings(Record):
    """How the outputs follow the wished moves, round by round."""

    start: Triple = Field(default=(29.0, 5.0, 3.6), description="Np, Nc and log10 R/Q before the first round")
    span: Triple = Field(default=(10.0, 5.0, 0.5), description="scale of the changes of each")
    check: int = Field(default=5, ge=1, description="rounds between two scores on the runs held out")
    averaged: int = Field(default=8, ge=1, description="latest rounds whose parameters are averaged for a score")
    revisited: int = Field(default=16, ge=1, description="one in so many runs of a round has failed before, if any")
    damping: float = Field(default=0.7, gt=0, le=1, description="share of a wished move that is aimed at, in round 0")
    damping_end: float = Field(default=0.3, ge=0, le=1, description="share of that damping left in the end (linear)")
    effort_end: float = Field(default=0.2, gt=0, le=1, description="share of the work of a fit left in the end (root)")
    Np: Pair = Field(default=(10.0, 60.0), description="periods, bounds of what is learned")
    Nc: Pair = Field(default=(1.0, 20.0), description="periods, bounds of what is learned")
    R: Pair = Field(default=(10.0, 1e6), description="1/rad^2, bounds of what is learned; Q is 1 per m^2")

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """(low, high) of the slots that are learned."""
        return {"Np": self.Np, "Nc": self.Nc, "R": self.R}

    @property
    def limits(self) -> Array:
        """(3, 2) low and high of Np, Nc and log10 R/Q."""
        return np.array([self.Np, self.Nc, np.log10(self.R)])


class NeuralSurface(Record):
    """The networks that learn."""

    hidden: Wholes = Field(default=(16, 8), description="neurons of each hidden layer")
    epochs: int = Field(default=100, ge=1, description="of Adam, in a round")
    rate: float = Field(default=0.01, gt=0, description="learning rate of Adam in the first epoch")


class NeuroFuzzySurface(Record):
    """The fuzzy systems that learn; their rules lie at the centres of clusters of the inputs."""

    rows: int = Field(default=6000, ge=100, description="inputs that are clustered")
    stride: int = Field(default=40, ge=1, description="periods between two of them in a run")
    restarts: int = Field(default=2, ge=1, description="of k-means")
    neighbours: int = Field(default=3, ge=1, description="rules whose mean distance gives a rule its width")
    width: float = Field(default=0.7, gt=0, description="of a rule, in that distance")
    hold: float = Field(default=0.02, gt=0, description="weight of a change of the consequents, relative to the data")


class Constants(Record):
    """The search for constant tunings, and the choice of the fallback."""

    start: Annotated[tuple[int, int, float, float], BeforeValidator(_tuples)] = Field(
        default=(29, 5, 1.0, 4000.0), description="Np, Nc, Q, R that is tried first; what the MPC begins with"
    )
    evaluations: int = Field(default=300, ge=20, description="tunings that the swarm tries")
    runs: int = Field(default=512, ge=1, description="that each of them drives")
    Np: Pair = Field(default=(10.0, 60.0), description="periods, bounds of the search")
    Nc: Pair = Field(default=(1.0, 18.0), description="periods, bounds of the search")
    R: Pair = Field(default=(10.0, 1e6), description="1/rad^2, bounds of the search; Q is 1 per m^2")
    fallback_margin: float = Field(default=0.1, gt=0, lt=1, description="least modulus margin of the fallback anywhere")
    fallback_ratio: float = Field(default=2.0, description="least log10 R/Q of the fallback")
    fallback_drives: int = Field(default=128, ge=1, description="hard drives on which candidates are first judged")
    fallback_kept: int = Field(default=16, ge=1, description="candidates that are then judged on all hard drives")
    fallback_failures: int = Field(default=1, ge=0, description="more failures than the fewest that are tolerated")

    @property
    def tuning(self) -> Tuning:
        """What the MPC begins with."""
        return Tuning(*self.start)


class LookUps(Record):
    """The look-up tables: at a node the tuning with the lowest mean log cost over the nearest operating points."""

    speed: int = Field(default=10, ge=2, description="nodes along the speed")
    y_ref: int = Field(default=7, ge=2, description="nodes along the lateral reference")
    friction: int = Field(default=5, ge=2, description="nodes along the friction")
    wind: int = Field(default=5, ge=2, description="nodes along the wind")
    neighbours: int = Field(default=12, ge=1, description="operating points averaged at a node, in four dimensions")
    speed_neighbours: int = Field(default=320, ge=1, description="and in one")


class PaperRecipe(Record):
    """Regression on the swarms' best tunings, as in the paper."""

    holdout: float = Field(default=0.2, gt=0, lt=1, description="share of the operating points held out")
    seed: int = Field(default=0, ge=0, description="of the hold-out and of the models")
    nn_epochs: int = Field(default=1000, ge=1, description="of a network")
    anfis_epochs: int = Field(default=50, ge=1, description="of a fuzzy system")


class Guarding(Record):
    """What stands between a learned schedule and the MPC."""

    margin: float = Field(default=0.05, gt=0, lt=1, description="least modulus margin of the straight-line loop")
    slow: float = Field(default=6.0, ge=0, description="m/s, below which the map is made more careful")
    slow_margin: float = Field(default=0.05, ge=0, lt=1, description="by so much of the modulus margin")
    slack: float = Field(default=1.0, ge=0, description="how far outside its domain an input may be, in its widths")
    offset_limit: float = Field(default=0.065, gt=0, description="s^2, largest |offset| over friction times g")
    hold: int = Field(default=30, ge=1, description="periods that a fallback lasts")
    rates: Triple = Field(default=(5.0, 2.0, 0.3), description="largest change of Np, Nc, log10 R/Q in a period")


class Method(Record):
    """How an adaptation learns; part of its configuration, and of the identity of each of its stages."""

    seeds: Seeds = Field(default_factory=Seeds, description="first random numbers")
    runs: Runs = Field(default_factory=Runs, description="to learn from, and held out")
    landscape: Landscape = Field(default_factory=Landscape, description="from costs to wished moves")
    improvement: ImprovementSettings = Field(
        default_factory=ImprovementSettings, description="from wished moves to outputs"
    )
    network: NeuralSurface = Field(default_factory=NeuralSurface, description="networks")
    fuzzy: NeuroFuzzySurface = Field(default_factory=NeuroFuzzySurface, description="fuzzy systems")
    constants: Constants = Field(default_factory=Constants, description="constants and the fallback")
    look_up: LookUps = Field(default_factory=LookUps, description="look-up tables")
    recipe: PaperRecipe = Field(default_factory=PaperRecipe, description="the paper's recipe")
    guard: Guarding = Field(default_factory=Guarding, description="of the learned schedules")
