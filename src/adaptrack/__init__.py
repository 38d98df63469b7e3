"""Adaptive model predictive path tracking: tune, learn, check and run the MPC that each condition needs.

The public names are loaded when they are first used, so that ``import adaptrack`` costs next to nothing.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_PUBLIC = {
    "errors": (
        "AdaptrackError",
        "ConfigError",
        "ContractError",
        "InvalidInput",
        "MissingExtra",
        "StorageError",
        "UnknownName",
    ),
    "vehicle": ("SteeringActuator", "Tyre", "Vehicle", "list_tyres", "list_vehicles", "load_tyre", "load_vehicle"),
    "plant": ("DualTrack", "Plant", "Profile", "SingleTrack", "UserPlant", "check_plant"),
    "prediction": ("PredictionModel",),
    "qp": ("QP", "Solution", "check_qp_solver", "get_qp_solver", "list_qp_solvers", "register_qp_solver"),
    "mpc": ("MPC", "Condition", "Limits", "Moves", "Tuning", "demand"),
    "estimation": ("Estimating", "FrictionWindEstimator"),
    "scenario": ("Scenario", "list_scenarios", "load_scenario", "random_drive"),
    "trajectory": ("Trajectory",),
    "simulate": ("Driver", "rollout", "rollout_batch", "simulate"),
    "metrics": ("Metrics", "compute_metrics"),
    "tuning.pso": ("SearchSpace", "Swarm", "SwarmSettings", "minimise"),
    "tuning.objective": ("Objective",),
    "tuning.config": ("CampaignConfig", "list_campaigns", "load_campaign"),
    "tuning.campaign": ("run_campaign",),
    "dataset": ("DataSet", "list_datasets", "load_dataset"),
    "learning.training": ("train",),
    "schedule": (
        "Constant",
        "Guarded",
        "Learned",
        "Lookup",
        "Schedule",
        "check_scheduler",
        "list_schedulers",
        "load_scheduler",
        "save_scheduler",
    ),
    "adaptation.config": ("load_adaptation",),
    "studies.adapt": ("adapt",),
}
"""Module -> the names that the package exposes from it; the imports below repeat it for type checkers."""

if TYPE_CHECKING:
    from adaptrack.adaptation.config import load_adaptation
    from adaptrack.dataset import DataSet, list_datasets, load_dataset
    from adaptrack.errors import (
        AdaptrackError,
        ConfigError,
        ContractError,
        InvalidInput,
        MissingExtra,
        StorageError,
        UnknownName,
    )
    from adaptrack.estimation import Estimating, FrictionWindEstimator
    from adaptrack.learning.training import train
    from adaptrack.metrics import Metrics, compute_metrics
    from adaptrack.mpc import MPC, Condition, Limits, Moves, Tuning, demand
    from adaptrack.plant import DualTrack, Plant, Profile, SingleTrack, UserPlant, check_plant
    from adaptrack.prediction import PredictionModel
    from adaptrack.qp import QP, Solution, check_qp_solver, get_qp_solver, list_qp_solvers, register_qp_solver
    from adaptrack.scenario import Scenario, list_scenarios, load_scenario, random_drive
    from adaptrack.schedule import (
        Constant,
        Guarded,
        Learned,
        Lookup,
        Schedule,
        check_scheduler,
        list_schedulers,
        load_scheduler,
        save_scheduler,
    )
    from adaptrack.simulate import Driver, rollout, rollout_batch, simulate
    from adaptrack.studies.adapt import adapt
    from adaptrack.trajectory import Trajectory
    from adaptrack.tuning.campaign import run_campaign
    from adaptrack.tuning.config import CampaignConfig, list_campaigns, load_campaign
    from adaptrack.tuning.objective import Objective
    from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmSettings, minimise
    from adaptrack.vehicle import (
        SteeringActuator,
        Tyre,
        Vehicle,
        list_tyres,
        list_vehicles,
        load_tyre,
        load_vehicle,
    )

_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "MPC",
    "QP",
    "AdaptrackError",
    "CampaignConfig",
    "Condition",
    "ConfigError",
    "Constant",
    "ContractError",
    "DataSet",
    "Driver",
    "DualTrack",
    "Estimating",
    "FrictionWindEstimator",
    "Guarded",
    "InvalidInput",
    "Learned",
    "Limits",
    "Lookup",
    "Metrics",
    "MissingExtra",
    "Moves",
    "Objective",
    "Plant",
    "PredictionModel",
    "Profile",
    "Scenario",
    "Schedule",
    "SearchSpace",
    "SingleTrack",
    "Solution",
    "SteeringActuator",
    "StorageError",
    "Swarm",
    "SwarmSettings",
    "Trajectory",
    "Tuning",
    "Tyre",
    "UnknownName",
    "UserPlant",
    "Vehicle",
    "__version__",
    "adapt",
    "check_plant",
    "check_qp_solver",
    "check_scheduler",
    "compute_metrics",
    "demand",
    "get_qp_solver",
    "list_campaigns",
    "list_datasets",
    "list_qp_solvers",
    "list_scenarios",
    "list_schedulers",
    "list_tyres",
    "list_vehicles",
    "load_adaptation",
    "load_campaign",
    "load_dataset",
    "load_scenario",
    "load_scheduler",
    "load_tyre",
    "load_vehicle",
    "minimise",
    "random_drive",
    "register_qp_solver",
    "rollout",
    "rollout_batch",
    "run_campaign",
    "save_scheduler",
    "simulate",
    "train",
]


def __getattr__(name: str) -> Any:
    try:
        home = _HOME[name]
    except KeyError:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    value = getattr(importlib.import_module(f"{__name__}.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """Keeps `adaptrack.simulate` the public function after the module of the same name has been imported.

    Importing a submodule binds it in its package; here that would shadow the function.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _HOME and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
