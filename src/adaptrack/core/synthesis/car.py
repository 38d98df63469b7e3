"""A car as controllers know it, what is estimated of one of which little is known, and what a speed control assumes."""

from __future__ import annotations

import math

from ..kernel import OK, Row, exported, float64, inlined, int64, local, record, several, vector
from ..maths.decimal import to_digits, to_places
from ..models.car import SIDE_FORCE_SLOPE, YAW_MOMENT_SLOPE, CarRow
from ..models.car import SteeringRow as SteeringRow
from ..physics.forces import GRAVITY
from ..planning.cornering import BENDS, cornering_at, cornering_limits

ESTIMATED_NUMBERS = (
    "cg_height", "frontal_area", "yaw_inertia", "stiffness_front", "stiffness_rear", "track_front", "track_rear",
)  # fmt: skip
"""Numbers that `complete_car` estimates, besides the place of the centre of gravity."""
KnownWithinRow = record(
    "KnownWithinRow",
    (
        "is_given",  # 1: the numbers of the car come with how well they are known, 0: nobody says
        "mass",  # factor
        "lf",  # m, to either side
        *ESTIMATED_NUMBERS,  # lengths in m, to either side; the others are factors
        "steering_lag", "steering_dead_time",  # s, to either side
    ),
    integers=("is_given",),
)  # fmt: skip
"""How far each number may be off; NaN: not said."""

# -- measured cars ----------------------------------------------------------------------------------------------------
MASSES, WHEELBASES = (600.0, 3500.0), (1.7, 5.0)
"""kg, m: beyond these the measurements say nothing."""
FRONT_DISTANCE, FRONT_DISTANCE_SPREAD = 0.42, 0.06
"""-, l_f over the wheelbase: mean 0.416, 5 to 95 % from 0.39 to 0.50 in 42 cars of opendbc, `centerToFrontRatio`."""
AXLE_COEFFICIENTS = (13.8, 21.9)
"""1/rad, cornering stiffness of the front and the rear axle over its load: that of a Honda Civic in opendbc (192.15 and
202.5 kN/rad at 1462 kg, l_f at 0.4 of the wheelbase) times 0.62, the middle (geometric) of its `tireStiffnessFactor`,
0.385 to 1, of 79 cars."""
STIFFNESS_FACTOR = 1.62
"""-, by which that factor differs to either side. The axles of three cars of N. Kapania's published programs
(nkapania/Wolverine: 15.8 to 18.7 in front, 21.5 to 28.7 behind) and of an Acura TSX (kktse.github.io, 2019: 6.7 and
3.1 deg/g, thus 8.6 and 18.5) lie within."""
AREA_FACTOR = 1.25

BodyStyle = record(
    "BodyStyle",
    (
        "dynamic_index", "dynamic_index_factor",  # -, I_z/(m l_f l_r), and the factor that covers 5 to 95 % of the cars
        "cg_height", "cg_height_margin",  # m
        "track", "track_per_mass", "track_margin",  # m at 0 kg, m/kg, m
        "frontal_area",  # m^2; ours
    ),
)  # fmt: skip
"""What measured cars of a kind have in common."""
PASSENGER_BODY = BodyStyle(1.09, 1.15, 0.548, 0.05, 1.229, 1.97e-4, 0.06, 2.1)
TRUCK = BodyStyle(1.00, 1.15, 0.667, 0.12, 1.229, 1.97e-4, 0.15, 2.7)
"""Passenger cars; pickups, vans and sport utility vehicles.

Dynamic index: 73 cars and 131 trucks of NHTSA's Light Vehicle Inertial Parameter Database of 1998 (Heydinger, Bixel,
Garrott, Pyne, Howe, Guenther: Measured Vehicle Inertial Parameters, SAE 1999-01-1336): mean 1.091 and 1.002, 5 to 95 %
from 0.946 to 1.194 and from 0.870 to 1.145. Height of the centre of gravity: 357 cars of 2001 to 2020 of NHTSA's
rollover rating (Walz, Trends in the Static Stability Factor, HS-809 868, and later years, as collected at
kktse.github.io), mean 0.548 m, 5 to 95 % within 0.05 m; of trucks, the database of 1998. Track: a line through the same
357 cars over mass, standard error 0.035 m, 5 to 95 % within 0.06 m; trucks lie about it.
"""

MASS_OUTSIDE, WHEELBASE_OUTSIDE, TOO_MUCH_LOAD, AXLES_DISAGREE = range(1, 5)
"""What `complete_car` answers."""
MILLIMETRES = 0.005
"""m, by which l_f + l_r and the wheelbase may differ."""


@inlined
def given_or(value, estimate):
    """A number, or where it is not given an estimate."""
    return estimate if math.isnan(value) else value


