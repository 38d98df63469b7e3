"""The closed loop for small deviations: its matrix over one control period, its stability and its stability margins.

The plant is linearised about driving straight, or about a steady turn, at a speed; the controller's law is
`PredictionModel.feedback`. What the controller's own model leaves out (tyre relaxation, steering lag, computation
delay) is part of the loop; the reference, with or without preview, is not: it cannot make a linear loop unstable.

The law du = -k [change of x_c; y] sums up to u = w - k_1..4 x_c, where w grows by -k_5 y at every step: besides the
vehicle, the wheel angle and the commands not yet applied, w is the loop's only state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers import MPC, Tuning
from adaptrack.errors import InvalidInput, real
from adaptrack.models import laguerre_basis
from adaptrack.plant import Plant, SteppedPlant
from adaptrack.profile import Profile, load_profile
from adaptrack.vehicle import GRAVITY

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MEASURED = ("vy", "psi", "yaw_rate", "Y")
"""The states of the plant that the controller measures: its x_c."""

_STATES = ("vy", "yaw", "yaw_rate", "y")  # the same, as the prediction model calls them

_HELD = ("X", "vx", "felt_ax")  # X does not matter; speed and longitudinal load transfer are held
_STEP = 1e-6  # of the central differences
_ROUNDING = 1e-15  # share of the largest entry of A below which an entry is a rounding error
_ANGLES = np.geomspace(1e-3, np.pi, 768)  # rad per period, at which the loop gain is looked at


# -- the plant --------------------------------------------------------------------------------------------------------
def steady_turn(plant: Plant, speed: float, lateral_acceleration: float, friction: float = 0.9) -> tuple[Array, float]:
    """State (n,) and front-wheel angle (rad) of a steady turn to the left at `speed` (m/s), without wind.

    lateral_acceleration: m/s^2, speed times yaw rate. The velocity points along X. Newton's method on the derivatives
    of all states but X, Y, yaw and v_x, the acceleration raised from zero in steps of at most 1 m/s^2; speed and
    longitudinal load transfer are held as they are in straight driving.

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

    def residual(values: Array, wanted: float) -> Array:
        state = x.copy()
        state[free] = values[:-1]
        slope = plant.derivative(state, [values[-1], 0.0], road)[free]
        return np.append(slope, state[yaw_rate] * speed - wanted)

    unknown, reached = _raised(residual, np.append(x[free], 0.0), acceleration)
    if reached < abs(acceleration):
        raise InvalidInput(
            f"Plant {plant.name!r}: no steady turn with more than {reached:.4g} m/s^2 at {speed:g} m/s on friction "
            f"{friction:g}: ask for a smaller lateral acceleration."
        )
    x[free] = unknown[:-1]
    x[names.index("psi")] = -np.arctan2(x[names.index("vy")], x[names.index("vx")])
    return x, float(unknown[-1])


def _raised(residual: Callable[[Array, float], Array], unknown: Array, acceleration: float) -> tuple[Array, float]:
    """Roots of residual(x, a) followed from a = 0 towards `acceleration`: the last one, and the |a| that was reached.

    The steering angle stands last in x. A step that changes it by more than 0.1 rad is beyond the grip, where slip
    grows without bound.
    """
    reached, step = 0.0, min(abs(acceleration), 1.0)
    ahead = np.zeros_like(unknown)  # change of the unknowns per m/s^2 in the last step
    while reached < abs(acceleration):
        wanted = min(reached + step, abs(acceleration))
        tried, found = _newton(residual, unknown + (wanted - reached) * ahead, np.copysign(wanted, acceleration))
        if found and abs(tried[-1] - unknown[-1]) < 0.1:
            ahead, unknown, reached = (tried - unknown) / (wanted - reached), tried, wanted
        elif step > 1e-3:
            step *= 0.5
        else:
            break
    return unknown, reached


def _newton(residual: Callable[[Array, float], Array], x: Array, wanted: float) -> tuple[Array, bool]:
    """A root of residual(x, wanted) near x, and whether one was found."""
    for _ in range(20):
        error = residual(x, wanted)
        slopes = [(residual(x + h, wanted) - error) / _STEP for h in _STEP * np.eye(len(x))]
        change = np.linalg.lstsq(np.array(slopes).T, error)[0]
        x = x - change
        if not np.abs(change).max() > 1e-10:
            break
    return x, bool(np.abs(residual(x, wanted)).max() < 1e-6)


