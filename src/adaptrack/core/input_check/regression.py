"""Comparisons: regressions y = sum b_i x_i + intercept under given hypotheses of b.

Of overlapping windows the squares of what a hypothesis leaves unexplained are summed, over those of the noise; old ones
are forgotten. A mistake is named when it explains what was measured better than every honest value, by a multiple of
twice the logarithm of the likelihood ratio (A. Wald, *Sequential Analysis*, 1947).
"""

from __future__ import annotations

import math

from ..kernel import inlined, local
from ..maths.bits import whole
from ..maths.exponential import exp
from .hypotheses import FIRST, HYPOTHESES
from .record import DELAYS, MISTAKES

MEMORY = 12.0
"""s, after which a window counts 1/e."""
EVIDENCE, SURE, AGAIN = 12.0, 5.0, 2
"""-, see above; where other measurements point there too; looks in a row at which it must be there."""
UNKNOWN = 0.07
"""Standard deviation of what was before the beginning, in the unit of y."""
OVERLAP = 2.0
"""Windows with a delay that share a sample."""
BANKS = 3
"""Of delays: of what is requested as it is, by wheels of a limited rate, by wheels that are thrown about."""
XX, XY, X1, XH, MM, MY, M1, MH, HH, HY, H1 = range(11)
"""Sums of a delay: of what was requested (x), the same with what was before its negative (m), y, 1, and h."""
YY, Y1, ONE = range(3)
"""Sums of no delay, in the last row."""

_square, _full = local(4, 4), local(5)


@inlined
def pass_on(own, which, time):
    """A window more; what is left of those before."""
    left = exp(-time / MEMORY)
    own.seconds[which] += time
    own.count[which] = own.count[which] * left + 1.0
    return left


@inlined
def decide(own, which, honest, usual, mistake, best, overlap, enough, again):
    """Take down the usual honest value, and a mistake that is better by enough; the mistake that is certain."""
    own.usual[which] = usual
    better = (honest - best) / (overlap * max(1.0, best / own.count[which]))
    own.repeated[which] = own.repeated[which] + 1 if better > enough else 0
    if own.repeated[which] >= again:
        own.label[which] = mistake
    return own.label[which]


@inlined
def _misfit(square, row):
    """b' G b of a hypothesis, with -1 for y."""
    b1, b2, b3 = HYPOTHESES[row, 1], HYPOTHESES[row, 2], HYPOTHESES[row, 3]
    return (
        b1 * (b1 * square[0, 0] + 2.0 * (b2 * square[0, 1] + b3 * square[0, 2] - square[0, 3]))
        + b2 * (b2 * square[1, 1] + 2.0 * (b3 * square[1, 2] - square[1, 3]))
        + b3 * (b3 * square[2, 2] - 2.0 * square[2, 3])
        + square[3, 3]
    )


@inlined
def compare(own, which, x1, x2, x3, y, noise, time, overlap, intercept, evidence):
    """Take in a window; 1 + the mistake that is now certain, or 0.

    overlap: windows that share a sample; intercept: its standard deviation, in the unit of y; evidence: that is needed.
    """
    gram, full, square = own.grams[which], _full(), _square()
    full[0], full[1], full[2], full[3], full[4] = x1 / noise, x2 / noise, x3 / noise, y / noise, 1.0 / noise
    left = pass_on(own, which, time)
    for i in range(5):
        for j in range(i, 5):
            gram[i, j] = gram[i, j] * left + full[i] * full[j]
    shrunk = 1.0 / (gram[4, 4] + 1.0 / (intercept * intercept)) if intercept > 0.0 else 0.0
    for i in range(4):
        for j in range(i, 4):
            square[i, j] = gram[i, j] - gram[i, 4] * gram[j, 4] * shrunk
    first, end = FIRST[which], FIRST[which + 1]
    if _misfit(square, first + own.usual[which]) < evidence * overlap:  # no mistake can be better by so much
        own.repeated[which] = 0
        return own.label[which]
    honest, best, usual, mistake = math.inf, math.inf, first, first
    for row in range(first, end):
        each = _misfit(square, row)
        if HYPOTHESES[row, 0] == 0.0:
            if each < honest:
                honest, usual = each, row
        elif each < best:
            best, mistake = each, row
    return decide(own, which, honest, usual - first, whole(HYPOTHESES[mistake, 0]), best, overlap, evidence, AGAIN)


