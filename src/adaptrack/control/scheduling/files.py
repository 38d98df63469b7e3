"""Schedules as files: one JSON document with a checksum, read back to the bit."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput, StorageError, UnknownName, did_you_mean
from adaptrack.base.files import SHIPPED, write_atomically
from adaptrack.control.controllers import MPC, Tuning
from adaptrack.control.controllers.made_for import car_of
from adaptrack.control.scheduling.functions import Table, load_function, save_function
from adaptrack.control.scheduling.guard import Guard, StabilityMap
from adaptrack.control.scheduling.schedule import Entry, Schedule
from adaptrack.scenario.profile import load_profile

FORMAT, VERSION = "adaptrack-scheduler", 2
_DATA = SHIPPED / "schedulers"


def save_scheduler(schedule: Schedule, path: str | os.PathLike[str]) -> None:
    """Write a schedule as one JSON file that `load_scheduler` reads back to the bit; it is then called as the file is.

    Raises
    ------
    InvalidInput
        When its provenance or `made_for` holds what JSON cannot.
    StorageError
        When the file cannot be written; an older one at `path` is then untouched.
    """
    content = _encode(replace(schedule, name=Path(path).stem))
    try:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"schedule {schedule.name!r}: its provenance and made_for must be text and finite numbers: {error}."
        ) from None
    digest = hashlib.sha256(text.encode()).hexdigest()
    file = {"format": FORMAT, "version": VERSION, "sha256": digest, "content": content}
    write_atomically(path, (json.dumps(file, separators=(",", ":")) + "\n").encode())


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
    content = _read(path)
    try:
        schedule = replace(_decode(content), name=path.stem)
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
    """What a schedule is made for, to stand in its file: car, profile, controller, and the kernels' version."""
    from adaptrack.core.library import kernels_hash

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


def _read(path: Path) -> Any:
    """The content of a scheduler's file, its checksum compared."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # not UTF-8, or a path that cannot be
        raise StorageError(f"{path}: cannot be read: {error}.") from None
    try:
        file = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: not a scheduler file, or damaged: {error}. Train or copy it again.") from None
    if not isinstance(file, dict) or file.get("format") != FORMAT:
        raise StorageError(f"{path}: not a scheduler file: its format is not {FORMAT!r}.")
    if file.get("version") != VERSION:
        raise StorageError(
            f"{path}: version {file.get('version')!r} of the scheduler format; this program reads {VERSION}. "
            "Train it again, or use the version of adaptrack that wrote it."
        )
    content = file.get("content")
    try:
        digest = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    except RecursionError:
        raise StorageError(f"{path}: not a scheduler file: its content is nested too deeply.") from None
    if digest != file.get("sha256"):
        raise StorageError(f"{path}: damaged: its content does not match its checksum. Train or copy it again.")
    return content


def _encode(schedule: Schedule) -> dict[str, Any]:
    entries = {name: schedule.tuning[name] for name in schedule.entries}
    return {
        "name": schedule.name,
        "made_for": dict(schedule.made_for),
        "inputs": list(schedule.inputs),
        "domain": schedule.domain.tolist(),
        "entries": [
            {"name": name, "low": e.low, "high": e.high, "log10": e.log10, "function": save_function(e.function)}
            for name, e in entries.items()
        ],
        "guard": None if schedule.guard is None else _encode_guard(schedule.guard),
        "provenance": dict(schedule.provenance),
    }


def _encode_guard(guard: Guard) -> dict[str, Any]:
    stability = guard.stability
    return {
        "fallback": guard.fallback.as_array().tolist(),
        "rates": list(guard.rates),
        "slack": guard.slack,
        "hold": guard.hold,
        "offset_limit": guard.offset_limit,
        "stability": stability and {"limit": stability.limit, "table": save_function(stability.table)},
    }


def _decode(content: Mapping[str, Any]) -> Schedule:
    entries = {
        each["name"]: Entry(load_function(each["function"]), each["low"], each["high"], each["log10"])
        for each in content["entries"]
    }
    if len(entries) != len(content["entries"]):
        raise InvalidInput("two entries have the same name")
    return Schedule(
        inputs=tuple(content["inputs"]),
        domain=np.array(content["domain"], float),
        tuning=entries,
        guard=None if content["guard"] is None else _decode_guard(content["guard"]),
        name=content["name"],
        provenance=content["provenance"],
        made_for=content["made_for"],
        entries=tuple(entries),
    )


def _decode_guard(saved: Mapping[str, Any]) -> Guard:
    Np, Nc, Q, R = saved["fallback"]
    stability = saved["stability"]
    if stability is not None:
        table = load_function(stability["table"])
        if not isinstance(table, Table):
            raise InvalidInput("the guard's stability map is no table")
        stability = StabilityMap(table, stability["limit"])
    return Guard(
        Tuning(int(Np), int(Nc), Q, R), tuple(saved["rates"]), saved["slack"], saved["hold"], stability,
        saved["offset_limit"],
    )  # fmt: skip
