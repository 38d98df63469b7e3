"""What a scheduler's file says that it was made for, held against the controller and the profile that it meets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

INCREMENTAL = "incremental"
"""What the files of schedulers call the paper's model and estimator."""
INFORMED = "path, kalman"
"""And those of the informed controller, see `MPC.kind_of_model`."""


def mismatches(made_for: Any, model: str, car: str | None, profile: str | None) -> list[str]:
    """A sentence with its remedy for each of controller, car and profile that is another than the file names.

    made_for: of a schedule, see `scheduling.files.made_for`; what it does not tell is not compared. model:
    `MPC.kind_of_model`; car, profile: their names, None where they are not known.
    """
    told = made_for if isinstance(made_for, Mapping) else {}
    asked, found = _model_of(told), []
    if asked not in (None, model):
        remedy = "published_mpc(...) is that one" if asked == INCREMENTAL else "learn it on this one"
        found.append(f"tunes an MPC whose model is {model!r}, not {asked!r}, for which it was made: {remedy}")
    for what, here in (("car", car), ("profile", profile)):
        if here is not None and told.get(what) not in (None, here):
            found.append(
                f"was made for the {what} {told[what]!r}, not {here!r}: leave it out, or make one for it "
                "(`adaptrack adapt`)"
            )
    return found


def is_for_published(made_for: Any) -> bool:
    """Whether a scheduler was made for the paper's MPC; one that does not tell is taken for such."""
    return _model_of(made_for) in (None, INCREMENTAL)


def _model_of(made_for: Any) -> Any:
    """What stands in a file for the model that is tuned; a file may say anything."""
    named = made_for.get("controller") if isinstance(made_for, Mapping) else None
    return named.get("model") if isinstance(named, Mapping) else None
