"""The constant tuning of the informed controller for a car: a search on random drives, unseen drives, a certificate."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.certify import Certificate, certify
from adaptrack.analysis.feasibility import Feasibility, feasibility
from adaptrack.analysis.stability import linear_twin
from adaptrack.base.checked import checked, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.base.statistics import Ratio, geometric_mean, ratio
from adaptrack.cars.domain import Domain
from adaptrack.cars.plant import Plant, SteppedPlant, get_plant, twin_of
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import ENTRIES, MPC, Tuning
from adaptrack.control.controllers.belief import Uncertainty
from adaptrack.control.kalman import KalmanFilter
from adaptrack.drive.failure import Failure
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.pso import Swarm, SwarmSettings
from adaptrack.tuning.runs import RunSet, random_drive_runs
from adaptrack.tuning.spaces import SearchBounds

Array = NDArray[np.float64]
_log = logging.getLogger("adaptrack")

FIRST_SOUGHT, FIRST_JUDGED = 13_000_000, 13_500_000
"""Numbers of the first random drive of the search and of the judgement: nothing else has them."""
NOISE_SOUGHT, NOISE_JUDGED = 5_001, 5_002
HARD_SPEEDS, HARD_DEMAND = 0.57, (0.2, 0.35)
"""Share of the range of speeds above which hard drives are; share of the grip that their roads ask for."""


@checked
@dataclass(frozen=True)
class TuningEffort:
    """How much a search may cost.

    Raises
    ------
    InvalidInput
        When a number is no whole one, or too small.
    """

    drives: int = 16
    """of the search, mixed ones"""
    hard_drives: int = 8
    """of the search, fast ones near the grip"""
    seconds: float = 30.0
    """of each of these"""
    swarm: SwarmSettings = field(default_factory=lambda: SwarmSettings(particles=12, generations=8))
    judged_drives: int = 48
    """drives of 60 s that nothing was sought on"""
    levels: tuple[int, int] = (14, 3)
    """of speed and friction, of the certificate"""

    def __post_init__(self) -> None:
        for name, least in (("drives", 1), ("hard_drives", 1), ("judged_drives", 4)):
            whole_number("TuningEffort", name, getattr(self, name), least=least)


@dataclass(frozen=True, eq=False)
class TunedCar:
    """The constant tuning of a car."""

    controller: MPC
    """with the tuning that is kept, ready to drive"""
    profile: Profile
    domain: Domain
    """the car's, less the speeds and frictions that nothing holds"""
    feasibility: Feasibility
    default: Tuning
    """of the controller, before"""
    sought: Tuning
    """the best of the search"""
    costs: dict[str, Array]
    """(runs,) m^2, J of each unseen drive with "default" and "sought"; infinite where it failed"""
    gain: Ratio
    """J sought over J default, drive by drive, failed ones counting the square of the failure distance"""
    certificate: Certificate
    """of the tuning that is kept, over the domain; of a plant without a linear model, see `stability.linear_twin`"""
    plant: str
    """name of the driven plant"""
    costly: bool
    """whether only the unseen drives were on the plant, see `Plant.costly`"""
    seconds: float

    @property
    def tuning(self) -> Tuning:
        """The one that is kept: that of the search where it is better for sure, else the default."""
        return self.controller.tuning

    @property
    def failed(self) -> int:
        """Unseen drives that failed with the tuning that is kept."""
        return int(np.isinf(self.costs["sought" if self.tuning is self.sought else "default"]).sum())

    @property
    def passed(self) -> bool:
        """Whether no unseen drive failed and the certificate finds the loop stable."""
        return self.failed == 0 and self.certificate.passed

    @property
    def headline(self) -> str:
        """The chosen tuning, the cost of the best of the search over the default's, and the failed drives."""
        entries = f"Np {self.tuning.Np}, Nc {self.tuning.Nc}, R/Q {self.tuning.R / self.tuning.Q:.4g}"
        gain = f"{self.gain.mean:.3g} [{self.gain.low:.3g}, {self.gain.high:.3g}]"
        drives = f"{self.failed} of {len(self.costs['default'])} unseen drives failed"
        return f"{entries}; the searched tuning costs {gain} times the default; {drives}."

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        worst = self.controller.model.vehicle.domain.failure_distance**2
        return {
            "verdict": self.headline,
            "feasible": self.feasibility.verdict,
            "certificate": self.certificate.verdict,
            "passed": self.passed,
            "profile": self.profile.name,
            "plant": self.plant,
            "belief": self.controller.belief_at_first,
            "domain": self.domain.model_dump(mode="json"),
            "tuning": _entries(self.tuning),
            "default": _entries(self.default),
            "sought": _entries(self.sought),
            "gain": self.gain._asdict(),
            "drives": len(self.costs["default"]),
            "failed": {name: int(np.isinf(drives).sum()) for name, drives in self.costs.items()},
            "cost": {name: geometric_mean(np.minimum(drives, worst)) for name, drives in self.costs.items()},
            "seconds": self.seconds,
        }

    def __repr__(self) -> str:
        return f"<TunedCar: {self.headline}>"


