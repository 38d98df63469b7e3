"""The result of closed-loop runs: what was run in plain words, tables of measures, figures 6 to 10, provenance."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import safe_names
from adaptrack.base.result import Column, Picture, Result, ResultTable, Row, Stroke, strokes
from adaptrack.drive.failure import DISTANCE, SLOW
from adaptrack.drive.metrics import PUBLISHED, Metrics, compute_metrics, published_mse
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.figures import CREEPING, conditions_picture, speed_picture, tracking_picture
from adaptrack.results.runs_verdict import runs_verdict
from adaptrack.results.tables import (
    Settings,
    Shown,
    differences_table,
    outcomes_table,
    overview_table,
    scenario_tables,
)
from adaptrack.results.words import (
    clock,
    controller_name,
    describe,
    few,
    legible,
    listed,
    number,
    recorded,
    setting,
    slug,
    title_of,
)
from adaptrack.scenario.profile import load_profile

_SETTINGS = ("profile", "plant", "tyre", "vehicle", "speed", "preview")
"""Entries of a run's provenance that split a scenario's runs into separate figures."""

_VARIANTS = ("moves", "tuning", "solver", "seed")
"""Entries that tell apart runs of one controller in one figure."""

_LISTED = {
    "scenario": "Scenario",
    "profile": "Profile",
    "plant": "Plant",
    "tyre": "Tyre",
    "vehicle": "Vehicle",
    "speed": "Speed",
    "preview": "Preview",
    "seed": "Seed",
    "controller": "Controller",
    "moves": "Moves",
    "tuning": "Tuning",
    "limits": "Limits",
    "solver": "QP solver",
    "belief": "Steering, as believed",
    "versions": "Versions",
}
"""Entries of the provenance block, with their names there."""

_PROFILES = {
    "paper": "ideal actuator, exact state, no delay",
    "road": "steering lag and rate limit, sensor noise, computation delay",
}

_PAPER_FIGURES = {
    "triple-lane-change": {"speed": "6(a)", "conditions": "7", "tracking": "8"},
    "general-trajectory": {"speed": "6(b)", "conditions": "9", "tracking": "10"},
}

CONSOLE = (
    Column("scenario", "scenario"),
    Column("controller", "controller"),
    Column("mse", "MSE", "m²"),
    Column("max_abs_error", "max |e|", "m", 3),
    Column("at_any_limit", "limits", "%", "percent"),
    Column("step_us_p50", "step", "µs", "whole"),
    Column("result", "result"),
)

Strokes = Mapping[str, Stroke]


@dataclass(frozen=True)
class Run:
    """A run as the report shows it."""

    trajectory: Trajectory
    label: str = ""
    """Its name in legends and tables; the controller's name when left out."""
    metrics: Metrics | None = None
    """Its measures; computed when left out."""


