"""The kernels that say how much memory a run takes say what Python lays."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.controllers.base import Room
from adaptrack.core import layout
from adaptrack.core.controllers import mpc
from adaptrack.core.kernel import Array
from adaptrack.core.simulation import run as kernel
from adaptrack.drive.batch import Batch
from adaptrack.road import Arc

CAR = at.load_vehicle("paper")
ROAD = at.RoadDrive(at.Road.from_segments([Arc(length=300.0, curvature=1 / 80.0)]), speed=12.0)
LANES = at.load_scenario("double-lane-change")


def scheduled():
    return at.published_mpc(CAR, scheduler=at.load_scheduler("road-nn"))


CASES = {
    "informed": (lambda: at.MPC(CAR, profile="road"), LANES, "road", None),
    "learning on a road": (lambda: at.MPC(CAR, profile="production", learning=at.Learning()), ROAD, "production", None),
    "scheduled, estimating": (scheduled, LANES, "road", at.FrictionWindEstimator),
    "laguerre, output limits": (
        lambda: at.MPC(CAR, moves=at.Moves.laguerre(0.5, 5), limits=at.Limits(output=(-3.0, 3.0)), solver="hildreth"),
        ROAD, "road", None,
    ),
    "Stanley": (lambda: at.Stanley(CAR), ROAD, "road", None),
}  # fmt: skip


def arrays(record):
    """All arrays of a record, in the order of its words."""
    for kind, value in zip(record.kinds.values(), record, strict=True):
        if isinstance(value, tuple):
            yield from arrays(value)
        elif isinstance(kind, Array):
            yield value


def sizes_of(run):
    """The sizes that are chosen, as a program has them that knows only how many numbers there are."""
    loop, part, plan = run, run.controller, run.controller.schedule
    law, controller, inputs, turning = part.law, part.mpc, run.inputs, part.mpc.feed.turning
    (row,) = kernel.RunSizes.new(1)
    for name, value in {
        "slots": len(part.tuning), "plant_parameters": loop.vehicles.parameters.size,
        "plant_states": loop.vehicles.start.shape[1],
        "scenarios": len(inputs.scenario) and inputs.signals.shape[0], "samples": inputs.signals.shape[2],
        "roads": len(inputs.roads.numbers), "starts": inputs.roads.start.size, "pieces": len(inputs.roads.pieces),
        "headings": inputs.roads.headings.size, "estimator_parameters": loop.variable_estimator.parameters.size,
        "estimator_settings": loop.variable_estimator.settings.size, "dead_whole": loop.settings.dead_whole,
        "past": loop.memory.past.shape[1], "segments": loop.segments.shape[1], "traced": loop.trace.state.shape[1],
        "answers": loop.trace.answer.shape[2], "requested": loop.memory.requested.shape[1],
    }.items():  # fmt: skip
        row[name] = value
    for name, value in {
        "slots": len(part.tuning), "tuning": part.tuning.shape[1], "law_parameters": law.parameters.size,
        "law_memory": law.memory.shape[1], "law_answer": law.answer.size, "answer": part.answer.shape[1],
        "integers": plan.integers.size, "numbers": plan.numbers.size, "scratch": plan.scratch.size,
    }.items():  # fmt: skip
        row.controller[name] = value
    for name, value in {
        "slots": len(part.tuning), "states": controller.states.size, "parameters": controller.parameters.size,
        "turning": turning.size, "lag": mpc.turning_of(turning, 0).lag if turning.size else 0.0,
        "estimator": controller.informed.estimator.size, "estimates": controller.informed.estimates.shape[1],
        "learner": controller.informed.learner.size, "learned": controller.informed.fresh.size,
        "curved": len(inputs.roads.numbers) > 0 and part.plans > 0,
    }.items():  # fmt: skip
        row.controller.mpc[name] = value
    return row


@pytest.mark.parametrize("name", CASES)
def test_the_sizes_that_kernels_say_are_those_that_python_lays(name):
    make, scenario, profile, estimator = CASES[name]
    controller = make()
    perception = None if estimator is None else estimator(CAR, period=controller.period)
    batch = Batch(at.DualTrack(CAR), controller, [scenario, scenario], profile, perception=perception)
    run = batch.run_record(3, int(batch.substeps[0]), Room(), 4, 50, batch.scheduler)
    (settings,) = mpc.MPCSettings.new(1, **run.controller.mpc.settings._asdict())
    settings.learns, settings.curved, settings.feeds_forward = 0, 0, 0
    table = np.full((layout.arrays_of(kernel.RunRecord), layout.SIZES), -1)
    assert kernel.write_sizes(settings, sizes_of(run), table) == len(table)
    for row, laid in zip(table.tolist(), arrays(run), strict=True):
        assert tuple(row[: laid.ndim]) == laid.shape
        assert not any(row[laid.ndim :])
    assert settings.tolist() == tuple(run.controller.mpc.settings)
    assert all(array.ctypes.data % layout.ALIGNMENT == 0 for array in arrays(run.controller.mpc.ws) if array.size)
