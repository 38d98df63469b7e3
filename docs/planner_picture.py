"""Draw images/planner.png, a drive behind a planner, in place and in time (10 s).

python docs/planner_picture.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt

import adaptrack as at
from adaptrack.road import Comfort

FILE = Path(__file__).resolve().parent / "images" / "planner.png"
TROUBLE = 2.0
"""s, by which the car is late at its start: it stands while the times of the planner go on."""
APART = 0.3
"""m, between the lines of two planners that send in turn."""
SHOWN = (160.0, 260.0)


def sent(
    road: at.Road, plan: at.SpeedPlan, now: float, aside: float, noise: np.random.Generator
) -> at.PlannedTrajectory:
    """What a planner sends: its line from the place at a time on, 4 s ahead, with noise across it."""
    t = np.arange(0.0, 4.0, 0.1)
    s, speed = plan.motion(now + t)
    place = road.at(s)
    across = aside + noise.normal(scale=0.02, size=t.size)
    x, y = place.x - across * np.sin(place.heading), place.y + across * np.cos(place.heading)
    return at.PlannedTrajectory(t, x, y, speed=speed, stamp=now)


def main() -> None:
    """Drive a simple car behind two planners that are 2 s ahead of it, and draw places and times."""
    car, noise = at.load_vehicle("midsize-sedan"), np.random.default_rng(1)
    road = at.generate_road("country", seed=3, length=600.0)
    plan = at.plan_speed(road, car, Comfort(lateral=2.0), start=0.0, top_speed=12.0)
    following = at.Following(speed_limit=14.0)
    tracker = at.Tracker(at.MPC(car, profile="road", computation=0.0), speed=at.SpeedControl(car), following=following)
    start = road.at(0.0)
    x, y, yaw, speed, wheels, force = float(start.x), float(start.y), float(start.heading), 0.0, 0.0, 0.0
    rows, trajectories = [], []
    for k in range(800):
        t = 0.05 * k
        if k % 2 == 0:
            trajectories.append(sent(road, plan, t, 0.5 * APART * (-1) ** (k // 2), noise))
            tracker.follow(trajectories[-1], now=t)
        out = tracker.step(t, x, y, yaw, speed, speed * np.tan(wheels) / car.wheelbase)
        rows.append((t, x, y, speed, out.late, float(plan.motion(t)[1])))
        wheels += 0.28 * (out.command - wheels)
        force += 0.28 * ((out.longitudinal.force if t >= TROUBLE else 0.0) - force)
        speed = max(0.0, speed + 0.05 * (force - out.longitudinal.hold * (t >= TROUBLE)) / car.mass)
        course = yaw + np.arctan(car.lr * np.tan(wheels) / car.wheelbase)
        yaw += 0.05 * speed * np.tan(wheels) / car.wheelbase
        x, y = x + 0.05 * speed * np.cos(course), y + 0.05 * speed * np.sin(course)
    t, x, y, speed, late, planned = np.array(rows).T
    figure, (place, time) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained", width_ratios=(1, 1.2))
    for trajectory in trajectories[::7]:
        foot = road.project(trajectory.x, trajectory.y)
        place.plot(foot.s, foot.offset, "C1", linewidth=0.6)
    place.plot([], [], "C1", label="trajectories")
    foot = road.project(x, y)
    place.plot(foot.s, foot.offset, "k", linewidth=1.6, label="driven")
    place.set(xlabel="way (m)", ylabel="beside the road (m)", xlim=SHOWN, ylim=(-0.4, 0.4))
    place.legend()
    time.plot(t, planned, "C1", label="planned")
    time.plot(t, speed, "k", label="driven")
    time.set(xlabel="time (s)", ylabel="speed (m/s)", xlim=(0.0, 40.0))
    delay = time.twinx()
    delay.plot(t, late, "C0", linewidth=1.0)
    delay.set_ylabel("late (s)", color="C0")
    time.legend(loc="lower right")
    figure.savefig(FILE)


if __name__ == "__main__":
    main()
