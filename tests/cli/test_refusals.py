"""Commands that are refused: one message on standard error, exit code 2, and nothing written."""

import importlib
from dataclasses import replace

import pytest

import adaptrack as at
from adaptrack.control.scheduling import Constant
from small_chain import write

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Files that commands are given: a campaign, schedules, a damaged one, a road, a file where a folder should be."""
    folder = tmp_path_factory.mktemp("places")
    mine, damaged, vans, points = (folder / name for name in ("mine.json", "damaged.json", "vans.json", "points.csv"))
    Constant(at.Tuning(38, 4, 1.0, 8000.0), name="mine").save(mine)
    damaged.write_text(mine.read_text().replace("8000", "80"))
    replace(Constant(at.Tuning()), made_for={"car": "van"}).save(vans)
    points.write_text("x,y\n" + "".join(f"{5 * k},0\n" for k in range(20)))
    learned = dict.fromkeys(("lag_sigma", "dead_time_sigma", "delay_sigma", "stiffness_sigma"), 0.05)
    at.LearnedCar(car="van", lag=0.1, dead_time=0.0, stiffness=1.0, **learned).to_toml(folder / "learned.toml")
    (folder / "file").write_text("")
    return {
        "pond": write(folder), "mine": mine, "damaged": damaged, "vans": vans, "points": points,
        "learned": folder / "learned.toml", "out": folder / "out", "file": folder / "file" / "result",
    }  # fmt: skip


SPEED = "drive country --road-seed 1 --length 300 --vehicle midsize-sedan --speed-control"


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
    ("drive step --planner delay=0.1", ["--planner", "name a road"]),
    ("drive country --planner dely=0.1", ["'dely'", "period, delay, jitter, start"]),
    ("drive country --planner period=x", ["adaptrack: planner 'period=x': period = 'x': must be a finite number"]),
    ("compare town:1 --planner period=x", ["adaptrack: planner 'period=x': period = 'x': must be a finite number"]),
    ("drive country --planner=", ["--planner '': has no settings"]),
    ("compare town:1 --planner=", ["--planner '': has no settings"]),
    ("export page --planner= --out page.html", ["--planner '': has no settings"]),
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
    # the car
    ("car", ["name a car, or give --mass and --wheelbase, or --tir"]),
    ("car vann", ["no vehicle is named 'vann'. Did you mean 'van'?"]),
    ("car --mass 1500", ["--wheelbase is missing"]),
    ("car --lf 1.1", ["needs --mass and --wheelbase"]),
    ("car van --mass 1500", ["van is an existing car"]),
    ("car van --out car.json", ["--out car.json: give a file name that ends in .toml, such as car.toml"]),
    ("car --mass 3 --wheelbase 0.3", ["mass = 3.0 kg: must be a finite number >= 600 and <= 3500"]),
    ("car --mass 3 --wheelbase 2.7", ["adaptrack: --mass = 3.0 kg: must be a finite number"]),
    ("car --mass 1500 --wheelbase 0.3", ["adaptrack: --wheelbase = 0.3 m: must be a finite number"]),
    ("car --mass 700 --wheelbase 2.7 --load 900", ["adaptrack: --load = 900 kg: must not be"]),
    ("car van --tir none.tir", ["none.tir"]),
    ("car van --tir a.tir --tyre-table b.csv", ["give only one of them"]),
    ("car --tyre-table b.csv", ["name a car"]),
    ("car van --drive rear", ["van is an existing car"]),
    ("car --drive rear", ["a new car needs --mass and --wheelbase"]),
    # roads
    ("road check contry", ["Did you mean 'country'"]),
    ("road check country --speed 5 --lateral-acceleration 3", ["give only one of them"]),
    ("road check country --speed 5 --speed-column v", ["--speed and --speed-column: give only one"]),
    ("road plot country --vehicle papr", ["paper"]),
    ("road plot country --out road", ["--out road: give a file name that ends in .png, such as road.png"]),
    ("drive lap --lateral-acceleration -2", ["adaptrack: "]),
    ("drive town --length 3", ["adaptrack: --length = 3.0 m: must be"]),
    ("drive town --road-seed -3", ["adaptrack: "]),
    ("drive sine town", ["give several scenarios or one road"]),
    ("drive sine --speed 12", ["sine is a scenario: --speed is an option of roads"]),
    ("drive sine --laps 2", ["sine is a scenario: --laps is an option of roads"]),
    ("drive town -o speed=12", ["town is a road: --option is an option of scenarios"]),
    ("drive {points} --laps 2", ["--closed"]),
    ("drive town --vehicle midsize-sedan --learned {learned}", ["set car = '' (in its file"]),
    (f"{SPEED} --stop 300", ["--stop 300: write S:SECONDS"]),
    (f"{SPEED} --stop 300 5", ["write one word with a colon, --stop 300:5."]),
    (f"{SPEED} --assumed-friction 0.65 0.9", ["write one word with a colon, --assumed-friction 0.65:0.9."]),
    (f"{SPEED} --assumed-friction=0.65 0.9 --start 0", ["write one word with a colon, --assumed-friction 0.65:0.9."]),
    ("road check country --assumed-friction 0.65 0.9", ["write one word with a colon"]),
    ("export c --out c --speed-control --assumed-friction 0.65 0.9", ["write one word with a colon"]),
    # files
    ("export page --out page", ["--out page: give a file name that ends in .html, such as page.html"]),
    ("identify log.csv --page log.htm", ["--page log.htm: give a file name that ends in .html, such as log.html"]),
    ("identify log.csv --out car", ["--out car: give a file name that ends in .toml, such as car.toml"]),
    (f"{SPEED} --stop here:5", ["--stop here:5: write S:SECONDS"]),
    (f"{SPEED} --stop 9000:5", ["must lie on the road"]),
    (f"{SPEED} --stop 100:-1", ["for a time >= 0 s"]),
    (f"{SPEED} --stop 100:1 --speed 10", ["leave out --speed"]),
    (f"{SPEED} --start 0 --speed 10", ["leave out --speed"]),
    # tuning and comparison
    ("tune town --out {out}", ["tune CAR --road town"]),
    ("tune papre --out {out}", ["Did you mean 'paper'"]),
    ("tune paper --controller lqr --out {out}", ["--controller does not apply: name roads"]),
    ("tune paper --road town --speed 5..9 --out {out}", ["--speed does not apply"]),
    ("tune paper --speed 5 --out {out}", ["must be LOW..HIGH"]),
    ("tune paper --road town --controller nn --out {out}", ["tunable controllers: as-"]),
    ("tune paper --road town --runs 19 --out {out}", ["give at least 20"]),
    ("compare town --controller stanly", ["Did you mean 'stanley'"]),
    ("compare country:101", ["is a test road as well"]),
    ("compare --config standart", ["Did you mean 'standard'"]),
    ("compare town --lane-change iso3888-1", ["ROAD has no effect"]),
    ("compare --lane-change iso3888-1 --budget 50", ["--budget 0: do not tune"]),
    ("compare town --controller nn --vehicle van", ["was made for the car 'paper'"]),
])  # fmt: skip
def test_a_wrong_argument_gives_one_clear_message_without_a_name_of_python_and_exit_code_2(
    run_command, places, tmp_path, monkeypatch, command, words
):
    monkeypatch.chdir(tmp_path)
    code, out, err = run_command(*(word.format(**places) for word in command.split()))
    assert (code, out) == (2, "")
    assert "Traceback" not in err
    assert all(word in err for word in words), err
    subject = err.split(": ")[1]
    assert subject == command.split()[0] or subject not in at.__all__, err
    assert not list(tmp_path.iterdir())


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
