"""Constant tuning of the informed controller for a car: search on random drives, test on unseen drives, certificate.

A constant tuning is one set of Np, Nc, Q and R for the whole domain of the car, in contrast to a scheduler.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from adaptrack.analysis.certify import Certificate, certify
from adaptrack.analysis.feasibility import Feasibility, feasibility
from adaptrack.analysis.stability import linear_twin
from adaptrack.base.checked import checked, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.base.statistics import Ratio, geometric_mean, ratio
from adaptrack.cars.plant import Plant, SteppedPlant, get_plant, twin_of
from adaptrack.cars.vehicle import Domain, Vehicle, load_vehicle
from adaptrack.control.controllers import ENTRIES, MPC, Tuning
from adaptrack.control.controllers.belief import Uncertainty
from adaptrack.control.kalman import KalmanFilter
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.drive.failure import FailureLimits
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.pso import SearchBounds, Swarm, SwarmSettings
from adaptrack.tuning.runs import RunSet, random_drive_runs

_log = logging.getLogger("adaptrack")

FIRST_SEARCH_DRIVE, FIRST_UNSEEN_DRIVE = 13_000_000, 13_500_000
"""Numbers of the first random drives of the search and of the test. No other random drives have these numbers."""
SEARCH_NOISE_SEED, UNSEEN_NOISE_SEED = 5_001, 5_002
"""Noise seeds of the search and of the test."""
HARD_SPEED_START = 0.57
"""Hard drives have speeds above this position in the speed range (0: lowest, 1: highest speed)."""
HARD_DEMAND = (0.2, 0.35)
"""Lowest and highest share of the grip that hard drives need."""


@checked
@dataclass(frozen=True)
class TuningEffort:
    """Computing effort of `tune`: numbers of drives, tunings and points.

    Raises
    ------
    InvalidInput
        When a number is not whole, or too small.
    """

    drives: int = 16
    """Number of search drives at all speeds of the domain."""
    hard_drives: int = 8
    """Number of search drives at high speed near the grip limit."""
    seconds: float = 30.0
    """Duration of each search drive (s)."""
    swarm: SwarmSettings = field(default_factory=lambda: SwarmSettings(particles=12, generations=8))
    """Settings of the swarm that searches."""
    unseen_drives: int = 48
    """Number of unseen drives of 60 s, which test the result of the search."""
    levels: tuple[int, int] = (14, 3)
    """Number of speeds and of frictions at which the certificate is computed."""

    def __post_init__(self) -> None:
        for name, least in (("drives", 1), ("hard_drives", 1), ("unseen_drives", 4)):
            whole_number("TuningEffort", name, getattr(self, name), least=least)


@dataclass(frozen=True, eq=False)
class TunedCar:
    """Result of `tune`: the constant tuning of a car with its tests."""

    controller: MPC
    """Controller with the selected tuning, ready to drive."""
    profile: Profile
    domain: Domain
    """Domain of the car without the infeasible speeds and frictions."""
    feasibility: Feasibility
    """Speeds and frictions at which at least one tuning is stable."""
    default: Tuning
    """Default tuning of the controller."""
    candidate: Tuning
    """Best tuning that the search found."""
    costs: dict[str, Array]
    """J (m^2) of each unseen drive, (drives,), with the tunings "default" and "candidate"; infinite after a failure."""
    gain: Ratio
    """Cost ratio on the same drives: J of the best tuning divided by J of the default; below 1 it is better.
    J of a failed drive is the failure distance squared."""
    certificate: Certificate
    """Certificate of the selected tuning over the domain, for the plant of `stability.linear_twin`."""
    plant: str
    """Name of the simulated plant."""
    costly: bool
    """Whether simulating the plant is expensive (`Plant.costly`). The search then used the dual track of the car."""
    seconds: float
    """Computation time (s)."""

    @property
    def tuning(self) -> Tuning:
        """The selected tuning: that of the search if it is better with 95 % confidence, otherwise the default."""
        return self.controller.tuning

    @property
    def failed(self) -> int:
        """The number of unseen drives that failed with the selected tuning."""
        return int(np.isinf(self.costs["candidate" if self.tuning is self.candidate else "default"]).sum())

    @property
    def passed(self) -> bool:
        """Whether no unseen drive failed and the certificate finds the loop stable."""
        return self.failed == 0 and self.certificate.passed

    @property
    def headline(self) -> str:
        """A sentence with the selected tuning, the cost ratio of the search and the number of failed drives."""
        entries = f"Np {self.tuning.Np}, Nc {self.tuning.Nc}, R/Q {self.tuning.R / self.tuning.Q:.4g}"
        gain = f"{self.gain.mean:.3g} [{self.gain.low:.3g}, {self.gain.high:.3g}]"
        drives = f"{self.failed} of {len(self.costs['default'])} unseen drives failed"
        return f"{entries}; the searched tuning costs {gain} times the default; {drives}."

    def summary(self) -> dict[str, Any]:
        """Return the result as a mapping that JSON can represent."""
        worst = portable.square(self.controller.model.vehicle.domain.failure_distance)
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
            "candidate": _entries(self.candidate),
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
    """Find the best constant tuning of the informed controller for a car.

    The function has four steps:

    1. Linear loops show at which speeds and frictions at least one tuning is stable. The domain is reduced to these.
    2. A swarm searches the tuning with the lowest cost on random drives in this domain.
    3. Default and best tuning are compared on unseen drives. The best tuning is selected if its cost is lower with
       95 % confidence and it fails no more often, otherwise the default.
    4. The selected tuning gets a certificate over the domain.

    The drives include the sensor delays of the profile; the linear loops of steps 1 and 4 do not.

    Parameters
    ----------
    car
        Car as the controller assumes it, or its name or file for `load_vehicle`. Its domain is the range of drives.
    profile
        Steering actuator, sensors and control period, or the name of a profile.
    plant
        Simulated plant, or its registered name; by default the dual track of the car. If simulating it is expensive
        (`Plant.costly`), the search uses the car's dual track (`twin_of`); only the unseen drives use the plant. A
        plant that is stepped in Python is driven one run at a time; the expected time is logged before the search.
    speed, friction
        Lowest and highest speed (m/s) and friction coefficient, instead of those of the car's domain.
    uncertainty, estimator
        As for `MPC`.
    effort
        Numbers of drives and tunings; the default takes about 20 s on two cores.
    seed
        Seed of the swarm, which also selects the random drives.
    progress
        Function that receives (stage, steps done, steps in all).

    Returns
    -------
    TunedCar
        The controller with its tuning, the tests and the certificate.

    Raises
    ------
    InvalidInput
        When no tuning is stable anywhere in the domain, or for an invalid range.
    UnknownName
        For an unknown car or plant.
    """
    start_time, report = time.perf_counter(), progress or (lambda stage, steps_done, steps: None)
    effort = effort or TuningEffort()
    seed = whole_number("tune", "seed", seed, least=0)
    car = car if isinstance(car, Vehicle) else load_vehicle(car)
    plant = "dual-track" if plant is None else plant
    simulated_plant = get_plant(plant, car) if isinstance(plant, str) else plant
    profile = load_profile(profile)
    mpc = MPC(car, profile=profile, uncertainty=uncertainty, estimator=estimator)
    limits = {name: limit for name, limit in (("speed", speed), ("friction", friction)) if limit is not None}
    requested = Domain(**{**car.domain.model_dump(), **limits})
    report("feasible speeds", 0, 1)
    linear = linear_twin(simulated_plant, car, requested)
    without_delay = profile.without_sample_ages
    feasible = feasibility(linear, mpc, without_delay, speed=requested.speed, friction=requested.friction, turn=None)
    if feasible.constant is None:
        raise InvalidInput(f"tune: {feasible.verdict}")
    feasible_tuning, feasible_domain = feasible.constant
    domain = requested.replace(**feasible_domain._asdict()) if feasible_domain != feasible.requested else requested
    default = mpc.tuning
    bench = _Bench(simulated_plant, mpc, profile, domain)
    cheap = replace(bench, plant=twin_of(car)) if simulated_plant.costly else bench
    runs = _search_runs(cheap, effort, seed)
    bench.warn_of_time(effort)
    best = _search_tuning(runs, [default, feasible_tuning], effort.swarm, seed, report)
    report("unseen drives", 0, 1)
    numbers = range(FIRST_UNSEEN_DRIVE + 1000 * seed, FIRST_UNSEEN_DRIVE + 1000 * seed + effort.unseen_drives)
    unseen = bench.drives(numbers, 60.0)
    costs = {"default": unseen.drive(default, [UNSEEN_NOISE_SEED])[:, 0]}
    costs["candidate"] = costs["default"] if best == default else unseen.drive(best, [UNSEEN_NOISE_SEED])[:, 0]
    bounded = {name: np.minimum(drives, unseen.failed_cost) for name, drives in costs.items()}
    gain = ratio(bounded["candidate"], bounded["default"])
    failures = {name: int(np.isinf(drives).sum()) for name, drives in costs.items()}
    tuning = best if gain.high < 1.0 and failures["candidate"] <= failures["default"] else default
    certificate = certify(
        tuning, linear, mpc, without_delay, domain={"speed": domain.speed, "friction": domain.friction},
        levels=effort.levels, progress=report,
    )  # fmt: skip
    controller = MPC(car, profile=profile, uncertainty=uncertainty, estimator=estimator, tuning=tuning)
    seconds = time.perf_counter() - start_time
    return TunedCar(
        controller, profile, domain, feasible, default, best, costs, gain, certificate, simulated_plant.name,
        simulated_plant.costly, seconds,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Bench:
    """Plant, controller, profile and domain of the drives."""

    plant: Plant | SteppedPlant
    mpc: MPC
    profile: Profile
    domain: Domain

    def drives(self, numbers: range, seconds: float, **options: Any) -> RunSet:
        """Return random drives in the domain with a duration in seconds; options: further ones of `random_drive`."""
        failure, options = FailureLimits(distance=self.domain.failure_distance), self.domain.drive_options | options
        return random_drive_runs(
            self.plant, self.mpc, numbers, seconds, self.profile, drive_options=options, failure=failure
        )

    def warn_of_time(self, effort: TuningEffort) -> None:
        """Log the expected time of all drives with a plant that is stepped in Python, after timing a short drive."""
        if not isinstance(self.plant, SteppedPlant):
            return
        seconds = min(5.0, effort.seconds)
        runs = self.drives(range(FIRST_SEARCH_DRIVE, FIRST_SEARCH_DRIVE + 1), seconds)
        start_time = time.perf_counter()
        runs.drive(self.mpc.tuning, [SEARCH_NOISE_SEED])
        per_second = (time.perf_counter() - start_time) / seconds
        tunings = 0 if self.plant.costly else effort.swarm.particles * effort.swarm.generations + 2
        simulated = tunings * (effort.drives + effort.hard_drives) * effort.seconds + 2 * effort.unseen_drives * 60.0
        _log.warning(
            "adaptrack: plant %r is stepped in Python, one run at a time: %.3g h of driving take about %.2g min.",
            self.plant.name, simulated / 3600.0, simulated * per_second / 60.0,
        )  # fmt: skip


def _search_runs(bench: _Bench, effort: TuningEffort, seed: int) -> list[RunSet]:
    """Return the drives of the search: at all speeds of the domain, and hard ones at high speed."""
    first = FIRST_SEARCH_DRIVE + 1000 * seed
    slow, fast = bench.domain.speed
    hard_speeds = (slow + HARD_SPEED_START * (fast - slow), fast)
    hard = range(first + 500, first + 500 + effort.hard_drives)
    return [
        bench.drives(range(first, first + effort.drives), effort.seconds),
        bench.drives(hard, effort.seconds, speed=hard_speeds, demand=HARD_DEMAND),
    ]


def _search_tuning(
    training: list[RunSet], candidates: list[Tuning], swarm: SwarmSettings, seed: int, report: ProgressCall
) -> Tuning:
    """Return the tuning with the lowest mean log cost over the run sets.

    The swarm searches around the first candidate; the candidates themselves are compared with its result.
    """
    default = candidates[0]
    search = Swarm(SearchBounds.around(default).space(), swarm, seed=seed)

    def costs(tunings: Array) -> Array:
        logs = [portable.log(runs.costs_of(tunings, [SEARCH_NOISE_SEED])).mean(axis=1) for runs in training]
        return np.sum(logs, axis=0)

    best, rows = search.run(costs, partial(report, "search")), np.array([tuning.as_array() for tuning in candidates])
    candidate_costs = costs(rows)
    if candidate_costs.min() <= best.cost:
        return candidates[int(candidate_costs.argmin())]
    *entries, R = best.x.tolist()
    return Tuning.of((*entries, float(f"{R:.6g}")))
