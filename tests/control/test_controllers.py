"""Control laws: their analytic truths, their contract, and that each drives the cars it is made for."""

from __future__ import annotations

import math
import pickle
from functools import partial

import numpy as np
import pytest

from adaptrack import Controller
from adaptrack.base.errors import ContractError, InvalidInput, UnknownName
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import (
    LQR,
    Command,
    Limits,
    PurePursuit,
    Stanley,
    UserController,
    check_controller,
    get_controller,
    list_controllers,
    register_controller,
    registry,
)
from adaptrack.control.controllers.kinematic_mpc import KinematicMPC
from adaptrack.control.controllers.laws import GAIN_SPEEDS
from adaptrack.control.controllers.preview_lqr import PreviewLQR
from adaptrack.control.tracker import Tracker
from adaptrack.core.controllers.contract import path_at
from adaptrack.core.synthesis.laws import lqr_error_model
from adaptrack.drive.simulate import simulate
from adaptrack.road import generate_road
from adaptrack.road.road_ahead import straight
from adaptrack.scenario import RoadDrive, load_scenario
from references.dense_mpc import lqr_gain_at

pytestmark = pytest.mark.kernels


CAR, SEDAN = load_vehicle("paper"), load_vehicle("midsize-sedan")


def without_preview(law):
    """A law that takes period and preview from a profile, with the defaults of those that do not."""
    return lambda car, **options: law(car, **{"period": 0.1, "preview": False, **options})


LAWS = {
    "kinematic-mpc": without_preview(KinematicMPC), "lqr": LQR, "preview-lqr": without_preview(PreviewLQR),
    "pure-pursuit": PurePursuit, "stanley": Stanley,
}  # fmt: skip
WIDE = Limits(move=(-1.5, 1.5), angle=(-1.5, 1.5))
LONG = {"kinematic-mpc": [pytest.mark.compiled]}  # its 50 stages; its own tests also run interpreted
every_law = pytest.mark.parametrize(
    "law", [pytest.param(law, id=name, marks=LONG.get(name, ())) for name, law in LAWS.items()]
)
every_car = pytest.mark.parametrize("car", [CAR, SEDAN], ids=lambda car: car.name)


def parabola(curvature: float, speed: float, period: float, n: int = 60) -> np.ndarray:
    """y_ref(t) of a path that leaves straight ahead with a curvature (1/m) at its start."""
    return 0.5 * curvature * (speed * period * np.arange(n)) ** 2


# -- the path that y_ref(t) draws --------------------------------------------------------------------------------------
@pytest.mark.parametrize("time", [0.0, 0.03, 0.1, 0.25, 1.9])
def test_heading_and_curvature_of_a_parabola_are_exact(time):
    speed, period, bend = 12.0, 0.1, 0.8
    reference = 1.0 + 0.3 * period * np.arange(22) + 0.5 * bend * (period * np.arange(22)) ** 2
    path = path_at(reference, straight(), time, speed, period)
    rate = 0.3 + bend * time
    assert path.y == pytest.approx(1.0 + 0.3 * time + 0.5 * bend * time**2, rel=1e-12)
    assert path.heading == pytest.approx(math.atan2(rate, speed), rel=1e-9)
    assert path.curvature == pytest.approx(bend / speed**2 / (1.0 + (rate / speed) ** 2) ** 1.5, rel=1e-9)


def test_beyond_its_end_the_reference_goes_straight_on():
    path = path_at(np.array([0.0, 0.5]), straight(), 1.0, 10.0, 0.1)
    assert (path.y, path.curvature) == (pytest.approx(5.0), 0.0)
    assert path.heading == pytest.approx(math.atan2(5.0, 10.0))
    alone = path_at(np.array([2.0]), straight(), 1.0, 10.0, 0.1)
    assert (alone.y, alone.heading, alone.curvature) == (2.0, 0.0, 0.0)


def test_a_step_in_the_reference_is_no_sharper_than_a_bend_at_one_g():
    assert path_at(np.array([0.0, 0.0, 10.0]), straight(), 0.0, 20.0, 0.1).curvature == pytest.approx(9.81 / 20.0**2)


