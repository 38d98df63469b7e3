"""The scheduling variables, and the functions of them: a network, a fuzzy system, a table or a number, of D inputs.

Each is packed into an array of whole numbers (`integers`) and one of reals (`numbers`) by the class that holds it, in
the order that `network`, `_sugeno` and `_table` state.
"""

from __future__ import annotations

import math

from ..kernel import columns, exported, float64, inlined, int64, int_matrix, int_vector, matrix, record, shaped, vector
from ..maths.bits import left, right, whole
from ..maths.exact import clip
from ..maths.exponential import exp, log, log1p

VARIABLE_NAMES = ("speed", "y_ref", "friction", "wind", "change", "acceleration", "offset")
VARIABLE_COLUMNS = columns(*VARIABLE_NAMES)


NUMBER, NETWORK, SUGENO, NEAREST, MULTILINEAR = range(5)
"""The kinds of functions; the last two are tables."""

SATURATED_INPUT = 700.0
"""A neuron's input this far below zero gives 1e-304; further, the exponential would overflow."""
MAX_DISTANCE_WIDTHS = 1e150
"""Widths from the centre at which a distance is held, so that its square is a number."""
NEGLIGIBLE = 50.0
"""A rule this much weaker than the strongest, by its logarithm, adds less than rounding does: e^-50 = 2e-22."""

SugenoRecord = record("SugenoRecord", (
    ("inputs", int64), ("functions", int64), ("rules", int64), ("owner", int_vector), ("bell", int_vector),
    ("antecedents", int_matrix), ("inverse_width", vector), ("slope", vector), ("centre", vector),
    ("log_weight", vector), ("slopes", matrix), ("constant", vector),
))  # fmt: skip
"""inputs, functions, rules: their numbers D, M and R; owner, bell (M,): the input of a membership function, and whether
it is a bell; antecedents (R, D): the functions of a rule (-1: any); inverse_width, slope, centre (M,); log_weight
(R,): of a rule; slopes (R, D), constant (R,): its consequent."""
TableRecord = record("TableRecord", (("inputs", int64), ("sizes", int_vector), ("nodes", vector), ("values", vector)))
"""inputs: D; sizes (D,): of the axes; nodes: of one axis after the other; values: at them, the last axis fastest."""

_FUNCTION = float64(vector, int_vector, vector, vector)


@exported(_FUNCTION)
def network(x, integers, numbers, neurons):
    """A feed-forward net with sigmoid hidden layers and one output, eqs. (21)-(23); neurons: scratch.

    integers: whether the output has a ReLU, number of layers, D, width of each layer; numbers: low and span of the
    output, low (D,) and inverse span (D,) of the inputs, then the weights of each neuron and its bias, layer by layer.
    """
    relu, layers, inputs, widths = integers[0], integers[1], integers[2], integers[3:]
    out_low, out_span, low, inverse_span = numbers[0], numbers[1], numbers[2 : 2 + inputs], numbers[2 + inputs :]
    weights = inverse_span[inputs:]
    for i in range(inputs):
        neurons[i] = (x[i] - low[i]) * inverse_span[i]
    width, before, at = inputs, 0, 0
    out = 0.0
    for layer in range(layers):
        next_wide, after = widths[layer], before + width
        for j in range(next_wide):
            out = weights[at + width]
            for i in range(width):
                out += weights[at + i] * neurons[before + i]
            at += width + 1
            if layer < layers - 1:
                neurons[after + j] = 1.0 / (1.0 + exp(min(-out, SATURATED_INPUT)))
        width, before = next_wide, after
    if relu == 1:
        out = max(0.0, out)
    return out_low + out_span * out


@inlined
def _sugeno(integers, numbers):
    inputs, functions, rules = integers[0], integers[1], integers[2]
    owner, bell = 3, 3 + functions
    antecedents = bell + functions
    weights = 3 * functions
    slopes = weights + rules
    constants = slopes + rules * inputs
    return SugenoRecord(
        inputs, functions, rules, integers[owner:bell], integers[bell:antecedents],
        shaped(integers[antecedents : antecedents + rules * inputs], rules, inputs),
        numbers[:functions], numbers[functions : 2 * functions], numbers[2 * functions : weights],
        numbers[weights:slopes], shaped(numbers[slopes:constants], rules, inputs), numbers[constants:],
    )  # fmt: skip


