"""What a program without Python is given of controllers and worlds, and the kernels it then calls: copies, no formulas.

Python writes these numbers once, per profile (`world_numbers`) and kind of controller (`controller_numbers`); of the
car there is what a user gives. A row of a record is a table by the names of its fields; what is not said is NaN. The
program lays rows in its memory (`numbers by name`), copies into them what is named here, and calls, in this order:

**A car.** Its numbers by name are the keys of a car file, those left out with the defaults of `page_inputs.car_fields`.

1. From a sheet: a row of `models.car.CarRow` with ``mass`` and what else the sheet says, NaN elsewhere, an empty
   `synthesis.car.KnownWithinRow`; ``complete_car(wheelbase, load, truck, car, within)``. Every other number has its
   default; the tyre is that of the default. From a file: `KnownWithinRow` is a copy of the section ``known_within``
   with ``is_given = 1``, or all NaN with ``is_given = 0`` where there is none.
2. `CarRow` is a copy by name; ``car_flaw(car)`` must answer `OK`. So are `synthesis.plant.TyreRow` (``linear`` and
   ``stiffness_load`` are numbers: the places of the words in `page_inputs.car_fields`; ``shape_factor`` is the file's
   ``shape``) and `BodyRow`. ``outline_of(body, car, outline)`` must answer `OK`.

**A world.** The profile's `world_numbers`.

1. ``plant_parameters(car, tyre, actuator, parameters)``; ``plant_law(tyre)`` chooses among ``plants`` which
   functions the `plants.contract.Vehicles` hold.
2. ``plant_substeps(car, tyre, 1, period, top speed of the drive)`` -> ``substeps`` of `simulation.world.LoopSettings`;
   ``dead_periods(delay, actuator.dead_time, period)`` -> ``dead_whole``, ``dead_share``. The rest of Settings are
   copies: of ``settings``, of the actuator (``steering_lag``, ``steering_limit``, ``steering_bias``), of the car
   (``mass``, ``engine_power``, ``traction_limit``, ``brake_limit``) and of the domain (``failure_distance``).
3. ``drive_start(line, offset, turned, pose)`` of `core.planning.drive`, then the speed there: the first four of the 12
   entries of ``start``; the others are zero.

When the truth changes while it drives, 1 and 2 are called again with a changed actuator.

**An informed MPC** (`informed`, `learning`): from ``order`` of `controller_numbers`.

1. Into the row of `synthesis.mpc.Order`: ``car`` and ``within`` of the car; ``file``: lag, dead_time, rate and
   limit of the section ``steering``, NaN where it has none; ``caller``: what a caller believes of lag and dead time.
2. ``informed_numbers(order, numbers)`` must answer `OK`; it writes a row of `synthesis.mpc.MPCNumbers`: tuning, model,
   states, turning, estimator, learner of the `Mpc`. A tuning of the caller's then takes the place of ``tuning``.
   ``learner_memory`` writes ``fresh``, as many numbers as ``learned``.
3. ``settings`` of `controller_numbers` go into ``numbers.settings``; ``longest_horizon`` and ``most_moves`` are those
   of ``settings``, or Np and Nc where these are larger.
4. ``learns`` is ``settings.learns``; on a road ``curved`` and ``feeds_forward`` are 1. ``functions`` names the members.

**The published MPC** (`published`, and with a schedule): ``published_numbers(car, period, numbers)``; there is no
turning, estimator or learner. On a road ``curved`` is 1 and ``feeds_forward`` 0.

**A speed control**: `speed_numbers`.

1. ``settings`` in a row of `speed_control.SpeedSettings`, completed by the period, the car and what ``resistance``
   and ``usable_friction`` answer.
2. ``write_speed_path`` of the plan, then a `core.tracker.longitudinal.Longitudinal` with ``bank`` hypotheses each of
   drive and brakes and ``speed_requests``; ``horizon_cells`` counts the cells ahead. ``top_speed`` of its sample is
   inf, or ``first_top_speed`` of a learner. Its estimate of the friction has no hypotheses without an informed MPC;
   otherwise ``plant_parameters`` of the steering that this assumes, and of ``sensor_variances`` those of ``sensors``.
   ``longitudinal_begin``.
3. ``prescribed_speed`` of the run is ``external_forces``, `control_planned_speed` its ``control_speed``, and there is
   room for ``speeds_ahead`` in ``speeds``. `roll_on` drives; what is seen is in ``frames``, by `show_period`.

**A law** (`pure-pursuit`, `stanley`, `lqr`): ``common`` is a row of `synthesis.laws.Common`; ``size`` numbers are made
by the kernel that ``made_by`` names, from car and common, of the LQR from its first three tuning entries as well; of
``tuning`` the entry that is NaN is ``steering_delay(file)``.
"""

