"""How well a run went: tracking, effort, comfort, limits, solver, time; and the cost J that tuning minimises.

Wherever smaller is better, a measure whose samples are not all finite is infinite: a run that ended in NaN never
looks good, and sorts last.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import NotNegative, checked
from adaptrack.base.shown import html_of
from adaptrack.control.controllers.learned import BeliefState, bounded_quantity
from adaptrack.control.models import PredictionModel
from adaptrack.drive.failure import SLOW, Failure, find_failure, state_is_finite
from adaptrack.drive.prediction import TIMES, run_prediction_error
from adaptrack.drive.trajectory import Trajectory

AT_CHANGE_LIMIT, AT_ANGLE_LIMIT, AT_OUTPUT_LIMIT = 1, 2, 4
"""The bits of the diagnostic ``at_limit``: Δu (13), u (14) and y (15)."""

_SOLVED, _CAPPED = 0, 1  # of the diagnostic ``qp_status``; everything else is no answer
_NOTHING = np.empty(0, np.int64)  # of a controller that does not say


@dataclass(frozen=True)
class Metrics:
    """The measures of one run of n control periods; e = Y − y_ref, Δu = u(k) − u(k−1)."""

    steps: int
    """n"""
    driven: int
    """Control periods with a finite command; fewer than n when the run was ended early. Shares, QPs count these."""
    failed: bool
    """Whether the run failed, as `find_failure` defines it."""
    failed_at: float
    """s, when; NaN for a run that did not."""
    failed_reason: str
    """A `failure.Reason`, or what the loop that drove it said; empty for a run that did not."""
    failed_because: str
    """Why, to complete "the vehicle ..."; empty for a run that did not."""

    mse: float
    """m², mean e²: the paper's MSE."""
    rms_error: float
    """m, sqrt(mean e²)."""
    max_abs_error: float
    """m, max |e|."""
    heading_rms: float
    """rad, RMS of the heading error over the instants with v_x >= 1 m/s; NaN when there is none."""
    heading_max: float
    """rad, its largest magnitude over the same instants."""

    steering_rms: float
    """rad, RMS of the command u: the steering effort."""
    steering_rate_rms: float
    """rad/s, RMS of Δu/Ts."""
    steering_activity: float
    """rad², mean Δu²."""
    lateral_acceleration_rms: float
    """m/s²."""
    lateral_acceleration_max: float
    """m/s², largest magnitude."""
    jerk_rms: float
    """m/s³, RMS of the lateral acceleration's differences over Ts; NaN for a single instant."""

    at_change_limit: float
    """Share of the driven control periods, 0..1, in which a limit on Δu was active; NaN when unknown."""
    at_angle_limit: float
    """Likewise on u."""
    at_output_limit: float
    """Likewise on y."""
    at_any_limit: float
    """Likewise on any of the three."""

    qp_solved: int
    """QPs solved to their tolerance."""
    qp_capped: int
    """QPs stopped at the iteration cap: the answer is not certified."""
    qp_failed: int
    """QPs without an answer: infeasible, not finite, not convex."""
    held: int
    """Control periods in which a safe steering angle was held."""
    dead_reckoning: int
    """Control periods that were steered without a new position, on the estimate; held ones do not count."""
    dead_reckoning_max: float
    """s, for which there was none at the longest, held periods included; NaN when unknown."""
    qp_residual_max: float
    """Largest KKT residual among the QPs with an answer; NaN when none was recorded."""
    qp_iterations_mean: float
    """Mean number of iterations."""
    qp_iterations_max: int
    """Largest number of iterations."""

    step_us_p50: float
    """µs, median wall-clock time of a control step; NaN when times were not measured."""
    step_us_p99: float
    """µs, 99th percentile."""
    step_us_p999: float
    """µs, 99.9th percentile."""
    step_us_max: float
    """µs, the slowest."""

    prediction_error_half: float
    """m, RMS error of the output that the controller's model predicts 0.5 s ahead, open loop, see
    `prediction.run_prediction_error`; NaN when `compute_metrics` was given no model."""
    prediction_error_one: float
    """m, likewise 1 s ahead."""

    belief_learning: float
    """Share of the driven control periods, 0..1, in which what is learned was still being learned (`BeliefState`); NaN
    of a controller that does not learn."""
    belief_settled: float
    """Likewise, in which it was settled."""
    belief_at_bound: float
    """Likewise, in which it was at the end of its range."""
    belief_contradictory: float
    """Likewise, in which it contradicted what was measured."""
    belief_state: str
    """The last of these states, in words; empty of a controller that does not learn."""

    cost: float
    """m², J = mean e² + w mean Δu²: what tuning minimises; w is `compute_metrics`' `move_weight`."""

    def _repr_html_(self) -> str:
        """The measures in a notebook."""
        return html_of(self)

    def as_row(self) -> dict[str, Any]:
        """The measures by name, ready for strict JSON: what is not finite becomes None."""
        row = dataclasses.asdict(self)
        return {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in row.items()}


