"""From a log to a car: estimates with standard errors, a validation, and what the log cannot tell."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Finite, NotNegative, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.vehicle import Tyre, Vehicle, load_tyre, load_vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.calibration import corrected
from adaptrack.identification.consistency import Moments, contradictions, implausible_estimates
from adaptrack.identification.drive_identification import LONGITUDINAL_COMMANDS, PEDALS, drive_of_columns
from adaptrack.identification.estimates import ReportedRow, estimates_at, slopes_at, values_at
from adaptrack.identification.hypotheses import Evidence, cleaned_log, drop_computed_columns, refuse_contradictions
from adaptrack.identification.identified_car import Estimate, Identification, Series, Validation, scale_correlations
from adaptrack.identification.likelihood import NEARLY, Likelihood, Scored, smooth_wheel
from adaptrack.identification.log import Log, noise_of
from adaptrack.identification.log_combination import combined, shared_by
from adaptrack.identification.quantities import (
    INDEX,
    QUANTITIES,
    Prior,
    beliefs_of,
    plain_car,
    understeer,
)
from adaptrack.identification.ratio import UNKNOWN_RATIO, check_fitted_ratio, check_scale, gain_of
from adaptrack.identification.reading import Columns, Reading, Source, read_columns
from adaptrack.identification.starts import find_optima
from adaptrack.identification.words import findings

Array = NDArray[np.float64]

VALIDATION_BLOCK, HELD_OUT_EVERY = 10.0, 4
"""s, length of the stretches of a validation; each fourth one is held out."""
RATIO_SPREAD = (0.3, 0.1)
"""Of the logarithm of a steering ratio that is to be found: guessed from the log, or said by the car's file."""
FIT_STEPS = 11
"""Steps of about equal duration in the fit of a log; its validation takes as long as one of them."""
MAX_SCALE_CORRELATION = 0.97
"""Of the scale of the steering angle with the understeer gradient, above which a log does not tell them apart."""
THIRDS, LEAST_THIRDS = 3, 50.0
"""Stretches of a log that are compared; s of driving from which they are."""
SHARED = (
    "delay", "lag", "dead_time", "understeer_gradient", "front", "rear", "lf", "ratio", "angle_scale", "rate",
    "relaxation",
)  # fmt: skip
"""Estimates that belong to the car: logs of one car share them."""


class Fit(NamedTuple):
    """The most likely point of a log, with what came of reading it."""

    likelihood: Likelihood
    z: Array
    covariance: Array
    """of the free entries of z"""
    rivals: tuple[Array, ...]
    """points that are as likely, between which z lies; empty where there is one"""
    columns: Columns
    beliefs: dict[str, Prior]


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
        (`SHARED`).
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
    sources = [log] if isinstance(log, str | os.PathLike | Mapping) else list(log)
    if not sources:
        raise InvalidInput("identify: no log.")
    read = [read_columns(source, reading or Reading()) for source in sources]
    if computation is not None:
        read = [replace(columns, computation=computation) for columns in read]
    show: ProgressCall = progress or (lambda *_: None)
    fits = _fits(read, believed, beliefs, show)
    alone: list[Identification] = []
    for fit in fits:
        show("validation", FIT_STEPS * len(fits) + len(alone), (FIT_STEPS + 1) * len(fits))
        alone.append(_alone(fit, curve))
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


def _fits(read: Sequence[Columns], believed: Vehicle, beliefs: Mapping[str, Prior], show: ProgressCall) -> list[Fit]:
    """Each log by itself; ratios that are to be found are measured from one guess."""
    log_beliefs = [dict(beliefs) for _ in read]
    prepared = [_prepared(columns, believed, belief) for columns, belief in zip(read, log_beliefs, strict=True)]
    unknown = [fit.log.ratio for fit, columns in zip(prepared, read, strict=True) if columns.ratio_unknown]
    if len(unknown) > 1:
        common = float(np.median(unknown))
        prepared = [
            _prepared(columns, believed, belief, common) for columns, belief in zip(read, log_beliefs, strict=True)
        ]
    fits: list[Fit] = []
    for likelihood, columns, belief in zip(prepared, read, log_beliefs, strict=True):
        done, total = FIT_STEPS * len(fits), (FIT_STEPS + 1) * len(read)
        show("fit", done, total)
        tell = partial(_tell, show, done, total)
        fits.append(Fit(likelihood, *optimum(likelihood, tell), columns, belief))
    return fits


def _tell(show: ProgressCall, done: int, total: int, step: int) -> None:
    """Report a step of the fit of a log behind the steps that are done."""
    show("fit", done + step, total)


