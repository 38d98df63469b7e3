"""Draw the pictures of the gallery from runs: python docs/thumbnails.py [NAME ...]  (all of them: 2 minutes)

Each is written to docs/images/gallery/NAME.png, 480 x 300 px.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import types
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from PIL import Image

import adaptrack as at

IMAGES = Path(__file__).resolve().parent / "images" / "gallery"
BLUE, ORANGE, GREY = "#3b8fd0", "#d9730d", "#8a8f98"
STYLE = {
    "font.size": 8, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#e4e7ea",
    "axes.edgecolor": GREY, "legend.frameon": False, "lines.linewidth": 1.8,
}  # fmt: skip


def drive(axes: Axes) -> None:
    """The informed MPC and pure pursuit on a mountain road: offset along it."""
    car, road = at.load_vehicle("midsize-sedan"), at.generate_road("mountain", seed=2, length=600.0)
    drive = at.RoadDrive(road, at.plan_speed(road, car))
    for label, controller, colour in (
        ("pure pursuit", at.PurePursuit(car, period=0.05), ORANGE),
        ("informed MPC", at.MPC(car, profile="road"), BLUE),
    ):
        run = at.simulate(at.DualTrack(car), controller, drive, profile="road")
        axes.plot(run.road["station"], 100 * run.error, color=colour, label=label)
    axes.set(xlabel="along the road (m)", ylabel="offset (cm)")
    axes.legend(loc="upper right")


def road(axes: Axes) -> None:
    """A generated road from above, coloured by its planned speed."""
    line, car = at.generate_road("mountain", seed=5, length=800.0), at.load_vehicle("midsize-sedan")
    plan = at.plan_speed(line, car)
    s = np.linspace(0.0, line.length, 400)
    at_s = line.at(s)
    points = np.stack([at_s.x, at_s.y], axis=-1)
    speeds = np.interp(s, plan.s, plan.speed)
    drawn = LineCollection(np.stack([points[:-1], points[1:]], axis=1), array=speeds[1:], cmap="viridis", linewidth=3)
    axes.add_collection(drawn)
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    plt.colorbar(drawn, ax=axes, label="planned speed (m/s)")


def car(axes: Axes) -> None:
    """Understeer gradient of a car from mass and wheelbase, with what is not known of it."""
    for mass, colour in ((900.0, BLUE), (1450.0, ORANGE), (2200.0, GREY)):
        made = at.vehicle_from_data_sheet("car", mass=mass, wheelbase=2.3 + mass / 4000.0)
        speed = np.linspace(3.0, 27.0, 100)
        gain = [made.steady_state_yaw_gain(v) for v in speed]
        axes.plot(speed, gain, color=colour, label=f"{mass:.0f} kg")
    axes.set(xlabel="speed (m/s)", ylabel="steady yaw gain (1/s)")
    axes.legend()


def tyre(axes: Axes) -> None:
    """Forces of an axle with noise, and the tyre that was fitted to them."""
    page = snippet("tyre.md")
    slip, fit, loads = page["slip"], page["fit"].tyre, page["loads"]
    measured = np.loadtxt("axles.csv", delimiter=",", skiprows=1)
    for i, (label, colour) in enumerate((("front axle", BLUE), ("rear axle", ORANGE))):
        stiffness = fit.stiffness_at(*loads)[i]
        peak = page["fit"].friction * loads[i]
        curve = 2 * peak * np.sin(fit.shape * np.arctan(stiffness / (fit.shape * peak) * slip))
        axes.plot(np.degrees(slip), measured[:, i + 1] / 1e3, ".", ms=3, color=colour)
        axes.plot(np.degrees(slip), curve / 1e3, color=colour, label=label)
    axes.set(xlabel="slip angle (°)", ylabel="force (kN)")
    axes.legend()


def log(axes: Axes) -> None:
    """Estimates over the truth with their 90 % intervals."""
    page = snippet("../identify.md", "initial = car")
    found, names = page["found"], ("delay", "front axle", "rear axle")
    for i, (name, true) in enumerate(page["truth"].items()):
        each = found[name]
        axes.plot([each.low / true, each.high / true], [i, i], color=BLUE, lw=6, alpha=0.5, solid_capstyle="butt")
        axes.plot(each.value / true, i, "o", color=BLUE)
    axes.axvline(1.0, color=ORANGE)
    axes.set(xlabel="estimate over truth, with its 90 % interval", yticks=range(3), ylim=(-0.6, 2.6))
    axes.set_yticklabels(names)


def learning(axes: Axes) -> None:
    """The delay that a controller learns while it drives, and its band."""
    vehicle = at.load_vehicle("midsize-sedan")
    belief = at.Steering(lag=0.2, dead_time=0.125)
    unsure = at.Uncertainty(lag=0.15, dead_time=0.125, stiffness=2.0, mass=0.3)
    mpc = at.MPC(vehicle, profile="road", belief=belief, uncertainty=unsure, learning=at.Learning())
    run = at.simulate(at.DualTrack(vehicle), mpc, at.load_scenario("random-drive", duration=40.0), profile="road")
    names = [name for name in run.diagnostics if "delay" in name]
    delay = run.diagnostics["learned_delay"] if "learned_delay" in run.diagnostics else run.diagnostics[names[0]]
    sigma = next((run.diagnostics[name] for name in names if "sigma" in name), None)
    if sigma is not None:
        axes.fill_between(run.t, delay - 1.64 * sigma, delay + 1.64 * sigma, color=BLUE, alpha=0.25, lw=0)
    axes.plot(run.t, delay, color=BLUE, label="learned")
    axes.axhline(0.15, color=ORANGE, label="true")
    axes.set(xlabel="time (s)", ylabel="delay of the steering (s)")
    axes.legend()


def manoeuvre(axes: Axes) -> None:
    """The cones of the obstacle avoidance of ISO 3888-2, and a line between them."""
    from adaptrack.comparison.lane_change import iso_3888_2, track_road

    outline = at.load_vehicle("compact-ev").outline
    track = iso_3888_2(outline.width)
    line = track_road(track, outline)
    s = np.linspace(0.0, line.length, 400)
    axes.plot(line.at(s).x, line.at(s).y, color=BLUE, label="driven line")
    for gate in track.gates:
        x = np.linspace(gate.start, gate.end, 5)
        axes.plot(np.r_[x, x], np.r_[np.full(5, gate.left), np.full(5, gate.right)], "^", ms=4, color=ORANGE)
    axes.set(xlabel="x (m)", ylabel="y (m)", xlim=(-5.0, track.gates[-1].end + 5.0))
    axes.legend()


def paper(axes: Axes) -> None:
    """The triple lane change of the paper: reference and the controller of its table."""
    vehicle = at.load_vehicle("paper")
    mpc = at.published_mpc(vehicle, at.Tuning(Np=35, Nc=8, Q=10, R=0.01))
    run = at.simulate(at.DualTrack(vehicle), mpc, at.load_scenario("triple-lane-change"))
    axes.plot(run.t, run.Y, color=BLUE, label="published MPC")
    axes.plot(run.t, run.y_ref, "--", color=ORANGE, label="reference", lw=1.2)
    axes.set(xlabel="time (s)", ylabel="lateral position (m)")
    axes.legend()


def scheduler(axes: Axes) -> None:
    """The prediction horizon that a guarded network asks for, over a drive."""
    vehicle = at.load_vehicle("paper")
    mpc = at.published_mpc(vehicle, scheduler=at.load_scheduler("road-nn"), period=0.05)
    run = at.simulate(at.DualTrack(vehicle), mpc, at.random_drive(1, duration=40.0), profile="road")
    axes.step(run.t, run.tuning["Np"], color=BLUE, label="horizon $N_p$", where="post")
    axes.set(xlabel="time (s)", ylabel="periods")
    other = axes.twinx()
    other.plot(run.t, run.vx, color=ORANGE, lw=1.2)
    other.set_ylabel("speed (m/s)", color=ORANGE)
    other.grid(False)
    axes.legend()


def certificate(axes: Axes) -> None:
    """Modulus margin of the default's loop over speed and friction."""
    from adaptrack.analysis.certify import certify

    vehicle = at.load_vehicle("midsize-sedan")
    mpc = at.MPC(vehicle, profile="road")
    found = certify(mpc.tuning, at.DualTrack(vehicle), mpc, "road", levels=(14, 5))
    rows = [row for row in found.rows() if row["driving"] == "straight"]
    speeds, frictions = (sorted({row[key] for row in rows}) for key in ("speed", "friction"))
    margin = {(row["speed"], row["friction"]): row["modulus_margin"] for row in rows}
    values = [[margin[v, mu] for v in speeds] for mu in frictions]
    drawn = axes.pcolormesh(speeds, frictions, values, cmap="viridis", vmin=0.0, shading="nearest")
    axes.set(xlabel="speed (m/s)", ylabel="friction")
    axes.grid(False)
    plt.colorbar(drawn, ax=axes, label="modulus margin")


