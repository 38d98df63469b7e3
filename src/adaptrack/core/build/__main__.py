"""Compile the kernels into the library: ``python -m adaptrack.core.build [PROCESSOR ...]``."""

import os
import sys

os.environ["ADAPTRACK_KERNELS"] = "jit"

from .library import TARGETS, BuildError, build

if __name__ == "__main__":
    asked = sys.argv[1:]
    unknown = [each for each in asked if each not in TARGETS]
    if unknown:
        sys.exit(f"{', '.join(unknown)}: no such processor; there are {', '.join(TARGETS)}.")
    try:
        build(asked)
    except (BuildError, OSError) as error:
        sys.exit(f"adaptrack.core.build: {error}")
