"""The speed along a road: the fastest one that curvature, friction, bank, grade, comfort and powertrain allow.

With w = v^2 the acceleration along the road is a = w'(s)/2; sideways tyres feel a_y = v^2 kappa - g sin(bank). Bounds:

    |a_y| <= min(comfort, grip),  grip = share mu g cos(theta) cos(bank);   -brake(w, s) <= a <= drive(w, s),

where friction leaves the largest b with b^2 + (a_y/(1 - b h/(g l cos(theta))))^2 <= grip^2 to brake or accelerate with:
the axle at the distance l from the centre of mass to the *other* one is unloaded by b h/(g l cos(theta)) of its load,
must carry its share of a_y all the same, and a car whose rear cannot spins. Without a car h = 0, the friction circle.
On a slope theta = atan(grade), a tyre force b of the mass accelerates by b - g sin(theta): uphill the slope takes from
what drives and adds to what brakes. Comfort bounds a itself. A bend on a descent leaves the tyres the force that holds
the speed.
The curvature may change no faster than v^3 |kappa'| = lateral jerk. Each bound falls as w grows, so the
fastest profile is found by one pass forward, with what the car can gain, and one backward, with what it can lose
(E. Velenis and P. Tsiotras, *Minimum-time travel for a vehicle with acceleration limits*, JOTA 138 (2008)).
"""

from __future__ import annotations

import math

from ..kernel import OK, columns, exported, float64, inlined, int64, local, matrix, record, several, vector, void
from ..maths.exact import sqrt, square
from ..maths.exponential import power
from ..maths.trigonometric import cos, sin
from ..models.car import unpack
from ..physics.forces import GRAVITY
from ..roads.road import CLOSED
from ..speed.plan import last_at
from .cells import PLAN, write_cells
from .cornering import BENDS, cornering_at, cornering_limits
from .station_table import Route, between

SpeedBounds = record(
    "SpeedBounds",
    (
        "lateral",  # m/s^2, felt sideways
        "accelerate", "brake",  # m/s^2
        "jerk",  # m/s^3, along the road; inf: any. `plan_along_road` does not keep it
        "lateral_jerk",  # m/s^3, v^3 d(curvature)/ds within pieces; inf: any
        "grip_share",  # -, of the friction that may be used
        "start", "end",  # m/s, at the ends of an open road; NaN: free
        "top_speed",  # m/s, beside the road's own limit; NaN: the domain's, where the road has none
        "domain_speed",  # m/s, the highest one of the car's domain
        "no_limit",  # m/s, above which a speed limit is none
        "steering_limit",  # rad, of the road wheels; NaN: `cornering.STEERING_LIMIT`
        "spacing",  # m, of the places at most
    ),
)  # fmt: skip
"""What bounds a plan beside the road and the car's powertrain."""

Planning = record(
    "Planning",
    (
        ("route", Route), ("bounds", SpeedBounds), ("car", vector), ("stops", vector), ("seconds", vector),
        ("held_at", vector), ("held", matrix), ("table", matrix),
    ),
)  # fmt: skip
"""A plan to be made. car: `PLANT_PARAMETERS`, or empty: comfort and friction alone bound the acceleration; stops: m,
ascending, moved to places of the table by `plan_cells`; seconds: s, at each of them; held_at, held: (m,) squares of
speeds, and (cells, m) m/s^2, the deceleration up to which the controller's margins hold at each, or both empty; table:
(`PLAN`, places), written."""

SPEED_LIMIT = columns(
    "lateral", "grip", "curvature_rate", "speed_limit", "domain", "top_speed", "margins", "ends", "accelerate", "power",
    "brake", "brakes", "jerk",
)  # fmt: skip
"""What bounds a planned speed."""
CANNOT_TURN, TOO_STEEP, START_TOO_FAST, END_TOO_FAST, CANNOT_BRAKE, NO_PLACES, NO_BOUNDS = range(1, 8)
TOO_WEAK, TOO_SLIPPERY = range(8, 10)
"""What `plan_along_road` answers: a plan; a bend too tight for the car; a bank that alone exceeds what is allowed; a
speed at the start, or at the end, above what is possible there; a start from which no car can brake in time; no road,
or a spacing that makes no places of it; comfort that is no number above 0; a grade that drive or brakes cannot hold;
a grade that the tyres cannot hold."""

