"""Write the C library that the C++ node is built with: the controller that the Python node would have.

python3 -m adaptrack_ros.export_controller config/follower.yaml ../adaptrack_ros_cpp/controller [TARGET ...]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import adaptrack as at
from adaptrack_ros.follower import Follower, Parameters


def export(parameters: Parameters, folder: str | Path, targets: Sequence[str] = ()) -> Any:
    """Write it. The node itself reads the parameters that the export does not use.

    These are `vehicle`, `profile`, `command_delay`, `oldest_sample`, `furthest`, `speed_control` and `acceleration`.

    targets: processors as `adaptrack.export_c` names them, this one without any.

    Raises
    ------
    adaptrack.InvalidInput
        When a parameter is not possible, or the kernels for this processor are not at hand.
    adaptrack.StorageError
        When a file cannot be written.
    """
    follower, road = Follower(parameters), at.load_road("country")
    return at.export_c(
        follower.controller(), folder, targets=targets, profile=follower.profile, furthest=parameters.furthest,
        road=road, plan=at.plan_speed(road, follower.car, follower.comfort), speed=follower.speed_control(),
    )  # fmt: skip


def main() -> None:
    """Read the parameter file, write the folder."""
    import yaml

    if len(sys.argv) < 3:
        sys.exit(f"usage: {sys.argv[0]} follower.yaml FOLDER [TARGET ...]")
    held = yaml.safe_load(Path(sys.argv[1]).read_text(encoding="utf-8"))
    export(Parameters(**held["adaptrack_follower"]["ros__parameters"]), sys.argv[2], sys.argv[3:])


if __name__ == "__main__":
    main()
