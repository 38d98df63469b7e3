"""What a step of the MPC promises whatever it is given: an answer within the limits, or `InvalidInput`."""

import copy
import decimal
import math
import pickle
import threading

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC, Limits, Moves, Stanley, Tuning, published_mpc
from adaptrack.control.qp import QPStatus, get_qp_solver
from adaptrack.control.scheduling import Constant, SchedulingVariables
from references.daqp import Daqp

CAR = load_vehicle("paper")
HERE = SchedulingVariables(speed=15.0, y_ref=0.5, friction=0.8, wind=3.0)
STATE, AHEAD = np.array([0.1, 0.01, -0.02, 0.2]), np.linspace(0.0, 1.0, 30)
CALM = Tuning(20, 4, 1.0, 5.0)
MOVES = {"pulse": Moves.pulses(), "laguerre": Moves.laguerre(0.75, 4)}

# NumPy warns of the infinities that the interpreter computes with; compiled code is silent.
pytestmark = pytest.mark.filterwarnings("ignore:.* encountered in:RuntimeWarning")
every_parametrisation = pytest.mark.parametrize("moves", MOVES.values(), ids=MOVES)


def keeps_its_limits(command, mpc, before):
    (least, most), (low, high) = mpc.limits.move, mpc.limits.angle
    return (
        math.isfinite(command.angle)
        and least - 1e-12 <= command.move <= most + 1e-12
        and low <= command.angle <= high
        and command.move == command.angle - before
    )


# -- what is not made of numbers --------------------------------------------------------------------------------------
class Raising:
    """An object of others that answers with an error whatever it is asked."""

    def __array__(self, *arguments, **options):
        raise RuntimeError("no")

    def __float__(self):
        raise ZeroDivisionError("no")

    def __len__(self):
        raise KeyError("no")

    def __repr__(self):
        raise KeyError("no")


CIRCLE = []
CIRCLE.append(CIRCLE)
NO_NUMBERS = {
    "nothing": None, "text": "fast", "bytes": b"fast", "mapping": {}, "set": {1, 2, 3, 4}, "object": object(),
    "generator": (i for i in range(4)), "circle": CIRCLE, "raising": Raising(), "list of raising": [Raising()] * 4,
    "complex": [1j, 0, 0, 0], "truth values": [True] * 4, "dates": [np.datetime64("2020-01-01")] * 4,
    "ragged": [[0], [0, 0], 0, 0], "texts": ["1", "2", "3", "4"], "a text among numbers": [0, "a", 0, 0],
    "nothing among numbers": [0, None, 0, 0], "no number": [decimal.Decimal("sNaN")] * 4,
    "structure": np.zeros(4, [("a", float)]),
}  # fmt: skip


@pytest.mark.parametrize("value", NO_NUMBERS.values(), ids=NO_NUMBERS)
@pytest.mark.parametrize("name", ["state", "speed", "reference", "variables"])
def test_what_is_not_made_of_numbers_is_refused_by_name_and_changes_nothing(name, value):
    mpc, twin = (published_mpc(CAR, CALM, scheduler=Constant(CALM)) for _ in range(2))
    for controller in (mpc, twin):
        controller.step(STATE, 15.0, AHEAD, HERE)
    arguments = {"state": STATE, "speed": 15.0, "reference": AHEAD, "variables": HERE} | {name: value}
    with pytest.raises(InvalidInput, match="scheduler" if name == "variables" and value is None else name):
        mpc.step(**arguments)
    assert mpc.step(STATE, 14.0, AHEAD, HERE) == twin.step(STATE, 14.0, AHEAD, HERE)
    if name != "variables":
        law = Stanley(CAR)
        with pytest.raises(InvalidInput, match=name):
            law.step(**arguments)
        assert law.angle == 0.0


# -- numbers that are none --------------------------------------------------------------------------------------------
HOLES = {"NaN": math.nan, "inf": math.inf, "-inf": -math.inf, "10^400": 10**400, "-10^400": -(10**400)}


