"""Scheduling: from what a car meets to the tuning of its controller, at every step.

* `variables`: the scheduling variables, their units and ranges.
* `functions`: what an entry of the tuning may be: a network, a fuzzy system, a table, a number, or one's own kind.
* `schedule`: schedules as data; `guard`: what makes their output safe to use.
* `files`: schedules by name or file; `document`: what stands in a file; `check`: the contract.

The names are loaded when they are first used: a controller needs the variables alone.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from adaptrack.control.controllers.tuning import ENTRIES, read_tuning

if TYPE_CHECKING:
    from adaptrack.control.scheduling.check import check_scheduler
    from adaptrack.control.scheduling.files import list_schedulers, load_scheduler, made_for
    from adaptrack.control.scheduling.functions import Function, Network, Number, Sugeno, Table, register_function
    from adaptrack.control.scheduling.guard import Guard, StabilityMap
    from adaptrack.control.scheduling.schedule import Constant, Entry, Guarded, Learned, Lookup, Schedule
    from adaptrack.control.scheduling.variables import VARIABLES, SchedulingVariables, reference_preview

_NAMES = {
    "check": ("check_scheduler",),
    "files": ("list_schedulers", "load_scheduler", "made_for"),
    "functions": ("Function", "Network", "Number", "Sugeno", "Table", "register_function"),
    "guard": ("Guard", "StabilityMap"),
    "schedule": ("Constant", "Entry", "Guarded", "Learned", "Lookup", "Schedule"),
    "variables": ("VARIABLES", "SchedulingVariables", "reference_preview"),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "ENTRIES",
    "VARIABLES",
    "Constant",
    "Entry",
    "Function",
    "Guard",
    "Guarded",
    "Learned",
    "Lookup",
    "Network",
    "Number",
    "Schedule",
    "SchedulingVariables",
    "StabilityMap",
    "Sugeno",
    "Table",
    "check_scheduler",
    "list_schedulers",
    "load_scheduler",
    "made_for",
    "read_tuning",
    "reference_preview",
    "register_function",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
