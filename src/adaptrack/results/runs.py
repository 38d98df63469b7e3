"""The report on closed-loop runs: what was run in plain words, tables of measures, figures 6 to 10, provenance."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import safe_names
from adaptrack.drive.metrics import PUBLISHED, Metrics, compute_metrics, published_mse
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import figures, style
from adaptrack.results.page import Drawing, Item, Picture, Section, Terms, Verbatim, Verdict, write_page
from adaptrack.results.runs_verdict import runs_verdict
from adaptrack.results.tables import (
    Settings,
    Shown,
    differences_table,
    effort_table,
    overview_table,
    reading,
    solver_table,
    tracking_table,
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
    span,
    title_of,
)

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

Strokes = Mapping[str, style.Stroke]
Key = Sequence[tuple[str, style.Stroke]]


@dataclass(frozen=True)
class Run:
    """A run as the report shows it."""

    trajectory: Trajectory
    label: str = ""
    """Its name in legends and tables; the controller's name when left out."""
    metrics: Metrics | None = None
    """Its measures; computed when left out."""


def write_report(
    out_dir: str | os.PathLike[str],
    runs: Sequence[Run | Trajectory],
    *,
    title: str = "",
    command: str = "",
    lead: Sequence[str] = (),
    first: Sequence[Section] = (),
    more: Sequence[Section] = (),
    png: bool = True,
) -> Path:
    """Write the page on `runs` and its PNG files into `out_dir`; return the page's path.

    Runs are grouped by scenario, and within it by profile, plant, tyre, vehicle and preview. Runs of one controller
    are told apart by what differs in their provenance. A label keeps its colour on the whole page. The heading and the
    first paragraph say which runs failed, if any.

    Parameters
    ----------
    title
        When left out: the scenarios and the controllers.
    command
        The command line that repeats the runs.
    lead
        Paragraphs under the title; a summary of what was run when left out.
    first
        Sections to put before those on the runs. A verdict of its own, at its head, takes the place of that on the
        runs.
    more
        Sections to put after them, before the provenance.
    png
        Whether to write the PNG files.

    Raises
    ------
    InvalidInput
        When there is no run.
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    if not runs:
        raise InvalidInput("report: at least one run is needed.")
    scenarios = grouped([run if isinstance(run, Run) else Run(run) for run in runs])
    shown = [run for settings in scenarios.values() for group in settings.values() for run in group]
    strokes = style.strokes(run.label for run in shown)
    figures_of = [(name, words) for name, settings in scenarios.items() for words in settings]
    stems = dict(zip(figures_of, safe_names(slug(f"{name} {words}") for name, words in figures_of), strict=True))
    own = bool(first) and bool(first[0].items) and isinstance(first[0].items[0], Verdict)
    sections = [
        *([] if own else [Section("Verdict", [runs_verdict(scenarios)])]),
        *first,
        *([_at_a_glance(scenarios, strokes)] if len(scenarios) > 1 else []),
        *(_scenario(name, settings, strokes, stems, len(scenarios) == 1) for name, settings in scenarios.items()),
        *more,
        reading(),
        _provenance(shown, command),
    ]
    created = max(str(run.trajectory.meta.get("created", "")) for run in shown)
    failed = _failed_runs(scenarios)
    alone = len(shown) == 1
    return write_page(
        out_dir,
        sections,
        title=title or (failed[0][0] if alone and failed else _title(scenarios)),
        failed=_failed_heading(failed, len(shown)),
        lead=[*([] if alone else map(_failed_sentence, failed)), *(lead or [_in_short(scenarios)])],
        created=clock(created),
        png=png,
    )


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


def _at_a_glance(scenarios: Mapping[str, Settings], strokes: Strokes) -> Section:
    """The MSE of every controller on every scenario, and the speed profiles (Fig. 6)."""
    first = {title_of(name): _runs(next(iter(settings.values()))) for name, settings in scenarios.items()}
    speed = _speed_picture(first, strokes, "Speed of each scenario: profile (dashed) and driven.", "6")
    return Section("At a glance", [overview_table(scenarios), speed])


def _scenario(
    name: str, settings: Settings, strokes: Strokes, stems: Mapping[tuple[str, str], str], with_speed: bool
) -> Section:
    """Words, tables and figures of one scenario; stems: what the files of its figures begin with, by setting."""
    shown = [run for group in settings.values() for run in group]
    registered = shown[0].trajectory.name_of("scenario")
    numbers = _PAPER_FIGURES.get(registered, {})
    items: list[Item] = [_conditions_in_words(shown), _outcome_in_words(settings)]
    if registered in PUBLISHED:
        items.append(_paper_in_words(registered, shown))
    items.append(tracking_table(settings))
    for words, group in settings.items():
        pictures = _pictures(stems[name, words], group, strokes, numbers)
        items += [Section(words[:1].upper() + words[1:], pictures)] if words else pictures
    if with_speed:
        caption = "Speed: profile (dashed) and driven."
        items.append(_speed_picture({title_of(name): _runs(shown)}, strokes, caption, numbers.get("speed", "")))
    rest = [effort_table(settings), solver_table(settings)]
    items += [Section("All measures", rest)] if any(settings) else rest
    return Section(title_of(name), items)


def _pictures(stem: str, group: Sequence[Shown], strokes: Strokes, numbers: Mapping[str, str]) -> list[Item]:
    """Tracking and conditions of the runs that share their figures."""
    runs = _runs(group)
    lines = figures.as_lines(runs, strokes)
    key = [(label, strokes[label]) for label in runs]

    def picture(
        kind: str, caption: str, panels: Sequence[figures.Panel], whole: Callable[[], Figure], key: Key
    ) -> Picture:
        caption += _shape(numbers.get(kind, ""))
        return Picture(caption, [_drawing(panel, lines) for panel in panels], key, f"{stem}-{kind}.png", whole)

    tracking = "Lateral position, tracking error, angle of the front wheels and yaw rate." + _marks(group)
    tracking += " Grey: the command." if len(lines) == 1 else ""
    panels = figures.condition_panels(runs)
    conditions = f"Lateral gust, {listed([panel.title.lower() for panel in panels[1:]])}; black is shared by all runs."
    return [
        picture(
            "tracking",
            tracking,
            figures.TRACKING,
            lambda: figures.tracking_figure(runs, strokes),
            [("Reference", style.REFERENCE), *key],
        ),
        picture("conditions", conditions, panels, lambda: figures.conditions_figure(runs, strokes), key),
    ]


def _speed_picture(
    scenarios: Mapping[str, Mapping[str, Trajectory]], strokes: Strokes, caption: str, number: str
) -> Picture:
    lines = {title: figures.as_lines(runs, strokes) for title, runs in scenarios.items()}
    return Picture(
        caption + _shape(number),
        [_drawing(figures.SPEED, own, title) for title, own in lines.items()],
        figures.speed_key(list(lines.values())),
        "speed.png",
        lambda: figures.speed_figure(scenarios, strokes),
    )


def _shape(number: str) -> str:
    return f" In the shape of the paper's figure {number}." if number else ""


def _drawing(panel: figures.Panel, lines: Sequence[figures.Line], title: str = "") -> Drawing:
    """A panel alone, with its alternative text."""
    figure = style.panel_figure(partial(panel.show, lines=lines, title=style.data_text(title)))
    return Drawing(figure, f"{title}. {panel.describe(lines)}" if title else panel.describe(lines))


def _runs(group: Sequence[Shown]) -> dict[str, Trajectory]:
    return {run.label: run.trajectory for run in group}


def _marks(group: Sequence[Shown]) -> str:
    return " A cross marks where a run failed." if any(run.metrics.failed for run in group) else ""


def _failed_runs(scenarios: Mapping[str, Settings]) -> list[tuple[str, Metrics]]:
    """The runs that failed, by scenario, controller and setting in words."""
    return [
        (", ".join(filter(None, (title_of(name), run.label, words))), run.metrics)
        for name, settings in scenarios.items()
        for words, group in settings.items()
        for run in group
        if run.metrics.failed
    ]


def _failed_heading(failed: Sequence[tuple[str, Metrics]], runs: int) -> str:
    """What the page's heading begins with; empty when no run failed."""
    if not failed:
        return ""
    if runs > 1:
        return f"{number(len(failed))} of {number(runs)} runs failed"
    (_, metrics), *_ = failed
    return f"Failed at {metrics.failed_at:.1f} s: the vehicle {metrics.failed_because}"


