"""Controllers: what `simulate` drives with. One file each; `check_controller` tells whether one keeps the contract."""

from adaptrack.control.controllers.base import (
    Command,
    CompiledController,
    Controller,
    TuningBounds,
    command_of,
    step_call,
)
from adaptrack.control.controllers.belief import Belief, Uncertainty
from adaptrack.control.controllers.check import check_controller
from adaptrack.control.controllers.informed import informed_tuning
from adaptrack.control.controllers.laws import LQR, PurePursuit, Stanley, UserController
from adaptrack.control.controllers.learned_car import BeliefState, LearnedCar, Learning, load_learned_car
from adaptrack.control.controllers.limits import Limits, Moves
from adaptrack.control.controllers.mpc import MPC, CompiledScheduler, MPCCommand, Scheduler
from adaptrack.control.controllers.published import published_mpc, released_mpc
from adaptrack.control.controllers.registry import (
    About,
    about_controller,
    get_controller,
    list_controllers,
    register_controller,
)
from adaptrack.control.controllers.tuning import ENTRIES, Tuning, read_tuning

__all__ = [
    "ENTRIES",
    "LQR",
    "MPC",
    "About",
    "Belief",
    "BeliefState",
    "Command",
    "CompiledController",
    "CompiledScheduler",
    "Controller",
    "LearnedCar",
    "Learning",
    "Limits",
    "MPCCommand",
    "Moves",
    "PurePursuit",
    "Scheduler",
    "Stanley",
    "Tuning",
    "TuningBounds",
    "Uncertainty",
    "UserController",
    "about_controller",
    "check_controller",
    "command_of",
    "get_controller",
    "informed_tuning",
    "list_controllers",
    "load_learned_car",
    "published_mpc",
    "read_tuning",
    "register_controller",
    "released_mpc",
    "step_call",
]
