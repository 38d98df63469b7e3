"""The car file of an identification."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from adaptrack.files import dump_toml, write_atomically
from adaptrack.vehicle import Vehicle

if TYPE_CHECKING:
    from adaptrack.identification.from_log import Identification


def write_car(found: Identification, path: str | os.PathLike[str]) -> None:
    """Write a car as TOML; the new one has the file's name. What is known of each number stands in comments above.

    Raises
    ------
    StorageError
        When the file cannot be written.
    """
    car = found.car.replace(name=Path(path).stem, description="Identified from a log")
    values = car.model_dump()
    if os.sep in car.tyre or car.tyre.endswith(".toml"):
        values["tyre"] = os.path.relpath(car.tyre, Path(path).resolve().parent)
    meanings = {name: field.description or "" for name, field in Vehicle.model_fields.items()}
    head = ["# Identified from a log; 90 % intervals:"]
    for each in found.estimates.values():
        head.append(f"# {each.name}: {each.low:.4g} to {each.high:.4g} {each.unit}")
    if found.computation:
        head.append(f"# steering.dead_time is without {found.computation:g} s of the controller's computation")
    head += [f"# {sentence}" for sentence in found.findings]
    write_atomically(path, ("\n".join(head) + "\n\n" + dump_toml(values, meanings)).encode())
