"""Statistics of signals: filters by their transfer functions, reversals by counting."""

import math

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.drive.signal_statistics import r79, r79_signals, reversal_rate

T = np.arange(0.0, 60.0, 0.05)


@pytest.mark.parametrize("frequency", [0.1, 0.25, 0.5, 1.0])
def test_a_sine_is_weakened_as_a_butterworth_of_fourth_order_does(frequency):
    t = np.arange(0, 60, 0.01)
    filtered, jerk = r79_signals(t, 2.0 * np.sin(2 * np.pi * frequency * t))
    gain = 2.0 / math.sqrt(1 + (frequency / 0.5) ** 8)
    assert np.abs(filtered[3000:]).max() == pytest.approx(gain, rel=2e-3)
    mean_of_slope = 2 * math.sin(math.pi * frequency * 0.5) / 0.5  # of a unit sine over 0.5 s
    assert np.abs(jerk[3000:]).max() == pytest.approx(gain * mean_of_slope, rel=2e-3)


def test_a_steady_acceleration_has_no_jerk_and_a_ramp_its_slope():
    assert r79(T, np.full(T.size, 3.0)) == pytest.approx((3.0, 0.0), abs=1e-9)
    _, jerk = r79_signals(T, 0.5 * T)
    assert jerk[-1] == pytest.approx(0.5, rel=1e-6)


def test_the_sampling_of_the_record_hardly_matters():
    slow, fast = (np.arange(0, 30, step) for step in (0.05, 0.01))
    assert r79(slow, np.sin(slow)) == pytest.approx(r79(fast, np.sin(fast)), rel=2e-3)


@pytest.mark.parametrize(("amplitude", "counted"), [(1.4, 0.0), (1.6, 24.0)])
def test_a_sine_reverses_twice_a_cycle_when_it_swings_by_more_than_the_gap(amplitude, counted):
    angle = math.radians(amplitude) * np.sin(2 * np.pi * 0.2 * np.arange(0, 300, 0.05))
    rates = reversal_rate(np.arange(0, 300, 0.05), angle)  # peak to peak 2.8 and 3.2 degrees, gap 3
    assert rates == pytest.approx(counted, abs=0.3)


def test_what_is_faster_than_the_filter_is_not_steering():
    slow = math.radians(5) * np.sin(2 * np.pi * 0.1 * T)
    fast = math.radians(5) * np.sin(2 * np.pi * 5.0 * T)
    assert reversal_rate(T, slow + fast) == reversal_rate(T, slow)
    assert reversal_rate(T, fast) == 0.0


def test_a_cut_off_beyond_half_the_sampling_is_refused():
    with pytest.raises(InvalidInput, match="below half the rate"):
        reversal_rate(T, T, cut_off=20.0)
