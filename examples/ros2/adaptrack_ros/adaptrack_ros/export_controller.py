"""Write the C library that the C++ node is built with: the controller that the Python node would have.

python3 -m adaptrack_ros.export_controller config/follower.yaml ../adaptrack_ros_cpp/controller
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import adaptrack as at
from adaptrack_ros.follower import Follower, Parameters


def export(parameters: Parameters, folder: str | Path) -> Any:
    """Write it. The node itself reads the parameters that the export does not use.

    These are `vehicle`, `profile`, `command_delay`, `oldest_sample`, `furthest`, `speed_control`, `acceleration`,
    `follow` and, for trajectories, `top_speed`.

    Raises
    ------
    adaptrack.InvalidInput
        When a parameter is not possible.
    adaptrack.StorageError
        When a file cannot be written.
    """
    follower, road = Follower(parameters), at.load_road("country")
    return at.export_c(
        follower.controller(), folder, profile=follower.profile, furthest=parameters.furthest, road=road,
        plan=at.plan_speed(road, follower.car, follower.comfort), speed=follower.speed_control(),
        following=follower.following,
    )  # fmt: skip


def main() -> None:
    """Read the parameter file, write the folder."""
    import yaml

    if len(sys.argv) != 3:
        sys.exit("usage: python3 -m adaptrack_ros.export_controller follower.yaml FOLDER")
    try:
        held = yaml.safe_load(Path(sys.argv[1]).read_text(encoding="utf-8"))
        export(Parameters(**held["adaptrack_follower"]["ros__parameters"]), sys.argv[2])
    except (OSError, at.AdaptrackError) as error:
        sys.exit(f"export_controller: {error}")


if __name__ == "__main__":
    main()
