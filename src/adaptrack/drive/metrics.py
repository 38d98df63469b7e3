"""Measures of a drive: tracking, corners of the car body, effort, comfort, limits, solver, time, and the cost J.

A measure whose smaller values are better is infinite if a sample is not finite, so a run that ends in NaN sorts
last. Signs are those of ISO 8855: positive to the left.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import NotNegative, Positive, checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.base.presentation import html_of
from adaptrack.cars.outline import Outline
from adaptrack.control.controllers.learned_car import BeliefState, bounded_quantity
from adaptrack.control.models import PredictionModel
from adaptrack.core.maths.portable import Array
from adaptrack.drive import signal_statistics as statistics
from adaptrack.drive.failure import MIN_JUDGED_SPEED, FailureLimits, find_failure, state_is_finite
from adaptrack.drive.prediction import TIMES, run_prediction_error
from adaptrack.drive.trajectory import Trajectory

LANE_WIDTH = 3.5
"""Default lane width (m), for the share of time in the lane."""
STEERING_RATIO = 15.0
"""Default ratio of the steering-wheel angle to the road-wheel angle; passenger cars have 13 to 17."""

AT_CHANGE_LIMIT, AT_ANGLE_LIMIT, AT_OUTPUT_LIMIT = 1, 2, 4
"""Bits of the diagnostic ``at_limit``: limits on the change of the command Δu, the command u and the output y."""

_SOLVED, _CAPPED = 0, 1  # values of the diagnostic ``qp_status`` with a usable solution
_NO_DIAGNOSTIC = np.empty(0, np.int64)  # stands for a diagnostic that the controller does not have


def _measure(unit: str, title: str, default: Any = math.nan, *, needs_outline: bool = False) -> Any:
    """Return a field of `Metrics` with its unit and title; needs_outline: known only with the outline of the car."""
    return field(default=default, metadata={"unit": unit, "title": title, "needs_outline": needs_outline})


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """Measures of one drive.

    In the titles, e is the lateral error from the reference or path, u the steering command, Δu = u(k) - u(k-1) its
    change and y the output of the prediction model. The metadata of each field has its title and unit; `rows` lists
    them. Unknown measures are NaN, unknown counts 0.
    """

    steps: int = _measure("-", "number of control instants", 0)
    driven: int = _measure("-", "control periods with a finite command", 0)
    failed: bool = _measure("-", "whether the run failed", False)
    failed_at: float = _measure("s", "time of the failure")
    failed_reason: str = _measure("-", "reason of the failure", "")
    failed_because: str = _measure("-", 'failure, as the end of a sentence "the vehicle ..."', "")

    duration: float = _measure("s", "duration of the run", needs_outline=True)
    distance: float = _measure("m", "driven distance, integral of |v_x|", needs_outline=True)
    mse: float = _measure("m^2", "mean square error, mean e^2")
    rms_error: float = _measure("m", "RMS error")
    mean_error: float = _measure("m", "mean error, positive to the left", needs_outline=True)
    p95_error: float = _measure("m", "95th percentile of the error |e|", needs_outline=True)
    max_abs_error: float = _measure("m", "largest error |e|")
    rms_corner: float = _measure("m", "RMS distance of the outermost corner from the path", needs_outline=True)
    p95_corner: float = _measure("m", "95th percentile of the corner distance", needs_outline=True)
    max_corner: float = _measure("m", "largest distance of a corner from the path", needs_outline=True)
    max_corner_error: float = _measure("m", "largest corner distance minus half the car width", needs_outline=True)
    in_lane: float = _measure("-", "share of time with all corners in the lane", needs_outline=True)
    heading_rms: float = _measure("rad", "RMS heading error at 1 m/s or more")
    heading_max: float = _measure("rad", "largest heading error at 1 m/s or more")
    yaw_rate_max: float = _measure("rad/s", "largest yaw rate", needs_outline=True)

    steering_rms: float = _measure("rad", "RMS steering command")
    steering_rate_rms: float = _measure("rad/s", "RMS rate of the steering command")
    steering_activity: float = _measure("rad^2", "steering activity, mean Δu^2")
    wheel_angle_rms: float = _measure("rad", "RMS road-wheel angle", needs_outline=True)
    reversals: float = _measure("1/min", "steering reversals per minute (SAE J2944)", needs_outline=True)
    lateral_acceleration_rms: float = _measure("m/s^2", "RMS lateral acceleration")
    lateral_acceleration_max: float = _measure("m/s^2", "largest lateral acceleration")
    lateral_acceleration_r79: float = _measure("m/s^2", "largest lateral acceleration by UN R79", needs_outline=True)
    jerk_rms: float = _measure("m/s^3", "RMS lateral jerk")
    jerk_max: float = _measure("m/s^3", "largest lateral jerk", needs_outline=True)
    jerk_r79: float = _measure("m/s^3", "largest lateral jerk by UN R79", needs_outline=True)

    at_change_limit: float = _measure("-", "share of periods with an active limit on Δu")
    at_angle_limit: float = _measure("-", "share of periods with an active limit on u")
    at_output_limit: float = _measure("-", "share of periods with an active limit on y")
    at_any_limit: float = _measure("-", "share of periods with any active limit")

    qp_solved: int = _measure("-", "QPs solved to tolerance", 0)
    qp_capped: int = _measure("-", "QPs stopped at the iteration limit", 0)
    qp_failed: int = _measure("-", "QPs without a solution", 0)
    held: int = _measure("-", "periods in which the controller computed no new command", 0)
    dead_reckoning: int = _measure("-", "periods without a new position measurement", 0)
    dead_reckoning_max: float = _measure("s", "longest time without a position measurement")
    qp_residual_max: float = _measure("-", "largest KKT residual of the QPs")
    qp_iterations_mean: float = _measure("-", "mean number of QP iterations")
    qp_iterations_max: int = _measure("-", "largest number of QP iterations", 0)

    step_us_p50: float = _measure("µs", "median computation time of a control step")
    step_us_p99: float = _measure("µs", "99th percentile of the computation time")
    step_us_p999: float = _measure("µs", "99.9th percentile of the computation time")
    step_us_max: float = _measure("µs", "longest computation time")

    prediction_error_half: float = _measure("m", "RMS prediction error of the model 0.5 s ahead")
    prediction_error_one: float = _measure("m", "RMS prediction error of the model 1 s ahead")

    belief_learning: float = _measure("-", "share of periods while learning")
    belief_settled: float = _measure("-", "share of periods with settled estimates")
    belief_at_bound: float = _measure("-", "share of periods with an estimate at its bound")
    belief_contradictory: float = _measure("-", "share of periods with contradictory measurements")
    belief_state: str = _measure("-", "learning state at the end", "")

    cost: float = _measure("m^2", "cost J = mean e^2 + w mean Δu^2")

    def _repr_html_(self) -> str:
        """Return the measures as a table for a notebook."""
        return html_of(self)

    def as_row(self) -> dict[str, Any]:
        """Return the measures by name for strict JSON, with None for values that are not finite.

        Measures that need the outline of the car are left out if it is unknown.
        """
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value, _, _ in self.rows()
        }

    def rows(self) -> list[tuple[str, Any, str, str]]:
        """Return (name, value, unit, title) of each measure in `as_row`."""
        has_outline = not math.isnan(self.duration)
        return [
            (column.name, getattr(self, column.name), column.metadata["unit"], column.metadata["title"])
            for column in dataclasses.fields(self)
            if has_outline or not column.metadata["needs_outline"]
        ]

    def __str__(self) -> str:
        """Return a line for each known measure: title, value and unit; `rows` also has the attribute names."""
        lines = []
        for _, value, unit, title in self.rows():
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            if text not in ("nan", ""):
                lines.append(f"{title:<56} {text:>9} {unit if unit != '-' else ''}".rstrip())
        return "\n".join(lines)


@checked
def compute_metrics(
    trajectory: Trajectory,
    *,
    move_weight: Annotated[NotNegative, "m^2/rad^2"] | None = None,
    failure: FailureLimits | None = None,
    model: PredictionModel | None = None,
    outline: Outline | None = None,
) -> Metrics:
    """Compute all measures of a run. For a part of the run, pass the result of `Trajectory.between`.

    Parameters
    ----------
    trajectory
        The run. It may contain NaN: then the run has failed and its MSE is infinite.
    move_weight
        Weight w of J = mean e² + w mean Δu² (m²/rad²). By default it is ``move_weight`` in ``trajectory.meta``, which
        comes from the profile, and otherwise 0.
    failure
        Limits beyond which the run has failed; see `find_failure` for the default.
    model
        Prediction model of the controller (`MPC.model`), for the prediction errors.
    outline
        Outline of the car (`Vehicle.outline`), for the measures of `path_metrics`. They are computed over the instants
        before the first one that is not finite.
    """
    if move_weight is None:
        move_weight = float(trajectory.meta.get("move_weight", 0.0))
    failed = find_failure(trajectory, failure)

    with np.errstate(invalid="ignore", over="ignore"):
        error = trajectory.error if state_is_finite(trajectory).all() else np.full(len(trajectory), np.nan)
        heading_error = trajectory.heading_error[~(trajectory.vx < MIN_JUDGED_SPEED)]  # NaN speeds stay in
        jerk = np.diff(trajectory.lateral_acceleration) / trajectory.period
    motion = _motion_measures(error, heading_error, trajectory.command, trajectory.lateral_acceleration, jerk)
    activity = statistics.mean_square(trajectory.command_change)
    prediction_errors = dict.fromkeys(TIMES, math.nan) if model is None else run_prediction_error(trajectory, model)
    record = None if outline is None else PathRecord.from_trajectory(trajectory)

    return Metrics(
        steps=len(trajectory),
        driven=int(np.count_nonzero(np.isfinite(trajectory.command))),
        failed=failed is not None,
        failed_at=failed.time if failed else math.nan,
        failed_reason=str(failed.reason) if failed else "",
        failed_because=failed.clause if failed else "",
        **motion,
        steering_rate_rms=math.sqrt(activity) / trajectory.period,
        steering_activity=activity,
        prediction_error_half=prediction_errors[0.5],
        prediction_error_one=prediction_errors[1.0],
        cost=motion["mse"] + move_weight * activity if move_weight else motion["mse"],
        **_belief_measures(trajectory),
        **_step_measures(trajectory),
        **({} if record is None or outline is None else _path_measures(record, outline, LANE_WIDTH, STEERING_RATIO)),
    )


def _motion_measures(error: Array, heading: Array, command: Array, acceleration: Array, jerk: Array) -> dict[str, Any]:
    """Return the measures of tracking, command, lateral acceleration and jerk by their names in `Metrics`."""
    mse = statistics.mean_square(error)
    return {
        "mse": mse,
        "rms_error": math.sqrt(mse),
        "max_abs_error": statistics.largest_magnitude(error),
        "heading_rms": math.sqrt(statistics.mean_square(heading)),
        "heading_max": statistics.largest_magnitude(heading),
        "steering_rms": math.sqrt(statistics.mean_square(command)),
        "lateral_acceleration_rms": math.sqrt(statistics.mean_square(acceleration)),
        "lateral_acceleration_max": statistics.largest_magnitude(acceleration),
        "jerk_rms": math.sqrt(statistics.mean_square(jerk)),
    }


def _step_measures(trajectory: Trajectory) -> dict[str, Any]:
    """Return the measures of limits, QPs, missing commands and computation times by their names in `Metrics`."""
    is_commanded = np.isfinite(trajectory.command)
    diagnostics = {name: values[is_commanded] for name, values in trajectory.diagnostics.items()}
    limits = diagnostics.get("at_limit", _NO_DIAGNOSTIC)
    status = diagnostics.get("qp_status", _NO_DIAGNOSTIC)
    iterations = diagnostics.get("qp_iterations", _NO_DIAGNOSTIC)
    time_without_position = diagnostics.get("dead_reckoning", np.zeros(is_commanded.sum()))
    has_solution = (status == _SOLVED) | (status == _CAPPED)
    step_times = trajectory.step_time[np.isfinite(trajectory.step_time)] * 1e6
    quantiles = np.percentile(step_times, [50, 99, 99.9]).tolist() if step_times.size else [math.nan] * 3
    return {
        "at_change_limit": _mean((limits & AT_CHANGE_LIMIT) != 0),
        "at_angle_limit": _mean((limits & AT_ANGLE_LIMIT) != 0),
        "at_output_limit": _mean((limits & AT_OUTPUT_LIMIT) != 0),
        "at_any_limit": _mean(limits != 0),
        "qp_solved": int(np.count_nonzero(status == _SOLVED)),
        "qp_capped": int(np.count_nonzero(status == _CAPPED)),
        "qp_failed": int(np.count_nonzero(~has_solution)),
        "held": int(np.count_nonzero(trajectory.held[is_commanded])),
        "dead_reckoning": int(np.count_nonzero((time_without_position > 0.0) & ~trajectory.held[is_commanded])),
        "dead_reckoning_max": statistics.largest_known(diagnostics.get("dead_reckoning", np.empty(0))),
        "qp_residual_max": statistics.largest_known(
            diagnostics.get("qp_residual", np.full(status.size, math.nan))[has_solution]
        ),
        "qp_iterations_mean": _mean(iterations),
        "qp_iterations_max": int(np.max(iterations, initial=0)),
        **dict(zip(("step_us_p50", "step_us_p99", "step_us_p999"), quantiles, strict=True)),
        "step_us_max": statistics.largest_known(step_times),
    }


# -- drives as arrays -------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class PathRecord:
    """Signals of a drive along a path at n instants, as arrays (n,). A number means the same value at all instants.

    Raises
    ------
    InvalidInput
        When arrays differ in length, or when times do not increase.
    """

    t: Array
    """Increasing times (s)."""
    offset: Array
    """Error e: offset of the centre of mass from the path (m)."""
    heading_error: Array
    """Yaw angle minus the heading of the path at its nearest point (rad); need not be wrapped."""
    speed: Array
    """Longitudinal speed v_x (m/s)."""
    lateral_acceleration: Array
    """Lateral acceleration of the centre of mass (m/s^2), without the part of gravity on a banked road."""
    wheel_angle: Array
    """Angle of the road wheels (rad)."""
    yaw_rate: Array | float = 0.0
    """Yaw rate of the car (rad/s)."""
    command: Array | float = 0.0
    """Steering command: requested angle of the road wheels (rad)."""
    curvature: Array | float = 0.0
    """Curvature of the path at its nearest point (1/m)."""

    def __post_init__(self) -> None:
        t = reals("PathRecord: t", self.t)
        if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
            raise InvalidInput("PathRecord: t must be at least two finite, increasing times in s.")
        for column in dataclasses.fields(self):
            values = reals(f"PathRecord: {column.name}", getattr(self, column.name))
            if values.shape not in ((), t.shape):
                raise InvalidInput(
                    f"PathRecord: {column.name} has the shape {values.shape}: must be ({t.size},), as t, or a number."
                )
            object.__setattr__(self, column.name, np.broadcast_to(values, t.shape))

    @classmethod
    @checked
    def from_trajectory(cls, run: Trajectory) -> Self | None:
        """Take the instants of a run before the first one that is not finite; None if fewer than two remain.

        The offset is the error from the reference of the run.
        """
        names = {"offset": "error", "speed": "vx", "wheel_angle": "steering"}  # of the run, where they differ
        columns = {"curvature": run.road.get("curvature", np.zeros(len(run)))}
        for column in dataclasses.fields(cls):
            if column.name not in columns:
                columns[column.name] = getattr(run, names.get(column.name, column.name))
        end = statistics.finite_length(*columns.values())
        return None if end < 2 else cls(**{name: values[:end] for name, values in columns.items()})

    @property
    def wrapped_heading_error(self) -> Array:
        """Heading error in [-pi, pi) (rad), (n,)."""
        return np.remainder(np.asarray(self.heading_error) + np.pi, 2.0 * np.pi) - np.pi


@checked
def path_metrics(
    record: PathRecord,
    outline: Outline,
    *,
    lane_width: Annotated[Positive, "m"] = LANE_WIDTH,
    steering_ratio: Positive | None = None,
) -> Metrics:
    """Compute measures from the recorded signals of any loop. Measures of controller, solver and failure stay unknown.

    Parameters
    ----------
    record
        Recorded signals.
    outline
        Outline of the car (`Vehicle.outline`).
    lane_width
        Width of the lane whose middle is the path (m).
    steering_ratio
        Ratio of the steering-wheel angle to the road-wheel angle, by default `STEERING_RATIO`.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        heading = record.wrapped_heading_error[~(record.speed < MIN_JUDGED_SPEED)]  # NaN speeds stay in
        jerk = np.diff(record.lateral_acceleration) / np.diff(record.t)
        command = np.asarray(record.command)
        command_rate = np.diff(command) / np.diff(record.t)
    return Metrics(
        steps=record.t.size,
        driven=record.t.size,
        **_motion_measures(record.offset, heading, command, record.lateral_acceleration, jerk),
        steering_rate_rms=math.sqrt(statistics.mean_square(command_rate)),
        steering_activity=statistics.mean_square(np.diff(command)),
        **_path_measures(record, outline, lane_width, STEERING_RATIO if steering_ratio is None else steering_ratio),
    )


