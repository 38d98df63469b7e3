"""The measures of a drive: tracking, corners, effort, comfort, limits, solver, time; the cost J that tuning minimises.

Wherever smaller is better, a measure whose samples are not all finite is infinite: a run that ended in NaN never
looks good, and sorts last. Signs are those of ISO 8855: positive to the left.
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
from adaptrack.drive.failure import MIN_JUDGED_SPEED, Failure, find_failure, state_is_finite
from adaptrack.drive.prediction import TIMES, run_prediction_error
from adaptrack.drive.signal_statistics import (
    largest_known,
    largest_magnitude,
    mean_square,
    percentile_95,
    r79,
    reversal_rate,
)
from adaptrack.drive.trajectory import Trajectory

Array = NDArray[np.float64]

LANE_WIDTH = 3.5
"""m, of the lane for the share of time inside."""
STEERING_RATIO = 15.0
"""Steering-wheel angle over road-wheel angle where the car file has none: passenger cars have 13 to 17."""

AT_CHANGE_LIMIT, AT_ANGLE_LIMIT, AT_OUTPUT_LIMIT = 1, 2, 4
"""The bits of the diagnostic ``at_limit``: Δu (13), u (14) and y (15)."""

_SOLVED, _CAPPED = 0, 1  # of the diagnostic ``qp_status``; all other values mean no answer
_NOTHING = np.empty(0, np.int64)  # a diagnostic that the controller does not have


def _measure(unit: str, meaning: str, default: Any = math.nan, *, path: bool = False) -> Any:
    """A field of `Metrics`; path: measured only where the car's outline is known."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning, "path": path})


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """The measures of one drive of n instants; e is the error from the reference or path, Δu = u(k) - u(k-1).

    The metadata of a field holds its unit and meaning; `rows` lists them. A measure that is unknown is NaN, a count 0.
    """

    steps: int = _measure("-", "instants n", 0)
    driven: int = _measure("-", "control periods with a finite command", 0)
    failed: bool = _measure("-", "whether it failed (`find_failure`)", False)
    failed_at: float = _measure("s", "when it failed")
    failed_reason: str = _measure("-", "a `failure.Reason`, or the loop's", "")
    failed_because: str = _measure("-", 'completes "the vehicle ..."', "")

    duration: float = _measure("s", "from the first instant to the last", path=True)
    distance: float = _measure("m", "integral of |v_x|", path=True)
    mse: float = _measure("m^2", "mean e^2, the paper's measure")
    rms_error: float = _measure("m", "root mean square of e")
    mean_error: float = _measure("m", "mean e, positive to the left", path=True)
    p95_error: float = _measure("m", "95th percentile of |e|", path=True)
    max_abs_error: float = _measure("m", "largest |e|")
    rms_corner: float = _measure("m", "RMS distance of the outermost corner", path=True)
    p95_corner: float = _measure("m", "its 95th percentile", path=True)
    max_corner: float = _measure("m", "its largest value", path=True)
    max_corner_error: float = _measure("m", "the same less half the width", path=True)
    in_lane: float = _measure("-", "share of time with all corners in lane", path=True)
    heading_rms: float = _measure("rad", "RMS heading error, v_x >= 1 m/s")
    heading_max: float = _measure("rad", "largest heading error, v_x >= 1 m/s")
    yaw_rate_max: float = _measure("rad/s", "largest magnitude", path=True)

    steering_rms: float = _measure("rad", "RMS of the command u")
    steering_rate_rms: float = _measure("rad/s", "RMS rate of the command")
    steering_activity: float = _measure("rad^2", "mean Δu^2")
    wheel_angle_rms: float = _measure("rad", "RMS angle of the road wheels", path=True)
    reversals: float = _measure("1/min", "steering reversals (SAE J2944)", path=True)
    lateral_acceleration_rms: float = _measure("m/s^2", "RMS, raw")
    lateral_acceleration_max: float = _measure("m/s^2", "largest, raw")
    lateral_acceleration_r79: float = _measure("m/s^2", "largest, as UN R79 evaluates it", path=True)
    jerk_rms: float = _measure("m/s^3", "RMS lateral jerk, raw")
    jerk_max: float = _measure("m/s^3", "largest, raw", path=True)
    jerk_r79: float = _measure("m/s^3", "largest, as UN R79 evaluates it", path=True)

    at_change_limit: float = _measure("-", "share of periods, limit on Δu active")
    at_angle_limit: float = _measure("-", "share of periods, limit on u active")
    at_output_limit: float = _measure("-", "share of periods, limit on y active")
    at_any_limit: float = _measure("-", "share of periods, any of them active")

    qp_solved: int = _measure("-", "QPs solved to their tolerance", 0)
    qp_capped: int = _measure("-", "QPs at the iteration cap", 0)
    qp_failed: int = _measure("-", "QPs without an answer", 0)
    held: int = _measure("-", "periods with a safe angle held", 0)
    dead_reckoning: int = _measure("-", "periods without a new position", 0)
    dead_reckoning_max: float = _measure("s", "longest time without one")
    qp_residual_max: float = _measure("-", "largest KKT residual")
    qp_iterations_mean: float = _measure("-", "mean QP iterations")
    qp_iterations_max: int = _measure("-", "largest number of them", 0)

    step_us_p50: float = _measure("µs", "median time of a control step")
    step_us_p99: float = _measure("µs", "99th percentile")
    step_us_p999: float = _measure("µs", "99.9th percentile")
    step_us_max: float = _measure("µs", "the slowest")

    prediction_error_half: float = _measure("m", "RMS, model's output 0.5 s ahead")
    prediction_error_one: float = _measure("m", "RMS, model's output 1 s ahead")

    belief_learning: float = _measure("-", "share of periods, learning")
    belief_settled: float = _measure("-", "share of periods, settled")
    belief_at_bound: float = _measure("-", "share of periods, at a bound")
    belief_contradictory: float = _measure("-", "share of periods, contradictory")
    belief_state: str = _measure("-", "the last of these states", "")

    cost: float = _measure("m^2", "J = mean e^2 + w mean Δu^2")

    def _repr_html_(self) -> str:
        """The measures in a notebook."""
        return html_of(self)

    def as_row(self) -> dict[str, Any]:
        """The measures by name, ready for strict JSON: None for what is not finite.

        Measures that need the car's outline are left out where it was not given.
        """
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value, _, _ in self.rows()
        }

    def rows(self) -> list[tuple[str, Any, str, str]]:
        """(name, value, unit, meaning) of the measures, as far as `as_row` holds them."""
        on_path = not math.isnan(self.duration)
        return [
            (column.name, getattr(self, column.name), column.metadata["unit"], column.metadata["meaning"])
            for column in dataclasses.fields(self)
            if on_path or not column.metadata["path"]
        ]

    def __str__(self) -> str:
        """A line for each known measure: name, value, unit, meaning."""
        lines = []
        for name, value, unit, meaning in self.rows():
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            if text not in ("nan", ""):
                lines.append(f"{name:<24} {text:>9} {unit:<6} {meaning}")
        return "\n".join(lines)