def plant(axes: Axes) -> None:
    """A plant of one's own, from the page about extending, on a sine."""
    page = snippet("../extending.md", "my_plants")
    run = page["run"]
    axes.plot(run.t, run.Y, color=BLUE, label="own plant")
    axes.plot(run.t, run.y_ref, "--", color=ORANGE, lw=1.2, label="reference")
    axes.set(xlabel="time (s)", ylabel="lateral position (m)")
    axes.legend()


def controller(axes: Axes) -> None:
    """A controller of one's own beside the default."""
    page = snippet("controller.md")
    runs = [
        at.simulate(at.DualTrack(page["car"]), each, page["scenario"], profile="road")
        for each in (page["own"], at.MPC(page["car"], profile="road"))
    ]
    for run, label, colour in zip(runs, ("own", "default"), (ORANGE, BLUE), strict=True):
        axes.plot(run.t, run.Y, color=colour, label=label)
    axes.plot(runs[0].t, runs[0].y_ref, "--", color=GREY, lw=1.2, label="reference")
    axes.set(xlabel="time (s)", ylabel="lateral position (m)")
    axes.legend()


def snippet(page: str, part: str = "") -> dict:
    """The names that the Python blocks of a page of the gallery leave, or those blocks that hold a part of text."""
    text = (Path(__file__).resolve().parent / "gallery" / page).read_text()
    names: dict = {"__name__": "snippet"}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        module = re.match(r"# (\w+)\.py$", block, re.MULTILINE)
        if module and part in block:
            made = sys.modules[module[1]] = types.ModuleType(module[1])
            exec(block, vars(made))
        elif part in block:
            exec(block, names)
    return names


PICTURES: dict[str, Callable[[Axes], None]] = {
    each.__name__: each
    for each in (
        drive, road, car, tyre, log, learning, manoeuvre, paper, scheduler, certificate, plant, controller,
    )
}  # fmt: skip


def main() -> None:
    """Draw all pictures, or those named."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, mpl.rc_context(STYLE):
        os.chdir(folder)
        for name in sys.argv[1:] or PICTURES:
            figure, axes = plt.subplots(figsize=(4.8, 3.0), layout="constrained")
            PICTURES[name](axes)
            figure.savefig("drawn.png", dpi=100)
            plt.close(figure)
            Image.open("drawn.png").convert("RGB").quantize(48).save(IMAGES / f"{name}.png", optimize=True)
            print(name, f"{(IMAGES / f'{name}.png').stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main()
