"""Learning from tuned conditions, with estimators that work as well on anybody's data.

* `anfis` holds the neuro-fuzzy system: its five layers, its training, and the scikit-learn estimator.
* `partition` divides an input space into fuzzy rules, by clusters or by a grid.
* `fis` reads and writes the text files of MATLAB's Fuzzy Logic Toolbox.
"""

from adaptrack.learning.anfis import ANFIS, Sugeno
from adaptrack.learning.fis import read_fis, write_fis
from adaptrack.learning.partition import subtractive_clustering

__all__ = ["ANFIS", "Sugeno", "read_fis", "subtractive_clustering", "write_fis"]
