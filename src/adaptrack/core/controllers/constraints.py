"""The rows of eqs. (13) to (16), M dU <= gamma, and the bounds on their right side.

Four rows a sample: the move, its negative, the angle (the sum of moves), its negative. In this order the rows of a
shorter control horizon are the leading block of a longer one's, so they are written once. Behind them two rows an
output, of eq. (15).
"""

from __future__ import annotations

from ..kernel import boolean, exported, inlined, int64, matrix, record, vector, viewer, void
from ..maths import vectors

Sample = record("Sample", ("move", "move_back", "angle", "angle_back"))
"""The four rows of a sample, or their bounds: its move and the angle after it, each to the left and to the right."""
sample_at = viewer(Sample)
Output = record("Output", ("above", "below"))
"""The two rows of an output, or their bounds."""
output_at = viewer(Output)
SAMPLE_ROWS, OUTPUT_ROWS = len(Sample._fields), len(Output._fields)
"""Of a sample, and of an output."""


@exported(void(int64, int64, boolean, matrix, matrix))
def limit_rows(samples, columns_of_e, laguerre, moves, rows):
    """Write M of eq. (16) for eqs. (13), (14), transposed: rows (columns, >= 4 samples)."""
    for c in range(columns_of_e):
        angle = 0.0
        for i in range(samples):
            move = moves[c, i] if laguerre else (1.0 if c == i else 0.0)
            angle += move
            row = sample_at(rows[c], SAMPLE_ROWS * i)
            row.move, row.move_back, row.angle, row.angle_back = move, -move, angle, -angle


@exported(void(int64, int64, int64, boolean, vector, matrix, matrix))
def output_rows(first, horizon, columns_of_e, laguerre, step, phi, rows):
    """Add to M of eq. (16) the soft eq. (15): y_j - s <= y_max, -y_j - s <= -y_min, s the column after the moves."""
    for j in range(horizon):
        at = first + OUTPUT_ROWS * j
        for c in range(columns_of_e):
            effect = phi[c, j] if laguerre else (step[j - c] if j >= c else 0.0)
            row = output_at(rows[c], at)
            row.above, row.below = effect, -effect
        row = output_at(rows[columns_of_e], at)
        row.above, row.below = -1.0, -1.0


@inlined
def clear_end(size, values):
    """Zero what a larger problem, perhaps one that was not finite, has left in the padding of a vector."""
    b = size // vectors.VECTOR_WIDTH * vectors.VECTOR_WIDTH
    if b < size:
        vectors.store(values, b, vectors.keep_first(vectors.load(values, b), size - b))


@inlined
def clear_ends(count, size, values):
    """`clear_end` of so many rows."""
    b = size // vectors.VECTOR_WIDTH * vectors.VECTOR_WIDTH
    if b < size:
        for i in range(count):
            vectors.store(values, i, b, vectors.keep_first(vectors.load(values, i, b), size - b))


@inlined
def bound_moves(samples, angle, settings, bounds):
    """Write gamma of eq. (16) for eqs. (13), (14), from the last angle (rad) on."""
    for i in range(vectors.VECTOR_WIDTH // SAMPLE_ROWS):
        sample = sample_at(bounds, SAMPLE_ROWS * i)
        sample.move, sample.move_back = settings.move_max, -settings.move_min
        sample.angle, sample.angle_back = settings.angle_max - angle, angle - settings.angle_min
    for b in range(vectors.VECTOR_WIDTH, SAMPLE_ROWS * samples, vectors.VECTOR_WIDTH):
        vectors.store(bounds, b, vectors.load(bounds, 0))


@inlined
def leave_to_free_moves(samples, moves, bounds):
    """Take moves (rad) that are made in any case out of the bounds: the rest is for those in which the QP is free."""
    total = 0.0
    for i in range(samples):
        sample, move = sample_at(bounds, SAMPLE_ROWS * i), moves[i]
        total += move
        sample.move -= move
        sample.move_back += move
        sample.angle -= total
        sample.angle_back += total


@inlined
def bound_outputs(first, horizon, settings, reference, error, bounds):
    """Write gamma of eq. (16) for eq. (15); reference, error: R_s and R_s - F x~."""
    for j in range(horizon):
        response = reference[j] - error[j]  # F x~
        output = output_at(bounds, first + OUTPUT_ROWS * j)
        output.above, output.below = settings.output_max - response, response - settings.output_min
    clear_end(first + OUTPUT_ROWS * horizon, bounds)
