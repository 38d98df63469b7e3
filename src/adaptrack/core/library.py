"""The library of compiled kernels: found, proved to be whole and of these sources, and loaded.

``ADAPTRACK_KERNELS`` says how kernels are run: ``library``, the default; ``jit``, compiled at run time (which needs
the package ziglang); ``interpreted``, as the Python that they are.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib
import json
import logging
import os
import platform
import subprocess
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

WAYS = ("library", "jit", "interpreted")
WAY = os.environ.get("ADAPTRACK_KERNELS") or "library"
if WAY not in WAYS:
    raise ImportError(f"ADAPTRACK_KERNELS={WAY}: need one of {', '.join(WAYS)}.")

PACKAGE_FOLDER = Path(__file__).parents[1]
BUILT_FOLDER = PACKAGE_FOLDER / "core" / "built"
MANIFEST = "manifest.json"
BUILD = "python -m adaptrack.core.build"
PAGE = "wasm32-page"
"""The WebAssembly module with the kernels of the driving page, among the libraries that `build.library` makes."""
COMPILER = "adaptrack.core.build.run_time"
"""What compiles kernels at run time; few processes need it: found by name."""

UNUSABLE = (OSError, ValueError, LookupError, TypeError, AttributeError)
"""What `manifest`, `whole` and `Library` raise where there is none, or a damaged one."""


class NoKernels(ImportError):
    """There is neither a library of the kernels nor a compiler for them."""


@cache
def source_hashes() -> dict[str, str]:
    """SHA-256 of every file that the library is made of, kernels and their builder, by its place in the package."""
    core = PACKAGE_FOLDER / "core"
    files = sorted([*core.rglob("*.py"), *core.glob("build/*.[ch]")])
    return {
        file.relative_to(PACKAGE_FOLDER).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest() for file in files
    }


@cache
def kernels_hash() -> str:
    """Hash of all inputs of the kernels (their sources and the builder's) as 16 hexadecimal digits."""
    digest = hashlib.sha256(json.dumps(source_hashes(), sort_keys=True).encode()).hexdigest()[:16]
    return f"{digest} (interpreted)" if WAY == "interpreted" else digest


def processor() -> str:
    """The name of the library for this system and processor, by what the processor says that it has."""
    system = {"win32": "windows-", "darwin": "macos-"}.get(sys.platform, "")
    machine = platform.machine().lower()
    if machine in ("x86_64", "amd64"):
        from numpy._core._multiarray_umath import __cpu_features__ as known  # type: ignore[import-not-found]

        # NumPy does not list what NPY_DISABLE_CPU_FEATURES takes from it: the kernels may still use that
        is_hidden = sys.platform == "linux" and "NPY_DISABLE_CPU_FEATURES" in os.environ
        flags = Path("/proc/cpuinfo").read_text(encoding="utf-8").split() if is_hidden else []
        avx2, fma, avx512 = (
            known.get(feature) or flag in flags
            for feature, flag in (("AVX2", "avx2"), ("FMA3", "fma"), ("AVX512_SKX", "avx512vl"))
        )
        if not (avx2 and fma):
            return f"{system}x86-64"
        return f"{system}x86-64-v4" if avx512 and system != "macos-" else f"{system}x86-64-v3"
    return system + {"arm64": "aarch64"}.get(machine, machine)


def can_compile() -> bool:
    """Whether kernels and users' functions can be compiled: the package ziglang, a compiler for C, is there."""
    return find_spec("ziglang") is not None


def compiler() -> Any:
    """The module `COMPILER`; ImportError where a package is missing that it needs."""
    return importlib.import_module(COMPILER)


def manifest() -> dict[str, Any]:
    """Return the record of the build: files and their hashes by processor, sources and their hashes by kernel.

    Raises OSError where there is none, ValueError where it is damaged.
    """
    path = BUILT_FOLDER / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: not JSON in UTF-8 ({type(error).__name__})") from None
    if not isinstance(content, dict) or not isinstance(content.get("sources"), dict):
        raise ValueError(f"{path} is damaged: 'sources' is missing or not a table")
    for name in ("libraries", "kernels"):
        table = content.setdefault(name, {})
        if not (isinstance(table, dict) and all(_is_entry(name, entry) for entry in table.values())):
            raise ValueError(f"{path} is damaged: the entries of {name!r} are not those that a build writes")
    return content


def _is_entry(name: str, entry: Any) -> bool:
    """Whether an entry of a table of the manifest is a list of sources, or a file with its hash."""
    if name == "kernels":
        return isinstance(entry, list) and all(isinstance(source, str) for source in entry)
    return isinstance(entry, dict) and all(isinstance(entry.get(key), str) for key in ("file", "sha256"))


def page_module() -> Path:
    """The WebAssembly module with the kernels of the driving page, built now where it is not there.

    Raises one of `UNUSABLE` where it cannot be built: without the compiler for C, in a read-only installation.
    """
    try:
        return _page_module()
    except UNUSABLE:
        if not (can_compile() and os.access(PACKAGE_FOLDER, os.W_OK)):
            raise
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(PACKAGE_FOLDER.parent), *sys.path])}
    subprocess.run([sys.executable, *BUILD.split()[1:], PAGE], env=environment)  # it says what goes wrong
    return _page_module()


