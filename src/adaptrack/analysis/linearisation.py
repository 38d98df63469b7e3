"""Linear models of car and controller over one control period, for small deviations from steady driving.

- The car (`sampled`, `Mismatch`): plant, steering and dead time, linearised about straight driving or a steady turn.
- The controller (`laws`): its estimator for small innovations, and the feedback of its MPC without active constraints.

`stability` connects both to the closed loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Finite, Hint, Positive, checked, real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.cars.vehicle import SteeringActuator
from adaptrack.control.controllers import MPC
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel, PredictionModel, laguerre_basis
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.models import contract
from adaptrack.scenario.profile import Profile, load_profile

SENSED_STATES = ("vy", "psi", "yaw_rate", "Y")
"""States of the plant that sensors measure."""
POSE_SENSORS = ("yaw", "y")
"""Signals of the sensors that have the age of the pose; all others have the age of the motion."""

_FIXED = ("X", "vx", "felt_ax")  # X has no influence; speed and longitudinal load transfer stay constant
_STEP = 1e-6  # step of central differences
_SMOOTH = 1e-3  # largest change of a difference with the step size / largest entry of A
_ROUNDING = 1e-15  # largest rounding error of an entry / largest entry of A
_SETTLED = 1e-12  # largest relative change of an estimator's memory in steady state
_MAX_SETTLING_STEPS = 20_000  # largest number of steps until the steady state
_SETTLING_INTERVAL = 20  # steps between two checks for the steady state
_DITHER = 1e-30  # amplitude of the measurements meanwhile; estimators may ignore a sensor with constant values as stuck
_DITHER_DERIVATIVE = 1e-12  # largest derivative that is only an effect of the dither
_TURN_DURATION = 8.0  # s, until the gains of an estimator are those of a steady turn
_TURN_DITHER = 1e-9  # amplitude of the measurements in a turn, where they are not zero


# -- the plant --------------------------------------------------------------------------------------------------------
class Steady(NamedTuple):
    """Steady motion of a plant: straight driving or a turn, with or without braking."""

    speed: float
    """Speed (m/s)."""
    friction: float
    """Friction coefficient."""
    deceleration: float
    """Deceleration (m/s^2) of a moment of braking."""
    state: Array
    """State of the plant, (n,)."""
    steering: float
    """Front-wheel angle (rad)."""

    def measured(self, plant: Plant, period: float) -> Array:
        """Return the signals of `sensed` and how far the path has turned (rad), (9,); period in s."""
        states = dict(zip(plant.state_names, self.state.tolist(), strict=True))
        yaw_rate = states["yaw_rate"]
        signals = {
            "vy": states["vy"], "yaw": states["psi"], "yaw_rate": yaw_rate, "wheel_angle": self.steering,
            "lateral_acceleration": yaw_rate * self.speed, "turned": yaw_rate * period,
        }  # fmt: skip
        return np.array([signals.get(name, 0.0) for name in (*sensed(), "turned")])


def steady_turn(
    plant: Plant, speed: float, lateral_acceleration: float, friction: float = 0.9, deceleration: float = 0.0
) -> Steady:
    """Return the steady motion of a turn to the left without wind.

    The velocity points along X. Newton's method finds a state in which the derivatives of all states except X, Y, yaw
    and v_x vanish. The lateral acceleration rises from zero in steps of at most 1 m/s^2. speed: m/s;
    lateral_acceleration: m/s^2, speed times yaw rate; deceleration: m/s^2, of a moment of braking, with its
    longitudinal tyre forces and load transfer, at constant speed. Raises InvalidInput when the plant cannot drive the
    turn, for instance on too low a friction, or has no right-hand side.
    """
    if isinstance(plant, SteppedPlant):
        raise InvalidInput(f"Plant {plant.name!r}: is stepped and has no right-hand side that could be linearised.")
    acceleration = real("steady_turn", "lateral_acceleration", lateral_acceleration)
    names = list(plant.state_names)
    free = [i for i, name in enumerate(names) if name not in (*_FIXED, "Y", "psi")]
    yaw_rate, road = names.index("yaw_rate"), _road(friction)
    x = np.array(plant.initial_state([0.0, 0.0, 0.0, speed, 0.0, 0.0]), dtype=np.float64)
    force = _braking_force(plant, deceleration)
    if deceleration != 0.0 and "felt_ax" in names:
        x[names.index("felt_ax")] = -deceleration

    def residual(values: Array, target: float) -> Array:
        state = x.copy()
        state[free] = values[:-1]
        slope = plant.derivative(state, [values[-1], force], road)[free]
        return np.append(slope, state[yaw_rate] * speed - target)

    unknown, reached = _continuation(residual, np.append(x[free], 0.0), acceleration)
    if reached < abs(acceleration):
        raise InvalidInput(
            f"Plant {plant.name!r}: no steady turn with more than {reached:.4g} m/s^2 at {speed:g} m/s on friction "
            f"{friction:g}: ask for a smaller lateral acceleration."
        )
    x[free] = unknown[:-1]
    x[names.index("psi")] = -portable.atan2(x[names.index("vy")], x[names.index("vx")])
    return Steady(speed, friction, deceleration, x, float(unknown[-1]))


def _braking_force(plant: Plant, deceleration: float) -> float:
    """Return the longitudinal force at the wheels (N) for a deceleration (m/s^2), without driving resistances."""
    if deceleration == 0.0:
        return 0.0
    if not isinstance(plant, SingleTrack | DualTrack):
        raise InvalidInput(f"Plant {plant.name!r}: its mass is not known, so no braking: analyse the car's twin.")
    return -plant.vehicle.mass * real("steady_turn", "deceleration", deceleration)


def _continuation(
    residual: Callable[[Array, float], Array], unknown: Array, acceleration: float
) -> tuple[Array, float]:
    """Follow a root of residual(x, a) from a = 0 to `acceleration`; return the last root and the |a| that was reached.

    The last entry of x is the steering angle. A step that changes it by more than 0.1 rad is rejected as beyond the
    grip, where slip grows without bound.
    """
    reached, step = 0.0, min(abs(acceleration), 1.0)
    slope = np.zeros_like(unknown)  # change of the unknowns per m/s^2 in the last step
    while reached < abs(acceleration):
        target = min(reached + step, abs(acceleration))
        trial, converged = _newton(residual, unknown + (target - reached) * slope, np.copysign(target, acceleration))
        if converged and abs(trial[-1] - unknown[-1]) < 0.1:
            slope, unknown, reached = (trial - unknown) / (target - reached), trial, target
        elif step > 1e-3:
            step *= 0.5
        else:
            break
    return unknown, reached


def _newton(residual: Callable[[Array, float], Array], x: Array, target: float) -> tuple[Array, bool]:
    """Return a root of residual(x, target) near x, and whether the iteration converged."""
    for _ in range(20):
        error = residual(x, target)
        slopes = np.array([(residual(x + h, target) - error) / _STEP for h in _STEP * np.eye(len(x))])
        if not np.isfinite(slopes).all() or not np.isfinite(error).all():
            return x, False
        try:
            change = portable.solve(slopes.T, error)
        except portable.LinAlgError:  # a state without influence
            normal = portable.pseudo_inverse(portable.product(slopes.T, slopes))
            change = portable.product(slopes, portable.product(normal, error))
        x = x - change
        if not np.abs(change).max() > 1e-10:
            break
    return x, bool(np.abs(residual(x, target)).max() < 1e-6)


def linearised(
    plant: Plant, speed: float, friction: float = 0.9, lateral_acceleration: float = 0.0, deceleration: float = 0.0
) -> tuple[list[str], Array, Array]:
    """Return state names, A (n, n) and B (n,) of the plant about straight driving or a steady turn.

    The states are deviations in axes along the velocity, and the input is the front-wheel angle; the speed is constant.
    States without influence on the measurements are left out. The derivatives are central differences. The arguments
    are those of `steady_turn`. Raises InvalidInput when the plant cannot drive the turn, or its derivatives jump there.
    A jump changes a difference when its step is four times as long.
    """
    return _linearised_at(plant, steady_turn(plant, speed, lateral_acceleration, friction, deceleration))


def _linearised_at(plant: Plant, turn: Steady) -> tuple[list[str], Array, Array]:
    x, steering = turn.state, turn.steering
    road, force = _road(turn.friction), _braking_force(plant, turn.deceleration)
    keep = [i for i, name in enumerate(plant.state_names) if name not in _FIXED]

    def slope(state: Array, angle: float) -> Array:
        return plant.derivative(state, [angle, force], road)[keep]

    def matrix(step: float) -> Array:
        moved = step * np.eye(len(x))[keep]
        return np.array([(slope(x + h, steering) - slope(x - h, steering)) / (2 * step) for h in moved]).T

    a = matrix(_STEP)
    jumps = np.abs(a - matrix(4 * _STEP)).max(axis=0) > _SMOOTH * np.abs(a).max()
    if jumps.any():
        raise InvalidInput(
            f"Plant {plant.name!r}: its derivatives jump with {plant.state_names[keep[int(np.argmax(jumps))]]}: it has "
            "no linear model there. Use a smoother plant of the same car (single-track), or test it in simulated "
            "drives."
        )
    b = (slope(x, steering + _STEP) - slope(x, steering - _STEP)) / (2 * _STEP)
    observed = np.array([plant.state_names[i] in SENSED_STATES for i in keep])
    for _ in keep:
        observed |= (np.abs(a[observed]) > _ROUNDING * np.abs(a).max()).any(axis=0)
    part = np.flatnonzero(observed)
    return [plant.state_names[keep[j]] for j in part], a[np.ix_(part, part)], b[part]


class SampleAges(NamedTuple):
    """Constant ages (s) of measured poses and motions on arrival."""

    pose: float = 0.0
    motion: float = 0.0

    @classmethod
    def of(cls, profile: str | Profile) -> SampleAges:
        """Return the mean ages in a profile."""
        world = load_profile(profile)
        return cls(world.pose_age, world.motion_age)

    def sensor_age(self, name: str) -> float:
        """Return the age (s) of a signal of `sensed`."""
        return self.pose if name in POSE_SENSORS else self.motion


PROMPT_SAMPLES = SampleAges()


class Sampled(NamedTuple):
    """Plant with its steering over one control period: z(k+1) = A z(k) + b u(k), with measurements C z(k).

    z consists of the states of the plant, the front-wheel angle if the steering has a lag, the commands that have not
    yet acted, and the earlier values of signals that are measured late.
    """

    a: Array
    """Matrix A, (m, m)."""
    b: Array
    """Column b of the steering command, (m,)."""
    c: Array
    """Matrix C, (sensors, m), with the rows of `sensed`; the row of the wheel angle is zero without a steering lag."""


def sampled(
    plant: Plant, period: float, speed: float, *, friction: float = 0.9, profile: str | Profile = "paper",
    lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> Sampled:  # fmt: skip
    """Return the linearised plant with its steering, exactly discretised with a zero-order hold of the commands.

    The rate limit of the steering has no effect on small deviations. plant, speed, friction, lateral_acceleration: as
    for `steady_turn`; period: s; profile: steering and dead time of the car, and mean ages of its samples; delay: s,
    dead time in addition to that of the profile, also fractions of a period. Raises InvalidInput when a command would
    act before its instant, and as for `steady_turn`.
    """
    turn = steady_turn(plant, speed, lateral_acceleration, friction)
    return sampled_about(plant, period, turn, load_profile(profile), delay)


def sampled_about(plant: Plant, period: float, turn: Steady, world: Profile, delay: float = 0.0) -> Sampled:
    """Return the result of `sampled` about a steady motion."""
    steering = _steering(plant, world)
    late = world.delay + (steering.dead_time + real("sampled", "delay", delay)) / period
    if not -1e-9 < late < np.inf:
        raise InvalidInput(f"delay = {delay!r} s: a command would act {-late:g} periods before it is given.")
    lag = steering.lag
    names, a, b = _linearised_at(plant, turn)
    flow = _with_lag(a, b, lag)
    step = _hold_flow(flow, period, max(late, 0.0))
    size = len(step)
    outputs = np.zeros((len(sensed()), size))
    outputs[range(len(SENSED_STATES)), [names.index(name) for name in SENSED_STATES]] = 1.0
    if lag > 0.0:
        outputs[sensed().index("wheel_angle"), len(b)] = 1.0
    felt = outputs[sensed().index("lateral_acceleration")]
    felt[: len(flow) - 1] = flow[names.index("vy"), :-1]
    felt[names.index("yaw_rate")] += turn.speed
    if lag == 0.0 and size >= len(flow):
        felt[size - 1] += flow[names.index("vy"), -1]  # the command that acts
    return _with_late_outputs(Sampled(step[:, :size], step[:, size], outputs), SampleAges.of(world), period)


def _with_late_outputs(prompt: Sampled, ages: SampleAges, period: float) -> Sampled:
    """Return the plant with its measurements delayed, linear between two control instants as in simulations."""
    periods = {i: ages.sensor_age(name) / period for i, name in enumerate(sensed()) if prompt.c[i].any()}
    size = len(prompt.b)
    total = size + sum(math.ceil(late) for late in periods.values())
    a, b, c = np.zeros((total, total)), np.zeros(total), np.zeros((len(prompt.c), total))
    a[:size, :size], b[:size], c[:, :size] = prompt.a, prompt.b, prompt.c
    for i, late in periods.items():
        count, first = math.ceil(late), math.floor(late)
        rows = np.vstack([c[i], np.eye(total)[size : size + count]])  # the signal now, one period ago, ...
        a[size : size + count] = rows[:count]
        c[i] = rows[first] + (late - first) * (rows[min(first + 1, count)] - rows[first])
        size += count
    return Sampled(a, b, c)


def _steering(plant: Plant, world: Profile) -> SteeringActuator:
    """Return the steering actuator of the plant if it has one, otherwise that of the profile."""
    return getattr(plant, "steering", None) or world.steering


@checked
@dataclass(frozen=True)
class Mismatch:
    """Difference between the true car and the controller's model of it."""

    lag: Annotated[Finite, "s"] = 0.0
    """True steering lag minus assumed one (s). The true lag is at least zero."""
    dead_time: Annotated[Finite, "s"] = 0.0
    """True dead time minus assumed one (s). The true dead time is at least zero."""
    stiffness: Annotated[Positive, Hint("it is a factor")] = 1.0
    """True cornering stiffness of the tyres / assumed one."""
    mass: Annotated[Positive, Hint("it is a factor")] = 1.0
    """True mass and yaw inertia / assumed ones."""

    @property
    def name(self) -> str:
        """The mismatch in words, as in tables."""
        sums = (("lag", self.lag), ("dead time", self.dead_time))
        factors = (("stiffness", self.stiffness), ("mass", self.mass))
        words = [f"{quantity} {value:+.3g} s" for quantity, value in sums if value != 0.0]
        return ", ".join(words + [f"{quantity} x {value:.3g}" for quantity, value in factors if value != 1.0]) or "none"

    def sampled(
        self, plant: Plant, period: float, speed: float, *, friction: float = 0.9, profile: str | Profile = "paper"
    ) -> Sampled:
        """Return the result of `sampled` for the true car in straight driving.

        `plant` and `profile` are those of the controller's model. Errors as `true_car`.
        """
        world = load_profile(profile)
        believed = _steering(plant, world)
        delay = max(self.dead_time, -world.delay * period - believed.dead_time)
        return sampled(self.true_car(plant, world), period, speed, friction=friction, profile=world, delay=delay)

    def true_car(self, plant: Plant, profile: str | Profile = "paper") -> Plant:
        """Return the true car with its true steering lag; the caller adds the dead time.

        Raises InvalidInput when stiffness or mass differ and the plant is neither `SingleTrack` nor `DualTrack`.
        """
        world = load_profile(profile)
        believed = _steering(plant, world)
        lag = max(believed.lag + self.lag, 0.0)
        steering = believed.replace(lag=lag, rate=believed.rate if lag > 0.0 else np.inf)
        if (self.stiffness, self.mass) == (1.0, 1.0):
            return plant.with_steering(steering)
        if not isinstance(plant, SingleTrack | DualTrack):
            raise InvalidInput(
                f"Mismatch {self.name}: plant {plant.name!r} has no built-in vehicle and tyre to change; analyse a "
                "second plant with different parameters and the same MPC."
            )
        car, tyre = plant.vehicle, plant.tyre
        heavier = car.replace(mass=self.mass * car.mass, yaw_inertia=self.mass * car.yaw_inertia)
        stiffness = {name: self.stiffness * getattr(tyre, name) for name in ("stiffness_front", "stiffness_rear")}
        return type(plant)(heavier, tyre.replace(**stiffness), steering, plant.steps)