def _path_measures(record: PathRecord, outline: Outline, lane_width: float, steering_ratio: float) -> dict[str, Any]:
    """Return the measures that need the outline of the car by their names in `Metrics`."""
    t, offset, acceleration, angle = record.t, record.offset, record.lateral_acceleration, record.wheel_angle
    with np.errstate(invalid="ignore", over="ignore"):
        corners = outline.corner_offsets(offset, record.wrapped_heading_error, record.curvature)
        corner = np.abs(corners).max(axis=-1)
        jerk = np.diff(acceleration) / np.diff(t)
        inside = corner <= 0.5 * lane_width
    comfort = statistics.r79(t, acceleration) if np.isfinite(acceleration).all() else (math.inf, math.inf)
    return {
        "duration": float(t[-1] - t[0]),
        "distance": float(np.trapezoid(np.abs(record.speed), t)),
        "mean_error": float(np.mean(offset)) if np.isfinite(offset).all() else math.inf,
        "p95_error": statistics.percentile_95(offset),
        "rms_corner": math.sqrt(statistics.mean_square(corner)),
        "p95_corner": statistics.percentile_95(corner),
        "max_corner": statistics.largest_magnitude(corner),
        "max_corner_error": statistics.largest_magnitude(corner) - 0.5 * outline.width,
        "in_lane": float(np.mean(inside)),
        "yaw_rate_max": statistics.largest_magnitude(np.asarray(record.yaw_rate)),
        "wheel_angle_rms": math.sqrt(statistics.mean_square(angle)),
        "reversals": statistics.reversal_rate(t, steering_ratio * angle) if np.isfinite(angle).all() else math.inf,
        "lateral_acceleration_r79": comfort[0],
        "jerk_max": statistics.largest_magnitude(jerk),
        "jerk_r79": comfort[1],
    }


