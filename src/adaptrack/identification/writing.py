"""The car file of an identification."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from adaptrack.base.files import dump_toml, write_atomically
from adaptrack.cars.vehicle import Vehicle
from adaptrack.identification.from_log import FACTORS

if TYPE_CHECKING:
    from adaptrack.identification.from_log import Identification


def write_car(found: Identification, path: str | os.PathLike[str]) -> None:
    """Write a car as TOML; the new one has the file's name. Intervals stand in ``[known_within]`` and in comments.

    Its tyre is written beside it (``-tyre`` behind the name): the plant then has the stiffness that was identified.

    Raises
    ------
    StorageError
        When the file cannot be written.
    """
    known, path = found.known_within(), Path(path)
    beside = path.with_name(f"{path.stem}-tyre.toml")
    said = f"{found.tyre_curve.name}, scaled to the axles of {path.stem}"
    found.tyre.replace(name=beside.stem, description=said).to_toml(beside)
    car = found.car.replace(
        name=path.stem, description="Identified from a log", tyre=str(beside), known_within=known,
        estimated=tuple(name for name in found.car.estimated if name not in FACTORS),
    )  # fmt: skip
    values = car.model_dump() | {"tyre": beside.name}
    meanings = {name: field.description or "" for name, field in Vehicle.model_fields.items()}
    head = ["# Identified from a log; 90 % intervals:"]
    for each in found.estimates.values():
        head.append(f"# {each.name}: {each.low:.4g} to {each.high:.4g} {each.unit}")
    if found.computation:
        head.append(f"# steering.dead_time is without {found.computation:g} s of the controller's computation")
    head += [f"# {sentence}" for sentence in found.findings]
    write_atomically(path, ("\n".join(head) + "\n\n" + dump_toml(values, meanings)).encode())