def linearised(
    plant: Plant, speed: float, friction: float = 0.9, lateral_acceleration: float = 0.0
) -> tuple[list[str], Array, Array]:
    """State names, A (n, n) and B (n,) of the plant about steady driving at `speed` (m/s) on `friction`.

    About a straight line, or about a `steady_turn` with `lateral_acceleration` (m/s^2), in which tyres are softer; then
    deviations are those from the turn, in axes along its velocity. The input is the front-wheel angle; the speed is
    held. States that do not influence what the controller measures are left out. By central differences.
    """
    x, steering = steady_turn(plant, speed, lateral_acceleration, friction)
    road = _road(friction)
    keep = [i for i, name in enumerate(plant.state_names) if name not in _HELD]

    def slope(state: Array, angle: float) -> Array:
        return plant.derivative(state, [angle, 0.0], road)[keep]

    columns = [(slope(x + h, steering) - slope(x - h, steering)) / (2 * _STEP) for h in _STEP * np.eye(len(x))[keep]]
    a, b = np.array(columns).T, (slope(x, steering + _STEP) - slope(x, steering - _STEP)) / (2 * _STEP)
    seen = np.array([plant.state_names[i] in MEASURED for i in keep])
    for _ in keep:
        seen |= (np.abs(a[seen]) > _ROUNDING * np.abs(a).max()).any(axis=0)
    part = np.flatnonzero(seen)
    return [plant.state_names[keep[j]] for j in part], a[np.ix_(part, part)], b[part]


class Sampled(NamedTuple):
    """The plant behind its steering over one control period: z(k+1) = A z(k) + b u(k), x_c(k) = C z(k)."""

    a: Array
    """(m, m); z: the plant's states, the front-wheel angle where the steering has a lag, commands not yet applied"""
    b: Array
    """(m,)"""
    c: Array
    """(4, m)"""


