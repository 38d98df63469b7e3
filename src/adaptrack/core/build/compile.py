"""Kernels to a library by way of C: translated, compiled room by room, linked.

An object is kept by the hash of its text, of the structs that it needs, and of what compiles it. The compiler is the
clang of the package ziglang: the same for every platform, and it brings a linker along.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from .c_files import HEAD_FILE, CFile, records, texts
from .c_types import PREFIX

CLANG_EXACT_OPTIONS = (
    "-ffp-contract=off", "-fno-strict-aliasing", "-fwrapv", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
"""Each operation rounds once, in the order in which it is written. Records lie in arrays of numbers, and whole numbers
wrap. The last two are for speed."""
OPTIONS = (
    "-std=c99", "-O3", "-g0", "-DADAPTRACK_SHARED", *CLANG_EXACT_OPTIONS,
    "-fno-builtin", "-ffreestanding",  # no function of C's library is called
    "-fno-sanitize=undefined", "-fno-stack-protector", "-fvisibility=hidden",
    "-Wall", "-Wextra", "-Werror", "-Wno-psabi", "-Wno-unused-parameter", "-Wno-unused-variable",
    "-Wno-unused-but-set-variable", "-Wno-bitwise-instead-of-logical", "-Wno-tautological-compare",
)  # fmt: skip
"""Of the compiler. What kernels leave unused they leave unused in Python, too."""


@dataclass(frozen=True)
class Processor:
    """A processor and system, as zig names them."""

    triple: str
    cpu: str = "baseline"
    options: tuple[str, ...] = ()
    linked: tuple[str, ...] = ()
    """options of the linker"""


_LINUX = ("-fPIC", "-fno-semantic-interposition")
_ALONE = ("-Wl,-Bsymbolic", "-Wl,-z,defs", "-Wl,-z,noexecstack")
PROCESSORS = {
    "x86-64": Processor("x86_64-linux-gnu.2.17", "x86_64", _LINUX, _ALONE),
    "x86-64-v3": Processor("x86_64-linux-gnu.2.17", "x86_64_v3", _LINUX, _ALONE),
    "x86-64-v4": Processor("x86_64-linux-gnu.2.17", "x86_64_v4", (*_LINUX, "-mprefer-vector-width=512"), _ALONE),
    "aarch64": Processor("aarch64-linux-gnu.2.17", "baseline", _LINUX, _ALONE),
    "riscv64": Processor("riscv64-linux-gnu", "baseline", _LINUX, _ALONE),
    "windows-x86-64": Processor("x86_64-windows-gnu", "x86_64"),
    "windows-x86-64-v3": Processor("x86_64-windows-gnu", "x86_64_v3"),
    "windows-x86-64-v4": Processor("x86_64-windows-gnu", "x86_64_v4"),
    "macos-x86-64": Processor("x86_64-macos", "x86_64"),
    "macos-x86-64-v3": Processor("x86_64-macos", "x86_64_v3"),
    "macos-aarch64": Processor("aarch64-macos"),
    "wasm32": Processor("wasm32-freestanding", "generic+simd128", ("-Os",)),  # as fast as with -O3, a third smaller
}
LACKING = ("x86-64", "riscv64", "wasm32")
"""Ends of the names of processors without an instruction, for which the head calls one of `SOFT_KERNELS`."""
MODULE_STACK = 2**18
"""bytes of the stack of a WebAssembly module"""

SANITIZED = (
    "-fsanitize=shift,integer-divide-by-zero,float-cast-overflow,bool,null,unreachable,return,bounds",
    "-fsanitize-trap=all", "-DADAPTRACK_CHECKS", "-g",
)  # fmt: skip
"""Options with which the process ends where the language leaves open what happens; a debugger shows the line."""
GCC_SANITIZERS = ("-march=native", "-Os", "-g1", "-w", "-fsanitize=address,undefined,float-cast-overflow",
                  "-fsanitize-recover=all")  # fmt: skip
"""Options with which GCC reports each access beyond an array, and each operation that is not defined, with its line."""


class CompileError(RuntimeError):
    """The compiler or the linker refuses the kernels; the message is its own."""


MEMORY_FILE, DLL_FILE = (Path(__file__).with_name(name) for name in ("memory.c", "dll.c"))
"""What every library holds, and what a DLL for Windows holds in addition."""


def compiler(tool: str = "cc") -> list[str]:
    """The command of the compiler, or of another tool of its package."""
    return [sys.executable, "-m", "ziglang", tool]


def write_sources(files: Mapping[str, CFile], folder: Path) -> None:
    """Write the files in C, the header of their records and the head."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts(files).items():
        (folder / name).write_text(text, encoding="utf-8")


