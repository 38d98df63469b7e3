"""The neuro-fuzzy regressor: its layers, its learning rule, its partitions, and its files for MATLAB."""

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling import functions as sugeno
from adaptrack.control.scheduling.functions import ANY, BELL_CENTRE, BELL_SLOPE, BELL_WIDTH, Sugeno
from adaptrack.paper import ANFIS, subtractive_clustering, write_fis
from adaptrack.paper import anfis as module


def data(n=300, inputs=2, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3.0, 3.0, (n, inputs))
    return x, np.sin(x[:, 0]) + 0.3 * x[:, 1] * np.tanh(x[:, 0])


def some_system(bell, seed=1):
    """Three rules on two inputs; the second one does not ask the second input."""
    rng = np.random.default_rng(seed)
    width, centre = rng.uniform(0.5, 1.5, 5), rng.uniform(-1.0, 1.0, 5)
    return Sugeno(
        owner=np.array([0, 0, 0, 1, 1]), bell=np.array([bell, bell, False, bell, bell]),
        premises=np.column_stack((width, rng.uniform(1.2, 2.5, 5), centre)),
        rules=np.array([[0, 3], [1, ANY], [2, 4]]), consequents=rng.normal(size=(3, 3)),
        weights=np.array([1.0, 0.5, 1.0]),
    )  # fmt: skip


# -- layers -----------------------------------------------------------------------------------------------------------
def test_the_layers_are_the_papers_equations():
    system, (x, _) = some_system(bell=True), data(7)
    mu = np.empty((7, 5))
    for m, (width, slope, centre) in enumerate(system.premises):
        distance = (x[:, system.owner[m]] - centre) / width
        mu[:, m] = 1 / (1 + np.abs(distance) ** (2 * slope)) if system.bell[m] else np.exp(-(distance**2) / 2)
    w = system.weights * np.column_stack((mu[:, 0] * mu[:, 3], mu[:, 1], mu[:, 2] * mu[:, 4]))
    f = x @ system.consequents[:, :2].T + system.consequents[:, 2]
    np.testing.assert_allclose(np.exp(sugeno.fuzzify(x, system)), mu, rtol=1e-13)
    np.testing.assert_allclose(np.exp(sugeno.fire(np.log(mu), system)), w, rtol=1e-13)
    np.testing.assert_allclose(system.strengths(x), w / w.sum(axis=1, keepdims=True), rtol=1e-13)
    np.testing.assert_allclose(system.predict(x), (w * f).sum(axis=1) / w.sum(axis=1), rtol=1e-12)


def test_normalised_strengths_sum_to_one_however_far_from_the_rules():
    x, y = data(60)
    distant = np.multiply.outer([1.0, 1e3, 1e9, 1e200], x).reshape(-1, 2)
    strengths = ANFIS(epochs=0).fit(x, y).system_.strengths(distant)
    assert (strengths >= 0.0).all()
    np.testing.assert_allclose(strengths.sum(axis=1), 1.0, rtol=1e-14)


# -- consequents ------------------------------------------------------------------------------------------------------
def test_least_squares_is_what_numpy_finds():
    rng = np.random.default_rng(3)
    for shape in ((80, 12), (10, 25)):
        a, y = rng.normal(size=shape), rng.normal(size=shape[0])
        for penalty in (1e-9, 1e-2):
            stacked = np.vstack((a, np.sqrt(penalty) * np.eye(shape[1])))
            expected = np.linalg.lstsq(stacked, np.concatenate((y, np.zeros(shape[1]))), rcond=None)[0]
            np.testing.assert_allclose(module.least_squares(a, y, penalty), expected, rtol=1e-9, atol=1e-11)


# -- premises ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("bell", [False, True])
def test_the_premise_gradient_is_that_of_finite_differences(bell):
    system, (x, y) = some_system(bell), data(40)
    gradient = module.premise_gradient(system, x, y)

    def error(premises):
        return ((replace(system, premises=premises).predict(x) - y) ** 2).mean() / 2

    for m, column in itertools.product(range(5), (BELL_WIDTH, BELL_SLOPE, BELL_CENTRE)):
        up, down = system.premises.copy(), system.premises.copy()
        up[m, column] += 1e-5
        down[m, column] -= 1e-5
        assert gradient[m, column] == pytest.approx((error(up) - error(down)) / 2e-5, rel=1e-6, abs=1e-9)


def test_the_step_grows_after_four_drops_and_shrinks_after_two_oscillations():
    def steps(errors):
        recent, step, steps_taken = [], 1.0, []
        for error in errors:
            recent.append(error)
            step = module.adapt_step(step, recent)
            steps_taken.append(step)
        return steps_taken

    np.testing.assert_allclose(steps([9, 8, 7, 6, 5, 4, 3, 2, 1]), [1, 1, 1, 1, 1.1, 1.1, 1.1, 1.1, 1.21])
    np.testing.assert_allclose(steps([5, 6, 5, 6, 5, 6]), [1, 1, 1, 1, 0.9, 0.9])
    np.testing.assert_allclose(steps([5, 4, 3, 4, 5, 4]), 1.0)


