"""MPCs of which kernels alone make the numbers, for tests."""

import adaptrack as at
from adaptrack.cars.vehicle import Steering
from adaptrack.control.controllers import informed as face
from adaptrack.control.controllers.belief import UNKNOWN
from adaptrack.core.synthesis.mpc import MPCNumbers

CASES = {
    "known": {"profile": "production"}, "told": {"learning": None, "profile": "road"},
    "unknown": {"belief": UNKNOWN, "learning": None}, "learning": {},
    "without lag": {"belief": Steering(lag=0.0, dead_time=0.12)},
    "unsure": {"belief": Steering(lag=0.1, dead_time=0.1), "uncertainty": at.Uncertainty(0.05, 0.05, 1.3, 0.1)},
}  # fmt: skip


def make_order(vehicle, options):
    """The order of an MPC, and room for its numbers."""
    knowledge = options.get("belief"), options.get("uncertainty"), options.get("learning", face.AUTO)
    order, *_ = face.order_of(vehicle, options.get("profile"), knowledge, None, None)
    return order, MPCNumbers.new(1)[0]
