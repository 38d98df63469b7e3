"""`adaptrack compare`: controllers x cars x roads x profiles, all tuned with the same effort; one table, one page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, next_line

if TYPE_CHECKING:
    from adaptrack.comparison.run import Compared


@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """Options of `adaptrack compare`."""

    out: Annotated[
        Path | None, Option("--out", metavar="FOLDER", help="Of the page and all runs; an interrupted one goes on.")
    ] = None
    quick: Annotated[bool, Option("--quick", help="Two cars, four roads, one profile: minutes [default].")] = False
    standard: Annotated[bool, Option("--standard", help="Six cars, twelve roads, three profiles.")] = False
    full: Annotated[bool, Option("--full", help="The same with 1,000 closed loops and those in Python: hours.")] = False
    config: Annotated[
        Path | None, Option("--config", metavar="FILE", help="TOML file of a comparison of your own.")
    ] = None
    contender: Annotated[
        list[str] | None, Option("--contender", metavar="NAME", help="Only these; `--list` names them.")
    ] = None
    car: Annotated[
        list[str] | None, Option("--car", metavar="CAR[/PLANT]", help="Only these: name or .toml file, with its plant.")
    ] = None
    road: Annotated[
        list[str] | None,
        Option("--road", metavar="ROAD", help="Judged on these: country:3, lap:1@6, random-drive:3, scenario, file."),
    ] = None
    profile: Annotated[list[str] | None, Option("--profile", metavar="NAME", help="Only in these.")] = None
    seeds: Annotated[
        int | None, Option("--seeds", metavar="N", hidden=True, min=1, max=1000, help="Noise seeds of the judgement.")
    ] = None
    budget: Annotated[
        int | None, Option("--budget", metavar="N", min=0, help="Closed loops of each search; 0: defaults alone.")
    ] = None
    dask: Annotated[
        str | None,
        Option("--dask", metavar="ADDRESS", hidden=True, help="Dask scheduler whose workers drive (extra `cluster`)."),
    ] = None
    names: Annotated[bool, Option("--list", help="Name the contenders, and drive nothing.")] = False
    plugin: options.Plugin = None
    as_json: options.Json = False

    @property
    def of(self) -> str | Path:
        """The chosen comparison, by name or file."""
        sizes = (("quick", self.quick), ("standard", self.standard), ("full", self.full))
        chosen: list[str | Path] = [name for name, wanted in sizes if wanted]
        chosen += [] if self.config is None else [self.config]
        if len(chosen) > 1:
            raise InvalidInput("compare: give one of --quick, --standard, --full and --config.")
        return chosen[0] if chosen else "quick"

    @property
    def changes(self) -> dict[str, Any]:
        """The fields of the comparison that are other than its own."""
        given = {
            "contenders": self.contender, "cars": self.car, "roads": self.road, "profiles": self.profile,
            "budget": self.budget, "seeds": None if self.seeds is None else list(range(self.seeds)),
        }  # fmt: skip
        return {key: value for key, value in given.items() if value is not None}


@options.grouped
def compare(given: CompareOptions) -> None:
    """Compare controllers on cars, roads and profiles.

    The same noise, the same effort of tuning, unseen roads. Each contender drives with its default and with a tuning
    that a search found on training roads; a schedule brings its own. Ranks differ only where the intervals part. Failed
    runs are counted in the table; the exit code is 0.
    """
    from adaptrack.comparison.run import TABLE, load_comparison, run_comparison
    from adaptrack.results.page import write_result
    from adaptrack.results.side_by_side import side_by_side_result

    options.load_plugins(given.plugin)
    if given.names:
        _list(given.as_json)
        return
    name, out = given.of, given.out
    if out is None:
        raise InvalidInput("compare: give --out FOLDER, for the page and all runs.")
    task = load_comparison(name, **given.changes)
    options.make_folder(out)
    cells = task.cells
    loops, hours = sum(map(task.loops, cells)), show.duration(max(60.0, task.seconds(cells)))
    size = f"{len(cells)} cells, about {loops:,} closed loops, roughly {hours} of one core"
    show.say(f"adaptrack: {task.name}: {size}", aside=True)
    interrupt.kept(f"What was driven is kept; the same command with --out {out} goes on.")
    with show.progress("compare") as advance:
        made = run_comparison(task, out, dask=given.dask, progress=advance)
    result = side_by_side_result(made, command=options.command_line(), next_step=next_line(*_next(made)))
    with show.progress("write the page"):
        page = write_result(out, result)
    files = {"page": str(page), "table": str(out / TABLE)}
    result = replace(result, record={**result.record, **files}, notes=[*result.notes, f"every run is in {out / TABLE}"])
    show.say_result(result, given.as_json, page)


def _next(made: Compared) -> tuple[str, str]:
    """With the controller of the least error in the last profile: drive it, or tune it for one's own road."""
    from adaptrack.comparison.views import standing_rows

    profile, table = list(made.by_profile.items())[-1]
    best = standing_rows(table)[0]
    where = ("ROAD", "--controller", best["contender"], "--profile", profile, "--vehicle", "CAR")
    if best["tuning"] == "tuned":
        return "for roads and a car of your own", command("tune", *where)
    return "on a road and with a car of your own", command("drive", *where)


def _list(as_json: bool) -> None:
    from adaptrack.control.controllers import about_controller, list_controllers

    rows = [
        {"contender": name, "what": about_controller(name).words, "tuned": about_controller(name).tunable,
         "compiled": about_controller(name).compiled}
        for name in list_controllers()
    ]  # fmt: skip
    show.listing("Contenders", rows, as_json)
