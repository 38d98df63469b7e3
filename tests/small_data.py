"""A data set and a campaign small enough for a test; every number of the tuning follows the operating point."""

from __future__ import annotations

import numpy as np

from adaptrack.paper.campaign_config import CampaignConfig
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.operating_points import grid

LEVELS = {
    "speed": (4.0, 9.0, 15.0, 22.0),
    "y_ref": (-9.0, 2.0, 12.0),
    "friction": (0.5, 0.9),
    "wind": (-20.0, 5.0, 30.0),
}
LIBRARY = np.array([[35, 8, 10.0, 0.01], [50, 3, 0.5, 0.05], [20, 5, 5.0, 0.02], [12, 2, 1.0, 0.09]])
SEARCH = {"Np": [1, 55], "Nc": [1, 18], "Q": [0.1, 10.0], "R": [0.001, 0.1], "decades": False}


def small(**changes) -> DataSet:
    """72 conditions on a grid; the second tuning of the library is the best on average, the first the paper's."""
    conditions = grid(**LEVELS)
    speed, y_ref, friction, wind = conditions.T
    costs = 0.1 + 0.01 * speed
    landscape = costs[:, np.newaxis] * np.array([4.0, 1.1, 1.5, 2.0])
    arrays = {
        "operating_points": conditions,
        "tunings": np.column_stack(
            [np.round(20 + speed), np.round(4 + 4 * friction), 4.0 + 0.2 * y_ref, 0.03 + 0.001 * wind]
        ),
        "costs": costs,
        "standard_costs": landscape[:, 0],
        "traces": costs[:, np.newaxis] * np.array([2.0, 1.0]),
        "landscape": landscape,
        "library": LIBRARY,
        "evaluations": np.full(len(conditions), 300),
        "control_steps": np.full(len(conditions), 54000),
        "stream": np.arange(len(conditions)),
        "mirrored_from": np.full(len(conditions), -1),
        "seed": np.full(len(conditions), 1),
        "provenance": {"name": "small", "identity": "0123", "settings": {"scenario": "step", "search": SEARCH}},
    }
    return DataSet(**(arrays | changes))


def small_campaign(**changes) -> CampaignConfig:
    """12 operating points, 8 of which are computed, in 4 parts; a second of work."""
    return CampaignConfig(
        **{
            "name": "small",
            "profile": "paper",
            "scenario": "step",
            "duration": 3.0,
            "chunk": 2,
            "seed": 3,
            "operating_points": {
                "kind": "grid",
                "speed": (10.0, 20.0),
                "y_ref": (-4.0, 2.0, 4.0),
                "friction": (0.8,),
                "wind": (-5.0, 5.0),
            },
            "swarm": {"particles": 5, "generations": 4},
            "library": {"size": 8, "seed": 1},
            **changes,
        }
    )
