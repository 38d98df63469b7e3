"""Answers in one sentence, from the numbers of a result: the first line that a command prints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from adaptrack.core.plants.forces import GRAVITY

if TYPE_CHECKING:
    from adaptrack.analysis.certify import Certificate
    from adaptrack.cars.vehicle import Vehicle

Row = Mapping[str, Any]

MOST_NAMED = 4
"""Contenders that an answer names beside the best."""
THIN_MODULUS = 0.25
"""-, of the modulus margin, below which it is called thin: textbooks ask for 0.5 and more."""


# -- words ------------------------------------------------------------------------------------------------------------
def length(metres: float) -> str:
    """A length in the unit in which one says it, to two or three digits."""
    if not math.isfinite(metres):
        return "unknown"
    if metres < 0.01:
        return f"{1000.0 * metres:.2g} mm"
    if metres < 0.995:
        return f"{100.0 * metres:.2g} cm"
    return f"{metres:.3g} m" if metres < 1000.0 else f"{metres / 1000.0:.3g} km"


# -- roads ------------------------------------------------------------------------------------------------------------
def of_road(summary: Mapping[str, Any], barred: int) -> str:
    """Whether a road can be driven, how long it is, how fast; barred: places that cannot."""
    radius = summary["smallest_radius"]
    bends = "straight" if radius is None else f"tightest radius {length(radius)}"
    speeds = " to ".join(dict.fromkeys(f"{summary[end]:.3g}" for end in ("slowest", "fastest"))) + " m/s"
    about = f"{length(summary['length'])}, {bends}, {speeds}, {summary['duration']:.0f} s"
    if barred:
        return f"The road cannot be driven at {barred} {'place' if barred == 1 else 'places'} ({about})."
    return f"The road can be driven: {about}."


# -- certificates -----------------------------------------------------------------------------------------------------
def of_certificate(found: Certificate) -> str:
    """The verdict; before it, where the loop is stable, whether its margins are thin, driving straight."""
    if not found.passed:
        return found.verdict
    (worst,), delay = found.worst_points(1), float(found.counted.straight.delay.min())
    modulus, at = worst["modulus_margin"], f"at {worst['speed']:.3g} m/s on friction {worst['friction']:.2g}"
    thin = []
    if delay < found.period:
        thin.append(f"{1000.0 * delay:.0f} ms of delay, where a control period is {1000.0 * found.period:.0f} ms")
    if modulus < THIN_MODULUS:
        thin.append(f"a modulus margin of {modulus:.2g} {at}, where 0.5 is usual")
    if thin:
        return f"Stable, but with thin margins: {' and '.join(thin)}. {found.verdict}"
    return f"Stable; the smallest modulus margin is {modulus:.2g}, {at}. {found.verdict}"


# -- cars -------------------------------------------------------------------------------------------------------------
def of_car(vehicle: Vehicle) -> str:
    """What a car is like to steer, and how much of it is estimated."""
    gradient = math.degrees(1.0) * GRAVITY * vehicle.understeer_gradient
    kind = f"understeers by {gradient:.2g} °/g"
    if gradient < 0.0:
        kind = f"oversteers by {-gradient:.2g} °/g, unstable from {vehicle.critical_speed:.3g} m/s on"
    guesses = len(vehicle.estimated)
    estimated = f"; {guesses} of its numbers are estimated" if guesses else ""
    return f"{vehicle.name}: {vehicle.mass:.5g} kg, wheelbase {vehicle.wheelbase:.3g} m, {kind}{estimated}."
