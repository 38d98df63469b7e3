"""From a log to a car: estimates with standard errors, a validation, and what the log cannot tell."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Finite, NotNegative, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.vehicle import Tyre, Vehicle, load_tyre, load_vehicle
from adaptrack.identification import consistency, log_fit
from adaptrack.identification.drive_identification import LONGITUDINAL_COMMANDS, PEDALS, drive_of_columns
from adaptrack.identification.estimates import estimates_of, moments_of, prior_of
from adaptrack.identification.hypotheses import Evidence, cleaned_log, drop_computed_columns, refuse_contradictions
from adaptrack.identification.identified_car import Identification, Series, Validation
from adaptrack.identification.likelihood import NEARLY, Fit, Likelihood, smooth_wheel
from adaptrack.identification.log import Log
from adaptrack.identification.outliers import noise_of
from adaptrack.identification.quantities import INDEX, Prior, beliefs_of, plain_car
from adaptrack.identification.reading import Columns, Reading, Source, read_columns, read_logs

Array = NDArray[np.float64]

VALIDATION_BLOCK, HELD_OUT_EVERY = 10.0, 4
"""s, length of the stretches of a validation; each fourth one is held out."""


@reports_progress("identify")
@checked
def identify(
    log: Source | Sequence[Source],
    car: str | os.PathLike[str] | Vehicle | None = None,
    *,
    mass: Annotated[Finite, within(1.0, 1e5), "kg"] | None = None,
    wheelbase: Annotated[Finite, within(0.1, 20.0), "m"] | None = None,
    reading: Reading | None = None,
    priors: Mapping[str, Prior] | None = None,
    computation: Annotated[NotNegative, Field(lt=1.0), "s"] | None = None,
    progress: ProgressCall | None = None,
) -> Identification:
    """Identify a car from a log of its driving, or several.

    Parameters
    ----------
    log
        A .csv or .parquet file, one of `Trajectory.save`, or arrays by name: time (s), command (rad, road wheels; or
        wheel, a measured angle), speed (m/s), yaw_rate (rad/s), and, where there are, vy, acceleration, yaw. With
        force_command (N), acceleration_command (m/s^2), or throttle and brake (0 to 1), drive and brakes are
        identified, too, as by `identify_drive`. Several logs of one car in a sequence share what belongs to the car
        (`MODEL_ERRORS`).
    car
        What is believed of the car: mass and geometry are kept, the rest is estimated about it.
    mass, wheelbase
        Instead of a car.
    reading
        Columns, units, signs, clocks and steering ratio, where they are not as the names say.
    priors
        Beliefs that replace those of the car, by the names of `QUANTITIES`.
    computation
        Of the log's dead time that lies in the controller's computation: it is taken off what the car's file
        gets. By default what the profile of an own trajectory says, else 0.
    progress
        Called with the stage, and how many of its logs are done, of how many. By default long work says how far it is.

    Raises
    ------
    StorageError
        When a file cannot be read.
    InvalidInput
        When the log lacks a signal, is too short, is hardly steered, or its signs or units do not fit together; the
        message names the option that mends it.
    """
    believed, beliefs, curve = _believed(car, mass, wheelbase, priors)
    read = read_logs(log, reading)
    if computation is not None:
        read = [replace(columns, computation=computation) for columns in read]
    show: ProgressCall = progress or (lambda *_: None)
    fits = _fits(read, believed, beliefs, show)
    alone: list[Identification] = []
    for fit, columns in zip(fits, read, strict=True):
        show("validation", log_fit.FIT_STEPS * len(fits) + len(alone), (log_fit.FIT_STEPS + 1) * len(fits))
        alone.append(_alone(fit, curve, columns.computation))
    return _with_drive(alone[0] if len(alone) == 1 else _together(fits, alone), read)


def _with_drive(identification: Identification, read: Sequence[Columns]) -> Identification:
    """An identification with drive and brakes, where logs have commands of acceleration or force, or pedals."""
    logs = [columns for columns in read if not columns.values.keys().isdisjoint(LONGITUDINAL_COMMANDS)]
    logs = logs or [columns for columns in read if columns.values.keys() >= set(PEDALS)]
    if not logs:
        return identification
    try:
        return replace(identification, drive=drive_of_columns(logs, identification.believed))
    except InvalidInput as error:
        finding = f"drive and brakes are not identified: {str(error).removeprefix('log: ').rstrip('.')}"
        return replace(identification, findings=(*identification.findings, finding))


def _fits(
    read: Sequence[Columns], believed: Vehicle, beliefs: Mapping[str, Prior], show: ProgressCall
) -> list[Fit[Likelihood]]:
    """Each log by itself; ratios that are to be found are measured from one guess."""
    prepared = [_prepared(columns, believed, beliefs) for columns in read]
    unknown = [likelihood.log.ratio for likelihood in prepared if likelihood.log.ratio_unknown]
    if len(unknown) > 1:
        common = float(np.median(unknown))
        prepared = [_prepared(columns, believed, beliefs, common) for columns in read]
    fits: list[Fit[Likelihood]] = []

    def tell(step: int) -> None:
        show("fit", log_fit.FIT_STEPS * len(fits) + step, (log_fit.FIT_STEPS + 1) * len(read))

    for likelihood in prepared:
        tell(0)
        fits.append(log_fit.fit_log(likelihood, tell))
    return fits


def _alone(fit: Fit[Likelihood], curve: Tyre, computation: float) -> Identification:
    """Identify the car from one log."""
    log, car = fit.likelihood.log, fit.likelihood.car
    estimates, spread = estimates_of(fit)
    validation, series = _validated(fit)
    usable, against, ratio_findings = consistency.check_ratio(fit, estimates, spread)
    thirds = [moments_of(third) for third in log_fit.fit_thirds(fit)]
    moved = consistency.contradictions("stretches of the log", prior_of(fit), thirds)
    reasons = consistency.implausible_estimates(estimates, car) + against + moved
    limits = _rivals_sentence(fit) + consistency.findings(log, estimates, validation) + ratio_findings
    rows = [i for i, name in enumerate(estimates) if name in usable]
    return Identification(
        usable, spread[np.ix_(rows, rows)], validation, limits, log, car, curve, computation, series, tuple(reasons)
    )


def _together(fits: Sequence[Fit[Likelihood]], alone: Sequence[Identification]) -> Identification:
    """Identify one car from several logs; quantities of a single log stay with that log."""
    main = max(
        range(len(fits)), key=lambda i: (len(log_fit.shared_places(fits[i].likelihood)), alone[i].log.driven_time)
    )
    first = alone[main]
    reasons = consistency.contradictions("logs", prior_of(fits[main]), list(map(moments_of, fits)))
    numbered = [(i + 1, reason) for i, identification in enumerate(alone) for reason in identification.reasons]
    unknown_ratio = consistency.UNKNOWN_RATIO
    log_reasons = [f"log {number}: {reason}" for number, reason in numbered if not reason.startswith(unknown_ratio)]
    joint = log_fit.combine(fits, agree=not (reasons or log_reasons))[main]
    estimates, spread = estimates_of(joint)
    against: list[str] = []
    ratio_findings: tuple[str, ...] = ()
    if not first.log.ratio_unknown:
        _, against, ratio_findings = consistency.check_ratio(joint, estimates, spread)
    has_ratio = any("ratio" in identification.estimates for identification in alone)
    shared = {
        name: estimate
        for name, estimate in estimates.items()
        if name in consistency.MODEL_ERRORS and (name != "ratio" or has_ratio)
    }
    rows = [i for i, name in enumerate(estimates) if name in shared]
    open_ratio = [reason for reason in first.reasons if reason.startswith(unknown_ratio) and not has_ratio]
    reasons = reasons or consistency.implausible_estimates(shared, first.believed)
    return replace(
        first, estimates=shared, covariance=spread[np.ix_(rows, rows)],
        findings=consistency.findings(first.log, estimates, first.validation) + ratio_findings,
        computation=max(identification.computation for identification in alone),
        reasons=(*reasons, *against, *log_reasons, *open_ratio), alone=tuple(alone),
    )  # fmt: skip


def _prepared(
    columns: Columns, believed: Vehicle, beliefs: Mapping[str, Prior], ratio: float | None = None
) -> Likelihood:
    """The likelihood of a log that is cleaned and whose conventions are checked.

    Where the steering ratio is to be found, the first guess of it follows from yaw rate and speed unless it is given.
    """
    refuse_contradictions(Evidence(columns.values), "positions")
    values, computed = drop_computed_columns(columns.values, believed.wheelbase)
    car_ratio = believed.steering.ratio if believed.steering is not None else None
    columns = replace(columns, values=values, notes=columns.notes + computed)
    cleaned = cleaned_log(columns, believed.wheelbase, car_ratio or ratio)
    if columns.ratio_unknown:
        beliefs = {**beliefs, "gain": Prior(1.0, consistency.RATIO_SPREAD[car_ratio is not None])}
    refuse_contradictions(Evidence(wheelbase=believed.wheelbase, cleaned=cleaned), "signals")
    noises = _noises(cleaned)
    if not cleaned.commanded:
        cleaned = replace(cleaned, command=smooth_wheel(cleaned))
    return Likelihood(cleaned, believed, {**beliefs, **noises})


def prepare(log: str | os.PathLike[str] | Mapping[str, object], car: Vehicle) -> Likelihood:
    """The likelihood of a log and a car, for `fit_log`; errors as `identify`."""
    return _prepared(read_columns(log, Reading()), car, beliefs_of(car))


def _believed(
    car: str | os.PathLike[str] | Vehicle | None, mass: float | None, wheelbase: float | None,
    priors: Mapping[str, Prior] | None,
) -> tuple[Vehicle, dict[str, Prior], Tyre]:  # fmt: skip
    """The car before the log, beliefs about it, and the tyre whose curve it has."""
    if car is not None:
        if mass is not None or wheelbase is not None:
            raise InvalidInput("identify: either a car, or mass and wheelbase.")
        vehicle = car if isinstance(car, Vehicle) else load_vehicle(car)
        return vehicle, beliefs_of(vehicle, priors), load_tyre(vehicle.tyre)
    if mass is None or wheelbase is None:
        raise InvalidInput("identify: give --car, or --mass (kg) and --wheelbase (m): no log tells them.")
    vehicle, rough = plain_car(mass, wheelbase)
    curve = load_tyre(vehicle.tyre).replace(nominal_load=0.5 * sum(vehicle.static_loads))
    return vehicle, beliefs_of(vehicle, rough | dict(priors or {})), curve


def _noises(log: Log) -> dict[str, Prior]:
    """First guesses of the noise of each sensor."""
    signals = ("yaw_rate", "vy", "acceleration", "yaw", "wheel")
    noises = {name: noise_of((values := getattr(log, name))[np.isfinite(values)]) for name in signals}
    return {f"noise_{name}": Prior(max(noise, 1e-5), 1.5) for name, noise in noises.items() if math.isfinite(noise)}


def _rivals_sentence(fit: Fit[Likelihood]) -> tuple[str, ...]:
    """A sentence on cars that fit a log equally well; none where there is one."""
    if not fit.rivals:
        return ()
    cars = []
    for values in map(fit.likelihood.values, fit.rivals):
        front, rear = (1e-3 * values[INDEX[axle]] for axle in ("front", "rear"))
        delay = f"delay {values[INDEX['delay']]:.3g} s, " if fit.likelihood.log.commanded else ""
        cars.append(f"{delay}axles {front:.3g} and {rear:.3g} kN/rad")
    return (f"different cars fit the log equally well ({'; '.join(cars)}): quick steering at speed tells them apart",)


# -- validation -------------------------------------------------------------------------------------------------------
def _validated(fit: Fit[Likelihood]) -> tuple[Validation, Series]:
    """A second fit without every fourth stretch, which predicts them."""
    likelihood, z, log = fit.likelihood, fit.z, fit.likelihood.log
    block = np.floor((log.time - log.time[0]) / VALIDATION_BLOCK).astype(np.int64)
    is_held_out = block % HELD_OUT_EVERY == HELD_OUT_EVERY - 1

    def errors(at: Array, used: Array) -> tuple[Array, Array]:
        e, s = likelihood.using(used).innovations(at)
        return e[0], s[0]

    blind = np.where(is_held_out, 0.0, 1.0)
    there, _ = likelihood.using(blind).fit(z, NEARLY)
    stepped, blindly = errors(there, np.ones(log.samples))[0], errors(there, blind)[0]
    e, s = errors(z, np.ones(log.samples))
    normal = e / np.sqrt(s)
    finite = normal[np.isfinite(normal)]
    lags = tuple(float(np.mean(finite[k:] * finite[:-k]) / np.mean(finite * finite)) for k in range(1, 6))
    measured = is_held_out & np.isfinite(log.yaw_rate)
    validation = Validation(
        _explained_share(log.yaw_rate[measured], stepped[measured]),
        _explained_share(log.yaw_rate[measured], blindly[measured]),
        float(log.period * is_held_out.sum()), lags,
    )  # fmt: skip
    wheels = likelihood.filter_results(z)["wheel_angle"]
    simulated = log.yaw_rate - errors(z, log.begins.astype(np.float64))[0]
    return validation, Series(log.time, log.yaw_rate, simulated, normal, is_held_out, wheels)


def _explained_share(measured: Array, errors: Array) -> float:
    """1 - var(error)/var(measured); NaN without samples."""
    if measured.size < 2 or not np.var(measured) > 0.0:
        return math.nan
    return float(1.0 - np.var(errors) / np.var(measured))
