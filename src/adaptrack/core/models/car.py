"""The numbers of a car and of its steering, each defined once; a number without a default must be given."""

from __future__ import annotations

import math

from ..kernel import Field, record, unpacker

_UNKNOWN = math.nan
SIDE_FORCE_SLOPE, YAW_MOMENT_SLOPE = 3.0, 1.0
"""1/rad, of a car whose wind coefficients are unknown."""
BODY = (
    Field("mass", "kg", _UNKNOWN, "total mass m", "(0, 1e5]"),
    Field("yaw_inertia", "kg m^2", _UNKNOWN, "I_z about the centre of gravity", "(0, 1e7]"),
    Field("lf", "m", _UNKNOWN, "l_f, centre of gravity to front axle", "(0, 20]"),
    Field("lr", "m", _UNKNOWN, "l_r, centre of gravity to rear axle", "(0, 20]"),
)
STIFFNESS = (
    Field("stiffness_front", "N/rad", _UNKNOWN, "C_f of one tyre in the prediction model", "(0, 1e7]"),
    Field("stiffness_rear", "N/rad", _UNKNOWN, "C_r of one tyre in the prediction model", "(0, 1e7]"),
)
CHASSIS = (
    *BODY,
    Field("track_front", "m", 1.5, "distance of the front wheels", "(0, 10]"),
    Field("track_rear", "m", 1.5, "distance of the rear wheels", "(0, 10]"),
    Field("cg_height", "m", 0.55, "centre of gravity above the road", "[0, 5]"),
    Field("load_transfer_time", "s", 0.1, "lag of the suspension from acceleration to wheel load", "(0, 10]"),
    Field("frontal_area", "m^2", 2.0, "reference area A_f of all air forces", "[0, 50]"),
    Field("air_density", "kg/m^3", 1.225, "density of the air", "[0, 10]"),
    Field("drag_coefficient", "", 0.3, "of the air drag", "[0, 10]"),
    Field("side_force_slope", "1/rad", SIDE_FORCE_SLOPE, "side-force coefficient per relative wind angle", "[0, 100]"),
    Field("yaw_moment_slope", "1/rad", YAW_MOMENT_SLOPE, "yaw-moment coefficient (on the wheelbase) per wind angle",
          "[0, 100]"),
    Field("wind_angle_limit", "rad", 0.3, "both coefficients stay constant beyond it", f"(0, {0.5 * math.pi}]"),
    Field("rolling_resistance", "", 0.013, "rolling resistance over weight", "[0, 1]"),
    Field("engine_power", "W", 1e5, "at the wheels", "(0, 1e7]"),
    Field("traction_limit", "N", 8000.0, "driving force, all wheels together", "(0, 1e6]"),
    Field("brake_limit", "N", 15000.0, "braking force, all wheels together", "(0, 1e6]"),
    Field("drive_front", "", 1.0, "share of the driving force on the front axle", "[0, 1]"),
    Field("brake_front", "", 0.65, "share of the braking force on the front axle", "[0, 1]"),
)  # fmt: skip
"""Body, air resistance and powertrain: a car without its tyres and its steering."""
CAR = (*BODY, *STIFFNESS, *CHASSIS[len(BODY) :])
SINGLE_TRACK = (*BODY, *STIFFNESS)
"""What a prediction model knows."""
POWERTRAIN = tuple(
    field for field in CHASSIS if field.name in ("mass", "engine_power", "traction_limit", "brake_limit")
)
"""What a driver may ask for."""
AXLES = tuple(field for field in CHASSIS if field.name in ("lf", "lr", "cg_height", "drive_front", "brake_front"))
"""What tells the loads of the axles."""
WIND = tuple(field for field in CHASSIS if field.name in ("frontal_area", "side_force_slope", "yaw_moment_slope"))
"""What the wind acts on."""