def runs_result(
    runs: Sequence[Run | Trajectory],
    rows: Sequence[Row] = (),
    *,
    title: str = "",
    command: str = "",
    introduction: Sequence[str] = (),
) -> Result:
    """Closed-loop runs as a result.

    Runs are grouped by scenario, and within it by profile, plant, tyre, vehicle and preview. Runs of one controller
    are distinguished by what differs in their provenance. A label keeps its colour in all pictures. Headline and answer
    say which runs failed, if any.

    Parameters
    ----------
    rows
        The measures of each run by name, for console and JSON.
    title
        When left out: the scenarios and the controllers.
    command
        The command line that repeats the runs.
    introduction
        Paragraphs under the title of the page; a summary of what was run when left out.

    Raises
    ------
    InvalidInput
        When there is no run.
    """
    if not runs:
        raise InvalidInput("report: at least one run is needed.")
    scenarios = grouped([run if isinstance(run, Run) else Run(run) for run in runs])
    shown = [run for settings in scenarios.values() for group in settings.values() for run in group]
    own = strokes(run.label for run in shown)
    figures_of = [(name, words) for name, settings in scenarios.items() for words in settings]
    stems = dict(zip(figures_of, safe_names(slug(f"{name} {words}") for name, words in figures_of), strict=True))
    failed = _failed_runs(scenarios)
    verdict = runs_verdict(scenarios)
    provenance, tables = _provenance(shown)
    return Result(
        kind="runs",
        title=title or (failed[0]["name"] if len(shown) == 1 and failed else _title(scenarios)),
        answer=verdict.text,
        record={"rows": list(rows)},
        tables=[
            overview_table(scenarios),
            *(table for name, settings in scenarios.items() for table in scenario_tables(name, settings)),
            *tables,
            *([console_table(rows)] if rows else []),
        ],
        pictures=[verdict.picture, *_speeds(scenarios, own), *_pictures(scenarios, stems, own)],
        failed=bool(failed),
        headline=_headline(failed, len(shown)),
        values={
            "scenarios": [_scenario(name, settings, stems) for name, settings in scenarios.items()],
            "failed_runs": failed if len(shown) > 1 else [], "introduction": introduction, "verdict": verdict.terms,
            "labels": list(dict.fromkeys(run.label for run in shown)), "runs": len(shown), "provenance": provenance,
            "limits": {"slow": SLOW, "distance": DISTANCE, "creeping": CREEPING,
                       "road_weight": load_profile("road").move_weight},
        },
        command=command,
        created=max(str(run.trajectory.meta.get("created", "")) for run in shown),
    )  # fmt: skip


def write_report(
    out_dir: str | os.PathLike[str],
    runs: Sequence[Run | Trajectory],
    *,
    title: str = "",
    command: str = "",
    introduction: Sequence[str] = (),
    png: bool = True,
) -> Path:
    """Write the page on `runs` and its PNG files into `out_dir`; return the page's path.

    Parameters are those of `runs_result`; png: whether to write the PNG files.

    Raises
    ------
    InvalidInput
        When there is no run.
    StorageError
        When the files cannot be written, see `page.write_result`.
    """
    from adaptrack.results.page import write_result

    return write_result(out_dir, runs_result(runs, title=title, command=command, introduction=introduction), png=png)


def console_table(rows: Sequence[Row]) -> ResultTable:
    """What the console shows of each run; rows: the measures of each."""
    return outcomes_table("Closed-loop runs", CONSOLE, rows)


def grouped(runs: Sequence[Run]) -> dict[str, Settings]:
    """Scenario -> setting in words -> runs, in the order given; each run with its label and measures."""
    found: dict[tuple[str, float], dict[str, list[Run]]] = {}
    for run in runs:
        scenario = (run.trajectory.name_of("scenario"), round(run.trajectory.duration, 6))
        settings = json.dumps([run.trajectory.meta.get(entry) for entry in _SETTINGS])
        found.setdefault(scenario, {}).setdefault(settings, []).append(run)
    names = [name for name, _ in found]
    result: dict[str, Settings] = {}
    for (name, duration), groups in found.items():
        words = _tell_apart([group[0].trajectory for group in groups.values()], _SETTINGS)
        settled = {own: _labelled(group) for own, group in zip(words, groups.values(), strict=True)}
        result[name if names.count(name) == 1 else f"{name} ({duration:g} s)"] = settled
    return result


def _labelled(runs: Sequence[Run]) -> list[Shown]:
    """The runs of one figure, under distinct labels."""
    labels = [legible(run.label) or controller_name(run.trajectory.name_of("controller")) for run in runs]
    for label in set(labels):
        same = [i for i, other in enumerate(labels) if other == label]
        if len(same) > 1:
            for i, words in zip(same, _tell_apart([runs[i].trajectory for i in same], _VARIANTS), strict=True):
                labels[i] = f"{label}, {words}" if words else label
    return [
        Shown(label, run.trajectory, run.metrics or compute_metrics(run.trajectory))
        for label, run in zip(labels, runs, strict=True)
    ]


