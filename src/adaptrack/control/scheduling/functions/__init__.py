"""The functions that a schedule is made of, one file per kind behind one contract: `Function`."""

from adaptrack.control.scheduling.functions.function import (
    Function,
    Pool,
    load_function,
    register_function,
    save_function,
)
from adaptrack.control.scheduling.functions.network import Network
from adaptrack.control.scheduling.functions.number import Number
from adaptrack.control.scheduling.functions.sugeno import Sugeno
from adaptrack.control.scheduling.functions.table import Table

__all__ = [
    "Function",
    "Network",
    "Number",
    "Pool",
    "Sugeno",
    "Table",
    "load_function",
    "register_function",
    "save_function",
]
