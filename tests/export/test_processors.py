"""Every processor gives the same bits: elementary functions, 3,000 steps of an MPC, ten drives, numbers of controllers.

What is compared are the libraries that `python -m adaptrack.core.build aarch64` has made, and the module for
WebAssembly of `python -m adaptrack.core.build wasm32`. Those of other
processors and systems are run by an emulator; for what is missing here, a test is skipped.
"""

import ctypes
import itertools
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.export.test_export_c import POINTS

import adaptrack as at
from adaptrack.control.controllers.base import Room
from adaptrack.core import library
from adaptrack.core.controllers.mpc_step import MPCStep
from adaptrack.core.kernel import INTERPRETED, row_of
from adaptrack.core.maths.portable import FUNCTION_NAMES
from adaptrack.core.synthesis import laws
from adaptrack.core.tracker.signals import TRACKER_SAMPLE as CALL
from adaptrack.drive.batch import Batch
from adaptrack.export.recorded_drive import record_drive
from adaptrack.export.tracking import speed_part
from by_kernels import CASES, make_order
from processors import board
from processors.image import BEGIN, COPY, DRIVE, ELEMENTARY, GAINS, MAKE, STEP, TELL, Image, run
from programs import EMULATORS, find_program, run_program
from tracker_calls import calls

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(library.WAY != "library", reason="compares libraries")]
HERE = Path(__file__).parents[1] / "processors"
EMULATED = {
    "aarch64": EMULATORS["aarch64"], "riscv64": EMULATORS["riscv64"], "windows-x86-64-v3": EMULATORS["windows"],
}  # fmt: skip
STEPS, AHEAD = 3000, 60


def built_library(name):
    try:
        entry = library.manifest()["libraries"].get(name)
        return None if entry is None else library.verified_file(entry)
    except library.UNUSABLE:
        return None


def own_library():
    path = built_library(library.processor())
    if path is None:
        pytest.skip("the kernels have not been compiled")
    return ctypes.CDLL(str(path))


def test_a_library_leaves_nothing_undefined():
    assert run_program("nm", "--dynamic", "--undefined-only", built_library(library.processor())) == ""


# -- what is called ---------------------------------------------------------------------------------------------------
def elementary(rng):
    """All elementary functions on every combination of special arguments, and on many others."""
    special = np.array([0.0, 5e-324, 2.2e-308, 0.5, 1.0, 1.5, 3.0, 710.0, 1e5, 2.0**53, 1.7e308, np.inf, np.nan])
    special = np.concatenate([special, -special])
    grid = np.array(np.meshgrid(special, special, special)).reshape(3, -1)
    count = 20000
    some = rng.integers(-(2**63), 2**63, (3, count)).view(np.float64)
    moderate = rng.uniform(-4.0, 4.0, (3, count))
    extreme = rng.choice([-1.0, 1.0], (3, count)) * 10.0 ** rng.uniform(-20.0, 20.0, (3, count))
    arguments = np.ascontiguousarray(np.concatenate([grid, some, moderate, extreme], axis=1))
    # the branch-free ones promise nothing beyond 1e5, but the same bits
    image, values = Image(), np.zeros(arguments.shape[1])
    inputs, outputs = image.put(arguments), image.put(values)
    for number in range(len(FUNCTION_NAMES)):
        image.do(ELEMENTARY, number, inputs, values.size, outputs)
        image.do(TELL, outputs, values.size)
    return image


