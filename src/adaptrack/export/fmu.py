"""A car of the simulated world, or a controller, as a Functional Mock-up Unit (FMI 2.0 and 3.0, co-simulation).

What lies in it: the description, a shared library for each platform, the constants of the unit, its C sources. All FMUs
share library and sources; what tells one from another are its description and its constants.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Bound, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import write_atomically
from adaptrack.cars.plant import Plant
from adaptrack.control.controllers import Controller
from adaptrack.control.following import Following
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.world import Driver
from adaptrack.export import fmu_build
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.memory import CACHE_LINE_WORDS, Member, file_of, members_of
from adaptrack.export.units import (
    CONSTANT_VALUE,
    DEFAULT_TRAJECTORY_POINTS,
    ELEMENT,
    INPUT_VALUE,
    PARAMETER,
    REAL,
    TRUTH,
    WHOLE_VALUE,
    TrajectoryPoints,
    Unit,
    UnitValue,
    car_unit,
    controller_unit,
)
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import Profile

VERSIONS = ("2.0", "3.0")
_BASE_UNITS = {"1": {}, "s": {"s": 1}, "m": {"m": 1}, "rad": {"rad": 1}, "N": {"kg": 1, "m": 1, "s": -2}}
_TYPES = {"2.0": {REAL: "Real", WHOLE_VALUE: "Integer", TRUTH: "Boolean"},
          "3.0": {REAL: "Float64", WHOLE_VALUE: "Int64", TRUTH: "Boolean"}}  # fmt: skip
_LARGEST_INTEGER = 2.0**31 - 1
_DATE = (1980, 1, 1, 0, 0, 0)
"""Of the files in an archive, so that the same unit gives the same bytes."""


@checked
def export_fmu(
    part: Plant | Controller,
    path: str | os.PathLike[str],
    route: Scenario | RoadDrive | None = None,
    *,
    version: Literal["2.0", "3.0"] = "3.0",
    platforms: Sequence[str] = (),
    profile: str | Profile = "road",
    driver: Driver | SpeedControl | None = None,
    period: Positive | None = None,
    furthest: Annotated[Bound, "m"] = 10.0,
    following: Following | None = None,
    trajectory_points: TrajectoryPoints = DEFAULT_TRAJECTORY_POINTS,
) -> Path:
    """Write a car of the simulated world, or a controller with its tracker, as an FMU; its path.

    part: a plant, or a controller that is compiled ahead of time; route: of a car where it starts, and the road from
    which its offset counts; of a controller the road that it follows, with its plan; version: of the interface;
    platforms: those that it has a binary for, of `fmu_build.PLATFORMS`, by default this one; profile,
    period: of a car, as for `simulate`; period: by default the profile's; driver: of a car, as for `simulate`: with a
    `SpeedControl` its inputs ``force`` and ``hold`` move it; of a controller: a `SpeedControl` that it runs;
    furthest: of a controller, m, from the path, beyond which a status says so; following: of a controller how it
    follows a planner's trajectories, which are inputs then, of at most `trajectory_points` points; it needs no route.

    Raises
    ------
    InvalidInput
        When it cannot be exported, or a binary cannot be compiled.
    StorageError
        When the file cannot be written.
    """
    if isinstance(part, Plant):
        unit = car_unit(part, route, profile=profile, driver=driver, period=period)
        return write_fmu(unit, path, version, platforms)
    if not (isinstance(route, RoadDrive) or (route is None and following is not None)):
        raise InvalidInput("export_fmu: route: a controller follows a road: give a RoadDrive.")
    road, plan = (None, None) if route is None else (route.road, route.plan)
    speed: Any = driver  # a `Driver` is a part of a simulated car: `controller_unit` refuses it
    unit = controller_unit(
        part, road, plan, furthest=furthest, speed=speed, following=following, trajectory_points=trajectory_points
    )
    return write_fmu(unit, path, version, platforms)


@checked
def write_fmu(
    unit: Unit,
    path: str | os.PathLike[str],
    version: Literal["2.0", "3.0"] = "3.0",
    platforms: Sequence[str] = (),
) -> Path:
    """Write a unit as an FMU; its path. platforms: as of `export_fmu`.

    Raises InvalidInput when the path does not end in .fmu, the unit holds a function that is none of the package's, or
    a binary cannot be compiled, and StorageError when the file cannot be written.
    """
    path = Path(path)
    if path.suffix != ".fmu":
        raise InvalidInput(f"{path}: must end in .fmu.")
    content = constants(unit)
    token = f"{{{zlib.crc32(content):08x}}}"
    name = f"adaptrack_{unit.name}"
    files = {
        "modelDescription.xml": description(unit, token, version),
        "resources/constants.bin": content,
        **dict(_binaries(name, version, platforms)),
        **{f"sources/{source}": text.encode() for source, text in fmu_build.sources().items()},
        **({"sources/buildDescription.xml": build_description(name)} if version == "3.0" else {}),
        "documentation/index.html": _page(unit).encode(),
        "documentation/licenses/license.txt": fmu_build.LICENSE.read_bytes(),
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for place, file in files.items():
            entry = zipfile.ZipInfo(place, _DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o755 << 16
            archive.writestr(entry, file)
    write_atomically(path, buffer.getvalue())
    return path


def _binaries(name: str, version: str, platforms: Sequence[str]) -> Iterator[tuple[str, bytes]]:
    """Places and contents of the shared libraries."""
    for platform in dict.fromkeys(platforms or (fmu_build.own_platform(),)):
        content, chosen = fmu_build.binary(platform), fmu_build.PLATFORMS[platform]
        yield f"binaries/{chosen.folders[VERSIONS.index(version)]}/{name}.{chosen.ending}", content


# -- the constants ----------------------------------------------------------------------------------------------------
def constants(unit: Unit) -> bytes:
    """Return the file of the constants of a unit: its record with all arrays, as the image of a memory.

    The library of FMUs holds every unit, and sizes depend on the road, so an FMU cannot have structs as the export to C
    does. The file (`memory.file_of`) holds counts, the places of addresses, then the words of the memory: the record as
    `core.kernel.Resident` lays it, the arrays that do not change, and all others, which a saved state holds. It names a
    kernel by its place in `fmu_build.UNIT_MEMBERS`. Raises InvalidInput when kernels are interpreted, or the record has
    a function that is none of the package's.
    """
    words: list[NDArray[np.uint64]] = []
    arrays: list[tuple[int, Member]] = []
    links: list[tuple[int, str]] = []
    size = 0
    for member in members_of(unit.record):
        arrays += [(size, member)] if member.is_array else []
        links += [(size, member.kernel)] if member.kernel else []
        words.append(np.array((0, *member.values.shape), np.uint64) if member.is_array else member.words)
        size += words[-1].size
    unknown = sorted({kernel for _, kernel in links} - set(fmu_build.UNIT_MEMBERS))
    if unknown:
        raise InvalidInput(
            f"export fmu: {', '.join(unknown)}: not among the kernels of an FMU; a plant is single-track or dual-track."
        )
    arrays.sort(key=lambda array: not array[1].is_among(unit.constants))
    places, state = list[int](), size
    for word, member in arrays:
        gap = -size % CACHE_LINE_WORDS
        words += [np.zeros(gap, np.uint64), member.words]
        places += [word | (size + gap) << 32] if member.values.size else []
        size += gap + words[-1].size
        state = size if member.is_among(unit.constants) else state
    fixes = [*places, *(word | fmu_build.UNIT_MEMBERS.index(kernel) << 32 for word, kernel in links)]
    head = np.array([size, state, len(places), len(links), *fixes], np.uint64)
    return file_of(fmu_build.unit_number(type(unit.record).__name__), np.concatenate([head, *words]))


# -- the description --------------------------------------------------------------------------------------------------
def description(unit: Unit, token: str, version: str) -> bytes:
    """``modelDescription.xml``, after the schema of a version."""
    from adaptrack import __version__

    second = version == "2.0"
    known_by = "guid" if second else "instantiationToken"
    root = ET.Element("fmiModelDescription", {
        "fmiVersion": version, "modelName": f"adaptrack_{unit.name}", known_by: token, "description": unit.title,
        "generationTool": f"adaptrack {__version__}", "variableNamingConvention": "flat",
    })  # fmt: skip
    states = "canGetAndSetFMUstate" if second else "canGetAndSetFMUState"
    serialised = "canSerializeFMUstate" if second else "canSerializeFMUState"
    names = {"modelIdentifier": f"adaptrack_{unit.name}", "canHandleVariableCommunicationStepSize": "false",
             states: "true", serialised: "true"}  # fmt: skip
    if not second:
        names["fixedInternalStepSize"] = repr(unit.period)
    interface = ET.SubElement(root, "CoSimulation", names)
    if second:
        _source_files(ET.SubElement(interface, "SourceFiles"), "File")
    _units(ET.SubElement(root, "UnitDefinitions"), unit)
    categories = ET.SubElement(root, "LogCategories")
    for category in ("logStatusError", *(("logStatusWarning",) if unit.follows else ())):
        ET.SubElement(categories, "Category", {"name": category})
    ET.SubElement(root, "DefaultExperiment", {"startTime": "0.0", "stopTime": "10.0", "stepSize": repr(unit.period)})
    variables = ET.SubElement(root, "ModelVariables")
    described = [i for i, value in enumerate(unit.values) if second or not value.kind & ELEMENT]
    for i, end in zip(described, [*described[1:], len(unit.values)], strict=True):
        _variable(variables, i, unit.values[i], version, end - i)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [i for i in described if unit.values[i].role == 0]
    if second:
        for kind, attributes in (("Outputs", {"dependencies": ""}), ("InitialUnknowns", {})):
            listed = ET.SubElement(structure, kind)
            for i in outputs:
                ET.SubElement(listed, "Unknown", {"index": str(i + 1), **attributes})
    else:
        for kind, attributes in (("Output", {"dependencies": ""}), ("InitialUnknown", {})):
            for i in outputs:
                ET.SubElement(structure, kind, {"valueReference": str(i), **attributes})
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def build_description(name: str) -> bytes:
    """``buildDescription.xml`` of version 3.0: the sources of a unit, and the options that keep its bits."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    options = {"language": "C99", "compilerOptions": " ".join(EXACT_OPTIONS)}
    _source_files(ET.SubElement(configuration, "SourceFileSet", options), "SourceFile")
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _source_files(parent: ET.Element, kind: str) -> None:
    for source in sorted(fmu_build.sources()):
        if source.endswith(".c"):
            ET.SubElement(parent, kind, {"name": source})


