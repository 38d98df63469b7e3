"""The example of a simulator drives. Those of ROS 2 and CARLA have tests of their own."""

from __future__ import annotations

from foreign_loop import example


def test_the_plain_simulator_drives(capsys):
    assert example("plain_simulator").main(seconds=12.0) < 0.03
    assert "RMS 0.0" in capsys.readouterr().out
