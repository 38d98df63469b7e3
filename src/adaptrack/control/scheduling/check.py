"""The contract of a scheduler, as a test that ours and anybody's must pass."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import ContractError
from adaptrack.control.controllers.tuning import ENTRIES, HORIZONS
from adaptrack.control.controllers.tuning import read_tuning as read_tuning
from adaptrack.control.scheduling.schedule import Schedule
from adaptrack.control.scheduling.variables import VARIABLES, SchedulingVariables
from adaptrack.core.maths import portable

Array = NDArray[np.float64]


def check_scheduler(scheduler: Any, samples: int = 200, seed: int = 0) -> None:
    """Refuse a scheduler that breaks the contract.

    It must be callable with `SchedulingVariables` and give a `Tuning` or four finite numbers (Np, Nc, Q, R) with
    1 <= Nc <= Np after rounding, Q >= 0 and R > 0, for variables inside, at the corners of and far outside the
    operating domain (`VARIABLES`); and give the same for the same variables. Of a `Schedule` for another controller,
    the answer must be a finite number for each of its entries. Every entry of a `Schedule` is also compared with its
    own function evaluated alone: no output can reach another's entry.

    Raises
    ------
    ContractError
        When it breaks one; the message gives the variables and what came back.
    """
    if not callable(scheduler):
        raise ContractError(f"scheduler {scheduler!r}: must be callable, scheduling variables -> (Np, Nc, Q, R).")
    rows = _samples(samples, np.random.default_rng(seed))
    entries = scheduler.entries if isinstance(scheduler, Schedule) else ENTRIES
    for row in rows:
        variables = SchedulingVariables(*row.tolist())
        first_tuning, again = _tuning_of(scheduler, variables, entries), _tuning_of(scheduler, variables, entries)
        if first_tuning != again:
            raise ContractError(f"scheduler: gave {first_tuning} and then {again} for the same {variables}.")
        if entries == ENTRIES:
            Np, Nc, Q, R = first_tuning
            if not (1 <= round(Nc) <= round(Np) and Q >= 0.0 and R > 0.0):
                raise ContractError(
                    f"scheduler: gave {first_tuning} for {variables}: need 1 <= Nc <= Np, Q >= 0, R > 0."
                )
    if isinstance(scheduler, Schedule):
        _check_functions(replace(scheduler, guard=None), rows)


def _samples(count: int, rng: np.random.Generator) -> Array:
    """Scheduling variables inside, at the corners of and far outside the operating domain."""
    low, high = np.array([(variable.low, variable.high) for variable in VARIABLES.values()]).T
    rows = low + (high - low) * rng.uniform(size=(count, len(low)))
    rows[::7] = np.where(rng.uniform(size=rows[::7].shape) < 0.5, low, high)
    rows[::11] += rng.normal(size=rows[::11].shape) * 3.0 * (high - low)
    return rows


def _tuning_of(scheduler: Any, variables: SchedulingVariables, entries: tuple[str, ...]) -> tuple[float, ...]:
    try:
        return read_tuning(scheduler(variables), entries)
    except (Exception, SystemExit) as error:
        raise ContractError(f"scheduler: failed for {variables}: {error}") from error


def _check_functions(schedule: Schedule, rows: Array) -> None:
    planned = Schedule.batch(schedule, rows)  # what compiled runs are given
    called = np.array([read_tuning(schedule(SchedulingVariables(*row)), schedule.entries) for row in rows.tolist()])
    if (called != planned).any():
        k = int(np.argmax((called != planned).any(axis=1)))
        raise ContractError(f"scheduler: called, it gives {called[k].tolist()}; compiled, {planned[k].tolist()}.")
    columns = [SchedulingVariables._fields.index(name) for name in schedule.inputs]
    x = np.clip(rows[:, columns], *schedule.domain.T)
    for i, name in enumerate(schedule.entries):
        entry = schedule.tuning[name]
        expected = entry.function.predict(x)
        expected = np.clip(portable.power(10.0, expected) if entry.log10 else expected, entry.low, entry.high)
        if schedule.tunes_mpc and name == "Nc":
            expected = np.minimum(expected, planned[:, 0])
        off = np.abs(planned[:, i] - expected)
        rounded = schedule.tunes_mpc and name in HORIZONS
        differs = off > (0.5 + 1e-9 if rounded else 1e-9 * np.abs(expected))  # at .5 rounding may go either way
        if differs.any():
            k = int(np.argmax(differs))
            raise ContractError(
                f"scheduler: entry {name} is {float(planned[k, i])!r} at {SchedulingVariables(*rows[k].tolist())}, "
                f"where its own function gives {float(expected[k])!r}."
            )
