"""MPCs of which kernels alone make the numbers, for tests."""

import numpy as np

import adaptrack as at
from adaptrack.cars.vehicle import Steering
from adaptrack.control.controllers import informed as face
from adaptrack.control.controllers.belief import UNKNOWN, steering_rows
from adaptrack.core.controllers.mpc import MPCSettings
from adaptrack.core.estimators import kalman, learning
from adaptrack.core.kernel import size_of
from adaptrack.core.synthesis import filter, informed
from adaptrack.scenario.profile import load_profile

UNTOUCHED = -1234.5
CASES = {
    "known": {"profile": "production"},
    "told": {"learning": None, "profile": "road"},
    "unknown": {"belief": UNKNOWN, "learning": None},
    "learning": {},
    "without lag": {"belief": Steering(lag=0.0, dead_time=0.12)},
    "unsure": {"belief": Steering(lag=0.1, dead_time=0.1), "uncertainty": at.Uncertainty(0.05, 0.05, 1.3, 0.1)},
}


def make_order(vehicle, options):
    """The order of an MPC, and its parts with the usual filter."""
    name, mode = options.get("profile"), options.get("learning", "auto")
    world = load_profile(name or "road")
    method = face.DEFAULT_LEARNING if mode in (None, "auto") else mode
    loop = world.controller_world(world.period)
    loop.computation = 0.0 if name is None else loop.computation
    order = face._order(
        vehicle, loop, steering_rows(vehicle, options.get("belief"), world, name is not None),
        options.get("uncertainty"), method,
    )  # fmt: skip
    order.learning = informed.NEVER if mode is None else informed.UNLESS_SAID
    row = informed.InformedParts.new(1)
    default_filter = np.zeros(size_of(filter.Filter))
    filter.usual_filter(default_filter)
    row["filter"] = default_filter.view(filter.Filter.dtype)[0]
    return order, row[0]


def make_parts(vehicle, options):
    """Order, parts and room for the constants of an MPC, whose numbers are not yet written."""
    order, parts = make_order(vehicle, options)
    again = np.array([parts])[0]
    assert informed.informed_parts(order, again) == informed.OK
    n, _, learned = informed.informed_sizes(order, again)
    numbers = size_of(learning.LearnerParameters) if learned else 0
    constants = informed.Constants(
        settings=MPCSettings.new(1), tuning=np.full(4, UNTOUCHED), model=np.full(7, UNTOUCHED),
        states=np.full(n, -7), turning=np.full(7, UNTOUCHED), learner=np.full(numbers, UNTOUCHED),
        estimator=np.full(size_of(kalman.FilterParameters), UNTOUCHED), fresh=np.full(learned, UNTOUCHED),
    )  # fmt: skip
    return order, parts, constants