@inlined
def _log_membership(x, m, system):
    """log mu of membership function m, eq. (24)."""
    distance = clip(
        (x[system.owner[m]] - system.centre[m]) * system.inverse_width[m], -MAX_DISTANCE_WIDTHS, MAX_DISTANCE_WIDTHS
    )
    if system.bell[m] == 0:
        return -0.5 * distance * distance
    if distance == 0.0:
        return 0.0
    exponent = 2.0 * system.slope[m] * log(abs(distance))
    return -(max(exponent, 0.0) + log1p(exp(-abs(exponent))))


@exported(_FUNCTION)
def sugeno(x, integers, numbers, work):
    """A first-order Sugeno system, eqs. (24)-(27), its strengths as logarithms up to the normalisation.

    work: M logarithms of memberships, then R of firing strengths.
    """
    system = _sugeno(integers, numbers)
    memberships, strengths = work[: system.functions], work[system.functions :]
    for m in range(system.functions):
        memberships[m] = _log_membership(x, m, system)
    strongest = -math.inf
    for r in range(system.rules):
        strength = system.log_weight[r]
        for d in range(system.inputs):
            m = system.antecedents[r, d]
            if m >= 0:
                strength += memberships[m]
        strengths[r] = strength
        strongest = max(strongest, strength)
    total, weighted = 0.0, 0.0
    for r in range(system.rules):
        if strengths[r] < strongest - NEGLIGIBLE:
            continue
        w = exp(strengths[r] - strongest)
        conclusion = system.constant[r]
        for d in range(system.inputs):
            conclusion += system.slopes[r, d] * x[d]
        total += w
        weighted += w * conclusion
    return weighted / total


@inlined
def _table(integers, numbers):
    inputs = integers[0]
    sizes = integers[1 : 1 + inputs]
    count = 0
    for d in range(inputs):
        count += sizes[d]
    return TableRecord(inputs, sizes, numbers[:count], numbers[count:])


@exported(int64(float64, vector))
def _cell(value, nodes):
    """The last of an axis's ascending nodes, but the very last, that is not above `value`; else the first."""
    low, high = 0, max(nodes.size - 2, 0)
    while low < high:
        middle = (low + high + 1) // 2
        if nodes[middle] <= value:
            low = middle
        else:
            high = middle - 1
    return low


@exported(_FUNCTION, name="nearest_node")
def nearest(x, integers, numbers, work):
    """The value at the nearest node of a table; half way the lower one."""
    table = _table(integers, numbers)
    index, first = 0, 0
    for d in range(table.inputs):
        size = table.sizes[d]
        axis = table.nodes[first : first + size]
        i = _cell(x[d], axis)
        above = i + 1
        if above < size and x[d] - axis[i] > axis[above] - x[d]:
            i = above
        index = index * size + i
        first += size
    return table.values[index]


@exported(_FUNCTION)
def multilinear(x, integers, numbers, work):
    """The multilinear interpolation of a table, held beyond its last nodes; work: 2 D reals."""
    table = _table(integers, numbers)
    cells, parts = work[: table.inputs], work[table.inputs :]
    first = 0
    for d in range(table.inputs):
        size = table.sizes[d]
        axis = table.nodes[first : first + size]
        i = _cell(x[d], axis)
        cells[d] = i
        parts[d] = 0.0
        if size > 1:
            above = i + 1
            parts[d] = clip((x[d] - axis[i]) / (axis[above] - axis[i]), 0.0, 1.0)
        first += size
    value = 0.0
    for corner in range(left(1, table.inputs)):
        index, weight = 0, 1.0
        for d in range(table.inputs):
            up = right(corner, d) & 1
            weight *= parts[d] if up == 1 else 1.0 - parts[d]
            index = index * table.sizes[d] + min(whole(cells[d]) + up, table.sizes[d] - 1)
        if weight > 0.0:
            value += weight * table.values[index]
    return value


@exported(float64(int64, vector, int_vector, vector, vector), name="evaluate_function")
def evaluate(kind, x, integers, numbers, work):
    """The function of `kind` that begins `integers` and `numbers`, at the inputs x (D,); work: scratch."""
    if kind == NETWORK:
        return network(x, integers, numbers, work)
    if kind == SUGENO:
        return sugeno(x, integers, numbers, work)
    if kind == NEAREST:
        return nearest(x, integers, numbers, work)
    if kind == MULTILINEAR:
        return multilinear(x, integers, numbers, work)
    return numbers[0]
