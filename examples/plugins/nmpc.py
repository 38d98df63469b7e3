"""Nonlinear MPC on the single track with its tyre's curve: `--plugin nmpc --controller nmpc`, or `nmpc-as-measured`.

CasADi differentiates and solves: pip install casadi.

The model in path coordinates, x = [v_y, r, psi, e, delta]; delta is left out without lag, u standing for it:

    dv_y/dt = (F_f + F_r)/m - v r + d_y,   dr/dt = (l_f F_f - l_r F_r)/I_z + d_r
    dpsi/dt = r - kappa (v cos psi - v_y sin psi)/(1 - kappa e),   de/dt = v sin psi + v_y cos psi
    ddelta/dt = (u - delta)/tau,   F: the Magic Formula at static load, see `Tyre`

(R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.3; path coordinates as in R. Verschueren, M. Zanon,
R. Quirynen, M. Diehl, *Time-Optimal Race Car Driving Using an Online Exact Hessian Based Nonlinear MPC Algorithm*,
European Control Conference 2016.)
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import checked, real, whole_number
from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.vehicle import Steering, Tyre, Vehicle, VehicleArgument, split_periods
from adaptrack.control.controllers.base import Array, Command, Controller
from adaptrack.control.controllers.informed import HORIZON_DURATION, informed_tuning
from adaptrack.control.controllers.inputs import finite, number, road_ahead, vector
from adaptrack.control.controllers.limits import Limits, LimitsArgument
from adaptrack.control.controllers.registry import register_controller
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel
from adaptrack.core.public import path_model
from adaptrack.road.road_ahead import RoadAhead
from adaptrack.scenario.profile import Profile
from known_car import KnownCar

SLOWEST, STANDING = 2.0, 0.1
"""m/s: the model is never formed below the first; a slower car than the second stands."""
STIFFEST = 2.0
"""Of a Runge-Kutta step times the fastest mode of the model; 2.78 is the bound of stability."""
MOST_STAGES = 200
CONVERGED = 1e-7
"""rad, of the largest change of a move in an iteration."""
_SENSORS = (4, 5, 6, 7, 8, 9)


def _casadi() -> Any:
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise MissingExtra("The controller 'nmpc' needs CasADi: python -m pip install casadi") from error


class Ahead(NamedTuple):
    """What is known of the stages; each (stages,)."""

    speed: Array
    """m/s"""
    curvature: Array
    """1/m, of the road"""
    reference: Array
    """m, y_ref at their ends"""


class NMPC(Controller):
    """Nonlinear MPC with the true parameters of tyres, lag and dead time.

        min sum q_e (e - y_ref)^2 + q_course (psi + v_y/v)^2 + R (move of u)^2,   within the limits on moves and angle

    over `horizon` (s), every move being free. Multiple shooting with fourth-order Runge-Kutta steps; Gauss-Newton SQP,
    warm started by the last solution a period on; the QPs are condensed and solved by DAQP. iterations: of the SQP
    at most; 1 is the real-time iteration of M. Diehl, H. G. Bock, J. P. Schlöder, *A Real-Time Iteration Scheme for
    Nonlinear Optimization in Optimal Feedback Control*, SIAM J. Control Optim. 43 (2005).

    The commands on their way are taken out by driving the model through them. estimating: whether the `KalmanFilter` of
    the informed MPC gives the state at their end, and by d_y and d_r what its pushes and its linear tyres know beyond
    the Magic Formula at that state; otherwise the state is taken as measured, what is not measured from the model.

    profile, belief, computation, tyre, friction, period, limits, preview: as for `MPPI`; R: by default that of the
    informed MPC.

    Raises
    ------
    MissingExtra
        When CasADi is not installed.
    InvalidInput
        For arguments that make no controller.
    """

    period: float
    tuning_names = ("q_e", "q_course", "R")
    diagnostic_names = ("held", "iterations", "change")
    sees_all_sensors = True

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        profile: str | Profile | None = None,
        belief: Steering | None = None,
        computation: float | None = None,
        tyre: Tyre | str | None = None,
        friction: float = 1.0,
        estimating: bool = True,
        q_e: float = 1.0,
        q_course: float = 0.0,
        R: float | None = None,
        horizon: float = HORIZON_DURATION,
        iterations: int = 1,
        period: float | None = None,
        limits: LimitsArgument | None = None,
        preview: bool | None = None,
    ) -> None:
        self.car = KnownCar.of("NMPC", vehicle, profile, belief, tyre, friction, period, computation)
        self.period, self.estimating = self.car.period, bool(estimating)
        own = informed_tuning(self.car.profile, self.period).R if R is None else R
        self.tuning: Mapping[str, float] = {"q_e": q_e, "q_course": q_course, "R": own}
        for name, value in self.tuning.items():
            least = 0.0 if name == "q_course" else 1e-300
            if not least <= real("NMPC", name, value) < math.inf:
                raise InvalidInput(f"NMPC: {name} = {value!r}: must be finite and positive; q_course may be 0.")
        self.horizon = real("NMPC", "horizon", horizon)
        if not self.period <= self.horizon <= MOST_STAGES * self.period:
            raise InvalidInput(
                f"NMPC: horizon = {horizon!r} s: must be from one control period to {MOST_STAGES} of them, "
                f"{self.period:g} to {MOST_STAGES * self.period:g} s."
            )
        self.stages, self.iterations = round(self.horizon / self.period), whole_number("NMPC", "iterations", iterations)
        self.limits = self.car.limits if limits is None else limits
        if not isinstance(self.limits, Limits):
            raise InvalidInput(f"NMPC: limits = {limits!r}: must be Limits(move=(low, high), angle=(low, high)).")
        self.preview = self.car.profile.preview if preview is None else bool(preview)
        self._dead = split_periods(self.car.belief.delay, self.period)
        self._model = PathModel(self.car.vehicle, self.period, self.car.belief.lag.value, self.car.belief.delay)
        self._filter = KalmanFilter.from_profile(self.car.profile)
        self._prepare()
        self.reset()

    # -- the model ----------------------------------------------------------------------------------------------------
    def _prepare(self) -> None:
        """The model and its derivatives, and the QP."""
        ca, n = _casadi(), self.stages
        lagging = self._model.lag > 0.0
        self._n = 5 if lagging else 4
        x, u, p, h = ca.SX.sym("x", self._n), ca.SX.sym("u"), ca.SX.sym("p", 4), ca.SX.sym("h")
        slope = ca.Function("slope", [x, u, p], [self._slope(ca, x, u, p)])
        steps = self._substeps()
        after = x
        for _ in range(steps):
            after = _runge_kutta(slope, after, u, p, h / steps)
        self._slope_of = slope
        self._step = ca.Function("step", [x, u, p, h], [after])
        moved = ca.substitute(after, h, self.period)
        stage = ca.Function("stage", [x, u, p], [moved, ca.jacobian(moved, x), ca.jacobian(moved, u)])
        self._stages = stage.map(n)
        self._all_steps = self._step.mapaccum(n)
        dense = {"h": ca.Sparsity.dense(n, n), "a": ca.Sparsity.dense(n, n)}
        self._qp = ca.conic("qp", "daqp", dense, {"error_on_fail": False})
        self._sums = np.tril(np.ones((n, n)))

    def _slope(self, ca: Any, x: Any, u: Any, p: Any) -> Any:
        """dx/dt of the states; p: v, kappa, d_y, d_r."""
        vehicle, (shape, curvature) = self.car.vehicle, self.car.curve
        vy, r, psi, e = x[0], x[1], x[2], x[3]
        v, kappa, push, turn = p[0], p[1], p[2], p[3]
        delta = x[4] if self._n == 5 else u

        def force(slip: Any, stiffness: float, peak: float) -> Any:
            b = stiffness / (shape * peak) * slip
            return peak * ca.sin(shape * ca.atan(b - curvature * (b - ca.atan(b))))

        stiffness, peaks = self.car.stiffness, self.car.peaks
        front = force(delta - ca.atan((vy + vehicle.lf * r) / v), stiffness[0], peaks[0])
        rear = force(-ca.atan((vy - vehicle.lr * r) / v), stiffness[1], peaks[1])
        along = (v * ca.cos(psi) - vy * ca.sin(psi)) / (1.0 - kappa * e)
        slopes = [
            (front + rear) / vehicle.mass - v * r + push,
            (vehicle.lf * front - vehicle.lr * rear) / vehicle.yaw_inertia + turn,
            r - kappa * along,
            v * ca.sin(psi) + vy * ca.cos(psi),
        ]
        if self._n == 5:
            slopes.append((u - delta) / self._model.lag)
        return ca.vertcat(*slopes)

    def _substeps(self) -> int:
        """Runge-Kutta steps of a period."""
        vehicle, (front, rear) = self.car.vehicle, self.car.stiffness
        fastest = max(
            (front + rear) / vehicle.mass, (front * vehicle.lf**2 + rear * vehicle.lr**2) / vehicle.yaw_inertia
        ) / SLOWEST  # fmt: skip
        lag = self._model.lag
        return math.ceil(self.period * max(fastest, 1.0 / lag if lag > 0.0 else 0.0) / STIFFEST)

    # -- the contract -------------------------------------------------------------------------------------------------
    @property
    def name(self) -> str:
        """How tables call the controller."""
        return "NMPC" if self.estimating else "NMPC (as measured)"

    def reset(self) -> None:
        """Forget the past: the next step is the first, from steering angle 0."""
        self._angle, self._begun = 0.0, False
        self._sent = np.zeros(self._dead[0] + 2)
        self._moves = np.zeros(self.stages)
        self._predicted = np.zeros(self._n)
        self._memory = np.zeros(self._filter.memory_size(self._model))

    @property
    def angle(self) -> float:
        """The last command (rad)."""
        return self._angle

    def applied(self, angle: float) -> None:
        """Say which angle (rad) was sent in place of the last command: the next step goes on from it.

        Raises
        ------
        InvalidInput
            When it is no finite number.
        """
        self._angle = finite("applied: angle", angle)

    def change_path(self, heading: float, offset: float) -> None:
        """Say that another path lies under the car, by how much (rad, m) heading and offset have grown against it.

        Raises
        ------
        InvalidInput
            When a number is not finite.
        """
        turned, shifted = finite("change_path: heading", heading), finite("change_path: offset", offset)
        self._predicted[2] += turned
        self._predicted[3] += shifted
        if self._begun:
            self._filter.change_path(self._model, self._memory, turned, shifted)

    def step(
        self, state: ArrayLike, speed: float, reference: ArrayLike, variables: Any = None,
        road: RoadAhead | None = None,
    ) -> Command:  # fmt: skip
        """One control step; arguments as for `MPC.step`.

        What is not finite gives no exception but a command that holds the previous angle.

        Raises
        ------
        InvalidInput
            When an argument is not made of numbers or has a wrong shape.
        """
        measured = np.full(9, math.nan)
        given = vector("state", state, _SENSORS)
        measured[: given.size] = given
        measured[8] = given[8] if given.size == 9 else 0.0
        speed, ahead = number("speed", speed), vector("reference", reference, most=2 * MOST_STAGES)
        road = road_ahead(road)
        self._take_command()
        found: Array | None = None
        iterations, change = 0, math.nan
        v = max(speed, SLOWEST) if speed < 1e3 else math.nan
        if math.isfinite(v) and np.abs(np.nan_to_num(given, nan=0.0)).max() < 1e6:
            path = self._look_ahead(ahead, v, road)
            x, pushes = self._state(measured, v, path, road)
            if np.isfinite(x).all() and np.isfinite(path.reference).all() and np.abs(path.reference).max() < 1e6:
                found, iterations, change = self._solve(x, pushes, path)
        return self._answer(found, speed, iterations, change)

    def _answer(self, found: Array | None, speed: float, iterations: int, change: float) -> Command:
        """The command; without a solution the next move of the last plan, of data that are not finite none."""
        held = found is None
        self._moves = np.append(self._moves[1:], 0.0) if found is None else found
        low, high = self.limits.move
        move = 0.0 if held or abs(speed) < STANDING else float(np.clip(self._moves[0], low, high))
        angle = float(np.clip(self._angle + move, *self.limits.angle))
        said = {"held": float(held), "iterations": float(iterations), "change": change}
        before, self._angle = self._angle, angle
        return Command(angle, angle - before, held, tuple(self.tuning.values()), said)

    # -- where the car is ---------------------------------------------------------------------------------------------
    def _take_command(self) -> None:
        """Keep the last command among those on their way."""
        if not self._begun:
            self._sent[:] = self._angle
            self._predicted[4:] = self._angle
        self._sent = np.append(self._angle, self._sent[:-1])

    def _look_ahead(self, reference: Array, v: float, road: RoadAhead | None) -> Ahead:
        """The stages, the first of which begins when the new command begins to act."""
        n, delay = self.stages, self._model.dead_time
        times = delay / self.period + np.arange(n + 1)
        ref = np.full(n + 1, reference[0])
        if self.preview:
            ref = np.interp(times, np.arange(reference.size), reference)
        if road is None:
            return Ahead(np.full(n, v), np.zeros(n), ref[1:])
        planned = np.interp(np.arange(n + times[0]), np.arange(road.speeds.size), road.speeds)[:n]
        speeds = np.maximum(planned, SLOWEST)
        stations = road.station + v * delay + self.period * (np.cumsum(speeds) - 0.5 * speeds)
        return Ahead(speeds, np.asarray(road.road.at(stations).curvature), ref[1:])

    def _state(self, measured: Array, v: float, path: Ahead, road: RoadAhead | None) -> tuple[Array, Array]:
        """x when the new command begins to act, and d_y, d_r (2,)."""
        if self.estimating:
            return self._estimated(measured, v, road)
        now, pushes = self._predicted.copy(), np.zeros(2)
        for i, value in ((0, measured[0]), (1, measured[2]), (2, measured[1]), (3, measured[3])):
            now[i] = value if math.isfinite(value) else (now[i] if self._begun else math.nan)
        self._begun = self._begun or bool(np.isfinite(now).all())
        if not np.isfinite(now).all():
            return now, pushes
        whole_number, share = self._dead
        here = path.curvature[0] if road is None else float(road.road.at(np.array([road.station])).curvature[0])
        p = np.array([v, here, 0.0, 0.0])
        self._predicted = self._over_a_period(now, p)
        x = now
        if share > 0.0:
            x = self._drive(x, self._sent[whole_number], p, share * self.period)
        for j in range(whole_number - 1, -1, -1):
            x = self._drive(x, self._sent[j], p, self.period)
        return x, pushes

    def _over_a_period(self, x: Array, p: Array) -> Array:
        """x a period on: in it first the older, then the newer of two commands on their way acts."""
        whole_number, share = self._dead
        if whole_number == 0:  # the command of this step acts soon; nobody knows it yet
            return self._drive(x, self._sent[0], p, self.period)
        before = self._drive(x, self._sent[whole_number], p, share * self.period) if share > 0.0 else x
        return self._drive(before, self._sent[whole_number - 1], p, (1.0 - share) * self.period)

    def _drive(self, x: Array, u: float, p: Array, time: float) -> Array:
        return np.asarray(self._step(x, u, p, time)).reshape(-1)

    def _estimated(self, measured: Array, v: float, road: RoadAhead | None) -> tuple[Array, Array]:
        """The filter's x at the end of the dead time, in path coordinates, and the pushes beyond the Magic Formula."""
        model, n = self._model, self._model.n
        a, b, _ = model.discrete(v)
        z, d = np.zeros(n), np.zeros(n)
        self._filter.function(
            v, measured, self._angle, a, b[:, 0].copy(), self._filter.parameters(model), self._memory, z, d
        )
        self._begun = True
        if not np.isfinite(z).all():
            return z, np.zeros(2)
        x = np.array([z[0], z[2], z[1], z[-1], *z[3 : n - 1]])
        if road is not None:
            there = road.road.at(np.array([road.station, road.station + v * model.dead_time]))
            x[2:4] = _in_path(x[2], x[3], v * model.dead_time, there)
        pushes = np.linalg.solve(self._entering(v), d[[0, 2]])
        continuous, inputs = model.continuous(v)
        u = self._angle
        linear = (continuous @ z + inputs[:, 0] * (u if n == 4 else 0.0))[[0, 2]] + pushes
        curved = np.asarray(self._slope_of(x, u, [v, 0.0, 0.0, 0.0])).reshape(-1)[:2]
        return x, linear - curved

    def _entering(self, v: float) -> Array:
        """(2, 2) what d_y and d_r add to v_y and r in a period."""
        at = path_model.PATH_STATE
        f, b = np.zeros((path_model.PATH_STATES, len(at))), np.zeros(path_model.PATH_STATES)
        own = path_model.parameters_of(self._model.parameters(), 0)
        path_model.discretise_disturbed(v, self.period, own, f, b)
        return f[np.ix_([at.vy, at.yaw_rate], [at.side, at.turn])]

    # -- the optimisation ---------------------------------------------------------------------------------------------
    def _solve(self, x0: Array, pushes: Array, path: Ahead) -> tuple[Array | None, int, float]:
        """The moves (stages,), None where a QP has no solution; iterations, and the last change of a move (rad)."""
        n, sums = self.stages, self._sums
        p = np.vstack([path.speed, path.curvature, np.full(n, pushes[0]), np.full(n, pushes[1])])
        moves = np.clip(np.append(self._moves[1:], 0.0), *self.limits.move)
        x = self._guess(x0, moves, p)
        q_e, q_course, R = self.tuning.values()
        low, high = self.limits.angle
        for iteration in range(self.iterations):
            u = self._angle + sums @ moves
            after, jx, ju = (np.asarray(each) for each in self._stages(x[:, :n], u, p))
            response, gap = self._condensed(after - x[:, 1:], jx, ju)
            rows = np.concatenate([response[:, 3], response[:, 2] + response[:, 0] / path.speed[:, None]])
            free = x[:, 1:] + gap
            misses = np.concatenate([free[3] - path.reference, free[2] + free[0] / path.speed])
            weights = np.repeat([q_e, q_course], n)
            hessian = 2.0 * (rows.T @ (weights[:, None] * rows) + R * np.eye(n))
            gradient = 2.0 * (rows.T @ (weights * misses) + R * moves)
            found = self._qp(
                h=hessian, g=gradient, a=sums, lba=low - u, uba=high - u,
                lbx=self.limits.move[0] - moves, ubx=self.limits.move[1] - moves,
            )  # fmt: skip
            step = np.asarray(found["x"]).reshape(-1)
            if not self._qp.stats()["success"] or not np.isfinite(step).all():
                return None, iteration + 1, math.nan
            moves = moves + step
            x[:, 1:] = free + np.tensordot(response, step, axes=(2, 0)).T
            change = float(np.abs(step).max())
            if change < CONVERGED:
                break
        return moves, iteration + 1, change

    def _guess(self, x0: Array, moves: Array, p: Array) -> Array:
        """States (n, stages + 1) of the shifted plan, driven from x0."""
        u = self._angle + np.cumsum(moves)
        after = np.asarray(self._all_steps(x0, u, p, np.full(self.stages, self.period)))
        return np.column_stack([x0, after])

    def _condensed(self, gaps: Array, jx: Array, ju: Array) -> tuple[Array, Array]:
        """What the states at the stages' ends answer to the moves (stages, n, moves), and to the gaps (n, stages)."""
        n, size = self.stages, self._n
        response, from_gaps = np.zeros((n, size, n)), np.zeros((size, n))
        matrix, shift = np.zeros((size, n)), np.zeros(size)
        for i in range(n):
            a = jx[:, size * i : size * (i + 1)]
            matrix, shift = a @ matrix, a @ shift + gaps[:, i]
            matrix[:, : i + 1] += ju[:, i : i + 1]
            response[i], from_gaps[:, i] = matrix, shift
        return response, from_gaps

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "law": "nmpc", "tuning": dict(self.tuning), "period": self.period, "horizon": self.horizon,
            "iterations": self.iterations, "estimating": self.estimating, "preview": self.preview,
            "limits": {"move": list(self.limits.move), "angle": list(self.limits.angle)}, **self.car.describe(),
        }  # fmt: skip