def _tell_apart(trajectories: Sequence[Trajectory], entries: Iterable[str]) -> list[str]:
    """For each trajectory the entries in which it differs from others, in words; a number where those are equal."""
    words: list[list[str]] = [[] for _ in trajectories]
    for entry in entries:
        values = [setting(entry, recorded(trajectory.meta, entry)) for trajectory in trajectories]
        if len(set(values)) > 1:
            for own, value in zip(words, values, strict=True):
                own.append(value)
    names = [", ".join(own) for own in words]
    return [
        f"{name} no. {names[:i].count(name) + 1}".strip() if names.count(name) > 1 else name
        for i, name in enumerate(names)
    ]


def _title(scenarios: Mapping[str, Settings]) -> str:
    """Scenarios and controllers, as long as there are few of them."""
    runs = [run for settings in scenarios.values() for group in settings.values() for run in group]
    drove = few(dict.fromkeys(run.label for run in runs), "controller")
    what = few([title_of(name) for name in scenarios], "scenario")
    return f"{what}: {drove[:1].upper() + drove[1:]}"


# -- pictures ---------------------------------------------------------------------------------------------------------
def _speeds(scenarios: Mapping[str, Settings], own: Strokes) -> list[Picture]:
    """The speed of each scenario; of several, that of each one's first setting."""
    alone = len(scenarios) == 1
    runs = {
        title_of(name): _runs(next(iter(settings.values()))) if not alone
        else _runs([run for group in settings.values() for run in group])
        for name, settings in scenarios.items()
    }  # fmt: skip
    registered = next(iter(next(iter(scenarios.values())).values()))[0].trajectory.name_of("scenario")
    figure = _PAPER_FIGURES.get(registered, {}).get("speed", "") if alone else "6"
    caption = "Speed: profile (dashed) and driven." if alone else "Speed of each scenario: profile (dashed) and driven."
    return [speed_picture(runs, own, caption + _shape(figure))]


def _pictures(scenarios: Mapping[str, Settings], stems: Mapping[tuple[str, str], str], own: Strokes) -> list[Picture]:
    """Tracking and conditions of the runs that share their figures."""
    pictures = []
    for name, settings in scenarios.items():
        for words, group in settings.items():
            runs, stem = _runs(group), stems[name, words]
            numbers = _PAPER_FIGURES.get(group[0].trajectory.name_of("scenario"), {})
            tracking = tracking_picture(runs, own, f"{stem}-tracking")
            conditions = conditions_picture(runs, own, f"{stem}-conditions")
            said = "Lateral position, tracking error, angle of the front wheels and yaw rate."
            said += " A cross marks where a run failed." if any(run.metrics.failed for run in group) else ""
            said += " Grey: the command." if len(runs) == 1 else ""
            titles = [panel.title.lower() for panel in conditions.panels[1:]]
            around = f"Lateral gust, {listed(titles)}; black is shared by all runs."
            pictures += [
                replace(tracking, caption=said + _shape(numbers.get("tracking", ""))),
                replace(conditions, caption=around + _shape(numbers.get("conditions", ""))),
            ]
    return pictures


def _shape(figure: str) -> str:
    return f" In the shape of the paper's figure {figure}." if figure else ""


def _runs(group: Sequence[Shown]) -> dict[str, Trajectory]:
    return {run.label: run.trajectory for run in group}


# -- what the page says -----------------------------------------------------------------------------------------------
def _failed_runs(scenarios: Mapping[str, Settings]) -> list[dict[str, Any]]:
    """The runs that failed, by scenario, controller and setting in words."""
    return [
        _failed(", ".join(filter(None, (title_of(name), run.label, words))), run.metrics)
        for name, settings in scenarios.items()
        for words, group in settings.items()
        for run in group
        if run.metrics.failed
    ]


def _failed(name: str, metrics: Metrics) -> dict[str, Any]:
    return {"name": name, "at": f"{metrics.failed_at:.1f}", "because": metrics.failed_because}


def _headline(failed: Sequence[Row], runs: int) -> str:
    """What the page's heading begins with; empty when no run failed."""
    if not failed:
        return ""
    if runs > 1:
        return f"{number(len(failed))} of {number(runs)} runs failed"
    return f"Failed at {failed[0]['at']} s: the vehicle {failed[0]['because']}"


