"""The translator of kernels to C."""

import ctypes
import importlib.util
import textwrap
from pathlib import Path

import pytest

from adaptrack.core import kernel
from adaptrack.core.build import c_files, compile
from adaptrack.core.build.sources import kernels_of
from adaptrack.core.build.translate import KernelError, Program

pytestmark = pytest.mark.skipif(kernel.INTERPRETED, reason="kernels are plain Python")

Point = kernel.record("Point", ("x", "y"))
Pair = kernel.record("Pair", (("first", Point), ("numbers", kernel.vector, 2)))
SCOPE = {name: getattr(kernel, name) for name in dir(kernel) if not name.startswith("__")} | {
    "Point": Point, "Pair": Pair, "FACTOR": 3.0,
}  # fmt: skip


def kernel_of(tmp_path, text, signature):
    """The kernel that a text defines as ``f``; functions before it are inlined."""
    file = tmp_path / "snippet.py"
    file.write_text(textwrap.dedent(text), encoding="utf-8")
    scope = dict(SCOPE) | {"__name__": "snippet"}
    exec(compile_text(file), scope)
    return kernel.Exported(scope["f"], "snippet_f", signature)


def compile_text(file: Path):
    return __builtins__["compile"](file.read_text(encoding="utf-8"), str(file), "exec")


def body_of(tmp_path, text, signature):
    return c_files.c_files({"snippet_f": kernel_of(tmp_path, text, signature)})["core"].text


NUMBER = kernel.float64(kernel.float64)
TAKE = """
@inlined
def take(v):
    v[0] += 1.0
    return v[0]

def f(v):
    return """
VECTOR = kernel.float64(kernel.vector)


@pytest.mark.parametrize(("text", "signature", "line", "remedy"), [
    ("def f(x):\n    try:\n        return x\n    except ValueError:\n        return 0.0", NUMBER, 2, "has no Try"),
    ("def f(x):\n    return sum([x, x])", NUMBER, 2, "has no List"),
    ("def f(x):\n    y = x\n    return print(y)", NUMBER, 3, "mark it as `inlined` or `exported`"),
    ("def f(x):\n    return x[0.5]", VECTOR, 2, "use `maths.bits.whole`"),
    ("def f(x):\n    return x**3", NUMBER, 2, "use `maths.exponential.power`"),
    ("def f(x):\n    return x % 2.0", NUMBER, 2, "maths.exact.modulo"),
    ("def f(x):\n    return int(x)", NUMBER, 2, "use `maths.bits.whole`"),
    ("def f(x):\n    if x > 0.0:\n        y = x\n    else:\n        y = Point(x, x)\n    return y", NUMBER, 5,
     "give the second its own name"),
    ("def f(x):\n    n = x.size\n    return float(n << n)", VECTOR, 3, "use `maths.bits.left`"),
    ("def f(x):\n    return x.mean()", VECTOR, 2, "name one of its fields"),
    ("def f(x):\n    p = Point(x, x)\n    p.x = 1.0\n    return p.x", NUMBER, 3, "make a new one"),
    ("def f(x):\n    for i in range(3):\n        x += 1.0\n    else:\n        x = 0.0\n    return x", NUMBER, 2,
     "use a variable"),
    ("def f(x):\n    return x[::2][0]", VECTOR, 2, "write a loop"),
    ("def f(x):\n    d = 1.0\n    for i in range(3, -1, -x.size):\n        d += x[i]\n    return d", VECTOR, 3,
     "a range needs a constant step"),
    ("def f(x):\n    for i in range(3, -1, 0):\n        x[i] = 1.0\n    return x[0]", VECTOR, 2, "not 0"),
])  # fmt: skip
def test_a_kernel_beyond_the_subset_is_refused_with_its_line_and_a_remedy(tmp_path, text, signature, line, remedy):
    with pytest.raises(KernelError, match=rf"snippet\.py:{line}: f: ") as refusal:
        body_of(tmp_path, text, signature)
    assert remedy in str(refusal.value)


@pytest.fixture(scope="module")
def files():
    """All exported kernels as files of C."""
    return c_files.c_files(kernels_of())


