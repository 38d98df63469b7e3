"""The page on which one drives: one file, opened from anywhere, that drives as Python does."""

import json
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import adaptrack as at
import page_drives
from adaptrack import cli
from adaptrack.core.kernel import INTERPRETED
from adaptrack.drive.planner import SimulatedPlanner
from adaptrack.export import page_file
from adaptrack.export.page_setup import road_of
from adaptrack.results.record import offset_scale
from browsers import BROWSERS
from pages import READY, STATE, differing, drive, export_page, open_page, serve
from programs import find_program, run_program

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="the page's kernels are compiled")]


TURN = np.linspace(0.0, np.pi, 60)
TIGHT = np.concatenate([
    np.stack([np.linspace(-60.0, -1.0, 30), np.zeros(30)], axis=-1),
    np.stack([2.5 * np.sin(TURN), 2.5 - 2.5 * np.cos(TURN)], axis=-1),
]).tolist()  # fmt: skip
"""A straight and half a circle of 2.5 m: tighter than a car can turn."""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The file."""
    return export_page(tmp_path_factory.mktemp("page"))


@pytest.fixture(scope="module", params=BROWSERS)
def browser_window(request):
    find_program(request.param)
    with BROWSERS[request.param]() as window:
        yield window


# -- one file ---------------------------------------------------------------------------------------------------------
def test_the_page_is_one_file_of_at_most_three_megabytes(page):
    text = page.read_text(encoding="utf-8")
    assert page.stat().st_size <= 3_000_000
    assert list(page.parent.iterdir()) == [page]
    assert not re.findall(r'(?:src|href)="(?!#|data:)(?!https://)[^"]', text)
    assert "default-src 'none'" in text


def test_files_of_a_script_share_no_name():
    pages = {path.name for path in page_file.PAGE_SOURCES.glob("*.js")} - set(page_file.ENGINE)
    for names in (pages, page_file.ENGINE):
        clashes = [
            name
            for clash in sorted(names)
            for name in re.findall(
                r"^(?:async )?(?:function\*? |class |const |let )(\w+)",
                (page_file.PAGE_SOURCES / clash).read_text(),
                re.M,
            )
        ]
        assert sorted(name for name in set(clashes) if clashes.count(name) > 1) == []


def test_scripts_of_the_page_can_be_read():
    pages = {path.name for path in page_file.PAGE_SOURCES.glob("*.js")} - set(page_file.ENGINE)
    for script in (page_file._together(page_file.ENGINE), page_file._together(tuple(sorted(pages)))):
        run_program("node", "--check", "-", input=script)
        assert "</script" not in script


def test_the_colours_of_the_trail_reach_as_far_as_those_of_the_replay():
    """To a round number above the largest error of the cars that did not fail; above most errors where all failed."""
    rng = np.random.default_rng(4)
    drives = [
        [(rng.exponential(scale) * rng.normal(size=200), failed) for failed in failures]
        for scale in (0.01, 0.05, 0.3, 4.0)
        for failures in ((False,), (False, False), (False, True), (True,))
    ]
    cars = [
        [{"count": 200, "failed": 9.0 if failed else None, "largest": np.abs(error).max(),
          "columns": {"error": error.tolist()}} for error, failed in drive]
        for drive in drives
    ]  # fmt: skip
    history = (page_file.PAGE_SOURCES / "history.js").read_text()
    script = (
        f"{history}\nconst drives = {json.dumps(cars)};"
        "for (const {columns} of drives.flat()) columns.error = Float64Array.from(columns.error);"
        "console.log(JSON.stringify(drives.map(topOf)));"
    )
    expected = [
        offset_scale([
            SimpleNamespace(failure=failed or None, max_offset=size.max(), p95_offset=np.percentile(size, 95))
            for size, failed in ((np.abs(error), failed) for error, failed in drive)
        ])
        for drive in drives
    ]  # fmt: skip
    assert json.loads(run_program("node", "-", input=script)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("options", "message"), [
    ({"road": "moutain"}, "no road 'moutain'. Did you mean 'mountain'"),
    ({"profile": "rode"}, "no profile 'rode'"),
    ({"controllers": ["inform"]}, "no controller 'inform'. Did you mean 'informed'"),
    ({"controllers": []}, "one or two"),
    ({"controllers": ["lqr"] * 3}, "one or two"),
    ({"speed": 10.0, "lateral_acceleration": 2.0}, "either speed or lateral_acceleration"),
    ({"road": [[0.0, 1.0, 2.0]]}, "x and y of each point"),
    ({"vehicle": "paprika"}, "paprika"),
    ({"speed": 99.0}, "speed (m/s) = 99.0: the page drives 1 to 60"),
    ({"speed": 55.0}, "the wheels must turn at"),
    ({"lateral_acceleration": 0.0}, "lateral_acceleration (m/s^2) = 0.0: the page drives 0.5 to 12"),
    ({"road": TIGHT}, "points, s = 60 to 60 m: the wheels must turn at"),
    ({"profile": "production", "controllers": ["published"]}, "does not measure vy"),
    ({"planner": SimulatedPlanner(jitter=0.1)}, "the page has period, delay, noise, start"),
    ({"planner": SimulatedPlanner(delay=3.0)}, "delay = 3.0: the page has 0 to 2"),
    ({"planner": SimulatedPlanner(), "controllers": ["published-nn"]}, "has a scheduler"),
])  # fmt: skip
def test_what_the_page_cannot_drive_is_refused_before_it_is_written(options, message, tmp_path):
    with pytest.raises(at.InvalidInput, match=re.escape(message)):
        at.export_page(tmp_path / "drive.html", **options)
    assert not list(tmp_path.iterdir())


def test_a_recorded_lap_is_fitted_and_closed_before_the_page_drives_it(tmp_path):
    turn, noise = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False), np.random.default_rng(3).normal(size=(400, 2))
    points = np.stack([120.0 * np.cos(turn), 60.0 * np.sin(turn)], axis=-1) + 0.05 * noise
    file = tmp_path / "lap.csv"
    np.savetxt(file, points, delimiter=",", header="x,y", comments="", fmt="%.3f")
    road = road_of(page_file._road(file))
    x, y, _, curvature = road.at(np.linspace(0.0, road.length, 2000))[:4]
    tightest = 120.0 / 60.0**2  # 1/m, of the ellipse
    assert road.closed
    assert np.abs(np.hypot(x / 120.0, y / 60.0) - 1.0).max() * 60.0 < 0.05
    assert np.abs(curvature).max() == pytest.approx(tightest, rel=0.1)


def run_command(monkeypatch, capsys, *words):
    monkeypatch.setattr(sys, "argv", ["adaptrack", "export", "page", *map(str, words)])
    code = cli.main()
    return code, *capsys.readouterr()


def test_the_command_writes_the_same_page_and_says_how_large_it_is(monkeypatch, capsys, tmp_path, page):
    out = tmp_path / "new" / "drive.html"
    code, report, _ = run_command(monkeypatch, capsys, "--out", out, "--json")
    assert code == 0
    assert json.loads(report) == {"file": str(out), "bytes": out.stat().st_size}
    assert out.read_bytes() == page.read_bytes()
    code, _, _ = run_command(monkeypatch, capsys, "--out", out, "--planner", "delay=0.3")
    assert code == 0
    assert out.read_bytes() != page.read_bytes()


def test_the_command_refuses_a_folder_by_name(monkeypatch, capsys, tmp_path):
    code, _, message = run_command(monkeypatch, capsys, "--out", tmp_path)
    assert code == 2
    assert "it is a folder; give a file name" in message


# -- it opens ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "way"), [
    ("chromium", "disk"), ("chromium", "server"), ("firefox", "disk"),
    pytest.param("firefox", "server", marks=pytest.mark.slow),
])  # fmt: skip
def test_it_opens_and_drives_without_a_network_and_without_an_error(name, way, page):
    find_program(name)
    with serve(page.parent) as (address, paths), BROWSERS[name]() as window:
        window.open(page.as_uri() if way == "disk" else f"{address}/{page.name}")
        window.wait(READY)
        window.wait(f"{STATE}.cars[0].last.station > 1")
        assert window.run(f"{STATE}.notice") == ""
        assert window.said() == []
        assert window.requests() == []
        assert paths == ([] if way == "disk" else [f"/{page.name}"])


def test_it_begins_with_what_it_was_exported_with(browser_window, tmp_path):
    along = np.linspace(0.0, 200.0, 41)
    points = np.stack([along, 3.0 * np.sin(along / 30.0)], axis=-1)
    car = at.vehicle_from_data_sheet("own", mass=1300.0, wheelbase=2.5)
    exported_page = at.export_page(
        tmp_path / "own.html", vehicle=car, road=points, speed=12.0, profile="production",
        controllers=["learning", "stanley"], seed=3, planner=SimulatedPlanner(delay=0.3, start="pose"),
    )  # fmt: skip
    state = open_page(browser_window, exported_page).run(STATE)
    assert state["notice"] == ""
    assert state["setup"]["car"]["file"]["numbers"]["mass"] == 1300.0
    assert len(state["setup"]["road"]["points"]) == 41
    assert [controller["kind"] for controller in state["setup"]["controllers"]] == ["learning", "stanley"]
    assert (state["setup"]["speed"], state["setup"]["profile"], state["setup"]["seed"]) == (
        {"constant": 12.0}, "production", 3,
    )  # fmt: skip
    assert state["setup"]["planner"] == {"period": 0.1, "delay": 0.3, "noise": 0.0, "start": "pose"}
    assert len(state["cars"]) == 2


# -- it drives as Python does -----------------------------------------------------------------------------------------
FEW = "informed", "from a bend"
"""Drives that are always compared; all of them where there is time."""


@pytest.mark.parametrize(
    "name", [name if name in FEW else pytest.param(name, marks=pytest.mark.slow) for name in page_drives.SETUPS]
)
def test_a_drive_of_the_page_is_that_of_python_to_the_last_bit(browser_window, page, name):
    expected = page_drives.drive_columns(name)
    answer = drive(open_page(browser_window, page), page_drives.SETUPS[name], 4000)
    assert "refused" not in answer, answer
    for car, run in zip(answer["cars"], expected, strict=True):
        assert len(car["numbers"]) == len(run["x"]) > 50
        assert differing(dict(zip(car["columns"], car["numbers"].T, strict=True)), run) == {}


def test_another_page_of_the_same_name_keeps_the_previous_one_beside_it_and_says_so(
    monkeypatch, capsys, tmp_path, page
):
    out = tmp_path / "drive.html"
    out.write_bytes(page.read_bytes())
    _, report, _ = run_command(monkeypatch, capsys, "--out", out, "--vehicle", "van")
    assert out.with_name("drive.html.bak").read_bytes() == page.read_bytes()
    assert f"The previous content is in {out}.bak" in report.replace("\n", "")