STRAIGHT_CURVATURE = 1e-9
"""1/m, a curvature that counts as none."""
UNLOADINGS = 6
"""Steps of Newton's method."""
POWER_HALVINGS = 60
"""In the search for the speed that the power holds."""
ABOVE, AT_CEILING, ALL_OF_IT = 1e-9, 1e-6, 0.98
"""Shares: by which a speed may be above what is possible, by which a square is below its ceiling and still at it, and
of an acceleration above which it is used up."""

Powertrain = record(
    "Powertrain",
    (
        "mass",  # kg
        "power", "traction", "brakes",  # W, N, N
        "drag",  # kg/m, force of the air over v^2
        "rolling",  # m/s^2
        "front", "rear",  # s^2/m, h/(g l): share of its load that an axle loses per deceleration, the other at l
    ),
)  # fmt: skip


# -- the car ----------------------------------------------------------------------------------------------------------
@inlined
def _powertrain(plant):
    """Return the longitudinal bounds of a car; without a powertrain there are none."""
    if plant.size == 0:
        return Powertrain(1.0, math.inf, math.inf, math.inf, 0.0, 0.0, 0.0, 0.0)
    car = unpack(plant)
    return Powertrain(
        car.mass, car.engine_power, car.traction_limit, car.brake_limit,
        0.5 * car.air_density * car.frontal_area * car.drag_coefficient, car.rolling_resistance * GRAVITY,
        car.cg_height / (GRAVITY * car.lf), car.cg_height / (GRAVITY * car.lr),
    )  # fmt: skip


@inlined
def _slowed(k, w, car, table):
    """Deceleration by air and rolling (m/s^2), without wind."""
    return car.drag * w / car.mass + car.rolling * table[PLAN.cosine, k]


@inlined
def _left(k, w, level_lever, table):
    """Return the friction left along the road (m/s^2), by Newton's method from above on a convex function, to rounding.

    level_lever: of the axle that is unloaded, see `Powertrain`, on a level road.
    """
    lever = level_lever / table[PLAN.cosine, k]
    sideways, grip = abs(w * table[PLAN.curvature, k] - table[PLAN.tilt, k]), table[PLAN.grip, k]
    if not sideways < grip:
        return 0.0
    b = sqrt(grip * grip - sideways * sideways)
    if lever == 0.0:
        return b
    b = min(b, (1.0 - sideways / grip) / lever)
    if sideways < 1e-6 * grip:
        return b
    for _ in range(UNLOADINGS):
        remaining = 1.0 - lever * b
        over = b * b + square(sideways / remaining) - grip * grip
        b -= over / (2.0 * b + 2.0 * lever * square(sideways) / (remaining * remaining * remaining))
    return max(b, 0.0)


@inlined
def _drives(k, w, car, planning):
    """Return the bounds of the acceleration (m/s^2) between two places at v^2 = w: comfort, grip, power."""
    table = planning.table
    slowed, slope = _slowed(k, w, car, table), table[PLAN.slope, k]
    force = min(car.traction, car.power / sqrt(max(w, 1e-6)))
    return planning.bounds.accelerate, _left(k, w, car.rear, table) - slowed - slope, force / car.mass - slowed - slope


@inlined
def _brakings(k, w, car, planning):
    """Return the bounds of the deceleration (m/s^2) at a place: comfort, grip, brakes, margins of the controller.

    What air and rolling add is left to the tyres as a reserve.
    """
    steady = math.inf
    if planning.held_at.size > 0:
        steady = max(between(w, last_at(w, planning.held_at), planning.held_at, planning.held[k]), 0.0)
    table, slope = planning.table, planning.table[PLAN.slope, k]
    brakes = car.brakes / car.mass + _slowed(k, w, car, table)
    return planning.bounds.brake, _left(k, w, car.front, table) + slope, brakes + slope, steady + slope


