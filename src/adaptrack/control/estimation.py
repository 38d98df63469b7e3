"""What a controller knows: the state and the disturbance that it predicts from, and friction and wind.

The estimator of an MPC gives the state of its prediction model (`Estimator`). The scheduler of one is given
friction and wind exactly, with errors (`Perception`), or as a car's own signals show them (`FrictionWindEstimator`):
neither is measured. Friction shows only where the tyres are near their limit; elsewhere the estimate drifts back to a
nominal value, and its standard deviation says so.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Self, final

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Count, Finite, Natural, NotNegative, Positive, checked, real, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import Contract, Registry, compile_function
from adaptrack.cars.plant import DualTrack, SingleTrack
from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle, load_tyre, pack_plant
from adaptrack.control.models import PredictionModel
from adaptrack.core.estimators import friction_wind
from adaptrack.core.estimators.extended_kalman import compile_estimator
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.member import MemberFunction
from adaptrack.core.simulation.run import VariableEstimator
from adaptrack.core.synthesis.plant import lateral_rate
from adaptrack.scenario.profile import Profile, load_profile

NOTHING_MEASURED = np.array([math.nan] * 6 + [0.0] * 4)
"""`core.models.contract.MEASUREMENT` without a sample, on a path that does not turn, with an unknown friction."""
LEAST_NOISE_VY, LEAST_NOISE_YAW_RATE = 0.005, 0.001
"""m/s and rad/s: with better sensors than these, the model's own errors are what limits the filter."""


MIN_FILTER_SPEED = 5.0
"""m/s: from this speed on a step of the filter is no longer than the time constants of the lateral motion."""


class Estimator(ABC):
    """From measurements to the state x (n,) of the MPC's prediction model and a disturbance d (n,).

    The controller predicts from x(k+1) = A x(k) + B u(k) + d. `check_estimator` admits one.
    """

    name: str
    """how tables call it"""

    @property
    def tyres(self) -> tuple[float, float]:
        """Friction and shape factor by which it knows that tyres pull less than linear ones; friction 0: not at all."""
        return 0.0, 0.0

    @property
    @abstractmethod
    def function(self) -> Any:
        """The compiled ``estimate(speed, measured, command, a, b, parameters, memory, x, d)``.

        See `core.estimators.extended_kalman`. None: the controller's own form on increments of the measured state.
        """

    def parameters(self, model: PredictionModel) -> Array:
        """The constant numbers of its function, with a model."""
        return np.zeros(0)

    def memory_size(self, model: PredictionModel) -> int:
        """Numbers that it remembers from step to step."""
        return 0

    def change_path(self, model: PredictionModel, memory: Array, heading: float, offset: float) -> None:
        """Heading (rad) and offset (m) of the past have grown by so much, against another path; else begin anew."""
        memory[:] = 0.0

    def late(self, model: PredictionModel) -> int:
        """Control periods that a Kalman filter goes through anew for samples that come late; -1: it is none."""
        return -1

    def left_out(self, memory: Array) -> str | None:
        """The sensor that it leaves out because it disagrees with all others, by what it remembers; None: none."""
        return None

    def check_fits(self, model: PredictionModel) -> None:  # noqa: B027 (most fit any model)
        """Refuse a model that it cannot serve.

        Raises
        ------
        InvalidInput
            When it is none for this model.
        """


@final
class Deadbeat(Estimator):
    """The paper's: x is the measured state, and d explains the last measurement whole.

    d(k) = x(k) - A x(k-1) - B u(k-1), all at the present speed: the free response is then F [x(k) - x(k-1); y], the
    incremental form of eqs. (9), (10). It needs the whole state measured.
    """

    name, function = "deadbeat", None

    def check_fits(self, model: PredictionModel) -> None:
        if "wheel_angle" in model.states:
            raise InvalidInput(
                f"estimator 'deadbeat': needs the whole state of model {model.name!r} measured, and wheel_angle is not "
                "given to every controller: use an estimator that reconstructs it."
            )
        if model.dead_time > 0.0:
            raise InvalidInput(
                f"estimator 'deadbeat': knows no dead time, and model {model.name!r} has {model.dead_time:g} s: use an "
                "estimator that carries the state over it, such as 'kalman'."
            )


