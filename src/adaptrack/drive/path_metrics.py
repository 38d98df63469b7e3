"""How well a path was followed: offsets of the centre of mass and of the body's corners, heading, steering, comfort.

From arrays, so that a drive of any loop can be measured. Signs are those of ISO 8855: offsets, heading errors, yaw
rates, accelerations and wheel angles positive to the left. Wherever smaller is better, a measure whose samples are not
all finite is infinite.
"""

from __future__ import annotations

import dataclasses
import html
import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Positive, checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.drive.failure import SLOW
from adaptrack.drive.metrics import largest_magnitude, mean_square
from adaptrack.drive.trajectory import Trajectory

Array = NDArray[np.float64]

LANE_WIDTH = 3.5
"""m, of the lane that the share of time inside is about."""
STEERING_RATIO = 15.0
"""Angle of the steering wheel over that of the road wheels where a car file does not say: passenger cars have 13-17."""

GAP, REVERSAL_CUT_OFF, REVERSAL_ORDER = math.radians(3.0), 0.6, 2
"""Steering reversals: the gap (rad, at the steering wheel), the cut-off (Hz) and the order of the low-pass."""
SAMPLING, COMFORT_CUT_OFF, COMFORT_ORDER, JERK_WINDOW = 100.0, 0.5, 4, 0.5
"""UN Regulation No. 79: sampling (Hz), Butterworth cut-off (Hz) and order, moving average of the jerk (s)."""


@dataclass(frozen=True, eq=False)
class PathRecord:
    """A drive along a path at n instants, as arrays (n,); a number stands for all instants.

    Raises
    ------
    InvalidInput
        When arrays differ in length, or times do not increase.
    """

    t: Array
    """s, increasing"""
    offset: Array
    """m, e: centre of mass from the path"""
    heading_error: Array
    """rad, yaw less the heading of the path at the foot; any number of turns"""
    speed: Array
    """m/s, v_x"""
    lateral_acceleration: Array
    """m/s^2, at the centre of mass, without the pull of a bank"""
    wheel_angle: Array
    """rad, of the road wheels"""
    yaw_rate: Array | float = 0.0
    """rad/s"""
    command: Array | float = 0.0
    """rad, requested angle of the road wheels"""
    curvature: Array | float = 0.0
    """1/m, of the path at the foot"""

    def __post_init__(self) -> None:
        t = reals("PathRecord: t", self.t)
        if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0.0).all():
            raise InvalidInput("PathRecord: t must be at least two finite, increasing times in s.")
        for each in dataclasses.fields(self):
            values = reals(f"PathRecord: {each.name}", getattr(self, each.name))
            if values.shape not in ((), t.shape):
                raise InvalidInput(
                    f"PathRecord: {each.name} has the shape {values.shape}: must be ({t.size},), as t, or a number."
                )
            object.__setattr__(self, each.name, np.broadcast_to(values, t.shape))

    @classmethod
    @checked
    def from_trajectory(cls, run: Trajectory) -> Self | None:
        """A run along a road as far as it is finite; None where fewer than two instants are.

        Offsets count from the reference that it was to follow.
        """
        columns = {
            "t": run.t, "offset": run.error, "heading_error": run.heading_error, "speed": run.vx,
            "lateral_acceleration": run.lateral_acceleration, "wheel_angle": run.steering, "yaw_rate": run.yaw_rate,
            "command": run.command, "curvature": run.road.get("curvature", np.zeros(len(run))),
        }  # fmt: skip
        whole = np.isfinite(np.stack(list(columns.values()))).all(axis=0)
        end = len(run) if whole.all() else int(whole.argmin())
        return None if end < 2 else cls(**{name: values[:end] for name, values in columns.items()})

    @property
    def turned(self) -> Array:
        """(n,) rad, the heading error in [-pi, pi)."""
        return np.remainder(np.asarray(self.heading_error) + np.pi, 2.0 * np.pi) - np.pi


