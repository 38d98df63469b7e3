"""Controllers on scenarios, side by side.

* `paper` runs the paper's experiment with the comparators that it left out.
"""

from adaptrack.evaluate.paper import Reproduction, best_constant, lookup, quality, reproduce, scheduler

__all__ = ["Reproduction", "best_constant", "lookup", "quality", "reproduce", "scheduler"]
