"""The simulated car: plant parameters, integration steps and outline, from car, tyre and steering actuator.

    car, tyre, actuator    -> plant_parameters, plant_law, plant_substeps: what a plant is driven with
    plant parameters           -> tyre_forces
    delay, dead time           -> dead_periods: `core.simulation.world.LoopSettings.dead_whole` and `dead_share`
    body, car              -> outline_of

Axes of ISO 8855; stiffness and load are those of one tyre.
"""

from __future__ import annotations

import math

from ..kernel import OK, Row, exported, float64, inlined, int64, matrix, packer, record, several, vector, void
from ..maths.bits import whole
from ..maths.exact import ceil, square
from ..models.car import ACTUATOR, CHASSIS, OUTLINE, CarRow, unpack
from ..physics.tyre import lateral_force, tyre_law
from .car import static_loads
from .filter import split_periods

TyreRow = record(
    "TyreRow",
    (
        "linear",  # 1: F = C mu alpha, 0: Magic Formula
        "stiffness_front", "stiffness_rear",  # N/rad, at the nominal load
        "nominal_load",  # N
        "stiffness_load",  # `CONSTANT_STIFFNESS`, ...
        "digressive_load_ratio",  # -, load over nominal load at which a digressive stiffness peaks
        "shape_factor", "curvature",  # C and E of the Magic Formula
        "friction_load_sensitivity",  # -
        "relaxation_length",  # m, 0: none
    ),
    integers=("linear", "stiffness_load"),
)  # fmt: skip
"""A tyre, see `adaptrack.cars.vehicle.Tyre`."""
CONSTANT_STIFFNESS, LINEAR_STIFFNESS, DIGRESSIVE_STIFFNESS = range(3)
"""How the stiffness depends on the load."""
Actuator = record("Actuator", ACTUATOR)
"""The steering of a simulated car."""

MAX_PLANT_STEP, STABLE, STEP_ROUNDING = 0.0125, 2.2, 1e-9
"""s; -, step times the fastest rate of a mode, within the region where Runge-Kutta is stable; of a number of steps."""
MIN_RELAXATION_SPEED = 1.0
"""m/s, below which no tyre relaxes more slowly."""

BodyRow = record("BodyRow", OUTLINE)
"""A car's outline; NaN: unknown."""
OutlineRow = record("OutlineRow", ("front", "rear", "width"))
"""m, from the centre of mass to either end, and the width without mirrors."""
LENGTH_OVER_WHEELBASE = 1.65
"""Length over wheelbase where nobody says length or overhangs: passenger cars have 1.55 to 1.75."""
FRONT_SHARE = 0.45
"""Share of the front in what the body is longer than the wheelbase, where nobody says it."""
WIDER_THAN_TRACK = 0.24
"""m, by which a body is wider than its larger track, where nobody says its width: mirrors do not count."""
AXLE_OUTSIDE, LENGTH_DISAGREES = range(1, 3)
"""What `overhangs` answers: fine; no room for an axle; length, wheelbase and overhangs differ."""
MATCHING = 0.02
"""m, by which they may differ."""
_pack = packer(record("Chassis", CHASSIS))


# -- tyre -------------------------------------------------------------------------------------------------------------
@exported(several(float64, float64, float64)(Row(TyreRow)))
def stiffness_coefficients(tyre):
    """(s0, s1, s2) of C(F_z)/C = (s0 + s1 q)/(1 + s2 q^2), q = F_z/nominal_load: all three laws in one formula."""
    if tyre.stiffness_load == CONSTANT_STIFFNESS:
        return 1.0, 0.0, 0.0
    if tyre.stiffness_load == LINEAR_STIFFNESS:
        return 0.0, 1.0, 0.0
    s2 = 1.0 / square(tyre.digressive_load_ratio)
    return 0.0, 1.0 + s2, s2


@inlined
def _stiffness(tyre, stiffness, load):
    s0, s1, s2 = stiffness_coefficients(tyre)
    q = load / tyre.nominal_load
    return stiffness * (s0 + s1 * q) / (1.0 + s2 * square(q))


@exported(several(float64, float64)(Row(TyreRow), float64, float64))
def tyre_stiffness(tyre, front_load, rear_load):
    """Cornering stiffness (N/rad) of one front and one rear tyre at their vertical loads (N)."""
    return _stiffness(tyre, tyre.stiffness_front, front_load), _stiffness(tyre, tyre.stiffness_rear, rear_load)


@exported(int64(Row(TyreRow)))
def plant_law(tyre):
    """Which plant drives on it: `physics.tyre.LINEAR`, `MAGIC_FORMULA` or `CURVED_MAGIC_FORMULA`."""
    return tyre_law(tyre.linear > 0, tyre.curvature)


