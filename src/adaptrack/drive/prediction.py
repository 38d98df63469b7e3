"""Open-loop errors of a prediction model over a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.errors import InvalidInput
from adaptrack.control.models import MEASURED_STATES, PredictionModel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.drive.failure import MIN_JUDGED_SPEED
from adaptrack.drive.signal_statistics import finite_length, mean_square
from adaptrack.drive.trajectory import Trajectory

TIMES = (0.5, 1.0)
"""Default prediction times (s)."""


def run_prediction_error(run: Trajectory, model: PredictionModel) -> dict[float, float]:
    """Return the `prediction_error` (m) of a controller's model over a run for each of `TIMES`.

    Each prediction starts from the true states of the car. On a curved road, the model uses heading and offset relative
    to the path. Disturbances and tyre corrections from the controller's estimator are not included. Below 1 m/s the
    model is stepped at 1 m/s, as in the controller. Only the finite beginning of the run is used. The error is NaN if
    this part is too short, or if the run does not contain a state of the model.
    """
    if not set(model.states) <= set(MEASURED_STATES):
        return dict.fromkeys(TIMES, math.nan)
    states = np.stack([_state(run, name) for name in model.states], axis=-1)
    curvature = run.road.get("curvature", np.zeros(len(run)))
    end = finite_length(states, run.command, run.vx, curvature)
    dead_periods = round(model.dead_time / model.period)
    times = [time for time in TIMES if 1 <= round(time / model.period) < end - dead_periods]
    errors = dict.fromkeys(TIMES, math.nan)
    if times:
        speeds = np.maximum(run.vx[:end], MIN_JUDGED_SPEED)
        errors |= prediction_error(
            model, states[:end], run.command[:end], speeds, curvatures=curvature[:end], times=times
        )
    return errors


def _state(run: Trajectory, name: str) -> Array:
    """A state of a model over a run, by its name in `MEASUREMENT`; on a road yaw and y count from the road."""
    if name == "yaw":
        return run.road.get("heading_error", run.psi)
    if name == "y":
        return run.road.get("offset", run.Y)
    return run.steering if name == "wheel_angle" else getattr(run, name)


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
    """Return the open-loop RMS error (m) of a prediction model's output for each prediction time.

    From every recorded state, the model is stepped with the recorded commands and speeds. Commands are delayed by the
    dead time of the model, rounded to whole periods. In a bend, yaw and y are relative to the path, whose heading
    changes by curvature times speed.

    Parameters
    ----------
    model
        Prediction model with the sampling period of the record.
    states : (n, model.n) array
        Measured or estimated states at each instant, in the order of `model.states`.
    commands : (n,) array
        Command of the period that begins at each instant (rad).
    speeds : (n,) array
        Speed (m/s), > 0.
    curvatures : (n,) array or float
        Curvature of the path at the point nearest to the car (1/m).
    outputs : (n,) array, optional
        Recorded output (m); by default the output computed from `states`.
    times
        Prediction times (s), each at least one period and shorter than the record.

    Raises
    ------
    InvalidInput
        When shapes do not match, or when a prediction time is too short or too long.
    """
    x, u, v = (np.asarray(signal, dtype=np.float64) for signal in (states, commands, speeds))
    n = len(x)
    y = None if outputs is None else np.asarray(outputs, dtype=np.float64)
    if x.shape != (n, model.n) or not u.shape == v.shape == (u if y is None else y).shape == (n,):
        raise InvalidInput(
            f"prediction_error: states {x.shape}, commands {u.shape}, speeds {v.shape}, "
            f"outputs {None if y is None else y.shape}: must be (n, {model.n}) for {', '.join(model.states)}, and (n,)."
        )
    y = product(x, model.output) if y is None else y
    dead_periods = round(model.dead_time / model.period)
    steps = {time: round(time / model.period) for time in times}
    for time, count in steps.items():
        if not 1 <= count < n - dead_periods:
            raise InvalidInput(
                f"prediction_error: {time!r} s: must be at least one period ({model.period:g} s) and within the record."
            )
    a, b = _discretised(model, v)
    e = _path_turn_input(model, v)
    turn = np.broadcast_to(np.asarray(curvatures, dtype=np.float64), (n,)) * v
    predicted, errors = x[dead_periods:], {}
    for k in range(1, max(steps.values()) + 1):
        count = n - dead_periods - k  # states that have a k-th successor
        state_rows = slice(dead_periods + k - 1, dead_periods + k - 1 + count)
        command_rows = slice(k - 1, k - 1 + count)
        step = b[state_rows] * u[command_rows, None] + e[state_rows] * turn[state_rows, None]
        predicted = product(a[state_rows], predicted[:count, :, None])[..., 0] + step
        if k in steps.values():
            errors[k] = math.sqrt(mean_square(product(predicted, model.output) - y[dead_periods + k :]))
    return {time: errors[count] for time, count in steps.items()}


def _discretised(model: PredictionModel, speeds: Array) -> tuple[Array, Array]:
    """Return A (n, m, m) and B (n, m) of a model at speeds (n,) in m/s; equal speeds are computed once."""
    unique_speeds, rows = np.unique(speeds, return_inverse=True)
    if not (np.isfinite(unique_speeds) & (unique_speeds > 0.0)).all():
        raise InvalidInput("prediction_error: speeds must be positive and finite; leave out standstill.")
    n = model.n
    a, b, e = np.zeros((unique_speeds.size, n, n)), np.zeros((unique_speeds.size, n)), np.zeros(n)
    for k, speed in enumerate(unique_speeds.tolist()):
        model.function(speed, model.period, model.parameters(), a[k], b[k], e)
    return a[rows], b[rows]


def _path_turn_input(model: PredictionModel, speeds: Array) -> Array:
    """Return the input matrix (n, m) of the path's turn rate (rad/s): -T for yaw and -v T^2/2 for y.

    Prediction models do not have this input. The controller adds it in the same way (`core.controllers.mpc`).
    """
    change, names = np.zeros((speeds.size, model.n)), list(model.states)
    if "yaw" in names:
        change[:, names.index("yaw")] = -model.period
        change[:, names.index("y")] = -0.5 * speeds * portable.square(model.period)
    return change