def sampled(
    plant: Plant, period: float, speed: float, *, friction: float = 0.9, profile: str | Profile = "paper",
    lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> Sampled:  # fmt: skip
    """The linearised plant, exactly discretised under commands held over the period (s).

    A command acts `delay` (s, >= 0, any fraction of a period) after its measurement, a period later still when the
    profile says so. The steering's rate limit plays no part in small deviations.
    """
    if not 0.0 <= real("sampled", "delay", delay) < np.inf:
        raise InvalidInput(f"delay = {delay!r} s: must be finite and not negative.")
    world = load_profile(profile)
    lag = (getattr(plant, "steering", None) or world.steering).lag
    names, a, b = linearised(plant, speed, friction, lateral_acceleration)
    step = _held(_with_lag(a, b, lag), period, world.delay + delay / period)
    size = len(step)
    outputs = np.zeros((len(MEASURED), size))
    outputs[range(len(MEASURED)), [names.index(name) for name in MEASURED]] = 1.0
    return Sampled(step[:, :size], step[:, size], outputs)


def _with_lag(a: Array, b: Array, lag: float) -> Array:
    """Flow (n + 1, n + 1) of the states, the wheel angle where the steering has a lag (s), and a constant command."""
    n = len(b) + (lag > 0.0)
    flow = np.zeros((n + 1, n + 1))
    flow[: len(b), : len(b)], flow[: len(b), len(b)] = a, b
    if lag > 0.0:
        flow[n - 1, n - 1], flow[n - 1, n] = -1.0 / lag, 1.0 / lag
    return flow


def _held(flow: Array, period: float, delay: float) -> Array:
    """[A b] (m, m + 1) over one period of a flow whose commands act `delay` periods late; the new one stands last."""
    from scipy.linalg import expm

    n = len(flow) - 1
    whole, part = divmod(delay, 1.0)
    pending = int(whole) + (part > 0.0)
    early, late = expm(flow * (part * period)), expm(flow * ((1.0 - part) * period))
    size = n + pending
    step = np.zeros((size, size + 1))
    step[:n, :n] = late[:n, :n] @ early[:n, :n]
    place = [size, *range(n, size)]  # columns of the commands of this instant, of the last one, ...
    step[:n, place[int(whole)]] = late[:n, n]
    if part > 0.0:
        step[:n, place[int(whole) + 1]] = late[:n, :n] @ early[:n, n]
    step[place[1:], place[:-1]] = 1.0
    return step


def _road(friction: float) -> Array:
    return np.array([friction] * 4 + [0.0, 0.0])


# -- the loop ---------------------------------------------------------------------------------------------------------
def laws(mpc: MPC, speed: float, tunings: ArrayLike) -> Array:
    """k (n, 5) of du = -k [change of x_c; y] at a speed (m/s) for n tunings (n, 4) of Np, Nc, Q, R.

    `PredictionModel.feedback` for many tunings at once. The horizons must be whole numbers, 1 <= Nc <= Np.

    Raises
    ------
    InvalidInput
        When the MPC has another prediction model or estimator than the paper's.
    """
    if mpc.model.states != _STATES or mpc.estimator.name != "deadbeat":
        raise InvalidInput(
            f"MPC: model {mpc.model.name!r} with estimator {mpc.estimator.name!r}: the linear loop is known for the "
            f"states {', '.join(_STATES)}, all of them measured, with the estimator 'deadbeat' only: take "
            "published_mpc(...)."
        )
    asked = np.atleast_2d(np.asarray(tunings, dtype=np.float64))
    horizons, group = np.unique(asked[:, :2].astype(np.int64), axis=0, return_inverse=True)
    longest = int(horizons[:, 0].max())
    free, step = mpc.model.responses(max(speed, mpc.speed_floor), longest)
    below = np.subtract.outer(np.arange(longest), np.arange(longest))
    phi = np.where(below >= 0, step[below], 0.0)
    gains = np.empty((len(asked), 5))
    for i, (Np, Nc) in enumerate(horizons.tolist()):
        which = np.flatnonzero(group.ravel() == i)
        basis = np.eye(Np, Nc)
        if mpc.moves.kind == "laguerre":
            basis = laguerre_basis(Np, mpc.moves.terms, mpc.moves.pole)
        effect = phi[:Np, :Np] @ basis
        Q, R = asked[which, 2, None, None], asked[which, 3, None, None]
        moves = np.linalg.solve(Q * (effect.T @ effect) + R * np.eye(effect.shape[1]), Q * (effect.T @ free[:, :Np].T))
        gains[which] = basis[0] @ moves
    return gains


def loops(body: Sampled, k: Array, gain: float = 1.0) -> Array:
    """The matrices (n, m + 1, m + 1) that take [z, w] from one control instant to the next, for n laws k (n, 5).

    gain: a factor on every command between the controller and the steering.
    """
    m = len(body.b)
    matrices = np.empty((len(k), m + 1, m + 1))
    matrices[:, :m, :m] = body.a - gain * body.b[:, None] * (_direct(k) @ body.c)[:, None, :]
    matrices[:, :m, m] = gain * body.b
    matrices[:, m, :m] = -k[:, 4, None] * body.c[3]
    matrices[:, m, m] = 1.0
    return matrices


def _direct(k: Array) -> Array:
    """(n, 4): what the newest x_c adds to -u; y acts through w as well, at once."""
    return k[:, :4] + k[:, 4, None] * np.array([0.0, 0.0, 0.0, 1.0])


def closed_loop(
    plant: Plant, mpc: MPC, speed: float, *, tuning: Tuning | None = None, friction: float = 0.9,
    profile: str | Profile = "paper", lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> Array:  # fmt: skip
    """The matrix that takes the loop's state from one control instant to the next, with a reference of zero.

    State: that of `sampled`, then w (see above). delay: s, additional dead time of the commands.
    """
    body = sampled(
        plant, mpc.period, speed, friction=friction, profile=profile, lateral_acceleration=lateral_acceleration,
        delay=delay,
    )  # fmt: skip
    return loops(body, laws(mpc, speed, (tuning or mpc.tuning).as_array()))[0]


def spectral_radius(
    plant: Plant, mpc: MPC, speed: float, *, tuning: Tuning | None = None, friction: float = 0.9,
    profile: str | Profile = "paper", lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> float:  # fmt: skip
    """Largest magnitude of the closed loop's eigenvalues over one control period: below 1 it is stable."""
    matrix = closed_loop(
        plant, mpc, speed, tuning=tuning, friction=friction, profile=profile,
        lateral_acceleration=lateral_acceleration, delay=delay,
    )  # fmt: skip
    return float(radii(matrix))


def radii(matrices: Array) -> Array:
    """Spectral radius of each matrix (..., n, n)."""
    return np.abs(np.linalg.eigvals(matrices)).max(axis=-1)


# -- margins ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Margins:
    """Stability margins of n loops, arrays (n,). An unstable loop has gain margins of 1 and a delay margin of 0 s."""

    radius: Array
    """spectral radius over one control period"""
    gain_up: Array
    """factor > 1 on the commands at which the loop becomes unstable, inf when none does"""
    gain_down: Array
    """likewise < 1, 0 when none does"""
    delay: Array
    """s, additional delay of the commands at which it becomes unstable"""
    modulus_margin: Array
    """0 at the stability limit, see `modulus_margin`"""

    def worst(self, other: Margins) -> Margins:
        """The worse of two, loop by loop."""
        return Margins(
            np.maximum(self.radius, other.radius),
            np.minimum(self.gain_up, other.gain_up),
            np.maximum(self.gain_down, other.gain_down),
            np.minimum(self.delay, other.delay),
            np.minimum(self.modulus_margin, other.modulus_margin),
        )


def loop_gain(body: Sampled, k: Array, angles: ArrayLike = _ANGLES) -> Complex:
    """The loop gain L (n, angles) of n laws at z = e^(i angle), the loop being cut at the steering command.

    The loop with a factor g on its commands has the characteristic equation 1 + g L(z) = 0.
    """
    z = np.exp(1j * np.asarray(angles, dtype=np.float64))
    resolvents = z[:, None, None] * np.eye(len(body.b)) - body.a
    states = np.linalg.solve(resolvents, np.broadcast_to(body.b[:, None], (len(z), len(body.b), 1)))[..., 0]
    measured = (states @ body.c.T).T
    return np.asarray(_direct(k) @ measured + k[:, 4, None] * (measured[3] / (z - 1.0)))


def modulus_margin(body: Sampled, k: Array) -> Array:
    """Modulus margin min |1 + L| (n,) of the loops of n laws k (n, 5): the distance of the loop gain from -1.

    It is 1/M, M the largest sensitivity |1/(1 + L)|: 0.5 is a comfortable loop, 0 the stability limit (I. D. Landau,
    G. Zito, Digital Control Systems, Springer 2006, chapter 2). It bounds all other margins: with a modulus margin m
    the loop is stable for factors on its commands from 1/(1 + m) to 1/(1 - m). At most 1. An unstable loop has the
    negative value -10 (spectral radius - 1), so that tables can be interpolated across the limit.
    """
    return _modulus_margin(loop_gain(body, k), radii(loops(body, k)))


def _modulus_margin(gains: Complex, radius: Array) -> Array:
    distance = np.abs(1.0 + gains).min(axis=1)
    return np.where(radius < 1.0, np.minimum(distance, 1.0), -10.0 * (radius - 1.0))


def margins(body: Sampled, k: Array, period: float) -> Margins:
    """Stability margins of the loops of n laws k (n, 5) around a sampled plant; period: s.

    From the loop gain L on the unit circle, which an eigenvalue must cross: where g L = -1 for a factor g, where
    L e^(-i angle tau/period) = -1 for a delay tau. Crossings are interpolated between 768 frequencies.
    """
    gains = loop_gain(body, k)
    radius = radii(loops(body, k))
    stable = radius < 1.0
    factor, delay = _critical_factors(gains), _critical_delays(gains, period)
    return Margins(
        radius,
        np.where(stable, np.min(factor, axis=1, where=factor > 1.0, initial=np.inf), 1.0),
        np.where(stable, np.max(factor, axis=1, where=factor < 1.0, initial=0.0), 1.0),
        np.where(stable, np.min(delay, axis=1, where=delay >= 0.0, initial=np.inf), 0.0),
        _modulus_margin(gains, radius),
    )


def _critical_factors(gains: Complex) -> Array:
    """Factors g = -1/L (n, 768) where L crosses the negative real axis, NaN elsewhere."""
    _, at = _crossings(gains.imag, gains)
    real_axis = np.concatenate([at.real, gains[:, -1:].real], axis=1)  # at half the sampling frequency L is real
    return np.asarray(-1.0 / np.where(real_axis < 0.0, real_axis, np.nan))


def _critical_delays(gains: Complex, period: float) -> Array:
    """Delays tau (s) (n, 767) where |L| crosses 1, NaN elsewhere: period (arg L + pi)/angle, arg L + pi in [0, 2 pi).

    Exact for whole periods; in between it leaves out that commands are held.
    """
    share, at = _crossings(np.log(np.abs(gains)), gains)
    angle = _ANGLES[:-1] * (_ANGLES[1:] / _ANGLES[:-1]) ** share
    return np.asarray(period * np.mod(np.angle(at) + np.pi, 2.0 * np.pi) / angle)


def _crossings(level: Array, gains: Complex) -> tuple[Array, Complex]:
    """Where `level` changes its sign: the share of the way to the next frequency, NaN elsewhere, and L there."""
    left, right = gains[:, :-1], gains[:, 1:]
    changes = level[:, :-1] * level[:, 1:] < 0.0
    share = np.full(changes.shape, np.nan)
    np.divide(level[:, :-1], level[:, :-1] - level[:, 1:], out=share, where=changes)
    return share, left + share * (right - left)


# -- the guard's table ------------------------------------------------------------------------------------------------
def hard_turn(speed: float, friction: float) -> float:
    """Lateral acceleration (m/s^2) of a turn as hard as driving gets at a speed (m/s) on `friction`.

    A share of the grip that grows with the speed: 0.027 v, at most 0.75. Measured: with the paper's vehicle in the
    `road` profile and a sound constant tuning (35, 5, 1, 1e4), in nine of ten random drives (`scenario.random_drive`,
    with gusts of up to 30 m/s) the largest share is at most 0.21 at 6 m/s, 0.40 at 14 m/s and 0.69 at 26 m/s; in the
    hardest of thirty 0.033 v up to 22 m/s.
    """
    return min(0.027 * speed, 0.75) * friction * GRAVITY


_NODES = (
    (6, 10, 14, 18, 22, 26, 30, 36, 42, 50, 60),
    (1, 2, 3, 5, 8, 13, 20),
    np.linspace(1.0, 6.0, 16),
)
"""Np, Nc and log10 R/Q (R/Q in m^2/rad^2) of the guard's table, for the `road` profile."""


def _speeds(low: float, high: float) -> Array:
    """Nodes at most a quarter of the speed and 2 m/s apart: slow loops change fastest with it."""
    nodes = [low]
    while nodes[-1] < high:
        nodes.append(min(nodes[-1] + min(0.25 * nodes[-1], 2.0), high))
    return np.array(nodes)


def loop_map(
    plant: Plant, mpc: MPC, profile: str | Profile = "road", *, speed: tuple[float, float] = (2.0, 30.0),
    friction: tuple[float, float] = (0.3, 1.0), nodes: Sequence[ArrayLike] = _NODES,
    turn: Callable[[float, float], float] = hard_turn,
) -> tuple[tuple[Array, ...], Array]:  # fmt: skip
    """The table of a guard over speed, friction, Np, Nc and log10 R/Q: the axes of a grid, and its values.

    Values: 1 less the smaller modulus margin of driving straight and in a turn, rounded up to 0.001, made to be
    interpolated linearly. 1 is the stability limit. It foretells failed drives better than the spectral radius, which
    also counts slow modes that are well damped.

    speed (m/s), friction: ranges; nodes: of Np, Nc and log10 R/Q; turn: lateral acceleration (m/s^2) of the turn at a
    speed on a friction, 0 for driving straight only. A node with Nc > Np stands for Nc = Np.
    """
    axes = (
        _speeds(*speed),
        np.array(friction, dtype=np.float64),
        *(np.asarray(axis, dtype=np.float64) for axis in nodes),
    )
    horizon, moves, ratio = (axis.ravel() for axis in np.meshgrid(*axes[2:], indexing="ij"))
    tunings = np.column_stack([horizon, np.minimum(moves, horizon), np.ones_like(ratio), 10.0**ratio])
    least = np.empty((len(axes[0]), len(axes[1]), len(tunings)))
    for i, v in enumerate(axes[0].tolist()):
        k = laws(mpc, v, tunings)
        for j, mu in enumerate(axes[1].tolist()):
            bodies = [
                sampled(plant, mpc.period, v, friction=mu, profile=profile, lateral_acceleration=acceleration)
                for acceleration in (0.0, turn(v, mu))
            ]
            least[i, j] = np.minimum(*(modulus_margin(body, k) for body in bodies))
    return axes, np.ceil(1000.0 * (1.0 - least.reshape([len(axis) for axis in axes]))) / 1000.0