@inlined
def _drive(k, w, car, planning):
    """The largest acceleration (m/s^2) between two places at v^2 = w."""
    comfort, grip, power_ = _drives(k, w, car, planning)
    return min(min(comfort, grip), power_)


@inlined
def _brake(k, w, car, planning):
    """The largest deceleration (m/s^2) between two places at v^2 = w."""
    comfort, grip, brakes, steady = _brakings(k, w, car, planning)
    return min(min(comfort, grip), min(brakes, steady))


# -- the largest speed at a place -------------------------------------------------------------------------------------
@inlined
def _square_in_bend(allowed, curvature, tilt):
    """v^2 at which a bend asks for what is allowed sideways (m/s^2)."""
    if not abs(curvature) > STRAIGHT_CURVATURE:
        return math.inf
    return (allowed + (tilt if curvature > 0.0 else -tilt)) / abs(curvature)


@inlined
def _square_of_turning(k, jerk, table):
    """v^2 at which the curvature changes as fast as the lateral jerk allows."""
    change = abs(table[PLAN.last, k] - table[PLAN.first, k])
    if not (change > 0.0 and jerk < math.inf):
        return math.inf
    return power(jerk * (table[PLAN.s, k + 1] - table[PLAN.s, k]) / change, 2.0 / 3.0)


@inlined
def _lower(least, limit, bound, name):
    """The smaller one of two bounds and its name, the first where they are equal."""
    return (bound, name) if bound < least else (least, limit)


@inlined
def _grip_in_bend(k, car, table):
    """Grip (m/s^2) that a bend may ask for sideways: on a descent, what is left where braking holds the speed."""
    slope, grip = table[PLAN.slope, k], table[PLAN.grip, k]
    if slope >= 0.0 or grip <= -slope:
        return grip
    steady = (1.0 + car.front / table[PLAN.cosine, k] * slope) * sqrt(grip * grip - slope * slope)
    return steady if steady > abs(table[PLAN.tilt, k]) else grip


@inlined
def _bound_between(k, car, planning):
    """The largest v^2 between two places, whatever comes before and after, and what bounds it."""
    table, bounds = planning.table, planning.bounds
    curvature, tilt, limit = table[PLAN.curvature, k], table[PLAN.tilt, k], table[PLAN.speed_limit, k]
    least, binding = _square_in_bend(bounds.lateral, curvature, tilt), SPEED_LIMIT.lateral
    grip = _grip_in_bend(k, car, table)
    least, binding = _lower(least, binding, _square_in_bend(grip, curvature, tilt), SPEED_LIMIT.grip)
    least, binding = _lower(
        least, binding, _square_of_turning(k, bounds.lateral_jerk, table), SPEED_LIMIT.curvature_rate
    )
    least, binding = _lower(least, binding, limit * limit, SPEED_LIMIT.speed_limit)
    least, binding = _lower(least, binding, table[PLAN.margins, k], SPEED_LIMIT.margins)
    if not math.isnan(bounds.top_speed):
        return _lower(least, binding, square(bounds.top_speed), SPEED_LIMIT.top_speed)
    if limit > bounds.no_limit:
        return _lower(least, binding, square(bounds.domain_speed), SPEED_LIMIT.domain)
    return least, binding


@inlined
def _write_grip(planning):
    """Write pull and grip between the places: `OK`, or where a bank alone is too much."""
    table, share = planning.table, planning.bounds.grip_share
    _, places = table.shape
    for k in range(places - 1):
        bank = table[PLAN.bank, k]
        grip = share * table[PLAN.friction, k] * GRAVITY * cos(bank)
        table[PLAN.tilt, k] = GRAVITY * sin(bank)
        table[PLAN.grip, k] = min(grip, share * table[PLAN.cornering, k]) * table[PLAN.cosine, k]
    for k in range(places - 1):
        allowed = min(table[PLAN.grip, k], planning.bounds.lateral)
        if not abs(table[PLAN.tilt, k]) < allowed:
            return (CANNOT_TURN if allowed == 0.0 else TOO_STEEP), k, allowed
    return OK, 0, 0.0


