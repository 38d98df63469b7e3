"""`adaptrack tune`: one constant for roads, or a campaign."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, on_roads, options, show
from adaptrack.cli.road import RoadOptions

if TYPE_CHECKING:
    from adaptrack.tuning.campaign import Progress
    from adaptrack.tuning.config import CampaignConfig

STEPS_PER_S = 8e5
"""Control steps that one thread simulates in a second (docs/campaign.md), for an estimate."""


@options.grouped
def tune(
    asked: RoadOptions,
    car: on_roads.CarOptions,
    search: on_roads.SearchOptions,
    road: on_roads.Roads = None,
    config: Annotated[
        str | None, Option(help="Name (paper-grid, road-sobol, ...) or .toml file of a campaign, instead of roads.")
    ] = None,
    out: Annotated[
        Path | None, Option(help="File of the tuning, by default tuning.toml; folder of the campaign.")
    ] = None,
    controller: Annotated[
        str | None,
        Option(
            "--controller",
            help="Whose tuning is sought: informed, the MPC that knows its car; as-written, the paper's; on roads also "
            "kinematic-mpc, lqr, mppi, preview-lqr, pure-pursuit, stanley. By default informed, or the campaign's.",
        ),
    ] = None,
    profile: Annotated[
        str | None,
        Option("--profile", metavar="NAME", help="paper, road, production, ...: by default road, or the campaign's."),
    ] = None,
    plant: Annotated[
        str | None,
        Option("--plant", hidden=True, help="On roads: single-track, dual-track [default], or a registered plant."),
    ] = None,
    resume: Annotated[bool, Option("--resume", help="Go on with the campaign in that folder.")] = False,
    workers: options.Workers = None,
    dask: Annotated[
        str | None,
        Option(metavar="ADDRESS", hidden=True, help="Dask scheduler whose workers do it instead, tcp://HOST:PORT."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Seek the tuning of a controller that is best on given roads, and write it for `drive --tuning`.

    Or, with --config, tune an MPC on every operating point of a campaign: a swarm each, and the cost of a common
    library. Runs that fail are counted; the exit code is 0.
    """
    if bool(road) == (config is not None):
        raise InvalidInput("tune: give roads, or --config with a campaign.")
    if road:
        given = {"--resume": resume, "--workers": workers, "--dask": dask}
        on_roads.refuse([name for name, value in given.items() if value], "on roads")
        file = Path("tuning.toml") if out is None else out
        options.make_place(file)
        setting = on_roads.Setting.of(road, asked, car, profile, plant or "dual-track", as_json)
        on_roads.tune(setting, controller or "informed", search, car.noise_seeds or 2, file, as_json)
        return
    on_roads.refuse([*asked.named, *_given(car, plant, search)], "with a campaign")
    if out is None:
        raise InvalidInput("tune --config: give the campaign a folder, --out DIR.")
    if controller not in (None, *options.TunedName):
        raise InvalidInput(f"--controller {controller}: a campaign tunes {' or '.join(options.TunedName)}.")
    _campaign(str(config), out, (controller, profile), (resume, workers, dask), as_json)


def _given(car: on_roads.CarOptions, plant: str | None, search: on_roads.SearchOptions) -> list[str]:
    """The options of roads that are given."""
    values = {**vars(car), "plant": plant, "runs": search.runs, "seed": search.seed or None}
    return [f"--{name.replace('_', '-')}" for name, value in values.items() if value is not None]


def _campaign(
    config: str, out: Path, driven: tuple[str | None, str | None], how: tuple[bool, int | None, str | None],
    as_json: bool,
) -> None:  # fmt: skip
    """Run a campaign. driven: controller and profile; how: resume, workers, dask."""
    from adaptrack.tuning.campaign import CampaignInterrupted, run_campaign
    from adaptrack.tuning.config import load_campaign
    from adaptrack.tuning.dataset import load_dataset

    resume, workers, dask = how
    campaign = load_campaign(config).driven_by(*driven)
    show.say(_estimate(campaign, None if dask else workers or os.cpu_count() or 1), aside=True)
    interrupt.kept(f"Finished chunks, if any, are kept in {out}: go on with --resume.")
    begun, runs = time.perf_counter(), 0
    try:
        with show.progress("campaign") as advance:

            def tell(at: Progress) -> None:
                nonlocal runs
                runs = at.runs
                advance(f"{at.done:,} of {at.total:,} operating points, {at.runs_per_s:,.0f} runs/s", at.done, at.total)

            file = run_campaign(campaign, out, resume=resume, workers=workers, dask=dask, progress=tell)
    except CampaignInterrupted as stop:
        interrupt.kept(str(stop).removeprefix("interrupted. "))
        raise
    seconds = time.perf_counter() - begun
    costs = load_dataset(file).best_costs
    failures = int((costs == math.inf).sum())
    if as_json:
        show.say_json({"dataset": str(file), "seconds": seconds, "runs": runs, "failures": failures})
        return
    show.say(f"Data set: {file} ({seconds:,.0f} s)")
    show.say(f"At {failures or 'none'} of the {len(costs):,} operating points the run failed with every tuning.")


def _estimate(campaign: CampaignConfig, threads: int | None) -> str:
    """How much work a campaign is: runs, memory, and the time on so many threads of this machine."""
    from adaptrack.scenario.profile import load_profile
    from adaptrack.tuning.config import Plan

    plan = Plan.of(campaign)
    settled, points = plan.config, len(plan.fold.representatives)
    runs = points * (settled.swarm.evaluations + len(plan.library)) * len(settled.noise_seeds or (0,))
    size = 4e-6 * len(plan.operating_points) * len(plan.library)
    told = f"adaptrack: {points:,} operating points, {runs:,} runs, {size:,.0f} MB"
    if threads is None or settled.duration is None:
        return f"{told}."
    steps = runs * settled.duration / load_profile(settled.profile).period
    return f"{told}; about {show.duration(steps / (STEPS_PER_S * threads))} on {threads} threads, in all."
