"""The prediction model is the paper's, equation by equation, in its readable and in its compiled form."""

import itertools
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control import models
from adaptrack.core.controllers import condensing
from adaptrack.core.models import single_track as kernel
from references import dense_mpc as dense
from references import mpc as reference

pytestmark = pytest.mark.kernels

CARS = {name: at.load_vehicle(name) for name in at.list_vehicles()}
SPEEDS = (0.5, 1.0, 3.0, 7.3, 15.0, 27.0, 41.7, 60.0)
STRIDE = 64  # row length of the compiled form's arrays, a multiple of 8

every_car = pytest.mark.parametrize("car", CARS.values(), ids=CARS)
GRID = [(car, speed) for car in CARS.values() for speed in SPEEDS]


def close(computed, expected, tolerance):
    """Equal within `tolerance` of the largest entry."""
    computed, expected = np.asarray(computed), np.asarray(expected)
    assert computed.shape == expected.shape
    assert np.abs(computed - expected).max() <= tolerance * np.abs(expected).max()


def padded(values, length=STRIDE):
    return np.concatenate([values, np.zeros(length - len(values))])


def compiled(model, speed, Np):
    """F without its last column (Np, 4) and the step response (Np,) as the kernels compute them."""
    a, b = np.empty((4, 4)), np.empty(4)
    free, step, e = np.zeros((4, STRIDE)), np.zeros(STRIDE), np.full(4, np.nan)
    kernel.discretise(speed, model.period, model.parameters(), a, b, e)
    assert (e == 0.0).all()  # the heading is that in the ground frame: no road bends it
    condensing.responses(Np, False, condensing.Discrete(a, b, model.output, e, *np.full((3, 4), np.nan)), free, step)
    return free[:, :Np].T, step[:Np]


# -- eqs. (7), (8): the model -----------------------------------------------------------------------------------------
def test_the_continuous_model_is_the_linearised_plant():
    for car, speed in GRID:
        a, b, c = at.SingleTrackModel(car).continuous(speed)
        expected_a, expected_b = reference.continuous(car, speed)
        close(a, expected_a, 1e-14)
        close(b[:, 0], expected_b, 1e-14)
        assert c.tolist() == [[0, 0, 0, 1]]
        compiled_a, compiled_b = np.empty((4, 4)), np.empty(4)
        kernel.linearise(speed, at.SingleTrackModel(car).parameters(), compiled_a, compiled_b)
        np.testing.assert_allclose(compiled_a, a, rtol=1e-14)
        np.testing.assert_allclose(compiled_b, b[:, 0], rtol=1e-14)


def test_the_continuous_model_has_the_papers_numbers():
    a, b, _ = at.SingleTrackModel(CARS["paper"]).continuous(20.0)
    assert a[0, 0] == pytest.approx(-2 * 52000 / (1575 * 20))
    assert a[0, 2] == pytest.approx(-20 - 2 * (19000 * 1.2 - 33000 * 1.6) / (1575 * 20))
    assert a[2, 0] == pytest.approx(-2 * (19000 * 1.2 - 33000 * 1.6) / (2875 * 20))
    assert a[2, 2] == pytest.approx(-2 * (19000 * 1.44 + 33000 * 2.56) / (2875 * 20))
    assert b[:, 0] == pytest.approx([2 * 19000 / 1575, 0, 2 * 19000 * 1.2 / 2875, 0])


def test_zero_order_hold_equals_the_matrix_exponential():
    for (car, speed), period in itertools.product(GRID, (0.01, 0.05, 0.1, 0.5)):
        a, b, _ = at.SingleTrackModel(car, period).discrete(speed)
        expected_a, expected_b = reference.discrete(car, speed, period)
        close(a, expected_a, 1e-12)
        close(b[:, 0], expected_b, 1e-12)


# -- eqs. (9), (10): augmentation, F and Phi --------------------------------------------------------------------------
def test_F_and_Phi_equal_the_simulated_model(rng):
    for (car, speed), (Np, Nc) in itertools.product(GRID, [(1, 1), (5, 5), (20, 3), (35, 8), (60, 20)]):
        model = at.SingleTrackModel(car)
        free, phi = dense.prediction(model, speed, Np, Nc)
        before, current, moves = rng.normal(size=4), rng.normal(size=4), np.zeros(Np)
        moves[:Nc] = rng.normal(size=Nc)
        simulated = reference.outputs(car, speed, model.period, before, current, moves)
        close(free @ np.append(current - before, current[3]) + phi @ moves[:Nc], simulated, 1e-10)


