"""Longitudinal drivers by name, with options, for comparisons: ``speed-control:friction=0.6..0.9,guard=0.8``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import Registry
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.cars.vehicle import Vehicle
from adaptrack.drive.world import LongitudinalDriver

COMPILED_DRIVERS = ("prescribed", "driver")
"""Drivers that the kernels run; others need Python at every step."""

_descriptions = {
    "prescribed": "follows the planned speed exactly, without forces",
    "driver": "preview of the planned speed, with a guard (`Driver`)",
    "speed-control": "governor, guard, stops, and learned brakes (`SpeedControl`)",
}


def _prescribed() -> None:
    """Return no driver: the planned speed is followed exactly."""


_registry: Registry[LongitudinalDriver] = Registry(
    "driver", "register_driver",
    {
        "prescribed": _prescribed, "driver": "adaptrack.drive.world:Driver",
        "speed-control": "adaptrack.control.speed_control:SpeedControl",
    },
)  # fmt: skip


@checked
def register_driver(name: str, factory: Callable[..., LongitudinalDriver] | str, *, words: str = "") -> None:
    """Give a longitudinal driver a name for `compare`.

    Parameters
    ----------
    name
        Name of letters, digits and hyphens.
    factory
        Callable, or ``"package.module:name"``, that returns a `SpeedDriver`. If it has an argument ``car``, it receives
        the `Vehicle` of the run. Its other arguments are the options of the driver: numbers, or pairs (low, high).
    words
        Description for tables.

    Raises
    ------
    InvalidInput
        For a name that is taken or empty, or a factory that cannot be called.
    """
    _registry.add(name, factory)
    _descriptions[name] = words


def list_drivers() -> dict[str, str]:
    """Return the description of each registered driver by name, sorted."""
    return {name: _descriptions.get(name, "") for name in _registry.names()}


def check_driver(text: str) -> tuple[Callable[..., LongitudinalDriver], dict[str, Any]]:
    """Return the factory and the options of a driver, whose values only `make_driver` checks.

    Parameters
    ----------
    text
        Registered name, optionally followed by a colon and options such as ``friction=0.6..0.9,guard=0.8``.

    Raises
    ------
    UnknownName
        For an unregistered name.
    InvalidInput
        For an unknown option, or a value that is not a number or an interval.
    """
    name, _, rest = text.partition(":")
    factory = _registry.factory(name)
    names = [option for option in inspect.signature(factory).parameters if option != "car"]
    options = {}
    for entry in filter(None, rest.split(",")):
        option, _, value = entry.partition("=")
        if option not in names:
            raise InvalidInput(f"driver {text!r}: no option {option!r}; options: {', '.join(names) or 'none'}.")
        try:
            low, *high = map(float, value.split("..", 1))
        except ValueError:
            raise InvalidInput(
                f"driver {text!r}: {option} = {value!r}: must be a number such as 0.9, or an interval such as 0.6..0.9."
            ) from None
        options[option] = (low, *high) if high else low
    return factory, options


def make_driver(text: str, car: Vehicle) -> LongitudinalDriver:
    """Return a driver of a car; text: as for `check_driver`.

    Raises
    ------
    InvalidInput
        As `check_driver`, and for an option whose value is not possible.
    """
    factory, options = check_driver(text)
    if "car" in inspect.signature(factory).parameters:
        options["car"] = car
    try:
        return factory(**options)
    except InvalidInput as error:
        raise InvalidInput(f"driver {text!r}: {error}") from None


def check_forces(driver: LongitudinalDriver, plant: Plant | SteppedPlant) -> None:
    """Refuse a driver on a plant that no force moves.

    Raises
    ------
    InvalidInput
        When the right-hand side of the plant does not read the force.
    """
    if driver is None or isinstance(plant, SteppedPlant):
        return
    straight, dry = plant.initial_state([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), [0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0]
    rolling, driven = (plant.derivative(straight, [0.0, force], dry)[3] for force in (0.0, plant.powertrain["mass"]))
    if driven == rolling:
        raise InvalidInput(
            f"plant {plant.name!r}: its right-hand side ignores the force u[1], but drivers move cars by forces: use "
            "the force, or compare with the driver 'prescribed'."
        )
