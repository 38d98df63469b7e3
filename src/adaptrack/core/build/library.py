"""Kernels to a library: compiled by numba file by file, optimised folder by folder, linked to a shared object.

front end (numba): of each file with kernels a module of LLVM's, kept as bitcode by the hash of the file's sources
-> of each folder its modules, joined, optimised and emitted for a target: an object, kept by the hash of its modules
-> the objects linked, with nothing left undefined

Objects for other programs, modules of WebAssembly and libraries for foreign systems are emitted of all modules at once.
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
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from .. import library
from ..kernel import EXPORTED, SYMBOL
from .emission import COMPILE_TARGETS, BuildError, CompileTarget, emit_files, joined
from .header import header
from .objects import undefined
from .rules import violations
from .sources import sources_of
from .wasm_link import linked

HEADER_FILE = "adaptrack.h"
CACHE = "cache"
"""Folder beside the library for modules in bitcode and objects, each named by the hash of what it is made of."""
FOREIGN_LIBRARY_AGE = 3600.0
"""s, for which a library is left alone that this build has not made: another build may have."""
A_DAY = 24.0 * FOREIGN_LIBRARY_AGE
"""s, after which a file of the cache is deleted that no build has used."""


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class _Stages:
    """Reports each stage of a build with the seconds it took."""

    def __init__(self) -> None:
        self._begin = time.monotonic()

    def report(self, text: str) -> None:
        time_now = time.monotonic()
        _say(f"  {time_now - self._begin:5.1f} s  {text}")
        self._begin = time_now


def kernels_of(package: str = "adaptrack.core") -> dict[str, Any]:
    """Return every exported kernel of a package by its name, after the import of all its modules."""
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.startswith("adaptrack.core.build"):
            importlib.import_module(module.name)
    return {name: kernel for name, kernel in EXPORTED.items() if kernel.function.__module__.startswith(f"{package}.")}


def _hash(*parts: object) -> str:
    return hashlib.sha256(json.dumps([str(part) for part in parts]).encode()).hexdigest()[:16]


def _cached(name: str) -> Path | None:
    """Return a file of the cache, marked as used just now, or None where it is not there."""
    path = library.BUILT_FOLDER / CACHE / name
    try:
        os.utime(path)
    except OSError:
        return None
    return path


def modules(kernels: Mapping[str, Any], stages: _Stages) -> list[Path]:
    """Return the files of bitcode with all kernels, one for each source file; those that are missing are compiled.

    Raises BuildError for kernels that break one of the `rules`.
    """
    (library.BUILT_FOLDER / CACHE).mkdir(parents=True, exist_ok=True)
    by_source = defaultdict(list)
    for kernel in kernels.values():
        by_source[Path(kernel.function.__code__.co_filename)].append(kernel)
    paths, compiled, broken = [], 0, []
    for source, kernels_of_source in sorted(by_source.items()):
        place = source.relative_to(library.PACKAGE_FOLDER)
        hashes = [library.source_hashes()[name] for name in [*sources_of(source), "core/build/rules.py"]]
        name = f"{'-'.join(place.with_suffix('').parts)}-{_hash(version('numba'), version('llvmlite'), *hashes)}.bc"
        path = _cached(name)
        if path is None:
            from .numba_functions import module_of

            module = module_of(kernels_of_source)
            broken += violations(str(module))
            path = library.BUILT_FOLDER / CACHE / name
            if not broken:
                _put(path, module.as_bitcode())
            compiled += 1
        paths.append(path)
    if broken:
        raise BuildError("\n".join(broken))
    stages.report(f"{len(kernels)} kernels in {len(paths)} files, of which {compiled} were compiled by numba")
    return paths


def _objects(paths: list[Path], target: str) -> dict[str, list[Path]]:
    """Return the modules of which each object of a library is made, by the name of the object's file in the cache."""
    groups = defaultdict(list)
    for path in paths:
        folder = path.name.rsplit("-", 2)[0] if COMPILE_TARGETS[target].has_parts else "all"
        groups[folder].append(path)
    emitter = library.source_hashes()["core/build/emission.py"]
    return {f"{folder}-{_hash(emitter, version('llvmlite'), target, *(path.name for path in group))}.{target}.o": group
            for folder, group in groups.items()}  # fmt: skip


