"""A schedule: from the scheduling variables to the entries of a controller's tuning, at every step.

It looks at some of the scheduling variables, clips them to the domain that it was made for, and gives each entry of
the tuning as a function of them: a number, a network, a fuzzy system or a table. For the MPC, horizons are rounded and
Nc <= Np; everything is held within bounds. `Guarded` adds what makes its output safe to use. The same compiled
code runs in a car's control loop, in `simulate` and in whole batches of runs.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Count, Natural, NotNegative, Positive, checked, real, reals
from adaptrack.base.errors import ConfigError, InvalidInput, StorageError, did_you_mean
from adaptrack.base.files import read_json, write_atomically
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.base.registry import Contract
from adaptrack.cars.vehicle import find_data, list_data
from adaptrack.control.controllers import MPC, Tuning
from adaptrack.control.controllers.base import Policy
from adaptrack.control.controllers.compatibility import car_of
from adaptrack.control.controllers.tuning import ENTRIES as ENTRIES
from adaptrack.control.controllers.tuning import HORIZONS
from adaptrack.control.controllers.tuning import read_tuning as read_tuning
from adaptrack.control.scheduling.functions import Function, Number, Pool, Table, load_function, save_function
from adaptrack.control.scheduling.variables import VARIABLES, SchedulingVariables, complete
from adaptrack.core.library import kernels_hash
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.scheduling import guard as guard_kernel
from adaptrack.core.scheduling import schedule as kernel
from adaptrack.core.scheduling.functions import VARIABLE_NAMES
from adaptrack.scenario.profile import load_profile

ENTRY_BOUNDS: dict[str, tuple[float, float]] = {"Np": (1, 60), "Nc": (1, 20), "Q": (1e-6, 1e9), "R": (1e-9, 1e9)}
"""Bounds of the entries of the MPC, where no others are given."""
MAX_HORIZON = 1000
"""The longest horizon that a schedule may ask for: a controller makes room for it."""
SCHEDULER_FORMAT, VERSION = "adaptrack-scheduler", 2
"""Of the files of schedules: JSON with a format, a version and a checksum."""


@dataclass(frozen=True, eq=False)
class Entry:
    """How one entry of the tuning follows from the inputs.

    Raises
    ------
    InvalidInput
        When the function is neither a `Function` nor a finite number, or a bound is no number.
    """

    function: Function
    """a plain number stands for a `Number`"""
    low: float
    high: float
    """bounds of the value"""
    log10: bool = False
    """whether the function gives log10 of the value"""

    def __post_init__(self) -> None:
        function: Any = self.function
        if not isinstance(function, Function):
            object.__setattr__(self, "function", Number(function))
        for bound in ("low", "high"):
            object.__setattr__(self, bound, real("entry", bound, getattr(self, bound)))
        object.__setattr__(self, "log10", bool(self.log10))


@checked
@dataclass(frozen=True, eq=False)
class StabilityMap:
    """1 - modulus margin of the loop over speed (m/s), friction, Np, Nc and log10 R/Q; see `stability.loop_map`.

    Raises
    ------
    InvalidInput
        When the table has not these five axes.
    """

    table: Table
    """above 1 the loop is unstable"""
    limit: Positive = 0.92
    """the largest value that is allowed: 1 - the least modulus margin"""

    def __post_init__(self) -> None:
        table, axes = self.table, guard_kernel.MAP_AXES
        if not isinstance(table, Table) or table.n_inputs != axes or table.method != "multilinear":
            raise InvalidInput("StabilityMap: needs a multilinear table over speed, friction, Np, Nc and log10 R/Q.")


@checked
@dataclass(frozen=True, eq=False)
class Guard:
    """Supervision of a scheduler's output before it reaches the MPC.

    Raises
    ------
    InvalidInput
        When a rate of the horizons is not whole.
    """

    fallback: Tuning
    """used while the output is not trusted"""
    rates: tuple[Positive, Positive, Positive] = (5.0, 2.0, 0.3)
    """largest change of Np, of Nc (both whole numbers) and of log10 R/Q from one step to the next"""
    slack: NotNegative = 0.25
    """how far outside the domain an input may lie, in widths of the domain, before the fallback is used"""
    hold: Count = 20
    """steps that a fallback lasts, the last one with its cause included"""
    stability: StabilityMap | None = None
    """without it the loop's stability is not looked at"""
    offset_limit: Annotated[Positive, "s^2"] | None = None
    """the largest |offset| over friction times g, before the fallback is used; without it any offset is allowed

    A tuning that is stable near the reference may not be so where the tyres saturate: an error too large for the grip
    to take back in time is the first sign of it."""

    def __post_init__(self) -> None:
        if any(rate != round(rate) for rate in self.rates[:2]):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: those of Np and Nc must be whole numbers.")

    def pack(self, row: Any, pool: Pool) -> None:
        """Write it to its record in a packed schedule (`core.scheduling.guard.GUARD`)."""
        row.used, row.hold, row.slack = True, self.hold, self.slack
        row.fallback[:] = self.fallback.as_array()
        row.rates[:], row.ratio_rate = self.rates[:2], self.rates[2]
        row.offset_limit = math.inf if self.offset_limit is None else self.offset_limit * GRAVITY
        if self.stability is not None:
            row.mapped, row.limit = True, self.stability.limit
            pool.add(self.stability.table, row)

    def saved(self) -> dict[str, Any]:
        """Return the content of the guard's file (text, numbers, lists), which `loaded` reads back to the bit."""
        stability = self.stability
        return {
            "fallback": self.fallback.as_array().tolist(),
            "rates": list(self.rates),
            "slack": self.slack,
            "hold": self.hold,
            "offset_limit": self.offset_limit,
            "stability": stability and {"limit": stability.limit, "table": save_function(stability.table)},
        }

    @classmethod
    def loaded(cls, saved: Mapping[str, Any]) -> Self:
        """The guard that was `saved`; raises `KeyError`, `TypeError`, `ValueError` or `InvalidInput` if it is none."""
        Np, Nc, Q, R = saved["fallback"]
        stability = saved["stability"]
        if stability is not None:
            table = load_function(stability["table"])
            if not isinstance(table, Table):
                raise InvalidInput("the guard's stability map is no table")
            stability = StabilityMap(table, stability["limit"])
        return cls(
            Tuning(int(Np), int(Nc), Q, R), tuple(saved["rates"]), saved["slack"], saved["hold"], stability,
            saved["offset_limit"],
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Schedule:
    """A scheduler as data: inputs, their domain, and a function for every entry of the tuning.

    Calling it gives the tuning for one set of scheduling variables, without memory; a controller and compiled runs keep
    a memory of their own for each run (`plan`), in which rate limits act and interventions are counted.

    Raises
    ------
    InvalidInput
        When an entry is missing, an input is unknown, or a function does not fit the inputs.
    """

    inputs: tuple[str, ...]
    """the scheduling variables that the functions see, in this order"""
    domain: Array
    """(D, 2) low and high of each input: values outside are clipped"""
    tuning: Mapping[str, Entry]
    """by name"""
    guard: Guard | None = None
    """of the MPC's entries only"""
    name: str = "schedule"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """how it was made"""
    made_for: Mapping[str, Any] = field(default_factory=dict)
    """the car, profile, controller and kernels that it was made for, as far as they are known; see `made_for`"""
    entries: tuple[str, ...] = ENTRIES
    """names of the controller's tuning entries, in the controller's order"""

    def __post_init__(self) -> None:
        for name in ("inputs", "entries"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "domain", np.asarray(self.domain, dtype=np.float64))
        self._check_inputs()
        self._check_entries()
        if self.guard is not None and not self.tunes_mpc:
            raise InvalidInput("schedule: only the MPC's entries can be guarded.")
        if max(self.largest) > MAX_HORIZON:
            raise InvalidInput(
                f"schedule: asks for horizons of up to {max(self.largest)} steps, at most {MAX_HORIZON} may be."
            )
        if not isinstance(self.name, str) or not all(
            isinstance(record, Mapping) for record in (self.provenance, self.made_for)
        ):
            raise InvalidInput("schedule: name must be text, provenance and made_for mappings.")

    def _check_inputs(self) -> None:
        for name in self.inputs:
            if name not in VARIABLES:
                raise InvalidInput(f"schedule: unknown input {name!r}. {did_you_mean(name, VARIABLES)}")
        if len(set(self.inputs)) < len(self.inputs) or not self.inputs:
            raise InvalidInput(f"schedule: inputs = {self.inputs!r}: must be one or more different names.")
        fits = self.domain.shape == (len(self.inputs), 2) and np.isfinite(self.domain).all()
        if not fits or (self.domain[:, 0] > self.domain[:, 1]).any():
            raise InvalidInput(f"schedule: domain: need finite low <= high for each of {', '.join(self.inputs)}.")

    def _check_entries(self) -> None:
        are_names = all(isinstance(name, str) for name in self.entries) and len(set(self.entries)) == len(self.entries)
        if not are_names or not 0 < len(self.entries) <= guard_kernel.MAX_ENTRIES:
            raise InvalidInput(
                f"schedule: entries = {self.entries!r}: must be 1 to {guard_kernel.MAX_ENTRIES} different names."
            )
        if set(self.tuning) != set(self.entries):
            raise InvalidInput(
                f"schedule: the tuning has {', '.join(map(str, self.tuning)) or 'no entry'}; "
                f"there must be {', '.join(self.entries)}."
            )
        for name, entry in self.tuning.items():
            reads = entry.function.n_inputs
            if reads not in (None, len(self.inputs)):
                raise InvalidInput(
                    f"schedule: the function of {name} has {reads} inputs, the schedule {len(self.inputs)}."
                )
            least = -math.inf
            if self.tunes_mpc:
                least = 1.0 if name in HORIZONS else 0.0
            finite = math.isfinite(entry.low) and math.isfinite(entry.high)
            if not (finite and least <= entry.low <= entry.high) or (
                self.tunes_mpc and name == "R" and entry.low <= 0.0
            ):
                raise InvalidInput(
                    f"schedule: bounds of {name} are ({entry.low!r}, {entry.high!r}): need finite low <= high"
                    f"{', those of R positive, of horizons at least 1' if self.tunes_mpc else ''}."
                )

    @property
    def tunes_mpc(self) -> bool:
        """True if the schedule tunes the MPC, whose rules for horizons and weights then hold."""
        return self.entries == ENTRIES

    @property
    def is_constant(self) -> bool:
        """Whether all entries are numbers."""
        return all(isinstance(entry.function, Number) for entry in self.tuning.values())

    def as_policy(self) -> Policy:
        """Return the policy that drives runs with their MPC and this schedule."""
        return Policy(scheduler=self)

    @property
    def largest(self) -> tuple[int, int]:
        """The longest Np and Nc that it can ask for; 0 of a schedule for another controller."""
        if not self.tunes_mpc:
            return 0, 0
        highest = [self.tuning[name].high for name in HORIZONS]
        if self.guard is not None:
            highest = [max(highest[0], self.guard.fallback.Np), max(highest[1], self.guard.fallback.Nc)]
        return int(highest[0]), int(highest[1])

    def __repr__(self) -> str:
        guard = "" if self.guard is None else ", guarded"
        return f"<Schedule {self.name!r}: {', '.join(self.entries)} of {', '.join(self.inputs)}{guard}>"

    def plot(self) -> Any:
        """The tuning over the first input, for three values of the second, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The schedule in a notebook: inputs, entries, and the tuning in pictures."""
        return html_of(self)

    def plan(self, slots: int) -> Any:
        """The schedule for the kernels (`core.scheduling.schedule.ScheduleRecord`), memory for `slots` runs fresh."""
        settings, integers, numbers, scratch = self._packed
        return kernel.ScheduleRecord(
            settings, np.zeros(slots, guard_kernel.MEMORY), integers, numbers, np.zeros(scratch)
        )

    def __call__(self, variables: SchedulingVariables) -> tuple[float, ...]:
        """The tuning for some scheduling variables, as at the first step of a run; (Np, Nc, Q, R) of the MPC.

        Raises
        ------
        InvalidInput
            When a variable is missing that has no default, see `variables.complete`.
        """
        return tuple(self.batch([complete(variables)])[0].tolist())

    def batch(self, variables: ArrayLike) -> Array:
        """(n, entries) tunings for n rows of scheduling variables (n, 4 to 7), each as at a first step.

        Raises
        ------
        InvalidInput
            When the rows are not like `SchedulingVariables`.
        """
        points = np.atleast_2d(reals("schedule: the scheduling variables", variables))
        least = len(VARIABLES) - len(SchedulingVariables._field_defaults)
        if points.ndim != 2 or not least <= points.shape[1] <= len(VARIABLES):
            raise InvalidInput(
                f"schedule: variables of shape {points.shape}: need a row for each, like `SchedulingVariables`."
            )
        rows = np.zeros((len(points), len(VARIABLES)))
        rows[:, : points.shape[1]] = points
        tunings = np.full((len(rows), len(self.entries)), np.nan)
        kernel.schedule_all(rows, self.plan(1), tunings)
        return tunings

    @cached_property
    def _packed(self) -> tuple[Any, NDArray[np.int64], Array, int]:
        """settings, integers, numbers and the length of the scratch, see `core.scheduling.schedule`."""
        array, pool = kernel.SCHEDULE_SETTINGS.new(1), Pool()
        settings = array[0]
        settings.n_inputs, settings.n_entries = len(self.inputs), len(self.entries)
        settings.tunes_mpc = self.tunes_mpc
        for row, name, (low, high) in zip(settings.inputs, self.inputs, self.domain.tolist(), strict=False):
            row.place, row.low, row.high = VARIABLE_NAMES.index(name), low, high
        for row, name in zip(settings.entries, self.entries, strict=False):
            entry = self.tuning[name]
            row.kind = pool.add(entry.function, row)
            row.log10, row.horizon = entry.log10, self.tunes_mpc and name in HORIZONS
            row.low, row.high = entry.low, entry.high
        if self.guard is not None:
            self.guard.pack(settings.guard, pool)
        scratch = pool.scratch + kernel.SCHEDULE_SCRATCH
        return array, np.array(pool.integers, np.int64), np.array(pool.numbers, np.float64), scratch

    def __getstate__(self) -> dict[str, Any]:
        """Without what is packed: data types that were pickled are slower to pass to a kernel."""
        return {name: value for name, value in self.__dict__.items() if name != "_packed"}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as one JSON file that `load_scheduler` reads back to the bit; it is then called as the file is.

        Raises
        ------
        InvalidInput
            When its provenance or `made_for` holds what JSON cannot.
        StorageError
            When the file cannot be written; an older one at `path` is then untouched.
        """
        content = replace(self, name=Path(path).stem)._saved()
        try:
            text = json.dumps(content, allow_nan=False, separators=(",", ":"))
        except (TypeError, ValueError) as error:
            raise InvalidInput(
                f"schedule {self.name!r}: its provenance and made_for must be text and finite numbers: {error}."
            ) from None
        checksum = hashlib.sha256(text.encode()).hexdigest()
        document = {"format": SCHEDULER_FORMAT, "version": VERSION, "sha256": checksum, "content": content}
        write_atomically(path, (json.dumps(document, separators=(",", ":")) + "\n").encode())

    def _saved(self) -> dict[str, Any]:
        entries = {name: self.tuning[name] for name in self.entries}
        return {
            "name": self.name,
            "made_for": dict(self.made_for),
            "inputs": list(self.inputs),
            "domain": self.domain.tolist(),
            "entries": [
                {"name": name, "low": e.low, "high": e.high, "log10": e.log10, "function": save_function(e.function)}
                for name, e in entries.items()
            ],
            "guard": None if self.guard is None else self.guard.saved(),
            "provenance": dict(self.provenance),
        }

    @classmethod
    def loaded(cls, content: Mapping[str, Any]) -> Self:
        """The schedule of a file's content; raises `KeyError`, `TypeError`, `ValueError`, ... when it makes none."""
        entries = {
            entry["name"]: Entry(load_function(entry["function"]), entry["low"], entry["high"], entry["log10"])
            for entry in content["entries"]
        }
        if len(entries) != len(content["entries"]):
            raise InvalidInput("two entries have the same name")
        return cls(
            inputs=tuple(content["inputs"]),
            domain=np.array(content["domain"], float),
            tuning=entries,
            guard=None if content["guard"] is None else Guard.loaded(content["guard"]),
            name=content["name"],
            provenance=content["provenance"],
            made_for=content["made_for"],
            entries=tuple(entries),
        )


@checked
def Constant(tuning: Tuning, name: str = "constant") -> Schedule:
    """Make a schedule that returns one tuning everywhere."""
    values = dict(zip(ENTRIES, tuning.as_array().tolist(), strict=True))
    entries = {entry: Entry(Number(value), value, value) for entry, value in values.items()}
    return Schedule(("speed",), np.array([[0.0, 1000.0]]), entries, name=name)


@checked
def Guarded(schedule: Schedule, fallback: Tuning, *, stability: StabilityMap | None = None, **limits: Any) -> Schedule:
    """`schedule` behind a `Guard`: domain, rate, tracking error and stability are checked at every step."""
    guard = Guard(fallback, stability=stability, **limits)
    if not isinstance(schedule, Schedule):
        raise InvalidInput(f"Guarded: {schedule!r}: must be a Schedule; a plain function cannot be guarded.")
    return replace(schedule, guard=guard, name=f"{schedule.name} (guarded)")


@checked
def Lookup(
    axes: Mapping[str, ArrayLike], tunings: ArrayLike, method: Literal["nearest", "multilinear"] = "multilinear",
    name: str = "lookup", provenance: Mapping[str, Any] | None = None,
) -> Schedule:  # fmt: skip
    """Tunings at the nodes of a grid; between them the nearest one, or interpolated, Q and R by their logarithms.

    At a node itself the tuning is the one given (Q and R to the last digit but one, when interpolated).

    axes: the nodes of each input, by name; tunings: (len(axis 1), len(axis 2), ..., 4) of Np, Nc, Q, R.
    """
    nodes = {key: np.asarray(values, dtype=np.float64) for key, values in axes.items()}
    nodal_tunings = np.asarray(tunings, dtype=np.float64)
    shape = tuple(len(values) for values in nodes.values())
    if nodal_tunings.shape != (*shape, 4):
        raise InvalidInput(f"Lookup: tunings must have the shape {(*shape, 4)}, they have {nodal_tunings.shape}.")
    if not np.isfinite(nodal_tunings).all() or (nodal_tunings <= 0.0).any():
        raise InvalidInput("Lookup: every Np, Nc, Q, R must be finite and positive.")
    entries = {}
    for i, entry in enumerate(ENTRIES):
        values = nodal_tunings[..., i]
        log10 = entry in ("Q", "R") and method == "multilinear"
        table = Table(tuple(nodes.values()), portable.log10(values) if log10 else values, method)
        entries[entry] = Entry(table, float(values.min()), float(values.max()), log10)
    domain = np.array([[values[0], values[-1]] for values in nodes.values()])
    return Schedule(tuple(nodes), domain, entries, name=name, provenance=provenance or {})


@checked
def Learned(
    functions: Mapping[str, Function | float], inputs: Sequence[str], domain: ArrayLike,
    bounds: Mapping[str, tuple[float, float]] | None = None, name: str = "learned",
    provenance: Mapping[str, Any] | None = None,
) -> Schedule:  # fmt: skip
    """Learned functions for the entries of the MPC's tuning.

    functions: by entry; `log10_ratio` in place of R is the logarithm of R/Q, Q then being a number (1 when left out);
    inputs, domain: see `Schedule`; bounds: (low, high) of each entry's value, `ENTRY_BOUNDS` where left out.
    """
    entry_functions = dict(functions)
    bounds = {**ENTRY_BOUNDS, **(bounds or {})}
    decades = "log10_ratio" in entry_functions
    if decades:
        if "R" in entry_functions:
            raise InvalidInput("Learned: give either R or log10_ratio.")
        if entry_functions.setdefault("Q", 1.0) not in (1.0, Number(1.0)):
            raise InvalidInput("Learned: with log10_ratio, Q must be 1: only R/Q changes the control law.")
        entry_functions["R"] = entry_functions.pop("log10_ratio")
    for entry in (*entry_functions, *bounds):
        if entry not in ENTRIES:
            raise InvalidInput(
                f"Learned: unknown entry {entry!r}: entries are {', '.join(ENTRIES)}, and log10_ratio for R."
            )
    entries = {
        entry: Entry(_function(entry, function), *bounds[entry], decades and entry == "R")
        for entry, function in entry_functions.items()
    }
    return Schedule(tuple(inputs), np.asarray(domain, float), entries, name=name, provenance=provenance or {})


def _function(entry: str, function: Function | float) -> Function:
    if isinstance(function, Function):
        return function
    if not math.isfinite(real("Learned", entry, function)):
        raise InvalidInput(f"Learned: {entry} = {function!r}: must be finite.")
    return Number(function)


# -- files of schedules ------------------------------------------------------------------------------------------------
@checked
def load_scheduler(name_or_path: str | os.PathLike[str]) -> Schedule:
    """The schedule in a file, or one that ships with the package, by name (`list_schedulers`).

    Its name is that of the file, without the ending.

    Raises
    ------
    UnknownName
        When no scheduler has the name.
    StorageError
        When the file cannot be read, is damaged, is not a scheduler, or has a version that this program cannot read.
    """
    path = find_data("schedulers", name_or_path, ".json")
    content = _read_content(path)
    try:
        schedule = replace(Schedule.loaded(content), name=path.stem)
        _ = schedule._packed  # numbers too large for the kernels are found here
    except KeyError as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error} is missing.") from None
    except (InvalidInput, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error}.") from None
    return schedule


