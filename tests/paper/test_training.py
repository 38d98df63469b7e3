"""From tuned conditions to models: what is held out stays out, and the quality is what anybody would compute."""

import dataclasses

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.paper import ANFIS, MLP, TARGET_SLOTS, train
from adaptrack.paper import training as module
from adaptrack.paper.operating_points import POINT_NAMES, Grid, fold, mirrored, sobol
from small_data import plain

BOX = {"speed": (3.0, 30.0), "y_ref": (-15.0, 15.0), "friction": (0.3, 1.0), "wind": (-30.0, 30.0)}
OPTIONS = {"nn": {"solver": "adam", "epochs": 60, "batch_size": 30, "learning_rate": 0.02}, "anfis": {"epochs": 3}}


def tuned(conditions, noise=0.0):
    """A data set whose best tuning is a smooth function of the condition, alike for left-right twins."""
    speed, y_ref, friction, wind = conditions.T
    rng = np.random.default_rng(0)
    family = fold(conditions).family
    Np = 20.0 + speed + noise * rng.normal(size=len(conditions))[family]
    Nc = 2.0 + np.abs(y_ref) / 3.0
    Q, R = 1.0 + friction * np.abs(y_ref), 10.0 ** (-3.0 + speed / 30.0 + (wind * y_ref) / 900.0)
    return plain(conditions, tunings=np.column_stack((Np, Nc, Q, R)), provenance={"name": "smooth", "identity": "abc"})


@pytest.fixture
def no_ceiling(monkeypatch):
    """No boosted trees: their predictions are the truth."""
    monkeypatch.setattr(module, "ceiling", lambda x, y, x_held, y_held, seed: y_held)


@pytest.fixture(scope="module")
def dataset():
    return tuned(sobol(400, BOX))


@pytest.fixture(scope="module", params=["nn", "anfis"])
def trained(request, dataset):
    return train(dataset, request.param, "ratio", seed=1, **OPTIONS[request.param])


@pytest.mark.parametrize("model", ["nn", "anfis"])
@pytest.mark.parametrize("targets", ["paper", "ratio"])
def test_each_slot_gets_a_model_of_its_own_target(no_ceiling, dataset, model, targets):
    models = train(dataset, model, targets, **OPTIONS[model] | {"epochs": 2})
    assert (models.model, models.targets, models.inputs) == (model, targets, POINT_NAMES)
    assert tuple(models.estimators) == tuple(row["slot"] for row in models.quality) == TARGET_SLOTS[targets]
    assert {type(estimator) for estimator in models.estimators.values()} == {MLP if model == "nn" else ANFIS}
    learned, _ = dataset.split(0.2, 0)
    expected = dict(zip(("Np", "Nc", "Q", "R"), learned.tunings.T, strict=True))
    expected["log10_ratio"] = np.log10(expected["R"] / expected["Q"])
    for slot, estimator in models.estimators.items():
        network = model == "nn"
        limits = (estimator.network_.out_low, estimator.network_.out_high) if network else estimator.output_range_
        np.testing.assert_allclose(limits, (expected[slot].min(), expected[slot].max()), rtol=1e-13)


def test_the_quality_is_what_anybody_computes_on_the_hold_out(dataset, trained):
    learned, holdout = dataset.split(0.2, 1)
    targets = {"Np": holdout.tunings[:, 0], "Nc": holdout.tunings[:, 1], "log10_ratio": np.log10(holdout.ratios)}
    for row in trained.quality:
        y, predicted = targets[row["slot"]], trained.estimators[row["slot"]].predict(holdout.operating_points)
        assert row["r2"] == pytest.approx(1.0 - ((y - predicted) ** 2).sum() / ((y - y.mean()) ** 2).sum(), rel=1e-9)
        assert row["rmse"] == pytest.approx(np.sqrt(((y - predicted) ** 2).mean()), rel=1e-9)
        assert (row["model"], row["n_train"], row["n_holdout"]) == (trained.model, len(learned), len(holdout))
        assert (len(learned), len(holdout)) == (320, 80)
        assert row["seconds"] > 0.0


