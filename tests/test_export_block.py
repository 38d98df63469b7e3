"""A record of the core, as bytes, is that record in the memory of a C program; nothing damaged is laid."""

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.core.controllers.mpc_step import MPCStep, step
from adaptrack.core.kernel import INTERPRETED
from adaptrack.export.block import ArrayRole, ArrayStart, pack
from exported import Memory

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
ROLES = {"mpc.states": ArrayRole.FIXED, "mpc.informed.fresh": ArrayRole.FIXED, "mpc.informed.learner": ArrayRole.FIXED,
         "mpc.parameters": ArrayRole.RENEWED, "mpc.informed.estimator": ArrayRole.RENEWED,
         "mpc.ws.rows": ArrayRole.RENEWED, "tuning": ArrayRole.RENEWED}  # fmt: skip
FROM = [ArrayStart("mpc.informed.learned", "mpc.informed.fresh")]
RESETS = {"mpc.memory": {"speed": np.nan}}
CAR = at.load_vehicle("midsize-sedan")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("export")


def made(tuning=None, start=None):
    """An MPC that learns, and its block."""
    mpc = at.MPC(CAR, tuning, profile="road", learning=at.Learning(start=start))
    given = MPCStep(mpc._mpc, mpc.functions, np.asarray(mpc._now), mpc._reference.values, mpc._requested)
    return mpc, pack(given, "Step", ROLES, FROM, RESETS)


def drive(memory, mpc, steps, rng):
    """Steps of both on the same inputs; the number of answers that differ."""
    differ, size = 0, mpc._mpc.answer.size
    for k in steps:
        state = np.array([0.1 * np.cos(k / 60), 0.1 * np.sin(k / 23), 0.1 * np.sin(k / 37), 0.5 * np.sin(k / 60)])
        state += rng.normal(size=4) * 0.01
        state[rng.uniform(size=4) < 0.03] = rng.choice([np.nan, 1e300, -np.inf])
        speed, reference = 15.0 + 8.0 * np.sin(k / 30), np.sin((k + np.arange(60)) / 60)
        mpc.step(state, speed, reference)
        memory.array("now", 2)[:] = np.asarray(mpc._now)
        memory.array("reference", 60)[:] = reference
        memory.array("mpc.measured", mpc._mpc.measured.size)[:] = mpc._mpc.measured
        step.call(memory.record)
        differ += memory.array("mpc.answer", size).tobytes() != mpc._mpc.answer[0].tobytes()
    return differ


def test_steps_in_memory_of_c_are_those_of_python(folder):
    mpc, block = made()
    memory = Memory(block, folder)
    assert memory.lay() == exported.OK
    assert drive(memory, mpc, range(200), np.random.default_rng(1)) == 0
    assert (memory.raw[-8:] == 0xA5A5A5A5A5A5A5A5).all()


def test_blocks_of_one_kind_of_controller_share_their_layout():
    blocks = [made()[1], made()[1], made(at.Tuning(30, 10, 2.0, 20.0))[1]]
    assert len({each.header.layout for each in blocks}) == 1
    assert blocks[0].content == blocks[1].content
    assert blocks[0].checksum != blocks[2].checksum


def test_another_learned_car_takes_the_place_of_what_was_learned(folder):
    mpc, block = made()
    memory, rng = Memory(block, folder), np.random.default_rng(4)
    memory.lay()
    drive(memory, mpc, range(100), rng)
    _, other = made(start=mpc.learned())
    size = mpc._mpc.informed.learned.size
    assert memory.renew(other.content) == exported.OK
    fresh = memory.array("mpc.informed.fresh", size)
    assert memory.array("mpc.informed.learned", size).tobytes() == fresh.tobytes()


def test_constants_of_other_sizes_are_refused_under_way(folder):
    _, block = made()
    memory = Memory(block, folder)
    memory.lay()
    mpc = at.MPC(CAR, profile="road", longest_horizon=40)
    given = MPCStep(mpc._mpc, mpc.functions, np.asarray(mpc._now), mpc._reference.values, mpc._requested)
    assert memory.renew(pack(given, "Step", ROLES, FROM, RESETS).content) == exported.OTHER_SIZES


def hostile(content, rng, count):
    """Damaged copies: cut short, longer, some bits of one byte or of two others."""
    for _ in range(count):
        found = bytearray(content)
        what = rng.integers(4)
        if what == 0:
            found = found[: rng.integers(len(found))]
        elif what == 1:
            found += bytes(int(rng.integers(1, 64)))
        else:
            for _ in range(what - 1):
                found[rng.integers(len(found))] ^= int(rng.integers(1, 256))
        yield bytes(found)


def refuses_damage(folder, count):
    _, block = made()
    memory, rng = Memory(block, folder), np.random.default_rng(5)
    before = memory.raw.copy()
    damaged = list(hostile(block.content, rng, count))
    assert exported.OK not in {memory.lay(each) for each in damaged}
    assert (memory.raw == before).all()
    memory.lay()
    state, before = memory.save(), memory.raw.copy()
    assert exported.OK not in {memory.renew(each) for each in damaged}
    assert exported.OK not in {memory.restore(each) for each in hostile(state, rng, count)}
    assert (memory.raw == before).all()


def test_damaged_constants_and_states_change_nothing(folder):
    refuses_damage(folder, 300)


def test_another_version_kind_or_memory_is_refused_and_nothing_is_written(folder):
    _, block = made()
    memory = Memory(block, folder)
    before = memory.raw.copy()
    memory.reader.kernels += 1
    assert memory.lay() == exported.OTHER_VERSION
    memory.reader.kernels -= 1
    memory.reader.kind += 1
    assert memory.lay() == exported.OTHER_KIND
    memory.reader.kind -= 1
    memory.reader.count -= 1  # a function is not linked in
    assert memory.lay() == exported.OTHER_KIND
    memory.reader.count += 1
    memory.size -= 8
    assert memory.lay() == exported.TOO_SMALL
    assert memory.renew(block.content) == exported.NOT_READY
    assert memory.restore(bytes(64)) == exported.NOT_READY
    assert (memory.raw == before).all()