def _alone(fit: Fit, curve: Tyre) -> Identification:
    """Identify the car from one log."""
    likelihood, z, covariance, rivals, columns, beliefs = fit
    log, car = likelihood.log, likelihood.car
    estimates, jacobian = _estimates(likelihood, z, covariance)
    validation, series = _validated(likelihood, z, log, car, beliefs)
    spread = portable.product(portable.product(jacobian, covariance), jacobian.T)
    usable, against, ratio_findings = _ratio(fit, estimates, spread)
    reasons = implausible_estimates(estimates, car) + against + contradictions("stretches of the log", *_stretches(fit))
    limits = _rivals_sentence(likelihood, rivals) + findings(log, estimates, validation) + ratio_findings
    rows = [i for i, name in enumerate(estimates) if name in usable]
    return Identification(
        usable, spread[np.ix_(rows, rows)], validation, limits, log, car, curve,
        columns.computation, series, tuple(reasons),
    )  # fmt: skip


def _together(fits: Sequence[Fit], alone: Sequence[Identification]) -> Identification:
    """Identify one car from several logs; quantities of a single log stay with that log."""
    main = max(range(len(fits)), key=lambda i: (len(shared_by(fits[i].likelihood)), alone[i].log.driven_time))
    likelihood, first = fits[main].likelihood, alone[main]
    reasons = contradictions("logs", *_moments_of_fits(fits, fits[main]))
    log_reasons = [
        f"log {i + 1}: {reason}"
        for i, fit in enumerate(alone)
        for reason in fit.reasons
        if not reason.startswith(UNKNOWN_RATIO)
    ]
    joint = combined(fits, agree=not (reasons or log_reasons))
    estimates, jacobian = _estimates(likelihood, *joint[main])
    spread = portable.product(portable.product(jacobian, joint[main][1]), jacobian.T)
    against: list[str] = []
    ratio_findings: tuple[str, ...] = ()
    if not likelihood.log.ratio_unknown:
        _, against, ratio_findings = _ratio(
            fits[main]._replace(z=joint[main][0], covariance=joint[main][1]), estimates, spread
        )
    ratio_logs = [i for i, identification in enumerate(alone) if "ratio" in identification.estimates]
    shared = {
        name: estimate for name, estimate in estimates.items() if name in SHARED and (name != "ratio" or ratio_logs)
    }
    rows = [i for i, name in enumerate(estimates) if name in shared]
    open_ratio = [reason for reason in first.reasons if reason.startswith(UNKNOWN_RATIO)] if not ratio_logs else []
    reasons = [*(reasons or implausible_estimates(shared, first.believed)), *against, *log_reasons, *open_ratio]
    return replace(
        first, estimates=shared, covariance=spread[np.ix_(rows, rows)],
        findings=findings(first.log, estimates, first.validation) + ratio_findings,
        computation=max(identification.computation for identification in alone),
        reasons=tuple(reasons), alone=tuple(alone),
    )  # fmt: skip


def _ratio(
    fit: Fit, estimates: dict[str, Estimate], spread: Array
) -> tuple[dict[str, Estimate], list[str], tuple[str, ...]]:
    """The estimates that may be reported, what contradicts the steering ratio, and findings; spread: covariance."""
    log = fit.likelihood.log
    if not log.ratio_unknown:
        if "angle_scale" not in estimates:
            return estimates, [], ()
        gain = gain_of(fit.likelihood, fit.z, fit.covariance)
        against, finding = check_scale(log, estimates["angle_scale"], gain, scale_correlations(estimates, spread))
        return estimates, [against] if against else [], (finding,) if finding else ()
    is_known, message = check_fitted_ratio(log, estimates["ratio"])
    guessed = fit.beliefs["gain"].spread == RATIO_SPREAD[0]
    if is_known or not guessed:
        return estimates, [], (message,) if message else ()
    return {name: estimate for name, estimate in estimates.items() if name != "ratio"}, [message], ()


def _prepared(columns: Columns, believed: Vehicle, beliefs: dict[str, Prior], ratio: float | None = None) -> Likelihood:
    """The likelihood of a log that is cleaned and whose conventions are checked.

    Where the steering ratio is to be found, the first guess of it follows from yaw rate and speed unless it is given.
    """
    refuse_contradictions(Evidence(columns.values), "positions")
    values, computed = drop_computed_columns(columns.values, believed.wheelbase)
    car_ratio = believed.steering.ratio if believed.steering is not None else None
    columns = replace(columns, values=values, notes=columns.notes + computed)
    cleaned = cleaned_log(columns, believed.wheelbase, car_ratio or ratio)
    if columns.ratio_unknown:
        beliefs["gain"] = Prior(1.0, RATIO_SPREAD[car_ratio is not None])
    refuse_contradictions(Evidence(wheelbase=believed.wheelbase, cleaned=cleaned), "signals")
    beliefs |= _noises(cleaned)
    if not cleaned.commanded:
        cleaned = replace(cleaned, command=smooth_wheel(cleaned))
    return Likelihood(cleaned, believed, beliefs)