def _measure(unit: str, meaning: str) -> Any:
    return field(metadata={"unit": unit, "meaning": meaning})


@dataclass(frozen=True)
class PathMetrics:
    """The measures of one drive; each field's metadata say its unit and what it is, `rows` lists them."""

    duration: float = _measure("s", "from the first instant to the last")
    distance: float = _measure("m", "integral of |v_x|")
    mean_offset: float = _measure("m", "mean e, positive to the left")
    rms_offset: float = _measure("m", "root mean square of e")
    p95_offset: float = _measure("m", "95th percentile of |e|")
    max_offset: float = _measure("m", "largest |e|")
    rms_corner: float = _measure("m", "RMS distance of the outermost corner")
    p95_corner: float = _measure("m", "its 95th percentile")
    max_corner: float = _measure("m", "its largest value")
    max_corner_error: float = _measure("m", "the same less half the width")
    in_lane: float = _measure("-", "share of time with all corners in the lane")
    rms_heading: float = _measure("rad", "RMS heading error, v_x >= 1 m/s")
    max_heading: float = _measure("rad", "largest heading error, v_x >= 1 m/s")
    max_yaw_rate: float = _measure("rad/s", "largest magnitude")
    rms_wheel_angle: float = _measure("rad", "RMS angle of the road wheels")
    rms_command_rate: float = _measure("rad/s", "RMS rate of the command")
    reversals: float = _measure("1/min", "steering reversals (SAE J2944)")
    rms_acceleration: float = _measure("m/s^2", "RMS lateral acceleration, raw")
    max_acceleration: float = _measure("m/s^2", "largest, raw")
    rms_jerk: float = _measure("m/s^3", "RMS lateral jerk, raw")
    max_jerk: float = _measure("m/s^3", "largest, raw")
    max_acceleration_r79: float = _measure("m/s^2", "largest, as UN R79 evaluates it")
    max_jerk_r79: float = _measure("m/s^3", "largest, as UN R79 evaluates it")

    def to_dict(self) -> dict[str, float | None]:
        """The measures by name, ready for strict JSON: what is not finite becomes None."""
        values = dataclasses.asdict(self)
        return {name: value if math.isfinite(value) else None for name, value in values.items()}

    def rows(self) -> list[tuple[str, float, str, str]]:
        """(name, value, unit, meaning) of each measure."""
        return [
            (each.name, getattr(self, each.name), each.metadata["unit"], each.metadata["meaning"])
            for each in dataclasses.fields(self)
        ]

    def __str__(self) -> str:
        return "\n".join(f"{name:<20} {value:>9.4g} {unit:<6} {meaning}" for name, value, unit, meaning in self.rows())

    def _repr_html_(self) -> str:
        """A table for notebooks and pages."""
        lines = "".join(
            f"<tr><td>{html.escape(name)}</td><td style='text-align:right'>{value:.4g}</td>"
            f"<td>{html.escape(unit)}</td><td>{html.escape(meaning)}</td></tr>"
            for name, value, unit, meaning in self.rows()
        )
        return f"<table><tr><th>measure</th><th>value</th><th>unit</th><th></th></tr>{lines}</table>"


