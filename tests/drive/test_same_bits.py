"""One drive, several ways: `simulate` in Python, `rollout` and a batch of many give the same bits."""

import functools
import math

import numpy as np
import pytest
from tests.drive.test_simulate import same, users_car

import adaptrack as at
from adaptrack.road import Arc, Line

pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered in scalar:RuntimeWarning")

CAR = at.load_vehicle("paper")
CALM = at.Tuning(25, 6, 1.0, 30.0)
PREVIEWING = {"tuning": at.Tuning(30, 6, 1.0, 3000.0), "period": 0.05, "preview": True}
LATE = at.load_profile("production").replace(missing=0.05, motion_age=0.03)
LATE = LATE.replace(steering=LATE.steering.replace(dead_time=0.07, bias=0.01))
BUS = at.load_profile("production-bus").replace(
    noise_station=0.2, noise_speed_floor=0.05, speed_resolution=0.02, speed_dead_zone=0.5, missing=0.05
)
SINGLE, DUAL, CURVED = at.SingleTrack(CAR), at.DualTrack(CAR), at.DualTrack(CAR, "magic-formula")
LANE_CHANGE = at.load_scenario("lane-change", duration=3.0, speed=15.0)
ROAD = at.generate_road("country", seed=1, length=150.0)
BEND = at.RoadDrive(ROAD, at.plan_speed(ROAD, CAR, top_speed=14.0))
TURN = Arc(length=15.0 * math.pi, curvature=1 / 15)
HAIRPIN = at.RoadDrive(at.Road.from_segments([Line(length=40.0), TURN, Line(length=40.0)], name="hairpin"), 6.0)


def wheels(speed, measured, command, a, b, parameters, memory, x, d):
    """The measured state, and a disturbance that the angle of the wheels alone decides."""
    for i in range(x.size):
        x[i] = measured[i] if math.isfinite(measured[i]) else 0.0
        d[i] = 0.0
    d[0] = measured[4] if math.isfinite(measured[4]) else 0.5


@functools.cache
def from_the_wheels():
    return at.UserEstimator(wheels, label="wheels")


def published(**options):
    return at.published_mpc(CAR, **{"tuning": CALM, **options})


def hildreth(**options):
    return published(solver="hildreth", moves=at.Moves.laguerre(0.75), **options)


DRIVES = {
    "published, paper": (SINGLE, published, LANE_CHANGE, {"profile": "paper"}),
    "published, driver": (DUAL, published, LANE_CHANGE, {"profile": "paper", "driver": at.Driver()}),
    "laguerre, hildreth": (DUAL, hildreth, LANE_CHANGE, {"profile": "paper"}),
    "soft limits": (
        DUAL, lambda: published(limits=at.Limits(output=(-1.0, 5.0))), at.load_scenario("triple-lane-change"),
        {"profile": "paper"},
    ),
    "preview, road": (CURVED, lambda: published(**PREVIEWING), LANE_CHANGE, {"profile": "road", "driver": at.Driver()}),
    "preview, hildreth": (SINGLE, lambda: hildreth(**PREVIEWING), LANE_CHANGE, {"profile": "road"}),
    "informed, road": (CURVED, lambda: at.MPC(CAR, profile="road"), BEND, {"profile": "road"}),
    "informed, production": (CURVED, lambda: at.MPC(CAR, profile="production"), BEND, {"profile": "production"}),
    "learning": (CURVED, lambda: at.MPC(CAR, profile="production", learning=at.Learning()), LANE_CHANGE,
                 {"profile": "production", "driver": at.Driver()}),
    "lqr": (DUAL, lambda: at.LQR(CAR, period=0.05, preview=True), BEND, {"profile": BUS}),
    "pure pursuit": (DUAL, lambda: at.PurePursuit(CAR, period=0.05), BEND, {"profile": "road"}),
    "stanley": (DUAL, lambda: at.Stanley(CAR, period=0.05), LANE_CHANGE, {"profile": "road"}),
    "a schedule": (
        CURVED, lambda: at.published_mpc(CAR, scheduler=at.load_scheduler("road-nn"), period=0.05, preview=True),
        LANE_CHANGE, {"profile": "road"},
    ),
    "missing and late samples": (CURVED, lambda: at.MPC(CAR, profile=LATE), LANE_CHANGE, {"profile": LATE}),
    "late speed and station": (CURVED, lambda: at.MPC(CAR, profile=BUS), BEND, {"profile": BUS, "driver": at.Driver()}),
    "an estimator of the wheels": (
        SINGLE, lambda: at.MPC(CAR, at.Tuning(20, 4, 1.0, 3000.0), period=0.05, estimator=from_the_wheels()),
        LANE_CHANGE, {"profile": "road"},
    ),
    "a user's plant": (users_car, published, LANE_CHANGE, {"profile": "paper"}),
    "informed, hairpin": (DUAL, lambda: at.MPC(CAR, profile="road"), HAIRPIN, {"profile": "road"}),
}  # fmt: skip
"""Plant, controller, drive and options by name."""
LAWS = (at.KinematicMPC, at.LQR, at.PreviewLQR, at.PurePursuit, at.Stanley)
DRIVES |= {
    f"{law.__name__}, hairpin": (
        DUAL,
        functools.partial(law, CAR, period=0.05, preview=True),
        HAIRPIN,
        {"profile": "road"},
    )
    for law in LAWS
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", DRIVES)
def test_a_drive_has_the_same_bits_in_python_compiled_and_among_others(name):
    plant, make, drive, options = DRIVES[name]
    plant = plant() if callable(plant) else plant
    run = at.simulate(plant, make(), drive, seed=7, **options)
    assert same(run, at.rollout(plant, make(), drive, seed=7, **options))
    batch = at.rollout_batch(plant, make(), [drive], scenario_indices=[0] * 3, seeds=[3, 7, 4], **options)
    assert batch.steps[1] == len(run.t)
    if not isinstance(drive, at.RoadDrive):
        assert batch.mse[1] == pytest.approx(np.mean(run.error**2), rel=1e-12)
