"""The parameters of the built-in plants, packed in one vector."""

from __future__ import annotations

from ..kernel import record, unpacker
from ..models.car import CHASSIS

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