from __future__ import annotations

import inspect
import math
from typing import Any

from adaptrack.base.errors import UnknownName, did_you_mean
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import LQR, MPC, CompiledController, Learning, PurePursuit, Stanley, published_mpc
from adaptrack.control.controllers.informed import order_of
from adaptrack.control.speed_control import (
    ASSUMED_KNOWLEDGE,
    FRICTION_COUNT,
    FRICTION_SENSORS,
    LONGEST_STEERING_DELAY,
    SpeedControl,
    speed_banks,
)
from adaptrack.core.physics.tyre import TYRE_NAMES
from adaptrack.core.simulation.world import EXTERNAL_FORCES
from adaptrack.core.speed.path import PLACE_SPACING
from adaptrack.core.synthesis import laws
from adaptrack.drive.closed_loop import LONGEST_SPEEDS_AHEAD
from adaptrack.drive.world import World
from adaptrack.road import Comfort
from adaptrack.scenario.profile import Profile, load_profile

INFORMED_KINDS = ("informed", "learning")
MADE_BY = {
    "pure-pursuit": (PurePursuit, laws.pure_pursuit_parameters, laws.PURSUIT),
    "stanley": (Stanley, laws.stanley_parameters, laws.STANLEY),
    "lqr": (LQR, laws.lqr_parameters, laws.LQR_NUMBERS),
}
"""Laws by kind: the controller, the kernel that makes its parameters, and how many these are."""
CAR_FIELDS, DRIVE_FIELDS = ("car", "within", "caller", "file"), ("substeps", "dead_whole", "dead_share")


def world_numbers(profile: str | Profile) -> dict[str, Any]:
    """A profile for a program without Python, see the module.

    ``period`` (s), ``delay`` (periods), ``actuator`` (`synthesis.plant.Actuator`), ``settings``
    (`simulation.world.LoopSettings`, all that is not of car or drive), ``remembered`` (instants whose samples are
    kept), ``requested`` (forces that are remembered), ``speed_requests`` (those of a speed control) and ``plants``, the
    names of the functions for each answer of ``plant_law``.
    """
    profile_world, car = load_profile(profile), _any_car()
    world = World.of(DualTrack(car), MPC(car, profile=profile_world), profile_world, None, None, None)
    settings = world.settings(1)._asdict()
    requested = 2 * (2 + max(settings["drive_whole"], settings["brake_whole"]))
    speed = SpeedControl(car).settings(world.period, Comfort())
    theirs = (*DRIVE_FIELDS, "failure_distance", *(key for key in settings if key.startswith("steering_")))
    for key in (*theirs, *world.plant.powertrain):
        del settings[key]
    plants = [
        {member: f"dual_track_{tyre}_{member}" for member in ("advance", "observe")} for tyre in TYRE_NAMES.values()
    ]
    return {
        "period": profile_world.period, "delay": profile_world.delay, "actuator": profile_world.steering.model_dump(),
        "settings": settings, "remembered": world.remembered, "plants": plants, "requested": requested,
        "speed_requests": speed_banks(speed, world.period).requests.size,
    }  # fmt: skip


