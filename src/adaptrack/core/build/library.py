"""Build the library of the kernels by way of C: ``python -m adaptrack.core.build [PROCESSOR ...]``.

For ``wasm32`` the library is a WebAssembly module. ``wasm32-page`` has the kernels of the driving page alone; with it
the library of this processor is built, too, where it is in use and not there.

``--portable``: for all processors of this machine's kind, and for the page, as a wheel holds them.
``--check``: the library ``PROCESSOR-checked``, which ``ADAPTRACK_PROCESSOR`` chooses: every index is checked, and the
process ends at one that is beyond its array; ``calls_of_NAME`` counts the calls of each kernel.
``--sanitize``: the library ``PROCESSOR-sanitized`` of this processor, compiled by GCC, which reports each access beyond
an array of NumPy's.
``--sources FOLDER``: write the files in C, too.
"""

import argparse
import hashlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from .. import library

MAX_UNUSED_AGE = 86400.0
"""s, after which a library or an object is deleted that no build has used."""


def build(processors: list[str], variant: str = "", sources: Path | None = None) -> None:
    """Write the libraries of these processors, and the manifest beside them.

    variant: empty, "checked" or "sanitized"; sources: a folder for the files in C.

    Raises KernelError for a kernel beyond the subset, CompileError where the compiler refuses one.
    """
    from .c_files import SOFT_KERNELS, CFile, c_files
    from .compile import CompileError, write_sources
    from .header import header
    from .sources import kernels_of, sources_of
    from .units import PAGE_KERNELS

    begin = time.monotonic()

    def report(text: str) -> None:
        print(f"  {time.monotonic() - begin:5.1f} s  {text}", file=sys.stderr, flush=True)

    hashes = library.source_hashes()
    kernels = kernels_of()
    library.BUILT_FOLDER.mkdir(parents=True, exist_ok=True)
    entries = _entries(hashes)
    if processors == [library.PAGE] and library.processor() not in entries:
        processors = [library.processor(), library.PAGE]
    translated: dict[tuple[str, ...], dict[str, CFile]] = {}
    for processor in processors:
        exports = PAGE_KERNELS if processor == library.PAGE else tuple(kernels)
        if exports not in translated:
            needed = {kernel: kernels[kernel] for kernel in (*exports, *SOFT_KERNELS)}
            translated[exports] = c_files(needed, variant == "checked")
            report(f"{len(exports)} kernels in {len(translated[exports])} files of C")
        files = translated[exports]
        if sources is not None:
            write_sources(files, sources)
        name = f"{processor}-{variant}" if variant else processor
        with tempfile.TemporaryDirectory(dir=library.BUILT_FOLDER) as workshop:
            linked = Path(workshop) / "kernels.dll"  # Windows knows a library by the name under which it was linked
            summary = _make_library(processor.removesuffix("-page"), files, exports, variant, linked)
            digest = hashlib.sha256(linked.read_bytes()).hexdigest()
            ending = "wasm" if processor.startswith("wasm") else "so"
            path = library.BUILT_FOLDER / f"kernels-{name}-{digest[:12]}.{ending}"
            os.replace(linked, path)
        entries[name] = {"file": path.name, "sha256": digest}
        report(f"{path.name}: {path.stat().st_size // 1000} kB; {summary}")
    names = {name: sources_of(Path(kernel.function.__code__.co_filename)) for name, kernel in kernels.items()}
    if library.source_hashes.__wrapped__() != hashes:
        raise CompileError("the sources were edited while they were compiled: run it again")
    entries = _entries(hashes) | entries  # of a build that has ended meanwhile
    (library.BUILT_FOLDER / "adaptrack.h").write_text(header(kernels.values()), encoding="utf-8")
    content = {"sources": hashes, "libraries": entries, "kernels": names}
    written = library.BUILT_FOLDER / f"manifest-{os.getpid()}"
    written.write_text(json.dumps(content, indent=1), encoding="utf-8")
    os.replace(written, library.BUILT_FOLDER / library.MANIFEST)
    in_use = {entry["file"] for entry in entries.values()}
    for path in [*library.BUILT_FOLDER.glob("kernels-*"), *library.BUILT_FOLDER.glob("cache/*")]:
        if path.name not in in_use and time.time() - path.stat().st_mtime > MAX_UNUSED_AGE:
            path.unlink(missing_ok=True)


def _make_library(processor: str, files: Any, exports: tuple[str, ...], variant: str, path: Path) -> str:
    """Compile and link the library of a processor; in words, what was compiled."""
    from .compile import compile_objects, link, link_by_gcc, link_module

    if variant == "sanitized":
        link_by_gcc(files, path)
        return "compiled by GCC"
    objects, compiled_count = compile_objects(files, processor, library.BUILT_FOLDER / "cache", variant == "checked")
    if processor == "wasm32":
        link_module(objects, exports, path)
    else:
        link(objects, processor, path, is_stripped=not variant)
    return f"{compiled_count} of {len(objects)} objects were compiled"


def _entries(hashes: dict[str, str]) -> dict[str, dict[str, str]]:
    """The libraries that are built of these sources already."""
    try:
        listed = library.manifest()
    except library.UNUSABLE:
        return {}
    return listed["libraries"] if listed["sources"] == hashes else {}


def main() -> None:
    """Build what the command line asks for."""
    library.source_hashes()  # of the sources before they are imported
    from .compile import PROCESSORS, CompileError
    from .translate import KernelError

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("processors", nargs="*", help="processors, by default this one's")
    parser.add_argument("--portable", action="store_true", help="as a wheel needs them")
    parser.add_argument("--check", action="store_const", dest="variant", const="checked", help="check every index")
    parser.add_argument("--sanitize", action="store_const", dest="variant", const="sanitized", help="check addresses")
    parser.add_argument("--sources", type=Path, help="folder for the files in C")
    arguments = parser.parse_args()
    names = arguments.processors or [library.processor()]
    if arguments.portable:
        kind = library.processor().split("-v")[0]
        names = [*(name for name in PROCESSORS if name.split("-v")[0] == kind), library.PAGE]
    try:
        build(names, arguments.variant or "", arguments.sources)
    except (KernelError, CompileError, OSError) as error:
        sys.exit(f"adaptrack.core.build: {error}")
