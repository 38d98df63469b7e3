"""The elementary functions of the kernels are right to a unit in the last place, with every special value.

Those without branches are right to a few units.

The oracles: mpmath with 240 bits, whole numbers and fractions, and for what IEEE 754 defines the processor itself.
"""

import ast
import math
import struct
import sys
from fractions import Fraction

import mpmath as mp
import numpy as np
import pytest

from adaptrack.core.kernel import INTERPRETED, float64, fma, vector
from adaptrack.core.maths import bits, exact, fast, trigonometric
from adaptrack.core.member import member
from references import elementary

pytestmark = pytest.mark.kernels


FUNCTIONS = {name: function for name, function in elementary.FUNCTIONS.items() if function.arguments}
ENTRIES = {name: function.kernel for name, function in elementary.FUNCTIONS.items()}
ENTRIES |= {"soft_fma": exact.soft_fma, "whole_fma": exact.whole_fma, "soft_ceil": exact.soft_ceil}
INF, NAN = math.inf, math.nan
ULPS = 4096.0 if INTERPRETED else 1.0  # the interpreter's multiply-add rounds twice: 1e-12 is left
LARGEST, LEAST = sys.float_info.max, 5e-324
SPECIAL = [0.0, LEAST, 2.2250738585072014e-308, 1e-320, 0.5, 1.0, 1.0 + 2.0**-52, 3.0, 2.0**53, LARGEST, INF, NAN]
SPECIAL += [-value for value in SPECIAL]


def same(x, y):
    """Equal to the bit; a NaN is like any other."""
    return (x != x and y != y) or struct.pack("d", x) == struct.pack("d", y)


def any_bits(rng, count):
    return rng.integers(-(2**63), 2**63, count).view(np.float64)


def few_bits(rng, count, exponent):
    """Numbers of three bits: sums of their products are often halfway between two doubles."""
    return rng.integers(-7, 8, count) * 2.0 ** rng.integers(-exponent, exponent, count)


CLASSES = [(name, kind) for name, function in FUNCTIONS.items() for kind in function.arguments]


@pytest.mark.parametrize(("name", "kind"), CLASSES)
def test_no_function_is_off_by_more_than_a_unit_in_the_last_place(name, kind, rng):
    if INTERPRETED and kind == "right angles":
        pytest.skip("the interpreter's multiply-add rounds twice: near a zero of sine nothing is left")
    function = FUNCTIONS[name]
    error, worst = elementary.worst(function, ENTRIES[name], function.arguments[kind](rng, 70))
    assert error <= ULPS, worst


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize(("name", "kind"), CLASSES)
def test_no_function_is_off_by_more_than_nine_tenths_of_a_unit_among_many_arguments(name, kind, rng):
    function = FUNCTIONS[name]
    error, worst = elementary.worst(function, ENTRIES[name], function.arguments[kind](rng, 20000))
    assert error <= 0.9, worst


