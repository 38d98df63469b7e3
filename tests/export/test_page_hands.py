"""The page on which one drives, used: lessons, touches, drawing, how much lag is borne, what is taken along."""

import json

import pytest

import adaptrack as at
from adaptrack.core.kernel import INTERPRETED
from browsers import Chromium
from pages import STATE, open_page

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(INTERPRETED, reason="the page's kernels are compiled"),
    pytest.mark.needs("chromium"),
]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return at.export_page(tmp_path_factory.mktemp("page") / "drive.html")


@pytest.fixture(scope="module")
def chromium():
    with Chromium() as page:
        yield page


@pytest.fixture
def window(chromium, file):
    """The page, paused."""
    return open_page(chromium, file)


def click(page, name):
    page.run(f"document.getElementById('{name}').click()")


def choose(page, name, value):
    page.run(f"(each => {{ each.value = '{value}'; each.dispatchEvent(new Event('change')); }})"
             f"(document.getElementById('{name}'))")  # fmt: skip


def drive(page, periods):
    """Goes on to the newest instant; the cars."""
    page.run(f"adaptrackPage.advance({periods})")
    page.run("adaptrackPage.seek(1e9)")
    return page.run(STATE)["cars"]


def test_it_drives_by_itself(chromium, file):
    chromium.open("about:blank")
    chromium.open(file.as_uri())
    chromium.wait(f"window.adaptrackPage && {STATE}.t > 0.5", 10)


# -- lessons ----------------------------------------------------------------------------------------------------------
def test_a_lesson_sets_the_page_and_ticks_itself_when_it_was_done(chromium, file):
    window = open_page(chromium, file, "#lesson=lag")
    assert [car["failed"] for car in drive(window, 100)] == [None, None]
    assert not window.run("document.getElementById('lesson-mark').classList.contains('done')")
    click(window, "lesson-do")
    informed, blind = drive(window, 300)
    window.wait("document.getElementById('lesson-mark').classList.contains('done')", 5)
    assert informed["rms"] < 0.03 < 0.2 < blind["rms"]
    assert "0.40 s" in window.run(STATE)["events"][0]["text"]
    window.wait("location.hash.startsWith('#car=')", 5)  # no longer as the lesson set it


# -- touches ----------------------------------------------------------------------------------------------------------
def test_each_touch_is_an_event_in_words(window):
    before = drive(window, 60)[0]["most"]
    touches = ("push-left", "pull-right", "ice", "sensor-yaw_rate")
    for name in touches:
        click(window, name)
        window.run("adaptrackPage.advance(20)")
    assert drive(window, 20)[0]["most"] > 2 * before
    window.wait(f"{STATE}.events.length === {len(touches)}", 5)
    words = window.run("document.getElementById('touches').textContent")
    for word in ("Pushed to the left", "Wheel pulled to the right", "Ice laid", "Yaw rate no longer measured"):
        assert word in words


def test_a_car_that_is_dragged_is_pushed(window):
    drive(window, 20)
    x, y = window.run("(() => { const {view} = adaptrackPage.page, {x, y} = view.place(0),"
                     " [px, py] = view.toScreen(x, y), road = document.getElementById('road-canvas'),"
                     " box = road.getBoundingClientRect(); return [px + box.left, py + box.top]; })()")  # fmt: skip
    window.click(x, y, to=(x, y - 40))  # the road begins along x: up is to the left
    window.wait(f"{STATE}.events.length === 1", 5)
    assert "pushed to the left" in window.run(STATE)["events"][0]["text"]


# -- a planner --------------------------------------------------------------------------------------------------------
LATEST = """(({cars: [car]}) => {
  const {points} = car.trajectory(car.count - 1), {x, y} = car.columns, last = car.count - 1;
  return [Math.hypot(points[1] - x[last], points[2] - y[last]), points.length / 5];
})(adaptrackPage.page.drive.history)"""
"""Distance (m) of the car from the beginning of the planner's last trajectory, and its number of points."""