def test_the_compiled_responses_are_F_and_Phi():
    Np = 55
    for car, speed in GRID:
        free, phi = dense.prediction(at.SingleTrackModel(car), speed, Np, Np)
        compiled_free, step = compiled(at.SingleTrackModel(car), speed, Np)
        close(compiled_free, free[:, :4], 1e-12)
        close(step, phi[:, 0], 1e-12)
        assert (free[:, 4] == 1.0).all()
        for column in range(Np):  # each column of Phi is the first, shifted
            assert np.array_equal(phi[column:, column], phi[: Np - column, 0])
            assert (phi[:column, column] == 0.0).all()


# -- eqs. (11), (17): the cost ----------------------------------------------------------------------------------------
@every_car
def test_the_quadratic_form_is_the_cost_up_to_a_constant(car, rng):
    model, Np, Nc, Q, R = at.SingleTrackModel(car), 25, 6, 3.0, 0.4
    x, reference_ahead = rng.normal(size=5), rng.normal(size=Np)
    E, K = dense.quadratic(model, 12.0, x, reference_ahead, Np, Nc, Q, R)
    free, phi = dense.prediction(model, 12.0, Np, Nc)

    def cost(moves):
        return dense.cost(reference_ahead, free @ x + phi @ moves, moves, Q, R)

    for moves in rng.normal(size=(10, Nc)):
        assert 0.5 * moves @ E @ moves + moves @ K + cost(np.zeros(Nc)) == pytest.approx(cost(moves), rel=1e-12)
    close(E, E.T, 1e-14)
    assert np.linalg.eigvalsh(E).min() > 0.0


@every_car
def test_the_compiled_cost_is_that_of_eq_17(car, rng):
    model = at.SingleTrackModel(car)
    for _ in range(60):
        Np = int(rng.integers(1, 61))
        Nc = int(rng.integers(1, min(Np, 20) + 1))
        speed, Q, R = rng.uniform(0.5, 60), 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-3, 1)
        x, ahead = rng.normal(size=5), rng.normal(size=Np)
        E, K = dense.quadratic(model, speed, x, ahead, Np, Nc, Q, R)
        free, step = compiled(model, speed, Np)
        error, hessian, gradient = np.full(STRIDE + 24, np.nan), np.zeros((20, 24)), np.zeros(24)
        rows = np.ascontiguousarray([padded(column) for column in free.T])
        condensing.tracking_error(Np, rows, x[:4].copy(), x[4], padded(ahead), error)
        condensing.pulse_hessian(Np, Nc, padded(step), Q, R, hessian)
        condensing.pulse_gradient(Np, Nc, padded(step), Q, error, gradient)
        close(error[:Np], ahead - dense.prediction(model, speed, Np, Nc)[0] @ x, 1e-11)
        close(hessian[:Nc, :Nc], E, 1e-11)
        close(gradient[:Nc], K, 1e-10)


# -- Laguerre functions -----------------------------------------------------------------------------------------------
def laguerre(samples, terms, pole):
    """(samples, terms): a function a column, as the kernel computes them."""
    moves = np.zeros((terms, samples))
    condensing.laguerre_moves(samples, terms, pole, moves)
    return moves.T


@pytest.mark.parametrize("pole", [0.0, 0.3, 0.75, 0.95])
def test_laguerre_functions_are_those_of_their_z_transforms(pole):
    close(laguerre(60, 10, pole), reference.laguerre(60, 10, pole), 1e-12)


@every_car
@pytest.mark.parametrize("pole", [0.0, 0.75, 0.95])
def test_the_laguerre_cost_is_the_pulse_cost_projected(car, pole, rng):
    model, Np, terms, Q, R = at.SingleTrackModel(car), 40, 7, 10.0, 0.02
    speed = 17.0
    _, step = compiled(model, speed, Np)
    basis = laguerre(Np, terms, pole)
    phi, hessian, gradient = np.zeros((terms, STRIDE)), np.zeros((terms, 8)), np.zeros(8)
    ahead = rng.normal(size=Np)
    moves = np.ascontiguousarray([padded(function) for function in basis.T])
    condensing.laguerre_response(Np, terms, padded(step), moves, phi)
    condensing.condensed_hessian(Np, terms, phi, Q, R, hessian)
    condensing.condensed_gradient(Np, terms, phi, Q, padded(ahead), gradient)
    E, K = dense.quadratic(model, speed, np.zeros(5), ahead, Np, Np, Q, 0.0)
    close(phi[:, :Np].T, dense.prediction(model, speed, Np, Np)[1] @ basis, 1e-12)
    close(hessian[:, :terms], basis.T @ E @ basis + 2 * R * np.eye(terms), 1e-12)
    close(gradient[:terms], basis.T @ K, 1e-12)