def prepare(log: str | os.PathLike[str] | Mapping[str, object], car: Vehicle) -> Likelihood:
    """The likelihood of a log and a car, for `fitted`; errors as `identify`."""
    return _prepared(read_columns(log, Reading()), car, beliefs_of(car))


def reported(likelihood: Likelihood, z: Array, covariance: Array) -> dict[str, Estimate]:
    """Return the reported quantities of a fit, without a validation."""
    return _estimates(likelihood, z, covariance)[0]


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


def fitted(likelihood: Likelihood) -> tuple[Array, Array]:
    """The most likely point z of a log, and the covariance of its free entries."""
    z, covariance, _ = optimum(likelihood)
    return z, covariance


def optimum(
    likelihood: Likelihood, tell: Callable[[int], None] = lambda step: None
) -> tuple[Array, Array, tuple[Array, ...]]:
    """The most likely point z of a log, the covariance of its free entries, and the points that are as likely.

    First all gusts are alike; then their spread follows the log; then it is widened, see `Likelihood.widen_gusts`. A
    scale of the steering angle that the log does not tell from understeer keeps its prior. Of several points that are
    as likely, which lie along a ridge, it returns one between them, and widens the covariance by their scatter. No
    variance is larger than that of the prior.

    tell: called with how many of `FIT_STEPS` are done
    """
    z, rivals = find_optima(likelihood, tell)
    likelihood.follow_gusts(z)
    z, _ = likelihood.fit(z, NEARLY)
    tell(FIT_STEPS - 1)
    z, at = likelihood.fit(likelihood.widen_gusts(z))
    covariance, free, held = _covariance(likelihood, z, at), likelihood.free, ["rear"]
    if abs(_scale_correlation(likelihood, z, at)) > MAX_SCALE_CORRELATION:
        place = int(np.flatnonzero(free == INDEX["gain"])[0])
        follow = covariance[place] / covariance[place, place]
        covariance += (1.0 - covariance[place, place]) * np.outer(follow, follow)
        z[free] -= z[INDEX["gain"]] * follow
        z, held = _fit_holding(likelihood, z, ["gain"]), ["rear", "gain"]
    if rivals:
        likely = np.array([z, *rivals])
        likely[:, INDEX["gain"]] = z[INDEX["gain"]] if "gain" in held else likely[:, INDEX["gain"]]
        z[free] = likely[:, free].mean(axis=0)
        z, rivals = _fit_holding(likelihood, z, held), tuple(likely)
        gaps = (likely - z)[:, free]
        covariance += portable.product(gaps.T, gaps) / len(likely)
    largest = np.maximum(np.sqrt(np.diag(covariance)), 1.0)
    return z, covariance / np.outer(largest, largest), rivals


def _fit_holding(likelihood: Likelihood, z: Array, held: Sequence[str]) -> Array:
    """The most likely point from a start with some quantities held."""
    free = likelihood.free
    likelihood.free = np.array([place for place in free if QUANTITIES[place].name not in held])
    try:
        return likelihood.fit(z, NEARLY)[0]
    finally:
        likelihood.free = free


def _scale_correlation(likelihood: Likelihood, z: Array, at: Scored) -> float:
    """Correlation of the scale of the steering angle and the understeer gradient, by the information of the log."""
    place = np.flatnonzero(likelihood.free == INDEX["gain"])
    if not place.size or likelihood.log.ratio_unknown:
        return 0.0
    inverse, slopes = portable.inverse(at.information), _understeer_slopes(likelihood, z)
    along = portable.product(inverse, slopes)
    variances = inverse[place[0], place[0]] * portable.product(slopes, along)
    return float(along[place[0]] / math.sqrt(variances))


def _understeer_slopes(likelihood: Likelihood, z: Array) -> Array:
    """Derivatives of the understeer gradient over the free entries of z."""
    rows = [row for row in _reported(likelihood) if row[0] == "understeer_gradient"]
    return slopes_at(likelihood, rows, z)[0]


