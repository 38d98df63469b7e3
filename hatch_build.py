"""Building a wheel compiles the kernels into it; an editable installation takes what `make install` compiles."""

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

BUILT = "src/adaptrack/core/built"
FMUS = "src/adaptrack/export/built"
LINKER = "ziglang==0.17.1"


class Kernels(BuildHookInterface):
    """The library of the kernels, for any Python 3 on this platform."""

    def dependencies(self):
        """A linker, where the system has none; with an isolated build it goes when the wheel is made."""
        return [] if shutil.which("ld") or shutil.which("ld.lld") else [LINKER]

    def initialize(self, version, build_data):
        if version == "editable":
            return
        root = Path(self.root)
        places = {**os.environ, "PYTHONPATH": str(root / "src")}
        build = [sys.executable, "-m", "adaptrack.core.build", "--portable", "--export", "windows-x86-64-v3"]
        subprocess.run(build, env=places, check=True)
        subprocess.run([sys.executable, "-m", "adaptrack.export.fmu_build"], env=places, check=True)
        sys.path.insert(0, str(root / "src"))
        from adaptrack.core.library import manifest, processor

        own = processor().split("-v")[0]
        files = [each["file"] for name, each in manifest()["libraries"].items() if name.split("-v")[0] == own]
        from adaptrack.core.build.exports import shipped

        files += [manifest()["exports"][name]["file"] for name in shipped(list(manifest()["libraries"]))]
        files += ["manifest.json", "adaptrack.h"]
        build_data["artifacts"] += [f"/{BUILT}/{name}" for name in files] + [f"/{FMUS}/*"]
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{self.platforms()}"

    @staticmethod
    def platforms():
        """A library that calls nothing of the system's fits every Linux of its processor, glibc's and musl's."""
        machine = platform.machine()
        if sys.platform == "linux":
            return f"manylinux_2_17_{machine}.manylinux2014_{machine}.musllinux_1_1_{machine}"
        if sys.platform == "darwin":  # Python's own may be one for two processors
            return f"macosx_11_0_{machine}"
        return sysconfig.get_platform().replace("-", "_")