def _page_module() -> Path:
    listed = manifest()
    if listed["sources"] != source_hashes():
        raise ValueError(f"{BUILT_FOLDER}: is of other kernels than {kernels_hash()}")
    return verified_file(listed["libraries"][PAGE])


def verified_file(entry: dict[str, str]) -> Path:
    """The file of a library of the manifest, proved to be as it was built."""
    path = BUILT_FOLDER / entry["file"]
    if hashlib.sha256(path.read_bytes()).hexdigest() != entry["sha256"]:
        raise ValueError(f"{path}: is not what was built: damaged, cut short or of another build")
    return path


class Library:
    """The library of this processor, and which sources have been edited since it was built."""

    def __init__(self) -> None:
        built, name = manifest(), os.environ.get("ADAPTRACK_PROCESSOR") or processor()
        if name not in built["libraries"]:
            raise ValueError(f"no library for {name}")
        self.path = verified_file(built["libraries"][name])
        self.functions = ctypes.CDLL(str(self.path))
        self.kernels = built["kernels"]
        then, current = built["sources"], source_hashes()
        self.edited = {path for path in {*then, *current} if then.get(path) != current.get(path)}

    def why_not(self, name: str) -> str:
        """Why a kernel of this library is not to be used; empty where it is."""
        if name not in self.kernels:
            return f"{name} is not in {self.path.name}"
        edited = self.edited.intersection(self.kernels[name])
        return f"{min(edited)} has been edited since" if edited else ""

    def address(self, name: str) -> int:
        """Where an exported kernel begins."""
        return int(ctypes.cast(getattr(self.functions, f"adaptrack_{name}"), ctypes.c_void_p).value or 0)


@cache
def loaded() -> Library | str:
    """The library, or why there is none."""
    if WAY != "library":
        return f"ADAPTRACK_KERNELS={WAY}"
    if not (BUILT_FOLDER / MANIFEST).exists():
        return "the kernels have not been compiled"
    try:
        return Library()
    except UNUSABLE as error:
        return str(error)


@cache
def _say_once(text: str) -> None:
    """A log record of level WARNING: without any configuration Python shows it on standard error, everywhere."""
    logging.getLogger("adaptrack").warning("adaptrack: %s", text)


def find(name: str) -> int | None:
    """Where an exported kernel of the library begins; None where it is to be compiled now.

    Raises NoKernels where it is neither in the library nor can be compiled.
    """
    library = loaded()
    why = library if isinstance(library, str) else library.why_not(name)
    if not why and isinstance(library, Library):
        return library.address(name)
    if not can_compile():
        raise NoKernels(
            f"{why}, and the compiler is not installed: python -m pip install 'adaptrack[compile]'. Then run: {BUILD}"
        )
    if WAY == "library":
        _say_once(f"{why}: what depends on it is compiled now, in this process. To compile it once: {BUILD}")
    return None


def description() -> str:
    """How kernels are run, and why: the line of ``adaptrack --version``."""
    library = loaded()
    if isinstance(library, Library):
        edited = f"; compiled now, as edited since: {', '.join(sorted(library.edited))}" if library.edited else ""
        return f"kernels {kernels_hash()}: library {library.path}{edited}"
    fallback = "as plain Python" if WAY == "interpreted" else "compiled at run time"
    return f"kernels {kernels_hash()}: {fallback}: {library}"
