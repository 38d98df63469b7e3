"""The page on which one drives, under every hand: keys, sizes, colours, links, and what nobody should give it."""

import json
import re

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.kernel import INTERPRETED
from adaptrack.export.page_inputs import page_car
from browsers import Chromium, Media
from pages import CONTROLS, NAME, NO_AXE, READY, STATE, axe, check_that_space_plays, export_page, open_page

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(INTERPRETED, reason="the page's kernels are compiled"),
    pytest.mark.needs("chromium"),
]
WIDTHS = (320, 400, 800, 1400, 2200)
OPEN_ALL = (
    "document.querySelectorAll('details').forEach((each) => { each.open = true; }), document.activeElement.blur()"
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return export_page(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module")
def window(file):
    with Chromium() as page:
        unfolded(page, file)
        yield page


def unfolded(window, file, fragment=""):
    """The page, paused, with all its panels open."""
    open_page(window, file, fragment).run(OPEN_ALL)


# -- keys -------------------------------------------------------------------------------------------------------------
def test_tab_reaches_every_control_in_the_order_of_the_page_and_shows_where_it_is(window):
    expected = window.run(f"{CONTROLS}.map({NAME})")
    assert len(expected) > 40
    window.run("scrollTo(0, 0), document.activeElement.blur()")
    visited, unmarked = [], []
    for _ in expected:
        window.press("Tab")
        visited.append(window.run(f"{NAME}(document.activeElement)"))
        if not window.run(
            "(({outlineStyle, outlineWidth, boxShadow}) => outlineStyle !== 'none' && parseFloat(outlineWidth) >= 2 ||"
            " boxShadow !== 'none')(getComputedStyle(document.activeElement))"
        ):
            unmarked.append(visited[-1])
    assert visited == expected
    assert unmarked == []
    window.press("Tab", shift=True)
    assert window.run(f"{NAME}(document.activeElement)") == expected[-2]


KEYS = {
    "range": "ArrowRight", "select-one": "ArrowDown", "number": "ArrowUp", "checkbox": " ", "radio": " ",
    "textarea": "a",
}  # fmt: skip


def test_every_control_does_by_key_what_it_does_by_mouse(window):
    # what it would set off is held back: it is the same as with a mouse
    window.run(
        """(() => {
          window.heard = [];
          window.hear = (event) => {
            window.heard.push(event.type);
            if (event.type === "click" && event.target.type !== "checkbox") event.preventDefault();
            event.stopImmediatePropagation();
          };
          for (const kind of ["click", "input", "change"]) addEventListener(kind, window.hear, true);
        })()"""
    )
    count = window.run(f"(window.controls = {CONTROLS}).length")
    deaf = []
    for i in range(count):
        kind = window.run(f"(window.heard = [], controls[{i}].focus(), controls[{i}].type || controls[{i}].tagName)")
        if kind in ("PRE", "CANVAS", "DIV", "SECTION"):
            continue
        if kind == "range":
            window.run(f"controls[{i}].value = controls[{i}].min")
        if kind == "select-one":
            window.run(f"controls[{i}].selectedIndex = 0")
        window.press(KEYS.get(kind, "Enter"))
        # the slider of time hands its keys to the clock, see below
        if not window.run(f"heard.length || controls[{i}].dataset.part === 'slider'") and kind != "select-one":
            deaf.append(window.run(f"{NAME}(controls[{i}])"))
    window.run("['click', 'input', 'change'].forEach((kind) => removeEventListener(kind, hear, true))")
    assert deaf == []


def test_the_picture_is_steered_by_keys(window, file):
    unfolded(window, file)
    window.run("adaptrackPage.advance(100)")
    window.run("adaptrackPage.seek(2), document.querySelector('#road canvas').focus()")
    before = window.run(f"{STATE}.t")
    window.press("ArrowRight")
    assert window.run(f"{STATE}.t") > before
    window.press("Home")
    assert window.run(f"{STATE}.t") == 0.0
    check_that_space_plays(window, STATE)


def test_keys_steer_the_picture_without_a_click_and_leave_other_controls_alone(window, file):
    unfolded(window, file)
    window.run("adaptrackPage.advance(100)")
    window.run("adaptrackPage.seek(2), document.activeElement.blur()")
    window.press("ArrowRight")
    assert window.run(f"{STATE}.t") == pytest.approx(3.0)
    window.press("ArrowLeft", times=2)
    assert window.run(f"{STATE}.t") == pytest.approx(1.0)
    check_that_space_plays(window, STATE)
    assert window.run("scrollY") == 0
    time = window.run(f"{STATE}.t")
    window.run("document.getElementById('setup-speed').focus()")
    window.press("ArrowLeft")
    window.press(" ")
    assert window.run(f"{STATE}.t") == time
    assert not window.run(f"{STATE}.playing")


# -- sizes and colours ------------------------------------------------------------------------------------------------
def test_nothing_is_wider_than_the_window_nor_smaller_than_a_finger(window, file):
    unfolded(window, file)
    for width in WIDTHS:
        window.resize(width, 900)
        assert window.run("document.documentElement.scrollWidth - innerWidth") <= 0, width
        small = window.run(
            f"""{CONTROLS}.filter((each) => !each.matches(".skip, p a")).map((each) => {{
              const boxes = [each, ...(each.labels ?? [])].map((part) => part.getBoundingClientRect());
              return [{NAME}(each), Math.max(...boxes.map((b) => b.width)), Math.max(...boxes.map((b) => b.height))];
            }}).filter(([_, wide, high]) => wide < 24 || high < 24)"""
        )
        assert small == [], width
    window.resize(1400, 900)


@pytest.mark.parametrize(("scheme", "width"), [("light", 1400), ("dark", 400), ("light", 400), ("dark", 1400)])
def test_a_checker_of_accessibility_finds_nothing_serious(window, file, scheme, width):
    checker = axe()
    if checker is None:
        pytest.skip(NO_AXE)
    window.media(Media(scheme))
    window.resize(width, 900)
    unfolded(window, file)
    window.run("adaptrackPage.advance(60)")
    window.run(f"{checker.read_text()};0")
    report = window.run("axe.run({runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']})")
    window.media(Media())
    violations = [violation for violation in report["violations"] if violation["impact"] in ("serious", "critical")]
    assert {violation["id"]: [node["html"][:120] for node in violation["nodes"]] for violation in violations} == {}


# -- out again --------------------------------------------------------------------------------------------------------
SETUP = {
    "car": {"sheet": {"mass": 1300, "wheelbase": 2.5}},
    "road": {"points": [[12 * k, round(9 * np.sin(k / 5), 1)] for k in range(100)], "closed": False, "name": "drawn"},
    "speed": {"lateral": 2}, "profile": "production", "seed": 5,
    "truth": {"lag": 0.31, "dead_time": 0.1, "bias": 0.01, "noise": 2, "friction": 0.8, "wind": -4,
              "brake_lag": 0.3, "slope": 0.02, "mass": 1.2},
    "controllers": [
        {
            "kind": "informed",
            "tuning": {"Np": 25, "Nc": 6, "Q": 2.5, "R": 300},
            "belief": {"lag": 0.2, "dead_time": 0.05},
            "speed_control": {"friction": [0.6, 0.7]},
        },
        {"kind": "stanley", "tuning": None, "belief": None},
    ],
}  # fmt: skip


DRIVEN = """adaptrackPage.advance(50).then(() => adaptrackPage.page.drive.history.cars.map(
  ({columns}) => ["x", "y", "yaw", "command"].map((name) => Array.from(columns[name].slice(0, 50)))))"""


def test_a_link_holds_all_settings_and_a_drawn_road(window, file):
    unfolded(window, file)
    window.run(f"adaptrackPage.start({json.dumps(SETUP)})")
    assert window.run(f"{STATE}.notice") == ""
    first, drove = window.run(f"{STATE}.setup"), window.run(DRIVEN)
    link = window.run("location.hash")
    assert len(link) < 8000
    unfolded(window, file, link)
    assert window.run(f"{STATE}.setup") == first
    assert window.run(DRIVEN) == drove


SHOWN = {
    "all settings": {**SETUP, "controllers": SETUP["controllers"][:1]},
    "as it begins": {},
    "learning": {
        "road": {"name": "town"}, "profile": "production", "controllers": [{"kind": "learning"}], "seed": 3,
    },
    "a law": {**SETUP, "controllers": SETUP["controllers"][1:]},
    "a planner": {
        **SETUP, "controllers": SETUP["controllers"][:1],
        "planner": {"period": 0.2, "delay": 0.1, "noise": 0, "start": "pose"},
    },
    "a test": {
        "road": {"test": "triple-lane-change"}, "car": {"name": "paper"}, "profile": "paper",
        "controllers": [{"kind": "published"}],
    },
}  # fmt: skip
"""What is changed of the setup with which the page begins; the first is always tried."""


@pytest.mark.parametrize(
    "name", [*list(SHOWN)[:1], *(pytest.param(name, marks=pytest.mark.slow) for name in list(SHOWN)[1:])]
)
def test_the_python_lines_on_the_page_drive_what_the_page_drives(window, file, name):
    unfolded(window, file)
    window.run(f"adaptrackPage.start({{...adaptrackPage.state().setup, ...{json.dumps(SHOWN[name])}}}).then(() => 0)")
    assert window.run(f"{STATE}.notice") == ""
    window.run("adaptrackPage.advance(300)")
    names: dict = {}
    exec(window.run("document.getElementById('code-python').textContent"), names)
    run = names["run"]
    for column, of in {"x": "X", "y": "Y", "command": "command", "wheel_angle": "steering"}.items():
        numbers = window.run(f"(({{columns, count}}) => Array.from(columns.{column}.slice(0, count)))"
                          "(adaptrackPage.page.drive.history.cars[0])")  # fmt: skip
        assert len(numbers) > 60
        assert np.array_equal(numbers, getattr(run, of)[: len(numbers)]), column


@pytest.mark.parametrize("fragment", ["#%E0%A4%A", "#setup=eyJ", "#car=unicorn", "#" + "a" * 100000])
def test_a_link_that_does_not_fit_says_so_and_drives(window, file, fragment):
    unfolded(window, file, fragment)
    assert window.run("adaptrackPage.advance(5)") == 5


# -- what nobody should give ------------------------------------------------------------------------------------------
DROP = """
(async (parts, name) => {
  const file = new File(parts, name), given = new DataTransfer();
  given.items.add(file);
  document.getElementById("notice").textContent = "";
  let longest = 0, before = performance.now();
  const beat = setInterval(() => {
    longest = Math.max(longest, performance.now() - before);
    before = performance.now();
  }, 5);
  document.body.dispatchEvent(new DragEvent("drop", {dataTransfer: given, bubbles: true, cancelable: true}));
  for (let k = 0; k < 500 && !adaptrackPage.state().notice; k++) await new Promise((done) => setTimeout(done, 10));
  clearInterval(beat);
  return [adaptrackPage.state().notice, longest];
})"""
STRAIGHT = "\n".join(f"{10 * k},0" for k in range(30))
HOSTILE = {
    "100 MB": ("Array(100).fill(new Uint8Array(1e6))", "large.csv"),
    "a car of 100 MB": ("Array(100).fill(new Uint8Array(1e6))", "large.json"), "nothing": ("[]", "empty.csv"),
    "bytes": ("[new Uint8Array(1e5).map((_, i) => i * 7919 % 251)]", "bytes.csv"),
    "a kink": (json.dumps([STRAIGHT + "\n290,0\n0,1\n10,1\n"]), "kink.csv"),
    "no car": (json.dumps(['{"wheels": 3}']), "none.json"), "deep": (json.dumps(["[" * 5000]), "deep.json"),
    "a car in TOML": (json.dumps(["mass = 1500\n"]), "my-car.toml"),
}  # fmt: skip


@pytest.mark.parametrize("case", HOSTILE)
def test_a_file_that_is_none_gives_a_sentence_and_never_a_frozen_page(window, file, case):
    if window.run(f"!window.adaptrackPage || {STATE}.over"):
        unfolded(window, file)
    parts, name = HOSTILE[case]
    notice, longest = window.run(f"{DROP}({parts}, {json.dumps(name)})")
    assert re.match(r".*\w{3,} .*\w{3,}.*\.$", notice, re.DOTALL), notice
    assert len(notice) < 1200
    assert longest < 1000.0
    assert window.run("adaptrackPage.advance(5)") == 5


DROP_CAR = """
(async (text) => {
  const given = new DataTransfer();
  given.items.add(new File([text], "own.json"));
  document.body.dispatchEvent(new DragEvent("drop", {dataTransfer: given, bubbles: true, cancelable: true}));
  const car = () => adaptrackPage.state().setup.car.file;
  for (let k = 0; k < 500 && !car(); k++) await new Promise((done) => setTimeout(done, 10));
  return car();
})"""


def test_a_car_that_was_saved_is_dropped_and_driven(window, file):
    unfolded(window, file)
    saved = page_car(at.load_vehicle("van").replace(name="own"))
    car = window.run(f"{DROP_CAR}({json.dumps(json.dumps({'page_car': saved}))})")
    assert car["numbers"] == saved["numbers"]
    assert car["tyre"] == saved["tyre"]
    assert window.run("adaptrackPage.advance(5)") == 5
    for source in ({"file": car}, {"name": "van"}):
        asking = json.dumps({"type": "write", "what": "car", "car": source})
        text = window.run(f"adaptrackPage.page.engine.ask({asking}).then(({{text}}) => text)")
        assert json.loads(text)["page_car"]["numbers"] == saved["numbers"]


@pytest.mark.parametrize(
    "changes",
    [
        {"speed": {"constant": 1e9}}, {"car": {"sheet": {"mass": 0, "wheelbase": 2.5}}}, {"road": {"points": []}},
        {"profile": "dream"}, {"controllers": [{"kind": "witch"}]}, {"truth": {"lag": -1}},
        {"planner": {"start": "line"}},
        {"controllers": [{"kind": "informed", "tuning": {"Np": 0, "Nc": -1, "Q": -1, "R": 0}}]},
    ],
    ids=json.dumps,
)  # fmt: skip
def test_a_setup_that_cannot_be_driven_gives_a_sentence(window, file, changes):
    if window.run(f"!window.adaptrackPage || {STATE}.over"):
        unfolded(window, file)
    window.run(f"adaptrackPage.start({{...adaptrackPage.state().setup, ...{json.dumps(changes)}}}).catch(() => 0)")
    assert re.match(r".*\w{3,} .*\w{3,}.*\.$", window.run(f"{STATE}.notice"))
    assert window.run("adaptrackPage.advance(5)") == 5


def test_who_wants_no_motion_gets_steps(file):
    with Chromium(media=Media(still=True)) as page:
        page.open(file.as_uri())
        page.wait(READY)
        assert not page.run(f"{STATE}.playing")
        assert page.run("adaptrackPage.page.clock.reduced")
