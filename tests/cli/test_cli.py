"""The command line: what it prints, where, and how it fails."""

import html
import importlib
import json
import re
from dataclasses import replace

import pytest
import typer

from adaptrack.base.errors import AdaptrackError, StorageError
from adaptrack.cli import options
from adaptrack.cli.app import app
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant, list_schedulers
from small_chain import write
from small_data import small, small_campaign

pytestmark = pytest.mark.compiled


@pytest.fixture
def places(tmp_path):
    """Files that commands are given: a campaign, schedules, a damaged one, a file where a folder should be."""
    mine, damaged, vans = (tmp_path / f"{name}.json" for name in ("mine", "damaged", "vans"))
    Constant(Tuning(38, 4, 1.0, 8000.0), name="mine").save(mine)
    damaged.write_text(mine.read_text().replace("8000", "80"))
    replace(Constant(Tuning()), made_for={"car": "van"}).save(vans)
    (tmp_path / "file").write_text("")
    return {
        "pond": write(tmp_path), "mine": mine, "damaged": damaged, "vans": vans, "out": tmp_path / "out",
        "file": tmp_path / "file" / "result",
    }  # fmt: skip


@pytest.mark.parametrize(("command", "words"), [
    ("drive triple-lane-chnage", ["triple-lane-change"]),
    ("drive step --vehicle papr", ["Did you mean 'paper'"]),
    ("drive step --tyre magic", ["no tyre is named 'magic'", "'magic-formula'"]),
    ("drive mountain --png", ["--png", "--out"]),
    ("drive step --np 5 --nc 8", ["Nc = 8", "Np = 5"]),
    ("drive step --r 0", ["R = 0.0", "positive"]),
    ("drive step --solver hildret", ["hildreth"]),
    ("drive step --laguerre-pole 1.5 --moves laguerre", ["pole"]),
    ("drive step -o amplitud=3", ["amplitude"]),
    ("drive step -o amplitude", ["KEY=VALUE"]),
    ("drive step -o friction=80", ["friction"]),
    ("drive step -o speed=1e15", ["at most 100 m/s"]),
    ("drive no-such-file.toml", ["no-such-file.toml"]),
    ("drive step --controller as-relased", ["Did you mean 'as-released'"]),
    ("drive step --scheduler no-such.json", ["no-such.json"]),
    ("drive step --period nan", ["period = nan s", "must be a finite number > 0"]),
    ("drive step --period 1e-9", ["2,000,000 are possible"]),
    ("drive step --np 1000000000", ["Np = 1000000000", "at most 1,000"]),
    ("tune van", ["--out"]),
    ("paper campaign paper-gird", ["paper-grid"]),
    ("paper train --model nn --out nn.json", ["--data"]),
    ("paper train --data nowhere.parquet --model nn --out {out}/nn.json", ["nowhere.parquet"]),
    ("paper train --data paper-grid --model forest --out nn.json", ["forest"]),
    ("paper train --data paper-grid --model nn --targets both --out nn.json", ["both"]),
    ("paper train --data paper-grid --model nn --out nn.txt", [".json"]),
    ("paper reproduce --data road-sobol --out {out}", ["do not fill a grid"]),
    ("paper adapt road-sobl --out {out}", ["no campaign is named 'road-sobl'", "Did you mean 'road-sobol'"]),
    ("paper adapt nowhere.toml --out {out}", ["nowhere.toml", "cannot be read"]),
    ("paper adapt paper-grid --out {out}", ["paper-grid", "Sobol"]),
    ("paper adapt --out nowhere --workers 100000", ["--workers = 100000", "at most 1,024"]),
    ("paper evaluate {out}", ["fallback.json", "cannot be read"]),
    ("paper evaluate --scheduler road-n", ["no scheduler is named 'road-n'", "Did you mean"]),
    ("paper evaluate --scheduler {damaged}", ["damaged.json", "checksum"]),
    ("paper evaluate --scheduler {vans}", ["'vans'", "car 'van', not 'paper'", "adaptrack paper adapt"]),
    ("paper evaluate --scheduler {mine} --scheduler {mine}", ["with this name exists already", "rename"]),
    ("paper evaluate --operating-points 0", ["--operating-points = 0", "at least 1"]),
    ("paper evaluate --drives many", ["--drives", "integer"]),
    ("paper evaluate --seed 1000000000000000000000000000000", ["--seed", "at most 10,000"]),
    ("paper evaluate --perception nosy", ["'nosy'", "noisy", "withheld"]),
    ("certify --controller informd", ["'informd'", "Did you mean 'informed'"]),
    ("certify {mine} --feasible", ["--feasible", "leave out the schedule"]),
    ("certify --feasible --out {out}", ["--feasible", "--out"]),
    ("certify --feasible --speed 9 5", ["speed = (9.0, 5.0)", "low <= high"]),
    ("certify {mine} --profile raod", ["raod"]),
    ("list --jason", ["--jason"]),
])  # fmt: skip
def test_a_wrong_argument_gives_one_clear_message_and_exit_code_2(run_command, places, command, words):
    code, out, err = run_command(*(word.format(**places) for word in command.split()))
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    assert all(word in err for word in words), err


def test_every_error_of_the_package_becomes_one_message(monkeypatch, run_command):
    def fail(*arguments, **settings):
        raise AdaptrackError("no way")

    monkeypatch.setattr("adaptrack.paper.campaign_config.load_campaign", fail)
    assert run_command("paper", "evaluate") == (2, "", "adaptrack: no way\n")


