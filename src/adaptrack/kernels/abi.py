"""What every kernel agrees on: compiler options, exact multiply-add, where compiled code is cached.

Rules of the room
-----------------
* Kernels take and return floats and C-contiguous arrays; they never allocate in a loop and never raise.
* Arithmetic is strict IEEE double precision: no re-association and no implicit contraction. Where a fused
  multiply-add is wanted it is written, `fma(a, b, c)`. So a run gives the same bits alone or in a batch.
* `ROUTINE` functions are compiled once for a fixed signature and cached on disk; `INLINE` functions are small
  formulas that the optimiser must see through, because the loops that call them are vectorised over lanes.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections import namedtuple
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import config as _numba_config
from numba.extending import intrinsic

INLINE: dict[str, Any] = {"nogil": True, "error_model": "numpy", "forceinline": True, "_nrt": False}
"""Options of the small formulas that are always inlined. Without numba's run-time (`_nrt`) nothing can be allocated,
and no array is counted in and out of a call."""

ROUTINE: dict[str, Any] = {"nogil": True, "error_model": "numpy", "cache": True, "_nrt": False}
"""Options of the routines that are compiled once and loaded from the cache."""

INLINED_ROUTINE: dict[str, Any] = {**ROUTINE, "forceinline": True}
"""A routine that Python calls and that kernels inline: handing a workspace of many arrays on costs time."""

float64 = types.float64
int64 = types.int64
vector = types.Array(types.float64, 1, "C")
matrix = types.Array(types.float64, 2, "C")
cube = types.Array(types.float64, 3, "C")
int_vector = types.Array(types.int64, 1, "C")
int_matrix = types.Array(types.int64, 2, "C")


def _fma_in_python(a: float, b: float, c: float) -> float:
    """``a*b + c``, rounded twice: what `fma` does when the compiler is switched off."""
    return a * b + c


if _numba_config.DISABLE_JIT:
    fma = _fma_in_python
else:

    @intrinsic
    def fma(typingctx, a, b, c):
        """``a*b + c`` with a single rounding (IEEE 754-2008, section 5.4.1)."""
        signature = types.float64(types.float64, types.float64, types.float64)

        def codegen(context, builder, signature, args):
            a, b, c = (
                value if isinstance(value.type, ir.DoubleType) else builder.sitofp(value, ir.DoubleType())
                for value in args
            )
            return builder.fma(a, b, c)

        return signature, codegen


def record(name: str, fields: Iterable[str]) -> Any:
    """A named tuple class: how a kernel receives many values under their names.

    It belongs to the module that asks for it: the compiler's cache finds a class again by module and name.
    """
    return namedtuple(name, list(fields), module=sys._getframe(1).f_globals["__name__"])


def cache_directory() -> Path:
    """Where compiled kernels are kept: named by a hash of every kernel source and of numba's version.

    Numba re-compiles a function when *its own* file changes, not when a file that it inlines changes; a
    directory per version of the sources is what keeps yesterday's physics out of today's run.
    The base is ``$NUMBA_CACHE_DIR``, else ``$XDG_CACHE_HOME``, else ``~/.cache``.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode())
        digest.update(source.read_bytes())
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "adaptrack" / f"kernels-{digest.hexdigest()[:16]}"


PLANT_PARAMETERS = (
    # body
    "mass",  # kg
    "yaw_inertia",  # kg m^2
    "lf",  # m, centre of gravity to front axle
    "lr",  # m, centre of gravity to rear axle
    "track_front",  # m
    "track_rear",  # m
    "cg_height",  # m
    "load_transfer_time",  # s, first-order lag from acceleration to wheel load
    # air
    "frontal_area",  # m^2
    "air_density",  # kg/m^3
    "drag_coefficient",  # -
    "side_force_slope",  # 1/rad, side-force coefficient per relative wind angle
    "yaw_moment_slope",  # 1/rad
    "wind_angle_limit",  # rad, both coefficients stay constant beyond it
    # powertrain
    "rolling_resistance",  # -
    "engine_power",  # W
    "traction_limit",  # N, wheel-force limit of the drivetrain
    "brake_limit",  # N
    "drive_front",  # share of the traction on the front axle, 0..1
    "brake_front",  # share of the braking on the front axle, 0..1
    # tyre
    "tyre_linear",  # 1 linear, 0 Magic Formula
    "stiffness_front",  # N/rad per tyre at the nominal load
    "stiffness_rear",  # N/rad per tyre at the nominal load
    "nominal_load",  # N
    "stiffness_load_0",  # stiffness(F_z)/stiffness = (s0 + s1 q)/(1 + s2 q^2), q = F_z/nominal_load
    "stiffness_load_1",
    "stiffness_load_2",
    "shape",  # Magic Formula C
    "curvature",  # Magic Formula E
    "friction_load_sensitivity",  # D = mu F_z (1 - d (q - 1))
    "relaxation_length",  # m, 0: none
    # steering actuator
    "steering_lag",  # s, 0: none
    "steering_rate",  # rad/s, inf: none
    "steering_limit",  # rad
)
"""The plants' packed parameters, in this order; a user's plant packs its own record behind its own names."""
