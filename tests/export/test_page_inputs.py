"""Files that a user drops on the page are read as Python reads them; what is wrong with them is said in sentences."""

import base64
import json
import math
import random
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack import cli
from adaptrack.core.kernel import row_of
from adaptrack.core.roads import path
from adaptrack.core.synthesis import car as cars
from adaptrack.export.page_inputs import SECTIONS, car_fields, page_car
from adaptrack.identification.reading import SIGNAL_COLUMNS, read_columns
from programs import run_program

HERE, PAGE = Path(__file__).parents[1] / "page", Path(at.__file__).parent / "export" / "page"
needs_node = pytest.mark.needs("node")
GIVEN = car_fields()


def ask(calls):
    """Answers of inputs.js to calls (function, arguments behind which `GIVEN` goes, further ones)."""
    asking = [{"call": call, "args": [*args, GIVEN, *further]} for call, args, further in calls]
    return ask_all(asking)


def ask_all(asking):
    text = run_program("node", HERE / "inputs.mjs", PAGE / "inputs.js", input=json.dumps(asking), timeout=60)
    return json.loads(text)


def points_of(text, **options):
    return ask([("readPoints", [text], [options])])[0]


# -- cars -------------------------------------------------------------------------------------------------------------
SPORTY = at.load_vehicle("van").replace(steering=at.Steering(lag=0.2, rate=0.6), known_within=None)
CARS = [*map(at.load_vehicle, at.list_vehicles()), at.vehicle_from_data_sheet("own", 1500.0, 2.7, load=75.0), SPORTY]


@needs_node
def test_a_car_that_python_writes_is_read_as_it_is():
    saved = [page_car(car) for car in CARS]
    read = [answer["value"] for answer in ask([("readCarFile", [json.dumps({"page_car": car})], []) for car in saved])]
    for car, answer in zip(saved, read, strict=True):
        absent = {part: dict.fromkeys(SECTIONS[part].model_fields) for part in ("steering", "body") if not car[part]}
        assert answer == {**car, **absent}
    assert [answer["value"] for answer in ask([("checkedCar", [car], []) for car in read])] == read


def test_the_command_writes_what_the_page_reads(monkeypatch, capsys, tmp_path):
    at.load_tyre("van").to_toml(tmp_path / "own-tyre.toml")
    SPORTY.replace(tyre=str(tmp_path / "own-tyre.toml")).to_toml(tmp_path / "own.toml")
    monkeypatch.setattr("sys.argv", ["adaptrack", "car", str(tmp_path / "own.toml"), "--json"])
    assert cli.main() == 0
    assert json.loads(capsys.readouterr().out)["page_car"] == page_car(at.load_vehicle(tmp_path / "own.toml"))


@needs_node
def test_what_is_no_car_is_refused_in_words():
    car = page_car(at.load_vehicle("van"))
    cars = [
        None, 3, "car", [], {}, {**car, "numbers": None}, {**car, "numbers": {**car["numbers"], "mass": "heavy"}},
        {**car, "numbers": {**car["numbers"], "mass": -1}}, {**car, "numbers": {**car["numbers"], "mass": [1]}},
        {**car, "numbers": {**car["numbers"], "lf": "Infinity"}}, {**car, "domain": {"speed": [9]}},
        {**car, "domain": {"speed": [9, 4]}}, {**car, "steering": {"lag": 99}}, {**car, "tyre": 5}, {**car, "tyre": {}},
        {**car, "tyre": {"name": "own", "numbers": {**car["tyre"]["numbers"], "linear": 7}}},
        {**car, "tyre": {"numbers": []}},
    ]  # fmt: skip
    for answer in ask([("checkedCar", [car], []) for car in cars]):
        is_refused_in_words(answer)
    (answer,) = ask([("checkedCar", [{**car, "numbers": {"mass": -1}, "steering": {"lag": 99}}], [])])
    assert "mass = -1: must be a finite number > 0 and <= 100000 (kg, total mass m)." in answer["error"]
    assert "steering.lag = 99: must be a finite number >= 0 and <= 10" in answer["error"]


def is_refused_in_words(answer):
    """Whole sentences, no trace of a program."""
    assert answer["name"] == "InputError", answer
    assert answer["problems"]
    for line in answer["error"].split("\n"):
        assert line.endswith((".", "?", "'...'.")), line
        assert " at " not in line or "inputs.js" not in line
        assert not {"undefined", "NaN", "[object", "TypeError"} & set(line.split()), line


