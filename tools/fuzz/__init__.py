"""Hostile inputs for controllers, tracker and estimators, and what must hold at every step whatever comes in.

    python -m tools.fuzz run --steps 100000 --seed 1     # counts; a failing input is saved as a file
    python -m tools.fuzz replay FILE                     # prints what fails
    python -m tools.fuzz constants --unnoticed           # of exported C libraries, see `constants`
    python -m tools.fuzz speed --steps 100000            # drives of the speed control, see `speed`

A case is a configuration and a list of inputs, both plain numbers and text, drawn from a seed. `targets` says what must
hold; a case that breaks it is cut short and saved.
"""

from tools.fuzz.search import Failed, Found, load, replay, save, search, shortened
from tools.fuzz.targets import TARGETS

__all__ = ["TARGETS", "Failed", "Found", "load", "replay", "save", "search", "shortened"]
