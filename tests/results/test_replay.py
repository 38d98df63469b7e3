"""The replay in a browser: it opens without errors, plays, and shows the car where it was."""

import re

import numpy as np
import pytest

from adaptrack.results.drive import write_drive_page
from adaptrack.results.record import REPLAYED_SIGNALS
from browsers import Chromium
from made_drives import bend, made_run, recorded
from pages import check_that_space_plays

pytestmark = pytest.mark.needs("chromium")

INSTANTS = (2.0, 9.13, 17.5)

ASK = """(async () => {
const found = {}, replay = window.adaptrackReplay, canvas = document.querySelector("#replay-view canvas");
const part = name => document.querySelector(`#replay-view :is([data-replay="${name}"], [data-part="${name}"])`);
const press = key => canvas.dispatchEvent(new KeyboardEvent("keydown", {key, bubbles: true, cancelable: true}));
const until = async condition => { while (!condition()) await new Promise(resolve => setTimeout(resolve, 20)); };
function colourAt([x, y]) {
  const dot = new OffscreenCanvas(1, 1).getContext("2d"), dense = canvas.width / canvas.clientWidth;
  dot.drawImage(canvas, -Math.round(x * dense), -Math.round(y * dense));
  return [...dot.getImageData(0, 0, 1, 1).data];
}
%s
return {...found, width: innerWidth, overflow: document.documentElement.scrollWidth - innerWidth};
})()"""


def ask_page(path, script, width=1400, fragment=""):
    """What `script` put into `found`, in the page at `path`, `width` pixels wide, which says nothing to the console."""
    with Chromium((width, 900)) as window:
        window.open(path.as_uri() + fragment)
        answer = window.run(ASK % script)
        assert window.said() == []
    return answer


@pytest.fixture(scope="module")
def runs():
    road = bend()
    return [
        made_run(road, controller="informed", amplitude=0.5),
        made_run(road, controller="stanley", amplitude=1.0, seconds=10.05, failed="spun", failed_at=10.0),
    ]


@pytest.fixture(scope="module")
def drives(runs):
    return [recorded(run) for run in runs]


@pytest.fixture(scope="module")
def page(tmp_path_factory, runs):
    return write_drive_page(tmp_path_factory.mktemp("replay") / "out", runs)


SEEK = (
    f"found.seen = {list(INSTANTS)}.map(t => {{"
    """
      replay.seek(t);
      const near = replay.state(), colour = colourAt(near.cars[0].pixel), beside = colourAt([5, 5]);
      const words = ["t", "s", "e", "v", "steering"].map(name => part(name).textContent);
      return {near, colour, beside, words};
    });
    replay.showWhole();
    found.whole = [2, 17.5].map(t => { replay.seek(t); return replay.state(); });
    replay.followCar();
"""
)


@pytest.fixture(scope="module", params=[1400, 400])
def answers(request, page):
    answer = ask_page(page, SEEK, request.param)
    assert answer["width"] == request.param
    return answer


def test_the_car_is_where_it_was_at_three_instants(answers, drives):
    for t, view in zip(INSTANTS, answers["seen"], strict=True):
        for drive, car in zip(drives, view["near"]["cars"], strict=True):
            when = min(t, float(drive.run.t[-1]))
            for name in ("x", "y", "yaw", "station", "speed", "offset", "steering"):
                value = np.interp(when, drive.run.t, REPLAYED_SIGNALS[name][0](drive.run))
                assert car[name] == pytest.approx(value, abs=6e-3), name


def test_the_followed_car_is_drawn_at_the_middle_of_the_picture(answers):
    for view in answers["seen"]:
        state = view["near"]
        assert state["follow"]
        assert state["cars"][0]["pixel"] == pytest.approx([0.5 * state["width"], 0.5 * state["height"]])
        red, _, blue, opaque = view["colour"]  # the first series is blue, the road grey
        assert blue - red > 60
        assert opaque == 255


def test_the_whole_road_is_shown_to_scale_with_the_car_in_it(answers, drives):
    first, last = answers["whole"]
    assert first["whole"]
    ends = [np.array(state["cars"][0]["pixel"]) for state in (first, last)]
    run = drives[0].run
    there = [np.array([np.interp(t, run.t, v) for v in (run.X, run.Y)]) for t in (2.0, 17.5)]
    assert (ends[1] - ends[0]) * [1, -1] == pytest.approx(first["scale"] * (there[1] - there[0]), abs=0.2)
    for pixel in ends:
        assert 0.0 < pixel[0] < first["width"]
        assert 0.0 < pixel[1] < first["height"]


def test_values_stand_beside_the_picture(answers, drives):
    drive = drives[0]
    words = answers["seen"][0]["words"]
    assert words[0] == "2.00 s"
    assert words[1] == "20.0 m"
    assert words[3] == "10.00 m/s"
    assert float(words[2].split()[0]) == pytest.approx(np.interp(2.0, drive.run.t, drive.offset), abs=1e-3)
    degrees, radians = (float(text) for text in re.findall(r"−?[\d.]+", answers["seen"][1]["words"][4]))
    assert radians == pytest.approx(np.interp(9.13, drive.run.t, drive.run.steering), abs=1e-4)
    assert degrees == pytest.approx(np.degrees(radians), abs=0.01)


def test_nothing_is_wider_than_the_window(answers):
    assert answers["overflow"] <= 0


