"""Pipelines: what is kept is found again, what is stale or missing is made, what is damaged is told."""

from __future__ import annotations

import json

import pytest

from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant
from adaptrack.studies.pipeline import JSONFile, SchedulerFile, Stage, identity_of, run, software


def stages(folder, calls, second="b"):
    """One number, and twice that number."""

    def make(name, value):
        def made(before):
            calls.append(name)
            return value(before)

        return made

    return [
        Stage("one", "a", make("one", lambda before: {"value": 0.1}), JSONFile(folder / "one.json")),
        Stage("two", second, make("two", lambda before: 2.0 * before["one"]["value"]), JSONFile(folder / "two.json")),
        Stage("three", "c", make("three", lambda before: before["two"] + 1.0)),
    ]


def test_what_is_kept_is_not_made_again_and_the_result_is_the_same(tmp_path):
    calls, heard = [], []
    first = run(stages(tmp_path, calls), lambda *at: heard.append(at))
    assert first == {"one": {"value": 0.1}, "two": 0.2, "three": 1.2}
    assert calls == ["one", "two", "three"]
    assert heard == [("one", 0, 1), ("two", 0, 1), ("three", 0, 1)]
    assert run(stages(tmp_path, calls)) == first
    assert calls[3:] == ["three"], "what has no file is made in every session"


def test_a_stage_of_another_identity_and_one_that_is_missing_are_made_again(tmp_path):
    calls = []
    run(stages(tmp_path, calls))
    run(stages(tmp_path, calls, second="another"))
    assert calls[3:] == ["two", "three"]
    (tmp_path / "one.json").unlink()
    run(stages(tmp_path, calls, second="another"))
    assert calls[5:] == ["one", "three"]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "other"}', '{"format": "adaptrack-stage"}', "[" * 100_000])
def test_a_damaged_file_is_told_with_its_name_and_not_written_over(tmp_path, text):
    run(stages(tmp_path, []))
    (tmp_path / "two.json").write_text(text)
    with pytest.raises(StorageError, match=r"two\.json.*Remove it"):
        run(stages(tmp_path, []))
    assert (tmp_path / "two.json").read_text() == text


def test_a_result_that_is_no_json_is_refused_and_leaves_no_file(tmp_path):
    with pytest.raises(InvalidInput, match="no plain JSON"):
        run([Stage("one", "a", lambda before: float("nan"), JSONFile(tmp_path / "one.json"))])
    assert not (tmp_path / "one.json").exists()


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        run([Stage("one", "a", lambda before: 1.0, JSONFile(tmp_path / "file" / "one.json"))])


def test_a_scheduler_is_kept_with_its_identity_and_its_record(tmp_path):
    keeper = SchedulerFile(tmp_path / "x.json", {"settings": {"seed": 3}}, {"car": "mine"})
    made = run([Stage("mine", "a", lambda before: Constant(Tuning()), keeper)])["mine"]
    assert (made.name, dict(made.provenance)) == ("x", {"stage": "a", "settings": {"seed": 3}})
    assert made.made_for == {"car": "mine"}
    assert keeper.load("another") is None


def test_an_identity_is_of_the_stage_the_settings_and_the_software():
    assert identity_of("a", {"x": 1, "y": 2}) == identity_of("a", {"y": 2, "x": 1})
    assert len({identity_of(*given) for given in (("a", 1), ("b", 1), ("a", 2))}) == 3
    assert set(software()) == {"adaptrack", "kernels", "numpy", "scikit-learn"}
    assert json.dumps(software())
