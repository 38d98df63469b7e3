"""From a log, or several of one car, to a car: the fit, estimates with standard errors, what the log cannot tell.

A short delay with soft tyres predicts nearly what a long delay with stiff ones does, so a fit that starts at one of
them may stay there. Fits of the few quantities that matter most, from several starts, find both.

Of several logs, what belongs to the car is shared, the rest is each log's own. Each log's posterior is freed of the
prior, which they share, and what remains is added in information form: with means m_k and covariances C_k of the shared
entries of z, whose prior is standard normal,

    C^-1 = I + sum(C_k^-1 - I),    C^-1 m = sum(C_k^-1 m_k)

(the logs are independent given the car). Once more at the common point, which mends what is not linear. Each log's own
entries follow as they do in its Gaussian posterior.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Finite, NotNegative, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.vehicle import Tyre, Vehicle, load_tyre, load_vehicle
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.identification import consistency
from adaptrack.identification.drive_identification import LONGITUDINAL_COMMANDS, PEDALS, drive_of_columns
from adaptrack.identification.estimates import estimates_of, moments_of, prior_of, slopes_at
from adaptrack.identification.hypotheses import Evidence, cleaned_log, drop_computed_columns, refuse_contradictions
from adaptrack.identification.identified_car import Identification, Series, Validation
from adaptrack.identification.likelihood import MEASURED_OUTPUTS, NEARLY, Fit, Likelihood, Scored, smooth_wheel
from adaptrack.identification.log import noise_of
from adaptrack.identification.quantities import INDEX, QUANTITIES, Prior, beliefs_of, plain_car
from adaptrack.identification.reading import Columns, Reading, Source, read_logs

VALIDATION_BLOCK, HELD_OUT_EVERY = 10.0, 4
"""s, length of the stretches of a validation; each fourth one is held out."""
START_DELAYS, START_LATENESSES = (0.12, 0.25, 0.45), (0.0, 0.2)
"""s, from which the fit of a log with a command starts; s, where only the wheel angle is logged."""
START_STIFFNESS = 2.0
"""Factor on the stiffness of both axles in one more start."""
ROUGH_QUANTITIES = (
    "delay", "lag_share", "lateness", "gain", "offset", "front", "rear", "gyro_offset", "wind_spread",
    "noise_yaw_rate", "jolt",
)  # fmt: skip
"""Quantities that are free in a rough fit."""
MAX_ROUGH_GAP, MAX_RIVAL_GAP = 60.0, 15.0
"""Differences of the objective: of rough fits that are continued, and of optima that count as equally likely."""
MAX_AXLE_GAP = 0.25
"""Difference of the logarithm of an axle's stiffness up to which two optima are one."""
FIT_STEPS = 11
"""Steps of about equal duration in the fit of a log; its validation takes as long as one of them."""
MAX_SCALE_CORRELATION = 0.97
"""Of the scale of the steering angle with the understeer gradient, above which a log does not tell them apart."""
THIRDS, LEAST_THIRDS = 3, 50.0
"""Stretches of a log that are compared; s of driving from which they are."""
CAR_QUANTITIES = (
    "delay", "lag_share", "rate", "gain", "front", "rear", "mass", "yaw_inertia", "front_share", "relaxation",
)  # fmt: skip
"""Quantities that logs of one car share."""


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
        show("validation", FIT_STEPS * len(fits) + len(alone), (FIT_STEPS + 1) * len(fits))
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
    prepared = [prepare(columns, believed, beliefs) for columns in read]
    unknown = [likelihood.log.ratio for likelihood in prepared if likelihood.log.ratio_unknown]
    if len(unknown) > 1:
        common = float(np.median(unknown))
        prepared = [prepare(columns, believed, beliefs, common) for columns in read]
    fits: list[Fit[Likelihood]] = []

    def tell(step: int) -> None:
        show("fit", FIT_STEPS * len(fits) + step, (FIT_STEPS + 1) * len(read))

    for likelihood in prepared:
        tell(0)
        fits.append(fit_log(likelihood, tell))
    return fits