@checked
def path_metrics(
    record: PathRecord,
    outline: Outline,
    *,
    lane_width: Annotated[Positive, "m"] = LANE_WIDTH,
    steering_ratio: Positive | None = None,
) -> PathMetrics:
    """All measures of a drive.

    Parameters
    ----------
    outline
        The car's, `Vehicle.outline`.
    lane_width
        The path is the middle of the lane.
    steering_ratio
        Angle of the steering wheel over that of the road wheels, by default `STEERING_RATIO`.
    """
    ratio = STEERING_RATIO if steering_ratio is None else steering_ratio
    t, offset = record.t, record.offset
    with np.errstate(invalid="ignore", over="ignore"):
        corner = np.abs(outline.corner_offsets(offset, record.turned, record.curvature)).max(axis=-1)
        heading = record.turned[~(record.speed < SLOW)]  # NaN speeds stay in
        jerk = np.diff(record.lateral_acceleration) / np.diff(t)
        command_rate = np.diff(record.command) / np.diff(t)
        inside = corner <= 0.5 * lane_width
    felt = record.lateral_acceleration
    comfort = r79(t, felt) if np.isfinite(felt).all() else (math.inf, math.inf)
    return PathMetrics(
        duration=float(t[-1] - t[0]),
        distance=float(np.trapezoid(np.abs(record.speed), t)),
        mean_offset=float(np.mean(offset)) if np.isfinite(offset).all() else math.inf,
        rms_offset=math.sqrt(mean_square(offset)),
        p95_offset=_p95(offset),
        max_offset=largest_magnitude(offset),
        rms_corner=math.sqrt(mean_square(corner)),
        p95_corner=_p95(corner),
        max_corner=largest_magnitude(corner),
        max_corner_error=largest_magnitude(corner) - 0.5 * outline.width,
        in_lane=float(np.mean(inside)),
        rms_heading=math.sqrt(mean_square(heading)),
        max_heading=largest_magnitude(heading),
        max_yaw_rate=largest_magnitude(np.asarray(record.yaw_rate)),
        rms_wheel_angle=math.sqrt(mean_square(record.wheel_angle)),
        rms_command_rate=math.sqrt(mean_square(command_rate)),
        reversals=reversal_rate(t, ratio * record.wheel_angle) if np.isfinite(record.wheel_angle).all() else math.inf,
        rms_acceleration=math.sqrt(mean_square(felt)),
        max_acceleration=largest_magnitude(felt),
        rms_jerk=math.sqrt(mean_square(jerk)),
        max_jerk=largest_magnitude(jerk),
        max_acceleration_r79=comfort[0],
        max_jerk_r79=comfort[1],
    )


def reversal_rate(t: ArrayLike, steering: ArrayLike, gap: float = GAP, cut_off: float = REVERSAL_CUT_OFF) -> float:
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

    t, steering, rate = _even(np.asarray(t, dtype=float), np.asarray(steering, dtype=float))
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
    from the steady state of the first sample. Records that are sampled otherwise are put to 100 Hz by straight lines.
    """
    filtered, jerk = r79_signals(t, lateral_acceleration)
    return largest_magnitude(filtered), largest_magnitude(jerk)


def r79_signals(t: ArrayLike, lateral_acceleration: ArrayLike) -> tuple[Array, Array]:
    """The two signals whose largest magnitudes `r79` gives, at 100 Hz; (m,) m/s^2 and (m - 50,) m/s^3.

    A record that is shorter than the moving average has the mean jerk over all of it.
    """
    from scipy.signal import butter, sosfilt, sosfilt_zi

    _, samples, rate = _even(np.asarray(t, dtype=float), np.asarray(lateral_acceleration, dtype=float), SAMPLING)
    sections = butter(COMFORT_ORDER, COMFORT_CUT_OFF, fs=rate, output="sos")
    filtered, _ = sosfilt(sections, samples, zi=sosfilt_zi(sections) * samples[0])
    window = min(round(JERK_WINDOW * rate), filtered.size - 1)
    return filtered, (filtered[window:] - filtered[:-window]) * rate / window  # the mean derivative is a difference


def _even(t: Array, values: Array, rate: float | None = None) -> tuple[Array, Array, float]:
    """Times an equal period apart, the values there by straight lines, and the rate (Hz), by default the mean one."""
    rate = (t.size - 1) / float(t[-1] - t[0]) if rate is None else rate
    even = t[0] + np.arange(max(2, math.floor((t[-1] - t[0]) * rate + 1e-6) + 1)) / rate
    return even, np.interp(even, t, values), rate


def _p95(values: Array) -> float:
    return float(np.percentile(np.abs(values), 95.0)) if np.isfinite(values).all() else math.inf