def _covariance(likelihood: Likelihood, z: Array, at: Scored) -> Array:
    """Covariance of z where it is free, in which the understeer gradient is widened instead of the rear axle.

    Both axles are known less well than their balance; widened one by one they would blur it.
    """
    slopes, is_rear = np.eye(likelihood.free.size), likelihood.free == INDEX["rear"]
    if is_rear.any():
        slopes[is_rear] = _understeer_slopes(likelihood, z)
    return likelihood.covariance(at, slopes)


# -- what is reported -------------------------------------------------------------------------------------------------
def _value(name: str) -> Callable[[Array], float]:
    return lambda values: float(values[INDEX[name]])


def _reported(likelihood: Likelihood) -> list[ReportedRow]:
    """Name, unit, meaning, whether it is positive, and how it follows from the quantities."""
    wheelbase = likelihood.car.wheelbase
    share, delay = INDEX["lag_share"], INDEX["delay"]

    def gradient(v: Array) -> float:
        return understeer(v[INDEX["front"]], v[INDEX["rear"]], v[INDEX["mass"]], wheelbase, v[INDEX["front_share"]])

    delayed = "lag and dead time together, from the command to the wheels"
    if not likelihood.present["wheel"]:
        delayed = "from the command to the logged yaw rate: lag and dead time of the wheels, and how late a gyro is"
    rows: list[ReportedRow] = []
    if likelihood.log.commanded:
        rows += [
            ("delay", "s", delayed, True, _value("delay")),
            ("lag", "s", "time constant of the steering", True, lambda v: float(v[share] * v[delay])),
            ("dead_time", "s", "until the wheels begin to move", True, lambda v: float((1.0 - v[share]) * v[delay])),
        ]
    rows += [
        ("understeer_gradient", "rad s^2/m", "steering per lateral acceleration in a steady bend", False, gradient),
        ("front", "N/rad", "cornering stiffness of the front axle", True, _value("front")),
        ("rear", "N/rad", "cornering stiffness of the rear axle", True, _value("rear")),
        ("lf", "m", "centre of gravity to front axle", True, lambda v: float(v[INDEX["front_share"]] * wheelbase)),
    ]
    if likelihood.log.ratio_unknown:
        meaning, ratio = "logged steering angle over road wheels", likelihood.log.ratio
        rows.append(("ratio", "-", meaning, True, lambda v: ratio / float(v[INDEX["gain"]])))
    elif likelihood.spread[INDEX["gain"]] > 0.0:
        meaning = "logged steering angle over that of yaw rate, speed and wheelbase"
        rows.append(("angle_scale", "-", meaning, True, lambda v: 1.0 / float(v[INDEX["gain"]])))
    free = {QUANTITIES[i].name for i in likelihood.free}
    also = (
        "lateness", "rate", "offset", "vy_ahead", "push_mean", "gyro_offset", "acceleration_offset", "wheel_offset",
        "relaxation", "noise_yaw_rate", "noise_vy", "noise_acceleration", "noise_yaw", "noise_wheel",
    )  # fmt: skip
    for name in also:
        if name in free:
            quantity = QUANTITIES[INDEX[name]]
            rows.append(
                (name, quantity.unit, quantity.meaning, quantity.kind in ("positive", "from zero"), _value(name))
            )
    return rows


def _estimates(likelihood: Likelihood, z: Array, covariance: Array) -> tuple[dict[str, Estimate], Array]:
    """Estimates of what is reported of a fit, and their derivatives over free entries."""
    return estimates_at(likelihood, _reported(likelihood), z, covariance, likelihood.log.tightest)


def _rivals_sentence(likelihood: Likelihood, rivals: Sequence[Array]) -> tuple[str, ...]:
    """A sentence on cars that fit a log equally well; none where there is one."""
    if not rivals:
        return ()
    cars = []
    for values in map(likelihood.values, rivals):
        front, rear = (1e-3 * values[INDEX[axle]] for axle in ("front", "rear"))
        delay = f"delay {values[INDEX['delay']]:.3g} s, " if likelihood.log.commanded else ""
        cars.append(f"{delay}axles {front:.3g} and {rear:.3g} kN/rad")
    return (f"different cars fit the log equally well ({'; '.join(cars)}): quick steering at speed tells them apart",)