def _alone(fit: Fit[Likelihood], curve: Tyre, computation: float) -> Identification:
    """Identify the car from one log."""
    log, car = fit.likelihood.log, fit.likelihood.car
    estimates, spread = estimates_of(fit)
    validation, series = _validated(fit)
    usable, against, ratio_findings = consistency.check_ratio(fit, estimates, spread)
    thirds = [moments_of(third) for third in fit_thirds(fit)]
    moved = consistency.contradictions("stretches of the log", prior_of(fit), thirds)
    reasons = consistency.implausible_estimates(estimates, car) + against + moved
    limits = _rivals_sentence(fit) + consistency.findings(log, estimates, validation) + ratio_findings
    rows = [i for i, name in enumerate(estimates) if name in usable]
    return Identification(
        usable, spread[np.ix_(rows, rows)], validation, limits, log, car, curve, computation, series, tuple(reasons)
    )


def _together(fits: Sequence[Fit[Likelihood]], alone: Sequence[Identification]) -> Identification:
    """Identify one car from several logs; quantities of a single log stay with that log."""
    main = max(range(len(fits)), key=lambda i: (len(shared_places(fits[i].likelihood)), alone[i].log.driven_time))
    first = alone[main]
    reasons = consistency.contradictions("logs", prior_of(fits[main]), list(map(moments_of, fits)))
    numbered = [(i + 1, reason) for i, identification in enumerate(alone) for reason in identification.reasons]
    unknown_ratio = consistency.UNKNOWN_RATIO
    log_reasons = [f"log {number}: {reason}" for number, reason in numbered if not reason.startswith(unknown_ratio)]
    joint = combine(fits, agree=not (reasons or log_reasons))[main]
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