def usual_mismatches(period: float) -> tuple[Mismatch, ...]:
    """Return mismatches of one parameter each.

    They are +-0.1 s of lag, +-1 control period (s) of dead time, 1.6 times and 1/1.6 times the stiffness, and +-30 %
    of the mass.
    """
    return (
        Mismatch(lag=0.1), Mismatch(lag=-0.1), Mismatch(dead_time=period), Mismatch(dead_time=-period),
        Mismatch(stiffness=1.6), Mismatch(stiffness=1.0 / 1.6), Mismatch(mass=1.3), Mismatch(mass=0.7),
    )  # fmt: skip


def _with_lag(a: Array, b: Array, lag: float) -> Array:
    """Return the continuous-time matrix of the states, the wheel angle if the lag (s) is not zero, and the command."""
    n = len(b) + (lag > 0.0)
    flow = np.zeros((n + 1, n + 1))
    flow[: len(b), : len(b)], flow[: len(b), len(b)] = a, b
    if lag > 0.0:
        flow[n - 1, n - 1], flow[n - 1, n] = -1.0 / lag, 1.0 / lag
    return flow


def _hold_flow(flow: Array, period: float, delay: float) -> Array:
    """Return [A b], (m, m + 1), over one period (s), with commands that act after `delay` periods.

    Columns and rows of delayed commands follow those of the states; the last column is that of the new command.
    """
    n = len(flow) - 1
    periods, part = divmod(delay, 1.0)
    pending = int(periods) + (part > 0.0)
    early, late = (portable.exponential_of(flow * (share * period)) for share in (part, 1.0 - part))
    size = n + pending
    step = np.zeros((size, size + 1))
    step[:n, :n] = product(late[:n, :n], early[:n, :n])
    columns = [size, *range(n, size)]  # of the new command, of the last one, ...
    step[:n, columns[int(periods)]] = late[:n, n]
    if part > 0.0:
        step[:n, columns[int(periods) + 1]] = product(late[:n, :n], early[:n, n])
    step[columns[1:], columns[:-1]] = 1.0
    return step