def object_name(file: CFile, processor: str, options: tuple[str, ...]) -> str:
    """The name of an object: of its file, and a hash of all that it is made of."""
    parts = [version("ziglang"), HEAD_FILE.read_text(encoding="utf-8"), records([file]), file.text, processor,
             repr(PROCESSORS[processor]), *options]  # fmt: skip
    return f"{file.name}-{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]}.{processor}.o"


def compile_objects(
    files: Mapping[str, CFile], processor: str, cache: Path, is_sanitized: bool = False
) -> tuple[list[Path], int]:
    """Objects of all files, several at a time; those that are there are not made again. And how many were made."""
    options = (*(option for option in OPTIONS if option != "-g0"), *SANITIZED) if is_sanitized else OPTIONS
    for path in (MEMORY_FILE, DLL_FILE) if "windows" in PROCESSORS[processor].triple else (MEMORY_FILE,):
        files = {**files, path.stem: CFile(path.stem, path.read_text(encoding="utf-8"))}
    paths = {name: cache / object_name(file, processor, options) for name, file in files.items()}
    missing = [name for name, path in paths.items() if not path.exists()]
    for path in paths.values():
        if path.exists():
            os.utime(path)  # it was used now
    missing.sort(key=lambda name: -len(files[name].text))
    cache.mkdir(parents=True, exist_ok=True)
    if missing:
        with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
            write_sources(files, Path(folder))
            list(pool.map(lambda name: _compile(Path(folder), name, processor, options, paths[name]), missing))
    return list(paths.values()), len(missing)


def _compile(folder: Path, name: str, processor: str, options: tuple[str, ...], path: Path) -> None:
    target = PROCESSORS[processor]
    result = folder / f"{name}.o"
    _run([*compiler(), "-target", target.triple, f"-mcpu={target.cpu}", *options, *target.options,
          "-c", str(folder / f"{name}.c"), "-o", str(result)])  # fmt: skip
    os.replace(result, path)


def link(objects: list[Path], processor: str, path: Path, is_stripped: bool = True) -> None:
    """Write the library of objects; nothing is left undefined."""
    target = PROCESSORS[processor]
    options = ["-shared", "-nostdlib", *(["-s"] if is_stripped else [])]
    options += [*target.linked, "-o", str(path)]
    _run([*compiler(), "-target", target.triple, f"-mcpu={target.cpu}", *options, *map(str, objects)])


def link_by_gcc(files: Mapping[str, CFile], path: Path) -> None:
    """Write the library of this processor with GCC's sanitizers; zig has no run-time library for those of clang."""
    with tempfile.TemporaryDirectory() as folder:
        write_sources(files, Path(folder))
        sources = [str(Path(folder, f"{name}.c")) for name in files]
        _run(["gcc", *OPTIONS, *_LINUX, *GCC_SANITIZERS, "-shared", *sources, "-o", str(path)])


def link_module(objects: list[Path], kernels: Iterable[str], path: Path) -> None:
    """Write the WebAssembly module of objects: it exports kernels, its memory and its table, and imports nothing.

    The stack lies first in memory and grows down to address 0: one that is too small ends in a trap, not in data that
    are overwritten. Who loads the module enters functions into the table.
    """
    _run([*compiler("wasm-ld"), "--no-entry", "--stack-first", "-z", f"stack-size={MODULE_STACK}", "--export-table",
          "--growable-table", "--strip-all", *(f"--export={PREFIX}{name}" for name in kernels),
          "-o", str(path), *map(str, objects)])  # fmt: skip


def _run(command: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:  # zig keeps every object it has made: once is enough
        places = {"ZIG_GLOBAL_CACHE_DIR": folder, "ZIG_LOCAL_CACHE_DIR": folder}
        process = subprocess.run(command, capture_output=True, text=True, env=os.environ | places)
    if process.returncode != 0:
        raise CompileError(f"{' '.join(command)}: {process.stderr}")