@checked
def compute_metrics(
    trajectory: Trajectory,
    *,
    move_weight: Annotated[NotNegative, "m^2/rad^2"] | None = None,
    failure: Failure | None = None,
    model: PredictionModel | None = None,
    outline: Outline | None = None,
) -> Metrics:
    """All measures of a run; `Trajectory.between` cuts out the window to measure.

    Parameters
    ----------
    move_weight
        The w of J = mean e² + w mean Δu²; by default ``move_weight`` of
        the run's `meta` (its profile's), else 0.
    failure
        When a run has failed, by default see `find_failure`.
    model
        Of the controller that drove (`MPC.model`), for the prediction errors.
    outline
        Of the car (`Vehicle.outline`), for the measures of `path_metrics`, over the instants before the first that is
        not finite.

    A trajectory with NaN is no error: it failed, and its MSE is infinite.
    """
    if move_weight is None:
        move_weight = float(trajectory.meta.get("move_weight", 0.0))
    failed = find_failure(trajectory, failure)

    with np.errstate(invalid="ignore", over="ignore"):
        error = trajectory.error if state_is_finite(trajectory).all() else np.full(len(trajectory), np.nan)
        heading_error = trajectory.heading_error[~(trajectory.vx < MIN_JUDGED_SPEED)]  # NaN speeds stay in
        jerk = np.diff(trajectory.lateral_acceleration) / trajectory.period
    mse = mean_square(error)
    activity = mean_square(trajectory.command_change)
    acceleration = trajectory.lateral_acceleration
    ahead = dict.fromkeys(TIMES, math.nan) if model is None else run_prediction_error(trajectory, model)
    record = None if outline is None else PathRecord.from_trajectory(trajectory)

    return Metrics(
        steps=len(trajectory),
        driven=int(np.count_nonzero(np.isfinite(trajectory.command))),
        failed=failed is not None,
        failed_at=failed.time if failed else math.nan,
        failed_reason=str(failed.reason) if failed else "",
        failed_because=failed.clause if failed else "",
        mse=mse,
        rms_error=math.sqrt(mse),
        max_abs_error=largest_magnitude(error),
        heading_rms=math.sqrt(mean_square(heading_error)),
        heading_max=largest_magnitude(heading_error),
        steering_rms=math.sqrt(mean_square(trajectory.command)),
        steering_rate_rms=math.sqrt(activity) / trajectory.period,
        steering_activity=activity,
        lateral_acceleration_rms=math.sqrt(mean_square(acceleration)),
        lateral_acceleration_max=largest_magnitude(acceleration),
        jerk_rms=math.sqrt(mean_square(jerk)),
        prediction_error_half=ahead[0.5],
        prediction_error_one=ahead[1.0],
        cost=mse + move_weight * activity if move_weight else mse,
        belief_state=last_belief_state(trajectory),
        **belief_shares(trajectory),
        **_step_measures(trajectory),
        **({} if record is None or outline is None else _path_measures(record, outline, LANE_WIDTH, STEERING_RATIO)),
    )