# -- consistency ------------------------------------------------------------------------------------------------------
def _stretches(fit: Fit) -> tuple[list[str], Moments, list[Moments]]:
    """Names of the reported quantities, prior, and what thirds of a log say, each fitted from the whole log's point."""
    log, parts = fit.likelihood.log, []
    ends = np.linspace(0, log.samples, THIRDS + 1).astype(int)
    for first, last in pairwise(ends) if log.driven_time >= LEAST_THIRDS else ():
        part = fit.likelihood.part(slice(first, last))
        z, at = part.fit(fit.z, NEARLY)
        parts.append(fit._replace(likelihood=part, z=z, covariance=_covariance(part, z, at)))
    return _moments_of_fits(parts, fit)


def _moments_of_fits(fits: Sequence[Fit], main: Fit) -> tuple[list[str], Moments, list[Moments]]:
    """Names of the quantities that a main fit reports, prior, and what each fit says of them."""
    rows = _reported(main.likelihood)
    prior, statements = _prior(main, rows), []
    for fit in fits:
        likelihood_rows = _reported(fit.likelihood)
        mine, place = _moments(fit, likelihood_rows), {row[0]: i for i, row in enumerate(likelihood_rows)}
        mean, variance = prior.mean.copy(), prior.variance.copy()
        for i, (name, *_) in enumerate(rows):
            if name in place:
                mean[i], variance[i] = mine.mean[place[name]], mine.variance[place[name]]
        statements.append(Moments(mean, variance))
    return [row[0] for row in rows], prior, statements


def _moments(fit: Fit, rows: Sequence[ReportedRow]) -> Moments:
    """Mean and variance of the reported quantities, errors corrected."""
    jacobian = slopes_at(fit.likelihood, rows, fit.z)
    mean = values_at(fit.likelihood, rows, fit.z)
    spread = np.sqrt(np.maximum((product(jacobian, fit.covariance) * jacobian).sum(axis=1), 0.0))
    before = np.sqrt((jacobian * jacobian).sum(axis=1))
    for i, (name, _, _, positive, _) in enumerate(rows):
        value = portable.exp(mean[i]) if positive else float(mean[i])
        spread[i] = corrected(name, spread[i], value, positive, before[i], fit.likelihood.log.tightest)
    return Moments(mean, spread * spread)


def _prior(fit: Fit, rows: Sequence[ReportedRow]) -> Moments:
    """Prior of the reported quantities, linearised at the fit."""
    likelihood = fit.likelihood
    jacobian = slopes_at(likelihood, rows, fit.z)
    mean = values_at(likelihood, rows, fit.z) - product(jacobian, fit.z[likelihood.free])
    return Moments(mean, np.sum(jacobian * jacobian, axis=1))


# -- validation -------------------------------------------------------------------------------------------------------
def _validated(
    likelihood: Likelihood, z: Array, log: Log, car: Vehicle, beliefs: Mapping[str, Prior]
) -> tuple[Validation, Series]:
    """A second fit without every fourth stretch, which predicts them."""
    block = np.floor((log.time - log.time[0]) / VALIDATION_BLOCK).astype(np.int64)
    is_held_out = block % HELD_OUT_EVERY == HELD_OUT_EVERY - 1

    def errors(at: Array, used: Array) -> tuple[Array, Array]:
        fold = Likelihood(log, car, beliefs, used)
        fold.take_gusts(likelihood)
        e, s = fold.innovations(at)
        return e[0], s[0]

    blind = np.where(is_held_out, 0.0, 1.0)
    fit = Likelihood(log, car, beliefs, blind)
    fit.take_gusts(likelihood)
    there, _ = fit.fit(z, NEARLY)
    stepped, blindly = errors(there, np.ones(log.samples))[0], errors(there, blind)[0]
    e, s = errors(z, np.ones(log.samples))
    normal = e / np.sqrt(s)
    finite = normal[np.isfinite(normal)]
    lags = tuple(float(np.mean(finite[k:] * finite[:-k]) / np.mean(finite * finite)) for k in range(1, 6))
    measured = is_held_out & np.isfinite(log.yaw_rate)
    validation = Validation(
        _explained(log.yaw_rate[measured], stepped[measured]),
        _explained(log.yaw_rate[measured], blindly[measured]),
        float(log.period * is_held_out.sum()), lags,
    )  # fmt: skip
    wheels = likelihood.filter_results(z)["wheel_angle"]
    simulated = log.yaw_rate - errors(z, log.begins.astype(np.float64))[0]
    return validation, Series(log.time, log.yaw_rate, simulated, normal, is_held_out, wheels)


def _explained(measured: Array, errors: Array) -> float:
    """1 - var(error)/var(measured); NaN without samples."""
    if measured.size < 2 or not np.var(measured) > 0.0:
        return math.nan
    return float(1.0 - np.var(errors) / np.var(measured))
