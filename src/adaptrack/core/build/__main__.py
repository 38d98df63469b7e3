"""Compile the kernels: ``python -m adaptrack.core.build [--portable] [PROCESSOR ...]``, see `library`."""

import os

if __name__ == "__main__":
    os.environ.setdefault("ADAPTRACK_KERNELS", "jit")  # read when the library is imported
    from .library import main

    main()