ACTUATOR_LAG = Field("lag", "s", _UNKNOWN, "time constant of the first-order lag; 0: none", "[0, 10]")
ACTUATOR_DEAD_TIME = Field("dead_time", "s", _UNKNOWN, "from a command until the wheels begin to move", "[0, 10]")
ACTUATOR_RATE = Field("rate", "rad/s", _UNKNOWN, "fastest change of the angle", "(0, 100]")
ACTUATOR_LIMIT = Field("limit", "rad", _UNKNOWN, "largest angle to either side", f"(0, {0.5 * math.pi}]")
STEERING_WHEEL_RATIO = Field(
    "ratio", "", _UNKNOWN, "angle of the steering wheel over that of the road wheels", "(0, 100]"
)
STEERING = (ACTUATOR_LAG, ACTUATOR_DEAD_TIME, ACTUATOR_RATE, ACTUATOR_LIMIT)
"""A steering between command and road wheels."""
ACTUATOR = (
    ACTUATOR_LAG._replace(default=0.0),
    ACTUATOR_DEAD_TIME._replace(default=0.0),
    ACTUATOR_RATE._replace(default=math.inf, meaning=f"{ACTUATOR_RATE.meaning}; inf: no limit", bounds="(0, inf]"),
    ACTUATOR_LIMIT._replace(default=0.5 * math.pi),
    Field("bias", "rad", 0.0, "what the wheels turn beyond the command", f"[{-0.25 * math.pi}, {0.25 * math.pi}]"),
)
"""The steering of a simulated car."""
FORCE_ACTUATOR = (
    ACTUATOR_LAG._replace(default=0.0),
    ACTUATOR_DEAD_TIME._replace(default=0.0, meaning="from a request until the force begins to change"),
    Field("gain", "", 1.0, "force that is reached over the requested one", "(0, 10]"),
    Field("rate", "m/s^3", math.inf, "fastest change of the force over the mass; inf: any", "(0, inf]"),
)
"""Drive or brakes of a simulated car."""
OUTLINE = (
    Field("length", "m", _UNKNOWN, "over all", "(0, 30]"),
    Field("width", "m", _UNKNOWN, "without mirrors", "(0, 10]"),
    Field("front_overhang", "m", _UNKNOWN, "front axle to the front end", "[0, 10]"),
    Field("rear_overhang", "m", _UNKNOWN, "rear axle to the rear end", "[0, 10]"),
)
"""A car from above."""

_SIGMA = "standard deviation"
_LOGARITHM_SIGMA = "standard deviation of the logarithm"
LEARNED_CAR = (
    Field("lag", "s", _UNKNOWN, "of the steering", "[0, 10]"),
    Field("lag_sigma", "s", _UNKNOWN, _SIGMA, "[0, 10]"),
    Field("dead_time", "s", _UNKNOWN, "of the steering, without the computation", "[0, 10]"),
    Field("dead_time_sigma", "s", _UNKNOWN, _SIGMA, "[0, 10]"),
    Field("delay_sigma", "s", _UNKNOWN, f"{_SIGMA} of lag and dead time together", "[0, 10]"),
    Field("stiffness", "", _UNKNOWN, "factor on the cornering stiffness over mass of the car file", "(0, 100]"),
    Field("stiffness_sigma", "", _UNKNOWN, _LOGARITHM_SIGMA, "[0, 10]"),
    Field("balance", "", 1.0, "factor on front over rear stiffness", "(0, 100]"),
    Field("balance_sigma", "", 0.1, _LOGARITHM_SIGMA, "[0, 10]"),
    Field("bias", "rad", 0.0, "by which the wheels turn beyond the command", "[-1, 1]"),
    Field("bias_sigma", "rad", 0.0, _SIGMA, "[0, 1]"),
)
"""What is learned of a car while it drives."""

CarRow = record("CarRow", CAR)
"""A car; NaN: unknown, see `synthesis.car.complete_car`."""
SingleTrackCar = record("SingleTrackCar", SINGLE_TRACK)
SteeringRow = record("SteeringRow", STEERING)
"""A steering; NaN: unknown."""
LearnedRow = record("LearnedRow", LEARNED_CAR)
"""A learned or assumed car; a lag of NaN: none."""


_PARAMETERS = (
    *CHASSIS,
    # tyre
    "tyre_linear",  # 1 linear, 0 Magic Formula
    "stiffness_front",  # N/rad per tyre at the nominal load
    "stiffness_rear",  # N/rad per tyre at the nominal load
    "nominal_load",  # N
    "stiffness_load_0",  # stiffness(F_z)/stiffness = (s0 + s1 q)/(1 + s2 q^2), q = F_z/nominal_load
    "stiffness_load_1",
    "stiffness_load_2",
    "shape",  # Magic Formula C
    "curvature",  # Magic Formula E
    "friction_load_sensitivity",  # D = mu F_z (1 - d (q - 1))
    "relaxation_length",  # m, 0: none
    # steering actuator
    "steering_lag",  # s, 0: none
    "steering_rate",  # rad/s, inf: none
    "steering_limit",  # rad
)
PlantParameters = record("PlantParameters", _PARAMETERS)
PLANT_PARAMETERS = PlantParameters._fields
"""The plants' packed parameters, in this order; a user's plant packs its own record behind its own names."""
unpack = unpacker(PlantParameters)
