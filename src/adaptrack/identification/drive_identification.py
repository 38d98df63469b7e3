"""Drive, brakes and resistance of a car, from logs of commands of acceleration or force and the speed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.core import drive_identification as kernel
from adaptrack.core.plants.forces import GRAVITY
from adaptrack.identification.conventions import refuse_contradictions
from adaptrack.identification.estimates import ReportedRow, estimates_at
from adaptrack.identification.identified_car import DriveIdentification
from adaptrack.identification.likelihood import NEARLY, SETTLING, InnovationLikelihood
from adaptrack.identification.log import GAP_PERIODS, LEAST_GAP, check_times, noise_of
from adaptrack.identification.longitudinal_conventions import compare_longitudinal
from adaptrack.identification.outliers import find_outliers
from adaptrack.identification.quantities import Prior, Quantity, kinds_of, values_of
from adaptrack.identification.reading import Columns, Reading, Source, read_columns

Array = NDArray[np.float64]

LONGITUDINAL_COMMANDS = ("force_command", "acceleration_command")
MIN_COMPARED_SPEED = 2.0
"""m/s, below which speeds are not compared: drives creep, and brakes hold a car at rest."""
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
_INDEX = {quantity.name: i for i, quantity in enumerate(DRIVE_QUANTITIES)}
_KINDS = kinds_of(DRIVE_QUANTITIES)


class DriveLikelihood(InnovationLikelihood):
    """Likelihood of the speed along a log.

    rows: (4, n) as `core.drive_identification.DRIVE_ROW`; beliefs: by the names of `DRIVE_QUANTITIES`
    """

    def __init__(self, rows: Array, beliefs: Mapping[str, Prior]) -> None:
        self.time, self._rows = rows[kernel.DRIVE_ROW.time], np.ascontiguousarray(rows)
        self._answer = np.empty((len(kernel.DRIVE_ANSWER), self.time.size))
        self.median, self.spread = np.array([beliefs[quantity.name] for quantity in DRIVE_QUANTITIES]).T.copy()
        self.free = np.flatnonzero(self.spread > 0.0)
        begins = rows[kernel.DRIVE_ROW.begins] > 0.0
        first = self.time[np.maximum.accumulate(np.where(begins, np.arange(self.time.size), 0))]
        self.innovations(np.zeros(len(DRIVE_QUANTITIES)))
        self.counts = np.isfinite(self._answer[kernel.DRIVE_ANSWER.innovation]) & (self.time - first >= SETTLING)

    def values(self, z: Array) -> Array:
        """The quantities at a point z, in the order of `DRIVE_QUANTITIES`."""
        return values_of(z, self.median, self.spread, _KINDS)

    def innovations(self, z: Array) -> tuple[Array, Array]:
        """Innovations of the speed (m/s) and their variances, (n,) each, NaN where it is not compared."""
        value = dict(zip(_INDEX, self.values(z), strict=True))
        for name in ACTUATORS:
            delay, share = value.pop(f"{name}_delay"), value.pop(f"{name}_lag_share")
            value |= {f"{name}_lag": share * delay, f"{name}_dead_time": (1.0 - share) * delay}
        packed = np.array([value[name] for name in kernel.DriveQuantities._fields])
        kernel.speed_innovations(packed, self._rows, self._answer)
        return self._answer[kernel.DRIVE_ANSWER.innovation].copy(), self._answer[kernel.DRIVE_ANSWER.variance].copy()

    @property
    def reported(self) -> list[ReportedRow]:
        """Rows of the free quantities that are reported."""
        free = {DRIVE_QUANTITIES[place].name for place in self.free}
        actuators = [row for name in ACTUATORS if f"{name}_gain" in free for row in _actuator_rows(name)]
        return [*actuators, _value_row("drag"), _value_row("rolling")]


def _value_row(name: str) -> ReportedRow:
    """Row of a quantity that is reported as it is."""
    place = _INDEX[name]
    quantity = DRIVE_QUANTITIES[place]
    return name, quantity.unit, quantity.meaning, quantity.kind == "positive", lambda v: float(v[place])


def _actuator_rows(name: str) -> list[ReportedRow]:
    """Rows of drive or brakes."""
    delay, share = _INDEX[f"{name}_delay"], _INDEX[f"{name}_lag_share"]
    late = "from a request until it begins to act on the logged speed"
    return [
        (f"{name}_lag", "s", "time constant", True, lambda v: float(v[share] * v[delay])),
        (f"{name}_dead_time", "s", late, True, lambda v: float((1.0 - v[share]) * v[delay])),
        _value_row(f"{name}_gain"),
    ]


def identify_drive(
    log: Source | Sequence[Source], car: str | os.PathLike[str] | Vehicle, *, reading: Reading | None = None
) -> DriveIdentification:
    """Identify drive, brakes and resistance from a log of commands and the speed, or several logs of one car.

    A request is positive for the drive and negative for the brakes. Gain and mass are one number: the gain of each
    actuator is relative to the mass of the car. The fit is the one of the steering: the likelihood of innovations.

    Parameters
    ----------
    log
        A file or arrays by name, see `identify`: ``time`` (s), ``speed`` (m/s), and ``force_command`` (N at the wheels)
        or ``acceleration_command`` (m/s^2).
    car
        Its mass turns force into acceleration; its resistance is the prior.
    reading
        Columns, units, signs and clocks, where they are not as the names say.

    Raises
    ------
    StorageError
        When a file cannot be read.
    InvalidInput
        When a column is missing, the log is too slow or too short, neither drive nor brakes act in it, or the speed
        contradicts the command.
    """
    sources = [log] if isinstance(log, str | os.PathLike | Mapping) else list(log)
    columns = [read_columns(source, reading or Reading()) for source in sources]
    return drive_of_columns(columns, car if isinstance(car, Vehicle) else load_vehicle(car))


def drive_of_columns(logs: Sequence[Columns], car: Vehicle) -> DriveIdentification:
    """Identify drive, brakes and resistance from columns; errors as `identify_drive`."""
    command = next((name for name in LONGITUDINAL_COMMANDS if all(name in columns.values for columns in logs)), "")
    if not command or not logs:
        raise InvalidInput(
            "log: no column for force_command (N) or acceleration_command (m/s^2): name it, --columns "
            "force_command=NAME."
        )
    for columns in logs:
        refuse_contradictions(compare_longitudinal(columns.values, car.mass))
    rows = np.concatenate(
        [_rows(columns.values, command, 1.0 if command == "acceleration_command" else car.mass) for columns in logs],
        axis=1,
    )
    time = rows[kernel.DRIVE_ROW.time]
    for first in np.flatnonzero(np.diff(time) <= 0.0) + 1:  # one log after the other
        time[first:] += time[first - 1] + 1.0 - time[first]
    seconds = _compared_seconds(rows)
    beliefs, findings = _beliefs(rows, car, command)
    likelihood = DriveLikelihood(rows, beliefs)
    delays = np.array([quantity.name.endswith("_delay") for quantity in DRIVE_QUANTITIES]) & (likelihood.spread > 0.0)
    starts = [likelihood.fit(np.where(delays, shift, 0.0), NEARLY)[0] for shift in DELAY_SHIFTS]
    z, at = likelihood.fit(min(starts, key=likelihood.objective))
    estimates, _ = estimates_at(likelihood, likelihood.reported, z, likelihood.covariance(at))
    return DriveIdentification(estimates, tuple(findings), car, command, seconds)


def _rows(values: Mapping[str, Array], command: str, mass: float) -> Array:
    """Rows (`DRIVE_ROW`) of a log whose samples have a time and a command."""
    for name in ("time", "speed"):
        if name not in values or not np.isfinite(values[name]).any():
            raise InvalidInput(f"log: no column for {name}: name it, --columns {name}=NAME.")
    time = values["time"]
    usable = np.isfinite(time) & np.isfinite(values[command])
    usable[1:] &= np.diff(np.maximum.accumulate(np.where(np.isfinite(time), time, -np.inf))) > 0.0
    time, request, speed = (values[name][usable] for name in ("time", command, "speed"))
    if time.size < 2:
        raise InvalidInput(f"log: {command} has {time.size} values with a time: too few.")
    period = check_times(time)
    compared = np.where(find_outliers("speed", time, speed) | (speed < MIN_COMPARED_SPEED), np.nan, speed)
    begins = np.append(True, np.diff(time) > max(GAP_PERIODS * period, LEAST_GAP))
    return np.stack([time, request / mass, compared, begins.astype(np.float64)])


def _compared_seconds(rows: Array) -> float:
    """s of driving in which the speed is compared; `InvalidInput` where they are few."""
    time, _, speed, begins = rows
    seconds = float(np.sum(np.diff(time)[np.isfinite(speed[1:]) & np.isfinite(speed[:-1]) & (begins[1:] <= 0.0)]))
    if seconds < LEAST_COMPARED:
        raise InvalidInput(
            f"log: {seconds:.3g} s above {MIN_COMPARED_SPEED:g} m/s: at least {LEAST_COMPARED:g} s of driving, "
            "accelerating and braking are needed."
        )
    return seconds


def _beliefs(rows: Array, car: Vehicle, command: str) -> tuple[dict[str, Prior], list[str]]:
    """Prior of every quantity, and what the log cannot tell, in words; an actuator that hardly acts is not free."""
    time, request, speed, _ = rows
    drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
    rolling = car.rolling_resistance * GRAVITY
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
