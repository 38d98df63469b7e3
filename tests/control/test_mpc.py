"""One step of the MPC: the minimiser of eq. (11) within its limits, for any tuning, and never a silent number."""

import dataclasses
import math
from functools import partial

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.qp import QPStatus
from adaptrack.core.controllers import mpc as kernel
from references import dense_mpc as dense
from references import mpc as reference

pytestmark = pytest.mark.kernels

CAR, SEDAN = at.load_vehicle("paper"), at.load_vehicle("midsize-sedan")
REST = np.zeros(4)
WIDE = at.Limits(move=(-1e3, 1e3), angle=(-1e3, 1e3))
MOVES = {"pulse": at.Moves.pulses(), "laguerre": at.Moves.laguerre(0.75, 6)}

every_parametrisation = pytest.mark.parametrize("moves", MOVES.values(), ids=MOVES)


def wild_state(rng, scale=1.0):
    return rng.normal(size=4) * [0.5, 0.05, 0.1, 1.0] * scale


def basis(moves, Np, Nc):
    """L of dU = L eta."""
    return np.eye(Np)[:, :Nc] if moves.kind == "pulse" else reference.laguerre(Np, moves.terms, moves.pole)


def transfer(mpc, to):
    """Give a controller what another one remembers: its last state, angle and that it has started."""
    theirs, target = mpc._mpc.memory[0], to._mpc.memory[0]
    target.started, target.command = theirs.started, theirs.command
    to._mpc.previous[:] = mpc._mpc.previous
    return to


# -- the minimiser ----------------------------------------------------------------------------------------------------
@every_parametrisation
@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("car", [CAR, SEDAN], ids=["paper", "sedan"])
def test_without_limits_a_step_is_the_least_squares_solution(moves, preview, car, rng):
    for _ in range(25):
        Np = int(rng.integers(5, 40))
        tuning = at.Tuning(Np, int(rng.integers(1, min(Np, 12) + 1)), 10 ** rng.uniform(0, 1), 10 ** rng.uniform(-1, 2))
        mpc = at.published_mpc(car, tuning, limits=WIDE, moves=moves, preview=preview)
        before, current = wild_state(rng), wild_state(rng)
        mpc.step(before, 12.0, [0.0])
        ahead, speed = rng.normal(size=60), rng.uniform(3, 30)
        command = mpc.step(current, speed, ahead)
        target = ahead[1 : Np + 1] if preview else np.full(Np, ahead[0])
        expected = reference.unconstrained_move(
            car, speed, 0.1, before, current, target, tuning.Q, tuning.R, basis(moves, Np, tuning.Nc)
        )
        assert command.status is QPStatus.SOLVED
        assert command.move == pytest.approx(expected, rel=1e-7, abs=1e-9)
        assert command.residual < 1e-9


def test_the_first_step_takes_the_state_for_unchanged(rng):
    state, ahead = wild_state(rng), rng.normal(size=1)
    mpc = at.published_mpc(CAR, at.Tuning(20, 5, 1.0, 1.0), limits=WIDE)
    expected = reference.unconstrained_move(
        CAR, 10.0, 0.1, state, state, np.full(20, ahead[0]), 1.0, 1.0, basis(MOVES["pulse"], 20, 5)
    )
    assert mpc.step(state, 10.0, ahead).move == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1])
def test_the_qp_is_that_of_eq_17(period, rng):
    mpc = at.published_mpc(CAR, period=period)
    model = at.SingleTrackModel(CAR, period)
    for _ in range(20):
        before, current, speed = wild_state(rng), wild_state(rng), rng.uniform(1, 40)
        mpc.reset()
        mpc.step(before, speed, [0.3])
        qp = mpc.problem(current, speed, [1.2])
        E, K = dense.quadratic(
            model, speed, np.append(current - before, current[3]), np.full(35, 1.2), 35, 8, 10.0, 0.01
        )
        np.testing.assert_allclose(qp.E, E, rtol=1e-10)
        np.testing.assert_allclose(qp.K, K, rtol=1e-9, atol=1e-9 * np.abs(K).max())
        assert np.array_equal(qp.M, dense.limit_matrix(8))
        np.testing.assert_allclose(qp.gamma, dense.limit_bounds(8, mpc.angle, mpc.limits), rtol=1e-14)


