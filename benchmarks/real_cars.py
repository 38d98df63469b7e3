"""How far our priors fit real cars: the public parameter table of opendbc (commaai, MIT licence), some 250 platforms.

    python benchmarks/real_cars.py CHECKOUT [--json]

CHECKOUT: a checkout of https://github.com/commaai/opendbc, which needs pycapnp, pycryptodome and tqdm. A platform that
has mass, wheelbase, ratio and delay of another is the same car under another name and counts once. Masses hold 136 kg
of people and luggage. `steerActuatorDelay` lumps whatever lies between command and motion, and openpilot adds 0.2 s to
it before it has learned the car's own (`selfdrive/locationd/lagd.py`): the row `delay + 0.2`.
The last column: the share of cars within the range that a controller believes where nobody says anything.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.cars import data_sheet
from adaptrack.control.controllers.learned import LEAST_LAG, MIDDLE, UNKNOWN_CAR
from adaptrack.core.synthesis import car as kernel

QUANTILES = (5, 25, 50, 75, 95)
NOT_CARS = {"COMMA_BODY", "MOCK"}
G = 9.81
"""m/s^2"""


def cars(checkout: Path) -> list[dict[str, Any]]:
    """Of each distinct car its name and numbers, as opendbc's own interface gives them."""
    sys.path.insert(0, str(checkout))
    from opendbc.car.car_helpers import interfaces
    from opendbc.car.values import PLATFORMS

    found: dict[tuple[float, ...], dict[str, Any]] = {}
    for name, platform in PLATFORMS.items():
        if name in NOT_CARS:
            continue
        has = interfaces[name].get_non_essential_params(name)
        to_front = has.centerToFront / has.wheelbase
        loads = has.mass * G * np.array([1.0 - to_front, to_front])
        over_load = np.array([has.tireStiffnessFront, has.tireStiffnessRear]) / loads  # 1/rad
        key = (has.mass, has.wheelbase, has.steerRatio, has.steerActuatorDelay)
        found[tuple(round(float(each), 4) for each in key)] = {
            "name": str(name), "make": has.brand, "mass": has.mass, "wheelbase": has.wheelbase,
            "steering ratio": has.steerRatio, "delay": has.steerActuatorDelay,
            "delay + 0.2": has.steerActuatorDelay + 0.2, "lf / wheelbase": to_front,
            "mass per wheelbase": has.mass / has.wheelbase, "front stiffness / load": over_load[0],
            "rear stiffness / load": over_load[1], "angle": has.steerControlType == "angle",
            "stiffness factor": platform.config.specs.tireStiffnessFactor,
        }  # fmt: skip
    return list(found.values())


def torques(checkout: Path) -> dict[str, list[float]]:
    """What was measured of the cars that are steered by torque."""
    table = tomllib.loads((checkout / "opendbc/car/torque_data/params.toml").read_text())
    del table["legend"]
    measured = np.array(list(table.values()))
    return {
        "lateral acceleration, full torque": measured[:, 0].tolist(),
        "friction of the steering": measured[:, 2].tolist(),
    }


def believed() -> dict[str, tuple[float, float]]:
    """Between which two a controller believes a quantity of a car of which it knows nothing, or a data sheet allows."""
    lag = max(MIDDLE[0] - UNKNOWN_CAR.lag, LEAST_LAG), MIDDLE[0] + UNKNOWN_CAR.lag
    dead = max(MIDDLE[1] - UNKNOWN_CAR.dead_time, 0.0), MIDDLE[1] + UNKNOWN_CAR.dead_time
    delay = lag[0] + dead[0], lag[1] + dead[1]
    spread, factor = kernel.FRONT_DISTANCE_SPREAD, kernel.STIFFNESS_FACTOR
    front, rear = kernel.AXLE_COEFFICIENTS
    return {
        "mass": data_sheet.MASSES, "wheelbase": data_sheet.WHEELBASES, "delay": delay, "delay + 0.2": delay,
        "lf / wheelbase": (kernel.FRONT_DISTANCE - spread, kernel.FRONT_DISTANCE + spread),
        "front stiffness / load": (front / factor, front * factor),
        "rear stiffness / load": (rear / factor, rear * factor),
    }  # fmt: skip


UNITS = {
    "mass": "kg", "wheelbase": "m", "mass per wheelbase": "kg/m", "delay": "s", "delay + 0.2": "s",
    "front stiffness / load": "1/rad", "rear stiffness / load": "1/rad",
    "lateral acceleration, full torque": "m/s^2", "friction of the steering": "m/s^2",
}  # fmt: skip
TABLE = ("mass", "wheelbase", "mass per wheelbase", "steering ratio", "lf / wheelbase", "delay", "delay + 0.2",
         "stiffness factor", "front stiffness / load", "rear stiffness / load")  # fmt: skip


def rows(checkout: Path) -> list[dict[str, Any]]:
    """Of each quantity its count, quantiles, and the share of cars within what we believe."""
    known, within, found = cars(checkout), believed(), []
    columns: dict[str, list[float]] = {name: [float(car[name]) for car in known] for name in TABLE}
    columns["delay, steered by angle"] = [float(car["delay"]) for car in known if car["angle"]]
    columns["delay, steered by torque"] = [float(car["delay"]) for car in known if not car["angle"]]
    for name, values in (columns | torques(checkout)).items():
        row: dict[str, Any] = {
            "quantity": name,
            "unit": UNITS.get(name, "s" if "delay" in name else "-"),
            "cars": len(values),
        }
        row["quantiles"] = [float(each) for each in np.percentile(values, QUANTILES)]
        row["lowest"], row["highest"] = min(values), max(values)
        row["different values"] = len({round(each, 4) for each in values})
        if name in within:
            low, high = within[name]
            row["believed"] = [low, high]
            row["within"] = float(np.mean([low - 1e-6 <= each <= high + 1e-6 for each in values]))
        found.append(row)
    return found


def main() -> None:
    """Print a row for each quantity."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("checkout", type=Path)
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    table = rows(given.checkout.resolve())
    if given.json:
        print(json.dumps(table))
        return
    print(
        f"{'':42s} cars values     least"
        + "".join(f"{each:8d} %" for each in QUANTILES)
        + "      most  believed, share"
    )
    for row in table:
        share = "{:.3g} to {:.3g}: {:.0%}".format(*row["believed"], row["within"]) if "within" in row else ""
        numbers = "".join(f"{each:10.4g}" for each in [row["lowest"], *row["quantiles"], row["highest"]])
        quantity = f"{row['quantity']} ({row['unit']})"
        print(f"{quantity:42s} {row['cars']:4d} {row['different values']:6d}{numbers}  {share}")


if __name__ == "__main__":
    main()
