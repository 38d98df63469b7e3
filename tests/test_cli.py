"""The command line: what it prints, where, and how it fails."""

import importlib
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

from adaptrack import cli
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.cli import options
from adaptrack.cli.app import app
from adaptrack.control.scheduling import list_schedulers
from adaptrack.drive.failure import Reason
from small_data import small, small_campaign

ROW_KEYS = {
    "scenario", "controller", "plant", "tyre", "profile", "preview", "seed", "mse", "max_abs_error",
    "qp_capped", "qp_failed", "step_us_p50", "step_us_p99", "vehicle", "failed", "failed_at", "failed_because",
}  # fmt: skip
pytestmark = pytest.mark.compiled


def run(monkeypatch, capsys, *arguments):
    """(exit code, standard output, standard error) of one command."""
    monkeypatch.setattr(sys, "argv", ["adaptrack", *map(str, arguments)])
    code = cli.main()
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_json_is_one_object_with_a_row_per_controller_and_scenario(monkeypatch, capsys):
    code, out, _ = run(
        monkeypatch, capsys, "simulate", "step", "sine", "--controller", "as-written", "--controller", "as-released",
        "-o", "duration=2.0", "--json",
    )  # fmt: skip
    rows = json.loads(out)["rows"]
    assert code == 0
    assert [(row["scenario"], row["controller"]) for row in rows] == [
        ("step", "as-written"), ("step", "as-released"), ("sine", "as-written"), ("sine", "as-released"),
    ]  # fmt: skip
    assert all(row.keys() >= ROW_KEYS for row in rows)


def test_the_profile_decides_period_and_preview_unless_told_otherwise(monkeypatch, capsys):
    for arguments, period, preview in (
        (["--profile", "paper"], 0.1, False),
        (["--profile", "road"], 0.05, True),
        (["--profile", "road", "--no-preview", "--period", "0.1"], 0.1, False),
    ):
        _, out, _ = run(monkeypatch, capsys, "simulate", "sine", "-o", "duration=1.0", "--json", *arguments)
        (row,) = json.loads(out)["rows"]
        assert (row["period"], row["preview"]) == (period, preview)


@pytest.mark.drawn
def test_out_holds_the_page_and_the_trajectories_and_where_asked_the_pictures(monkeypatch, capsys, tmp_path):
    out = tmp_path / "a" / "b"
    asked = ["simulate", "sine", "-o", "duration=2.0", "--out", out]
    assert run(monkeypatch, capsys, *asked)[0] == 0
    assert {path.name for path in out.iterdir()} == {"index.html", "sine-informed.parquet"}
    assert run(monkeypatch, capsys, *asked, "--png")[0] == 0
    linked = re.findall(r'<a href="([^"#]+)"', (out / "index.html").read_text(encoding="utf-8"))
    assert sorted(linked) == ["sine-conditions.png", "sine-tracking.png", "speed.png"]
    assert sorted(path.name for path in out.glob("*.png")) == sorted(linked)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulate", "triple-lane-chnage"], ["triple-lane-change"]),
        (["simulate", "step", "--vehicle", "papr"], ["paper"]),
        (["simulate", "step", "--tyre", "magic"], ["magic-formula"]),
        (["simulate", "step", "--png"], ["--png", "--out"]),
        (["drive", "mountain", "--png"], ["--png", "--out"]),
        (["simulate", "step", "--np", "5", "--nc", "8"], ["Nc = 8", "Np = 5"]),
        (["simulate", "step", "--r", "0"], ["R = 0.0", "positive"]),
        (["simulate", "step", "--solver", "hildret"], ["hildreth"]),
        (["simulate", "step", "--laguerre-pole", "1.5", "--moves", "laguerre"], ["pole"]),
        (["simulate", "step", "-o", "amplitud=3"], ["amplitude"]),
        (["simulate", "step", "-o", "amplitude"], ["KEY=VALUE"]),
        (["simulate", "step", "-o", "friction=80"], ["friction"]),
        (["simulate", "no-such-file.toml"], ["no-such-file.toml"]),
        (["simulate", "step", "--controller", "as-relased"], ["Did you mean 'as-released'"]),
        (["simulate", "step", "--period", "0"], ["period = 0.0 s", "must be a finite number > 0"]),
        (["simulate", "step", "--period", "-0.1"], ["period = -0.1 s", "must be a finite number > 0"]),
        (["simulate", "step", "--period", "nan"], ["period = nan s", "must be a finite number > 0"]),
        (["simulate", "step", "--period", "1e-9"], ["2,000,000 are possible"]),
        (["simulate", "step", "--np", "1000000000"], ["Np = 1000000000", "at most 1,000"]),
        (["simulate", "step", "-o", "speed=1e15"], ["at most 100 m/s"]),
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
    code, _, err = run(monkeypatch, capsys, "simulate", "step", "--out", tmp_path / "file" / "folder")
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
        ("simulate step --learned {file}.toml", "adaptrack.drive.simulate.simulate"),
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