def linker(target: CompileTarget) -> list[str] | None:
    """The command that makes a library of an object of a target, None where no such linker is installed."""
    if "windows" in target.triple:
        names, options = ["lld-link"], ["/dll", "/noentry", "/nodefaultlib", "/brepro"]
    elif "macosx" in target.triple:
        names, options = ["ld64.lld"], ["-dylib", "-arch", target.triple.split("-")[0]]
        options += ["-platform_version", "macos", "11.0", "11.0", "-install_name", "kernels.dylib"]
    else:
        is_native = target.triple.split("-")[0] == platform.machine()
        names = ["ld", "ld.lld", "lld"] if is_native else ["ld.lld"]
        options = ["-shared", "--build-id=none", "-z", "noexecstack", "-z", "defs"]
    for name in names:
        if shutil.which(name):
            return [name, *options]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", names[0] if len(names) == 1 else "ld.lld", *options]
    return None


def link(objects: Iterable[bytes], command: list[str]) -> bytes:
    """Return the library of object files."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "kernels.dll"  # the name lies in a DLL
        names = []
        for i, content in enumerate(objects):
            names.append(str(Path(folder) / f"kernels{i}.o"))
            Path(names[-1]).write_bytes(content)
        to = [f"/out:{result}"] if "/dll" in command else ["-o", str(result)]
        process = subprocess.run([*command, *to, *names], capture_output=True, text=True)
        if process.returncode != 0:
            raise BuildError(f"{' '.join(command)}: {process.stderr}")
        return result.read_bytes()


def finished(name: str, objects: list[bytes]) -> tuple[str, bytes]:
    """The ending of the file and the content of what is kept of a target: its library, or its object without a linker.

    Raises BuildError for an object that calls what it does not have, and without a linker for this processor.
    """
    left = sorted({symbol for content in objects for symbol in undefined(content) if not symbol.startswith(SYMBOL)})
    if left:
        raise BuildError(
            f"the kernels for {name} call {', '.join(left)}: each belongs into SOFT, or is to be replaced."
        )
    if name == "wasm32":
        return "wasm", linked(objects[0])
    command = linker(COMPILE_TARGETS[name])
    if command is not None:
        ending = {"windows": "dll", "macos": "dylib"}.get(name.split("-")[0], "so")
        return ending, link(objects, command)
    if name in compatible_processors():
        raise BuildError("no linker: install binutils or lld, or the package ziglang (pip install ziglang).")
    if len(objects) > 1:
        raise BuildError(f"no linker for {name}: install lld, or the package ziglang (pip install ziglang).")
    _say(f"  {name}: no linker for it is installed, so its object file is kept")
    return "o", objects[0]


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


def compatible_processors() -> list[str]:
    """The names of all that a processor of this machine's kind may ask for when the library is loaded."""
    name = library.processor()
    return [target for target in COMPILE_TARGETS if target.split("-v")[0] == name.split("-v")[0]] or [name]


def _listed(section: str) -> dict[str, dict[str, str]]:
    """The ``libraries`` or the ``exports`` of the manifest that is there."""
    with suppress(*library.UNUSABLE):
        return dict(library.manifest()[section])
    return {}


def _built(section: str = "libraries") -> dict[str, dict[str, str]]:
    """Return the complete files built from these sources, by target."""
    current = {}
    with suppress(*library.UNUSABLE):
        if library.manifest()["sources"] == library.source_hashes():
            for name, entry in _listed(section).items():
                with suppress(*library.UNUSABLE):
                    library.verified_file(entry)
                    current[name] = entry
    return current


