"""What is exported drives as it does in Python, to the bit, and no call of a C program spoils it."""

import copy
import ctypes
import functools
import math
import os
import re
import shlex
import struct
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from tools.fuzz.constants import CONTROLLERS as FUZZED
from tools.fuzz.constants import NOT_READ, Library, search_constants, unnoticed
from typer.testing import CliRunner

import adaptrack as at
import exported
from adaptrack.cli.app import app
from adaptrack.core.build import compile
from adaptrack.core.kernel import INTERPRETED
from adaptrack.core.roads.road import LINE_NUMBERS
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.memory import FILE_HEAD
from adaptrack.export.recorded_drive import record_drive
from adaptrack.export.tracking import Twin, tracking_memory
from adaptrack.road import Comfort
from adaptrack.road.speed import constant_speed
from exported import CPath, CTracker, Exported
from programs import EMULATORS, find_program, run_program
from references.daqp import Daqp
from small_controllers import Scripted
from tracker_calls import calls, in_python

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
HERE = Path(__file__).parents[1]
CAR = at.load_vehicle("midsize-sedan")
ALONG = np.arange(0.0, 300.0, 5.0)
POINTS = np.stack([ALONG, 12.0 * (1.0 - np.cos(ALONG / 45.0))], axis=-1)
CONTROLLERS = {
    "informed": lambda: at.MPC(CAR, profile="road"), "production": lambda: at.MPC(CAR, profile="production"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "as-written": lambda: at.published_mpc(CAR), "as-released": lambda: at.get_controller("as-released", CAR),
    "nn": lambda: at.published_mpc(CAR, scheduler=at.load_scheduler("road-nn")),
    "anfis": lambda: at.published_mpc(CAR, scheduler=at.load_scheduler("road-anfis")), "lqr": lambda: at.LQR(CAR),
    "stanley": lambda: at.Stanley(CAR), "pure-pursuit": lambda: at.PurePursuit(CAR),
}  # fmt: skip

SHARED = "informed", "learning", "production"
"""Controllers whose exports have the same sources."""
EACH = int(os.environ.get("ADAPTRACK_TEST_STEPS", "3000"))
"""Calls of each controller in the long comparisons."""


def test_a_car_that_leaves_the_road_at_the_planned_speed_is_recorded_more_slowly():
    car = CAR.replace(steering=at.Steering(dead_time=0.3))
    controller = at.MPC(car, profile="road", learning=at.Learning())
    road, world = at.generate_road("country"), at.load_profile("road")
    planned, steady = at.plan_speed(road, car), constant_speed(road, 14.0)
    record = record_drive(controller, at.DualTrack(car), road, planned, world)
    assert record.failed == ""
    assert record.plan.speed[:-2].max() < controller.learner.first_top_speed
    # a speed that the user has chosen is kept, and its failure is said
    assert "left the road" in record_drive(controller, at.DualTrack(car), road, steady, world).failed


@pytest.fixture(scope="module")
def way():
    """A path and a plan of the speed along it."""
    path = at.road_through(POINTS)
    return path, at.plan_speed(path, CAR, Comfort(lateral=2.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("export")


@pytest.fixture(scope="module")
def library_of(folder, way):
    """Exports by name, as libraries of this process; each is made once."""
    libraries = {}

    def make(name, **options):
        key = name, *options.items()
        if key not in libraries:
            place = folder / f"{len(libraries)}-{name}"
            controller = CONTROLLERS[name]()
            at.export_c(controller, place, road=way[0], plan=way[1], **options)
            libraries[key] = Exported(place, controller, "-Og" if name in SHARED else "-O0")
        return libraries[key]

    return make


def start_tracker(library, way):
    tracker, path = CTracker(library), library.path(POINTS)
    assert (tracker.error, path.error) == (exported.OK, exported.OK)
    assert tracker.follow(path, way[1]) == exported.OK
    return tracker


def differing(tracker, answer_of, samples):
    """How many answers of C and of Python differ, any NaN being one; calls without a time are C's alone."""
    count = 0
    for sample in samples:
        error, answer = tracker.step(sample)
        assert error == exported.OK
        assert math.isfinite(answer.command)
        if not math.isfinite(sample[1]) and not math.isfinite(sample[0]):
            assert answer.status == 9
            continue
        expected = answer_of(sample)[:5]
        row = (answer.command, float(answer.status), answer.offset, answer.heading_error, answer.station)
        count += any(struct.pack("d", a) != struct.pack("d", b) and (a == a or b == b)
                     for a, b in zip(row, expected, strict=True))  # fmt: skip
    return count


def count_differences(library_of, way, name, steps, seed=0):
    library = library_of(name)
    tracker, rng = start_tracker(library, way), np.random.default_rng(seed)
    if library.controller.scheduler is None:
        twin = at.Tracker(copy.deepcopy(library.controller), way[0], plan=way[1])
        differences = differing(tracker, lambda sample: in_python(twin, sample), calls(rng, steps, way[0]))
    else:
        twin = Twin(library.controller, *way)
        differences = differing(tracker, lambda sample: twin.call(sample)[:5], calls(rng, steps, way[0]))
    assert tracker.untouched
    return differences


@pytest.mark.parametrize("name", ["informed", "learning", "nn", "stanley"])
def test_every_step_is_that_of_python(name, library_of, way, caplog):
    assert count_differences(library_of, way, name, 400) == 0


@pytest.mark.parametrize("name", ["informed", "learning", "stanley"])
def test_the_predicted_path_is_that_of_python_and_of_a_restored_tracker_to_the_bit(name, library_of, way):
    library, rng, lengths = library_of(name), np.random.default_rng(3), []
    tracker, twin = start_tracker(library, way), at.Tracker(copy.deepcopy(library.controller), way[0], plan=way[1])
    for sample in calls(rng, 400, way[0]):
        tracker.step(sample)
        if math.isfinite(sample[0]) or math.isfinite(sample[1]):
            in_python(twin, sample)
        error, points, first = tracker.predicted_path()
        lengths.append(len(points))
        assert error == exported.OK
        if lengths[-1]:
            assert points.tobytes() == twin.predicted_path().tobytes()
            assert first == twin.controller.predicted_output()[0][0]
        elif name != "stanley":
            assert twin.predicted_path().shape == (0, 2)
    if name == "stanley":
        assert set(lengths) == {0}
        return
    assert set(lengths) == {0, library.controller.tuning.Np}
    assert lengths.count(0) < 40
    other = start_tracker(library, way)
    assert other.restore(tracker.save()) == exported.OK
    assert other.predicted_path()[1].tobytes() == points.tobytes()


def test_a_path_is_predicted_from_the_first_instant_on_it_and_where_there_is_room(library_of, way):
    library = library_of("informed")
    horizon = library.controller.tuning.Np
    tracker = CTracker(library)
    assert tracker.predicted_path()[0] == exported.OUT_OF_ORDER
    tracker = start_tracker(library, way)
    assert len(tracker.predicted_path()[1]) == 0
    tracker.step([0.0, 0.0, 1.0, 0.0, 0.0, 10.0, 0.0])
    assert tracker.predicted_path(horizon - 1)[:2] == (exported.TOO_SMALL, horizon)
    assert len(tracker.predicted_path(horizon)[1]) == horizon
    begins = (
        lambda: tracker.follow(library.path(POINTS + 1.0)),
        lambda: tracker.load(another_tuning(way, library, R=0.1)),
        tracker.engage,
    )
    for k, begin_anew in enumerate(begins, 1):
        tracker.step([0.05 * k, 0.05 * k, 1.0 + 0.5 * k, 0.0, 0.0, 10.0, 0.0])
        assert np.isfinite(tracker.predicted_path()[1]).sum() == 2 * horizon
        assert begin_anew() == exported.OK
        assert len(tracker.predicted_path()[1]) == 0


# -- constants and state ----------------------------------------------------------------------------------------------
def same_answers(first, other, samples):
    return all(bytes(first.step(sample)[1]) == bytes(other.step(sample)[1]) for sample in samples)


def test_a_restored_tracker_goes_on_as_the_saved_one(library_of, way):
    library = library_of("learning")
    first, other, rng = start_tracker(library, way), start_tracker(library, way), np.random.default_rng(2)
    for sample in calls(rng, 150, way[0]):
        first.step(sample)
    state = first.save()
    samples = list(calls(rng, 150, way[0]))
    assert other.restore(state) == exported.OK
    assert same_answers(first, other, samples)


def test_a_state_is_refused_under_other_constants_or_another_path(library_of, way):
    library = library_of("informed")
    state, tracker = start_tracker(library, way).save(), CTracker(library)
    before = tracker.raw.copy()
    assert tracker.restore(state) == exported.OTHER_PATH
    assert tracker.follow(library.path(POINTS + 1.0), way[1]) == exported.OK
    assert tracker.restore(state) == exported.OTHER_PATH
    retuned = start_tracker(library, way)
    assert retuned.load(another_tuning(way, library, R=2.0 * library.controller.tuning.R)) == exported.OK
    assert retuned.restore(state) == exported.OTHER_CONSTANTS
    assert start_tracker(library_of("lqr"), way).restore(state) == exported.OTHER_CONSTANTS
    assert (before[:64] == tracker.raw[:64]).all()


def another_tuning(way, library, **tuning):
    """The constants of the same controller, tuned otherwise."""
    return tracking_memory(library.controller.with_tuning(tuning)).content


def test_another_tuning_acts_from_the_next_instant_without_a_bump(library_of, way):
    library = library_of("informed")
    tracker, other = start_tracker(library, way), start_tracker(library, way)
    samples = [[0.05 * k, 0.05 * k, 0.6 * k, 0.3, 0.0, 12.0, 0.0, 0.0, math.nan, math.nan] for k in range(60)]
    for sample in samples[:30]:
        tracker.step(sample)
        other.step(sample)
    last = tracker.step(samples[30])[1].command
    other.step(samples[30])
    assert tracker.load(another_tuning(way, library, R=100.0 * library.controller.tuning.R)) == exported.OK
    changed = [tracker.step(sample)[1] for sample in samples[31:]]
    expected = [other.step(sample)[1] for sample in samples[31:]]
    assert abs(changed[0].command - last) <= library.controller.limits.move[1] + 1e-12
    assert [answer.status for answer in changed] == [answer.status for answer in expected]
    assert any(a.command != b.command for a, b in zip(changed, expected, strict=True))


def is_allowed(number, value):
    """Whether a constant may have a value, by its rule."""
    rule, least, most, _ = number.bounds
    return (
        rule == "ANY" or (rule == "NUMBER" and not math.isnan(value)) or (rule == "BETWEEN" and least <= value <= most)
    )


@pytest.mark.parametrize(("name", "every"), [("informed", 1), ("learning", 1), ("nn", 4), ("lqr", 1)])
def test_numbers_out_of_bounds_are_refused_under_a_right_checksum(name, every, library_of, way):
    export = library_of(name)
    memory, driving, fresh = tracking_memory(export.controller), start_tracker(export, way), CTracker(export)
    before, first = driving.raw.copy(), FILE_HEAD.size // 8
    numbers = [number for part in memory.numbers.values() for number in part]
    for word, number in list(enumerate(numbers[:300], first))[::every]:
        for value in (math.nan, 1e300, -1e300, 5e-324):
            if is_allowed(number, value):
                continue
            content = exported.with_word(export.constants, word, value)
            if content != export.constants:
                assert driving.load(content) == fresh.init(content) == exported.DAMAGED, number
    assert (driving.raw == before).all()


def test_a_tracker_begins_with_the_numbers_of_python(library_of):
    for name in ("informed", "learning", "nn", "stanley"):
        export = library_of(name)
        memory, tracker = tracking_memory(export.controller), CTracker(export)
        state = np.frombuffer(tracker.save(), np.uint64)[FILE_HEAD.size // 8 :]
        for first, member in memory.placed_state():
            if member.name != "tracker.sample":  # the next call writes it
                words, expected = state[first : first + member.words.size], member.words
                is_nan = np.isnan(words.view(float)) & np.isnan(expected.view(float))
                assert ((words == expected) | is_nan).all(), member.name


@pytest.fixture(scope="module")
def fuzzed(folder):
    """Exports as the tool for constants drives them, by name; each is export once."""
    return functools.cache(lambda name: Library(FUZZED[name](), folder / f"fuzzed-{name}", exported.compile_export))


def test_constants_changed_at_random_under_a_right_checksum_neither_crash_nor_hang(fuzzed):
    assert set(search_constants(fuzzed("informed"), 100, seed=1)) == {"driven", "refused"}


@pytest.mark.parametrize(("name", "every"), [
    ("informed", 5), ("stanley", 1),
    pytest.param("informed", 1, marks=pytest.mark.slow), pytest.param("learning", 1, marks=pytest.mark.slow),
])  # fmt: skip
def test_the_recorded_minute_notices_eight_of_ten_constants_that_are_read(name, every, fuzzed):
    count, misses = unnoticed(fuzzed(name), every)
    read = count - list(misses.values()).count(NOT_READ)
    assert count - len(misses) >= 0.8 * read, misses


# -- calls that are wrong ---------------------------------------------------------------------------------------------
def test_calls_out_of_order_are_refused(library_of, way):
    library = library_of("informed")
    tracker = CTracker(library)
    error, answer = tracker.step([0.0, 0.0, 0.0, 0.0, 0.0, 10.0, 0.0])
    assert (error, answer.status) == (exported.OUT_OF_ORDER, -1)
    assert math.isnan(answer.command)
    nothing = CPath(library.c, POINTS[:3])
    assert nothing.error == exported.BAD_PATH
    assert tracker.follow(nothing) == exported.BAD_PATH
    tracker.raw[:] = 0
    assert tracker.engage() == exported.NOT_READY
    assert tracker.step([0.0] * 7)[0] == exported.NOT_READY
    assert library.c.adaptrack_step(None, None, None) == exported.BAD_ARGUMENT
    assert library.c.adaptrack_init(None, ctypes.c_size_t(0), None, ctypes.c_size_t(0)) == exported.BAD_ARGUMENT
    assert library.c.adaptrack_state_size(None) == 0


def test_a_tracker_that_is_in_a_call_refuses_another(library_of, way):
    tracker = start_tracker(library_of("informed"), way)
    tracker.raw[tracker.MARGIN + 1] |= 1  # as a call that is under way leaves it
    assert tracker.step([0.0] * 7)[0] == exported.BUSY
    assert tracker.load(tracker.constants) == exported.BUSY
    assert tracker.engage() == exported.BUSY


def test_two_threads_on_one_tracker_get_a_command_or_a_refusal(library_of, way):
    tracker, answers = start_tracker(library_of("informed"), way), []

    def call_often():
        for k in range(1000):
            error, answer = tracker.step([0.05 * k, 0.05 * k, 0.6 * k, 0.1, 0.0, 12.0, 0.0, 0.0, math.nan, math.nan])
            answers.append((error, math.isfinite(answer.command)))

    threads = [threading.Thread(target=call_often) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(answers) <= {(exported.OK, True), (exported.BUSY, False)}
    assert tracker.untouched


@pytest.mark.parametrize("flaw", ["few", "nan", "inf", "kink", "far"])
def test_points_that_make_no_path_are_refused_by_number(flaw, library_of):
    library, points, where = library_of("informed"), POINTS.copy(), 7
    if flaw == "few":
        points, where = points[:3], 3
    elif flaw == "kink":
        points, where = np.array([[3.0 - abs(k), 0.0] for k in range(-3, 4)]), 3
    else:
        points[7, 0] = {"nan": math.nan, "inf": math.inf, "far": 1e9}[flaw]
    path = CPath(library.c, points, surplus=100_000)
    assert path.error == exported.BAD_PATH
    assert path.flaw.value == where


def test_a_plan_that_is_none_is_refused(library_of, way):
    library = library_of("informed")
    tracker, path = CTracker(library), library.path(POINTS)
    length = way[0].length

    class Given:
        def __init__(self, s, speed):
            self.s, self.speed = np.array(s, float), np.array(speed, float)

    for s, speed in (([0.0, 10.0], [5.0, 5.0]), ([0.0, length], [5.0, math.nan]), ([1.0, length], [5.0, 5.0]),
                     ([0.0, 50.0, 40.0, length], [5.0] * 4), ([0.0, length], [-1.0, 5.0])):  # fmt: skip
        assert tracker.follow(path, Given(s, speed)) == exported.BAD_ARGUMENT
    assert tracker.follow(path, Given([0.0, length], [5.0, 6.0])) == exported.OK


def test_flushed_subnormals_and_other_rounding_are_refused(library_of, way, tmp_path):
    library = library_of("informed")
    source = tmp_path / "modes.c"
    source.write_text(
        "#include <fenv.h>\n#include <xmmintrin.h>\n"
        "int flushed(int on) { _mm_setcsr(on ? _mm_getcsr() | 0x8040 : _mm_getcsr() & ~0x8040u); return 0; }\n"
        "int rounded(int up) { return fesetround(up ? FE_UPWARD : FE_TONEAREST); }\n"
    )
    if os.uname().machine != "x86_64":
        pytest.skip("sets a register of x86-64")
    run_program("gcc", "-shared", "-fPIC", source, "-o", tmp_path / "m.so", "-lm")
    modes, tracker = ctypes.CDLL(str(tmp_path / "m.so")), start_tracker(library, way)
    for mode in (modes.flushed, modes.rounded):
        mode(1)
        codes = tracker.init(library.constants), tracker.step([0.0] * 7)[0]
        mode(0)
        assert codes == (exported.ARITHMETIC, exported.ARITHMETIC)


@pytest.mark.parametrize("option", ["-Ofast", "-ffast-math", "-ffinite-math-only"])
def test_a_file_compiled_without_nan_is_refused_with_the_option_by_name(option, library_of, tmp_path):
    export = library_of("informed")
    for source in (export.folder / "main.c", export.folder / "src" / "adaptrack_memory.c"):
        command = [find_program("gcc"), option, f"-I{export.folder}/include", f"-I{export.folder}/src",
                   f"-I{export.folder}", "-c", str(source), "-o", str(tmp_path / "a.o")]  # fmt: skip
        run = subprocess.run(command, capture_output=True, text=True)
        assert run.returncode != 0
        assert "without -Ofast, -ffast-math or -ffinite-math-only" in run.stderr


# -- the folder -------------------------------------------------------------------------------------------------------
def test_the_library_asks_for_memory_functions_alone_and_writes_nothing_static(library_of):
    library = library_of("learning")
    symbols = {line.split()[-1] for line in run_program("nm", "-u", library.folder / "tracker.so").splitlines()}
    symbols = {symbol.split("@")[0] for symbol in symbols if not symbol.startswith(("__cxa", "_ITM", "__gmon"))}
    assert symbols <= {"memcpy", "memmove", "memset"}  # which compilers call by themselves
    for part in exported.compile_export(library.folder, library.level):
        sizes = run_program("size", "-A", part).splitlines()
        assert all(line.split()[1] == "0" for line in sizes if line.startswith((".data ", ".bss ")))


def test_the_recorded_drive_of_the_folder_does_not_differ(library_of):
    assert " 0 differ" in library_of("informed").make("check")


COMPILERS = {
    "gcc with fma": ("gcc", "-O3", "-mfma"), "gcc without fma": ("gcc", "-O2", ""),
    "gcc for size": ("gcc", "-Os", "-mfma"), "clang with fma": ("zig", "-O2", "-march=x86_64_v3"),
    "clang without fma": ("zig", "-O2", "-march=x86_64"),
    "clang in plain C99": ("zig", "-O2", "-march=x86_64_v3 -DADAPTRACK_PLAIN_C"),
}  # fmt: skip
"""Compiler, its CFLAGS and PROCESSOR."""


def needs_zig():
    pytest.importorskip("ziglang", reason="needs ziglang: pip install 'adaptrack[compile]'")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["informed", "learning", "nn", "anfis", "lqr", "stanley", "pure-pursuit"])
@pytest.mark.parametrize("compiler", COMPILERS)
def test_every_compiler_gives_the_bits_of_python_without_a_warning(compiler, name, library_of):
    if os.uname().machine != "x86_64":
        pytest.skip("gives options for x86-64")
    program, options, processor = COMPILERS[compiler]
    if program == "zig":
        needs_zig()
    command = shlex.join(compile.compiler()) if program == "zig" else find_program(program)
    words = [f"CC={command}", f"CFLAGS={options} -pedantic -Werror", f"PROCESSOR={processor}"]
    folder = library_of(name).folder
    run_program("make", "-C", folder, "clean")
    assert " 0 differ" in run_program("make", "-j2", "-C", folder, "check", *words)


def test_cpp_drives_without_exceptions_or_allocation(library_of, tmp_path):
    text = (
        '#include "adaptrack.hpp"\n'
        "static adaptrack::Tracker tracker;\nstatic adaptrack::Path<20000> path;\n"
        "int main() {\n    double points[40];\n"
        "    for (int i = 0; i < 20; i++) { points[2 * i] = 5.0 * i; points[2 * i + 1] = 0.0; }\n"
        "    adaptrack::Sample sample; adaptrack::Answer answer{};\n"
        "    sample.t = 0.0; sample.x = 1.0; sample.y = 0.2; sample.yaw = 0.0; sample.speed = 10.0;\n"
        "    if (tracker.ready() || path.through(points, 20) || tracker.follow(path) || tracker.step(sample, answer))\n"
        "        return 1;\n    if (answer.status != ADAPTRACK_STATUS_OK || answer.command >= 0.0) return 2;\n"
        "    double way[2 * ADAPTRACK_HORIZON], first = 0.0;\n    std::size_t count = 0;\n"
        "    if (tracker.predicted_path(way, ADAPTRACK_HORIZON, count, first)) return 3;\n"
        "    return count == ADAPTRACK_HORIZON && first > ADAPTRACK_PERIOD && way[0] > 1.0 + 9.9 * first ? 0 : 4;\n}\n"
    )
    exported.run_cpp(library_of("informed"), text, tmp_path)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: Scripted(lambda t: 0.0), "controller 'scripted' is none that is compiled ahead"),
    (lambda: at.PreviewLQR(CAR), "is none that is compiled ahead"),
    (lambda: at.MPC(CAR, solver=Daqp()), "QP solver 'daqp' .* is Python's"),
    (lambda: at.published_mpc(CAR, scheduler=lambda variables: at.Tuning()), "scheduler .* is Python"),
])  # fmt: skip
def test_what_is_python_is_refused_by_name_and_nothing_is_written(make, message, tmp_path):
    with pytest.raises(at.InvalidInput, match=message):
        at.export_c(make(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_a_controller_has_learned_travels(library_of):
    mpc = CONTROLLERS["learning"]()
    before = tracking_memory(mpc)
    for k in range(200):
        mpc.step([0.0, 0.0, 0.02 * math.sin(k / 9), 0.1 * math.sin(k / 20)], 15.0, np.zeros(1))
    after = tracking_memory(mpc)
    assert after.layout == before.layout
    assert after.content != before.content
    tracker = CTracker(library_of("learning"))
    learned = mpc.learner.restart_memory(mpc._mpc.informed.learned[0]).tobytes()
    assert learned not in tracker.save()
    assert tracker.load(after.content) == exported.OK
    assert learned in tracker.save()


def test_the_command_writes_the_folder_and_says_how_to_prove_it(tmp_path):
    words = ["export", "c", "--vehicle", "midsize-sedan", "--controller", "stanley", "--road", "town", "--out",
             str(tmp_path / "out")]  # fmt: skip
    process = CliRunner().invoke(app, words)
    assert process.exit_code == 0, process.output
    assert f"make -C {tmp_path / 'out'} check" in process.output
    names = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")}
    assert {"include/adaptrack.h", "include/adaptrack.hpp", "src/adaptrack.c", "main.c", "constants.bin",
            "src/head.h", "src/records.h", "src/tracker.c", "CMakeLists.txt", "README.md"} <= names  # fmt: skip
    assert not {"src/qp.c", "src/estimators.c", "src/plants.c"} & names  # which this controller does not need
    texts = [(tmp_path / "out" / name).read_text() for name in ("README.md", "Makefile", "CMakeLists.txt", "main.c")]
    assert not any(re.search("@[A-Z]+@", text) for text in texts)


def test_a_car_of_which_nobody_says_the_steering_leaves_learning(tmp_path):
    at.vehicle_from_data_sheet("mine", 1450.0, 2.65).to_toml(tmp_path / "car.toml")
    for options, learns in (([], True), (["--controller", "stanley"], False)):
        words = ["export", "c", "--vehicle", str(tmp_path / "car.toml"), "--out", str(tmp_path / "out"), *options]
        process = CliRunner().invoke(app, words)
        assert process.exit_code == 0, process.output
        assert ("Steering model" in process.output and "learns" in process.output) == learns
        assert "Warning" not in process.output  # it learns below the speed at which the steering must be known


# -- other processors -------------------------------------------------------------------------------------------------
EMULATED = EMULATORS | {"wasm32": ("zig", "node", "--no-warnings", str(HERE / "processors" / "wasi.mjs"))}
"""The compiler, and the command that runs its program with two files of a folder."""


def _compile(compiler, sources, place):
    """The program of C sources for another processor."""
    zig = [*compile.compiler(), "-target", "wasm32-wasi", "-msimd128"]
    called = zig if compiler == "zig" else [compiler]
    options = [*called, "-O1", *EXACT_OPTIONS, f"-I{place}/include", f"-I{place}/src"]
    run_program(*options, *sources, "-o", place / "replay")
    written = place / "replay.exe"
    return written.name if written.exists() else "replay"


def _emulator(target):
    """The compiler and the command of a target; a test without them is skipped."""
    compiler, runner, *options = EMULATED[target]
    if compiler == "zig":
        needs_zig()
    else:
        find_program(compiler)
    return compiler, [find_program(runner), *options]


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("target", EMULATED)
def test_another_processor_answers_the_same_bits(target, name, way, folder):
    compiler, emulator = _emulator(target)
    assert _differing_on(name, way, folder / f"{target}-{name}", compiler, emulator) == 0


def _differing_on(name, way, place, compiler, emulator):
    controller, rng = CONTROLLERS[name](), np.random.default_rng(7)
    at.export_c(controller, place, road=way[0], plan=way[1])
    samples = np.array([[*sample[:10], rng.uniform(0.3, 1.0), rng.choice([math.nan, 3.0]), sample[12]]
                        for sample in calls(rng, EACH, way[0])])  # fmt: skip
    head = [len(POINTS), way[1].s.size], POINTS, way[1].s, way[1].speed, samples
    np.concatenate([np.ravel(part) for part in head]).astype(float).tofile(place / "samples")
    sources = [HERE / "processors" / "replay.c", *(place / "src").glob("*.c")]
    program = _compile(compiler, sources, place)
    run_program(*emulator, program, "samples", "answers", cwd=place)
    twin = Twin(controller, *way)
    expected = np.array([twin.call(sample)[:5] for sample in samples])
    answers = np.fromfile(place / "answers").reshape(-1, 5)
    is_equal = (answers.view(np.int64) == expected.view(np.int64)) | (np.isnan(answers) & np.isnan(expected))
    return int(np.sum(~is_equal.all(axis=1)))


def test_a_path_that_is_overwritten_under_the_car_is_said(library_of, way):
    library = library_of("informed")
    tracker, path = CTracker(library), library.path(POINTS)
    tracker.follow(path, way[1])
    assert tracker.step([0.0, 0.0, 1.0, 0.0, 0.0, 10.0, 0.0])[0] == exported.OK
    path.raw[:8] = 0.0
    assert tracker.step([0.05, 0.05, 1.5, 0.0, 0.0, 10.0, 0.0])[0] == exported.BAD_PATH


@pytest.mark.parametrize("noise", [math.nan, 0.0, 0.05])
@pytest.mark.parametrize("closed", [False, True])
def test_a_path_of_noisy_points_is_the_one_of_python_to_the_bit(closed, noise, library_of):
    angle = np.linspace(0.0, 2.0 * math.pi, 150, endpoint=False)
    points = np.stack([40.0 * np.cos(angle), 25.0 * np.sin(angle)], axis=-1)
    points += 0.05 * np.random.default_rng(3).standard_normal(points.shape)
    c = library_of("stanley").c
    road = at.road_through(points, closed=closed, noise=None if math.isnan(noise) else noise)
    made = CPath(c, points, closed, surplus=20_000, noise=noise)  # noise that is not smoothed needs more pieces
    c.adaptrack_path_curvature.restype = c.adaptrack_path_length.restype = ctypes.c_double
    assert made.error == exported.OK
    pieces = road.table.pieces
    first = 8 + len(LINE_NUMBERS)  # words, behind the head
    assert made.raw[first : first + pieces.size].tobytes() == pieces.tobytes()
    assert c.adaptrack_path_length(made.place) == road.length
    cells = math.ceil(road.length / 0.5)
    headings = road.at(np.minimum(np.linspace(0.0, road.length, cells + 1), road.length - 1e-9)).heading
    for s in np.linspace(-1.0, road.length + 1.0, 40):
        cell = min(max(math.floor(s * cells / road.length), 0), cells - 1)
        curvature = (headings[cell + 1] - headings[cell]) * cells / road.length
        assert c.adaptrack_path_curvature(made.place, ctypes.c_double(s)) == pytest.approx(curvature, abs=1e-7)
    assert math.isnan(c.adaptrack_path_curvature(made.place, ctypes.c_double(math.nan)))
    assert math.isnan(c.adaptrack_path_curvature(None, ctypes.c_double(0.0)))


def test_a_memory_that_is_too_small_for_a_path_is_refused(library_of):
    library = library_of("informed")
    assert [CPath(library.c, POINTS, surplus=count).error for count in (-20_000, -30_000)] == [
        exported.TOO_SMALL, exported.TOO_SMALL
    ]  # fmt: skip


def test_a_path_of_more_points_than_the_header_says_is_refused(library_of):
    export = library_of("informed")
    header = (export.folder / "include" / "adaptrack_config.h").read_text()
    assert "#define ADAPTRACK_MOST_POINTS 100000 " in header
    points = np.stack([np.arange(100_001.0), np.zeros(100_001)], axis=-1)
    path = CPath(export.c, points, surplus=1000)
    assert (path.error, path.flaw.value) == (exported.BAD_PATH, 100_001)


def test_another_export_into_a_folder_keeps_the_previous_content_beside_it_and_says_so(tmp_path):
    words = ["export", "c", "--vehicle", "midsize-sedan", "--road", "town", "--out", str(tmp_path), "--controller"]
    assert CliRunner().invoke(app, [*words, "stanley"]).exit_code == 0
    before = (tmp_path / "constants.bin").read_bytes()
    process = CliRunner().invoke(app, [*words, "stanley"])
    assert (process.exit_code, list(tmp_path.rglob("*.bak"))) == (0, [])
    assert "previous content" not in process.output
    process = CliRunner().invoke(app, [*words, "pure-pursuit"])
    assert (tmp_path / "constants.bin.bak").read_bytes() == before
    assert "The previous content is in " in process.output
    assert str(tmp_path / "constants.bin.bak") in process.output.replace("\n", "")


@pytest.mark.needs("gcc")
def test_make_lib_writes_the_archive_that_the_readme_of_the_export_names(library_of):
    folder = library_of("stanley").folder
    run_program("make", "-C", folder, "lib", "CFLAGS=-O0 -Werror")
    (line,) = [line for line in (folder / "README.md").read_text().splitlines() if line.startswith("$ make lib")]
    assert (folder / re.search(r"(\S+\.a):", line)[1]).is_file()