@needs_node
def test_random_bytes_and_torn_files_are_refused_in_words_and_soon():
    rng = random.Random(7)
    content = json.dumps({"page_car": page_car(at.load_vehicle("model-car"))}).encode()
    texts = [rng.randbytes(rng.randint(0, 400)) for _ in range(150)]
    texts += [bytes(rng.choice(b"[]{}=\".#\n\\a1,-_ '") for _ in range(rng.randint(1, 200))) for _ in range(250)]
    for _ in range(250):
        torn = bytearray(content)
        for _ in range(rng.randint(1, 4)):
            torn[rng.randrange(len(torn))] = rng.randrange(256)
        texts.append(bytes(torn[: rng.randint(1, len(torn))]))
    texts += [b"[" * 200_000, b'"' * 99_999, b'{"page_car":' * 50_000]
    calls = [{"base64": base64.b64encode(text).decode()} for text in texts]
    answers = ask_all([{"call": "readCarFile", "args": [GIVEN], **call} for call in calls])
    answers += ask_all([{"call": "readPoints", "args": [GIVEN], **call} for call in calls])
    for answer in answers:
        assert answer["ms"] < 3000.0
        if "error" in answer:
            is_refused_in_words(answer)


# -- what kernels judge -----------------------------------------------------------------------------------------------


def test_a_page_is_given_plain_data_with_the_range_of_every_number():
    text = json.dumps(GIVEN, allow_nan=False)
    assert len(text) < 40_000
    for section in GIVEN["sections"].values():
        for field in section:
            assert field["kind"] != "number" or (field["meaning"] and field["allowed"]), field


# -- a data sheet -----------------------------------------------------------------------------------------------------
@needs_node
def test_a_typed_sheet_becomes_the_car_that_python_makes_of_it():
    typed = {
        "mass": "1500", "wheelbase": 2.7, "load": "75", "body_style": "truck", "lf": "1.2", "cg_height": "",
        "name": "a",
    }  # fmt: skip
    sheet = ask([("readSheet", [typed], [])])[0]["value"]
    assert sheet == {"name": "a", "mass": 1500, "wheelbase": 2.7, "load": 75, "truck": 1, "known": {"lf": 1.2}}
    car, within = row_of(cars.CarRow, mass=sheet["mass"], **sheet["known"]), row_of(cars.KnownWithinRow)
    assert cars.complete_car(sheet["wheelbase"], sheet["load"], sheet["truck"], car, within) == cars.OK
    rows = [
        dict(zip(row.dtype.names, (None if x != x else x for x in row.tolist()), strict=True)) for row in (car, within)
    ]
    read_car = ask([("carOfSheet", [sheet, *rows], [])])[0]["value"]
    expected = at.vehicle_from_data_sheet("a", 1500.0, 2.7, load=75.0, body_style="truck", lf=1.2)
    assert read_car["numbers"] == {key: getattr(expected, key) for key in read_car["numbers"]}
    assert read_car["known_within"] == json.loads(expected.known_within.model_dump_json())
    assert read_car["domain"] == json.loads(expected.domain.model_dump_json())
    assert read_car["tyre"]["name"] == expected.tyre


WRONG_SHEETS = [
    ({}, "mass: missing; give kg, 600 to 3500."),
    ({"mass": "1500"}, "wheelbase: missing"),
    ({"mass": "1,5", "wheelbase": 2.7}, 'mass = "1,5": write the decimal point: 1.5.'),
    ({"mass": "heavy", "wheelbase": 2.7}, 'mass = "heavy": is no number'),
    ({"mass": 1.5, "wheelbase": 2.7}, "mass = 1.5: must be from 600 to 3500 kg"),
    ({"mass": 1500, "wheelbase": 270}, "wheelbase = 270: must be from 1.7 to 5 m"),
    ({"mass": 1500, "wheelbase": 2.7, "load": -1}, "load = -1: must be a finite number >= 0"),
    ({"mass": 1500, "wheelbase": 2.7, "body_style": "lorry"}, 'body_style = "lorry": unknown'),
    ({"mass": 1500, "wheelbase": 2.7, "lf": "x"}, 'lf = "x": is no number'),
    ({"mass": 1500, "wheelbase": 2.7, "lff": 1}, '"lff": unknown'),
]


@needs_node
def test_a_wrong_sheet_is_refused_in_words():
    answers = ask([("readSheet", [typed], []) for typed, _ in WRONG_SHEETS])
    for (_, words), answer in zip(WRONG_SHEETS, answers, strict=True):
        assert words in answer["error"]
        is_refused_in_words(answer)


# -- points of a road -------------------------------------------------------------------------------------------------
SQUARE = "0,0\n30,0\n60,1\n90,4\n120,9\n"


