"""The paper's experiment, sections III to V in the paper's order; docs/notation.md lists its symbols.

* `operating_points`, `campaign_config`, `campaign`, `data_set`: particle swarms tune the MPC at operating points.
* `mlp`, `anfis` with `partition`, `fis`, `training`, `schedules`: networks and neuro-fuzzy models learn the tuning.
* `learning_task`, `landscape`, `surfaces`, `improvement`, `adaptation`: schedules learn on the closed loop.
* `evaluation`: these schedules, the best constant and the optimum of each operating point.
* `reproduce`: both tests of the paper with the standard, the NN and the ANFIS controller.

Public names are loaded on first use: schedules run without scikit-learn.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from adaptrack.paper.adaptation import adapt
    from adaptrack.paper.anfis import ANFIS
    from adaptrack.paper.campaign import run_campaign
    from adaptrack.paper.campaign_config import CampaignConfig, list_campaigns, load_campaign
    from adaptrack.paper.data_set import DataSet, list_datasets, load_dataset
    from adaptrack.paper.data_set_summary import describe
    from adaptrack.paper.fis import read_fis, write_fis
    from adaptrack.paper.improvement import improve
    from adaptrack.paper.mlp import MLP
    from adaptrack.paper.partition import subtractive_clustering
    from adaptrack.paper.schedules import trained_schedule
    from adaptrack.paper.training import TARGETS, Trained, train

_MODULES = {
    "ANFIS": "anfis",
    "CampaignConfig": "campaign_config",
    "DataSet": "data_set",
    "MLP": "mlp",
    "TARGETS": "training",
    "Trained": "training",
    "adapt": "adaptation",
    "describe": "data_set_summary",
    "improve": "improvement",
    "list_campaigns": "campaign_config",
    "list_datasets": "data_set",
    "load_campaign": "campaign_config",
    "load_dataset": "data_set",
    "read_fis": "fis",
    "run_campaign": "campaign",
    "subtractive_clustering": "partition",
    "train": "training",
    "trained_schedule": "schedules",
    "write_fis": "fis",
}

__all__ = [
    "ANFIS",
    "MLP",
    "TARGETS",
    "CampaignConfig",
    "DataSet",
    "Trained",
    "adapt",
    "describe",
    "improve",
    "list_campaigns",
    "list_datasets",
    "load_campaign",
    "load_dataset",
    "read_fis",
    "run_campaign",
    "subtractive_clustering",
    "train",
    "trained_schedule",
    "write_fis",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
