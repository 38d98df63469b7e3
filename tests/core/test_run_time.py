"""Users' functions in Python give the same bits compiled by way of C and called back; what is refused says where."""

import math

import numpy as np
import pytest

from adaptrack.core import library, public
from adaptrack.core.kernel import INTERPRETED, float64, vector, void
from adaptrack.core.member import CFunction, UserFunction, _called_back, member
from adaptrack.core.plants.user import layout_of

pytestmark = pytest.mark.skipif(INTERPRETED or not library.can_compile(), reason="needs the compiler for C")
SIGNATURE = void(vector, vector)
GAINS = np.array([0.5, 2.0, -1.0])
work = public.local(3)


def arithmetic(a, out):
    """Powers, quotients and remainders of real numbers."""
    first, second = a
    out[0] = first**2 + second**3
    out[1] = first // second
    out[2] = first % second
    out[3] = abs(first) ** 0.7
    out[4] = -(first**2) if first > second else max(first, 0.0, second)


def elementary(a, out):
    """Functions of `math`."""
    x, y = a[0], a[1]
    out[0] = math.sin(x) + math.cos(y) * math.tan(x)
    out[1] = math.atan2(x, y) + math.atan(x) + math.asin(math.sin(x)) + math.acos(math.cos(y))
    out[2] = math.exp(math.sin(x)) + math.log(abs(x) + 1e-3) + math.log1p(abs(y)) + math.expm1(math.cos(x))
    out[3] = math.sinh(math.sin(x)) + math.tanh(y) + math.log2(abs(y) + 1.0) + math.log10(abs(x) + 1.0)
    out[4] = math.sqrt(abs(x)) + math.degrees(x) - math.radians(y) + np.floor(x) + np.abs(y) + math.fmod(x, 0.3)


def kernels(a, out):
    """Functions of `core.public`."""
    out[0] = public.sin(a[0]) + public.atan2(a[0], a[1])
    out[1] = public.fma(a[0], a[1], -a[0] * a[1])
    out[2] = public.exp(-abs(a[0]))


def helper(x, scale=2.0):
    """A plain function of Python."""
    return scale * x


def loops(a, out):
    """Loops, local memory, plain functions, numbers and arrays of the file."""
    room = work()
    for i in range(GAINS.size):
        room[i] = GAINS[i] * a[i % 2]
    total = 0.0
    for value in room:
        total += helper(value)
    count = 0
    while count < 3 and total < 1e6:
        total, count = helper(total, 3.0), count + 1
    out[:] = total
    out[0], out[1] = float(count), math.pi * total


def pair(x, y):
    """A list that is returned."""
    both = []
    both.append(x)
    both.append(2.0 * y)
    return both


def lists(a, out):
    """Lists of real numbers, and arrays of a known size."""
    room = np.zeros(3)
    parts = [a[0], a[1], 1]
    if a[0] > 0.0:
        parts = [a[1], 0.5]
        parts.append(a[0] * a[1])
    numbers = pair(parts[0], parts[2])
    for i in range(len(numbers)):
        room[i] = numbers[i]
    out[0], out[1], out[2] = room[0], room[1], float(len(parts))


def samples():
    rng = np.random.default_rng(3)
    return np.concatenate([rng.normal(size=(300, 2)), 10.0 ** rng.uniform(-5, 5, (300, 2)), [[0.0, 0.0], [-0.0, 1.0]]])


@pytest.mark.parametrize("function", [arithmetic, elementary, kernels, loops, lists])
def test_a_function_gives_the_same_bits_compiled_and_called_back(function):
    compiled = member(function, SIGNATURE)
    assert not compiled.calls_python
    call = _called_back(compiled)
    for values in samples():
        ours, theirs = np.zeros(5), np.zeros(5)
        compiled(values, ours)
        call(values.ctypes.data, values.size, theirs.ctypes.data, theirs.size)
        assert ours.tobytes() == theirs.tobytes(), (values, ours, theirs)


