"""The controller of the paper: its prediction model, the increments of what is measured, the tuning of its table."""

from __future__ import annotations

from typing import Any

from adaptrack.base.checked import checked
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers.limits import Moves
from adaptrack.control.controllers.mpc import MPC
from adaptrack.control.controllers.tuning import Tuning
from adaptrack.control.models import SingleTrackModel


@checked
def published_mpc(vehicle: Vehicle, tuning: Tuning | None = None, *, period: float = 0.1, **options: Any) -> MPC:
    """The MPC of the paper as written: eqs. (8)-(17), moves as pulses, `Tuning()` of its table by default.

    It predicts with the single track of `vehicle`, whose wheels are where the command is, and takes the measured state
    as it is. period: s; options: of `MPC`, but for profile, belief, model and estimator.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    return MPC(vehicle, tuning, model=SingleTrackModel(vehicle, period), estimator="deadbeat", **options)


def released_mpc(vehicle: Vehicle, tuning: Tuning | None = None, **options: Any) -> MPC:
    """The paper's MPC as its authors released it: it moves by ten Laguerre functions with the pole 0.95.

    Raises
    ------
    InvalidInput
        For arguments that make no controller.
    """
    return published_mpc(vehicle, tuning, **{"moves": Moves.laguerre(0.95), **options})
