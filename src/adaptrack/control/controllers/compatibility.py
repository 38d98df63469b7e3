"""What a scheduler's file says that it was made for, held against the controller and the profile that it meets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from adaptrack.cars.vehicle import Vehicle, list_vehicles, load_vehicle
from adaptrack.core.models.car import SingleTrackCar

INCREMENTAL = "incremental"
"""What the files of schedulers call the paper's model and estimator."""


def car_of(part: Any) -> str | None:
    """Return the name of the car of a model or a plant as in a scheduler's file; None without one.

    A car that has the name of a shipped one and other numbers in its model is not that one.
    """
    vehicle = getattr(part, "vehicle", None)
    if not isinstance(vehicle, Vehicle):
        return getattr(vehicle, "name", None)
    if vehicle.name not in list_vehicles():
        return vehicle.name
    shipped = _shipped(vehicle.name)
    is_shipped = all(getattr(vehicle, key) == getattr(shipped, key) for key in SingleTrackCar._fields)
    return vehicle.name if is_shipped else f"{vehicle.name} with other numbers"


@cache
def _shipped(name: str) -> Vehicle:
    return load_vehicle(name)


def mismatches(
    made_for: Any, model: str, car: str | None, profile: str | None, plant_car: str | None = None
) -> list[str]:
    """A sentence with its remedy for each of controller, car and profile that is another than the file names.

    made_for: of a schedule, see `scheduling.made_for`; what it does not tell is not compared. model:
    `MPC.kind_of_model`; car, profile: their names (`car_of`), None where they are not known; plant_car: the car of the
    plant, where it is known.
    """
    names = made_for if isinstance(made_for, Mapping) else {}
    expected, sentences = _model_of(names), []
    if expected not in (None, model):
        published = "use it with the published MPC (`adaptrack paper evaluate`, in Python published_mpc(...))"
        remedy = published if expected == INCREMENTAL else "learn it on this one"
        sentences.append(f"tunes an MPC whose model is {model!r}, not {expected!r}, for which it was made: {remedy}")
    cars = dict.fromkeys(name for name in (car, plant_car) if name is not None)
    for kind, actual in (*(("car", name) for name in cars), ("profile", profile)):
        if actual is not None and names.get(kind) not in (None, actual):
            sentences.append(
                f"was made for the {kind} {names[kind]!r}, not {actual!r}: leave it out, or make one for it "
                "(`adaptrack paper adapt`)"
            )
    return sentences


def is_for_published(made_for: Any) -> bool:
    """Whether a scheduler was made for the paper's MPC; one that does not tell is taken for such."""
    return _model_of(made_for) in (None, INCREMENTAL)


def _model_of(made_for: Any) -> Any:
    """Return the file's entry for the tuned model, whatever its type."""
    controller = made_for.get("controller") if isinstance(made_for, Mapping) else None
    return controller.get("model") if isinstance(controller, Mapping) else None
