"""What is estimated of a car, its sensors and what disturbs it: names, units, and what is believed before a log.

A belief is a median and a spread: the standard deviation of the logarithm for what is positive, of the value for what
has either sign, of the logit for a share. What may be 0 is linear in z below its median, as 0 is infinitely far on the
scale of a logarithm. A spread of 0 keeps the value. In units of its spread every quantity z has a standard normal
prior; all fits are in z.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from adaptrack.cars.vehicle import Vehicle, load_tyre
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY


class Prior(NamedTuple):
    """Prior of a quantity before the log is read."""

    median: float
    spread: float
    """of its logarithm, value or logit; 0: it is kept"""


@dataclass(frozen=True)
class Quantity:
    """One entry of the fit."""

    name: str
    unit: str
    kind: Literal["positive", "real", "share", "from zero"]
    meaning: str
    prior: Prior | None = None
    """of any car; None: the car file gives it"""


class Reported(NamedTuple):
    """A quantity that is reported, and how it follows from those of the fit."""

    name: str
    unit: str
    meaning: str
    is_positive: bool
    value: Callable[[Array], float]
    """of the fitted quantities, in their units and order"""


def report_quantity(quantities: Sequence[Quantity], name: str, meaning: str = "") -> Reported:
    """A quantity that is reported as it is."""
    place = [quantity.name for quantity in quantities].index(name)
    quantity = quantities[place]
    is_positive = quantity.kind in ("positive", "from zero")
    return Reported(name, quantity.unit, meaning or quantity.meaning, is_positive, lambda v: float(v[place]))


def report_delay(
    quantities: Sequence[Quantity], prefix: str = "", lag: str = "", dead_time: str = "", is_positive: bool = True
) -> list[Reported]:
    """Lag and dead time of an actuator, with their meanings, from its delay and the share of the lag."""
    delay, share = ([quantity.name for quantity in quantities].index(prefix + name) for name in ("delay", "lag_share"))
    return [
        Reported(f"{prefix}lag", "s", lag, is_positive, lambda v: float(v[share] * v[delay])),
        Reported(f"{prefix}dead_time", "s", dead_time, is_positive, lambda v: float((1.0 - v[share]) * v[delay])),
    ]


QUANTITIES = (
    Quantity("delay", "s", "from zero", "lag and dead time together", Prior(0.3, 0.7)),
    Quantity("lag_share", "-", "share", "the lag's share of the delay", Prior(0.5, 1.5)),
    Quantity("rate", "rad/s", "positive", "fastest turn of the road wheels", Prior(0.7, 0.6)),
    Quantity("lateness", "s", "real", "of what is measured of the motion, against the wheel angle", Prior(0.0, 0.15)),
    Quantity("gain", "-", "positive", "road wheels over the logged steering angle", Prior(1.0, 0.15)),
    Quantity("offset", "rad", "real", "what the road wheels turn beyond the command", Prior(0.0, 0.03)),
    Quantity("front", "N/rad", "positive", "cornering stiffness of the front axle"),
    Quantity("rear", "N/rad", "positive", "cornering stiffness of the rear axle"),
    Quantity("mass", "kg", "positive", "total mass", Prior(1500.0, 0.0)),
    Quantity("yaw_inertia", "kg m^2", "positive", "yaw inertia"),
    Quantity("front_share", "-", "share", "l_f over the wheelbase"),
    Quantity("relaxation", "m", "from zero", "relaxation length of the tyres"),
    Quantity(
        "friction", "-", "positive", "friction at which the tyres' curve bends, a mean over the log", Prior(0.7, 0.35)
    ),
    Quantity("wind_mean", "m/s", "real", "mean side wind", Prior(0.0, 4.0)),
    Quantity("wind_spread", "m/s", "positive", "standard deviation of the gusts", Prior(4.0, 1.0)),
    Quantity("wind_time", "s", "positive", "correlation time of the gusts", Prior(0.6, 0.6)),
    Quantity("wind_smoothness", "-", "share", "shorter over longer time constant of the gusts", Prior(0.5, 1.5)),
    Quantity("lever", "m", "real", "by which gusts act before where the car's air moment has them", Prior(0.0, 0.8)),
    Quantity("push_mean", "m/s^2", "real", "mean push of the bank", Prior(0.0, 0.2)),
    Quantity("push_spread", "m/s^2", "positive", "standard deviation of the bank's push", Prior(0.15, 1.0)),
    Quantity(
        "superelevation", "-", "real", "share of lateral acceleration that the bank of bends gives", Prior(0.0, 0.08)
    ),
    Quantity("jolt", "rad/s^1.5", "positive", "white yaw acceleration of the road", Prior(0.01, 1.5)),
    Quantity("noise_yaw_rate", "rad/s", "positive", "noise of the yaw rate", Prior(0.01, 1.5)),
    Quantity("noise_vy", "m/s", "positive", "noise of the lateral velocity", Prior(0.05, 1.5)),
    Quantity("noise_acceleration", "m/s^2", "positive", "noise of the lateral acceleration", Prior(0.1, 1.5)),
    Quantity("noise_yaw", "rad", "positive", "noise of the yaw angle", Prior(0.003, 1.5)),
    Quantity("noise_wheel", "rad", "positive", "noise of the wheel angle", Prior(0.002, 1.5)),
    Quantity("gyro_offset", "rad/s", "real", "offset of the yaw rate", Prior(0.0, 0.003)),
    Quantity("acceleration_offset", "m/s^2", "real", "offset of the lateral acceleration", Prior(0.0, 0.2)),
    Quantity("wheel_offset", "rad", "real", "offset of the measured wheel angle", Prior(0.0, 0.02)),
    Quantity("vy_ahead", "m", "real", "sensor of the lateral velocity before the centre of gravity", Prior(0.0, 1.0)),
    Quantity("vy_turned", "rad", "real", "turn of that sensor", Prior(0.0, 0.01)),
)
"""All, in the order of the fit."""
INDEX = {quantity.name: i for i, quantity in enumerate(QUANTITIES)}

AXLE_OVER_LOAD = 11.0
"""1/rad, cornering stiffness of an axle over its load where nothing is known of the tyres."""
PUSH_TIME = 5.0
"""s, correlation time of what the bank adds."""
LEAST_LINEAR = 0.1
"""Share of the median down to which a quantity that may be 0 is linear in z; below it is an exponential tail."""
SHAPE = 1.35
"""-, shape factor of the tyres' curve where nothing is known of it."""