# -- pure pursuit ------------------------------------------------------------------------------------------------------
@every_car
@pytest.mark.parametrize("speed", [1.0, 8.0, 25.0])
def test_pure_pursuit_steers_the_arc_to_its_target_exactly(car, speed):
    controller = PurePursuit(car, lookahead_time=0.8, lookahead_min=3.0, period=0.05, limits=WIDE, preview=True)
    yaw, y, reference = 0.05, -0.4, parabola(0.004, speed, 0.05, 400)
    command = controller.step([0.1, yaw, 0.2, y], speed, reference)
    ahead = max(0.8 * speed, 3.0)
    rear = np.array([-car.lr * math.cos(yaw), y - car.lr * math.sin(yaw)])
    to_target = np.array([ahead, 0.5 * 0.004 * ahead**2]) - rear
    distance, alpha = np.hypot(*to_target), math.atan2(to_target[1], to_target[0]) - yaw
    assert command.diagnostics["distance"] == pytest.approx(distance, rel=1e-12)
    assert command.diagnostics["alpha"] == pytest.approx(alpha, rel=1e-9)
    assert command.angle == pytest.approx(math.atan(2.0 * car.wheelbase * math.sin(alpha) / distance), rel=1e-9)


# -- Stanley -----------------------------------------------------------------------------------------------------------


def test_stanley_steers_by_heading_offset_and_yaw_rate():
    controller = Stanley(
        CAR, gain=1.5, softening=1.0, yaw_rate_gain=0.1, dead_time=0.0, limits=WIDE, preview=True
    )  # fmt: skip
    yaw, rate, y, speed = 0.02, 0.1, -0.5, 12.0
    command = controller.step([0.0, yaw, rate, y], speed, np.zeros(50))
    front = y + CAR.lf * math.sin(yaw)
    assert command.diagnostics["offset"] == pytest.approx(-front)
    assert command.angle == pytest.approx(-yaw + math.atan(1.5 * -front / (1.0 + speed)) - 0.1 * rate, rel=1e-12)


def test_the_dead_time_of_stanley_is_that_of_a_car_which_moves_on():
    """A car on a circle, seen a dead time later without one, is steered alike."""
    late, prompt = (Stanley(CAR, dead_time=t, limits=WIDE, preview=True) for t in (0.3, 0.0))
    vy, yaw, rate, y, speed = 0.0, 0.05, 0.2, -0.3, 10.0
    later_yaw = yaw + 0.3 * rate
    later_y = y + speed / rate * (math.cos(yaw) - math.cos(later_yaw))
    reference = parabola(0.01, speed, 0.1)
    angle = late.step([vy, yaw, rate, y], speed, reference).angle
    then = prompt.step([vy, later_yaw, rate, later_y], speed, reference[3:]).angle
    assert angle == pytest.approx(then, abs=2e-5)  # the chord's direction stands for the arc's


# -- LQR ---------------------------------------------------------------------------------------------------------------


def applied_gain(controller: LQR, speed: float, tuning: np.ndarray | None = None) -> np.ndarray:
    """The gain (4,) that the compiled law applies on a straight path, asked for by small errors."""
    small, answer = 1e-6, np.zeros(1 + len(controller.diagnostic_names))
    basis = [(0.0, 0.0, 0.0, small), (small, 0.0, 0.0, 0.0), (-speed * small, small, 0.0, 0.0), (0.0, 0.0, small, 0.0)]
    gain = []
    for state in basis:
        controller.function(
            np.array([*state, speed, 0.0]), np.zeros(50), straight(),
            controller.packed_tuning() if tuning is None else tuning,
            controller.parameters(), np.zeros(controller.memory_size), answer,
        )  # fmt: skip
        gain.append(-answer[0] / small)
    return np.array(gain)


