"""How well the numbers of a car are known: by a factor, or by so much to either side."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from adaptrack.base.files import Record

FACTOR = "-, factor"
"""How the description of a key begins whose uncertainty is a factor; that of another begins with its unit."""


def _factor(of: str) -> Any:
    return Field(default=None, ge=1, le=10, description=f"{FACTOR} by which {of} may be larger or smaller")


def _margin(unit: str, of: str, most: float) -> Any:
    return Field(default=None, ge=0, le=most, description=f"{unit}, {of} may lie so much to either side")


class KnownWithin(Record):
    """How far the numbers of a car may be off: the section ``[known_within]`` of a car file.

    A factor f says that the true value lies between value/f and f value; a margin d, between value - d and value + d.
    Keys are those of the car, of its ``[steering]`` with ``steering_`` in front. What is left out is not said.
    """

    mass: float | None = _factor("the mass")
    yaw_inertia: float | None = _factor("the yaw inertia")
    stiffness_front: float | None = _factor("the cornering stiffness of a front tyre")
    stiffness_rear: float | None = _factor("the cornering stiffness of a rear tyre")
    lf: float | None = _margin("m", "the centre of gravity, the axles being where they are,", 5)
    track_front: float | None = _margin("m", "the front track", 5)
    track_rear: float | None = _margin("m", "the rear track", 5)
    cg_height: float | None = _margin("m", "the height of the centre of gravity", 5)
    load_transfer_time: float | None = _factor("the lag of the load transfer")
    frontal_area: float | None = _factor("the frontal area")
    air_density: float | None = _factor("the density of the air")
    drag_coefficient: float | None = _factor("the drag coefficient")
    side_force_slope: float | None = _factor("the side force of wind")
    yaw_moment_slope: float | None = _factor("the yaw moment of wind")
    wind_angle_limit: float | None = _factor("the wind angle at which both stay constant")
    rolling_resistance: float | None = _factor("the rolling resistance")
    engine_power: float | None = _factor("the power")
    traction_limit: float | None = _factor("the driving force")
    brake_limit: float | None = _factor("the braking force")
    drive_front: float | None = _margin("-", "the front axle's share of the driving force", 1)
    brake_front: float | None = _margin("-", "the front axle's share of the braking force", 1)
    length: float | None = _margin("m", "the length", 10)
    width: float | None = _margin("m", "the width", 5)
    front_overhang: float | None = _margin("m", "the front overhang", 5)
    rear_overhang: float | None = _margin("m", "the rear overhang", 5)
    steering_lag: float | None = _margin("s", "the lag", 1)
    steering_dead_time: float | None = _margin("s", "the dead time", 1)
    steering_rate: float | None = _factor("the fastest change of the angle")
    steering_limit: float | None = _factor("the largest angle")
    steering_ratio: float | None = _factor("the steering ratio")

    @classmethod
    def is_factor(cls, name: str) -> bool:
        """Whether the uncertainty of a key is a factor, not a margin."""
        return (cls.model_fields[name].description or "").startswith(FACTOR)

    def clause(self, name: str) -> str:
        """A factor as "x/÷ 1.3", a margin as "± 0.05 m"; empty where nothing is said."""
        value = getattr(self, name, None)
        if value is None:
            return ""
        if self.is_factor(name):
            return f"x/÷ {value:.3g}"
        unit = (type(self).model_fields[name].description or "").split(",")[0]
        return f"± {value:.3g}" + ("" if unit == "-" else f" {unit}")
