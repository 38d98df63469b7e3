"""A simulator in another process is driven over a pipe: python examples/simulator_in_another_process.py

With ``--serve`` this file is the simulator: it needs nothing of adaptrack and may be written in any language.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

MASS, INERTIA, LF, LR, FRONT, REAR = 1575.0, 2875.0, 1.2, 1.6, 38e3, 66e3  # kg, kg m^2, m, m, N/rad of an axle


def rates(motion: list[float], steering: float, acceleration: float, grip: float) -> list[float]:
    """A single track on linear tyres: the derivative of X, Y, yaw, v_x, v_y, yaw rate."""
    _, _, yaw, vx, vy, r = motion
    v = max(vx, 2.0)
    front = grip * FRONT * (steering - (vy + LF * r) / v)
    rear = -grip * REAR * (vy - LR * r) / v
    return [
        vx * math.cos(yaw) - vy * math.sin(yaw), vx * math.sin(yaw) + vy * math.cos(yaw), r, acceleration,
        (front + rear) / MASS - vx * r, (LF * front - LR * rear) / INERTIA,
    ]  # fmt: skip


def answer(motion: list[float], request: dict[str, Any]) -> list[float]:
    """The motion after the request: a reset, or a step by the midpoint rule."""
    if request["do"] == "reset":
        return request["motion"]
    dt, grip = request["dt"], min(1.0, sum(request["environment"][:4]) / 3.6)
    held = request["steering"], request["acceleration"], grip
    middle = [x + 0.5 * dt * slope for x, slope in zip(motion, rates(motion, *held), strict=True)]
    return [x + dt * slope for x, slope in zip(motion, rates(middle, *held), strict=True)]


def serve() -> None:
    """Greet, then answer each line with a line until there are no more."""
    print(json.dumps({"adaptrack_plant": 1, "name": "bicycle over a pipe", "mass": MASS}), flush=True)
    motion = [0.0] * 6
    for line in sys.stdin:
        motion = answer(motion, json.loads(line))
        print(json.dumps({"motion": motion}), flush=True)


def main(seconds: float = 20.0) -> float:
    """Check the plant, drive a sine with it, and give the RMS (m) of the error."""
    import adaptrack as at

    with at.ProcessPlant([sys.executable, str(Path(__file__).resolve()), "--serve"]) as plant:
        at.check_plant(plant, period=0.05)
        mpc = at.MPC(at.load_vehicle("paper"), profile="road")
        run = at.simulate(plant, mpc, at.load_scenario("sine", duration=seconds), profile="road")
    rms = math.sqrt(at.compute_metrics(run).mse)
    print(f"{plant.name}: RMS {rms:.3f} m over {seconds:g} s")
    return rms


if __name__ == "__main__":
    serve() if "--serve" in sys.argv else main()
