"""Compile the kernels: ``python -m adaptrack.core.build [--portable] [PROCESSOR ...] [--export TARGET ...]``.

Into the library for this processor, and for those that are named; portable: for all processors of this machine's kind.
export: into the object files that other programs take in, for the targets that are named or for ``all``; with
``--archive FOLDER`` at the end they are packed.
"""

import os
import sys

os.environ["ADAPTRACK_KERNELS"] = "jit"

from pathlib import Path

from .. import library

if __name__ == "__main__":
    library.source_hashes()  # of the sources before they are imported
    from .emission import BuildError
    from .exports import EXPORT_TARGETS, archive
    from .library import build

    arguments, _, folder = " ".join(sys.argv[1:]).partition("--archive")
    arguments, _, exports = arguments.partition("--export")
    try:
        names = [argument for argument in arguments.split() if argument != "--portable"]
        build(names, "--portable" in arguments, list(EXPORT_TARGETS) if "all" in exports.split() else exports.split())
        if folder:
            print(archive(Path(folder.strip())))
    except (BuildError, OSError) as error:
        sys.exit(f"adaptrack.core.build: {error}")
