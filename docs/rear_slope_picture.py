"""Draw images/rear-slope.png, the slope of the rear tyres and what it does in a bend (10 s).

python docs/rear_slope_picture.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

import adaptrack as at
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.road import Comfort

FILE = Path(__file__).resolve().parent / "images" / "rear-slope.png"
USED = 0.78
BEND = (30.0, 43.0)  # s


class SameSlope(at.MPC):
    """An MPC that is told so much friction that its prediction keeps the slope at no slip."""

    def step(self, state: Any, *inputs: Any, **road: Any) -> Any:
        """Step with an unlimited friction."""
        return super().step(np.append(state[: MEASUREMENT.friction], 1e9), *inputs, **road)


def drive(controller: at.MPC) -> at.Trajectory:
    """Drive a lap near the grip of the car."""
    car, lap = controller.vehicle, at.generate_road("lap", seed=5)
    plan = at.plan_speed(lap, car, Comfort(lateral=7.0))  # m/s^2
    control = at.SpeedControl(car, friction=0.9)
    return at.simulate(at.DualTrack(car), controller, at.RoadDrive(lap, plan), profile="road", driver=control, seed=3)


def main() -> None:
    """Draw the curve of a tyre with two slopes, and a bend that is driven with each of them."""
    car = at.load_vehicle("midsize-sedan")
    figure, (curve, bend) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained", width_ratios=(1, 1.6))
    z = np.linspace(0.0, 1.1, 200)
    curve.plot(3.0 * z, 1.0 - (1.0 - np.minimum(z, 1.0)) ** 3, "k", label="brush tyre")
    place = 1.0 - (1.0 - USED) ** (1.0 / 3.0)
    slope = (1.0 - USED) ** (2.0 / 3.0)
    near = np.linspace(place - 0.25, place + 0.25, 2)
    curve.plot(3.0 * near, USED + 3.0 * slope * (near - place), "C1", linewidth=2.5, label=f"slope {slope:.2f} there")
    curve.plot([0.0, 1.0], [0.0, 1.0], "C0--", label="slope at no slip")
    curve.set(xlabel="slip angle, stiffness x angle / grip", ylabel="lateral force / grip", ylim=(0.0, 1.1))
    curve.legend(loc="lower right")
    for controller, name in (
        (SameSlope(car, profile="road"), "slope at no slip"),
        (at.MPC(car, profile="road"), "slope where they work"),
    ):
        run = drive(controller)
        bend.plot(run.t, run.lateral_acceleration, label=name)
    bend.set(xlabel="time (s)", ylabel="lateral acceleration (m/s²)", xlim=BEND)
    bend.legend()
    figure.savefig(FILE)


if __name__ == "__main__":
    main()
