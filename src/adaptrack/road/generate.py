"""Clothoid roads by design speed: straight lines, clothoids and arcs, drawn from a seed.

A bend is clothoid - arc - clothoid. The clothoids are as long as a lateral jerk asks for at the speed at which the bend
is driven, v^3/(R jerk) (W. Shortt's transition, 1909), but within R/3 <= A <= R of their parameter A^2 = R length, as
in the German guidelines (RAL 2012, RAA 2008). A bend is driven at the design speed, or as fast as the kind's lateral
acceleration allows.

Roads of up to 5 km are drawn whole until one keeps off itself. Longer ones, of which hardly any draw does, grow bend by
bend: a bend that comes too near is drawn again, and when none fits the last bends are given up, twice as many each
time, until the road is longer than it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from adaptrack.base.checked import Finite, Natural, checked, within
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.road.road import Road
from adaptrack.road.segments import Arc, Clothoid, Line, Pose, heading_integral

Element = Line | Arc | Clothoid


class RoadKind(NamedTuple):
    """Recipe of a kind of road; ranges (least, most) of radii and lengths are drawn on a logarithmic scale."""

    speed: float
    """m/s, design speed: the default speed limit"""
    radius: tuple[float, float]
    """m, of bends"""
    angle: tuple[float, float]
    """rad, by which a bend turns"""
    straight: tuple[float, float]
    """m, between bends"""
    tight: float = 0.0
    """share of bends that are tight"""
    tight_radius: tuple[float, float] = (0.0, 0.0)
    """m, of these: the corners of a town, the hairpins of a pass"""
    tight_angle: tuple[float, float] = (0.0, 0.0)
    """Range of the angle of tight bends (rad)."""
    acceleration: float = 3.0
    """m/s^2, lateral, with which bends are driven below the design speed"""
    jerk: float = 0.6
    """m/s^3, lateral, of the clothoids"""
    half_width: float = 1.75
    """m, of the lane"""


ROAD_KINDS = {
    "motorway": RoadKind(
        36.0, (900.0, 4000.0), (0.1, 0.6), (150.0, 1200.0), acceleration=1.5, jerk=0.5, half_width=1.875
    ),
    "country": RoadKind(25.0, (120.0, 700.0), (0.2, 1.3), (40.0, 500.0), half_width=1.75),
    "town": RoadKind(
        13.9, (40.0, 200.0), (0.1, 0.5), (40.0, 200.0), tight=0.6, tight_radius=(9.0, 16.0),
        tight_angle=(0.5 * math.pi, 0.5 * math.pi), jerk=2.0, half_width=1.625,
    ),
    "mountain": RoadKind(
        16.7, (30.0, 130.0), (0.3, 1.5), (15.0, 120.0), tight=0.25, tight_radius=(10.0, 15.0),
        tight_angle=(2.6, 3.3), acceleration=3.5, jerk=1.5, half_width=1.75,
    ),
    "lap": RoadKind(
        25.0, (60.0, 200.0), (0.3, 0.9), (10.0, 80.0), tight_radius=(15.0, 15.0), tight_angle=(math.pi, math.pi),
        acceleration=4.0, jerk=2.0, half_width=3.0,
    ),
}  # fmt: skip
"""The kinds of roads that can be generated. A lap is closed: two hairpins of 15 m and weaving between them."""

MAX_GENERATED_LENGTH = 100_000.0
"""m"""
ATTEMPTS = 100
"""Draws from which the first road that keeps off itself is taken."""
DRAWN_WHOLE = 5_000.0
"""m, up to which open roads are drawn whole."""
TRIES, DRAWS = 12, 50_000
"""Bends that are drawn for one place before the last ones are given up, and in all."""
MIN_CLEARANCE = 4.0
"""Least distance between parts of a road, in half widths of its lane, where they are not neighbours."""


@checked
def generate_road(
    kind: str,
    seed: Natural = 0,
    length: Annotated[Finite, within(100.0, MAX_GENERATED_LENGTH), "m"] = 2000.0,
    **along: Any,
) -> Road:
    """A road of a kind: "motorway", "country", "town", "mountain", or "lap" (closed).

    A seed gives the same road on every machine, to rounding. It begins straight along x and
    comes back to its mean direction; it neither crosses nor touches itself.

    Parameters
    ----------
    seed : int
        Which road.
    length : float
        About: the last bend is driven to its end.
    **along
        As in `Road.from_segments`; the speed limit is the kind's design speed unless given.

    Raises
    ------
    UnknownName
        When there is no such kind.
    InvalidInput
        For so long a lap that none was found that keeps off itself.
    """
    if kind not in ROAD_KINDS:
        raise UnknownName(f"no kind of road is named {kind!r}. {did_you_mean(str(kind), ROAD_KINDS)}")
    sizes = ROAD_KINDS[kind]
    values = {"speed_limit": sizes.speed, "width_left": sizes.half_width, "width_right": sizes.half_width} | along
    whole_draws = ATTEMPTS if kind == "lap" or length <= DRAWN_WHOLE else 0
    for attempt in range(whole_draws):
        rng = _random(kind, seed, attempt)
        segments = _lap(rng, sizes, length) if kind == "lap" else _open(rng, sizes, length)
        road = Road.from_segments(segments, closed=kind == "lap", name=f"{kind}-{seed}", **values)
        if not _touches_itself(road, MIN_CLEARANCE * sizes.half_width):
            return road
    if kind != "lap":
        grown = _grown(_random(kind, seed, whole_draws), sizes, length)
        if grown is not None:
            return Road.from_segments(grown, name=f"{kind}-{seed}", **values)
    raise InvalidInput(
        f"generate_road: no road of kind {kind!r} and {length:g} m was found that keeps off itself: "
        "take another seed or a shorter road."
    )


def _random(kind: str, seed: int, attempt: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64([list(ROAD_KINDS).index(kind), seed, attempt]))


def _open(rng: np.random.Generator, kind: RoadKind, length: float) -> list[Element]:
    """Straight lines and bends."""
    elements: list[Element] = [Line(length=_even(rng, kind.straight))]
    distance, heading = elements[0].length, 0.0
    while distance < length:
        bend, angle = _next_bend(rng, kind, heading)
        elements += bend
        distance += sum(element.length for element in bend)
        heading += angle
    return elements


def _next_bend(rng: np.random.Generator, kind: RoadKind, heading: float) -> tuple[list[Element], float]:
    """A bend with the straight line behind it, and its angle (rad).

    The farther off the road heads (rad), the likelier a bend turns back.
    """
    tight = bool(rng.random() < kind.tight)
    angle = float(rng.uniform(*(kind.tight_angle if tight else kind.angle)))
    left = rng.random() < 0.5 * (1.0 - portable.tanh(1.5 * heading))
    angle = angle if left else -angle
    bend = _bend(kind, angle, _even(rng, kind.tight_radius if tight else kind.radius))
    return [*bend, Line(length=_even(rng, kind.straight))], angle


def _grown(rng: np.random.Generator, kind: RoadKind, length: float) -> list[Element] | None:
    """As `_open`, each bend of which keeps off those before it; None when no road is found."""
    road = _Growing(MIN_CLEARANCE * kind.half_width)
    road.accepts([Line(length=_even(rng, kind.straight))])
    failed, given_up, longest = 0, 1, 0.0
    for _ in range(DRAWS):
        if road.length >= length:
            return [element for part in road.parts for element in part.elements]
        if road.accepts(_next_bend(rng, kind, road.end.heading)[0]):
            failed = 0
        else:
            failed += 1
        if road.length > longest:
            longest, given_up = road.length, 1
        if failed == TRIES:
            road.give_up(given_up)
            failed, given_up = 0, 2 * given_up
    return None


class _Part(NamedTuple):
    """A bend where it lies."""

    elements: list[Element]
    s: Array
    """(n,) m, arc length of its points along the road"""
    points: Array
    """(n, 2) m"""
    end: Pose


@dataclass
class _Growing:
    """An open road while it grows."""

    clearance: float
    """m, by which parts that are not neighbours keep off each other"""
    parts: list[_Part] = field(default_factory=list)
    length: float = 0.0
    """Length so far (m)."""

    @property
    def end(self) -> Pose:
        return self.parts[-1].end if self.parts else Pose()

    def accepts(self, elements: list[Element]) -> bool:
        """Add a bend if it keeps off the road, itself included; tell whether it did."""
        part = self._laid(elements)
        low, high = part.points.min(axis=0) - self.clearance, part.points.max(axis=0) + self.clearance
        for other in [*self.parts, part]:
            if (other.points.min(axis=0) > high).any() or (other.points.max(axis=0) < low).any():
                continue
            distances = portable.hypot(*(part.points[:, np.newaxis] - other.points).transpose(2, 0, 1))
            along = np.abs(part.s[:, np.newaxis] - other.s)
            if ((distances <= self.clearance) & (along > _neighbours(self.clearance))).any():
                return False
        self.parts.append(part)
        self.length += sum(element.length for element in elements)
        return True

    def give_up(self, count: int) -> None:
        """Take the last bends away, never the first line."""
        for part in self.parts[max(1, len(self.parts) - count) :]:
            self.length -= sum(element.length for element in part.elements)
        del self.parts[max(1, len(self.parts) - count) :]

    def _laid(self, elements: list[Element]) -> _Part:
        pose, begun, s, points = self.end, self.length, [], []
        for element in elements:
            places = np.linspace(0.0, element.length, math.ceil(element.length / (0.25 * self.clearance)) + 1)
            first, last = element.curvatures
            line = heading_integral(first, (last - first) / element.length, places)
            line = pose.x + 1j * pose.y + portable.times(portable.direction(pose.heading), line)
            s.append(begun + places)
            points.append(np.stack([line.real, line.imag], axis=-1))
            turn = 0.5 * (first + last) * element.length
            pose = Pose(float(line[-1].real), float(line[-1].imag), pose.heading + turn)
            begun += element.length
        return _Part(elements, np.concatenate(s), np.concatenate(points), pose)


def _lap(rng: np.random.Generator, kind: RoadKind, length: float) -> list[Element]:
    """Half a lap that turns by pi, twice: the second half is the first turned by pi, so the lap is closed.

    Each weave turns to one side and back, twice as far to the other side and back; the hairpin is what turns the half.
    """
    half: list[Element] = [Line(length=_even(rng, kind.straight))]
    while sum(element.length for element in half) < 0.5 * length - 150.0:
        angle = float(rng.uniform(*kind.angle)) * (1.0 if rng.random() < 0.5 else -1.0)
        radius = _even(rng, kind.radius)
        for turn in (angle, -2.0 * angle, angle):
            half += _bend(kind, turn, radius)
        half.append(Line(length=_even(rng, kind.straight)))
    return [*half, *_bend(kind, math.pi, _even(rng, kind.tight_radius))] * 2


def _bend(kind: RoadKind, angle: float, radius: float) -> list[Element]:
    """Clothoid, arc, clothoid that turn by `angle` (rad); without the arc where the clothoids take all of it."""
    v = min(kind.speed, math.sqrt(kind.acceleration * radius))
    length = min(max((v * v * v) / (radius * kind.jerk), radius / 9.0), radius)
    length = min(length, radius * abs(angle))
    curvature = math.copysign(1.0 / radius, angle)
    arc_length = abs(angle) * radius - length
    into = Clothoid(length=length, start_curvature=0.0, end_curvature=curvature)
    out = Clothoid(length=length, start_curvature=curvature, end_curvature=0.0)
    return [into, Arc(length=arc_length, curvature=curvature), out] if arc_length > 1e-6 * radius else [into, out]


def _even(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A length drawn evenly on a logarithmic scale."""
    return float(portable.exp(rng.uniform(portable.log(bounds[0]), portable.log(bounds[1]))))


def _touches_itself(road: Road, clearance: float) -> bool:
    """Whether two places that are no neighbours are nearer than `clearance` (m)."""
    from scipy.spatial import cKDTree

    step = 0.25 * clearance
    s = np.arange(0.0, road.length, step)
    points = road.at(s)
    pairs = cKDTree(np.stack([points.x, points.y], axis=-1)).query_pairs(clearance, output_type="ndarray")
    along = np.abs(s[pairs[:, 0]] - s[pairs[:, 1]])
    if road.closed:
        along = np.minimum(along, road.length - along)
    return bool((along > _neighbours(clearance)).any())


def _neighbours(clearance: float) -> float:
    """m along the road, up to which places may be nearer than `clearance`: four times that, a half turn and more."""
    return max(4.0 * clearance, 0.5 * math.pi * clearance + 1.0)
