"""Data sets of tuned conditions: what campaigns leave, and what learning starts from.

* `data` holds the record itself, its file, and the data sets that have a name.
* `describe` tells what is in one: ranges, optimum, how much of it the conditions explain, how flat it is.
"""

from adaptrack.dataset.data import DataSet, list_datasets, load_dataset
from adaptrack.dataset.describe import TARGETS, describe, explained, flatness

__all__ = ["TARGETS", "DataSet", "describe", "explained", "flatness", "list_datasets", "load_dataset"]