PI = math.pi
NAMED = {"pi": PI, "pi/2": PI / 2, "pi/4": PI / 4, "3pi/4": 3 * PI / 4, "max": LARGEST, "least": LEAST}
NAMED |= {f"-{name}": -value for name, value in NAMED.items()}
SPECIAL_VALUES = {  # C99, annex F.9: arguments and then the value
    "sin": "0 0, -0 -0, inf nan, -inf nan, nan nan",
    "cos": "0 1, -0 1, inf nan, -inf nan, nan nan",
    "tan": "0 0, -0 -0, inf nan, -inf nan, nan nan",
    "asin": "0 0, -0 -0, 1 pi/2, -1 -pi/2, 2 nan, -1.0000000000000002 nan, inf nan, -inf nan, nan nan",
    "atan": "0 0, -0 -0, inf pi/2, -inf -pi/2, 1 pi/4, -1 -pi/4, max pi/2, nan nan",
    "atan2": """0 -0 pi, -0 -0 -pi, 0 0 0, -0 0 -0, 0 -1 pi, -0 -1 -pi, 0 1 0, -0 1 -0, -1 0 -pi/2, -1 -0 -pi/2,
        1 0 pi/2, 1 -0 pi/2, 1 -inf pi, -1 -inf -pi, 1 inf 0, -1 inf -0, inf 1 pi/2, -inf 1 -pi/2, inf -inf 3pi/4,
        -inf -inf -3pi/4, inf inf pi/4, -inf inf -pi/4, nan 1 nan, 0 nan nan, inf nan nan, nan 0 nan, least max 0,
        max least pi/2, -least -max -pi, least least pi/4, max max pi/4, inf max pi/2, max inf 0""",
    "exp": "0 1, -0 1, inf inf, -inf 0, nan nan, 710 inf, 1e300 inf, -746 0, -1e300 0, -745.13 least",
    "log": "0 -inf, -0 -inf, 1 0, -1 nan, -least nan, inf inf, -inf nan, nan nan",
    "log10": "0 -inf, -0 -inf, 1 0, -1 nan, -least nan, inf inf, -inf nan, nan nan",
    "log1p": "0 0, -0 -0, -1 -inf, -2 nan, inf inf, -inf nan, nan nan, least least",
    "tanh": "0 0, -0 -0, inf 1, -inf -1, 30 1, -1e300 -1, least least, nan nan",
    "hypot": """0 -0 0, -3 0 3, 3 -4 5, inf nan inf, nan -inf inf, -inf 1 inf, nan 1 nan, 0 nan nan, max max inf,
        least 0 least, max 1 max, 1e300 -1e-300 1e300""",
    "power": """0 -3 inf, -0 -3 -inf, 0 -2 inf, -0 -2 inf, 0 -0.5 inf, -0 -0.5 inf, 0 -inf inf, -0 -inf inf, -0 3 -0,
        -0 2 0, 0 3 0, -0 0.5 0, -1 inf 1, -1 -inf 1, 1 nan 1, 1 inf 1, nan 0 1, inf -0 1, -2 0.5 nan, -max 1.5 nan,
        0.5 -inf inf, -0.5 -inf inf, 2 -inf 0, -2 -inf 0, 0.5 inf 0, -0.5 inf 0, 2 inf inf, -2 inf inf, -inf -3 -0,
        -inf -2 0, -inf 3 -inf, -inf 2 inf, -inf 0.5 inf, -inf -0.5 0, inf -1.5 0, inf 1.5 inf, nan 1 nan, 2 nan nan,
        -2 3 -8, -2 2 4, -1 9007199254740992 1, -1 9007199254740991 -1, -1 max 1, 2 max inf, 2 -max 0, 0.5 1e300 0,
        -2 1025 -inf, -2 -1077 -0, 2 -1074 least, 2 least 1, -inf inf inf, 0 inf 0, 0 nan nan, nan inf nan""",
    "fmod": """0 1 0, -0 1 -0, inf 1 nan, 1 0 nan, 1 inf 1, -1 -inf -1, nan 1 nan, 1 nan nan, -6 3 -0, 0 0 nan,
        inf inf nan, nan 0 nan, inf nan nan, max least 0""",
    "modulo": """-1 3 2, 1 -3 -2, 6 -3 -0, -6 3 0, 1 0 nan, -1 inf inf, 1 -inf -inf, 1 inf 1, inf 1 nan, 1 nan nan,
        nan 1 nan, 0 0 nan""",
    "soft_sqrt": "0 0, -0 -0, -1 nan, inf inf, -inf nan, nan nan, 4 2",
    "soft_floor": "-0 -0, 0 0, -0.5 -1, 0.5 0, inf inf, -inf -inf, nan nan",
    "soft_ceil": "-0 -0, 0 0, -0.5 -0, 0.5 1, inf inf, -inf -inf, nan nan",
}


@pytest.mark.parametrize("name", SPECIAL_VALUES)
def test_special_values_are_those_of_the_standard(name):
    for case in SPECIAL_VALUES[name].split(","):
        *arguments, value = (NAMED[word] if word in NAMED else float(word) for word in case.split())
        result = ENTRIES[name](*arguments)
        if INTERPRETED and math.isfinite(value):
            assert result == pytest.approx(value, rel=1e-12, abs=0.0), case
            assert math.copysign(1.0, result) == math.copysign(1.0, value), case
        else:
            assert same(result, value), case