def test_every_exported_kernel_translates_and_twice_to_the_same_text(files):
    kernels = kernels_of()
    assert {name: file.text for name, file in c_files.c_files(kernels).items()} == {
        name: file.text for name, file in files.items()
    }
    assert len(files) == len({Path(kernel.function.__code__.co_filename).parent for kernel in kernels.values()})


def test_a_file_depends_on_no_other_file(files):
    alone = {name: kernel for name, kernel in kernels_of().items() if c_files.room_of(kernel) == "qp"}
    assert c_files.c_files(alone)["qp"].text == files["qp"].text


def test_a_record_in_its_place_or_a_new_one_is_a_value(tmp_path):
    text = body_of(
        tmp_path,
        """
        def f(pair, x):
            point = pair.first if x > 0.0 else Point(x, x)
            return point.x
        """,
        kernel.float64(kernel.Place(Pair), kernel.float64),
    )
    assert "_Point point = x > 0.0 ? pair->first : (struct" in text


def test_an_operand_that_writes_is_computed_in_its_turn(tmp_path):
    text = body_of(tmp_path, TAKE + "v[0] + take(v)", VECTOR)
    assert "const double t1 = v.data[0];" in text
    with pytest.raises(KernelError, match="assign it to a variable first"):
        body_of(tmp_path, TAKE + "1.0 if v[0] > 0.0 and v[0] + take(v) > 1.0 else 0.0", VECTOR)


def test_sizes_are_those_of_the_array_when_they_are_asked_for(tmp_path):
    text = body_of(
        tmp_path,
        """
        @inlined
        def first(sizes):
            return sizes[0]

        def f(v):
            sizes = v.shape
            v = v[1:]
            (count,) = v.shape
            return float(sizes[0] + first(v.shape) + count)
        """,
        VECTOR,
    )
    assert "sizes = (struct tuple_int64_t){v.size[0]};" in text
    assert "snippet_first((struct tuple_int64_t){v.size[0]})" in text
    assert "int64_t count = v.size[0];" in text


def test_names_comments_and_docstrings_of_the_source_are_in_the_text(tmp_path):
    text = body_of(
        tmp_path,
        '''
        def f(speed):
            """Three times a speed (m/s)."""
            # the factor of the file
            fast = FACTOR * speed
            return fast
        ''',
        NUMBER,
    )
    assert "/* Three times a speed (m/s). */" in text
    assert "/* the factor of the file */" in text
    assert "static const double FACTOR = 3.0;" in text
    assert "double fast = FACTOR * speed;" in text


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs the compiler of the package ziglang")
def test_a_kernel_that_is_compiled_computes_what_python_computes(tmp_path):
    program = """
    @inlined
    def halves(n):
        return n // 2, n % 2

    def f(v):
        total, steps = 0.0, 0
        for i in range(v.size - 1, -1, -1):
            q, r = halves(i - 2)
            if r == 1:
                continue
            total += v[i] * q + (1.0 if 0 <= i < 2 or i in (3, 5) else 0.5)
            steps += 1
        v[1:3] = total
        x = steps
        x = x / 4
        return max(total, x, 1) + abs(-steps)
    """
    compiled = kernel_of(tmp_path, program, VECTOR)
    files = c_files.c_files({"snippet_f": compiled})
    processor = "x86-64"
    objects, compiled_count = compile.compile_objects(files, processor, tmp_path / "cache")
    assert compiled_count == len(objects)
    assert compile.compile_objects(files, processor, tmp_path / "cache") == (objects, 0)  # nothing is made again
    compile.link(objects, processor, tmp_path / "snippet.so")
    import numpy as np

    numbers, expected = (np.arange(7.0) ** 1.5 for _ in range(2))
    function = ctypes.CDLL(str(tmp_path / "snippet.so")).adaptrack_snippet_f
    function.restype = ctypes.c_double
    answer = function(ctypes.c_void_p(numbers.ctypes.data), ctypes.c_int64(numbers.size))
    assert answer == compiled.function(expected)
    assert np.array_equal(numbers, expected)


def test_an_index_is_checked_where_that_is_asked_for(tmp_path):
    compiled = kernel_of(tmp_path, "def f(v):\n    return v[2]", VECTOR)
    program = Program(checks_indices=True)
    assert "checked_index(2, v.size[0])" in program.kernel(compiled).body
