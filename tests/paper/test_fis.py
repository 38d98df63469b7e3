"""MATLAB's `.fis` files: what is written means the same, read by the equations of the format."""

import re

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.paper import ANFIS, write_fis


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
