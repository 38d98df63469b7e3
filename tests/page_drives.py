"""Drives of the page, and what Python drives with the same setups: for Node and for browsers."""

import functools

import numpy as np

import adaptrack as at
from adaptrack.core.simulation.frame import FRAME
from adaptrack.export.page_inputs import page_car
from adaptrack.export.page_setup import simulate_setup

COLUMNS = {
    "x": "X", "y": "Y", "yaw": "psi", "vx": "vx", "vy": "vy", "yaw_rate": "yaw_rate", "wheel_angle": "steering",
    "command": "command", "command_change": "command_change", "y_ref": "y_ref", "v_ref": "v_ref",
    "lateral_acceleration": "lateral_acceleration",
}  # fmt: skip
"""Columns of frames, and what a `Trajectory` calls them."""
SHEET = {"mass": 1480.0, "wheelbase": 2.68}
VAN = page_car(
    at.load_vehicle("van").replace(name="mine", steering=at.Steering(lag=0.2, dead_time=0.08, rate=0.6, limit=0.55))
)
"""A car file as the page has read it."""


def _wave(count, step, height):
    s = np.arange(count) * step
    return np.round(np.stack([s, height * np.sin(s / 45.0)], axis=-1), 3).tolist()


_ANGLES = np.linspace(0.0, 1.5 * np.pi, 60)
BEND = {"points": np.round(40.0 * np.stack([np.sin(_ANGLES), 1.0 - np.cos(_ANGLES)], axis=-1), 3).tolist(),
        "closed": False, "name": "bend"}  # fmt: skip
"""Three quarters of a circle: drives begin in a bend."""
WAVE = {"points": _wave(60, 12.0, 9.0), "closed": False, "name": "drawn"}
PAPER, SEDAN, TYPED = {"name": "paper"}, {"name": "midsize-sedan"}, {"sheet": SHEET}


def _setup(car, road, speed, profile, *controllers, seed=1, **truth):
    setups = [
        {"tuning": None, "belief": None, **({"kind": controller} if isinstance(controller, str) else controller)}
        for controller in controllers
    ]
    nothing = dict.fromkeys(("lag", "dead_time", "bias", "noise", "friction", "wind"))
    return {"car": car, "road": road, "speed": speed, "profile": profile, "truth": nothing | truth, "seed": seed,
            "controllers": setups}  # fmt: skip


def _tuned(kind, Np, Nc, Q, R, **belief):
    return {"kind": kind, "tuning": {"Np": Np, "Nc": Nc, "Q": Q, "R": R}, "belief": belief or None}


def _assuming(friction, kind, **more):
    """A controller behind a speed control that assumes a friction."""
    return {"kind": kind, "speed_control": {"friction": friction}, **more}