# -- runs that failed -------------------------------------------------------------------------------------------------
FAILING = ["simulate", "step", "-o", "friction=0.1", "-o", "speed=30", "-o", "wind=60", "-o", "duration=8"]


def test_a_run_that_failed_is_loud_and_says_when_and_why(monkeypatch, capsys):
    code, out, err = run(monkeypatch, capsys, *FAILING, "--json")
    (row,) = json.loads(out)["rows"]
    assert code == 3
    assert row["failed"] in list(Reason)
    assert 0.0 <= row["failed_at"] <= 8.0
    sentence = f"FAILED step, informed: at {row['failed_at']:.2f} s the vehicle {row['failed_because']}."
    assert sentence in err
    code, out, _ = run(monkeypatch, capsys, *FAILING)
    assert code == 3
    assert sentence in out
    assert "\x1b" not in out


def test_one_failed_run_of_several_gives_exit_code_3_and_rows_for_all(monkeypatch, capsys):
    code, out, err = run(monkeypatch, capsys, *FAILING, "--controller", "standard", "--controller", "lqr", "--json")
    rows = json.loads(out)["rows"]
    assert code == 3
    assert [row["controller"] for row in rows] == ["standard", "lqr"]
    assert all(row.keys() >= ROW_KEYS for row in rows)
    assert err.count("FAILED ") == sum(row["failed"] is not None for row in rows)


def test_a_failed_run_may_be_allowed(monkeypatch, capsys):
    code, out, err = run(monkeypatch, capsys, *FAILING, "--json", "--allow-failed")
    assert code == 0
    assert json.loads(out)["rows"][0]["failed"]
    assert "FAILED" in err


OFF_ROAD = ["simulate", "general-trajectory", "--profile", "road", "-o", "duration=15"]


def test_a_run_off_the_road_gives_exit_code_3_and_a_page_whose_heading_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    code, out, _ = run(monkeypatch, capsys, *OFF_ROAD, "--controller", "standard", "--out", tmp_path, "--json")
    (row,) = json.loads(out)["rows"]
    assert (code, row["failed"]) == (3, "off-road")
    heading = f"Failed at {row['failed_at']:.1f} s: the vehicle left the road"
    page = (tmp_path / "index.html").read_text()
    assert re.search(rf"<title>{heading}[^<]* · General trajectory, standard</title>", page)
    assert re.search(rf"<h1><strong class=\"failed\">{heading}[^<]*</strong> <span>General trajectory, standard<", page)
    assert (tmp_path / "general-trajectory-standard.parquet").exists()
    assert run(monkeypatch, capsys, *OFF_ROAD, "--controller", "standard", "--allow-failed")[0] == 0


def test_a_failed_car_whose_model_and_tyre_disagree_is_told_the_remedy(monkeypatch, capsys, tmp_path):
    numbers = {"mass": 1500.0, "yaw_inertia": 2500.0, "lf": 1.1, "lr": 1.6, "stiffness_front": 15000.0,
               "stiffness_rear": 60000.0}  # fmt: skip
    (tmp_path / "soft.toml").write_text("".join(f"{name} = {value}\n" for name, value in numbers.items()))
    asked = ["simulate", "double-lane-change", "-o", "speed=27", "--profile", "road", "--vehicle"]
    code, out, _ = run(monkeypatch, capsys, *asked, tmp_path / "soft.toml")
    assert code == 3
    assert re.search(r"believes 15000 and 60000 N/rad.* has 79\d+ and 59\d+\..*stiffness_front.*matched_to", out)
    code, out, _ = run(monkeypatch, capsys, *FAILING)  # whose tyre is the model's
    assert code == 3
    assert "matched_to" not in out