# -- learning ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("partition", ["subtractive", "grid"])
@pytest.mark.parametrize("membership", ["gaussian", "bell"])
def test_a_linear_function_is_learned_exactly(partition, membership):
    x, _ = data(200, 3)
    y = 2.0 * x[:, 0] - x[:, 1] + 0.5 * x[:, 2] + 7.0
    estimator = ANFIS(partition, membership=membership, n_mfs=2, epochs=1, ridge=1e-12).fit(x[:150], y[:150])
    np.testing.assert_allclose(estimator.predict(x[150:]), y[150:], rtol=0, atol=1e-7)


def test_a_sugeno_system_recovers_itself_from_its_own_data():
    x, _ = data(400)
    truth = ANFIS("grid", n_mfs=2, epochs=0).fit(*data()).system_
    truth = replace(truth, consequents=np.random.default_rng(5).normal(size=truth.consequents.shape))
    corners = np.array(list(itertools.product((-3.0, 3.0), repeat=2)))  # the grid spans the data: make it the same one
    truth = replace(truth, premises=np.column_stack((np.full(4, 6 / 2.3548200450309493), np.ones(4), [-3, 3, -3, 3])))
    x = np.vstack((x, corners))
    system = ANFIS("grid", n_mfs=2, epochs=0, ridge=1e-14).fit(x, truth.predict(x)).system_
    np.testing.assert_allclose(system.premises, truth.premises, rtol=1e-12)
    np.testing.assert_allclose(system.consequents, truth.consequents, rtol=1e-6, atol=1e-7)


def test_early_stopping_keeps_the_epoch_that_is_best_on_the_hold_out():
    x, y = data(120)
    y = y + np.random.default_rng(6).normal(0.0, 0.3, len(y))
    estimator = ANFIS(influence=0.3, epochs=200, step=0.1, early_stopping=True, patience=5, random_state=0).fit(x, y)
    errors = estimator.history_["validation_rmse"]
    assert estimator.best_epoch_ == errors.argmin()
    assert estimator.n_iter_ == len(errors) - 1 == estimator.best_epoch_ + 5
    assert len(estimator.history_["train_rmse"]) == len(estimator.history_["step"]) == len(errors)


# -- partitions -------------------------------------------------------------------------------------------------------
def test_clustering_finds_the_centres_of_blobs():
    rng = np.random.default_rng(7)
    centres = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 500.0], [10.0, 500.0]])
    points = np.vstack([c + rng.normal(size=(60, 2)) * (0.3, 15.0) for c in centres])
    system = subtractive_clustering(points, influence=0.4)
    assert len(system.centres) == 4
    for centre in centres:
        assert (np.abs((system.centres - centre) / (0.3, 15.0)).max(axis=1) < 1.0).sum() == 1
    np.testing.assert_allclose(system.sigma, 0.4 * np.ptp(points, axis=0) / np.sqrt(8.0))


def test_clustering_is_chius_algorithm_written_out():
    """Against the recurrence with the whole matrix of distances, one accept/reject decision after the other."""
    points = np.random.default_rng(8).uniform(size=(120, 3))
    unit = (points - points.min(0)) / np.ptp(points, axis=0)
    for ra in (0.3, 0.5):
        square = ((unit[:, None] - unit[None]) ** 2).sum(-1)
        p = np.exp(-4 / ra**2 * square).sum(1)
        first, chosen = p.max(), [int(p.argmax())]
        p = p - p.max() * np.exp(-4 / (1.25 * ra) ** 2 * square[p.argmax()])
        while (ratio := p.max() / first) >= 0.15:
            k = int(p.argmax())
            if ratio > 0.5 or np.sqrt(square[k, chosen].min()) / ra + ratio >= 1:
                chosen.append(k)
                p = p - p[k] * np.exp(-4 / (1.25 * ra) ** 2 * square[k])
            else:
                p[k] = 0.0
        np.testing.assert_array_equal(subtractive_clustering(points, ra).centres, points[chosen])


def test_a_grid_has_a_rule_for_each_combination():
    x, y = data(100, 3)
    for n_mfs, rules in ((2, 8), ((2, 3, 4), 24), ((1, 1, 5), 5)):
        estimator = ANFIS("grid", n_mfs=n_mfs, epochs=0).fit(x, y)
        assert estimator.n_rules_ == rules == len(np.unique(estimator.system_.rules, axis=0))


def test_pruning_removes_the_rules_that_no_data_fire():
    x, y = data(300)
    line = np.column_stack((x[:, 0], x[:, 0] + 0.05 * x[:, 1]))  # a diagonal: most cells of the grid are empty
    full = ANFIS("grid", n_mfs=5, epochs=3).fit(line, y)
    lean = ANFIS("grid", n_mfs=5, epochs=3, prune=0.01).fit(line, y)
    assert full.n_rules_ == 25
    assert lean.n_rules_ < 20
    assert lean.system_.mass(line).sum() == pytest.approx(1.0)
    assert lean.score(line, y) > full.score(line, y) - 0.02


