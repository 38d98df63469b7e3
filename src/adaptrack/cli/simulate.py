"""`adaptrack simulate`: drive scenarios, print the metrics, write the report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller, Learning, Moves, Tuning
    from adaptrack.control.models import PredictionModel
    from adaptrack.control.scheduling import Schedule
    from adaptrack.drive.trajectory import Trajectory
    from adaptrack.scenario import Scenario
    from adaptrack.scenario.profile import Profile

FAILED = 3
"""The exit code when a run failed."""

STIFFNESS = 1.25
"""Factor between the tyre's stiffness and the model's from which a failed run is told of it."""

BEYOND = 1.25
"""Factor on the highest speed of a car's domain from which a scenario is said to leave it."""

INFORMED, STANDARD, AS_WRITTEN, AS_RELEASED = "informed", "standard", "as-written", "as-released"

COLUMNS = (
    Column("scenario", "scenario"),
    Column("controller", "controller"),
    Column("mse", "MSE", "m²"),
    Column("max_abs_error", "max |e|", "m", show.digits(3)),
    Column("at_any_limit", "limits", "%", show.percent),
    Column("step_us_p50", "step", "µs", show.whole),
    Column("result", "result"),
)


def simulate(
    scenarios: Annotated[
        list[str], typer.Argument(metavar="SCENARIO...", help="Names (see `scenarios`) or .toml/.csv files.")
    ],
    controller: Annotated[
        list[str] | None,
        Option(
            metavar="NAME",
            help="informed: the MPC that knows its car [default]; standard: the published one, "
            "as --scheduler, --np, --nc, --q, --r and --moves say [default when one of these is given, but for a "
            "scheduler of the informed one]; as-written: "
            "pulses; as-released: Laguerre functions, pole 0.95; lqr, pure-pursuit, stanley.",
        ),
    ] = None,
    vehicle: options.Vehicle = "paper",
    plant: options.Plant = "dual-track",
    tyre: options.Tyre = None,
    profile: options.Profile = "paper",
    driver: Annotated[bool, Option("--driver/--perfect-speed", help="Powertrain and driver, or exact speed.")] = False,
    np_: Annotated[int | None, Option("--np", help="Prediction horizon (periods); standard: 35.")] = None,
    nc: Annotated[int | None, Option("--nc", help="Control horizon (periods); standard: 8.")] = None,
    q: Annotated[float | None, Option("--q", help="Weight of the tracking error (1/m^2); standard: 10.")] = None,
    r: Annotated[float | None, Option("--r", help="Weight of the moves (1/rad^2); standard: 0.01.")] = None,
    moves: Annotated[
        options.MovesName, Option(help="pulse: eq. (10); laguerre: Laguerre functions.")
    ] = options.MovesName.pulse,
    laguerre_pole: Annotated[float, Option(help="Pole a of the Laguerre functions.")] = 0.95,
    laguerre_terms: Annotated[int, Option(help="Number of Laguerre functions.")] = 10,
    preview: Annotated[
        bool | None, Option("--preview/--no-preview", help="Know the reference ahead; by default the profile's.")
    ] = None,
    scheduler: Annotated[
        str | None, Option(help="Name or .json file (see `train`) of a scheduler that retunes the MPC at every step.")
    ] = None,
    solver: Annotated[str, Option(help="QP solver: active-set, hildreth, daqp, ...")] = "active-set",
    period: Annotated[float | None, Option(help="Control period (s); by default the profile's.")] = None,
    learn: options.Learn = False,
    learned: options.LearnedFile = None,
    seed: Annotated[int, Option("--seed", help="Seed of the sensor noise.")] = 0,
    option: Annotated[
        list[str] | None,
        Option("--option", "-o", metavar="KEY=VALUE", help="Option of the scenario, e.g. speed=20."),
    ] = None,
    out: Annotated[Path | None, Option(help="Folder for the report and the trajectories.")] = None,
    png: options.Png = False,
    allow_failed: Annotated[
        bool,
        Option(
            "--allow-failed",
            help=f"Exit code 0, not {FAILED}, when a run failed; drives a scheduler that is unstable on this car.",
        ),
    ] = False,
    plugin: options.Plugin = None,
    as_json: options.Json = False,
) -> None:
    """Drive scenarios with a controller; print the metrics, write the report.

    A run that leaves the road, spins or is not finite is printed as FAILED; the exit code is then 3. A scheduler that
    was made for another car is certified on this one first, and refused where that loop is unstable.
    """
    from adaptrack.cli.new_car import certify_meeting
    from adaptrack.control.controllers import MPC, Moves
    from adaptrack.control.scheduling import load_scheduler
    from adaptrack.scenario import load_scenario
    from adaptrack.scenario.profile import load_profile

    options.load_plugins(plugin)
    car, body = options.car_and_plant(vehicle, plant, tyre)
    loaded = [load_scenario(name, domain=car.domain, **scenario_options(option or [])) for name in scenarios]
    world = load_profile(profile)
    asked = Asked(
        car=car,
        profile=world,
        tuning={key: value for key, value in (("Np", np_), ("Nc", nc), ("Q", q), ("R", r)) if value is not None},
        moves=Moves(str(moves), laguerre_pole, laguerre_terms),
        period=world.period if period is None else period,
        preview=world.preview if preview is None else preview,
        solver=solver,
        schedule=None if scheduler is None else load_scheduler(scheduler),
        label="" if scheduler is None else Path(scheduler).stem if scheduler.endswith(".json") else scheduler,
        learning=asked_learning(learn, learned),
    )
    controllers = [make_controller(name, asked) for name in dict.fromkeys(controller or [asked.usual])]
    for scenario in loaded:
        tell_domain(scenario, car, as_json)
    options.make_page_folder(out, png)
    options.make_place(learned)
    for label, each in controllers:
        if isinstance(each, MPC):
            certify_meeting(label, each, body, car, world, allow_failed, as_json)
    runs = _drive(loaded, controllers, body, world, driver, seed, out)
    models = {label: each.model for label, each in controllers}
    rows = [measured_row(label, run, models[label]) for label, run in runs]
    if not any(row["failed"] for row in rows):
        keep_learned(learned, controllers, as_json)
    if out is not None:
        show.say(f"Report: {_write_report(out, runs, png)}", aside=as_json)
    _print(rows, as_json)
    for label, each in controllers:
        tell_belief(label, each, body, world, as_json)
    if any(row["failed"] for row in rows):
        tell_stiffness(car, body, as_json)
    if any(row["failed"] for row in rows) and not allow_failed:
        raise typer.Exit(FAILED)