@every_parametrisation
@pytest.mark.parametrize("hole", HOLES.values(), ids=HOLES)
@pytest.mark.parametrize("solver", ["active-set", "hildreth", Daqp()])
def test_a_hole_in_any_entry_holds_the_angle_for_one_step(moves, hole, solver):
    mpc = published_mpc(CAR, CALM, moves=moves, preview=True, solver=solver)
    before = mpc.step(STATE, 15.0, AHEAD).angle
    assert before != 0.0
    for place in range(4):
        state = list(STATE)
        state[place] = hole
        command = mpc.step(state, 15.0, AHEAD)
        assert (command.angle, command.move, command.held) == (before, 0.0, True)
        assert command.status is QPStatus.NON_FINITE
        assert math.isnan(command.residual)
    for place in (1, 7, 20):  # as far as the horizon looks
        ahead = list(AHEAD)
        ahead[place] = hole
        assert mpc.step(STATE, 15.0, ahead)[:3] == (before, 0.0, True)
    again = mpc.step(STATE, 15.0, AHEAD)
    assert (again.status, again.held) == (QPStatus.SOLVED, False)


@pytest.mark.parametrize("hole", HOLES.values(), ids=HOLES)
@pytest.mark.parametrize("make", [published_mpc, MPC], ids=["published", "informed"])
def test_a_speed_that_is_missing_is_the_last_one_for_six_seconds(make, hole):
    mpc, twin = make(CAR, CALM, period=0.25), make(CAR, CALM, period=0.25)
    assert mpc.step(STATE, hole, AHEAD)[:3] == (0.0, 0.0, True)  # none has been there
    for speed in (12.0, 15.0):
        mpc.step(STATE, speed, AHEAD)
    twin.step(STATE, math.nan, AHEAD)
    for speed in (12.0, 15.0):
        twin.step(STATE, speed, AHEAD)
    for k in range(24):
        mpc.problem(STATE, hole, AHEAD)  # counts for nothing
        assert mpc.step(STATE + 0.001 * k, hole, AHEAD) == twin.step(STATE + 0.001 * k, 15.0, AHEAD)
    copied, before = copy.copy(mpc), mpc.angle
    assert mpc.step(STATE, hole, AHEAD)[:3] == copied.step(STATE, hole, AHEAD)[:3] == (before, 0.0, True)
    assert not mpc.step(STATE, 15.0, AHEAD).held
    assert not mpc.step(STATE, hole, AHEAD).held
    mpc.reset()
    assert mpc.step(STATE, hole, AHEAD).held


def test_what_a_mask_hides_is_not_read():
    mpc = published_mpc(CAR, CALM, preview=True)
    before = mpc.step(STATE, 15.0, AHEAD).angle
    for place in range(4):
        state = np.ma.masked_array(STATE, np.arange(4) == place)
        assert mpc.step(state, 15.0, AHEAD)[:3] == (before, 0.0, True)
    assert mpc.step(STATE, 15.0, np.ma.masked_array(AHEAD, np.arange(30) == 5))[:3] == (before, 0.0, True)
    assert not mpc.step(STATE, 15.0, np.ma.masked_array(AHEAD, np.arange(30) == 25)).held  # beyond the horizon


VALUES = (0.0, 1.0, -3.0, math.nan, math.inf, -math.inf, 1e-308, 1e300, -1e300, 1e9, 10**400)


