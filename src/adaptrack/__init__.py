"""Adaptive model predictive path tracking: tune, learn, check and run the MPC that each condition needs.

`__init__.pyi` lists the public names. They are loaded at first use, so that ``import adaptrack`` costs next to nothing.
"""

from __future__ import annotations

from typing import Any

import lazy_loader

__version__ = "0.4.0"

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in __all__:
        return _load(name)
    message = f"module {__name__!r} has no attribute {name!r}"
    if not name.startswith("_"):
        from adaptrack.base.errors import nearest

        near = nearest(name, __all__)
        message += f". Did you mean {near!r}?" if near else ""
    # Without an object: Python's own suggestion, of tracebacks alone, would repeat this one.
    raise AttributeError(message, name=name, obj=None)
