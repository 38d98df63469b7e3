"""Compile the kernels into the library: ``python -m adaptrack.core.build [--portable] [PROCESSOR ...]``.

For this processor, and for those that are named; portable: for all processors of this machine's kind.
"""

import os
import sys

os.environ["ADAPTRACK_KERNELS"] = "jit"

from .. import library

if __name__ == "__main__":
    library.source_hashes()  # of the sources before they are imported
    from .library import BuildError, build

    try:
        build([each for each in sys.argv[1:] if each != "--portable"], "--portable" in sys.argv)
    except (BuildError, OSError) as error:
        sys.exit(f"adaptrack.core.build: {error}")
