"""Roads from OpenDRIVE files: the plan view of one road, its lane offset, the middle of one of its lanes.

Read are <planView> (line, arc, spiral, poly3, paramPoly3), <laneOffset>, the widths of lanes, <superelevation> and the
speed limits of <type>, of ASAM OpenDRIVE 1.4 to 1.8 (https://publications.pages.asam.net, OpenDRIVE, chapters 9 to 11).
The shape of the line is exact. Height, junctions and links between roads are not read.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import is_number, printable, read_bytes
from adaptrack.road.along import Along, alongs
from adaptrack.road.road import GAP, KINK, Road
from adaptrack.road.segments import Arc, Array, Clothoid, Cubic, Line, Pose, Segment
from adaptrack.road.table import Pieces, beside, joined, placed, tabulate

Element = ElementTree.Element

SPEED_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
SAMPLES = 2.0
"""m, between the samples of widths and bank, between which straight lines are drawn."""
DRIVEN = ("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional")
"""Types of lanes that count to the width of a road."""
STATED = 1e-3
"""m, from which on a difference between the stated and the true length of an element is reported."""


def read_opendrive(
    path: str | os.PathLike[str], road: str | int | None = None, lane: int | None = None, **along: Any
) -> Road:
    """The centre line of a road of an OpenDRIVE file, or of one of its lanes.

    Parameters
    ----------
    road : str or int, optional
        Its id; may be left out where the file has one road only.
    lane : int, optional
        Id of a lane to the right (negative, driven in the direction of the road), present all along it. Without it
        the line is the reference line moved by <laneOffset>, and the widths are those of the driving lanes beside it.
    **along
        As in `Road.from_segments`, in place of what the file says.

    Notes
    -----
    A <poly3> is read as the cubic v(u), u from 0 to where the arc is as long as the file says; a <paramPoly3> over its
    range of p, whatever length the file states, and stations s of the file are stretched to it.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not OpenDRIVE, has no such road or lane, or a shape that cannot be read; with the remedy.
    """
    where = os.fspath(path)
    element = _road(where, _root(where, read_bytes(path)), road)
    where = f"{where}, road {element.get('id')!r}"
    try:
        return _read(where, element, lane, along)
    except ConfigError:
        raise
    except InvalidInput as error:
        raise ConfigError(f"{where}: {error}") from None


def _root(where: str, content: bytes) -> Element:
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an encoding that nobody knows
        raise ConfigError(f"{where}: not XML: {error}.") from error
    for element in root.iter():  # files of version 1.6 on may name their namespace
        element.tag = str(element.tag).rpartition("}")[2]
    if root.tag != "OpenDRIVE":
        raise ConfigError(f"{where}: <{printable(root.tag)}>, where <OpenDRIVE> is expected.")
    return root


def _road(where: str, root: Element, wanted: str | int | None) -> Element:
    roads = {str(element.get("id")): element for element in root.findall("road")}
    if not roads:
        raise ConfigError(f"{where}: there is no <road> in it.")
    if wanted is None:
        if len(roads) > 1:
            stated = {name: _stated_length(element) for name, element in roads.items()}
            longest = sorted(stated, key=lambda name: -stated[name])[:8]
            named = ", ".join(f"{printable(name)!r} ({stated[name]:.0f} m)" for name in longest)
            raise ConfigError(f"{where}: {len(roads)} roads; say which one by its id. The longest: {named}.")
        return next(iter(roads.values()))
    if str(wanted) not in roads:
        raise ConfigError(f"{where}: no road has the id {str(wanted)!r}. {did_you_mean(str(wanted), roads)}")
    return roads[str(wanted)]


def _stated_length(element: Element) -> float:
    """m; 0 where a road does not say it as a number."""
    text = element.get("length", "")
    length = float(text) if is_number(text) else 0.0
    return length if math.isfinite(length) else 0.0


def _read(where: str, element: Element, lane: int | None, along: dict[str, Any]) -> Road:
    view = element.find("planView")
    shapes = [] if view is None else sorted(view.findall("geometry"), key=lambda shape: _number(where, shape, "s"))
    if not shapes:
        raise ConfigError(f"{where}: it has no <planView> with a <geometry>.")
    segments = [_segment(where, shape) for shape in shapes]
    tables = tabulate(segments)
    poses = [Pose(*(_number(where, shape, key) for key in ("x", "y", "hdg"))) for shape in shapes]
    origin = poses[0]
    near = [Pose(pose.x - origin.x, pose.y - origin.y, pose.heading) for pose in poses]  # keeps digits of far places
    reference = joined([placed(table, pose) for table, pose in zip(tables, near, strict=True)])
    stations = _Stations(where, shapes, tables)
    lanes = _Lanes(where, element, stations)
    base = lanes.offset() if lane is None else lanes.middle(lane)
    table = reference if base is None else beside(reference, *base)
    values = {**lanes.widths(lane), **_speed_limit(where, element, stations), **_bank(where, element, stations)}
    moved = {name: _moved(value, reference, table) for name, value in values.items()}
    name = element.get("name") or Path(where.partition(", road ")[0]).stem
    found = {"closed": _meets_itself(table), "notes": tuple(stations.notes), **alongs(moved | along)}
    if base is None:
        laid = zip(segments, poses, strict=True)
        found["elements"] = tuple(segment.replace(start=tuple(pose)) for segment, pose in laid)
    return Road(name=printable(name), table=placed(table, Pose(origin.x, origin.y, 0.0)), **found)


def _meets_itself(table: Pieces) -> bool:
    """Whether the line ends where, and as, it begins."""
    first, last = table.at(0.0), table.at(table.length)
    turn = float(last.heading - first.heading) / (2.0 * math.pi)
    apart = math.hypot(float(last.x - first.x), float(last.y - first.y))
    return apart <= GAP and abs(turn - round(turn)) * 2.0 * math.pi <= KINK


def _moved(along: Along, reference: Pieces, table: Pieces) -> Along:
    """A quantity over the arc length of the reference line, over that of a line beside it."""
    if table is reference or len(along.s) == 1:
        return along
    base = np.linspace(0.0, reference.length, max(2, math.ceil(reference.length / 5.0)) + 1)
    points, own = reference.at(base), np.linspace(0.0, table.length, base.size)
    for _ in range(50):  # the foot of each point on the line beside
        beside_ = table.at(np.clip(own, 0.0, table.length))
        step = (points.x - beside_.x) * np.cos(beside_.heading) + (points.y - beside_.y) * np.sin(beside_.heading)
        own = np.clip(own + np.clip(step, -5.0, 5.0), 0.0, table.length)
        if np.abs(step).max() < 1e-6:
            break
    own = np.maximum.accumulate(own)
    s = np.interp(along.s, base, own)
    s = np.maximum.accumulate(s + 1e-9 * np.arange(s.size))
    return along.replace(s=tuple(s.tolist()))


# -- shapes -----------------------------------------------------------------------------------------------------------
def _segment(where: str, shape: Element) -> Segment:
    length = _number(where, shape, "length")
    kind = next((child for child in shape if child.tag in _READERS), None)
    if kind is None:
        found = ", ".join(f"<{child.tag}>" for child in shape) or "nothing"
        raise ConfigError(
            f"{where}: <geometry> at s = {shape.get('s')} holds {printable(found)}; known: {', '.join(_READERS)}."
        )
    return _READERS[kind.tag](where, kind, length)


def _line(where: str, kind: Element, length: float) -> Segment:
    return Line(length=length)


def _arc(where: str, kind: Element, length: float) -> Segment:
    return Arc(length=length, curvature=_number(where, kind, "curvature"))


def _spiral(where: str, kind: Element, length: float) -> Segment:
    start, end = (_number(where, kind, key) for key in ("curvStart", "curvEnd"))
    return Clothoid(length=length, start_curvature=start, end_curvature=end)


def _param_poly3(where: str, kind: Element, length: float) -> Segment:
    span = kind.get("pRange", "normalized")
    if span not in ("normalized", "arcLength"):
        raise ConfigError(f"{where}: <paramPoly3 pRange={span!r}>: must be 'normalized' or 'arcLength'.")
    x, y = (tuple(_number(where, kind, key + axis) for key in "abcd") for axis in "UV")
    return Cubic(x=x, y=y, end=1.0 if span == "normalized" else length)  # type: ignore[arg-type]


def _poly3(where: str, kind: Element, length: float) -> Segment:
    """v(u) = a + b u + c u^2 + d u^3; u ends where the arc is `length` long."""
    a, b, c, d = (_number(where, kind, key) for key in "abcd")
    nodes, weights = np.polynomial.legendre.leggauss(16)
    end = length
    for _ in range(50):
        panels = np.linspace(0.0, end, 33)
        u = 0.5 * (panels[:-1] + panels[1:])[:, np.newaxis] + 0.5 * (end / 32.0) * nodes
        with np.errstate(over="ignore", invalid="ignore"):  # such a cubic is refused
            arc = 0.5 * (end / 32.0) * float((np.hypot(1.0, b + u * (2.0 * c + 3.0 * d * u)) @ weights).sum())
        step = (length - arc) / math.hypot(1.0, b + end * (2.0 * c + 3.0 * d * end))
        end += step
        if not abs(step) >= 1e-13 * length:
            break
    return Cubic(x=(0.0, 1.0, 0.0, 0.0), y=(a, b, c, d), end=end)


_READERS = {"line": _line, "arc": _arc, "spiral": _spiral, "poly3": _poly3, "paramPoly3": _param_poly3}


class _Stations:
    """The stations s of the file, as arc lengths of the reference line."""

    def __init__(self, where: str, shapes: Sequence[Element], tables: Sequence[Pieces]) -> None:
        stated = [_number(where, shape, "length") for shape in shapes]
        first = _number(where, shapes[0], "s")
        true = [table.length for table in tables]
        self._file = first + np.concatenate([[0.0], np.cumsum(stated)])
        self._own = np.concatenate([[0.0], np.cumsum(true)])
        off = np.abs(np.subtract(stated, true))
        self.notes: list[str] = []
        if off.max() > STATED:
            k = int(off.argmax())
            self.notes.append(
                f"the element at s = {self._file[k]:.2f} m is {true[k]:.4f} m long, the file says {stated[k]:.4f}"
            )
        self.length = float(self._own[-1])

    def of(self, s: float) -> float:
        """The arc length at a station."""
        return float(np.interp(s, self._file, self._own))


# -- lanes ------------------------------------------------------------------------------------------------------------
Laws = tuple[list[float], Array]
"""Where cubics in the arc length begin (m), and their coefficients (m, 4)."""


class _Lanes:
    """<laneOffset> and the widths of the lanes, as piecewise cubics over the arc length of the reference line."""

    def __init__(self, where: str, element: Element, stations: _Stations) -> None:
        self._where, self._stations = where, stations
        lanes = element.find("lanes")
        self._offset = [] if lanes is None else self._laws(lanes.findall("laneOffset"), 0.0)
        self._sections: list[tuple[float, dict[int, tuple[str, list[tuple[float, Array]] | None]]]] = []
        for section in [] if lanes is None else lanes.findall("laneSection"):
            s = _number(where, section, "s")
            found = {}
            for lane in section.iter("lane"):
                found[int(_number(where, lane, "id"))] = (
                    lane.get("type", ""),
                    None if lane.find("border") is not None else self._laws(lane.findall("width"), s),
                )
            self._sections.append((stations.of(s), found))

    def _laws(self, elements: Iterable[Element], s: float) -> list[tuple[float, Array]]:
        """(arc length, coefficients) of cubics whose elements count s or sOffset."""
        found = []
        for element in elements:
            station = (
                s + _number(self._where, element, "sOffset")
                if element.get("sOffset")
                else _number(self._where, element, "s")
            )
            found.append((self._stations.of(station), np.array([_number(self._where, element, key) for key in "abcd"])))
        return sorted(found, key=lambda law: law[0])

    def offset(self) -> Laws | None:
        """The distance of the lane reference from the reference line; None where it is always 0."""
        if not any(law.any() for _, law in self._offset):
            return None
        return self._combined([(1.0, self._offset)])

    def middle(self, lane: int) -> Laws:
        """The distance of the middle of a lane from the reference line.

        Raises
        ------
        ConfigError
            When there is no such lane, not all along the road, or one that runs against it.
        """
        if lane >= 0:
            raise ConfigError(f"{self._where}: lane {lane}: only lanes to the right (-1, -2, ...) run with the road.")
        summed: list[tuple[float, list[tuple[float, Array]]]] = [(1.0, self._offset)]
        for inner in range(-1, lane - 1, -1):
            summed.append((-0.5 if inner == lane else -1.0, self._width(inner)))
        return self._combined(summed)

    def _width(self, lane: int) -> list[tuple[float, Array]]:
        laws: list[tuple[float, Array]] = []
        for start, lanes in self._sections:
            if lane not in lanes:
                known = ", ".join(str(each) for each in sorted(lanes))
                raise ConfigError(f"{self._where}: at s = {start:.2f} m there is no lane {lane}; there are {known}.")
            laws += self._of_lane(lane, lanes, start)
        if not laws:
            raise ConfigError(f"{self._where}: it has no <laneSection>, so no lane {lane}.")
        return laws

    def _of_lane(self, lane: int, lanes: dict[int, Any], start: float) -> list[tuple[float, Array]]:
        laws = lanes[lane][1]
        if laws is None:
            raise ConfigError(f"{self._where}: lane {lane} has a <border>, which is not read; give it a <width>.")
        return laws or [(start, np.zeros(4))]

    def _combined(self, summed: Sequence[tuple[float, list[tuple[float, Array]]]]) -> Laws:
        """The weighted sum of piecewise cubics."""
        starts = sorted({0.0, *(s for _, laws in summed for s, _ in laws)})
        starts = [s for k, s in enumerate(starts) if k == 0 or s > starts[k - 1] + 1e-9]
        rows = np.zeros((len(starts), 4))
        for weight, laws in summed:
            for row, s in enumerate(starts):
                before = [law for law in laws if law[0] <= s + 1e-9]
                if before:
                    begin, coefficients = before[-1]
                    rows[row] += weight * _shifted(coefficients, s - begin)
        return starts, rows

    def widths(self, lane: int | None) -> dict[str, Along]:
        """Width to the left and to the right of the line, where the file has lanes."""
        if not any(lanes for _, lanes in self._sections):
            return {}
        if lane is not None:
            half = self._sampled([(0.5, self._width(lane))])
            return {"width_left": half, "width_right": half}
        found = {}
        for name, side in (("width_left", 1), ("width_right", -1)):
            s, values = [], []
            for k, (start, lanes) in enumerate(self._sections):
                end = self._sections[k + 1][0] if k + 1 < len(self._sections) else self._stations.length
                ids = [each for each, (kind, _) in lanes.items() if each * side > 0 and kind in DRIVEN]
                along = self._sampled([(1.0, self._of_lane(each, lanes, start)) for each in ids], start, end)
                s += list(along.s)
                values += list(along.value)
            found[name] = _increasing(s, np.maximum(values, 0.01))
        return found

    def _sampled(
        self, summed: Sequence[tuple[float, list[tuple[float, Array]]]], start: float = 0.0, end: float | None = None
    ) -> Along:
        end = self._stations.length if end is None else end
        starts, rows = self._combined(summed)
        s = np.linspace(start, end, max(1, math.ceil((end - start) / SAMPLES)) + 1)
        row = np.maximum(np.searchsorted(starts, s, "right") - 1, 0)
        b = s - np.array(starts)[row]
        c = rows[row].T
        return _increasing(s, c[0] + b * (c[1] + b * (c[2] + b * c[3])))


def _increasing(s: Any, values: Any) -> Along:
    """Samples of which those at one place are moved apart by a micrometre: a step."""
    s = np.maximum.accumulate(np.asarray(s, dtype=np.float64))
    for k in range(1, s.size):
        s[k] = max(s[k], s[k - 1] + 1e-6)
    return Along.through(s, values)


def _shifted(c: Array, b: float) -> Array:
    """The coefficients of a cubic whose argument counts from b."""
    slope = c[1] + b * (2.0 * c[2] + 3.0 * b * c[3])
    return np.array([c[0] + b * (c[1] + b * (c[2] + b * c[3])), slope, c[2] + 3.0 * b * c[3], c[3]])


# -- what else lies along ---------------------------------------------------------------------------------------------
def _speed_limit(where: str, element: Element, stations: _Stations) -> dict[str, Along]:
    s, values = [], []
    for kind in element.findall("type"):
        speed = kind.find("speed")
        text = "" if speed is None else speed.get("max", "")
        if speed is not None and text not in ("", "no limit", "undefined"):
            unit = speed.get("unit", "m/s")
            if unit not in SPEED_UNITS:
                raise ConfigError(f"{where}: <speed unit={unit!r}>: must be one of {', '.join(SPEED_UNITS)}.")
            limit = _number(where, speed, "max") * SPEED_UNITS[unit]
            s.append(stations.of(_number(where, kind, "s")))
            values.append(limit if limit > 0.0 else 1000.0)
        elif s:  # the limit ends
            s.append(stations.of(_number(where, kind, "s")))
            values.append(1000.0)
    return {"speed_limit": Along.through(np.array(s), np.array(values), "steps")} if s else {}


def _bank(where: str, element: Element, stations: _Stations) -> dict[str, Along]:
    """A superelevation, the roll about the line, is positive where the road falls to the right; a bank, to the left."""
    profile = element.find("lateralProfile")
    found = [] if profile is None else profile.findall("superelevation")
    laws = [(stations.of(_number(where, law, "s")), [_number(where, law, key) for key in "abcd"]) for law in found]
    if not any(any(law) for _, law in laws):
        return {}
    s, values = [], []
    for k, (start, c) in enumerate(laws):
        end = laws[k + 1][0] if k + 1 < len(laws) else stations.length
        b = np.linspace(0.0, end - start, max(1, math.ceil((end - start) / SAMPLES)) + 1)
        s += (start + b).tolist()
        values += (-(c[0] + b * (c[1] + b * (c[2] + b * c[3])))).tolist()
    return {"bank": _increasing(s, np.array(values))}


def _number(where: str, element: Element, key: str) -> float:
    text = element.get(key, "0" if key == "sOffset" else "")
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"{where}: <{printable(element.tag)} {key}={text!r}>: must be a finite number.")
    return number