@pytest.mark.parametrize(("command", "work"), [
    ("identify log.csv --out {file}.toml", "adaptrack.identify"),
    ("identify log.csv --page {file}.html", "adaptrack.identify"),
    ("tune paper --road town --out {file}", "adaptrack.comparison.tune_on_roads.tune_on_roads"),
    ("compare town --out {file}", "adaptrack.comparison.run.run_comparison"),
    ("road plot town --out {file}.png", "adaptrack.load_road"),
    ("drive town --length 200 --learned {file}.toml", "adaptrack.load_road"),
    ("drive step --learned {file}.toml", "adaptrack.simulate"),
    ("drive step --out {file}", "adaptrack.simulate"),
    ("certify {mine} --out {file}", "adaptrack.analysis.certify.certify"),
    ("paper train --data paper-grid --model nn --out {file}.json", "adaptrack.paper.training.train"),
    ("paper reproduce --out {file}", "adaptrack.paper.reproduce.reproduce"),
    ("paper adapt {pond} --out {file}", "adaptrack.paper.adaptation.operating_point_runs"),
    ("paper evaluate --out {file}", "adaptrack.paper.evaluation.operating_point_runs"),
])  # fmt: skip
def test_a_place_where_no_result_can_be_written_is_found_before_any_work(
    monkeypatch, run_command, places, command, work
):
    module, _, name = work.rpartition(".")
    monkeypatch.setattr(
        importlib.import_module(module), name, lambda *arguments, **settings: pytest.fail("it works already")
    )
    code, out, err = run_command(*command.format(**places).split())
    assert (code, out) == (2, "")
    assert f"{places['file'].parent}" in err
    assert "cannot be written to: " in err


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


def test_train_saves_a_scheduler_that_simulate_drives_with(run_command, tmp_path, data):
    out = tmp_path / "new" / "fuzzy.json"
    code, printed, err = run_command("paper", "train", "--data", data, "--model", "anfis", "--out", out, "--json")
    assert code == 0, err
    result = json.loads(printed)
    assert (result["scheduler"], result["model"], result["targets"]) == (str(out), "anfis", "paper")
    assert [row["slot"] for row in result["rows"]] == ["Np", "Nc", "Q", "R"]
    assert all(row.keys() >= {"r2", "rmse", "ceiling_r2", "ceiling_rmse", "seconds"} for row in result["rows"])

    code, printed, err = run_command(
        "drive", "sine", "-o", "duration=1.0", "--scheduler", out, "--out", tmp_path, "--json"
    )
    assert code == 0, err
    assert [(row["controller"], row["scheduler"]) for row in json.loads(printed)["rows"]] == [("fuzzy", "fuzzy")]
    assert (tmp_path / "sine-fuzzy.parquet").exists()


def test_reproduce_writes_the_page_and_prints_its_rows(run_command, monkeypatch, tmp_path, data):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
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


def test_a_campaign_is_run_described_and_written_on_a_page(run_command, monkeypatch, tmp_path):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    file, out = tmp_path / "small.toml", tmp_path / "out"
    small_campaign().to_toml(file)
    arguments = ("paper", "campaign", file, "--out", out, "--workers", "1", "--json")
    code, printed, err = run_command(*arguments)
    assert code == 0, err
    assert [json.loads(printed)[key] for key in ("name", "operating_points", "computed")] == ["small", 12, 8]
    assert (out / "index.html").exists()
    code, again, _ = run_command("paper", "campaign", out, "--json")
    assert (code, json.loads(again)) == (0, json.loads(printed))


def test_lists_name_everything_that_can_be_asked_for(run_command):
    _, out, _ = run_command("list", "--json")
    names = {row["kind"]: row["names"].split(", ") for row in json.loads(out)["rows"]}
    assert {"triple-lane-change", "random-drive"} <= set(names["scenarios"])
    assert {"paper", "midsize-sedan"} <= set(names["cars"])
    assert {"quick", "standard", "full"} <= set(names["comparisons"])
    assert set(names["schedules"]) == set(list_schedulers())
    for kind in names:
        _, out, _ = run_command("list", kind, "--json")
        assert ", ".join(row["name"] for row in json.loads(out)["rows"]) == ", ".join(names[kind])


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


@pytest.mark.parametrize(("words", "message"), [
    (("car", "--mass", "3", "--wheelbase", "2.7"), "adaptrack: --mass = 3.0 kg: must be a finite number"),
    (("car", "--mass", "1500", "--wheelbase", "0.3"), "adaptrack: --wheelbase = 0.3 m: must be a finite number"),
    (("car", "--mass", "700", "--wheelbase", "2.7", "--load", "900"), "adaptrack: --load = 900 kg: must not be"),
    (("drive", "lap", "--lateral-acceleration", "-2"), "adaptrack: "),
    (("drive", "town", "--length", "3"), "adaptrack: --length = 3.0 m: must be"),
    (("drive", "town", "--road-seed", "-3"), "adaptrack: "),
])  # fmt: skip
def test_a_message_names_options_and_no_python_function(run_command, words, message):
    import adaptrack

    code, _, err = run_command(*words)
    assert code == 2
    assert err.startswith(message), err
    assert err.split(": ")[1] not in dir(adaptrack)
