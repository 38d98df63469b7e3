"""Filter and learner of a controller that steers nothing, and what they predict of the car.

From the state and the belief of an instant the car is predicted `TIMES`, with the commands and speeds that followed, by

    learned   the path model (`core.models.path`) with the belief of that instant, its disturbances held
    held      the filtered yaw rate and lateral velocity, held
    first     the same model and filter as the first, with the belief before the first sample
    steady    r = v delta/(L + K v^2) and v_y = (l_r - m l_f v^2/(C_r L)) r of the car's file, delta behind the first
              belief's steering (R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.control.controllers import MPC
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel
from adaptrack.core.estimators import kalman
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.maths.portable import product
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.models.path import PATH_STATES, discretise_disturbed
from adaptrack.drive.prediction import TIMES
from adaptrack.identification.instants import InstantSamples

Array = NDArray[np.float64]
InstantIndices = NDArray[np.int64]
Predicted = dict[tuple[str, str, float], Array]
"""(predictor, quantity, s ahead) -> (n,), at the instants that it is for; NaN where nothing was predicted"""

PREDICTORS = ("learned", "held", "first", "steady")
PREDICTED_QUANTITIES = ("yaw_rate", "y")
PREDICTION_SPACING = 0.1
"""s, at least, between the instants from which is predicted."""
_STATE, _N = kalman.FILTER_STATE, len(kalman.FILTER_STATE)
_MODEL = slice(_N + 1, _N + 8)
_WHOLE, _SHARE, _BIAS, LEFT_OUT = range(_N + 8, _N + 12)
"""Places in `Observer.state_row`, behind the states of the filter and the saturation."""


class Observer:
    """Filter and learner of a controller, without what steers; one that does not learn keeps the first belief."""

    def __init__(self, mpc: MPC, learns: bool = True) -> None:
        model, estimator = mpc.model, mpc.estimator
        assert isinstance(model, PathModel)
        assert isinstance(estimator, KalmanFilter)
        assert mpc.learner is not None
        self.learner, self.learns, self.size = mpc.learner, learns, estimator.memory_size(model)
        self.car, self.filter = model.parameters(), estimator.parameters(model)
        self.learning, self.known = mpc.learner.parameters(), mpc.learner.fresh()
        self.unused, self.a = np.zeros((3, model.n)), np.zeros((model.n, model.n))
        self.restart()

    def restart(self) -> None:
        """Before the first sample of a drive; what was learned stays."""
        self.memory, self.known = np.zeros(self.size), self.learner.restart_memory(self.known)

    def take(self, speed: float, measured: Array, command: float) -> None:
        """An instant: speed (m/s), what is measured, the command (rad) that was applied since the last one.

        As `core.controllers.informed` lets a controller take it.
        """
        if self.learns:
            omitted = int(kalman.memory_of(self.memory, 0).excluded)
            kernel.learn(speed, measured, command, omitted, self.learning, self.known)
            if not np.isfinite(self.beliefs).all():
                self.known = self.learner.fresh()
            kernel.believe(self.learning, self.known, self.car, self.filter, self.memory)
        b, x, d = self.unused
        kalman.kalman(speed, measured, command, self.a, b, self.filter, self.memory, x, d)

    @property
    def beliefs(self) -> Array:
        """By `BELIEFS`."""
        return self.known[kernel.BELIEFS_OFFSET : kernel.BELIEFS_OFFSET + len(kernel.BELIEF_NAMES)]

    def state_row(self) -> Array:
        """Return z, saturation, the model, dead time in periods, bias and the number of the omitted sensor."""
        m, p = kalman.memory_of(self.memory, 0), kalman.parameters_of(self.filter, 0)
        return np.array([*m.z, m.saturation, *self.car, p.periods, p.share, p.bias, m.excluded])


def predicted(samples: InstantSamples, ours: Array, first: Array, mpc: MPC, tell: Callable[[float], None]) -> Predicted:
    """Predict from every `PREDICTION_SPACING` s of a segment.

    ours, first: (n, .) of `Observer.state_row`, with and without learning; tell: takes the share of the work on
    the segment that is done, of which this is the second half.
    """
    n, period, steps = samples.time.size, mpc.period, {round(ahead / mpc.period): ahead for ahead in TIMES}
    start = np.arange(0, max(n - max(steps), 0), math.ceil(PREDICTION_SPACING / period - 1e-6))
    starts = {"learned": ours[start], "first": first[start]}
    z = {name: starts["learned" if name in ("learned", "held") else "first"][:, :_N].copy() for name in PREDICTORS}
    for name, observed in starts.items():
        z[name][:, _STATE.side] += observed[:, _N]  # what tyres pull less in the bend at hand
    z["steady"][:, _STATE.offset] = 0.0
    predictions = {
        (name, quantity, ahead): np.full(n, math.nan)
        for name in z
        for quantity in PREDICTED_QUANTITIES
        for ahead in TIMES
    }
    for j in range(max(steps)):
        tell(0.5 + 0.5 * j / max(steps))
        k = start + j
        for name, observed in starts.items():
            _roll(z[name], samples, k, observed, period)
        _turn_steadily(z["steady"], samples.speed[k], z["first"][:, _STATE.wheel_angle], mpc.vehicle)
        for name in ("held", "steady"):
            _carry(z[name], samples, k, period)
        for name, state in z.items() if j + 1 in steps else ():
            predictions[name, "yaw_rate", steps[j + 1]][k + 1] = state[:, _STATE.yaw_rate] + state[:, _STATE.offset]
            predictions[name, "y", steps[j + 1]][k + 1] = state[:, _STATE.y] if samples.path is not None else math.nan
    return predictions


def _roll(z: Array, samples: InstantSamples, k: InstantIndices, rows: Array, period: float) -> None:
    """Move states z (m, .) from the instants k (m,) on by a period, with the commands that act behind the dead time."""
    f, b, u = np.zeros((k.size, PATH_STATES, _N)), np.zeros((k.size, _N)), samples.command
    for i, speed in enumerate(samples.speed[k].tolist()):
        discretise_disturbed(speed, period, rows[i, _MODEL], f[i], b[i])
    newer, share = k - rows[:, _WHOLE].astype(np.int64), rows[:, _SHARE]
    command = (1.0 - share) * u[np.maximum(newer, 0)] + share * u[np.maximum(newer - 1, 0)] + rows[:, _BIAS]
    z[:, :PATH_STATES] = product(f, z[..., None])[..., 0] + b[:, :PATH_STATES] * command[:, None]
    turned = samples.measured[k + 1, MEASUREMENT.turned]
    z[:, _STATE.yaw] -= turned
    z[:, _STATE.y] -= 0.5 * samples.speed[k] * period * turned


def _carry(z: Array, samples: InstantSamples, k: InstantIndices, period: float) -> None:
    """Move heading and offset alone on by a period, with the lateral velocity and the yaw rate in z."""
    turned = period * z[:, _STATE.yaw_rate] - samples.measured[k + 1, MEASUREMENT.turned]
    z[:, _STATE.y] += period * (z[:, _STATE.vy] + samples.speed[k] * (z[:, _STATE.yaw] + 0.5 * turned))
    z[:, _STATE.yaw] += turned


def _turn_steadily(z: Array, speed: Array, wheel_angle: Array, car: Any) -> None:
    """Write yaw rate and lateral velocity of the steady turn at a speed (m/s) and a wheel angle (rad)."""
    front, rear, wheelbase = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear, car.wheelbase
    understeer = car.mass * (car.lr * rear - car.lf * front) / (wheelbase * front * rear)
    z[:, _STATE.yaw_rate] = speed * wheel_angle / (wheelbase + understeer * (speed * speed))
    z[:, _STATE.vy] = (car.lr - car.mass * car.lf * (speed * speed) / (rear * wheelbase)) * z[:, _STATE.yaw_rate]
