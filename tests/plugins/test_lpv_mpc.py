"""The authors' joint MPC: its model is their plant's to first order, its contract, and what its preview error costs."""

import math

import numpy as np
import pytest
from benchmarks.joint_mpc import joint_law, load_test, rms_errors, separate_law

import adaptrack as at
import lpv_mpc

CAR = at.load_vehicle("paper")
PLANT = lpv_mpc.AuthorsCar()
MOVING = np.array([15.0, 0.02, 0.01, 0.03, 0.01])


def test_the_plant_turns_with_the_yaw_rate_of_the_steady_single_track():
    """r = v delta/(L + K v^2), K = m (l_r C_r - l_f C_f)/(L C_f C_r) (Rajamani, 2nd ed., eq. (3.12))."""
    angle, state = 0.005, np.array([15.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(100):
        state = PLANT.after(state, np.array([angle, lpv_mpc.PLANT_DRAG * state[0]]), 0.0, 0.0, 0.1)
    (front, rear), wheelbase = PLANT.stiffness, PLANT.lf + PLANT.lr
    understeer = PLANT.mass * (PLANT.lr * rear - PLANT.lf * front) / (wheelbase * front * rear)
    v = float(np.hypot(state[0], state[1]))
    assert state[2] == pytest.approx(v * angle / (wheelbase + understeer * v * v), rel=2e-3)


def test_the_model_is_the_plant_to_first_order_but_for_its_resistance():
    controller = lpv_mpc.LPVMPC(CAR, stiffness=lpv_mpc.AXLE_STIFFNESS)
    inputs, curvature = np.array([0.003, 0.5]), 0.004
    a, b = controller._model(MOVING, inputs, curvature)
    linear = (a @ MOVING + b @ inputs - MOVING) / controller.period
    true = PLANT.slopes(MOVING, inputs, curvature, 0.0)
    resistance = -controller.period * (
        lpv_mpc.ROLLING * lpv_mpc.GRAVITY + 0.5 * lpv_mpc.AIR_DENSITY * lpv_mpc.DRAG_AREA * MOVING[0] ** 2 / PLANT.mass
    )
    assert linear[1:] == pytest.approx(true[1:], rel=1e-3, abs=2e-5)
    expected = true[0] + lpv_mpc.PLANT_DRAG * MOVING[0] + resistance / controller.period
    assert linear[0] == pytest.approx(expected, abs=0.01)


def test_in_a_bend_of_constant_curvature_the_published_preview_makes_no_error():
    commands = []
    for corrected in (False, True):
        controller = lpv_mpc.LPVMPC(CAR, corrected=corrected)
        speeds, curvatures = np.full(9, 15.0), np.full(9, 0.01)
        commands.append([controller.inputs(MOVING, speeds, curvatures)[0] for _ in range(5)])
    assert np.array_equal(*commands)
    controller.reset()
    assert np.array_equal([controller.inputs(MOVING, speeds, curvatures)[0] for _ in range(5)], commands[1])


def test_inputs_keep_their_bounds_also_where_no_plan_keeps_those_of_the_states():
    controller = lpv_mpc.LPVMPC(CAR)
    for offset in (0.1, 1.5, -1.5):
        inputs, is_held = controller.inputs([24.9, 0.0, 0.0, offset, 0.0], np.full(9, 30.0), np.zeros(9))
        assert not is_held
        assert (inputs >= lpv_mpc.INPUT_LOW - 1e-9).all()
        assert (inputs <= lpv_mpc.INPUT_HIGH + 1e-9).all()


def test_on_their_plant_the_corrected_preview_and_learning_beat_what_is_published():
    test = load_test("accelerating-double-lane-change")
    true_stiffness = lpv_mpc.AXLE_STIFFNESS
    published, corrected = (
        rms_errors(test, joint_law(test, true_stiffness, corrected))[0] for corrected in (False, True)
    )
    assert published == pytest.approx(0.0184, abs=0.0003)  # measured with their signals before these were simplified
    assert corrected == pytest.approx(0.0027, abs=0.0003)
    assert rms_errors(test, separate_law(test, lpv_mpc.NETWORK_STIFFNESS, learns=True))[0] < published


@pytest.mark.parametrize("name", ["lpv-mpc", "lpv-mpc-corrected"])
def test_it_keeps_the_contract_of_controllers(name):
    at.check_controller(at.get_controller(name, CAR, profile="paper"))


def test_it_steers_the_dual_track_through_their_double_lane_change():
    controller = at.get_controller("lpv-mpc-corrected", CAR)
    run = at.simulate(
        at.DualTrack(CAR), controller, at.load_scenario("accelerating-double-lane-change"), profile="paper"
    )
    assert run.failed is None
    assert np.abs(run.error).max() < 0.02


@pytest.mark.parametrize(("option", "value"), [
    ("horizon", 0), ("horizon", 61), ("move_weights", (0.0, 1.0)), ("period", math.nan), ("stiffness", (0.0, 1.0)),
])  # fmt: skip
def test_nonsense_is_refused(option, value):
    with pytest.raises(at.InvalidInput, match=r"LPVMPC|period"):
        lpv_mpc.LPVMPC(CAR, **{option: value})
