"""Options that describe the columns of a log, for all commands that read one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

from adaptrack.base.errors import InvalidInput

if TYPE_CHECKING:
    from adaptrack.identification import Reading


@dataclass(frozen=True, kw_only=True)
class ColumnOptions:
    """Options that assign the columns of a log to signals."""

    columns: Annotated[
        list[str] | None,
        Option("--columns", metavar="SIGNAL=NAME,...", help="Column of a signal, such as yaw_rate=GyroZ."),
    ] = None
    units: Annotated[
        list[str] | None,
        Option(
            "--units",
            metavar="UNITS",
            help="Units in the log: deg for all angles and rates, or by signal, such as speed=km/h,time=ms.",
        ),
    ] = None
    flip: Annotated[
        list[str] | None, Option("--flip", metavar="SIGNAL", help="Signal that is positive to the right in the log.")
    ] = None
    steering_ratio: Annotated[
        str | None,
        Option(
            "--steering-ratio",
            metavar="RATIO",
            help="Ratio of logged steering angle to road-wheel angle, or fit to estimate it.",
        ),
    ] = None
    clock: Annotated[
        list[str] | None,
        Option(
            "--clock",
            metavar="SIGNAL=NAME,...",
            help="Column with the time stamps of a signal, such as yaw_rate=t_imu.",
        ),
    ] = None
    late: Annotated[
        list[str] | None,
        Option(
            "--late", metavar="SIGNAL=S,...", help="Time by which a signal lags its stamps (s), such as yaw_rate=0.2."
        ),
    ] = None

    @property
    def reading(self) -> Reading:
        """Return the options as a `Reading` for `identify`."""
        from adaptrack.identification import Reading

        columns = dict(_pair("--columns", part) for part in parts(self.columns))
        units = dict(("", part) if "=" not in part else _pair("--units", part) for part in parts(self.units))
        clocks = dict(_pair("--clock", part) for part in parts(self.clock))
        late = {name: _seconds(name, part) for name, part in (_pair("--late", part) for part in parts(self.late))}
        return Reading(columns, units, tuple(parts(self.flip)), _ratio(self.steering_ratio), clocks, late)


def _ratio(text: str | None) -> float | Literal["fit"] | None:
    if text is None or text == "fit":
        return text  # type: ignore[return-value]  # "fit"
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"--steering-ratio {text}: must be a number, or fit.") from None


def _seconds(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"--late {name}={text}: must be a number (s).") from None


def parts(texts: Sequence[str] | None) -> list[str]:
    """Split option values at their commas."""
    return [part.strip() for text in texts or () for part in text.split(",") if part.strip()]


def _pair(option: str, text: str) -> tuple[str, str]:
    name, mark, value = text.partition("=")
    if not mark or not name or not value:
        raise InvalidInput(f"{option} {text}: must be SIGNAL=NAME.")
    return name, value
