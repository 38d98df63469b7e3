"""What a scheduler's file says that it was made for, held against the controller and the profile that it meets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from adaptrack.cars.vehicle import Vehicle, list_vehicles, load_vehicle

INCREMENTAL = "incremental"
"""What the files of schedulers call the paper's model and estimator."""

_MODEL = ("mass", "yaw_inertia", "lf", "lr", "stiffness_front", "stiffness_rear")


def car_of(part: Any) -> str | None:
    """What a scheduler's file calls the car of a model or a plant; None where it has none.

    A car that has the name of a shipped one and other numbers in its model is not that one.
    """
    vehicle = getattr(part, "vehicle", None)
    if not isinstance(vehicle, Vehicle):
        return getattr(vehicle, "name", None)
    if vehicle.name not in list_vehicles():
        return vehicle.name
    shipped = _shipped(vehicle.name)
    same = all(getattr(vehicle, key) == getattr(shipped, key) for key in _MODEL)
    return vehicle.name if same else f"{vehicle.name} with other numbers"


@cache
def _shipped(name: str) -> Vehicle:
    return load_vehicle(name)


def mismatches(made_for: Any, model: str, car: str | None, profile: str | None, driven: str | None = None) -> list[str]:
    """A sentence with its remedy for each of controller, car and profile that is another than the file names.

    made_for: of a schedule, see `scheduling.files.made_for`; what it does not tell is not compared. model:
    `MPC.kind_of_model`; car, profile: their names (`car_of`), None where they are not known; driven: the car of the
    plant, where it is known.
    """
    named = made_for if isinstance(made_for, Mapping) else {}
    expected, found = _model_of(named), []
    if expected not in (None, model):
        published = "use it with the published MPC (`adaptrack paper evaluate`, in Python published_mpc(...))"
        remedy = published if expected == INCREMENTAL else "learn it on this one"
        found.append(f"tunes an MPC whose model is {model!r}, not {expected!r}, for which it was made: {remedy}")
    cars = dict.fromkeys(each for each in (car, driven) if each is not None)
    for what, here in (*(("car", each) for each in cars), ("profile", profile)):
        if here is not None and named.get(what) not in (None, here):
            found.append(
                f"was made for the {what} {named[what]!r}, not {here!r}: leave it out, or make one for it "
                "(`adaptrack paper adapt`)"
            )
    return found


def is_for_published(made_for: Any) -> bool:
    """Whether a scheduler was made for the paper's MPC; one that does not tell is taken for such."""
    return _model_of(made_for) in (None, INCREMENTAL)


def _model_of(made_for: Any) -> Any:
    """What stands in a file for the model that is tuned; a file may say anything."""
    named = made_for.get("controller") if isinstance(made_for, Mapping) else None
    return named.get("model") if isinstance(named, Mapping) else None