def sensed() -> tuple[str, ...]:
    """Return the names of the sensor signals, see `core.models.contract.MEASUREMENT`."""
    return contract.MEASUREMENT._fields[: contract.MEASUREMENT.turned]  # the path and the speed control give the rest


def _road(friction: float) -> Array:
    return np.array([friction] * 4 + [0.0, 0.0, 0.0])


Turn = Callable[[float, float], float]
"""Function that returns the lateral acceleration (m/s^2) of a turn for a speed (m/s) and a friction."""
LinearPlant = Callable[[float, float], Sampled]
"""Function that returns the linear plant with its steering for a speed (m/s) and a friction."""


def linear_plants(
    plant: Plant, period: float, profile: str | Profile, turn: Turn | None, mismatches: Sequence[Mismatch] = ()
) -> list[LinearPlant]:
    """Return linear plants for straight driving, for the turn unless it is None, and for each mismatch.

    period: control period (s).
    """

    def steady(speed: float, friction: float, acceleration: float = 0.0) -> Sampled:
        return sampled(plant, period, speed, friction=friction, profile=profile, lateral_acceleration=acceleration)

    def with_mismatch(mismatch: Mismatch) -> LinearPlant:
        return lambda speed, friction: mismatch.sampled(plant, period, speed, friction=friction, profile=profile)

    in_turn = [] if turn is None else [lambda speed, friction: steady(speed, friction, turn(speed, friction))]
    return [steady, *in_turn, *map(with_mismatch, mismatches)]