def _entries(tuning: Tuning) -> dict[str, float]:
    return dict(zip(ENTRIES, tuning.as_array().tolist(), strict=True))


@reports_progress("tune")
@checked
def tune(
    car: Vehicle | str, profile: str | Profile = "road", *, plant: Plant | SteppedPlant | str | None = None,
    speed: tuple[float, float] | None = None, friction: tuple[float, float] | None = None,
    uncertainty: Uncertainty | None = None, estimator: KalmanFilter | None = None, effort: TuningEffort | None = None,
    seed: int = 0, progress: ProgressCall | None = None,
) -> TunedCar:  # fmt: skip
    """The constant tuning with which the controller that knows its car drives it best, checked.

    First which speeds and frictions any tuning holds at all, by the linear loops; then one swarm on random drives of
    the domain that is left; then unseen drives, on which the default is kept unless it is beaten for sure (95 %); then
    the certificate of what is kept. The linear loops take late samples as prompt; the drives do not.

    Parameters
    ----------
    car
        What the controller believes, or its name or file for `load_vehicle`; its domain says where it is driven.
    profile
        The world: steering actuator, sensors, period.
    plant
        What is driven, or its registered name; by default the car as a dual track. Where it is `costly`
        (`Plant.costly`) the search is on the car's twin, the unseen drives are on the plant. One that is stepped in
        Python is driven run by run: how long that takes is logged first.
    speed, friction
        Lowest and highest, m/s and without a unit: instead of the domain's.
    uncertainty, estimator
        As for `MPC`.
    effort
        How much to spend; the default takes about 20 s on two cores.
    seed
        Of the search, and which drives.

    Raises
    ------
    InvalidInput
        When no tuning holds the loop anywhere in the domain, or a range makes no sense.
    UnknownName
        When no car or plant has this name.
    """
    began, show = time.perf_counter(), progress or (lambda work, steps, of: None)
    effort = effort or TuningEffort()
    seed = whole_number("tune", "seed", seed, least=0)
    car, driven_plant = _car_and_plant(car, plant)
    world = load_profile(profile)
    mpc = MPC(car, profile=world, uncertainty=uncertainty, estimator=estimator)
    limits = {name: limit for name, limit in (("speed", speed), ("friction", friction)) if limit is not None}
    requested = Domain(**{**car.domain.model_dump(), **limits})
    show("which speeds can be held", 0, 1)
    linear = linear_twin(driven_plant, car, requested)
    holdable = feasibility(linear, mpc, world.prompt, speed=requested.speed, friction=requested.friction, turn=None)
    if holdable.constant is None:
        raise InvalidInput(f"tune: {holdable.verdict}")
    constant, holdable_domain = holdable.constant
    domain = requested.replace(**holdable_domain._asdict()) if holdable_domain != holdable.requested else requested
    default = mpc.tuning
    bench = _Bench(driven_plant, mpc, world, domain)
    runs = _search_runs(bench.on_twin(), effort, seed)
    bench.warn_of_time(effort)
    searched = _search_tuning(runs, [default, constant], effort.swarm, seed, show)
    show("unseen drives", 0, 1)
    numbers = range(FIRST_JUDGED + 1000 * seed, FIRST_JUDGED + 1000 * seed + effort.judged_drives)
    unseen = bench.drives(numbers, 60.0)
    costs = {"default": unseen.drive(default, [NOISE_JUDGED])[:, 0]}
    costs["sought"] = costs["default"] if searched == default else unseen.drive(searched, [NOISE_JUDGED])[:, 0]
    bounded = {name: np.minimum(drives, unseen.failed_cost) for name, drives in costs.items()}
    gain = ratio(bounded["sought"], bounded["default"])
    failures = {name: int(np.isinf(drives).sum()) for name, drives in costs.items()}
    tuning = searched if gain.high < 1.0 and failures["sought"] <= failures["default"] else default
    certificate = certify(
        tuning, linear, mpc, world.prompt, domain={"speed": domain.speed, "friction": domain.friction},
        levels=effort.levels, progress=show,
    )  # fmt: skip
    controller = MPC(car, profile=world, uncertainty=uncertainty, estimator=estimator, tuning=tuning)
    seconds = time.perf_counter() - began
    return TunedCar(
        controller, world, domain, holdable, default, searched, costs, gain, certificate, driven_plant.name,
        driven_plant.costly, seconds,
    )  # fmt: skip