def test_the_model_speed_has_a_floor():
    slow = [at.published_mpc(CAR, speed_floor=2.0).step(REST, speed, [1e-3]).move for speed in (0.0, 0.5, 2.0)]
    assert slow[0] == slow[1] == slow[2]
    assert at.published_mpc(CAR, speed_floor=2.0).step(REST, 2.1, [1e-3]).move != slow[0]


# -- preview ----------------------------------------------------------------------------------------------------------


def test_with_preview_the_last_reference_is_held(rng):
    ahead = np.array([0.0, 0.1, 0.4])
    short = at.published_mpc(CAR, preview=True).step(REST, 12.0, ahead)
    padded = at.published_mpc(CAR, preview=True).step(REST, 12.0, np.concatenate([ahead, np.full(60, 0.4)]))
    assert short == padded
    assert at.published_mpc(CAR, preview=True).step(REST, 12.0, [0.3]) == at.published_mpc(CAR).step(REST, 12.0, [0.3])


# -- limits -----------------------------------------------------------------------------------------------------------
@every_parametrisation
@pytest.mark.parametrize("solver", ["active-set", "hildreth"])
def test_moves_and_angles_stay_within_their_limits(moves, solver, rng):
    limits = at.Limits(move=(-0.05, 0.03), angle=(-0.2, 0.25))
    mpc = at.published_mpc(CAR, limits=limits, moves=moves, solver=solver)
    angle, count = 0.0, 0
    for _ in range(60):
        command = mpc.step(wild_state(rng, 3.0), rng.uniform(1, 30), rng.normal(size=1) * 10)
        assert command.status is QPStatus.SOLVED
        assert -0.05 - 1e-15 <= command.move <= 0.03 + 1e-15  # a difference of two angles, each rounded
        assert -0.2 <= command.angle <= 0.25
        assert command.angle - angle == pytest.approx(command.move, abs=1e-15)
        assert bool(command.at_limit & 1) == (command.move <= -0.05 + 1e-9 or command.move >= 0.03 - 1e-9)
        assert bool(command.at_limit & 2) == (command.angle <= -0.2 + 1e-9 or command.angle >= 0.25 - 1e-9)
        angle, count = command.angle, count | command.at_limit
        assert mpc.angle == angle
    assert count == 3


@every_parametrisation
def test_an_output_limit_is_violated_only_as_far_as_it_must(moves):
    limits = at.Limits(output=(-math.inf, 0.6))
    mpc = at.published_mpc(CAR, at.Tuning(30, 8, 1.0, 0.1), limits=limits, moves=moves)
    a, b = reference.discrete(CAR, 12.0, 0.1)
    x, count, path = np.zeros(4), 0, []
    for _ in range(80):
        command = mpc.step(x, 12.0, [1.0])
        count |= command.at_limit
        x = a @ x + b * command.angle
        path.append(x[3])
    assert count & 4
    assert 0.59 < path[-1] < 0.605
    assert max(path) < 0.63
    # far outside, the weight leaves only one way: back
    assert at.published_mpc(CAR, limits=at.Limits(output=(-0.1, 0.1))).step([0, 0, 0, 2.0], 12.0, [2.0]).move < 0.0


def test_a_higher_weight_violates_an_output_limit_less():
    def overshoot(weight):
        mpc = at.published_mpc(
            CAR, at.Tuning(30, 8, 1.0, 0.1), limits=at.Limits(output=(-1.0, 0.6), output_weight=weight)
        )
        a, b = reference.discrete(CAR, 12.0, 0.1)
        x = np.zeros(4)
        for _ in range(80):
            x = a @ x + b * mpc.step(x, 12.0, [1.0]).angle
        return x[3] - 0.6

    light, heavy = overshoot(10.0), overshoot(1e4)
    assert light > 5 * heavy > 0.0