@inlined
def _spread(value, spread):
    """The spread of a number that is estimated; none of one that is given."""
    return spread if math.isnan(value) else math.nan


@inlined
def _place_axles(wheelbase, car):
    """Fill l_f and l_r; whether they make the wheelbase."""
    front, rear = car.lf, car.lr
    car.lf = given_or(front, given_or(wheelbase - rear, to_places(FRONT_DISTANCE * wheelbase, 4)))
    car.lr = given_or(rear, to_places(wheelbase - car.lf, 6))
    return 0.0 < car.lf < wheelbase and abs(car.lf + car.lr - wheelbase) < MILLIMETRES


@exported(int64(float64, float64, int64, Row(CarRow), Row(KnownWithinRow)))
def complete_car(wheelbase, load, truck, car, within):
    """Estimate what is NaN in a car from its mass and wheelbase (m), and write how well that is known to `within`.

        l_f = 0.42 L +- 0.06 L,   I_z = 1.09 m l_f l_r  x/÷ 1.15,   2 C_f = 13.8 F_zf,  2 C_r = 21.9 F_zr  x/÷ 1.62,
        track = 1.229 m + 1.97e-4 m/kg m +- 0.06 m,   height 0.548 m +- 0.05 m

    with m of the car alone, L the wheelbase and F_z the load of an axle. load: kg beside the car's own mass, at the
    centre of gravity; truck: 1: pickup, van or sport utility vehicle. The mass holds the load afterwards. Answers
    `OK`, or what does not fit: then nothing is written.
    """
    mass, style = car.mass, TRUCK if truck > 0 else PASSENGER_BODY
    if not MASSES[0] <= mass <= MASSES[1]:
        return MASS_OUTSIDE
    if not WHEELBASES[0] <= wheelbase <= WHEELBASES[1]:
        return WHEELBASE_OUTSIDE
    if not 0.0 <= load <= mass:
        return TOO_MUCH_LOAD
    front, rear = car.lf, car.lr
    if not _place_axles(wheelbase, car):
        car.lf, car.lr = front, rear
        return AXLES_DISAGREE
    within.is_given = 1
    unplaced = math.isnan(front) and math.isnan(rear)
    within.lf = to_places(FRONT_DISTANCE_SPREAD * wheelbase, 3) if unplaced else math.nan
    within.mass = within.steering_lag = within.steering_dead_time = math.nan
    within.yaw_inertia = _spread(car.yaw_inertia, style.dynamic_index_factor)
    within.stiffness_front = _spread(car.stiffness_front, STIFFNESS_FACTOR)
    within.stiffness_rear = _spread(car.stiffness_rear, STIFFNESS_FACTOR)
    within.track_front = _spread(car.track_front, style.track_margin)
    within.track_rear = _spread(car.track_rear, style.track_margin)
    within.cg_height = _spread(car.cg_height, style.cg_height_margin)
    within.frontal_area = _spread(car.frontal_area, AREA_FACTOR)

    per_length = 0.5 * (mass + load) * GRAVITY
    track = to_digits(style.track + style.track_per_mass * mass, 4)
    length = car.lf + car.lr
    car.yaw_inertia = given_or(car.yaw_inertia, to_digits(style.dynamic_index * mass * car.lf * car.lr, 4))
    stiff = to_digits(AXLE_COEFFICIENTS[0] * (per_length * car.lr / length), 4)
    car.stiffness_front = given_or(car.stiffness_front, stiff)
    stiff = to_digits(AXLE_COEFFICIENTS[1] * (per_length * car.lf / length), 4)
    car.stiffness_rear = given_or(car.stiffness_rear, stiff)
    car.track_front, car.track_rear = given_or(car.track_front, track), given_or(car.track_rear, track)
    car.cg_height = given_or(car.cg_height, style.cg_height)
    car.frontal_area = given_or(car.frontal_area, style.frontal_area)
    car.side_force_slope = given_or(car.side_force_slope, SIDE_FORCE_SLOPE)
    car.yaw_moment_slope = given_or(car.yaw_moment_slope, YAW_MOMENT_SLOPE)
    car.mass = mass + load
    return OK


# -- what a car is to be ----------------------------------------------------------------------------------------------
INERTIAS, STIFFNESSES = (0.1, 10.0), (1.0, 150.0)
"""-, of I_z/(m l_f l_r): beyond these one of the numbers is in another unit, or of another car. 1/rad, of a tyre's
cornering stiffness over its static load; per degree it is 0.1 to 0.5."""
INERTIA_ODD, FRONT_ODD, REAR_ODD = range(1, 4)
"""What `car_flaw` answers."""


@exported(several(float64, float64)(Row(CarRow)))
def static_loads(car):
    """Vertical load (N) of one front and one rear wheel at rest."""
    per_length = 0.5 * car.mass * GRAVITY / (car.lf + car.lr)
    return per_length * car.lr, per_length * car.lf


