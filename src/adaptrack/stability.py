"""The closed loop far from its limits: a linear map over one control period, and how stable it is.

The plant is linearised about straight driving at a speed, the controller's law is `PredictionModel.feedback`. What
the controller's own model leaves out (tyre relaxation, steering lag, computation delay) is part of the loop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adaptrack.mpc import MPC, Tuning
from adaptrack.plant import Plant, Profile, load_profile
from adaptrack.prediction import laguerre_basis

Array = NDArray[np.float64]


def linearised(plant: Plant, speed: float, friction: float = 0.9) -> tuple[list[str], Array, Array]:
    """State names, A (n, n) and B (n,) of the plant about straight driving at `speed` (m/s) on `friction`.

    The input is the front-wheel angle; the speed is held. States that take no part (X, the longitudinal ones, the
    slip angles of tyres without relaxation) are left out. By central differences.
    """
    keep = [i for i, name in enumerate(plant.state_names) if name not in ("X", "vx", "felt_ax")]
    x = np.zeros(len(plant.state_names))
    x[3] = speed
    road = np.array([friction] * 4 + [0.0, 0.0])
    h = 1e-6

    def slope(state: Array, steering: float) -> Array:
        return plant.derivative(state, [steering, 0.0], road)[keep]

    columns = []
    for i in keep:
        step = np.zeros_like(x)
        step[i] = h
        columns.append((slope(x + step, 0.0) - slope(x - step, 0.0)) / (2 * h))
    a, b = np.array(columns).T, (slope(x, h) - slope(x, -h)) / (2 * h)
    part = [j for j in range(len(keep)) if np.abs(a[j]).sum() + np.abs(a[:, j]).sum() + abs(b[j]) > 0.0]
    return [plant.state_names[keep[j]] for j in part], a[np.ix_(part, part)], b[part]


def closed_loop(
    plant: Plant, mpc: MPC, speed: float, *, tuning: Tuning | None = None, friction: float = 0.9,
    profile: str | Profile = "paper",
) -> Array:  # fmt: skip
    """The matrix that takes the loop's state from one control instant to the next, with a reference of zero.

    State: the plant's (without X, v_x), the front-wheel angle, the last command, the last measured x_c (4). The
    steering's rate limit plays no part near rest.
    """
    from scipy.linalg import expm

    world = load_profile(profile)
    steering = getattr(plant, "steering", None) or world.steering
    t = tuning or mpc.tuning
    basis = laguerre_basis(t.Np, mpc.moves.terms, mpc.moves.pole) if mpc.moves.kind == "laguerre" else None
    _, k = mpc.model.feedback(max(speed, mpc.speed_floor), t.Np, t.Nc, t.Q, t.R, basis)

    names, a, b = linearised(plant, speed, friction)
    n = len(b)
    measured = np.zeros((4, n))
    for row, name in enumerate(("vy", "psi", "yaw_rate", "Y")):
        measured[row, names.index(name)] = 1.0

    # over one period: plant and wheel angle under a constant command
    flow = np.zeros((n + 2, n + 2))
    flow[:n, :n] = a
    if steering.lag > 0.0:
        flow[:n, n] = b
        flow[n, n], flow[n, n + 1] = -1.0 / steering.lag, 1.0 / steering.lag
    else:
        flow[:n, n + 1] = b
    flow = expm(flow * mpc.period)

    # du = -k [measured - last measured; y], then u = last u + du; the command acts now, or one period later
    change = np.zeros(n + 2 + 4)
    change[:n] = -(k[:4] @ measured + k[4] * measured[3])
    change[n + 2 :] = k[:4]
    command = change.copy()
    command[n + 1] += 1.0
    acting = np.zeros_like(command)
    acting[n + 1] = 1.0
    if not world.delay:
        acting = command
    loop = np.zeros((n + 6, n + 6))
    loop[: n + 1, : n + 1] = flow[: n + 1, : n + 1]
    loop[: n + 1] += np.outer(flow[: n + 1, n + 1], acting)
    if steering.lag <= 0.0:
        loop[n] = acting
    loop[n + 1] = command
    loop[n + 2 :, :n] = measured
    return loop


def spectral_radius(
    plant: Plant, mpc: MPC, speed: float, *, tuning: Tuning | None = None, friction: float = 0.9,
    profile: str | Profile = "paper",
) -> float:  # fmt: skip
    """Largest magnitude of the closed loop's eigenvalues over one control period: below 1 it is stable."""
    matrix = closed_loop(plant, mpc, speed, tuning=tuning, friction=friction, profile=profile)
    return float(np.abs(np.linalg.eigvals(matrix)).max())
