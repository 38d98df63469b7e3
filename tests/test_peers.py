"""The peers of `benchmarks/peers.py` solve the problem that ours solves."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def peers():
    path = Path(__file__).parents[1] / "benchmarks" / "peers.py"
    spec = importlib.util.spec_from_file_location("peers", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def given(peers):
    return peers.recorded(False, 60)


@pytest.mark.parametrize("solver", ["Daqp", "Piqp", "Osqp"])
def test_a_plain_peer_gives_the_commands_of_our_mpc(peers, given, solver):
    pytest.importorskip(solver.lower())
    ours, peer = peers.ours(False), peers.Peer(peers.AsMeasured(), getattr(peers, solver)(), False, (1.0, 30.0))
    apart = []
    for step in given:
        command = ours.step(*step)
        apart.append(command.angle - peer.step(*step).angle)
        peer.angle = command.angle  # each step alone: errors of the solver do not add up
    assert np.abs(apart).max() < {"Daqp": 1e-10, "Piqp": 1e-5, "Osqp": 1e-3}[solver]


def test_ours_and_daqp_are_exact_and_the_exact_solution_is_found(peers, given):
    assert peers.off_of(peers.ours(False), given) < 1e-12
    peer = peers.Peer(peers.AsMeasured(), peers.Daqp(), True, (1.0, 30.0))
    assert peers.off_of(peer, given) < 1e-12
    assert sum(np.isfinite([peers.exact_move(_posed(peers, each)) for each in given[:10]])) == 10


def _posed(peers, step):
    peer = peers.Peer(peers.AsMeasured(), peers.Daqp(), False, (1.0, 30.0))
    peer.step(*step)
    return peer.posed


def test_a_tabulated_filter_ends_where_the_plain_one_does(peers):
    """The gain of the steady state is that which the filter with a covariance comes to."""
    problem, speed = peers.Filtered(), 15.0
    plain, known = problem.matrices(speed), problem.matrices(speed, gain=True)
    problem.state(plain, np.zeros(4), 0.0)
    for _ in range(2000):
        problem.state(plain, np.zeros(4), 0.0)
    before = plain.f @ problem.P @ plain.f.T + problem.Q
    gain = np.linalg.solve(problem.H @ before @ problem.H.T + problem.R, problem.H @ before).T
    np.testing.assert_allclose(gain, known.gain, atol=1e-6)
