"""Fixed-step Runge-Kutta integration of many vehicles at once, one vehicle per lane.

A *block* holds up to `LANES` vehicles: a flat array of STATES rows of state and INPUTS rows of input, LANES entries
each. The constant row length lets the compiler prove that rows do not overlap, so the loop over lanes becomes
vector instructions. The loop runs over a multiple of `LANE_STEP` lanes: a lane's arithmetic never depends on how
many others ride along, so a run alone and a run in a batch agree to the last bit.
"""

from __future__ import annotations

from numba import types

from .abi import INLINE, ROUTINE, float64, fma, int64, matrix, njit, vector
from .dynamics import INPUTS, PLANT_FUNCTION, SINGLE_TRACK, STATES, dual_track, single_track, unpack
from .maths.elementary import clip
from .tyre import CURVED_MAGIC_FORMULA, LINEAR, MAGIC_FORMULA, tyre_law

LANES = 32
LANE_STEP = 8
BLOCK = (STATES + INPUTS) * LANES
"""Length of a block's array."""
_INPUT = STATES * LANES  # where a block's inputs begin


@njit(**INLINE)
def _step_along(x, h, k):
    """x + h k."""
    return (
        fma(h, k[0], x[0]),
        fma(h, k[1], x[1]),
        fma(h, k[2], x[2]),
        fma(h, k[3], x[3]),
        fma(h, k[4], x[4]),
        fma(h, k[5], x[5]),
        fma(h, k[6], x[6]),
        fma(h, k[7], x[7]),
        fma(h, k[8], x[8]),
        fma(h, k[9], x[9]),
        fma(h, k[10], x[10]),
        fma(h, k[11], x[11]),
        fma(h, k[12], x[12]),
    )


@njit(**INLINE)
def _rk4(derivative, x, u, h, c, law):
    """One step of the classical fourth-order Runge-Kutta method."""
    k1 = derivative(x, u, c, law)
    k2 = derivative(_step_along(x, 0.5 * h, k1), u, c, law)
    k3 = derivative(_step_along(x, 0.5 * h, k2), u, c, law)
    k4 = derivative(_step_along(x, h, k3), u, c, law)
    x = _step_along(x, h / 6.0, k1)
    x = _step_along(x, h / 3.0, k2)
    x = _step_along(x, h / 3.0, k3)
    return _step_along(x, h / 6.0, k4)


@njit(**INLINE)
def _load(z, i):
    return (
        z[i],
        z[LANES + i],
        z[2 * LANES + i],
        z[3 * LANES + i],
        z[4 * LANES + i],
        z[5 * LANES + i],
        z[6 * LANES + i],
        z[7 * LANES + i],
        z[8 * LANES + i],
        z[9 * LANES + i],
        z[10 * LANES + i],
        z[11 * LANES + i],
        z[12 * LANES + i],
    )


@njit(**INLINE)
def _store(z, i, x):
    z[i] = x[0]
    z[LANES + i] = x[1]
    z[2 * LANES + i] = x[2]
    z[3 * LANES + i] = x[3]
    z[4 * LANES + i] = x[4]
    z[5 * LANES + i] = x[5]
    z[6 * LANES + i] = x[6]
    z[7 * LANES + i] = x[7]
    z[8 * LANES + i] = x[8]
    z[9 * LANES + i] = x[9]
    z[10 * LANES + i] = x[10]
    z[11 * LANES + i] = x[11]
    z[12 * LANES + i] = x[12]


@njit(**INLINE)
def _load_input(z, i):
    j = _INPUT + i
    return (
        z[j],
        z[LANES + j],
        z[2 * LANES + j],
        z[3 * LANES + j],
        z[4 * LANES + j],
        z[5 * LANES + j],
        z[6 * LANES + j],
        z[7 * LANES + j],
        z[8 * LANES + j],
    )


@njit(**INLINE)
def _sweep(derivative, block, lanes, substeps, h, c, law):
    for _ in range(substeps):
        for i in range(lanes):
            x = _load(block, i)
            u = _load_input(block, i)
            _store(block, i, _rk4(derivative, x, u, h, c, law))


@njit(types.void(int64, vector, vector, int64, int64, float64), **ROUTINE)
def integrate(kind, p, block, lanes, substeps, h):
    """Advance the first `lanes` vehicles of a block by `substeps` steps of h (s), inputs held.

    kind: SINGLE_TRACK or DUAL_TRACK; p: packed parameters; block: (BLOCK,), see the module. Lanes up to the next
    multiple of LANE_STEP are advanced as well: fill them with a copy of a real lane.
    """
    c = unpack(p)
    law = tyre_law(c)
    lanes = (lanes + LANE_STEP - 1) // LANE_STEP * LANE_STEP
    # the law is a constant in each of these calls: the compiler builds one loop for each and drops the rest
    if kind == SINGLE_TRACK:
        if law == LINEAR:
            _sweep(single_track, block, lanes, substeps, h, c, LINEAR)
        elif law == MAGIC_FORMULA:
            _sweep(single_track, block, lanes, substeps, h, c, MAGIC_FORMULA)
        else:
            _sweep(single_track, block, lanes, substeps, h, c, CURVED_MAGIC_FORMULA)
    else:
        if law == LINEAR:
            _sweep(dual_track, block, lanes, substeps, h, c, LINEAR)
        elif law == MAGIC_FORMULA:
            _sweep(dual_track, block, lanes, substeps, h, c, MAGIC_FORMULA)
        else:
            _sweep(dual_track, block, lanes, substeps, h, c, CURVED_MAGIC_FORMULA)


@njit(types.void(PLANT_FUNCTION, vector, vector, matrix, int64, int64, float64, matrix), **ROUTINE)
def integrate_custom(derivative, p, block, states, lanes, substeps, h, work):
    """The same for a user's plant, one lane after the other.

    derivative: see `dynamics.PLANT_SIGNATURE`; p: its own parameters, the last three of which are the steering
    actuator's lag, rate and limit; states: (LANES, n) its states, the first six copied to the block on return;
    work: (7, >= max(n, 6)) scratch.
    """
    n = states.shape[1]
    own = p[: p.size - 3]
    lag, fastest, limit = p[p.size - 3], p[p.size - 2], p[p.size - 1]
    x, k1, k2, k3, k4 = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
    u, environment = work[5, :2], work[6, :6]
    for i in range(lanes):
        command = clip(block[_INPUT + i], -limit, limit)
        u[1] = block[_INPUT + LANES + i]
        acceleration = block[_INPUT + 2 * LANES + i]
        prescribed = acceleration == acceleration
        for j in range(6):
            environment[j] = block[_INPUT + (3 + j) * LANES + i]
        angle = block[12 * LANES + i] if lag > 0.0 else command
        for _ in range(substeps):
            slope = 0.0
            rise = 0.0
            for stage in range(4):
                reach = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                previous = k1 if stage <= 1 else (k2 if stage == 2 else k3)
                for j in range(n):
                    x[j] = states[i, j] + reach * previous[j] if stage > 0 else states[i, j]
                u[0] = angle + reach * slope
                slope = clip((command - u[0]) / lag, -fastest, fastest) if lag > 0.0 else 0.0
                rise += slope * (h / 6.0 if stage == 0 or stage == 3 else h / 3.0)
                k = k1 if stage == 0 else (k2 if stage == 1 else (k3 if stage == 2 else k4))
                derivative(x, u, environment, own, k)
                if prescribed:
                    k[3] = acceleration
            for j in range(n):
                states[i, j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
            angle += rise
        for j in range(6):
            block[j * LANES + i] = states[i, j]
        block[12 * LANES + i] = angle
