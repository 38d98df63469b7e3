"""The picture and the notebook form of an object, by its type. The room that draws is loaded when it is needed."""

from __future__ import annotations

import importlib
from typing import Any

_ROOM = "adaptrack.results.presentation"


def figure_of(result: Any, *options: Any) -> Any:
    """The object as a matplotlib figure."""
    return importlib.import_module(_ROOM).figure_of(result, *options)


def html_of(result: Any) -> str:
    """Return the HTML form of an object for a notebook."""
    return str(importlib.import_module(_ROOM).html_of(result))
