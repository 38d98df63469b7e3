"""Stability and stability margins of the linear closed loop over one control period.

The loop contains the true car, including effects that the controller's model neglects, such as tyre relaxation or an
unknown lag or dead time. The reference, with or without preview, is left out, since it cannot make a linear loop
unstable. `linearisation` provides car and controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.analysis.linearisation import (
    PROMPT_SAMPLES,
    SENSED_STATES,
    LinearControllers,
    LinearPlant,
    SampleAges,
    Sampled,
    Turn,
    laws,
    linear_estimator,
    linear_plants,
    linearised,
    sensed,
)
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant, twin_of
from adaptrack.cars.vehicle import Domain, Vehicle
from adaptrack.control.controllers import MPC
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.scenario.profile import Profile

Complex = NDArray[np.complex128]

_ANGLES = portable.geomspace(1e-3, np.pi, 768)  # frequencies of the loop gain (rad per control period)
COARSE_ANGLES = portable.geomspace(2e-3, np.pi, 192)
"""Frequencies of the loop gain (rad per control period) where only the modulus margin is needed."""


# -- the loop ---------------------------------------------------------------------------------------------------------
def loops(plant: Sampled, law: LinearControllers) -> Array:
    """Return the closed-loop matrices over one control period of n controllers, (n, m + q, m + q).

    The loop's state is that of the plant (m,), then that of the controllers' estimator (q,).
    """
    estimator, measured = law.estimator, _measured(plant, law)
    m, q = len(plant.b), len(estimator.a)
    of_z = -product(law.k, product(estimator.d, measured))  # u = of_z z + of_s s
    of_s = estimator.h - product(law.k, estimator.c)
    matrices = np.empty((len(law.k), m + q, m + q))
    matrices[:, :m, :m] = plant.a + plant.b[:, None] * of_z[:, None, :]
    matrices[:, :m, m:] = plant.b[:, None] * of_s[:, None, :]
    matrices[:, m:, :m] = product(estimator.e, measured) + estimator.f[:, None] * of_z[:, None, :]
    matrices[:, m:, m:] = estimator.a + estimator.f[:, None] * of_s[:, None, :]
    return matrices


def _measured(plant: Sampled, law: LinearControllers) -> Array:
    """Return C of the plant; raises `InvalidInput` if the estimator uses a signal that is no state of the plant."""
    read = np.asarray(law.estimator.e.any(axis=0) | law.estimator.d.any(axis=0))
    without = np.flatnonzero(read & ~plant.c.any(axis=1))
    missing = [sensed()[i] for i in without.tolist() if i >= len(SENSED_STATES)]
    if missing:
        raise InvalidInput(
            f"the estimator reads {', '.join(missing)}, which is no state of the linear loop: leave that sensor out "
            "(SensorNoise: inf); a wheel angle is a state where the steering has a lag (0.001 s will do)."
        )
    return plant.c


# -- margins ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Margins:
    """Stability margins of n loops, arrays (n,). An unstable loop has gain margins of 1 and a delay margin of 0 s."""

    radius: Array
    """Spectral radius over one control period."""
    gain_up: Array
    """Smallest gain factor above 1 that makes the loop unstable; infinite if there is none."""
    gain_down: Array
    """Largest gain factor below 1 that makes the loop unstable; 0 if there is none."""
    delay: Array
    """Smallest additional delay of the commands that makes the loop unstable (s)."""
    modulus_margin: Array
    """Modulus margin, 0 at the stability limit, see `modulus_margin`."""

    def worst(self, other: Margins) -> Margins:
        """Return the worse margins of two sets, loop by loop."""
        return Margins(*(worse(getattr(self, name), getattr(other, name)) for name, worse in _WORSE.items()))

    @property
    def extremes(self) -> dict[str, float]:
        """The worst value of each margin over all loops."""
        return {name: float(worse.reduce(getattr(self, name))) for name, worse in _WORSE.items()}


_WORSE = {
    "radius": np.maximum, "gain_up": np.minimum, "gain_down": np.maximum, "delay": np.minimum,
    "modulus_margin": np.minimum,
}  # fmt: skip
"""Function that returns the worse of two values of each margin."""


def loop_gain(plant: Sampled, law: LinearControllers, angles: ArrayLike = _ANGLES) -> Complex:
    """Return the loop gain L (n, angles) of n controllers at z = e^(i angle), with the loop cut at the command.

    The loop with a factor g on its commands has the characteristic equation 1 + g L(z) = 0. The factor applies after
    the controller, whose estimator uses the commands without it.
    """
    estimator, z = law.estimator, portable.direction(np.asarray(angles, dtype=np.float64))
    measured = product(_measured(plant, law), _resolved(z, plant.a, plant.b[:, None]))  # (sensors, angles)
    by_measured = _resolved(z, estimator.a, product(estimator.e, measured))
    by_own = _resolved(z, estimator.a, estimator.f[:, None])
    fed_back = product(law.k, product(estimator.c, by_measured) + product(estimator.d, measured))
    eigenvalues_of_loop = product(law.k, product(estimator.c, by_own)) - product(estimator.h, by_own)
    return np.asarray((fed_back - product(estimator.h, by_measured)) / (1.0 + eigenvalues_of_loop))


def _resolved(z: Complex, a: Array, b: NDArray[Any]) -> Complex:
    """Return (z - A)^-1 b for each z, (n, len(z)); b is (n, len(z)) or (n, 1)."""
    n, right = len(a), np.broadcast_to(b, (len(a), len(z)))
    matrices = np.empty((len(z), 2 * n, 2 * n))  # real and imaginary parts, one below the other
    matrices[:, :n, :n] = matrices[:, n:, n:] = z.real[:, None, None] * np.eye(n) - a
    matrices[:, n:, :n] = z.imag[:, None, None] * np.eye(n)
    matrices[:, :n, n:] = -matrices[:, n:, :n]
    x = portable.solve(matrices, np.concatenate([right.real, right.imag]).T[..., None])[..., 0].T
    return np.asarray(x[:n] + 1j * x[n:])


def modulus_margin(plant: Sampled, law: LinearControllers, angles: ArrayLike = _ANGLES) -> Array:
    """Return the modulus margin min |1 + L| (n,) of the loops of n controllers: the distance of the loop gain from -1.

    It is 1/M, M the largest sensitivity |1/(1 + L)|: 0.5 is a comfortable loop, 0 the stability limit (I. D. Landau,
    G. Zito, Digital Control Systems, Springer 2006, chapter 2). It bounds all other margins: with a modulus margin m
    the loop is stable for factors on its commands from 1/(1 + m) to 1/(1 - m). At most 1. An unstable loop has the
    negative value -10 (spectral radius - 1), so that tables can be interpolated across the limit.
    """
    return _modulus_margin(loop_gain(plant, law, angles), portable.spectral_radius(loops(plant, law)))


def _modulus_margin(gains: Complex, radius: Array) -> Array:
    distance = portable.magnitude(1.0 + gains).min(axis=1)
    return np.where(radius < 1.0, np.minimum(distance, 1.0), -10.0 * (radius - 1.0))


def margins(plant: Sampled, law: LinearControllers, period: float) -> Margins:
    """Return the stability margins of the loops of n controllers with a sampled plant; period in s.

    At the stability limit an eigenvalue lies on the unit circle. The gain margins are the factors g with g L = -1
    there, and the delay margin is the delay tau with L e^(-i angle tau/period) = -1. L is interpolated between 768
    frequencies.
    """
    gains = loop_gain(plant, law)
    radius = portable.spectral_radius(loops(plant, law))
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
    """Return the factors g = -1/L (n, 768) where L crosses the negative real axis, NaN elsewhere."""
    _, crossing = _crossings(gains.imag, gains)
    real_axis = np.concatenate([crossing.real, gains[:, -1:].real], axis=1)  # L is real at half the sampling frequency
    return np.asarray(-1.0 / np.where(real_axis < 0.0, real_axis, np.nan))


def _critical_delays(gains: Complex, period: float) -> Array:
    """Return the delays tau (s), (n, 767), where |L| crosses 1, NaN elsewhere.

    tau = period (arg L + pi)/angle with arg L + pi in [0, 2 pi). This is exact for whole periods; for other delays it
    neglects the zero-order hold of the commands.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # log |L| = -inf for a loop without gain
        share, crossing = _crossings(portable.log(portable.magnitude(gains)), gains)
    angle = _ANGLES[:-1] * portable.power(_ANGLES[1:] / _ANGLES[:-1], share)
    return np.asarray(period * np.mod(portable.atan2(crossing.imag, crossing.real) + np.pi, 2.0 * np.pi) / angle)