def list_schedulers() -> list[str]:
    """The names of the schedulers that ship with the package."""
    return list_data("schedulers", ".json")


def made_for(mpc: MPC, profile: str) -> dict[str, Any]:
    """Return the scope of a schedule for its file: car, profile, controller and kernel version."""
    described = mpc.describe()
    return {
        "car": car_of(mpc.model) or mpc.model.name,
        "profile": load_profile(profile).name,
        "controller": {
            "kind": "MPC",
            "model": mpc.kind_of_model,
            **{key: described[key] for key in ("moves", "period", "preview")},
        },
        "kernels": kernels_hash(),
    }


def _read_content(path: Path) -> Any:
    """The content of a scheduler's file, its checksum compared.

    Raises StorageError when the file cannot be read, is damaged, is no scheduler, or has a version that this program
    cannot read.
    """
    try:
        file = read_json(path)
    except ConfigError as error:
        raise StorageError(f"{error} It is not a scheduler file, or damaged: train or copy it again.") from None
    if not isinstance(file, dict) or file.get("format") != SCHEDULER_FORMAT:
        raise StorageError(f"{path}: not a scheduler file: its format is not {SCHEDULER_FORMAT!r}.")
    if file.get("version") != VERSION:
        raise StorageError(
            f"{path}: version {file.get('version')!r} of the scheduler format; this program reads {VERSION}. "
            "Train it again, or use the version of adaptrack that wrote it."
        )
    content = file.get("content")
    try:
        digest = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    except RecursionError:
        raise StorageError(f"{path}: not a scheduler file: its content is nested too deeply.") from None
    if digest != file.get("sha256"):
        raise StorageError(f"{path}: damaged: its content does not match its checksum. Train or copy it again.")
    return content