def as_measured(vehicle: Vehicle, *, profile: str | Profile | None = None, **options: Any) -> NMPC:
    """`NMPC` that takes its state as it is measured; options: its other arguments."""
    return NMPC(vehicle, profile=profile, estimating=False, **options)


def _runge_kutta(slope: Any, x: Any, u: Any, p: Any, h: Any) -> Any:
    """The classical fourth-order step."""
    k1 = slope(x, u, p)
    k2 = slope(x + 0.5 * h * k1, u, p)
    k3 = slope(x + 0.5 * h * k2, u, p)
    k4 = slope(x + h * k3, u, p)
    return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _in_path(yaw: float, y: float, driven: float, there: Any) -> tuple[float, float]:
    """Heading (rad) and offset (m) against the path, from those against its tangent `driven` (m) before.

    there: the road at the foot of the tangent and so much further.
    """
    x0, y0, heading = float(there.x[0]), float(there.y[0]), float(there.heading[0])
    cos, sin, turned = math.cos(heading), math.sin(heading), float(there.heading[1]) - heading
    dx, dy = float(there.x[1]) - x0, float(there.y[1]) - y0
    ahead, aside = dx * cos + dy * sin, dy * cos - dx * sin
    return yaw - turned, (y - aside) * math.cos(turned) - (driven - ahead) * math.sin(turned)


register_controller("nmpc", NMPC, words="NMPC on the tyre's curve, with our estimator")
register_controller("nmpc-as-measured", as_measured, words="the same without an estimator")
