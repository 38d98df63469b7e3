"""How well the speed control follows a plan and stops, behind drive and brakes that it does not know.

    python benchmarks/longitudinal.py [--cars 200] [--driver control|naive|autoware] [--smooth-plan] [--seed 20261126]
    python benchmarks/longitudinal.py --noise-station 0.2 --pose-period 0.1 --speed-scale 1.02    worse sensors

Each car draws lag (to 0.6 s), dead time (to 0.4 s) and gain (0.85 to 1.1) of drive and of brakes, a mass of 0.85 to 1.4
times the one in its file, and a slope of -10 to 10 % from 300 m on, all from the seed. It drives 900 m at up to
15 m/s with stops at 250 and 600 m. --driver: the speed control, the naive driver of the simulation, or Autoware's
structure with its published parameters (the plug-in `autoware_speed` in examples/plugins/, in PYTHONPATH).
--smooth-plan: 1 m/s^2 and 1 m/s^3 at most, as Autoware's planner has it, instead of 1.5 and 2 m/s^2 without a limit of
jerk. The last lines compare what the speed control has learned with the truth.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from adaptrack import MPC, DualTrack, RoadDrive, SpeedControl, load_profile, load_vehicle, simulate
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.control.speed_control import SpeedCommand, SpeedController
from adaptrack.drive.world import Driver
from adaptrack.road import Comfort, Line, Road, SpeedPlan, Stop, plan_speed

STOPS = (250.0, 600.0)
CAR = load_vehicle("midsize-sedan")
SETTLED = 20.0
"""s, after which the error of the speed counts."""
INTERVAL = 1.645
"""Standard deviations to each side, in which 90 % of a normal distribution lie."""


@dataclass
class Sensors:
    """Measured position and speed of the speed control, beyond the profile."""

    pose_period: int
    """control periods between two positions; between them the last one is carried forward with the measured speed"""
    speed_scale: float
    """measured speed over the true one"""


class SensedController(SpeedController):
    """A speed control behind sensors; it records its estimates of the position along the road (m)."""

    sensors = Sensors(1, 1.0)

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.stations: list[float] = []
        self._measured = np.nan

    def step(self, station: float, speed: float, yaw_rate: float, **options: Any) -> SpeedCommand:
        """Return the requests for the present period, see `SpeedController.step`."""
        speed *= self.sensors.speed_scale
        is_new = len(self.stations) % self.sensors.pose_period == 0
        self._measured = station if is_new else self._measured + speed * self._period
        command = super().step(self._measured, speed, yaw_rate, **options)
        self.stations.append(float(self.record.memory[0].station))
        return command


class SensedControl:
    """Driver of a simulation: a speed control that knows nothing, behind `Sensors`."""

    def __init__(self, car: Any, sensors: Sensors) -> None:
        self._control, self._sensors = SpeedControl(car), sensors
        self.controller: SensedController | None = None

    def begin(self, path: Road, plan: SpeedPlan, period: float) -> SensedController:
        """Begin a run."""
        self.controller = SensedController(self._control, path, plan, period)
        self.controller.sensors = self._sensors
        return self.controller


DRIVERS = {
    "control": (SensedControl, "speed control, nothing known"), "naive": (lambda car, _: Driver(), "naive driver"),
    "autoware": (
        lambda car, _: import_module("autoware_speed").AutowareSpeed(car), "Autoware's structure, as published",
    ),
}  # fmt: skip
"""Factories that take the car of the file and its sensors, and what the table calls them."""


class Stopped(NamedTuple):
    """A stop."""

    error: float
    """m, of the true place"""
    estimate_error: float
    """m, of the estimated place, which the pose does not share"""
    jerk: float
    """m/s^3, largest in the last metre"""
    rolled_back: float
    """m"""


class Learned(NamedTuple):
    """What a speed control has learned at the end of a run, against the truth."""

    name: str
    error: float
    sigma: float


class Drive(NamedTuple):
    """A drive: RMS error of the speed (m/s), stops, and what was learned."""

    speed_error: float
    stops: list[Stopped]
    learned: list[Learned]


def drive_one(rng: np.random.Generator, seed: int, driver: Any, profile: Any, is_smooth: bool) -> Drive:
    """Drive one car."""
    delays = [{"lag": rng.uniform(0.0, 0.6), "dead_time": rng.uniform(0.0, 0.4), "gain": rng.uniform(0.85, 1.1)}
              for _ in range(2)]  # fmt: skip
    mass, grade = rng.uniform(0.85, 1.4), rng.uniform(-0.1, 0.1)
    road = Road.from_segments([Line(length=900.0)], name="straight")
    road = road.replace(grade=([0.0, 300.0, 320.0, 900.0], [0.0, 0.0, grade, grade]))
    comfort = Comfort(accelerate=1.0, brake=1.0, jerk=1.0) if is_smooth else Comfort(accelerate=1.5, brake=2.0)
    plan = plan_speed(road, CAR, comfort, stops=[Stop(s, 3.0) for s in STOPS], top_speed=15.0)
    car = CAR.replace(
        mass=CAR.mass * mass, yaw_inertia=CAR.yaw_inertia * mass, drive=DriveActuator(**delays[0]),
        brakes=BrakeActuator(**delays[1]),
    )  # fmt: skip
    run = simulate(
        DualTrack(car), MPC(CAR, profile=profile), RoadDrive(road, plan), profile=profile, driver=driver, seed=seed
    )
    s, speed, jerk = run.road["station"], run.vx, np.zeros(run.vx.size)
    mean_acceleration = (speed[4:] - speed[:-4]) / (4 * run.period)  # over 0.2 s
    jerk[4:-4] = np.abs(mean_acceleration[4:] - mean_acceleration[:-4]) / (4 * run.period)
    planned = plan.at(s)
    counted = (run.t > SETTLED) & (planned > 1.0)
    controller = getattr(driver, "controller", None)
    estimate = s if controller is None else np.array(controller.stations)
    stops = []
    for stop in STOPS:
        stands = np.flatnonzero((speed < 0.01) & (np.abs(s - stop) < 8.0))
        if not stands.size:
            stops.append(Stopped(np.inf, np.inf, np.inf, 0.0))
            continue
        last_metre = (s > stop - 1.0) & (np.arange(s.size) < stands[0])
        stops.append(
            Stopped(
                float(s[stands[0]] - stop), float(estimate[stands[0]] - stop), float(jerk[last_metre].max(initial=0.0)),
                float(s[stands[0]] - s[stands[0] :].min()),
            )
        )  # fmt: skip
    learned = []
    for name, truth in zip(("drive", "brakes"), delays, strict=True) if controller is not None else ():
        belief = controller.learned[name]
        delay_error = belief.lag + belief.dead_time - truth["lag"] - truth["dead_time"]
        learned.append(Learned(f"{name}, lag and dead time (s)", delay_error, belief.delay_sigma))
        learned.append(Learned(f"{name}, gain over mass (-)", belief.ratio - truth["gain"] / mass, belief.ratio_sigma))
    return Drive(float(np.sqrt(np.mean((speed - planned)[counted] ** 2))), stops, learned)


def print_learned(learned: list[Learned]) -> None:
    """Print how many 90 % intervals hold the truth."""
    for name in dict.fromkeys(belief.name for belief in learned):
        errors, sigmas = np.array([(belief.error, belief.sigma) for belief in learned if belief.name == name]).T
        print(f"{name}: 90 % interval holds in {100 * np.mean(np.abs(errors) <= INTERVAL * sigmas):.0f} %, "
              f"RMS error {np.sqrt(np.mean(errors**2)):.3f}, mean sigma {sigmas.mean():.3f}")  # fmt: skip


def main() -> None:
    """Drive the cars and print quantiles."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cars", type=int, default=200)
    parser.add_argument("--driver", choices=list(DRIVERS), default="control")
    parser.add_argument("--smooth-plan", action="store_true", help="1 m/s^2 and 1 m/s^3 at most")
    parser.add_argument("--seed", type=int, default=20261126)
    parser.add_argument("--profile", default="road")
    parser.add_argument("--noise-station", type=float, help="m, standard deviation of each position along the road")
    parser.add_argument("--pose-period", type=float, default=0.05, help="s between two positions (speed control only)")
    parser.add_argument("--speed-scale", type=float, default=1.0, help="measured over true speed (speed control only)")
    arguments = parser.parse_args()
    profile = load_profile(arguments.profile)
    if arguments.noise_station is not None:
        profile = profile.replace(noise_station=arguments.noise_station)
    sensors = Sensors(max(1, round(arguments.pose_period / profile.period)), arguments.speed_scale)
    rng = np.random.default_rng(arguments.seed)
    make_driver, title = DRIVERS[arguments.driver]
    drives = [
        drive_one(rng, seed, make_driver(CAR, sensors), profile, arguments.smooth_plan)
        for seed in range(arguments.cars)
    ]
    speed = np.array([drive.speed_error for drive in drives])
    stops = [stop for drive in drives for stop in drive.stops]
    errors, estimate_errors, jerks, back = np.array(stops).T
    print(f"{arguments.cars} cars, {title}")
    print(f"speed RMS (m/s) after {SETTLED:.0f} s: mean {speed.mean():.3f}, 95 % {np.quantile(speed, 0.95):.3f}, "
          f"largest {speed.max():.3f}")  # fmt: skip
    print(f"stops (m): within 0.15 m {100 * np.mean(np.abs(errors) < 0.15):.0f} %, median {np.median(errors):+.3f}, "
          f"95 % {np.quantile(np.abs(errors), 0.95):.3f}, largest {np.abs(errors).max():.3f}; of the estimated place "
          f"95 % {np.quantile(np.abs(estimate_errors), 0.95):.3f}")  # fmt: skip
    print(f"jerk over 0.2 s in the last metre (m/s^3): median {np.median(jerks):.2f}, "
          f"95 % {np.quantile(jerks, 0.95):.2f}, largest {np.max(jerks):.2f}, "
          f"at most 2.5 at {100 * np.mean(jerks <= 2.5):.0f} %")  # fmt: skip
    print(f"rolled back at most {back.max():.3f} m")
    print_learned([belief for drive in drives for belief in drive.learned])


if __name__ == "__main__":
    main()
