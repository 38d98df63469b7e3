"""How much error the plants' default integration step leaves: against steps twenty times finer, over 5 s.

    python benchmarks/integration_step.py [--json] [--period 0.1] [--runs 32]

For each plant, tyre and speed, vehicles drive `runs` random manoeuvres: steering that holds a new angle in every
control period (a smooth weave with the jitter of a controller, up to two thirds of what friction allows), changing
speed, friction and gusts, without and with the steering actuator of the road profile. Reported are the largest errors
of any run at any control instant, in position and yaw, and the fewest steps per period that keep the position within
a millimetre: the evidence for the rule in `adaptrack.plant` (`SingleTrack.substeps`, `DualTrack.substeps`).
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import sys
from dataclasses import asdict, dataclass

import numba
import numpy as np

from adaptrack.cars.plant import DualTrack, Plant, SingleTrack
from adaptrack.cars.vehicle import GRAVITY, load_tyre, load_vehicle
from adaptrack.core.plants.contract import INPUTS, SLOTS, STATES, place, vehicle_batch
from adaptrack.scenario.profile import load_profile

DURATION = 5.0  # s
FINER = 20
SPEEDS = (3.0, 5.0, 8.0, 12.0, 16.0, 20.0, 25.0, 30.0)
TARGET = 1e-3  # m
FRICTION = 0.8  # about which it varies


@dataclass(frozen=True)
class Row:
    """What one plant leaves at one speed."""

    plant: str
    car: str
    tyre: str
    actuator: str
    speed: float
    """m/s"""
    steps: int
    """per control period, by default"""
    step_ms: float
    position_error_mm: float
    yaw_error_mrad: float
    steps_for_1mm: int
    """the fewest steps per period from which on the position error stays below a millimetre"""


def plants() -> list[Plant]:
    """Both plants on every tyre, each tyre on the car that it belongs to; the Magic Formula without relaxation, too."""
    car, sedan = load_vehicle("paper"), load_vehicle("midsize-sedan")
    immediate = load_tyre("magic-formula").replace(name="no relaxation", relaxation_length=0.0)
    tyres = [(car, "magic-formula"), (car, "constant-stiffness"), (sedan, "passenger-car")]
    single = [SingleTrack(vehicle, tyre) for vehicle, tyre in tyres]  # which knows no relaxation
    return [*single, *(DualTrack(vehicle, tyre) for vehicle, tyre in [*tyres, (car, immediate)])]


def manoeuvres(plant: Plant, speed: float, period: float, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Inputs (periods, INPUTS, runs), held over each control period."""
    periods = round(DURATION / period)
    t = period * np.arange(periods)[:, None]
    car = plant.vehicle.matched_to(plant.tyre)
    gain = car.steady_state_yaw_gain(min(speed, 0.9 * car.critical_speed)) * max(speed, 1.0)  # m/s^2 per rad
    largest = min(0.3, 0.65 * FRICTION * GRAVITY / gain)
    inputs = np.zeros((periods, INPUTS, runs))
    frequency, phase = rng.uniform(0.1, 0.8, runs), rng.uniform(0, 2 * math.pi, runs)
    inputs[:, 0] = largest * (
        0.8 * np.sin(2 * math.pi * frequency * t + phase) + 0.2 * rng.uniform(-1, 1, (periods, runs))
    )
    inputs[:, 2] = np.sin(2 * math.pi * 0.3 * t + rng.uniform(0, 2 * math.pi, runs)) * min(1.5, 0.5 * speed)
    inputs[:, 3:7] = FRICTION * (1 + 0.1 * np.sin(2 * math.pi * 0.5 * t + phase))[:, None]
    inputs[:, 8] = 10.0 * np.sin(2 * math.pi * 0.25 * t + rng.uniform(0, 2 * math.pi, runs))
    return inputs


