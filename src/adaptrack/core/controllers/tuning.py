"""The tuning of an MPC; each entry is defined once."""

from __future__ import annotations

from ..kernel import Field, defaults, record

MPC_TUNING_FIELDS = (
    Field("Np", "control periods", 35, "prediction horizon", "[1, inf)"),
    Field("Nc", "control periods", 8, "control horizon", "[1, inf)"),
    Field("Q", "1/m^2", 10.0, "weight of the tracking error", "[0, inf)"),
    Field("R", "1/rad^2", 0.01, "weight of the moves", "(0, inf)"),
)
MPCTuning = record("MPCTuning", MPC_TUNING_FIELDS)
PAPER_TUNING = defaults(MPCTuning)
"""The tuning of the paper's table."""
