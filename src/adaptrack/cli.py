"""The command line. Every command imports what it needs when it runs: `adaptrack --help` loads no numerics."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adaptrack import __version__
from adaptrack.errors import AdaptrackError, InvalidInput

if TYPE_CHECKING:
    from adaptrack.trajectory import Trajectory

app = typer.Typer(
    name="adaptrack",
    help="Auto-tuned, auto-adaptive model predictive control for path tracking.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
bench_app = typer.Typer(help="Time the package on this machine.", no_args_is_help=True)
app.add_typer(bench_app, name="bench")
dataset_app = typer.Typer(help="Data sets of tuned conditions.", no_args_is_help=True)
app.add_typer(dataset_app, name="dataset")


class ProfileName(StrEnum):
    """Profiles."""

    paper = "paper"
    road = "road"


class PlantName(StrEnum):
    """Plants."""

    single_track = "single-track"
    dual_track = "dual-track"


class MovesName(StrEnum):
    """Parametrisations of the moves."""

    pulse = "pulse"
    laguerre = "laguerre"


class ModelName(StrEnum):
    """Models that learn a tuning."""

    nn = "nn"
    anfis = "anfis"


class TargetsName(StrEnum):
    """What they learn."""

    paper = "paper"
    ratio = "ratio"


class ControllerName(StrEnum):
    """Controllers: `standard` is what the options say; the others fix the moves."""

    standard = "standard"
    as_written = "as-written"
    as_released = "as-released"


def main() -> int:
    """Run the command line; errors that adaptrack raises on purpose become one message and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except AdaptrackError as error:
        print(f"adaptrack: {error}", file=sys.stderr)
        return 2
    except typer.Exit as done:
        return done.exit_code
    except typer.Abort:
        print("adaptrack: interrupted.", file=sys.stderr)
        return 130
    except Exception as error:
        # Typer's own complaints about the command line know how to show themselves.
        show = getattr(error, "show", None)
        if show is None:
            raise
        show()
        return int(getattr(error, "exit_code", 2))
    return code if isinstance(code, int) else 0


