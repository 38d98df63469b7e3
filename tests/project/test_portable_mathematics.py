"""Which functions of libraries the package may call: those that give the same bits on every processor, but for a table.

NumPy chooses the code of its elementary functions by the vector unit, BLAS and LAPACK the order of their sums, and the
C library whether it fuses a product with a sum: `core.maths.portable` has the kernels' own. `test_processors.py`
compares.
"""

import ast
from pathlib import Path

import adaptrack

SOURCE = Path(adaptrack.__file__).parent
MATH = """
ceil copysign degrees floor frexp inf isclose isfinite isinf isnan nan nextafter pi prod radians remainder sqrt tau
"""
"""Of `math`: exact, or rounded once."""
SHAPES = """
__version__ all allclose any append arange argmax argmin argsort argwhere array array_equal asarray
ascontiguousarray atleast_1d atleast_2d block bool_ broadcast_arrays broadcast_shapes broadcast_to can_cast clip
column_stack complex128 concatenate copyto count_nonzero diag diag_indices_from dtype empty empty_like equal
errstate eye finfo flatnonzero float32 float64 floating frombuffer full full_like generic hstack imag indices
inf insert int64 int8 integer intp iscomplexobj isfinite isin isinf isnan isnat isneginf ix_ less lexsort
linalg.LinAlgError ma.MaskedArray ma.getmaskarray ma.masked_invalid max maximum maximum.accumulate
maximum.reduceat meshgrid min minimum minimum.accumulate moveaxis nan nan_to_num nanmax nanmin ndarray ndim
ndindex newaxis nonzero object_ ones ones_like pad pi ptp ravel ravel_multi_index real record repeat roll searchsorted
setdiff1d shape sign size sort split stack swapaxes take_along_axis tile tril uint64 uint8 union1d unique
unravel_index vstack where zeros zeros_like
"""
"""Of NumPy: types, shapes, choices, comparisons."""
OPERATIONS = """
abs add ceil copysign degrees divide floor gradient interp kron linspace mod multiply outer radians remainder
rint round sqrt square subtract subtract.outer unwrap vander
"""
"""Of NumPy: what is rounded once, or made of it entry by entry."""
SUMS = """
add.reduceat average bincount cumsum diff histogram histogram2d histogram_bin_edges mean median nanmean
nanmedian nanpercentile nansum nanvar percentile quantile std sum trace trapezoid var
"""
"""Of NumPy: sums, whose order is fixed by the array's shape."""
RANDOM = """
random.Generator random.PCG64 random.RandomState random.default_rng
"""
"""Of NumPy: draws; a normal one beyond 3.6 sigma (1 in 4,000) is a logarithm of the C library."""
ALLOWED = {f"np.{name}" for name in (SHAPES + OPERATIONS + SUMS + RANDOM).split()} | {
    f"math.{name}" for name in MATH.split()
}
IMPORTS = {
    "numpy.polynomial.polynomial": "road/table.py",
    "numpy._core._multiarray_umath": "core/library.py",
    # sums and comparisons in the order of the entries
    "scipy.integrate": "identification/drive_identification.py",
    "scipy.ndimage": "identification/log.py",
    "scipy.sparse": "comparison/lane_change.py",
    "scipy.spatial": "paper/adaptation.py road/generate.py",
    "scipy.signal": "drive/signal_statistics.py",
    "scipy": "road/fit.py road/smoothing.py road/speed.py paper/anfis.py",
    # last digits may differ: docs/install.md, "Reproducibility"
    "scipy.linalg": "identification/drive_identification.py",  # block_diag
    "scipy.optimize": "cars/tyre_file.py cars/tyre_fit.py comparison/lane_change.py "
    "identification/drive_identification.py",
    "scipy.stats": "identification/consistency.py paper/operating_points.py",
    "scipy.special": "paper/anfis.py paper/surfaces.py",
}
"""Modules of NumPy and SciPy, and the files that may import from them."""
TRAINING = {"paper/anfis.py", "paper/surfaces.py"}
"""Training of the paper's schedules: BLAS and scikit-learn."""
SPARSE = {"road/smoothing.py", "road/speed.py"}
"""Products of sparse matrices, which SciPy sums in the order of the rows."""
COMPLEX = {
    "core/maths/portable.py", "analysis/stability.py", "road/generate.py", "road/opendrive.py",
    "road/opendrive_lanes.py",
}  # fmt: skip
"""Complex numbers: a product of two is `portable.times`, a magnitude `portable.magnitude`."""

