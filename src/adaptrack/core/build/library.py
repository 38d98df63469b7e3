"""Kernels to a library: compiled by numba, linked into one module, emitted for a processor, linked to a shared object.

front end (numba): a module of LLVM's for each kernel and the C function around it
-> one module in which all but the C functions is internal
-> optimised and emitted for each target -> linked, with nothing left undefined

A library calls nothing but itself: C's functions differ from system to system, and so would the results.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import multiprocessing
import os
import pkgutil
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

from .. import library
from ..kernel import EXPORTED
from . import numba_functions
from .header import header
from .objects import undefined
from .rules import violations
from .sources import sources_of
from .wasm_link import linked

ROOMS = tuple(f"adaptrack.{each.replace('/', '.')}" for each in library.ROOMS)
"""Packages whose kernels are compiled."""


@dataclass(frozen=True)
class Target:
    """A processor, as LLVM names it.

    lacks: of `SOFT` what it has no instruction for, so that LLVM calls C's function of that name.
    """

    triple: str
    cpu: str = ""
    features: str = ""
    lacks: tuple[str, ...] = ()


TARGETS = {
    "x86-64": Target("x86_64-unknown-linux-gnu", "x86-64", lacks=("fma", "floor", "ceil")),
    "x86-64-v3": Target("x86_64-unknown-linux-gnu", "x86-64-v3"),
    "x86-64-v4": Target("x86_64-unknown-linux-gnu", "x86-64-v4", "-prefer-256-bit"),  # eight floats in one register
    "aarch64": Target("aarch64-unknown-linux-gnu"),
    "riscv64": Target("riscv64-unknown-linux-gnu", "generic-rv64", "+m,+a,+f,+d"),
    "wasm32": Target("wasm32-unknown-unknown", "", "+simd128,+bulk-memory,-relaxed-simd", lacks=("fma",)),
    "windows-x86-64": Target("x86_64-pc-windows-msvc", "x86-64", lacks=("fma", "floor", "ceil")),
    "windows-x86-64-v3": Target("x86_64-pc-windows-msvc", "x86-64-v3"),
    "windows-x86-64-v4": Target("x86_64-pc-windows-msvc", "x86-64-v4", "-prefer-256-bit"),
    "macos-aarch64": Target("arm64-apple-macosx11.0.0", "apple-m1"),
    "macos-x86-64": Target("x86_64-apple-macosx11.0.0", "x86-64", lacks=("fma", "floor", "ceil")),
    "macos-x86-64-v3": Target("x86_64-apple-macosx11.0.0", "x86-64-v3"),
}
SOFT = {"fma": 3, "floor": 1, "ceil": 1, "sqrt": 1}
"""Functions of C's library that the kernels have themselves, exactly, as ``soft_NAME``; how many floats each takes."""

WINDOWS = """
module asm ".globl __chkstk"
module asm "__chkstk: pushq %rcx; pushq %rax; leaq 24(%rsp), %rcx"
module asm "1: cmpq $0x1000, %rax; jb 2f"
module asm "subq $0x1000, %rcx; testq %rcx, (%rcx); subq $0x1000, %rax; jmp 1b"
module asm "2: subq %rax, %rcx; testq %rcx, (%rcx); popq %rax; popq %rcx; ret"
@_fltused = constant i32 1
"""
"""What compilers for Windows ask of C's library: a stack grows (by rax bytes) when its pages are touched in turn; and a
name which says that there are floats.
"""

HEADER = "adaptrack.h"
AN_HOUR = 3600.0
"""s, for which a library is left alone that this build has not made: another build may have."""


class BuildError(RuntimeError):
    """The library cannot be built; the message says what to do."""


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def kernels_of(rooms: Iterable[str]) -> dict[str, Any]:
    """Every exported kernel of packages by its name: all of their modules are imported."""
    for room in rooms:
        package = importlib.import_module(room)
        for found in pkgutil.walk_packages(package.__path__, f"{room}."):
            if not found.name.startswith("adaptrack.core.build"):
                importlib.import_module(found.name)
    insides = tuple(f"{room}." for room in rooms)
    return {name: each for name, each in EXPORTED.items() if each.function.__module__.startswith(insides)}


