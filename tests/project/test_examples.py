"""The example of a simulator drives. Those of ROS 2 and CARLA have tests of their own."""

from __future__ import annotations

import re
import runpy

from foreign_loop import example


def test_the_plain_simulator_drives(capsys):
    assert example("plain_simulator").main(seconds=12.0) < 0.03
    assert "RMS 0.0" in capsys.readouterr().out


def test_sensors_with_their_own_rates_and_late_poses_drive_as_the_docs_say(project, capsys):
    runpy.run_path(str(project / "examples" / "asynchronous_loop.py"))
    rms, largest = map(
        float, re.match(r"([\d.]+) cm RMS, largest ([\d.]+) cm", line := capsys.readouterr().out).groups()
    )
    assert rms < 5.0  # the noise of one pose
    assert largest < 20.0
    assert line.endswith("suspect: 0\n")
    assert f"\n{line}" in (project / "docs" / "tracker.md").read_text()