EXACT = {("core/roads/path.py", "math.cos"), ("core/roads/path.py", "_GRID ** j")}
"""Expressions whose value is rounded to few digits, or a whole number."""


def breaches(name: str, text: str) -> list[str]:
    """What a file calls that its processor decides: lines."""
    findings, inner = [], set()
    for node in ast.walk(ast.parse(text)):
        words = ""
        match node:
            case ast.Attribute(value=value):
                inner.add(value)
                words = "" if node in inner else _called(name, _dotted(node))
            case ast.BinOp(op=ast.MatMult()) if name not in TRAINING | SPARSE:
                words = "@ is BLAS: portable.product"
            case ast.BinOp(op=ast.Pow(), left=left, right=right) if not _is_exact(left, right):
                words = "** of a number is the C library's: x * x, portable.square or portable.power"
            case ast.Constant(value=complex()) if name not in COMPLEX:
                words = "NumPy fuses products of complex numbers: portable.times"
            case ast.ImportFrom(module=str(module)):
                words = _imported(name, module)
            case ast.Import(names=aliases):
                words = "".join(_imported(name, alias.name) for alias in aliases if alias.name != "numpy")
        if words and (name, ast.unparse(node)) not in EXACT:
            findings.append(f"{name}:{node.lineno}: {words}")
    return findings


def _dotted(node: ast.expr) -> str:
    """A name with its attributes; what they are of, if it is no name, is `?`."""
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def _called(name: str, path: str) -> str:
    library, _, other_names = path.partition(".")
    if library not in ("np", "math"):
        return f"{path} is BLAS: portable.product" if path.endswith(".dot") else ""
    heads = {f"{library}.{'.'.join(other_names.split('.')[:count])}" for count in (1, 2)}
    trained = name in TRAINING and other_names.startswith("linalg.")
    return "" if heads & ALLOWED or trained else f"{path}: core.maths.portable has it"


def _imported(name: str, module: str) -> str:
    if module in ("cmath", "statistics"):
        return f"{module}: core.maths.portable has it"
    if module in ("numpy.typing", "numpy") or module.split(".")[0] not in ("numpy", "scipy"):
        return ""
    return "" if name in IMPORTS.get(module, "").split() else f"{module}: see IMPORTS"


def _is_exact(left: ast.expr, right: ast.expr) -> bool:
    """Of 2, or of whole numbers that are written out."""
    base = left.value if isinstance(left, ast.Constant) else None
    return base in (2, 2.0) or (isinstance(base, int) and isinstance(right, ast.Constant))


def test_the_package_calls_what_gives_the_same_bits_on_every_processor():
    findings = []
    for file in sorted(SOURCE.rglob("*.py")):
        name = file.relative_to(SOURCE).as_posix()
        if not name.startswith(("core/build/", "core/maths/matrices")):
            findings += breaches(name, file.read_text(encoding="utf-8"))
    assert not findings, "\n".join(findings)


def test_what_a_processor_decides_is_found():
    for line in (
        "np.exp(x)", "math.hypot(1, 2)", "np.linalg.solve(a, b)", "a @ b", "x**2", "10.0**k", "np.einsum('i', a)",
                 "a.dot(b)", "1j * x", "from scipy.linalg import expm", "import cmath", "np.fft.fft(x)",
        "map(math.log, x)",
    ):  # fmt: skip
        assert len(breaches("drive/new.py", line)) == 1, line
    for line in ("2.0**k", "np.sqrt(x)", "math.sqrt(2.0)", "x * x", "portable.exp(x)", "np.maximum.accumulate(x)"):
        assert not breaches("drive/new.py", line), line
