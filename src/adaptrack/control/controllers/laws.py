"""Compiled control laws: pure pursuit, Stanley, LQR with curvature feed-forward, and one of your own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, ClassVar, final

import numpy as np

from adaptrack.base.checked import Finite, Hint, Natural, NotNegative, Number, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import compile_function
from adaptrack.cars.vehicle import Vehicle, VehicleArgument
from adaptrack.control.controllers.base import FIXED_TUNING, TWO_DECADES, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.core.controllers import lqr, pure_pursuit, stanley
from adaptrack.core.controllers.contract import compile_law
from adaptrack.core.kernel import row_of
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import MemberFunction
from adaptrack.core.models.car import SteeringRow
from adaptrack.core.synthesis import laws

GAIN_SPEEDS = portable.geomspace(laws.MIN_GAIN_SPEED, laws.MAX_GAIN_SPEED, laws.GAIN_SPEED_COUNT)
"""m/s, where gains are computed; between them they are interpolated over log v."""
WEIGHT_FACTORS = portable.power(10.0, np.linspace(-laws.GAIN_DECADES, laws.GAIN_DECADES, laws.GAIN_WEIGHTS))
"""Of q_e/r and q_heading/r, about the controller's own: where gains are computed for weights that change."""
WEIGHTS_TOO_FAR_APART = "LQR: no gain for weights (over r) so far apart: bring q_e, q_heading and r nearer."


def steering_delay(vehicle: Vehicle) -> float:
    """Lag and dead time (s) of a car's steering as far as they are known, else `laws.STEERING_DELAY`."""
    return float(laws.steering_delay(row_of(SteeringRow, vehicle.steering)))