@every_car
def test_at_its_nodes_the_law_applies_the_gain_of_the_riccati_equation(car):
    controller = LQR(car, limits=WIDE, preview=True)
    for speed in GAIN_SPEEDS[[0, 5, 12, 20]]:
        np.testing.assert_allclose(applied_gain(controller, speed), lqr_gain_at(controller, speed), rtol=1e-7)


@pytest.mark.parametrize("factor", [0.03, 0.5, 30.0])
def test_weights_that_change_change_the_gain_as_weights_given_at_the_start(factor):
    controller = LQR(CAR, q_e=1.0, q_heading=100.0, r=1000.0, limits=WIDE)
    expected = LQR(CAR, q_e=1.0, q_heading=100.0, r=1000.0 * factor, limits=WIDE)
    changed = applied_gain(controller, 15.0, expected.packed_tuning())
    np.testing.assert_allclose(changed, lqr_gain_at(expected, 15.0), rtol=0.06)


@every_car
@pytest.mark.parametrize("speed", [2.0, 12.0, 30.0])
def test_the_feed_forward_holds_a_steady_turn_of_the_linear_car_exactly(car, speed):
    curvature = 2.0 / speed**2 if speed > 5.0 else 0.02
    A, B = np.zeros((4, 4)), np.zeros(4)
    lqr_error_model(car.numbers, speed, A, B)
    # in the turn de/dt = 0 and dpsi_e/dt = 0; the path's yaw rate enters v_y' and r' as in Rajamani, eq. (2.45)
    m, inertia, v = car.mass, car.yaw_inertia, speed
    front, rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    turning = np.array(
        [
            0.0,
            -v - (front * car.lf - rear * car.lr) / (m * v),
            0.0,
            -(front * car.lf**2 + rear * car.lr**2) / (inertia * v),
        ]
    )
    (psi_e, steering) = np.linalg.solve(np.column_stack([A[:, 2], B])[[1, 3]], -turning[[1, 3]] * v * curvature)
    controller = LQR(car, preview_time=0.0, limits=WIDE, preview=True)
    command = controller.step([-v * psi_e, psi_e, v * curvature, 0.0], v, parabola(curvature, v, 0.1))
    assert command.angle == pytest.approx(steering, rel=1e-9)
    assert command.diagnostics["feed_forward"] == pytest.approx(steering, rel=1e-9)


# -- what all laws have in common --------------------------------------------------------------------------------------
@every_law
@every_car
def test_a_mirrored_situation_gives_the_mirrored_command(law, car, rng):
    for _ in range(50):
        controller = law(car, preview=True)
        state, speed = rng.normal(0.0, (0.3, 0.1, 0.1, 1.0)), rng.uniform(0.0, 40.0)
        reference = np.cumsum(rng.normal(0.0, 0.05, 80))
        left = controller.step(state, speed, reference)
        controller.reset()
        assert controller.step(-state, speed, -reference).angle == -left.angle


@every_law
def test_the_limits_hold_and_the_move_is_the_change_of_the_angle(law):
    if law is LAWS["kinematic-mpc"]:  # without the filter, behind which commands move less
        law = without_preview(partial(KinematicMPC, cutoff=0.0))
    controller = law(CAR, limits=Limits(move=(-0.05, 0.03), angle=(-0.1, 0.2)), preview=True)
    angles = [controller.step([0.0, 0.0, 0.0, -20.0], 10.0, np.zeros(50)) for _ in range(10)]
    assert [round(command.angle, 12) for command in angles[:7]] == [0.03, 0.06, 0.09, 0.12, 0.15, 0.18, 0.2]
    assert angles[0].move == 0.03
    back = [controller.step([0.0, 0.0, 0.0, 20.0], 10.0, np.zeros(50)).angle for _ in range(10)]
    assert back[0] == pytest.approx(0.15)
    assert back[-1] == -0.1


@every_law
def test_without_preview_only_the_present_reference_counts(law, rng):
    blind, seeing = law(CAR), law(CAR, preview=True)
    reference = np.cumsum(rng.normal(0.0, 0.1, 50))
    arguments = [0.1, 0.01, 0.0, 0.3], 15.0
    assert blind.step(*arguments, reference) == law(CAR).step(*arguments, np.full(50, reference[0]))
    assert seeing.step(*arguments, reference).angle != blind.angle


