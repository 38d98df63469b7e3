"""Commands that read logs: `adaptrack identify`, `shadow` and `check-loop`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.next_step import add_command, say_next
from adaptrack.cli.options import EXIT_FAILED, argument, flag, json_flag, option, option_group, option_words


# -- columns ----------------------------------------------------------------------------------------------------------
@option_group
class ColumnOptions:
    """Options that assign the columns of a log to signals."""

    columns: list[str] | None = option("SIGNAL=NAME,...", "Column of a signal, such as yaw_rate=GyroZ.")
    units: list[str] | None = option(
        "UNITS", "Units in the log: deg for all angles and rates, or by signal, such as speed=km/h,time=ms."
    )
    flip: list[str] | None = option("SIGNAL", "Signal that is positive to the right in the log.")
    steering_ratio: str | None = option(
        "RATIO", "Ratio of logged steering angle to road-wheel angle, or fit to estimate it."
    )
    clock: list[str] | None = option(
        "SIGNAL=NAME,...", "Column with the time stamps of a signal, such as yaw_rate=t_imu."
    )
    late: list[str] | None = option("SIGNAL=S,...", "Time by which a signal lags its stamps (s), such as yaw_rate=0.2.")

    @property
    def reading(self) -> at.Reading:
        """Return the options as a `Reading` for `identify`."""
        columns = dict(_pair("--columns", part) for part in parts(self.columns))
        units = dict(("", part) if "=" not in part else _pair("--units", part) for part in parts(self.units))
        clocks = dict(_pair("--clock", part) for part in parts(self.clock))
        lags = dict(_pair("--late", part) for part in parts(self.late))
        late = {name: _number(f"--late {name}=", text, "a number (s)") for name, text in lags.items()}
        ratio: float | Literal["fit"] | None = None
        if self.steering_ratio is not None:
            is_open = self.steering_ratio == "fit"
            ratio = "fit" if is_open else _number("--steering-ratio ", self.steering_ratio, "a number, or fit")
        return at.Reading(columns, units, tuple(parts(self.flip)), ratio, clocks, late)


def _number(option: str, text: str, expected: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{option}{text}: must be {expected}.") from None


def parts(texts: Sequence[str] | None) -> list[str]:
    """Split option values at their commas."""
    return [part.strip() for text in texts or () for part in text.split(",") if part.strip()]


def _pair(option: str, text: str) -> tuple[str, str]:
    name, mark, value = text.partition("=")
    if not mark or not name or not value:
        raise InvalidInput(f"{option} {text}: must be SIGNAL=NAME.")
    return name, value


# -- identify ---------------------------------------------------------------------------------------------------------
@option_group
class IdentifyOptions:
    """Options of `adaptrack identify`."""

    logs: list[Path] = argument(
        "LOG", "Log (.csv, .parquet, or from `drive --out`); several logs must be of the same car.", ...
    )
    car: str | None = option("CAR", "Initial car: see `list cars`, or a .toml file.")
    mass: float | None = option("KG", "Mass (kg); with --wheelbase instead of --car.")
    wheelbase: float | None = option("M", "Wheelbase (m); with --mass instead of --car.")
    log_columns: ColumnOptions
    computation: float | None = option(
        "S", "Computation time of the logged controller (s), part of the dead time.", hidden=True
    )
    out: Path | None = option("FILE", "Car file to write (.toml); its tyre file is written to the same folder.")
    anyway: bool = flag("Write --out and exit with code 0 even if the estimates are inconsistent.")
    longitudinal: bool = flag("Identify drive, brakes and pedal map only.")
    page: Path | None = option("FILE", "Page to write (.html).")
    as_json: bool = json_flag()


@options.grouped
def identify(arguments: IdentifyOptions) -> None:
    """Identify a car from logs of driving.

    The command estimates steering delay, tyre stiffness, offsets and noise, each with a 90 % interval. A log needs
    time, speed, yaw rate, and steering command or wheel angle, at 10 Hz or more. With acceleration_command (m/s^2),
    force_command (N), or throttle and brake (0 to 1) it also gives drive and brakes.

    The exit code is 3 if estimates of logs, or of parts of a log, contradict each other or the initial car.
    """
    from adaptrack.identification.consistency import implausible_estimates
    from adaptrack.results.identify import identification_result, write_identification_page

    out, page, as_json = arguments.out, arguments.page, arguments.as_json
    reading = arguments.log_columns.reading
    options.make_place(out, ".toml")
    if arguments.longitudinal:
        _identify_drive(arguments, reading)
        return
    options.make_place(page, ".html", "--page")
    with show.progress("identify") as advance:
        identified = at.identify(
            list(arguments.logs), arguments.car, mass=arguments.mass, wheelbase=arguments.wheelbase, reading=reading,
            computation=arguments.computation, progress=advance,
        )  # fmt: skip
    show.say_result(identification_result(identified), as_json)
    for reason in identified.reasons:
        show.say_failed(f"not consistent: {reason}.", aside=as_json)
    refused = not (identified.consistent or arguments.anyway)
    is_implausible = refused and any(
        implausible_estimates(result.estimates, result.believed) for result in (identified, *identified.alone)
    )
    if out is not None and not refused:
        with show.replacing(out, out.with_name(f"{out.stem}-tyre.toml"), aside=as_json):
            identified.to_toml(out, anyway=arguments.anyway)
        show.say(f"Car: {out}", aside=as_json)
    elif out is not None:
        remedy = "an estimate is implausible" if is_implausible else "use --anyway to write it"
        show.say(f"{out} was not written; {remedy}.", aside=as_json)
    if page is not None:
        show.say(f"Page: {write_identification_page(identified, page, options.command_line())}", aside=as_json)
    if not as_json:
        say_next(
            "identify", has_hidden_contradictions=page is None and (identified.findings or refused),
            is_implausible=is_implausible, is_refused=refused, is_unsaved=out is None, log=arguments.logs[0],
            car=None if arguments.car is None else ["--vehicle", arguments.car],
            columns=option_words(arguments.log_columns), file=out or "my-car.toml",
        )  # fmt: skip
    if refused:
        raise typer.Exit(EXIT_FAILED)


def _identify_drive(arguments: IdentifyOptions, reading: at.Reading) -> None:
    """Identify drive, brakes and resistance only."""
    from adaptrack.identification import identify_drive
    from adaptrack.results.identify import drive_identification_result

    out = arguments.out
    if arguments.car is None or arguments.page is not None:
        raise InvalidInput("--longitudinal: needs --car, whose mass turns force into acceleration, and has no page.")
    identified = identify_drive(list(arguments.logs), arguments.car, reading=reading)
    show.say_result(drive_identification_result(identified), arguments.as_json)
    if out is not None:
        with show.replacing(out, aside=arguments.as_json):
            identified.to_toml(out)
        show.say(f"Car: {out}", aside=arguments.as_json)
    if not arguments.as_json:
        say_next("identify --longitudinal", is_unsaved=out is None, file=out)


# -- shadow -----------------------------------------------------------------------------------------------------------
@option_group
class ShadowOptions:
    """Options of `adaptrack shadow`."""

    log: list[Path] = argument("LOG...", "Logs of one car, the oldest first (.csv, .parquet).", ...)
    vehicle: str = options.vehicle_option(...)
    path: str | None = option("ROAD", "Road that the controller follows; default: smoothed x and y of the log.")
    log_columns: ColumnOptions
    without: list[str] | None = option("SIGNAL,...", "Signals to ignore: vy, acceleration, wheel, x, y, yaw.")
    profile: str = options.profile_option("road")
    computation: float | None = option("S", "Part of the dead time that the controller causes.", hidden=True)
    out: Path | None = options.page_option()
    as_json: bool = json_flag()


@options.grouped
def shadow(arguments: ShadowOptions) -> None:
    """Test the learning controller on logs of a human driver.

    The controller does not steer; it only learns the car from the log. The report has the learned values, the errors of
    predicted yaw rate and position, and the warnings of the controller. The exit code is 3 if the learned values are
    implausible because measurements contradict them.
    """
    from adaptrack.results.shadow import shadow_result

    options.make_page_folder(arguments.out)
    with show.progress("shadow", len(arguments.log)) as advance:
        report = at.shadow(
            arguments.log, arguments.vehicle, path=arguments.path, reading=arguments.log_columns.reading,
            without=parts(arguments.without), profile=arguments.profile, computation=arguments.computation,
            progress=advance,
        )  # fmt: skip
    computation = option_words(arguments, "computation")
    result = add_command(
        shadow_result(report), "shadow", is_spoiled=report.spoiling, has_no_page=arguments.out is None,
        is_plausible=report.believable, without=",".join([*parts(arguments.without), *report.spoiling]),
        identify=[*arguments.log, "--car", arguments.vehicle, *option_words(arguments.log_columns), *computation],
    )  # fmt: skip
    show.say_result(result, arguments.as_json, arguments.out)
    if not report.believable:
        raise typer.Exit(EXIT_FAILED)


# -- check-loop -------------------------------------------------------------------------------------------------------
@option_group
class CheckLoopOptions:
    """Options of `adaptrack check-loop`."""

    log: Path = argument("LOG", "Log of the loop (.csv, .parquet), or a file of adaptrack.Tracker(record=...).", ...)
    vehicle: str | None = option("CAR", "Car, for its dimensions: see `list cars`, or a .toml file.")
    log_columns: ColumnOptions
    as_json: bool = json_flag()


@options.grouped
def check_loop(arguments: CheckLoopOptions) -> None:
    """Find contradictory inputs of a control loop in its log.

    The check finds wrong signs, units, reference frames and time stamps. It compares position, yaw, speed, yaw rate,
    lateral velocity, lateral acceleration, wheel angle and steering command with each other. It compares the change of
    speed with longitudinal acceleration and with commands of acceleration or force, and reports whether this
    acceleration possibly contains gravity. The exit code is 3 if signals contradict each other, and 2 if no signals
    could be compared.
    """
    from adaptrack.identification.loop_check import check_loop as check_log
    from adaptrack.identification.reading import read_columns
    from adaptrack.results.identify import check_result

    vehicle = None if arguments.vehicle is None else at.load_vehicle(arguments.vehicle)
    with show.progress("check-loop"):
        columns = read_columns(arguments.log, arguments.log_columns.reading)
        check = check_log(columns, vehicle)
    if not check.contradictions and not check.compared:
        reason = check.limit or "no two signals are related."
        raise InvalidInput(
            f"log: no signals could be compared: {reason} Drive bends, and log speed with x, y and yaw, or yaw rate "
            "with the command."
        )
    show.say_result(check_result(check, str(arguments.log), columns.notes), arguments.as_json)
    if check.contradictions:
        raise typer.Exit(EXIT_FAILED)
    if not arguments.as_json:
        words = option_words(arguments.log_columns)
        say_next("check-loop", log=arguments.log, vehicle=arguments.vehicle, columns=words)
