"""Tyre laws keep what their names promise: slope, peak, load dependence, symmetry, friction ellipse."""

import itertools
import math

import numpy as np
import pytest

from adaptrack.cars.vehicle import SteeringActuator, list_tyres, load_tyre, load_vehicle, pack_plant
from adaptrack.core.models.car import unpack
from adaptrack.core.physics.tyre import (
    CURVED_MAGIC_FORMULA,
    LINEAR_TYRE,
    MAGIC_FORMULA,
    curve,
    force_and_slope,
    friction_ellipse,
    lateral_force,
    reach_at,
    tyre_law,
)
from references.vehicle import cornering_stiffness, tyre_force

pytestmark = pytest.mark.kernels


LOADS = (800.0, 2500.0, 4850.0, 7000.0)
FRICTIONS = (0.3, 0.9)

TYRES = {name: load_tyre(name) for name in list_tyres()}
TYRES["curved"] = TYRES["passenger-car"].replace(name="curved", curvature=-1.5, shape=1.5)


def compiled(tyre):
    """The tyre's force as the plant computes it: (slip, load, friction) -> N, of a front tyre."""
    c = unpack(pack_plant(load_vehicle("paper"), tyre, SteeringActuator.ideal()))
    law = tyre_law(tyre.kind == "linear", tyre.curvature)
    return lambda slip, load, friction: lateral_force(slip, load, friction, tyre.stiffness_front, c, law)


@pytest.fixture(params=TYRES, scope="module")
def tyre(request):
    return TYRES[request.param]


@pytest.fixture(scope="module")
def force(tyre):
    return compiled(tyre)


saturating = pytest.mark.parametrize(
    "tyre", [name for name, tyre in TYRES.items() if tyre.kind == "magic-formula"], indirect=True
)


def friction_force(tyre, load, friction):
    """D = mu F_z (1 - d (q - 1))."""
    return friction * load * (1.0 - tyre.friction_load_sensitivity * (load / tyre.nominal_load - 1.0))


def test_each_law_is_chosen_by_its_parameters():
    laws = {name: tyre_law(tyre.kind == "linear", tyre.curvature) for name, tyre in TYRES.items()}
    curved = dict.fromkeys(("small-car", "curved"), CURVED_MAGIC_FORMULA)
    assert laws == dict.fromkeys(TYRES, MAGIC_FORMULA) | {"constant-stiffness": LINEAR_TYRE} | curved


def test_the_slope_at_the_origin_is_the_cornering_stiffness(tyre, force):
    slip, friction = 1e-6, 0.7
    scaled = friction if tyre.kind == "linear" else 1.0  # the released tyre's stiffness is scaled by friction
    for load in LOADS:
        stiffness = cornering_stiffness(tyre, tyre.stiffness_front, load)
        slope = (force(slip, load, friction) - force(-slip, load, friction)) / (2 * slip)
        assert slope == pytest.approx(stiffness * scaled, rel=1e-7)


@saturating
def test_the_peak_is_friction_times_load_and_beyond_it_the_force_falls_but_never_turns(tyre, force):
    for load, friction in itertools.product(LOADS, FRICTIONS):
        grip = friction_force(tyre, load, friction)
        forces = np.array([force(slip, load, friction) for slip in np.linspace(0.0, 3.0, 1001).tolist()])
        assert grip * (1 - 1e-3) <= forces.max() <= grip * (1 + 1e-12)
        top = forces.argmax()
        assert (np.diff(forces[: top + 1]) > 0).all()
        assert (np.diff(forces[top:]) < 0).all()
        assert (forces[1:] > 0).all()


def test_a_linear_tyre_is_linear_in_slip_friction_and_load():
    force = compiled(TYRES["constant-stiffness"])
    reference = force(0.01, 2500.0, 0.5)
    assert reference == pytest.approx(19000.0 * 0.5 * 0.5 * 0.01, rel=1e-14)  # C (F_z/5000 N) mu alpha
    assert force(0.5, 2500.0, 0.5) == pytest.approx(50 * reference, rel=1e-14)
    assert force(0.01, 5000.0, 0.5) == pytest.approx(2 * reference, rel=1e-14)
    assert force(0.01, 2500.0, 1.0) == pytest.approx(2 * reference, rel=1e-14)


def test_friction_falls_with_load_by_its_sensitivity_to_a_tenth():
    tyre = TYRES["passenger-car"]
    force = compiled(tyre)

    def share(load):
        return max(force(slip, load, 1.0) for slip in np.linspace(0.0, 3.0, 4001).tolist()) / load

    assert share(tyre.nominal_load) == pytest.approx(1.0, rel=1e-6)
    assert share(2 * tyre.nominal_load) == pytest.approx(1 - tyre.friction_load_sensitivity, rel=1e-6)
    assert share(40000.0) == pytest.approx(0.1, rel=1e-4)


def test_the_force_is_that_of_the_formula_written_with_libm_and_odd_in_slip(tyre, force, rng):
    for slip, load, friction in rng.uniform([0, 50, 0.05], [0.6, 8000, 1.2], (300, 3)).tolist():
        expected = tyre_force(tyre, tyre.stiffness_front, slip, load, friction)
        assert force(slip, load, friction) == pytest.approx(expected, rel=1e-12, abs=1e-9)
        assert force(-slip, load, friction) == -force(slip, load, friction)
    assert force(0.0, 4000.0, 0.9) == 0.0
    assert abs(force(0.3, 4000.0, 0.0)) < 1e-3  # on ice


@pytest.mark.parametrize("shape", [1.05, 1.35, 1.9])
def test_the_slip_at_a_used_share_is_the_inverse_of_the_curve(shape):
    tyre = curve(4000.0, 1e5, 0.8, shape)
    for used in np.linspace(0.0, 0.95, 20).tolist():
        force, slope = force_and_slope(reach_at(used, shape) * tyre.peak / tyre.stiffness, tyre)
        assert force == pytest.approx(used * tyre.peak, rel=1e-12, abs=1e-9)
        exact = math.sqrt(1.0 - used**2) * math.cos(math.asin(used) / shape) ** 2  # of its slope at no slip
        assert slope == pytest.approx(exact * tyre.stiffness, rel=1e-9)


def test_lateral_and_longitudinal_force_share_a_circle(rng):
    for along, load, friction in rng.uniform([-0.99, 100, 0.1], [0.99, 8000, 1.2], (200, 3)).tolist():
        grip = friction * load
        left = friction_ellipse(along * grip, load, friction)
        assert (left * grip) ** 2 + (along * grip) ** 2 == pytest.approx(grip**2, rel=1e-12) or left == 0.1
    assert friction_ellipse(0.0, 3000.0, 0.8) == 1.0
    assert friction_ellipse(5000.0, 3000.0, 0.8) == pytest.approx(0.1)
    assert friction_ellipse(0.0, 3000.0, 0.0) == 1.0
    assert math.isfinite(friction_ellipse(100.0, 0.0, 0.0))