# -- a tuning that changes --------------------------------------------------------------------------------------------
class Playlist:
    """A scheduler that plays a list of tunings."""

    def __init__(self, tunings):
        self.tunings, self.k, self.seen = list(tunings), 0, []

    def __call__(self, variables):
        self.seen.append(variables)
        self.k += 1
        return self.tunings[self.k - 1]


HERE = at.SchedulingVariables(speed=15.0, y_ref=0.5, friction=0.8, wind=3.0)


@every_parametrisation
@pytest.mark.parametrize("output", [(-math.inf, math.inf), (-0.8, 0.8)], ids=["free", "soft"])
def test_a_new_tuning_acts_as_if_the_controller_had_always_had_it(moves, output, rng):
    limits = at.Limits(output=output)
    tunings = []
    for _ in range(30):
        Np = int(rng.integers(1, 60))
        tunings.append(
            at.Tuning(Np, int(rng.integers(1, min(Np, 20) + 1)), 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-2, 1))
        )
    changing = at.published_mpc(CAR, limits=limits, moves=moves, scheduler=Playlist(tunings))
    for tuning in tunings:
        fresh = at.published_mpc(CAR, tuning, limits=limits, moves=moves, longest_horizon=60, most_moves=20)
        transfer(changing, fresh)
        state, speed, ahead = wild_state(rng, 0.7), rng.uniform(1, 30), rng.normal(size=1)
        expected = fresh.step(state, speed, ahead)
        command = changing.step(state, speed, ahead, HERE)
        assert command.tuning == expected.tuning == dataclasses.astuple(tuning)
        assert command.status is expected.status is QPStatus.SOLVED
        assert command.move == pytest.approx(expected.move, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize(("horizons", "used"), [
    ((34.5, 8.2), (35, 8)), ((34.49, 7.5), (34, 8)), ((10.0, 14.0), (10, 10)), ((1e12, 1e12), (60, 20)),
    ((0.2, 0.2), (1, 1)), ((-7.0, 3.0), (1, 1)), ((60.4, 19.6), (60, 20)),
])  # fmt: skip
def test_real_valued_horizons_are_rounded_and_clamped(horizons, used):
    mpc = at.published_mpc(CAR, scheduler=lambda variables: (*horizons, 10.0, 0.01))
    command = mpc.step(REST, 15.0, [0.2], HERE)
    assert command.tuning == (*used, 10.0, 0.01)
    plain = at.published_mpc(CAR, at.Tuning(*used, 10.0, 0.01)).step(REST, 15.0, [0.2])
    assert command.move == pytest.approx(plain.move, rel=1e-9)


@pytest.mark.parametrize("weights", [(-1.0, 0.01), (10.0, 0.0), (10.0, -1.0)])
def test_a_scheduler_that_gives_impossible_weights_holds_the_angle_and_says_so(weights):
    mpc = at.published_mpc(CAR, scheduler=lambda variables: (35, 8, *weights))
    command = mpc.step(REST, 15.0, [0.5], HERE)
    assert command.held
    assert command.status is QPStatus.NOT_CONVEX
    assert "positive" in command.status.sentence


def raising(variables):
    raise RuntimeError("the network is down")


@pytest.mark.parametrize("answer", [
    (35, 8, 10.0), None, "fast", (35, 8, 10.0, "small"), (35, 8, 10**400, 1.0), {}, 3.0, [[35, 8, 1, 1]],
    (math.nan, 4, 1.0, 0.5), (20, math.inf, 1.0, 0.5), (20, 4, -math.inf, 0.5), (20, 4, 1.0, math.nan), raising
], ids=lambda answer: str(answer)[:20])  # fmt: skip
def test_a_scheduler_that_fails_keeps_the_tuning_before_is_counted_and_said_once(answer, caplog):
    tuning = at.Tuning(20, 4, 2.0, 0.5)
    scheduler = answer if callable(answer) else lambda variables: answer
    mpc, plain = at.published_mpc(CAR, tuning, scheduler=scheduler), at.published_mpc(CAR, tuning)
    for steps in (1, 2, 3):
        command = mpc.step(REST, 15.0, [0.1], HERE)
        assert (command.tuning, command.move) == (dataclasses.astuple(tuning), plain.step(REST, 15.0, [0.1]).move)
        assert mpc.scheduler_counts == {"raised": steps}
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "the scheduler failed" in caplog.text
    mpc.reset()
    assert mpc.scheduler_counts == {"raised": 0}


# -- bad arguments ----------------------------------------------------------------------------------------------------
NO_LIMIT = (0.0, -1.0, math.nan, math.inf)
REFUSED = [
    (at.Tuning, "Np", (0, -1, 35.0, True, math.nan, "35", None)), (at.Tuning, "Nc", (0, 36, 2.5, math.inf)),
    (at.Tuning, "Q", (-1.0, math.nan, math.inf)), (at.Tuning, "R", NO_LIMIT),
    (at.Limits, "move", ((0.1, -0.1), (math.nan, 0.1), (0.01, 0.1), (-0.1, -0.01), (-math.inf, 0.1), (-0.1, math.inf))),
    (at.Limits, "angle", ((0.2, -0.2), (-0.2, math.nan), (0.1, 0.2), (-math.inf, math.inf))),
    (at.Limits, "output", ((1.0, -1.0), (math.nan, 1.0))), (at.Limits, "output_weight", NO_LIMIT),
    (at.Moves, "kind", ("pulses",)), (at.Moves, "pole", (1.0, -0.1, math.nan)), (at.Moves, "terms", (0, -2)),
    (partial(at.published_mpc, CAR), "period", NO_LIMIT), (partial(at.published_mpc, CAR), "speed_floor", NO_LIMIT),
    (partial(at.published_mpc, CAR), "longest_horizon", (20,)), (partial(at.published_mpc, CAR), "most_moves", (5,)),
    (partial(at.published_mpc, CAR, moves=at.Moves.laguerre()), "most_moves", (80,)),
]  # fmt: skip


@pytest.mark.parametrize(("make", "argument", "values"), REFUSED)
def test_what_makes_no_controller_is_refused_by_name(make, argument, values):
    for value in values:
        with pytest.raises(at.InvalidInput, match=rf"{argument}(\[.\])? (= |must)"):
            make(**{argument: value})


# -- workspace --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("options", [
    {}, {"moves": MOVES["laguerre"]}, {"limits": at.Limits(output=(-0.5, 0.5))}, {"solver": "hildreth"}
], ids=["pulse", "laguerre", "soft", "hildreth"])  # fmt: skip
def test_what_a_workspace_held_before_changes_no_bit(options, rng):
    from adaptrack.core.controllers.mpc_step import MPCStep, step

    mpc = at.published_mpc(CAR, **options)
    settings = mpc.settings()
    used = mpc.batch(1, settings)
    for _ in range(40):
        fresh = mpc.batch(1, settings)
        kernel.forget(0, 0.0, used)
        for k in range(6):
            if k % 3 == 0:
                tuning = np.array(
                    [rng.integers(2, 56), rng.integers(1, 19), rng.uniform(0.1, 10), 10 ** rng.uniform(-2, 3)]
                )
                speed = rng.uniform(3, 25)
            state, ahead = wild_state(rng, 0.6), rng.normal(size=1)
            for workspace in (fresh, used):
                workspace.measured[:4] = state
                step(MPCStep(workspace, mpc.functions, np.array([speed, ahead.size]), ahead, tuning))
            assert np.array_equal(fresh.answer, used.answer, equal_nan=True)


# -- memory -----------------------------------------------------------------------------------------------------------


def test_a_controller_describes_itself():
    described = at.published_mpc(CAR, moves=at.Moves.laguerre(0.75, 6), preview=True).describe()
    assert described["tuning"] == {"Np": 35, "Nc": 8, "Q": 10.0, "R": 0.01}
    assert described["moves"] == {"kind": "laguerre", "pole": 0.75, "terms": 6}
    assert described["preview"] is True
    assert described["solver"] == "active-set"
    assert at.published_mpc(CAR).describe()["moves"] == {"kind": "pulse"}
    assert at.published_mpc(CAR).name == "standard MPC (pulse)"
    assert "scheduled" in at.published_mpc(CAR, scheduler=Playlist([])).name