# -- the controller ---------------------------------------------------------------------------------------------------
class LinearEstimator(NamedTuple):
    """Linear estimator of an MPC at one speed, for small deviations.

        u(k) = h s(k) - k xi(k),   xi(k) = C s(k) + D m(k),   s(k+1) = A s(k) + E m(k) + f u(k)

    - s (q,): memory of the estimator;
    - m: measurements in the order of `sensed`;
    - u: command (rad);
    - k: feedback gains of the MPC;
    - xi (n + 1,): input of the feedback, or its sum over all steps if h = 0.
    """

    a: Array
    """Matrix A, (q, q)."""
    e: Array
    """Matrix E, (q, sensors)."""
    f: Array
    """Column f of the command, (q,)."""
    c: Array
    """Matrix C, (n + 1, q)."""
    d: Array
    """Matrix D, (n + 1, sensors)."""
    h: Array
    """Row h of the memory, (q,)."""


def linear_estimator(mpc: MPC, speed: float, ages: SampleAges = PROMPT_SAMPLES) -> LinearEstimator:
    """Return the linear estimator of an MPC at a speed (m/s) with samples of known ages, in steady state.

    A Kalman filter is linear as long as its innovations are small. The matrices are difference quotients of the
    compiled estimator with respect to its inputs and its memory, so user-defined estimators are analysed in the same
    way. Entries of the memory that do not depend on the measurements (gains, covariances) or do not influence the
    command are left out. Raises InvalidInput when the Kalman filter takes in no samples that are so old.
    """
    return EstimatorAt(mpc, speed, ages).straight


