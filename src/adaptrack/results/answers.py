"""Answers in one sentence, from the numbers of a result: the first line that a command prints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from adaptrack.core.physics.forces import GRAVITY

if TYPE_CHECKING:
    from adaptrack.analysis.certify import Certificate
    from adaptrack.cars.vehicle import Vehicle

THIN_MODULUS = 0.25
"""-, modulus margin below which an answer calls it thin; textbooks ask for at least 0.5"""


# -- words ------------------------------------------------------------------------------------------------------------
def length(metres: float) -> str:
    """Write a length in mm, cm, m or km, to two or three digits."""
    if not math.isfinite(metres):
        return "unknown"
    if metres < 0.01:
        return f"{1000.0 * metres:.2g} mm"
    if metres < 0.995:
        return f"{100.0 * metres:.2g} cm"
    return f"{metres:.3g} m" if metres < 1000.0 else f"{metres / 1000.0:.3g} km"


# -- roads ------------------------------------------------------------------------------------------------------------
def road_answer(summary: Mapping[str, Any], barred: int) -> str:
    """Drivability, length, bends and speeds of a road; barred: number of places that cannot be driven."""
    radius = summary["smallest_radius"]
    bends = "straight" if radius is None else f"tightest radius {length(radius)}"
    speeds = " to ".join(dict.fromkeys(f"{summary[end]:.3g}" for end in ("slowest", "fastest"))) + " m/s"
    slopes = [100.0 * summary[name] for name in ("least_grade", "largest_grade")]
    grades = f", grades {slopes[0]:.2g} to {slopes[1]:.2g} %" if any(slopes) else ""
    description = f"{length(summary['length'])}, {bends}{grades}, {speeds}, {summary['duration']:.0f} s"
    if barred:
        return f"The road cannot be driven at {barred} {'place' if barred == 1 else 'places'} ({description})."
    return f"The road can be driven: {description}."


# -- certificates -----------------------------------------------------------------------------------------------------
def certificate_answer(certificate: Certificate) -> str:
    """The verdict; for a stable loop preceded by its smallest margins when driving straight."""
    if not certificate.passed:
        return certificate.verdict
    (worst,), delay = certificate.worst_points(1), float(certificate.counted.straight.delay.min())
    modulus, at = worst["modulus_margin"], f"at {worst['speed']:.3g} m/s on friction {worst['friction']:.2g}"
    thin = []
    if delay < certificate.period:
        thin.append(f"{1000.0 * delay:.0f} ms of delay, where a control period is {1000.0 * certificate.period:.0f} ms")
    if modulus < THIN_MODULUS:
        thin.append(f"a modulus margin of {modulus:.2g} {at}, where 0.5 is usual")
    if thin:
        return f"Stable, but with thin margins: {' and '.join(thin)}. {certificate.verdict}"
    return f"Stable; the smallest modulus margin is {modulus:.2g}, {at}. {certificate.verdict}"


# -- cars -------------------------------------------------------------------------------------------------------------
def car_answer(vehicle: Vehicle) -> str:
    """Mass, wheelbase and understeer gradient of a car, and the number of estimated values."""
    gradient = math.degrees(1.0) * GRAVITY * vehicle.understeer_gradient
    kind = f"understeers by {gradient:.2g} °/g"
    if gradient < 0.0:
        kind = f"oversteers by {-gradient:.2g} °/g, unstable from {vehicle.critical_speed:.3g} m/s on"
    guesses = len(vehicle.estimated)
    estimated = f"; {guesses} of its numbers are estimated" if guesses else ""
    return f"{vehicle.name}: {vehicle.mass:.5g} kg, wheelbase {vehicle.wheelbase:.3g} m, {kind}{estimated}."
