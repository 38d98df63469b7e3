"""The binaries of FMUs, made before an FMU is exported: kernels, the C layer of the interface, and nothing of Python.

``python -m adaptrack.export.fmu_build`` writes one shared library for each system into `FMU_FOLDER`. It holds all units
and both versions of the interface; which unit an FMU is, its constants say. So `adaptrack export fmu` copies it, and in
a checkout makes it first where it is missing.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import write_atomically
from adaptrack.core import library
from adaptrack.core.build.units import PLANTS, TRACKERS, UNIT_KERNELS

HERE = Path(__file__).parent
FMU_FOLDER = HERE / "built"
FMU_MANIFEST = "fmu.json"
FMU_SOURCES = (
    *(HERE / "fmu_c" / name for name in ("fmu.c", "fmi2.c", "fmi3.c", "fmu.h")),
    *(HERE / "c" / name for name in ("adaptrack_block.c", "adaptrack_block.h", "adaptrack_error.h")),
)
LICENSE = HERE / "c" / "LICENSE"
UNIT_MEMBERS = (*TRACKERS, *PLANTS)
"""Kernels whose addresses a unit's record may hold."""
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-fno-stack-protector", "-DADAPTRACK_NEEDS_AVX2")


@dataclass(frozen=True)
class System:
    """A system that FMUs have a binary for.

    target: of `core.build`; folders: in an FMU of version 2.0 and 3.0; compilers: the first that is installed; zig: the
    target of the package ziglang, which stands for them; options: of compiler and linker.
    """

    target: str
    folders: tuple[str, str]
    ending: str
    compilers: tuple[str, ...]
    zig: str
    options: tuple[str, ...]


SYSTEMS = {
    "linux": System(
        "x86-64-v3", ("linux64", "x86_64-linux"), "so", ("gcc", "clang"), "x86_64-linux-gnu.2.17",
        # names of C's library without a version, so that musl has them as well
        ("-fPIC", "-fvisibility=hidden", "-nostdlib", "-Wl,--gc-sections,-z,noexecstack,--version-script={exports}"),
    ),
    "windows": System(
        "windows-x86-64-v3", ("win64", "x86_64-windows"), "dll", ("x86_64-w64-mingw32-gcc",), "x86_64-windows-gnu",
        ("-Wl,--gc-sections",),
    ),
}  # fmt: skip
FMU_VERSION_SCRIPT = "{ global: fmi2*; fmi3*; local: *; };\n"


def units_header() -> str:
    """``units.h``: the kernels of the units as a table, and the hash by which constants know them."""
    declared = "".join(f"extern void adaptrack_{member}(void);\n" for member in UNIT_MEMBERS)
    declared += "".join(
        f"extern int64_t adaptrack_{kernel}(void *);\n" for pair in UNIT_KERNELS.values() for kernel in pair
    )
    rows = "".join(f"    {{{zlib.crc32(member.encode()):#x}u, adaptrack_{member}}},\n" for member in UNIT_MEMBERS)
    units = "".join(
        f"    {{{{{int(library.kernels_hash(), 16):#x}u, {zlib.crc32(name.encode()):#x}u, MEMBERS, "
        f"sizeof MEMBERS / sizeof *MEMBERS, 0}}, adaptrack_{begin}, adaptrack_{step}}},\n"
        for name, (begin, step) in UNIT_KERNELS.items()
    )
    return (
        f'/* Written by adaptrack.export.fmu_build. */\n#include "fmu.h"\n\n{declared}\n'
        f"static const adaptrack_function MEMBERS[] = {{\n{rows}}};\n\nconst fmu_unit FMU_UNITS[] = {{\n{units}}};\n"
        "const size_t FMU_COUNT = sizeof FMU_UNITS / sizeof *FMU_UNITS;\n"
    )


def compiler(system: System) -> list[str] | None:
    """The command of a C compiler for a system, None where none is installed."""
    for name in system.compilers:
        if shutil.which(name):
            return [name]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-target", system.zig]
    return None


def linked(system: System, kernels: bytes, command: list[str]) -> bytes:
    """The shared library of an object of kernels and the C sources.

    Raises
    ------
    InvalidInput
        When the compiler refuses.
    """
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for source in FMU_SOURCES:
            shutil.copy(source, work)
        (work / "units.c").write_text(units_header())
        (work / "kernels.o").write_bytes(kernels)
        (work / "exports").write_text(FMU_VERSION_SCRIPT)
        names = [source.name for source in FMU_SOURCES if source.suffix == ".c"]
        options = [option.format(exports="exports") for option in system.options]
        if "ziglang" in command:  # without a library it has no headers of one either
            options = [option for option in options if option != "-nostdlib"]
        library_name = f"made.{system.ending}"
        arguments = [*command, *FLAGS, *options, "-shared", *names, "units.c", "kernels.o", "-o", library_name, "-s"]
        process = subprocess.run(arguments, cwd=work, capture_output=True, text=True)
        if process.returncode != 0:
            raise InvalidInput(f"{' '.join(arguments)}: {process.stderr}")
        return (work / library_name).read_bytes()


def manifest() -> dict[str, Any] | None:
    """Return what was built of these kernels and C sources; None where there is nothing or something older."""
    try:
        content = json.loads((FMU_FOLDER / FMU_MANIFEST).read_text(encoding="utf-8"))
        current = content["kernels"] == library.kernels_hash() and content["sources"] == sources_hash()
        entries = {name: {"sha256": str(entry["sha256"])} for name, entry in content["binaries"].items()}
    except (*library.UNUSABLE, RecursionError):
        return None
    return {"binaries": entries} if current else None


def build() -> None:
    """Make the binaries of those systems whose kernels and compiler are at hand; say which are left out.

    The kernels for this system are compiled where they are missing.
    """
    FMU_FOLDER.mkdir(exist_ok=True)
    binaries: dict[str, Any] = {}
    native = "windows" if sys.platform == "win32" else "linux"
    for name, system in SYSTEMS.items():
        command = compiler(system)
        try:
            kernels = library.exported(system.target) if name == native else library.export_of(system.target)
        except library.UNUSABLE as error:
            _say(f"no kernels ({error}): {library.BUILD} --export {system.target}", name)
            continue
        if command is None:
            _say(f"no C compiler: install {' or '.join(system.compilers)}, or the package ziglang", name)
            continue
        content = linked(system, kernels.read_bytes(), command)
        write_atomically(FMU_FOLDER / f"fmu-{name}.{system.ending}", content)
        binaries[name] = {"sha256": hashlib.sha256(content).hexdigest()}
        _say(f"{len(content) // 1000} kB, by {command[0]}", name)
    if not binaries:
        return
    manifest = {"kernels": library.kernels_hash(), "sources": sources_hash(), "binaries": binaries}
    write_atomically(FMU_FOLDER / FMU_MANIFEST, json.dumps(manifest, indent=1).encode())


def _say(text: str, name: str) -> None:
    print(f"  FMUs for {name}: {text}", file=sys.stderr)


def sources_hash() -> str:
    """SHA-256 of the C sources."""
    return hashlib.sha256(b"".join(source.read_bytes() for source in FMU_SOURCES)).hexdigest()


if __name__ == "__main__":
    build()
