"""What a car can know of road friction and side wind: an estimator from its own signals, and a controller that uses it.

Friction and wind are not measured. Friction shows only where the tyres are near their limit; everywhere else the
estimate drifts back to a nominal value, and its standard deviation says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput, real
from adaptrack.mpc import Command, Controller
from adaptrack.plant import DualTrack, Profile, SingleTrack, load_profile
from adaptrack.vehicle import SteeringActuator, Tyre, Vehicle, load_tyre, pack_plant

if TYPE_CHECKING:
    from adaptrack.scheduling.variables import SchedulingVariables

Array = NDArray[np.float64]

LEAST_NOISE_VY, LEAST_NOISE_YAW_RATE = 0.005, 0.001
"""m/s and rad/s: with better sensors than these, the model's own errors are what limits the filter."""


SLOWEST = 5.0
"""m/s: from this speed on a step of the filter is no longer than the time constants of the lateral motion."""


class Estimate(NamedTuple):
    """What is known of the surroundings at one control instant; deviations are standard deviations."""

    friction: float
    """coefficient of friction, the same on all wheels; the median"""
    wind: float
    """m/s, v_w: velocity of the air along +Y"""
    friction_std: float
    wind_std: float
    """m/s"""
    stiffness: float
    """cornering stiffness of the tyres, over what the estimator was told"""


@dataclass(frozen=True)
class Belief:
    """What the estimator believes before it has seen anything, and how fast it forgets.

    ln(friction), wind and ln(stiffness) are Gauss-Markov processes: mean, standard deviation ("spread") and
    correlation time. The spreads suit friction from 0.3 to 1 and gusts up to 30 m/s.

    Raises
    ------
    InvalidInput
        When a number is not finite, a time or a spread not positive, or nominal_friction outside friction_range.
    """

    nominal_friction: float = 0.65
    friction_spread: float = 0.33
    """of ln(friction)"""
    friction_time: float = 8.0
    """s"""
    friction_range: tuple[float, float] = (0.1, 1.5)
    wind_spread: float = 12.0
    """m/s"""
    wind_time: float = 3.0
    """s"""
    most_wind: float = 60.0
    """m/s, the estimate stays within +- this"""
    stiffness_spread: float = 0.05
    """of ln(stiffness); 0 when the tyres are known exactly"""
    stiffness_time: float = 600.0
    """s"""
    tyre_error: float = 0.02
    """s^0.5, white noise on the lateral force of each axle, over that force"""
    drift_vy: float = 0.02
    """m/s per s^0.5, random walk of the lateral velocity that the model does not explain"""
    drift_yaw_rate: float = 0.006
    """rad/s per s^0.5"""

    def __post_init__(self) -> None:
        low, high = (real("Belief", "friction_range", value) for value in self.friction_range)
        for field in fields(self):
            if field.name == "friction_range":
                continue
            value = real("Belief", field.name, getattr(self, field.name))
            least = 0.0 if field.name in ("stiffness_spread", "tyre_error") else math.ulp(0.0)
            if not least <= value < math.inf:
                raise InvalidInput(f"Belief: {field.name} = {value!r}: must be finite and positive.")
        if not 0.0 < low <= self.nominal_friction <= high < math.inf:
            raise InvalidInput(
                f"Belief: nominal_friction = {self.nominal_friction!r} must lie in friction_range = {(low, high)!r}, "
                "of finite positive numbers."
            )


