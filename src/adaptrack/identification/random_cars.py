"""Random cars about shipped ones: what a method that gets to know a car is measured on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from adaptrack.base.checked import RISING, Finite, Natural, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Tyre, Vehicle, load_tyre, load_vehicle
from adaptrack.control.controllers.learned_car import STEERING_QUANTITIES
from adaptrack.core.maths import portable
from adaptrack.scenario.profile import Profile, load_profile

BASES = ("paper", "midsize-sedan")
_CAR = 0x0CA5  # stream of random numbers


_Factors = Annotated[tuple[Positive, Positive], RISING]
_Range = Annotated[tuple[Finite, Finite], RISING]


@checked
@dataclass(frozen=True)
class CarRanges:
    """From where random cars are drawn: factors log-uniform, the others uniform, all independent."""

    mass: _Factors = (0.6, 1.6)
    """factor on mass, yaw inertia and the tyres' nominal load"""
    stiffness: _Factors = (0.5, 2.5)
    """factor on the cornering stiffness of both axles"""
    front_to_rear: _Factors = (0.85, 1.18)
    """factor on the ratio of front to rear stiffness"""
    lag: Annotated[_Range, "s"] = (0.05, 0.35)
    """of the steering"""
    dead_time: Annotated[_Range, "s"] = (0.0, 0.25)
    """of the steering, beside the computation that the profile has"""
    bias: Annotated[_Range, "rad"] = (-0.02, 0.02)
    """of the steering"""
    noise: _Factors = (0.3, 3.0)
    """factor on the noise of all sensors of the profile"""


@dataclass(frozen=True)
class RandomCar:
    """A car, its tyre and its world, as `random_car` draws them."""

    seed: int
    base: str
    """the shipped car that it was drawn about"""
    vehicle: Vehicle
    """the truth; its prediction model has the stiffness of the tyre at the static loads"""
    tyre: Tyre
    profile: Profile
    """true steering actuator and sensors"""
    noise: float
    """-, factor on the noise of the profile's sensors"""

    @property
    def delay(self) -> float:
        """s, dead time and lag of the steering, with the computation of the profile."""
        return self.profile.dead_time + self.profile.steering.lag


@checked
def random_car(
    seed: Natural,
    *,
    bases: Sequence[str] = BASES,
    profile: str | Profile = "road",
    ranges: CarRanges | None = None,
) -> RandomCar:
    """The car of a seed: about one of the shipped cars, each in turn, in a profile with its own steering and noise.

    A seed gives the same car on every machine. The tyre keeps its curve: stiffness and nominal load are scaled. Mass
    and yaw inertia are scaled alike. Of what a controller knows of the steering nothing is said (`vehicle.steering`
    is None but for rate and limit).

    Raises
    ------
    InvalidInput
        When there is no base.
    """
    if not bases:
        raise InvalidInput("random_car: bases = (): name at least one shipped car.")
    ranges = ranges or CarRanges()
    rng = np.random.default_rng((_CAR, seed))

    def factor(bounds: tuple[float, float]) -> float:
        return float(portable.exp(rng.uniform(portable.log(bounds[0]), portable.log(bounds[1]))))

    base = bases[seed % len(bases)]
    car = load_vehicle(base)
    tyre = load_tyre(car.tyre)
    mass, stiffness, ratio = factor(ranges.mass), factor(ranges.stiffness), factor(ranges.front_to_rear)
    noise = factor(ranges.noise)
    steering = {name: float(rng.uniform(*getattr(ranges, name))) for name in STEERING_QUANTITIES}
    tyre = tyre.replace(
        name=f"{tyre.name}-{seed}",
        stiffness_front=tyre.stiffness_front * stiffness * math.sqrt(ratio),
        stiffness_rear=tyre.stiffness_rear * stiffness / math.sqrt(ratio),
        nominal_load=tyre.nominal_load * mass,
    )
    vehicle = car.replace(name=f"{base}-{seed}", mass=car.mass * mass, yaw_inertia=car.yaw_inertia * mass).matched_to(
        tyre
    )
    world = load_profile(profile)
    noises = ("noise_vy", "noise_yaw", "noise_yaw_rate", "noise_y", "noise_wheel_angle", "noise_lateral_acceleration")
    world = world.replace(
        name=f"{world.name}-{seed}",
        steering=world.steering.replace(**steering),
        **{name: getattr(world, name) * noise for name in noises},
    )
    return RandomCar(seed, base, vehicle, tyre, world, noise)