# -- learning and the paper's numbers ---------------------------------------------------------------------------------
def _belief_measures(trajectory: Trajectory) -> dict[str, Any]:
    """Return the share of periods in each learning state, and the last one in words, by their names in `Metrics`."""
    if "belief_state" not in trajectory.diagnostics:
        return {}
    is_commanded = np.isfinite(trajectory.command)
    states, bounds = (trajectory.diagnostics[name][is_commanded] for name in ("belief_state", "belief_at_bound"))
    words = BeliefState(int(states[-1])).words(bounded_quantity(float(bounds[-1]))) if states.size else ""
    return {f"belief_{state.name.lower()}": _mean(states == state) for state in BeliefState} | {"belief_state": words}


@dataclass(frozen=True)
class Published:
    """Mean square errors that the paper reports for one of its two tests (section V)."""

    duration: float
    """Duration of the test (s), chosen to reproduce the reported errors."""
    mse: dict[str, float]
    """Mean square error by controller (m²)."""


PAPER_MSE = {
    "triple-lane-change": Published(28.0, {"standard": 0.0318, "nn": 0.0051, "anfis": 0.0062}),
    "general-trajectory": Published(200.0, {"standard": 0.5896, "nn": 0.132, "anfis": 0.1349}),
}
"""The paper's errors by scenario. The paper does not state the durations; its figures match these."""


def published_mse(trajectory: Trajectory) -> float | None:
    """Return the paper's mean square error (m²) for the same test and controller; None if the run is not comparable.

    A run is comparable if it drives one of the paper's two tests in the ``paper`` profile, without preview and for the
    paper's duration. The names come from ``trajectory.meta``. The name ``NN-MPC`` means the controller ``nn``; text in
    brackets is ignored.
    """
    meta = trajectory.meta
    published = PAPER_MSE.get(trajectory.name_of("scenario"))
    if published is None or meta.get("profile") != "paper" or meta.get("preview"):
        return None
    if not math.isclose(trajectory.duration, published.duration, abs_tol=1.5 * trajectory.period):
        return None
    controller = re.sub(r"\(.*\)", "", trajectory.name_of("controller").lower()).strip()
    return published.mse.get(controller.removesuffix("mpc").rstrip(" -_"))


def _mean(values: NDArray[Any]) -> float:
    """Mean of an array; NaN if it is empty."""
    return float(np.mean(values)) if values.size else math.nan
