"""Planned speeds of a planner that is followed, from legs of constant acceleration."""

import numpy as np

from adaptrack.core.layout import empty
from adaptrack.core.planned.records import PLANNED_MEMORY, PLANNED_SETTINGS, Planned, PlannedSpeeds

PERIOD, GAIN = 0.05, 0.4
"""s, 1/s: of the control, and with which a car catches up."""


def speeds_of(legs, speed, *, start=0.0):
    """Planned speeds from legs of constant acceleration (s, m/s^2) and rests (s, None)."""
    nodes, place, time = [[0.0, speed, start, start]], 0.0, start
    for seconds, acceleration in legs:
        time += seconds
        if acceleration is None:
            nodes[-1][3] = time
            continue
        place += (speed + 0.5 * acceleration * seconds) * seconds
        speed = max(speed + acceleration * seconds, 0.0)
        nodes.append([place, speed, time, time])
    return PlannedSpeeds(*np.array(nodes).T.copy())


def planned(speeds, **settings):
    """A planner whose trajectory is followed."""
    row = np.zeros(1, PLANNED_SETTINGS.dtype)
    for name in PLANNED_SETTINGS.dtype.names:
        default = getattr(PLANNED_SETTINGS.field_settings.get(name), "default", 0.0)
        row[name] = ({"period": PERIOD, "catch_up": GAIN} | settings).get(name, default)
    return empty(Planned)._replace(settings=row, memory=PLANNED_MEMORY.new(1), speeds=speeds)