# -- eq. (16): the limits ---------------------------------------------------------------------------------------------
def test_limit_rows_bound_each_move_and_each_angle(rng):
    class Limits:
        move = (-0.1, 0.2)
        angle = (-0.4, 0.5)

    Nc, angle = 6, 0.15
    M, gamma = dense.limit_matrix(Nc), dense.limit_bounds(Nc, angle, Limits)
    assert M.shape == (4 * Nc, Nc)
    assert gamma.shape == (4 * Nc,)
    for moves in rng.uniform(-0.25, 0.25, (300, Nc)):
        angles = angle + np.cumsum(moves)
        inside = (moves >= -0.1).all() and (moves <= 0.2).all() and (angles >= -0.4).all() and (angles <= 0.5).all()
        assert (M @ moves <= gamma).all() == inside


# -- refusals ---------------------------------------------------------------------------------------------------------
def test_what_makes_no_model_is_refused():
    model = at.SingleTrackModel(CARS["paper"])
    for value in (0.0, -3.0, math.nan, math.inf):
        for method in (model.continuous, model.discrete):
            with pytest.raises(at.InvalidInput, match="speed = "):
                method(value)
        with pytest.raises(at.InvalidInput, match="period = "):
            at.SingleTrackModel(CARS["paper"], value)


# -- names ------------------------------------------------------------------------------------------------------------
def test_a_model_of_ones_own_may_be_registered_and_found_by_name(monkeypatch):
    monkeypatch.setattr(models._registry, "factories", dict(models._registry.factories))
    at.register_model("stiffer", lambda car, period: at.SingleTrackModel(car.replace(stiffness_front=30000.0), period))
    assert at.list_models() == ["path", "single-track", "stiffer"]
    assert at.get_model("stiffer", CARS["paper"], 0.05).vehicle.stiffness_front == 30000.0
    assert at.get_model("single-track", CARS["paper"], 0.05) == at.SingleTrackModel(CARS["paper"], 0.05)
    for name, factory in (("single-track", at.SingleTrackModel), ("", at.SingleTrackModel), ("mine", None)):
        with pytest.raises(at.InvalidInput, match="register_model"):
            at.register_model(name, factory)
    with pytest.raises(at.UnknownName, match="'single-track'"):
        at.get_model("single-trak", CARS["paper"])


# -- the checker ------------------------------------------------------------------------------------------------------
def test_ours_is_admitted():
    for car, period in itertools.product(CARS.values(), (0.02, 0.1, 0.25)):
        at.check_model(at.SingleTrackModel(car, period))


@at.PredictionModel.register
class Broken:
    """A model whose function writes the matrices of the paper's, but for one thing."""

    def __init__(self, **changes):
        model = at.SingleTrackModel(CARS["paper"])
        self.name, self.period, self.n, self.output = "broken", model.period, model.n, model.output
        self.numbers, self.changes, self.asked = model.parameters(), changes, 0

    def parameters(self):
        return self.numbers

    def function(self, speed, period, parameters, a, b, e):
        self.asked += 1
        kernel.discretise(speed, period, parameters, a, b, e)
        for name, change in self.changes.items():
            change({"a": a, "b": b, "e": e, "p": parameters}[name], self.asked)


@pytest.mark.parametrize(("changes", "clause"), [
    ({"e": lambda e, count: e.fill(math.nan)}, "must be written and finite"),
    ({"b": lambda b, count: b.__setitem__(0, count)}, "must give the same matrices"),
    ({"a": lambda a, count: a.__setitem__((1, 3), 0.1)}, "must stay where it is"),
    ({"b": lambda b, count: b.__imul__(-1.0)}, "to the left must move y to the left"),
], ids=lambda value: value if isinstance(value, str) else "")  # fmt: skip
def test_the_checker_refuses_a_model_that_breaks(changes, clause):
    with pytest.raises(at.ContractError, match=clause):
        at.check_model(Broken(**changes))


def test_the_checker_refuses_a_model_that_writes_to_its_parameters():
    class Careless(Broken):
        def parameters(self):
            return np.append(self.numbers, 0.0)  # one more, which the matrices do not need

    with pytest.raises(at.ContractError, match="parameters must not be written to"):
        at.check_model(Careless(p=lambda p, count: p.__setitem__(6, 1.0)))