@final
class UserEstimator(Estimator):
    """An estimator of one's own: one function and its numbers. `check_estimator` admits it.

    estimate(speed, measured, command, a, b, parameters, memory, x, d) writes x and d and may return for how long (s) it
    has had no position, see `core.estimators.extended_kalman`, and `UserPlant` for how it is called; parameters:
    name -> number; memory_size: numbers that it remembers, a whole number or a function of the number of states.

    Raises
    ------
    ContractError
        When the function cannot be compiled; the message states file, line and remedy.
    """

    function = None

    @checked
    def __init__(
        self, estimate: MemberFunction, *, parameters: Mapping[str, float] | None = None,
        memory_size: int | Callable[[int], int] = 0, label: str = "user",
    ) -> None:  # fmt: skip
        self.name, where = label, f"UserEstimator {label!r}"
        self.numbers = {key: real(where, key, value) for key, value in (parameters or {}).items()}
        self._memory_size = memory_size
        form = "function as f(speed, measured, command, a, b, parameters, memory, x, d) on float64 numbers and arrays"
        self.function = compile_function(where, compile_estimator, estimate, form)

    def parameters(self, model: PredictionModel) -> Array:
        return np.array(list(self.numbers.values()), dtype=float)

    def memory_size(self, model: PredictionModel) -> int:
        size = self._memory_size
        return size(model.n) if callable(size) else int(size)


_registry: Registry[Estimator] = Registry(
    "estimator", "register_estimator", {"deadbeat": Deadbeat, "kalman": "adaptrack.control.kalman:KalmanFilter"},
    member_type=Estimator,
)  # fmt: skip


list_estimators = _registry.names


@checked
def register_estimator(name: str, factory: Callable[..., Estimator] | str) -> None:
    """Make ``get_estimator(name, **options)`` call ``factory(**options)``.

    Raises `InvalidInput` for a name that is taken or empty, and a factory that is neither callable nor a text
    ``"package.module:name"``, or takes other arguments.
    """
    _registry.add(name, factory)


@checked
def get_estimator(name: str, **options: Any) -> Estimator:
    """A registered estimator; raises `UnknownName` when none has this name."""
    return _registry.make(name, **options)


@checked
def check_estimator(estimator: Estimator, model: PredictionModel, speed: float = 15.0, steps: Count = 200) -> None:
    """Test that an estimator keeps the contract on which the controller relies, with a model that it is meant for.

    It fits the model. Driven by measurements that the model itself gives, at rest first, then under a steering command
    that wanders: it writes x and d, finite, leaves its other arguments alone, and in the end predicts the output of the
    next period to a millimetre; a measurement that is not finite gives no NaN.

    Raises
    ------
    ContractError
        Naming the clause that is broken and the evidence.
    """

    require = Contract(f"estimator {estimator.name!r}").require
    estimator.check_fits(model)
    if estimator.function is None:
        return
    a, b, c = model.discrete(speed)
    matrix, column, places = np.ascontiguousarray(a), b[:, 0].copy(), model.measured_places()
    parameters, memory = estimator.parameters(model), np.zeros(estimator.memory_size(model))
    x, estimate, d = np.zeros(model.n), np.full(model.n, np.nan), np.full(model.n, np.nan)
    command = ahead = 0.0
    for k in range(steps):
        measured = NOTHING_MEASURED.copy()
        measured[places] = x
        copies = [array.copy() for array in (measured, matrix, column, parameters)]
        estimator.function(speed, measured, command, matrix, column, parameters, memory, estimate, d)
        after = (measured, matrix, column, parameters)
        unchanged = all(np.array_equal(*pair, equal_nan=True) for pair in zip(copies, after, strict=True))
        require(unchanged, "it must write to memory, x and d only", f"step {k}")
        is_finite = np.isfinite([estimate, d]).all()
        require(is_finite, "x and d must be written and finite", f"x = {estimate}, d = {d} at step {k}")
        command = 0.01 * portable.sin(0.2 * k)
        ahead = product(c, product(matrix, estimate) + column * command + d).item()
        x = product(matrix, x) + column * command
    y = product(c, x).item()
    holds = abs(ahead - y) < 1e-3
    require(holds, "it must predict the model that it is driven by", f"y = {ahead:g} m instead of {y:g} m")
    estimator.function(speed, NOTHING_MEASURED.copy(), command, matrix, column, parameters, memory, estimate, d)
    is_finite = np.isfinite([estimate, d]).all()
    require(is_finite, "a measurement that is not finite must leave x and d finite", f"x = {estimate}, d = {d}")