class EstimatorAt:
    """The compiled estimator of an MPC at one speed (m/s), as `linear_estimator` analyses it."""

    def __init__(self, mpc: MPC, speed: float, ages: SampleAges = PROMPT_SAMPLES) -> None:
        self.model, self._own, self._ages = mpc.model, mpc.estimator, ages
        _check_ages(mpc, ages)
        self._speed = max(speed, mpc.speed_floor)
        self._is_deadbeat = self._own.function is None
        if self._is_deadbeat:
            return
        self._parameters = self._own.parameters(self.model)
        self._a, self._b, _ = self.model.discrete(self._speed)
        self._memory, self._sensors = self._own.memory_size(self.model), len(sensed())
        self._x, self._d = np.zeros(self.model.n), np.zeros(self.model.n)

    @property
    def _age_places(self) -> slice:
        """Places of both ages in the inputs [memory, measurements, command] of a step."""
        return slice(self._memory + self._sensors - 2, self._memory + self._sensors)

    def _step(self, measured: Array, command: float, memory: Array) -> None:
        self._own.function(
            self._speed, measured, command, self._a, self._b[:, 0], self._parameters, memory, self._x, self._d
        )

    def _answer(self, turned: float, inputs: Array) -> Array:
        """Return [memory, xi] after a step from [memory, measurements, command]; turned: path rotation (rad)."""
        after, command = inputs[: self._memory].copy(), float(inputs[-1])
        self._step(np.append(inputs[self._memory : -1], turned), command, after)
        return np.concatenate(
            [after, product(self._a, self._x) + self._b[:, 0] * command + self._d - self._x, self._x[-1:]]
        )

    @cached_property
    def straight(self) -> LinearEstimator:
        """The linear estimator in straight driving."""
        return _increments(self.model) if self._is_deadbeat else self._straight[0]

    @cached_property
    def _straight(self) -> tuple[LinearEstimator, list[int]]:
        equilibrium = np.zeros(self._memory + self._sensors + 1)
        equilibrium[self._age_places] = self._ages
        remembered = equilibrium[: self._memory]
        swing, back = (np.append(equilibrium[self._memory : -1], 0.0) for _ in range(2))
        swing[: self._sensors - 2], back[: self._sensors - 2] = -_DITHER, _DITHER
        before, change = remembered.copy(), np.full(self._memory, np.inf)
        for k in range(_MAX_SETTLING_STEPS):
            self._step(back if k % 2 else swing, 0.0, remembered)
            if k % _SETTLING_INTERVAL == 0:
                earlier, change = change, remembered - before  # compared, since a counter changes at a constant rate
                limit = _SETTLED * np.nanmax(np.abs(before), initial=0.0)
                if not (np.abs(change - earlier) > limit).any():  # NaN, for a missing measurement, is ignored
                    break
                before = remembered.copy()
        derivatives = _differences(partial(self._answer, 0.0), equilibrium, self._memory, self._age_places)
        moved = np.array([i for i in derivatives if i < self._memory], dtype=np.intp)
        moves = np.array([derivatives[i] for i in moved.tolist()]).reshape(len(moved), self._memory + self.model.n + 1)
        relevant = _relevant_places(moves, moved, self._memory)
        return self._linearise_changes(derivatives, relevant), relevant

    def _linearise_changes(self, derivatives: Mapping[int, Array], relevant: list[int]) -> LinearEstimator:
        memory, n = self._memory, self.model.n
        inputs = [*relevant, *range(memory, memory + self._sensors + 1)]
        rows = np.array([derivatives[i] for i in inputs]).T[[*relevant, *range(memory, memory + n + 1)]]
        return _with_last_command(rows, len(relevant))

    def with_turn_gains(self, measured: Array, command: float) -> LinearEstimator:
        """Return the linear estimator with the gains that it has after some time in a steady turn.

        The gains are treated as constant, since they follow the tyre forces more slowly than the loop moves. measured:
        (9,) signals in the turn, see `Steady.measured`; command: rad, steering command in the turn.
        """
        if self._is_deadbeat:
            return self.straight
        places, memory = self._straight[1], np.zeros(self._memory)
        measured = np.concatenate([measured[: self._sensors - 2], self._ages, measured[-1:]])
        swing = np.zeros_like(measured)
        swing[: self._sensors - 2] = _TURN_DITHER
        for k in range(math.ceil(_TURN_DURATION / self.model.period)):
            self._step(measured + (swing if k % 2 else -swing), command, memory)
        equilibrium = np.concatenate([memory, measured[:-1], [command]])
        settled = self._answer(measured[-1], equilibrium)
        derivatives = {}
        for place in (*places, *range(self._memory, equilibrium.size)):
            inputs = equilibrium.copy()
            inputs[place] += _STEP
            derivatives[place] = (self._answer(measured[-1], inputs) - settled) / _STEP
        for place in range(self._age_places.start, self._age_places.stop):
            derivatives[place] = np.zeros_like(settled)  # the age of samples is constant
        return self._linearise_changes(derivatives, places)


