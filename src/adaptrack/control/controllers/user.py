"""A compiled controller of one's own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, final

from adaptrack.base.checked import checked, real, whole_number
from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.control.controllers.base import TWO_DECADES, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.core.controllers.contract import compile_law
from adaptrack.core.member import MemberFunction


@final
class UserController(CompiledController):
    """A controller of one's own: one law and its numbers. `check_controller` admits it.

    law(situation, reference, road, tuning, parameters, memory, answer) writes the steering command (rad) to answer[0]
    and its diagnostics behind it, and returns nothing; see `core.controllers.contract`, and `UserPlant` for how it is
    called. situation: v_y (m/s), yaw
    (rad), yaw rate (rad/s), y (m), v_x (m/s), last command (rad); road: the centre line and the car's foot on it;
    parameters: period (s), least and largest move (rad per period), least and largest angle (rad), then `parameters`
    in their order. It must keep its command within those limits, answer a finite command on finite input, and write to
    memory and answer only.

    tuning: name -> number; bounds: name -> (least, largest) value that is sought for it, by default two decades to
    either side of the number; parameters: name -> number; memory_size: numbers that it remembers; diagnostics: names of
    answer[1:], of which ``held`` (1 where the last command is held) is known to the drivers; label: how tables call it.

    Raises
    ------
    ContractError
        When numba cannot compile the law.
    """

    @checked
    def __init__(
        self,
        law: MemberFunction,
        *,
        tuning: Mapping[str, float] | None = None,
        parameters: Mapping[str, float] | None = None,
        memory_size: int = 0,
        diagnostics: Sequence[str] = (),
        bounds: Mapping[str, tuple[float, float]] | None = None,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
        label: str = "user",
    ) -> None:
        self.law, self.label = law, label
        where = f"UserController {label!r}"
        self.constants = {name: real(where, name, value) for name, value in (parameters or {}).items()}
        faulty = [f"{name} = {value!r}" for name, value in self.constants.items() if not math.isfinite(value)]
        if faulty:
            raise InvalidInput(f"{where}: parameters must be finite numbers: {', '.join(faulty)}.")
        self.memory_size = whole_number(where, "memory_size", memory_size, least=0)
        self.tuning_names, self.diagnostic_names = tuple(tuning or {}), tuple(diagnostics)
        if bounds and set(bounds) - set(self.tuning_names):
            raise InvalidInput(f"{where}: bounds of {', '.join(bounds)}: must be of {', '.join(self.tuning_names)}.")
        self.tuning_bounds = dict.fromkeys(self.tuning_names, TWO_DECADES)
        self.tuning_bounds |= {
            name: TuningBounds(float(ends[0]), float(ends[1])) for name, ends in (bounds or {}).items()
        }
        try:
            self._compiled = compile_law(law)
        except Exception as error:
            raise ContractError(
                f"{where}: numba cannot compile its law as "
                f"f(situation, reference, road, tuning, parameters, memory, answer) on float64 arrays: {error}"
            ) from error
        super().__init__(tuning or {}, period=period, limits=limits, preview=preview)

    @property
    def name(self) -> str:
        return self.label

    @property
    def function(self) -> Any:
        return self._compiled

    def own_parameters(self) -> Sequence[float]:
        return tuple(self.constants.values())

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "law": self.label, "parameters": dict(self.constants)}
