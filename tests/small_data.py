"""A data set and a campaign small enough for a test; every number of the tuning follows the operating point."""

from __future__ import annotations

import numpy as np

from adaptrack.paper.campaign_config import CampaignConfig
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.operating_points import Grid

LEVELS = {"speed": (4.0, 9.0, 15.0, 22.0), "y_ref": (-9.0, 2.0, 12.0), "friction": (0.5, 0.9),
          "wind": (-20.0, 5.0, 30.0)}  # fmt: skip
LIBRARY = np.array([[35, 8, 10.0, 0.01], [50, 3, 0.5, 0.05], [20, 5, 5.0, 0.02], [12, 2, 1.0, 0.09]])
SEARCH = {"Np": [1, 55], "Nc": [1, 18], "Q": [0.1, 10.0], "R": [0.001, 0.1], "decades": False}


def plain(conditions, **arrays) -> DataSet:
    """A data set with these operating points; arrays that are not given are ones, zeros or numbers."""
    n, ones = len(conditions), np.ones(len(conditions))
    defaults = {
        "operating_points": conditions, "costs": ones, "standard_costs": ones, "traces": ones[:, None],
        "landscape": ones[:, None], "library": np.ones((1, 4)), "evaluations": ones, "control_steps": ones,
        "stream": np.arange(n), "mirrored_from": np.full(n, -1), "seed": np.zeros(n),
    }  # fmt: skip
    return DataSet(**(defaults | arrays))


def small(**changes) -> DataSet:
    """72 conditions on a grid; the second tuning of the library is the best on average, the first the paper's."""
    conditions = Grid(**LEVELS).rows()
    speed, y_ref, friction, wind = conditions.T
    costs, entries = 0.1 + 0.01 * speed, (20 + speed, 4 + 4 * friction, 4.0 + 0.2 * y_ref, 0.03 + 0.001 * wind)
    landscape = costs[:, np.newaxis] * np.array([4.0, 1.1, 1.5, 2.0])
    arrays = {
        "tunings": np.column_stack([np.round(entries[0]), np.round(entries[1]), *entries[2:]]),
        "costs": costs, "standard_costs": landscape[:, 0], "traces": costs[:, np.newaxis] * np.array([2.0, 1.0]),
        "landscape": landscape, "library": LIBRARY, "evaluations": np.full(len(conditions), 300),
        "provenance": {"name": "small", "identity": "0123", "settings": {"scenario": "step", "search": SEARCH}},
    }  # fmt: skip
    return plain(conditions, **arrays | changes)


def small_campaign(**changes) -> CampaignConfig:
    """12 operating points, 8 of which are computed, in 4 parts; a second of work."""
    levels = {"speed": (10.0, 20.0), "y_ref": (-4.0, 2.0, 4.0), "friction": (0.8,), "wind": (-5.0, 5.0)}
    settings = {
        "name": "small", "profile": "paper", "scenario": "step", "duration": 3.0, "chunk": 2, "seed": 3,
        "operating_points": {"kind": "grid", **levels}, "swarm": {"particles": 5, "generations": 4},
        "library": {"size": 8, "seed": 1},
    }  # fmt: skip
    return CampaignConfig(**settings | changes)
