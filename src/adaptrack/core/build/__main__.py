"""Compile the kernels into the library: ``python -m adaptrack.core.build [PROCESSOR ...]``.

Without arguments for this machine; for the named processors, too, otherwise.
"""

import os
import sys

os.environ["ADAPTRACK_KERNELS"] = "jit"

from .library import BuildError, build

if __name__ == "__main__":
    try:
        build(sys.argv[1:])
    except (BuildError, OSError) as error:
        sys.exit(f"adaptrack.core.build: {error}")
