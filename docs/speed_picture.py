"""Draw images/speed-control.png, speed, used grip and error on a lap: python docs/speed_picture.py  (10 s)"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

import adaptrack as at
from adaptrack.road import Comfort

FILE = Path(__file__).resolve().parent / "images" / "speed-control.png"


def main() -> None:
    """Drive a lap twice with an interval of friction, at a plan near the grip of the car."""
    car, lap = at.load_vehicle("midsize-sedan"), at.generate_road("lap", seed=2)
    plan = at.plan_speed(lap, car, Comfort(lateral=8.0))  # m/s^2
    control, mpc = at.SpeedControl(car, friction=(0.65, 0.9)), at.MPC(car, profile="road")
    run = at.simulate(at.DualTrack(car), mpc, at.RoadDrive(lap, plan), profile="road", driver=control)
    s = run.road["station"]
    used_grip = np.hypot(np.gradient(run.vx, run.t), run.lateral_acceleration) / (0.9 * 9.81)
    figure, panels = plt.subplots(3, sharex=True, figsize=(10, 5.6), layout="constrained")
    panels[0].plot(s, np.c_[plan.at(s), run.vx], label=["planned", "driven"])
    panels[0].legend()
    panels[1].plot(s, used_grip, "C1")
    panels[2].plot(s, run.error, "C1")
    for panel, name in zip(panels, ("speed (m/s)", "used grip", "error (m)"), strict=True):
        panel.set_ylabel(name)
    panels[2].set_xlabel("distance (m)")
    figure.savefig(FILE)


if __name__ == "__main__":
    main()