def _units(definitions: ET.Element, unit: Unit) -> None:
    for name in sorted({value.unit for value in unit.values if value.unit}):
        element = ET.SubElement(definitions, "Unit", {"name": name})
        ET.SubElement(element, "BaseUnit", {base: str(power) for base, power in _base_units(name).items()})


def _base_units(unit: str) -> dict[str, int]:
    """Return the powers of the base units in a unit such as "m/s^2" or "N m"."""
    powers = Counter[str]()
    for sign, factors in zip((1, -1), unit.split("/"), strict=False):
        for factor in factors.split():
            name, _, power = factor.partition("^")
            for base, exponent in _BASE_UNITS[name].items():
                powers[base] += sign * int(power or 1) * exponent
    return powers


def _variable(variables: ET.Element, reference: int, value: UnitValue, version: str, length: int) -> None:
    """One variable. What is an output does not depend on an input of the same instant.

    length: numbers of the variable if its name has an index; in FMI 2.0, which has no arrays, each is a variable.
    """
    second = version == "2.0"
    causality, variability = {
        CONSTANT_VALUE: ("independent", "continuous") if reference == 0 else ("local", "constant"),
        PARAMETER: ("parameter", "fixed"), INPUT_VALUE: ("input", "discrete"), 0: ("output", "discrete"),
    }[value.role]  # fmt: skip
    common = {"name": value.name, "valueReference": str(reference), "causality": causality, "variability": variability}
    if value.description:
        common["description"] = value.description
    attributes: dict[str, str] = {"unit": value.unit} if value.unit else {}
    if value.type != TRUTH and value.role in (PARAMETER, INPUT_VALUE):
        limits = {
            "min": value.least,
            "max": min(value.most, _LARGEST_INTEGER) if second and value.type == WHOLE_VALUE else value.most,
        }
        attributes |= {name: _text(limit, value) for name, limit in limits.items() if math.isfinite(limit)}
    if value.role in (PARAMETER, INPUT_VALUE) or causality == "local":
        attributes["start"] = _text(value.start, value)
        if causality == "local":
            common["initial"] = "exact"
    elif causality == "output":
        common["initial"] = "calculated"
    kind = _TYPES[version][value.type]
    if second:
        ET.SubElement(ET.SubElement(variables, "ScalarVariable", common), kind, attributes)
    else:
        name, is_array, _ = value.name.partition("[")
        variable = ET.SubElement(variables, kind, common | attributes | {"name": name})
        if is_array:
            if "start" in attributes:
                variable.set("start", " ".join([attributes["start"]] * length))
            ET.SubElement(variable, "Dimension", {"start": str(length)})


def _text(number: float, value: UnitValue) -> str:
    if value.type == TRUTH:
        return "true" if number else "false"
    return str(int(number)) if value.type == WHOLE_VALUE else repr(float(number))


def _page(unit: Unit) -> str:
    """``documentation/index.html``: the values in a table."""
    from html import escape

    roles = {CONSTANT_VALUE: "constant", PARAMETER: "parameter", INPUT_VALUE: "input", 0: "output"}
    rows = "\n".join(
        f"<tr><td>{value.name}</td><td>{roles[value.role]}</td><td>{escape(value.unit)}</td>"
        f"<td>{escape(value.description)}</td></tr>"
        for value in unit.values
        if not value.kind & ELEMENT
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>adaptrack</title></head><body>\n'
        f"<h1>{escape(unit.title)}</h1>\n<p>A step is {unit.period:g} s. SI units, angles in rad; x forward, y left, "
        "angles positive to the left (ISO 8855).</p>\n"
        f"<table>\n<tr><th>name</th><th>is</th><th>unit</th><th>means</th></tr>\n{rows}\n</table></body></html>\n"
    )
