"""What a car is driven in: speeds, friction, wind, lanes, and when it is off the road."""

from __future__ import annotations

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from adaptrack.base.files import LISTED, Record

MAX_DOMAIN = {"speed": 100.0, "friction": 2.0}
"""m/s, -: the ranges of a domain end there at the latest."""
Range = Annotated[tuple[float, float], LISTED]
"""Lowest and highest value; a list in TOML."""


class Domain(Record):
    """Where a car is at home: the section ``[domain]`` of a car file. Random drives are drawn in it.

    The defaults are those of a passenger car on public roads. `failure_distance` is when a run of the car has failed,
    unless the caller says otherwise.
    """

    speed: Range = Field(default=(4.0, 27.0), description="m/s, lowest and highest")
    friction: Range = Field(default=(0.3, 1.0), description="-, lowest and highest coefficient")
    wind: float = Field(default=30.0, ge=0, le=100, description="m/s, strongest lateral wind")
    lane_width: float = Field(default=3.5, gt=0, le=20, description="m; lane changes are 2/7 to 12/7 of it")
    failure_distance: float = Field(
        default=5.0, gt=0, le=100, description="m from the reference, beyond which the car is off the road"
    )

    @model_validator(mode="after")
    def _ranges_rise(self) -> Self:
        for name, most in MAX_DOMAIN.items():
            low, high = getattr(self, name)
            if not 0.0 < low <= high <= most:
                raise ValueError(f"{name} = [{low:g}, {high:g}]: need 0 < lowest <= highest <= {most:g}.")
        return self

    @property
    def drive_options(self) -> dict[str, Any]:
        """Options of `scenario.random_drive` that draw a drive in the domain."""
        return {name: getattr(self, name) for name in ("speed", "friction", "wind", "lane_width")}
