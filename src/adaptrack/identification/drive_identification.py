"""Drive, brakes, resistance and pedals of a car, from logs of commands or pedals, and the speed.

With lags, dead times and noise known, the speed is linear in the forces at the points of a pedal map. The Kalman filter
of the likelihood turns the response to each of them into innovations, and their least squares give the map. No force
falls as its pedal goes down (C. L. Lawson and R. J. Hanson, *Solving Least Squares Problems*, chapter 23: bounds).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import PedalMap, Vehicle, load_vehicle
from adaptrack.core.identification import drive as kernel
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.estimates import estimates_of
from adaptrack.identification.hypotheses import Evidence, refuse_contradictions
from adaptrack.identification.identified_car import DriveIdentification
from adaptrack.identification.likelihood import NEARLY, Fit, InnovationLikelihood, Scored
from adaptrack.identification.log import (
    GAP_PERIODS,
    LEAST_GAP,
    check_times,
    find_outliers,
    is_rising,
    noise_of,
    require_columns,
)
from adaptrack.identification.quantities import Prior, Quantity, Reported, report_delay, report_quantity
from adaptrack.identification.reading import Columns, Reading, Source, read_logs

LONGITUDINAL_COMMANDS, PEDALS = ("force_command", "acceleration_command"), ("throttle", "brake")
MIN_COMPARED_SPEED, MIN_PEDAL_SPEED = 2.0, 0.3
"""m/s, below which speeds are not compared, with commands and with pedals: drives creep, and brakes hold a car."""
SPEED_POINTS = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 11.0, 16.0, 22.0, 30.0, 40.0, 55.0])
PEDAL_POINTS = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0])
"""m/s, -: points of a pedal map."""
BEND_SIGMA = 0.3
"""m/s^2, prior standard deviation of a force over mass from the line between the neighbouring points."""
FIRST_GAINS, PEDAL_TURNS = (4.0, 8.0), 5
"""m/s^2, of full throttle and full brake, at first; turns of likelihood and least squares until the map."""
LEAST_COMPARED = 20.0
"""s, above this speed."""
LEAST_REQUEST, LEAST_ACTING = 0.3, 4.0
"""m/s^2; s, for which drive or brakes are asked for as much, below which nothing is found of them."""
LEAST_CHANGE = 0.15
"""m/s^2, standard deviation of the requests of an actuator while it acts, below which gain and slope are one."""
ACTUATORS = ("drive", "brake")
DELAY_SHIFTS = (-0.9, 0.15, 0.9)
"""Spreads from the prior of both delays, from which the fit starts."""

DRIVE_QUANTITIES = (
    *(quantity for name, words in (("drive", "of the drive"), ("brake", "of the brakes")) for quantity in (
        Quantity(f"{name}_delay", "s", "positive", f"lag and dead time {words} together"),
        Quantity(f"{name}_lag_share", "-", "share", f"the lag's share of the delay {words}"),
        Quantity(f"{name}_gain", "-", "positive", f"gain {words} over the mass, relative to the mass of the car file"),
    )),
    Quantity("drag", "1/m", "real", "air drag over speed squared and mass"),
    Quantity("rolling", "m/s^2", "real", "rolling resistance over mass, and the mean slope of the road"),
    Quantity("push_spread", "m/s^2", "positive", "standard deviation of slope, wind and bends"),
    Quantity("push_time", "s", "positive", "their correlation time"),
    Quantity("jolt", "m/s^1.5", "positive", "white acceleration of the road"),
    Quantity("noise_speed", "m/s", "positive", "noise of the speed"),
)  # fmt: skip


class DriveLikelihood(InnovationLikelihood):
    """Likelihood of the speed along a log.

    rows: (4, n) as `core.identification.drive.DRIVE_ROW`; beliefs: by the names of `DRIVE_QUANTITIES`
    """

    quantities = DRIVE_QUANTITIES

    def __init__(self, rows: Array, beliefs: Mapping[str, Prior]) -> None:
        super().__init__(rows[kernel.DRIVE_ROW.time], rows[kernel.DRIVE_ROW.begins] > 0.0, beliefs)
        self._rows, self._answer = np.ascontiguousarray(rows), np.empty((len(kernel.DRIVE_ANSWER), self.time.size))
        self.counts = np.isfinite(self.innovations(np.zeros(len(DRIVE_QUANTITIES)))[0]) & self.settled

    def packed(self, z: Array) -> Array:
        """The quantities at a point z, in the order of `core.identification.drive.DriveQuantities`."""
        value = {quantity.name: float(x) for quantity, x in zip(self.quantities, self.values(z), strict=True)}
        for name in ACTUATORS:
            delay, share = value.pop(f"{name}_delay"), value.pop(f"{name}_lag_share")
            value |= {f"{name}_lag": share * delay, f"{name}_dead_time": (1.0 - share) * delay}
        return np.array([value[name] for name in kernel.DriveQuantities._fields])

    def innovations(self, z: Array) -> tuple[Array, Array]:
        """Innovations of the speed (m/s) and their variances, (n,) each, NaN where it is not compared."""
        kernel.speed_innovations(self.packed(z), self._rows, self._answer)
        return self._answer[kernel.DRIVE_ANSWER.innovation].copy(), self._answer[kernel.DRIVE_ANSWER.variance].copy()

    @property
    def reported(self) -> list[Reported]:
        """Free quantities that are reported."""
        free = [self.quantities[place].name for place in self.free]
        late, rows = "from a request until it begins to act on the logged speed", []
        for name in [name for name in ACTUATORS if f"{name}_gain" in free]:
            rows += report_delay(self.quantities, f"{name}_", "time constant", late)
            rows.append(report_quantity(self.quantities, f"{name}_gain"))
        return rows + [report_quantity(self.quantities, name) for name in ("drag", "rolling") if name in free]


def identify_drive(
    log: Source | Sequence[Source], car: str | os.PathLike[str] | Vehicle, *, reading: Reading | None = None
) -> DriveIdentification:
    """Identify drive, brakes and resistance from a log of commands and the speed, or several logs of one car.

    A request is positive for the drive and negative for the brakes. Gain and mass are one number: the gain of each
    actuator is relative to the mass of the car. The fit is the one of the steering: the likelihood of innovations.
    From pedals instead of a command, the pedal map is identified, with the resistance of the car file.

    Parameters
    ----------
    log
        A file or arrays by name, see `identify`: ``time`` (s), ``speed`` (m/s), and ``force_command`` (N at the wheels)
        or ``acceleration_command`` (m/s^2), or ``throttle`` and ``brake`` (0 to 1).
    car
        Its mass turns force into acceleration; its resistance is the prior.
    reading
        Columns, units, signs and clocks, where they are not as the names say.

    Raises
    ------
    StorageError
        When a file cannot be read.
    InvalidInput
        When a column is missing, the log is too slow or too short, neither drive nor brakes act in it, the speed
        contradicts the command, or a pedal is hardly used or leaves 0 to 1.
    """
    return drive_of_columns(read_logs(log, reading), car if isinstance(car, Vehicle) else load_vehicle(car))


def drive_of_columns(logs: Sequence[Columns], car: Vehicle) -> DriveIdentification:
    """Identify drive, brakes and resistance from columns; errors as `identify_drive`."""
    signals = set.intersection(*(set(columns.values) for columns in logs)) if logs else set()
    command = next((name for name in LONGITUDINAL_COMMANDS if name in signals), "")
    if not command and signals.issuperset(PEDALS):
        return _pedals_of_columns(logs, car)
    if not command:
        raise InvalidInput(
            "log: no column for force_command (N), acceleration_command (m/s^2), or throttle and brake (0 to 1): name "
            "it, --columns force_command=NAME."
        )
    for columns in logs:
        refuse_contradictions(Evidence(columns.values, mass=car.mass), "speed")
    rows, seconds = _joined_rows(logs, (command,), MIN_COMPARED_SPEED)
    if command == "force_command":
        rows[kernel.DRIVE_ROW.request] /= car.mass
    beliefs, findings = _beliefs(rows, car, command)
    likelihood = DriveLikelihood(rows, beliefs)
    z, scored = _fit_from_starts(likelihood)
    estimates, _ = estimates_of(Fit(likelihood, z, likelihood.covariance(scored)))
    return DriveIdentification(estimates, tuple(findings), car, command, seconds)


def _pedals_of_columns(logs: Sequence[Columns], car: Vehicle) -> DriveIdentification:
    """Identify the pedal map, drive and brakes: likelihood and least squares take turns; errors as `identify_drive`."""
    log, seconds = _joined_rows(logs, PEDALS, MIN_PEDAL_SPEED)
    for columns in logs:
        refuse_contradictions(Evidence(columns.values), "pedals")
    throttle, brake = log[1:3].max(axis=1)
    regression, z = PedalRegression(log, car), np.zeros(len(DRIVE_QUANTITIES))
    drive, brakes = FIRST_GAINS[0] * np.tile(PEDAL_POINTS, (regression.speeds.size, 1)), FIRST_GAINS[1] * PEDAL_POINTS
    for turn in range(PEDAL_TURNS):
        rows = regression.rows(drive, brakes)
        beliefs, findings = _beliefs(rows, car, "pedals")
        if len(findings) > 1:
            raise InvalidInput(f"log: {findings[0].split(':')[0]}: a pedal map needs many positions of both pedals.")
        likelihood = DriveLikelihood(rows, beliefs | {name: Prior(0.0, 0.0) for name in ("drag", "rolling")})
        z, scored = likelihood.fit(z) if turn else _fit_from_starts(likelihood)
        drive, brakes = regression.solve(likelihood.packed(z), likelihood.counts)
    estimates, _ = estimates_of(Fit(likelihood, z, likelihood.covariance(scored)))
    findings.append(
        f"the log reaches throttle {throttle:.2g}, brake {brake:.2g} and {np.nanmax(log[3]):.3g} m/s: the pedal map is "
        "extrapolated beyond"
    )
    force, brake_force = (np.round(car.mass * values, 1).tolist() for values in (drive, brakes))
    speeds, points = regression.speeds.tolist(), PEDAL_POINTS.tolist()
    pedals = PedalMap(speed=speeds, throttle=points, force=force, brake=points, brake_force=brake_force)
    return DriveIdentification(estimates, tuple(findings), car, "pedals", seconds, pedals)


class PedalRegression:
    """Least squares for the forces at the points of a pedal map, over the mass of the car (m/s^2).

    log: time, throttle, brake, compared speed, and 1 where a segment begins, (5, n)
    """

    def __init__(self, log: Array, car: Vehicle) -> None:
        self._time, throttle, brake, self._compared, self._begins = log
        is_compared = np.isfinite(self._compared)
        speed = np.interp(self._time, self._time[is_compared], self._compared[is_compared])
        rolling, drag = _resistance(car)
        self._resistance = rolling + drag * (speed * speed)
        self.speeds = SPEED_POINTS[: np.searchsorted(SPEED_POINTS, speed.max()) + 1]
        self._shares = np.array([np.interp(speed, self.speeds, point) for point in np.eye(self.speeds.size)])
        ends = np.stack([PEDAL_POINTS[:-1], PEDAL_POINTS[1:]], axis=1)
        self._throttle, self._brake = (
            np.array([np.interp(pedal, section, (0.0, 1.0)) for section in ends]) for pedal in (throttle, brake)
        )

    def rows(self, drive: Array, brakes: Array) -> Array:
        """Rows (`DRIVE_ROW`) for a map: requests relative to coasting, speeds without the effect of coasting."""
        driving = (self._shares * product(np.diff(drive, axis=1), self._throttle)).sum(axis=0)
        coasting = self._integral(product(drive[:, 0], self._shares) - self._resistance)
        request = driving - product(np.diff(brakes), self._brake)
        return np.stack([self._time, request, self._compared - coasting, self._begins])

    def solve(self, quantities: Array, counts: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Forces over mass at the points: drive (speeds, throttles), brakes (pedal positions,).

        quantities: `DriveQuantities`, whose gains are not used; counts: samples whose speed counts, (n,)
        """
        packed = kernel.DriveQuantities(*quantities)._replace(drive_gain=1.0, brake_gain=1.0)
        answer, zero = np.empty((len(kernel.DRIVE_ANSWER), self._time.size)), np.zeros(self._time.size)

        def whitened(request: Array, speed: Array) -> Array:
            log = np.stack([self._time, request, speed + 0.0 * self._compared, self._begins])
            kernel.speed_innovations(np.array(packed), log, answer)
            innovation, variance = answer[kernel.DRIVE_ANSWER.innovation], answer[kernel.DRIVE_ANSWER.variance]
            return (innovation / np.sqrt(variance))[counts]

        columns = []
        for share in self._shares:
            columns.append(whitened(zero, self._integral(share)))
            columns += [-whitened(share * ramp, zero) for ramp in self._throttle]
        columns += [-whitened(-ramp, zero) for ramp in self._brake]
        target = whitened(zero, self._compared + self._integral(self._resistance))
        steps, count = np.tril(np.ones((PEDAL_POINTS.size,) * 2)), self.speeds.size
        over_pedal, over_speed = product(_bends(PEDAL_POINTS), steps), np.kron(_bends(self.speeds), steps)
        smoothness = block_diag(np.vstack([np.kron(np.eye(count), over_pedal), over_speed]), over_pedal[:, 1:])
        system = np.vstack([np.column_stack([*columns, target]), np.pad(smoothness / BEND_SIGMA, ((0, 0), (0, 1)))])
        triangle = portable.triangle(system)
        least = np.zeros(len(columns))
        least[: count * PEDAL_POINTS.size : PEDAL_POINTS.size] = -np.inf  # coasting
        rises = lsq_linear(triangle[:, :-1], triangle[:, -1], (least, np.inf)).x
        drive, brakes = np.split(rises, [count * PEDAL_POINTS.size])
        return np.cumsum(drive.reshape(count, -1), axis=1), np.append(0.0, np.cumsum(brakes))

    def _integral(self, acceleration: Array) -> Array:
        return np.asarray(cumulative_trapezoid(acceleration, self._time, initial=0.0))


