"""Scheduling: from what a car meets to the tuning of its controller, at every step.

* `variables`: the scheduling variables, their units and ranges.
* `functions`: what an entry of the tuning may be: a network, a fuzzy system, a table, a number, or one's own kind.
* `schedule`: schedules as data, by name and in files, the guard that makes their output safe to use, and the contract.

`__init__.pyi` lists the names. They are loaded when they are first used: a controller needs the variables alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
