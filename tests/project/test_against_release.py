"""The comparison of two states of the repository finds what differs, and nothing else."""

import json

import pytest
from benchmarks import against_release

ANSWER = {"exit code": 0, "answer": {"rows": [{"cost": 0.25, "name": "a"}, {"cost": None, "name": "b"}], "seconds": 3}}


def lines(other, answer):
    return list(against_release.compare(json.loads(json.dumps(other)), json.loads(json.dumps(answer))))


def test_equal_answers_are_one_line_and_times_do_not_count():
    assert lines(ANSWER, {**ANSWER, "answer": {**ANSWER["answer"], "seconds": 4}}) == [
        "5 of 5 values are identical to the bit"
    ]


def test_a_last_digit_is_found_with_its_size():
    (summary, difference) = lines({"rows": [1.0, 2.0]}, {"rows": [1.0, 2.0 + 2**-51]})
    assert summary.startswith("1 of 2")
    assert difference == "  /rows/*: 1 differ, by at most 4.4e-16, relative 2.2e-16"


@pytest.mark.parametrize(("old", "new"), [(1, True), (0.0, None), ("a", "b"), (0, 0.0)])
def test_values_of_another_kind_differ(old, new):
    assert len(lines({"x": old}, {"x": new})) == 2


def test_what_one_side_lacks_is_named_with_its_side():
    (_, *difference) = lines({"a": 1, "b": 2}, {"a": 1, "c": 2})
    assert difference == ["  /b: only in the other", "  /c: only in this tree"]


def test_an_answer_that_is_missing_counts_as_a_difference(tmp_path, capsys):
    (tmp_path / "lists-names.json").write_text("{}")
    assert against_release.report(tmp_path, tmp_path / "none", [("lists", "names")]) == 1
    assert "no " in capsys.readouterr().out


def test_every_question_has_a_name_of_its_own_as_a_file():
    files = [f"{group}-{name}" for group, name in against_release.questions(())]
    assert len(files) == len(set(files))
    assert list(against_release.questions(["drive/lap"])) == [("drive", "lap")]
