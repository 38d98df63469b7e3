"""What draws a drive in the browser, on a replay page and while it is driven: its plots tell the numbers they are given."""

from importlib.resources import files

import numpy as np
import pytest

import browser
from adaptrack.drive.predicted import PredictedPaths
from adaptrack.results.drive import write_drive_page
from adaptrack.results.replay import SCRIPTS, STYLE
from browser import Served
from made_drives import bend, made_drive
from test_replay import COLLECT, NOTHING_ELSE, ask_page

pytestmark = pytest.mark.skipif(browser.PROGRAM is None, reason=browser.NONE)


def predicted_of(drive, ahead=1.0, points=8):
    """Paths that foretell where the car will be, up to so many seconds ahead."""
    paths = PredictedPaths(points=points)
    paths._time = list(drive.time[::5][:-4])
    later = np.add.outer(np.array(paths._time), np.linspace(ahead / points, ahead, points))
    paths._points = list(np.stack([np.interp(later, drive.time, v) for v in (drive.x, drive.y)], axis=-1))
    return paths


@pytest.fixture(scope="module")
def drives():
    road = bend()
    first = made_drive(road, controller="informed", amplitude=0.5)
    return [
        made_drive(road, controller="informed", amplitude=0.5, predicted=predicted_of(first)),
        made_drive(road, controller="stanley", amplitude=1.0, planned_speed=np.full(len(first), 11.0)),
    ]


@pytest.fixture(scope="module")
def seen(tmp_path_factory, drives):
    page = write_drive_page(tmp_path_factory.mktemp("viewer") / "out", drives, png=False)
    return ask_page(
        page,
        """
        const {plots, clock, history, view} = replay, named = name => plots.list.find(plot => plot.name === name);
        found.plots = plots.list.map(plot => plot.name);
        plots.setSpan(0); plots.draw();
        found.round = plots.list.map(plot => [[3.5, 0.1], [17, -0.02]].map(([t, value]) => {
          const there = plot.toValue(...plot.toPixel(t, value)); return [there[0] - t, there[1] - value]; }));
        const error = named("error");
        found.thinned = error.lines.map(line => {
          const drawn = [...error.decimated(line)], values = line.car.columns[line.column];
          const narrow = drawn.map(i => values[i]);
          return {drawn: drawn.length, low: Math.min(...narrow), high: Math.max(...narrow),
                  all: [line.car.count, Math.min(...values), Math.max(...values)], grows: drawn.every((i, k) => !k || i > drawn[k - 1])};
        });
        // the cursor: under the pointer of one plot, in all of them and on the road
        replay.seek(4);
        const box = error.canvas.getBoundingClientRect(), [px, py] = error.toPixel(9.13, 0);
        const point = (kind, more = {}) => error.canvas.dispatchEvent(new PointerEvent(kind, {pointerId: 7, pointerType: "mouse", bubbles: true,
          clientX: box.left + px, clientY: box.top + py, ...more}));
        error.canvas.setPointerCapture = () => {};
        const frame = () => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
        point("pointermove"); await frame();
        found.cursor = {shown: clock.shown, t: clock.t, texts: plots.list.map(plot => plot.values.map(value => value.textContent)),
          now: plots.list.map(plot => +plot.canvas.getAttribute("aria-valuenow")), place: {...view.place(0)}, words: part("t").textContent};
        point("pointerleave"); await frame();
        found.left = {shown: clock.shown, x: view.place(0).x};
        point("pointerdown"); point("pointerup"); await frame();
        found.clicked = replay.state().t;
        error.canvas.focus();
        const key = (name, more = {}) => error.canvas.dispatchEvent(new KeyboardEvent("keydown", {key: name, bubbles: true, cancelable: true, ...more}));
        key("End"); key("ArrowLeft", {shiftKey: true}); await frame();
        found.byKey = {shown: clock.shown, t: clock.t, told: error.canvas.getAttribute("aria-valuetext")};
        key("Enter"); found.entered = clock.t;
        // the driven line, too
        replay.seek(8); replay.state();
        const {columns} = history.cars[0], k = columns.time.findIndex(t => t >= 6), [rx, ry] = view.toScreen(columns.x[k], columns.y[k]);
        const road = canvas.getBoundingClientRect();
        canvas.dispatchEvent(new PointerEvent("pointermove", {pointerId: 9, pointerType: "mouse", clientX: road.left + rx, clientY: road.top + ry}));
        found.onRoad = clock.shown;
        clock.leave(); replay.seek(5);
        found.said = [view.describe(), error.describe()];
        part("aloud").click(); found.aloud = part("spoken").textContent;
        const path = history.cars[0].predicted(columns.time.findIndex(t => t >= 5));
        found.predicted = {x: [...path.x], y: [...path.y]};
        found.none = history.cars[1].predicted(50);
        found.late = history.cars[0].predicted(history.cars[0].count - 1);
        """,
    )