@inlined
def _write_ceiling(car, planning):
    """Write the largest v^2 at each place, whatever comes before and after, and what bounds it."""
    table = planning.table
    _, places = table.shape
    before, named_before = math.inf, SPEED_LIMIT.lateral
    for k in range(places):
        after, limit = math.inf, SPEED_LIMIT.lateral
        if k < places - 1:
            after, limit = _bound_between(k, car, planning)
        table[PLAN.ceiling, k] = min(before, after)
        table[PLAN.named, k] = named_before if before <= after else limit
        before, named_before = after, limit
    for i in range(planning.stops.size):
        for k in range(places):
            if table[PLAN.s, k] == planning.stops[i]:
                table[PLAN.ceiling, k], table[PLAN.named, k] = 0.0, SPEED_LIMIT.ends


@inlined
def _lower_end(speed, k, table):
    """Let a road begin, or end, with a speed (m/s; NaN: any): whether that is possible, and the highest (m/s)."""
    most = sqrt(table[PLAN.ceiling, k])
    if math.isnan(speed):
        return True, most
    if speed > most * (1.0 + ABOVE):
        return False, most
    table[PLAN.ceiling, k], table[PLAN.named, k] = speed * speed, SPEED_LIMIT.ends
    return True, most


@inlined
def _sustained(most, car, planning):
    """The largest v^2, up to `most`, at which the car's power holds the speed at the start."""
    if _drive(0, most, car, planning) >= 0.0:
        return most
    low, high = 0.0, most
    for _ in range(POWER_HALVINGS):
        middle = 0.5 * (low + high)
        if _drive(0, middle, car, planning) >= 0.0:
            low = middle
        else:
            high = middle
    return low


# -- the two passes ---------------------------------------------------------------------------------------------------
@inlined
def _reached(bound, k, w, ceiling, car, planning):
    """v^2 at the other end of a cell, with the acceleration (`_drive`) or deceleration (`_brake`) possible at both."""
    way = 2.0 * (planning.table[PLAN.s, k + 1] - planning.table[PLAN.s, k])
    reached = max(min(ceiling, w + way * bound(k, w, car, planning)), 0.0)
    return max(min(reached, w + way * bound(k, reached, car, planning)), 0.0)


@inlined
def _close(w):
    """Let both ends of a lap be as slow as the slower one."""
    last = w.size - 1
    w[0] = w[last] = min(w[0], w[last])


@inlined
def _pass(car, planning):
    """Forward, then backward; on a closed road once around before it counts."""
    w, laps = planning.table[PLAN.square], 2 if planning.route.line.numbers[CLOSED] > 0.5 else 1
    w[:] = planning.table[PLAN.ceiling]
    for lap in range(laps):
        if lap > 0:
            _close(w)
        for k in range(w.size - 1):
            w[k + 1] = min(w[k + 1], _reached(_drive, k, w[k], w[k + 1], car, planning))
    for lap in range(laps):
        if lap > 0:
            _close(w)
        for k in range(w.size - 2, -1, -1):
            w[k] = min(w[k], _reached(_brake, k, w[k + 1], w[k], car, planning))


@inlined
def _check_slopes(car, planning):
    """`OK`, or why a car comes to rest on a slope where nothing stops it, between which places, and its force.

    The force (m/s^2, over the mass) is that of the drive on a climb, of the brakes on a descent, or of the tyres.
    """
    table = planning.table
    _, places = table.shape
    for k in range(places):
        if table[PLAN.square, k] > 0.0 or table[PLAN.ceiling, k] <= 0.0:
            continue
        before, after = max(k - 1, 0), min(k, places - 2)
        if _drive(before, 0.0, car, planning) < 0.0:
            _, by_grip, by_force = _drives(before, 0.0, car, planning)
            loss = _slowed(before, 0.0, car, table) + table[PLAN.slope, before]
            return (TOO_SLIPPERY if by_grip < by_force else TOO_WEAK), before, min(by_grip, by_force) + loss
        if _brake(after, 0.0, car, planning) < 0.0:
            _, by_grip, by_force, by_margins = _brakings(after, 0.0, car, planning)
            force = min(min(by_grip, by_force), by_margins) - table[PLAN.slope, after]
            return (TOO_SLIPPERY if by_grip < by_force else TOO_WEAK), after, force
    return OK, 0, 0.0


