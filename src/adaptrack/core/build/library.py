"""Kernels to a library: compiled by numba, linked into one module, emitted for a processor, linked to a shared object.

front end (numba): a module of LLVM's for each kernel and the C function around it
-> one module in which all but the C functions is internal
-> optimised and emitted for each target -> linked, with nothing left undefined
"""

from __future__ import annotations

import hashlib
import importlib
import json
import multiprocessing
import os
import pkgutil
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from .. import library
from ..kernel import EXPORTED
from . import numba_functions
from .header import header

_IMPORT = re.compile(r"^[ \t]*from[ \t]+(\.+)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)

ROOMS = ("adaptrack.core",)
"""Packages whose kernels are compiled."""


@dataclass(frozen=True)
class Target:
    """A processor, as LLVM names it."""

    triple: str
    cpu: str = ""
    features: str = ""


TARGETS = {
    "x86-64": Target("x86_64-unknown-linux-gnu", "x86-64"),
    "x86-64-v3": Target("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "aarch64": Target("aarch64-unknown-linux-gnu"),
    "riscv64": Target("riscv64-unknown-linux-gnu", "generic-rv64", "+m,+a,+f,+d"),
    "wasm32": Target("wasm32-unknown-unknown", "", "+simd128,+bulk-memory"),
}


HEADER = "adaptrack.h"
AN_HOUR = 3600.0
"""s, for which a library is left alone that this build has not made: another build may have."""


class BuildError(RuntimeError):
    """The library cannot be built; the message says what to do."""


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def import_kernels(rooms: Iterable[str]) -> None:
    """Import every module of packages, so that their kernels are known."""
    for room in rooms:
        package = importlib.import_module(room)
        for found in pkgutil.walk_packages(package.__path__, f"{room}."):
            if not found.name.startswith("adaptrack.core.build"):
                importlib.import_module(found.name)


def _module(kernels: dict[str, Any]) -> Any:
    """One module of all kernels and the C functions around them; all but these is internal."""
    whole = numba_functions.linked(kernels.values())
    names = {f"adaptrack_{name}" for name in kernels}
    for function in whole.functions:
        if not function.is_declaration and function.name not in names:
            function.linkage = "internal"
    # LLVM's writer of WebAssembly ends the process at a `common` variable
    return re.sub(r"= common (local_unnamed_addr |unnamed_addr )?global", r"= internal \1global", str(whole))


def _imported(source: Path) -> Iterator[Path]:
    """The files of the room that a file of it imports itself (by relative names)."""
    for dots, module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        folder = source.parents[len(dots) - 1].joinpath(*module.split(".")) if module else source.parents[len(dots) - 1]
        if folder.with_suffix(".py").is_file():
            yield folder.with_suffix(".py")
            continue
        for name in re.findall(r"\w+", re.sub(r"#.*|\bas\s+\w+", "", names)):
            if (folder / f"{name}.py").is_file():
                yield folder / f"{name}.py"


@cache
def sources_of(source: Path) -> list[str]:
    """A file of the room and every one that it depends on, by their places in the room."""
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            waiting += _imported(here)
    return sorted(each.relative_to(library.ROOM).as_posix() for each in found)


def emit(text: str, target: Target) -> tuple[bytes, list[str]]:
    """The object file of a module for a target, and what it leaves to be linked."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=3, reloc="pic"
    )
    text = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', text)
    module = llvm.parse_assembly(re.sub(r'target triple = ".*"', f'target triple = "{target.triple}"', text))
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    undefined = sorted(f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm."))
    return machine.emit_object(module), undefined


def linker() -> list[str]:
    """The command that links a shared object: the system's, else that of the package ziglang."""
    for name in ("ld", "ld.lld", "lld"):
        if shutil.which(name):
            return [name]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "ld.lld"]
    raise BuildError("no linker: install binutils or lld, or the package ziglang (pip install ziglang).")


def link(content: bytes) -> bytes:
    """The shared object of an object file."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "kernels.o", Path(folder) / "kernels.so"
        given.write_bytes(content)
        command = [*linker(), "-shared", "--build-id=none", "-z", "noexecstack", "-o", str(made), str(given)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise BuildError(f"{' '.join(command)}: {done.stderr}")
        return made.read_bytes()


def _put(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: another build, or a process that loads it, sees the old one or the new one."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(name, 0o755)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _is_built(names: Iterable[str]) -> bool:
    """Whether the libraries are there, whole and of these sources."""
    try:
        there = library.manifest()
        whole = all(library.whole(there["libraries"][name]) for name in names)
    except (library.Unusable, KeyError):
        return False
    return bool(whole and there["sources"] == library.source_hashes())


def build(names: Iterable[str] | None = None) -> None:
    """Compile all kernels for processors (the names of `TARGETS`; None: this one) into `library.BUILT`.

    Raises BuildError.
    """
    begun = time.monotonic()
    names = list(names or (library.processor(),))
    if _is_built(names):
        _say(f"The kernels are compiled already: {library.BUILT}")
        return
    cores = min(2, os.cpu_count() or 1)
    _say(f"Compiling the kernels for {', '.join(names)}: about half a minute on {cores} cores.")
    import_kernels(ROOMS)
    whole = _module(EXPORTED)
    _say(f"  {len(EXPORTED)} kernels, {time.monotonic() - begun:.0f} s")
    library.BUILT.mkdir(exist_ok=True)
    with multiprocessing.get_context("spawn").Pool(min(cores, len(names))) as pool:
        objects = pool.starmap(emit, [(whole, TARGETS[name]) for name in names])
    made = {}
    for name, (content, undefined) in zip(names, objects, strict=True):
        linked = link(content)
        digest = hashlib.sha256(linked).hexdigest()
        path = library.BUILT / f"kernels-{name}-{digest[:12]}.so"  # another build at the same time has its own
        _put(path, linked)
        made[name] = {"file": path.name, "sha256": digest, "undefined": undefined}
        _say(f"  {path}: {path.stat().st_size // 1000} kB, {time.monotonic() - begun:.0f} s; left to link: {undefined}")
    _put(library.BUILT / HEADER, header(EXPORTED.values()).encode())
    kernels = {name: sources_of(Path(each.function.__code__.co_filename)) for name, each in EXPORTED.items()}
    manifest = {"sources": library.source_hashes(), "libraries": made, "kernels": kernels}
    _put(library.BUILT / library.MANIFEST, json.dumps(manifest, indent=1).encode())
    for old in library.BUILT.glob("kernels-*.so"):
        if old.name not in {each["file"] for each in made.values()} and time.time() - old.stat().st_mtime > AN_HOUR:
            old.unlink(missing_ok=True)
