"""The plug-ins have their names in their own tests alone."""

import pytest

from adaptrack.cars import plant
from adaptrack.control.controllers import registry

PLACES = ((registry._registry, "factories"), (registry, "_descriptions"), (plant._registry, "factories"))
BEFORE = [dict(getattr(owner, name)) for owner, name in PLACES]

import commonroad_cars  # noqa: E402, F401
import lpv_mpc  # noqa: E402, F401
import mppi  # noqa: E402, F401
import nmpc  # noqa: E402, F401

REGISTERED = [getattr(owner, name) for owner, name in PLACES]
for (owner, name), members in zip(PLACES, BEFORE, strict=True):
    setattr(owner, name, members)


@pytest.fixture(autouse=True)
def _registered(monkeypatch):
    for (owner, name), members in zip(PLACES, REGISTERED, strict=True):
        monkeypatch.setattr(owner, name, members)
