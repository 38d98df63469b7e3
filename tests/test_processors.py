"""Every processor gives the same bits: elementary functions, 3,000 steps of an MPC, ten drives, numbers of controllers.

What is compared are the libraries that `python -m adaptrack.core.build aarch64 wasm32` has made. Those of other
processors and systems are run by an emulator; for what is missing here, a test is skipped.
"""

import ctypes
import itertools
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core import library
from adaptrack.core.build.objects import undefined
from adaptrack.core.controllers.mpc_step import MPCStep
from adaptrack.core.kernel import INTERPRETED
from adaptrack.core.maths.values import FUNCTION_NAMES
from adaptrack.core.synthesis import laws
from adaptrack.core.synthesis.rows import row_of
from adaptrack.drive.batch import Batch
from adaptrack.road import plan_speed, road_through
from by_kernels import CASES, prepared
from processors import board
from processors.image import BEGIN, COPY, DRIVE, ELEMENTARY, GAINS, MAKE, STEP, TELL, Image, bits, run
from programs import find_program
from test_export_c import POINTS, calls

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(library.WAY != "library", reason="compares libraries")]
HERE = Path(__file__).parent / "processors"
EMULATED = {
    "aarch64": ("aarch64-linux-gnu-gcc", "qemu-aarch64"),
    "riscv64": ("riscv64-linux-gnu-gcc", "qemu-riscv64"),
    "windows-x86-64-v3": ("x86_64-w64-mingw32-gcc", "wine64"),
}
STEPS, AHEAD = 3000, 60


def built(name):
    try:
        entry = library.manifest()["libraries"].get(name)
        return None if entry is None else library.verified_file(entry)
    except library.UNUSABLE:
        return None


def own():
    path = built(library.processor())
    if path is None:
        pytest.skip("the kernels have not been compiled")
    return ctypes.CDLL(str(path))


def test_a_library_leaves_nothing_undefined():
    found = {name: built(name) for name in library.manifest()["libraries"]}
    assert library.processor() in found
    assert {name: undefined(path.read_bytes()) for name, path in found.items()} == {name: [] for name in found}


def test_what_a_library_of_the_system_leaves_undefined_is_found():
    import _ctypes  # one that calls others

    path = getattr(_ctypes, "__file__", None)
    if path is None:
        pytest.skip("no extension module to look at")
    assert "memcpy" in undefined(Path(path).read_bytes()) or "malloc" in undefined(Path(path).read_bytes())
    with pytest.raises(ValueError, match="neither ELF nor WebAssembly, COFF, PE or Mach-O"):
        undefined(b"something else")


def test_a_kernel_that_calls_what_the_library_lacks_is_refused_in_words():
    text = """
        target datalayout = "e"
        target triple = "any"
        declare double @cbrt(double)
        declare double @adaptrack_soft_fma(double, double, double)
        declare double @adaptrack_soft_floor(double)
        declare double @adaptrack_soft_ceil(double)
        define double @adaptrack_root(double %x) {
            %y = call double @cbrt(double %x)
            ret double %y
        }
    """
    pytest.importorskip("llvmlite", reason="what builds the library")
    from adaptrack.core.build import emission
    from adaptrack.core.build.library import finished

    for name in emission.COMPILE_TARGETS:
        content = emission.emit(text, name)
        with pytest.raises(emission.BuildError, match=f"the kernels for {name} call .*cbrt"):
            finished(name, [content])


# -- what is called ---------------------------------------------------------------------------------------------------
def elementary(rng):
    """All elementary functions on every combination of special arguments, and on many others."""
    special = np.array([0.0, 5e-324, 2.2e-308, 0.5, 1.0, 1.5, 3.0, 710.0, 1e5, 2.0**53, 1.7e308, np.inf, np.nan])
    special = np.concatenate([special, -special])
    grid = np.array(np.meshgrid(special, special, special)).reshape(3, -1)
    count = 20000
    some = rng.integers(-(2**63), 2**63, (3, count)).view(np.float64)
    usual = rng.uniform(-4.0, 4.0, (3, count))
    wide = rng.choice([-1.0, 1.0], (3, count)) * 10.0 ** rng.uniform(-20.0, 20.0, (3, count))
    arguments = np.ascontiguousarray(np.concatenate([grid, some, usual, wide], axis=1))
    # the branch-free ones promise nothing beyond 1e5, but the same bits
    image, values = Image(), np.zeros(arguments.shape[1])
    given, found = image.put(arguments), image.put(values)
    for number in range(len(FUNCTION_NAMES)):
        image.do(ELEMENTARY, number, given, values.size, found)
        image.do(TELL, found, values.size)
    return image


