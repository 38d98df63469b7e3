"""Contenders of a comparison: schedules, tunings or controllers with a name."""

from __future__ import annotations

from dataclasses import dataclass

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers.base import Policy
from adaptrack.tuning.runs import PolicyArgument, policy_of


@checked
@dataclass(frozen=True, eq=False)
class Contender:
    """A policy with the name under which it is compared.

    Raises
    ------
    InvalidInput
        For an empty name or an invalid policy.
    """

    name: str
    policy: PolicyArgument
    """Schedule, tuning, tunings (runs, 4), or controller with `step`, `reset`, `period` and `name`."""
    hindsight: bool = False
    """Whether the policy was optimised for the very runs of the comparison."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidInput(f"Contender: name = {self.name!r}: must be text.")
        self.as_policy()

    def as_policy(self) -> Policy:
        """Return the record of the policy."""
        return policy_of(self.policy, f"contender {self.name!r}")

    @property
    def controller(self) -> str:
        """The name of the controller; "mpc" if the policy is a schedule or tuning for the MPC of the runs."""
        controller = self.as_policy().controller
        return "mpc" if controller is None else str(controller.name)

    @property
    def adapts(self) -> bool:
        """Whether the tuning changes between or during runs, without `hindsight`."""
        return not self.hindsight and self.as_policy().adapts