def mpc_steps(rng):
    """Steps of an MPC that estimates, its sensors noisy and at times broken."""
    mpc = at.MPC(at.load_vehicle("paper"), profile="road")
    mpc.step(np.zeros(4), 15.0, np.zeros(AHEAD))
    mpc.reset()
    clock, reference, image = np.array([0.0, AHEAD]), np.zeros(AHEAD), Image()
    step = image.record(MPCStep(mpc._mpc, mpc.functions, clock, reference, mpc._requested))
    speed_now, ahead = image.put(clock), image.put(reference)
    measured, answer = image.put(mpc._mpc.measured), image.put(mpc._mpc.answer)
    inputs = np.zeros((STEPS, 1 + mpc._mpc.measured.size + AHEAD))
    for k in range(STEPS):
        state = np.array([0.3 * np.sin(k / 37), 0.1 * np.cos(k / 60), 0.1 * np.sin(k / 23), 2.0 * np.sin(k / 60)])
        state += rng.normal(size=4) * [0.05, 0.003, 0.01, 0.05]
        state[rng.uniform(size=4) < 0.02] = rng.choice([np.nan, 1e300, -np.inf])
        speed = rng.uniform(-1.0, 2.0) if 700 < k < 900 else 15.0 + 8.0 * np.sin(k / 300)
        visible = 2.0 * np.sin((k + np.arange(AHEAD)) / 60) + (3.0 if k % 500 > 400 else 0.0)
        mpc.step(state, speed, visible)
        inputs[k] = [speed, *mpc._mpc.measured, *visible]
    first, width = image.put(inputs), inputs.shape[1]
    for k in range(STEPS):
        place = first + k * width
        image.do(COPY, place, speed_now, 1)
        image.do(COPY, place + 1, measured, mpc._mpc.measured.size)
        image.do(COPY, place + 1 + mpc._mpc.measured.size, ahead, AHEAD)
        image.do(STEP, step)
        image.do(TELL, answer, mpc._mpc.answer.size)
    return image


def drives(rng):
    """Ten whole drives: two plants, the MPC and the other control laws, noise and all."""
    image = Image()
    vehicle = at.load_vehicle("paper")
    scenario = at.load_scenario("double-lane-change")
    controllers = [
        at.MPC(vehicle, profile="road"), at.MPC(vehicle), at.Stanley(vehicle), at.PurePursuit(vehicle),
        at.LQR(vehicle),
    ]  # fmt: skip
    for plant in (at.SingleTrack(vehicle), at.DualTrack(vehicle)):
        for controller in controllers:
            add_drive(image, Batch(plant, controller, [scenario], "road"))
    return image


