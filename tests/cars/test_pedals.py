"""Pedal maps: forces to pedals and back, and tables that are refused."""

from __future__ import annotations

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import COASTING_SHARE, PedalMap

MAP = PedalMap(
    speed=[0.0, 3.0, 20.0], throttle=[0.0, 0.1, 0.4, 1.0],
    force=[[400.0, 400.0, 3000.0, 7000.0], [-300.0, -100.0, 2000.0, 5000.0], [-600.0, -500.0, 500.0, 2500.0]],
    brake=[0.0, 0.1, 0.5, 0.9], brake_force=[0.0, 0.0, 4000.0, 10000.0],
)  # fmt: skip
BAND = COASTING_SHARE * 10000.0


def test_pedals_of_a_force_give_the_force_but_in_the_band_below_coasting_where_they_coast() -> None:
    for speed in (-1.0, 0.0, 1.5, 12.0, 30.0):
        coasting, largest = MAP.force_at(0.0, 0.0, speed), MAP.force_at(1.0, 0.0, speed)
        for force in np.linspace(coasting - 9000.0, largest, 300):
            throttle, brake = MAP.positions(force, speed)
            assert throttle * brake == 0.0
            expected = coasting if coasting - BAND <= force < coasting else force
            if not -2.0 * BAND < force - coasting < -BAND:
                assert MAP.force_at(throttle, brake, speed) == pytest.approx(expected, abs=1e-6)
        assert MAP.positions(1e6, speed) == (1.0, 0.0)
        assert MAP.positions(-1e6, speed) == (0.0, 0.9)


def test_hold_pressure_of_a_standing_car_is_a_brake_pedal_that_also_holds_its_creep() -> None:
    throttle, brake = MAP.positions(0.0, 0.0, hold=1600.0)
    assert throttle == 0.0
    assert MAP.force_at(throttle, brake, 0.0) == pytest.approx(-1600.0)


@pytest.mark.parametrize(("changes", "message"), [
    ({"throttle": [0.0, 10.0, 40.0, 100.0]}, "throttle must begin with 0 and end at most at 1"),
    ({"speed": [0.0, 3.0, 3.0]}, "speed must begin .* rise from value to value"),
    ({"force": MAP.force[:2]}, "a row for each speed"),
    ({"force": [*MAP.force[:2], (0.0, 5.0, 4.0, 9.0)]}, "force at 20 m/s is 0, 5, 4, 9 N: .* none below"),
    ({"brake_force": [0.0, 10.0]}, "brake_force is 0, 10 N: give a value for each position of brake"),
])  # fmt: skip
def test_a_table_that_is_no_map_is_refused_with_its_place(changes, message) -> None:
    with pytest.raises(InvalidInput, match=message):
        MAP.replace(**changes)
