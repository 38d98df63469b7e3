"""Joint MPC of steering and acceleration by the paper's authors, and their plant: `--plugin lpv_mpc`.

    --plugin lpv_mpc --controller lpv-mpc               steers; the driver controls the speed, below 25 m/s
    LPVMPC(car).inputs(state, speeds, curvatures)       steering angle and acceleration

Y. Kebbati, N. Ait-Oufroukh, V. Puig, D. Ichalal, V. Vigneron, arXiv 2509.19523; constants from their repository
GA-optimized-MLP-based-LPV_MPC (MIT licence). The state is x = [v_x, v_y, r, e, psi] with offset e and heading error psi
of the path, the input u = [delta, a]. The model is linear in x and u; its matrices depend on the state and input that
the last plan predicts for a stage (quasi-LPV):

    dv_x/dt = -(mu g/v_x + rho C_d A v_x/(2 m)) v_x + C_f s (v_y + l_f r)/(m v_x) + v_y r - C_f s delta/m + a
    dv_y/dt = -(C_r + C_f c) v_y/(m v_x) - ((l_f C_f c - l_r C_r)/(m v_x) + v_x) r + C_f c delta/m
    dr/dt   = -(l_f C_f c - l_r C_r) v_y/(I v_x) - (l_f^2 C_f c + l_r^2 C_r) r/(I v_x) + l_f C_f c delta/I
    de/dt   = v_x sin psi + v_y cos psi
    dpsi/dt = r - kappa (v_x cos psi - v_y sin psi)/(1 - e kappa),      s, c = sin, cos of delta

discretised by Euler steps, C_f and C_r being stiffnesses of axles. The QP minimises

    sum (x - x_ref)' Q (x - x_ref) + sum (move of u)' R (move of u),    x_ref = [planned speed, 0, 0, 0, 0]

within bounds on states and inputs. In their program the curvatures of the stages are those of the first nine samples of
the road, wherever the car is. `corrected=True` takes those ahead of the car. The model has neither lag nor dead time of
the steering: with those of the profile `road` the car leaves the road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Positive, checked, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle, VehicleArgument
from adaptrack.control.controllers.base import Array, Command, Controller
from adaptrack.control.controllers.inputs import finite, number, road_ahead, vector
from adaptrack.control.controllers.limits import Limits
from adaptrack.control.controllers.registry import register_controller
from adaptrack.control.qp import QP, get_qp_solver
from adaptrack.core.public import GRAVITY
from adaptrack.road.road_ahead import RoadAhead

PERIOD, HORIZON = 0.033, 9
"""s and control periods, as published."""
AXLE_STIFFNESS = 19000.0, 33000.0
"""N/rad, of their plant's front and rear axle."""
NETWORK_STIFFNESS = 61755.0, 67874.0
"""N/rad, mean output of the network that their controller uses: 3.3 and 2.1 times too stiff for their plant."""
STATE_LOW, STATE_HIGH = np.array([0.1, -3.0, -2.5, -0.25, -4.0]), np.array([25.0, 3.0, 2.5, 0.25, 5.0])
"""m/s, m/s, rad/s, m, rad."""
INPUT_LOW, INPUT_HIGH = np.array([-0.67, -2.0]), np.array([0.67, 5.0])
"""rad, m/s^2."""
STATE_WEIGHTS, MOVE_WEIGHTS = (0.1, 0.001, 0.0011208, 0.445332, 0.05), (0.0054029, 0.00200117)
"""Found by their genetic algorithm; the weights of the cost are these over the upper bounds."""
ROLLING, DRAG_AREA, AIR_DENSITY = 0.05, 0.464, 1.225
"""-, m^2, kg/m^3: resistance in their model."""
MIN_MODEL_SPEED, MAX_CURVATURE = 1.0, 0.2
"""m/s, 1/m: the model is singular at standstill and at the centre of a bend."""
PLANT_DRAG, SIDE_AREA = 0.05, 1.5
"""1/s, m^2: deceleration over speed, and area of the wind load in their plant."""
STATES, INPUTS, MAX_HORIZON = 5, 2, 60


class PathState(NamedTuple):
    """State of a car relative to its path."""

    vx: float
    vy: float
    yaw_rate: float
    offset: float
    """m, positive to the left of the path"""
    heading_error: float


