"""Learning from tuned operating points, with estimators that work as well on anybody's data.

* `mlp` holds the scikit-learn estimator of small networks, `anfis` the neuro-fuzzy one; what they learn are functions
  of a schedule (`scheduling.functions.network`, `sugeno`).
* `holding` chooses the rows that are held out while one learns.
* `partition` divides an input space into fuzzy rules, by clusters or by a grid.
* `boosting` says how much can be learned from a data set at all.
* `fis` reads and writes the text files of MATLAB's Fuzzy Logic Toolbox.
* `training` makes models of the tuning from a data set of tuned operating points, and says how good they are.

The names are loaded when they are first used: what has been learned runs without scikit-learn.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptrack.learning.anfis import ANFIS
    from adaptrack.learning.fis import read_fis, write_fis
    from adaptrack.learning.mlp import MLP
    from adaptrack.learning.partition import subtractive_clustering
    from adaptrack.learning.training import TARGETS, Trained, train

_HOME = {
    "ANFIS": "anfis",
    "MLP": "mlp",
    "TARGETS": "training",
    "Trained": "training",
    "read_fis": "fis",
    "subtractive_clustering": "partition",
    "train": "training",
    "write_fis": "fis",
}

__all__ = [
    "ANFIS",
    "MLP",
    "TARGETS",
    "Trained",
    "read_fis",
    "subtractive_clustering",
    "train",
    "write_fis",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