def _crossings(values: Array, gains: Complex) -> tuple[Array, Complex]:
    """Return the zero crossings of values between neighbouring frequencies, and L there.

    A crossing is a share of the step to the next frequency; it is NaN without a change of sign.
    """
    left, right = gains[:, :-1], gains[:, 1:]
    changes = values[:, :-1] * values[:, 1:] < 0.0
    share = np.full(changes.shape, np.nan)
    np.divide(values[:, :-1], values[:, :-1] - values[:, 1:], out=share, where=changes)
    return share, left + share * (right - left)


# -- the margin table of a guard --------------------------------------------------------------------------------------
def hard_turn(speed: float, friction: float) -> float:
    """Return the lateral acceleration (m/s^2) of a hard turn at a speed v (m/s) on a friction.

    Its share of the grip is 0.027 v, at most 0.75. The factor comes from random drives (`scenario.random_drive`, gusts
    of up to 30 m/s) with the paper's vehicle, the `road` profile and a constant tuning of (35, 5, 1, 1e4). The largest
    share of the grip in nine of ten drives is at most

    - 0.21 at 6 m/s,
    - 0.40 at 14 m/s,
    - 0.69 at 26 m/s.

    In the hardest of thirty drives it is 0.033 v up to 22 m/s.
    """
    return min(0.027 * speed, 0.75) * friction * GRAVITY


