"""One weighted regression for every comparison: y = b1 x1 + b2 x2 + b3 x3 + intercept under the given hypotheses.

Each window adds the products of its regressors, divided by its noise, to a Gram matrix; old windows are forgotten. From
it follows the squared misfit of any hypothesis. A mistake is reported when it explains the windows better than every
honest value, by a multiple of twice the logarithm of the likelihood ratio (A. Wald, *Sequential Analysis*, 1947).
"""

from __future__ import annotations

import math

from ..kernel import inlined, local
from ..maths.bits import whole
from ..maths.exact import clip
from ..maths.exponential import exp
from .hypotheses import (
    COMPARED,
    DELAY,
    DELAYS,
    EVIDENCE,
    FIRST,
    FIRST_GRAM,
    GAINS,
    GRAMS_OF,
    HYPOTHESES,
    HYPOTHESIS,
    LEAST_EVIDENCE,
    MISTAKES,
    RULE,
    RULES,
    SURE,
    THROWN,
)

MEMORY = 12.0
"""s, after which a window counts 1/e."""
LOOKS = 2
"""Looks in a row at which there must be enough evidence."""
X1, X2, X3, Y, ONE = range(5)
REGRESSORS = 5
LATE_GAINS = 0.6, 1.6
"""Ratio of the car's turning to that of a steady turn, least and most, where the steering is later than specified."""
LOOSE = 2.5
"""How many times wider the intercept is for wheels that are thrown about."""

_square, _window = local(REGRESSORS, REGRESSORS), local(REGRESSORS)


@inlined
def start_window(memory, comparison, time):
    """Count a window of a comparison; return the share that is left of the earlier ones."""
    left = exp(-time / MEMORY)
    memory.seconds[comparison] += time
    memory.count[comparison] = memory.count[comparison] * left + 1.0
    return left


@inlined
def add_window(gram, left, weight, x1, x2, x3, y):
    """Add a window to the sums of one alternative; weight: the inverse of its noise."""
    window = _window()
    window[X1], window[X2], window[X3], window[Y], window[ONE] = x1, x2, x3, y, 1.0
    for i in range(REGRESSORS):
        for j in range(i, REGRESSORS):
            gram[i, j] = gram[j, i] = gram[i, j] * left + weight * weight * window[i] * window[j]


@inlined
def _eliminate(square, place, spread):
    """Fit the coefficient of a regressor, whose prior has the standard deviation spread, whatever the others are."""
    scale = 1.0 / (square[place, place] + 1.0 / (spread * spread))
    for i in range(REGRESSORS):
        for j in range(REGRESSORS):
            if i != place and j != place:
                square[i, j] -= square[i, place] * square[place, j] * scale


@inlined
def _reduce(memory, comparison, alternative, square):
    """Write the sums of an alternative without its intercept and what was before the first command."""
    gram = memory.grams[FIRST_GRAM[comparison] + alternative]
    for i in range(REGRESSORS):
        for j in range(REGRESSORS):
            square[i, j] = gram[i, j]
    intercept, before = RULES[comparison, RULE.intercept], RULES[comparison, RULE.before]
    if before > 0.0:
        _eliminate(square, X3, before)
    if intercept > 0.0:
        _eliminate(square, ONE, intercept * LOOSE if alternative >= THROWN else intercept)


@inlined
def _misfit(square, row):
    """The squared misfit of a hypothesis."""
    b1, b2, b3 = HYPOTHESES[row, HYPOTHESIS.b1], HYPOTHESES[row, HYPOTHESIS.b2], HYPOTHESES[row, HYPOTHESIS.b3]
    return (
        b1 * (b1 * square[X1, X1] + 2.0 * (b2 * square[X1, X2] + b3 * square[X1, X3] - square[X1, Y]))
        + b2 * (b2 * square[X2, X2] + 2.0 * (b3 * square[X2, X3] - square[X2, Y]))
        + b3 * (b3 * square[X3, X3] - 2.0 * square[X3, Y])
        + square[Y, Y]
    )