def speed_numbers() -> dict[str, Any]:
    """A speed control for a program without Python, see the module; all that is not of car, plan or period."""
    settings = SpeedControl(_any_car()).settings(1.0, Comfort())
    names = ("accelerate", "brake", "emergency", "stop_jerk", "governor", "guard", "gain", "patience")
    return {
        "settings": {name: getattr(settings, name) for name in names}, "bank": speed_banks(settings, 1.0).drive.size,
        "speeds_ahead": LONGEST_SPEEDS_AHEAD, "spacing": PLACE_SPACING, "external_forces": EXTERNAL_FORCES,
        "knowledge": ASSUMED_KNOWLEDGE, "frictions": FRICTION_COUNT, "sensors": FRICTION_SENSORS,
        "longest_delay": LONGEST_STEERING_DELAY,
    }  # fmt: skip


def controller_numbers(kind: str, profile: str | Profile, preview: bool | None = None) -> dict[str, Any]:
    """A controller of a kind (`INFORMED_KINDS`, ``published``, `MADE_BY`) for a program without Python, see the module.

    preview: whether the reference is known ahead; None: as the profile says.
    """
    world = load_profile(profile)
    preview = world.preview if preview is None else preview
    if kind in MADE_BY:
        return _law_numbers(kind, world, preview)
    car = _any_car()
    if kind == "published":
        mpc = published_mpc(car, period=world.period, preview=preview)
        return {"settings": _other_settings(mpc, _WRITTEN), "functions": _functions(mpc)}
    if kind not in INFORMED_KINDS:
        kinds = (*INFORMED_KINDS, "published", *MADE_BY)
        raise UnknownName(f"no kind of controller is named {kind!r}. {did_you_mean(kind, kinds)}")
    learning: Any = Learning() if kind == "learning" else "auto"
    order, *_ = order_of(car, world, (None, None, learning), None, None, preview)
    mpc = MPC(car, profile=world, learning=learning, preview=preview)
    left = _row(order)
    for part in CAR_FIELDS:
        del left[part]
    return {"order": left, "settings": _other_settings(mpc, (*_WRITTEN, "preview")), "functions": _functions(mpc)}


_WRITTEN = (
    "period", "delay", "ahead", "error_max", "move_min", "move_max", "angle_min", "angle_max", "informed", "learns",
    "curved", "feeds_forward",
)  # fmt: skip
"""Of the settings of an MPC, what kernels write, or the road decides."""


def _any_car() -> Vehicle:
    """Nothing of it is said."""
    return load_vehicle("paper")


def _other_settings(mpc: MPC, written: tuple[str, ...]) -> dict[str, Any]:
    return {key: value for key, value in mpc.settings()._asdict().items() if key not in written}


def _functions(mpc: MPC) -> dict[str, str | None]:
    """The names of the members whose addresses `core.controllers.mpc.Functions` holds."""
    return {"discretise": _name(mpc.model.function), "estimate": _name(mpc.estimator.function)}


def _name(function: Any) -> str | None:
    return None if function is None else getattr(function, "name", function.__name__)


def _law_numbers(kind: str, profile: Profile, preview: bool) -> dict[str, Any]:
    law, kernel, size = MADE_BY[kind]
    controller: CompiledController = law(_any_car(), period=profile.period, preview=preview)
    (low, high), (least, most) = controller.limits.move, controller.limits.angle
    arguments = inspect.signature(law).parameters
    tuning = {
        name: math.nan if arguments[name].default is None else controller.tuning[name]
        for name in controller.tuning_names
    }
    return {
        "common": {
            "period": controller.period, "move_min": low, "move_max": high, "angle_min": least, "angle_max": most,
        },
        "tuning": tuning, "made_by": _name(kernel), "size": size, "function": _name(controller.function),
        "memory": controller.memory_size, "diagnostics": list(controller.diagnostic_names), "preview": preview,
    }  # fmt: skip


def _row(row: Any) -> dict[str, Any]:
    """A row of a record as tables in one another."""
    names = row.dtype.names
    return {name: _row(row[name]) if row.dtype[name].names else row[name].tolist() for name in names}