def test_a_value_goes_to_a_pixel_and_back(seen):
    assert seen["plots"] == ["error", "steering", "speed"]
    assert np.abs(seen["round"]).max() < 1e-9


def test_a_thinned_line_keeps_its_extremes(seen):
    for line in seen["thinned"]:
        assert [line["low"], line["high"]] == line["all"][1:]
        assert line["drawn"] <= line["all"][0]
        assert line["grows"]


def test_one_cursor_goes_through_all_plots_and_the_road(seen, drives):
    cursor, drive = seen["cursor"], drives[0]
    assert cursor["t"] == 4.0
    assert cursor["shown"] == pytest.approx(9.13, abs=0.02)
    assert cursor["now"] == pytest.approx([cursor["shown"]] * 3, abs=0.006)
    assert cursor["place"]["x"] == pytest.approx(np.interp(cursor["shown"], drive.time, drive.x), abs=5e-3)
    assert cursor["words"] == f"{cursor['shown']:.2f} s"
    told = [[float(text.replace("−", "-").split()[0].rstrip("°")) for text in plot] for plot in cursor["texts"]]
    at = cursor["shown"]
    assert told[0] == pytest.approx([np.interp(at, each.time, each.offset) for each in drives], abs=2e-3)
    assert told[1][:2] == pytest.approx([np.degrees(np.interp(at, drive.time, drive.steering))] * 2, abs=0.02)
    assert told[2] == pytest.approx([10.0, 10.0], abs=0.02)
    assert seen["left"]["shown"] == 4.0
    assert seen["left"]["x"] == pytest.approx(np.interp(4.0, drive.time, drive.x), abs=5e-3)
    assert seen["onRoad"] == pytest.approx(6.0, abs=0.11)


def test_a_click_and_enter_go_where_the_cursor_is(seen, drives):
    assert seen["clicked"] == pytest.approx(9.13, abs=0.02)
    by_key = seen["byKey"]
    assert by_key["t"] == seen["clicked"]
    assert by_key["shown"] == pytest.approx(float(drives[0].time[-1]) - 1.0, abs=0.06)
    assert by_key["told"].startswith(f"{by_key['shown']:.2f} s: Informed −0")
    assert seen["entered"] == by_key["shown"]


def test_what_is_shown_is_told_in_words(seen, drives):
    road, error = seen["said"]
    e = float(np.interp(5.0, drives[0].time, drives[0].offset))
    assert f"Informed is {abs(e):.2f} m to the {'left' if e > 0 else 'right'} of its line" in road
    assert "at 10.0 m/s" in road
    low, high = (pick(drives[0].offset) for pick in (np.min, np.max))
    assert f"Error at 5.00 s: Informed {e:.3f} m".replace("-", "−") in error
    assert f"goes from −{-low:.3f} m" in error
    assert f"to {high:.3f} m" in error
    assert road in seen["aloud"]
    assert error in seen["aloud"]


def test_the_predicted_path_lies_where_it_was_predicted(seen, drives):
    paths = drives[0].predicted
    k = int(np.argmin(np.abs(paths.time - 5.0)))
    found = np.column_stack([seen["predicted"][name] for name in "xy"])
    assert found == pytest.approx(paths.points[k], abs=0.02)
    assert seen["none"] is None
    assert seen["late"] is None


