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
from adaptrack.cli.next_step import again, command, say_next
from adaptrack.cli.show import Column
from adaptrack.results.console import print_table

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import Controller, LearnedCar, Learning, Moves, Tuning
    from adaptrack.control.models import PredictionModel
    from adaptrack.control.scheduling import Schedule
    from adaptrack.drive.trajectory import Trajectory
    from adaptrack.scenario import Scenario
    from adaptrack.scenario.profile import Profile

LEARNED = (
    Column("quantity", "learned"),
    Column("value", "value", "", 3),
    Column("low", "90 % from", "", 3),
    Column("high", "to", "", 3),
    Column("unit", "unit"),
)

FAILED = 3
"""The exit code when a run failed."""

STIFFNESS = 1.25
"""Factor between the tyre's stiffness and the model's from which a failed run says so."""

BEYOND = 1.25
"""Factor on the highest speed of a car's domain from which a scenario is said to leave it."""

INFORMED, STANDARD, AS_WRITTEN, AS_RELEASED = "informed", "standard", "as-written", "as-released"


@dataclass(frozen=True)
class PublishedOptions:
    """The tuning and the moves of the published MPC, and of the informed one where they are given."""

    np_: Annotated[int | None, Option("--np", hidden=True, help="Prediction horizon (periods); standard: 35.")] = None
    nc: Annotated[int | None, Option("--nc", hidden=True, help="Control horizon (periods); standard: 8.")] = None
    q: Annotated[
        float | None, Option("--q", hidden=True, help="Weight of the tracking error (1/m^2); standard: 10.")
    ] = None
    r: Annotated[float | None, Option("--r", hidden=True, help="Weight of the moves (1/rad^2); standard: 0.01.")] = None
    moves: Annotated[
        options.MovesName, Option("--moves", hidden=True, help="pulse: eq. (10); laguerre: Laguerre functions.")
    ] = options.MovesName.pulse
    laguerre_pole: Annotated[
        float, Option("--laguerre-pole", hidden=True, help="Pole a of the Laguerre functions.")
    ] = 0.95
    laguerre_terms: Annotated[int, Option("--laguerre-terms", hidden=True, help="Number of Laguerre functions.")] = 10
    solver: Annotated[
        str, Option("--solver", metavar="NAME", hidden=True, help="QP solver: active-set or hildreth")
    ] = "active-set"
    preview: Annotated[
        bool | None,
        Option("--preview/--no-preview", hidden=True, help="Know the reference ahead; by default the profile's."),
    ] = None

    @property
    def tuning(self) -> dict[str, Any]:
        """The entries that are given, by name."""
        entries = {"Np": self.np_, "Nc": self.nc, "Q": self.q, "R": self.r}
        return {name: value for name, value in entries.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class SimulateOptions:
    """Options of `adaptrack simulate`."""

    scenarios: Annotated[
        list[str], typer.Argument(metavar="SCENARIO...", help="Names (see `list scenarios`) or .toml/.csv files.")
    ]
    controller: Annotated[
        list[str] | None,
        Option(
            "--controller",
            metavar="NAME",
            help="informed: the MPC that knows its car [default]; standard: the published one, tuned by --np, --nc, "
            "--q, --r [default with these]; as-written, as-released: its two moves; lqr, pure-pursuit, stanley. May be "
            "repeated.",
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        Option("--scheduler", metavar="NAME", help="Name or .json file (see `train`): retunes the MPC at every step."),
    ] = None
    car: options.CarAndPlant
    profile: options.Profile = "paper"
    option: Annotated[
        list[str] | None,
        Option("--option", "-o", metavar="KEY=VALUE", help="Option of the scenario, e.g. speed=20."),
    ] = None
    published: PublishedOptions
    drive: options.DriveSettings


@options.grouped
def simulate(given: SimulateOptions) -> None:
    """Drive scenarios with a controller.

    A run that leaves the road, spins or is not finite is printed as FAILED; the exit code is then 3. A scheduler that
    was made for another car is certified on this one first, and refused where that loop is unstable.
    """
    from adaptrack.cli.new_car import certify_meeting
    from adaptrack.control.controllers import MPC
    from adaptrack.scenario import load_scenario
    from adaptrack.scenario.profile import load_profile

    how, as_json = given.drive, given.drive.as_json
    car, plant = given.car.load()
    chosen = scenario_options(given.option or [])
    loaded = [load_scenario(name, domain=car.domain, **chosen) for name in given.scenarios]
    world = load_profile(given.profile)
    settings = controller_settings(given, car, world)
    controllers = [make_controller(name, settings) for name in dict.fromkeys(given.controller or [settings.usual])]
    for scenario in loaded:
        tell_domain(scenario, car)
    how.make_places()
    for label, each in controllers:
        if isinstance(each, MPC):
            certify_meeting(label, each, plant, car, world, how.allow_failed)
    runs = _drive(loaded, controllers, plant, world, how)
    models = {label: each.model for label, each in controllers}
    rows = [measured_row(label, run, models[label]) for label, run in runs]
    failed = any(row["failed"] for row in rows)
    _print(rows, as_json)
    for label, each in controllers:
        tell_belief(label, each, plant, world, as_json)
        tell_learned(label, each, as_json)
    if failed:
        tell_stiffness(car, plant, as_json)
    else:
        keep_learned(how.learned, controllers, as_json)
    if how.out is not None:
        show.say(f"Page: {_write_report(how.out, runs, how.png)}", aside=as_json)
    if not as_json:
        say_next(*_next_step(given, rows))
    if failed and not how.allow_failed:
        raise typer.Exit(FAILED)


def _next_step(given: SimulateOptions, rows: Sequence[dict[str, Any]]) -> tuple[str, str]:
    """What to do after the runs, and the command."""
    driven, failed = {row["controller"] for row in rows}, {row["controller"] for row in rows if row["failed"]}
    usual = () if given.controller else tuple(word for each in driven for word in ("--controller", each))
    if failed and INFORMED not in driven and given.scheduler is None:
        return "to drive the controller that knows its car beside it", again(*usual, "--controller", INFORMED)
    if given.drive.out is None:
        return f"to see {'where it failed' if failed else 'the runs'} on a page", again("--out", "report")
    if driven == {INFORMED}:
        return "to drive another controller beside it", again(*usual, "--controller", "lqr")
    return "to drive a road", command("drive", "country", "--vehicle", given.car.vehicle, "--profile", "road")


# -- controllers ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ControllerSettings:
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
    computation: float | None = None
    """s; None: of the profile"""

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


def controller_settings(given: SimulateOptions, car: Vehicle, world: Profile) -> ControllerSettings:
    """What the options of `simulate` say about the controllers."""
    from adaptrack.control.controllers import Moves
    from adaptrack.control.scheduling import load_scheduler

    own, named = given.published, given.scheduler
    return ControllerSettings(
        car=car,
        profile=world,
        tuning=own.tuning,
        moves=Moves(own.moves.value, own.laguerre_pole, own.laguerre_terms),
        period=world.period if given.drive.period is None else given.drive.period,
        preview=world.preview if own.preview is None else own.preview,
        solver=own.solver,
        schedule=None if named is None else load_scheduler(named),
        label="" if named is None else Path(named).stem if named.endswith(".json") else named,
        learning=learning_of(given.drive),
    )


def make_controller(name: str, settings: ControllerSettings) -> tuple[str, Controller]:
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

    own = settings.moves or Moves.pulses()
    moves = {STANDARD: own, AS_WRITTEN: Moves.pulses(), AS_RELEASED: Moves.laguerre(0.95, own.terms)}
    others = [each for each in list_controllers() if each not in moves]
    if name in others:
        if settings.schedule is not None and (name != INFORMED or is_for_published(settings.schedule.made_for)):
            raise InvalidInput(
                f"--scheduler {settings.label}: tunes the {'published ' if name == INFORMED else ''}MPC; controller "
                f"{name!r} takes none{', --controller standard does' if name == INFORMED else ''}."
            )
        offered = {name: getattr(settings, name) for name in ("period", "preview", "computation")}
        options = dict[str, Any]()
        if name == INFORMED:
            options |= {"moves": own, "solver": settings.solver}
            if settings.learning is not None:
                options["learning"] = settings.learning
            if settings.schedule is not None:
                options |= {"scheduler": settings.schedule, "most_moves": max(20, settings.schedule.largest[1])}
            if settings.tuning:
                options["tuning"] = settings.tuned(informed_tuning(settings.profile, settings.period))
        label = settings.label if settings.schedule is not None else name
        return label, get_controller(name, settings.car, profile=settings.profile, offered=offered, **options)
    if name not in moves:
        raise UnknownName(f"no controller is named {name!r}. {did_you_mean(name, [*moves, *others])}")
    tuning = settings.tuned(Tuning())
    mpc = published_mpc(
        settings.car, tuning, period=settings.period, moves=moves[name], preview=settings.preview,
        solver=settings.solver, scheduler=settings.schedule, most_moves=_most_moves(tuning, settings),
    )  # fmt: skip
    if not settings.label:
        return name, mpc
    return settings.label if name == STANDARD else f"{settings.label}-{name}", mpc


def learning_of(how: options.DriveSettings) -> Learning | None:
    """How the informed controller learns; None: it does not."""
    from adaptrack.control.controllers import Learning, load_learned_car

    file = how.learned
    if not (how.learn or file is not None):
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


def _most_moves(tuning: Tuning, settings: ControllerSettings) -> int:
    return max(20, tuning.Nc, 0 if settings.schedule is None else settings.schedule.largest[1])


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
    scenarios: Sequence[Any], controllers: Sequence[tuple[str, Any]], plant: Any, world: Profile,
    how: options.DriveSettings,
) -> list[tuple[str, Trajectory]]:  # fmt: skip
    """Every scenario with every controller; each trajectory is saved as soon as it is driven."""
    from adaptrack.base.files import safe_names
    from adaptrack.drive.simulate import simulate as drive
    from adaptrack.drive.world import Driver

    pairs = [(scenario, *named) for scenario in scenarios for named in controllers]
    files = safe_names(f"{scenario.name}-{label}" for scenario, label, _ in pairs)
    out = how.out
    where = f"their trajectories are in {out}, without a report" if out else "nothing was written"
    runs: list[tuple[str, Trajectory]] = []
    with show.progress("simulate", len(pairs)) as advance:
        for file, (scenario, label, controller) in zip(files, pairs, strict=True):
            step = partial(advance, f"{scenario.name}, {label}")
            driver = Driver() if how.driver else None
            run = drive(plant, controller, scenario, profile=world, driver=driver, seed=how.seed, progress=step)
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
        "learning": meta["control"].get("learning"),
        "failed": reason or None,
        "failed_at": measures.pop("failed_at"),
        "failed_because": clause or None,
        **measures,
    }


