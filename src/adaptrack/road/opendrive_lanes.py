"""The lanes of an OpenDRIVE road, and what lies along them: widths, speed limits, bank, grade.

ASAM OpenDRIVE 1.4 to 1.8, chapters 10 and 11 (https://publications.pages.asam.net).
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from operator import itemgetter
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.base.files import finite_number, printable
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.roads.road import HALF_LENGTH
from adaptrack.road.station_table import NO_LIMIT, Along
from adaptrack.road.table import Pieces, cubic_line, points_on_pieces

Cubics = list[tuple[float, Array]]
"""Arc lengths at which cubics begin (m), in their order, each with its coefficients (4,): one after the other."""
Part = tuple[float, float, list[Cubics]]
"""Start and end (m), and cubics of which the sum counts there."""

SPEED_UNITS = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
HALF_TRACK = 0.75
"""m, to both sides of the line: the bank is the mean slope of the surface between."""
SIDES = ("both", "left", "right")
"""To which a crossfall belongs."""
SAMPLE_SPACING = 2.0
"""m, between the samples of widths, bank and grade, between which straight lines are drawn."""
OFFSET_STEP, SHORTEST_SAMPLE = 0.5, 1e-4
"""m, most and least between the samples of a line at an offset."""
DRIVEN = ("driving", "entry", "exit", "onRamp", "offRamp", "connectingRamp", "bidirectional")
"""Types of lanes that count to the width of a road."""
STATED = 1e-3
"""m, from which on a difference between the stated and the true length of an element is reported."""
ROUNDING = 1e-3
"""m: an `s` or `sOffset` below counts as 0."""
MAX_CLOSED_GAP = 0.1
"""m, the largest gap in a line that is closed."""
WIDE_ENOUGH = 1.75
"""m, or half the largest width of a lane if that is less: where a lane is narrower it opens or closes."""
LEAST_WIDTH = 0.01
"""m, to a side of the line on which no lane is driven."""
HEIGHT_STEP = 0.02
"""m, from which on a step between two elevations is reported."""


class Stations:
    """The stations s of the file, as arc lengths of the reference line."""

    def __init__(self, where: str, shapes: Sequence[Element], tables: Sequence[Pieces]) -> None:
        self._where = where
        stated = [number_of(where, shape, "length") for shape in shapes]
        first = number_of(where, shapes[0], "s")
        true = [table.length for table in tables]
        self._file = first + np.concatenate([[0.0], np.cumsum(stated)])
        self._own = np.concatenate([[0.0], np.cumsum(true)])
        off = np.abs(np.subtract(stated, true))
        self._notes: list[str] = []
        if off.max() > STATED:
            k = int(off.argmax())
            self._notes.append(
                f"the element at s = {self._file[k]:.2f} m is {true[k]:.4f} m long, the file says {stated[k]:.4f}"
            )
        self.length = float(self._own[-1])
        self._beyond: list[str] = []
        self._no_limits: list[str] = []

    @property
    def notes(self) -> list[str]:
        """Deviations of the file from itself."""
        reasons = {"beyond the end of the road": self._beyond, "not above 0": self._no_limits}
        omitted = [
            f"left out, {reason}: {', '.join(dict.fromkeys(texts))}" for reason, texts in reasons.items() if texts
        ]
        return [*self._notes, *omitted]

    def of(self, s: float) -> float:
        """The arc length at a station, also of one beyond the end."""
        return float(np.interp(s, self._file, self._own)) + max(0.0, s - float(self._file[-1]))

    def stated(self, element: Element, key: str = "s") -> float:
        """A station in the file."""
        station = number_of(self._where, element, key)
        return station if abs(station) >= ROUNDING else 0.0

    def located(self, elements: Iterable[Element], section: float | None = None) -> list[tuple[float, Element]]:
        """Elements with the arc lengths at which they begin, in their order; those from the end on are left out.

        section: the station from which `sOffset` counts; without it elements have their own `s`.
        """
        pairs = []
        for element in elements:
            station = (section or 0.0) + self.stated(element, "s" if section is None else "sOffset")
            if station < self._file[-1]:
                pairs.append((self.of(station), element))
            else:
                self._beyond.append(f"{element.tag} at s = {station:.2f} m")
        return sorted(pairs, key=lambda pair: pair[0])

    def cubics(self, elements: Iterable[Element], section: float | None = None) -> Cubics:
        """The cubics of elements with a, b, c, d; where several begin at one place, the last one."""
        rows = {s: [number_of(self._where, law, key) for key in "abcd"] for s, law in self.located(elements, section)}
        return [(s, np.array(row)) for s, row in rows.items()]

    def limit(self, speed: Element | None) -> float:
        """A speed limit (m/s); `NO_LIMIT` where there is none, and for a number that is not above 0."""
        if speed is None or speed.get("max", "") in ("", "no limit", "undefined"):
            return NO_LIMIT
        unit = speed.get("unit", "m/s")
        if unit not in SPEED_UNITS:
            raise ConfigError(f"{self._where}: <speed unit={unit!r}>: must be one of {', '.join(SPEED_UNITS)}.")
        limit = number_of(self._where, speed, "max") * SPEED_UNITS[unit]
        if limit <= 0.0:
            self._no_limits.append(f"speed max={speed.get('max')!r}")
        return limit if limit > 0.0 else NO_LIMIT


# -- lanes ------------------------------------------------------------------------------------------------------------
class _Lane(NamedTuple):
    """A lane within one section."""

    type: str
    width: Cubics | None
    """None: it has a <border>"""
    limits: dict[float, float]
    """speed limits (m/s) by the arc lengths at which they begin"""
    level: bool
    """whether it stays level where the road is banked"""
    direction: str
    predecessor: str | None
    successor: str | None

    @property
    def is_driven(self) -> bool:
        """A lane that counts to the width of the road."""
        return self.type in DRIVEN


class _Stretch(NamedTuple):
    """A side of the road within one section."""

    start: float
    """m, arc length of the reference line"""
    end: float
    """m, where the next section begins"""
    lanes: dict[int, _Lane]

    @property
    def driven_lanes(self) -> list[int]:
        """The lanes that count to the width of the road."""
        return [number for number, lane in self.lanes.items() if lane.is_driven]


class Lanes:
    """<laneOffset> and the lanes beside it; the line is the middle of one of them, or the lane offset."""

    def __init__(self, where: str, road: Element, stations: Stations, lane: int | None) -> None:
        self._where, self._road, self._stations = where, road, stations
        self._offset = stations.cubics(road.findall("lanes/laneOffset"))
        self._left, self._right = self._sides(road.findall("lanes/laneSection"))
        self._path = None if lane is None else self._follow(lane)
        self.notes = self._side_notes() if self._path is None else self._path_notes(self._path)
        self._check_direction(_choice(where, road, "rule", ("RHT", "LHT")))

    # ---- read

    def _sides(self, sections: Iterable[Element]) -> tuple[list[_Stretch], list[_Stretch]]:
        """The lanes to the left and to the right; a section of a single side leaves the other one as it is."""
        sides: tuple[dict[float, dict[int, _Lane]], ...] = {0.0: {}}, {0.0: {}}
        for start, section in self._stations.located(sections):
            s = self._stations.stated(section)
            lanes = {int(number_of(self._where, lane, "id")): self._lane(lane, s) for lane in section.iter("lane")}
            single = section.get("singleSide", "false").lower() in ("true", "1")
            for side, sign in zip(sides, (1, -1), strict=True):
                side_lanes = {number: lane for number, lane in lanes.items() if number * sign > 0}
                if side_lanes or not single:
                    side[start] = side_lanes
        left, right = (
            [
                _Stretch(start, end, lanes)
                for (start, lanes), end in zip(side.items(), [*side, self._stations.length][1:], strict=True)
            ]
            for side in sides
        )
        return left, right

    def _lane(self, lane: Element, section: float) -> _Lane:
        speeds = self._stations.located(lane.findall("speed"), section)
        links = {link.tag: link.get("id") for link in lane.iterfind("link/*")}
        return _Lane(
            type=lane.get("type", ""),
            width=None if lane.find("border") is not None else self._stations.cubics(lane.findall("width"), section),
            limits={s: self._stations.limit(speed) for s, speed in speeds},
            level=lane.get("level", "false").lower() in ("true", "1"),
            direction=_choice(self._where, lane, "direction", ("standard", "reversed", "both")),
            predecessor=links.get("predecessor"),
            successor=links.get("successor"),
        )

    def _follow(self, lane: int) -> list[tuple[int, _Stretch]]:
        """The ids of a lane from the first section that has it to the last; ConfigError when there is no such lane."""
        path: list[tuple[int, _Stretch]] = []
        for stretch in self._left if lane > 0 else self._right:
            number = _next_id(*path[-1], stretch.lanes) if path else lane
            if number in stretch.lanes:
                path.append((number, stretch))
            elif path:
                break
        if not path:
            raise ConfigError(f"{self._where}: there is no lane {lane}; there are {self._ids()}.")
        return path

    def _ids(self) -> str:
        """The ids of all lanes, with the types of those that are not driven."""
        lanes: dict[int, _Lane] = {}
        for stretch in reversed((*self._left, *self._right)):
            lanes |= stretch.lanes
        ids = [f"{k}" if lanes[k].is_driven else f"{k} ({printable(lanes[k].type)})" for k in sorted(lanes)]
        return ", ".join(ids) or "none"

    def _check_direction(self, rule: str) -> None:
        """Refuse a lane that is driven against the direction of the road."""
        for number, stretch in self._path or ():
            lane = stretch.lanes[number]
            if not _runs_with_road(number, lane, rule):
                lanes = self._right[0].lanes | self._left[0].lanes
                ids = ", ".join(str(k) for k in sorted(lanes) if _runs_with_road(k, lanes[k], rule)) or "none"
                raise ConfigError(
                    f"{self._where}: lane {number} runs against the road (rule={rule!r}, direction="
                    f"{lane.direction!r}): choose one of the lanes that run with the road: {ids}."
                )

    def _side_notes(self) -> list[str]:
        """The sides of the line on which no lane is driven."""
        notes = []
        for name, side in (("left", self._left), ("right", self._right)):
            bare = [stretch for stretch in side if not any(stretch.driven_lanes)]
            if bare and any(stretch.lanes for stretch in (*self._left, *self._right)):
                part = "" if len(bare) == len(side) else f" from s = {bare[0].start:.2f} to {bare[-1].end:.2f} m"
                notes.append(
                    f"no driving lane is to the {name} of the line{part}, where the road is {LEAST_WIDTH:g} m wide: "
                    f"the line is its edge; the lane of a car is one of {self._ids()}"
                )
        return notes

    def _path_notes(self, path: Sequence[tuple[int, _Stretch]]) -> list[str]:
        """Where the lane has a new id, or is no driving lane."""
        first = path[0][0]
        notes = [
            f"lane {first} is lane {number} from s = {stretch.start:.2f} m on"
            for (before, _), (number, stretch) in itertools.pairwise(path)
            if number != before
        ]
        start, end = self.extent
        if start > 0.0 or end < self._stations.length:
            notes.append(f"lane {first} is read from s = {start:.2f} to {end:.2f} m, where it is wide enough")
        types = {stretch.lanes[number].type for number, stretch in path} - set(DRIVEN)
        return [*notes, f"lane {first} is of type {printable(', '.join(sorted(types)))}"] if types else notes

    # ---- distances and widths

    @cached_property
    def line(self) -> Cubics | None:
        """The distance of the line from the reference line; None where it is always 0."""
        if self._path is None:
            offset = _combined([self._offset]) if any(law.any() for _, law in self._offset) else None
            return offset and self._checked(offset, f"<laneOffset> jumps by {{:.3g}} m: choose a lane: {self._ids()}")
        summed = [self._offset]
        for rank in range(1, max(abs(number) for number, _ in self._path) + 1):
            cubics: Cubics = []
            for number, stretch in self._path:
                share = 1.0 if rank < abs(number) else 0.5 if rank == abs(number) else 0.0
                inner = int(math.copysign(rank, number))
                widths = self._width(inner, stretch) if share else [(stretch.start, np.zeros(4))]
                cubics += [(s, math.copysign(share, number) * width) for s, width in widths]
            summed.append(cubics)
        remedy = f"its <link>, <width> and <laneOffset> do not fit; choose a different lane: {self._ids()}"
        return self._checked(_combined(summed), f"lane {self._path[0][0]} jumps by {{:.3g}} m: {remedy}")

    def _checked(self, cubics: Cubics, flaw: str) -> Cubics:
        """The distances of a line that has no jump in its extent."""
        for s, jump in _jumps(cubics):
            if abs(jump) > MAX_CLOSED_GAP and self.extent[0] < s < self.extent[1]:
                raise ConfigError(f"{self._where}: at s = {s:.2f} m {flaw.format(abs(jump))}.")
        return cubics

    @cached_property
    def extent(self) -> tuple[float, float]:
        """Start and end (m) of the longest part on which a lane is wide enough (`WIDE_ENOUGH`)."""
        if self._path is None:
            return 0.0, self._stations.length
        s, half = map(np.array, (self._half_width().s, self._half_width().value))
        if not half.max() > 0.0:
            raise ConfigError(
                f"{self._where}: lane {self._path[0][0]} has no <width> above 0; there are {self._ids()}."
            )
        is_narrow = np.concatenate([[True], half < 0.5 * min(WIDE_ENOUGH, half.max()), [True]])
        starts = np.flatnonzero(is_narrow[:-1] & ~is_narrow[1:])
        ends = np.flatnonzero(~is_narrow[:-1] & is_narrow[1:]) - 1
        longest = int((s[ends] - s[starts]).argmax())
        start, end = int(starts[longest]), int(ends[longest])
        return 0.0 if start == 0 else float(s[start]), self._stations.length if end == s.size - 1 else float(s[end])

    def _half_width(self) -> Along:
        """Half the width of the lane; 0 before its first section and behind its last one."""
        parts: list[Part] = [
            (stretch.start, stretch.end, [[(s, 0.5 * cubic) for s, cubic in self._width(lane, stretch)]])
            for lane, stretch in self._path or ()
        ]
        first, last, length = parts[0][0], parts[-1][1], self._stations.length
        parts = [(0.0, first, []), *parts] if first > 0.0 else parts
        return _sampled_sums([*parts, (last, length, [])] if last < length else parts)

    def _width(self, number: int, stretch: _Stretch) -> Cubics:
        """The width of a lane within a section."""
        if number not in stretch.lanes:
            raise ConfigError(f"{self._where}: at s = {stretch.start:.2f} m there is no lane {number}.")
        width = stretch.lanes[number].width
        if width is None:
            raise ConfigError(f"{self._where}: lane {number} has a <border>, which is not read; give it a <width>.")
        return width or [(stretch.start, np.zeros(4))]

    def _widths(self) -> dict[str, Along]:
        """Width to the left and to the right of the line, where the file has lanes."""
        if self._path is not None:
            half = self._half_width()
            return {"width_left": half, "width_right": half}
        sides = {"width_left": self._left, "width_right": self._right}
        if not any(stretch.lanes for side in sides.values() for stretch in side):
            return {}
        return {name: self._side_width(side) for name, side in sides.items()}

    def _side_width(self, side: Sequence[_Stretch]) -> Along:
        """The width of all driving lanes of a side."""
        parts: list[Part] = [
            (stretch.start, stretch.end, [self._width(number, stretch) for number in stretch.driven_lanes])
            for stretch in side
        ]
        along = _sampled_sums(parts)
        return along.replace(value=tuple(np.maximum(along.value, LEAST_WIDTH).tolist()))

    # ---- what lies along

    def along(self) -> tuple[dict[str, Along], list[str]]:
        """Widths, speed limit, bank and grade by the arc length of the reference line, if the file has them; notes."""
        values = {**self._widths(), **self._speed_limit(), **self._bank()}
        grade, notes = self._grade()
        return values | grade, notes

    def _speed_limit(self) -> dict[str, Along]:
        """The lowest limit of the lane, or else of all driving lanes: their own, or that of the road."""
        types = self._stations.located(self._road.findall("type"))
        road_limits = {0.0: NO_LIMIT} | {s: self._stations.limit(kind.find("speed")) for s, kind in types}
        sides = (*self._left, *self._right)
        path = self._path or [(number, stretch) for stretch in sides for number in stretch.driven_lanes]
        lane_limits = [
            (stretch.start, stretch.end, {stretch.start: NO_LIMIT} | stretch.lanes[number].limits)
            for number, stretch in path
        ]
        places = sorted({*road_limits, *(s for _, end, limits in lane_limits for s in limits if s < end)})
        values = []
        for place in places:
            general = _latest(road_limits, place)
            limits = [_latest(limits, place) for start, end, limits in lane_limits if start <= place < end]
            values.append(min((general if limit == NO_LIMIT else limit for limit in limits), default=general))
        if min(values) == NO_LIMIT:
            return {}
        return {"speed_limit": Along.through(np.array(places), np.array(values), "steps")}

    def _bank(self) -> dict[str, Along]:
        """The bank of the line, level where its lane is."""
        surface, line, length = _Surface(self._where, self._road, self._stations), self.line, self._stations.length
        levels = {
            stretch.start if k else 0.0: stretch.lanes[lane].level for k, (lane, stretch) in enumerate(self._path or ())
        }
        starts = sorted(s for s in {0.0, *surface.starts, *levels} if s < length)

        def bank_from(start: float, s: Array) -> Array:
            if levels and _latest(levels, start):
                return np.zeros_like(s)
            return surface.bank(start, s, np.zeros_like(s) if line is None else _values(line, s))

        ends = [*starts[1:], length]
        bank = _sampled((start, end, partial(bank_from, start)) for start, end in zip(starts, ends, strict=True))
        return {"bank": bank} if any(bank.value) else {}

    def _grade(self) -> tuple[dict[str, Along], list[str]]:
        """The grade of the reference line, the slope of its elevations; a note on the largest step between two."""
        laws = self._stations.cubics(self._road.findall("elevationProfile/elevation"))
        s, step = max(_jumps(laws), key=lambda jump: abs(jump[1]), default=(0.0, 0.0))
        notes = [f"the height steps by {step:.3g} m at s = {s:.2f} m: left out"] if abs(step) > HEIGHT_STEP else []
        if not laws or laws[0][0] > 0.0:  # level before the first one
            laws = [(0.0, np.zeros(4)), *laws]
        ends = [*(start for start, _ in laws[1:]), self._stations.length]
        slopes = [partial(_slope, start, law) for start, law in laws]
        grade = _sampled(zip([start for start, _ in laws], ends, slopes, strict=True))
        return {"grade": grade} if any(grade.value) else {}, notes


def _next_id(number: int, stretch: _Stretch, lanes: dict[int, _Lane]) -> int:
    """The id of a lane in the next section: by the link to it, or the link back, or else unchanged."""
    linked = {str(after): after for after in lanes}.get(stretch.lanes[number].successor or "")
    if linked is not None:
        return linked
    return next((after for after, lane in lanes.items() if lane.predecessor == str(number)), number)


def _runs_with_road(number: int, lane: _Lane, rule: str) -> bool:
    """Whether a lane is driven in the direction of the road."""
    if lane.direction == "both" or lane.type == "bidirectional":
        return True
    return ((number < 0) == (rule == "RHT")) == (lane.direction == "standard")


def _combined(summed: Sequence[Cubics]) -> Cubics:
    """The sum of cubics."""
    starts = sorted({0.0, *(s for cubics in summed for s, _ in cubics)})
    starts = [s for k, s in enumerate(starts) if k == 0 or s > starts[k - 1] + 1e-9]
    total = [(s, np.zeros(4)) for s in starts]
    for cubics in summed:
        for s, coefficients in total:
            for begin, cubic in [law for law in cubics if law[0] <= s + 1e-9][-1:]:
                coefficients += _shifted(cubic, s - begin)
    return total


def _jumps(cubics: Cubics) -> Iterator[tuple[float, float]]:
    """Where a cubic follows another one, and by how much it begins above the end of that."""
    for (start, cubic), (end, after) in itertools.pairwise(cubics):
        yield end, after[0] - _shifted(cubic, end - start)[0]


def _values(cubics: Cubics, s: Array) -> Array:
    """Cubics at arc lengths."""
    starts, rows = (np.array(column) for column in zip(*cubics, strict=True))
    row = np.maximum(np.searchsorted(starts, s, "right") - 1, 0)
    return _shifted(rows[row].T, s - starts[row])[0]


def _sampled_sums(parts: Iterable[Part]) -> Along:
    """Sums of cubics, each from an arc length to the next one."""
    return _sampled((start, end, partial(_values, _combined(summed))) for start, end, summed in parts)


def _sampled(parts: Iterable[tuple[float, float, Callable[[Array], Array]]]) -> Along:
    """Functions of the arc length, each from a start to an end; samples at one place are moved 1e-6 m apart: a step."""
    samples = [
        (np.linspace(start, end, max(1, math.ceil((end - start) / SAMPLE_SPACING)) + 1), function)
        for start, end, function in parts
    ]
    values = np.concatenate([function(places) for places, function in samples])
    s = np.maximum.accumulate(np.concatenate([places for places, _ in samples]))
    for k in range(1, s.size):
        s[k] = max(s[k], s[k - 1] + 1e-6)
    return Along.through(s, values)


def _shifted(c: Array, b: float | Array) -> Array:
    """The coefficients of a cubic whose argument counts from b: its value and slope at b come first."""
    slope = c[1] + b * (2.0 * c[2] + 3.0 * b * c[3])
    value = c[0] + b * (c[1] + b * (c[2] + b * c[3]))
    return np.stack(np.broadcast_arrays(value, slope, c[2] + 3.0 * b * c[3], c[3]))


def line_at_offset(
    base: Pieces, offsets: Cubics, extent: tuple[float, float] | None = None
) -> tuple[Pieces, Array, Array]:  # fmt: skip
    """The line at a lateral offset from another, and the arc lengths (m) of its samples on the base and on itself.

    A cubic with their directions goes through samples at most `OFFSET_STEP` apart and at the joints of both lines.
    offsets: where along the base each cubic of the offset begins (m), and its coefficients; positive to the left, m;
    extent: start and end (m) of the part of the base beside which the line lies; by default all of it. Raises
    InvalidInput where the line passes the centre of curvature of its base.
    """
    first, last = extent or (0.0, base.length)
    starts, rows = (np.array(column) for column in zip(*offsets, strict=True))
    s = np.unique(np.concatenate([base.start, starts, np.arange(0.0, base.length, OFFSET_STEP), [first, last]]))
    s = s[(s >= first) & (s <= last)]
    s = s[np.append(True, np.diff(s) > SHORTEST_SAMPLE)]  # editors leave elements of micrometres
    s[-1] = last
    middle = 0.5 * (s[:-1] + s[1:])
    piece = np.searchsorted(base.start, middle, "right") - 1
    law = np.maximum(np.searchsorted(starts, middle, "right") - 1, 0)
    ends = []
    for end in (s[:-1], s[1:]):
        points = points_on_pieces(base.pieces[piece], (end - base.start[piece]) / base.pieces[piece, HALF_LENGTH] - 1.0)
        offset, slope = _shifted(rows[law].T, end - starts[law])[:2]
        ahead, normal = 1.0 - offset * points.curvature, 1j * portable.direction(points.heading)
        for k in np.flatnonzero(~(ahead > 0.0))[:1]:
            raise InvalidInput(
                f"at s = {end[k]:.2f} m the lane lies {abs(offset[k]):.3g} m from the reference line, beyond its "
                f"centre of curvature ({1.0 / abs(points.curvature[k]):.3g} m): it would run backwards; choose "
                "another lane."
            )
        ends.append(
            (points.x + 1j * points.y + offset * normal, portable.times(slope - 1j * ahead, normal) * np.diff(s))
        )
    (first, begin), (last, end) = ends
    step = last - first
    powers = np.stack([first, begin, 3.0 * step - 2.0 * begin - end, begin + end - 2.0 * step], axis=-1)
    line, places = cubic_line(np.stack([powers.real, powers.imag], axis=1))
    return line, s, places


# -- values along -----------------------------------------------------------------------------------------------------
def _latest(steps: Mapping[float, float], place: float) -> float:
    """The value of steps at a place."""
    return steps[max(s for s in steps if s <= place)]


class _Surface:
    """The lateral profile: superelevation, crossfall and shape."""

    def __init__(self, where: str, road: Element, stations: Stations) -> None:
        profile = "lateralProfile/"
        falls = road.findall(profile + "crossfall")
        self._roll = stations.cubics(road.findall(profile + "superelevation"))
        self._falls = [
            stations.cubics(fall for fall in falls if _choice(where, fall, "side", SIDES) in ("both", side))
            for side in ("left", "right")
        ]
        shapes: dict[float, list[tuple[float, Array]]] = {}
        for shape in road.findall(profile + "shape"):
            s, t, *cubic = (number_of(where, shape, key) for key in ("s", "t", *"abcd"))
            shapes.setdefault(stations.of(s), []).append((t, np.array(cubic)))
        self._sections = [(s, sorted(shapes[s], key=itemgetter(0))) for s in sorted(shapes)]

    @property
    def starts(self) -> set[float]:
        """Where an element begins, m."""
        return {s for cubics in (self._roll, *self._falls) for s, _ in cubics} | {s for s, _ in self._sections}

    def bank(self, start: float, s: Array, t: Array) -> Array:
        """The bank (rad) at arc lengths s from `start` to the next element, at the distances t from the reference line.

        A superelevation, the roll about the line, is positive where the road falls to the right; a bank, to the left.
        """
        left, right = (self._height(start, s, t + side) for side in (HALF_TRACK, -HALF_TRACK))
        return -_valid_cubic(self._roll, start, s) - portable.atan((left - right) / (2.0 * HALF_TRACK))

    def _height(self, start: float, s: Array, t: Array) -> Array:
        """The height (m) above the plane that rolls with the superelevation.

        A crossfall falls to the outside; between two cross sections the height is interpolated.
        """
        fall = np.where(t > 0.0, *(_valid_cubic(cubics, start, s) for cubics in self._falls))
        height = -portable.tan(fall) * np.abs(t)
        k = bisect_right(self._sections, start, key=lambda section: section[0])
        if k == 0:
            return np.asarray(height)
        (begin, shape), (end, next_shape) = self._sections[k - 1], self._sections[min(k, len(self._sections) - 1)]
        share = (s - begin) / (end - begin) if end > begin else 0.0
        return np.asarray(height + (1.0 - share) * _values(shape, t) + share * _values(next_shape, t))


def _valid_cubic(cubics: Cubics, start: float, s: Array) -> Array:
    """The last of the cubics that begin at `start` or before, at arc lengths s; 0 before the first."""
    before = [cubic for cubic in cubics if cubic[0] <= start]
    return _shifted(before[-1][1], s - before[-1][0])[0] if before else np.zeros_like(s)


def _slope(start: float, cubic: Array, s: Array) -> Array:
    """The slope of a cubic that begins at `start`, at arc lengths."""
    return np.asarray(_shifted(cubic, s - start)[1])


def _choice(where: str, element: Element, key: str, choices: Sequence[str]) -> str:
    """An attribute that is one of some words; the first where there is none."""
    word = element.get(key, choices[0])
    if word not in choices:
        raise ConfigError(f"{where}: <{element.tag} {key}={word!r}>: must be one of {', '.join(choices)}.")
    return word


def number_of(where: str, element: Element, key: str) -> float:
    """An attribute that is a finite number."""
    text = element.get(key, "0" if key == "sOffset" else "")
    number = finite_number(text)
    if number is None:
        raise ConfigError(f"{where}: <{printable(element.tag)} {key}={text!r}>: must be a finite number.")
    return number