# -- an independent library -------------------------------------------------------------------------------------------
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("kind", "names"), [("gaussian", ("sigma", "", "mean")), ("bell", ("a", "b", "c"))])
def test_the_trained_system_of_an_independent_anfis_predicts_the_same_here(kind, names):
    toolbox = pytest.importorskip("anfis_toolbox")
    x, y = data(200)
    other = toolbox.ANFISRegressor(n_mfs=3, mf_type=kind, epochs=3, optimizer="hybrid", random_state=0).fit(x, y)
    numbers = other.model_.get_parameters()
    functions = [function for group in numbers["membership"].values() for function in group]
    system = Sugeno(
        owner=np.repeat([0, 1], 3), bell=np.full(6, kind == "bell"),
        premises=np.array([[function.get(name, 1.0) for name in names] for function in functions]),
        rules=np.array(other.model_.rules) + np.array([0, 3]), consequents=numbers["consequent"], weights=np.ones(9),
    )  # fmt: skip
    expected = np.ravel(other.predict(x))  # it adds 1e-8 to the sum of eq. (26)
    np.testing.assert_allclose(system.predict(x), expected, rtol=1e-6, atol=1e-7)


# -- FIS files --------------------------------------------------------------------------------------------------------
def trained(seed=0, **options):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3.0, 3.0, (150, 3)) * (1.0, 100.0, 1e-3) + (0.0, 20.0, 1.0)
    y = np.sin(x[:, 0]) + 1e-2 * x[:, 1] * np.tanh(x[:, 0]) + 1e3 * x[:, 2]
    return ANFIS(epochs=3, **options).fit(x, y), x


def numbers(text):
    return [float(word) for word in text.strip("[]").split()]


def predict(text, x):
    """Output of the Sugeno system in a `.fis` file at inputs x (n, D): product as AND, weighted average."""
    sections = dict(re.findall(r"^\[(\w+)\]\n(.*?)(?=\n\n|\n*\Z)", text, re.MULTILINE | re.DOTALL))
    functions = {
        name: [(kind, numbers(values)) for kind, values in re.findall(r"MF\d+='.*':'(\w+)',(\[.*\])", section)]
        for name, section in sections.items()
    }
    shapes = {
        "gaussmf": lambda x, sigma, centre: np.exp(-((x - centre) ** 2) / (2.0 * sigma**2)),
        "gbellmf": lambda x, width, slope, centre: 1.0 / (1.0 + np.abs((x - centre) / width) ** (2.0 * slope)),
    }
    total = weighted = 0.0
    for line in sections["Rules"].splitlines():
        inputs, output, weight = re.fullmatch(r"([\d ]+), (\d+) \((.*)\) : 1", line).groups()
        strength = float(weight)
        for i, member in enumerate(map(int, inputs.split())):
            if member:  # 0: the rule does not ask this input
                kind, values = functions[f"Input{i + 1}"][member - 1]
                strength = strength * shapes[kind](x[:, i], *values)
        kind, (*slopes, constant) = functions["Output1"][int(output) - 1]
        assert kind == "linear"
        total, weighted = total + strength, weighted + strength * (x @ slopes + constant)
    return weighted / total


@pytest.mark.parametrize("options", [
    {}, {"membership": "bell"}, {"partition": "grid", "n_mfs": (2, 3, 1)}, {"influence": 0.3, "prune": 0.02},
])  # fmt: skip
def test_a_file_means_by_the_equations_of_the_format_what_the_estimator_predicts(options, tmp_path):
    estimator, x = trained(**options)
    write_fis(estimator, tmp_path / "a.fis")
    text = (tmp_path / "a.fis").read_text()
    np.testing.assert_allclose(predict(text, x), estimator.predict(x), rtol=1e-11)
    assert f"NumRules={estimator.n_rules_}\n" in text
    ranges = [numbers(text_range) for text_range in re.findall(r"Range=(.*)", text)]
    np.testing.assert_array_equal(ranges, [*estimator.input_range_, estimator.output_range_])


def test_names_of_the_inputs_reach_the_file_without_what_would_end_them(tmp_path):
    estimator, _ = trained()
    estimator.input_names_ = ["speed", "driver's\nmood", "grip"]
    write_fis(estimator, tmp_path / "a.fis", name="it's")
    names = re.findall(r"^Name='(.*)'$", (tmp_path / "a.fis").read_text(), re.MULTILINE)
    assert names == ["it s", "speed", "driver s mood", "grip", "out1"]


def test_an_untrained_estimator_is_not_written(tmp_path):
    with pytest.raises(InvalidInput, match="not fitted"):
        write_fis(ANFIS(), tmp_path / "a.fis")
    assert not list(tmp_path.iterdir())
