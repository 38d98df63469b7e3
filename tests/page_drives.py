"""Drives of the page, and what Python drives with the same setups: for Node and for browsers."""

import functools
import math

import numpy as np

import adaptrack as at
from adaptrack.control.controllers.learned_car import STEERING_QUANTITIES
from adaptrack.core.simulation.frame import FRAME
from adaptrack.drive.batch import Batch
from adaptrack.drive.planner import PlannedController, SimulatedPlanner
from adaptrack.drive.simulate import rollouts
from adaptrack.export.page_inputs import page_car
from adaptrack.export.page_setup import road_of
from adaptrack.road import Comfort

CLOSED_ROAD_DURATION = 3600.0
"""s, for which a closed road is driven."""
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


def _planned(setup, **planner):
    """A setup behind a planner."""
    return {**setup, "planner": planner}


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
    "planner": _planned(_setup(SEDAN, {"name": "mountain"}, {"lateral": 3.0}, "road", _assuming(0.9, "informed")),
                        period=0.1, delay=0.3, start="pose"),
    "planner, late samples": _planned(_setup({"name": "van"}, {"name": "country"}, {"lateral": 2.5}, "production",
                                             _assuming([0.6, 1.0], "learning"), _assuming(0.9, "stanley"), seed=5),
                                      period=0.2, delay=0.1),
    "planner, published": _planned(_setup(PAPER, {"name": "town"}, {"lateral": 3.0}, "paper",
                                          _assuming(0.8, "published")), period=0.15, delay=0.2, start="pose"),
    "tests, typed": _setup(TYPED, {"test": "triple-lane-change"}, {}, "road", "learning", "published-nn", wind=5.0),
}  # fmt: skip


def simulate_setup(setup):
    """The drives of a setup, one for each controller; the planner may be one of Python."""
    car, profile = car_of(setup["car"]), at.load_profile(setup["profile"])
    drive, world = drive_of(setup, car), world_of(profile, setup.get("truth") or {})
    mass = (setup.get("truth") or {}).get("mass")
    plant = at.DualTrack(car if mass is None else car.replace(mass=car.mass * mass))
    runs = []
    for controller in setup["controllers"]:
        model_car = (
            at.vehicle_from_data_sheet(car.name, car.mass, car.wheelbase) if controller.get("knows") == "sheet" else car
        )
        steering_controller, seed = controller_of(controller, model_car, profile), int(setup.get("seed", 0))
        if planner := setup.get("planner"):
            driver = at.SpeedControl(model_car, **controller["speed_control"])
            simulated = SimulatedPlanner(**planner) if isinstance(planner, dict) else planner
            planned = PlannedController(steering_controller, driver, simulated)
            runs.append(at.simulate(plant, planned, drive, profile=world, seed=seed))
        elif speed_control := controller.get("speed_control"):
            driver = at.SpeedControl(model_car, **speed_control)
            runs.append(at.simulate(plant, steering_controller, drive, profile=world, driver=driver, seed=seed))
        else:
            runs += rollouts(Batch(plant, steering_controller, [drive], world), (seed,), threads=1)[0]
    return runs


def car_of(setup):
    """The car of a setup."""
    if "name" in setup:
        return at.load_vehicle(setup["name"])
    if "sheet" in setup:
        return at.vehicle_from_data_sheet("sheet", **setup["sheet"])
    file = setup["file"]
    sections = {key: file.get(key) for key in ("steering", "body", "known_within", "domain") if file.get(key)}
    return at.Vehicle(name=file.get("name", "file"), tyre=file["tyre"]["name"], **file["numbers"], **sections)


def drive_of(setup, car):
    """Return the drive of a page's setup: a road at a speed or a test of the paper, with true friction and wind."""
    truth, road_setup = setup.get("truth") or {}, setup["road"]
    friction, wind = truth.get("friction"), truth.get("wind")
    if "test" in road_setup:
        scenario = at.load_scenario(road_setup["test"])
        changes = {} if friction is None else {"friction": friction}
        changes |= {} if wind is None else {"wind": wind, "wind_gain": 1.0}
        return scenario.replace(**changes) if changes else scenario
    road, speed = road_of(road_setup), setup["speed"]
    plan = speed["constant"] if "constant" in speed else at.plan_speed(road, car, Comfort(lateral=speed["lateral"]))
    surface = {"friction": friction, "grade": truth.get("slope")}
    true_road = road.replace(**{name: value for name, value in surface.items() if value is not None})
    drive = at.RoadDrive(true_road, plan, wind=wind or 0.0)
    return drive.replace(laps=max(1, math.floor(CLOSED_ROAD_DURATION / drive.duration))) if road.closed else drive


def world_of(profile, truth):
    """The simulated world: the profile with another steering and with so many times its noise."""
    steering = {name: truth[name] for name in STEERING_QUANTITIES if truth.get(name) is not None}
    if steering.get("lag", profile.steering.lag) == 0.0:
        steering["rate"] = math.inf  # a rate limit acts on a lag
    factor = 1.0 if truth.get("noise") is None else float(truth["noise"])
    noises = {name: getattr(profile, name) for name in type(profile).model_fields if name.startswith("noise_")}
    changed = {name: value * factor for name, value in noises.items() if math.isfinite(value)}
    if (brake_lag := truth.get("brake_lag")) is not None:
        changed["brakes"] = profile.brakes.replace(lag=brake_lag)
    return profile.replace(steering=profile.steering.replace(**steering), **changed)


def controller_of(setup, car, profile):
    """A controller of a setup, for a car in a profile."""
    kind, loop = setup["kind"], {"period": profile.period, "preview": profile.preview}
    entries, believed = setup.get("tuning"), setup.get("belief")
    tuning = None if entries is None else at.Tuning(**{**entries, "Np": int(entries["Np"]), "Nc": int(entries["Nc"])})
    laws = {"pure-pursuit": at.PurePursuit, "stanley": at.Stanley, "lqr": at.LQR}
    if kind in laws:
        return laws[kind](car, **loop)
    scheduled = kind.partition("-")[2]
    if kind.startswith("published"):
        scheduler = at.load_scheduler(f"road-{scheduled}") if scheduled else None
        return at.published_mpc(car, tuning, scheduler=scheduler, **loop)
    steering = {name: value for name, value in (believed or {}).items() if value is not None}
    options = {"belief": at.Steering(**steering)} if steering else {}
    if kind == "learning":
        options["learning"] = at.Learning()
    return at.MPC(car, tuning, profile=profile, **options)


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
    if np.isnan(columns.get("governed_speed", 0.0)).all():  # not recorded of a speed control behind a tracker
        del columns["governed_speed"]
    count = int(np.isfinite(trajectory.command).sum())
    return {name: np.ascontiguousarray(values[:count], float) for name, values in columns.items()}
