"""Paths and plans of an axle, converted to those of the centre of mass.

Wheels that do not slip at the rear axle roll along the car: where it follows a path of curvature k, the yaw is the
heading of the path, and the centre of mass moves sqrt(1 + (l_r k)^2) times as far. Where the front axle follows a path,
the yaw psi trails its heading phi (a tractrix): dpsi/ds = sin(phi - psi)/wheelbase = k. At a speed v the rear tyres
slip: in a steady turn the yaw is m l_f v^2 k/(C_r wheelbase) further inside, with C_r of both tyres (R. Rajamani,
Vehicle Dynamics and Control, 2012, section 3.3).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.road.fit import road_through, smooth_road
from adaptrack.road.road import Road
from adaptrack.road.speed import SpeedPlan
from adaptrack.road.station_table import ALONG_QUANTITIES, Along

Axle = Literal["rear axle", "front axle"]
AXLE_PATH_SPACING, SLIP_PLACES = 0.5, 9
"""m, between the places at which a path is converted; and number of those over which the slip is averaged, since a car
takes some metres to turn."""
MAX_ROUNDING = 0.02
"""m, from the rear axle's path to one without jumps of curvature, at which the centre of mass would turn at once."""


@checked
def convert_axle_path(road: Road, plan: SpeedPlan | None, car: Vehicle, axle: Axle) -> tuple[Road, SpeedPlan | None]:
    """Path of the centre of mass of a car whose axle follows a road, and the plan along it.

    The new road goes through places every `AXLE_PATH_SPACING`. Speeds and stops of the plan are at the places at which
    the axle has reached those of the plan. What lies along the road stays where it is, steps to within that spacing.
    Where the curvature of a rear axle's path jumps, a path within `MAX_ROUNDING` replaces it: the centre of mass would
    have to turn at once. The slip of the rear tyres is that at the planned speeds; without a plan it is neglected.

    Raises
    ------
    InvalidInput
        When a radius of the road is below the wheelbase, or the plan is not of this road.
    """
    if plan is not None and abs(plan.s[-1] - road.length) > 1e-6:
        raise InvalidInput(
            "convert_axle_path: plan: must be a SpeedPlan of this road; plan_speed(road, ...) makes one."
        )
    is_rear = axle == "rear axle"
    line = smooth_road(road, MAX_ROUNDING) if is_rear and road.curvature_jumps() else road
    s = np.linspace(0.0, road.length, max(8, math.ceil(road.length / AXLE_PATH_SPACING)) + 1)
    places = s
    if line is not road:
        x, y, _, _ = road.at(s)
        places = line.project(x, y, near=s * (line.length / road.length)).s
    _check_radius(line, places, car, axle)
    points = line.at(places)
    yaw, turn = (points.heading, points.curvature) if is_rear else _trail(line, car.wheelbase, s.size)
    if plan is not None:
        yaw = yaw + _slip(turn, plan.at(s), car, road.closed)
    arm = -car.lr if is_rear else car.lf
    x, y = points.x - arm * portable.cos(yaw), points.y - arm * portable.sin(yaw)
    ways = np.concatenate([[0.0], np.cumsum(portable.hypot(np.diff(x), np.diff(y)))])
    ends = slice(0, -1 if road.closed else None)
    centre = road_through(np.stack([x, y], axis=-1)[ends], closed=road.closed, noise=0.0, name=road.name)
    stations = centre.project(x, y, near=ways * (centre.length / ways[-1])).s
    stations[[0, -1]] = 0.0, centre.length
    notes = () if line is road else (f"jumps of curvature rounded by up to {line.deviation:.2g} m",)
    centre = centre.replace(notes=(*road.notes, *notes), **_move_along(line, x, y, places - arm, stations))
    return centre, None if plan is None else _convert_plan(plan, s, stations)


def _check_radius(line: Road, places: Array, car: Vehicle, axle: Axle) -> None:
    """Refuse a bend in which the wheels would be turned by 45 degrees (rear axle) or 90 degrees (front axle)."""
    curvature = np.abs(line.at(places).curvature)
    k = int(curvature.argmax())
    if curvature[k] * car.wheelbase >= 1.0:
        raise InvalidInput(
            f"path of the {axle}: its radius at s = {places[k]:.6g} m is {1.0 / curvature[k]:.3g} m, below the "
            f"wheelbase of {car.wheelbase:.3g} m: correct the path."
        )


def _trail(line: Road, wheelbase: float, count: int) -> tuple[Array, Array]:
    """Yaw (rad) of a car whose front axle follows a line, and its change over the way (1/m), at even arc lengths.

    The classical Runge-Kutta method from a steady turn on; of a lap, the second one, which begins as it ends to within
    exp(-2 lap/wheelbase).
    """
    yaw, (_, _, heading, curvature) = np.empty(count), line.at(np.linspace(0.0, line.length, 2 * count - 1))
    step, course = line.length / ((count - 1) * wheelbase), heading.tolist()
    sine = wheelbase * float(curvature[0])
    psi = course[0] - portable.atan2(sine, math.sqrt(1.0 - sine * sine))
    for lap in range(2 if line.closed else 1):
        yaw[0] = psi = psi - lap * line.turn
        for k in range(count - 1):
            before, middle, after = course[2 * k : 2 * k + 3]
            k1 = step * portable.sin(before - psi)
            k2 = step * portable.sin(middle - psi - 0.5 * k1)
            k3 = step * portable.sin(middle - psi - 0.5 * k2)
            k4 = step * portable.sin(after - psi - k3)
            psi += (k1 + 2.0 * (k2 + k3) + k4) / 6.0
            yaw[k + 1] = psi
    return yaw, portable.sin(heading[::2] - yaw) / wheelbase


def _slip(turn: Array, speed: Array, car: Vehicle, closed: bool) -> Array:
    """Slip angle (rad) of the rear tyres in steady turns, averaged over `SLIP_PLACES`."""
    slip = car.rear_slip_gradient * speed * speed * turn
    side = SLIP_PLACES // 2
    before, after = (slip[-1 - side : -1], slip[1 : 1 + side]) if closed else (slip[[0] * side], slip[[-1] * side])
    sums = np.concatenate([[0.0], before, slip, after]).cumsum()
    return (sums[SLIP_PLACES:] - sums[:-SLIP_PLACES]) / SLIP_PLACES


def _move_along(line: Road, x: Array, y: Array, near: Array, stations: Array) -> dict[str, Along]:
    """Widths, speed limit, friction, bank and grade of a line at the feet of points x, y (m) of a new line.

    near, stations: arc lengths (m) of the feet, about, and of the points.
    """
    foot = line.project(x, y, near=near)
    offsets = {"width_left": -foot.offset, "width_right": foot.offset}
    values = {name: getattr(line, name) for name in ALONG_QUANTITIES}
    return {
        name: Along.through(stations, line.along(name, foot.s) + offsets.get(name, 0.0), value.kind)
        for name, value in values.items()
        if value is not None
    }


def _convert_plan(plan: SpeedPlan, s: Array, stations: Array) -> SpeedPlan:
    """The plan along the new path, whose arc lengths (m) are those `s` of the old one in turn; stops last as long."""
    places = np.interp(plan.s, s, stations)
    speed = plan.speed * np.interp(plan.s, s, np.gradient(stations, s, edge_order=2))
    old, new = (2.0 * np.diff(a) / (v[1:] + v[:-1]) for a, v in ((plan.s, plan.speed), (places, speed)))
    delay = np.concatenate([[0.0], np.cumsum(new - old)])
    return replace(plan, s=places, speed=speed, time=plan.time + delay, duration=plan.duration + float(delay[-1]))