@inlined
def _find_best(memory, comparison, hypotheses):
    """Squared misfits of the best honest value, noted in `usual`, and of the best mistake, and the row of this."""
    square = _square()
    first, end, alternatives = FIRST[hypotheses], FIRST[hypotheses + 1], GRAMS_OF[comparison]
    honest, best, mistake = math.inf, math.inf, first
    for alternative in range(alternatives):
        _reduce(memory, comparison, alternative, square)
        for row in range(first, end):
            if not HYPOTHESES[row, HYPOTHESIS.first] <= alternative < HYPOTHESES[row, HYPOTHESIS.end]:
                continue
            misfit = _misfit(square, row)
            if HYPOTHESES[row, HYPOTHESIS.label] > 0.0:
                if misfit < best:
                    best, mistake = misfit, row
            elif misfit < honest:
                honest, memory.usual[comparison] = misfit, (row - first) * alternatives + alternative
    return honest, best, mistake


@inlined
def judge(memory, comparison, hypotheses, factor, sure):
    """Compare all hypotheses; return 1 + the mistake that is now certain, or 0.

    hypotheses: the place of their table in `FIRST`; factor: on the evidence that is needed; sure: whether other
    measurements point to a mistake, so that `SURE` is enough.
    """
    overlap, alternatives, usual = RULES[comparison, RULE.overlap], GRAMS_OF[comparison], memory.usual[comparison]
    square = _square()
    _reduce(memory, comparison, usual % alternatives, square)
    least = SURE if sure else factor * LEAST_EVIDENCE[hypotheses]
    if _misfit(square, FIRST[hypotheses] + usual // alternatives) < least * overlap:  # no mistake can be better by it
        memory.repeated[comparison] = 0
        return memory.label[comparison]
    honest, best, mistake = _find_best(memory, comparison, hypotheses)
    label = whole(HYPOTHESES[mistake, HYPOTHESIS.label])
    sure = sure and label != 1 + MISTAKES.command_too_large
    enough = SURE if sure else factor * HYPOTHESES[mistake, HYPOTHESIS.evidence]
    better = (honest - best) / (overlap * max(1.0, best / memory.count[comparison]))
    memory.repeated[comparison] = memory.repeated[comparison] + 1 if better > enough else 0
    if memory.repeated[comparison] >= (1 if sure else LOOKS):
        memory.label[comparison] = label
    return memory.label[comparison]


@inlined
def honest_misfit(memory, comparison):
    """Squared misfit of the best honest value of a comparison without alternatives, per independent window."""
    square = _square()
    _reduce(memory, comparison, 0, square)
    return _misfit(square, FIRST[comparison] + memory.usual[comparison]) / RULES[comparison, RULE.overlap]


@inlined
def _least_misfit(memory, alternative, least, most, square):
    """The squared misfit of an alternative of the steering with the best gain from `least` to `most`."""
    _reduce(memory, COMPARED.steering, alternative, square)
    both = square[X1, X2] - square[X1, Y]
    gain = clip(-both / square[X1, X1], least, most) if square[X1, X1] > 0.0 else 1.0
    remainder = square[X2, X2] - 2.0 * square[X2, Y] + square[Y, Y]
    return gain * (gain * square[X1, X1] + 2.0 * both) + remainder


@inlined
def late_steering(memory, lag, latest):
    """Compare the delays of the steering up to `latest` (s) with longer ones; return the best longer one, 0: none.

    lag: s, that the models of the wheels add to the delays that are tried. A car that turns much less or more than
    its commands ask for has a different flaw, as has one that the longest delay explains best: it may not turn at all.
    """
    honest, late, delay, square = math.inf, math.inf, 0.0, _square()
    for alternative in range(THROWN):
        total = lag + DELAY * (alternative % DELAYS)
        if total <= latest:
            honest = min(honest, _least_misfit(memory, alternative, GAINS[0], GAINS[-1], square))
            continue
        misfit = _least_misfit(memory, alternative, LATE_GAINS[0], LATE_GAINS[1], square)
        if misfit < late:
            late, delay = misfit, total
    enough = EVIDENCE * RULES[COMPARED.steering, RULE.overlap]
    better = honest - late > enough * max(1.0, late / memory.count[COMPARED.steering])
    memory.late = memory.late + 1 if better and delay < lag + DELAY * (DELAYS - 1.5) else 0
    return delay if memory.late >= LOOKS else 0.0


@inlined
def compare(memory, comparison, x1, x2, x3, y, noise, time):
    """Add a window (s long) to a comparison without alternatives; return 1 + the mistake that is now certain, or 0."""
    left = start_window(memory, comparison, time)
    add_window(memory.grams[FIRST_GRAM[comparison]], left, 1.0 / noise, x1, x2, x3, y)
    return judge(memory, comparison, comparison, 1.0, False)
