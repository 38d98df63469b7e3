"""Certificate for a schedule or tuning on a car for which it was not made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import show

if TYPE_CHECKING:
    from adaptrack.analysis.certify import Certificate
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.control.controllers import MPC, Tuning
    from adaptrack.control.scheduling import Schedule
    from adaptrack.scenario.profile import Profile

LEVELS = (9, 3)
"""Numbers of speeds and frictions in the certificate."""


def certify_meeting(label: str, mpc: MPC, plant: Any, car: Vehicle, world: Profile, allowed: bool) -> None:
    """Certify a scheduled MPC whose schedule was made for a different car than the modelled or the simulated one.

    label: name of the schedule in messages; allowed: whether an unstable loop is only a warning. Schedules without a
    car, or for this car, are not certified.

    Raises
    ------
    InvalidInput
        When a loop is unstable when driving straight and `allowed` is False.
    """
    from adaptrack.control.controllers.compatibility import car_of
    from adaptrack.control.scheduling import Schedule

    schedule = mpc.scheduler
    if not isinstance(schedule, Schedule):
        return
    made_for = schedule.made_for.get("car")
    other_cars = [name for name in dict.fromkeys((car_of(mpc.model), car_of(plant))) if name not in (None, made_for)]
    if made_for is not None and other_cars:
        clause = f"scheduler {label!r}, made for the car {made_for!r}, on {' and '.join(map(repr, other_cars))}"
        judge(clause, schedule, (mpc, plant, car, world), allowed)


def judge(clause: str, tuning: Schedule | Tuning, loop: tuple[MPC, Any, Vehicle, Profile], allowed: bool) -> None:
    """Certify a schedule or a tuning over the domain of a car and print the verdict; clause: start of the message.

    Raises
    ------
    InvalidInput
        When the loop is unstable when driving straight and `allowed` is False.
    """
    certificate = _certificate(tuning, *loop)
    clause = f"{clause}: certificate over the domain of {loop[2].name!r}: {certificate.verdict}"
    if not certificate.passed and not allowed:
        raise InvalidInput(f"{clause} To drive it anyway, use --allow-failed.")
    show.say(f"Warning, {clause}", aside=True)


def _certificate(tuning: Schedule | Tuning, mpc: MPC, plant: Any, car: Vehicle, world: Profile) -> Certificate:
    from adaptrack.analysis.certify import certify
    from adaptrack.analysis.stability import linear_twin

    domain = {"speed": car.domain.speed, "friction": car.domain.friction}
    with show.progress("certify for this car") as advance:
        return certify(
            tuning, linear_twin(plant, car, car.domain), mpc, world.without_sample_ages, domain=domain, levels=LEVELS,
            progress=advance,
        )  # fmt: skip
