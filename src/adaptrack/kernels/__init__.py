"""The numeric kernels: the only room that imports numba. Floats and arrays in, floats and arrays out."""

import sys as _sys

from numba.core import config as _config

from .abi import cache_directory

if not _config.DISABLE_JIT and not cache_directory().exists() and _sys.stderr.isatty():
    print("adaptrack: compiling its kernels, once for this version; about a minute.", file=_sys.stderr)

_users_cache = _config.CACHE_DIR
_config.CACHE_DIR = str(cache_directory())
try:
    # Numba fixes a function's cache location when it decorates it: import every kernel here, once.
    from . import dynamics, elementary, estimation, inference, integrate, loop, prediction, qp, swarm, tuning, tyre
finally:
    _config.CACHE_DIR = _users_cache

__all__ = [
    "cache_directory",
    "dynamics",
    "elementary",
    "estimation",
    "inference",
    "integrate",
    "loop",
    "prediction",
    "qp",
    "swarm",
    "tuning",
    "tyre",
]
