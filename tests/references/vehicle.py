"""The equations of motion a second time: NumPy, wheel by wheel, written from the equations and not from the kernels.

Nothing here is fast. Wheels are points with a position, a direction and a load; forces are vectors; moments are cross
products. The parameters come from the validated records by name, so a slip in their packing shows as well.

State, as in the package: X, Y, yaw, v_x, v_y, yaw rate, then for the dual track the relaxed slip angles of the wheels
front-left, front-right, rear-left, rear-right and the accelerations that the wheel loads follow.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle

Array = npt.NDArray[np.float64]

STANDARD_GRAVITY = 9.80665  # m/s^2
LEAST_SPEED = 1.0  # m/s, slip angles are formed with at least this
LEAST_LOAD = 1.0  # N, a lifted wheel keeps this


def cornering_stiffness(tyre: Tyre, nominal: float, load: float) -> float:
    """N/rad of one tyre whose stiffness at the nominal load is `nominal`."""
    q = load / tyre.nominal_load
    if tyre.stiffness_load == "constant":
        return nominal
    if tyre.stiffness_load == "linear":
        return nominal * q
    peak = tyre.digressive_load_ratio
    return nominal * np.sin(2 * np.arctan(q / peak)) / np.sin(2 * np.arctan(1 / peak))


def tyre_force(tyre: Tyre, nominal: float, slip: float, load: float, friction: float) -> float:
    """Lateral force (N) of one tyre."""
    stiffness = cornering_stiffness(tyre, nominal, load)
    if tyre.kind == "linear":
        return stiffness * friction * slip
    c, e = tyre.shape, tyre.curvature
    d = friction * load * max(1 - tyre.friction_load_sensitivity * (load / tyre.nominal_load - 1), 0.1)
    b = stiffness / (c * d)
    return d * np.sin(c * np.arctan(b * slip - e * (b * slip - np.arctan(b * slip))))


def rotation(angle: float) -> Array:
    """From a frame turned by `angle` to the frame in which it is turned."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def air_load(car: Vehicle, yaw: float, velocity: Array, wind: Array) -> tuple[Array, float]:
    """Force (2,) in body axes, N, and yaw moment, N m, of the air on the body."""
    relative = velocity - rotation(yaw).T @ wind
    pressure = 0.5 * car.air_density * car.frontal_area * relative @ relative
    # the side on which the air comes in pushes, measured from the nose or from the tail
    beta = np.arctan2(-relative[1], max(abs(relative[0]), 1e-6))
    beta = np.clip(beta, -car.wind_angle_limit, car.wind_angle_limit)
    drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient * relative[0] * abs(relative[0])
    force = np.array([-drag, pressure * car.side_force_slope * beta])
    return force, pressure * car.wheelbase * car.yaw_moment_slope * beta


def rolling(car: Vehicle, vx: float) -> float:
    """Rolling resistance (N), fading in over the first half metre per second."""
    return car.rolling_resistance * car.mass * STANDARD_GRAVITY * float(np.clip(vx / 0.5, -1, 1))


def kinematics(x: Array) -> Array:
    """Eq. (5) and its companions: dX/dt, dY/dt, dyaw/dt."""
    return np.append(rotation(x[2]) @ x[3:5], x[5])


def single_track(
    car: Vehicle, tyre: Tyre, x: Array, u: Array, environment: Array, acceleration: float | None = None
) -> Array:
    """dx/dt (6,) of eqs. (1), (3), (4), (5); acceleration: prescribed dv_x/dt (m/s^2), none to let the force act."""
    vx, vy, r = x[3:6]
    speed = max(vx, LEAST_SPEED)
    axles = (
        (car.lf, tyre.stiffness_front, car.lr, u[0], environment[0:2].mean()),
        (-car.lr, tyre.stiffness_rear, car.lf, 0.0, environment[2:4].mean()),
    )
    air, moment = air_load(car, x[2], x[3:5], environment[4:6])
    force = np.array([u[1] - rolling(car, vx), 0.0]) + air
    for place, stiffness, arm, steering, friction in axles:
        slip = steering - np.arctan((vy + place * r) / speed)
        load = car.mass * STANDARD_GRAVITY * arm / car.wheelbase / 2
        axle = 2 * tyre_force(tyre, stiffness, slip, load, friction)
        force[1] += axle
        moment += place * axle
    motion = force / car.mass + r * np.array([vy, -vx])
    if acceleration is not None:
        motion[0] = acceleration
    motion[1] += pull_of_bank(environment)
    return np.concatenate([kinematics(x), motion, [moment / car.yaw_inertia]])


