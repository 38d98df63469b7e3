"""Controllers: what `simulate` drives with. One file each; `check_controller` tells whether one keeps the contract."""

from adaptrack.controllers.base import Command, CompiledController, Controller
from adaptrack.controllers.belief import Belief, Uncertainty
from adaptrack.controllers.check import check_controller
from adaptrack.controllers.informed import informed_tuning
from adaptrack.controllers.kinematic_mpc import KinematicMPC
from adaptrack.controllers.learned import LearnedCar, Learning, load_learned_car
from adaptrack.controllers.limits import Limits, Moves
from adaptrack.controllers.lqr import LQR
from adaptrack.controllers.mpc import MPC, CompiledScheduler, MPCCommand, Scheduler
from adaptrack.controllers.mppi import MPPI
from adaptrack.controllers.nmpc import NMPC
from adaptrack.controllers.preview_lqr import PreviewLQR
from adaptrack.controllers.published import published_mpc, released_mpc
from adaptrack.controllers.pure_pursuit import PurePursuit
from adaptrack.controllers.registry import get_controller, list_controllers, register_controller
from adaptrack.controllers.stanley import Stanley
from adaptrack.controllers.tuning import ENTRIES, Tuning, read_tuning
from adaptrack.controllers.user import UserController

__all__ = [
    "ENTRIES",
    "LQR",
    "MPC",
    "MPPI",
    "NMPC",
    "Belief",
    "Command",
    "CompiledController",
    "CompiledScheduler",
    "Controller",
    "KinematicMPC",
    "LearnedCar",
    "Learning",
    "Limits",
    "MPCCommand",
    "Moves",
    "PreviewLQR",
    "PurePursuit",
    "Scheduler",
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
    "read_tuning",
    "register_controller",
    "released_mpc",
]
