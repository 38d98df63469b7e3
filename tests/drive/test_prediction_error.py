"""Errors of a prediction model over a drive, open loop."""

import math

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.control.models import PathModel
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.prediction import prediction_error, run_prediction_error
from adaptrack.drive.simulate import rollout
from adaptrack.road import Arc
from adaptrack.road.road import Road
from adaptrack.scenario import RoadDrive

MODEL = PathModel(load_vehicle("midsize-sedan"), period=0.05, lag=0.2, dead_time=0.1)


def drive(rng, n=200, late=2):
    """A drive of the model itself along a bend, its commands acting `late` periods later."""
    v, u, x = np.linspace(15, 20, n), 0.02 * rng.standard_normal(n), np.zeros((n, MODEL.n))
    for k in range(n - 1):
        a, b, e = (np.zeros(shape) for shape in ((MODEL.n, MODEL.n), MODEL.n, MODEL.n))
        MODEL.function(v[k], 0.05, MODEL.parameters(), a, b, e)
        x[k + 1] = a @ x[k] + b * (u[k - late] if k >= late else 0.0) + e * 0.01 * v[k]
    return x, u, v


def test_a_model_foretells_itself_and_an_output_that_is_off_is_off_by_as_much(rng):
    x, u, v = drive(rng)
    errors = prediction_error(MODEL, x, u, v, curvatures=0.01)
    assert errors == {0.5: pytest.approx(0.0, abs=1e-12), 1.0: pytest.approx(0.0, abs=1e-12)}
    assert prediction_error(MODEL, x, u, v)[1.0] > 0.5  # a bend that is not told
    shifted = prediction_error(MODEL, x, u, v, curvatures=0.01, outputs=x @ MODEL.output + 0.3)
    assert shifted[0.5] == pytest.approx(0.3)
    with pytest.raises(InvalidInput, match="within the record"):
        prediction_error(MODEL, x[:20], u[:20], v[:20])
    with pytest.raises(InvalidInput, match="states"):
        prediction_error(MODEL, x[:, :2], u, v)


@pytest.mark.parametrize("model", ["path", "single-track"])
def test_a_model_foretells_a_gentle_drive_along_a_bend_far_better_than_not_turning_would(model):
    car = load_vehicle("midsize-sedan")
    road = Road.from_segments([Arc(length=300.0, curvature=0.005)], name="bend")
    mpc = MPC(car, profile="paper") if model == "path" else published_mpc(car, Tuning(30, 10, 1.0, 100.0), preview=True)
    run = rollout(DualTrack(car), mpc, RoadDrive(road, 15.0))
    errors = run_prediction_error(run, mpc.model)
    turned_away = 0.5 * 0.005 * 15.0**2  # m, of a car that goes straight on for 1 s
    assert 0.0 < errors[0.5] < errors[1.0] < 0.15 * turned_away
    assert compute_metrics(run, model=mpc.model).prediction_error_one == errors[1.0]
    assert math.isnan(compute_metrics(run).prediction_error_one)
    short = run_prediction_error(run.between(0.0, 0.8), mpc.model)
    assert math.isfinite(short[0.5])
    assert math.isnan(short[1.0])