class FrictionWindEstimate(NamedTuple):
    """Estimates of friction, wind and stiffness at one control instant, with their standard deviations."""

    friction: float
    """coefficient of friction, the same on all wheels; the median"""
    wind: float
    """m/s, v_w: velocity of the air along +Y"""
    friction_std: float
    wind_std: float
    """standard deviation of the wind (m/s)"""
    stiffness: float
    """cornering stiffness of the tyres, over what the estimator was given"""


class FrictionWindEstimator:
    """Extended Kalman filter for road friction and lateral wind, from the signals of a car.

    `core.estimators.friction_wind` has its equations and sources. Measured are v_y and the yaw rate, and the lateral
    acceleration where there is a sensor; yaw and speed count as exact, and the wind along X as zero.

    vehicle, tyre, steering: the assumed car (by default the vehicle's tyre and an ideal actuator); period:
    control period; delay: whether a command acts one period after its measurement; noise_vy, noise_yaw_rate,
    noise_acceleration: standard deviations of the sensors.
    """

    _prior = friction_wind.DEFAULT_PRIOR
    """`core.estimators.friction_wind.FrictionWindPrior`; an experiment replaces it in a subclass"""

    @checked
    def __init__(
        self,
        vehicle: Vehicle,
        tyre: Tyre | str | None = None,
        steering: SteeringActuator | None = None,
        *,
        period: Annotated[Positive, "s"] = 0.05,
        delay: bool = True,
        noise_vy: Annotated[Positive, "m/s"] = 0.05,
        noise_yaw_rate: Annotated[Positive, "rad/s"] = 0.01,
        noise_acceleration: Annotated[Positive, "m/s^2"] = 0.1,
    ) -> None:
        tyre = vehicle.tyre if tyre is None else tyre
        self.vehicle = vehicle
        self.tyre = tyre if isinstance(tyre, Tyre) else load_tyre(tyre)
        self.steering = steering or SteeringActuator.ideal()
        self.delay = bool(delay)
        self.period = period
        rate = lateral_rate(vehicle.numbers, self.tyre.numbers)
        self.steps = math.ceil(self.period * rate / MIN_FILTER_SPEED)
        self.noise = (noise_vy, noise_yaw_rate, noise_acceleration)
        self._packed = pack_plant(self.vehicle, self.tyre, self.steering)
        self._settings = self.settings()
        self.reset()

    @classmethod
    @checked
    def of(
        cls,
        plant: SingleTrack | DualTrack,
        profile: str | Profile = "road",
        *,
        period: float | None = None,
        noise_acceleration: float = 0.1,
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
            delay=profile.delay > 0.0,
            noise_vy=max(profile.noise_vy, LEAST_NOISE_VY),
            noise_yaw_rate=max(profile.noise_yaw_rate, LEAST_NOISE_YAW_RATE),
            noise_acceleration=noise_acceleration,
        )

    def settings(self) -> Array:
        """Everything but the vehicle: numbers of `core.estimators.friction_wind.FrictionWindSettings`."""
        prior, step = self._prior, self.period / self.steps
        root, (least, most) = math.sqrt(step), prior.friction_range
        noise_vy, noise_yaw_rate, noise_acceleration = self.noise
        row = friction_wind.FrictionWindSettings.new(
            1, prior=prior, steps=self.steps, step=step, delay=self.delay, noise_vy=noise_vy,
            noise_yaw_rate=noise_yaw_rate, noise_acceleration=noise_acceleration, drift_vy=prior.drift_vy * root,
            drift_yaw_rate=prior.drift_yaw_rate * root, tyre_error=prior.tyre_error * root,
            log_friction=portable.log(prior.nominal_friction), log_least_friction=portable.log(least),
            log_most_friction=portable.log(most), friction_left=portable.exp(-step / prior.friction_time),
            wind_left=portable.exp(-step / prior.wind_time), stiffness_left=portable.exp(-step / prior.stiffness_time),
        )  # fmt: skip
        numbers: Array = row.view(float)
        return numbers

    def packed_for(self, slots: int) -> Any:
        """So many fresh estimators like this one, as `core.simulation.run.VariableEstimator`."""
        return VariableEstimator(self._packed, self._settings, friction_wind.Memory.new(slots))

    def reset(self, memory: Array | None = None) -> None:
        """Forget the past: the next step is the first, with the wheels straight ahead.

        memory: that of one of `packed_for`, whose steps are this one's from now on.
        """
        self._memory = friction_wind.Memory.new() if memory is None else memory

    def step(
        self, measured: ArrayLike, speed: float, command: float, acceleration: float | None = None
    ) -> FrictionWindEstimate:
        """One step, at a control instant, before the controller's.

        measured: x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; speed: v_x (m/s); command: the controller's
        last steering command (rad), 0 before its first; acceleration: measured lateral acceleration (m/s^2), if there
        is such a sensor. What is absurd (1e5 or more) or not a number is left out, or the last known value
        stands in.

        Raises
        ------
        InvalidInput
            When `measured` has another shape, or an argument is not made of numbers.
        """
        sensed = np.ascontiguousarray(reals("measured", measured))
        if sensed.shape != (4,):
            raise InvalidInput(f"measured: shape {sensed.shape}, expected (4,): v_y, yaw, yaw rate, y.")
        felt = math.nan if acceleration is None else real("estimator", "acceleration", acceleration)
        forward, sent = real("estimator", "speed", speed, measured=True), real("estimator", "command", command)
        friction_wind.estimate(0, sensed, forward, sent, felt, self._packed, self._settings, self._memory)
        return self.estimate

    @property
    def estimate(self) -> FrictionWindEstimate:
        """The estimate of the last step."""
        memory = self._memory[0]
        values = {name: float(memory[name]) for name in ("friction", "wind", "friction_std", "wind_std")}
        return FrictionWindEstimate(**values, stiffness=portable.exp(memory.z[friction_wind.LOG_STIFFNESS]))