def _failed_sentence(failed: tuple[str, Metrics]) -> str:
    name, metrics = failed
    return f"Failed: {name}, at {metrics.failed_at:.1f} s; the vehicle {metrics.failed_because}."


def _in_short(scenarios: Mapping[str, Settings]) -> str:
    shown = [run for settings in scenarios.values() for group in settings.values() for run in group]
    labels = list(dict.fromkeys(run.label for run in shown))
    drove = labels[0] if len(labels) == 1 else f"{len(labels)} controllers ({listed(labels)})"
    return (
        f"{drove} drove the {listed([title_of(name).lower() for name in scenarios])}: {len(shown)} closed-loop "
        f"run{'s' if len(shown) > 1 else ''}, with tracking, effort, comfort, solver behaviour and provenance."
    )


def _conditions_in_words(shown: Sequence[Shown]) -> str:
    """What was run: length, conditions, plant, profile, preview."""
    runs = [run.trajectory for run in shown]
    first, meta = runs[0], runs[0].meta
    shared = {entry for entry in _SETTINGS if all(run.meta.get(entry) == meta.get(entry) for run in runs)}
    speed, friction, wind = (np.concatenate([getattr(r, name) for r in runs]) for name in ("vx", "friction", "wind"))
    gust = f"lateral wind {span(wind[:, 1])} m/s" if wind[:, 1].any() else "no lateral wind"
    gust += f", longitudinal wind {span(wind[:, 0])} m/s" if wind[:, 0].any() else ""
    sentences = [
        f"{first.duration:g} s in {number(len(first))} control periods of {first.period:g} s: "
        f"speed {span(speed)} m/s, friction {span(friction)}, {gust}."
    ]
    if {"plant", "tyre", "vehicle"} <= shared and first.name_of("plant"):
        tyre, vehicle = first.name_of("tyre"), first.name_of("vehicle")
        details = [f"{tyre} tyres"] * bool(tyre) + [f"vehicle {vehicle}"] * bool(vehicle)
        sentences.append(f"Plant: {', '.join([first.name_of('plant'), *details])}.")
    profile = str(meta.get("profile", ""))
    if "profile" in shared and profile:
        sentences.append(f"Profile: {profile}{f' ({_PROFILES[profile]})' if profile in _PROFILES else ''}.")
    if "preview" in shared and meta.get("preview") is not None:
        sees = "the reference ahead" if meta["preview"] else "only the present reference, not what lies ahead"
        sentences.append(f"The controller sees {sees}.")
    return " ".join(sentences)