def _scenario(name: str, settings: Settings, stems: Mapping[tuple[str, str], str]) -> dict[str, Any]:
    """The numbers and words of the section on one scenario."""
    shown = [run for group in settings.values() for run in group]
    runs = [run.trajectory for run in shown]
    wind = np.concatenate([run.wind for run in runs])
    named = [(f"{run.label} ({words})" if words else run.label, run.metrics) for words in settings
             for run in settings[words]]  # fmt: skip
    kept = [each for each in named if not each[1].failed]
    best = min(kept, key=lambda each: each[1].mse) if kept else None
    totals = {key: sum(getattr(each, key) for _, each in named)
              for key in ("qp_solved", "qp_capped", "qp_failed", "held", "dead_reckoning")}  # fmt: skip
    blind = [each.dead_reckoning_max for _, each in named if each.dead_reckoning]
    return {
        "name": name, "title": title_of(name), "first": runs[0], "several": len(named) > 1, "best": best,
        **{key: np.concatenate([getattr(run, key) for run in runs]) for key in ("vx", "friction")},
        "across": wind[:, 1], "along": wind[:, 0],
        "shared": _shared(runs), "failed": [_failed(*each) for each in named if each[1].failed],
        "totals": totals, "qps": totals["qp_solved"] + totals["qp_capped"] + totals["qp_failed"],
        "longest": max(blind, default=0.0), "paper": _paper(runs),
        "groups": [{"title": words[:1].upper() + words[1:], "stem": stems[name, words]} for words in settings],
    }  # fmt: skip


def _shared(runs: Sequence[Trajectory]) -> dict[str, Any]:
    """What all runs of a scenario have in common: plant, profile, preview; None where they differ."""
    first = runs[0]
    same = {entry for entry in _SETTINGS if all(run.meta.get(entry) == first.meta.get(entry) for run in runs)}
    known = {"plant", "tyre", "vehicle"} <= same and bool(first.name_of("plant"))
    profile = str(first.meta.get("profile", "")) if "profile" in same else ""
    return {
        "plant": [first.name_of("plant"), *(f"{first.name_of('tyre')} tyres",) * bool(first.name_of("tyre")),
                  *(f"vehicle {first.name_of('vehicle')}",) * bool(first.name_of("vehicle"))] if known else [],
        "profile": profile, "about": _PROFILES.get(profile, ""),
        "preview": first.meta.get("preview") if "preview" in same else None,
    }  # fmt: skip


def _paper(runs: Sequence[Trajectory]) -> dict[str, Any] | None:
    """What the paper reports for a test, and whether a run compares with that."""
    published = PUBLISHED.get(runs[0].name_of("scenario"))
    if published is None:
        return None
    reported = listed([f"{value:g} m² ({controller_name(key)})" for key, value in published.mse.items()])
    compares = any(published_mse(run) is not None for run in runs)
    return {"reported": reported, "duration": published.duration, "compares": compares}


def _provenance(shown: Sequence[Shown]) -> tuple[dict[str, Any], list[ResultTable]]:
    """What all runs share, each full record, and a table of where they differ."""
    metas = [run.trajectory.meta for run in shown]
    values = {entry: [recorded(meta, entry) for meta in metas] for entry in _LISTED}
    known = {entry: own for entry, own in values.items() if any(value is not None for value in own)}
    shared = {entry: own[0] for entry, own in known.items() if all(value == own[0] for value in own)}
    differing = [(entry, _LISTED[entry]) for entry in known if entry not in shared]
    moments = sorted({clock(str(meta["created"])) for meta in metas if "created" in meta})
    created = [("Created", " to ".join(dict.fromkeys([moments[0], moments[-1]])))] if moments else []
    records = {
        f"{i}. {run.label}, {run.trajectory.name_of('scenario')}": run.trajectory.meta for i, run in enumerate(shown, 1)
    }
    terms = [*((_LISTED[entry], describe(value)) for entry, value in shared.items()), *created]
    tables = [differences_table(shown, differing)] if differing else []
    return {"terms": terms, "records": json.dumps(records, indent=1, ensure_ascii=False)}, tables