@dataclass(frozen=True)
class AuthorsCar:
    """Plant of the authors in path coordinates: a single track with wheel slip and linear tyres.

    The acceleration is an input of the car; drive and brakes have no lag.
    """

    mass: float = 1575.0
    yaw_inertia: float = 2875.0
    lf: float = 1.2
    lr: float = 1.6
    stiffness: tuple[float, float] = AXLE_STIFFNESS
    """N/rad, of the front and rear axle"""

    @classmethod
    def of(cls, vehicle: Vehicle) -> Self:
        """Return a plant with mass, inertia, axle distances and tyre stiffness of a data sheet."""
        stiffness = 2.0 * vehicle.stiffness_front, 2.0 * vehicle.stiffness_rear
        return cls(vehicle.mass, vehicle.yaw_inertia, vehicle.lf, vehicle.lr, stiffness)

    def slopes(self, state: Array, inputs: Array, curvature: float, wind: float) -> Array:
        """Time derivative of a `PathState` (5,).

        inputs: (2,) rad, m/s^2; curvature: 1/m; wind: m/s, lateral, positive to the left.
        """
        vx, vy, r, e, psi = state
        angle, acceleration = inputs
        front = self.stiffness[0] * (angle - math.atan((vy + self.lf * r) / vx))
        rear = -self.stiffness[1] * math.atan((vy - self.lr * r) / vx)
        push = 0.5 * AIR_DENSITY * SIDE_AREA * wind * abs(wind)
        along = (vx * math.cos(psi) - vy * math.sin(psi)) / (1.0 - e * curvature)
        moment = self.lf * front * math.cos(angle) - self.lr * rear + push * (self.lf - self.lr)
        return np.array(
            [
                acceleration - PLANT_DRAG * vx - front * math.sin(angle) / self.mass + r * vy,
                (front * math.cos(angle) + rear + push) / self.mass - r * vx,
                moment / self.yaw_inertia,
                vx * math.sin(psi) + vy * math.cos(psi),
                r - curvature * along,
            ]
        )

    def after(self, state: Array, inputs: Array, curvature: float, wind: float, duration: float) -> Array:
        """Return the state after a time (s) with constant inputs, curvature and wind, by Runge-Kutta steps."""
        steps = math.ceil(duration / 0.011)
        h = duration / steps
        for _ in range(steps):
            k1 = self.slopes(state, inputs, curvature, wind)
            k2 = self.slopes(state + 0.5 * h * k1, inputs, curvature, wind)
            k3 = self.slopes(state + 0.5 * h * k2, inputs, curvature, wind)
            k4 = self.slopes(state + h * k3, inputs, curvature, wind)
            state = state + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return state

    def lateral_acceleration(self, state: Array, inputs: Array, wind: float) -> float:
        """Return what an accelerometer measures sideways (m/s^2): tyre and wind forces over the mass."""
        return float(self.slopes(state, inputs, 0.0, wind)[1] + state[2] * state[0])


