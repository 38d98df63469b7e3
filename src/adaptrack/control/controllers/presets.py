"""Presets of the MPC: of the paper, with a schedule, with learning, with less knowledge of the car.

Those that know the car are given its file, and of the steering what the profile says; one that learns is given of the
steering what the file says alone.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers.learned_car import Learning
from adaptrack.control.controllers.limits import Moves
from adaptrack.control.controllers.mpc import MPC
from adaptrack.control.controllers.tuning import Tuning
from adaptrack.control.models import SingleTrackModel
from adaptrack.control.scheduling import load_scheduler
from adaptrack.scenario.profile import Profile, load_profile


@checked
def published_mpc(vehicle: Vehicle, tuning: Tuning | None = None, *, period: float = 0.1, **options: Any) -> MPC:
    """The MPC of the paper as written: eqs. (8)-(17), moves as pulses, `Tuning()` of its table by default.

    It predicts with the single track of `vehicle`, whose wheels are where the command is, and takes the measured state
    as it is. period: s; options: of `MPC`, but for profile, belief, model and estimator.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    return MPC(vehicle, tuning, model=SingleTrackModel(vehicle, period), estimator="deadbeat", **options)


def released_mpc(vehicle: Vehicle, tuning: Tuning | None = None, **options: Any) -> MPC:
    """The paper's MPC as its authors released it: it moves by ten Laguerre functions with the pole 0.95.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    return published_mpc(vehicle, tuning, **{"moves": Moves.laguerre(0.95), **options})


def learning(vehicle: Vehicle, *, profile: str | Profile | None = None, **options: Any) -> MPC:
    """The informed controller, learning while it drives."""
    return MPC(vehicle, profile=profile, learning=Learning(), **options)


def learning_from_sheet(vehicle: Vehicle, *, profile: str | Profile | None = None, **options: Any) -> MPC:
    """Make a learning MPC from the mass and wheelbase of a car and its sensors."""
    car = vehicle_from_data_sheet(vehicle.name, vehicle.mass, vehicle.wheelbase)
    return learning(car, profile=profile, **options)


def nn(vehicle: Vehicle, *, profile: str | Profile | None = None, **options: Any) -> MPC:
    """The paper's controller with its shipped networks; InvalidInput when they were made for another car or profile."""
    return _scheduled("road-nn", vehicle, profile, options)


def anfis(vehicle: Vehicle, *, profile: str | Profile | None = None, **options: Any) -> MPC:
    """The paper's controller with the fuzzy systems that ship for it; raises as `nn`."""
    return _scheduled("road-anfis", vehicle, profile, options)


def _scheduled(name: str, vehicle: Vehicle, profile: str | Profile | None, options: dict[str, Any]) -> MPC:
    """The paper's controller with a scheduler that ships; refused where that was made for something else."""
    schedule, profile_name = load_scheduler(name), load_profile(profile or "road").name
    if faults := published_mpc(vehicle, **options).mismatches(schedule, profile_name):
        raise InvalidInput(f"scheduler {name!r} {'; it '.join(faults)}")
    return published_mpc(vehicle, scheduler=schedule, **options)


def published(vehicle: Vehicle, **options: Any) -> MPC:
    """The paper's controller with the constant that was best for the paper's car on drives in profile `road`."""
    Np, Nc, Q, R = (entry.low for entry in load_scheduler("road-best-constant-on-drives").tuning.values())
    return published_mpc(vehicle, Tuning(round(Np), round(Nc), Q, R), **options)


def published_nn(vehicle: Vehicle, **options: Any) -> MPC:
    """The paper's controller with the networks that ship for the paper's car in profile `road`, on any car.

    That they were made for another car is what is compared: no warning says so.
    """
    return published_mpc(vehicle, scheduler=replace(load_scheduler("road-nn"), made_for={}), **options)