def add_drive(image, batch):
    periods, steps = int(batch.periods[0]), int(batch.substeps[0])
    run_record = batch.run_record(1, steps, Room(), 0, periods)
    run_record.inputs.scenario[:], run_record.inputs.seeds[:] = 0, 7
    run_record.vehicles.start[:], run_record.controller.tuning[:] = batch.starts[0], batch.tuning
    place = image.record(run_record)
    image.do(BEGIN, 1, place)
    image.do(DRIVE, periods, 1, place)
    for part in (run_record.result, *run_record.trace):
        image.do(TELL, image.put(part), part.nbytes // 8)


def synthesis(rng):
    """The numbers of MPCs and of an LQR, made of cars and beliefs."""
    image = Image()
    for name, case in itertools.product(("paper", "midsize-sedan", "van"), CASES):
        rows = make_order(at.load_vehicle(name), CASES[case])
        order, numbers = (image.put(np.array([row])) for row in rows)
        image.do(MAKE, order, numbers)
        image.do(TELL, numbers, rows[1].nbytes // 8)
    car = at.load_vehicle("van")
    common = row_of(laws.Common, period=0.05, move_min=-0.1, move_max=0.1, angle_min=-0.5, angle_max=0.5)
    tuning, gains = np.array([1.0, 100.0, 1000.0, 0.0]), np.zeros(laws.LQR_NUMBERS)
    inputs = [image.put(values) for values in (np.array([car.numbers]), np.array([common]), tuning, gains)]
    image.do(GAINS, *inputs)
    image.do(TELL, inputs[-1], gains.size)
    return image


IMAGES = {"elementary": elementary, "mpc": mpc_steps, "drives": drives, "synthesis": synthesis}


@pytest.fixture(scope="module")
def images():
    if INTERPRETED:
        pytest.skip("needs compiled kernels")
    drawn_images = {name: make(np.random.default_rng(5)) for name, make in IMAGES.items()}
    answers = own_library()
    return {name: (image, run(image, answers)) for name, image in drawn_images.items()}


def same(answers, expected):
    """How many words differ; a NaN is like any other."""
    assert answers.size == expected.size
    both = np.isnan(answers.view(np.float64)) & np.isnan(expected.view(np.float64))
    return int(np.sum((answers != expected) & ~both))


# -- who calls it -----------------------------------------------------------------------------------------------------
def by_emulator(name, image, folder):
    compiler, *emulator = EMULATED[name]
    names = image.functions
    (folder / "functions.h").write_text(
        "".join(f"extern void adaptrack_{name}(void);\n" for name in names)
        + f"static void (*FUNCTIONS[])(void) = {{{', '.join(f'adaptrack_{name}' for name in names) or '0'}}};\n"
    )
    of_windows, driver = name.startswith("windows"), folder / "driver.exe"
    library_file = shutil.copy(built_library(name), folder / ("kernels.dll" if of_windows else "kernels.so"))
    run_program(compiler, "-O1", f"-I{folder}", HERE / "driver.c", library_file, "-o", driver)
    return [*emulator, driver, folder / "image", folder / "answers"]


def by_node(name, image, folder):
    files = HERE / "driver.mjs", built_library(name), folder / "image", folder / "answers"
    return ["node", *files, *image.functions]


@pytest.mark.slow
@pytest.mark.parametrize("content", IMAGES)
@pytest.mark.parametrize("name", [*EMULATED, "wasm32"])
def test_another_processor_gives_the_same_bits(name, content, images, tmp_path):
    if built_library(name) is None:
        pytest.skip(f"not compiled: {library.BUILD} {name}")
    image, expected = images[content]
    image.words().tofile(tmp_path / "image")
    command = (by_node if name == "wasm32" else by_emulator)(name, image, tmp_path)
    run_program(*command)
    assert same(np.fromfile(tmp_path / "answers", np.int64), expected) == 0


@pytest.mark.slow
@pytest.mark.parametrize("content", IMAGES)
@pytest.mark.parametrize("name", ["x86-64", "x86-64-v3"])
def test_an_older_processor_of_this_kind_gives_the_same_bits(name, content, images):
    if library.processor() <= name:  # the names of a kind are in the order of their age
        pytest.skip(f"needs a younger processor; this is {library.processor()}")
    if built_library(name) is None:
        pytest.skip(f"not compiled: {library.BUILD} {name}")
    image, expected = images[content]
    assert same(run(image, ctypes.CDLL(str(built_library(name)))), expected) == 0


# -- microcontrollers -------------------------------------------------------------------------------------------------
CAR = at.load_vehicle("midsize-sedan")
SMALL = {
    "informed": lambda: at.MPC(CAR, profile="road", learning=None),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "published": lambda: at.published_mpc(CAR),
    "speed control": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
}


def program(name, count, folder):
    """With a speed control: half of the samples are those of a drive with a stop and hills."""
    path, controller = at.road_through(POINTS), SMALL[name]()
    plan, samples = at.plan_speed(path, CAR), np.array(list(calls(np.random.default_rng(2), count, path)))
    speed = at.SpeedControl(CAR, (0.6, 0.9)) if name == "speed control" else None
    if speed is not None:
        part = speed_part(speed, controller, plan)
        drive = record_drive(controller, at.DualTrack(CAR), path, plan, at.load_profile("road"), speed=part)
        samples[:, [CALL.t, CALL.now, CALL.motion_time]] += drive.samples[count // 2, CALL.now] + 10.0
        samples = np.pad(samples, ((0, 0), (0, len(CALL) - samples.shape[1])), constant_values=np.nan)
        samples = np.concatenate([drive.samples[: count // 2], samples[: count - count // 2]])
    return board.Program(controller, samples, (path, plan), folder, speed)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("target", board.BOARDS)
def test_a_microcontroller_gives_the_same_bits_in_its_memory(target, name, tmp_path):
    if why := board.missing():
        pytest.skip(why)
    ran = program(name, 600 if target == "cortex-m7" else 30, tmp_path).on(target)
    assert ran.differ == 0
    assert ran.code < 400_000
    assert ran.constants < 64_000
    assert ran.memory < {"learning": 91_000, "speed control": 107_000}.get(name, 72_000)
    assert ran.stack < 16_000


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("target", EMULATED)
def test_what_is_exported_gives_the_same_bits_on_another_processor(target, name, tmp_path):
    compiler, emulator, *options = EMULATED[target]
    if why := board.missing((compiler, emulator, "gcc")):
        pytest.skip(why)
    built_program = program(name, 2000, tmp_path)
    answers = built_program.here(compiler, [find_program(emulator), *options])
    assert board.differing(built_program.here(), answers) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_no_call_uses_memory_that_was_not_written(name, tmp_path):
    # for the oldest processor, gcc's default: valgrind does not know all instructions of the others
    if why := board.missing(("valgrind", "gcc")):
        pytest.skip(why)
    built_program = program(name, 300, tmp_path)
    answers = built_program.here(under=["valgrind", "--quiet", "--error-exitcode=9"])
    assert board.differing(built_program.here(), answers) == 0