# -- controllers ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Asked:
    """What the options say about the controllers."""

    car: Vehicle
    profile: Profile
    period: float
    """s"""
    preview: bool
    tuning: dict[str, Any] = field(default_factory=dict)
    """the entries that are given, by name"""
    moves: Moves | None = None
    """None: pulses"""
    solver: str = "active-set"
    schedule: Schedule | None = None
    label: str = ""
    """how tables call the scheduler: as the command line does"""
    learning: Learning | None = None

    @property
    def usual(self) -> str:
        """The controller that drives unless one is named."""
        from adaptrack.control.controllers.made_for import is_for_published

        if self.schedule is not None:
            return STANDARD if is_for_published(self.schedule.made_for) else INFORMED
        laguerre = self.moves is not None and self.moves.kind != "pulse"
        return STANDARD if self.tuning or laguerre else INFORMED

    def tuned(self, base: Tuning) -> Tuning:
        """A tuning with the entries that are given."""
        return replace(base, **self.tuning)


def make_controller(name: str, asked: Asked) -> tuple[str, Controller]:
    """A controller by its name, and how tables call it: an MPC, or one that is registered.

    Raises
    ------
    UnknownName
        For a name that no controller has.
    InvalidInput
        When the options make no controller.
    """
    from adaptrack.control.controllers import (
        Moves,
        Tuning,
        get_controller,
        informed_tuning,
        list_controllers,
        published_mpc,
    )
    from adaptrack.control.controllers.made_for import is_for_published

    own = asked.moves or Moves.pulses()
    moves = {STANDARD: own, AS_WRITTEN: Moves.pulses(), AS_RELEASED: Moves.laguerre(0.95, own.terms)}
    others = [each for each in list_controllers() if each not in moves]
    if name in others:
        if asked.schedule is not None and (name != INFORMED or is_for_published(asked.schedule.made_for)):
            raise InvalidInput(
                f"--scheduler {asked.label}: tunes the {'published ' if name == INFORMED else ''}MPC; controller "
                f"{name!r} takes none{', --controller standard does' if name == INFORMED else ''}."
            )
        offered, options = {"period": asked.period, "preview": asked.preview}, dict[str, Any]()
        if name == INFORMED:
            options |= {"moves": own, "solver": asked.solver}
            if asked.learning is not None:
                options["learning"] = asked.learning
            if asked.schedule is not None:
                options |= {"scheduler": asked.schedule, "most_moves": max(20, asked.schedule.largest[1])}
            if asked.tuning:
                options["tuning"] = asked.tuned(informed_tuning(asked.profile, asked.period))
        label = asked.label if asked.schedule is not None else name
        return label, get_controller(name, asked.car, profile=asked.profile, offered=offered, **options)
    if name not in moves:
        raise UnknownName(f"no controller is named {name!r}. {did_you_mean(name, [*moves, *others])}")
    tuning = asked.tuned(Tuning())
    mpc = published_mpc(
        asked.car, tuning, period=asked.period, moves=moves[name], preview=asked.preview, solver=asked.solver,
        scheduler=asked.schedule, most_moves=_most_moves(tuning, asked),
    )  # fmt: skip
    if not asked.label:
        return name, mpc
    return asked.label if name == STANDARD else f"{asked.label}-{name}", mpc