def _step_measures(trajectory: Trajectory) -> dict[str, Any]:
    """Limits, QPs, held angles and step times, by the names of `Metrics`."""
    is_commanded = np.isfinite(trajectory.command)
    diagnostics = {name: values[is_commanded] for name, values in trajectory.diagnostics.items()}
    limits = diagnostics.get("at_limit", _NOTHING)
    status = diagnostics.get("qp_status", _NOTHING)
    iterations = diagnostics.get("qp_iterations", _NOTHING)
    reckoned = diagnostics.get("dead_reckoning", np.zeros(is_commanded.sum()))
    answered = (status == _SOLVED) | (status == _CAPPED)
    step_times = trajectory.step_time[np.isfinite(trajectory.step_time)] * 1e6
    quantiles = np.percentile(step_times, [50, 99, 99.9]).tolist() if step_times.size else [math.nan] * 3
    return {
        "at_change_limit": _mean((limits & AT_CHANGE_LIMIT) != 0),
        "at_angle_limit": _mean((limits & AT_ANGLE_LIMIT) != 0),
        "at_output_limit": _mean((limits & AT_OUTPUT_LIMIT) != 0),
        "at_any_limit": _mean(limits != 0),
        "qp_solved": int(np.count_nonzero(status == _SOLVED)),
        "qp_capped": int(np.count_nonzero(status == _CAPPED)),
        "qp_failed": int(np.count_nonzero(~answered)),
        "held": int(np.count_nonzero(trajectory.held[is_commanded])),
        "dead_reckoning": int(np.count_nonzero((reckoned > 0.0) & ~trajectory.held[is_commanded])),
        "dead_reckoning_max": largest_known(diagnostics.get("dead_reckoning", np.empty(0))),
        "qp_residual_max": largest_known(diagnostics.get("qp_residual", np.full(status.size, math.nan))[answered]),
        "qp_iterations_mean": _mean(iterations),
        "qp_iterations_max": int(np.max(iterations, initial=0)),
        **dict(zip(("step_us_p50", "step_us_p99", "step_us_p999"), quantiles, strict=True)),
        "step_us_max": largest_known(step_times),
    }