def test_nested_parameters_are_a_record():
    def plant(x, p, out):
        out[0] = p.body.mass * x[0] + p.tyres.front.stiffness

    layout = layout_of({"body": {"mass": 2.0}, "tyres": {"front": {"stiffness": 1.0}}})
    compiled, out = member(plant, void(vector, vector, vector), viewed=layout), np.zeros(1)
    compiled(np.array([3.0]), np.array([2.0, 5.0]), out)
    assert out[0] == 11.0


def test_a_function_that_returns_nothing_answers_zero_and_another_one_its_number():
    def nothing(a, out):
        out[0] = a[0]

    def number(a, out):
        return a[0]

    signature = float64(vector, vector)
    assert member(nothing, signature)(np.ones(1), np.zeros(1)) == 0.0
    assert member(number, signature)(np.ones(1), np.zeros(1)) == 1.0


def refused(function, signature=SIGNATURE):
    with pytest.raises(RuntimeError) as raised:
        member(function, signature)
    return str(raised.value)


def test_what_is_outside_the_subset_is_refused_with_file_line_and_remedy():
    def numpy_cosine(a, out):
        out[0] = np.cos(a[0])

    def allocates(a, out):
        out[0] = np.zeros(a.size)[0]

    def returned():
        return np.zeros(3)

    def returns_an_array(a, out):
        out[0] = returned()[0]

    def comprehension(a, out):
        out[0] = sum([x for x in a])

    def raises(a, out):
        raise ValueError

    def word(a, out):
        out[0] = "fast"

    def unknown(a, out):
        out[0] = no_such_name  # noqa: F821

    def prints(a, out):
        print("once")

    def three(a, b, out):
        out[0] = a[0]

    texts = {
        numpy_cosine: "use math.cos", allocates: "take a shape that is known",
        returns_an_array: "write to one of the caller's arrays", comprehension: "ListComp",
        raises: "write math.nan", word: "'fast' is not a number", unknown: "no_such_name",
        prints: "print is not in the subset", three: "has the arguments (a, b, out): it is called with 2",
    }  # fmt: skip
    for function, text in texts.items():
        message = refused(function)
        assert text in message
        assert message.startswith(f"{__file__}:{function.__code__.co_firstlineno}") or f"{__file__}:" in message


def test_a_function_whose_source_cannot_be_read_is_called_back():
    scope = {}
    exec("def f(a, out):\n    out[0] = 2.0 * a[0]", scope)
    function, out = member(scope["f"], SIGNATURE), np.zeros(1)
    function(np.array([4.0]), out)
    assert function.calls_python
    assert out[0] == 8.0


def test_a_library_is_compiled_once_and_again_when_the_function_changes(monkeypatch, tmp_path):
    from adaptrack.core.build import run_time

    monkeypatch.setattr(run_time, "folder", lambda: tmp_path)

    def compile_text(factor):
        (tmp_path / "mine.py").write_text(f"def f(a, out):\n    out[0] = {factor} * a[0]\n")
        scope, file = {}, str(tmp_path / "mine.py")
        exec(compile((tmp_path / "mine.py").read_text(), file, "exec"), scope)
        function, out = UserFunction(scope["f"], SIGNATURE), np.zeros(1)
        function(np.ones(1), out)
        return out[0], len(list(tmp_path.glob("*.so")))

    assert compile_text("2.5") == (2.5, 1)
    assert compile_text("2.5") == (2.5, 1)
    assert compile_text("13.5") == (13.5, 2)


def test_a_function_in_c_is_no_matter_of_the_compiler(monkeypatch):
    import ctypes.util

    monkeypatch.setattr(library, "can_compile", lambda: False)
    function = member(CFunction(ctypes.util.find_library("m"), "fabs"), float64(float64))
    assert not function.calls_python
    assert function(-27.0) == 27.0
