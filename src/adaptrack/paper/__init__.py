"""The paper's experiment, sections III to V in the paper's order; docs/notation.md lists its symbols.

* `operating_points`, `campaign_config`, `campaign`, `data_set`: particle swarms tune the MPC at operating points.
* `regressor`, `mlp`, `anfis`, `training`: networks and neuro-fuzzy models learn the tuning.
* `surfaces`, `improvement`, `adaptation`: schedules learn on the closed loop.
* `evaluation`: these schedules, the best constant and the optimum of each operating point.
* `reproduce`: both tests of the paper with the standard, the NN and the ANFIS controller.

`__init__.pyi` lists the public names. They are loaded at first use: schedules run without scikit-learn.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
