"""What a page shows of a drive is the drive: frames are its trace, the predicted path lies where the car will be."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.controllers.base import Room
from adaptrack.core.controllers.mpc import MPC_ANSWER
from adaptrack.core.kernel import Resident, address_of
from adaptrack.core.plants.contract import PLANT_STATE
from adaptrack.core.simulation import frame
from adaptrack.core.simulation import run as kernel
from adaptrack.core.simulation.frame import FRAME
from adaptrack.core.simulation.run import TRACE_SIGNALS, Frames
from adaptrack.core.simulation.world import OFF_ROAD, RUNNING
from adaptrack.drive.batch import Batch
from adaptrack.road import Arc, Line

CAR = at.load_vehicle("paper")
CIRCLE = at.Road.from_segments([Arc(length=2.0 * np.pi * 60.0, curvature=1 / 60.0)], name="circle")


def run_of(controller, scenario, profile="road", traced=False, **options):
    """A run of one slot before its first instant, which shows as many periods as it has, and how many these are."""
    batch = Batch(at.DualTrack(CAR), controller, [scenario], profile, **options)
    n = int(batch.periods[0])
    run = batch.run_record(
        1, int(batch.substeps[0]), Room(), 0, n if traced else 0, batch.scheduler,
    )  # fmt: skip
    part, settings = run.controller, run.controller.mpc.settings
    width = len(FRAME) + part.answer.shape[1] - 1 + (0 if part.plans else part.tuning.shape[1])
    widths = width, 2 * int(settings.longest_horizon), int(settings.most_moves)
    frames = Frames(*(np.full((n, columns), np.nan) for columns in widths))
    run = run._replace(show=address_of(frame.show_period), frames=frames)
    run.inputs.seeds[:], run.vehicles.start[:], run.controller.tuning[:] = 3, batch.starts[0], batch.tuning
    kernel.begin(1, Resident(run))
    return run, n


def frames_of(run, pieces):
    """The frames of a drive that is driven in pieces of so many periods."""
    first = int(run.memory.drives["instant"][0])
    periods = sum(kernel.roll_on(count, 1, run) for count in pieces)
    return [table[first : first + periods] for table in run.frames]


def pieces_of(n):
    yield from (1, 1, 7, 40)
    yield from [64] * (n // 64 + 1)


CONTROLLERS = {
    "informed": lambda: at.MPC(CAR, profile="road"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "published, scheduled": lambda: at.published_mpc(CAR, scheduler=at.load_scheduler("road-nn")),
    "Stanley": lambda: at.Stanley(CAR),
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_the_frames_of_a_drive_in_pieces_are_its_trace_to_the_bit(name):
    scenario = at.load_scenario("double-lane-change")
    run, periods = run_of(CONTROLLERS[name](), scenario)
    numbers, _, _ = frames_of(run, pieces_of(periods))
    unbroken, _ = run_of(CONTROLLERS[name](), scenario, traced=True)
    kernel.roll_on(periods, 1, Resident(unbroken))
    trace = unbroken.trace
    assert len(numbers) == periods
    for column, expected in (
        ("x", trace.state[0, :, PLANT_STATE.x]),
        ("yaw_rate", trace.state[0, :, PLANT_STATE.yaw_rate]),
    ):
        assert np.array_equal(numbers[:, getattr(FRAME, column)], expected)
    assert np.array_equal(numbers[:, : len(TRACE_SIGNALS)], trace.signals[0])
    assert np.array_equal(numbers[:, FRAME.command], trace.answer[0, :, MPC_ANSWER.command])
    assert np.array_equal(numbers[:, len(FRAME) :], trace.answer[0, :, 1:], equal_nan=True)
    assert run.result.tobytes() == unbroken.result.tobytes()
    counts = unbroken.controller.schedule.memory
    stepped_in = sum(int(counts[name][0]) for name in ("rate_limited", "unstable", "fallback")) if counts.size else 0
    assert numbers[-1, FRAME.guard] == stepped_in


def test_a_run_that_fails_ends_and_says_why():
    run, _ = run_of(at.MPC(CAR, profile="road"), at.load_scenario("double-lane-change"), profile="paper")
    frames_of(run, [20])
    run.vehicles.block[PLANT_STATE.y * 32] += 30.0
    numbers, _, _ = frames_of(run, [5, 5])
    assert len(numbers) == 0
    assert int(run.memory.drives[0].ended) == OFF_ROAD != RUNNING
    assert run.memory.drives[0].ended_at == pytest.approx(20 * run.settings.period)


def test_on_a_straight_road_the_predicted_path_is_what_is_driven():
    straight = at.Road.from_segments([Line(length=400.0)], name="straight")
    run, _ = run_of(at.MPC(CAR, profile="paper"), at.RoadDrive(straight, speed=15.0), "paper")
    run.vehicles.start[0, PLANT_STATE.y] = 0.4
    kernel.begin(1, Resident(run))
    numbers, predicted, moves = frames_of(run, [120])
    horizon, delay = int(numbers[0, len(FRAME) + MPC_ANSWER.Np - 1]), run.controller.mpc.settings.delay
    at_instant = 30
    points = predicted[at_instant].reshape(-1, 2)
    expected_x = numbers[at_instant, FRAME.x] + 15.0 * run.settings.period * (np.arange(horizon) + 1.0 + delay)
    assert np.allclose(points[:horizon, 0], expected_x, rtol=0.0, atol=0.05)
    assert np.isnan(points[horizon:]).all()
    path = np.interp(points[:horizon, 0], numbers[:, FRAME.x], numbers[:, FRAME.y])
    assert np.abs(points[:horizon, 1] - path).max() < 0.05
    count = int(numbers[0, len(FRAME) + MPC_ANSWER.Nc - 1])
    assert np.allclose(moves[:, 0], numbers[:, len(FRAME)], rtol=0.0, atol=1e-12)
    settings = run.controller.mpc.settings
    assert (moves[:, 1:count] <= settings.move_max + 1e-9).all()
    assert (moves[:, 1:count] >= settings.move_min - 1e-9).all()
    assert np.isnan(moves[:, count:]).all()


def test_on_a_circle_the_predicted_path_is_the_circle():
    run, _ = run_of(at.MPC(CAR, profile="paper"), at.RoadDrive(CIRCLE, speed=10.0), "paper")
    numbers, predicted, _ = frames_of(run, [200])
    points = predicted[-1].reshape(-1, 2)
    points = points[np.isfinite(points[:, 0])]
    radius = np.hypot(points[:, 0], points[:, 1] - 60.0)
    assert len(points) == int(numbers[-1, len(FRAME) + MPC_ANSWER.Np - 1])
    assert np.abs(radius - 60.0).max() < 0.05
    along = np.hypot(*np.diff(points, axis=0).T)
    assert np.allclose(along, 10.0 * run.settings.period, rtol=0.01)