@checked
@dataclass(frozen=True)
class Perception:
    """Friction and wind for a scheduler and the driver, with a delay, a bias and noise in place of an estimator."""

    noise: NotNegative = 0.0
    """standard deviation of a relative error of friction and of wind, new at every step"""
    bias: Finite = 0.0
    """relative error of both: 0.2: 20 % too much"""
    delay: Annotated[NotNegative, "s"] = 0.0
    """age of what is known"""
    withheld: bool = False
    """the nominal friction and no wind"""
    nominal_friction: NotNegative = 0.65
    friction: Annotated[Positive, "-"] | None = None
    """coefficient that is assumed wherever the car drives; None: the true one, with the errors"""
    seed: Natural = 0
    """of the noise: the scenario i of a batch has that of seed + i"""

    def perceive(self, friction: Array, wind: Array, period: float, number: int) -> tuple[Array, Array]:
        """Return the perceived friction and wind at the instants of a run, from the true ones (n,).

        number: of the scenario in its batch.
        """
        if self.withheld:
            return np.full_like(friction, self.nominal_friction), np.zeros_like(wind)
        late = np.maximum(np.arange(len(friction)) - round(self.delay / period), 0)
        rng = np.random.default_rng((self.seed + number, 0x7E11))
        estimates = []
        for truth in (friction, wind):
            error = 1.0 + self.bias + self.noise * rng.normal(size=len(truth))
            estimates.append(truth[late] * error)
        if self.friction is not None:
            estimates[0] = np.full_like(friction, self.friction)
        return np.maximum(estimates[0], 0.01), estimates[1]