@inlined
def add_delayed(sums, i, left, mean, before, share, y, weight):
    """Take a window into the sums of a delay.

    mean: what was requested; before: the first command as it was before the beginning, of which the share is what is
    left; weight: of a square.
    """
    plus, minus, row = mean + before, mean - before, sums[i]
    row[XX] = row[XX] * left + weight * plus * plus
    row[XY] = row[XY] * left + weight * plus * y
    row[X1] = row[X1] * left + weight * plus
    row[XH] = row[XH] * left + weight * plus * share
    row[MM] = row[MM] * left + weight * minus * minus
    row[MY] = row[MY] * left + weight * minus * y
    row[M1] = row[M1] * left + weight * minus
    row[MH] = row[MH] * left + weight * minus * share
    row[HH] = row[HH] * left + weight * share * share
    row[HY] = row[HY] * left + weight * share * y
    row[H1] = row[H1] * left + weight * share


@inlined
def _parabola(sums, i, against, intercept):
    """(a, b, c) of the misfit a f^2 - 2 b f + c of y = f x + g h + intercept, with a free g; against: for f < 0."""
    row, end = sums[i], sums[BANKS * DELAYS]
    xx, xy, x1, xh = row[XX], row[XY], row[X1], row[XH]
    if against:
        xx, xy, x1, xh = row[MM], row[MY], row[M1], row[MH]
    hh, one, h1 = row[HH] + 1.0 / (UNKNOWN * UNKNOWN), end[ONE] + 1.0 / (intercept * intercept), row[H1]
    hy, y1, scale = row[HY], end[Y1], 1.0 / (hh * one - h1 * h1)
    return (
        xx - scale * (one * xh * xh - 2.0 * h1 * xh * x1 + hh * x1 * x1),
        xy - scale * (one * xh * hy - h1 * (xh * y1 + hy * x1) + hh * x1 * y1),
        end[YY] - scale * (one * hy * hy - 2.0 * h1 * hy * y1 + hh * y1 * y1),
    )


@inlined
def begin_delayed(own, which, sums, y, weight, time):
    """A window more in a comparison with a bank of delays; what is left of those before."""
    left = pass_on(own, which, time)
    row = sums[BANKS * DELAYS]
    row[YY], row[Y1], row[ONE] = row[YY] * left + weight * y * y, row[Y1] * left + weight * y, row[ONE] * left + weight
    return left


@inlined
def compare_delayed(own, which, hypotheses, sums, intercept, loose, against, small, large, sure):
    """1 + the mistake that is now certain, or 0.

    intercept, loose: standard deviations of the intercept, and of that of wheels that are thrown about; against,
    small, large: evidence that is needed for a wrong sign, and for commands that do too little and too much; sure: what
    else is measured makes a mistake likely.
    """
    first, end = FIRST[hypotheses], FIRST[hypotheses + 1]
    least, last = SURE if sure else min(min(against, small), large), own.usual[which]
    factor = HYPOTHESES[first + last // (BANKS * DELAYS), 1]
    a, b, c = _parabola(sums, last % (BANKS * DELAYS), factor < 0.0, intercept)
    if factor * (a * factor - 2.0 * b) + c < least * OVERLAP:
        own.repeated[which] = 0
        return own.label[which]
    honest, best, usual, mistake = math.inf, math.inf, 0, first
    for i in range(BANKS * DELAYS):
        thrown = i >= (BANKS - 1) * DELAYS
        a, b, c = _parabola(sums, i, False, loose if thrown else intercept)
        minus_a, minus_b, minus_c = _parabola(sums, i, True, intercept)
        for row in range(first, end):
            label, factor = HYPOTHESES[row, 0], HYPOTHESES[row, 1]
            if thrown != (label == 1.0 + MISTAKES.command_too_large):
                continue
            if factor < 0.0:
                each = factor * (minus_a * factor - 2.0 * minus_b) + minus_c
            else:
                each = factor * (a * factor - 2.0 * b) + c
            if label == 0.0:
                if each < honest:
                    honest, usual = each, (row - first) * BANKS * DELAYS + i
            elif each < best:
                best, mistake = each, row
    label = whole(HYPOTHESES[mistake, 0])
    enough = small
    if label == 1 + MISTAKES.command_too_large:
        enough = large
    elif sure:
        enough = SURE
    elif label == 1 + MISTAKES.steering_sign:
        enough = against
    return decide(own, which, honest, usual, label, best, OVERLAP, enough, 1 if sure else AGAIN)
