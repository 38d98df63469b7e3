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
from small_data import small

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
        (["evaluate-schedules", "--drives", "1000000000"], ["--drives = 1000000000", "at most 10,000"]),
        (["evaluate-schedules", "--drives", "-5"], ["--drives = -5", "at least 1"]),
        (["evaluate-schedules", "--conditions", "sobol:1000000000"], ["at most 100,000 operating points"]),
        (["evaluate-schedules", "--operating-points", "sobol:" + 5000 * "9"], ["at most 100,000 operating points"]),
        (["evaluate-schedules", "--seed", "10" + 30 * "0"], ["--seed", "at most 10,000"]),
        (["adaptation", "--out", "nowhere", "--workers", "100000"], ["--workers = 100000", "at most 1,024"]),
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
        ("tune town --length 200 --out {file}.toml", "adaptrack.road.load_road"),
        ("evaluate town --length 200 --out {file}", "adaptrack.road.load_road"),
        ("road plot town --out {file}.png", "adaptrack.road.load_road"),
        ("drive town --length 200 --learned {file}.toml", "adaptrack.road.load_road"),
        ("drive step --learned {file}.toml", "adaptrack.drive.simulate.simulate"),
        ("train --data paper-grid --model nn --out {file}.json", "adaptrack.learning.training.train"),
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
    code, printed, err = run(monkeypatch, capsys, "train", "--data", data, "--model", "anfis", "--out", out, "--json")
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
    code, out, err = run(monkeypatch, capsys, "reproduce", "--quick", "--data", data, "--out", tmp_path, "--json")
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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train", "--data", "paper-gird", "--model", "nn", "--out", "nn.json"], ["paper-grid"]),
        (["train", "--data", "paper-grid", "--model", "forest", "--out", "nn.json"], ["forest"]),
        (["train", "--data", "paper-grid", "--model", "nn", "--out", "nn.txt"], ["*.json"]),
        (["train", "--data", "paper-grid", "--model", "nn", "--out", "{file}/nn.json"], ["cannot be written"]),
        (["reproduce", "--out", "{file}/out"], ["cannot be written"]),
        (["reproduce", "--data", "paper-gird", "--out", "{folder}"], ["paper-grid"]),
        (["reproduce", "--data", "road-sobol", "--out", "{folder}"], ["do not fill a grid"]),
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
    _, out, _ = run(monkeypatch, capsys, "scenarios", "--json")
    assert {row["scenario"] for row in json.loads(out)["rows"]} == {
        "triple-lane-change", "general-trajectory", "step", "lane-change", "double-lane-change", "sine",
        "random-drive",
    }  # fmt: skip
    _, out, _ = run(monkeypatch, capsys, "vehicles", "--json")
    names = {row["name"] for row in json.loads(out)["rows"]}
    assert {"paper", "midsize-sedan", "magic-formula", "constant-stiffness", "passenger-car"} <= names


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
