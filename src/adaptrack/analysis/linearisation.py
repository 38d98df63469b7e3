"""The car and the controller for small deviations from steady driving: linear, over one control period.

What the car is (`sampled`: plant, steering, dead time; `Mismatch`) and what the controller believes of it (`laws`: its
estimator, linear for small innovations, and the feedback of its MPC far from all limits) are apart: `stability` closes
the loop of both. The plant is linearised about driving straight, or about a steady turn, at a speed.
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
from adaptrack.control.models import PredictionModel, laguerre_basis
from adaptrack.core.models import contract
from adaptrack.scenario.profile import Profile, load_profile

Array = NDArray[np.float64]

SENSED_STATES = ("vy", "psi", "yaw_rate", "Y")
"""The states of the plant that sensors read."""

_HELD = ("X", "vx", "felt_ax")  # X does not matter; speed and longitudinal load transfer are held
_STEP = 1e-6  # of the central differences
_SMOOTH = 1e-3  # share of the largest entry of A by which a difference over a wider step may differ
_ROUNDING = 1e-15  # share of the largest entry of A below which an entry is a rounding error
_SETTLED, _LONGEST = 1e-12, 20_000  # of an estimator's memory: largest relative change in a step, and steps at most
_SETTLING = 20  # steps between two looks at whether it has
_DITHER = 1e-30  # of what is measured while it settles: a sensor that always reads the same may count as stuck
_NOTHING = 1e-12  # a derivative that is no more than the trace of that
_TURNING = 8.0  # s, of a steady turn, after which the gains of an estimator are those of it
_SWING = 1e-9  # as `_DITHER`, of samples that are not zero


# -- the plant --------------------------------------------------------------------------------------------------------
def steady_turn(
    plant: Plant, speed: float, lateral_acceleration: float, friction: float = 0.9, deceleration: float = 0.0
) -> tuple[Array, float]:
    """State (n,) and front-wheel angle (rad) of a steady turn to the left at `speed` (m/s), without wind.

    lateral_acceleration: m/s^2, speed times yaw rate. The velocity points along X. Newton's method on the derivatives
    of all states but X, Y, yaw and v_x, the acceleration raised from zero in steps of at most 1 m/s^2; speed and
    longitudinal load transfer are held: as in straight driving, or, with a `deceleration` (m/s^2), as they are for a
    moment in braking, the tyres pulling along the road as well.

    Raises
    ------
    InvalidInput
        When the plant has no such turn, for instance because friction is too low for it, or no right-hand side.
    """
    if isinstance(plant, SteppedPlant):
        raise InvalidInput(f"Plant {plant.name!r}: is stepped and has no right-hand side that could be linearised.")
    acceleration = real("steady_turn", "lateral_acceleration", lateral_acceleration)
    names = list(plant.state_names)
    free = [i for i, name in enumerate(names) if name not in (*_HELD, "Y", "psi")]
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

    unknown, reached = _raised(residual, np.append(x[free], 0.0), acceleration)
    if reached < abs(acceleration):
        raise InvalidInput(
            f"Plant {plant.name!r}: no steady turn with more than {reached:.4g} m/s^2 at {speed:g} m/s on friction "
            f"{friction:g}: ask for a smaller lateral acceleration."
        )
    x[free] = unknown[:-1]
    x[names.index("psi")] = -np.arctan2(x[names.index("vy")], x[names.index("vx")])
    return x, float(unknown[-1])


def _braking_force(plant: Plant, deceleration: float) -> float:
    """N, at the wheels, air and rolling left out."""
    if deceleration == 0.0:
        return 0.0
    if not isinstance(plant, SingleTrack | DualTrack):
        raise InvalidInput(f"Plant {plant.name!r}: its mass is not known, so no braking: analyse the car's twin.")
    return -plant.vehicle.mass * real("steady_turn", "deceleration", deceleration)


def _raised(residual: Callable[[Array, float], Array], unknown: Array, acceleration: float) -> tuple[Array, float]:
    """Roots of residual(x, a) followed from a = 0 towards `acceleration`: the last one, and the |a| that was reached.

    The steering angle stands last in x. A step that changes it by more than 0.1 rad is beyond the grip, where slip
    grows without bound.
    """
    reached, step = 0.0, min(abs(acceleration), 1.0)
    ahead = np.zeros_like(unknown)  # change of the unknowns per m/s^2 in the last step
    while reached < abs(acceleration):
        target = min(reached + step, abs(acceleration))
        trial, converged = _newton(residual, unknown + (target - reached) * ahead, np.copysign(target, acceleration))
        if converged and abs(trial[-1] - unknown[-1]) < 0.1:
            ahead, unknown, reached = (trial - unknown) / (target - reached), trial, target
        elif step > 1e-3:
            step *= 0.5
        else:
            break
    return unknown, reached


def _newton(residual: Callable[[Array, float], Array], x: Array, target: float) -> tuple[Array, bool]:
    """A root of residual(x, wanted) near x, and whether one was found."""
    for _ in range(20):
        error = residual(x, target)
        slopes = np.array([(residual(x + h, target) - error) / _STEP for h in _STEP * np.eye(len(x))])
        if not np.isfinite(slopes).all() or not np.isfinite(error).all():
            return x, False
        change = np.linalg.lstsq(slopes.T, error)[0]
        x = x - change
        if not np.abs(change).max() > 1e-10:
            break
    return x, bool(np.abs(residual(x, target)).max() < 1e-6)


def linearised(
    plant: Plant, speed: float, friction: float = 0.9, lateral_acceleration: float = 0.0, deceleration: float = 0.0
) -> tuple[list[str], Array, Array]:
    """State names, A (n, n) and B (n,) of the plant about steady driving at `speed` (m/s) on `friction`.

    About a straight line, or about a `steady_turn` with `lateral_acceleration` (m/s^2), in which tyres are softer; then
    deviations are those from the turn, in axes along its velocity. The input is the front-wheel angle; the speed is
    held. States that do not influence what the controller measures are left out. By central differences.

    Raises
    ------
    InvalidInput
        When there is no such turn, or the derivatives jump there: a difference over four times the step is another.
    """
    return _linearised_at(plant, Steady.of(plant, speed, friction, lateral_acceleration, deceleration))


class Steady(NamedTuple):
    """A steady turn of a plant, or driving straight."""

    speed: float
    """Speed (m/s)."""
    friction: float
    deceleration: float
    """m/s^2, of a moment of braking"""
    state: Array
    steering: float
    """rad, front-wheel angle"""

    @classmethod
    def of(
        cls, plant: Plant, speed: float, friction: float, lateral_acceleration: float, deceleration: float = 0.0
    ) -> Steady:
        """See `steady_turn`."""
        turn = steady_turn(plant, speed, lateral_acceleration, friction, deceleration)
        return cls(speed, friction, deceleration, *turn)

    def measured(self, plant: Plant, period: float) -> Array:
        """(9,) what the sensors give in it, the turn of the path included, see `core.models.contract.MEASUREMENT`."""
        states = dict(zip(plant.state_names, self.state.tolist(), strict=True))
        yaw_rate = states["yaw_rate"]
        signals = {name: states[name] for name in ("vy", "yaw_rate")} | {
            "yaw": states["psi"],
            "wheel_angle": self.steering,
        }
        signals |= {"lateral_acceleration": yaw_rate * self.speed, "turned": yaw_rate * period}
        return np.array([signals.get(name, 0.0) for name in contract.MEASUREMENT._fields])


def _linearised_at(plant: Plant, turn: Steady) -> tuple[list[str], Array, Array]:
    x, steering = turn.state, turn.steering
    road, force = _road(turn.friction), _braking_force(plant, turn.deceleration)
    keep = [i for i, name in enumerate(plant.state_names) if name not in _HELD]

    def slope(state: Array, angle: float) -> Array:
        return plant.derivative(state, [angle, force], road)[keep]

    def matrix(step: float) -> Array:
        moved = step * np.eye(len(x))[keep]
        return np.array([(slope(x + h, steering) - slope(x - h, steering)) / (2 * step) for h in moved]).T

    a = matrix(_STEP)
    _refuse_jumps(plant, a, matrix(4 * _STEP), [plant.state_names[i] for i in keep])
    b = (slope(x, steering + _STEP) - slope(x, steering - _STEP)) / (2 * _STEP)
    observed = np.array([plant.state_names[i] in SENSED_STATES for i in keep])
    for _ in keep:
        observed |= (np.abs(a[observed]) > _ROUNDING * np.abs(a).max()).any(axis=0)
    part = np.flatnonzero(observed)
    return [plant.state_names[keep[j]] for j in part], a[np.ix_(part, part)], b[part]


def _refuse_jumps(plant: Plant, a: Array, wider: Array, names: list[str]) -> None:
    jumps = np.abs(a - wider).max(axis=0) > _SMOOTH * np.abs(a).max()
    if jumps.any():
        raise InvalidInput(
            f"Plant {plant.name!r}: its derivatives jump with {names[int(np.argmax(jumps))]}: it has no linear model "
            "there. Take a smoother plant of the same car (single-track), or judge it by its drives."
        )


class Sampled(NamedTuple):
    """The plant behind its steering over one control period: z(k+1) = A z(k) + b u(k), measured: C z(k)."""

    a: Array
    """(m, m); z: the plant's states, the front-wheel angle where the steering has a lag, commands not yet applied"""
    b: Array
    """Input column of the steering angle, shape (m,)."""
    c: Array
    """(sensors, m), by `sensed`; the wheel angle's row is zero where the steering has no lag"""