@exported(several(int64, int64, float64)(Planning))
def fastest_speeds(planning):
    """Write ceilings and the squares of the fastest speeds, of a table that `plan_cells` and the caller have written.

    The answer is `OK`, or what is not possible, at which place, and the number that bounds it: m/s^2 allowed
    sideways, m/s possible at the end or at the start, m/s^2 available on a grade.
    """
    table, bounds = planning.table, planning.bounds
    _, places = table.shape
    status, place, allowed = _write_grip(planning)
    if status != OK:
        return status, place, allowed
    last, car = places - 1, _powertrain(planning.car)
    _write_ceiling(car, planning)
    fits, most = _lower_end(bounds.start, 0, table)
    if not fits:
        return START_TOO_FAST, 0, most
    fits, most = _lower_end(bounds.end, last, table)
    if not fits:
        return END_TOO_FAST, last, most
    if planning.route.line.numbers[CLOSED] > 0.5:
        slower = last if table[PLAN.ceiling, last] < table[PLAN.ceiling, 0] else 0
        for row in (PLAN.ceiling, PLAN.named):
            table[row, 0] = table[row, last] = table[row, slower]
    elif math.isnan(bounds.start) and (planning.car.size > 0 or table[PLAN.slope, 0] > 0.0):
        table[PLAN.ceiling, 0] = min(table[PLAN.ceiling, 0], _sustained(table[PLAN.ceiling, 0], car, planning))
    _pass(car, planning)
    status, place, available = _check_slopes(car, planning)
    if status != OK:
        return status, place, available
    if table[PLAN.square, 0] < square(bounds.start) * (1.0 - ABOVE):
        return CANNOT_BRAKE, 0, sqrt(table[PLAN.square, 0])
    return OK, 0, 0.0


@exported(void(Planning, vector, vector))
def plan_accelerations(planning, drive, brake):
    """Write the largest acceleration and deceleration (m/s^2) that hold at both ends between places, at the squares."""
    car, w = _powertrain(planning.car), planning.table[PLAN.square]
    for k in range(w.size - 1):
        drive[k] = min(_drive(k, w[k], car, planning), _drive(k, w[k + 1], car, planning))
        brake[k] = min(_brake(k, w[k], car, planning), _brake(k, w[k + 1], car, planning))


# -- times, and what binds --------------------------------------------------------------------------------------------
@exported(float64(Planning))
def plan_times(planning):
    """Write speeds and times of arrival of the squares; the time (s) in all, standing at stops included."""
    table, stops = planning.table, planning.stops
    _, places = table.shape
    moving = standing = 0.0
    passed = 0
    for k in range(places):
        speed = sqrt(max(table[PLAN.square, k], 0.0))
        table[PLAN.speed, k] = speed
        if k > 0:
            mean = 0.5 * (table[PLAN.speed, k - 1] + speed)  # exact for a constant acceleration
            moving += (table[PLAN.s, k] - table[PLAN.s, k - 1]) / mean if mean > 0.0 else math.inf
        table[PLAN.time, k] = moving + standing
        while passed < stops.size and stops[passed] <= table[PLAN.s, k]:
            standing += planning.seconds[passed]
            passed += 1
    return moving + standing


_four = local(4)


