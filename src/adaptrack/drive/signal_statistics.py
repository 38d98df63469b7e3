"""Statistics of one signal: mean square, extremes, steering reversals, lateral comfort as UN R79 evaluates it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput

Array = NDArray[np.float64]

REVERSAL_GAP, REVERSAL_CUT_OFF, REVERSAL_ORDER = math.radians(3.0), 0.6, 2
"""Steering reversals: the gap (rad, at the steering wheel), the cut-off (Hz) and the order of the low-pass."""
SAMPLING, COMFORT_CUT_OFF, COMFORT_ORDER, JERK_WINDOW = 100.0, 0.5, 4, 0.5
"""UN Regulation No. 79: sampling (Hz), Butterworth cut-off (Hz) and order, moving average of the jerk (s)."""


def mean_square(values: Array) -> float:
    """Mean of the squares; NaN of nothing, infinite when a value is not finite (or its square overflows)."""
    if not values.size:
        return math.nan
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(np.mean(np.square(values)))
    return mean if math.isfinite(mean) else math.inf


def largest_magnitude(values: Array) -> float:
    """Largest magnitude; NaN of nothing, infinite when a value is not finite."""
    if not values.size:
        return math.nan
    return float(np.max(np.abs(values))) if np.isfinite(values).all() else math.inf


def largest_known(values: Array) -> float:
    """The largest value that is not NaN; NaN when there is none."""
    measured = values[~np.isnan(values)]
    return float(np.max(measured)) if measured.size else math.nan


def percentile_95(values: Array) -> float:
    """95th percentile of the magnitudes; infinite when a value is not finite."""
    return float(np.percentile(np.abs(values), 95.0)) if np.isfinite(values).all() else math.inf


def reversal_rate(
    t: ArrayLike, steering: ArrayLike, gap: float = REVERSAL_GAP, cut_off: float = REVERSAL_CUT_OFF
) -> float:
    """Reversals per minute of a steering-wheel angle (n,) in rad at times t (n,) in s.

    The angle is low-pass filtered (Butterworth of second order, forward and backward, no phase). A reversal is a pair
    of its stationary points between which it rises, or falls, by more than `gap` (rad), each counted once. SAE
    J2944_201506, after G. Markkula and J. Engstroem, *A steering wheel reversal rate metric for assessing effects of
    visual and cognitive secondary task load*, 13th ITS World Congress, 2006 (gap 3 degrees at 0.6 Hz for the larger
    corrections; 0.1 degrees at 2 Hz for the smaller ones). The standard itself was not read: this follows the article's
    published program.

    Raises
    ------
    InvalidInput
        When the sampling is too slow for the cut-off (Hz).
    """
    from scipy.signal import butter, filtfilt

    t, steering, rate = _resample(np.asarray(t, dtype=float), np.asarray(steering, dtype=float))
    if not 0.0 < cut_off < 0.5 * rate:
        raise InvalidInput(f"reversal_rate: cut_off = {cut_off!r} Hz: must be below half of the sampling, {rate:g} Hz.")
    b, a = butter(REVERSAL_ORDER, cut_off, fs=rate)
    smooth = filtfilt(b, a, steering, padlen=min(t.size - 1, 3 * max(len(a), len(b))))
    change = np.diff(smooth, prepend=smooth[0])
    stationary = np.flatnonzero((change[:-1] * change[1:] < 0.0) | (change[:-1] == 0.0))
    turning = smooth[stationary]
    return (_rises(turning, gap) + _rises(-turning, gap)) * 60.0 / float(t[-1] - t[0])


def _rises(turning: Array, gap: float) -> int:
    """How often the values at the stationary points rise by more than the gap from the lowest one since the last."""
    count, lowest = 0, math.inf
    for value in turning:
        if value - lowest > gap:
            count, lowest = count + 1, value
        lowest = min(lowest, value)
    return count


def r79(t: ArrayLike, lateral_acceleration: ArrayLike) -> tuple[float, float]:
    """The largest lateral acceleration (m/s^2) and jerk (m/s^3) as UN Regulation No. 79 evaluates them.

    Sampled at 100 Hz, lateral acceleration filtered by a Butterworth filter of fourth order with a cut-off of 0.5 Hz,
    jerk the moving average over 500 ms of its derivative (Revision 4, 03 series of amendments with Supplement 2, Annex
    8). The text does not say how the filter starts or whether it is run forward and backward: here it runs forward,
    from the steady state of the first sample. Records with another sampling are resampled to 100 Hz by straight lines.
    """
    filtered, jerk = r79_signals(t, lateral_acceleration)
    return largest_magnitude(filtered), largest_magnitude(jerk)


def r79_signals(t: ArrayLike, lateral_acceleration: ArrayLike) -> tuple[Array, Array]:
    """The two signals whose largest magnitudes `r79` returns, at 100 Hz; (m,) m/s^2 and (m - 50,) m/s^3.

    A record that is shorter than the moving average has the mean jerk over all of it.
    """
    from scipy.signal import butter, sosfilt, sosfilt_zi

    _, samples, rate = _resample(np.asarray(t, dtype=float), np.asarray(lateral_acceleration, dtype=float), SAMPLING)
    sections = butter(COMFORT_ORDER, COMFORT_CUT_OFF, fs=rate, output="sos")
    filtered, _ = sosfilt(sections, samples, zi=sosfilt_zi(sections) * samples[0])
    window = min(round(JERK_WINDOW * rate), filtered.size - 1)
    return filtered, (filtered[window:] - filtered[:-window]) * rate / window  # the mean derivative is a difference


def _resample(t: Array, values: Array, rate: float | None = None) -> tuple[Array, Array, float]:
    """Equidistant times, the values there by straight lines, and the rate (Hz), by default the mean one."""
    rate = (t.size - 1) / float(t[-1] - t[0]) if rate is None else rate
    even = t[0] + np.arange(max(2, math.floor((t[-1] - t[0]) * rate + 1e-6) + 1)) / rate
    return even, np.interp(even, t, values), rate
