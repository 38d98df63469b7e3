"""Horizons and weights of the informed MPC for a loop."""

from __future__ import annotations

import math

from ..kernel import Row, exported, float64, int64, record, vector, void
from ..maths.decimal import to_digits, to_places
from ..models.contract import MEASURED_MOTION

ControllerWorld = record(
    "ControllerWorld",
    (
        "period",  # s, control period
        "computation",  # s, from a measurement until its command is given
        "preview",  # 1: the reference is known ahead
        "move_weight",  # s^2, R/Q times the squared control period that the drive's cost asks for
        *MEASURED_MOTION,
        "oldest",  # s, age of a sample at most
    ),
    integers=("preview",),
)  # fmt: skip
"""Loop and sensors, as the controller knows them."""

UNSEEN = 3.0
"""Factor on R where the lateral velocity is not measured: what the filter makes of it is less sure. On seven cars
random drives in `production` cost a quarter less, half on the van and the electric car, a fifth more on the paper's."""
ASSUMED_DELAY_CAUTION = 10.0
"""Factor on R where the delay of the steering is assumed."""
HORIZON_DURATION, MOVES_DURATION = 1.5, 0.5
"""s, over which the outputs are predicted and the command may change, with preview."""
BLIND_HORIZON, BLIND_MOVES = 3.5, 0.8
"""s, the same without preview, as in the paper's table: a reference that is held is followed too eagerly in less."""
BLIND_MOVE_WEIGHT = 1e-5
"""s^2, R/Q times the squared control period where the profile gives them none and the reference is not known ahead:
that of the paper's table."""
LEAST_MOVE_WEIGHT = 1e-2
"""s^2, the same where it is known ahead. On six cars and twelve roads in `paper`: J 4e-6 m^2, none of 72 runs failed;
with weight and horizons as without preview 3e-4 m^2, and 7 failed."""


@exported(void(Row(ControllerWorld), float64, int64, int64, vector))
def tune_informed(world, caution, longest_horizon, most_moves, tuning):
    """Write Np, Nc, Q = 1 and R (4,): fixed times over the control period, and the least weight or the world's own.

    caution: factor on R; longest_horizon, most_moves: Np and Nc at most.
    """
    step = world.period
    least = LEAST_MOVE_WEIGHT if world.preview > 0 else BLIND_MOVE_WEIGHT
    weight = max(world.move_weight, least) / (step * step)
    weight *= caution * (1.0 if world.noise_vy < math.inf else UNSEEN)
    ahead, free = (HORIZON_DURATION, MOVES_DURATION) if world.preview > 0 else (BLIND_HORIZON, BLIND_MOVES)
    tuning[0] = min(max(2.0, to_places(ahead / step, 0)), float(longest_horizon))
    tuning[1] = min(max(1.0, to_places(free / step, 0)), float(most_moves))
    tuning[2], tuning[3] = 1.0, to_digits(weight, 6)