def test_a_planner_is_chosen_touched_and_silenced(window):
    assert window.run("document.getElementById('more-planner').hidden")
    choose(window, "setup-planner", "pose")
    window.wait(f"{STATE}.setup.planner && !adaptrackPage.page.drive.busy", 5)
    window.run("adaptrackPage.pause()")
    assert not window.run("document.getElementById('more-planner').hidden")
    (car,) = drive(window, 100)
    distance, count = window.run(LATEST)
    assert 0.2 * car["last"]["vx"] < distance < 0.6 * car["last"]["vx"]  # 0.3 s ago
    assert count > 20
    assert car["rms"] < 0.1
    assert "the planner drives" in window.run("document.getElementById('score').innerText")
    window.run("(each => { each.value = '0.6'; each.dispatchEvent(new Event('input')); })"
               "(document.getElementById('touch-planner-delay'))")  # fmt: skip
    window.wait(f"{STATE}.events.length === 1 && !{STATE}.touching", 5)
    speed = drive(window, 60)[0]["last"]["vx"]
    assert window.run(f"{STATE}.setup.planner.delay") == 0.6
    assert window.run(LATEST)[0] > 0.4 * speed
    click(window, "silence")
    window.wait(f"{STATE}.events.length === 2", 5)
    (car,) = drive(window, 300)
    assert car["last"]["vx"] < 0.01 * speed
    window.wait("document.getElementById('score').innerText.includes('no trajectory comes: it stops')", 5)


def test_a_link_holds_the_planner_and_a_drive_without_one_has_none(chromium, file):
    link = "#road=town&planner=line&planner.delay=0.25&planner.noise=0.05&c1=lqr"
    setup = open_page(chromium, file, link).run(f"{STATE}.setup")
    assert setup["planner"] == {"period": 0.1, "delay": 0.25, "noise": 0.05, "start": "line"}
    assert setup["controllers"][0]["speed_control"] == {"friction": 0.9}
    address = chromium.run("location.hash")
    assert open_page(chromium, file, address).run(f"{STATE}.setup") == setup
    assert "--planner period=0.1,delay=0.25,noise=0.05,start=line" in chromium.run(
        "document.getElementById('code-command').textContent"
    )
    choose(chromium, "setup-speed-control", "")
    chromium.wait(f"!{STATE}.setup.planner && !{STATE}.setup.controllers[0].speed_control", 5)
    assert "planner" not in chromium.run("location.hash")


# -- a road of one's own ----------------------------------------------------------------------------------------------
def test_a_road_is_drawn_with_the_pointer_and_with_keys(window):
    choose(window, "setup-road", "draw")
    box = "document.getElementById('road-canvas').getBoundingClientRect()"
    left, top, width, height = window.run(f"(({{x, y, width, height}}) => [x, y, width, height])({box})")
    window.click(left + 0.1 * width, top + 0.6 * height, to=(left + 0.9 * width, top + 0.4 * height))
    window.wait(f"{STATE}.setup.road.points && {STATE}.cars[0].count > 0", 10)
    pointed = window.run(STATE)["setup"]["road"]["points"]
    choose(window, "setup-road", "draw")
    window.wait("document.activeElement.id === 'road-canvas'", 5)
    for _ in range(6):
        window.press("ArrowRight", shift=True, times=2)
        window.press("ArrowUp")
        window.press("Enter")
    window.press("d")
    window.wait(f"{STATE}.setup.road.points.length === 6 && {STATE}.cars[0].count > 0", 10)
    assert len(pointed) >= 4
    assert window.run(STATE)["notice"] == ""


# -- mishaps ----------------------------------------------------------------------------------------------------------
def test_a_worker_that_dies_is_begun_anew_with_a_sentence(window):
    window.run("adaptrackPage.page.engine.die('a test')")
    window.wait(f"{STATE}.notice.includes('begun anew') && {STATE}.cars[0].count > 0", 10)
    assert window.run("adaptrackPage.advance(5)") == 5


def test_a_car_that_leaves_the_road_says_what_helps(window):
    window.run(f"adaptrackPage.start({{...{STATE}.setup, truth: {{lag: 1}}}})")
    drive(window, 1000)
    window.wait("!document.getElementById('verdict').hidden", 5)
    assert "let the controller know the lag" in window.run("document.getElementById('verdict').textContent")


# -- in words, and out again ------------------------------------------------------------------------------------------


def test_the_drive_is_saved_as_csv(window):
    drive(window, 50)
    window.run("window.saved = null, URL.createObjectURL = (blob) => { blob.text().then((t) => { saved = t; });"
              " return '#'; }, HTMLAnchorElement.prototype.click = () => {}")  # fmt: skip
    click(window, "csv-0")
    window.wait("window.saved !== null", 10)
    lines = [line for line in window.run("saved").splitlines() if not line.startswith("#")]
    assert len(lines) >= 50
    assert json.dumps(window.said()) == "[]"
