"""The binaries of FMUs: kernels, the C layer of the interface, and nothing of Python.

A shared library for each platform holds all units and both versions of the interface; which unit an FMU is, its
constants say. It is compiled by zig's clang from the sources that the FMU carries, and kept in a cache by their hash.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
import tempfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.files import write_atomically
from adaptrack.core.build.compile import DLL_FILE, compiler
from adaptrack.core.build.run_time import cache_path
from adaptrack.core.build.units import PLANTS, TRACKERS, UNIT_KERNELS
from adaptrack.core.kernel import fields_of
from adaptrack.core.tracker.followed import BAD_FALLBACK, FLAW
from adaptrack.export.kernel_sources import EXACT_OPTIONS, kernel_sources
from adaptrack.export.memory import kernels_number

HERE = Path(__file__).parent
FMU_SOURCES = (
    *(HERE / "fmu_c" / name for name in ("fmu.c", "fmi2.c", "fmi3.c", "fmu.h")),
    *(HERE / "c" / name for name in ("adaptrack_memory.c", "adaptrack_memory.h", "adaptrack_error.h")),
)
WINDOWS_SOURCES = (DLL_FILE, HERE / "fmu_c" / "windows.c")
LICENSE = HERE / "c" / "LICENSE"
UNIT_MEMBERS = (*TRACKERS, *PLANTS)
"""Kernels whose addresses a unit's record may hold."""
BINARY_OPTIONS = (
    "-std=c99", "-O3", "-g0", *EXACT_OPTIONS, "-Wall", "-Wextra", "-Wconversion", "-fno-stack-protector",
    "-fvisibility=hidden", "-ffunction-sections", "-fdata-sections",
)  # fmt: skip


@dataclass(frozen=True)
class Platform:
    """A system and processor that FMUs have a binary for.

    target: as zig names it; folders: in an FMU of version 2.0 and 3.0; options: of the compiler; linked: of the linker.
    """

    target: str
    folders: tuple[str, str]
    ending: str
    options: tuple[str, ...] = ("-fPIC",)
    linked: tuple[str, ...] = ("-Wl,-dead_strip",)


AVX2 = ("-mcpu=x86_64_v3", "-DADAPTRACK_NEEDS_AVX2")
# names of C's library without a version, so that musl has them as well
ANY_LIBC = ("-nostdlib", "-Wl,--gc-sections,-z,noexecstack")
PLATFORMS = {
    "linux": Platform("x86_64-linux-gnu.2.17", ("linux64", "x86_64-linux"), "so", ("-fPIC", *AVX2), ANY_LIBC),
    "linux-aarch64": Platform("aarch64-linux-gnu.2.17", ("aarch64-linux", "aarch64-linux"), "so", linked=ANY_LIBC),
    "windows": Platform("x86_64-windows-gnu", ("win64", "x86_64-windows"), "dll", AVX2,
                        ("-nostdlib", "-lucrtbase", "-lkernel32", "-Wl,--gc-sections")),
    "macos": Platform("aarch64-macos", ("darwin64", "aarch64-darwin"), "dylib"),
}  # fmt: skip
"""By name; x86-64 with AVX2 and FMA unless the name has a processor, macOS on Apple's processors."""


def own_platform() -> str:
    """The platform of this process; it may be none of `PLATFORMS`."""
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    default = "aarch64" if system == "macos" else "x86_64"
    return system if machine == default else f"{system}-{machine}"


@cache
def sources() -> dict[str, str]:
    """The sources of a binary by their names, which an FMU carries."""
    kernels = kernel_sources([*UNIT_MEMBERS, *sum(UNIT_KERNELS.values(), ())])
    return kernels | {source.name: source.read_text(encoding="utf-8") for source in FMU_SOURCES} | {
        "fmu_units.c": _units_table()}  # fmt: skip


def unit_number(name: str) -> int:
    """The number of a unit by the name of its record."""
    return zlib.crc32(name.encode())


def _units_table() -> str:
    """The kernels of the units as a table, the hash by which constants know them, and flaws of trajectories."""
    declared = "".join(f"extern void adaptrack_{member}(void);\n" for member in UNIT_MEMBERS)
    declared += "".join(
        f"extern int64_t adaptrack_{kernel}(void *);\n" for pair in UNIT_KERNELS.values() for kernel in pair
    )
    members = "".join(f"    adaptrack_{member},\n" for member in UNIT_MEMBERS)
    units = "".join(
        f"    {{{unit_number(name):#x}u, adaptrack_{begin}, adaptrack_{step}}}, /* {name} */\n"
        for name, (begin, step) in UNIT_KERNELS.items()
    )
    flaws = ", ".join(f'"{field.meaning}"' for field in fields_of(FLAW))
    return (
        f'/* Written by adaptrack.export.fmu_build. */\n#include "fmu.h"\n\n{declared}\n'
        f"const uint64_t FMU_KERNELS = {kernels_number():#x}u;\n"
        f"const fmu_member FMU_MEMBERS[] = {{\n{members}}};\nconst size_t FMU_MEMBER_COUNT = {len(UNIT_MEMBERS)};\n"
        f"const fmu_unit FMU_UNITS[] = {{\n{units}}};\nconst size_t FMU_COUNT = {len(UNIT_KERNELS)};\n"
        f"const int64_t FMU_BAD_FALLBACK = {BAD_FALLBACK};\nconst char *const FMU_FLAWS[] = {{\n    {flaws}}};\n"
    )


def check_platforms(names: tuple[str, ...]) -> None:
    """Refuse names that are no platforms, and any name while the compiler is not installed: InvalidInput."""
    for name in names:
        if name not in PLATFORMS:
            raise InvalidInput(f"platform {name!r}: {did_you_mean(name, list(PLATFORMS))}")
    if importlib.util.find_spec("ziglang") is None:
        raise InvalidInput(
            "export fmu: the package ziglang, whose compiler makes the binaries, is not installed; run: "
            "python -m pip install 'adaptrack[compile]'."
        )


def binary(name: str) -> bytes:
    """The shared library for a platform; it is compiled where the cache does not hold it.

    Raises InvalidInput as `check_platforms`, and when the compiler refuses the sources.
    """
    check_platforms((name,))
    chosen = PLATFORMS[name]
    texts = dict(sources())
    if "windows" in chosen.target:
        texts |= {source.name: source.read_text(encoding="utf-8") for source in WINDOWS_SOURCES}
    version = importlib.metadata.version("ziglang")
    parts = repr((version, chosen, BINARY_OPTIONS, sorted(texts.items())))
    path = cache_path() / f"fmu-{name}-{hashlib.sha256(parts.encode()).hexdigest()[:32]}.{chosen.ending}"
    if not path.is_file():
        content = _compiled(chosen, texts)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, content)
    return path.read_bytes()


def _compiled(chosen: Platform, texts: dict[str, str]) -> bytes:
    """The shared library of sources, several compiled at a time."""
    command = [*compiler(), "-target", chosen.target]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        for name, text in texts.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        names = sorted((name for name in texts if name.endswith(".c")), key=lambda name: -len(texts[name]))
        compiled = [*command, *chosen.options, *BINARY_OPTIONS]
        list(pool.map(lambda name: _run([*compiled, "-c", name, "-o", f"{name}.o"], folder), names))
        objects = [f"{name}.o" for name in sorted(names)]
        _run([*command, "-shared", "-s", *objects, *chosen.linked, "-o", "made"], folder)
        return Path(folder, "made").read_bytes()


def _run(command: list[str], folder: str) -> None:
    process = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if process.returncode != 0:
        raise InvalidInput(f"{' '.join(command)}: {process.stderr}")
