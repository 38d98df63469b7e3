"""Schedules by name or file, and what they are made for."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, StorageError, UnknownName, did_you_mean
from adaptrack.base.files import SHIPPED
from adaptrack.control.controllers import MPC
from adaptrack.control.controllers.compatibility import car_of
from adaptrack.control.scheduling.document import read_document
from adaptrack.control.scheduling.schedule import Schedule
from adaptrack.core.library import kernels_hash
from adaptrack.scenario.profile import load_profile

_DATA = SHIPPED / "schedulers"


@checked
def load_scheduler(name_or_path: str | os.PathLike[str]) -> Schedule:
    """The schedule in a file, or one that ships with the package, by name (`list_schedulers`).

    Its name is that of the file, without the ending.

    Raises
    ------
    UnknownName
        When no scheduler has the name.
    StorageError
        When the file cannot be read, is damaged, is not a scheduler, or has a version that this program cannot read.
    """
    path = _path(name_or_path)
    content = read_document(path)
    try:
        schedule = replace(Schedule.loaded(content), name=path.stem)
        schedule._packed()  # numbers too large for the kernels are found here
    except KeyError as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error} is missing.") from None
    except (InvalidInput, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error}.") from None
    return schedule


def list_schedulers() -> list[str]:
    """The names of the schedulers that ship with the package."""
    return sorted(path.stem for path in _DATA.glob("*.json"))


def made_for(mpc: MPC, profile: str) -> dict[str, Any]:
    """Return the scope of a schedule for its file: car, profile, controller and kernel version."""
    described = mpc.describe()
    return {
        "car": car_of(mpc.model) or mpc.model.name,
        "profile": load_profile(profile).name,
        "controller": {
            "kind": "MPC",
            "model": mpc.kind_of_model,
            **{key: described[key] for key in ("moves", "period", "preview")},
        },
        "kernels": kernels_hash(),
    }


def _path(name_or_path: str | os.PathLike[str]) -> Path:
    path = Path(name_or_path)
    if not isinstance(name_or_path, str) or path.suffix == ".json" or len(path.parts) != 1:
        return path
    path = _DATA / f"{name_or_path}.json"
    if not path.exists():
        raise UnknownName(
            f"no scheduler is named {name_or_path!r}. {did_you_mean(name_or_path, list_schedulers())} "
            "A file is given by its .json path."
        )
    return path