class LPVMPC(Controller):
    """Joint quasi-LPV MPC of steering and acceleration, see the module.

    Parameters
    ----------
    vehicle
        Car whose mass, inertia, axle distances and tyre stiffness the model has.
    stiffness
        N/rad, of the front and rear axle in the model; by default those of the car.
    corrected
        Whether the stages have the curvature ahead of the car, not that of the first samples as published.
    state_weights, move_weights
        Weights of speed, lateral speed, yaw rate, offset and heading error, and of the moves of angle and acceleration.
    horizon
        Control periods.
    period
        Control period (s). The Euler steps of the model need a short one.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """

    period: float
    diagnostic_names = ("acceleration", "held")

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        stiffness: tuple[float, float] | None = None,
        corrected: bool = False,
        state_weights: tuple[float, float, float, float, float] = STATE_WEIGHTS,
        move_weights: tuple[float, float] = MOVE_WEIGHTS,
        horizon: int = HORIZON,
        period: Annotated[Positive, "s"] = PERIOD,
    ) -> None:
        self.period = period
        self.horizon = whole_number("LPVMPC", "horizon", horizon)
        car = AuthorsCar.of(vehicle)
        self.car = car if stiffness is None else replace(car, stiffness=stiffness)
        if not (min(*self.car.stiffness, *move_weights) > 0.0 and min(state_weights) >= 0.0):
            raise InvalidInput("LPVMPC: stiffness and move weights must be positive, state weights not negative.")
        if not (np.isfinite([*self.car.stiffness, *state_weights, *move_weights]).all() and horizon <= MAX_HORIZON):
            raise InvalidInput(f"LPVMPC: stiffness and weights must be finite, horizon at most {MAX_HORIZON}.")
        self.vehicle, self.corrected = vehicle, corrected
        self.limits = Limits(angle=(INPUT_LOW[0], INPUT_HIGH[0]), move=(2.0 * INPUT_LOW[0], 2.0 * INPUT_HIGH[0]))
        self._state_cost = np.array(state_weights) / STATE_HIGH
        self._move_cost = np.tile(np.array(move_weights) / INPUT_HIGH, self.horizon)
        count = INPUTS * self.horizon
        self._differences = np.eye(count) - np.eye(count, k=-INPUTS)
        self._input_rows = np.vstack([np.eye(count), -np.eye(count)])
        self._input_bounds = np.concatenate([np.tile(INPUT_HIGH, self.horizon), -np.tile(INPUT_LOW, self.horizon)])
        self._solver = get_qp_solver("active-set")
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next step is the first, from steering angle 0."""
        self._last = np.zeros(INPUTS)
        self._planned_states: Array | None = None
        self._planned_inputs = np.zeros((self.horizon, INPUTS))
        self._first_curvatures: Array | None = None

    def applied(self, angle: float) -> None:
        """Set the angle (rad) that was sent in place of the last command."""
        self._last[0] = finite("applied: angle", angle)

    # -- the joint controller ------------------------------------------------------------------------------------------
    def inputs(self, state: ArrayLike, speeds: ArrayLike, curvatures: ArrayLike) -> tuple[Array, bool]:
        """Return steering angle (rad) and acceleration (m/s^2), (2,), and whether the last inputs are held.

        Without a plan within the bounds of the states these bounds are dropped.

        Parameters
        ----------
        state : (5,)
            `PathState`.
        speeds, curvatures : (horizon,)
            Planned speeds (m/s) and curvatures of the path (1/m) at this instant and the next ones.
        """
        x = np.array(state, dtype=np.float64)
        speed_plan, bends = np.array(speeds, dtype=np.float64), np.array(curvatures, dtype=np.float64)
        if self._first_curvatures is None:
            self._first_curvatures, bends = bends.copy(), np.zeros(self.horizon)
        elif not self.corrected:
            bends = self._first_curvatures
        if self._planned_states is None:
            zeros = np.zeros((self.horizon, STATES - 1))
            self._planned_states = np.column_stack([speed_plan, zeros])
        models = [self._model(*stage) for stage in zip(self._planned_states, self._planned_inputs, bends, strict=True)]
        moves = self._solve(x, speed_plan, models)
        if moves is None:
            return self._last.copy(), True
        self._planned_inputs = moves
        predicted = []
        for (a, b), stage_input in zip(models, moves, strict=True):
            x = a @ x + b @ stage_input
            predicted.append(x)
        self._planned_states, self._last = np.array(predicted), moves[0].copy()
        return self._last.copy(), False

    def _model(self, state: Array, inputs: Array, curvature: float) -> tuple[Array, Array]:
        """A (5, 5) and B (5, 2) of one control period."""
        car, vx, (vy, e, psi) = self.car, max(float(state[0]), MIN_MODEL_SPEED), state[[1, 3, 4]]
        (front, rear), sine, cosine = car.stiffness, math.sin(inputs[0]), math.cos(inputs[0])
        turn, total = car.lf * front * cosine - car.lr * rear, front * cosine + rear
        damping = car.lf**2 * front * cosine + car.lr**2 * rear
        bend = curvature / (1.0 - e * curvature)
        resistance = ROLLING * GRAVITY / vx + 0.5 * AIR_DENSITY * DRAG_AREA * vx / car.mass
        side = front * sine / (car.mass * vx)
        a = np.array(
            [
                [-resistance, side, side * car.lf + vy, 0.0, 0.0],
                [0.0, -total / (car.mass * vx), -turn / (car.mass * vx) - vx, 0.0, 0.0],
                [0.0, -turn / (car.yaw_inertia * vx), -damping / (car.yaw_inertia * vx), 0.0, 0.0],
                [math.sin(psi), math.cos(psi), 0.0, 0.0, 0.0],
                [-bend * math.cos(psi), bend * math.sin(psi), 1.0, 0.0, 0.0],
            ]
        )
        b = np.zeros((STATES, INPUTS))
        b[:3, 0] = -front * sine / car.mass, front * cosine / car.mass, car.lf * front * cosine / car.yaw_inertia
        b[0, 1] = 1.0
        return np.eye(STATES) + self.period * a, self.period * b

    def _solve(self, x: Array, speeds: Array, models: list[tuple[Array, Array]]) -> Array | None:
        """Inputs of the stages (horizon, 2); None without a solution."""
        count = INPUTS * self.horizon
        response, free = np.zeros((STATES, count)), x
        hessian = 2.0 * self._differences.T @ (self._move_cost[:, None] * self._differences)
        gradient = -2.0 * self._differences[:INPUTS].T @ (self._move_cost[:INPUTS] * self._last)
        rows, bounds = [], []
        for stage, (a, b) in enumerate(models):
            if stage > 0:
                miss = free - np.array([speeds[stage], 0.0, 0.0, 0.0, 0.0])
                hessian += 2.0 * response.T @ (self._state_cost[:, None] * response)
                gradient += 2.0 * response.T @ (self._state_cost * miss)
            free, response = a @ free, a @ response
            response[:, INPUTS * stage : INPUTS * (stage + 1)] += b
            rows += [response, -response]
            bounds += [STATE_HIGH - free, free - STATE_LOW]
        for m, gamma in (
            (np.vstack([*rows, self._input_rows]), np.concatenate([*bounds, self._input_bounds])),
            (self._input_rows, self._input_bounds),
        ):
            solution = self._solver.solve(QP(hessian, gradient, m, gamma))
            if solution.usable:
                return solution.x.reshape(self.horizon, INPUTS)
        return None

    # -- the contract of controllers -----------------------------------------------------------------------------------
    def step(
        self, state: ArrayLike, speed: float, reference: ArrayLike, variables: Any = None,
        road: RoadAhead | None = None,
    ) -> Command:  # fmt: skip
        """One control step; arguments as for `MPC.step`. The acceleration is among the diagnostics.

        Raises
        ------
        InvalidInput
            When an argument is not made of numbers or has a wrong shape.
        """
        vy, yaw, yaw_rate, y = vector("state", state, (4,)).tolist()
        measured_speed, ahead = number("speed", speed), vector("reference", reference, most=10_000)
        path, last_angle, is_held = road_ahead(road), float(self._last[0]), True
        if np.isfinite([vy, yaw, yaw_rate, y, measured_speed]).all() and np.isfinite(ahead[: self.horizon + 2]).all():
            speeds, curvatures, heading = self._path(measured_speed, ahead, path)
            x = PathState(measured_speed, vy, yaw_rate, float(np.clip(y - ahead[0], -2.0, 2.0)), yaw - heading)
            if np.abs(x).max() < 100.0:
                _, is_held = self.inputs(x, speeds, curvatures)
        angle = float(self._last[0])
        diagnostics = {"acceleration": float(self._last[1]), "held": float(is_held)}
        return Command(angle, angle - last_angle, is_held, (), diagnostics)

    def _path(self, speed: float, reference: Array, road: RoadAhead | None) -> tuple[Array, Array, float]:
        """Planned speeds (m/s) and curvatures (1/m) of the stages, and the heading (rad) of the path at the car.

        Without a road the path is the lateral reference.
        """
        count = self.horizon
        speeds = np.full(count, speed)
        if road is not None:
            speeds = road.speeds[np.minimum(np.arange(count), road.speeds.size - 1)]
        stride = np.maximum(speeds, MIN_MODEL_SPEED) * self.period
        offsets = reference[np.minimum(np.arange(count + 2), reference.size - 1)]
        headings = np.arcsin(np.clip(np.diff(offsets) / np.append(stride, stride[-1]), -0.9, 0.9))
        curvatures = np.diff(headings) / stride
        if road is not None:
            stations = road.station + np.concatenate([[0.0], np.cumsum(stride[:-1])])
            curvatures = curvatures + np.asarray(road.road.at(stations).curvature)
        return speeds, np.clip(curvatures, -MAX_CURVATURE, MAX_CURVATURE), float(headings[0])

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "law": "lpv-mpc", "period": self.period, "horizon": self.horizon, "corrected": self.corrected,
            "stiffness": list(self.car.stiffness), "state_cost": self._state_cost.tolist(),
            "move_cost": self._move_cost[:INPUTS].tolist(),
        }  # fmt: skip


def published_mpc(vehicle: Vehicle) -> LPVMPC:
    """Return an `LPVMPC` with its published period and preview."""
    return LPVMPC(vehicle)


def corrected_mpc(vehicle: Vehicle) -> LPVMPC:
    """Return an `LPVMPC` with its published period, which sees the curvature ahead of the car."""
    return LPVMPC(vehicle, corrected=True)


register_controller("lpv-mpc", published_mpc, words="joint LPV-MPC, as published")
register_controller("lpv-mpc-corrected", corrected_mpc, words="joint LPV-MPC with the curvature ahead of the car")
