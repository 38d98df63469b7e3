"""Result of shadow mode: learned car, accuracy of the predictions, and warnings for each log."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, best_entries
from adaptrack.control.controllers.learned_car import WITHIN
from adaptrack.core.estimators.learning import LEARNED
from adaptrack.core.maths import portable
from adaptrack.drive.prediction import TIMES
from adaptrack.identification.shadow import PREDICTOR_NAMES, PREDICTORS, Shadow, ShadowLog
from adaptrack.results.identify import ESTIMATE_COLUMNS, quantity_row
from adaptrack.results.marks import BACKGROUND_STROKE, BAND, REFERENCE_STROKE, SERIES, add_degrees, strokes
from adaptrack.results.run_pictures import LABELS, thin_curve, turning_part
from adaptrack.results.words import capital, listed, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

VERDICT_WORDS = {"not believable": "implausible", "believable": "plausible", "at a bound": "at the limit of the prior"}
PREDICTOR_STROKES = strokes(PREDICTORS)
SHOWN_SECONDS = 15.0
"""Length of the drawn part of the log, which has the most turning (s)."""
SOON, LATER = TIMES

PREDICTION_COLUMNS = (
    Column("name", "prediction by"),
    Column("soon", f"{SOON:g} s", "rad/s", 3, f"RMS error {SOON:g} s ahead"),
    Column("later", f"{LATER:g} s", "rad/s", 3, f"RMS error {LATER:g} s ahead"),
    Column("interval", "95 %", show=2, meaning=f"95 % interval of the error {LATER:g} s ahead (rad/s)"),
    Column("ours", "ratio", show=2, meaning="95 % interval: error of the learned model divided by this error"),
    Column(
        "fastest", "fast", "rad/s", 3, f"error {LATER:g} s ahead, in the third of the log with the fastest steering"
    ),
    Column("y", "offset", "m", 3, f"error of the offset from the path, {LATER:g} s ahead"),
)


def shadow_result(shadow: Shadow) -> Result:
    """Return the logs of shadow mode as a result."""
    several = len(shadow.logs) > 1
    return Result(
        kind="shadow",
        title=f"Learning from logs of a driver: {shadow.car.name}",
        answer="\n".join(_answer(log, several) for log in shadow.logs),
        record=_record(shadow),
        tables=[table for log in shadow.logs for table in _tables(log, f", {log.source}" if several else "")],
        notes=_notes(shadow),
        pictures=[_predicted(shadow.logs), _believed(shadow.logs), *_commands(shadow.logs)],
        failed=not shadow.believable,
        headline="" if shadow.believable else "Implausible",
    )


def _answer(log: ShadowLog, with_source: bool) -> str:
    """Describe the learned delay with its verdict, and the best predictor."""
    why = "; ".join(log.doubts or log.bounds)
    delay, half = log.learned.lag + log.learned.dead_time, WITHIN * log.learned.delay_sigma
    verdict = VERDICT_WORDS.get(log.verdict, log.verdict)
    learned = f"Learned delay {number(delay)} ± {number(half, 2)} s ({verdict}{f': {why}' if why else ''})."
    return f"{f'{log.source}: ' if with_source else ''}{learned}\n{_winner(log)}"


def _winner(log: ShadowLog) -> str:
    """Name the best predictor of the yaw rate, and give the error of the learned model."""
    predictions = log.of("yaw_rate", LATER)
    if not predictions:
        return "The log is too short to compare predictions."
    ours = predictions["learned"]
    best, *rivals = sorted(predictions.values(), key=lambda prediction: prediction.rms.value)
    other = rivals[0] if best is ours else best
    over = f"{number(other.ours.mean, 2)} [{number(other.ours.low, 2)}, {number(other.ours.high, 2)}]"
    error = f"{number(ours.rms.value)} rad/s [{number(ours.rms.low)}, {number(ours.rms.high)}]"
    winner = PREDICTOR_NAMES[best.predictor]
    sure = "" if other.ours.verdict != "level" else " (no significant difference)"
    return (
        f"Best prediction of the yaw rate {LATER:g} s ahead: {winner}.\nRMS error of the learned model: {error},\n"
        f"{over} times that of the {PREDICTOR_NAMES[other.predictor]}{sure}."
    )


def _notes(shadow: Shadow) -> list[str]:
    """Return the notes for the reader."""
    several = len(shadow.logs) > 1
    notes = []
    for log in shadow.logs:
        warned = "; ".join(
            f"{warning.what} (the whole log)" if math.isnan(warning.seconds) else
            f"{warning.what} ({warning.seconds:.0f} of {log.time[-1]:.0f} s, from {warning.first:.0f} s on)"
            for warning in log.warnings
        )  # fmt: skip
        for sentence in (capital("; ".join(log.notes)), warned and f"Warnings of the controller: {warned}"):
            notes += [f"{f'{log.source}: ' if several else ''}{sentence}."] if sentence else []
    if shadow.spoiling:
        notes.append(
            f"Fewer contradictions without {listed(shadow.spoiling)}: these contradict other signals, or are not "
            "measured at the centre of gravity."
        )
    if several:
        notes.append("The learned values continue from log to log, in the order of the command line.")
    return [
        *notes,
        "The controller did not steer: each command is one control step from the state of the driver's car.",
    ]


def _record(shadow: Shadow) -> dict[str, Any]:
    logs = [
        {
            "log": log.source, "verdict": log.verdict, "doubts": list(log.doubts), "bounds": list(log.bounds),
            "notes": list(log.notes),
            "warnings": [warning._asdict() for warning in log.warnings], "learned": log.learned.model_dump(),
            "predictions": [
                {**prediction._asdict(), "rms": prediction.rms._asdict(), "ours": prediction.ours._asdict()}
                for prediction in log.predictions
            ],
        }
        for log in shadow.logs
    ]  # fmt: skip
    return {"vehicle": shadow.car.name, "period": shadow.period, "spoiling": list(shadow.spoiling), "logs": logs}


def _tables(log: ShadowLog, suffix: str) -> list[ResultTable]:
    """Return tables of the prediction errors and of the learned values."""
    soon, later = (log.of("yaw_rate", ahead) for ahead in TIMES)
    fastest, y = log.of("yaw_rate", LATER, "fastest"), log.of("y", LATER)
    rows: list[dict[str, Any]] = [
        {
            "name": PREDICTOR_NAMES[name], "soon": soon[name].rms.value, "later": prediction.rms.value,
            "interval": prediction.rms[1:], "ours": None if name == "learned" else prediction.ours[1:],
            "fastest": fastest[name].rms.value, "y": y[name].rms.value if y else None,
        }
        for name, prediction in later.items()
    ]  # fmt: skip
    best = best_entries(rows, dict.fromkeys(("soon", "later", "fastest", "y"), min))
    learned_rows = [
        quantity_row(name, interval.unit, interval.value, (interval.low, interval.high), (old.low, old.high))
        for name, interval, old in zip(LEARNED._fields, log.learned.intervals, log.before.intervals, strict=False)
    ]
    title = f"RMS errors of predicted yaw rate{' and offset' if y else ''}{suffix}"
    columns = PREDICTION_COLUMNS if y else PREDICTION_COLUMNS[:-1]
    return [
        ResultTable(f"predicted{suffix}", title, columns, rows, best=best, brief=True),
        ResultTable(f"believed{suffix}", f"Learned values{suffix}", ESTIMATE_COLUMNS, learned_rows, brief=True),
    ]


# -- pictures ---------------------------------------------------------------------------------------------------------
def _picture(name: str, caption: str, panels: Sequence[Panel], key: Any = ()) -> Picture:
    """A picture of wide panels, one below the other."""
    return Picture(name, caption, panels, key, file=f"{name}.png", columns=1, row_height=2.4)


def _predicted(logs: Sequence[ShadowLog]) -> Picture:
    """A picture of measured and predicted yaw rate."""
    panels = [Panel(log.source, partial(_draw_predicted, log=log), _winner(log)) for log in logs]
    key = [
        *((capital(PREDICTOR_NAMES[name]), PREDICTOR_STROKES[name]) for name in PREDICTORS),
        ("Measured", REFERENCE_STROKE),
    ]
    caption = (
        f"Yaw rate, predicted {LATER:g} s earlier with the recorded commands, in the {SHOWN_SECONDS:.0f} s with "
        "the most turning."
    )
    return _picture("predicted", caption, panels, key)


def _draw_predicted(axes: Axes, log: ShadowLog) -> None:
    part = turning_part(log.time, log.measured["yaw_rate"], SHOWN_SECONDS)
    for name in reversed(PREDICTORS):
        values = log.predicted[name, "yaw_rate", LATER][part]
        finite = np.isfinite(values)
        axes.plot(log.time[part][finite], values[finite], **PREDICTOR_STROKES[name], linewidth=1.0)
    axes.plot(log.time[part], log.measured["yaw_rate"][part], **REFERENCE_STROKE, linewidth=1.0)
    axes.set(xlabel="Time (s)", ylabel="Yaw rate (rad/s)")


def _believed(logs: Sequence[ShadowLog]) -> Picture:
    """Draw the learned values over time, one log after the other."""
    panels = [
        Panel(
            title, partial(_draw_believed, logs=logs, name=name, label=label),
            f"{logs[-1].beliefs[f'belief_{name}'][-1]:.3g} {unit} at the end.",
        )
        for name, (title, label, unit) in LABELS.items() if name not in ("dead_time", "bank", "friction")
    ]  # fmt: skip
    return Picture(
        "believed", "Learned values over time. Band: 90 % interval.", panels, file="believed.png", row_height=1.9
    )


def _draw_believed(axes: Axes, logs: Sequence[ShadowLog], name: str, label: str) -> None:
    starts, stroke = np.concatenate([[0.0], np.cumsum([log.time[-1] for log in logs])]), PREDICTOR_STROKES["learned"]
    for start in starts[1:-1]:
        axes.axvline(start, linewidth=0.8, **BACKGROUND_STROKE)
    for log, start in zip(logs, starts[:-1], strict=True):
        keep = thin_curve(log.beliefs[f"belief_{name}"])
        mean, sigma = (log.beliefs[f"belief_{name}{end}"][keep] for end in ("", "_sigma"))
        logarithmic = name in ("stiffness", "balance")
        factor, spread = (portable.exp(WITHIN * sigma), 0.0) if logarithmic else (1.0, WITHIN * sigma)
        time = start + log.time[keep]
        axes.fill_between(time, mean / factor - spread, mean * factor + spread, color=stroke["color"], **BAND)
        axes.plot(time, mean, **stroke)
    axes.set(xlabel="Time (s)", ylabel=label)


def _commands(logs: Sequence[ShadowLog]) -> list[Picture]:
    """Draw the commands of driver and controller; no picture without a path."""
    panels = []
    for log in logs:
        difference = (log.proposed - log.command)[np.isfinite(log.proposed)]
        if difference.size:
            description = (
                f"{number(float(np.sqrt(np.mean(difference * difference))))} rad apart (RMS of the whole log)."
            )
            panels.append(Panel(log.source, partial(_draw_commands, log=log), description))
    caption = "Commands of the driver (line) and of the controller for the same states (points)."
    return [_picture("commands", caption, panels)] if panels else []


def _draw_commands(axes: Axes, log: ShadowLog) -> None:
    part = turning_part(log.time, log.measured["yaw_rate"], SHOWN_SECONDS)
    axes.plot(log.time[part], log.command[part], **BACKGROUND_STROKE)
    axes.plot(log.time[part], log.proposed[part], ".", color=SERIES[0], markersize=1.6, zorder=5)
    axes.set(xlabel="Time (s)", ylabel="Angle (rad)")
    add_degrees(axes)
