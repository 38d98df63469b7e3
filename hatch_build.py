"""Building a wheel compiles the kernels into it; an editable installation takes what `make install` compiles."""

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Kernels(BuildHookInterface):
    """The library of the kernels, for any Python 3 on this platform."""

    def initialize(self, version, build_data):
        if version == "editable":
            return
        places = {**os.environ, "PYTHONPATH": str(Path(self.root) / "src")}
        subprocess.run([sys.executable, "-m", "adaptrack.core.build"], env=places, check=True)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"