@pytest.mark.parametrize("name", ["sin", "tan", "asin", "atan", "tanh", "soft_sqrt", "cos"])
def test_odd_functions_are_odd_and_the_cosine_even_to_the_last_bit(name, rng):
    function = ENTRIES[name]
    for x in [*any_bits(rng, 300).tolist(), *rng.uniform(-1.0, 1.0, 300).tolist(), *rng.uniform(-50, 50, 300).tolist()]:
        if name == "cos":
            assert same(function(-x), function(x))
        elif name == "soft_sqrt":
            assert math.isnan(function(-x)) or math.isnan(function(x)) or x == 0.0
        else:
            assert same(function(-x), -function(x))


@pytest.mark.compiled
def test_a_ratio_that_has_an_arctangent_has_the_one_that_its_quotient_has(rng):
    function = trigonometric.arctangent_of_ratio
    for y, x in zip((few_bits(rng, 1000, 5)).tolist(), np.exp2(rng.uniform(-1000, 1000, 1000)).tolist(), strict=True):
        y *= x
        with mp.workprec(elementary.PRECISION):
            assert elementary.ulps(function(y, x), mp.atan2(mp.mpf(y), mp.mpf(x))) <= 1.0
    assert function(INF, 1.0) == PI / 2
    assert math.isnan(function(1.0, NAN))
    assert math.isnan(function(NAN, 1.0))