def _outcome_in_words(settings: Settings) -> str:
    """What came of it: the smallest MSE, the failed runs, the QPs that were not solved."""
    runs = [
        (f"{run.label} ({words})" if words else run.label, run.metrics) for words in settings for run in settings[words]
    ]
    sentences = []
    kept = [(name, metrics) for name, metrics in runs if not metrics.failed]
    if kept:
        name, best = min(kept, key=lambda item: item[1].mse)
        sentences.append(
            f"{'Best tracking' if len(runs) > 1 else 'Tracking'}: {name}, with a mean square error of "
            f"{number(best.mse)} m², never more than {number(best.max_abs_error)} m from the reference."
        )
    sentences += [_failed_sentence(each) for each in runs if each[1].failed]
    solved, capped, failed, held = (
        sum(getattr(metrics, name) for _, metrics in runs) for name in ("qp_solved", "qp_capped", "qp_failed", "held")
    )
    total = solved + capped + failed
    troubles = [f"{number(capped)} stopped at the iteration cap"] * bool(capped)
    troubles += [f"{number(failed)} had no answer"] * bool(failed)
    if troubles:
        sentences.append(f"Of {number(total)} QPs, {listed(troubles)}.")
    elif total:
        sentences.append(f"All {number(total)} QPs were solved to their tolerance.")
    if held:
        sentences.append(f"A safe steering angle was held in {number(held)} control periods.")
    if reckoned := sum(metrics.dead_reckoning for _, metrics in runs):
        longest = max(metrics.dead_reckoning_max for _, metrics in runs if metrics.dead_reckoning)
        sentences.append(
            f"In {number(reckoned)} control periods there was no new position, for {number(longest)} s at the longest: "
            "the controller steered on its estimate."
        )
    return " ".join(sentences)


def _paper_in_words(scenario: str, shown: Sequence[Shown]) -> str:
    """What the paper reports for this test, and whether that compares."""
    published = PUBLISHED[scenario]
    reported = listed([f"{value:g} m² ({controller_name(key)})" for key, value in published.mse.items()])
    setting = f"paper profile, no preview, {published.duration:g} s"
    if any(published_mse(run.trajectory) is not None for run in shown):
        remark = f"Its values stand beside the runs that compare with them: {setting}."
    else:
        remark = f"None of these runs compares with that: it takes the {setting}."
    return f"The paper reports a mean square error of {reported} on this test. {remark}"


def _provenance(shown: Sequence[Shown], command: str) -> Section:
    """The command line, what all runs share, where they differ, and each full record folded away."""
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
    items: list[Item] = [Verbatim(command)] if command else []
    items.append(Terms([*((_LISTED[entry], describe(value)) for entry, value in shared.items()), *created]))
    items += [differences_table(shown, differing)] if differing else []
    items.append(Verbatim(json.dumps(records, indent=1, ensure_ascii=False), "The full record of every run"))
    return Section("Provenance", items)