DISTURBANCES = {quantity.name: quantity.prior for quantity in QUANTITIES if quantity.prior is not None}
"""What is believed of steering, sensors and weather: wide enough for any car on a road."""


def values_of(z: Array, median: Array, spread: Array, quantities: Sequence[Quantity] = QUANTITIES) -> Array:
    """The quantities of a point z (in spreads from the medians), in their units; all of one shape."""
    moved, kinds = spread * z, np.array([quantity.kind for quantity in quantities])
    share = np.where(kinds == "share", median, 0.5)
    logit = portable.log(share / (1.0 - share))
    is_linear = (kinds == "from zero") & (moved < 0.0)
    tail = np.minimum(moved + 1.0 - LEAST_LINEAR, 0.0) / LEAST_LINEAR
    factor = np.where(is_linear, np.maximum(1.0 + moved, LEAST_LINEAR), 1.0)
    is_positive = (kinds == "positive") | (kinds == "from zero")
    return np.where(
        is_positive, median * factor * portable.exp(np.where(is_linear, tail, np.where(is_positive, moved, 0.0))),
        np.where(kinds == "real", median + moved, 1.0 / (1.0 + portable.exp(-(logit + moved)))),
    )  # fmt: skip


def beliefs_of(car: Vehicle, priors: Mapping[str, Prior] | None = None) -> dict[str, Prior]:
    """Return the prior of every quantity: body values from the car file, tyre values around it.

    priors: replaces entries; a car file that says how well it knows its numbers is read here.
    """
    tyre = load_tyre(car.tyre)
    beliefs = dict(DISTURBANCES)
    beliefs["mass"] = Prior(car.mass, 0.0)
    beliefs["front_share"] = Prior(car.lf / car.wheelbase, 0.0)
    beliefs["yaw_inertia"] = Prior(car.yaw_inertia, 0.1)
    beliefs["front"] = Prior(2.0 * car.stiffness_front, 0.7)
    beliefs["rear"] = Prior(2.0 * car.stiffness_rear, 0.7)
    beliefs["relaxation"] = Prior(max(tyre.relaxation_length, 0.25), 0.7)
    steering = car.steering
    if steering is not None and steering.lag is not None and steering.dead_time is not None:
        delay = max(steering.lag + steering.dead_time, 0.02)
        beliefs["delay"] = Prior(delay, 0.7)
        beliefs["lag_share"] = Prior(min(max(steering.lag / delay, 0.1), 0.9), 1.5)
    if steering is not None and steering.rate is not None:
        beliefs["rate"] = Prior(steering.rate, 0.3)
    return beliefs | dict(priors or {})


def plain_car(mass: float, wheelbase: float) -> tuple[Vehicle, dict[str, Prior]]:
    """A car of which only mass (kg) and wheelbase (m) are known, and how far the rest may be off.

    The centre of gravity lies at 0.45 +- 0.03 of the wheelbase behind the front axle, the yaw inertia is m l_f l_r
    within 15 %, the axles have `AXLE_OVER_LOAD` times their load, within a factor of 2.2.
    """
    lf, lr = 0.45 * wheelbase, 0.55 * wheelbase
    front, rear = (0.5 * AXLE_OVER_LOAD * mass * GRAVITY * arm / wheelbase for arm in (lr, lf))
    car = Vehicle(
        name="my-car", description="Identified from a log; mass and wheelbase as given", mass=mass,
        yaw_inertia=mass * lf * lr, lf=lf, lr=lr, stiffness_front=front, stiffness_rear=rear,
    )  # fmt: skip
    spread = 0.03 / (0.45 * 0.55)
    values = {
        "front_share": Prior(0.45, spread), "yaw_inertia": Prior(mass * lf * lr, 0.15),
        "front": Prior(2.0 * front, 0.8), "rear": Prior(2.0 * rear, 0.8), "relaxation": Prior(0.25, 0.7),
    }  # fmt: skip
    return car, values


def understeer(front: float, rear: float, mass: float, wheelbase: float, front_share: float) -> float:
    """K = (m/L)(l_r/C_f - l_f/C_r) (rad s^2/m) of two axles (N/rad), as `Vehicle.understeer_gradient`."""
    return mass * ((1.0 - front_share) / front - front_share / rear)


def degrees_per_g(gradient: float) -> float:
    """An understeer gradient (rad s^2/m) in degrees per g."""
    return math.degrees(gradient * GRAVITY)