def test_the_remainder_is_exact(rng):
    pairs = list(zip(any_bits(rng, 1000).tolist(), any_bits(rng, 1000).tolist(), strict=True))
    pairs += zip(rng.uniform(-100, 100, 500).tolist(), rng.uniform(-10, 10, 500).tolist(), strict=True)
    pairs += [(x, y) for x in SPECIAL for y in SPECIAL]
    for x, y in pairs:
        if not (math.isfinite(x) and math.isfinite(y) and y != 0.0):
            continue
        x_exact, y_exact = abs(Fraction(x)), abs(Fraction(y))
        expected = math.copysign(float(x_exact - y_exact * (x_exact // y_exact)), x)
        assert same(ENTRIES["fmod"](x, y), expected), (x, y)
        assert same(ENTRIES["modulo"](x, y), x % y), (x, y)


def rounded(exact):
    """The double nearest to a fraction other than zero."""
    try:
        magnitude = float(abs(exact))
    except OverflowError:
        magnitude = INF
    return math.copysign(magnitude, -1.0 if exact < 0 else 1.0)


def hard_cases(rng, count):
    """Triples whose sums cancel, tie, underflow or overflow."""
    a, b = rng.uniform(1.0, 2.0, count), rng.uniform(-2.0, 2.0, count)
    tiny = 2.0 ** rng.integers(-560, -480, count)
    subnormal = rng.integers(-(2**55), 2**55, count) * 2.0**-1074
    yield any_bits(rng, count), any_bits(rng, count), any_bits(rng, count)
    yield a, b, -a * b
    yield a, b, rng.uniform(-4.0, 4.0, count) * 2.0 ** rng.integers(-120, 120, count)
    yield a * tiny, b * tiny, subnormal
    yield few_bits(rng, count, 60), few_bits(rng, count, 60), few_bits(rng, count, 120)
    yield (
        few_bits(rng, count, 20) * 2.0**-530,
        few_bits(rng, count, 30) * 2.0**-530,
        few_bits(rng, count, 20) * 2.0**-1050,
    )
    big = 2.0 ** rng.integers(490, 520, count)
    yield a * big, b * big, rng.uniform(-2.0, 2.0, count) * 2.0 ** rng.integers(1000, 1023, count)
    # next to a sum that cancels, half a unit and a little from a double, and with zeros of both signs
    near = np.nextafter(-a * b, rng.choice([-9.0, 9.0], count))
    yield a, b, rng.choice([1.0, 0.5, 2.0], count) * near
    yield a, few_bits(rng, count, 3), np.where(rng.uniform(size=count) < 0.5, a, b) * 2.0 ** rng.integers(50, 57, count)
    yield a, 1.0 + 2.0 ** -rng.integers(20, 53, count), 2.0 ** rng.integers(-56, 56, count).astype(float)
    signed = rng.choice([0.0, -0.0, 1.0, -3.0], (3, count))
    yield signed[0], signed[1], signed[2]
    yield signed[0] * a, signed[1] * b, -signed[0] * a * signed[1] * b


def test_the_soft_multiply_add_rounds_the_exact_sum_once(rng):
    for triples in hard_cases(rng, 30):
        for a, b, c in zip(*(column.tolist() for column in triples), strict=True):
            if all(map(math.isfinite, (a, b, c))):
                exact = Fraction(a) * Fraction(b) + Fraction(c)
                expected = rounded(exact) if exact != 0 else a * b + c
                assert same(ENTRIES["soft_fma"](a, b, c), expected), (a, b, c)


def check_multiply_adds(rng, count):
    """Every soft multiply-add, one number or eight at a time, against the processor's."""
    soft, careful, eight = exact.soft_fma, exact.careful_fma, exact.soft_fma8

    def same_float(x, y):
        return (x != x and y != y) or (x == y and math.copysign(1.0, x) == math.copysign(1.0, y))

    def first_difference(a, b, c, eighth):
        for i in range(a.size):
            if i % 8 == 0 and i + 8 <= a.size:
                eight(a[i : i + 8], b[i : i + 8], c[i : i + 8], eighth)
            x = fma(a[i], b[i], c[i])
            if not (same_float(x, soft(a[i], b[i], c[i])) and same_float(x, careful(a[i], b[i], c[i]))):
                return float(i)
            if i < a.size // 8 * 8 and not same_float(x, eighth[i % 8]):
                return float(i)
        return -1.0

    first_difference = member(first_difference, float64(vector, vector, vector, vector))
    grid = [column.ravel().copy() for column in np.meshgrid(SPECIAL, SPECIAL, SPECIAL)]
    for triples in [*hard_cases(rng, count), grid]:
        difference = first_difference(*map(np.ascontiguousarray, triples), np.zeros(8))
        assert difference == -1.0, [values[int(difference)] for values in triples]


@pytest.mark.compiled
@pytest.mark.parametrize("count", [50_000, pytest.param(1_600_000, marks=pytest.mark.slow)])
def test_the_soft_multiply_adds_are_those_of_the_processor(count, rng):
    check_multiply_adds(rng, count)


def test_roots_and_whole_numbers_soft_or_not_are_those_of_the_processor(rng):
    sqrt, floor, ceil = exact.sqrt, exact.floor, exact.ceil
    halves, squares = rng.integers(-20, 20, 200) / 2.0, rng.integers(1, 2**26, 200).astype(float) ** 2
    for x in [*any_bits(rng, 2000), *rng.uniform(-(2.0**54), 2.0**54, 500), *halves, *squares, *SPECIAL]:
        x = float(x)
        root = math.sqrt(x) if x >= 0.0 else NAN
        for function, expected in ((sqrt, root), (floor, float(np.floor(x))), (ceil, float(np.ceil(x)))):
            assert same(function(x), expected), x
        assert same(ENTRIES["soft_sqrt"](x), root), x
        assert same(ENTRIES["soft_floor"](x), float(np.floor(x))), x
        assert same(ENTRIES["soft_ceil"](x), float(np.ceil(x))), x


def test_a_whole_number_is_found_in_every_float(rng):
    integer = bits.whole
    for x in rng.uniform(-(2.0**62), 2.0**62, 1000).tolist() + few_bits(rng, 1000, 70).tolist():
        assert integer(x) == (int(x) if abs(x) < 2.0**62 else int(math.copysign(2**62, x)))
    assert [integer(x) for x in (NAN, INF, -INF, 1e300, -0.0, 0.999, -1.5)] == [0, 2**62, -(2**62), 2**62, 0, 0, -1]


def test_a_float_becomes_an_integer_in_one_place_alone(project):
    names = set()
    for path in (project / "src" / "adaptrack" / "core").rglob("*.py"):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            marks = [ast.unparse(decorator).split("(")[0] for decorator in getattr(function, "decorator_list", [])]
            if isinstance(function, ast.FunctionDef) and {"inlined", "exported"} & {*marks}:
                called = {node.func.id for node in ast.walk(function)
                          if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}  # fmt: skip
                names |= {function.name} if "int" in called else set()
    assert names == {"whole", "_word"}  # the second of an integer


def test_bits_make_the_float_that_they_came_from(rng):
    bits_of, float_of = bits.bits_of, bits.float_of
    for x in [*any_bits(rng, 1000).tolist(), *SPECIAL]:
        assert bits_of(x) == struct.unpack("q", struct.pack("d", x))[0] or x != x
        assert same(float_of(bits_of(x)), x)


def test_a_number_is_scaled_by_a_power_of_two():
    scaled = bits.scaled
    assert [scaled(3.0, k) for k in (-1074, 0, 1000, -2044, 2044)] == [3 * LEAST, 3.0, 3 * 2.0**1000, 0.0, INF]


def test_clipping_keeps_what_lies_between_the_bounds(rng):
    clip = exact.clip
    for x in rng.normal(size=200).tolist():
        assert clip(x, -0.5, 0.25) == min(max(x, -0.5), 0.25)
    assert [clip(x, -1.0, 2.0) for x in (INF, -INF)] == [2.0, -1.0]
    assert math.isnan(clip(NAN, -1.0, 1.0))


# -- without branches -------------------------------------------------------------------------------------------------
def compiled(kernel, count=1):
    """A function of so many real numbers, compiled unless kernels are interpreted: its multiply-add rounds once."""
    return kernel if INTERPRETED else member(kernel.function, float64(*[float64] * count))


arctangent, arctangent_of_ratio = compiled(fast.fast_arctangent), compiled(fast.fast_arctangent_of_ratio, 2)
cosine, sine = compiled(fast.fast_cosine), compiled(fast.fast_sine)

CLAIMED = 4e-15  # the relative error that the module promises


def magnitudes(rng, low, high, count):
    """Numbers of both signs, spread evenly over the orders of magnitude from 10**low to 10**high."""
    return (10.0 ** rng.uniform(low, high, count) * rng.choice([-1.0, 1.0], count)).tolist()


def worst_relative_error(ours, libm, arguments):
    return max(abs(ours(x) - libm(x)) / abs(libm(x)) for x in arguments)


def test_the_arctangent_is_that_of_libm_over_every_magnitude(rng):
    near_the_seams = [
        sign * seam * (1.0 + offset)
        for seam in (math.tan(math.pi / 8), 1.0, math.tan(3 * math.pi / 8))
        for offset in np.linspace(-1e-3, 1e-3, 201).tolist()
        for sign in (-1.0, 1.0)
    ]
    arguments = magnitudes(rng, -300, 300, 2000) + magnitudes(rng, -3, 3, 10000) + near_the_seams
    assert worst_relative_error(arctangent, math.atan, arguments) < CLAIMED


def test_the_arctangent_of_a_ratio_divides_as_libm_does(rng):
    for y, x in zip(magnitudes(rng, -8, 8, 3000), np.abs(magnitudes(rng, -8, 8, 3000)).tolist(), strict=True):
        assert arctangent_of_ratio(y, x) == pytest.approx(math.atan2(y, x), rel=1e-14, abs=0)


@pytest.mark.compiled  # the interpreter's multiply-add rounds twice
@pytest.mark.parametrize(
    ("ours", "libm", "shift"), [(sine, math.sin, 0.0), (cosine, math.cos, 0.5)], ids=["sine", "cosine"]
)
def test_sine_and_cosine_are_those_of_libm_below_a_hundred_thousand_radians(ours, libm, shift, rng):
    near_zeros = [(k + shift) * math.pi * (1.0 + 1e-12) for k in range(1, 30000, 17)]
    arguments = magnitudes(rng, -300, 0, 1000) + rng.uniform(-1e5, 1e5, 10000).tolist() + near_zeros
    assert worst_relative_error(ours, libm, arguments) < CLAIMED


def test_sine_and_cosine_are_those_of_libm_within_a_few_turns(rng):
    for x in rng.uniform(-4 * math.pi, 4 * math.pi, 10000).tolist() + magnitudes(rng, -300, 0, 100):
        assert sine(x) == pytest.approx(math.sin(x), rel=0, abs=1e-14)
        assert cosine(x) == pytest.approx(math.cos(x), rel=0, abs=1e-14)


def test_not_a_number_stays_not_a_number():
    assert math.isnan(arctangent(math.nan))
    assert math.isnan(arctangent_of_ratio(1.0, math.nan))


@pytest.mark.compiled
def test_the_sine_of_no_finite_number_is_not_a_number():
    for x in (math.nan, math.inf, -math.inf):
        assert math.isnan(sine(x))
        assert math.isnan(cosine(x))