@every_law
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_bad_measurement_holds_the_command_and_says_so(law, value):
    controller = law(CAR, preview=True)
    before = controller.step([0.0, 0.0, 0.0, 0.3], 15.0, np.zeros(50)).angle
    assert before != 0.0
    for state, speed, reference in (
        ([value, 0.0, 0.0, 0.0], 15.0, np.zeros(50)),
        ([0.0, 0.0, 0.0, value], 15.0, np.zeros(50)),
        ([0.0, 0.0, 0.0, 0.0], value, np.zeros(50)),
        (np.ma.masked_array([0.0, 0.0, 0.0, 0.0], [False, True, False, False]), 15.0, np.zeros(50)),
        ([10**400, 0.0, 0.0, 0.0], 15.0, np.zeros(50)),  # beyond the largest float: infinity
    ):
        command = controller.step(state, speed, reference)
        assert (command.angle, command.move, command.held) == (before, 0.0, True)
    assert not controller.step([0.0, 0.0, 0.0, 0.3], 15.0, np.zeros(50)).held


@every_law
@pytest.mark.parametrize("speed", [-3.0, 0.0, 0.3, 1.0])
def test_a_car_that_hardly_moves_is_steered_sanely(law, speed):
    controller = law(CAR, preview=True)
    moving = parabola(0.01, 1.0, 0.1)
    for _ in range(20):
        command = controller.step([0.0, 0.0, 0.0, 0.05], speed, moving)
        assert math.isfinite(command.angle)
        assert not command.held
        assert abs(command.angle) < 0.3


@pytest.mark.parametrize("law", [LQR, Stanley])
def test_below_walking_pace_the_last_heading_of_the_path_is_kept(law):
    controller = law(CAR, preview=True, limits=WIDE)
    uphill = 0.2 * 0.1 * 5.0 * np.arange(60)  # a straight path at atan(0.2) for a car at 5 m/s
    driving = controller.step([0.0, 0.0, 0.0, 0.0], 5.0, uphill)
    standing = controller.step([0.0, 0.0, 0.0, 0.0], 0.0, uphill)  # y_ref(t) runs on: its slope means nothing
    assert standing.diagnostics["heading_error"] == pytest.approx(driving.diagnostics["heading_error"], abs=1e-12)


@every_law
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf, "1", None, True])
def test_an_impossible_tuning_or_period_is_refused(law, value):
    name = law(CAR).tuning_names[0]
    with pytest.raises(InvalidInput, match=name):
        law(CAR, **{name: value})
    with pytest.raises(InvalidInput, match="period"):
        law(CAR, period=0.0 if value is None else value)  # None: some take the profile's


@pytest.mark.parametrize(("make", "options", "message"), [
    (Stanley, {"vehicle": "paper"}, r"load_vehicle\(name\) gives one"),
    (PurePursuit, {"lookahead_min": 0.0}, "lookahead_min = 0.0 m: must be a finite number > 0; a standing car"),
    (LQR, {"r": 0}, "r = 0 1/rad.2: must be a finite number > 0"),
    (LQR, {"limits": 0.5}, r"must be a Limits or None; Limits\(move="),
    (KinematicMPC, {"lateral": 1.0}, "lateral: no weight of it; known are lateral_error"),
    (KinematicMPC, {"steering": 0.0, "steering_v2": 0.0}, "one of them must be positive"),
    (KinematicMPC, {"stages": 0}, "stages"),
    (KinematicMPC, {"stages": 101}, "must be a whole number >= 1 and <= 100"),
    (KinematicMPC, {"step": 0.0}, r"step = 0.0 s: must be a finite number > 0"),
    (KinematicMPC, {"period": math.nan}, "period"),
    (KinematicMPC, {"belief": 0.2}, "belief"),
    (PreviewLQR, {"q_e": 0.0}, "q_e = 0.0: must be finite and positive"),
    (PreviewLQR, {"ahead": 0.01}, "ahead = 0.01 s: must be from a control period to 10"),
    (PreviewLQR, {"ahead": 11.0}, "ahead"),
    (PreviewLQR, {"q_e": 1e300, "r": 1e-300}, "so far apart"),
])  # fmt: skip
def test_what_makes_no_controller_is_refused_with_the_remedy(make, options, message):
    with pytest.raises(InvalidInput, match=message):
        make(**{"vehicle": CAR, **options})


