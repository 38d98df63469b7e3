"""Write the C library that the C++ node is built with: the controller that the Python node would have.

python3 -m adaptrack_ros.export_controller config/follower.yaml ../adaptrack_ros_cpp/controller
"""

from __future__ import annotations

import sys
from pathlib import Path

from adaptrack.export.c_library import Exported, export_c
from adaptrack_ros.follower import Follower, Parameters


def export(parameters: Parameters, folder: str | Path) -> Exported:
    """Of `vehicle`, `profile`, `command_delay`, `oldest_sample` and `furthest`; the node itself reads the others.

    Raises
    ------
    adaptrack.InvalidInput
        When a parameter is not possible, or the kernels for this processor are not at hand.
    adaptrack.StorageError
        When a file cannot be written.
    """
    follower = Follower(parameters)
    return export_c(follower.controller(), folder, profile=follower.profile, furthest=parameters.furthest)


def main() -> None:
    """Read the parameter file, write the folder."""
    import yaml

    if len(sys.argv) != 3:
        sys.exit(f"usage: {sys.argv[0]} follower.yaml FOLDER")
    held = yaml.safe_load(Path(sys.argv[1]).read_text(encoding="utf-8"))
    export(Parameters(**held["adaptrack_follower"]["ros__parameters"]), sys.argv[2])


if __name__ == "__main__":
    main()