@pytest.mark.parametrize("options", [
    {"solver": "active-set"},
    {"solver": "hildreth"},
    {"solver": get_qp_solver("hildreth", on_uncertified="hold")},
    {"solver": get_qp_solver("hildreth", on_uncertified="apply")},
    {"moves": MOVES["laguerre"]},
    {"limits": Limits(output=(-1.0, 1.0)), "solver": get_qp_solver("hildreth", on_uncertified="hold")},
    {"limits": Limits(output=(-1.0, 1.0)), "moves": MOVES["laguerre"]},
    {"preview": True, "scheduler": Constant(CALM)},
], ids=["exact", "hildreth", "hold", "apply", "laguerre", "soft", "soft laguerre", "scheduled"])  # fmt: skip
def test_whatever_numbers_come_the_command_keeps_its_limits_and_solved_means_solved(options, rng):
    mpc = published_mpc(CAR, Tuning(12, 2, 1.0, 0.1), **options)
    before, calm, last_speed = 0.0, True, math.nan
    for _ in range(60):
        is_good = rng.random() < 0.6
        state = list(rng.normal(size=4) * [0.5, 0.05, 0.1, 1.0])
        speed, ahead, look = float(rng.uniform(-2.0, 40.0)), list(rng.normal(size=14)), list(HERE)
        if not is_good:
            for row in (state, ahead, look):
                for place in np.flatnonzero(rng.random(len(row)) < 0.15):
                    row[place] = VALUES[rng.integers(len(VALUES))]
            speed = float(VALUES[rng.integers(len(VALUES) - 1)]) if rng.random() < 0.2 else speed
        command = mpc.step(state, speed, ahead, look)
        assert keeps_its_limits(command, mpc, before)
        last_speed = speed if math.isfinite(speed) else last_speed
        sample = [*state, last_speed, *(ahead[1:13] if mpc.preview else ahead[:1])]
        finite = all(abs(value) < 1e308 for value in sample)
        assert finite or command.held
        if command.status is QPStatus.SOLVED:
            assert not command.held
            assert command.residual < 1e-6
        if is_good and calm:  # after an absurd sample the increments are absurd, too
            assert not command.held or command.status is QPStatus.CAPPED
        before, calm = command.angle, is_good


# -- the problem ------------------------------------------------------------------------------------------------------
@every_parametrisation
@pytest.mark.parametrize("output", [(-math.inf, math.inf), (-0.4, 0.4)], ids=["free", "soft"])
@pytest.mark.parametrize("scheduled", [False, True], ids=["constant", "scheduled"])
def test_the_problem_is_what_the_step_solves_and_asking_changes_nothing(moves, output, scheduled, rng):
    def schedule(variables):
        calls.append(variables)
        return 10 + len(calls) % 5, 2 + len(calls) % 3, 1.0, 0.3

    calls = []
    options = {"moves": moves, "limits": Limits(move=(-0.05, 0.05), output=output), "preview": True}
    mpc, twin = (published_mpc(CAR, Tuning(12, 3, 1.0, 0.3), **options) for _ in range(2))
    if scheduled:
        mpc, twin = (published_mpc(CAR, scheduler=Constant(CALM), **options) for _ in range(2))
    exact = get_qp_solver("active-set")
    for _ in range(6):
        state, speed, ahead = rng.normal(size=4) * [0.5, 0.05, 0.1, 1.0], rng.uniform(3, 25), rng.normal(size=20)
        before = pickle.dumps(mpc)
        qp = mpc.problem(state, speed, ahead, HERE)
        assert pickle.dumps(mpc) == before
        expected = exact.solve(qp).x
        command = mpc.step(state, speed, ahead, HERE)
        assert command == twin.step(state, speed, ahead, HERE)
        first = expected[0] if moves.kind == "pulse" else mpc._mpc.ws.moves[: moves.terms, 0] @ expected[: moves.terms]
        assert command.move == pytest.approx(first, abs=1e-9)