def _module(kernels: dict[str, Any]) -> Any:
    """One module of all kernels and the C functions around them; all but these is internal."""
    whole = numba_functions.linked(kernels.values())
    names = {f"adaptrack_{name}" for name in kernels}
    for function in whole.functions:
        if not function.is_declaration and function.name not in names:
            function.linkage = "internal"
    # LLVM's writer of WebAssembly ends the process at a `common` variable
    return re.sub(r"= common (local_unnamed_addr |unnamed_addr )?global", r"= internal \1global", str(whole))


_FMA8 = """
define internal <8 x double> @soft_fma8(<8 x double> %a, <8 x double> %b, <8 x double> %c) {
  %pa = alloca <8 x double>, align 64
  %pb = alloca <8 x double>, align 64
  %pc = alloca <8 x double>, align 64
  %py = alloca <8 x double>, align 64
  store <8 x double> %a, ptr %pa, align 64
  store <8 x double> %b, ptr %pb, align 64
  store <8 x double> %c, ptr %pc, align 64
  call void @adaptrack_soft_fma8(ptr %pa, i64 8, ptr %pb, i64 8, ptr %pc, i64 8, ptr %py, i64 8)
  %y = load <8 x double>, ptr %py, align 64
  ret <8 x double> %y
}
"""
"""The kernel of this name, on values instead of arrays."""


def with_soft(text: str, target: Target, linkage: str, inlined: bool = False) -> str:
    """A module with C's functions that a target lacks, from the kernels' own; linkage: of these.

    Where there is floating-point arithmetic, LLVM's multiply-add becomes a call of ours before anything is optimised;
    without it, the one in whole numbers is faster. inlined: eight multiply-adds at once are a part of those that call
    them, which takes a quarter of the time and half of the code more.
    """
    for name in target.lacks:
        taken, own = SOFT[name], f"soft_{name}"
        if name == "fma" and "sqrt" in target.lacks:
            own = "whole_fma"
        elif name == "fma":
            text = text.replace("call double @llvm.fma.f64(", "call double @adaptrack_soft_fma(")
            text = text.replace("call <8 x double> @llvm.fma.v8f64(", "call <8 x double> @soft_fma8(")
            if "@adaptrack_soft_fma8(" in text:
                text += _FMA8.replace(") {", ") alwaysinline {" if inlined else ") noinline {")
            text = re.sub(r"^(define .*careful_fma.*) \{$", r"\1 noinline cold {", text, flags=re.MULTILINE)
            text = re.sub(r"^(define .*@adaptrack_soft_fma\(.*) \{$", r"\1 noinline {", text, flags=re.MULTILINE)
        if f"@adaptrack_{own}(" not in text:
            text += f"declare double @adaptrack_{own}({', '.join(['double'] * taken)})\n"
        given = ", ".join(f"double %x{i}" for i in range(taken))
        text += f"define {linkage} double @{name}({given}) noinline {{\n"
        text += f"  %y = call double @adaptrack_{own}({given})\n  ret double %y\n}}\n"
    return text