def linear_twin(plant: Plant | SteppedPlant, car: Vehicle, domain: Domain) -> Plant:
    """Return the plant for linear analysis: the plant itself if it has a linear model in the domain, else a twin.

    A plant that is stepped in Python, or whose derivatives jump, has no linear model. Its twin is the built-in plant
    with the data of the car (`plant.twin_of`). Effects that the twin lacks are not analysed.
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
    """Return the values of Np, Nc and log10 R/Q (R/Q in m^2/rad^2) in a guard's table, for the `road` profile.

    An MPC without an estimator needs larger weights R against lag and noise.
    """
    return (*_HORIZONS, _RATIOS["deadbeat" if mpc.estimator.function is None else "informed"])


def speed_nodes(low: float, high: float) -> Array:
    """Return speeds from low to high (m/s) with steps of at most 2 m/s and at most a quarter of the speed.

    The loop varies most with the speed at low speeds.
    """
    nodes = [low]
    while nodes[-1] < high:
        nodes.append(min(nodes[-1] + min(0.25 * nodes[-1], 2.0), high))
    return np.array(nodes)


def margin_map(
    mpc: MPC, plants: Sequence[LinearPlant], axes: Sequence[Array], angles: ArrayLike = _ANGLES,
    ages: SampleAges = PROMPT_SAMPLES, progress: ProgressCall | None = None,
) -> Array:  # fmt: skip
    """Return the smallest modulus margin of an MPC with several plants, on a grid of operating points and tunings.

    The axes are values of speed (m/s), friction, Np, Nc and log10 R/Q. A node with Nc > Np is computed with Nc = Np.
    angles: frequencies of the loop gain (rad per control period); ages: of the samples in the plants.
    """
    horizon, moves, ratio = (axis.ravel() for axis in np.meshgrid(*axes[2:], indexing="ij"))
    tunings = np.column_stack([horizon, np.minimum(moves, horizon), np.ones_like(ratio), portable.power(10.0, ratio)])
    least = np.empty((len(axes[0]), len(axes[1]), len(tunings)))
    for i, v in enumerate(axes[0].tolist()):
        if progress is not None:
            progress("margins", i, len(axes[0]))
        law = laws(mpc, v, tunings, linear_estimator(mpc, v, ages))
        # The last linear plant and its margins; in straight driving most tyres do not depend on friction.
        sampled_plants: dict[LinearPlant, tuple[Sampled, Array]] = {}
        for j, mu in enumerate(axes[1].tolist()):
            for plant in plants:
                linear_plant = plant(v, mu)
                if plant not in sampled_plants or not _are_equal(linear_plant, sampled_plants[plant][0]):
                    sampled_plants[plant] = linear_plant, modulus_margin(linear_plant, law, angles)
            least[i, j] = np.min([margin for _, margin in sampled_plants.values()], axis=0)
    return least.reshape([len(axis) for axis in axes])


def _are_equal(first: Sampled, other: Sampled) -> bool:
    """Whether two linear plants are equal up to rounding errors of their linearisation."""
    return bool(
        np.allclose(first.a, other.a, rtol=1e-7, atol=1e-9) and np.allclose(first.b, other.b, rtol=1e-7, atol=1e-9)
    )


def loop_map(
    plant: Plant, mpc: MPC, profile: str | Profile = "road", *, speed: tuple[float, float] = (2.0, 30.0),
    friction: tuple[float, float] = (0.3, 1.0), nodes: Sequence[ArrayLike] | None = None,
    turn: Turn | None = hard_turn,
) -> tuple[tuple[Array, ...], Array]:  # fmt: skip
    """Return the margin table of a guard.

    A guard is the safety layer of a scheduler that replaces tunings with small stability margins. The table contains
    1 - m with the smaller modulus margin m of straight driving and the turn, rounded up to 0.001, for linear
    interpolation. A value of 1 is the stability limit. It predicts failed drives better than the spectral radius, which
    is also large for slow but well damped modes.

    Parameters
    ----------
    plant, profile
        The true car, its true steering, dead time and sensors, and the mean ages of its samples.
    mpc
        Controller; its own tuning is ignored.
    speed, friction
        Lowest and highest speed (m/s) and friction coefficient.
    nodes
        Values of Np, Nc and log10 R/Q; None for `guard_nodes`. A node with Nc > Np is computed with Nc = Np.
    turn
        Function that returns the lateral acceleration (m/s^2) of the turn for a speed (m/s) and a friction. None for
        straight driving only.

    Returns
    -------
    axes, values
        Axes of the grid (speed, friction, Np, Nc, log10 R/Q) and the table.
    """
    tuning_nodes = guard_nodes(mpc) if nodes is None else nodes
    axes = (speed_nodes(*speed), np.array(friction), *(np.asarray(axis, dtype=np.float64) for axis in tuning_nodes))
    least = margin_map(mpc, linear_plants(plant, mpc.period, profile, turn), axes, ages=SampleAges.of(profile))
    return axes, np.ceil(1000.0 * (1.0 - least)) / 1000.0