def asked_learning(learn: bool, file: Path | None) -> Learning | None:
    """How the informed controller learns, from the options; None: it does not."""
    from adaptrack.control.controllers import Learning, load_learned_car

    if not (learn or file is not None):
        return None
    return Learning(start=load_learned_car(file) if file is not None and file.exists() else None)


def keep_learned(file: Path | None, controllers: Sequence[tuple[str, Controller]], aside: bool) -> None:
    """Leave what the informed controller has learned in a file, for the next drive."""
    if file is None:
        return
    for _, each in controllers:
        if each.learner is not None:
            each.learned().to_toml(file)  # type: ignore[attr-defined]
            show.say(f"Learned: {file}", aside=aside)


def _most_moves(tuning: Tuning, asked: Asked) -> int:
    return max(20, tuning.Nc, 0 if asked.schedule is None else asked.schedule.largest[1])


# -- runs -------------------------------------------------------------------------------------------------------------
def scenario_options(given: Sequence[str]) -> dict[str, Any]:
    """`speed=20`, `friction=[0.9, 0.5]`, `window=full`: values are read as TOML, else taken as text."""
    import tomllib

    found: dict[str, Any] = {}
    for text in given:
        key, sign, value = text.partition("=")
        if not sign:
            raise InvalidInput(f"--option {text}: write KEY=VALUE, for instance speed=20.")
        try:
            found[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            found[key.strip()] = value.strip()
    return found


def _drive(
    scenarios: Sequence[Any], controllers: Sequence[tuple[str, Any]], body: Any, world: Profile, driver: bool,
    seed: int, out: Path | None,
) -> list[tuple[str, Trajectory]]:  # fmt: skip
    """Every scenario with every controller; each trajectory is saved as soon as it is driven."""
    from adaptrack.base.files import safe_names
    from adaptrack.drive.simulate import simulate as drive
    from adaptrack.drive.world import Driver

    pairs = [(scenario, *named) for scenario in scenarios for named in controllers]
    files = safe_names(f"{scenario.name}-{label}" for scenario, label, _ in pairs)
    where = f"their trajectories are in {out}, without a report" if out else "nothing was written"
    runs: list[tuple[str, Trajectory]] = []
    with show.progress("simulate", len(pairs)) as advance:
        for file, (scenario, label, controller) in zip(files, pairs, strict=True):
            step = partial(advance, f"{scenario.name}, {label}")
            pace = Driver() if driver else None
            run = drive(body, controller, scenario, profile=world, driver=pace, seed=seed, progress=step)
            if out is not None:
                run.save(out / f"{file}.parquet")
            runs.append((label, run))
            interrupt.kept(f"{len(runs)} of {len(pairs)} runs were finished; {where}. Run the command again.")
    return runs


def _write_report(out: Path, runs: Sequence[tuple[str, Trajectory]], png: bool) -> Path:
    from adaptrack.results import Run, write_report

    with show.progress("write the report"):
        shown = [Run(run, label=label) for label, run in runs]
        return write_report(out, shown, command=options.command_line(), png=png)


def measured_row(controller: str, run: Trajectory, model: PredictionModel | None = None) -> dict[str, Any]:
    """What --json says about a run: what was driven, `failed` (the reason, or null), `failed_at` (s), the metrics.

    model: of the controller, if it has one.
    """
    from adaptrack.drive.metrics import compute_metrics

    meta, measures = run.meta, compute_metrics(run, model=model).as_row()
    del measures["failed"]
    reason, clause = measures.pop("failed_reason"), measures.pop("failed_because")
    return {
        "scenario": run.name_of("scenario"),
        "controller": controller,
        "vehicle": run.name_of("vehicle"),
        "plant": run.name_of("plant"),
        "tyre": run.name_of("tyre"),
        "profile": meta["profile"],
        "preview": meta["preview"],
        "speed": meta["speed"],
        "seed": meta["seed"],
        "period": run.period,
        **{key.lower(): value for key, value in meta["tuning"].items()},
        "moves": meta["control"].get("moves"),
        "scheduler": meta["control"].get("scheduler"),
        "solver": meta["control"].get("solver"),
        "belief": meta["control"].get("belief"),
        "failed": reason or None,
        "failed_at": measures.pop("failed_at"),
        "failed_because": clause or None,
        **measures,
    }


def _print(rows: Sequence[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        show.say_json({"rows": rows})
    else:
        shown = [{**row, "result": "failed" if row["failed"] else "ok"} for row in rows]
        show.table("Closed-loop runs", COLUMNS, shown)
    for row in rows:
        run = f"{row['scenario']}, {row['controller']}"
        if row["failed"]:
            show.say_failed(f"{run}: at {row['failed_at']:.2f} s the vehicle {row['failed_because']}.", aside=as_json)
        tell_open_qps(row, as_json)


def tell_open_qps(row: dict[str, Any], as_json: bool) -> None:
    """How many QPs of a run have no certified answer, if any."""
    unsolved = row["qp_capped"] + row["qp_failed"]
    if unsolved and not as_json:
        run = f"{row['scenario']}, {row['controller']}"
        show.say(f"Warning, {run}: {unsolved:,} of {row['driven']:,} QPs not solved.")


def tell_belief(label: str, controller: Controller, body: Any, world: Profile, aside: bool) -> None:
    """What a controller believes of its steering, and the simulated one where it is another."""
    belief = controller.belief
    if belief is None:
        return
    warning = "Warning, " if belief.assumed else ""
    show.say(f"{warning}{label} believes of its steering: {belief}.", aside=aside)
    actuator = getattr(body, "steering", None) or world.steering
    driven = (actuator.lag, world.delay * controller.period + actuator.dead_time, actuator.rate)
    if not all(map(math.isclose, (belief.lag.value, belief.delay, belief.rate.value), driven)):
        lag, late, rate = driven
        show.say(
            f"The simulated steering is another: lag {lag:.4g} s, {late:.4g} s from measurement to wheels, rate "
            f"{rate:.4g} rad/s.",
            aside=aside,
        )


def tell_domain(scenario: Scenario, car: Vehicle, aside: bool) -> None:
    """Say when a scenario is much faster than what a car is driven at."""
    fastest, usual = float(scenario.sample(0.1).speed.max()), car.domain.speed[1]
    if fastest > BEYOND * usual:
        show.say(
            f"Warning, {scenario.name}: reaches {fastest:.3g} m/s; the domain of car {car.name!r} ends at {usual:g} "
            "m/s (--option speed=...).",
            aside=aside,
        )


def tell_stiffness(car: Vehicle, body: Any, aside: bool) -> None:
    """The remedy where a failed car's model and its tyre disagree about the stiffness."""
    tyre = getattr(body, "tyre", None)
    if tyre is None or max(abs(math.log(factor)) for factor in car.stiffness_factors(tyre)) < math.log(STIFFNESS):
        return
    matched = car.matched_to(tyre)
    show.say(
        f"The model of car {car.name!r} believes {car.stiffness_front:.0f} and {car.stiffness_rear:.0f} N/rad (a front "
        f"and a rear tyre), the driven tyre {tyre.name!r} has {matched.stiffness_front:.0f} and "
        f"{matched.stiffness_rear:.0f}. Write these into the car's file as stiffness_front and stiffness_rear (in "
        "Python: car.matched_to(tyre)), or drive another tyre.",
        aside=aside,
    )
