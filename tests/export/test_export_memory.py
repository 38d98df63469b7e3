"""Constants are a struct of C and a file with the same words; damaged ones, and other layouts, are refused."""

import ctypes
import platform

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.core.kernel import INTERPRETED
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.tracking import tracking_memory
from exported import CTracker, Exported
from programs import run_program

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
CAR = at.load_vehicle("midsize-sedan")


def controller(tuning=None, **options):
    """An MPC that learns."""
    return at.MPC(CAR, tuning, profile="road", **{"learning": at.Learning(), **options})


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """The export of one, as a library of this process."""
    folder, mpc = tmp_path_factory.mktemp("export"), controller()
    at.export_c(mpc, folder)
    return Exported(folder, mpc)


def test_controllers_that_differ_in_their_numbers_share_their_layout():
    memories = [tracking_memory(controller(tuning)) for tuning in (None, None, at.Tuning(30, 10, 2.0, 20.0))]
    assert len({memory.layout for memory in memories}) == 1
    assert memories[0].content == memories[1].content
    assert memories[0].content != memories[2].content


def test_other_horizons_and_another_car_fit_a_layout_with_room_for_them():
    cars = CAR, CAR.replace(mass=1.1 * CAR.mass)
    tunings = at.Tuning(20, 5), at.Tuning(40, 12)
    layouts = {
        tracking_memory(at.MPC(car, tuning, profile="road", learning=None), (40, 12)).layout
        for car, tuning in zip(cars, tunings, strict=True)
    }
    assert len(layouts) == 1


def test_constants_of_another_layout_are_refused_at_the_start_and_under_way(library):
    tracker = CTracker(library)
    for other in (controller(learning=None), controller(longest_horizon=40), at.Stanley(CAR)):
        content = tracking_memory(other).content
        assert tracker.init(content) == tracker.load(content) == exported.OTHER_SIZES


def hostile(content, rng, count):
    """Damaged copies: cut short, longer, some bits of one byte or of two others."""
    for _ in range(count):
        damaged = bytearray(content)
        kind = rng.integers(4)
        if kind == 0:
            damaged = damaged[: rng.integers(len(damaged))]
        elif kind == 1:
            damaged += bytes(int(rng.integers(1, 64)))
        else:
            for _ in range(kind - 1):
                damaged[rng.integers(len(damaged))] ^= int(rng.integers(1, 256))
        yield bytes(damaged)


def test_damaged_constants_and_states_change_nothing(library):
    tracker, rng = CTracker(library), np.random.default_rng(5)
    state, before = tracker.save(), tracker.raw.copy()
    damaged = list(hostile(library.constants, rng, 300))
    assert exported.OK not in {tracker.init(content) for content in damaged}
    assert exported.OK not in {tracker.load(content) for content in damaged}
    assert exported.OK not in {tracker.restore(content) for content in hostile(state, rng, 300)}
    assert (tracker.raw == before).all()


def test_another_version_or_memory_is_refused_and_nothing_is_written(library):
    tracker = CTracker(library)
    state = tracker.save()
    tracker.raw[:] = 7
    before = tracker.raw.copy()
    for word in (1, 3):  # format, kernels
        assert tracker.init(exported.with_word(library.constants, word, 99, "<Q")) == exported.OTHER_VERSION
    assert tracker.init(library.constants[:-8]) == exported.DAMAGED
    tracker.size -= 8
    assert tracker.init(library.constants) == exported.TOO_SMALL
    assert tracker.load(library.constants) == exported.NOT_READY
    assert tracker.restore(state) == exported.NOT_READY
    assert (tracker.raw == before).all()


def test_constants_of_a_big_endian_processor_are_read(library):
    swapped = np.frombuffer(library.constants, ">u8").astype("<u8").tobytes()
    first, second = CTracker(library), CTracker(library, library.constants)
    assert second.init(swapped) == exported.OK
    assert (first.raw == second.raw).sum() >= first.raw.size - 400  # all but addresses
    assert first.save() == second.save()


def test_bounds_are_those_of_the_fields():
    numbers = {
        name: {number.name: number.bounds for number in part}
        for name, part in tracking_memory(controller()).numbers.items()
    }
    estimator = numbers["controller.mpc.informed.estimator"]
    assert estimator["longest"].rule == "EXACT"
    assert estimator["periods"][:3] == ("BETWEEN", 0.0, 11.0)  # as many as there is memory for
    assert estimator["share"][:3] == ("BETWEEN", 0.0, np.nextafter(1.0, 0.0))
    assert numbers["controller.mpc.informed.learner"]["computation"][:3] == ("BETWEEN", 0.0, 10.0)
    assert numbers["controller.mpc.settings"][".laguerre"].rule == "EXACT"
    assert numbers["controller.mpc.informed.fresh"]["last[0]"].rule == "ANY"
    assert numbers["tracker.settings"]["[0].furthest"].rule == "NUMBER"


def gcc_version():
    return run_program("gcc", "-dumpfullversion")


REORDERS = ("-O3", "-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")


@pytest.mark.parametrize("options", [("-O2", "-mfma", "-ffp-contract=fast"), REORDERS, ("-O2", "-mfma")])
def test_a_compiler_that_fuses_or_reorders_operations_is_refused_at_the_start(options, library, tmp_path):
    if platform.machine() != "x86_64":
        pytest.skip("gives options for x86-64")
    if options == ("-O2", "-mfma") and int(gcc_version().split(".")[0]) > 12:
        pytest.skip("this GCC fuses nothing in C99")
    source, program = str(library.folder / "src" / "adaptrack_memory.c"), tmp_path / "memory.so"
    for number, chosen in enumerate((options, ("-O3", "-mfma", *EXACT_OPTIONS))):
        compiled = program.with_stem(f"memory{number}")
        options = "-std=c99", *chosen, f"-I{library.folder}/include", "-shared", "-fPIC"
        run_program("gcc", *options, source, "-o", compiled)
        answer = ctypes.CDLL(str(compiled)).adaptrack_compiled_exactly()
        assert answer == (exported.ARITHMETIC, exported.OK)[number]