# -- the contract ------------------------------------------------------------------------------------------------------
@checked
def check_scheduler(scheduler: Any, samples: Count = 200, seed: Natural = 0) -> None:
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
    contract = Contract("scheduler")
    contract.require(callable(scheduler), "must be callable, variables -> (Np, Nc, Q, R)", repr(scheduler))
    rows = _check_samples(samples, np.random.default_rng(seed))
    entries = scheduler.entries if isinstance(scheduler, Schedule) else ENTRIES
    for row in rows:
        variables = SchedulingVariables(*row.tolist())
        try:
            tuning, again = (read_tuning(scheduler(variables), entries) for _ in range(2))
        except (Exception, SystemExit) as error:
            raise contract.breach(f"failed for {variables}", error) from error
        contract.require(
            tuning == again, "must give the same for the same variables", f"{tuning}, {again}, {variables}"
        )
        if entries == ENTRIES:
            Np, Nc, Q, R = tuning
            is_sound = 1 <= round(Nc) <= round(Np) and Q >= 0.0 and R > 0.0
            contract.require(is_sound, "need 1 <= Nc <= Np, Q >= 0, R > 0", f"{tuning} for {variables}")
    if isinstance(scheduler, Schedule):
        _check_functions(replace(scheduler, guard=None), rows, contract)