# -- closed loop -------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@every_law
@every_car
def test_each_law_drives_a_double_lane_change_on_the_road(law, car):
    controller = law(car, period=0.05, preview=True)
    run = simulate(DualTrack(car), controller, load_scenario("double-lane-change"), profile="road")
    assert np.abs(run.error).max() < 2.0
    assert not run.held.any()


# -- a controller of one's own -----------------------------------------------------------------------------------------
def proportional(situation, reference, road, tuning, parameters, memory, answer):
    """Steer by the offset; memory counts the steps."""
    offset = reference[0] - situation[3]
    command = tuning[0] * offset / parameters[5]
    if not math.isfinite(command + situation[0] + situation[1] + situation[2] + situation[4]):
        command = situation[5]
    move = min(max(command - situation[5], parameters[1]), parameters[2])
    answer[0] = min(max(situation[5] + move, parameters[3]), parameters[4])
    memory[0] += 1.0
    answer[1] = memory[0]


def make_proportional(law=proportional, **options) -> UserController:
    options = {"tuning": {"gain": 0.2}, "parameters": {"scale": 4.0}, "memory_size": 1, **options}
    return UserController(law, **{"diagnostics": ("steps",), "label": "proportional", **options})


def test_a_law_of_ones_own_sees_its_numbers_and_keeps_its_memory():
    controller = make_proportional()
    answers = [controller.step([0.0, 0.0, 0.0, 0.0], 10.0, [1.0]) for _ in range(3)]
    assert [answer.angle for answer in answers] == [0.05] * 3
    assert [answer.diagnostics["steps"] for answer in answers] == [1.0, 2.0, 3.0]
    assert answers[0].tuning == (0.2,)
    controller.reset()
    assert controller.step([0.0, 0.0, 0.0, 0.0], 10.0, [1.0]).diagnostics["steps"] == 1.0
    assert controller.describe()["parameters"] == {"scale": 4.0}
    assert pickle.loads(pickle.dumps(controller)).name == "proportional"


# -- the registry and the checker --------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize(
    "name", ["as-released", "as-written", "informed", "kinematic-mpc", "lqr", "preview-lqr", "pure-pursuit", "stanley"]
)
@pytest.mark.parametrize("preview", [False, True])
def test_every_named_controller_keeps_the_contract(name, preview):
    controller = get_controller(name, "paper", period=0.05, preview=preview)
    check_controller(controller)
    assert controller.describe()["period"] == 0.05


def test_names_are_known_once_and_a_misspelt_one_is_answered_with_the_nearest():
    assert {"as-released", "as-written", "informed", "kinematic-mpc", "lqr"} <= set(list_controllers())
    assert isinstance(get_controller("stanley", CAR, gain=2.0), Stanley)
    with pytest.raises(UnknownName, match="Did you mean 'stanley'"):
        get_controller("stanly", CAR)
    with pytest.raises(InvalidInput, match="already"):
        register_controller("lqr", LQR)
    with pytest.raises(InvalidInput, match="needs a name"):
        register_controller("", LQR)
    with pytest.raises(InvalidInput, match=r"must be callable or 'package.module:name'"):
        register_controller("mine", "mine")