def test_an_informed_run_says_what_it_believes_of_the_steering_and_who_says_so(monkeypatch, capsys):
    asked = ["simulate", "sine", "-o", "duration=1.0", "--profile", "road"]
    code, out, _ = run(monkeypatch, capsys, *asked, "--vehicle", "midsize-sedan")
    assert code == 0
    assert "lag 0.15 s, dead time 0 s, computation 0.05 s (profile road)" in out
    assert "rate 0.4 rad/s, limit 1.066 rad (car file midsize-sedan)" in out
    assert "The simulated steering is another" in out
    _, out, _ = run(monkeypatch, capsys, *asked, "--json", "--controller", "informed", "--controller", "standard")
    beliefs = [row["belief"] for row in json.loads(out)["rows"]]
    assert "profile road" in beliefs[0]
    assert beliefs[1] is None


def test_a_run_that_was_driven_to_its_end_has_no_failure(monkeypatch, capsys):
    code, out, _ = run(monkeypatch, capsys, "simulate", "sine", "-o", "duration=1.0", "--json")
    (row,) = json.loads(out)["rows"]
    assert code == 0
    assert (row["failed"], row["failed_at"], row["failed_because"]) == (None, None, None)
    assert not row.keys() & {"lost", "lost_at", "lost_because"}


def test_tables_call_a_scheduler_as_the_command_line_does(monkeypatch, capsys, tmp_path):
    from adaptrack.control.controllers import Tuning
    from adaptrack.control.scheduling import Constant

    Constant(Tuning(30, 5, 1.0, 4000.0), name="nn").save(tmp_path / "mine.json")
    for given, label in (("road-nn", "road-nn"), (tmp_path / "mine.json", "mine")):
        _, out, err = run(
            monkeypatch, capsys, "simulate", "sine", "-o", "duration=1.0", "--scheduler", given, "--json",
            "--controller", "standard", "--controller", "as-written",
        )  # fmt: skip
        rows = json.loads(out)["rows"]
        assert [row["controller"] for row in rows] == [label, f"{label}-as-written"], err
        assert {row["scheduler"] for row in rows} == {label}


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
        monkeypatch, capsys, "simulate", "sine", "-o", "duration=2.0", "--scheduler", out, "--out", tmp_path, "--json"
    )
    assert code == 0, err
    assert [(row["controller"], row["scheduler"]) for row in json.loads(printed)["rows"]] == [("fuzzy", "fuzzy")]
    assert (tmp_path / "sine-fuzzy.parquet").exists()


def test_train_learns_with_the_seed_that_is_given(monkeypatch, capsys, tmp_path, data):
    def learn(dataset, model, targets, *, seed=0, progress=None):
        raise InvalidInput(f"seed {seed}")

    monkeypatch.setattr("adaptrack.paper.training.train", learn)
    asked = ["paper", "train", "--data", data, "--model", "nn", "--out", tmp_path / "nn.json", "--seed", "7"]
    assert run(monkeypatch, capsys, *asked) == (2, "", "adaptrack: seed 7\n")


def test_train_prints_the_quality_on_the_hold_out(monkeypatch, capsys, tmp_path, data):
    arguments = [
        "paper",
        "train",
        "--data",
        data,
        "--model",
        "anfis",
        "--targets",
        "ratio",
        "--out",
        tmp_path / "fuzzy.json",
    ]
    code, out, _ = run(monkeypatch, capsys, *arguments)
    assert code == 0
    assert all(word in out for word in ("held out", "log10_ratio", "of trees", "fuzzy.json"))


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
        (["simulate", "step", "--scheduler", "no-such.json"], ["no-such.json"]),
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


def test_a_users_scenario_and_vehicle_files_are_driven(monkeypatch, capsys, tmp_path):
    from adaptrack import load_scenario, load_vehicle

    load_scenario("sine", duration=2.0).to_toml(tmp_path / "mine.toml")
    load_vehicle("midsize-sedan").to_toml(tmp_path / "car.toml")
    assert tomllib.loads((tmp_path / "car.toml").read_text())["name"] == "car"
    code, out, err = run(
        monkeypatch, capsys, "simulate", tmp_path / "mine.toml", "--vehicle", tmp_path / "car.toml", "--json"
    )
    assert code == 0, err
    assert json.loads(out)["rows"][0]["vehicle"] == "car"


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