def _check_ages(mpc: MPC, ages: SampleAges) -> None:
    """Refuse samples that the Kalman filter of an MPC leaves out because of their age."""
    if not isinstance(mpc.estimator, KalmanFilter):
        return
    longest, oldest = mpc.estimator.late(mpc.model) * mpc.model.period, max(ages)
    if oldest > longest + 0.5 * mpc.model.period:
        raise InvalidInput(
            f"the samples are {oldest:.3g} s old, and the controller's filter takes in none older than {longest:.3g} "
            f"s: give MPC(..., estimator=KalmanFilter(..., oldest={oldest:.3g})), or an MPC of this profile."
        )


def _increments(model: PredictionModel) -> LinearEstimator:
    """Return the estimator of an MPC that feeds back increments of the measured state and the measured output y.

    The sum of the increments is the state; the memory s is the sum of y over earlier steps.
    """
    d = np.zeros((model.n + 1, len(sensed())))
    d[range(model.n), model.measured_places()] = 1.0
    d[model.n] = d[model.n - 1]
    return LinearEstimator(
        np.ones((1, 1)), d[-1:].copy(), np.zeros(1), np.eye(model.n + 1)[:, -1:].copy(), d, np.zeros(1)
    )


def _differences(step: Callable[[Array], Array], equilibrium: Array, memory: int, constant: slice) -> dict[int, Array]:
    """Return the derivatives of a step by index in `equilibrium`.

    The indices are those of all inputs, and of the memory entries that depend on them. `memory` is the memory size;
    the inputs at `constant` do not change.
    """
    settled, waiting = step(equilibrium), [*range(memory, constant.start), *range(constant.stop, len(equilibrium))]
    derivatives = {i: np.zeros_like(settled) for i in range(constant.start, constant.stop)}
    while waiting:
        place = waiting.pop()
        inputs = equilibrium.copy()
        inputs[place] += _STEP
        change = (step(inputs) - settled) / _STEP
        derivatives[place] = np.where(np.abs(change) > _DITHER_DERIVATIVE, change, 0.0)
        moved = np.flatnonzero(derivatives[place][:memory]).tolist()
        waiting += [i for i in moved if i not in derivatives and i not in waiting]
    return derivatives