def _check_samples(count: int, rng: np.random.Generator) -> Array:
    """Scheduling variables inside, at the corners of and far outside the operating domain."""
    low, high = np.array([(variable.low, variable.high) for variable in VARIABLES.values()]).T
    rows = low + (high - low) * rng.uniform(size=(count, len(low)))
    rows[::7] = np.where(rng.uniform(size=rows[::7].shape) < 0.5, low, high)
    rows[::11] += rng.normal(size=rows[::11].shape) * 3.0 * (high - low)
    return rows


def _check_functions(schedule: Schedule, rows: Array, contract: Contract) -> None:
    planned = Schedule.batch(schedule, rows)  # what compiled runs are given
    called = np.array([read_tuning(schedule(SchedulingVariables(*row)), schedule.entries) for row in rows.tolist()])
    k = int(np.argmax((called != planned).any(axis=1)))
    evidence = f"called, it gives {called[k].tolist()}; compiled, {planned[k].tolist()}"
    contract.require((called == planned).all(), "must give the same in Python and compiled", evidence)
    for i, name in enumerate(schedule.entries):
        alone = Schedule(schedule.inputs, schedule.domain, {name: schedule.tuning[name]}, entries=(name,))
        expected = alone.batch(rows)[:, 0]  # neither rounded nor kept below another entry
        if schedule.tunes_mpc and name == "Nc":
            expected = np.minimum(expected, planned[:, 0])
        off = np.abs(planned[:, i] - expected)
        rounded = schedule.tunes_mpc and name in HORIZONS
        differs = off > (0.5 + 1e-9 if rounded else 1e-9 * np.abs(expected))  # at .5 rounding may go either way
        k = int(np.argmax(differs))
        value = f"{float(planned[k, i])!r} at {SchedulingVariables(*rows[k].tolist())}"
        evidence = f"it is {value}, where its own function gives {float(expected[k])!r}"
        contract.require(not differs.any(), f"entry {name} must be that of its function", evidence)
