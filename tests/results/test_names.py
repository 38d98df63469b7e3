"""A name is data: whatever it is, it is driven, saved, drawn and printed, and its files stay in their folder."""

import os

import pytest
from tests.results.test_report import Outline, drive

from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import Run, write_drive_page
from adaptrack.scenario import load_scenario

NASTY = {
    "path": "/../../../x", "markup": "[/red] [bold]x", "mathematics": r"$\frac{$ \$ $$",
    "html": "<script>alert(1)</script>&amp;\"'", "long": "x" * 10_000, "right to left": "\u202eabc\u200f",
    "terminal": "\x1b[31mred\x07", "scripts": "名前 é 🚗", "nothing": " ",
}  # fmt: skip


@pytest.mark.parametrize("name", NASTY.values(), ids=NASTY)
def test_any_name_is_driven_saved_loaded_and_printed(output_of, answer_of, monkeypatch, tmp_path, name):
    monkeypatch.setattr("adaptrack.results.page.write_result", lambda out, *_, **__: out)  # drawn below
    inside = tmp_path / "in" / "deep"
    inside.mkdir(parents=True)
    load_scenario("sine", duration=0.5).replace(name=name).to_toml(inside / "scenario.toml")
    Constant(Tuning(), name=name).save(inside / "scheduler.json")
    before = sorted(tmp_path.rglob("*"))

    arguments = ["drive", inside / "scenario.toml", "--scheduler", inside / "scheduler.json", "--period", "0.1"]
    (row,) = answer_of(*arguments, "--out", inside / "out")["rows"]
    assert (row["scenario"], row["scheduler"], row["controller"]) == (name, "scheduler", "scheduler")
    assert {path.parent for path in set(tmp_path.rglob("*")) - set(before) - {inside / "out"}} == {inside / "out"}
    (file,) = (inside / "out").glob("*.parquet")
    assert Trajectory.load(file).name_of("scenario") == name

    out = output_of(*arguments)
    assert not {"\x1b", "\u202e", "\x07"} & set(out)
    assert name[:6] in out or not name.isprintable() or name == " "


def test_pages_show_a_name_whole_and_its_controls_as_escapes(tmp_path):
    names = list(NASTY.values())
    runs = [Run(drive(n=40, scenario=names[i % 3]), label=name) for i, name in enumerate(names)]
    page = write_drive_page(tmp_path, runs, title="\ud800 [/red] $\0", command="drive '\ud800'")
    assert "<script>alert" not in page.read_text(encoding="utf-8")
    text = Outline(page.read_text(encoding="utf-8")).text
    escaped = (
        r"\ud800 [/red] $\x00", "[/red] [bold]x", r"$\frac{$ \$ $$", "名前 é 🚗", r"\x1b[31mred\x07", r"\u202eabc",
    )  # fmt: skip
    assert [name for name in escaped if name not in text] == []
    assert len(list(tmp_path.glob("*-tracking.png"))) == 3


def test_scenarios_of_one_name_get_a_file_each(output_of, tmp_path):
    output_of("drive", "sine", "sine", "-o", "duration=0.5", "--out", tmp_path)
    assert {path.name for path in tmp_path.glob("*.parquet")} == {"sine-informed.parquet", "sine-informed-2.parquet"}


@pytest.mark.parametrize("name", [r"a\u0000b", r"\u0000"])
def test_a_name_that_is_no_text_is_refused_with_file_and_key(run_command, tmp_path, name):
    load_scenario("sine", duration=0.5).to_toml(tmp_path / "scenario.toml")
    text = (tmp_path / "scenario.toml").read_text()
    (tmp_path / "scenario.toml").write_text(text.replace('name = "sine"', f'name = "{name}"'))
    code, _, err = run_command("drive", tmp_path / "scenario.toml")
    assert code == 2
    assert "scenario.toml: name = " in err
    assert os.listdir(tmp_path) == ["scenario.toml"]