def _relevant_places(moves: Array, places: NDArray[np.intp], memory: int) -> list[int]:
    """Return the memory indices that influence xi now or later; row i of moves: derivatives by places[i]."""
    is_relevant = moves[:, memory:].any(axis=1)
    for _ in places:
        is_relevant |= moves[:, places[is_relevant]].any(axis=1)
    return places[is_relevant].tolist()


def _with_last_command(rows: Array, size: int) -> LinearEstimator:
    """Return the estimator from rows that map [s, m, last command] to [next s, xi]; the last command joins s."""
    q, sensors = size + 1, len(sensed())
    last = np.eye(q)[-1]
    a, e = np.zeros((q, q)), np.zeros((q, sensors))
    a[:size, :size], a[:size, size] = rows[:size, :size], rows[:size, -1]
    e[:size] = rows[:size, size:-1]
    c = np.column_stack([rows[size:, :size], rows[size:, -1]])
    return LinearEstimator(a, e, last, c, rows[size:, size:-1], last)


@dataclass(frozen=True, eq=False)
class LinearControllers:
    """The linear controllers of n tunings at one speed."""

    estimator: LinearEstimator
    k: Array
    """Feedback gains of each tuning, (n, states + 1), with du = -k xi."""


def laws(
    mpc: MPC, speed: float, tunings: ArrayLike, estimator: LinearEstimator | None = None, rear_slope: float = 1.0
) -> LinearControllers:
    """Return the linear controllers of an MPC with n tunings at one speed (m/s).

    The tunings are Np, Nc, Q and R, (n, 4), with whole horizons and 1 <= Nc <= Np. A controller that learns is analysed
    in its initial state: with its initial belief, and R times its initial caution factor. estimator: None for
    `linear_estimator` at this speed; rear_slope: of the rear tyres in the prediction, see `informed.rear_slope`
    """
    caution = mpc.first_caution
    rows = np.atleast_2d(np.asarray(tunings, dtype=np.float64))
    horizons, group = np.unique(rows[:, :2].astype(np.int64), axis=0, return_inverse=True)
    longest = int(horizons[:, 0].max())
    estimator = linear_estimator(mpc, speed) if estimator is None else estimator
    of_next = mpc.estimator.function is not None
    model = mpc.model.with_rear_slope(rear_slope) if isinstance(mpc.model, PathModel) else mpc.model
    free, step = model.responses(max(speed, mpc.speed_floor), longest, of_next)
    below = np.subtract.outer(np.arange(longest), np.arange(longest))
    phi = np.where(below >= 0, step[below], 0.0)
    gains = np.empty((len(rows), mpc.model.n + 1))
    for i, (Np, Nc) in enumerate(horizons.tolist()):
        members = np.flatnonzero(group.ravel() == i)
        basis = np.eye(Np, Nc)
        if mpc.moves.kind == "laguerre":
            basis = laguerre_basis(Np, mpc.moves.terms, mpc.moves.pole)
        effect = product(phi[:Np, :Np], basis)
        Q, R = rows[members, 2, None, None], caution * rows[members, 3, None, None]
        matrix = Q * product(effect.T, effect) + R * np.eye(effect.shape[1])
        moves = portable.solve(matrix, Q * product(effect.T, free[:, :Np].T))
        gains[members] = product(basis[0], moves)
    return LinearControllers(estimator, gains)