def prepare(
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
    signals = {name: getattr(cleaned, name) for name in MEASURED_OUTPUTS}
    noises = {name: noise_of(values[np.isfinite(values)]) for name, values in signals.items()}
    first = {f"noise_{name}": Prior(max(noise, 1e-5), 1.5) for name, noise in noises.items() if math.isfinite(noise)}
    if not cleaned.commanded:
        cleaned = replace(cleaned, command=smooth_wheel(cleaned))
    return Likelihood(cleaned, believed, {**beliefs, **first})


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


# -- the fit of a log -------------------------------------------------------------------------------------------------
def fit_log(likelihood: Likelihood, tell: Callable[[int], None] = lambda step: None) -> Fit[Likelihood]:
    """The most likely point z of a log, the covariance of its free entries, and the points that are as likely.

    First all gusts are alike; then their spread follows the log; then it is widened, see `Likelihood.widen_gusts`. A
    scale of the steering angle that the log does not tell from understeer keeps its prior. Of several points that are
    as likely, which lie along a ridge, it returns one between them, and widens the covariance by their scatter. No
    variance is larger than that of the prior.

    tell: called with how many of `FIT_STEPS` are done
    """
    z, rivals = _find_optima(likelihood, tell)
    likelihood.follow_gusts(z)
    z, _ = likelihood.fit(z, NEARLY)
    tell(FIT_STEPS - 1)
    z, at = likelihood.fit(likelihood.widen_gusts(z))
    covariance, free, moving = _covariance(likelihood, z, at), likelihood.free, INDEX.keys() - {"rear"}
    if abs(_scale_correlation(likelihood, z, at)) > MAX_SCALE_CORRELATION:
        place = int(np.flatnonzero(free == INDEX["gain"])[0])
        follow = covariance[place] / covariance[place, place]
        covariance += (1.0 - covariance[place, place]) * np.outer(follow, follow)
        z[free] -= z[INDEX["gain"]] * follow
        z, moving = likelihood.fit_over(INDEX.keys() - {"gain"}, z), moving - {"gain"}
    if rivals:
        likely = np.array([z, *rivals])
        likely[:, INDEX["gain"]] = likely[:, INDEX["gain"]] if "gain" in moving else z[INDEX["gain"]]
        z[free] = likely[:, free].mean(axis=0)
        z, rivals = likelihood.fit_over(moving, z), tuple(likely)
        gaps = (likely - z)[:, free]
        covariance += product(gaps.T, gaps) / len(likely)
    largest = np.maximum(np.sqrt(np.diag(covariance)), 1.0)
    return Fit(likelihood, z, covariance / np.outer(largest, largest), rivals)


# -- optima -----------------------------------------------------------------------------------------------------------
def _find_optima(likelihood: Likelihood, tell: Callable[[int], None]) -> tuple[Array, tuple[Array, ...]]:
    """The best of the nearby optima of a likelihood, and those that are as likely, within `MAX_RIVAL_GAP`.

    tell: called with the number of fits that are done, 9 at most.
    """
    name, values = ("delay", START_DELAYS) if likelihood.log.commanded else ("lateness", START_LATENESSES)
    starts = [starting_point(likelihood, name, value) for value in values]
    starts.append(starting_point(likelihood, name, values[1], START_STIFFNESS))
    optima = [likelihood.fit(min(starts[:-1], key=likelihood.objective), NEARLY)[0]]
    refined: list[Array] = list(optima)
    rough: list[Array] = []
    for z in starts:
        tell(1 + len(rough))
        if math.isfinite(likelihood.objective(z)):
            rough.append(likelihood.fit_over(ROUGH_QUANTITIES, z))
    rough.sort(key=likelihood.objective)
    limit = min(map(likelihood.objective, rough), default=math.inf) + MAX_ROUGH_GAP
    for i, z in enumerate(rough):
        tell(1 + len(starts) + i)
        if likelihood.objective(z) <= limit and not any(_have_equal_axles(likelihood, z, other) for other in refined):
            optima.append(likelihood.fit(z, NEARLY)[0])
            refined.append(z)
    objectives = [likelihood.objective(z) for z in optima]
    best = optima[int(np.argmin(objectives))]
    rivals = [
        z for z, objective in zip(optima, objectives, strict=True)
        if objective <= min(objectives) + MAX_RIVAL_GAP and not _have_equal_axles(likelihood, z, best)
    ]  # fmt: skip
    return best, tuple(rivals)


def starting_point(likelihood: Likelihood, name: str, value: float, stiffness: float = 1.0) -> Array:
    """Starting point z with a delay or lateness (s), and a factor on the believed stiffness of both axles.

    Entries that are not estimated are 0.
    """
    median = float(likelihood.median[INDEX[name]])
    shifts = dict.fromkeys(("front", "rear"), portable.log(stiffness))
    shifts[name] = value - median
    if name == "delay":  # linear below its median, see `quantities`
        shifts[name] = value / median - 1.0 if value < median else portable.log(value / median)
    z = np.zeros(len(QUANTITIES))
    for quantity, shift in shifts.items():
        if (place := INDEX[quantity]) in likelihood.free:
            z[place] = shift / float(likelihood.spread[place])
    return z


def _have_equal_axles(likelihood: Likelihood, z: Array, other: Array) -> bool:
    """Whether two points have nearly the same axles."""
    axles = [INDEX["front"], INDEX["rear"]]
    return bool(np.all(np.abs((z - other)[axles]) * likelihood.spread[axles] < MAX_AXLE_GAP))


# -- covariance -------------------------------------------------------------------------------------------------------
def _covariance(likelihood: Likelihood, z: Array, at: Scored) -> Array:
    """Covariance of z where it is free, in which the understeer gradient is widened instead of the rear axle.

    Both axles are known less well than their balance; widened one by one they would blur it.
    """
    slopes, is_rear = np.eye(likelihood.free.size), likelihood.free == INDEX["rear"]
    if is_rear.any():
        slopes[is_rear] = _understeer_slopes(likelihood, z)
    return likelihood.covariance(at, slopes)


def _scale_correlation(likelihood: Likelihood, z: Array, at: Scored) -> float:
    """Correlation of the scale of the steering angle and the understeer gradient, by the information of the log."""
    place = np.flatnonzero(likelihood.free == INDEX["gain"])
    if not place.size or likelihood.log.ratio_unknown:
        return 0.0
    inverse, slopes = portable.inverse(at.information), _understeer_slopes(likelihood, z)
    along = product(inverse, slopes)
    variances = inverse[place[0], place[0]] * product(slopes, along)
    return float(along[place[0]] / math.sqrt(variances))


def _understeer_slopes(likelihood: Likelihood, z: Array) -> Array:
    """Derivatives of the understeer gradient over the free entries of z."""
    return slopes_at(likelihood, [row for row in likelihood.reported if row.name == "understeer_gradient"], z)[0]


def fit_thirds(fit: Fit[Likelihood]) -> list[Fit[Likelihood]]:
    """Fits of thirds of a long log, each from the point of the whole log; none of a short one."""
    log, parts = fit.likelihood.log, []
    ends = np.linspace(0, log.samples, THIRDS + 1).astype(int)
    for first, last in pairwise(ends) if log.driven_time >= LEAST_THIRDS else ():
        part = fit.likelihood.part(slice(first, last))
        z, at = part.fit(fit.z, NEARLY)
        parts.append(Fit(part, z, _covariance(part, z, at)))
    return parts


# -- several logs -----------------------------------------------------------------------------------------------------
def shared_places(likelihood: Likelihood) -> list[int]:
    """Entries of z that belong to the car and are free."""
    return [int(i) for i in likelihood.free if QUANTITIES[i].name in CAR_QUANTITIES]


def combine(fits: Sequence[Fit[Likelihood]], agree: bool) -> list[Fit[Likelihood]]:
    """The fit of each log, given all logs.

    agree: whether they do; those that do not are granted the scatter of their means as an error of their own (random
    effects; R. DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986) 177-188).
    """
    fits = fits if agree else _widen(fits)
    mean, information = _add(fits)
    return [_condition(fit, mean, information) for fit in fits]


def _widen(fits: Sequence[Fit[Likelihood]]) -> list[Fit[Likelihood]]:
    """Fits with posteriors wider by the scatter of the logs' means."""
    means = np.full((len(fits), len(CAR_QUANTITIES)), np.nan)
    for row, fit in zip(means, fits, strict=True):
        rows, places = _places(fit.likelihood)
        row[places] = fit.z[fit.likelihood.free][rows]
    is_known = np.isfinite(means)
    mean = np.where(is_known, means, 0.0).sum(axis=0) / np.maximum(is_known.sum(axis=0), 1)
    scatter = np.where(is_known, means - mean, 0.0)
    between = (scatter * scatter).sum(axis=0) / np.maximum(is_known.sum(axis=0) - 1, 1)
    wider = []
    for fit in fits:
        rows, places = _places(fit.likelihood)
        covariance = fit.covariance.copy()
        covariance[rows, rows] += between[places]
        wider.append(fit._replace(covariance=covariance))
    return wider


def _places(likelihood: Likelihood) -> tuple[list[int], list[int]]:
    """Rows of the shared entries among the free ones, and among `CAR_QUANTITIES`."""
    shared = shared_places(likelihood)
    names = [QUANTITIES[i].name for i in shared]
    return list(np.searchsorted(likelihood.free, shared)), [CAR_QUANTITIES.index(name) for name in names]


def _add(fits: Sequence[Fit[Likelihood]]) -> tuple[Array, Array]:
    """Mean and information of `CAR_QUANTITIES` given all logs."""
    information, toward = np.eye(len(CAR_QUANTITIES)), np.zeros(len(CAR_QUANTITIES))
    for fit in fits:
        rows, places = _places(fit.likelihood)
        precision = portable.inverse(fit.covariance[np.ix_(rows, rows)])
        values, vectors = portable.eigen(precision - np.eye(len(rows)))
        added = product(vectors * np.maximum(values, 0.0), vectors.T)
        mean = fit.z[fit.likelihood.free][rows]
        freed = product(portable.pseudo_inverse(added), product(precision, mean))
        information[np.ix_(places, places)] += added
        toward[places] += product(added, freed)
    return portable.solve(information, toward), information


def _condition(fit: Fit[Likelihood], mean: Array, information: Array) -> Fit[Likelihood]:
    """A log's fit, where the shared entries are as all logs have them."""
    free, covariance = fit.likelihood.free, fit.covariance
    rows, places = _places(fit.likelihood)
    common = portable.inverse(information)[np.ix_(places, places)]
    shared_block = covariance[np.ix_(rows, rows)]
    follow = product(covariance[:, rows], portable.inverse(shared_block))
    z = fit.z.copy()
    z[free] += product(follow, mean[places] - z[free][rows])
    return fit._replace(z=z, covariance=covariance + product(product(follow, common - shared_block), follow.T))


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
