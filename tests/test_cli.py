"""The command line: what it prints, where, and how it fails."""

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from adaptrack import cli
from adaptrack.base.errors import StorageError
from adaptrack.cli import options
from adaptrack.cli.app import app
from adaptrack.control.scheduling import list_schedulers
from small_data import small, small_campaign

pytestmark = pytest.mark.compiled


def run(monkeypatch, capsys, *arguments):
    """(exit code, standard output, standard error) of one command."""
    monkeypatch.setattr(sys, "argv", ["adaptrack", *map(str, arguments)])
    code = cli.main()
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["drive", "triple-lane-chnage"], ["triple-lane-change"]),
        (["drive", "step", "--vehicle", "papr"], ["paper"]),
        (["drive", "step", "--tyre", "magic"], ["magic-formula"]),
        (["drive", "step", "--png"], ["--png", "--out"]),
        (["drive", "mountain", "--png"], ["--png", "--out"]),
        (["drive", "step", "--np", "5", "--nc", "8"], ["Nc = 8", "Np = 5"]),
        (["drive", "step", "--r", "0"], ["R = 0.0", "positive"]),
        (["drive", "step", "--solver", "hildret"], ["hildreth"]),
        (["drive", "step", "--laguerre-pole", "1.5", "--moves", "laguerre"], ["pole"]),
        (["drive", "step", "-o", "amplitud=3"], ["amplitude"]),
        (["drive", "step", "-o", "amplitude"], ["KEY=VALUE"]),
        (["drive", "step", "-o", "friction=80"], ["friction"]),
        (["drive", "no-such-file.toml"], ["no-such-file.toml"]),
        (["drive", "step", "--controller", "as-relased"], ["Did you mean 'as-released'"]),
        (["drive", "step", "--period", "0"], ["period = 0.0 s", "must be a finite number > 0"]),
        (["drive", "step", "--period", "-0.1"], ["period = -0.1 s", "must be a finite number > 0"]),
        (["drive", "step", "--period", "nan"], ["period = nan s", "must be a finite number > 0"]),
        (["drive", "step", "--period", "1e-9"], ["2,000,000 are possible"]),
        (["drive", "step", "--np", "1000000000"], ["Np = 1000000000", "at most 1,000"]),
        (["drive", "step", "-o", "speed=1e15"], ["at most 100 m/s"]),
        (["paper", "evaluate", "--drives", "1000000000"], ["--drives = 1000000000", "at most 10,000"]),
        (["paper", "evaluate", "--drives", "-5"], ["--drives = -5", "at least 1"]),
        (["paper", "evaluate", "--operating-points", "1000000000"], ["at most 100,000"]),
        (["paper", "evaluate", "--seed", "10" + 30 * "0"], ["--seed", "at most 10,000"]),
        (["paper", "adapt", "--out", "nowhere", "--workers", "100000"], ["--workers = 100000", "at most 1,024"]),
    ],
)
def test_a_wrong_argument_gives_one_clear_message_and_exit_code_2(monkeypatch, capsys, arguments, words):
    code, out, err = run(monkeypatch, capsys, *arguments)
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert all(word in err for word in words)


