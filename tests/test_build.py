"""Building the library: whatever goes wrong or on beside it, what is there afterwards is whole."""

import hashlib
import json
import os
import resource
import shutil
import time
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from adaptrack.core import library

builder = pytest.importorskip("adaptrack.core.build.library", reason="what builds the library", exc_type=ImportError)
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
    pool = SimpleNamespace(starmap=lambda function, given, chunksize: [b"new" for _ in given])
    monkeypatch.setattr(library, "BUILT", folder)
    monkeypatch.setattr(builder, "kernels_of", lambda rooms: {})
    monkeypatch.setattr(builder, "_module", lambda kernels: "")
    monkeypatch.setattr(builder, "header", lambda kernels: "")
    monkeypatch.setattr(builder, "finished", lambda name, content: ("so", content))
    monkeypatch.setattr(
        builder.multiprocessing, "get_context", lambda _: SimpleNamespace(Pool=lambda _: nullcontext(pool))
    )
    return folder


def test_a_library_that_another_build_has_made_meanwhile_is_kept(quick, monkeypatch):
    def meanwhile(kernels):
        enter(quick, {"aarch64": b"theirs"}, library.source_hashes())
        return ""

    monkeypatch.setattr(builder, "_module", meanwhile)
    builder.build()
    assert set(builder._built()) == {library.processor(), "aarch64"}


def test_who_has_just_read_the_manifest_before_still_finds_its_library(quick):
    long_ago = time.time() - 2.0 * builder.AN_HOUR
    enter(quick, {library.processor(): b"before"}, {"kernel.py": "of then"})
    left = quick / "kernels-of-a-build-that-was-killed"
    left.touch()
    for each in quick.iterdir():
        os.utime(each, (long_ago, long_ago))
    read = library.manifest()["libraries"][library.processor()]
    builder.build()
    assert library.whole(read).read_bytes() == b"before"
    assert library.whole(library.manifest()["libraries"][library.processor()]).read_bytes() == b"new"
    assert not left.exists()


def test_sources_that_are_edited_while_they_are_read_make_no_library(quick, monkeypatch, tmp_path):
    room = tmp_path / "core"
    room.mkdir()
    (room / "kernel.py").write_text("now")
    library.source_hashes()
    monkeypatch.setattr(library, "PACKAGE", tmp_path)
    with pytest.raises(builder.BuildError, match="edited"):
        builder.build()
    assert list(quick.iterdir()) == []


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
        builder.finished(library.processor(), b"")


@pytest.mark.parametrize(
    ("system", "machine"),
    [("linux", "x86_64"), ("linux", "aarch64"), ("win32", "AMD64"), ("darwin", "arm64"), ("darwin", "x86_64")],
)
def test_what_is_built_on_a_system_holds_what_its_processor_asks_for(monkeypatch, system, machine):
    monkeypatch.setattr(library, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(library.platform, "machine", lambda: machine)
    assert library.processor() in builder.of_this_kind()
    assert set(builder.of_this_kind()) <= set(builder.TARGETS)
