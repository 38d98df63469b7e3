"""Files that a user drops on the page are read as Python reads them; what is wrong with them is said in sentences."""

from __future__ import annotations

import base64
import json
import math
import random
import subprocess
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import ConfigError
from adaptrack.base.files import SHIPPED
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.cars.vehicle import Tyre, list_tyres, list_vehicles, load_tyre, load_vehicle
from adaptrack.core import path
from adaptrack.core.plants import tyre as tyre_laws
from adaptrack.core.synthesis import car as cars
from adaptrack.core.synthesis import plant
from adaptrack.core.synthesis.rows import row_of
from adaptrack.export.page_inputs import SECTIONS, car_fields, tyre_numbers
from adaptrack.identification.reading import ALIASES, Reading, read_columns
from programs import find_program

HERE, PAGE = Path(__file__).parent / "page", Path(at.__file__).parent / "export" / "page"
needs_node = pytest.mark.needs("node")
GIVEN = car_fields()
SIX = "mass = 1500\nyaw_inertia = 2500\nlf = 1.1\nlr = 1.6\nstiffness_front = 55e3\nstiffness_rear = 60e3\n"


def asked(calls):
    """Answers of inputs.js to calls (function, arguments behind which `GIVEN` goes, further ones)."""
    asking = [{"call": call, "args": [*args, GIVEN, *more]} for call, args, more in calls]
    return told(asking)