def _resistance(car: Vehicle) -> tuple[float, float]:
    """Rolling resistance (m/s^2) and air drag over speed squared (1/m) of a car, over its mass."""
    drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
    return car.rolling_resistance * GRAVITY, drag


def _bends(points: Array) -> Array:
    """Matrix that gives the distance of each inner value from the line between its neighbours, (n - 2, n)."""
    gaps = np.diff(points)
    slopes = np.diff(np.eye(points.size), axis=0) / gaps[:, None]
    return np.asarray(np.diff(slopes, axis=0) / (1.0 / gaps[1:] + 1.0 / gaps[:-1])[:, None])


def _fit_from_starts(likelihood: DriveLikelihood) -> tuple[Array, Scored]:
    """The most likely point from several delays, and what is known there."""
    delays = np.array([quantity.name.endswith("_delay") for quantity in DRIVE_QUANTITIES]) & (likelihood.spread > 0.0)
    return likelihood.fit(likelihood.fit_best((np.where(delays, shift, 0.0) for shift in DELAY_SHIFTS), NEARLY)[0])


def _joined_rows(logs: Sequence[Columns], requests: Sequence[str], slowest: float) -> tuple[Array, float]:
    """Rows of logs, one after the other, and how long (s) their speed is compared: above `slowest` (m/s).

    Rows are time, requests, compared speed, and 1 where a segment begins: `DRIVE_ROW` for one request.
    """
    rows = np.concatenate([_rows(columns.values, requests, slowest) for columns in logs], axis=1)
    time, *_, speed, begins = rows
    for first in np.flatnonzero(np.diff(time) <= 0.0) + 1:
        time[first:] += time[first - 1] + 1.0 - time[first]
    seconds = float(np.sum(np.diff(time)[np.isfinite(speed[1:]) & np.isfinite(speed[:-1]) & (begins[1:] <= 0.0)]))
    if seconds < LEAST_COMPARED:
        raise InvalidInput(
            f"log: {seconds:.3g} s above {slowest:g} m/s: at least {LEAST_COMPARED:g} s of driving, "
            "accelerating and braking are needed."
        )
    return rows, seconds