def test_it_plays_pauses_and_ends(page):
    answer = ask_page(
        page,
        """
        part("play").click();
        await until(() => replay.state().t > 0.5);
        found.playing = replay.state();
        part("play").click();
        found.paused = replay.state();
        await new Promise(resolve => setTimeout(resolve, 200));
        found.later = replay.state();
        part("rate").value = "5";
        part("rate").dispatchEvent(new Event("change"));
        replay.seek(17);
        replay.play();
        await until(() => !replay.state().playing);
        found.ended = replay.state();
        found.again = (replay.play(), replay.state());""",
    )
    assert answer["playing"]["playing"]
    assert not answer["paused"]["playing"]
    assert answer["later"]["t"] == answer["paused"]["t"]
    assert answer["ended"]["t"] == pytest.approx(18.25, abs=0.03)
    assert answer["again"]["t"] == 0.0


def test_keys_slider_wheel_and_drag_do_what_they_say(page):
    answer = ask_page(
        page,
        """
        replay.seek(5);
        press("ArrowRight"); found.on = replay.state().t;
        press("ArrowLeft"); press("ArrowLeft"); found.back = replay.state().t;
        press("End"); found.end = replay.state().t;
        press("Home"); found.home = replay.state().t;
        press(" "); found.played = replay.state().playing; press(" ");
        const slider = part("slider");
        slider.value = 7.5; slider.dispatchEvent(new Event("input")); found.slid = replay.state().t;
        found.spoken = slider.getAttribute("aria-valuetext");
        const before = replay.state().scale;
        press("+"); found.zoomed = replay.state().scale / before;
        canvas.dispatchEvent(new WheelEvent("wheel", {deltaY: -200, cancelable: true}));
        found.wheeled = replay.state().scale / before;
        found.follows = replay.state().follow;
        const at = (kind, id, x, y) => canvas.dispatchEvent(
          new PointerEvent(kind, {pointerId: id, clientX: x, clientY: y, bubbles: true, pointerType: "mouse"}));
        canvas.setPointerCapture = () => {};
        const [x, y] = replay.state().cars[0].pixel;
        at("pointerdown", 1, 100, 100); at("pointermove", 1, 160, 130); at("pointerup", 1, 160, 130);
        const moved = replay.state().cars[0].pixel;
        found.moved = [moved[0] - x, moved[1] - y];
        found.free = !replay.state().follow;
        const wide = replay.state().scale;
        at("pointerdown", 1, 100, 100); at("pointerdown", 2, 200, 100); at("pointermove", 2, 300, 100);
        found.pinched = replay.state().scale / wide;
        at("pointerup", 1, 100, 100); at("pointerup", 2, 300, 100);
        const car = part("car");
        car.value = "1"; car.dispatchEvent(new Event("change")); replay.followCar(); replay.seek(18);
        found.other = replay.state();
        found.words = part("t").textContent;
        const controls = document.querySelector("#replay-view").querySelectorAll("button, select, input, canvas");
        found.names = [...controls].map(
          each => each.getAttribute("aria-label") || each.closest("label")?.textContent || each.textContent);""",
    )
    assert (answer["on"], answer["back"], answer["home"]) == (6.0, 4.0, 0.0)
    assert answer["end"] == pytest.approx(18.25, abs=0.03)
    assert answer["played"]
    assert answer["slid"] == 7.5
    assert answer["spoken"].startswith("7.50 s, station 75.0 m, offset ")
    assert answer["zoomed"] == pytest.approx(1.4)
    assert answer["wheeled"] > 1.4
    assert answer["follows"]
    assert answer["free"]
    assert answer["moved"] == pytest.approx([60.0, 30.0])
    assert answer["pinched"] == pytest.approx(2.0)
    other = answer["other"]
    assert other["cars"][1]["pixel"] == pytest.approx([0.5 * other["width"], 0.5 * other["height"]])
    assert other["cars"][1]["failed"]
    assert answer["words"] == "18.00 s failed"
    assert all(name.strip() for name in answer["names"])


@pytest.mark.parametrize("size", [(1400, 900), (400, 800)])
def test_the_replay_is_in_the_first_screen_and_its_keys_work_without_a_click(page, size):
    state = "adaptrackReplay.state()"
    with Chromium(size) as window:
        window.open(page.as_uri())
        bottoms = window.run(
            "['#replay-view canvas', '#replay-view [data-part=play]'].map("
            "each => document.querySelector(each).getBoundingClientRect().bottom)"
        )
        assert max(bottoms) < size[1]
        window.press("ArrowRight", times=3)
        assert window.run(f"{state}.t") == pytest.approx(3.0)
        window.press("ArrowLeft")
        assert window.run(f"{state}.t") == pytest.approx(2.0)
        check_that_space_plays(window, state)
        assert window.run("scrollY") == 0
        window.press("End")  # the page's own, where the replay does not have the focus
        assert window.run(f"{state}.t") < 5.0
        window.run("document.querySelector('.table').focus()")
        window.press(" ")
        assert not window.run(f"{state}.playing")


def test_no_script_runs_but_the_replay(page, tmp_path):
    written = "<script>window.evil = true;</script>"
    other = tmp_path / "other.html"
    other.write_text(page.read_text(encoding="utf-8").replace("</main>", written + "</main>"), encoding="utf-8")
    with Chromium() as window:
        window.open(other.as_uri())
        assert window.run("window.evil ?? null") is None
        assert any("Content Security Policy" in line for line in window.said())


def test_a_link_to_an_instant_opens_there(page):
    answer = ask_page(page, "found.t = replay.state().t;", fragment="#t=12.5")
    assert answer["t"] == 12.5