class FrictionWindEstimator:
    """Extended Kalman filter for road friction and lateral wind, from signals that a car has.

    State z = [v_y, r, ln mu, w, ln s] of the single-track vehicle with saturating tyres and wind loads,

        m (dv_y/dt + v_x r) = F_f(alpha_f, mu, s) cos(delta) + F_r(alpha_r, mu, s) + F_w(v_y, w)
        I_z dr/dt = l_f F_f cos(delta) - l_r F_r + M_w(v_y, w)
        d(ln mu)/dt = (ln mu_0 - ln mu)/tau_mu + noise,   dw/dt = -w/tau_w + noise,   d(ln s)/dt = -ln s/tau_s + noise

    delta: a replica of the steering actuator behind the known commands; s: a factor on the cornering stiffness, so
    that a tyre a little softer or stiffer than believed is not taken for a slippery or a grippy road. Measured are v_y
    and the yaw rate, and the lateral acceleration where there is a sensor; yaw and speed are taken as they come. The
    wind along X is taken as zero. Sources: D. Simon, *Optimal State Estimation* (2006), chapter 13; R. Rajamani,
    *Vehicle Dynamics and Control*, 2nd ed., chapters 2 and 13.

    vehicle, tyre, steering: what the estimator believes (by default the vehicle's tyre and an ideal actuator); period:
    control period (s); delay: whether a command acts one period after its measurement; noise_vy (m/s),
    noise_yaw_rate (rad/s), noise_acceleration (m/s^2): standard deviations of the sensors; belief: see `Belief`.

    Raises
    ------
    InvalidInput
        When the period or a noise is not positive and finite.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        tyre: Tyre | str | None = None,
        steering: SteeringActuator | None = None,
        *,
        period: float = 0.05,
        delay: bool = True,
        noise_vy: float = 0.05,
        noise_yaw_rate: float = 0.01,
        noise_acceleration: float = 0.1,
        belief: Belief | None = None,
    ) -> None:
        tyre = vehicle.tyre if tyre is None else tyre
        self.vehicle = vehicle
        self.tyre = tyre if isinstance(tyre, Tyre) else load_tyre(tyre)
        self.steering = steering or SteeringActuator.ideal()
        self.belief = belief or Belief()
        self.delay = bool(delay)
        given = {
            "period": period,
            "noise_vy": noise_vy,
            "noise_yaw_rate": noise_yaw_rate,
            "noise_acceleration": noise_acceleration,
        }
        for name, value in given.items():
            if not 0.0 < real("FrictionWindEstimator", name, value) < math.inf:
                raise InvalidInput(f"FrictionWindEstimator: {name} = {value!r}: must be positive and finite.")
        self.period = float(period)
        front, rear = (2.0 * c for c in self.tyre.stiffness_at(*vehicle.static_loads))
        rate = max((front + rear) / vehicle.mass, (front * vehicle.lf**2 + rear * vehicle.lr**2) / vehicle.yaw_inertia)
        self.steps = math.ceil(self.period * rate / SLOWEST)
        self.noise = (float(noise_vy), float(noise_yaw_rate), float(noise_acceleration))
        self._packed = pack_plant(self.vehicle, self.tyre, self.steering)
        self._settings = self.settings()
        self.reset()

    @classmethod
    def of(
        cls,
        plant: SingleTrack | DualTrack,
        profile: str | Profile = "road",
        *,
        period: float | None = None,
        noise_acceleration: float = 0.1,
        belief: Belief | None = None,
    ) -> Self:
        """The estimator that knows a plant behind a profile: its car and tyres, steering, delay and sensor noise.

        period: of the controller (s), by default the profile's.
        """
        profile = load_profile(profile)
        return cls(
            plant.vehicle,
            plant.tyre,
            plant.steering or profile.steering,
            period=profile.period if period is None else period,
            delay=profile.delay,
            noise_vy=max(profile.noise_vy, LEAST_NOISE_VY),
            noise_yaw_rate=max(profile.noise_yaw_rate, LEAST_NOISE_YAW_RATE),
            noise_acceleration=noise_acceleration,
            belief=belief,
        )

    def settings(self) -> Array:
        """Everything but the vehicle as the kernel expects it (`kernels.estimation.ESTIMATOR_SETTINGS`)."""
        from adaptrack.kernels.estimation import ESTIMATOR_SETTINGS

        belief, step = self.belief, self.period / self.steps
        root = math.sqrt(step)
        values = {
            "steps": self.steps,
            "step": step,
            "delay": self.delay,
            **dict(zip(("noise_vy", "noise_yaw_rate", "noise_acceleration"), self.noise, strict=True)),
            "drift_vy": belief.drift_vy * root,
            "drift_yaw_rate": belief.drift_yaw_rate * root,
            "tyre_error": belief.tyre_error * root,
            "log_friction": math.log(belief.nominal_friction),
            "friction_spread": belief.friction_spread,
            "friction_kept": math.exp(-step / belief.friction_time),
            "wind_spread": belief.wind_spread,
            "wind_kept": math.exp(-step / belief.wind_time),
            "stiffness_spread": belief.stiffness_spread,
            "stiffness_kept": math.exp(-step / belief.stiffness_time),
            "log_least_friction": math.log(belief.friction_range[0]),
            "log_most_friction": math.log(belief.friction_range[1]),
            "most_wind": belief.most_wind,
        }
        return np.array([values[name] for name in ESTIMATOR_SETTINGS], dtype=float)

    def packed(self) -> Array:
        """The vehicle as the kernel expects it (`kernels.abi.PLANT_PARAMETERS`)."""
        return self._packed.copy()

    def reset(self) -> None:
        """Forget the past: the next step is the first, with the wheels straight ahead."""
        from adaptrack.kernels import estimation

        self._kernel = estimation
        self._memory = np.zeros((1, estimation.MEMORY))

    def step(self, measured: ArrayLike, speed: float, command: float, acceleration: float | None = None) -> Estimate:
        """One step, at a control instant, before the controller's.

        measured: x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; speed: v_x (m/s); command: the controller's
        last steering command (rad), 0 before its first; acceleration: measured lateral acceleration (m/s^2), if there
        is such a sensor. What is absurd (1e5 or more) or not a number is left out, or the last known value
        stands in.

        Raises
        ------
        InvalidInput
            When `measured` has another shape.
        """
        seen = np.ascontiguousarray(measured, dtype=np.float64)
        if seen.shape != (4,):
            raise InvalidInput(f"measured: shape {seen.shape}, expected (4,): v_y, yaw, yaw rate, y.")
        felt = math.nan if acceleration is None else float(acceleration)
        kernel = self._kernel
        kernel.estimate(0, seen, float(speed), float(command), felt, self._packed, self._settings, self._memory)
        own = self._memory[0]
        return Estimate(
            friction=float(own[kernel.FRICTION_HAT]),
            wind=float(own[kernel.WIND_HAT]),
            friction_std=float(own[kernel.FRICTION_STD]),
            wind_std=float(own[kernel.WIND_STD]),
            stiffness=math.exp(own[kernel.LOG_STIFFNESS]),
        )

    @property
    def covariance(self) -> Array:
        """(5, 5) covariance of z = [v_y, r, ln mu, w, ln s] after the last step."""
        k = self._kernel
        return self._memory[0, k.COVARIANCE : k.COVARIANCE + k.N**2].reshape(k.N, k.N).copy()


@dataclass(frozen=True)
class Perception:
    """What a scheduler is told of friction and wind, when that is neither the truth nor an estimate from signals.

    Raises
    ------
    InvalidInput
        When a number is not finite, or the noise or the delay negative.
    """

    noise: float = 0.0
    """standard deviation of a relative error of friction and of wind, new at every step"""
    bias: float = 0.0
    """relative error of both: 0.2 tells 20 % more"""
    delay: float = 0.0
    """s, age of what is told"""
    withheld: bool = False
    """tells the nominal friction and no wind"""
    nominal_friction: float = 0.65

    def __post_init__(self) -> None:
        for name in ("noise", "bias", "delay", "nominal_friction"):
            value = real("Perception", name, getattr(self, name))
            if not math.isfinite(value) or (value < 0.0 and name != "bias"):
                raise InvalidInput(f"Perception: {name} = {value!r}: must be finite and not negative.")

    def told(self, friction: Array, wind: Array, period: float, seed: int) -> tuple[Array, Array]:
        """What is told at the instants of a run, given the true friction and wind (n,) there."""
        if self.withheld:
            return np.full_like(friction, self.nominal_friction), np.zeros_like(wind)
        late = np.maximum(np.arange(len(friction)) - round(self.delay / period), 0)
        rng = np.random.default_rng((seed, 0x7E11))
        told = []
        for truth in (friction, wind):
            error = 1.0 + self.bias + self.noise * rng.normal(size=len(truth))
            told.append(truth[late] * error)
        return np.maximum(told[0], 0.01), told[1]


class Estimating:
    """A controller whose scheduler is told estimated friction and wind instead of the true ones.

    controller: any, such as an `MPC` with a scheduler; estimator: run before each of its steps.
    `estimates` holds what was found at each step since the last reset.
    """

    def __init__(self, controller: Controller, estimator: FrictionWindEstimator) -> None:
        if not math.isclose(controller.period, estimator.period):
            raise InvalidInput(
                f"the controller's period is {controller.period!r} s, the estimator's {estimator.period!r} s: "
                "both run at the same instants."
            )
        self.controller = controller
        self.estimator = estimator
        self.reset()

    @property
    def name(self) -> str:
        """How tables call it."""
        return f"{self.controller.name}, friction and wind estimated"

    @property
    def period(self) -> float:
        """Control period (s)."""
        return self.controller.period

    def reset(self) -> None:
        """Forget the past."""
        self.controller.reset()
        self.estimator.reset()
        self.estimates: list[Estimate] = []
        self._command = 0.0

    def step(
        self, state: ArrayLike, speed: float, reference: ArrayLike, condition: SchedulingVariables | None = None
    ) -> Command:
        """One control step, see `MPC.step`; of `condition`, friction and wind are replaced."""
        found = self.estimator.step(state, speed, self._command)
        self.estimates.append(found)
        if condition is not None:
            condition = condition._replace(friction=found.friction, wind=found.wind)
        command = self.controller.step(state, speed, reference, condition)
        self._command = command.angle
        return command

    def describe(self) -> dict[str, Any]:
        """The configuration, for provenance."""
        belief = {field.name: getattr(self.estimator.belief, field.name) for field in fields(Belief)}
        return {**self.controller.describe(), "estimator": belief}