def paths(plant: Plant, speed: float, inputs: np.ndarray, period: float, steps: int) -> np.ndarray:
    """X, Y and yaw (periods, 3, runs) at the control instants."""
    runs = inputs.shape[2]
    start = plant.initial_state(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0]))
    fleet, advance = vehicle_batch(plant.compiled, plant.packed(), np.tile(start, (SLOTS, 1))), plant.compiled.advance
    place(SLOTS, fleet.start, fleet.block, fleet.states)
    rows, seen = fleet.block.reshape(-1, SLOTS), np.empty((len(inputs), 3, runs))
    for k, held in enumerate(inputs):
        rows[STATES:, :runs] = held
        rows[STATES:, runs:] = held[:, :1]
        advance(fleet.member, fleet.parameters, fleet.block, fleet.states, fleet.work, runs, steps, period / steps)
        seen[k] = rows[:3, :runs]
    return seen


def errors(coarse: np.ndarray, fine: np.ndarray) -> tuple[float, float]:
    """Largest distance (m) and angle (rad) between two sets of paths; infinite when a path is not finite."""
    if not np.isfinite(coarse).all():
        return math.inf, math.inf
    return float(np.hypot(*(coarse - fine)[:, :2].swapaxes(0, 1)).max()), float(np.abs((coarse - fine)[:, 2]).max())


def measure(plant: Plant, actuator: str, speed: float, period: float, runs: int, seed: int) -> Row:
    """Compare the default step, and every coarser one, with the reference."""
    if actuator == "road":
        plant = plant.with_steering(load_profile("road").steering)
    inputs = manoeuvres(plant, speed, period, runs, np.random.default_rng(seed))
    default = plant.substeps(period, speed)
    fine = paths(plant, speed, inputs, period, FINER * default)
    position, yaw = errors(paths(plant, speed, inputs, period, default), fine)
    enough = default
    if position > TARGET:
        while errors(paths(plant, speed, inputs, period, enough), fine)[0] > TARGET and enough < FINER * default:
            enough += 1
    else:
        while enough > 1 and errors(paths(plant, speed, inputs, period, enough - 1), fine)[0] <= TARGET:
            enough -= 1
    return Row(
        plant=plant.name,
        car=plant.vehicle.name,
        tyre=plant.tyre.name,
        actuator=actuator,
        speed=speed,
        steps=default,
        step_ms=1e3 * period / default,
        position_error_mm=1e3 * position,
        yaw_error_mrad=1e3 * yaw,
        steps_for_1mm=enough,
    )


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--period", type=float, default=0.1, help="control period, s")
    parser.add_argument("--runs", type=int, default=SLOTS, help=f"manoeuvres per line, at most {SLOTS}")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if not 1 <= options.runs <= SLOTS:
        parser.error(f"--runs must be between 1 and {SLOTS}")

    rows = [
        measure(plant, actuator, speed, options.period, options.runs, options.seed)
        for plant in plants()
        for actuator in ("ideal", "road")
        for speed in SPEEDS
    ]
    worst = max(rows, key=lambda row: row.position_error_mm)
    if options.json:
        result = {
            "worst_position_error_mm": worst.position_error_mm,
            "worst_yaw_error_mrad": max(row.yaw_error_mrad for row in rows),
            "period_s": options.period,
            "duration_s": DURATION,
            "finer": FINER,
            "runs": options.runs,
            "seed": options.seed,
            "machine": platform.processor() or platform.machine(),
            "python": platform.python_version(),
            "numba": numba.__version__,
            "rows": [asdict(row) for row in rows],
        }
        print(json.dumps(result))
    else:
        print(f"{options.runs} manoeuvres of {DURATION:g} s, period {options.period:g} s, reference {FINER} x finer")
        print(f"{'plant':13}{'tyre':22}{'steering':10}  m/s  steps   h ms        mm      mrad  1 mm needs")
        for row in rows:
            print(
                f"{row.plant:13}{row.tyre:22}{row.actuator:10}{row.speed:5.0f}{row.steps:7d}{row.step_ms:7.2f}"
                f"{row.position_error_mm:10.2g}{row.yaw_error_mrad:10.2g}{row.steps_for_1mm:12d}"
            )
        print(f"worst: {worst.position_error_mm:.2g} mm ({worst.plant}, {worst.tyre}, {worst.speed:g} m/s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
