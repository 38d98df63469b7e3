"""Building the library: whatever goes wrong or on beside it, what is there afterwards is whole."""

import hashlib
import json
import os
import time
from types import SimpleNamespace

import pytest

from adaptrack.core import library
from adaptrack.core.build import c_files, compile, sources
from adaptrack.core.build import library as builder
from adaptrack.core.build.units import CONTROLLERS, PAGE_KERNELS, PLANTS, TRACKERS, UNIT_KERNELS
from adaptrack.core.kernel import INTERPRETED
from adaptrack.core.maths import exact


def enter(folder, libraries, hashes):
    """Libraries (name -> content) and the manifest of a build of these sources."""
    entries = {}
    for name, content in libraries.items():
        entries[name] = {"file": f"kernels-{name}-{content.decode()}.so", "sha256": hashlib.sha256(content).hexdigest()}
        (folder / entries[name]["file"]).write_bytes(content)
    (folder / library.MANIFEST).write_text(json.dumps({"libraries": entries, "sources": hashes, "kernels": {}}))


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """A folder for the library, and a builder that compiles nothing: its library is "new"."""
    folder = tmp_path / "built"
    (folder / "cache").mkdir(parents=True)
    monkeypatch.setattr(library, "BUILT_FOLDER", folder)
    monkeypatch.setattr(
        sources, "kernels_of", lambda: dict.fromkeys(c_files.SOFT_KERNELS, SimpleNamespace(function=enter))
    )
    monkeypatch.setattr("adaptrack.core.build.c_files.c_files", lambda kernels, checks: {})
    monkeypatch.setattr("adaptrack.core.build.header.header", lambda kernels: "")
    monkeypatch.setattr(sources, "sources_of", lambda path: [])
    monkeypatch.setattr(compile, "compile_objects", lambda *arguments: ([], 0))
    monkeypatch.setattr(compile, "link", lambda objects, processor, path, is_stripped: path.write_bytes(b"new"))
    return folder


def contents():
    """The libraries of the manifest, proved to be whole."""
    return {name: library.verified_file(entry).read_bytes() for name, entry in library.manifest()["libraries"].items()}


def test_a_library_that_another_build_has_made_meanwhile_is_kept(quick, monkeypatch):
    def meanwhile(objects, processor, path, is_stripped):
        path.write_bytes(b"new")
        enter(quick, {"aarch64": b"theirs"}, library.source_hashes())

    monkeypatch.setattr(compile, "link", meanwhile)
    builder.build(["x86-64"])
    assert contents() == {"aarch64": b"theirs", "x86-64": b"new"}


def test_who_has_just_read_the_manifest_before_still_finds_its_library(quick):
    enter(quick, {"x86-64": b"before"}, {"kernel.py": "of then"})
    left = quick / "kernels-of-a-build-that-was-killed"
    left.touch()
    long_ago = time.time() - 2.0 * builder.MAX_UNUSED_AGE
    os.utime(left, (long_ago, long_ago))
    read = library.manifest()["libraries"]["x86-64"]
    builder.build(["x86-64"])
    assert library.verified_file(read).read_bytes() == b"before"
    assert contents() == {"x86-64": b"new"}
    assert not left.exists()


def test_sources_that_are_edited_while_they_are_compiled_make_no_library(quick, monkeypatch):
    monkeypatch.setattr(library.source_hashes, "__wrapped__", lambda: {"core/kernel.py": "edited"}, raising=False)
    with pytest.raises(compile.CompileError, match="edited"):
        builder.build(["x86-64"])
    assert not (quick / library.MANIFEST).exists()


@pytest.mark.parametrize("content", [
    b"", b"\xff\xfe", b"[" * 100_000, b"null", b"[]", b"{}", b'{"sources": []}',
    *(f'{{"sources": {{}}, "{name}": {table}}}'.encode() for name in ("libraries", "kernels")
      for table in ('{"x": null}', "1", '[["x", 1]]', '{"x": {"file": 1, "sha256": "0"}}')),
    b'{"sources": {}, "kernels": {"x": [[]]}}',
])  # fmt: skip
def test_a_damaged_manifest_is_refused_by_name(quick, content):
    (quick / library.MANIFEST).write_bytes(content)
    for read in (library.manifest, library.Library):
        with pytest.raises(ValueError, match=r"manifest\.json is damaged: "):
            read()


@pytest.mark.parametrize(("system", "machine"), [("linux", "x86_64"), ("linux", "aarch64")])
def test_what_is_built_on_a_system_holds_what_its_processor_asks_for(monkeypatch, system, machine):
    monkeypatch.setattr(library, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(library.platform, "machine", lambda: machine)
    assert library.processor() in compile.PROCESSORS


@pytest.mark.skipif(INTERPRETED or not library.can_compile(), reason="needs the compiler for C")
@pytest.mark.parametrize("processor", ["riscv64", "windows-x86-64"])
def test_kernels_in_place_of_instructions_link_for_a_processor_that_lacks_them(tmp_path, processor):
    assert processor.endswith(compile.LACKING)
    files = c_files.c_files({name: getattr(exact, name) for name in c_files.SOFT_KERNELS})
    objects, _ = compile.compile_objects(files, processor, tmp_path)
    compile.link(objects, processor, tmp_path / "kernels.dll")
    assert b"adaptrack_soft_floor" in (tmp_path / "kernels.dll").read_bytes()


def test_every_kernel_that_a_program_may_call_is_there():
    called = {
        *PAGE_KERNELS, *CONTROLLERS, *TRACKERS, *PLANTS, *(name for pair in UNIT_KERNELS.values() for name in pair),
    }  # fmt: skip
    assert called <= set(sources.kernels_of())