@checked
def compute_metrics(
    trajectory: Trajectory,
    *,
    move_weight: Annotated[NotNegative, "m^2/rad^2"] | None = None,
    failure: Failure | None = None,
    model: PredictionModel | None = None,
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

    A trajectory with NaN is no error: it failed, and its MSE is infinite.
    """
    if move_weight is None:
        move_weight = float(trajectory.meta.get("move_weight", 0.0))
    failed = find_failure(trajectory, failure)

    with np.errstate(invalid="ignore", over="ignore"):
        error = trajectory.error if state_is_finite(trajectory).all() else np.full(len(trajectory), np.nan)
        heading_error = trajectory.heading_error[~(trajectory.vx < SLOW)]  # NaN speeds stay in
        jerk = np.diff(trajectory.lateral_acceleration) / trajectory.period
    mse = mean_square(error)
    activity = mean_square(trajectory.command_change)
    acceleration = trajectory.lateral_acceleration
    driven = np.isfinite(trajectory.command)
    said = {name: values[driven] for name, values in trajectory.diagnostics.items()}
    limits = said.get("at_limit", _NOTHING)
    status = said.get("qp_status", _NOTHING)
    iterations = said.get("qp_iterations", _NOTHING)
    reckoned = said.get("dead_reckoning", np.zeros(driven.sum()))
    answered = (status == _SOLVED) | (status == _CAPPED)
    ahead = dict.fromkeys(TIMES, math.nan) if model is None else run_prediction_error(trajectory, model)
    step_times = trajectory.step_time[np.isfinite(trajectory.step_time)] * 1e6

    return Metrics(
        steps=len(trajectory),
        driven=int(np.count_nonzero(driven)),
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
        at_change_limit=_mean((limits & AT_CHANGE_LIMIT) != 0),
        at_angle_limit=_mean((limits & AT_ANGLE_LIMIT) != 0),
        at_output_limit=_mean((limits & AT_OUTPUT_LIMIT) != 0),
        at_any_limit=_mean(limits != 0),
        qp_solved=int(np.count_nonzero(status == _SOLVED)),
        qp_capped=int(np.count_nonzero(status == _CAPPED)),
        qp_failed=int(np.count_nonzero(~answered)),
        held=int(np.count_nonzero(trajectory.held[driven])),
        dead_reckoning=int(np.count_nonzero((reckoned > 0.0) & ~trajectory.held[driven])),
        dead_reckoning_max=_largest_known(said.get("dead_reckoning", np.empty(0))),
        qp_residual_max=_largest_known(said.get("qp_residual", np.full(status.size, math.nan))[answered]),
        qp_iterations_mean=_mean(iterations),
        qp_iterations_max=int(np.max(iterations, initial=0)),
        step_us_p50=float(np.percentile(step_times, 50)) if step_times.size else math.nan,
        step_us_p99=float(np.percentile(step_times, 99)) if step_times.size else math.nan,
        step_us_p999=float(np.percentile(step_times, 99.9)) if step_times.size else math.nan,
        step_us_max=_largest_known(step_times),
        prediction_error_half=ahead[0.5],
        prediction_error_one=ahead[1.0],
        **belief_shares(trajectory),
        belief_state=last_belief_state(trajectory),
        cost=mse + move_weight * activity if move_weight else mse,
    )


def belief_shares(trajectory: Trajectory) -> dict[str, float]:
    """Share of the driven control periods in each state of what is learned, by `Metrics`' names; NaN: nothing is."""
    states = trajectory.diagnostics.get("belief_state", _NOTHING)
    known = states[np.isfinite(trajectory.command)] if states.size else states
    return {f"belief_{state.name.lower()}": _mean(known == state) for state in BeliefState}


def last_belief_state(trajectory: Trajectory) -> str:
    """The last state of what is learned, in words; empty where nothing is."""
    driven = np.flatnonzero(np.isfinite(trajectory.command))
    said = trajectory.diagnostics
    if "belief_state" not in said or not driven.size:
        return ""
    state, at_bound = (float(said[name][driven[-1]]) for name in ("belief_state", "belief_at_bound"))
    return BeliefState(int(state)).words(bounded_quantity(at_bound))


@dataclass(frozen=True)
class Published:
    """The mean square errors that the paper reports for one of its two tests (section V)."""

    duration: float
    """s, the window that matches them."""
    mse: dict[str, float]
    """m², by controller."""


PUBLISHED = {
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
    published = PUBLISHED.get(trajectory.name_of("scenario"))
    if published is None or meta.get("profile") != "paper" or meta.get("preview"):
        return None
    if not math.isclose(trajectory.duration, published.duration, abs_tol=1.5 * trajectory.period):
        return None
    controller = re.sub(r"\(.*\)", "", trajectory.name_of("controller").lower()).strip()
    return published.mse.get(controller.removesuffix("mpc").rstrip(" -_"))


def _mean(values: NDArray[Any]) -> float:
    """The mean; NaN of nothing."""
    return float(np.mean(values)) if values.size else math.nan


def mean_square(values: NDArray[Any]) -> float:
    """Mean of the squares; NaN of nothing, infinite when a value is not finite (or its square overflows)."""
    if not values.size:
        return math.nan
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(np.mean(np.square(values)))
    return mean if math.isfinite(mean) else math.inf


def largest_magnitude(values: NDArray[Any]) -> float:
    """Largest magnitude; NaN of nothing, infinite when a value is not finite."""
    if not values.size:
        return math.nan
    return float(np.max(np.abs(values))) if np.isfinite(values).all() else math.inf


def _largest_known(values: NDArray[Any]) -> float:
    """The largest value that is not NaN; NaN when there is none."""
    known = values[~np.isnan(values)]
    return float(np.max(known)) if known.size else math.nan
