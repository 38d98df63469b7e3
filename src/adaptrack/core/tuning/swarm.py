"""The improved particle swarm of the paper's section III: one equation per routine, on plain arrays.

    begin
    for g in 0 .. G-1:
        evaluate the positions `swarm.x`
        learn
        move, unless g = G-1

Generation 0 is the initial draw, so `particles * G` positions are evaluated. A whole swarm run, and each of its
numbers, depends on the costs, the seed and the stream only: every draw is counted (`random.counted_uniform`).
"""

from __future__ import annotations

import math
from typing import Any

from ..kernel import Place, columns, exported, float64, inlined, int64, matrix, record, several, unpacker, vector, void
from ..layout import allocate
from ..maths.bits import whole
from ..maths.exact import ceil, clip, floor
from ..maths.exponential import exp, power
from ..maths.random import counted_uniform

# -- settings, fixed over a run ---------------------------------------------------------------------------------------
SWARM_SETTING = columns(
    "generations",  # G
    "improved",  # 1: inertia and accelerations by eqs. (19) and (20); 0: the constants w, c1 and c2 (classic)
    "w",  # inertia of the classic swarm
    "w_max", "w_min", "lambda1", "lambda2",  # eq. (19)
    "c1",  # cognitive acceleration, of eq. (20) the initial value
    "c2",  # social acceleration
    "step_1",  # alpha of eq. (20): change of c1 per generation, and minus the change of c2, for g/G <= 20 %
    "step_2", "step_3", "step_4",  # up to 35 %, up to 75 %, after
    "velocity_clamp",  # largest velocity, as a share of the dimension's range
    "smaller", "larger",  # dimensions with x[smaller] <= x[larger] at all times; -1: none
    "spread",  # in the initial draw x[larger] >= spread*x[smaller]
)  # fmt: skip
SPACE = columns("low", "high", "whole", "decades")
"""The search space, (4, dims): bounds of each dimension, 1 where it holds whole numbers, and 1 where a coordinate is
the decimal logarithm of the value that it stands for (its bounds are logarithms too)."""

# -- the swarm --------------------------------------------------------------------------------------------------------
PROGRESS = columns(
    "leader_cost",  # cost of Gb
    "w",  # inertia of the last move, 0 before
    "c1", "c2",  # accelerations of the next move
)  # fmt: skip
Particles = record(
    "Particles",
    (
        ("x", matrix, "particles", "dims"),  # positions, to be evaluated
        ("v", matrix, "particles", "dims"),  # velocities, in units of x per generation
        ("best", matrix, "particles", "dims"),  # Pb, each particle's best position so far
        ("best_costs", vector, "particles"),
        ("leader", vector, "dims"),  # Gb, the best position so far
        ("progress", vector, len(PROGRESS)),
    ),
)


def particles(count: int, dims: int) -> Any:
    """The arrays of a swarm, zero: `begin` fills them."""
    return allocate(Particles, {"particles": count, "dims": dims})


# -- the paper's equations --------------------------------------------------------------------------------------------
@exported(float64(int64, int64, float64, float64, float64, float64))
def inertia(g, G, w_max, w_min, lambda1, lambda2):
    """w of generation g, eq. (19): w_min + exp(w_max - lambda1 (w_max + w_min) g/G) / lambda2."""
    return w_min + exp(w_max - lambda1 * (w_max + w_min) * (g / G)) / lambda2


_alphas = unpacker(record("Alphas", ("up_to_20", "up_to_35", "up_to_75", "after")))


@exported(several(float64, float64)(int64, int64, float64, float64, vector), name="swarm_accelerations")
def accelerations(g, G, c1, c2, steps):
    """(c1, c2) of generation g + 1 from those of generation g, eq. (20); the ranges share ends, the first one wins.

    steps (4,): alpha in the four ranges of g/G, the paper's being 0.05, 0.02, -0.035 and -0.0015; beta = -alpha, so
    that c1 + c2 stays.
    """
    part, alphas = g / G, _alphas(steps)
    if part <= 0.20:
        alpha = alphas.up_to_20
    elif part <= 0.35:
        alpha = alphas.up_to_35
    elif part <= 0.75:
        alpha = alphas.up_to_75
    else:
        alpha = alphas.after
    return c1 + alpha, c2 - alpha


SwarmCoefficients = record("SwarmCoefficients", ("w", "c1", "c2"))
"""Of eq. (18): inertia, cognitive and social acceleration of a generation."""


@inlined
def velocity(v, x, best, leader, by, r1, r2):
    """One dimension of eq. (18): w v + c1 r1 (Pb - x) + c2 r2 (Gb - x); by: `SwarmCoefficients`."""
    return by.w * v + by.c1 * r1 * (best - x) + by.c2 * r2 * (leader - x)


# -- one run ----------------------------------------------------------------------------------------------------------
@exported(float64(float64, float64, float64, float64))
def place_between(low, high, integers, u):
    """The point that u in [0, 1) picks from [low, high]; with `whole`, from its integers, each as likely."""
    if integers > 0.5:
        return min(low + floor(u * (high - low + 1.0)), high)
    return min(low + u * (high - low), high)