TABLES = [
    SQUARE, "x,y\n" + SQUARE, "# x, y\n# a remark\n" + SQUARE, SQUARE.replace(",", ";"), SQUARE.replace(",", "\t"),
    SQUARE.replace(",", "  "), "\ufeffX_m;Y_m\r\n" + SQUARE.replace(",", ";").replace("\n", "\r\n"),
    "y,time,x\n" + "".join(f"{y},{k},{x}\n" for k, (x, y) in enumerate([(0, 0), (30, 0), (60, 1), (90, 4), (120, 9)])),
    '"x [m]","y [m]"\n' + SQUARE, "x;y\n" + SQUARE.replace(",", ",0;").replace("\n", ",0\n"), SQUARE + "120,9\n\n",
]  # fmt: skip
"""The same points."""


@needs_node
def test_points_are_read_with_any_separator_and_header():
    for answer in ask([("readPoints", [text], [{"name": "a"}]) for text in TABLES]):
        points = answer["value"]
        assert points["points"] == [0, 0, 30, 0, 60, 1, 90, 4, 120, 9]
        assert (points["count"], points["closed"], points["name"]) == (5, False, "a")
        assert len(points["lines"]) == 5


@needs_node
def test_points_are_those_that_python_reads(tmp_path):
    rng = np.random.default_rng(4)
    values = np.cumsum(rng.uniform(1.0, 9.0, (300, 2)), axis=0)
    text = "x,y,width_left\n" + "".join(f"{x!r},{y!r},2\n" for x, y in values.tolist())
    (tmp_path / "road.csv").write_text(text)
    from adaptrack.road.points import read_points

    points, expected = points_of(text)["value"], read_points(tmp_path / "road.csv")
    assert np.array(points["points"]).tobytes() == expected.points.tobytes()
    assert points["lines"] == list(expected.lines)
    assert points["notes"] == ["Columns left out: width_left."]


XY = [(0.0, 0.5), (30.0, 0.25), (60.0, 1.0), (90.0, 4.0), (120.0, 9.0)]


def table(header, columns, separator=","):
    """A file of the points `XY` under a header; columns: their order, where s counts the points."""
    rows = [{"x": x, "y": y, "s": float(k)} for k, (x, y) in enumerate(XY)]
    return header + "".join(separator.join(str(row[name]) for name in columns) + "\n" for row in rows)


HEADERS = {
    table("# 3f2a\n# 9b1c\n# s_m; x_m; y_m; psi_rad\n", "sxys", "; "): None,
    table("# run 1\n# t_s,x_m,y_m,v_mps\n", "sxys"): None,
    table("#v,y,x,t\n", "syxs"): None,
    table("## y_m, x_m\n# Monza, Italy\n", "yx"): None,
    table("# y x\n", "yx", " "): None,
    table("# y x\n", "yx"): None,
    table("# y\tx\n# a remark\n", "yx", "\t"): None,
    table("# x, y\ny, x\n", "yx"): None,
    table("# a remark\n", "xy"): None,
    table("# this file has x and y\n", "xy"): None,
    table("# this file has x and y\n", "xy", " "): None,
    table("# friction 0.9\n# Monza: 2019, lap: 3\n", "xy"): None,
    table("# Centre line of Monza, east and north in m\n", "xy"): None,
    table("# x [m], y (M), s []\n", "xys"): None,
    table("x;y\n", "xy", ";").replace(".", ","): None,
    table("", "xy", "\t").replace(".", ","): None,
    table("# s_m,kappa_radpm\n", "xy"): (1, "If this line is a remark, remove it."),
    table("# a remark\n# s; kappa; v; a\n", "xyxy", ";"): (2, "one column must be"),
    table("# s kappa\n", "xy", " "): (1, "one column must be"),
    table("# s in m, path curvature\n", "xy"): (1, "one column must be"),
    table("# \u03ba, \u03c8\n", "xy"): (1, "one column must be"),
    table("# x_m, kappa\n", "xy"): (1, "one column must be"),
    table("# lat, lon\n", "xy"): (1, "latitude"),
    table("# x [km], y [km]\n", "xy"): (1, "convert"),
    table("# x_m, y_m\n", "xyss"): (2, "4 columns, where 2 are expected"),
    table("", "xys"): (None, "3 columns without a header"),
}
"""Files of points: None for those that hold `XY`; of the others the line that is refused, and words of the sentence."""


@needs_node
def test_the_page_takes_the_same_line_for_the_header():
    for (text, refused), answer in zip(
        HEADERS.items(), ask([("readPoints", [text], [{}]) for text in HEADERS]), strict=True
    ):
        if refused is None:
            assert np.reshape(answer["value"]["points"], (-1, 2)).tolist() == [list(point) for point in XY], text
        else:
            assert refused[1] in answer["error"], text
            assert refused[0] is None or f"line {refused[0]}:" in answer["error"], answer["error"]


@needs_node
def test_a_lap_that_ends_where_it_began_is_closed():
    points = points_of("0,0\n30,0\n30,30\n0,30\n0,0\n")["value"]
    assert (points["count"], points["closed"]) == (4, True)
    assert points_of("0,0\n30,0\n30,30\n0,30\n", closed=True)["value"]["closed"] is True