# -- copies -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("make_copy", [copy.copy, copy.deepcopy, lambda mpc: pickle.loads(pickle.dumps(mpc))])
@pytest.mark.parametrize("options", [
    {},
    {"moves": MOVES["laguerre"], "limits": Limits(output=(-0.5, 0.5))},
    {"scheduler": Constant(CALM)},
    {"solver": "hildreth"},
    {"solver": Daqp()},
], ids=["pulse", "soft laguerre", "scheduled", "hildreth", "daqp"])  # fmt: skip
def test_a_copy_made_in_mid_run_goes_on_alike_and_apart(make_copy, options, rng):
    drive = [(rng.normal(size=4) * [0.5, 0.05, 0.1, 1.0], rng.uniform(3, 25), rng.normal(size=20)) for _ in range(9)]
    mpc, undisturbed = (published_mpc(CAR, CALM, preview=True, **options) for _ in range(2))
    expected = [undisturbed.step(*sample, HERE) for sample in drive]
    for sample in drive[:4]:
        mpc.step(*sample, HERE)
    other = make_copy(mpc)
    assert [other.step(*sample, HERE) for sample in drive[4:]] == expected[4:]  # the copy goes on as the original would
    assert [mpc.step(*sample, HERE) for sample in drive[4:]] == expected[4:]  # which the copy's steps did not touch
    other.reset()
    assert (other.angle, mpc.angle) == (0.0, expected[-1].angle)
    assert other.describe() == mpc.describe()


def test_a_controller_in_a_step_refuses_a_second_thread_and_goes_on():
    inside, leave = threading.Event(), threading.Event()

    def slow(variables):
        inside.set()
        assert leave.wait(30.0)
        return 20, 4, 1.0, 5.0

    mpc, answers = published_mpc(CAR, scheduler=slow), []
    thread = threading.Thread(target=lambda: answers.append(mpc.step(STATE, 15.0, AHEAD, HERE)))
    thread.start()
    assert inside.wait(30.0)
    with pytest.raises(InvalidInput, match="another thread"):
        mpc.step(STATE, 15.0, AHEAD, HERE)
    leave.set()
    thread.join()
    assert answers == [published_mpc(CAR, CALM).step(STATE, 15.0, AHEAD)]
    assert not mpc.step(STATE, 15.0, AHEAD, HERE).held


# -- where nothing solves ---------------------------------------------------------------------------------------------
FAR = np.array([0.0, 0.0, 0.0, 4.0])  # metres off the path: every move at its limit, Hildreth does not converge


@every_parametrisation
@pytest.mark.parametrize("output", [(-math.inf, math.inf), (-9.0, 9.0)], ids=["free", "soft"])
def test_where_nothing_solves_the_last_plan_is_followed_to_its_end(moves, output):
    limits = Limits(output=output)
    mpc = published_mpc(CAR, CALM, limits=limits, moves=moves, solver=get_qp_solver("hildreth", on_uncertified="hold"))
    near = [0.0, 0.0, 0.0, 0.05]
    qp = mpc.problem(near, 15.0, [0.0])
    first = mpc.step(near, 15.0, [0.0])
    assert first.status is QPStatus.SOLVED
    assert first.at_limit == 0
    solution = get_qp_solver("active-set").solve(qp).x
    if moves.kind == "pulse":
        plan = [*solution[: CALM.Nc], 0.0, 0.0]
    else:
        terms, basis = moves.terms, mpc._mpc.ws.moves
        plan = [*(basis[:terms, : CALM.Np].T @ solution[:terms]), 0.0, 0.0]
    assert np.abs(plan[1 : CALM.Nc]).max() > 1e-4
    followed = [mpc.step(FAR * (-1) ** k, 25.0, [0.0]) for k in range(len(plan) - 1)]
    assert {command.status for command in followed} == {QPStatus.CAPPED}
    assert all(command.held for command in followed)
    assert [first.move, *(command.move for command in followed)] == pytest.approx(plan, abs=1e-6)


def test_without_finite_data_the_plan_waits_for_nobody_and_nothing_moves():
    mpc = published_mpc(CAR, CALM, solver=get_qp_solver("hildreth", on_uncertified="hold"))
    near = [0.0, 0.0, 0.0, 0.05]
    plan = get_qp_solver("active-set").solve(mpc.problem(near, 15.0, [0.0])).x
    mpc.step(near, 15.0, [0.0])
    assert mpc.step([math.nan, 0.0, 0.0, 0.0], 25.0, [0.0]).move == 0.0
    assert mpc.step(FAR, 25.0, [0.0]).move == pytest.approx(plan[2], abs=1e-6)  # plan[1] was for the period before
