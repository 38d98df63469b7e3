"""Building the library: whatever goes wrong or on beside it, what is there afterwards is whole."""

import ctypes
import hashlib
import json
import os
import resource
import shutil
import tarfile
import time
from types import SimpleNamespace

import numpy as np
import pytest

from adaptrack.core import library

builder = pytest.importorskip("adaptrack.core.build.library", reason="what builds the library", exc_type=ImportError)
llvm = pytest.importorskip("llvmlite.binding")

from adaptrack.core.build import emission, numba_functions  # noqa: E402
from adaptrack.core.build.exports import EXPORT_TARGETS, archive, emit_export, shipped  # noqa: E402
from adaptrack.core.build.objects import undefined  # noqa: E402
from adaptrack.core.build.rules import violations  # noqa: E402
from adaptrack.core.kernel import EXPORTED, SYMBOL  # noqa: E402
from adaptrack.core.maths.values import FUNCTION_NAMES  # noqa: E402

pytestmark = pytest.mark.compiled


def enter(folder, libraries, sources):
    """Libraries (name -> content) and the manifest of a build of these sources."""
    entries = {}
    for name, content in libraries.items():
        entries[name] = {"file": f"kernels-{name}-{content.decode()}.so", "sha256": hashlib.sha256(content).hexdigest()}
        (folder / entries[name]["file"]).write_bytes(content)
    manifest = {"libraries": entries, "sources": sources, "kernels": {}}
    (folder / library.MANIFEST).write_text(json.dumps(manifest))


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """A folder for the library, and a builder that compiles nothing: its library is "new"."""
    folder = tmp_path / "built"
    folder.mkdir()
    monkeypatch.setattr(library, "BUILT_FOLDER", folder)
    monkeypatch.setattr(builder, "kernels_of", dict)
    monkeypatch.setattr(builder, "modules", lambda kernels, stages: [])
    monkeypatch.setattr(builder, "header", lambda kernels: "")
    monkeypatch.setattr(builder, "_emitted", lambda target, name, paths: (f"{target}-{name}", "o", b"new"))
    return folder


def test_a_library_that_another_build_has_made_meanwhile_is_kept(quick, monkeypatch):
    def meanwhile(kernels, stages):
        enter(quick, {"aarch64": b"theirs"}, library.source_hashes())
        return []

    monkeypatch.setattr(builder, "modules", meanwhile)
    builder.build()
    assert set(builder._built()) == {library.processor(), "aarch64"}


def test_who_has_just_read_the_manifest_before_still_finds_its_library(quick):
    long_ago = time.time() - 2.0 * builder.FOREIGN_LIBRARY_AGE
    enter(quick, {library.processor(): b"before"}, {"kernel.py": "of then"})
    left = quick / "kernels-of-a-build-that-was-killed"
    left.touch()
    for path in quick.iterdir():
        os.utime(path, (long_ago, long_ago))
    read = library.manifest()["libraries"][library.processor()]
    builder.build()
    assert library.verified_file(read).read_bytes() == b"before"
    assert library.verified_file(library.manifest()["libraries"][library.processor()]).read_bytes() == b"new"
    assert not left.exists()


