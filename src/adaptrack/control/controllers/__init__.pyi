"""The public names of controllers."""

from .base import (
    Command as Command,
    CompiledController as CompiledController,
    Controller as Controller,
    TuningBounds as TuningBounds,
    command_of as command_of,
    step_call as step_call,
)
from .belief import Belief as Belief, Uncertainty as Uncertainty
from .check import check_controller as check_controller
from .informed import informed_tuning as informed_tuning
from .laws import LQR as LQR, PurePursuit as PurePursuit, Stanley as Stanley, UserController as UserController
from .learned_car import (
    BeliefState as BeliefState,
    LearnedCar as LearnedCar,
    Learning as Learning,
    load_learned_car as load_learned_car,
)
from .limits import Limits as Limits, Moves as Moves
from .mpc import MPC as MPC, CompiledScheduler as CompiledScheduler, MPCCommand as MPCCommand, Scheduler as Scheduler
from .presets import published_mpc as published_mpc, released_mpc as released_mpc
from .registry import (
    About as About,
    about_controller as about_controller,
    get_controller as get_controller,
    list_controllers as list_controllers,
    register_controller as register_controller,
)
from .tuning import ENTRIES as ENTRIES, Tuning as Tuning, read_tuning as read_tuning