def mpc_steps(rng):
    """Steps of an MPC that estimates, its sensors noisy and at times broken."""
    mpc = at.MPC(at.load_vehicle("paper"), profile="road")
    mpc.step(np.zeros(4), 15.0, np.zeros(AHEAD))
    mpc.reset()
    now, reference, image = np.array([0.0, AHEAD]), np.zeros(AHEAD), Image()
    given = image.record(MPCStep(mpc._mpc, mpc.functions, now, reference, mpc._requested))
    speed_now, ahead = image.put(now), image.put(reference)
    measured, answer = image.put(mpc._mpc.measured), image.put(mpc._mpc.answer)
    inputs = np.zeros((STEPS, 1 + mpc._mpc.measured.size + AHEAD))
    for k in range(STEPS):
        state = np.array([0.3 * np.sin(k / 37), 0.1 * np.cos(k / 60), 0.1 * np.sin(k / 23), 2.0 * np.sin(k / 60)])
        state += rng.normal(size=4) * [0.05, 0.003, 0.01, 0.05]
        state[rng.uniform(size=4) < 0.02] = rng.choice([np.nan, 1e300, -np.inf])
        speed = rng.uniform(-1.0, 2.0) if 700 < k < 900 else 15.0 + 8.0 * np.sin(k / 300)
        shown = 2.0 * np.sin((k + np.arange(AHEAD)) / 60) + (3.0 if k % 500 > 400 else 0.0)
        mpc.step(state, speed, shown)
        inputs[k] = [speed, *mpc._mpc.measured, *shown]
    first, width = image.put(inputs), inputs.shape[1]
    for k in range(STEPS):
        here = first + k * width
        image.do(COPY, here, speed_now, 1)
        image.do(COPY, here + 1, measured, mpc._mpc.measured.size)
        image.do(COPY, here + 1 + mpc._mpc.measured.size, ahead, AHEAD)
        image.do(STEP, given)
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
    settings = batch.mpc_settings(np.inf, np.inf, residuals=True)
    run_ = batch.arena(1, steps, settings, 0, periods)
    run_.given.scenario[:], run_.given.seeds[:] = 0, 7
    run_.vehicles.start[:], run_.tuning[:] = batch.starts[0], batch.tuning
    place = image.record(run_)
    span = image.put(np.array([periods, 1, 0, bits(0.0)], np.int64))
    image.do(BEGIN, 1, place)
    image.do(DRIVE, span, place)
    for part in (run_.result, *run_.trace):
        image.do(TELL, image.put(part), part.nbytes // 8)
    return run_


def synthesis(rng):
    """The numbers of MPCs and of an LQR, made of cars and beliefs."""
    image = Image()
    for name, case in itertools.product(("paper", "midsize-sedan", "van"), CASES):
        order, parts, constants = prepared(at.load_vehicle(name), CASES[case])
        rows, found = [image.put(np.array([each])) for each in (order, parts)], image.record(constants)
        image.do(MAKE, *rows, found)
        for values in constants:
            image.do(TELL, image.put(values), values.nbytes // 8)
    car = at.load_vehicle("van")
    common = row_of(laws.Common, period=0.05, move_min=-0.1, move_max=0.1, angle_min=-0.5, angle_max=0.5)
    tuning, gains = np.array([1.0, 100.0, 1000.0, 0.0]), np.zeros(laws.LQR_NUMBERS)
    given = [image.put(values) for values in (np.array([car.numbers]), np.array([common]), tuning, gains)]
    image.do(GAINS, *given)
    image.do(TELL, given[-1], gains.size)
    return image


IMAGES = {"elementary": elementary, "mpc": mpc_steps, "drives": drives, "synthesis": synthesis}


@pytest.fixture(scope="module")
def images():
    if INTERPRETED:
        pytest.skip("needs compiled kernels")
    made = {name: make(np.random.default_rng(5)) for name, make in IMAGES.items()}
    here = own()
    return {name: (image, run(image, here)) for name, image in made.items()}


def same(found, expected):
    """How many words differ; a NaN is like any other."""
    assert found.size == expected.size
    both = np.isnan(found.view(np.float64)) & np.isnan(expected.view(np.float64))
    return int(np.sum((found != expected) & ~both))


# -- who calls it -----------------------------------------------------------------------------------------------------
def by_emulator(name, image, folder):
    compiler, emulator = EMULATED[name]
    compiler_path, emulator_path = find_program(compiler), find_program(emulator)
    names = image.functions
    (folder / "functions.h").write_text(
        "".join(f"extern void adaptrack_{each}(void);\n" for each in names)
        + f"static void (*FUNCTIONS[])(void) = {{{', '.join(f'adaptrack_{each}' for each in names) or '0'}}};\n"
    )
    library_of_it = shutil.copy(built(name), folder / ("kernels.dll" if emulator == "wine64" else "kernels.so"))
    driver = str(folder / "driver.exe")
    inputs = str(HERE / "driver.c"), library_of_it
    subprocess.run([compiler_path, "-O1", f"-I{folder}", *inputs, "-o", driver], check=True)
    home = [] if emulator == "wine64" else ["-L", f"/usr/{compiler.removesuffix('-gcc')}"]
    return [emulator_path, *home, driver, str(folder / "image"), str(folder / "answers")]


def by_node(name, image, folder):
    files = HERE / "driver.mjs", built(name), folder / "image", folder / "answers"
    return [find_program("node"), *map(str, files), *image.functions]


@pytest.mark.slow
@pytest.mark.parametrize("what", IMAGES)
@pytest.mark.parametrize("name", [*EMULATED, "wasm32"])
def test_another_processor_gives_the_same_bits(name, what, images, tmp_path):
    if built(name) is None:
        pytest.skip(f"not compiled: {library.BUILD} {name}")
    image, expected = images[what]
    image.words().tofile(tmp_path / "image")
    command = (by_node if name == "wasm32" else by_emulator)(name, image, tmp_path)
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert same(np.fromfile(tmp_path / "answers", np.int64), expected) == 0


@pytest.mark.slow
@pytest.mark.parametrize("what", IMAGES)
@pytest.mark.parametrize("name", ["x86-64", "x86-64-v3"])
def test_an_older_processor_of_this_kind_gives_the_same_bits(name, what, images):
    if library.processor() <= name:  # the names of a kind are in the order of their age
        pytest.skip(f"needs a younger processor; this is {library.processor()}")
    if built(name) is None:
        pytest.skip(f"not compiled: {library.BUILD} {name}")
    image, expected = images[what]
    assert same(run(image, ctypes.CDLL(str(built(name)))), expected) == 0


# -- microcontrollers -------------------------------------------------------------------------------------------------
CAR = at.load_vehicle("midsize-sedan")
SMALL = {
    "informed": lambda: at.MPC(CAR, profile="road", learning=None),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "published": lambda: at.published_mpc(CAR),
}


def program(name, count, folder, target=None):
    way = road_through(POINTS), plan_speed(road_through(POINTS), CAR)
    return board.Program(SMALL[name](), list(calls(np.random.default_rng(2), count, way[0])), way, folder, target)


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("target", board.BOARDS)
def test_a_microcontroller_gives_the_same_bits_in_its_memory(target, name, tmp_path):
    if why := board.missing(target):
        pytest.skip(why)
    ran = program(name, 600 if target == "cortex-m7" else 30, tmp_path, target).on(target)
    assert ran.differ == 0
    assert ran.code < 400_000
    assert ran.constants < 64_000
    assert ran.memory < (80_000 if name == "learning" else 64_000)
    assert ran.stack < 16_000


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_what_is_exported_gives_the_same_bits_on_windows(name, tmp_path):
    target = "windows-x86-64-v3"
    compiler, emulator = EMULATED[target]
    if why := board.missing(target, (compiler, emulator, "gcc")):
        pytest.skip(why)
    made = program(name, 2000, tmp_path, target)
    assert board.differing(made.here(), made.here(target, compiler, [find_program(emulator)])) == 0


@pytest.mark.slow
@pytest.mark.parametrize("what", ["elementary", "mpc"])
def test_what_is_exported_for_webassembly_gives_the_same_bits(what, images, tmp_path):
    if why := board.missing("wasm32", ("node",)):
        pytest.skip(why)
    linker = pytest.importorskip("adaptrack.core.build.wasm_link", exc_type=ImportError)
    (tmp_path / "kernels.wasm").write_bytes(linker.linked(library.export_of("wasm32").read_bytes()))
    image, expected = images[what]
    image.words().tofile(tmp_path / "image")
    subprocess.run(["node", str(HERE / "driver.mjs"), str(tmp_path / "kernels.wasm"), str(tmp_path / "image"),
                    str(tmp_path / "answers"), *image.functions], check=True)  # fmt: skip
    assert same(np.fromfile(tmp_path / "answers", np.int64), expected) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL)
def test_no_call_uses_memory_that_was_not_written(name, tmp_path):
    # the oldest processor: valgrind does not know all instructions of the others
    if why := board.missing("x86-64", ("valgrind", "gcc")):
        pytest.skip(why)
    made = program(name, 300, tmp_path, "x86-64")
    found = made.here("x86-64", under=["valgrind", "--quiet", "--error-exitcode=9"])
    assert board.differing(made.here(), found) == 0


@pytest.mark.slow
def test_an_image_of_a_drive_is_that_drive():
    batch = Batch(at.SingleTrack(at.load_vehicle("paper")), at.MPC(at.load_vehicle("paper")),
                  [at.load_scenario("double-lane-change")], "road")  # fmt: skip
    image = Image()
    add_drive(image, batch)
    found = run(image, own())
    zero, seeds = np.zeros(1, np.int64), np.full(1, 7, np.int64)
    expected = batch.run(zero, batch.tuning[None], seeds, 1, traced=True)
    told = np.concatenate([np.frombuffer(each.tobytes(), np.int64) for each in (expected.result, *expected.trace)])
    assert same(found, told) == 0
    assert struct.unpack("<d", found[:1].tobytes())[0] > 0.0