def test_a_smooth_schedule_is_learned(dataset, trained):
    _, holdout = dataset.split(0.2, 1)
    for row in trained.quality:
        assert row["r2"] > 0.85
        assert row["ceiling_r2"] > 0.8
        spread = module.target(holdout, row["slot"]).std()
        assert row["ceiling_rmse"] == pytest.approx(spread * np.sqrt(1.0 - row["ceiling_r2"]))


def test_no_twin_of_a_held_out_condition_is_trained_on(no_ceiling, monkeypatch):
    dataset = tuned(Grid(speed=[5, 15, 25], y_ref=[-8, -3, 3, 8], friction=[0.5, 0.9], wind=[-20, 0, 20]).rows())
    inputs = []
    fit = ANFIS.fit
    monkeypatch.setattr(ANFIS, "fit", lambda self, x, y: inputs.append(x) or fit(self, x, y))
    train(dataset, "anfis", epochs=0, seed=2)
    _, holdout = dataset.split(0.2, 2)
    either = np.vstack((holdout.operating_points, mirrored(holdout.operating_points)))
    assert len(holdout) >= 10
    assert len(inputs) == 4
    for x in inputs:
        assert len(x) + len(holdout) == len(dataset)
        assert not (x[:, np.newaxis] == either).all(axis=2).any()


def test_the_ceiling_has_not_seen_the_twins_of_what_it_predicts():
    conditions = Grid(
        speed=[*range(4, 29, 3)], y_ref=[-8, -3, 3, 8], friction=[0.5, 0.9], wind=[-20, -10, 10, 20]
    ).rows()
    dataset = tuned(conditions, noise=50.0)  # the speed explains next to nothing: what a twin tells would be seen
    learned, holdout = dataset.split(0.3, 0)
    y, y_held = module.target(learned, "Np"), module.target(holdout, "Np")
    r2, _ = module.score(y_held, module.ceiling(learned.operating_points, y, holdout.operating_points, y_held, 0))
    assert -0.3 < r2 < 0.3


def test_operating_points_where_every_tuning_fails_teach_nothing(no_ceiling, dataset):
    costs, tunings = dataset.costs.copy(), dataset.tunings.copy()
    costs[:40], tunings[:40] = np.inf, 1e6
    rows = train(dataclasses.replace(dataset, costs=costs, tunings=tunings), "anfis", epochs=0).quality
    assert {row["n_train"] + row["n_holdout"] for row in rows} == {360}
    assert max(row["rmse"] for row in rows) < 10.0


def test_a_target_that_never_changes_has_no_r2_and_no_error(dataset):
    tunings = dataset.tunings.copy()
    tunings[:, 2] = 1.0
    for model in ("nn", "anfis"):
        models = train(dataclasses.replace(dataset, tunings=tunings), model, epochs=1)
        row = next(row for row in models.quality if row["slot"] == "Q")
        assert row["r2"] == row["ceiling_r2"] == 0.0
        assert row["rmse"] == pytest.approx(0.0, abs=1e-12)


def test_the_seed_chooses_the_hold_out_and_the_start(no_ceiling, dataset):
    def weights(seed):
        return train(dataset, "nn", epochs=2, seed=seed).functions["Np"].weights[0]

    np.testing.assert_array_equal(weights(3), weights(3))
    assert (weights(3) != weights(4)).any()


def test_where_it_comes_from_is_told(no_ceiling, dataset):
    provenance = train(dataset, "anfis", holdout=0.3, seed=5, epochs=0).provenance
    options = {"random_state": 5, "epochs": 0}
    assert provenance == {"dataset": "smooth", "identity": "abc", "holdout": 0.3, "seed": 5, "options": options}


@pytest.mark.parametrize(("options", "message"), [
    ({"model": "svm"}, r"train: model = 'svm': must be one of \('nn', 'anfis'\)"),
    ({"targets": "all"}, r"train: targets = 'all': must be one of \('paper', 'ratio'\)"),
    ({"epoch": 3}, r"MLP has no option 'epoch'. Did you mean 'epochs'"),
    ({"epochs": 0}, "epochs = 0"),
    ({"holdout": 0.0}, "holdout|fraction = 0.0"),
])  # fmt: skip
def test_what_train_cannot_use_is_named(dataset, options, message):
    with pytest.raises(InvalidInput, match=message):
        train(dataset, **options)
