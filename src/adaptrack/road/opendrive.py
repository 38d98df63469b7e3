"""Roads from OpenDRIVE files: the plan view of one road, its lane offset, the middle of one of its lanes.

`READ` lists the elements and attributes that are read, of ASAM OpenDRIVE 1.4 to 1.8 (https://publications.pages.asam.net,
OpenDRIVE, chapters 9 to 11); the notes of a road name all others. The reference line is exact; a line beside it is
sampled every 0.5 m.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import finite_number, printable, read_bytes
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.roads.road import X, Y
from adaptrack.road.opendrive_lanes import MAX_CLOSED_GAP, Lanes, Stations, line_at_offset, number_of
from adaptrack.road.road import MAX_JOINT_GAP, MAX_JOINT_KINK, Road
from adaptrack.road.segments import MIN_ELEMENT_LENGTH, NODES, WEIGHTS, Arc, Clothoid, Cubic, Line, Pose, Segment
from adaptrack.road.station_table import Along, alongs
from adaptrack.road.table import Pieces, joined, placed, tabulate

READ = {
    "OpenDRIVE/header": "revMajor revMinor name version date north south east west vendor",
    "OpenDRIVE/road": "name id length junction rule",
    "road/type": "s type country",
    "type/speed": "max unit",
    "road/planView": "",
    "planView/geometry": "s x y hdg length",
    "geometry/line": "",
    "geometry/arc": "curvature",
    "geometry/spiral": "curvStart curvEnd",
    "geometry/poly3": "a b c d",
    "geometry/paramPoly3": "pRange aU bU cU dU aV bV cV dV",
    "road/elevationProfile": "",
    "elevationProfile/elevation": "s a b c d",
    "road/lateralProfile": "",
    "lateralProfile/superelevation": "s a b c d",
    "lateralProfile/crossfall": "s side a b c d",
    "lateralProfile/shape": "s t a b c d",
    "road/lanes": "",
    "lanes/laneOffset": "s a b c d",
    "lanes/laneSection": "s singleSide",
    "laneSection/left": "",
    "laneSection/center": "",
    "laneSection/right": "",
    "left/lane": "id type level direction",
    "center/lane": "id type level",
    "right/lane": "id type level direction",
    "lane/link": "",
    "link/predecessor": "id",
    "link/successor": "id",
    "lane/width": "sOffset a b c d",
    "lane/speed": "sOffset max unit",
}
"""Parent and element, and the attributes of the element: those that are read, and labels that change nothing."""
SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")
"""Shapes of a <geometry>."""
STATED_LENGTH = 0.1, 1e-3
"""m, and share of it: a larger difference between the stated length of a road and that of its geometry is reported."""


def read_opendrive(
    path: str | os.PathLike[str], road: str | int | None = None, lane: int | None = None, **along: Any
) -> Road:
    """The centre line of a road of an OpenDRIVE file, or of one of its lanes.

    Parameters
    ----------
    road : str or int, optional
        Its id; may be left out where the file has one road only.
    lane : int, optional
        Id, in the first lane section that has it, of a lane that is driven in the direction of the road; its <link>
        leads to its ids in later sections. A lane that opens or closes is read where it is wide enough. Without a lane
        the line is the reference line moved by <laneOffset>, with the widths of the driving lanes on both sides and
        their lowest speed limit.
    **along
        As in `Road.from_segments`, in place of what the file says.

    Notes
    -----
    A <poly3> is read as the cubic v(u), u from 0 to where the arc is as long as the file says; a <paramPoly3> over its
    range of p, whatever length the file states, and stations s of the file are stretched to it. Gaps of 0.01 to 0.1 m
    between elements are closed by moving the elements behind them. `notes` of the road name such deviations, and the
    elements of the file that are not in `READ`.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not OpenDRIVE, has no such road or lane, or a shape that cannot be read; with the remedy.
    """
    where = os.fspath(path)
    root = _root(where, read_bytes(path))
    element = _road(where, root, road)
    where = f"{where}, road {element.get('id')!r}"
    try:
        line = _read(where, element, lane, along)
    except ConfigError:
        raise
    except InvalidInput as error:
        middle = f" The line is the middle of lane {lane}: see its <width> and the <laneOffset>."
        raise ConfigError(f"{where}: {error}{'' if lane is None else middle}") from None
    unread = dict.fromkeys(
        name for child in root if child.tag != "road" or child is element for name in _unread(root, child)
    )
    return line.replace(notes=(*line.notes, f"not read: {printable(', '.join(unread))}")) if unread else line


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


def _road(where: str, root: Element, road_id: str | int | None) -> Element:
    roads = {str(element.get("id")): element for element in root.findall("road")}
    if not roads:
        raise ConfigError(f"{where}: there is no <road> in it.")
    if road_id is None:
        if len(roads) > 1:
            stated = {name: _stated_length(element) for name, element in roads.items()}
            longest = sorted(stated, key=lambda name: -stated[name])[:8]
            examples = ", ".join(f"{printable(name)!r} ({stated[name]:.0f} m)" for name in longest)
            raise ConfigError(f"{where}: {len(roads)} roads; say which one by its id. The longest: {examples}.")
        return next(iter(roads.values()))
    if str(road_id) not in roads:
        raise ConfigError(f"{where}: no road has the id {str(road_id)!r}. {did_you_mean(str(road_id), roads)}")
    return roads[str(road_id)]


def _stated_length(element: Element) -> float:
    """m; 0 where a road does not say it as a number."""
    return finite_number(element.get("length", "")) or 0.0


def _unread(parent: Element, element: Element) -> Iterator[str]:
    """The elements (parent/element) and attributes (element@attribute) that are not in `READ`."""
    name = f"{parent.tag}/{element.tag}"
    if name not in READ:
        yield name
        return
    labels = READ[name].split()
    yield from (f"{element.tag}@{attribute}" for attribute in element.attrib if attribute not in labels)
    for child in element:
        yield from _unread(element, child)


def _read(where: str, road: Element, lane: int | None, along: dict[str, Any]) -> Road:
    shapes, notes = _shapes(where, road)
    segments = [_segment(where, shape) for shape in shapes]
    tables = tabulate(segments)
    poses = [Pose(*(number_of(where, shape, key) for key in ("x", "y", "hdg"))) for shape in shapes]
    origin = poses[0]
    near = [Pose(pose.x - origin.x, pose.y - origin.y, pose.heading) for pose in poses]  # keeps digits of far places
    reference = joined([placed(table, pose) for table, pose in zip(tables, near, strict=True)])
    stations = Stations(where, shapes, tables)
    lanes = Lanes(where, road, stations, lane)
    table = reference
    values, height_notes = lanes.along()
    if lanes.line is not None:
        table, base_s, s = line_at_offset(reference, lanes.line, lanes.extent)
        values |= {name: _per_arc_length(values[name], base_s, s) for name in ("grade",) if name in values}
        values = {name: _on_line(along, base_s, s) for name, along in values.items()}
    table, shifts = _close_gaps(table, notes)
    closed = _meets_itself(table)
    options = {"closed": closed, **alongs(values | along)}
    if lanes.line is None and not (closed and shifts.any()):
        heads = np.cumsum([0, *(len(part.pieces) for part in tables[:-1])])
        options["elements"] = tuple(
            segment.replace(start=(pose.x + shift.real, pose.y + shift.imag, pose.heading))
            for segment, pose, shift in zip(segments, poses, shifts[heads].tolist(), strict=True)
        )
    name = printable(road.get("name") or Path(where.partition(", road ")[0]).stem)
    notes = [*notes, *stations.notes, *lanes.notes, *height_notes]
    stated = _stated_length(road)
    if abs(stated - stations.length) > max(STATED_LENGTH[0], STATED_LENGTH[1] * stated):
        notes.append(f"its geometry is {stations.length:.6g} m long, the file says {stated:.6g}")
    return Road(name=name, table=placed(table, Pose(origin.x, origin.y, 0.0)), notes=tuple(notes), **options)


def _on_line(along: Along, base_s: Array, s: Array) -> Along:
    """A quantity over arc lengths of the reference line, over those (s at base_s, n,) of a line beside it."""
    inside = [place for place in along.s if base_s[0] < place < base_s[-1]]
    stations = np.array([base_s[0], *inside, base_s[-1]])
    places = np.maximum.accumulate(np.interp(stations, base_s, s) + 1e-9 * np.arange(stations.size))
    return along.replace(s=tuple(places.tolist()), value=tuple(along.at(stations).tolist()))


def _per_arc_length(slope: Along, base_s: Array, s: Array) -> Along:
    """A slope per metre of the reference line, per metre of a line (arc lengths s at base_s, n,) beside it."""
    k = np.clip(np.searchsorted(base_s, slope.s, "right") - 1, 0, base_s.size - 2)
    values = np.array(slope.value) * (base_s[k + 1] - base_s[k]) / (s[k + 1] - s[k])
    return slope.replace(value=tuple(values.tolist()))


def _shapes(where: str, road: Element) -> tuple[list[Element], list[str]]:
    """The <geometry> elements in their order, without those of length 0, and notes of these."""
    shapes = sorted(road.findall("planView/geometry"), key=lambda shape: number_of(where, shape, "s"))
    empty = [shape for shape in shapes if 0.0 <= number_of(where, shape, "length") < MIN_ELEMENT_LENGTH]
    shapes = [shape for shape in shapes if shape not in empty]
    if not shapes:
        raise ConfigError(f"{where}: it has no <planView> with a <geometry> longer than 0.")
    places = ", ".join(f"{number_of(where, shape, 's'):.2f}" for shape in empty)
    return shapes, [f"elements of length 0 are left out, at s = {places} m"] if empty else []


def _close_gaps(table: Pieces, notes: list[str]) -> tuple[Pieces, NDArray[np.complex128]]:
    """Close the gaps from `MAX_JOINT_GAP` to `MAX_CLOSED_GAP`, note them; with the shift of each piece (m, x + i y).

    The pieces behind a gap are moved. On a lap, the distance by which the end then misses the start is shared out
    among all joints.
    """
    first, last = (points.x + 1j * points.y for points in table.ends())
    gaps, lap = np.roll(first, -1) - last, _meets_itself(table, MAX_CLOSED_GAP)
    widths = portable.magnitude(gaps)
    closable = (widths > MAX_JOINT_GAP) & (widths <= MAX_CLOSED_GAP)
    closable[-1] &= lap
    shifts = -np.concatenate([[0.0], np.cumsum(np.where(closable, gaps, 0.0))[:-1]])
    if not closable.any():
        return table, shifts
    if lap:
        shifts += (gaps[-1] - shifts[-1]) * np.arange(gaps.size) / gaps.size
    widest = int(np.argmax(np.where(closable, widths, 0.0)))
    notes.append(
        f"gaps in the line are closed: {closable.sum()}, the largest {widths[widest]:.4f} m at s = "
        f"{table.start[widest + 1]:.2f} m; the line moves by up to {portable.magnitude(shifts).max():.3f} m"
    )
    pieces = table.pieces.copy()
    pieces[:, X] += shifts.real
    pieces[:, Y] += shifts.imag
    return Pieces(table.start, pieces), shifts


def _meets_itself(table: Pieces, gap: float = MAX_JOINT_GAP) -> bool:
    """Whether the line ends within `gap` (m) of its start, in the same direction."""
    first, last = table.at(0.0), table.at(table.length)
    turn = float(last.heading - first.heading) / (2.0 * math.pi)
    distance = portable.hypot(float(last.x - first.x), float(last.y - first.y))
    return distance <= gap <= 0.1 * table.length and abs(turn - round(turn)) * 2.0 * math.pi <= MAX_JOINT_KINK


# -- shapes -----------------------------------------------------------------------------------------------------------
def _segment(where: str, shape: Element) -> Segment:
    """The element of a <geometry>."""

    def number(key: str) -> float:
        return number_of(where, kind, key)

    length = number_of(where, shape, "length")
    kind = next((child for child in shape if child.tag in SHAPES), shape)
    match kind.tag:
        case "line":
            return Line(length=length)
        case "arc":
            return Arc(length=length, curvature=number("curvature"))
        case "spiral":
            return Clothoid(length=length, start_curvature=number("curvStart"), end_curvature=number("curvEnd"))
        case "poly3":
            a, b, c, d = map(number, "abcd")
            return Cubic(x=(0.0, 1.0, 0.0, 0.0), y=(a, b, c, d), end=_poly3_end(b, c, d, length))
        case "paramPoly3":
            span = kind.get("pRange", "normalized")
            if span not in ("normalized", "arcLength"):
                raise ConfigError(f"{where}: <paramPoly3 pRange={span!r}>: must be 'normalized' or 'arcLength'.")
            x, y = (tuple(number(power + axis) for power in "abcd") for axis in "UV")
            return Cubic(x=x, y=y, end=1.0 if span == "normalized" else length)  # type: ignore[arg-type]
    tags = ", ".join(f"<{child.tag}>" for child in shape) or "nothing"
    raise ConfigError(
        f"{where}: <geometry> at s = {shape.get('s')} holds {printable(tags)}; known: {', '.join(SHAPES)}."
    )


def _poly3_end(b: float, c: float, d: float, length: float) -> float:
    """The u at which the arc of v(u) = a + b u + c u^2 + d u^3 is `length` (m) long."""
    end = length
    for _ in range(50):
        panels = np.linspace(0.0, end, 33)
        u = 0.5 * (panels[:-1] + panels[1:])[:, np.newaxis] + 0.5 * (end / 32.0) * NODES
        with np.errstate(over="ignore", invalid="ignore"):  # such a cubic is refused
            arc = 0.5 * (end / 32.0) * float((portable.hypot(1.0, b + u * (2.0 * c + 3.0 * d * u)) * WEIGHTS).sum())
        step = (length - arc) / portable.hypot(1.0, b + end * (2.0 * c + 3.0 * d * end))
        end += step
        if not abs(step) >= 1e-13 * length:
            break
    return end
