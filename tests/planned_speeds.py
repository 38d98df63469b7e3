"""Planned speeds of a planner that is followed, from legs of constant acceleration."""

import numpy as np

from adaptrack.core.kernel import defaults
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
    row = PLANNED_SETTINGS.new(
        1, **defaults(PLANNED_SETTINGS)._asdict() | {"period": PERIOD, "catch_up": GAIN} | settings
    )
    return empty(Planned)._replace(settings=row, memory=PLANNED_MEMORY.new(1), speeds=speeds)