# -- a drive that grows -----------------------------------------------------------------------------------------------
LIVE = """
<canvas class="road-view" id="road" tabindex="0" style="height: 400px"></canvas><div id="controls"></div><div id="plots"></div>
<script>(() => {
%s
const road = {name: "straight", closed: false, length: 400};
const s = Float64Array.from({length: 401}, (_, i) => i), at = y => s.map(() => y);
Object.assign(road, {x: s, y: at(0), left_x: s, left_y: at(3), right_x: s, right_y: at(-3)});
const columns = ["time", "x", "y", "yaw", "vx", "wheel_angle", "command", "station", "offset", "error", "belief_lag", "belief_lag_sigma", "Np", "guard"];
const outline = {front: 2, rear: 2, width: 1.8, lf: 1.2, lr: 1.3, track_front: 1.5, track_rear: 1.5};
const car = name => ({name, columns, horizon: 4, moves: 3, outline, limits: {angle: 0.5, move: 0.02}});
const history = makeHistory({period: 0.1, road, cars: [car("a"), car("b")]}, {top: 0.5, shades: ["#00f", "#f00"]});
function frames(first, count) {
  const each = k => {
    const numbers = [], predicted = [], moves = [];
    for (let i = first; i < first + count; i++) {
      const t = i * 0.1, e = 0.2 * Math.sin(t) * (k + 1);
      numbers.push(t, 10 * t, e, 0, 10, 0.01, 0.02, 10 * t, e, e, 0.2, 0.05, 20, Math.floor(i / 10));
      predicted.push(10 * t + 1, 0, 10 * t + 2, 0, k ? NaN : 10 * t + 3, 0, k ? NaN : 10 * t + 4, 0);
      moves.push(0.01, -0.02, NaN);
    }
    return {numbers: Float64Array.from(numbers), predicted: Float32Array.from(predicted), moves: Float32Array.from(moves), ended: null};
  };
  return {first, count, cars: [each(0), each(1)]};
}
appendFrames(history, frames(0, 60));
history.truth.belief_lag = [{time: 0, value: 0.2}, {time: 3, value: 0.3}];
history.patches.push({from: 55, to: 65, friction: 0.2});
const clock = makeClock({start: 0, end: lastTime(history), period: 0.1, live: true}), pushed = [], drawn = [];
const canvas = document.getElementById("road"), view = makeRoadView(canvas, history, clock, {onpush: (...words) => pushed.push(words)});
makeTransport(document.getElementById("controls"), clock, {view, keys: document.body});
const plots = makePlots(document.getElementById("plots"), history, clock);
window.live = {history, frames, clock, view, plots, pushed, drawn, canvas, appendFrames, lastTime, RECENT, COARSE};
})();</script>
"""