def test_an_unwritable_folder_is_found_before_anything_is_driven(monkeypatch, capsys, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run(monkeypatch, capsys, "drive", "step", "--out", tmp_path / "file" / "folder")
    assert code == 2
    assert "cannot be written" in err


@pytest.mark.parametrize(
    ("command", "work"),
    [
        ("identify log.csv --out {file}.toml", "adaptrack.identification.identify"),
        ("identify log.csv --page {file}.html", "adaptrack.identification.identify"),
        ("tune paper --road town --out {file}", "adaptrack.comparison.tune_on_roads.tune_on_roads"),
        ("compare town --out {file}", "adaptrack.comparison.run.run_comparison"),
        ("road plot town --out {file}.png", "adaptrack.road.load_road"),
        ("drive town --length 200 --learned {file}.toml", "adaptrack.road.load_road"),
        ("drive step --learned {file}.toml", "adaptrack.drive.simulate.simulate"),
        ("paper train --data paper-grid --model nn --out {file}.json", "adaptrack.paper.training.train"),
    ],
)
def test_a_place_where_no_result_can_be_written_is_found_before_any_work(monkeypatch, capsys, tmp_path, command, work):
    module, _, name = work.rpartition(".")
    monkeypatch.setattr(importlib.import_module(module), name, lambda *given, **more: pytest.fail("it works already"))
    (tmp_path / "file").write_text("")
    code, out, err = run(monkeypatch, capsys, *command.format(file=tmp_path / "file" / "result").split())
    assert (code, out) == (2, "")
    assert f"{tmp_path / 'file'}" in err
    assert "cannot be written to: " in err


def test_a_folder_for_a_result_is_made_and_a_folder_in_its_place_is_refused(tmp_path):
    options.make_place(tmp_path / "new" / "folder" / "page.html")
    assert (tmp_path / "new" / "folder").is_dir()
    assert not list((tmp_path / "new" / "folder").iterdir())
    with pytest.raises(StorageError, match="folder: cannot be written to: is a folder; name a file"):
        options.make_place(tmp_path / "new" / "folder")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The file of a small data set."""
    path = tmp_path_factory.mktemp("data") / "small.parquet"
    small().save(path)
    return path


def test_train_saves_a_scheduler_that_simulate_drives_with(monkeypatch, capsys, tmp_path, data):
    out = tmp_path / "new" / "fuzzy.json"
    code, printed, err = run(
        monkeypatch, capsys, "paper", "train", "--data", data, "--model", "anfis", "--out", out, "--json"
    )
    assert code == 0, err
    told = json.loads(printed)
    assert (told["scheduler"], told["model"], told["targets"]) == (str(out), "anfis", "paper")
    assert [row["slot"] for row in told["rows"]] == ["Np", "Nc", "Q", "R"]
    assert all(row.keys() >= {"r2", "rmse", "ceiling_r2", "ceiling_rmse", "seconds"} for row in told["rows"])

    code, printed, err = run(
        monkeypatch, capsys, "drive", "sine", "-o", "duration=2.0", "--scheduler", out, "--out", tmp_path, "--json"
    )
    assert code == 0, err
    assert [(row["controller"], row["scheduler"]) for row in json.loads(printed)["rows"]] == [("fuzzy", "fuzzy")]
    assert (tmp_path / "sine-fuzzy.parquet").exists()


def test_reproduce_writes_the_page_and_prints_its_rows(monkeypatch, capsys, tmp_path, data):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    code, out, err = run(
        monkeypatch, capsys, "paper", "reproduce", "--quick", "--data", data, "--out", tmp_path, "--json"
    )
    told = json.loads(out)
    assert code == 0, err
    assert len(told["rows"]) == 48
    keys = {"configuration", "scenario", "controller", "preview", "mse", "paper_mse", "ratio", "max_abs_error",
            "steering_activity", "failed", "failed_at", "failed_reason", "clipped_share", "plant", "vehicle", "profile",
            "seed"}  # fmt: skip
    assert all(row.keys() >= keys for row in told["rows"])
    assert all((row["failed_at"] is not None, row["failed_reason"] != "") == (row["failed"],) * 2
               for row in told["rows"])  # fmt: skip
    assert told["quick"]
    assert (tmp_path / "index.html").exists()
    assert "index.html" in err


def test_a_campaign_is_run_described_and_written_on_a_page(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    file, out = tmp_path / "small.toml", tmp_path / "out"
    small_campaign().to_toml(file)
    arguments = ("paper", "campaign", file, "--out", out, "--workers", "1", "--json")
    code, printed, err = run(monkeypatch, capsys, *arguments)
    assert code == 0, err
    assert [json.loads(printed)[key] for key in ("name", "operating_points", "computed")] == ["small", 12, 8]
    assert (out / "index.html").exists()
    code, again, _ = run(monkeypatch, capsys, "paper", "campaign", out, "--json")
    assert (code, json.loads(again)) == (0, json.loads(printed))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["paper", "campaign", "paper-gird"], ["paper-grid"]),
        (["paper", "campaign", "paper-gird", "--out", "{folder}"], ["paper-grid"]),
        (["paper", "train", "--data", "paper-gird", "--model", "nn", "--out", "nn.json"], ["paper-grid"]),
        (["paper", "train", "--data", "paper-grid", "--model", "forest", "--out", "nn.json"], ["forest"]),
        (["paper", "train", "--data", "paper-grid", "--model", "nn", "--out", "nn.txt"], [".json"]),
        (["paper", "train", "--data", "paper-grid", "--model", "nn", "--out", "{file}/nn.json"], ["cannot be written"]),
        (["paper", "reproduce", "--out", "{file}/out"], ["cannot be written"]),
        (["paper", "reproduce", "--data", "paper-gird", "--out", "{folder}"], ["paper-grid"]),
        (["paper", "reproduce", "--data", "road-sobol", "--out", "{folder}"], ["do not fill a grid"]),
        (["drive", "step", "--scheduler", "no-such.json"], ["no-such.json"]),
    ],
)
def test_learning_says_what_is_wrong_before_it_begins(monkeypatch, capsys, tmp_path, arguments, words):
    (tmp_path / "file").write_text("")
    given = [argument.format(file=tmp_path / "file", folder=tmp_path / "folder") for argument in arguments]
    code, out, err = run(monkeypatch, capsys, *given)
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert all(word in err for word in words)


def test_lists_name_everything_that_can_be_asked_for(monkeypatch, capsys):
    _, out, _ = run(monkeypatch, capsys, "list", "--json")
    names = {row["kind"]: row["names"].split(", ") for row in json.loads(out)["rows"]}
    assert {"triple-lane-change", "random-drive"} <= set(names["scenarios"])
    assert {"paper", "midsize-sedan"} <= set(names["cars"])
    assert {"quick", "standard", "full"} <= set(names["comparisons"])
    assert set(names["schedules"]) == set(list_schedulers())
    for kind in names:
        _, out, _ = run(monkeypatch, capsys, "list", kind, "--json")
        assert ", ".join(row["name"] for row in json.loads(out)["rows"]) == ", ".join(names[kind])


def test_help_and_version_come_from_the_module_run_as_a_program():
    done = subprocess.run([sys.executable, "-m", "adaptrack", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("adaptrack ")


# -- help -------------------------------------------------------------------------------------------------------------
def every_command(group, *names):
    """The words that call each command, groups among them."""
    yield names
    for name, command in getattr(group, "commands", {}).items():
        yield from every_command(command, *names, name)


COMMANDS = list(every_command(typer.main.get_command(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_help_of_a_command_fits_a_terminal_of_80_columns_and_40_lines(monkeypatch, capsys, words):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(monkeypatch, capsys, *words, "--help")
    lines = out.splitlines()
    assert code == 0
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80


def test_the_first_screen_says_each_command_in_a_whole_sentence_and_where_to_begin(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = run(monkeypatch, capsys, "--help")
    assert "..." not in out.partition("Commands:")[2]
    assert "Begin with: adaptrack drive country --out drive" in out
    assert (Path(__file__).parents[1] / "docs" / "guide.md").exists()


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_option_is_in_the_help_or_in_the_help_of_all(monkeypatch, capsys, words):
    command = typer.main.get_command(app)
    for word in words:
        command = command.commands[word]
    spelt = {name for each in command.params for name in each.opts if name.startswith("--")}
    shown = "--help-all" if "--help-all" in spelt else "--help"
    code, out, _ = run(monkeypatch, capsys, *words, shown)
    assert code == 0
    assert spelt <= set(re.findall(r"--[a-z][a-z-]*", out))
