"""`adaptrack road check` and `plot`: check whether a car can drive a road, and draw the road."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.next_step import add_command, say_next
from adaptrack.cli.options import argument, json_flag, option, option_group, option_words

if TYPE_CHECKING:
    from adaptrack.road import Finding, SpeedPlan, Stop
    from adaptrack.road.holdable_speed import HoldableSpeed

app = typer.Typer(help="Check and draw roads from files or generators.", no_args_is_help=True, rich_markup_mode=None)

NOT_DRIVABLE = 1
"""Exit code if the car cannot drive some place of the road."""

SPEED_REDUCTION = 0.7
"""Factor on the speed or lateral acceleration in the command suggested after a failure."""

ROADS_HELP = "a name from `list roads`, or a file: .csv of x, y (m), .toml, OpenDRIVE (.xodr), CommonRoad (.xml)."
road_argument = partial(argument, "ROAD", f"Road: {ROADS_HELP}")


@option_group
class RoadOptions:
    """Options of all commands with a road: how to read the road and how fast to drive."""

    speed: float | None = options.speed_option()
    lateral_acceleration: float | None = options.lateral_acceleration_option()
    speed_column: str | None = option(
        "NAME", ".csv: column of speeds to drive (m/s), limited by --lateral-acceleration.", hidden=True
    )
    max_deviation: float | None = option(
        "M", ".csv: largest distance of the road from a point (m); default: from the noise of the points.", hidden=True
    )
    closed: bool | None = option(
        None, ".csv: closed lap or open road; default: detected.", names=["--closed/--open"], hidden=True
    )
    road_id: str | None = option(
        "ID", ".xodr: identifier of the road; .xml: identifiers of the lanelets.", names=["--road"], hidden=True
    )
    lane: int | None = option("N", ".xodr: lane whose middle is driven, such as -1.", hidden=True)
    road_seed: int | None = option("N", "Seed of a generated road; default: 0.")
    length: float | None = option("M", "Length of a generated road (m); default: 2000.")

    margins: bool | None = option(
        None,
        "Limit the planned speed to keep the stability margins of the controller.",
        names=["--margins/--no-margins"],
    )
    assumed_friction: str | None = options.assumed_friction_option()
    stop: list[str] | None = option("S:SECONDS", "Stop at S (m) for SECONDS (300:5); may be repeated.", hidden=True)
    start: float | None = option("V", "Speed at the start (m/s); 0: from standstill.", hidden=True, min=0.0)

    @property
    def stops(self) -> list[Stop]:
        """Stops of the plan, each written as S:SECONDS."""
        from adaptrack.road import Stop

        stops = []
        for text in self.stop or []:
            place, _, seconds = text.partition(":")
            try:
                stops.append(Stop(float(place), float(seconds)))
            except ValueError:
                raise InvalidInput(
                    f"--stop {text}: write S:SECONDS, such as 300:5, for 5 s at rest at 300 m of the road."
                ) from None
        return stops

    @property
    def slower(self) -> list[str]:
        """Words of a lower speed, or of a lower lateral acceleration if no speed is set."""
        if self.speed is not None:
            return ["--speed", str(round(SPEED_REDUCTION * self.speed, 1))]
        comfort = 3.0 if self.lateral_acceleration is None else self.lateral_acceleration
        return ["--lateral-acceleration", str(round(SPEED_REDUCTION * comfort, 2))]

    @property
    def assumed_interval(self) -> tuple[float, float] | None:
        """Low and high end of the assumed friction, which is written as MU or LOW:HIGH; None: that of the road."""
        if self.assumed_friction is None:
            return None
        from adaptrack.control.speed_control import ASSUMABLE_FRICTION

        least, most = ASSUMABLE_FRICTION
        try:
            low, *high = (float(number) for number in self.assumed_friction.split(":"))
            if len(high) > 1 or not least <= low <= max(high, default=low) <= most:
                raise ValueError
        except ValueError:
            raise InvalidInput(
                f"--assumed-friction {self.assumed_friction}: must be a friction such as 0.9 or an interval such as "
                f"0.65:0.9, at least {least:g} and at most {most:g}."
            ) from None
        return low, max(high, default=low)

    def look(
        self, name: str, car: at.Vehicle, profile: str | at.Profile = "road", holdable: HoldableSpeed | None = None
    ) -> CheckedRoad:
        """Load a road by its name, plan the speed along it for a car, and check both.

        profile: profile for the stability margins of --margins; holdable: speeds with sufficient margins from a tuning.
        A constant speed excludes a speed column, a lateral acceleration, stops and a speed at the start.
        """
        from adaptrack.road import Comfort
        from adaptrack.road.speed import constant_speed, speed_limit_plan

        if self.speed is not None and self.lateral_acceleration is not None:
            raise InvalidInput("--speed and --lateral-acceleration: give only one of them.")
        if self.speed is not None and self.speed_column is not None:
            raise InvalidInput("--speed and --speed-column: give only one of them.")
        if (self.stop or self.start is not None) and (self.speed is not None or self.speed_column is not None):
            raise InvalidInput(
                "--stop and --start: belong to a planned speed: leave out --speed and --speed-column; use "
                "--lateral-acceleration."
            )
        settings = {
            "max_deviation": self.max_deviation, "closed": self.closed, "road": self.road_id, "lane": self.lane,
            "seed": self.road_seed, "length": self.length,
            "speed_column": self.speed_column,
        }  # fmt: skip
        road = at.load_road(name, **{key: value for key, value in settings.items() if value is not None})
        comfort = Comfort() if self.lateral_acceleration is None else Comfort(lateral=self.lateral_acceleration)
        if self.speed is not None:
            plan = constant_speed(road, self.speed)
        elif self.speed_column is not None and self.lateral_acceleration is None:
            plan = speed_limit_plan(road)
        else:
            friction = self.assumed_interval
            assumed = road if friction is None else road.replace(friction=friction[0])
            plan = at.plan_speed(
                assumed, car, comfort, start=self.start, stops=self.stops, holds=self._holds(car, profile, holdable)
            )
        return CheckedRoad(road, plan, at.check_road(road, car, plan))

    def _holds(
        self, car: at.Vehicle, profile: str | at.Profile, holdable: HoldableSpeed | None
    ) -> HoldableSpeed | None:
        """Return the speeds with sufficient stability margins; None if they do not limit the plan."""
        if not self.margins or holdable is not None:
            return None if self.margins is False else holdable
        from adaptrack.analysis.holdable import holdable_speed

        with show.progress("stability margins of the controller"):
            return holdable_speed(car, at.MPC(car, profile=profile), profile)


@app.command()
@options.grouped
def check(
    *,
    road: str = road_argument(...),
    vehicle: str = options.vehicle_option("paper"),
    route: RoadOptions,
    as_json: bool = json_flag(),
) -> None:
    """Check whether a car can drive a road; exit code 1 if not."""
    from adaptrack.results.road import road_result

    checked = route.look(road, at.load_vehicle(vehicle))
    is_too_fast = all(finding.drivable or finding.kind in ("grip", "steering-rate") for finding in checked.findings)
    result = add_command(
        road_result(checked.road, checked.plan, checked.findings), "road check", is_drivable=checked.drivable,
        is_too_fast=is_too_fast, slower=route.slower, road=[road, "--vehicle", vehicle, *option_words(route)],
    )  # fmt: skip
    show.say_result(result, as_json)
    if not checked.drivable:
        raise typer.Exit(NOT_DRIVABLE)


@app.command()
@options.grouped
def plot(
    *,
    road: str = road_argument(...),
    vehicle: str = options.vehicle_option("paper"),
    route: RoadOptions,
    out: Path = option("FILE", "PNG file of the picture.", Path("road.png")),
) -> None:
    """Draw the course, curvature and planned speed of a road as PNG."""
    from adaptrack.base.files import write_atomically
    from adaptrack.results.road import road_picture
    from adaptrack.results.style import png, print_figure

    options.make_place(out, ".png")
    checked = route.look(road, at.load_vehicle(vehicle))
    write_atomically(out, png(print_figure(road_picture(checked.road, checked.plan, checked.findings))))
    show.say(f"Picture: {out}")
    say_next("road plot", road=[road, "--vehicle", vehicle, *option_words(route)])


@dataclass(frozen=True)
class CheckedRoad:
    """Road, speed plan and findings of the check."""

    road: at.Road
    plan: SpeedPlan
    findings: list[Finding]

    @property
    def drivable(self) -> bool:
        """Whether the car can drive all of the road."""
        return all(finding.drivable for finding in self.findings)

    def warn(self) -> None:
        """Print warnings for places that the car cannot drive, and notes on unusual speed limits."""
        for finding in self.findings:
            where = f"(s = {finding.start:.0f} to {finding.end:.0f} m)"
            if not finding.drivable:
                show.say(f"Warning, {self.road.name}: {finding.text} {where}.", aside=True)
            elif finding.kind in ("domain", "ripple"):
                show.say(f"{self.road.name}: {finding.text} {where}.", aside=True)
