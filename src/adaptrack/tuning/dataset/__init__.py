"""Data sets of tuned operating points: what campaigns leave, and what learning starts from.

* `data` holds the record itself, its file, and the data sets that have a name.
* `describe` tells what is in one: ranges, optimum, costs, how flat it is.
"""

from adaptrack.tuning.dataset.data import DataSet, list_datasets, load_dataset
from adaptrack.tuning.dataset.describe import TARGETS, describe, flatness

__all__ = ["TARGETS", "DataSet", "describe", "flatness", "list_datasets", "load_dataset"]