class InPython(Controller):
    """A controller in plain Python; a broken one differs in one function or attribute."""

    name: object = "in Python"
    period: object = 0.1
    limits = Limits()

    def __init__(self, **broken) -> None:
        self.__dict__.update(broken)
        self.reset()

    def reset(self) -> None:
        self.last, self.steps = 0.0, 0

    def law(self, state, speed, reference) -> float:
        return 0.05 * (reference[0] - state[3])

    def step(self, state, speed, reference, variables=None) -> Command:
        command = self.law(state, speed, reference) if np.isfinite([*state, speed, reference[0]]).all() else self.last
        move = float(np.clip(command - self.last, *self.limits.move))
        angle = float(np.clip(self.last + move, *self.limits.angle))
        move, self.last = angle - self.last, angle
        return Command(angle, move, False, (), {})

    def describe(self) -> dict:
        return {}


def raises(state, speed, reference):
    raise ZeroDivisionError("speed")


def remembers():
    """A law that `reset` does not reach."""
    calls = [0]

    def law(state, speed, reference):
        calls[0] += 1
        return 1e-3 * calls[0]

    return law


def jump_to(angle):
    """A controller whose step leaps to an angle (rad), whatever the limits are."""

    class Jumping(InPython):
        def step(self, state, speed, reference, variables=None):
            move, self.last = (angle if state[3] < -0.5 else 0.0) - self.last, angle if state[3] < -0.5 else 0.0
            return Command(self.last, move, False, (), {})

    return Jumping()


def writing(state, speed, reference, variables=None):
    state.flags.writeable = True
    state[0] += 1.0
    return Command(0.0, 0.0, False, (), {})


def write_to_the_state(state, speed, reference):
    state[0] = 0.0
    return 0.0


BROKEN = {
    "it must have a name": InPython(name=""), "`period` must be a positive float": InPython(period=0),
    "it must have a method `step`": InPython(step=None),
    r"`describe\(\)` must give a dict of plain data": InPython(describe=lambda: {"law": object()}),
    "must raise nothing but InvalidInput.*ZeroDivisionError": InPython(law=raises),
    "must raise nothing but InvalidInput.*read-only": InPython(law=write_to_the_state),
    "after `reset` it must answer as before": InPython(law=remembers()),
    "the mirrored situation must give the mirrored command": InPython(law=lambda *_: 0.01),
    "a command must be finite": InPython(step=lambda *_: Command(math.nan, 0.0, False, (), {})),
    "`move` must be the change of `angle`": InPython(step=lambda *_: Command(0.0, 0.1, False, (), {})),
    "must keep the limits on the angle": jump_to(3.0), "must keep the limits on the move": jump_to(0.5),
    "must not write to its arguments": InPython(step=writing),
}  # fmt: skip


@pytest.mark.parametrize("clause", BROKEN)
def test_the_checker_refuses_a_controller_that_breaks(clause):
    with pytest.raises(ContractError, match=f"(?s){clause}"):
        check_controller(BROKEN[clause])


def test_a_controller_in_python_may_be_registered_and_found_by_name(monkeypatch):
    monkeypatch.setattr(registry._registry, "factories", dict(registry._registry.factories))
    register_controller("in-python", lambda vehicle, **options: InPython())
    assert get_controller("in-python", "paper").name == "in Python"


class Blind(Controller):
    """A controller as it was written before there were roads."""

    period = 0.05

    def step(self, state, speed, reference, variables=None):
        return 0.1 * (reference[0] - state[3]) - state[1]


def test_a_controller_without_the_argument_road_drives_along_one_by_offset_and_heading():
    road = generate_road("country", seed=1, length=150.0)
    run = simulate(DualTrack(CAR), Blind(), RoadDrive(road, 10.0), profile="road")
    tracker = Tracker(Blind(), road)
    place = road.at(20.0)
    tracked = tracker.step(0.0, float(place.x), float(place.y), float(place.heading) + 0.01, 10.0, 0.0)
    assert run.failed is None
    assert np.abs(run.error).max() < 2.0
    assert tracked.command < 0.0


def test_a_step_that_returns_no_angle_is_named():
    class Mute(Blind):
        def step(self, state, speed, reference, variables=None):
            pass

    for drive in (lambda: simulate(DualTrack(CAR), Mute(), load_scenario("step")), lambda: check_controller(Mute())):
        with pytest.raises(ContractError, match=r"step\(\) returned None: it must return the steering angle"):
            drive()