# -- drives as arrays -------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class PathRecord:
    """A drive along a path at n instants, as arrays (n,); a number stands for all instants.

    Raises
    ------
    InvalidInput
        When arrays differ in length, or times do not increase.
    """

    t: Array
    """s, increasing"""
    offset: Array
    """m, e: centre of mass from the path"""
    heading_error: Array
    """rad, yaw less the heading of the path at the foot; any number of turns"""
    speed: Array
    """m/s, v_x"""
    lateral_acceleration: Array
    """m/s^2, at the centre of mass, without the pull of a bank"""
    wheel_angle: Array
    """rad, of the road wheels"""
    yaw_rate: Array | float = 0.0
    """rad/s, of the car"""
    command: Array | float = 0.0
    """rad, requested angle of the road wheels"""
    curvature: Array | float = 0.0
    """1/m, of the path at the foot"""

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
        """A run before its first instant that is not finite; None where fewer than two are.

        Offsets count from the reference that it was to follow.
        """
        columns = {
            "t": run.t, "offset": run.error, "heading_error": run.heading_error, "speed": run.vx,
            "lateral_acceleration": run.lateral_acceleration, "wheel_angle": run.steering, "yaw_rate": run.yaw_rate,
            "command": run.command, "curvature": run.road.get("curvature", np.zeros(len(run))),
        }  # fmt: skip
        is_finite = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
        end = len(run) if is_finite.all() else int(is_finite.argmin())
        return None if end < 2 else cls(**{name: values[:end] for name, values in columns.items()})

    @property
    def wrapped_heading_error(self) -> Array:
        """(n,) rad, the heading error in [-pi, pi)."""
        return np.remainder(np.asarray(self.heading_error) + np.pi, 2.0 * np.pi) - np.pi