def _car_and_plant(
    car: Vehicle | str, plant: Plant | SteppedPlant | str | None
) -> tuple[Vehicle, Plant | SteppedPlant]:
    """The car that the controller believes in, and what is driven."""
    believed = car if isinstance(car, Vehicle) else load_vehicle(car)
    driven_plant = "dual-track" if plant is None else plant
    return believed, get_plant(driven_plant, believed) if isinstance(driven_plant, str) else driven_plant


@dataclass(frozen=True, eq=False)
class _Bench:
    """Plant, controller, profile and domain of the drives."""

    plant: Plant | SteppedPlant
    mpc: MPC
    world: Profile
    domain: Domain

    def drives(self, numbers: range, seconds: float, **roads: Any) -> RunSet:
        """Random drives in the domain, of so many seconds; roads: other options of `random_drive`."""
        failure = Failure(distance=self.domain.failure_distance)
        return random_drive_runs(
            self.plant, self.mpc, numbers, seconds, self.world, roads=self.domain.drive_options | roads, failure=failure
        )

    def on_twin(self) -> _Bench:
        """Return the bench for a search: with the car's twin if the plant is costly."""
        car = self.mpc.model.vehicle
        return replace(self, plant=twin_of(car)) if self.plant.costly else self

    def warn_of_time(self, effort: TuningEffort) -> None:
        """Log how long the drives of a stepped plant will take, from a short one."""
        if not isinstance(self.plant, SteppedPlant):
            return
        seconds = min(5.0, effort.seconds)
        runs, began = self.drives(range(FIRST_SOUGHT, FIRST_SOUGHT + 1), seconds), time.perf_counter()
        runs.drive(self.mpc.tuning, [NOISE_SOUGHT])
        per_second = (time.perf_counter() - began) / seconds
        tunings = 0 if self.plant.costly else effort.swarm.particles * effort.swarm.generations + 2
        simulated = tunings * (effort.drives + effort.hard_drives) * effort.seconds + 2 * effort.judged_drives * 60.0
        _log.warning(
            "adaptrack: plant %r is stepped in Python: %.3g h of driving one after the other, about %.2g min.",
            self.plant.name, simulated / 3600.0, simulated * per_second / 60.0,
        )  # fmt: skip


def _search_runs(bench: _Bench, effort: TuningEffort, seed: int) -> list[RunSet]:
    """Mixed drives and hard ones."""
    first = FIRST_SOUGHT + 1000 * seed
    slow, fast = bench.domain.speed
    hard_speeds = (slow + HARD_SPEEDS * (fast - slow), fast)
    hard = range(first + 500, first + 500 + effort.hard_drives)
    return [
        bench.drives(range(first, first + effort.drives), effort.seconds),
        bench.drives(hard, effort.seconds, speed=hard_speeds, demand=HARD_DEMAND),
    ]


def _search_tuning(
    training: list[RunSet], candidates: list[Tuning], swarm: SwarmSettings, seed: int, show: ProgressCall
) -> Tuning:
    """The tuning with the lowest mean log cost over the run sets: found about the first candidate, or a candidate."""
    default = candidates[0]
    search = Swarm(SearchBounds.around(default).space(), swarm, seed=seed)

    def costs(tunings: Array) -> Array:
        total = np.zeros(len(tunings))
        for runs in training:
            indices = np.tile(np.arange(len(runs)), len(tunings))
            values = runs.costs(np.repeat(tunings, len(runs), axis=0), [NOISE_SOUGHT], indices)
            total += np.log(values).reshape(len(tunings), len(runs)).mean(axis=1)
        return total

    while not search.is_done:
        show("search", search.generation, search.settings.generations)
        search.tell(costs(search.ask()))
    best, rows = search.result(), np.array([tuning.as_array() for tuning in candidates])
    candidate_costs = costs(rows)
    if candidate_costs.min() <= best.cost:
        return candidates[int(candidate_costs.argmin())]
    Np, Nc, Q, R = best.x.tolist()
    return replace(default, Np=round(Np), Nc=round(Nc), Q=Q, R=float(f"{R:.6g}"))