@contextmanager
def _one_at_a_time() -> Iterator[None]:
    """Let a build wait for another one that runs: it may make what this one wants. A killed one lets go."""
    library.BUILT_FOLDER.mkdir(exist_ok=True)
    try:
        import fcntl
    except ImportError:  # on Windows builds may run side by side
        yield
        return
    with (library.BUILT_FOLDER / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def build(names: Iterable[str] = (), portable: bool = False, exports: Iterable[str] = ()) -> None:
    """Compile all kernels into `library.BUILT_FOLDER` for this processor and further ones (of `COMPILE_TARGETS`).

    portable: for all processors of this machine's kind, as a wheel needs them; exports: names of
    `exports.EXPORT_TARGETS`, for which the object file is made that other programs take in.

    Raises BuildError, also for kernels that break one of the `rules`.
    """
    from .exports import EXPORT_TARGETS, shipped

    processors = compatible_processors() if portable else [library.processor()]
    requested: dict[str, tuple[dict[str, Any], list[str]]] = {
        "libraries": (COMPILE_TARGETS, [*processors, *names]),
        "exports": (EXPORT_TARGETS, [*(shipped(processors) if portable else ()), *exports]),
    }
    with _one_at_a_time():
        _build(requested)


def _build(requested: Mapping[str, tuple[Mapping[str, Any], list[str]]]) -> None:
    """Make those of the requested libraries and exports that are not there."""
    jobs = [(section, name) for section, (_, names) in requested.items() for name in dict.fromkeys(names)
            if name not in _built(section)]  # fmt: skip
    if not jobs:
        _say(f"The kernels are compiled already: {library.BUILT_FOLDER}")
        return
    unknown = [
        f"{name} ({', '.join(requested[section][0])})" for section, name in jobs if name not in requested[section][0]
    ]
    if unknown:
        raise BuildError(f"no such processor: {'; '.join(unknown)}.")
    _say(f"Compiling the kernels for {', '.join(name for _, name in jobs)}")
    stages = _Stages()
    kernels = kernels_of()
    if library.source_hashes.__wrapped__() != library.source_hashes():
        raise BuildError("a source was edited while it was read: once more.")
    paths = modules(kernels, stages)
    results: dict[str, dict[str, dict[str, str]]] = {section: {} for section in requested}
    for section, name in jobs:
        stem, ending, content = _emitted(section, name, paths)
        results[section][name] = _write_library(stem, ending, content)
        stages.report(f"{results[section][name]['file']}: {len(content) // 1000} kB")
    _put(library.BUILT_FOLDER / HEADER_FILE, header(kernels.values()).encode())
    sources = {name: sources_of(Path(kernel.function.__code__.co_filename)) for name, kernel in kernels.items()}
    results = {
        section: _built(section) | entries for section, entries in results.items()
    }  # another build may have ended meanwhile
    # who reads the old manifest wants these
    in_use = {
        entry["file"] for section in results for entry in [*results[section].values(), *_listed(section).values()]
    }
    manifest = {"sources": library.source_hashes(), **results, "kernels": sources}
    _put(library.BUILT_FOLDER / library.MANIFEST, json.dumps(manifest, indent=1).encode())
    for pattern, age in {
        "kernels-*": FOREIGN_LIBRARY_AGE,
        "export-*": FOREIGN_LIBRARY_AGE,
        f"{CACHE}/*": A_DAY,
    }.items():
        for path in library.BUILT_FOLDER.glob(pattern):
            if path.name not in in_use and time.time() - path.stat().st_mtime > age:
                path.unlink(missing_ok=True)


def _emitted(section: str, name: str, paths: list[Path]) -> tuple[str, str, bytes]:
    """Return the beginning of the file's name, its ending and the content of a library or an export."""
    from .exports import EXPORT_TARGETS, emit_export

    if section == "exports":
        return f"export-{name}", "wasm" if EXPORT_TARGETS[name].is_module else "o", emit_export(joined(paths), name)
    groups = _objects(paths, name)
    missing = {file: group for file, group in groups.items() if _cached(file) is None}
    if len(missing) > 1:
        with multiprocessing.get_context("spawn").Pool(min(len(missing), os.cpu_count() or 1)) as pool:
            contents = pool.starmap(emit_files, [(group, name, False) for group in missing.values()], chunksize=1)
    else:
        contents = [emit_files(group, name, len(groups) == 1) for group in missing.values()]
    for file, content in zip(missing, contents, strict=True):
        _put(library.BUILT_FOLDER / CACHE / file, content)
    ending, content = finished(name, [(library.BUILT_FOLDER / CACHE / file).read_bytes() for file in groups])
    return f"kernels-{name}", ending, content


def _write_library(stem: str, ending: str, content: bytes) -> dict[str, str]:
    """Write what was made; its entry of the manifest. Another build at the same time has its own name."""
    digest = hashlib.sha256(content).hexdigest()
    path = library.BUILT_FOLDER / f"{stem}-{digest[:12]}.{ending}"
    _put(path, content)
    return {"file": path.name, "sha256": digest}