def sampled(
    plant: Plant, period: float, speed: float, *, friction: float = 0.9, profile: str | Profile = "paper",
    lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> Sampled:  # fmt: skip
    """The linearised plant, exactly discretised under commands held over the period (s).

    A command acts `delay` (s, any fraction of a period) later than the profile says. The steering's rate limit plays no
    part in small deviations.

    Raises
    ------
    InvalidInput
        When a command would act before it is given, and as `steady_turn`.
    """
    return sampled_about(
        plant, period, Steady.of(plant, speed, friction, lateral_acceleration), load_profile(profile), delay
    )


def sampled_about(plant: Plant, period: float, turn: Steady, world: Profile, delay: float = 0.0) -> Sampled:
    """`sampled` about a steady turn that is known."""
    if world.oldest > 0.0:
        raise InvalidInput(
            f"profile {world.name!r}: its samples are late, and the linear loop takes them as prompt: analyse its "
            "`without_sample_ages`, which is slightly optimistic."
        )
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
    return Sampled(step[:, :size], step[:, size], outputs)


def _steering(plant: Plant, world: Profile) -> SteeringActuator:
    """The actuator between command and wheels: the plant's own, or the profile's."""
    return getattr(plant, "steering", None) or world.steering


@checked
@dataclass(frozen=True)
class Mismatch:
    """How the true car differs from the one that the controller believes in.

    lag, dead_time: more than believed (less: negative; neither gets below zero); stiffness: true over believed, of
    the tyres; mass: likewise, of mass and yaw inertia.
    """

    lag: Annotated[Finite, "s"] = 0.0
    dead_time: Annotated[Finite, "s"] = 0.0
    stiffness: Annotated[Positive, Hint("it is a factor")] = 1.0
    mass: Annotated[Positive, Hint("it is a factor")] = 1.0

    @property
    def name(self) -> str:
        """How tables call it."""
        sums = (("lag", self.lag), ("dead time", self.dead_time))
        factors = (("stiffness", self.stiffness), ("mass", self.mass))
        words = [f"{quantity} {value:+.3g} s" for quantity, value in sums if value != 0.0]
        return ", ".join(words + [f"{quantity} x {value:.3g}" for quantity, value in factors if value != 1.0]) or "none"

    def sampled(
        self, plant: Plant, period: float, speed: float, *, friction: float = 0.9, profile: str | Profile = "paper"
    ) -> Sampled:
        """`sampled` of the true car, driving straight; `plant` and `profile` are as believed.

        Raises
        ------
        InvalidInput
            As `true_car`.
        """
        world = load_profile(profile)
        believed = _steering(plant, world)
        delay = max(self.dead_time, -world.delay * period - believed.dead_time)
        return sampled(self.true_car(plant, world), period, speed, friction=friction, profile=world, delay=delay)

    def true_car(self, plant: Plant, profile: str | Profile = "paper") -> Plant:
        """The true car behind its true steering; its dead time is the caller's.

        Raises
        ------
        InvalidInput
            When stiffness or mass differ and the plant is neither `SingleTrack` nor `DualTrack`.
        """
        world = load_profile(profile)
        believed = _steering(plant, world)
        lag = max(believed.lag + self.lag, 0.0)
        steering = believed.replace(lag=lag, rate=believed.rate if lag > 0.0 else np.inf)
        if (self.stiffness, self.mass) == (1.0, 1.0):
            return plant.with_steering(steering)
        if not isinstance(plant, SingleTrack | DualTrack):
            raise InvalidInput(
                f"Mismatch {self.name}: plant {plant.name!r} has no vehicle and tyre of ours to change: analyse a "
                "second plant, with other numbers, against the same MPC."
            )
        car, tyre = plant.vehicle, plant.tyre
        heavier = car.replace(mass=self.mass * car.mass, yaw_inertia=self.mass * car.yaw_inertia)
        stiffness = {name: self.stiffness * getattr(tyre, name) for name in ("stiffness_front", "stiffness_rear")}
        return type(plant)(heavier, tyre.replace(**stiffness), steering, plant.steps)


def usual_mismatches(period: float) -> tuple[Mismatch, ...]:
    """One thing at a time: lag 0.1 s off, dead time one period (s), stiffness by a factor of 1.6, mass by 30 %."""
    return (
        Mismatch(lag=0.1), Mismatch(lag=-0.1), Mismatch(dead_time=period), Mismatch(dead_time=-period),
        Mismatch(stiffness=1.6), Mismatch(stiffness=1.0 / 1.6), Mismatch(mass=1.3), Mismatch(mass=0.7),
    )  # fmt: skip


def _with_lag(a: Array, b: Array, lag: float) -> Array:
    """Flow (n + 1, n + 1) of the states, the wheel angle where the steering has a lag (s), and a constant command."""
    n = len(b) + (lag > 0.0)
    flow = np.zeros((n + 1, n + 1))
    flow[: len(b), : len(b)], flow[: len(b), len(b)] = a, b
    if lag > 0.0:
        flow[n - 1, n - 1], flow[n - 1, n] = -1.0 / lag, 1.0 / lag
    return flow


def _hold_flow(flow: Array, period: float, delay: float) -> Array:
    """[A b] (m, m + 1) over one period of a flow whose commands act `delay` periods late; the new one stands last."""
    from scipy.linalg import expm

    n = len(flow) - 1
    periods, part = divmod(delay, 1.0)
    pending = int(periods) + (part > 0.0)
    early, late = expm(flow * (part * period)), expm(flow * ((1.0 - part) * period))
    size = n + pending
    step = np.zeros((size, size + 1))
    step[:n, :n] = late[:n, :n] @ early[:n, :n]
    place = [size, *range(n, size)]  # columns of the commands of this instant, of the last one, ...
    step[:n, place[int(periods)]] = late[:n, n]
    if part > 0.0:
        step[:n, place[int(periods) + 1]] = late[:n, :n] @ early[:n, n]
    step[place[1:], place[:-1]] = 1.0
    return step


def sensed() -> tuple[str, ...]:
    """Return the signals of a controller at one instant by name, see `core.models.contract.MEASUREMENT`."""
    return tuple(name for name in contract.MEASUREMENT._fields if name != "turned")  # it is known, not measured


def _road(friction: float) -> Array:
    return np.array([friction] * 4 + [0.0, 0.0, 0.0])


Turn = Callable[[float, float], float]
"""Lateral acceleration (m/s^2) of a turn at a speed (m/s) on a friction."""
LinearPlant = Callable[[float, float], Sampled]
"""The plant behind its steering at a speed (m/s) on a friction."""


def linear_plants(
    plant: Plant, period: float, profile: str | Profile, turn: Turn | None, mismatches: Sequence[Mismatch] = ()
) -> list[LinearPlant]:
    """Linear plants: driving straight, in a turn if one is requested, and straight with each mismatch. period: s."""

    def steady(speed: float, friction: float, acceleration: float = 0.0) -> Sampled:
        return sampled(plant, period, speed, friction=friction, profile=profile, lateral_acceleration=acceleration)

    def mismatched(by: Mismatch) -> LinearPlant:
        return lambda speed, friction: by.sampled(plant, period, speed, friction=friction, profile=profile)

    bent = [] if turn is None else [lambda speed, friction: steady(speed, friction, turn(speed, friction))]
    return [steady, *bent, *map(mismatched, mismatches)]


# -- the controller ---------------------------------------------------------------------------------------------------
class LinearEstimator(NamedTuple):
    """An estimator at one speed, for small deviations, as the MPC sees it.

        u(k) = h s(k) - k xi(k),   xi(k) = C s(k) + D m(k),   s(k+1) = A s(k) + E m(k) + f u(k)

    s (q,): what is remembered; m: what is measured, by `sensed`; u: the command (rad); k: the feedback of the MPC; xi:
    what that feeds back, or its sum over all steps where h = 0.
    """

    a: Array
    """(q, q)"""
    e: Array
    """(q, sensors)"""
    f: Array
    """Input column of the command, shape (q,)."""
    c: Array
    """(n + 1, q)"""
    d: Array
    """(n + 1, sensors)"""
    h: Array
    """Output row of the state memory, shape (q,)."""


def linear_estimator(mpc: MPC, speed: float) -> LinearEstimator:
    """The estimator of an MPC at a speed (m/s), settled after a long drive at that speed.

    A Kalman filter is linear as long as its innovations are small. What a step of the compiled one makes of each number
    that it is given, or has made of them before, is found by changing that number: so every estimator, one's own
    included, is analysed as it runs. Numbers that do not move with the measurements (gains, covariances), or that move
    no command, are left out.
    """
    return EstimatorAt(mpc, speed).straight


class EstimatorAt:
    """The compiled estimator of an MPC at one speed (m/s), as `linear_estimator` analyses it."""

    def __init__(self, mpc: MPC, speed: float) -> None:
        self.model, self._own = mpc.model, mpc.estimator
        self._speed = max(speed, mpc.speed_floor)
        self._is_deadbeat = self._own.function is None
        if self._is_deadbeat:
            return
        self._parameters = self._own.parameters(self.model)
        self._a, self._b, _ = self.model.discrete(self._speed)
        self._memory, self._sensors = self._own.memory_size(self.model), len(sensed())
        self._x, self._d = np.zeros(self.model.n), np.zeros(self.model.n)

    def _step(self, measured: Array, command: float, memory: Array) -> None:
        self._own.function(
            self._speed, measured, command, self._a, self._b[:, 0], self._parameters, memory, self._x, self._d
        )

    def _answer(self, turned: float, inputs: Array) -> Array:
        """[memory, xi] after a step from [memory, measured, command]."""
        after, command = inputs[: self._memory].copy(), float(inputs[-1])
        self._step(np.append(inputs[self._memory : -1], turned), command, after)
        return np.concatenate([after, self._a @ self._x + self._b[:, 0] * command + self._d - self._x, self._x[-1:]])

    @cached_property
    def straight(self) -> LinearEstimator:
        """Driving straight."""
        return _increments(self.model) if self._is_deadbeat else self._straight[0]

    @cached_property
    def _straight(self) -> tuple[LinearEstimator, list[int]]:
        equilibrium = np.zeros(self._memory + self._sensors + 1)
        remembered = equilibrium[: self._memory]
        swing, back = np.zeros(self._sensors + 1), np.zeros(self._sensors + 1)
        swing[: self._sensors - 2], back[: self._sensors - 2] = -_DITHER, _DITHER
        before, change = remembered.copy(), np.full(self._memory, np.inf)
        for k in range(_LONGEST):
            self._step(back if k % 2 else swing, 0.0, remembered)
            if k % _SETTLING == 0:
                earlier, change = change, remembered - before  # a counter changes, but always alike
                if _within(change - earlier, _SETTLED * np.nanmax(np.abs(before), initial=0.0)):
                    break
                before = remembered.copy()
        derivatives = _differences(partial(self._answer, 0.0), equilibrium, self._memory)
        moved = [i for i in derivatives if i < self._memory]
        moves = np.array([derivatives[i] for i in moved]).reshape(len(moved), self._memory + self.model.n + 1)
        matter = _that_matter(moves, moved, self._memory)
        return self._linearise_changes(derivatives, matter), matter

    def _linearise_changes(self, derivatives: Mapping[int, Array], matter: list[int]) -> LinearEstimator:
        memory, n = self._memory, self.model.n
        inputs = [*matter, *range(memory, memory + self._sensors + 1)]
        rows = np.array([derivatives[i] for i in inputs]).T[[*matter, *range(memory, memory + n + 1)]]
        return _with_last_command(rows, len(matter))

    def with_turn_gains(self, measured: Array, command: float) -> LinearEstimator:
        """After some time in a steady turn: of the same numbers, with the gains that the estimator then has.

        measured: (9,), see `Steady.measured`; command: rad. Gains count as constant: they follow the size of the
        tyres' forces, more slowly than the loop moves.
        """
        if self._is_deadbeat:
            return self.straight
        places, memory = self._straight[1], np.zeros(self._memory)
        swing = np.zeros_like(measured)
        swing[: self._sensors - 2] = _SWING
        for k in range(math.ceil(_TURNING / self.model.period)):
            self._step(measured + (swing if k % 2 else -swing), command, memory)
        equilibrium = np.concatenate([memory, measured[:-1], [command]])
        settled = self._answer(measured[-1], equilibrium)
        derivatives = {}
        for place in (*places, *range(self._memory, equilibrium.size)):
            inputs = equilibrium.copy()
            inputs[place] += _STEP
            derivatives[place] = (self._answer(measured[-1], inputs) - settled) / _STEP
        ages = slice(self._memory + self._sensors - 2, self._memory + self._sensors)
        for place in range(ages.start, ages.stop):
            derivatives[place] = np.zeros_like(settled)  # how old a sample is does not change
        return self._linearise_changes(derivatives, places)


def _within(values: Array, most: float) -> bool:
    """Whether none is larger; NaN, what has never been measured, counts as none."""
    return not (np.abs(values) > most).any()


def _increments(model: PredictionModel) -> LinearEstimator:
    """The increments of the measured state: their sum is that state, s that of y over the steps before."""
    d = np.zeros((model.n + 1, len(sensed())))
    d[range(model.n), model.measured_places()] = 1.0
    d[model.n] = d[model.n - 1]
    return LinearEstimator(
        np.ones((1, 1)), d[-1:].copy(), np.zeros(1), np.eye(model.n + 1)[:, -1:].copy(), d, np.zeros(1)
    )


def _differences(step: Callable[[Array], Array], equilibrium: Array, memory: int) -> dict[int, Array]:
    """By place in `rest`: what a unit change there does to a step, for inputs and the memory that moves with them."""
    settled, derivatives, waiting = step(equilibrium), {}, list(range(memory, len(equilibrium)))
    while waiting:
        place = waiting.pop()
        inputs = equilibrium.copy()
        inputs[place] += _STEP
        change = (step(inputs) - settled) / _STEP
        derivatives[place] = np.where(np.abs(change) > _NOTHING, change, 0.0)
        moved = np.flatnonzero(derivatives[place][:memory]).tolist()
        waiting += [i for i in moved if i not in derivatives and i not in waiting]
    return derivatives


def _that_matter(moves: Array, places: list[int], memory: int) -> list[int]:
    """Return the places in memory that influence xi now or later; moves: effect of each place, row by row."""
    matters = np.abs(moves[:, memory:]).max(axis=1, initial=0.0) > 0.0
    for _ in places:
        acting = [place for place, says in zip(places, matters, strict=True) if says]
        matters |= np.abs(moves[:, acting]).max(axis=1, initial=0.0) > 0.0
    return [place for place, says in zip(places, matters, strict=True) if says]


def _with_last_command(rows: Array, size: int) -> LinearEstimator:
    """From [s, xi] of [s before, m, last command]: the last command joins what is remembered."""
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
    """(n, states + 1) feedback of each tuning, du = -k xi"""

    def __getitem__(self, rows: slice) -> LinearControllers:
        return LinearControllers(self.estimator, self.k[rows])


def laws(mpc: MPC, speed: float, tunings: ArrayLike, estimator: LinearEstimator | None = None) -> LinearControllers:
    """The controllers at a speed (m/s) with n tunings (n, 4) of Np, Nc, Q, R.

    `PredictionModel.feedback` for many tunings at once, behind the `linear_estimator`, made here unless it is given.
    The horizons must be whole numbers, 1 <= Nc <= Np. A controller that learns is taken as it begins: with its first
    belief, and R times its first caution.
    """
    caution = mpc.first_caution
    rows = np.atleast_2d(np.asarray(tunings, dtype=np.float64))
    horizons, group = np.unique(rows[:, :2].astype(np.int64), axis=0, return_inverse=True)
    longest = int(horizons[:, 0].max())
    estimator = linear_estimator(mpc, speed) if estimator is None else estimator
    of_next = mpc.estimator.function is not None
    free, step = mpc.model.responses(max(speed, mpc.speed_floor), longest, of_next)
    below = np.subtract.outer(np.arange(longest), np.arange(longest))
    phi = np.where(below >= 0, step[below], 0.0)
    gains = np.empty((len(rows), mpc.model.n + 1))
    for i, (Np, Nc) in enumerate(horizons.tolist()):
        members = np.flatnonzero(group.ravel() == i)
        basis = np.eye(Np, Nc)
        if mpc.moves.kind == "laguerre":
            basis = laguerre_basis(Np, mpc.moves.terms, mpc.moves.pole)
        effect = phi[:Np, :Np] @ basis
        Q, R = rows[members, 2, None, None], caution * rows[members, 3, None, None]
        moves = np.linalg.solve(Q * (effect.T @ effect) + R * np.eye(effect.shape[1]), Q * (effect.T @ free[:, :Np].T))
        gains[members] = basis[0] @ moves
    return LinearControllers(estimator, gains)