def ask_live(script):
    page = files("adaptrack.export").joinpath("page")
    scripts = "\n".join(page.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    style = "<style>%s</style>" % page.joinpath(STYLE).read_text(encoding="utf-8")
    collect = COLLECT.replace("replay = window.adaptrackReplay", "{live} = window").replace(
        'const canvas = document.querySelector("#replay-view canvas");', "const {canvas} = live;"
    )
    page = (
        f"<!doctype html><meta charset='utf-8'><link rel='icon' href='data:,'>{style}{LIVE % scripts}{collect % script}"
    )
    found, said = browser.ask({"/": Served(page, NOTHING_ELSE)})
    assert found["failures"] == []
    assert said == []
    return found


@pytest.fixture(scope="module")
def live():
    return ask_live(
        """
        const {history, frames, clock, view, plots, pushed, drawn} = live, [a, b] = history.cars;
        const at = (kind, x, y) => { const box = canvas.getBoundingClientRect(); canvas.dispatchEvent(new PointerEvent(kind,
          {pointerId: 1, clientX: box.left + x, clientY: box.top + y, bubbles: true, pointerType: "mouse"})); };
        canvas.setPointerCapture = () => {};
        found.plots = plots.list.map(plot => plot.name);
        found.gap = live.appendFrames(history, frames(99, 5));
        clock.seek(5.9); clock.play();
        await new Promise(done => setTimeout(done, 150));
        found.waits = [clock.t, clock.playing];
        for (let n = 60; n < 6000; n += 500) live.appendFrames(history, frames(n, 500));
        clock.grow(live.lastTime(history));
        await until(() => clock.t > 5.95);
        found.goes = true; clock.pause();
        found.count = a.count; found.last = a.columns.time[a.count - 1];
        const starts = i => a.predicted(i).x[0] - 1 - 10 * a.columns.time[i];
        found.recent = starts(a.count - 3); found.old = [8 * 100 + 5, 8 * 100].map(starts);
        found.predicted = [a.predicted(50).count, b.predicted(50).count];
        const plan = a.moves(50); found.moves = [[...plan.values.slice(0, plan.count)], plan.least, plan.most];
        clock.seek(6); view.draw();
        found.ice = colourAt(view.toScreen(60.3, 2.4)); found.tar = colourAt(view.toScreen(53, 2.2));
        const [px, py] = view.toScreen(view.place(0).x, view.place(0).y);
        at("pointerdown", px, py); at("pointermove", px + 20, py - 30); at("pointerup", px + 20, py - 30);
        found.pushed = pushed; found.scale = view.scale; found.follows = view.follow;
        found.told = plots.list.find(plot => plot.name === "lag").describe();
        found.movesTold = plots.list.find(plot => plot.name === "moves").describe();
        view.look({x: 0, y: 0, scale: 2});
        view.startDrawing((points, closed) => drawn.push([points, closed]));
        at("pointerdown", 100, 100);
        for (let i = 1; i <= 20; i++) at("pointermove", 100 + 10 * i, 100);
        at("pointerup", 300, 100);
        found.expected = view.toWorld(300, 100);
        view.startDrawing((points, closed) => drawn.push([points, closed]));
        for (const key of ["Enter", "ArrowRight", "Enter", "ArrowUp", "Enter", "c"]) press(key);
        view.startDrawing((points, closed) => drawn.push([points, closed]));
        press("Escape");
        found.drawn = drawn;
        """
    )


def test_a_live_clock_waits_for_frames_and_goes_on(live):
    assert live["gap"] is False
    assert live["waits"] == [pytest.approx(5.9), True]
    assert live["goes"]
    assert live["count"] == 6060
    assert live["last"] == pytest.approx(605.9)


def test_predicted_paths_are_kept_whole_at_last_and_now_and_then_before(live):
    assert live["recent"] == pytest.approx(0.0, abs=1e-3)
    assert live["old"] == pytest.approx([-5.0, 0.0], abs=1e-3)  # the path of five periods before, and its own
    assert live["predicted"] == [4, 2]
    assert live["moves"] == [pytest.approx([0.01, -0.02]), -0.02, 0.02]


def test_a_belief_is_told_with_its_interval_and_the_truth(live):
    assert {"error", "steering", "moves", "speed", "lag", "horizons"} <= set(live["plots"])
    assert "a 0.200 ± 0.100 s, b 0.200 ± 0.100 s, true 0.300 s" in live["told"]
    assert "a plans 2 moves, the next 0.57°, the largest 1.15° of at most ±1.15°" in live["movesTold"]


def test_ice_lies_on_the_road_where_it_was_laid(live):
    assert live["ice"][2] > live["tar"][2]
    assert live["ice"][:3] != live["tar"][:3]


def test_a_car_that_is_dragged_tells_how_far_in_its_own_axes(live):
    ((_, vector),) = live["pushed"]
    assert [vector["x"], vector["y"]] == pytest.approx([20.0 / live["scale"], 30.0 / live["scale"]])
    assert live["follows"]


def test_a_road_is_drawn_by_hand_and_by_keyboard(live):
    stroke, keyed, given_up = live["drawn"]
    assert stroke[0][-1] == pytest.approx(live["expected"])
    assert len(stroke[0]) == 21
    assert not stroke[1]
    assert np.diff(keyed[0], axis=0).tolist() == [[5.0, 0.0], [0.0, 5.0]]
    assert keyed[1]
    assert given_up == [None, False]
