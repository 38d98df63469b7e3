"""Statistics of one signal: mean square, extremes, steering reversals and lateral comfort by UN R79."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

REVERSAL_GAP, REVERSAL_CUT_OFF, REVERSAL_ORDER = math.radians(3.0), 0.6, 2
"""Steering reversals: smallest steering-wheel movement (rad), cut-off (Hz) and order of the low-pass filter."""
SAMPLING, COMFORT_CUT_OFF, COMFORT_ORDER, JERK_WINDOW = 100.0, 0.5, 4, 0.5
"""UN Regulation No. 79: sampling rate (Hz), Butterworth cut-off (Hz) and order, averaging window of the jerk (s)."""


def mean_square(values: Array) -> float:
    """Mean of the squares; NaN for an empty array, infinite if a value is not finite or its square overflows."""
    if not values.size:
        return math.nan
    with np.errstate(invalid="ignore", over="ignore"):
        mean = float(np.mean(np.square(values)))
    return mean if math.isfinite(mean) else math.inf


def largest_magnitude(values: Array) -> float:
    """Largest magnitude; NaN for an empty array, infinite if a value is not finite."""
    if not values.size:
        return math.nan
    return float(np.max(np.abs(values))) if np.isfinite(values).all() else math.inf


def largest_known(values: Array) -> float:
    """Largest value that is not NaN; NaN if all values are NaN."""
    measured = values[~np.isnan(values)]
    return float(np.max(measured)) if measured.size else math.nan


def finite_length(*signals: Array) -> int:
    """Number of instants before the first one at which a signal, (n,) or (n, m), is not finite."""
    is_finite = np.asarray(np.isfinite(np.column_stack(signals)).all(axis=1))
    return is_finite.size if is_finite.all() else int(is_finite.argmin())


def percentile_95(values: Array) -> float:
    """95th percentile of the magnitudes; infinite if a value is not finite."""
    return float(np.percentile(np.abs(values), 95.0)) if np.isfinite(values).all() else math.inf


def reversal_rate(
    t: ArrayLike, steering: ArrayLike, gap: float = REVERSAL_GAP, cut_off: float = REVERSAL_CUT_OFF
) -> float:
    """Reversals per minute of a steering-wheel angle (n,) in rad at times t (n,) in s.

    The angle is low-pass filtered by a second-order Butterworth filter, forward and backward, without phase shift. A
    reversal is a rise or a fall by more than `gap` (rad) between stationary points of the filtered angle. Raises
    InvalidInput when the sampling rate is too low for the cut-off frequency (Hz).

    The measure is that of SAE J2944_201506. The text of the standard was not available; the implementation follows the
    program by G. Markkula and J. Engstroem, *A steering wheel reversal rate metric for assessing effects of visual and
    cognitive secondary task load*, 13th ITS World Congress, 2006. The article uses 3 degrees at 0.6 Hz for large
    corrections and 0.1 degrees at 2 Hz for small ones.
    """
    from scipy.signal import filtfilt

    t, steering, rate = _resample(np.asarray(t, dtype=float), np.asarray(steering, dtype=float))
    if not 0.0 < cut_off < 0.5 * rate:
        raise InvalidInput(f"reversal_rate: cut_off = {cut_off!r} Hz: must be below half the rate {rate:g} Hz.")
    b, a = np.split(_low_pass(REVERSAL_ORDER, cut_off, rate)[0], 2)
    smooth = filtfilt(b, a, steering, padlen=min(t.size - 1, 3 * max(len(a), len(b))))
    change = np.diff(smooth, prepend=smooth[0])
    stationary = np.flatnonzero((change[:-1] * change[1:] < 0.0) | (change[:-1] == 0.0))
    turning = smooth[stationary]
    return (_rises(turning, gap) + _rises(-turning, gap)) * 60.0 / float(t[-1] - t[0])


def _rises(turning: Array, gap: float) -> int:
    """Count the rises by more than `gap` above the lowest stationary point since the previous counted rise."""
    count, lowest = 0, math.inf
    for value in turning:
        if value - lowest > gap:
            count, lowest = count + 1, value
        lowest = min(lowest, value)
    return count


def r79(t: ArrayLike, lateral_acceleration: ArrayLike) -> tuple[float, float]:
    """Return the largest lateral acceleration (m/s^2) and jerk (m/s^3) as evaluated by UN Regulation No. 79.

    The lateral acceleration is sampled at 100 Hz and filtered by a fourth-order Butterworth filter with a cut-off of
    0.5 Hz. The jerk is the moving average of its derivative over 500 ms (Revision 4, 03 series of amendments with
    Supplement 2, Annex 8). The regulation does not specify the initial state and the direction of the filter. Here it
    runs forward from the steady state of the first sample. Records with a different sampling rate are interpolated
    linearly to 100 Hz.
    """
    filtered, jerk = r79_signals(t, lateral_acceleration)
    return largest_magnitude(filtered), largest_magnitude(jerk)


def r79_signals(t: ArrayLike, lateral_acceleration: ArrayLike) -> tuple[Array, Array]:
    """Return filtered lateral acceleration (m,) in m/s^2 and averaged jerk (m - 50,) in m/s^3 at 100 Hz, as in `r79`.

    If the record is shorter than the averaging window, the jerk is averaged over the whole record.
    """
    from scipy.signal import sosfilt, sosfilt_zi

    _, samples, rate = _resample(np.asarray(t, dtype=float), np.asarray(lateral_acceleration, dtype=float), SAMPLING)
    sections = _low_pass(COMFORT_ORDER, COMFORT_CUT_OFF, rate)
    filtered, _ = sosfilt(sections, samples, zi=sosfilt_zi(sections) * samples[0])
    window = min(round(JERK_WINDOW * rate), filtered.size - 1)
    return filtered, (filtered[window:] - filtered[:-window]) * rate / window  # mean derivative over the window


def _low_pass(order: int, cut_off: float, rate: float) -> Array:
    """Sections [b, a] (order/2, 6) of a Butterworth low-pass of even order, by the bilinear transform."""
    k, sections = portable.tan(math.pi * cut_off / rate), []
    for i in range(order // 2):
        damping = 2.0 * portable.sin(math.pi * (2 * i + 1) / (2 * order)) * k
        a = np.array([1.0 + damping + k * k, 2.0 * (k * k - 1.0), 1.0 - damping + k * k])
        sections.append(np.concatenate([k * k * np.array([1.0, 2.0, 1.0]), a]) / a[0])
    return np.array(sections)


def _resample(t: Array, values: Array, rate: float | None = None) -> tuple[Array, Array, float]:
    """Interpolate values linearly at equidistant times; return times (s), values and rate (Hz)."""
    rate = (t.size - 1) / float(t[-1] - t[0]) if rate is None else rate
    even = t[0] + np.arange(max(2, math.floor((t[-1] - t[0]) * rate + 1e-6) + 1)) / rate
    return even, np.interp(even, t, values), rate