def _rows(values: Mapping[str, Array], requests: Sequence[str], slowest: float) -> Array:
    """Rows of one log as `_joined_rows`: of the samples that have a time and all requests."""
    require_columns(values, "time", "speed")
    usable = is_rising(values["time"]) & np.all([np.isfinite(values[name]) for name in requests], axis=0)
    time, speed = values["time"][usable], values["speed"][usable]
    if time.size < 2:
        raise InvalidInput(f"log: {' and '.join(requests)}: {time.size} values with a time: too few.")
    period = check_times(time)
    compared = np.where(find_outliers("speed", time, speed) | (speed < slowest), np.nan, speed)
    begins = np.append(True, np.diff(time) > max(GAP_PERIODS * period, LEAST_GAP))
    return np.stack([time, *(values[name][usable] for name in requests), compared, begins.astype(np.float64)])


def _beliefs(rows: Array, car: Vehicle, command: str) -> tuple[dict[str, Prior], list[str]]:
    """Prior of every quantity, and what the log cannot tell, in words; an actuator that hardly acts is not free."""
    time, request, speed, _ = rows
    rolling, drag = _resistance(car)
    share = 1.0 if command == "force_command" else 0.5  # some of it may be compensated behind an acceleration command
    beliefs = {
        "drag": Prior(share * drag, max(drag, 1e-4) * (1.5 - share)), "rolling": Prior(share * rolling, 0.15),
        "push_spread": Prior(0.2, 1.0), "push_time": Prior(8.0, 0.7), "jolt": Prior(0.03, 1.5),
        "noise_speed": Prior(max(noise_of(speed), 1e-4), 1.5),
    }  # fmt: skip
    findings, steps = [], np.append(np.diff(time), 0.0)
    for name, sign, verb in (("drive", 1.0, "accelerating"), ("brake", -1.0, "braking")):
        acts = (sign * request > LEAST_REQUEST) & np.isfinite(speed)
        acting = float(np.sum(steps[acts & (steps < 1.0)]))
        is_told = acting >= LEAST_ACTING and float(np.std(request[acts])) >= LEAST_CHANGE
        spreads = (1.0, 1.8, 0.25) if is_told else (0.0, 0.0, 0.0)
        believed = car.drive if name == "drive" else car.brakes
        medians = (max(believed.lag + believed.dead_time, 0.05), 0.5, believed.gain) if believed else (0.3, 0.5, 1.0)
        for part, median, spread in zip(("delay", "lag_share", "gain"), medians, spreads, strict=True):
            beliefs[f"{name}_{part}"] = Prior(median, spread)
        if not is_told:
            cause = "hardly any" if acting < LEAST_ACTING else "only even"
            findings.append(f"{cause} {verb} in the log: the {'drive' if sign > 0.0 else 'brakes'} keep their values")
    if len(findings) == len(ACTUATORS):
        raise InvalidInput(
            f"log: no accelerating and no braking of {LEAST_REQUEST:g} m/s^2 for {LEAST_ACTING:g} s that changes: "
            "drive with changing force, and brake."
        )
    findings.append("gain and mass are one number: each gain holds for the mass of the car file")
    if command == "acceleration_command":
        findings.append("resistance stays as in the car file: behind an acceleration command it may be compensated")
    return beliefs, findings
