"""Building a wheel compiles the kernels into it; an editable installation takes what `make install` compiles."""

import json
import os
import platform
import subprocess
import sys
import sysconfig
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

BUILT = "src/adaptrack/core/built"


class Kernels(BuildHookInterface):
    """The library of the kernels, for any Python 3 on this platform."""

    def initialize(self, version, build_data):
        if version == "editable":
            return
        root = Path(self.root)
        paths = [str(root / "src"), *filter(None, [os.environ.get("PYTHONPATH")])]
        places = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        subprocess.run([sys.executable, "-m", "adaptrack.core.build", "--portable"], env=places, check=True)
        libraries = json.loads((root / BUILT / "manifest.json").read_text(encoding="utf-8"))["libraries"]
        own = self.family(next(name for name in libraries if not name.startswith("wasm32")))
        files = [entry["file"] for name, entry in libraries.items() if self.family(name) in (own, "wasm32-page")]
        files += ["manifest.json", "adaptrack.h"]
        build_data["artifacts"] += [f"/{BUILT}/{name}" for name in files]
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{self.platforms()}"

    @staticmethod
    def family(name):
        """The processors of a kind: all versions of x86-64."""
        return name.split("-v")[0]

    @staticmethod
    def platforms():
        """A library that calls nothing of the system's fits every Linux of its processor, glibc's and musl's."""
        machine = platform.machine()
        if sys.platform == "linux":
            return f"manylinux_2_17_{machine}.manylinux2014_{machine}.musllinux_1_1_{machine}"
        if sys.platform == "darwin":  # Python's own may be one for two processors
            return f"macosx_11_0_{machine}"
        return sysconfig.get_platform().replace("-", "_")