def _print(rows: Sequence[dict[str, Any]], as_json: bool) -> None:
    from adaptrack.results.answers import of_runs
    from adaptrack.results.runs import console_table

    for row in rows:
        if row["failed"]:
            run = f"{row['scenario']}, {row['controller']}"
            show.say_failed(f"{run}: at {row['failed_at']:.2f} s the vehicle {row['failed_because']}.", aside=as_json)
    if as_json:
        show.say_json({"rows": rows})
    else:
        if not all(row["failed"] for row in rows):
            show.say(of_runs(rows))
        print_table(console_table(rows))
    for row in rows:
        tell_open_qps(row, as_json)


def tell_open_qps(row: dict[str, Any], as_json: bool) -> None:
    """How many QPs of a run have no certified answer, if any."""
    unsolved = row["qp_capped"] + row["qp_failed"]
    if unsolved and not as_json:
        run = f"{row['scenario']}, {row['controller']}"
        show.say(f"Warning, {run}: {unsolved:,} of {row['driven']:,} QPs not solved.")


def tell_belief(label: str, controller: Controller, plant: Any, world: Profile, aside: bool) -> None:
    """What a controller believes of its steering, and the simulated one where it is another."""
    belief = controller.belief
    if belief is None:
        return
    if controller.learner is not None:
        show.say(f"{label} {controller.learns}. It begins with: {belief}.", aside=aside)
    else:
        warning = "Warning, " if belief.assumed else ""
        show.say(f"{warning}{label} believes of its steering: {belief}.", aside=aside)
    actuator = getattr(plant, "steering", None) or world.steering
    driven = (actuator.lag, world.delay * controller.period + actuator.dead_time, actuator.rate)
    if not all(map(math.isclose, (belief.lag.value, belief.delay, belief.rate.value), driven)):
        lag, late, rate = driven
        show.say(
            f"The simulated steering is another: lag {lag:.4g} s, {late:.4g} s from measurement to wheels, rate "
            f"{rate:.4g} rad/s.",
            aside=aside,
        )


def tell_learned(label: str, controller: Controller, as_json: bool) -> None:
    """What a controller has learned of its car, each number with its interval."""
    if controller.learner is None or as_json:
        return
    mpc: Any = controller
    learned: LearnedCar = mpc.learned()
    rows = [each._asdict() for each in learned.intervals]
    title = f"Learned by {label} in {learned.seconds:.0f} s of driving; the belief is {mpc.belief_in_words}"
    show.table(title, LEARNED, rows)


def tell_domain(scenario: Scenario, car: Vehicle) -> None:
    """Say when a scenario is much faster than what a car is driven at."""
    fastest, usual = float(scenario.sample(0.1).speed.max()), car.domain.speed[1]
    if fastest > BEYOND * usual:
        show.say(
            f"Warning, {scenario.name}: reaches {fastest:.3g} m/s; the domain of car {car.name!r} ends at {usual:g} "
            "m/s (--option speed=...).",
            aside=True,
        )


def tell_stiffness(car: Vehicle, plant: Any, aside: bool) -> None:
    """The remedy where a failed car's model and its tyre disagree about the stiffness."""
    tyre = getattr(plant, "tyre", None)
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