# -- plant ------------------------------------------------------------------------------------------------------------
@exported(void(Row(CarRow), Row(TyreRow), Row(Actuator), vector))
def plant_parameters(car, tyre, actuator, parameters):
    """Write `models.car.PlantParameters`."""
    _pack(parameters, 0, car)
    p = parameters[len(CHASSIS) :]
    p[0] = 1.0 if tyre.linear > 0 else 0.0
    p[1], p[2], p[3] = tyre.stiffness_front, tyre.stiffness_rear, tyre.nominal_load
    p[4], p[5], p[6] = stiffness_coefficients(tyre)
    p[7], p[8], p[9] = tyre.shape_factor, tyre.curvature, tyre.friction_load_sensitivity
    p[10] = tyre.relaxation_length
    p[11], p[12], p[13] = actuator.lag, actuator.rate, actuator.limit


@exported(void(vector, float64, matrix, vector))
def tyre_forces(plant, friction, wheels, forces):
    """Write the lateral forces (N) of tyres at rows (n, 3) of slip (rad), vertical load (N) and rear (1) or front (0).

    plant: `models.car.PLANT_PARAMETERS`.
    """
    car = unpack(plant)
    law = tyre_law(car.tyre_linear > 0.5, car.curvature)
    for i in range(len(wheels)):
        stiffness = car.stiffness_rear if wheels[i, 2] > 0.5 else car.stiffness_front
        forces[i] = lateral_force(wheels[i, 0], wheels[i, 1], friction, stiffness, car, law)


@exported(float64(Row(CarRow), Row(TyreRow)))
def lateral_rate(car, tyre):
    """The fastest rate (1/s) of lateral and yaw motion at 1 m/s, the lowest speed of the slip angles."""
    front, rear = static_loads(car)
    front, rear = tyre_stiffness(tyre, front, rear)
    front, rear = 2.0 * front, 2.0 * rear
    turning = front * square(car.lf) + rear * square(car.lr)
    return max((front + rear) / car.mass, turning / car.yaw_inertia)


@exported(int64(Row(CarRow), Row(TyreRow), int64, float64, float64))
def plant_substeps(car, tyre, relaxes, period, top_speed):
    """Runge-Kutta steps in a control period (s) that keep every mode stable up to a speed (m/s).

    relaxes: 1: the plant's tyres build up their force over the relaxation length (dual track), 0: at once.
    """
    if relaxes > 0 and tyre.relaxation_length > 0.0:
        rate = max(top_speed, MIN_RELAXATION_SPEED) / tyre.relaxation_length
    else:
        rate = lateral_rate(car, tyre)
    steps = max(ceil(period / MAX_PLANT_STEP - STEP_ROUNDING), ceil(period * rate / STABLE - STEP_ROUNDING))
    return max(1, whole(steps))


@exported(several(int64, float64)(float64, float64, float64))
def dead_periods(delay, dead_time, period):
    """From an instant until its command acts: whole control periods (s), and the share of one more.

    delay: control periods of computation; dead_time: s, of the steering.
    """
    return split_periods(delay * period + dead_time, period)


# -- outline ----------------------------------------------------------------------------------------------------------
@exported(several(int64, float64, float64)(Row(BodyRow), float64))
def overhangs(body, wheelbase):
    """`OK` or what is wrong, and front and rear overhang (m) over a wheelbase (m), estimated where not given."""
    front, rear = body.front_overhang, body.rear_overhang
    if not math.isnan(body.length):
        beyond = body.length - wheelbase
    elif not (math.isnan(front) or math.isnan(rear)):
        beyond = front + rear
    elif not math.isnan(front):
        beyond = front / FRONT_SHARE
    elif not math.isnan(rear):
        beyond = rear / (1.0 - FRONT_SHARE)
    else:
        beyond = (LENGTH_OVER_WHEELBASE - 1.0) * wheelbase
    if math.isnan(front):
        front = FRONT_SHARE * beyond if math.isnan(rear) else beyond - rear
    if math.isnan(rear):
        rear = beyond - front
    if min(front, rear) < 0.0:
        return AXLE_OUTSIDE, front, rear
    return (LENGTH_DISAGREES if abs(front + rear - beyond) > MATCHING else OK), front, rear


@exported(int64(Row(BodyRow), Row(CarRow), Row(OutlineRow)))
def outline_of(body, car, outline):
    """Write the rectangle that a car fills; what is not given is estimated from wheelbase and track. As `overhangs`."""
    status, front, rear = overhangs(body, car.lf + car.lr)
    outline.front, outline.rear, outline.width = car.lf + front, car.lr + rear, body.width
    if math.isnan(body.width):
        outline.width = max(car.track_front, car.track_rear) + WIDER_THAN_TRACK
    return status
