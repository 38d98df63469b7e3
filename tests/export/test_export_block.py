"""A record of the core, as bytes, is that record in the memory of a C program; nothing damaged is laid."""

import platform
import subprocess

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.core.controllers.mpc_step import MPCStep
from adaptrack.core.kernel import INTERPRETED
from adaptrack.export.block import ArrayRole, ArrayStart, pack
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from exported import Memory
from programs import find_program

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


def block_of(tuning=None, **options):
    """The block of an MPC that learns."""
    mpc = at.MPC(CAR, tuning, profile="road", **{"learning": at.Learning(), **options})
    step = MPCStep(mpc._mpc, mpc.functions, np.asarray(mpc._now), mpc._reference.values, mpc._requested)
    return pack(step, "Step", ROLES, FROM, RESETS)


def test_blocks_of_one_kind_of_controller_share_their_layout():
    blocks = [block_of(), block_of(), block_of(at.Tuning(30, 10, 2.0, 20.0))]
    assert len({block.header.layout for block in blocks}) == 1
    assert blocks[0].content == blocks[1].content
    assert blocks[0].checksum != blocks[2].checksum


def test_constants_of_other_sizes_are_refused_under_way(folder):
    memory = Memory(block_of(), folder)
    memory.lay()
    shorter = block_of(learning=None, longest_horizon=40)
    assert memory.renew(shorter.content) == exported.OTHER_SIZES


def gcc_version():
    return subprocess.run([find_program("gcc"), "-dumpfullversion"], capture_output=True, text=True, check=True).stdout


def hostile(content, rng, count):
    """Damaged copies: cut short, longer, some bits of one byte or of two others."""
    for _ in range(count):
        damaged_block = bytearray(content)
        kind = rng.integers(4)
        if kind == 0:
            damaged_block = damaged_block[: rng.integers(len(damaged_block))]
        elif kind == 1:
            damaged_block += bytes(int(rng.integers(1, 64)))
        else:
            for _ in range(kind - 1):
                damaged_block[rng.integers(len(damaged_block))] ^= int(rng.integers(1, 256))
        yield bytes(damaged_block)


def test_damaged_constants_and_states_change_nothing(folder):
    block = block_of()
    memory, rng = Memory(block, folder), np.random.default_rng(5)
    before = memory.raw.copy()
    damaged = list(hostile(block.content, rng, 300))
    assert exported.OK not in {memory.lay(content) for content in damaged}
    assert (memory.raw == before).all()
    memory.lay()
    state, before = memory.save(), memory.raw.copy()
    assert exported.OK not in {memory.renew(content) for content in damaged}
    assert exported.OK not in {memory.restore(content) for content in hostile(state, rng, 300)}
    assert (memory.raw == before).all()


def test_another_version_kind_or_memory_is_refused_and_nothing_is_written(folder):
    block = block_of()
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


REORDERS = ("-O3", "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")


@pytest.mark.parametrize("options", [("-O2", "-mfma", "-ffp-contract=fast"), REORDERS, ("-O2", "-mfma")])
def test_a_compiler_that_fuses_or_reorders_operations_is_refused_at_the_start(options, folder):
    if platform.machine() != "x86_64":
        pytest.skip("gives options for x86-64")
    if options == ("-O2", "-mfma") and int(gcc_version().split(".")[0]) > 12:
        pytest.skip("this GCC fuses nothing in C99")
    assert Memory(block_of(), folder, options=options).lay() == exported.ARITHMETIC
    assert Memory(block_of(), folder, options=("-O3", "-mfma", *EXACT_OPTIONS)).lay() == exported.OK