def retargeted(text: str, target: Target, reloc: str = "pic") -> tuple[Any, str]:
    """LLVM's machine of a target, and the text of a module for it."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    if "windows" in target.triple:
        llvm.initialize_native_asmparser()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=3, reloc=reloc
    )
    text = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', text)
    return machine, re.sub(r'target triple = ".*"', f'target triple = "{target.triple}"', text)


def optimised(module: Any, machine: Any, speed: int = 3, vectors: bool = True) -> None:
    """Optimise a module for a machine, in place."""
    options = llvm.create_pipeline_tuning_options(speed_level=speed)
    options.loop_vectorization = options.slp_vectorization = vectors
    passes = llvm.create_pass_builder(machine, options)
    for function in module.functions:  # small before they are inlined: that takes half the time
        if not function.is_declaration:
            passes.getFunctionPassManager().run(function, passes)
    passes.getModulePassManager().run(module, passes)


def emit(text: str, name: str) -> bytes:
    """The object file of a module for a target.

    No function of C's is called: "no-builtins" keeps loops from becoming calls of memcpy and its like, and what the
    target lacks comes from `SOFT`.
    """
    target = TARGETS[name]
    machine, text = retargeted(text, target, "static" if target.triple.startswith("wasm") else "pic")
    text = with_soft(text, target, "hidden")
    if "windows" in target.triple:
        text = re.sub(r"^define (?=[^@]*@adaptrack_)", "define dllexport ", text, flags=re.MULTILINE) + WINDOWS
    module = llvm.parse_assembly(re.sub(r"^(define .*) \{$", r'\1 "no-builtins" {', text, flags=re.MULTILINE))
    optimised(module, machine)
    return bytes(machine.emit_object(module))


def linker(target: Target) -> list[str] | None:
    """The command that makes a library of an object of a target, None where no such linker is installed."""
    if "windows" in target.triple:
        names, options = ["lld-link"], ["/dll", "/noentry", "/nodefaultlib", "/brepro"]
    elif "macosx" in target.triple:
        names, options = ["ld64.lld"], ["-dylib", "-arch", target.triple.split("-")[0]]
        options += ["-platform_version", "macos", "11.0", "11.0", "-install_name", "kernels.dylib"]
    else:
        own = target.triple.split("-")[0] == platform.machine()
        names = ["ld", "ld.lld", "lld"] if own else ["ld.lld"]
        options = ["-shared", "--build-id=none", "-z", "noexecstack", "-z", "defs"]
    for name in names:
        if shutil.which(name):
            return [name, *options]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", names[0] if len(names) == 1 else "ld.lld", *options]
    return None


def link(content: bytes, command: list[str]) -> bytes:
    """The library of an object file."""
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "kernels.o", Path(folder) / "kernels.dll"  # the name lies in a DLL
        given.write_bytes(content)
        to = [f"/out:{made}"] if "/dll" in command else ["-o", str(made)]
        done = subprocess.run([*command, *to, str(given)], capture_output=True, text=True)
        if done.returncode != 0:
            raise BuildError(f"{' '.join(command)}: {done.stderr}")
        return made.read_bytes()


def finished(name: str, content: bytes) -> tuple[str, bytes]:
    """The ending of the file and the content of what is kept of a target: its library, or its object without a linker.

    Raises BuildError for an object that calls what it does not have, and without a linker for this processor.
    """
    left = undefined(content)
    if left:
        raise BuildError(
            f"the kernels for {name} call {', '.join(left)}: each belongs into SOFT, or is to be replaced."
        )
    if name == "wasm32":
        return "wasm", linked(content)
    command = linker(TARGETS[name])
    if command is not None:
        ending = {"windows": "dll", "macos": "dylib"}.get(name.split("-")[0], "so")
        return ending, link(content, command)
    if name in of_this_kind():
        raise BuildError("no linker: install binutils or lld, or the package ziglang (pip install ziglang).")
    _say(f"  {name}: no linker for it is installed, so its object file is kept")
    return "o", content


def _put(path: Path, content: bytes) -> None:
    """Write a file whole or not at all: another build, or a process that loads it, sees the old one or the new one."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix="kernels-")  # a build that was killed leaves it
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(name, 0o755)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def of_this_kind() -> list[str]:
    """The names of all that a processor of this machine's kind may ask for when the library is loaded."""
    name = library.processor()
    return [each for each in TARGETS if each.split("-v")[0] == name.split("-v")[0]] or [name]


def _listed(what: str) -> dict[str, dict[str, str]]:
    """The ``libraries`` or the ``exports`` of the manifest that is there."""
    with suppress(*library.UNUSABLE):
        return dict(library.manifest()[what])
    return {}


