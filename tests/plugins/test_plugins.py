"""The plug-ins keep to the contracts that docs/extending.md lists, and commands take them."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "plugins"
CONTRACTS = {
    "cars.plant", "cars.vehicle", "control.controllers.base", "control.controllers.belief",
    "control.controllers.informed", "control.controllers.inputs", "control.controllers.limits",
    "control.controllers.registry", "control.controllers.setup", "control.kalman", "control.models", "control.qp",
    "control.speed_control", "core.public", "drive.drivers", "drive.planner", "road", "road.road_ahead",
    "scenario.profile",
}  # fmt: skip
"""Modules that a plug-in may import, in addition to those of `base`."""


def test_plugins_import_the_contracts_alone():
    imports = {
        node.module.removeprefix("adaptrack.")
        for file in FOLDER.glob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("adaptrack")
    }
    assert {module for module in imports if not module.startswith("base.")} <= CONTRACTS


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", ["drive country --length 100", "tune paper --road country --length 100 --runs 20 --out tuned"]
)
def test_commands_drive_a_controller_of_a_plugin(tmp_path, command):
    line = [*command.split(), "--plugin", "mppi", "--controller", "mppi", "--json"]
    environment = {**os.environ, "PYTHONPATH": str(FOLDER)}
    process = subprocess.run(
        [sys.executable, "-m", "adaptrack", *line], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    assert json.loads(process.stdout)