class PurePursuit(CompiledController):
    """Pure pursuit: steer the arc that leads the rear axle to a point of the path ahead.

        delta = atan(2 L sin(alpha)/l_d)

    alpha: angle from the car's axis to the target; l_d: distance from the rear axle to it; L: wheelbase. The target is
    the point of the path that lies max(lookahead_time v, lookahead_min) ahead of the centre of gravity. Tyre slip is
    not modelled. R. C. Coulter, *Implementation of the Pure Pursuit Path Tracking Algorithm*, CMU-RI-TR-92-01, 1992;
    a look-ahead that grows with the speed is common practice.

    Arguments: see `CompiledController`.
    """

    name, law_name, is_exportable = "pure pursuit", "pure-pursuit", True
    function = staticmethod(pure_pursuit.pure_pursuit)
    memory_size, diagnostic_names = pure_pursuit.MEMORY, pure_pursuit.PURSUIT_DIAGNOSTICS
    positive: ClassVar[tuple[str, ...]] = ("lookahead_min",)
    tuning_bounds: Mapping[str, TuningBounds] = {
        "lookahead_time": TuningBounds(0.1, 1.5),
        "lookahead_min": TuningBounds(1.0, 10.0),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        lookahead_time: Annotated[NotNegative, "s"] = 0.6,
        lookahead_min: Annotated[Positive, "m", Hint("a standing car has no target else")] = 4.0,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = vehicle
        tuning = {"lookahead_time": lookahead_time, "lookahead_min": lookahead_min}
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    def own_parameters(self) -> Array:
        return self._made_by(laws.pure_pursuit_parameters, laws.PURSUIT)


class Stanley(CompiledController):
    """The law of the car that won the DARPA Grand Challenge of 2005, with a dead-time term.

        delta = psi_e + m l_r/(2 C_f L) v^2 kappa + atan(gain e/(softening + v)) + yaw_rate_gain (v kappa - r)

    psi_e: heading of the path less the car's; e: offset of the path from the front axle, positive to the left; kappa:
    curvature of the path; the second term is the slip of the front tyres in the turn. G. M. Hoffmann, C. J. Tomlin,
    M. Montemerlo, S. Thrun, *Autonomous Automobile Trajectory Tracking for Off-Road Driving*, American Control
    Conference 2007; their damping of the steering servo is left out, because the wheel's angle is not measured here.

    The dead-time term is ours: psi_e and e are those that the present motion (v_x, v_y, yaw rate) leads to after
    `dead_time`, against the path there.

    gain: 1/s; softening: m/s; yaw_rate_gain: s; dead_time: s, None for the lag and dead time of the vehicle's steering
    (0.2 s where nothing is known); the rest: see `CompiledController`.
    """

    name, law_name, is_exportable = "Stanley", "stanley", True
    function = staticmethod(stanley.stanley)
    memory_size, diagnostic_names = stanley.MEMORY, stanley.STANLEY_DIAGNOSTICS
    tuning_bounds: Mapping[str, TuningBounds] = {
        "gain": TuningBounds(0.1, 10.0, relative=True),
        "softening": TuningBounds(0.1, 10.0, relative=True),
        "yaw_rate_gain": TuningBounds(0.0, 0.3),
        "dead_time": TuningBounds(0.0, 0.6),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        gain: float = 1.0,
        softening: float = 1.0,
        yaw_rate_gain: float = 0.05,
        dead_time: float | None = None,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = vehicle
        tuning = {
            "gain": gain,
            "softening": softening,
            "yaw_rate_gain": yaw_rate_gain,
            "dead_time": steering_delay(vehicle) if dead_time is None else dead_time,
        }
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    def own_parameters(self) -> Array:
        return self._made_by(laws.stanley_parameters, laws.STANLEY)


class LQR(CompiledController):
    """Linear-quadratic regulator about the steady turn of the path, with curvature feed-forward.

    With the lateral errors x = [e, v_y + v psi_e, psi_e, r - v kappa] (`core.synthesis.laws.lqr_error_model`), the
    steering is

        delta = (L + K v^2) kappa - gain (x - x_ss),   x_ss = [0, 0, (m l_f v^2/(2 C_r L) - l_r) kappa, 0]

    L: wheelbase; K: understeer gradient; kappa: curvature of the path; x_ss: the errors of the steady turn, in which
    the car's heading differs from the path's. gain minimises sum q_e e^2 + q_heading psi_e^2 + r delta^2 for the model
    sampled at the control period. R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., eqs. (2.45), (3.12)-(3.15).
    Lag and dead time of the steering are not part of the model; the feed-forward looks `preview_time` ahead for them.

    q_e, q_heading, r: only their ratios count; preview_time: s, None for the lag and dead time of the
    vehicle's steering (0.2 s where nothing is known); the rest: see `CompiledController`.
    """

    name, law_name, is_exportable = "LQR with curvature feed-forward", "lqr", True
    function = staticmethod(lqr.lqr)
    memory_size, diagnostic_names = lqr.MEMORY, lqr.LQR_DIAGNOSTICS
    # only the ratios to r count; gains are tabulated over two decades to either side of its own
    positive: ClassVar[tuple[str, ...]] = ("q_e", "q_heading", "r")
    tuning_bounds: Mapping[str, TuningBounds] = {
        "q_e": TWO_DECADES,
        "q_heading": TWO_DECADES,
        "r": FIXED_TUNING,
        "preview_time": TuningBounds(0.0, 0.6),
    }

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        q_e: Annotated[Positive, "1/m^2"] = 1.0,
        q_heading: Annotated[Positive, "1/rad^2"] = 100.0,
        r: Annotated[Positive, "1/rad^2"] = 1000.0,
        preview_time: float | None = None,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.vehicle = vehicle
        tuning = {
            "q_e": q_e,
            "q_heading": q_heading,
            "r": r,
            "preview_time": steering_delay(vehicle) if preview_time is None else preview_time,
        }
        super().__init__(tuning, period=period, limits=limits, preview=preview)

    def own_parameters(self) -> Array:
        return _parameters(self.vehicle, self.period, tuple(self.tuning[name] for name in ("q_e", "q_heading", "r")))


@lru_cache(maxsize=64)
def _parameters(vehicle: Vehicle, period: float, tuning: tuple[float, ...]) -> Array:
    """Return the law's parameters that follow `core.controllers.contract.COMMON_PARAMETERS`."""
    parameters = np.zeros(laws.LQR_NUMBERS)
    if laws.lqr_parameters(vehicle.numbers, row_of(laws.Common, period=period), np.array(tuning), parameters) == 0:
        raise InvalidInput(WEIGHTS_TOO_FAR_APART)
    return parameters[len(laws.Common._fields) :]


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
        When the law cannot be compiled; the message states file, line and remedy.
    """

    name, function = "user", None

    @checked
    def __init__(
        self,
        law: MemberFunction,
        *,
        tuning: Mapping[str, float] | None = None,
        parameters: Mapping[str, Finite] | None = None,
        memory_size: Natural = 0,
        diagnostics: Sequence[str] = (),
        bounds: Mapping[str, tuple[Number, Number]] | None = None,
        period: float = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
        label: str = "user",
    ) -> None:
        self.law, self.label, self.name = law, label, label
        self.constants, self.memory_size = dict(parameters or {}), memory_size
        where = f"UserController {label!r}"
        self.tuning_names, self.diagnostic_names = tuple(tuning or {}), tuple(diagnostics)
        if bounds and set(bounds) - set(self.tuning_names):
            raise InvalidInput(f"{where}: bounds of {', '.join(bounds)}: must be of {', '.join(self.tuning_names)}.")
        self.tuning_bounds = dict.fromkeys(self.tuning_names, TWO_DECADES)
        self.tuning_bounds |= {name: TuningBounds(*ends) for name, ends in (bounds or {}).items()}
        form = "law as f(situation, reference, road, tuning, parameters, memory, answer) on float64 arrays"
        self.function = compile_function(where, compile_law, law, form)
        super().__init__(tuning or {}, period=period, limits=limits, preview=preview)

    def own_parameters(self) -> Sequence[float]:
        return tuple(self.constants.values())

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "law": self.label, "parameters": dict(self.constants)}
