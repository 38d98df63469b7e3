"""Rows of records from objects of Python."""

from __future__ import annotations

import math
from typing import Any


def row_of(kind: Any, source: Any = None, **fields: Any) -> Any:
    """A row of a record of numbers: each field the attribute of that name, NaN where that is missing or None."""
    row = kind.new(1)[0]
    for name in kind.dtype.names:
        value = fields[name] if name in fields else getattr(source, name, None)
        row[name] = (math.nan if kind.kinds[name].name == "float64" else 0) if value is None else value
    return row