@exported(void(vector, matrix, vector))
def repair(settings, space, x):
    """Bring a position (dims,) into the space: clamp it, round what is whole, lower x[smaller] to x[larger]."""
    for d in range(x.size):
        x[d] = clip(x[d], space[SPACE.low, d], space[SPACE.high, d])
        if space[SPACE.whole, d] > 0.5:
            x[d] = floor(x[d] + 0.5)
    smaller, larger = whole(settings[SWARM_SETTING.smaller]), whole(settings[SWARM_SETTING.larger])
    if smaller >= 0:
        x[smaller] = min(x[smaller], x[larger])


@exported(void(int64, matrix, matrix, matrix))
def decode(count, space, x, values):
    """Write the values that the first `count` positions x (.., dims) stand for."""
    _, dims = x.shape
    for i in range(count):
        for d in range(dims):
            values[i, d] = power(10.0, x[i, d]) if space[SPACE.decades, d] > 0.5 else x[i, d]


@exported(void(int64, int64, vector, matrix, Place(Particles)), name="begin_swarm")
def begin(seed, stream, settings, space, swarm):
    """Generation 0: positions uniform in the space, velocities zero, nothing learnt yet.

    Of an ordered pair, x[smaller] is drawn first and x[larger] between spread*x[smaller] and its upper bound.
    """
    count, dims = swarm.x.shape
    smaller, larger = whole(settings[SWARM_SETTING.smaller]), whole(settings[SWARM_SETTING.larger])
    for i in range(count):
        x = swarm.x[i]
        for d in range(dims):
            high = space[SPACE.high, d]
            if d == smaller:
                high = min(high, space[SPACE.high, larger])
            u = counted_uniform(seed, stream, 0, i, d)
            x[d] = place_between(space[SPACE.low, d], high, space[SPACE.whole, d], u)
        if smaller >= 0:
            integers, high = space[SPACE.whole, larger], space[SPACE.high, larger]
            low = min(max(settings[SWARM_SETTING.spread] * x[smaller], space[SPACE.low, larger]), high)
            if integers > 0.5:
                low = ceil(low)
            x[larger] = place_between(low, high, integers, counted_uniform(seed, stream, 0, i, larger))
        swarm.v[i, :], swarm.best[i, :] = 0.0, x
        swarm.best_costs[i] = math.inf
    swarm.leader[:] = swarm.x[0]
    swarm.progress[PROGRESS.leader_cost], swarm.progress[PROGRESS.w] = math.inf, 0.0
    swarm.progress[PROGRESS.c1], swarm.progress[PROGRESS.c2] = settings[SWARM_SETTING.c1], settings[SWARM_SETTING.c2]


@exported(void(vector, Place(Particles)), name="learn_costs")
def learn(costs, swarm):
    """Take in the costs (particles,) of the positions: update every Pb, then Gb.

    Only a strictly lower cost replaces a best one, and of equal costs the first particle's leads. NaN counts as +inf.
    """
    for i in range(costs.size):
        if costs[i] < swarm.best_costs[i]:  # never true for NaN
            swarm.best_costs[i] = costs[i]
            swarm.best[i, :] = swarm.x[i]
    for i in range(costs.size):
        if swarm.best_costs[i] < swarm.progress[PROGRESS.leader_cost]:
            swarm.progress[PROGRESS.leader_cost] = swarm.best_costs[i]
            swarm.leader[:] = swarm.best[i]


@exported(void(int64, int64, int64, vector, matrix, Place(Particles)))
def move(g, seed, stream, settings, space, swarm):
    """Move generation g, whose costs are learnt, to generation g + 1: eq. (18), then the clamps and repairs.

    r1 and r2 are drawn for each particle and dimension. The velocity is clamped before it moves the particle; it
    keeps its value where the position is clamped, rounded or repaired.
    """
    G = whole(settings[SWARM_SETTING.generations])
    c1, c2 = swarm.progress[PROGRESS.c1], swarm.progress[PROGRESS.c2]
    if settings[SWARM_SETTING.improved] > 0.5:
        w = inertia(
            g, G, settings[SWARM_SETTING.w_max], settings[SWARM_SETTING.w_min], settings[SWARM_SETTING.lambda1],
            settings[SWARM_SETTING.lambda2],
        )  # fmt: skip
        following = accelerations(g, G, c1, c2, settings[SWARM_SETTING.step_1 : SWARM_SETTING.step_4 + 1])
        swarm.progress[PROGRESS.c1], swarm.progress[PROGRESS.c2] = following
    else:
        w = settings[SWARM_SETTING.w]
    swarm.progress[PROGRESS.w] = w
    by = SwarmCoefficients(w, c1, c2)
    count, dims = swarm.x.shape
    for i in range(count):
        x, v = swarm.x[i], swarm.v[i]
        for d in range(dims):
            r1 = counted_uniform(seed, stream, g + 1, i, 2 * d)
            r2 = counted_uniform(seed, stream, g + 1, i, 2 * d + 1)
            fastest = settings[SWARM_SETTING.velocity_clamp] * (space[SPACE.high, d] - space[SPACE.low, d])
            v[d] = clip(velocity(v[d], x[d], swarm.best[i, d], swarm.leader[d], by, r1, r2), -fastest, fastest)
            x[d] += v[d]
        repair(settings, space, x)
