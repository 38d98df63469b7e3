"""MPPI, a controller of others as a plug-in: `--plugin mppi --controller mppi`. Needs adaptrack[compile]."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import mppi_kernel as kernel
from adaptrack.base.checked import checked, real, whole_number
from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.vehicle import Steering, Tyre, VehicleArgument, split_periods
from adaptrack.control.controllers.base import FIXED_TUNING, TWO_DECADES, CompiledController, TuningBounds
from adaptrack.control.controllers.limits import LimitsArgument
from adaptrack.control.controllers.registry import register_controller
from adaptrack.core.public import LAW_SIGNATURE, compiles, member
from adaptrack.scenario.profile import Profile
from known_car import KnownCar

MOST_SAMPLES, MOST_STAGES, MOST_ROUNDS = 16_384, 400, 64


class MPPI(CompiledController):
    """Model predictive path integral control on the single track with its tyre's curve, lag and dead time.

    In each period `samples` plans of steering are drawn around the last one and driven over `horizon` by the model,
    from the state in which the commands on their way leave the car; the plan moves to their mean, weighed by
    exp(-cost/temperature). See `mppi_kernel` for the equations and the sources. What a sample costs is

        integral of q_e e^2 + q_course chi^2 + r (du/dt)^2 over the horizon

    e: offset from the path (m); chi: angle between velocity and path (rad); u: command (rad). The state is taken as
    it is measured, carried on by the age that the profile gives to the pose; what has no sensor, the angle of the
    wheels and perhaps the lateral velocity, is the model's. Draws are counted: the same seed, the same drive.

    profile: whose period and preview are taken, and whose actuator is believed where neither `belief` nor the car's
    file says, as by `MPC`; computation: s, as for `MPC`;
    tyre: by default the car's; friction: coefficient that the tyres are thought to have.

    temperature: m^2 s; spread: rad/s, standard deviation of the sampled steering rate; q_e: 1; q_course: m^2/rad^2;
    r: m^2 s^2/rad^2; samples: a multiple of 64; horizon: s; rounds: of sampling in a step; seed: of the draws; the
    rest: see `CompiledController`.

    Raises
    ------
    MissingExtra
        When the compiler is not installed, or kernels are interpreted.
    InvalidInput
        For arguments that make no controller.
    """

    # only the ratios to q_e count
    tuning_bounds: Mapping[str, TuningBounds] = {
        "temperature": TWO_DECADES, "spread": TuningBounds(0.1, 10.0, relative=True), "q_e": FIXED_TUNING,
        "q_course": TWO_DECADES, "r": TWO_DECADES,
    }  # fmt: skip

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        *,
        profile: str | Profile | None = None,
        belief: Steering | None = None,
        computation: float | None = None,
        tyre: Tyre | str | None = None,
        friction: float = 1.0,
        temperature: float = 0.0005,
        spread: float = 0.3,
        q_e: float = 1.0,
        q_course: float = 3.0,
        r: float = 0.1,
        samples: int = 512,
        horizon: float = 1.0,
        rounds: int = 1,
        seed: int = 0,
        period: float | None = None,
        limits: LimitsArgument | None = None,
        preview: bool | None = None,
    ) -> None:
        _compiled_law()
        self.car = KnownCar.of("MPPI", vehicle, profile, belief, tyre, friction, period, computation)
        self.horizon = real("MPPI", "horizon", horizon)
        if not self.car.period <= self.horizon <= MOST_STAGES * self.car.period:
            raise InvalidInput(
                f"MPPI: horizon = {horizon!r} s: must be from one control period to {MOST_STAGES} of them, "
                f"{self.car.period:g} to {MOST_STAGES * self.car.period:g} s."
            )
        self.stages = round(self.horizon / self.car.period)
        self.samples = whole_number("MPPI", "samples", samples)
        if self.samples % (2 * kernel.LANES) or self.samples > MOST_SAMPLES:
            raise InvalidInput(
                f"MPPI: samples = {samples!r}: must be a multiple of {2 * kernel.LANES}, {MOST_SAMPLES} at most."
            )
        self.rounds = whole_number("MPPI", "rounds", rounds)
        self.seed = whole_number("MPPI", "seed", seed, least=0)
        if self.rounds > MOST_ROUNDS or self.seed >= 2**53:
            raise InvalidInput(f"MPPI: rounds = {rounds!r}, seed = {seed!r}: {MOST_ROUNDS} rounds, seeds below 2^53.")
        self.tuning_names, self.diagnostic_names = kernel.TUNING, kernel.DIAGNOSTICS
        self._dead = split_periods(self.car.belief.delay, self.car.period)
        self.memory_size = int(kernel.memory_size(self._dead[0], self.stages, self.samples // 2))
        super().__init__(
            {"temperature": temperature, "spread": spread, "q_e": q_e, "q_course": q_course, "r": r},
            period=self.car.period,
            limits=self.car.limits if limits is None else limits,
            preview=self.car.profile.preview if preview is None else preview,
        )

    @property
    def name(self) -> str:
        return "MPPI"

    @property
    def function(self) -> Any:
        return _compiled_law()

    def own_parameters(self) -> tuple[float, ...]:
        car, steering = self.car, self.car.belief
        vehicle, rate = car.vehicle, steering.rate.value
        return (
            self.samples // 2, self.stages, self.rounds, self.seed, *self._dead,
            steering.lag.value, rate if math.isfinite(rate) else 1e9, steering.limit.value,
            vehicle.mass, vehicle.yaw_inertia, vehicle.lf, vehicle.lr, *car.stiffness, *car.peaks, *car.curve,
            float(math.isfinite(car.profile.noise_vy)), car.profile.pose_age,
        )  # fmt: skip

    def describe(self) -> dict[str, Any]:
        own = {"samples": self.samples, "horizon": self.horizon, "rounds": self.rounds, "seed": self.seed}
        return {**super().describe(), "law": "mppi", **own, **self.car.describe()}


@cache
def _compiled_law() -> Any:
    """Return the law, compiled for this process."""
    if not compiles():
        raise MissingExtra("The controller 'mppi' is compiled at run time: python -m pip install 'adaptrack[compile]'")
    return member(kernel.mppi, LAW_SIGNATURE)


register_controller("mppi", MPPI, words="MPPI on the tyre's curve", compiled=True)
