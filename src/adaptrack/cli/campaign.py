"""`adaptrack campaign`: an MPC tuned on every operating point of a campaign."""

from __future__ import annotations

import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, say_next

if TYPE_CHECKING:
    from adaptrack.paper.campaign import Progress
    from adaptrack.paper.campaign_config import CampaignConfig

STEPS_PER_S = 8e5
"""Control steps that one thread simulates in a second (docs/campaign.md), for an estimate."""


@dataclass(frozen=True, kw_only=True)
class CampaignOptions:
    """Options of `adaptrack campaign`."""

    config: Annotated[str, typer.Argument(metavar="CAMPAIGN", help="Name (paper-grid, road-sobol, ...) or .toml file.")]
    out: Annotated[Path, Option("--out", metavar="DIR", help="Folder of the campaign.")]
    profile: options.OtherProfile = None
    resume: Annotated[bool, Option("--resume", help="Go on with the campaign in that folder.")] = False
    workers: options.Workers = None
    dask: Annotated[
        str | None,
        Option("--dask", metavar="ADDRESS", hidden=True, help="Dask scheduler whose workers do it, tcp://HOST:PORT."),
    ] = None
    as_json: options.Json = False


@options.grouped
def campaign(given: CampaignOptions) -> None:
    """Tune an MPC on every operating point of a campaign.

    A swarm for each, and the cost of a common library of tunings. Runs that fail are counted; the exit code is 0.
    """
    from adaptrack.paper.campaign import CampaignInterrupted, run_campaign
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.paper.data_set import load_dataset

    out, dask = given.out, given.dask
    config = load_campaign(given.config).in_profile(given.profile)
    show.say(_estimate(config, None if dask else given.workers or os.cpu_count() or 1), aside=True)
    interrupt.kept(f"Finished chunks, if any, are kept in {out}: go on with --resume.")
    begun, runs = time.perf_counter(), 0
    try:
        with show.progress("campaign") as advance:

            def tell(at: Progress) -> None:
                nonlocal runs
                runs = at.runs
                advance(f"{at.done:,} of {at.total:,} operating points, {at.runs_per_s:,.0f} runs/s", at.done, at.total)

            file = run_campaign(config, out, resume=given.resume, workers=given.workers, dask=dask, progress=tell)
    except CampaignInterrupted as stop:
        interrupt.kept(str(stop).removeprefix("interrupted. "))
        raise
    seconds = time.perf_counter() - begun
    costs = load_dataset(file).best_costs
    failures = int((costs == math.inf).sum())
    if given.as_json:
        show.say_json({"dataset": str(file), "seconds": seconds, "runs": runs, "failures": failures})
        return
    show.say(f"At {failures or 'none'} of the {len(costs):,} operating points the run failed with every tuning.")
    show.say(f"Data set: {file} ({seconds:,.0f} s)")
    say_next("learn a scheduler from it", command("train", "--data", out, "--model", "nn", "--out", "nn.json"))


def _estimate(campaign: CampaignConfig, threads: int | None) -> str:
    """How much work a campaign is: runs, memory, and the time on so many threads of this machine."""
    from adaptrack.paper.campaign_config import Plan
    from adaptrack.scenario.profile import load_profile

    plan = Plan.of(campaign)
    settled, points = plan.config, len(plan.fold.representatives)
    runs = points * (settled.swarm.evaluations + len(plan.library)) * len(settled.noise_seeds or (0,))
    size = 4e-6 * len(plan.operating_points) * len(plan.library)
    work = f"adaptrack: {points:,} operating points, {runs:,} runs, {size:,.0f} MB"
    if threads is None or settled.duration is None:
        return f"{work}."
    steps = runs * settled.duration / load_profile(settled.profile).period
    return f"{work}; about {show.duration(steps / (STEPS_PER_S * threads))} on {threads} threads, in all."
