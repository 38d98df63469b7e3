"""The closed loop that a campaign tunes."""

from __future__ import annotations

from typing import Any

from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.paper.campaign_config import Setup
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.objective import Objective


def tuned_mpc(setup: Setup, tuning: Tuning | None = None, **options: Any) -> MPC:
    """The paper's MPC for a campaign's car and profile, by default with the paper's tuning.

    options: of `MPC`.
    """
    profile = load_profile(setup.config.profile)
    return published_mpc(setup.vehicle, tuning, period=profile.period, preview=profile.preview, **options)


def campaign_objective(setup: Setup) -> Objective:
    """The cost of a tuning in a campaign: its plant or the plant's twin, its profile, and the MPC with free moves."""
    config = setup.config
    mpc = tuned_mpc(
        setup, longest_horizon=max(60, config.search.Np[1]), most_moves=max(20, config.search.Nc[1])
    )  # fmt: skip
    return Objective(
        plant=setup.searched_on,
        mpc=mpc,
        test=config.scenario,
        profile=load_profile(config.profile),
        noise_seeds=config.noise_seeds or (0,),
        move_weight=config.move_weight,
        duration=config.duration,
        failure=config.failure.rule,
    )
