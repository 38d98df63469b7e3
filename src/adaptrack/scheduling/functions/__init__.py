"""The functions that a schedule is made of, one file per kind behind one contract: `Function`."""

from adaptrack.scheduling.functions.function import Function, load_function, register_function, save_function
from adaptrack.scheduling.functions.network import Network
from adaptrack.scheduling.functions.number import Number
from adaptrack.scheduling.functions.sugeno import Sugeno
from adaptrack.scheduling.functions.table import Table

__all__ = [
    "Function",
    "Network",
    "Number",
    "Sugeno",
    "Table",
    "load_function",
    "register_function",
    "save_function",
]
