"""The noise of the points of a path, and smooth points in their place.

Smooth points q minimise, over points p and the third derivatives c''' of curves through four points of q in a row,

    sum_k |p_k - q_k|^2 + sum_j r_j^6 |c'''_j|^2,

so that waves of a length 2 pi r lose half, and twice as long ones 1/65 (P. Eilers, A perfect smoother, Analytical
Chemistry 75 (2003)). Of noise sigma at steps h, c''' keeps sigma sqrt(h/18) r^-3.5. The radius r makes this a share of
the largest |c'''| within half a wave: long on straights, short in hairpins.

The noise is estimated from the sixth divided differences across the path, in which curves have no part.
"""

from __future__ import annotations

import math

from ..kernel import boolean, columns, exported, float64, inlined, local, matrix, shaped, vector
from ..maths.bits import whole
from ..maths.exact import sqrt, square
from ..maths.exponential import hypot, power

MIN_NOISY_POINTS, NEGLIGIBLE_CURVATURE = 16, 5e-4
"""Points from which noise is estimated; 1/m, noise of the curvature that stays: 0.5 m/s^2 at 30 m/s."""
CURVATURE_NOISE = 4.0
"""Noise of the curvature of a cubic spline through points, over that of the points and the square of their step."""
WHITENESS = -0.5
"""Largest correlation of neighbouring differences of noise: -6/7 if it is white, 0.7 of waves of 8 points."""
MEDIAN, HALVINGS, TINY = 1.4826, 30, 1e-300
"""Standard deviation over the median of absolute values; halvings of the range of the median; least divisor."""
AMPLITUDE, SHARE, MIN_THIRD_DERIVATIVE = 0.057, 0.2, 2e-4
"""sqrt(m), of r^6 |c'''|^2 over sigma sqrt(h); -, of c''', its noise; 1/m^2, less of c''' is negligible: a lateral jerk
of 5 m/s^3 at 30 m/s. Chosen on hairpins, chicanes and lane changes (`benchmarks/noisy_paths.py`)."""
MAX_RADIUS, ROUNDS = 60.0, 4
"""Steps; fits, each with radii that suit the curve of the fit before."""
BANDS = 7
"""Of the equations, with the diagonal."""
_DIFFERENCE = columns("step", "x", "y", "factors", "factor_1", "factor_2", "factor_3")
SMOOTHING_WORDS = 4 + len(_DIFFERENCE) + BANDS + 2
"""Numbers for each point that `smooth_points` needs."""

_three, _six, _seven = local(3), local(6), local(7)


@inlined
def index_on_lap(number, count):
    """Index of a point of a lap of `count` points, for a number from -count to 2 count - 1."""
    return number + count if number < 0 else number - count if number >= count else number


@inlined
def _difference(points, first, steps, factors):
    """Write the factors of the divided difference of points in a row; their mean step (m), and the difference.

    steps: m, from each of these points to the next, of the call for the point before; they are updated.
    """
    count, last, places, x, y = len(points), steps.size, _seven(), 0.0, 0.0
    for j in range(last):
        k, after = index_on_lap(first + j, count), index_on_lap(first + j + 1, count)
        if first > 0 and j < last - 1:
            steps[j] = steps[j + 1]
        else:
            steps[j] = hypot(points[after, 0] - points[k, 0], points[after, 1] - points[k, 1])
        places[j + 1] = places[j] + steps[j]
    for j in range(last + 1):
        k, factors[j] = index_on_lap(first + j, count), 1.0
        for i in range(last + 1):
            factors[j] /= places[j] - places[i] if i != j else 1.0
        x += factors[j] * (points[k, 0] - points[first, 0])
        y += factors[j] * (points[k, 1] - points[first, 1])
    return places[last] / last, x, y


@exported(float64(matrix, boolean, vector))
def noise_of(points, closed, differences):
    """Return the standard deviation (m) of the noise of x and y of points (n, columns), one behind the other.

    0 for few points, for what is no noise but a curve, and for noise that the curvature hardly has. differences: (n,).
    """
    count, steps, factors = len(points), _six(), _seven()
    rows = count if closed else count - steps.size
    products = squares = length = before = low = high = 0.0
    for k in range(rows if count >= MIN_NOISY_POINTS else 0):
        step, dx, dy = _difference(points, k, steps, factors)
        end, size = index_on_lap(k + steps.size, count), 0.0
        for j in range(factors.size):
            size += square(factors[j])
        tx, ty = points[end, 0] - points[k, 0], points[end, 1] - points[k, 1]
        across = (tx * dy - ty * dx) / max(hypot(tx, ty) * sqrt(size), TINY)
        products, squares, length = products + before * across, squares + square(across), length + step
        differences[k], before, high = abs(across), across, max(high, abs(across))
    if not products < WHITENESS * squares:
        return 0.0
    for _ in range(HALVINGS):
        middle, below = 0.5 * (low + high), 0
        for k in range(rows):
            below += 1 if differences[k] <= middle else 0
        low, high = (low, middle) if 2 * below >= rows else (middle, high)
    noise = MEDIAN * high
    return noise if CURVATURE_NOISE * noise > NEGLIGIBLE_CURVATURE * square(length / rows) else 0.0


