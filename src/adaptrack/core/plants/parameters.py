"""The parameters of the built-in plants, packed in one vector."""

from __future__ import annotations

from ..kernel import record, unpacker

CHASSIS = (
    # body
    "mass",  # kg
    "yaw_inertia",  # kg m^2
    "lf",  # m, centre of gravity to front axle
    "lr",  # m, centre of gravity to rear axle
    "track_front",  # m
    "track_rear",  # m
    "cg_height",  # m
    "load_transfer_time",  # s, first-order lag from acceleration to wheel load
    # air
    "frontal_area",  # m^2
    "air_density",  # kg/m^3
    "drag_coefficient",  # -
    "side_force_slope",  # 1/rad, side-force coefficient per relative wind angle
    "yaw_moment_slope",  # 1/rad
    "wind_angle_limit",  # rad, both coefficients stay constant beyond it
    # powertrain
    "rolling_resistance",  # -
    "engine_power",  # W
    "traction_limit",  # N, wheel-force limit of the drivetrain
    "brake_limit",  # N
    "drive_front",  # share of the traction on the front axle, 0..1
    "brake_front",  # share of the braking on the front axle, 0..1
)
"""Of the car without its tyres and its steering."""
PLANT_PARAMETERS = (
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
"""The plants' packed parameters, in this order; a user's plant packs its own record behind its own names."""

PlantParameters = record("PlantParameters", PLANT_PARAMETERS)
unpack = unpacker(PlantParameters)
