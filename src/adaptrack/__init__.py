"""Adaptive model predictive path tracking: tune, learn, check and run the MPC that each condition needs.

The public names are loaded when they are first used, so that ``import adaptrack`` costs next to nothing.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.3.0"

_PUBLIC = {
    "base.errors": (
        "AdaptrackError",
        "ConfigError",
        "ContractError",
        "InvalidInput",
        "MissingExtra",
        "StorageError",
        "UnknownName",
    ),
    "core.member": ("CFunction",),
    "cars.domain": ("Domain",),
    "cars.known_within": ("KnownWithin",),
    "cars.outline": ("Outline",),
    "cars.vehicle": (
        "Body",
        "Steering",
        "SteeringActuator",
        "Tyre",
        "Vehicle",
        "list_tyres",
        "list_vehicles",
        "load_tyre",
        "load_vehicle",
    ),
    "cars.data_sheet": ("vehicle_from_data_sheet",),
    "cars.tyre_file": ("read_tyre_file",),
    "cars.tyre_table": ("tyre_from_table",),
    "scenario.profile": (
        "Profile",
        "list_profiles",
        "load_profile",
    ),
    "identification": (
        "CarRanges",
        "Identification",
        "RandomCar",
        "Reading",
        "identify",
        "random_car",
    ),
    "cars.plant": (
        "DualTrack",
        "Plant",
        "SingleTrack",
        "SteppedPlant",
        "UserPlant",
        "check_plant",
        "get_plant",
        "list_plants",
        "register_plant",
    ),
    "control.controllers.kinematic_mpc": ("KinematicMPC",),
    "control.controllers.preview_lqr": ("PreviewLQR",),
    "road": (
        "Road",
        "check_road",
        "fit_road",
        "generate_road",
        "load_road",
        "plan_speed",
        "road_through",
    ),
    "road.ahead": ("RoadAhead",),
    "scenario": (
        "RoadDrive",
        "Scenario",
        "list_scenarios",
        "load_scenario",
        "random_drive",
    ),
    "control.models": (
        "PathModel",
        "PredictionModel",
        "SingleTrackModel",
        "UserModel",
        "check_model",
        "get_model",
        "list_models",
        "register_model",
    ),
    "control.estimation": (
        "Deadbeat",
        "Estimator",
        "FrictionWindEstimator",
        "Perception",
        "UserEstimator",
        "check_estimator",
        "get_estimator",
        "list_estimators",
        "register_estimator",
    ),
    "control.kalman": (
        "Drifts",
        "KalmanFilter",
        "SensorNoise",
    ),
    "control.qp": (
        "QP",
        "Solution",
        "get_qp_solver",
    ),
    "control.controllers": (
        "BeliefState",
        "Controller",
        "LQR",
        "MPC",
        "LearnedCar",
        "Learning",
        "Limits",
        "Moves",
        "PurePursuit",
        "Stanley",
        "Tuning",
        "Uncertainty",
        "UserController",
        "check_controller",
        "get_controller",
        "informed_tuning",
        "list_controllers",
        "load_learned_car",
        "published_mpc",
        "register_controller",
    ),
    "control.scheduling": (
        "Constant",
        "Guarded",
        "Learned",
        "Lookup",
        "Schedule",
        "SchedulingVariables",
        "check_scheduler",
        "list_schedulers",
        "load_scheduler",
        "reference_preview",
        "save_scheduler",
    ),
    "drive.trajectory": ("Trajectory",),
    "drive.failure": (
        "Failure",
        "find_failure",
    ),
    "drive.predicted": ("PredictedPaths",),
    "drive.world": ("Driver",),
    "drive.batch": ("rollout_batch",),
    "drive.simulate": ("rollout", "simulate"),
    "drive.metrics": (
        "Metrics",
        "compute_metrics",
    ),
    "drive.path_metrics": (
        "PathMetrics",
        "PathRecord",
        "path_metrics",
    ),
    "control.tracker": (
        "Status",
        "Tracker",
        "yaw_of",
    ),
    "tuning.pso": (
        "SearchSpace",
        "Swarm",
        "SwarmSettings",
        "minimise",
    ),
    "tuning.objective": ("Objective",),
    "tuning.car": ("TunedCar", "TuningEffort", "tune"),
    "comparison.contenders": (
        "Contender",
    ),
    "identification.shadow": ("Shadow", "shadow"),
    "export.c_library": ("export_c",),
    "export.fmu": ("export_fmu",),
    "export.page_file": ("export_page",),
}
"""Module -> the names that the package exposes from it; the imports below repeat it for type checkers."""

if TYPE_CHECKING:
    from adaptrack.base.errors import (
        AdaptrackError,
        ConfigError,
        ContractError,
        InvalidInput,
        MissingExtra,
        StorageError,
        UnknownName,
    )
    from adaptrack.cars.data_sheet import vehicle_from_data_sheet
    from adaptrack.cars.domain import Domain
    from adaptrack.cars.known_within import KnownWithin
    from adaptrack.cars.outline import Outline
    from adaptrack.cars.plant import (
        DualTrack,
        Plant,
        SingleTrack,
        SteppedPlant,
        UserPlant,
        check_plant,
        get_plant,
        list_plants,
        register_plant,
    )
    from adaptrack.cars.tyre_file import read_tyre_file
    from adaptrack.cars.tyre_table import tyre_from_table
    from adaptrack.cars.vehicle import (
        Body,
        Steering,
        SteeringActuator,
        Tyre,
        Vehicle,
        list_tyres,
        list_vehicles,
        load_tyre,
        load_vehicle,
    )
    from adaptrack.comparison.contenders import Contender
    from adaptrack.control.controllers import (
        LQR,
        MPC,
        BeliefState,
        Controller,
        LearnedCar,
        Learning,
        Limits,
        Moves,
        PurePursuit,
        Stanley,
        Tuning,
        Uncertainty,
        UserController,
        check_controller,
        get_controller,
        informed_tuning,
        list_controllers,
        load_learned_car,
        published_mpc,
        register_controller,
    )
    from adaptrack.control.controllers.kinematic_mpc import KinematicMPC
    from adaptrack.control.controllers.preview_lqr import PreviewLQR
    from adaptrack.control.estimation import (
        Deadbeat,
        Estimator,
        FrictionWindEstimator,
        Perception,
        UserEstimator,
        check_estimator,
        get_estimator,
        list_estimators,
        register_estimator,
    )
    from adaptrack.control.kalman import Drifts, KalmanFilter, SensorNoise
    from adaptrack.control.models import (
        PathModel,
        PredictionModel,
        SingleTrackModel,
        UserModel,
        check_model,
        get_model,
        list_models,
        register_model,
    )
    from adaptrack.control.qp import QP, Solution, get_qp_solver
    from adaptrack.control.scheduling import (
        Constant,
        Guarded,
        Learned,
        Lookup,
        Schedule,
        SchedulingVariables,
        check_scheduler,
        list_schedulers,
        load_scheduler,
        reference_preview,
        save_scheduler,
    )
    from adaptrack.control.tracker import Status, Tracker, yaw_of
    from adaptrack.core.member import CFunction
    from adaptrack.drive.batch import rollout_batch
    from adaptrack.drive.failure import Failure, find_failure
    from adaptrack.drive.metrics import Metrics, compute_metrics
    from adaptrack.drive.path_metrics import PathMetrics, PathRecord, path_metrics
    from adaptrack.drive.predicted import PredictedPaths
    from adaptrack.drive.simulate import rollout, simulate
    from adaptrack.drive.trajectory import Trajectory
    from adaptrack.drive.world import Driver
    from adaptrack.export.c_library import export_c
    from adaptrack.export.fmu import export_fmu
    from adaptrack.export.page_file import export_page
    from adaptrack.identification import CarRanges, Identification, RandomCar, Reading, identify, random_car
    from adaptrack.identification.shadow import Shadow, shadow
    from adaptrack.road import Road, check_road, fit_road, generate_road, load_road, plan_speed, road_through
    from adaptrack.road.ahead import RoadAhead
    from adaptrack.scenario import RoadDrive, Scenario, list_scenarios, load_scenario, random_drive
    from adaptrack.scenario.profile import Profile, list_profiles, load_profile
    from adaptrack.tuning.car import TunedCar, TuningEffort, tune
    from adaptrack.tuning.objective import Objective
    from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmSettings, minimise

_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [
    "LQR",
    "MPC",
    "QP",
    "AdaptrackError",
    "BeliefState",
    "Body",
    "CFunction",
    "CarRanges",
    "ConfigError",
    "Constant",
    "Contender",
    "ContractError",
    "Controller",
    "Deadbeat",
    "Domain",
    "Drifts",
    "Driver",
    "DualTrack",
    "Estimator",
    "Failure",
    "FrictionWindEstimator",
    "Guarded",
    "Identification",
    "InvalidInput",
    "KalmanFilter",
    "KinematicMPC",
    "KnownWithin",
    "Learned",
    "LearnedCar",
    "Learning",
    "Limits",
    "Lookup",
    "Metrics",
    "MissingExtra",
    "Moves",
    "Objective",
    "Outline",
    "PathMetrics",
    "PathModel",
    "PathRecord",
    "Perception",
    "Plant",
    "PredictedPaths",
    "PredictionModel",
    "PreviewLQR",
    "Profile",
    "PurePursuit",
    "RandomCar",
    "Reading",
    "Road",
    "RoadAhead",
    "RoadDrive",
    "Scenario",
    "Schedule",
    "SchedulingVariables",
    "SearchSpace",
    "SensorNoise",
    "Shadow",
    "SingleTrack",
    "SingleTrackModel",
    "Solution",
    "Stanley",
    "Status",
    "Steering",
    "SteeringActuator",
    "SteppedPlant",
    "StorageError",
    "Swarm",
    "SwarmSettings",
    "Tracker",
    "Trajectory",
    "TunedCar",
    "Tuning",
    "TuningEffort",
    "Tyre",
    "Uncertainty",
    "UnknownName",
    "UserController",
    "UserEstimator",
    "UserModel",
    "UserPlant",
    "Vehicle",
    "__version__",
    "check_controller",
    "check_estimator",
    "check_model",
    "check_plant",
    "check_road",
    "check_scheduler",
    "compute_metrics",
    "export_c",
    "export_fmu",
    "export_page",
    "find_failure",
    "fit_road",
    "generate_road",
    "get_controller",
    "get_estimator",
    "get_model",
    "get_plant",
    "get_qp_solver",
    "identify",
    "informed_tuning",
    "list_controllers",
    "list_estimators",
    "list_models",
    "list_plants",
    "list_profiles",
    "list_scenarios",
    "list_schedulers",
    "list_tyres",
    "list_vehicles",
    "load_learned_car",
    "load_profile",
    "load_road",
    "load_scenario",
    "load_scheduler",
    "load_tyre",
    "load_vehicle",
    "minimise",
    "path_metrics",
    "plan_speed",
    "published_mpc",
    "random_car",
    "random_drive",
    "read_tyre_file",
    "reference_preview",
    "register_controller",
    "register_estimator",
    "register_model",
    "register_plant",
    "road_through",
    "rollout",
    "rollout_batch",
    "save_scheduler",
    "shadow",
    "simulate",
    "tune",
    "tyre_from_table",
    "vehicle_from_data_sheet",
    "yaw_of",
]


def __getattr__(name: str) -> Any:
    try:
        home = _HOME[name]
    except KeyError:
        message = f"module {__name__!r} has no attribute {name!r}"
        if not name.startswith("_"):
            near = importlib.import_module(f"{__name__}.base.errors").nearest(name, __all__)
            message += f". Did you mean {near!r}?" if near else ""
        # Without an object: Python's own suggestion, of tracebacks alone, would repeat this one.
        raise AttributeError(message, name=name, obj=None) from None
    value = getattr(importlib.import_module(f"{__name__}.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)


class _Package(ModuleType):
    """Keeps `adaptrack.simulate` the public function after the module of the same name has been imported.

    Importing a submodule binds it in its package; here that would shadow the function.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if name in _HOME and isinstance(value, ModuleType):
            return
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