@inlined
def _binds(k, car, planning):
    """Return the bound that limits the acceleration between two places."""
    table, most = planning.table, _four()
    start, there = table[PLAN.square, k], table[PLAN.square, k + 1]
    drive = min(_drive(k, start, car, planning), _drive(k, there, car, planning))
    acceleration = (there - start) / (2.0 * (table[PLAN.s, k + 1] - table[PLAN.s, k]))
    if acceleration >= 0.0 or acceleration >= drive / ALL_OF_IT:
        names = (SPEED_LIMIT.accelerate, SPEED_LIMIT.grip, SPEED_LIMIT.power, SPEED_LIMIT.power)
        first, other = _drives(k, start, car, planning), _drives(k, there, car, planning)
        for i in range(3):
            most[i] = min(first[i], other[i])
        most[3] = math.inf
    else:
        names = (SPEED_LIMIT.brake, SPEED_LIMIT.grip, SPEED_LIMIT.brakes, SPEED_LIMIT.margins)
        before, behind = _brakings(k, start, car, planning), _brakings(k, there, car, planning)
        for i in range(4):
            most[i] = min(before[i], behind[i])
    least = 0
    for i in range(1, 4):
        if most[i] < most[least]:
            least = i
    soft = planning.bounds.jerk < math.inf and abs(acceleration) < ALL_OF_IT * most[least]
    return SPEED_LIMIT.jerk if soft else names[least]


@exported(void(Planning))
def plan_binding(planning):
    """Write what bounds the speed between the places.

    Where both ends are at their ceilings, that of the slower one; else what bounds the acceleration.
    """
    table, car = planning.table, _powertrain(planning.car)
    _, places = table.shape
    for k in range(places - 1):
        start, there = table[PLAN.square, k], table[PLAN.square, k + 1]
        low, high = table[PLAN.ceiling, k] * (1.0 - AT_CEILING), table[PLAN.ceiling, k + 1] * (1.0 - AT_CEILING)
        if start >= low and there >= high:
            table[PLAN.binding, k] = table[PLAN.named, k] if start <= there else table[PLAN.named, k + 1]
        else:
            table[PLAN.binding, k] = _binds(k, car, planning)


# -- all of it --------------------------------------------------------------------------------------------------------
@exported(void(Planning))
def plan_cells(planning):
    """Write the places, and what the road says between them, to the table; any cornering, and any margins."""
    write_cells(planning.route, planning.bounds.spacing, planning.stops, planning.table)


_limits = local(BENDS)


@inlined
def _write_cornering(planning):
    """Write what the car can corner with between the places, by the tables of their frictions."""
    table, limits, last_curvature, tightest = planning.table, _limits(), math.nan, 0.0
    _, places = table.shape
    for k in range(places - 1):
        friction = table[PLAN.friction, k]
        if friction != last_curvature:
            tightest = cornering_limits(planning.car, planning.bounds.steering_limit, friction, limits)
            last_curvature = friction
        table[PLAN.cornering, k] = cornering_at(table[PLAN.curvature, k], tightest, limits)


@inlined
def _comfortable(bounds):
    """Whether comfort is made of numbers above 0."""
    along = bounds.accelerate > 0.0 and bounds.brake > 0.0
    return along and bounds.lateral > 0.0 and bounds.lateral_jerk > 0.0 and bounds.grip_share > 0.0


@exported(several(int64, int64, float64, float64)(Planning))
def plan_along_road(planning):
    """Write a whole plan, whatever its jerk along the road: whether it can be, and the time (s).

    The answer is that of `fastest_speeds`, or why there is nothing to plan.
    """
    _, places = planning.table.shape
    if places < 2:
        return NO_PLACES, 0, 0.0, 0.0
    if not _comfortable(planning.bounds):
        return NO_BOUNDS, 0, 0.0, 0.0
    plan_cells(planning)
    if planning.car.size > 0:
        _write_cornering(planning)
    status, place, value = fastest_speeds(planning)
    if status != OK:
        return status, place, value, 0.0
    duration = plan_times(planning)
    plan_binding(planning)
    return status, place, value, duration


@exported(float64(float64, Planning))
def plan_constant(speed, planning):
    """Write one speed (m/s) all along a road, whatever its limits: places, speeds and times; the time (s) in all."""
    plan_cells(planning)
    for k in range(planning.table.shape[1]):
        planning.table[PLAN.square, k] = square(speed)
    return plan_times(planning)