def _built(what: str = "libraries") -> dict[str, dict[str, str]]:
    """What is there of these sources, whole, by the names of the targets."""
    found = {}
    with suppress(*library.UNUSABLE):
        if library.manifest()["sources"] == library.source_hashes():
            for name, entry in _listed(what).items():
                with suppress(*library.UNUSABLE):
                    library.whole(entry)
                    found[name] = entry
    return found


def build(names: Iterable[str] = (), portable: bool = False, exports: Iterable[str] = ()) -> None:
    """Compile all kernels into `library.BUILT`, for this processor and for further ones (names of `TARGETS`).

    portable: for all processors of this machine's kind, as a wheel needs them; exports: names of `exports.EXPORTS`, for
    which the object file is made that other programs take in.

    Raises BuildError, also for kernels that break one of the `rules`.
    """
    from .exports import EXPORTS, emit_export, shipped

    begun = time.monotonic()
    own = of_this_kind() if portable else [library.processor()]
    requested: dict[str, tuple[Any, dict[str, Any], list[str]]] = {
        "libraries": (emit, TARGETS, [*own, *names]),
        "exports": (emit_export, EXPORTS, [*shipped(own, portable), *exports]),
    }
    jobs = [(what, name) for what, (_, _, wanted) in requested.items() for name in dict.fromkeys(wanted)
            if name not in _built(what)]  # fmt: skip
    if not jobs:
        _say(f"The kernels are compiled already: {library.BUILT}")
        return
    unknown = [f"{name} ({', '.join(requested[what][1])})" for what, name in jobs if name not in requested[what][1]]
    if unknown:
        raise BuildError(f"no such processor: {'; '.join(unknown)}.")
    cores = min(2, os.cpu_count() or 1)
    _say(f"Compiling the kernels for {', '.join(name for _, name in jobs)}: a minute or two on {cores} cores.")
    kernels = kernels_of(ROOMS)
    if library.source_hashes.__wrapped__() != library.source_hashes():
        raise BuildError("a source was edited while it was read: once more.")
    whole = _module(kernels)
    if found := violations(whole):
        raise BuildError("\n".join(found))
    _say(f"  {len(kernels)} kernels, {time.monotonic() - begun:.0f} s")
    library.BUILT.mkdir(exist_ok=True)
    made: dict[str, dict[str, dict[str, str]]] = {what: {} for what in requested}
    with multiprocessing.get_context("spawn").Pool(min(cores, len(jobs))) as pool:
        waiting = [pool.apply_async(requested[what][0], (whole, name)) for what, name in jobs]
        for (what, name), each in zip(jobs, waiting, strict=True):
            content = each.get()
            if what == "libraries":
                stem, (ending, content) = f"kernels-{name}", finished(name, content)
            else:
                stem, ending = f"export-{name}", "wasm" if EXPORTS[name].whole else "o"
            made[what][name] = _kept(stem, ending, content)
            _say(f"  {made[what][name]['file']}: {len(content) // 1000} kB, {time.monotonic() - begun:.0f} s")
    _put(library.BUILT / HEADER, header(kernels.values()).encode())
    sources = {name: sources_of(Path(each.function.__code__.co_filename)) for name, each in kernels.items()}
    made = {what: _built(what) | each for what, each in made.items()}  # another build may have ended meanwhile
    # who reads the old manifest wants these
    kept = {each["file"] for what in made for each in [*made[what].values(), *_listed(what).values()]}
    manifest = {"sources": library.source_hashes(), **made, "kernels": sources}
    _put(library.BUILT / library.MANIFEST, json.dumps(manifest, indent=1).encode())
    for old in [*library.BUILT.glob("kernels-*"), *library.BUILT.glob("export-*")]:
        if old.name not in kept and time.time() - old.stat().st_mtime > AN_HOUR:
            old.unlink(missing_ok=True)


def _kept(stem: str, ending: str, content: bytes) -> dict[str, str]:
    """Write what was made; its entry of the manifest. Another build at the same time has its own name."""
    digest = hashlib.sha256(content).hexdigest()
    path = library.BUILT / f"{stem}-{digest[:12]}.{ending}"
    _put(path, content)
    return {"file": path.name, "sha256": digest}