SETUPS = {
    "informed": _setup(PAPER, {"name": "mountain"}, {"lateral": 3.0}, "road", "informed"),
    "learning": _setup(PAPER, {"name": "country"}, {"lateral": 3.0}, "road", "learning"),
    "published": _setup(PAPER, {"name": "country"}, {"constant": 15.0}, "paper", "published"),
    "networks": _setup(PAPER, {"name": "mountain"}, {"lateral": 2.5}, "road", "published-nn", "published-anfis"),
    "laws": _setup(SEDAN, {"name": "country"}, {"lateral": 2.0}, "road", "pure-pursuit", "stanley", seed=4),
    "lqr": _setup({"name": "van"}, {"name": "town"}, {"lateral": 2.0}, "production", "lqr", "stanley"),
    "late samples": _setup(SEDAN, {"name": "mountain"}, {"lateral": 3.0}, "production", "informed", "learning", seed=9),
    "unknown": _setup({"name": "van"}, {"name": "country"}, {"lateral": 2.5}, "production",
                      {"kind": "learning", "knows": "sheet"}, {"kind": "informed", "knows": "sheet"}, seed=6),
    "first test": _setup(PAPER, {"test": "triple-lane-change"}, {}, "paper", "published", "published-nn"),
    "second test": _setup(PAPER, {"test": "general-trajectory"}, {}, "road", "informed", "published-anfis"),
    # begun from what a user gives
    "sheet": _setup(TYPED, {"name": "country"}, {"lateral": 3.0}, "road", "informed", "learning"),
    "sheet, late": _setup(TYPED, WAVE, {"lateral": 2.5}, "production", "learning", seed=3),
    "file": _setup({"file": VAN}, {"name": "town"}, {"lateral": 2.0}, "road", "informed", "lqr"),
    "file, learning": _setup({"file": VAN}, WAVE, {"constant": 12.0}, "production", "learning", "informed"),
    "points": _setup(PAPER, WAVE, {"lateral": 3.0}, "road", "informed", "stanley"),
    "from a bend": _setup(SEDAN, BEND, {"constant": 10.0}, "production", "learning", "stanley", mass=1.2, bias=0.01),
    "tuned": _setup(SEDAN, WAVE, {"lateral": 3.0}, "road", _tuned("informed", 42, 7, 2.0, 11.5), seed=2),
    "believing": _setup(SEDAN, {"name": "mountain"}, {"lateral": 2.0}, "road",
                        _tuned("informed", 30, 10, 1.0, 40.0, lag=0.3, dead_time=0.12), lag=0.3, dead_time=0.06),
    "another truth": _setup(TYPED, WAVE, {"lateral": 2.0}, "road", "informed", _tuned("published", 25, 5, 1.0, 30.0),
                            lag=0.22, dead_time=0.07, bias=0.01, noise=2.0, friction=0.6, wind=8.0),
    "paper, drawn": _setup({"sheet": {**SHEET, "load": 75.0}}, WAVE, {"constant": 14.0}, "paper", "pure-pursuit",
                           _tuned("published", 20, 4, 5.0, 0.05)),
    # driven by a speed control
    "speed control": _setup(SEDAN, {"name": "mountain"}, {"lateral": 3.0}, "road", _assuming([0.3, 0.9], "informed"),
                            _assuming([0.4, 0.5], "stanley"), friction=0.35),
    "speed control, unknown": _setup({"name": "van"}, WAVE, {"constant": 14.0}, "production",
                                     _assuming([0.5, 0.9], "learning", knows="sheet"), "learning", seed=7),
    "speed control, networks": _setup(PAPER, {"name": "town"}, {"lateral": 2.5}, "road",
                                      _assuming(0.3, "published-nn"), _assuming(0.7, "lqr"), seed=2, wind=5.0),
    "speed control, heavy": _setup({"name": "compact-ev"}, WAVE, {"lateral": 2.5}, "road",
                                   _assuming([0.6, 1.0], "informed"), "informed", seed=3, mass=1.3, slope=0.04,
                                   brake_lag=0.4),
    "tests, typed": _setup(TYPED, {"test": "triple-lane-change"}, {}, "road", "learning", "published-nn", wind=5.0),
}  # fmt: skip


@functools.cache
def drive_columns(name):
    """Of each car of a drive the columns that are compared, by name."""
    return [columns_of(run) for run in simulate_setup(SETUPS[name])]


def columns_of(trajectory):
    """The columns of a trajectory as frames name them, until it ends."""
    columns = {name: getattr(trajectory, theirs) for name, theirs in COLUMNS.items()}
    columns |= {"held": trajectory.held.astype(float), "error": trajectory.Y - trajectory.y_ref}
    columns |= {key: trajectory.road[key] for key in ("station", "offset", "heading_error") if trajectory.road}
    if trajectory.road:
        columns["error"] = trajectory.road["offset"] - trajectory.y_ref
    for group in (trajectory.tuning, trajectory.diagnostics):
        for key, values in group.items():
            columns[f"answered_{key}" if key in FRAME._fields else key] = values.astype(float)
    columns.pop("longitudinal_acceleration", None)  # computed from the others
    count = int(np.isfinite(trajectory.command).sum())
    return {name: np.ascontiguousarray(values[:count], float) for name, values in columns.items()}
