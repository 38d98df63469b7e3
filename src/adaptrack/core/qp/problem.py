"""The quadratic programme in the letters of the paper (eq. 17), the records that cross, and their sizes.

    minimise  1/2 x'E x + x'K   subject to   M x <= gamma,      E symmetric positive definite, n x n.

Arrays
------
M is stored transposed: column j of ``Mt`` (n x m) is row j of M. Every array is C-contiguous float64 (``index``:
int64) and belongs to the caller; nothing is allocated here. Only the leading n (or m) entries count, but the length
of every row and vector is a multiple of 8 (`padded`). What stands in the padding is never part of a result, but it
must be finite (allocate with `aligned`, or zeros); ``lam`` comes back with zeros there. ``gamma[j] = inf`` says that
row j is absent.

Accuracy
--------
E may have a condition number up to 1e12 or so: double precision then loses five digits or more in every
solve. The residual E x + K + M'lam is therefore accumulated in twice the working precision (Dekker 1971; Ogita, Rump
and Oishi 2005, algorithm 4.3) and x is corrected with it until the correction is below 1e-9: the result is the
solution *for the given float64 data* to nearly full precision. With the compiler switched off the fused multiply-add
rounds twice, and the accuracy is that of plain double precision.
"""

from __future__ import annotations

from ..kernel import boolean, columns, cube, float64, inlined, int64, int_vector, matrix, record, several, vector
from ..maths.vectors import padded

SOLVED = 0
CAPPED = 1
INFEASIBLE = 2
NOT_CONVEX = 3
NON_FINITE = 4

CHANGES = 10
"""Changes of the active set, per variable and row, after which the active-set method stops by default."""

Problem = record(
    "Problem", (("n", int64), ("m", int64), ("E", matrix), ("K", vector), ("Mt", matrix), ("gamma", vector))
)
"""n variables, m rows; E (>=n, padded n), K (padded n), Mt (>=n, padded m), gamma (padded m)."""

Factor = record("Factor", (("inverse_root", matrix), ("inverse", matrix), ("condition", float64)))
"""L^-1 (E = L L') and E^-1, each (>=n, padded n), and a bound on the condition number: see `factor.factorise`."""

SolutionRecord = record("SolutionRecord", (("x", vector), ("lam", vector)))
"""x (padded n) and the multipliers of all rows lam (padded m)."""

Scratch = record("Scratch", (("work", cube), ("rows", matrix), ("index", int_vector)))
"""Arrays of the shapes that `workspace_sizes` gives. ``work`` and ``index`` carry the factor of the active rows from
one call of `active_set` to the next; ``rows`` carries nothing."""

ScratchParts = record(
    "ScratchParts",
    (
        ("T", matrix),  # T E T' = I; T N = [R; 0] for the active rows N
        ("inverse_r", matrix),  # row i is column i of R^-1
        ("normals", matrix),  # row i is the i-th active row of M
        ("a", vector),  # the row of M that is to become active
        ("d", vector),  # T a
        ("z", vector),  # step of x per unit of its multiplier
        ("r", vector),  # minus the step of u
        ("u", vector),  # multipliers of the active rows
        ("residual", vector),  # -(K + E x + N u)
        ("step", vector),
        ("active_bounds", vector),  # gamma of the active rows
        ("ratios", vector),  # u/r where r > 0
        ("slack", vector),  # M x - bounds
        ("bounds", vector),  # gamma, or inf while the row is active
        ("diagonal", vector),  # of Hildreth's H
        ("gradient", vector),  # of the dual
        ("index", int_vector),  # the active rows
    ),
)
"""The parts of `Scratch` by name."""
PLANE = columns("T", "inverse_r", "normals", "vectors")
VECTOR = columns("a", "d", "z", "r", "u", "residual", "step", "active_bounds", "ratios")
PROBLEM_ROW = columns("slack", "bounds", "diagonal", "gradient")
"""Where they are. ``work``: three matrices, each a plane, and vectors in n, the rows of the fourth plane; ``rows``:
vectors in m, then Hildreth's V (n rows) and H (m rows)."""
INVERSE = columns("root", "inverse")
"""The planes that `factor.factorise` writes: inverses of the Cholesky factor of E and of E."""

SOLVE = several(int64, int64, int64)(Problem, Factor, SolutionRecord, Scratch, int64, boolean, int64)
HILDRETH = several(int64, int64)(Problem, Factor, SolutionRecord, Scratch, int64, float64, boolean)
"""Signatures of `active_set.active_set` and `hildreth.hildreth`."""

ROW_VECTORS = len(PROBLEM_ROW)


@inlined
def work_of(scratch):
    """The parts of ``scratch`` by name."""
    planes, rows = scratch.work, scratch.rows
    v = planes[PLANE.vectors]
    return ScratchParts(
        planes[PLANE.T], planes[PLANE.inverse_r], planes[PLANE.normals],
        v[VECTOR.a], v[VECTOR.d], v[VECTOR.z], v[VECTOR.r], v[VECTOR.u], v[VECTOR.residual], v[VECTOR.step],
        v[VECTOR.active_bounds], v[VECTOR.ratios],
        rows[PROBLEM_ROW.slack], rows[PROBLEM_ROW.bounds], rows[PROBLEM_ROW.diagonal], rows[PROBLEM_ROW.gradient],
        scratch.index,
    )  # fmt: skip


@inlined
def factor_of(inverses, condition):
    """The `Factor` that `factor.factorise` has written."""
    return Factor(inverses[INVERSE.root], inverses[INVERSE.inverse], condition)


@inlined
def workspace_sizes(n_max, m_max, hildreth):
    """Shapes of the arrays for up to ``n_max`` variables and ``m_max`` rows: both inverses, then ``work``, ``rows`` and
    ``index``. Without ``hildreth`` the m_max x m_max matrix H is left out, which only `hildreth` needs.
    """
    width = padded(n_max)
    return (
        (len(INVERSE), n_max, width),
        (len(PLANE), max(width, len(VECTOR)), width),
        (ROW_VECTORS + (n_max + m_max if hildreth else 0), padded(m_max)),
        max(n_max, m_max),
    )
