"""`adaptrack bench`: time the package on this machine."""

from __future__ import annotations

from typing import Annotated

import typer

from adaptrack.cli import options, show
from adaptrack.limits import TIMED_GRID, TIMED_POINTS, TIMED_STEPS

app = typer.Typer(help="Time the package on this machine.", no_args_is_help=True)


ALONE = "nothing else should run on this machine, not even a progress bar."


@app.command("step")
def bench_step(
    count: Annotated[int, options.count_of("Control steps to time", TIMED_STEPS)] = 4000,
    as_json: options.Json = False,
) -> None:
    """Time one control step called from Python, beside a plain NumPy + DAQP controller."""
    from adaptrack.benchmark import bench_step as measure

    show.say(f"adaptrack: timing {count:,} control steps; {ALONE}", aside=True)
    show.flat("One control step from Python", measure(count), as_json)


@app.command("rollout")
def bench_rollout(
    conditions: Annotated[int, options.count_of("Operating points to run, 20 tunings each", TIMED_POINTS)] = 150,
    threads: options.Threads = None,
    as_json: options.Json = False,
) -> None:
    """Time the compiled batch of runs, beside a plain NumPy + DAQP loop."""
    from adaptrack.benchmark import bench_rollout as measure

    show.say(f"adaptrack: timing {20 * conditions:,} runs; {ALONE}", aside=True)
    show.flat("Compiled batch of runs", measure(conditions, threads), as_json)


@app.command("campaign")
def bench_campaign(
    conditions: Annotated[int, options.count_of("Operating points of the paper's grid to tune", TIMED_GRID)] = 48,
    threads: options.Threads = None,
    as_json: options.Json = False,
) -> None:
    """Time swarms and landscape on a sample of the paper's campaign."""
    from adaptrack.benchmark import bench_campaign as measure

    show.say(f"adaptrack: timing the swarms of {conditions:,} operating points; {ALONE}", aside=True)
    show.flat("A sample of the paper's campaign", measure(conditions, threads), as_json)