@exported(several(int64, float64)(Row(CarRow)))
def car_flaw(car):
    """`OK`, or which number is in another unit than the others, and its ratio, see `INERTIAS`."""
    index = car.yaw_inertia / (car.mass * car.lf * car.lr)
    if not INERTIAS[0] <= index <= INERTIAS[1]:
        return INERTIA_ODD, index
    front, rear = static_loads(car)
    front, rear = car.stiffness_front / front, car.stiffness_rear / rear
    if not STIFFNESSES[0] <= front <= STIFFNESSES[1]:
        return FRONT_ODD, front
    if not STIFFNESSES[0] <= rear <= STIFFNESSES[1]:
        return REAR_ODD, rear
    return OK, index


@exported(float64(Row(CarRow)))
def wind_turn(car):
    """d_r over d_y (1/m) of side wind: L C_ym m/(C_s I_z), 0 for a body that feels none."""
    if car.side_force_slope == 0.0:
        return 0.0
    arm = (car.lf + car.lr) * car.yaw_moment_slope / car.side_force_slope
    return arm * car.mass / car.yaw_inertia


@exported(float64(Row(CarRow)))
def understeer_gradient(car):
    """K (rad s^2/m) = m (l_r/(2 C_f) - l_f/(2 C_r))/L (Rajamani, *Vehicle Dynamics and Control*, section 3.3)."""
    return car.mass / (car.lf + car.lr) * (car.lr / (2.0 * car.stiffness_front) - car.lf / (2.0 * car.stiffness_rear))


@exported(float64(Row(CarRow)))
def rear_slip_gradient(car):
    """W (rad s^2/m) = m l_f/(2 C_r L): slip angle of the rear tyres per lateral acceleration in a steady turn."""
    return car.mass * car.lf / (2.0 * car.stiffness_rear * (car.lf + car.lr))


# -- tyres that build up their force over a distance -------------------------------------------------------------------
TYRE_LATERAL_STIFFNESS = 1.3e5
"""N/m, of a standing tyre; the relaxation length is the cornering stiffness over it (Besselink, Schmeitz, Pacejka,
*Vehicle System Dynamics* 48, 2010). The tyres of the shipped cars have 0.7e5 to 1.8e5, of the paper's car 1.9e5 and
3.3e5."""
RELAXATION_SPEED, RELAXATION_FREQUENCY = 27.0, 8.0
"""m/s and rad/s, at which `relaxation_delay` holds: the top speed of the shipped passenger cars, and the frequency at
which their loops become unstable there without a measured lateral velocity (0.9 to 1.5 Hz)."""


@exported(float64(Row(CarRow)))
def relaxation_delay(car):
    """Dead time (s) with the phase that relaxation of the tyres adds to the yaw rate behind the wheel angle.

        T = sigma/v w^2/(w^2 + a^2),   a = 2 (C_f + C_r)/(m v),   sigma = (C_f + C_r)/2/`TYRE_LATERAL_STIFFNESS`

    To first order in sigma/v, with forces C alpha/(1 + s sigma/v), for a neutral car with I_z = m l_f l_r. It hardly
    changes with the speed v above a m v/w, 18 m/s for the van, and vanishes below.
    """
    stiffness = car.stiffness_front + car.stiffness_rear
    relaxation = 0.5 * stiffness / TYRE_LATERAL_STIFFNESS / RELAXATION_SPEED
    turning = 2.0 * stiffness / (car.mass * RELAXATION_SPEED) / RELAXATION_FREQUENCY
    return to_places(relaxation / (1.0 + turning * turning), 3)


TYPICAL_CURVATURE = 0.02
"""1/m, of the bend in which the car's share of the friction is taken."""
_limits = local(BENDS)


@exported(several(float64, float64)(float64, float64, float64, float64))
def resistance(air_density, frontal_area, drag_coefficient, rolling_resistance):
    """Force of the air over v^2 (kg/m), and deceleration by rolling (m/s^2): `SpeedSettings.drag`, `rolling`."""
    return 0.5 * air_density * frontal_area * drag_coefficient, rolling_resistance * GRAVITY


@exported(float64(vector, float64, float64))
def usable_friction(plant, steering_limit, friction):
    """The friction of which a car reaches all in a bend: load transfer takes some from tyres that lose with load.

    plant: `PLANT_PARAMETERS`; steering_limit: rad, NaN: `STEERING_LIMIT`.
    """
    limits = _limits()
    tightest = cornering_limits(plant, steering_limit, friction, limits)
    limit = cornering_at(TYPICAL_CURVATURE, tightest, limits)
    return friction * min(limit / (friction * GRAVITY), 1.0)