def pull_of_bank(environment: Array) -> float:
    """What a banked road adds to dv_y/dt (m/s^2), behind friction and wind; 0 where it is left out."""
    return float(environment[6:].sum())


def wheel_loads(car: Vehicle, felt: Array) -> Array:
    """Vertical loads (4,) under the accelerations `felt` = (longitudinal, lateral) of the centre of gravity."""
    weight = car.mass * STANDARD_GRAVITY
    loads = np.empty(4)
    for first, share, sign, track in ((0, car.lr, -1, car.track_front), (2, car.lf, 1, car.track_rear)):
        share = share / car.wheelbase
        # the moment m a h about the road is balanced by the axles (pitch) and, axle by axle, by the sides (roll)
        axle = weight * share + sign * car.mass * felt[0] * car.cg_height / car.wheelbase
        across = car.mass * share * felt[1] * car.cg_height / track
        loads[first : first + 2] = axle / 2 - across, axle / 2 + across
    return np.maximum(loads, LEAST_LOAD)


def dual_track(
    car: Vehicle, tyre: Tyre, x: Array, u: Array, environment: Array, acceleration: float | None = None
) -> Array:
    """dx/dt (12,) on four tyres; acceleration: prescribed dv_x/dt (m/s^2), none to let the force act."""
    velocity, r = x[3:5], x[5]
    slips, felt = x[6:10], x[10:12]
    places = np.array(
        [
            [car.lf, car.track_front / 2],
            [car.lf, -car.track_front / 2],
            [-car.lr, car.track_rear / 2],
            [-car.lr, -car.track_rear / 2],
        ]
    )
    directions = np.array([u[0], u[0], 0.0, 0.0])
    stiffness = np.repeat([tyre.stiffness_front, tyre.stiffness_rear], 2)
    loads = wheel_loads(car, felt)
    demand = u[1] if acceleration is None else 0.0
    front = car.drive_front if demand >= 0 else car.brake_front
    shares = np.repeat([front, 1 - front], 2) / 2

    force, moment = air_load(car, x[2], velocity, environment[4:6])
    force[0] -= rolling(car, velocity[0])
    slip_rates = np.zeros(4)
    for i, place in enumerate(places):
        at_wheel = velocity + r * np.array([-place[1], place[0]])
        slip = directions[i] - np.arctan(at_wheel[1] / max(at_wheel[0], LEAST_SPEED))
        relaxed = slip
        if tyre.relaxation_length > 0:
            relaxed = slips[i]
            slip_rates[i] = max(abs(velocity[0]), LEAST_SPEED) / tyre.relaxation_length * (slip - relaxed)
        grip = environment[i] * loads[i]
        along = float(np.clip(shares[i] * demand, -grip, grip))
        across = tyre_force(tyre, stiffness[i], relaxed, loads[i], environment[i])
        if tyre.kind != "linear":
            across *= np.sqrt(max(1 - (along / grip) ** 2, 0.01))
        pull = rotation(directions[i]) @ np.array([along, across])
        force = force + pull
        moment += place[0] * pull[1] - place[1] * pull[0]
    motion = force / car.mass + r * np.array([velocity[1], -velocity[0]])
    if acceleration is not None:
        motion[0] = acceleration
    felt_rates = (motion - r * np.array([velocity[1], -velocity[0]]) - felt) / car.load_transfer_time
    motion[1] += pull_of_bank(environment)
    return np.concatenate([kinematics(x), motion, [moment / car.yaw_inertia], slip_rates, felt_rates])


def steering_speed(actuator: SteeringActuator, angle: float, command: float) -> float:
    """d(angle)/dt (rad/s) of the steering actuator."""
    target = np.clip(command, -actuator.limit, actuator.limit)
    return float(np.clip((target - angle) / actuator.lag, -actuator.rate, actuator.rate))