NO_ROADS = [
    ("", "no line of numbers"), ("1,2\n", "1 points; a road needs at least 4"), ("x,y\n", "no line of numbers"),
    ("0,0\n1,nan\n2,0\n3,0\n", 'line 2: y = "nan" is not a finite number'),
    ("0,0\n1,\n2,0\n3,0\n", 'line 2: y = "" is not a finite number'),
    ("0,0\n1,0\n2\n3,0\n", "line 3: 1 columns, where 2 are expected"),
    ("1\n2\n3\n4\n", "1 columns without a header; give x,y"),
    ("a,b\n" + SQUARE, 'line 1: one column must be "x" or "x_m"'),
    ("x,x_m,y\n1,1,1\n", "line 1: one column must be"), ("lat,lon\n48.1,11.5\n", "line 1: column \"lat\": latitude"),
    ("x [km],y [km]\n" + SQUARE, 'column "x [km]": metres are needed, not "km"; convert them (times 1000)'),
    ("".join(f"{11.5 + k * 1e-4!r},{48.1 + k * 1e-5!r}\n" for k in range(9)), "degrees of longitude and latitude"),
    ("x" * 20_000, "line 1: a line of more than 10,000 characters"),
    ("".join(f"{k},0\n" for k in range(20_002)), "line 20001: more than 20000 points"),
    ("0,0\n" * 50, "1 points; a road needs"),
]  # fmt: skip


@needs_node
def test_points_that_make_no_road_are_refused_in_words():
    answers = ask([("readPoints", [text], [{}]) for text, _ in NO_ROADS])
    for (_, words), answer in zip(NO_ROADS, answers, strict=True):
        assert words in answer["error"]
        is_refused_in_words(answer)


@needs_node
def test_what_path_through_answers_is_said_with_the_line():
    def answered(points, closed=False):
        values = np.array(points, float)
        memory = np.empty(40_000)
        return path.path_through(values, closed, 0.0, memory)

    straight = [(10.0 * k, 0.0) for k in range(6)]
    statuses = {
        "TOO_FEW": answered(straight[:3]),
        "POINT_TOO_FAR": answered([*straight, (1e6, 0.0)]), "POINT_NOT_FINITE": answered([*straight, (math.nan, 0.0)]),
        "TOO_SHORT": answered([(1e-4 * k, 0.0) for k in range(6)]),
        "PATH_KINK": answered([*straight, (40.0, 0.001), (30.0, 0.0), (20.0, 0.0)]),
    }  # fmt: skip
    road = {"count": 6, "lines": list(range(11, 31))}
    answers = ask([("roadFlaw", [status, place, road], []) for status, place in [(path.OK, 0), *statuses.values()]])
    assert answers[0]["value"] is None
    for (name, (status, place)), answer in zip(statuses.items(), answers[1:], strict=True):
        assert status == getattr(path, name)
        assert answer["value"].endswith((".", "?"))
        assert name in ("TOO_FEW", "TOO_SHORT") or f"line {11 + place}" in answer["value"]


# -- a drive as a table ------------------------------------------------------------------------------------------------
def drive_history(profile="road"):
    """A drive as a page keeps it."""
    car = at.load_vehicle("midsize-sedan")
    road = at.generate_road("country", seed=2, length=600.0)
    run = at.simulate(at.DualTrack(car), at.MPC(car, profile=profile), at.RoadDrive(road, 15.0), profile=profile)
    columns = {
        "time": run.t, "command": run.command, "wheel_angle": run.steering, "vx": run.vx, "yaw_rate": run.yaw_rate,
        "vy": run.vy, "lateral_acceleration": run.lateral_acceleration, "yaw": run.psi, "x": run.X, "y": run.Y,
        "error": run.error,
    }  # fmt: skip
    return run, {"cars": [{"columns": {key: np.asarray(column).tolist() for key, column in columns.items()},
                           "count": len(run.t)}]}  # fmt: skip


@needs_node
def test_python_reads_the_drive_that_the_page_writes(tmp_path):
    assert set(GIVEN["drive"]) <= set(SIGNAL_COLUMNS)
    run, history = drive_history()
    text = ask([("writeDrive", [history, 0], [])])[0]["value"]
    (tmp_path / "drive.csv").write_text(text)
    columns = read_columns(tmp_path / "drive.csv", at.Reading())
    assert columns.commanded
    assert not columns.ratio_unknown
    for signal, values in (("command", run.command), ("wheel", run.steering), ("speed", run.vx), ("yaw", run.psi),
                           ("yaw_rate", run.yaw_rate), ("vy", run.vy), ("x", run.X), ("y", run.Y)):  # fmt: skip
        assert columns.values[signal].tobytes() == np.asarray(values, float).tobytes(), signal
