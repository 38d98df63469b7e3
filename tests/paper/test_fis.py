"""MATLAB's `.fis` files: what is written reads back the same, and what is wrong is named with its line."""

import re

import numpy as np
import pytest

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.control.scheduling.functions.sugeno import ANY
from adaptrack.paper import ANFIS, read_fis, write_fis

SAMPLE = """\
[System]
Name='speed'
Type='sugeno'
Version=2.0
NumInputs=2
NumOutputs=1
NumRules=3
AndMethod='prod'
OrMethod='probor'
ImpMethod='prod'
AggMethod='sum'
DefuzzMethod='wtaver'

[Input1]
Name='wind'
Range=[-10 10]
NumMFs=2
MF1='low':'gaussmf',[4 -5]
MF2='high':'gaussmf',[4 5]

[Input2]
Name='grip'
Range=[0 1]
NumMFs=1
MF1='good':'gbellmf',[0.5 2 1]

[Output1]
Name='speed'
Range=[0 30]
NumMFs=2
MF1='line':'linear',[0.5 2 10]
MF2='flat':'constant',[20]

[Rules]
1 1, 1 (1) : 1
2 1, 2 (0.5) : 1
2 0, 2 (1) : 2
"""


@pytest.fixture
def write(tmp_path):
    def written(text, encoding="utf-8"):
        path = tmp_path / "some.fis"
        path.write_bytes(text.encode(encoding))
        return path

    return written


def trained(seed=0, **options):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3.0, 3.0, (150, 3)) * (1.0, 100.0, 1e-3) + (0.0, 20.0, 1.0)
    y = np.sin(x[:, 0]) + 1e-2 * x[:, 1] * np.tanh(x[:, 0]) + 1e3 * x[:, 2]
    return ANFIS(epochs=3, **options).fit(x, y), x


@pytest.mark.parametrize(
    "options",
    [{}, {"membership": "bell"}, {"partition": "grid", "n_mfs": (2, 3, 1)}, {"influence": 0.3, "prune": 0.02}],
)
def test_a_system_that_was_written_predicts_the_same_when_read(options, tmp_path):
    estimator, x = trained(**options)
    write_fis(estimator, tmp_path / "a.fis")
    back = read_fis(tmp_path / "a.fis")
    np.testing.assert_allclose(back.predict(x), estimator.predict(x), rtol=1e-12)
    assert (back.n_rules_, back.n_parameters_) == (estimator.n_rules_, estimator.n_parameters_)
    np.testing.assert_array_equal(back.input_range_, estimator.input_range_)
    write_fis(back, tmp_path / "b.fis")
    written = [re.sub(r"Name='.*'", "", (tmp_path / name).read_text()) for name in ("a.fis", "b.fis")]
    assert written[0] == written[1]


def test_names_of_the_inputs_reach_the_file_without_what_would_end_them(tmp_path):
    estimator, _ = trained()
    estimator.input_names_ = ["speed", "driver's\nmood", "grip"]
    write_fis(estimator, tmp_path / "a.fis", name="it's")
    assert read_fis(tmp_path / "a.fis").input_names_ == ["speed", "driver s mood", "grip"]


def test_a_file_in_matlabs_manner_means_what_its_equations_say(write):
    estimator = read_fis(write(SAMPLE))
    wind, grip = 3.0, 0.4
    low, high = np.exp(-((wind + 5) ** 2) / 32), np.exp(-((wind - 5) ** 2) / 32)
    good_grip = 1 / (1 + (0.6 / 0.5) ** 4)
    w = np.array([low * good_grip, 0.5 * high * good_grip, high])
    expected = w @ [0.5 * wind + 2 * grip + 10, 20, 20] / w.sum()
    assert estimator.predict([[wind, grip]])[0] == pytest.approx(expected, rel=1e-14)
    assert estimator.system_.rules[2, 1] == ANY
    assert estimator.input_names_ == ["wind", "grip"]


@pytest.mark.parametrize(
    "text",
    [
        SAMPLE.replace("\n", "\r\n"),
        "\ufeff" + SAMPLE,
        "% made by hand\n" + SAMPLE.replace("[4 -5]", "[4, -5]"),
        SAMPLE.replace("'gaussmf',[4 -5]", "'gaussmf', [ -4 -5.0e0 ]"),
        SAMPLE.replace("1 1, 1 (1) : 1", "1 1 , 1  (1.0000) : 1"),
    ],
)
def test_harmless_ways_of_writing_are_read_alike(write, text):
    plain = read_fis(write(SAMPLE)).system_
    assert read_fis(write(text)).system_.predict(np.array([[1.0, 0.5]])) == plain.predict(np.array([[1.0, 0.5]]))


