"""What a speed control (`core.speed.speed_control`) assumes of resistance and grip, from the numbers of a car."""

from __future__ import annotations

from ..kernel import exported, float64, local, several, vector
from ..physics.forces import GRAVITY
from ..planning.cornering import BENDS, cornering_at, cornering_limits

TYPICAL_CURVATURE = 0.02
"""1/m, of the bend in which the car's share of the friction is taken."""
_limits = local(BENDS)


@exported(several(float64, float64)(float64, float64, float64, float64))
def resistance(air_density, frontal_area, drag_coefficient, rolling_resistance):
    """Force of the air over v^2 (kg/m), and deceleration by rolling (m/s^2): `SpeedSettings.drag`, `rolling`."""
    return 0.5 * air_density * frontal_area * drag_coefficient, rolling_resistance * GRAVITY


@exported(float64(vector, float64, float64))
def usable_friction(plant, steering_limit, friction):
    """The friction of which a car reaches all in a bend: load transfer takes some from tyres that lose with load.

    plant: `PLANT_PARAMETERS`; steering_limit: rad, NaN: `STEERING_LIMIT`.
    """
    limits = _limits()
    tightest = cornering_limits(plant, steering_limit, friction, limits)
    limit = cornering_at(TYPICAL_CURVATURE, tightest, limits)
    return friction * min(limit / (friction * GRAVITY), 1.0)
