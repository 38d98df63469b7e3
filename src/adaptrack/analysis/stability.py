"""The closed loop for small deviations: its matrix over one control period, its stability and its stability margins.

What the controller leaves out (tyre relaxation, a lag or dead time that it does not know) is part of the loop; the
reference, with or without preview, is not: it cannot make a linear loop unstable. Car and controller: `linearisation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.analysis.linearisation import (
    SENSED_STATES,
    LinearControllers,
    LinearPlant,
    Sampled,
    Turn,
    laws,
    linear_plants,
    linearised,
    sampled,
    sensed,
)
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.domain import Domain
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant, twin_of
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import MPC, Tuning
from adaptrack.core.plants.forces import GRAVITY
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_ANGLES = np.geomspace(1e-3, np.pi, 768)  # rad per period, at which the loop gain is looked at


# -- the loop ---------------------------------------------------------------------------------------------------------
def loops(plant: Sampled, law: LinearControllers, gain: float = 1.0) -> Array:
    """The matrices (n, m + q, m + q) that take [z, s] from one control instant to the next, for n laws.

    gain: a factor on every command between the controller and the steering.
    """
    estimator, measured = law.estimator, _measured(plant, law)
    m, q = len(plant.b), len(estimator.a)
    of_z, of_s = -law.k @ (estimator.d @ measured), estimator.h - law.k @ estimator.c  # u = of_z z + of_s s
    matrices = np.empty((len(law.k), m + q, m + q))
    matrices[:, :m, :m] = plant.a + gain * plant.b[:, None] * of_z[:, None, :]
    matrices[:, :m, m:] = gain * plant.b[:, None] * of_s[:, None, :]
    matrices[:, m:, :m] = estimator.e @ measured + estimator.f[:, None] * of_z[:, None, :]
    matrices[:, m:, m:] = estimator.a + estimator.f[:, None] * of_s[:, None, :]
    return matrices


def _measured(plant: Sampled, law: LinearControllers) -> Array:
    """C of the plant; refused where the estimator reads what is no state of it."""
    read = np.asarray(law.estimator.e.any(axis=0) | law.estimator.d.any(axis=0))
    without = np.flatnonzero(read & ~plant.c.any(axis=1))
    missing = [sensed()[i] for i in without.tolist() if i >= len(SENSED_STATES)]
    if missing:
        raise InvalidInput(
            f"the estimator reads {', '.join(missing)}, which is no state of the linear loop: leave that sensor out "
            "(SensorNoise: inf); a wheel angle is a state where the steering has a lag (0.001 s will do)."
        )
    return plant.c


def closed_loop(
    plant: Plant, mpc: MPC, speed: float, *, tuning: Tuning | None = None, friction: float = 0.9,
    profile: str | Profile = "paper", lateral_acceleration: float = 0.0, delay: float = 0.0,
) -> Array:  # fmt: skip
    """The matrix that takes the loop's state from one control instant to the next, with a reference of zero.

    State: that of `sampled`, then that of `linear_estimator`. delay: s, additional dead time of the commands.
    """
    linear = sampled(
        plant, mpc.period, speed, friction=friction, profile=profile, lateral_acceleration=lateral_acceleration,
        delay=delay,
    )  # fmt: skip
    return loops(linear, laws(mpc, speed, (tuning or mpc.tuning).as_array()))[0]


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
    """Largest gain factor below 1 that makes the loop unstable; 0 if there is none."""
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


def loop_gain(plant: Sampled, law: LinearControllers, angles: ArrayLike = _ANGLES) -> Complex:
    """The loop gain L (n, angles) of n laws at z = e^(i angle), the loop being cut at the steering command.

    The loop with a factor g on its commands has the characteristic equation 1 + g L(z) = 0. The controller itself knows
    the commands that it gave.
    """
    estimator, z = law.estimator, np.exp(1j * np.asarray(angles, dtype=np.float64))
    measured = _measured(plant, law) @ _resolvent(z, plant.a, plant.b[:, None])[:, 0]  # (sensors, angles)
    remembered = _resolvent(z, estimator.a, np.column_stack([estimator.e, estimator.f]))  # (q, sensors + 1, angles)
    by_measured, by_own = np.einsum("qsz,sz->qz", remembered[:, :-1], measured), remembered[:, -1]
    fed_back = law.k @ (estimator.c @ by_measured + estimator.d @ measured) - estimator.h @ by_measured
    return np.asarray(fed_back / (1.0 + law.k @ (estimator.c @ by_own) - estimator.h @ by_own))


def _resolvent(z: Complex, a: Array, b: Array) -> Complex:
    """(z - A)^-1 B (n, columns, len(z)), from the Schur form of A: one back substitution for all z."""
    from scipy.linalg import schur

    t, u = schur(a, output="complex")
    rotated, x = u.conj().T @ b, np.empty((*b.shape, len(z)), dtype=np.complex128)
    for i in reversed(range(len(a))):
        x[i] = (rotated[i][:, None] + np.tensordot(t[i, i + 1 :], x[i + 1 :], 1)) / (z - t[i, i])
    return np.asarray(np.tensordot(u, x, 1))


def modulus_margin(plant: Sampled, law: LinearControllers, angles: ArrayLike = _ANGLES) -> Array:
    """Modulus margin min |1 + L| (n,) of the loops of n laws: the distance of the loop gain from -1.

    It is 1/M, M the largest sensitivity |1/(1 + L)|: 0.5 is a comfortable loop, 0 the stability limit (I. D. Landau,
    G. Zito, Digital Control Systems, Springer 2006, chapter 2). It bounds all other margins: with a modulus margin m
    the loop is stable for factors on its commands from 1/(1 + m) to 1/(1 - m). At most 1. An unstable loop has the
    negative value -10 (spectral radius - 1), so that tables can be interpolated across the limit.
    """
    return _modulus_margin(loop_gain(plant, law, angles), radii(loops(plant, law)))


def _modulus_margin(gains: Complex, radius: Array) -> Array:
    distance = np.abs(1.0 + gains).min(axis=1)
    return np.where(radius < 1.0, np.minimum(distance, 1.0), -10.0 * (radius - 1.0))


def margins(plant: Sampled, law: LinearControllers, period: float) -> Margins:
    """Stability margins of the loops of n laws around a sampled plant; period: s.

    From the loop gain L on the unit circle, which an eigenvalue must cross: where g L = -1 for a factor g, where
    L e^(-i angle tau/period) = -1 for a delay tau. Crossings are interpolated between 768 frequencies.
    """
    gains = loop_gain(plant, law)
    radius = radii(loops(plant, law))
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
    with np.errstate(divide="ignore", invalid="ignore"):  # a loop without gain crosses nothing
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


def linear_twin(plant: Plant | SteppedPlant, car: Vehicle, domain: Domain) -> Plant:
    """Return the plant's stand-in for linear analysis: the plant itself where it has a linear model in the domain.

    Else the car's twin (`plant.twin_of`): of a plant that is stepped in Python, or whose derivatives jump. What the
    twin leaves out is not in the analysis.
    """
    if isinstance(plant, SingleTrack | DualTrack):
        return plant
    if not isinstance(plant, SteppedPlant):
        corners = [(speed, friction) for speed in domain.speed for friction in domain.friction]
        with suppress(InvalidInput):
            for speed, friction in corners:
                linearised(plant, speed, friction)
                linearised(plant, speed, friction, hard_turn(speed, friction))
            return plant
    return twin_of(car)


_HORIZONS = ((6, 10, 14, 18, 22, 26, 30, 36, 42, 50, 60), (1, 2, 3, 5, 8, 13, 20))
_RATIOS = {"deadbeat": np.linspace(1.0, 6.0, 16), "informed": np.linspace(-1.0, 4.0, 16)}


def guard_nodes(mpc: MPC) -> tuple[ArrayLike, ...]:
    """Np, Nc and log10 R/Q (R/Q in m^2/rad^2) of a guard's table, for the `road` profile.

    Without an estimator the weight of the moves is what keeps lag and noise from the loop, so that it is larger.
    """
    return (*_HORIZONS, _RATIOS["deadbeat" if mpc.estimator.function is None else "informed"])


def speed_nodes(low: float, high: float) -> Array:
    """Speeds (m/s) at most a quarter of the speed and 2 m/s apart: slow loops change fastest with it."""
    nodes = [low]
    while nodes[-1] < high:
        nodes.append(min(nodes[-1] + min(0.25 * nodes[-1], 2.0), high))
    return np.array(nodes)


def margin_map(mpc: MPC, plants: Sequence[LinearPlant], axes: Sequence[Array], angles: ArrayLike = _ANGLES) -> Array:
    """Least modulus margin of an MPC around some plants, at a grid over speed, friction, Np, Nc and log10 R/Q (axes).

    A node with Nc > Np stands for Nc = Np.
    """
    horizon, moves, ratio = (axis.ravel() for axis in np.meshgrid(*axes[2:], indexing="ij"))
    tunings = np.column_stack([horizon, np.minimum(moves, horizon), np.ones_like(ratio), 10.0**ratio])
    least = np.empty((len(axes[0]), len(axes[1]), len(tunings)))
    for i, v in enumerate(axes[0].tolist()):
        law = laws(mpc, v, tunings)
        sampled_plants: dict[
            LinearPlant, tuple[Sampled, Array]
        ] = {}  # driving straight, most tyres are alike on every friction
        for j, mu in enumerate(axes[1].tolist()):
            for plant in plants:
                linear_plant = plant(v, mu)
                if plant not in sampled_plants or not _are_alike(linear_plant, sampled_plants[plant][0]):
                    sampled_plants[plant] = linear_plant, modulus_margin(linear_plant, law, angles)
            least[i, j] = np.min([margin for _, margin in sampled_plants.values()], axis=0)
    return least.reshape([len(axis) for axis in axes])


def _are_alike(first: Sampled, other: Sampled) -> bool:
    """Whether two bodies differ by no more than the rounding of their linearisation."""
    return bool(
        np.allclose(first.a, other.a, rtol=1e-7, atol=1e-9) and np.allclose(first.b, other.b, rtol=1e-7, atol=1e-9)
    )


def loop_map(
    plant: Plant, mpc: MPC, profile: str | Profile = "road", *, speed: tuple[float, float] = (2.0, 30.0),
    friction: tuple[float, float] = (0.3, 1.0), nodes: Sequence[ArrayLike] | None = None,
    turn: Turn | None = hard_turn,
) -> tuple[tuple[Array, ...], Array]:  # fmt: skip
    """The table of a guard over speed, friction, Np, Nc and log10 R/Q: the axes of a grid, and its values.

    Values: 1 less the smaller modulus margin of driving straight and in a turn, rounded up to 0.001, made to be
    interpolated linearly. 1 is the stability limit. It foretells failed drives better than the spectral radius, which
    also counts slow modes that are well damped.

    speed (m/s), friction: ranges; nodes: of Np, Nc and log10 R/Q, by default `guard_nodes`; turn: lateral acceleration
    (m/s^2) of the turn at a speed on a friction, None for driving straight only. A node with Nc > Np stands for
    Nc = Np.
    """
    chosen = guard_nodes(mpc) if nodes is None else nodes
    axes = (speed_nodes(*speed), np.array(friction), *(np.asarray(axis, dtype=np.float64) for axis in chosen))
    least = margin_map(mpc, linear_plants(plant, mpc.period, profile, turn), axes)
    return axes, np.ceil(1000.0 * (1.0 - least)) / 1000.0
