"""The public names of adaptrack and the modules that define them."""

from .base.errors import (
    AdaptrackError as AdaptrackError,
    ConfigError as ConfigError,
    ContractError as ContractError,
    InvalidInput as InvalidInput,
    MissingExtra as MissingExtra,
    StorageError as StorageError,
    UnknownName as UnknownName,
)
from .cars.data_sheet import vehicle_from_data_sheet as vehicle_from_data_sheet
from .cars.plant import (
    DualTrack as DualTrack,
    Plant as Plant,
    SingleTrack as SingleTrack,
    SteppedPlant as SteppedPlant,
    UserPlant as UserPlant,
    check_plant as check_plant,
    get_plant as get_plant,
    list_plants as list_plants,
    register_plant as register_plant,
)
from .cars.tyre_file import read_tyre_file as read_tyre_file
from .cars.tyre_fit import tyre_from_table as tyre_from_table
from .cars.vehicle import (
    Body as Body,
    Domain as Domain,
    KnownWithin as KnownWithin,
    Steering as Steering,
    SteeringActuator as SteeringActuator,
    Tyre as Tyre,
    Vehicle as Vehicle,
    list_tyres as list_tyres,
    list_vehicles as list_vehicles,
    load_tyre as load_tyre,
    load_vehicle as load_vehicle,
)
from .control.controllers import (
    LQR as LQR,
    MPC as MPC,
    BeliefState as BeliefState,
    Controller as Controller,
    LearnedCar as LearnedCar,
    Learning as Learning,
    Limits as Limits,
    Moves as Moves,
    PurePursuit as PurePursuit,
    Stanley as Stanley,
    Tuning as Tuning,
    Uncertainty as Uncertainty,
    UserController as UserController,
    check_controller as check_controller,
    get_controller as get_controller,
    list_controllers as list_controllers,
    load_learned_car as load_learned_car,
    published_mpc as published_mpc,
    register_controller as register_controller,
)
from .control.controllers.kinematic_mpc import KinematicMPC as KinematicMPC
from .control.controllers.preview_lqr import PreviewLQR as PreviewLQR
from .control.estimation import (
    Deadbeat as Deadbeat,
    Estimator as Estimator,
    FrictionWindEstimator as FrictionWindEstimator,
    Perception as Perception,
    UserEstimator as UserEstimator,
    check_estimator as check_estimator,
    get_estimator as get_estimator,
    list_estimators as list_estimators,
    register_estimator as register_estimator,
)
from .control.following import Following as Following
from .control.kalman import Drifts as Drifts, KalmanFilter as KalmanFilter, SensorNoise as SensorNoise
from .control.models import (
    PathModel as PathModel,
    PredictionModel as PredictionModel,
    SingleTrackModel as SingleTrackModel,
    UserModel as UserModel,
    check_model as check_model,
    get_model as get_model,
    list_models as list_models,
    register_model as register_model,
)
from .control.scheduling import (
    Constant as Constant,
    Guarded as Guarded,
    Learned as Learned,
    Lookup as Lookup,
    Schedule as Schedule,
    SchedulingVariables as SchedulingVariables,
    check_scheduler as check_scheduler,
    list_schedulers as list_schedulers,
    load_scheduler as load_scheduler,
)
from .control.speed_control import SpeedControl as SpeedControl
from .control.tracker import Status as Status, Tracker as Tracker, yaw_of as yaw_of
from .core.member import CFunction as CFunction
from .drive.batch import rollout_batch as rollout_batch
from .drive.failure import FailureLimits as FailureLimits
from .drive.metrics import (
    Metrics as Metrics,
    PathRecord as PathRecord,
    compute_metrics as compute_metrics,
    path_metrics as path_metrics,
)
from .drive.simulate import rollout as rollout, simulate as simulate
from .drive.trajectory import Trajectory as Trajectory
from .drive.world import Driver as Driver
from .export.c_library import export_c as export_c
from .export.fmu import export_fmu as export_fmu
from .export.page_file import export_page as export_page
from .identification import (
    Identification as Identification,
    Reading as Reading,
    SteeringTest as SteeringTest,
    identify as identify,
)
from .road import (
    Road as Road,
    check_road as check_road,
    fit_road as fit_road,
    generate_road as generate_road,
    load_road as load_road,
    plan_speed as plan_speed,
    road_through as road_through,
)
from .road.planned_trajectory import PlannedTrajectory as PlannedTrajectory
from .road.road_ahead import RoadAhead as RoadAhead
from .scenario import (
    RoadDrive as RoadDrive,
    Scenario as Scenario,
    list_scenarios as list_scenarios,
    load_scenario as load_scenario,
    random_drive as random_drive,
)
from .scenario.profile import Profile as Profile, list_profiles as list_profiles, load_profile as load_profile
from .identification.shadow import shadow as shadow
from .tuning.car import tune as tune

__version__: str
