"""A result as JSON: what it holds by name, in one strict object."""

from __future__ import annotations

import json

from adaptrack.base.result import Result, strict


def to_json(result: Result) -> str:
    """The record of a result as one line of strict JSON: null for what is not finite."""
    return json.dumps(strict(result.record), allow_nan=False)