def _version(asked: bool) -> None:
    if asked:
        print(f"adaptrack {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Auto-tuned, auto-adaptive model predictive control for path tracking."""


Option = typer.Option


@app.command()
def simulate(
    scenarios: Annotated[
        list[str], typer.Argument(metavar="SCENARIO...", help="Names (see `scenarios`) or .toml/.csv files.")
    ],
    controller: Annotated[
        list[ControllerName] | None,
        Option(help="standard: as the options say [default]; as-written: pulses; as-released: Laguerre, pole 0.95."),
    ] = None,
    vehicle: Annotated[str, Option(help="Name (see `vehicles`) or .toml file.")] = "paper",
    plant: Annotated[PlantName, Option(help="What is driven.")] = PlantName.dual_track,
    tyre: Annotated[str | None, Option(help="Name (see `vehicles`) or .toml file; by default the vehicle's.")] = None,
    profile: Annotated[ProfileName, Option(help="paper: ideal; road: steering lag, noise, delay.")] = ProfileName.paper,
    driver: Annotated[bool, Option("--driver/--perfect-speed", help="Powertrain and driver, or exact speed.")] = False,
    np_: Annotated[int, Option("--np", help="Prediction horizon (periods).")] = 35,
    nc: Annotated[int, Option("--nc", help="Control horizon (periods).")] = 8,
    q: Annotated[float, Option("--q", help="Weight of the tracking error (1/m^2).")] = 10.0,
    r: Annotated[float, Option("--r", help="Weight of the moves (1/rad^2).")] = 0.01,
    moves: Annotated[MovesName, Option(help="pulse: eq. (10); laguerre: Laguerre functions.")] = MovesName.pulse,
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
    seed: Annotated[int, Option(help="Seed of the sensor noise.")] = 0,
    option: Annotated[
        list[str] | None,
        Option("--option", "-o", metavar="KEY=VALUE", help="Option of the scenario, e.g. speed=20."),
    ] = None,
    out: Annotated[Path | None, Option(help="Folder for the report and the trajectories.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Drive scenarios with the MPC; print the metrics, write the report."""
    from adaptrack.metrics import compute_metrics
    from adaptrack.mpc import MPC, Moves, Tuning
    from adaptrack.plant import DualTrack, SingleTrack, load_profile
    from adaptrack.scenario import load_scenario
    from adaptrack.schedule import load_scheduler
    from adaptrack.simulate import Driver
    from adaptrack.simulate import simulate as drive
    from adaptrack.vehicle import load_vehicle

    options = _scenario_options(option or [])
    loaded = [load_scenario(name, **options) for name in scenarios]
    car = load_vehicle(vehicle)
    world = load_profile(str(profile))
    ahead = world.preview if preview is None else preview
    ts = period or world.period
    body = (SingleTrack if plant is PlantName.single_track else DualTrack)(car, tyre)
    asked = {
        ControllerName.standard: Moves(str(moves), laguerre_pole, laguerre_terms),
        ControllerName.as_written: Moves.pulses(),
        ControllerName.as_released: Moves.laguerre(0.95, laguerre_terms),
    }
    schedule = None if scheduler is None else load_scheduler(scheduler)
    most = max(20, nc, 0 if schedule is None else schedule.largest[1])
    controllers = [
        (
            str(name) if schedule is None else schedule.name if name == "standard" else f"{schedule.name}-{name}",
            MPC(
                car, Tuning(np_, nc, q, r), period=ts, moves=asked[name], preview=ahead, solver=solver,
                scheduler=schedule, most_moves=most,
            ),
        )
        for name in dict.fromkeys(controller or [ControllerName.standard])
    ]  # fmt: skip
    if out is not None:
        _make_folder(out)

    runs: list[tuple[str, Trajectory]] = []
    with _progress(len(loaded) * len(controllers), quiet=as_json) as advance:
        for scenario in loaded:
            for name, mpc in controllers:
                show = partial(advance, f"{scenario.name}, {name}")
                pace = Driver() if driver else None
                run = drive(body, mpc, scenario, profile=world, driver=pace, seed=seed, progress=show)
                runs.append((name, run))
    rows = [_row(label, run, compute_metrics(run).as_row()) for label, run in runs]
    if out is not None:
        from adaptrack.report import Run, write_report

        for label, run in runs:
            run.save(out / f"{run.name_of('scenario')}-{label}.parquet")
        page = write_report(out, [Run(run, label=label) for label, run in runs], command=_command())
        _tell(f"Report: {page}", quiet=as_json)
    if as_json:
        print(json.dumps({"rows": rows}, allow_nan=False))
    else:
        _table(
            "Closed-loop runs",
            ("scenario", "controller", "mse", "max_abs_error", "at_any_limit", "qp_capped", "qp_failed", "step_us_p50"),
            rows,
        )


def _row(controller: str, run: Trajectory, measures: dict[str, Any]) -> dict[str, Any]:
    meta = run.meta
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
        "moves": meta["control"]["moves"],
        "scheduler": meta["control"]["scheduler"],
        "solver": meta["control"]["solver"],
        **measures,
    }


@app.command()
def scenarios(as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False) -> None:
    """List the scenarios that have a name, and their options."""
    from adaptrack.scenario import list_scenarios, scenario_options

    rows = [
        {"scenario": name, "what it is": text, "options": ", ".join(scenario_options(name))}
        for name, text in list_scenarios().items()
    ]
    _list("Scenarios", rows, as_json)


@app.command()
def vehicles(as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False) -> None:
    """List the vehicles and tyres that have a name."""
    from adaptrack.vehicle import list_tyres, list_vehicles, load_tyre, load_vehicle

    rows = [
        {"kind": "vehicle", "name": name, "what it is": load_vehicle(name).description, "tyre": load_vehicle(name).tyre}
        for name in list_vehicles()
    ] + [{"kind": "tyre", "name": name, "what it is": load_tyre(name).description, "tyre": ""} for name in list_tyres()]
    _list("Vehicles and tyres", rows, as_json)


@app.command()
def tune(
    config: Annotated[str, Option(help="Name (paper-grid, road-sobol) or .toml file of the campaign.")],
    out: Annotated[Path, Option(help="Folder of the campaign.")],
    resume: Annotated[bool, Option("--resume", help="Go on with the campaign in that folder.")] = False,
    workers: Annotated[int | None, Option(help="Threads, by default one per core.")] = None,
    dask: Annotated[str | None, Option(metavar="ADDRESS", help="Dask scheduler whose workers do it instead.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Tune the MPC on every condition of a campaign: a swarm each, and the cost of a common library."""
    import time

    from adaptrack.tuning.campaign import CampaignInterrupted, Progress, run_campaign
    from adaptrack.tuning.config import load_campaign

    campaign = load_campaign(config)
    begun = time.perf_counter()
    last: list[Progress] = []
    try:
        with _progress(1, quiet=as_json) as show:

            def told(at: Progress) -> None:
                last[:] = [at]
                left = f"{at.runs_per_s:,.0f} runs/s, {at.seconds_left:,.0f} s left"
                show(f"{at.done:,} of {at.total:,} conditions, {left}", at.done, at.total)

            file = run_campaign(campaign, out, resume=resume, workers=workers, dask=dask, progress=told)
    except CampaignInterrupted as stop:
        print(f"adaptrack: {stop}", file=sys.stderr)
        raise typer.Exit(130) from None
    seconds = time.perf_counter() - begun
    if as_json:
        runs = last[0].runs if last else 0
        print(json.dumps({"dataset": str(file), "seconds": seconds, "runs": runs}))
    else:
        print(f"Data set: {file} ({seconds:,.0f} s)")


@app.command()
def train(
    data: Annotated[str, Option(help="Name (see `dataset list`), file, or folder of a campaign.")],
    model: Annotated[ModelName, Option(help="nn: 4-16-8-1 networks; anfis: fuzzy systems.")],
    out: Annotated[Path, Option(help="File of the scheduler, *.json.")],
    targets: Annotated[
        TargetsName, Option(help="paper: Np, Nc, Q and R; ratio: log10 R/Q in place of the two weights.")
    ] = TargetsName.paper,
    seed: Annotated[int, Option(help="Of the hold-out and of the first weights.")] = 0,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Learn a scheduler from the tuned conditions of a data set; print how well, on conditions held out."""
    from adaptrack.adaptation.recipes import trained_schedule
    from adaptrack.dataset import load_dataset
    from adaptrack.learning.training import train as learn
    from adaptrack.schedule import check_scheduler

    if out.suffix != ".json":
        raise InvalidInput(f"--out {out}: a scheduler's file is called *.json.")
    dataset = load_dataset(data)
    _make_folder(out.parent)
    trained = learn(dataset, str(model), str(targets), seed=seed)
    schedule = trained_schedule(trained, dataset)
    check_scheduler(schedule)
    schedule.save(out)
    rows = trained.quality
    if as_json:
        told = {"scheduler": str(out), "data": dataset.name, "model": str(model), "targets": str(targets), "rows": rows}
        print(json.dumps(told, allow_nan=False))
        return
    columns = ("slot", "r2", "ceiling_r2", "rmse", "ceiling_rmse", "dead_share", "parameters", "seconds")
    _table(f"{dataset.name}, {rows[0]['n_holdout']} of {len(dataset)} conditions held out", columns, rows)
    print(f"Scheduler: {out}")


@app.command()
def reproduce(
    out: Annotated[Path, Option(help="Folder for the page and its pictures.")],
    quick: Annotated[bool, Option("--quick", help="Learn for fewer epochs, from fewer conditions.")] = False,
    data: Annotated[str, Option(help="Data set to learn from; its conditions must fill a grid.")] = "paper-grid",
    seed: Annotated[int, Option(help="Of the hold-out and of the first weights.")] = 0,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Run the paper's experiment again: learn, drive both tests with every controller, write the page about it."""
    from adaptrack.dataset import load_dataset
    from adaptrack.report.reproduce import write_reproduction
    from adaptrack.studies.reproduce import reproduce as run_again

    dataset = load_dataset(data)
    _make_folder(out)
    with _progress(1, quiet=as_json) as show:
        made = run_again(dataset, quick=quick, seed=seed, folder=out, progress=show)
    page = write_reproduction(out, made, command=_command())
    _tell(f"Report: {page}", quiet=as_json)
    if as_json:
        print(json.dumps(made.as_json(), allow_nan=False))
        return
    columns = ("scenario", "controller", "preview", "moves", "mse", "paper_mse", "ratio", "lost")
    for configuration in dict.fromkeys(row["configuration"] for row in made.rows):
        _table(configuration, columns, [row for row in made.rows if row["configuration"] == configuration])
    print(f"{made.seconds:.0f} s, of which {made.training_seconds:.0f} s learning")


@app.command()
def adapt(
    out: Annotated[Path, Option(help="Folder of the chain; one that was interrupted goes on.")],
    config: Annotated[str, Option(help="Name (road) or .toml file.")] = "road",
    workers: Annotated[int | None, Option(help="Threads of the campaign, by default one per core.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """The whole chain: tune on conditions, learn schedulers, guard them, evaluate them on roads nobody trained on."""
    from adaptrack.adaptation.config import load_adaptation
    from adaptrack.studies.adapt import Adapted
    from adaptrack.studies.adapt import adapt as run

    settings = load_adaptation(config)
    _make_folder(out)
    with _progress(1, quiet=as_json) as show:
        made: Adapted = run(settings, out, workers=workers, progress=show)
    page = _comparison_page(out, made)
    _tell(f"Schedulers: {out / 'schedulers'}\nReport: {page}", quiet=as_json)
    _comparisons(made, as_json)


@app.command()
def certify(
    scheduler: Annotated[str, typer.Argument(help="Name (see `schedulers`) or .json file (see `train`).")],
    profile: Annotated[ProfileName, Option(help="paper: ideal; road: steering lag, delay.")] = ProfileName.road,
    vehicle: Annotated[str, Option(help="Name (see `vehicles`) or .toml file.")] = "paper",
    plant: Annotated[PlantName, Option(help="What is driven.")] = PlantName.dual_track,
    tyre: Annotated[str | None, Option(help="Name (see `vehicles`) or .toml file; by default the vehicle's.")] = None,
    out: Annotated[Path | None, Option(help="Folder for the page with the maps.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Map spectral radius, gain and delay margins over the operating domain; exit code 1 when a point is unstable."""
    from adaptrack.certify import certify as look
    from adaptrack.mpc import MPC
    from adaptrack.plant import DualTrack, SingleTrack, load_profile
    from adaptrack.schedule import load_scheduler
    from adaptrack.vehicle import load_vehicle

    schedule = load_scheduler(scheduler)
    car = load_vehicle(vehicle)
    body = (SingleTrack if plant is PlantName.single_track else DualTrack)(car, tyre)
    longest, most = schedule.largest
    mpc = MPC(car, period=load_profile(str(profile)).period, longest_horizon=max(60, longest), most_moves=max(20, most))
    if out is not None:
        _make_folder(out)
    with _progress(1, quiet=as_json) as show:
        found = look(schedule, body, mpc, str(profile), progress=show)
    if out is not None:
        from adaptrack.report.certificate import write_certificate

        _tell(f"Report: {write_certificate(out, found, command=_command())}", quiet=as_json)
    summary = found.summary()
    if as_json:
        print(json.dumps({**summary, "rows": found.rows()}, allow_nan=False))
    else:
        columns = ("guard", "speed", "friction", "Np", "Nc", "Q", "R", "driving", "radius", "gain_up", "gain_down",
                   "delay", "nearness")  # fmt: skip
        sweeps = [(found.guarded is not None, found.counted)]
        if found.guarded is not None:
            sweeps.append((False, found.bare))
        worst = [{"guard": guard, **point} for guard, sweep in sweeps for point in found.worst_points(5, sweep)]
        _table(f"{found.scheduler}: the points nearest to instability", columns, worst)
        print(f"{summary['points']:,} points, {summary['unstable']:,} unstable")
    if not found.passed:
        at = summary["worst"]
        _tell(
            f"adaptrack: unstable at {summary['unstable']:,} of {summary['points']:,} points; the worst: "
            f"{at['speed']:g} m/s on friction {at['friction']:g}, "
            f"{'in a turn' if at['driving'] == 'turn' else 'straight'}, with Np = {at['Np']:g}, Nc = {at['Nc']:g}, "
            f"Q = {at['Q']:g}, R = {at['R']:g}: spectral radius {at['radius']:.4f}.",
            quiet=True,
        )
        raise typer.Exit(1)


@app.command()
def evaluate(
    schedulers: Annotated[
        list[str] | None, Option(help="Names (see `schedulers`) or files, beside those that ship with the package.")
    ] = None,
    contenders: Annotated[
        list[str] | None, Option("--contender", help="Name of a registered contender, driven beside the schedulers.")
    ] = None,
    conditions: Annotated[str | None, Option(metavar="sobol:N", help="So many unseen operating points.")] = None,
    drives: Annotated[int | None, Option(min=1, help="So many random drives of 60 s.")] = None,
    tests: Annotated[bool, Option("--tests", help="The paper's two tests.")] = False,
    config: Annotated[str, Option(help="Whose vehicle, profile and domain: name (road) or .toml file.")] = "road",
    profile: Annotated[ProfileName | None, Option(help="Must be the configuration's; for the record.")] = None,
    knowledge: Annotated[
        list[str] | None,
        Option("--told", help="How friction and wind are known: exact, noisy, lagged, estimated, withheld, ..."),
    ] = None,
    seed: Annotated[int, Option(min=0, help="Which conditions and drives.")] = 7,
    out: Annotated[Path | None, Option(help="Folder for the page.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object on standard output, nothing else.")] = False,
) -> None:
    """Compare schedulers with the best constant and the per-condition optimum, on conditions and drives never seen."""
    from adaptrack.adaptation.config import load_adaptation
    from adaptrack.adaptation.splits import SetUp
    from adaptrack.comparison.contenders import check_contender
    from adaptrack.comparison.evaluate import on_drives, on_operating_points, on_tests
    from adaptrack.runs import perception
    from adaptrack.schedule import check_scheduler, load_scheduler
    from adaptrack.studies.adapt import Adapted, shipped

    settings = load_adaptation(config)
    setup = SetUp.of(settings)
    if profile is not None and str(profile) != setup.profile:
        raise InvalidInput(f"--profile {profile}: configuration {settings.name!r} is for {setup.profile!r}.")
    schedules = shipped(settings.name)
    for name in schedulers or []:
        schedule = load_scheduler(name)
        check_scheduler(schedule)
        schedules[schedule.name if schedule.name not in schedules else f"{schedule.name} ({name})"] = schedule
    if conditions is None and drives is None and not tests:
        conditions = "sobol:2000"
    points = 0 if conditions is None else _sample_size(conditions)
    ways = tuple(dict.fromkeys(["exact", *(knowledge or [])]))
    for way in ways:
        perception(way, setup.plant, setup.profile)  # an unknown one is refused before any work
    more = contenders or []
    for name in more:
        check_contender(name)
    if out is not None:
        _make_folder(out)
    with _progress(1, quiet=as_json) as show:
        told: dict[str, Any] = {"known_as": ways, "more": more, "progress": show}
        made = Adapted(
            schedules,
            {},
            on_operating_points(setup, schedules, points, seed, **told) if points else {},
            on_drives(setup, schedules, drives, seed, **told) if drives else {},
            on_tests(setup, schedules, more=more) if tests else {},
        )
    if out is not None:
        _tell(f"Report: {_comparison_page(out, made)}", quiet=as_json)
    _comparisons(made, as_json)


def _sample_size(text: str) -> int:
    """The N of `sobol:N`."""
    kind, _, count = text.partition(":")
    if kind != "sobol" or not count.isdecimal() or int(count) < 1:
        raise InvalidInput(f"conditions = {text!r}: write sobol:N, for instance sobol:2000.")
    return int(count)


def _comparison_page(out: Path, made: Any) -> Path:
    from adaptrack.report.comparison import write_comparison

    return write_comparison(
        out,
        operating_points=made.operating_points,
        drives=made.drives,
        tests=made.tests,
        schedules=made.schedules,
        histories=made.histories,
        command=_command(),
    )


def _comparisons(made: Any, as_json: bool) -> None:
    """The rows of comparisons: by view, then by how friction and wind are known, or by test."""
    from adaptrack.comparison.compare import finite

    views = {"operating points": made.operating_points, "drives": made.drives, "tests": made.tests}
    rows: list[dict[str, Any]] = []
    for view, comparisons in views.items():
        for name, each in comparisons.items():
            rows += [
                {"view": view, "scenario" if view == "tests" else "known_as": name, "reference": each.reference, **row}
                for row in finite(each.rows())
            ]
    if as_json:
        print(json.dumps({"rows": rows}, allow_nan=False))
        return
    columns = ("contender", "cost_geomean", "regret_geomean", "regret_low", "regret_high", "regret_p50", "regret_p90",
               "regret_p99", "regret_worst", "failures")  # fmt: skip
    for view, comparisons in views.items():
        for name, each in comparisons.items():
            title = f"{view}, {name}: {len(each.where)} runs, regret to {each.reference}"
            _table(title, columns, each.rows())


@app.command()
def schedulers(as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False) -> None:
    """List the schedulers that ship with the package."""
    from adaptrack.schedule import list_schedulers, load_scheduler

    rows = [
        {"name": name, "contender": load_scheduler(name).name, "inputs": ", ".join(load_scheduler(name).inputs)}
        for name in list_schedulers()
    ]
    _list("Schedulers", rows, as_json)


@dataset_app.command("describe")
def describe_dataset(
    name: Annotated[str, typer.Argument(help="Name (see `dataset list`), file, or folder of a campaign.")],
    out: Annotated[Path | None, Option(help="Folder for the page with the pictures.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object.")] = False,
) -> None:
    """Tell what is in a data set: ranges, optimum, how much the conditions explain, how flat the optimum is."""
    from adaptrack.dataset import describe, load_dataset

    dataset = load_dataset(name)
    told = describe(dataset)
    if out is not None:
        from adaptrack.report import write_dataset_report

        _make_folder(out)
        _tell(f"Report: {write_dataset_report(out, dataset, summary=told)}", quiet=as_json)
    if as_json:
        print(json.dumps(told, allow_nan=False))
        return
    _flat(told["name"], {key: value for key, value in told.items() if not isinstance(value, dict | list)}, False)
    for key, value in told.items():
        rows = value if isinstance(value, list) else []
        if isinstance(value, dict):
            rows = [{"what": what, "value": entry} for what, entry in value.items()]
        if rows and isinstance(rows[0], dict):
            _table(key.replace("_", " "), tuple(rows[0]), rows)


@dataset_app.command("list")
def datasets(as_json: Annotated[bool, Option("--json", help="One JSON object.")] = False) -> None:
    """List the data sets that have a name."""
    from adaptrack.dataset import list_datasets

    rows = [{"name": name} for name in list_datasets()]
    if rows or as_json:
        _list("Data sets", rows, as_json)


@bench_app.command("step")
def bench_step(
    count: Annotated[int, typer.Option(help="Control steps to time.")] = 4000,
    as_json: Annotated[bool, typer.Option("--json", help="One flat JSON object.")] = False,
) -> None:
    """Time one control step called from Python, beside a plain NumPy + DAQP controller."""
    from adaptrack.benchmark import bench_step as measure

    _flat("One control step from Python", measure(count), as_json)


@bench_app.command("rollout")
def bench_rollout(
    conditions: Annotated[int, typer.Option(help="Conditions to run, 20 tunings each.")] = 150,
    threads: Annotated[int | None, typer.Option(help="By default one per core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One flat JSON object.")] = False,
) -> None:
    """Time the compiled batch of runs, beside a plain NumPy + DAQP loop."""
    from adaptrack.benchmark import bench_rollout as measure

    _flat("Compiled batch of runs", measure(conditions, threads), as_json)


@bench_app.command("campaign")
def bench_campaign(
    conditions: Annotated[int, Option(help="Conditions of the paper's grid to tune.")] = 48,
    threads: Annotated[int | None, Option(help="By default one per core.")] = None,
    as_json: Annotated[bool, Option("--json", help="One flat JSON object.")] = False,
) -> None:
    """Time swarms and landscape on a sample of the paper's campaign."""
    from adaptrack.benchmark import bench_campaign as measure

    _flat("A sample of the paper's campaign", measure(conditions, threads), as_json)


# -- how things are shown ---------------------------------------------------------------------------------------------
def _scenario_options(given: list[str]) -> dict[str, Any]:
    """`speed=20`, `friction=[0.9, 0.5]`, `window=full`: values are read as TOML, else taken as text."""
    import tomllib

    options: dict[str, Any] = {}
    for text in given:
        key, sign, value = text.partition("=")
        if not sign:
            raise InvalidInput(f"--option {text}: write KEY=VALUE, for instance speed=20.")
        try:
            options[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            options[key.strip()] = value.strip()
    return options


def _make_folder(path: Path) -> None:
    from adaptrack.errors import StorageError

    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = path / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise StorageError(f"{path}: cannot be written to: {error.strerror or error}.") from error


def _command() -> str:
    """The command line at hand."""
    return shlex.join(["adaptrack", *sys.argv[1:]])


def _tell(text: str, quiet: bool = False) -> None:
    print(text, file=sys.stderr if quiet else sys.stdout)


@contextmanager
def _progress(total: int, quiet: bool) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on standard error; yields show(label, steps done, steps in all), for one drive at a time."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        finished = 0

        def show(label: str, done: int, steps: int) -> None:
            nonlocal finished
            bar.update(task, completed=finished + done / steps, description=label)
            finished += done == steps

        yield show


def _list(title: str, rows: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"rows": rows}))
    else:
        _table(title, tuple(rows[0]), rows)


def _flat(title: str, values: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print(json.dumps(values, allow_nan=False))
    else:
        _table(title, ("what", "value"), [{"what": key, "value": value} for key, value in values.items()])


def _table(title: str, columns: tuple[str, ...], rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title)
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(_show(row[column]) for column in columns))
    Console(width=None if sys.stdout.isatty() else 140).print(table)


def _show(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
