"""The command line: what it prints, where, and how it fails."""

import html
import json
import re

import pytest
import typer

from adaptrack.base.errors import AdaptrackError, StorageError
from adaptrack.cli import options
from adaptrack.cli.app import app
from adaptrack.control.scheduling import list_schedulers
from small_data import small, small_campaign

pytestmark = pytest.mark.compiled


def test_every_error_of_the_package_becomes_one_message(monkeypatch, run_command):
    def fail(*arguments, **settings):
        raise AdaptrackError("no way")

    monkeypatch.setattr("adaptrack.paper.campaign_config.load_campaign", fail)
    assert run_command("paper", "evaluate") == (2, "", "adaptrack: no way\n")


def test_a_folder_for_a_result_is_made_and_a_folder_in_its_place_is_refused(tmp_path):
    options.make_place(tmp_path / "new" / "folder" / "page.html")
    assert (tmp_path / "new" / "folder").is_dir()
    assert not list((tmp_path / "new" / "folder").iterdir())
    with pytest.raises(StorageError, match="folder: cannot be written: it is a folder; give a file name"):
        options.make_place(tmp_path / "new" / "folder")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """The file of a small data set."""
    path = tmp_path_factory.mktemp("data") / "small.parquet"
    small().save(path)
    return path


def test_train_saves_a_scheduler_that_simulate_drives_with(answer_of, tmp_path, data):
    out = tmp_path / "new" / "fuzzy.json"
    result = answer_of("paper", "train", "--data", data, "--model", "anfis", "--out", out)
    assert (result["scheduler"], result["model"], result["targets"]) == (str(out), "anfis", "paper")
    assert [row["slot"] for row in result["rows"]] == ["Np", "Nc", "Q", "R"]
    assert all(row.keys() >= {"r2", "rmse", "ceiling_r2", "ceiling_rmse", "seconds"} for row in result["rows"])

    rows = answer_of("drive", "sine", "-o", "duration=1.0", "--scheduler", out, "--out", tmp_path)["rows"]
    assert [(row["controller"], row["scheduler"]) for row in rows] == [("fuzzy", "fuzzy")]
    assert (tmp_path / "sine-fuzzy.parquet").exists()


def test_reproduce_writes_the_page_and_prints_its_rows(run_command, tmp_path, data):
    code, out, err = run_command("paper", "reproduce", "--quick", "--data", data, "--out", tmp_path, "--json")
    result = json.loads(out)
    assert code == 0, err
    assert len(result["rows"]) == 48
    keys = {"configuration", "scenario", "controller", "preview", "mse", "paper_mse", "ratio", "max_abs_error",
            "steering_activity", "failed", "failed_at", "failed_reason", "clipped_share", "plant", "vehicle", "profile",
            "seed"}  # fmt: skip
    assert all(row.keys() >= keys for row in result["rows"])
    assert all((row["failed_at"] is not None, row["failed_reason"] != "") == (row["failed"],) * 2
               for row in result["rows"])  # fmt: skip
    assert result["quick"]
    text = html.unescape((tmp_path / "index.html").read_text())
    assert all(f"Figure {number} of the paper's section V." in text for number in range(6, 11))
    assert "index.html" in err


def test_a_campaign_is_run_described_and_written_on_a_page(run_command, tmp_path):
    file, out = tmp_path / "small.toml", tmp_path / "out"
    small_campaign().to_toml(file)
    arguments = ("paper", "campaign", file, "--out", out, "--workers", "1", "--json")
    code, printed, err = run_command(*arguments)
    assert code == 0, err
    assert [json.loads(printed)[key] for key in ("name", "operating_points", "computed")] == ["small", 12, 8]
    assert (out / "index.html").exists()
    code, again, _ = run_command("paper", "campaign", out, "--json")
    assert (code, json.loads(again)) == (0, json.loads(printed))


def test_lists_name_everything_that_can_be_asked_for(answer_of):
    names = {row["kind"]: row["names"].split(", ") for row in answer_of("list")["rows"]}
    assert {"triple-lane-change", "random-drive"} <= set(names["scenarios"])
    assert {"paper", "midsize-sedan"} <= set(names["cars"])
    assert {"quick", "standard", "full"} <= set(names["comparisons"])
    assert set(names["schedules"]) == set(list_schedulers())
    for kind in names:
        assert ", ".join(row["name"] for row in answer_of("list", kind)["rows"]) == ", ".join(names[kind])


# -- help -------------------------------------------------------------------------------------------------------------
def every_command(group, *names):
    """The words that call each command, groups among them."""
    yield names
    for name, command in getattr(group, "commands", {}).items():
        yield from every_command(command, *names, name)


COMMANDS = list(every_command(typer.main.get_command(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_help_fits_80_columns_and_40_lines_and_names_every_option_or_else_help_all(run_command, words):
    command = typer.main.get_command(app)
    for word in words:
        command = command.commands[word]
    code, text, _ = run_command(*words, "--help")
    assert code == 0
    assert len(text.splitlines()) <= 40
    assert max(map(len, text.splitlines())) <= 80
    assert not hasattr(command, "commands") or "..." not in text.partition("Options:")[2]
    names = {name for parameter in command.params for name in parameter.opts if name.startswith("--")}
    if "--help-all" in names:
        _, text, _ = run_command(*words, "--help-all")
    assert names <= set(re.findall(r"--[a-z][a-z-]*", text))


def test_help_says_where_to_begin_lists_every_command_and_loads_no_numerics(run_command, run_python, project):
    _, text, _ = run_command("--help")
    assert "Begin with: adaptrack drive country --out drive" in text
    assert (project / "docs" / "guide.md").exists()
    assert set(re.findall(r"^  ([a-z][a-z-]*)  ", text, re.MULTILINE)) == set(typer.main.get_command(app).commands)
    code = (
        "import sys; from adaptrack import cli\n"
        f"for words in {COMMANDS}:\n"
        "    sys.argv = ['adaptrack', *words, '--help']\n"
        "    assert cli.main() == 0 and 'numpy' not in sys.modules, words\n"
    )
    assert "Usage: adaptrack" in run_python(code=code)
    assert run_python("-m", "adaptrack", "--version").startswith("adaptrack ")


@pytest.mark.parametrize("command", ["adapt", "evaluate", "reproduce"])
def test_help_says_that_failed_runs_are_counted_and_the_exit_code_is_0(run_command, command):
    text = " ".join(run_command("paper", command, "--help")[1].split())
    assert all(words in text for words in ("Failed runs", "they are counted", "the exit code is 0"))
