"""The figure and the notebook form of an object. The drawing code is imported when it is first used."""

from __future__ import annotations

import importlib
from typing import Any

_DRAWING_MODULE = "adaptrack.results.presentation"


def figure_of(result: Any, *options: Any) -> Any:
    """Return the matplotlib figure of an object."""
    return importlib.import_module(_DRAWING_MODULE).figure_of(result, *options)


def html_of(result: Any) -> str:
    """Return the HTML form of an object for a notebook."""
    return str(importlib.import_module(_DRAWING_MODULE).html_of(result))
