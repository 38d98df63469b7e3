"""Errors of a prediction model over a recorded drive, open loop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.models import PredictionModel
from adaptrack.drive.failure import MIN_JUDGED_SPEED
from adaptrack.drive.trajectory import Trajectory

Array = NDArray[np.float64]

TIMES = (0.5, 1.0)
"""s, ahead."""


def run_prediction_error(run: Trajectory, model: PredictionModel) -> dict[float, float]:
    """`prediction_error` of a controller's model over a run, at `TIMES`: from the car's true states, open loop.

    On a curved road heading and offset count from the path. What the controller's estimator adds (disturbances, what
    tyres lose in bends) is not part of it. Below 1 m/s the model is stepped at 1 m/s, as the controller does. A run
    counts as far as it is finite; NaN for a time at which nothing is left, or where a state of the model is not in the
    record.
    """
    columns = {
        "vy": run.vy, "yaw": run.road.get("heading_error", run.psi), "yaw_rate": run.yaw_rate,
        "wheel_angle": run.steering, "y": run.road.get("offset", run.Y),
    }  # fmt: skip
    if not set(model.states) <= set(columns):
        return dict.fromkeys(TIMES, math.nan)
    states = np.stack([columns[name] for name in model.states], axis=-1)
    curvature = run.road.get("curvature", np.zeros(len(run)))
    complete = np.isfinite(np.column_stack([states, run.command, run.vx, curvature])).all(axis=1)
    end = len(run) if complete.all() else int(complete.argmin())
    late = round(model.dead_time / model.period)
    times = [time for time in TIMES if 1 <= round(time / model.period) < end - late]
    errors = dict.fromkeys(TIMES, math.nan)
    if times:
        speeds = np.maximum(run.vx[:end], MIN_JUDGED_SPEED)
        errors |= prediction_error(
            model, states[:end], run.command[:end], speeds, curvatures=curvature[:end], times=times
        )
    return errors


def prediction_error(
    model: PredictionModel,
    states: ArrayLike,
    commands: ArrayLike,
    speeds: ArrayLike,
    *,
    curvatures: ArrayLike = 0.0,
    outputs: ArrayLike | None = None,
    times: Sequence[float] = TIMES,
) -> dict[float, float]:
    """RMS error (m) of the output that a prediction model foretells for some times ahead, open loop.

    From every state the model is stepped over the record with the commands that followed, at their speeds. Its dead
    time is taken out by the commands of so much earlier, in whole periods: a fraction is rounded. In a bend the path
    turns under the car, by curvature times speed: of the states, yaw and y count from it.

    Parameters
    ----------
    model
        Its period is that of the record.
    states : (n, model.n) array
        In the order of `model.states`, as measured or estimated at each instant.
    commands : (n,) array
        rad, of the period that begins at each instant.
    speeds : (n,) array
        m/s, > 0.
    curvatures : (n,) array or float
        1/m, of the path at the foot.
    outputs : (n,) array, optional
        m, what the output was; by default that of `states`.
    times
        s, each at least a period and within the record.

    Raises
    ------
    InvalidInput
        When shapes do not fit or a time does not.
    """
    x, u, v = (np.asarray(signal, dtype=np.float64) for signal in (states, commands, speeds))
    n = len(x)
    y = u if outputs is None else np.asarray(outputs, dtype=np.float64)
    if x.shape != (n, model.n) or not u.shape == v.shape == y.shape == (n,):
        raise InvalidInput(
            f"prediction_error: states {x.shape}, commands {u.shape}, speeds {v.shape}, outputs {y.shape}: "
            f"must be (n, {model.n}) for {', '.join(model.states)}, and (n,)."
        )
    y = x @ model.output if outputs is None else y
    late = round(model.dead_time / model.period)
    steps = {time: round(time / model.period) for time in times}
    for time, count in steps.items():
        if not 1 <= count < n - late:
            raise InvalidInput(
                f"prediction_error: {time!r} s: must be at least one period ({model.period:g} s) and within the record."
            )
    a, b = _discretised(model, v)
    e = _turning(model, v)
    turn = np.broadcast_to(np.asarray(curvatures, dtype=np.float64), (n,)) * v
    ahead, errors = x[late:], {}
    for k in range(1, max(steps.values()) + 1):
        count = n - late - k  # states that have a k-th successor
        current, then = slice(late + k - 1, late + k - 1 + count), slice(k - 1, k - 1 + count)
        step = b[current] * u[then, None] + e[current] * turn[current, None]
        ahead = np.einsum("kij,kj->ki", a[current], ahead[:count]) + step
        if k in steps.values():
            errors[k] = _rms(ahead @ model.output - y[late + k :])
    return {time: errors[count] for time, count in steps.items()}


def _discretised(model: PredictionModel, speeds: Array) -> tuple[Array, Array]:
    """A (n, m, m) and B (n, m) of a model at speeds (n,), each speed once."""
    unique_speeds, place = np.unique(speeds, return_inverse=True)
    if not (np.isfinite(unique_speeds) & (unique_speeds > 0.0)).all():
        raise InvalidInput("prediction_error: speeds must be positive and finite; leave out where the car stands.")
    a, b, e = (
        np.zeros((unique_speeds.size, model.n, model.n)),
        np.zeros((unique_speeds.size, model.n)),
        np.zeros(model.n),
    )
    for k, speed in enumerate(unique_speeds.tolist()):
        model.function(speed, model.period, model.parameters(), a[k], b[k], e)
    return a[place], b[place]


def _turning(model: PredictionModel, speeds: Array) -> Array:
    """(n, m) change of the states for each rad/s by which the path turns: -T of yaw, -v T^2/2 of y.

    Of every model, as the controller predicts (`core.controllers.mpc`): the single track has no such input itself.
    """
    change, names = np.zeros((speeds.size, model.n)), list(model.states)
    if "yaw" in names:
        change[:, names.index("yaw")] = -model.period
        change[:, names.index("y")] = -0.5 * speeds * model.period**2
    return change


def _rms(values: Array) -> float:
    """Infinite where a value is not finite."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.isfinite(values).all() else math.inf
