"""Data that are not finite never steer."""

import math

import pytest

from adaptrack import Tuning, load_vehicle, published_mpc
from adaptrack.control.qp import QPStatus


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("moves", range(1, 21))
def test_after_a_step_at_every_limit_a_sample_that_is_not_finite_is_not_solved(moves, value):
    mpc = published_mpc(load_vehicle("paper"), Tuning(35, moves, 10.0, 0.01))
    for entry in range(5):
        mpc.reset()
        assert mpc.step([0.0, 0.0, 0.0, 0.0], 20.0, [50.0]).status is QPStatus.SOLVED
        state, reference = [0.0, 0.0, 0.0, 0.0], [50.0]
        (state if entry < 4 else reference)[entry % 4] = value
        command = mpc.step(state, 20.0, reference)
        assert command.status is not QPStatus.SOLVED
        assert command.held