@checked
def path_metrics(
    record: PathRecord,
    outline: Outline,
    *,
    lane_width: Annotated[Positive, "m"] = LANE_WIDTH,
    steering_ratio: Positive | None = None,
) -> Metrics:
    """The measures of a drive from arrays, of any loop; those of controller, solver and failure stay unknown.

    Parameters
    ----------
    outline
        The car's, `Vehicle.outline`.
    lane_width
        The path is the middle of the lane.
    steering_ratio
        Angle of the steering wheel over that of the road wheels, by default `STEERING_RATIO`.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        heading = record.wrapped_heading_error[~(record.speed < MIN_JUDGED_SPEED)]  # NaN speeds stay in
        jerk = np.diff(record.lateral_acceleration) / np.diff(record.t)
        command = np.asarray(record.command)
        command_rate = np.diff(command) / np.diff(record.t)
    mse = mean_square(record.offset)
    return Metrics(
        steps=record.t.size,
        driven=record.t.size,
        mse=mse,
        rms_error=math.sqrt(mse),
        max_abs_error=largest_magnitude(record.offset),
        heading_rms=math.sqrt(mean_square(heading)),
        heading_max=largest_magnitude(heading),
        steering_rms=math.sqrt(mean_square(command)),
        steering_rate_rms=math.sqrt(mean_square(command_rate)),
        steering_activity=mean_square(np.diff(command)),
        lateral_acceleration_rms=math.sqrt(mean_square(record.lateral_acceleration)),
        lateral_acceleration_max=largest_magnitude(record.lateral_acceleration),
        jerk_rms=math.sqrt(mean_square(jerk)),
        **_path_measures(record, outline, lane_width, STEERING_RATIO if steering_ratio is None else steering_ratio),
    )


def _path_measures(record: PathRecord, outline: Outline, lane_width: float, steering_ratio: float) -> dict[str, Any]:
    """The measures that need the car's outline, by the names of `Metrics`."""
    t, offset, acceleration, angle = record.t, record.offset, record.lateral_acceleration, record.wheel_angle
    with np.errstate(invalid="ignore", over="ignore"):
        corners = outline.corner_offsets(offset, record.wrapped_heading_error, record.curvature)
        corner = np.abs(corners).max(axis=-1)
        jerk = np.diff(acceleration) / np.diff(t)
        inside = corner <= 0.5 * lane_width
    comfort = r79(t, acceleration) if np.isfinite(acceleration).all() else (math.inf, math.inf)
    return {
        "duration": float(t[-1] - t[0]),
        "distance": float(np.trapezoid(np.abs(record.speed), t)),
        "mean_error": float(np.mean(offset)) if np.isfinite(offset).all() else math.inf,
        "p95_error": percentile_95(offset),
        "rms_corner": math.sqrt(mean_square(corner)),
        "p95_corner": percentile_95(corner),
        "max_corner": largest_magnitude(corner),
        "max_corner_error": largest_magnitude(corner) - 0.5 * outline.width,
        "in_lane": float(np.mean(inside)),
        "yaw_rate_max": largest_magnitude(np.asarray(record.yaw_rate)),
        "wheel_angle_rms": math.sqrt(mean_square(angle)),
        "reversals": reversal_rate(t, steering_ratio * angle) if np.isfinite(angle).all() else math.inf,
        "lateral_acceleration_r79": comfort[0],
        "jerk_max": largest_magnitude(jerk),
        "jerk_r79": comfort[1],
    }


# -- beliefs and the paper's numbers ----------------------------------------------------------------------------------
def belief_shares(trajectory: Trajectory) -> dict[str, Any]:
    """Share of the driven control periods in each state of what is learned, by `Metrics`' names; NaN: nothing is."""
    states = trajectory.diagnostics.get("belief_state", _NOTHING)
    states = states[np.isfinite(trajectory.command)] if states.size else states
    return {f"belief_{state.name.lower()}": _mean(states == state) for state in BeliefState}


def last_belief_state(trajectory: Trajectory) -> str:
    """The last state of what is learned, in words; empty where nothing is."""
    commanded_rows = np.flatnonzero(np.isfinite(trajectory.command))
    diagnostics = trajectory.diagnostics
    if "belief_state" not in diagnostics or not commanded_rows.size:
        return ""
    state, at_bound = (float(diagnostics[name][commanded_rows[-1]]) for name in ("belief_state", "belief_at_bound"))
    return BeliefState(int(state)).words(bounded_quantity(at_bound))


@dataclass(frozen=True)
class Published:
    """The mean square errors that the paper reports for one of its two tests (section V)."""

    duration: float
    """s, the window that matches them."""
    mse: dict[str, float]
    """m², by controller."""


PAPER_MSE = {
    "triple-lane-change": Published(28.0, {"standard": 0.0318, "nn": 0.0051, "anfis": 0.0062}),
    "general-trajectory": Published(200.0, {"standard": 0.5896, "nn": 0.132, "anfis": 0.1349}),
}
"""By scenario. The paper's window is not stated; its figures match these."""


def published_mse(trajectory: Trajectory) -> float | None:
    """m², the paper's MSE for the same test and controller; None when it has none that this run compares with.

    Comparable are runs of its two tests, in the paper profile, without preview, over the paper's window. The names
    are read from `Trajectory.meta`; ``NN-MPC`` means the controller ``nn``, and words in brackets do not count.
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
    """The mean; NaN of nothing."""
    return float(np.mean(values)) if values.size else math.nan