@inlined
def _row_of(k, count):
    """The row of a point in the equations: there and back in turns, so that those of a lap are a band, too."""
    return 2 * k if 2 * k < count else 2 * (count - k) - 1


@inlined
def _solve(equations, first_coupled):
    """Solve symmetric equations by Cholesky's factors: bands (n, BANDS) from the diagonal down, then right sides.

    Rows before `first_coupled` have entries in every second band alone: those of points from both ends of a line.
    """
    for i in range(len(equations)):
        stride = 2 if i < first_coupled else 1
        count = min(BANDS - 1, i) // stride
        for j in range(count, -1, -1):
            d = j * stride
            entry = equations[i, d]
            for k in range(1, count - j + 1):
                entry -= equations[i, d + k * stride] * equations[i - d, k * stride]
            equations[i, d] = entry / equations[i - d, 0] if d > 0 else sqrt(entry)
        for column in range(BANDS, BANDS + 2):
            entry = equations[i, column]
            for j in range(1, count + 1):
                entry -= equations[i, j * stride] * equations[i - j * stride, column]
            equations[i, column] = entry / equations[i, 0]
    for i in range(len(equations) - 1, -1, -1):
        stride = 2 if i < first_coupled else 1
        count = min(BANDS - 1, i) // stride
        for column in range(BANDS, BANDS + 2):
            equations[i, column] /= equations[i, 0]
            for j in range(1, count + 1):
                equations[i - j * stride, column] -= equations[i, j * stride] * equations[i, column]


@inlined
def _maximum(values):
    """The largest of numbers that are at least 0, four at a time: a chain of comparisons would wait for each."""
    a = b = c = d = 0.0
    whole_fours = values.size - values.size % 4
    for k in range(0, whole_fours, 4):
        a, b, c, d = max(a, values[k]), max(b, values[k + 1]), max(c, values[k + 2]), max(d, values[k + 3])
    for k in range(whole_fours, values.size):
        a = max(a, values[k])
    return max(max(a, b), max(c, d))


@inlined
def smooth_points(points, closed, noise, memory):
    """Smooth points (n, columns) of x, y (m) with some noise (m). memory: `SMOOTHING_WORDS` numbers for each point."""
    count, steps = len(points), _three()
    rows = count if closed else count - steps.size
    x, y = memory[:count], memory[count : 2 * count]  # m, of the points less the smooth ones
    sharpness, radius = memory[2 * count : 3 * count], memory[3 * count : 4 * count]
    differences = shaped(memory[4 * count : (4 + len(_DIFFERENCE)) * count], count, len(_DIFFERENCE))
    equations = shaped(memory[(4 + len(_DIFFERENCE)) * count : SMOOTHING_WORDS * count], count, BANDS + 2)
    x[:], y[:], radius[:] = 0.0, 0.0, 0.0
    for fit in range(ROUNDS):
        equations[:] = 0.0
        equations[:, 0] = 1.0
        for k in range(rows):
            difference = differences[k]
            step, dx, dy = _difference(points, k, steps, difference[_DIFFERENCE.factors :])
            difference[_DIFFERENCE.step], difference[_DIFFERENCE.x], difference[_DIFFERENCE.y] = step, dx, dy
            sharpness[k] = 6.0 * hypot(dx, dy) if fit > 0 else 0.0
        for k in range(rows):
            step, factors = differences[k, _DIFFERENCE.step], differences[k, _DIFFERENCE.factors :]
            dx, dy = differences[k, _DIFFERENCE.x], differences[k, _DIFFERENCE.y]
            near, sharpest = math.pi * radius[k], MIN_THIRD_DERIVATIVE
            reach = whole(near / step) if near < rows * step else rows
            if closed:
                for other in range(k - reach, k + reach + 1):
                    sharpest = max(sharpest, sharpness[other % rows])
            else:
                sharpest = max(sharpest, _maximum(sharpness[max(k - reach, 0) : min(k + reach + 1, rows)]))
            spread = noise * sqrt(step)
            amplitude, share = sqrt(AMPLITUDE * spread) / sharpest, spread / (sqrt(18.0) * SHARE * sharpest)
            is_longer = spread < 1.0 and share * square(share) < 0.999 * amplitude * square(amplitude) * sqrt(amplitude)
            longest = power(amplitude, 1.0 / 3.0)
            radius[k] = min(longest if is_longer else max(longest, power(share, 2.0 / 7.0)), MAX_RADIUS * step)
            weight = square(6.0 * radius[k] * square(radius[k]))
            for i in range(factors.size):
                point = index_on_lap(k + i, count)
                dx, dy = dx + factors[i] * x[point], dy + factors[i] * y[point]
            for i in range(factors.size):
                row = _row_of(index_on_lap(k + i, count), count)
                equations[row, BANDS] += weight * factors[i] * dx
                equations[row, BANDS + 1] += weight * factors[i] * dy
                for j in range(i + 1):
                    other = _row_of(index_on_lap(k + j, count), count)
                    equations[max(row, other), abs(row - other)] += weight * factors[i] * factors[j]
        _solve(equations, 0 if closed else count - BANDS + 1)
        for k in range(count):
            row = _row_of(k, count)
            points[k, 0] += x[k] - equations[row, BANDS]
            points[k, 1] += y[k] - equations[row, BANDS + 1]
            x[k], y[k] = equations[row, BANDS], equations[row, BANDS + 1]