def test_one_of_several_outputs_is_chosen(write):
    text = SAMPLE.replace("NumOutputs=1", "NumOutputs=2")
    second = "[Output2]\nRange=[0 1]\nNumMFs=1\nMF1='c':'constant',[7]\n\n[Rules]"
    text = text.replace("[Rules]", second).replace("1 1, 1 (", "1 1, 1 1 (").replace(", 2 (", ", 2 0 (")
    path = write(text)
    assert read_fis(path, output=2).system_.predict(np.array([[1.0, 0.5]])) == pytest.approx(7.0)
    assert read_fis(path).n_rules_ == 3
    with pytest.raises(ConfigError, match=r"line 6: output 3 is requested"):
        read_fis(path, output=3)


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("[System]", "[System", 1, "reads"),
        ("[System]\n", "", 1, "before the first section"),
        ("Version=2.0\n", "", 1, "Version is missing"),
        ("Name='speed'\nType", "Type='sugeno'\nType", 3, "given before, in line 2"),
        ("Type='sugeno'", "Type=sugeno", 3, "single quotes"),
        ("NumInputs=2", "NumInputs=two", 5, "whole number"),
        ("NumInputs=2", "NumInputs=0", 5, "at least 1"),
        ("NumInputs=2", "NumInputs=3", 34, "Input3"),
        ("NumRules=3", "NumRules=4", 7, "holds 3 rules"),
        ("[Input2]", "[Input1]", 21, "given before, in line 14"),
        ("Range=[-10 10]", "Range=[10 -10]", 16, "lower one first"),
        ("Range=[-10 10]", "Range=-10 10", 16, "low high"),
        ("Range=[-10 10]", "Range=[-10 inf]", 16, "finite"),
        ("NumMFs=2\nMF1='low'", "NumMFs=3\nMF1='low'", 14, "MF3 is missing"),
        ("NumMFs=2\nMF1='low'", "NumMFs=1\nMF1='low'", 19, "MF2 is beyond"),
        ("[4 -5]", "[4 -5", 18, "reads"),
        ("[4 -5]", "[4 x]", 18, "'x' is not a number"),
        ("[4 -5]", "[4]", 18, "needs 2 numbers, found 1"),
        ("[4 -5]", "[0 -5]", 18, "width must not be 0"),
        ("[0.5 2 1]", "[0.5 -2 1]", 25, "slope must be above 0"),
        ("[0.5 2 10]", "[0.5 2]", 31, "needs 3 numbers"),
        ("Range=[0 30]", "Range", 29, "key=value"),
        ("1 1, 1 (1) : 1", "1 1 1 (1) : 1", 35, "a rule reads"),
        ("1 1, 1 (1) : 1", "1, 1 (1) : 1", 35, "needs 2 input"),
        ("1 1, 1 (1) : 1", "1 1-, 1 (1) : 1", 35, "whole numbers"),
        ("1 1, 1 (1) : 1", "1 2, 1 (1) : 1", 35, "input 2 has 1 functions"),
        ("1 1, 1 (1) : 1", "1 1, 3 (1) : 1", 35, "output function 3 of 2"),
        ("1 1, 1 (1) : 1", "1 1, 1 (2) : 1", 35, "weight"),
        ("1 1, 1 (1) : 1", "1 1, 1 (a) : 1", 35, "not a number"),
        ("Type='sugeno'", "Type='mamdani'", 3, "mamdani"),
        ("Version=2.0", "Version=1.0", 4, "only 2.0"),
        ("AndMethod='prod'", "AndMethod='min'", 8, "'min' is not supported"),
        ("DefuzzMethod='wtaver'", "DefuzzMethod='wtsum'", 12, "wtsum"),
        ("'low':'gaussmf',[4 -5]", "'low':'trimf',[-9 -5 0]", 18, "trimf"),
        ("'flat':'constant'", "'flat':'gaussmf'", 32, "not supported as an output function"),
        ("1 1, 1 (1) : 1", "-1 1, 1 (1) : 1", 35, "NOT"),
        ("2 1, 2 (0.5) : 1", "2 1, 2 (0.5) : 2", 36, "OR"),
    ],
)
def test_what_is_malformed_or_not_supported_is_named_with_its_line(write, old, new, line, reason):
    assert old in SAMPLE
    with pytest.raises(ConfigError, match=re.escape("some.fis") + rf", line {line}: .*{reason}"):
        read_fis(write(SAMPLE.replace(old, new, 1)))


def test_a_file_cut_anywhere_is_refused_or_whole(write):
    """Cut at every third character: a reason from us, never another error, and no half system."""
    for end in range(0, len(SAMPLE) - len("\n"), 3):
        with pytest.raises(ConfigError):
            read_fis(write(SAMPLE[:end]))


def test_an_untrained_estimator_is_not_written(tmp_path):
    with pytest.raises(InvalidInput, match="not fitted"):
        write_fis(ANFIS(), tmp_path / "a.fis")
    assert not list(tmp_path.iterdir())
