"""Longitudinal drivers by name, with options, for comparisons: ``speed-control:friction=0.6:0.9,guard=0.8``."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, UnknownName
from adaptrack.base.files import is_number
from adaptrack.base.registry import Registry
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.world import Driver, LongitudinalDriver, SpeedDriver


def _prescribed() -> None:
    """The planned speed is followed exactly, without forces."""


_registry: Registry[LongitudinalDriver] = Registry(
    "driver", "register_driver",
    {"prescribed": _prescribed, "driver": Driver, "speed-control": "adaptrack.control.speed_control:SpeedControl"},
    member_type=Driver | SpeedControl | SpeedDriver,
)  # fmt: skip


@checked
def register_driver(name: str, factory: Callable[..., LongitudinalDriver] | str) -> None:
    """Give your own `SpeedDriver` a name for `compare`; the docstring of the factory describes it.

    factory: callable, or ``"package.module:name"``. Its argument ``car``, if any, receives the `Vehicle`; the other
    arguments are options: numbers, or pairs (low, high). Raises `InvalidInput` for a name that is taken or empty.
    """
    _registry.add(name, factory)


def list_drivers() -> dict[str, str]:
    """Return the description of each registered driver by name."""
    return {name: (inspect.getdoc(_registry.factory(name)) or "").partition("\n")[0] for name in _registry.names()}


def check_driver_name(text: str) -> None:
    """Raise `UnknownName` if no driver is registered under the name in a text, see `make_driver`."""
    try:
        _registry.check_name(text.partition(":")[0])
    except UnknownName as error:
        raise UnknownName(f"{error} The driver of a plug-in also needs --plugin MODULE.") from None


def make_driver(text: str, car: Vehicle) -> LongitudinalDriver:
    """Return a driver of a car.

    Raises `UnknownName` for its name, `InvalidInput` for its options, `ContractError` where its factory returns no
    driver.

    text: registered name, optionally followed by a colon and options, as in ``driver:preview=0.4,guard=0.8``.
    """
    name, _, option_text = text.partition(":")
    factory = _registry.factory(name)
    signature = inspect.signature(factory)
    arguments: dict[str, Any] = {"car": car} if "car" in signature.parameters else {}
    try:
        for entry in filter(None, option_text.split(",")):
            option, _, value = entry.partition("=")
            if not all(map(is_number, value.split(":"))):
                raise ValueError(f"{option} = {value!r}: must be a number, or two as in 0.6:0.9")
            numbers = tuple(map(float, value.split(":")))
            arguments[option] = numbers if len(numbers) > 1 else numbers[0]
        signature.bind(**arguments)
    except (TypeError, ValueError) as error:
        names = ", ".join(option for option in signature.parameters if option != "car")
        raise InvalidInput(f"driver {text!r}: {error}; options, as in friction=0.6:0.9: {names or 'none'}.") from None
    return None if factory is _prescribed else _registry.make(name, **arguments)


def check_forces(plant: Plant | SteppedPlant) -> None:
    """Refuse a plant that no longitudinal force moves; raises `InvalidInput`."""
    if isinstance(plant, Plant):
        motion, dry = plant.initial_state([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), [0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0]
        slopes = [plant.derivative(motion, [0.0, force], dry)[3] for force in (0.0, plant.powertrain["mass"])]
        if slopes[0] == slopes[1]:
            raise InvalidInput(f"plant {plant.name!r}: its right-hand side ignores the force u[1], which drivers need.")
