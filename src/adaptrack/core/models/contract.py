"""What a prediction model is to the controller: x(k+1) = A x(k) + B u(k) + E w(k), y(k) = C x(k).

A model is one compiled function; its size n, its output row C (n,) and the measured quantities that its states are
(`MEASUREMENT`, by place) stand beside it. u: steering command (rad); w: known input, curvature of the road times speed
(rad/s), which is zero on a straight road.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ..kernel import Caller, columns, float64, matrix, vector, void
from ..member import member

MEASUREMENT = columns(
    "vy", "yaw", "yaw_rate", "y", "wheel_angle",  # m/s, rad, rad/s, m, rad: the states of a model are some of these
    "lateral_acceleration",  # m/s^2, of an accelerometer: it does not feel the pull of a banked road
    "pose_age", "motion_age",  # s, how old yaw and y are, and all others
    "turned",  # rad, heading of the path at the foot of the car now less that of a period ago
)  # fmt: skip
"""What the sensors give; what is missing is not finite. On a curved road yaw and y count from the path."""

DISCRETISE = void(float64, float64, vector, matrix, vector, vector)
"""``discretise(speed, period, parameters, a, b, e)``: write A (n, n), B (n,) and E (n,) of one control period (s) at a
speed (m/s, > 0)."""
call_discretise = Caller(DISCRETISE)


@lru_cache(maxsize=64)
def compile_model(function: Any) -> Any:
    """A user's function as a member of `DISCRETISE`."""
    return member(function, DISCRETISE)