def test_sources_that_are_edited_while_they_are_read_make_no_library(quick, monkeypatch, tmp_path):
    room = tmp_path / "core"
    room.mkdir()
    (room / "kernel.py").write_text("now")
    library.source_hashes()
    monkeypatch.setattr(library, "PACKAGE_FOLDER", tmp_path)
    with pytest.raises(builder.BuildError, match="edited"):
        builder.build()
    assert [path.name for path in quick.iterdir()] == ["lock"]


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path):
    old = tmp_path / library.MANIFEST
    old.write_text("old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            builder._put(old, bytes(5000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert old.read_text() == "old"
    assert list(tmp_path.iterdir()) == [old]


def test_without_a_linker_the_build_says_what_to_install(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(builder.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(builder, "undefined", lambda content: [])
    with pytest.raises(builder.BuildError, match="no linker: install binutils or lld"):
        builder.finished(library.processor(), [b""])


@pytest.mark.parametrize(
    ("system", "machine"),
    [("linux", "x86_64"), ("linux", "aarch64"), ("win32", "AMD64"), ("darwin", "arm64"), ("darwin", "x86_64")],
)
def test_what_is_built_on_a_system_holds_what_its_processor_asks_for(monkeypatch, system, machine):
    monkeypatch.setattr(library, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(library.platform, "machine", lambda: machine)
    assert library.processor() in builder.compatible_processors()
    assert set(builder.compatible_processors()) <= set(builder.COMPILE_TARGETS)


# -- rules ------------------------------------------------------------------------------------------------------------
WHOLE, LEFT, OTHER = "_ZN9adaptrack4core5maths4bits5wholeB3v1", "_ZN9adaptrack4bits4left", "_ZN9adaptrack4core4road3far"
INT = "_ZN5numba7cpython8builtins6ol_intB3v2"


def function(name, line):
    return f"define i32 @{name}(ptr %r, double %x, i64 %n) {{\n  {line}\n  ret i32 0\n}}\n"


@pytest.mark.parametrize(("name", "line", "broken"), [
    (INT, "%1 = fptosi double %x to i64", ""),
    (WHOLE, f"%1 = call i32 @{INT}(ptr %r, double %x)", ""),
    (OTHER, f"%1 = call i32 @{INT}(ptr %r, double %x)", "road.far converts a number"),
    (OTHER, "%1 = fptoui double %x to i64", "road.far converts a number"),
    (LEFT, "%1 = shl i64 1, %n", ""),
    (OTHER, "%1 = shl i64 1, %n", "road.far shifts by a number"),
    (OTHER, "%1 = lshr exact i64 %n, %n", "road.far shifts by a number"),
    (OTHER, "%1 = ashr i64 %n, 52", ""),
])  # fmt: skip
def test_a_kernel_that_converts_or_shifts_without_bounds_is_found(name, line, broken):
    rest_of_module = function(INT, "%1 = fptosi double %x to i64") if name != INT else ""
    places = violations(rest_of_module + function(name, line))
    assert len(places) == bool(broken)
    assert all(broken in place for place in places)


@pytest.fixture
def one_kernel(tmp_path, monkeypatch):
    """A function of the text of a kernel: makes its module and returns its file with the number of compilations."""
    monkeypatch.setattr(library, "BUILT_FOLDER", tmp_path)
    kernels = {"elementary_values": EXPORTED["elementary_values"]}

    def make(text):
        calls = []
        monkeypatch.setattr(numba_functions, "module_of", lambda kernels: calls.append(1) or llvm.parse_assembly(text))
        return builder.modules(kernels, builder._Stages()), len(calls)

    return make


def test_a_build_with_a_kernel_that_breaks_a_rule_is_refused_each_time(one_kernel):
    for _ in range(2):
        with pytest.raises(builder.BuildError, match=r"road\.far shifts"):
            one_kernel(function(OTHER, "%1 = shl i64 1, %n"))


def test_a_file_of_kernels_is_compiled_again_only_when_one_of_its_sources_has_changed(one_kernel, monkeypatch):
    text = function(OTHER, "%1 = ashr i64 %n, 52")
    (first, compiled), (again, compiled_again) = one_kernel(text), one_kernel(text)
    assert (compiled, compiled_again, again) == (1, 0, first)
    hashes = dict(library.source_hashes())
    monkeypatch.setattr(library, "source_hashes", lambda: hashes)
    hashes["core/simulation/run.py"] = "edited"  # none of its sources
    assert one_kernel(text) == (first, 0)
    hashes["core/kernel.py"] = "edited"
    assert one_kernel(text)[1] == 1


def test_kernels_of_two_objects_call_each_other_and_give_the_bits_of_one(tmp_path):
    kernels = builder.kernels_of("adaptrack.core.maths")
    caller = kernels["elementary_values"]
    callees = [kernel for name, kernel in kernels.items() if kernel is not caller]
    objects, paths = [], []
    for group in ([caller], callees):
        path = tmp_path / f"{len(paths)}.bc"
        path.write_bytes(numba_functions.module_of(group).as_bitcode())
        paths.append(path)
        objects.append(emission.emit_files([path], library.processor(), alone=False))
    assert any(symbol.startswith(SYMBOL) for symbol in undefined(objects[0]))
    answers = []
    for parts in (objects, [emission.emit_files(paths, library.processor())]):
        file = tmp_path / f"{len(parts)}.so"
        file.write_bytes(builder.finished(library.processor(), parts)[1])
        call = ctypes.CDLL(str(file)).adaptrack_elementary_values
        call.argtypes, call.restype = caller.signature.prototype._argtypes_, None
        arguments, values = np.linspace(0.01, 0.99, 90).reshape(3, 30), np.zeros((len(FUNCTION_NAMES), 30))
        for i, row in enumerate(values):
            call(i, arguments.ctypes.data, *arguments.shape, row.ctypes.data, row.size)
        answers.append(values)
    assert answers[0].tobytes() == answers[1].tobytes()
    assert (np.isfinite(answers[0]).sum(axis=1) > 0).all()


@pytest.mark.parametrize(
    "content",
    [
        b"", b"\xff\xfe", b"[" * 100_000, b"null", b"[]", b"{}", b'{"sources": []}',
        *(f'{{"sources": {{}}, "{name}": {table}}}'.encode() for name in ("libraries", "exports", "kernels")
          for table in ('{"x": null}', "1", '[["x", 1]]', '{"x": {"file": 1, "sha256": "0"}}')),
        b'{"sources": {}, "kernels": {"x": [[]]}}',
    ],
)  # fmt: skip
def test_a_damaged_manifest_is_refused_by_name(quick, content):
    (quick / library.MANIFEST).write_bytes(content)
    for read in (library.manifest, lambda: library.export_of("x86-64-v3"), library.Library):
        with pytest.raises(ValueError, match=r"manifest\.json is damaged: "):
            read()


# -- what other programs take in --------------------------------------------------------------------------------------
def test_what_is_packed_is_found_in_the_archive_and_a_damaged_file_is_not(quick, tmp_path):
    builder.build(exports=["cortex-m7"])
    packed = archive(tmp_path / "dist")
    again = packed.read_bytes()
    assert archive(tmp_path / "dist").read_bytes() == again
    with tarfile.open(packed) as tar:
        tar.extractall(tmp_path, filter="data")
    folder = tmp_path / packed.name.removesuffix(".tar.gz")
    assert {path.name for path in folder.iterdir()} > {"LICENSE", "manifest.json"}
    file = library.export_of("cortex-m7", folder)
    assert file.read_bytes() == b"new"
    file.write_bytes(b"old")
    with pytest.raises(ValueError, match="damaged"):
        library.export_of("cortex-m7", folder)
    with pytest.raises(LookupError):
        library.export_of("cortex-m0", folder)


def test_a_wheel_holds_objects_for_its_processors_and_for_pages():
    processors = ["x86-64", "x86-64-v3", "x86-64-v4"]
    assert shipped(processors) == ["x86-64", "x86-64-v3", "wasm32", "wasm32-page"]


CALLS = """
target datalayout = "e"
target triple = "any"
declare double @NAME(double)
declare double @adaptrack_soft_fma(double, double, double)
declare double @adaptrack_soft_floor(double)
declare double @adaptrack_soft_ceil(double)
define double @adaptrack_kalman(double %x) {
    %y = call double @NAME(double %x)
    ret double %y
}
"""


@pytest.mark.parametrize("name", EXPORT_TARGETS)
def test_an_object_that_calls_what_a_target_has_not_is_refused(name):
    with pytest.raises(builder.BuildError, match=f"exported for {name} calls .*cbrt"):
        emit_export(CALLS.replace("NAME", "cbrt"), name)
    if name == "cortex-m7":
        assert undefined(emit_export(CALLS.replace("NAME", "__aeabi_l2d"), name)) == ["__aeabi_l2d"]


@pytest.mark.parametrize("name", emission.COMPILE_TARGETS)
def test_a_library_that_calls_what_it_lacks_is_refused(name):
    content = emission.emit(CALLS.replace("NAME", "cbrt"), name)
    with pytest.raises(builder.BuildError, match=f"the kernels for {name} call .*cbrt"):
        builder.finished(name, [content])


def test_every_kernel_that_a_program_may_call_is_there():
    there = builder.kernels_of()
    assert not [
        (name, kernel) for name, export in EXPORT_TARGETS.items() for kernel in export.kernels if kernel not in there
    ]