def told(asking):
    done = subprocess.run(
        [find_program("node"), str(HERE / "inputs.mjs"), str(PAGE / "inputs.js")], input=json.dumps(asking), text=True,
        capture_output=True, timeout=60, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


def read_car(text, **options):
    return asked([("readCarFile", [text], [options])])[0]


def points_of(text, **options):
    return asked([("readPoints", [text], [options])])[0]


# -- car files --------------------------------------------------------------------------------------------------------
@needs_node
def test_every_shipped_car_is_read_as_python_reads_it():
    names = list_vehicles()
    calls = [("readCarFile", [(SHIPPED / "vehicles" / f"{name}.toml").read_text()], [{}]) for name in names]
    for name, answer in zip(names, asked(calls), strict=True):
        found, car = answer["value"], load_vehicle(name)
        assert (found["name"], found["description"]) == (car.name, car.description)
        for key, value in found["numbers"].items():
            assert float(value).hex() == getattr(car, key).hex(), key
        assert len(found["numbers"]) == 22
        for part in ("steering", "body", "known_within", "domain"):
            own = getattr(car, part)
            expected = None if own is None else json.loads(own.model_dump_json())
            if own is None and part != "known_within":
                expected = dict.fromkeys(SECTIONS[part].model_fields)
            assert found[part] == expected, part
        assert found["tyre"] == {"name": car.tyre, "numbers": tyre_numbers(load_tyre(car.tyre))}


@needs_node
def test_every_shipped_tyre_is_read_as_a_section_and_as_a_file_beside_the_car():
    names = list_tyres()
    texts = {name: (SHIPPED / "tyres" / f"{name}.toml").read_text() for name in names}
    calls = [("readCarFile", [f"{SIX}[tyre]\n{texts[name]}"], [{}]) for name in names]
    calls += [
        ("readCarFile", [f'{SIX}tyre = "files/{name}.toml"'], [{"others": {f"{name}.toml": texts[name]}}])
        for name in names
    ]
    for name, answer in zip(names * 2, asked(calls), strict=True):
        assert answer["value"]["tyre"] == {"name": name, "numbers": tyre_numbers(load_tyre(name))}


@needs_node
def test_what_python_writes_is_read(tmp_path):
    car = vehicle_from_data_sheet("own", 1500.0, 2.7, load=75.0)
    car.to_toml(tmp_path / "own.toml")
    found = read_car((tmp_path / "own.toml").read_text())["value"]
    assert found["numbers"] == {key: getattr(car, key) for key in found["numbers"]}
    assert found["estimated"] == list(car.estimated)
    assert found["known_within"] == json.loads(car.known_within.model_dump_json())


@needs_node
def test_all_of_toml_that_a_car_needs_is_read():
    text = (
        "\ufeff# a remark\r\nname = 'a # b'  # \"\r\n" + SIX.replace("1500", "+1_500.0").replace("\n", "\r\n")
        + 'estimated = [ # one\n  "mass",\n  "lf", ]\nsteering = {lag = 0.1, dead_time = 0}\n"domain".wind = 1e1\n'
        + '[body]\nwidth = 0x2\n'
    )  # fmt: skip
    found = read_car(text)["value"]
    assert found["name"] == "a # b"
    assert found["numbers"]["mass"] == 1500.0
    assert found["estimated"] == ["mass", "lf"]
    assert (found["steering"]["lag"], found["steering"]["dead_time"], found["steering"]["rate"]) == (0.1, 0, None)
    assert (found["domain"]["wind"], found["body"]["width"]) == (10.0, 2)
    assert read_car(SIX, name="my-car")["value"]["name"] == "my-car"


@needs_node
def test_a_car_from_a_link_is_the_same_or_refused_in_words():
    texts = [(SHIPPED / "vehicles" / f"{name}.toml").read_text() for name in list_vehicles()]
    read = [each["value"] for each in asked([("readCarFile", [text], [{}]) for text in texts])]
    assert [each["value"] for each in asked([("checkedCar", [car], []) for car in read])] == read
    car = read[0]
    named = asked([("checkedCar", [{**car, "tyre": {"name": "van"}}], [])])[0]["value"]
    assert named["tyre"] == {"name": "van", "numbers": tyre_numbers(load_tyre("van"))}
    wrong = [
        None, 3, "car", [], {}, {**car, "numbers": None}, {**car, "numbers": {**car["numbers"], "mass": "heavy"}},
        {**car, "numbers": {**car["numbers"], "mass": -1}}, {**car, "steering": 3}, {**car, "domain": {"speed": [9]}},
        {**car, "tyre": {"name": "own", "numbers": {**car["tyre"]["numbers"], "linear": 7}}}, {**car, "tyre": 5},
        {**car, "tyre": {"numbers": []}}, {**car, "tyre": {}}, {**car, "tyre": {"name": 3}},
        {**car, "__proto__": {}, "unknown": 1},
    ]  # fmt: skip
    for answer in asked([("checkedCar", [each], []) for each in wrong]):
        is_refused_in_words(answer)


BROKEN = {
    "": "mass: missing; give a finite number > 0",
    SIX.replace("yaw_inertia", "yaw_inertai"): 'line 2: "yaw_inertai": unknown key. Did you mean "yaw_inertia"?',
    SIX.replace(
        "1500", "-1500"
    ): r"line 1: mass = -1500: must be a finite number > 0 and <= 100000 (kg, total mass m).",
    SIX.replace("1500", '"1500"'): 'line 1: mass = "1500": must be a finite number',
    SIX.replace("1500", "nan"): "line 1: mass = nan: must be",
    SIX.replace("1500", "inf"): "line 1: mass = inf: must be",
    SIX.replace("1500", "true"): "line 1: mass = true: must be",
    SIX.replace("1500", "[1]"): "line 1: mass = [1]: must be",
    SIX.replace("1500", "1500 kg"): 'line 1: "kg" behind the value',
    SIX.replace("1.1", "1,1"): 'line 3: ",1" behind a number: write a decimal point',
    SIX.replace("1.1", ".5"): "line 3: lf = .5: a number needs digits on both sides",
    SIX.replace("1.1", "5."): "line 3: lf = 5.: a number needs digits",
    SIX.replace("1.1", "01.1"): "line 3: lf = 01.1: a number does not begin with 0",
    SIX.replace("1.1", "2026-11-24"): "line 3: lf = 2026-11-24: a date",
    SIX.replace("1.1", "one"): "line 3: lf = one: neither a number",
    SIX.replace("1.1", ""): "line 3: lf: the value is missing",
    SIX.replace("lf = 1.1", "lf 1.1"): 'line 3: lf: "=" and a value are missing',
    SIX.replace("lf = 1.1", "= 1.1"): 'line 3: "= 1.1" is no key',
    SIX + "mass = 2\n": "line 7: mass comes twice, first in line 1",
    SIX + "[body]\nwidth = 2\n[body]\n": "line 9: [body] comes twice",
    SIX + "[[body]]\n": "line 7: [[...]]: a list of sections",
    SIX + "[body\n": 'line 7: [body: the bracket "]" is missing',
    SIX + 'name = "a\n': 'line 7: a quote " is missing',
    SIX + 'name = """a"""\n': "line 7: a text over several lines",
    SIX + 'name = "\\q"\n': 'line 7: "\\q" is no character',
    SIX + 'name = "\\ud800"\n': 'line 7: "\\ud800" is no character',
    SIX + 'name = ""\n': 'line 7: name = "": must be text of at least one letter',
    SIX + "name = 3\n": "line 7: name = 3: must be text, in quotes",
    SIX + 'estimated = ["mas"]\n': 'line 7: estimated = ["mas"]: "mas" is no number of a car. Did you mean "mass"?',
    SIX + "estimated = [1\n": 'line 7: estimated: the bracket "]" of a list is missing',
    SIX + "lag = 0.1\n": 'line 7: "lag": unknown key; it belongs into the section [steering]',
    SIX + "steering = 0.1\n": "line 7: steering = 0.1: must be a section, [steering]",
    SIX + "[stering]\nlag = 0.1\n": 'line 7: "stering": unknown key. Did you mean "steering"?',
    SIX + "[steering]\nlga = 0.1\n": 'line 8: "steering.lga": unknown key. Did you mean "lag"?',
    SIX + "[steering]\nrate = 28\n": "line 8: steering.rate = 28: no road wheels turn so fast",
    SIX + "[steering]\nlag = 99\n": "line 8: steering.lag = 99: must be a finite number >= 0 and <= 10",
    SIX + "[domain]\nspeed = [9, 4]\n": "line 8: domain.speed = [9, 4]: must be two numbers that rise",
    SIX
    + "[domain]\nspeed = [4, 400]\n": "line 8: domain.speed = [4, 400]: must be two numbers that rise, [lowest, hig",
    SIX + "[known_within]\nmass = 0.5\n": "line 8: known_within.mass = 0.5: must be a finite number >= 1 and <= 10",
    SIX + 'tyre = "passenger"\n': 'line 7: tyre = "passenger": unknown tyre. Did you mean "passenger-car"?',
    SIX + 'tyre = "my.toml"\n': 'line 7: tyre = "my.toml": another file, which is not here',
    SIX + "tyre = 3\n": "line 7: tyre = 3: must be text",
    SIX + '[tyre]\nkind = "magic"\n': 'line 8: tyre.kind = "magic": must be one of',
    "\0" + SIX: "line 1: holds a control character",
    SIX + "x = " + "[" * 99 + "\n": "line 7: more than 64 brackets in one another",
    SIX + ".".join(["x"] * 99) + " = 1\n": "line 7: more than 64 tables in one another",
}


@needs_node
def test_every_broken_file_is_refused_in_a_sentence_that_names_line_or_key():
    answers = asked([("readCarFile", [text], [{}]) for text in BROKEN])
    assert len(BROKEN) >= 30
    for (text, expected), answer in zip(BROKEN.items(), answers, strict=True):
        assert answer.get("name") == "InputError", (text, answer)
        assert expected in answer["error"], text
        is_refused_in_words(answer)


def is_refused_in_words(answer):
    """Whole sentences, no trace of a program."""
    assert answer["name"] == "InputError", answer
    assert answer["problems"]
    for each in answer["error"].split("\n"):
        assert each.endswith((".", "?", "'...'.")), each
        assert " at " not in each or "inputs.js" not in each
        assert not {"undefined", "NaN", "[object", "TypeError"} & set(each.split()), each


@needs_node
def test_all_problems_of_a_file_are_said_at_once():
    answer = read_car("mass = -1\nmsas = 2\n[steering]\nlag = -1\n")
    lines = [each["line"] for each in answer["problems"]]
    assert lines == [1, 2, 4, None, None, None, None, None]
    assert sum("missing" in each["message"] for each in answer["problems"]) == 5


@needs_node
def test_a_tyre_has_a_load_ratio_where_its_law_has_a_use_for_it():
    own = 'kind = "magic-formula"\nstiffness_front = 5e4\nstiffness_rear = 5e4\nnominal_load = 4e3\n'
    without = read_car(f'{SIX}[tyre]\n{own}stiffness_load = "digressive"\n')
    assert "tyre.digressive_load_ratio: missing: a digressive stiffness needs" in without["error"]
    beside = read_car(f"{SIX}[tyre]\n{own}digressive_load_ratio = 2.0\n")
    assert 'line 12: tyre.digressive_load_ratio: only stiffness_load = "digressive"' in beside["error"]


@needs_node
def test_random_bytes_and_torn_files_are_refused_in_words_and_soon():
    rng = random.Random(7)
    whole = (SHIPPED / "vehicles" / "model-car.toml").read_bytes()
    texts = [rng.randbytes(rng.randint(0, 400)) for _ in range(150)]
    texts += [bytes(rng.choice(b"[]{}=\".#\n\\a1,-_ '") for _ in range(rng.randint(1, 200))) for _ in range(250)]
    for _ in range(250):
        torn = bytearray(whole)
        for _ in range(rng.randint(1, 4)):
            torn[rng.randrange(len(torn))] = rng.randrange(256)
        texts.append(bytes(torn[: rng.randint(1, len(torn))]))
    texts += [b"[" * 200_000, b"a." * 100_000, b'"' * 99_999, b"a = " + b"{a = " * 50_000, b"=\n" * 100_000]
    texts.append(b"".join(b"key_%d = 1\n" % i for i in range(20_000)))
    calls = [{"base64": base64.b64encode(each).decode()} for each in texts]
    answers = told([{"call": "readCarFile", "args": [GIVEN], **each} for each in calls])
    answers += told([{"call": "readPoints", "args": [GIVEN], **each} for each in calls])
    for answer in answers:
        assert answer["ms"] < 3000.0
        if "error" in answer:
            is_refused_in_words(answer)


# -- what kernels judge -----------------------------------------------------------------------------------------------
@needs_node
@pytest.mark.parametrize(("change", "words"), [
    ({"mass": 1.5}, "do not belong together"), ({"stiffness_front": 900.0}, "stiffness_front = 900 N/rad is 0.2"),
    ({"stiffness_rear": 9e6}, "stiffness_rear = 9000000 N/rad"), ({}, None),
])  # fmt: skip
def test_numbers_of_different_units_are_named(change, words):
    car = {"mass": 1500.0, "yaw_inertia": 2500.0, "lf": 1.1, "lr": 1.6, "stiffness_front": 5.5e4,
           "stiffness_rear": 6e4, **change}  # fmt: skip
    status, ratio = cars.car_flaw(row_of(cars.Car, **car))
    loads = cars.static_loads(car["mass"], car["lf"], car["lr"])
    found = asked([("carFlaw", [status, ratio, {"numbers": car}, loads], [])])[0]["value"]
    assert (words is None and found is None) or words in found


@needs_node
@pytest.mark.parametrize(("body", "words"), [
    ({"length": 2.0}, "does not hold wheelbase"), ({"length": 5.0, "front_overhang": 1.0, "rear_overhang": 0.1},
    "leave one of the three out"), ({"length": 4.6}, None),
])  # fmt: skip
def test_a_body_that_cannot_be_is_named(body, words):
    status, front, rear = plant.overhangs(row_of(plant.Body, **body), 2.7)
    found = asked([("outlineFlaw", [status, front, rear, {"body": body}], [])])[0]["value"]
    assert (words is None and found is None) or words in found


def test_choices_are_numbered_as_kernels_number_them():
    words = {each["key"]: each.get("words") for each in GIVEN["sections"]["tyre"]}
    assert words["kind"].index("linear") == 1
    assert [words["stiffness_load"].index(each) for each in ("constant", "linear", "digressive")] == [
        plant.CONSTANT, plant.LINEAR, plant.DIGRESSIVE,
    ]  # fmt: skip
    assert plant.plant_law(load_tyre("constant-stiffness").numbers) == tyre_laws.LINEAR
    assert set(tyre_numbers(load_tyre("van"))) == set(plant.Tyre._fields)
    named = {each["row"] for each in GIVEN["sections"]["tyre"] if each["kind"] in ("number", "choice")}
    assert named == set(plant.Tyre._fields)
    assert {each["key"] for each in GIVEN["sections"]["tyre"]} == set(Tyre.model_fields)


def test_a_page_is_given_plain_data_with_the_unit_of_every_number():
    text = json.dumps(GIVEN, allow_nan=False)
    assert len(text) < 40_000
    for section in GIVEN["sections"].values():
        for field in section:
            assert field["kind"] != "number" or (field["unit"] and field["meaning"] and field["allowed"]), field


# -- a data sheet -----------------------------------------------------------------------------------------------------
@needs_node
def test_a_typed_sheet_becomes_the_car_that_python_makes_of_it():
    typed = {
        "mass": "1500",
        "wheelbase": 2.7,
        "load": "75",
        "body_style": "truck",
        "lf": "1.2",
        "cg_height": "",
        "name": "a",
    }
    sheet = asked([("readSheet", [typed], [])])[0]["value"]
    assert sheet == {"name": "a", "mass": 1500, "wheelbase": 2.7, "load": 75, "truck": 1, "known": {"lf": 1.2}}
    car, within = row_of(cars.Car, mass=sheet["mass"], **sheet["known"]), row_of(cars.KnownWithin)
    assert cars.complete_car(sheet["wheelbase"], sheet["load"], sheet["truck"], car, within) == cars.COMPLETE
    rows = [
        dict(zip(row.dtype.names, (None if x != x else x for x in row.tolist()), strict=True)) for row in (car, within)
    ]
    found = asked([("carOfSheet", [sheet, *rows], [])])[0]["value"]
    expected = vehicle_from_data_sheet("a", 1500.0, 2.7, load=75.0, body_style="truck", lf=1.2)
    assert found["numbers"] == {key: getattr(expected, key) for key in found["numbers"]}
    assert found["known_within"] == json.loads(expected.known_within.model_dump_json())
    assert found["domain"] == json.loads(expected.domain.model_dump_json())
    assert found["tyre"]["name"] == expected.tyre


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
    answers = asked([("readSheet", [typed], []) for typed, _ in WRONG_SHEETS])
    for (_, words), answer in zip(WRONG_SHEETS, answers, strict=True):
        assert words in answer["error"]
        is_refused_in_words(answer)


@needs_node
def test_what_complete_car_answers_is_said():
    sheet = {"mass": 1500, "wheelbase": 2.7, "load": 2000}
    answers = [each["value"] for each in asked([("sheetFlaw", [status, sheet], []) for status in range(5)])]
    assert answers[0] is None
    assert all(each.endswith(".") for each in answers[1:])
    assert "load = 2000 kg" in answers[cars.TOO_MUCH_LOAD]


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
    for answer in asked([("readPoints", [text], [{"name": "a"}]) for text in TABLES]):
        found = answer["value"]
        assert found["points"] == [0, 0, 30, 0, 60, 1, 90, 4, 120, 9]
        assert (found["count"], found["closed"], found["name"]) == (5, False, "a")
        assert len(found["lines"]) == 5


@needs_node
def test_points_are_those_that_python_reads(tmp_path):
    rng = np.random.default_rng(4)
    values = np.cumsum(rng.uniform(1.0, 9.0, (300, 2)), axis=0)
    text = "x,y,width_left\n" + "".join(f"{x!r},{y!r},2\n" for x, y in values.tolist())
    (tmp_path / "road.csv").write_text(text)
    from adaptrack.road.points import read_points

    found, expected = points_of(text)["value"], read_points(tmp_path / "road.csv")
    assert np.array(found["points"]).tobytes() == expected.points.tobytes()
    assert found["lines"] == list(expected.lines)
    assert found["notes"] == ["Columns left out: width_left."]


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


def test_python_takes_a_commented_line_of_names_for_the_header(tmp_path):
    from adaptrack.road.points import read_points

    for k, (text, refused) in enumerate(HEADERS.items()):
        path = tmp_path / f"{k}.csv"
        path.write_text(text)
        if refused is None:
            assert read_points(path).points.tolist() == [list(point) for point in XY], text
            continue
        with pytest.raises(ConfigError, match=refused[1]) as error:
            read_points(path)
        assert refused[0] is None or f"line {refused[0]}:" in str(error.value), error.value


@needs_node
def test_the_page_takes_the_same_line_for_the_header():
    for (text, refused), answer in zip(
        HEADERS.items(), asked([("readPoints", [text], [{}]) for text in HEADERS]), strict=True
    ):
        if refused is None:
            assert np.reshape(answer["value"]["points"], (-1, 2)).tolist() == [list(point) for point in XY], text
        else:
            assert refused[1] in answer["error"], text
            assert refused[0] is None or f"line {refused[0]}:" in answer["error"], answer["error"]


@needs_node
def test_a_lap_that_ends_where_it_began_is_closed():
    found = points_of("0,0\n30,0\n30,30\n0,30\n0,0\n")["value"]
    assert (found["count"], found["closed"]) == (4, True)
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
    answers = asked([("readPoints", [text], [{}]) for text, _ in NO_ROADS])
    for (_, words), answer in zip(NO_ROADS, answers, strict=True):
        assert words in answer["error"]
        is_refused_in_words(answer)


@needs_node
def test_a_road_that_may_be_in_kilometres_is_said():
    found = points_of("".join(f"{0.03 * k},{0.001 * k * k}\n" for k in range(40)))["value"]
    assert any("if x and y are in km" in note for note in found["notes"])


@needs_node
def test_what_path_through_answers_is_said_with_the_line():
    def answered(points, closed=False):
        values = np.array(points, float)
        memory = np.empty(40_000)
        return path.path_through(values, closed, memory)

    straight = [(10.0 * k, 0.0) for k in range(6)]
    found = {
        "TOO_FEW": answered(straight[:3]),
        "TOO_FAR": answered([*straight, (1e6, 0.0)]), "NOT_FINITE": answered([*straight, (math.nan, 0.0)]),
        "TOO_SHORT": answered([(1e-4 * k, 0.0) for k in range(6)]),
        "KINK": answered([*straight, (40.0, 0.001), (30.0, 0.0), (20.0, 0.0)]),
    }  # fmt: skip
    road = {"count": 6, "lines": list(range(11, 31))}
    answers = asked([("roadFlaw", [status, place, road], []) for status, place in [(path.OK, 0), *found.values()]])
    assert answers[0]["value"] is None
    for (name, (status, place)), answer in zip(found.items(), answers[1:], strict=True):
        assert status == getattr(path, name)
        assert answer["value"].endswith((".", "?"))
        assert name in ("TOO_FEW", "TOO_SHORT") or f"line {11 + place}" in answer["value"]


# -- sizes, and a drive as a table ------------------------------------------------------------------------------------
@needs_node
def test_a_file_of_100_mb_is_refused_by_its_size_before_it_is_read():
    calls = [("tooLarge", [100_000_000, what], []) for what in ("car file", "csv")]
    calls += [("textOf", [{"size": 100_000_000}, "csv"], []), ("tooLarge", [1000, "csv"], [])]
    car, csv, read, small = asked(calls)
    assert car["value"] == "The file has 100.0 MB; a car file has at most 1 MB: give a smaller one."
    assert "at most 20 MB" in csv["value"]
    assert read["error"] == csv["value"]
    assert small["value"] is None


def driven(profile="road"):
    """A drive as a page keeps it."""
    car = load_vehicle("midsize-sedan")
    road = at.generate_road("country", seed=2, length=600.0)
    run = at.simulate(at.DualTrack(car), at.MPC(car, profile=profile), at.RoadDrive(road, 15.0), profile=profile)
    columns = {
        "time": run.t, "command": run.command, "wheel_angle": run.steering, "vx": run.vx, "yaw_rate": run.yaw_rate,
        "vy": run.vy, "lateral_acceleration": run.lateral_acceleration, "yaw": run.psi, "x": run.X, "y": run.Y,
        "error": run.error,
    }  # fmt: skip
    return run, {"cars": [{"columns": {key: np.asarray(each).tolist() for key, each in columns.items()},
                           "count": len(run.t)}]}  # fmt: skip


@needs_node
def test_python_reads_the_drive_that_the_page_writes(tmp_path):
    assert set(GIVEN["drive"]) <= set(ALIASES)
    run, history = driven()
    text = asked([("writeDrive", [history, 0], [])])[0]["value"]
    (tmp_path / "drive.csv").write_text(text)
    found = read_columns(tmp_path / "drive.csv", Reading())
    assert found.commanded
    assert not found.ratio_unknown
    for signal, values in (("command", run.command), ("wheel", run.steering), ("speed", run.vx), ("yaw", run.psi),
                           ("yaw_rate", run.yaw_rate), ("vy", run.vy), ("x", run.X), ("y", run.Y)):  # fmt: skip
        assert found.values[signal].tobytes() == np.asarray(values, float).tobytes(), signal
