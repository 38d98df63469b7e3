"""Schedulers: from a condition to the tuning of the MPC, at every step.

Every scheduler here is the same thing: it looks at some entries of a `Condition`, clips them to the domain that it was
made for, and fills each of the four slots Np, Nc, Q, R with a function of them: a number, a network, a fuzzy system or
a table. Horizons are rounded, everything is held within bounds, and Nc <= Np. `Guarded` adds what makes its output safe
to use. The same compiled code runs in a car's control loop, in `simulate` and in whole batches of runs.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import ContractError, InvalidInput, StorageError, UnknownName, did_you_mean, real, whole
from adaptrack.files import write_atomically
from adaptrack.learning.network import Network
from adaptrack.learning.sugeno import WIDTH, Sugeno
from adaptrack.mpc import Condition, Tuning, astuple
from adaptrack.vehicle import GRAVITY

Array = NDArray[np.float64]

SLOTS = ("Np", "Nc", "Q", "R")
BOUNDS: dict[str, tuple[float, float]] = {"Np": (1, 60), "Nc": (1, 20), "Q": (1e-6, 1e9), "R": (1e-9, 1e9)}
"""What a slot's value is held within, unless told otherwise."""
LONGEST = 1000
"""The longest horizon that a schedule may ask for: a controller makes room for it."""

FORMAT, VERSION = "adaptrack-scheduler", 1


@dataclass(frozen=True, eq=False)
class Table:
    """Values at the nodes of a grid.

    Raises
    ------
    InvalidInput
        When the axes do not ascend, do not fit the values, or something is not finite.
    """

    axes: tuple[Array, ...]
    """the nodes along each input, ascending"""
    values: Array
    """one for each node, (len(axes[0]), len(axes[1]), ...)"""
    method: Literal["nearest", "multilinear"] = "multilinear"

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", tuple(np.asarray(axis, dtype=np.float64) for axis in self.axes))
        object.__setattr__(self, "values", np.ascontiguousarray(self.values, dtype=np.float64))
        if self.method not in ("nearest", "multilinear"):
            raise InvalidInput(f"Table: method = {self.method!r}: must be 'nearest' or 'multilinear'.")
        for axis in self.axes:
            if axis.ndim != 1 or not axis.size or not np.isfinite(axis).all() or (np.diff(axis) <= 0.0).any():
                raise InvalidInput(f"Table: an axis must be finite numbers that ascend, got {axis!r}.")
        shape = tuple(len(axis) for axis in self.axes)
        if not shape or self.values.shape != shape or not np.isfinite(self.values).all():
            raise InvalidInput(f"Table: needs finite values of shape {shape}, got {self.values.shape}.")


Function = float | Network | Sugeno | Table
"""What may fill a slot."""


@dataclass(frozen=True, eq=False)
class Slot:
    """How one number of the tuning follows from the inputs."""

    function: Function
    low: float
    high: float
    """bounds of the value"""
    decades: bool = False
    """whether the function gives log10 of the value"""

    def __post_init__(self) -> None:
        for bound in ("low", "high"):
            object.__setattr__(self, bound, real("slot", bound, getattr(self, bound)))


@dataclass(frozen=True, eq=False)
class StabilityMap:
    """How near the loop is to instability, over speed (m/s), friction, Np, Nc and log10 R/Q; see `stability.loop_map`.

    Raises
    ------
    InvalidInput
        When the table has not these five axes, or the limit is not positive.
    """

    table: Table
    limit: float = 0.92
    """the largest nearness that is allowed; from 1 on the loop is unstable"""

    def __post_init__(self) -> None:
        if not isinstance(self.table, Table) or len(self.table.axes) != 5:
            raise InvalidInput("StabilityMap: needs a table over speed, friction, Np, Nc and log10 R/Q.")
        if not 0.0 < real("StabilityMap", "limit", self.limit) < math.inf:
            raise InvalidInput(f"StabilityMap: limit = {self.limit!r}: must be positive and finite.")


@dataclass(frozen=True, eq=False)
class Guard:
    """What stands between a scheduler's output and the MPC.

    Raises
    ------
    InvalidInput
        When a limit is not positive, or a rate of the horizons not whole.
    """

    fallback: Tuning
    """used while the output is not trusted"""
    rates: tuple[float, float, float] = (5.0, 2.0, 0.3)
    """largest change of Np, of Nc (both whole numbers) and of log10 R/Q from one step to the next"""
    slack: float = 0.25
    """how far outside the domain an input may lie, in widths of the domain, before the fallback is used"""
    hold: int = 20
    """steps that a fallback lasts, the last one with its cause included"""
    stability: StabilityMap | None = None
    """without it the loop's stability is not looked at"""
    offset_limit: float | None = None
    """s^2, the largest |offset| over friction times g, before the fallback is used; without it the car may stray

    A tuning that is stable near the reference may not be so where the tyres saturate: an error too large for the grip
    to take back in time is the first sign of it."""

    def __post_init__(self) -> None:
        if not isinstance(self.fallback, Tuning):
            raise InvalidInput(f"Guard: fallback = {self.fallback!r}: must be a Tuning.")
        rates = [real("Guard", "rates", rate) for rate in self.rates]
        if len(rates) != 3 or not all(0.0 < rate < math.inf for rate in rates):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: must be three positive numbers.")
        if any(rate != round(rate) for rate in rates[:2]):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: those of Np and Nc must be whole numbers.")
        if not 0.0 <= real("Guard", "slack", self.slack) < math.inf:
            raise InvalidInput(f"Guard: slack = {self.slack!r}: must be finite and not negative.")
        if self.offset_limit is not None and not 0.0 < real("Guard", "offset_limit", self.offset_limit) < math.inf:
            raise InvalidInput(f"Guard: offset_limit = {self.offset_limit!r}: must be positive and finite.")
        whole("Guard", "hold", self.hold)


@dataclass(frozen=True, eq=False)
class Schedule:
    """A scheduler as data: inputs, their domain, and a function for every slot.

    Calling it gives (Np, Nc, Q, R) for one condition, without memory; an `MPC` and compiled runs keep a memory of their
    own for each run (`plan`), in which rate limits act and interventions are counted.

    Raises
    ------
    InvalidInput
        When a slot is missing, an input is unknown, or a function does not fit the inputs.
    """

    inputs: tuple[str, ...]
    """entries of `Condition` that the functions see, in this order"""
    domain: Array
    """(D, 2) low and high of each input: values outside are clipped"""
    slots: Mapping[str, Slot]
    """Np, Nc, Q, R"""
    guard: Guard | None = None
    name: str = "schedule"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """how it was made"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", tuple(self.inputs))
        for name in self.inputs:
            if name not in Condition._fields:
                raise InvalidInput(f"schedule: unknown input {name!r}. {did_you_mean(name, Condition._fields)}")
        if len(set(self.inputs)) < len(self.inputs) or not self.inputs:
            raise InvalidInput(f"schedule: inputs = {self.inputs!r}: must be one or more different names.")
        domain = np.asarray(self.domain, dtype=np.float64)
        if (
            domain.shape != (len(self.inputs), 2)
            or not np.isfinite(domain).all()
            or (domain[:, 0] > domain[:, 1]).any()
        ):
            raise InvalidInput(f"schedule: domain: need finite low <= high for each of {', '.join(self.inputs)}.")
        object.__setattr__(self, "domain", domain)
        if set(self.slots) != set(SLOTS):
            raise InvalidInput(f"schedule: slots are {sorted(self.slots)}; there must be {', '.join(SLOTS)}.")
        for name in SLOTS:
            _check_slot(name, self.slots[name], len(self.inputs))
        if max(self.largest) > LONGEST:
            raise InvalidInput(
                f"schedule: asks for horizons of up to {max(self.largest)} steps, at most {LONGEST} may be."
            )
        if not isinstance(self.name, str) or not isinstance(self.provenance, Mapping):
            raise InvalidInput("schedule: name must be text and provenance a mapping.")

    @property
    def largest(self) -> tuple[int, int]:
        """The longest Np and Nc that it can ask for."""
        highest = [self.slots[name].high for name in ("Np", "Nc")]
        if self.guard is not None:
            highest = [max(highest[0], self.guard.fallback.Np), max(highest[1], self.guard.fallback.Nc)]
        return int(highest[0]), int(highest[1])

    def plan(self, lanes: int) -> Any:
        """The schedule as the kernels read it (`kernels.inference.Schedule`), with a fresh memory for `lanes` runs."""
        from adaptrack.kernels import inference

        layout, numbers, scratch = self._packed()
        none, state = np.zeros(0), np.zeros((lanes, inference.STATE))
        return inference.Schedule(layout, numbers, np.zeros(scratch), state, none, none, np.zeros((0, 0)))

    def __call__(self, condition: Condition) -> tuple[float, float, float, float]:
        """(Np, Nc, Q, R) for a condition, as at the first step of a run."""
        return tuple(self.batch(np.array([condition], dtype=np.float64))[0].tolist())

    def batch(self, conditions: ArrayLike) -> Array:
        """(n, 4) tunings for n conditions (n, D') whose columns begin like `Condition`, each as at a first step."""
        from adaptrack.kernels import inference

        given = np.atleast_2d(np.asarray(conditions, dtype=np.float64))
        if given.ndim != 2 or given.shape[1] > len(Condition._fields):
            raise InvalidInput(f"schedule: conditions of shape {given.shape}: need a row for each, like `Condition`.")
        rows = np.zeros((len(given), len(Condition._fields)))
        rows[:, : given.shape[1]] = given
        plan = self.plan(1)
        tunings = np.full((len(rows), 4), np.nan)
        inference.schedule_all(rows, plan, tunings)
        return tunings

    def _packed(self) -> tuple[NDArray[np.int64], Array, int]:
        """layout, numbers and the length of the scratch, see `kernels.inference`; packed once."""
        cached: tuple[NDArray[np.int64], Array, int] | None = self.__dict__.get("_cache")
        if cached is None:
            cached = _pack(self)
            object.__setattr__(self, "_cache", cached)
        return cached

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to one file, see `save_scheduler`."""
        save_scheduler(self, path)


def Constant(tuning: Tuning, name: str = "constant") -> Schedule:
    """The same tuning for every condition."""
    values = dict(zip(SLOTS, tuning.as_array().tolist(), strict=True))
    slots = {slot: Slot(value, value, value) for slot, value in values.items()}
    return Schedule(("speed",), np.array([[0.0, 1000.0]]), slots, name=name)


def Lookup(
    axes: Mapping[str, ArrayLike], tunings: ArrayLike, method: Literal["nearest", "multilinear"] = "multilinear",
    name: str = "lookup", provenance: Mapping[str, Any] | None = None,
) -> Schedule:  # fmt: skip
    """Tunings at the nodes of a grid; between them the nearest one, or interpolated, Q and R by their logarithms.

    At a node itself the tuning is the one given (Q and R to the last digit but one, when interpolated).

    axes: the nodes of each input, by name; tunings: (len(axis 1), len(axis 2), ..., 4) of Np, Nc, Q, R.
    """
    nodes = {key: np.asarray(values, dtype=np.float64) for key, values in axes.items()}
    given = np.asarray(tunings, dtype=np.float64)
    shape = tuple(len(values) for values in nodes.values())
    if given.shape != (*shape, 4):
        raise InvalidInput(f"Lookup: tunings must have the shape {(*shape, 4)}, they have {given.shape}.")
    if not np.isfinite(given).all() or (given <= 0.0).any():
        raise InvalidInput("Lookup: every Np, Nc, Q, R must be finite and positive.")
    slots = {}
    for i, slot in enumerate(SLOTS):
        values = given[..., i]
        decades = slot in ("Q", "R") and method == "multilinear"
        table = Table(tuple(nodes.values()), np.log10(values) if decades else values, method)
        slots[slot] = Slot(table, float(values.min()), float(values.max()), decades)
    domain = np.array([[values[0], values[-1]] for values in nodes.values()])
    return Schedule(tuple(nodes), domain, slots, name=name, provenance=provenance or {})


def Learned(
    functions: Mapping[str, Function], inputs: Sequence[str], domain: ArrayLike,
    bounds: Mapping[str, tuple[float, float]] | None = None, name: str = "learned",
    provenance: Mapping[str, Any] | None = None,
) -> Schedule:  # fmt: skip
    """Learned functions for the slots.

    functions: by slot; `log10_ratio` in place of R is the logarithm of R/Q, Q then being a number (1 when left out);
    inputs, domain: see `Schedule`; bounds: (low, high) of each slot's value, `BOUNDS` where left out.
    """
    given = dict(functions)
    bounds = {**BOUNDS, **(bounds or {})}
    decades = "log10_ratio" in given
    if decades:
        if "R" in given:
            raise InvalidInput("Learned: give either R or log10_ratio.")
        q = given.setdefault("Q", 1.0)
        if not isinstance(q, float | int) or q <= 0.0:
            raise InvalidInput("Learned: with log10_ratio, Q must be a positive number.")
        if q != 1.0:
            raise InvalidInput("Learned: with log10_ratio, Q must be 1: only R/Q changes the control law.")
        given["R"] = given.pop("log10_ratio")
    for slot in (*given, *bounds):
        if slot not in SLOTS:
            raise InvalidInput(f"Learned: unknown slot {slot!r}: slots are {', '.join(SLOTS)}, and log10_ratio for R.")
    slots = {slot: Slot(function, *bounds[slot], decades and slot == "R") for slot, function in given.items()}
    return Schedule(tuple(inputs), np.asarray(domain, float), slots, name=name, provenance=provenance or {})


def Guarded(schedule: Schedule, fallback: Tuning, *, stability: StabilityMap | None = None, **limits: Any) -> Schedule:
    """`schedule` behind a `Guard`: domain, rate and stability of its output are checked at every step."""
    guard = Guard(fallback, stability=stability, **limits)
    if not isinstance(schedule, Schedule):
        raise InvalidInput(f"Guarded: {schedule!r}: must be a Schedule; a plain function cannot be guarded.")
    return replace(schedule, guard=guard, name=f"{schedule.name} (guarded)")


def _check_slot(name: str, slot: Slot, inputs: int) -> None:
    function = slot.function
    if isinstance(function, Network | Sugeno) and function.n_inputs != inputs:
        raise InvalidInput(f"schedule: the function of {name} has {function.n_inputs} inputs, the schedule {inputs}.")
    if isinstance(function, Table) and len(function.axes) != inputs:
        raise InvalidInput(
            f"schedule: the table of {name} has {len(function.axes)} axes, the schedule {inputs} inputs."
        )
    if not isinstance(function, Network | Sugeno | Table) and not math.isfinite(real("schedule", name, function)):
        raise InvalidInput(f"schedule: {name} = {function!r}: must be finite.")
    least = 1.0 if name in ("Np", "Nc") else 0.0
    if not least <= slot.low <= slot.high < math.inf or (name == "R" and not slot.low > 0.0):
        raise InvalidInput(f"schedule: bounds of {name} are ({slot.low!r}, {slot.high!r}): need finite low <= high.")


# -- packing for the kernels ------------------------------------------------------------------------------------------
def _pack(schedule: Schedule) -> tuple[NDArray[np.int64], Array, int]:
    from adaptrack.kernels import inference

    inputs = len(schedule.inputs)
    layout: list[int] = [inputs, 0] + [0] * (3 * len(SLOTS))
    layout += [Condition._fields.index(name) for name in schedule.inputs] + [0]
    numbers: list[float] = [*schedule.domain[:, 0], *schedule.domain[:, 1]]
    for name in SLOTS:
        slot = schedule.slots[name]
        numbers += [float(slot.decades), slot.low, slot.high]
    scratch = 0
    for i, name in enumerate(SLOTS):
        place = inference.SLOT + 3 * i
        kind, whole, real_numbers, work = _pack_function(schedule.slots[name].function)
        layout[place : place + 3] = [kind, len(layout), len(numbers)]
        layout += whole
        numbers += real_numbers
        scratch = max(scratch, work)
    guard = schedule.guard
    if guard is not None:
        layout[inference.GUARD], layout[inference.PLACES + inputs] = len(layout), len(numbers)
        layout += [int(guard.stability is not None), guard.hold]
        limit = math.inf if guard.stability is None else guard.stability.limit
        leeway = math.inf if guard.offset_limit is None else guard.offset_limit * GRAVITY
        numbers += [*guard.fallback.as_array(), *guard.rates, guard.slack, limit, leeway]
        if guard.stability is not None:
            _, whole, real_numbers, work = _pack_function(guard.stability.table)
            layout += whole
            numbers += real_numbers
            scratch = max(scratch, work)
    return np.array(layout, np.int64), np.array(numbers, np.float64), scratch + inputs + 5


def _pack_function(function: Function) -> tuple[int, list[int], list[float], int]:
    """Kind, layout, numbers and scratch of one function, in the order that its kernel reads."""
    from adaptrack.kernels import inference

    if isinstance(function, Network):
        widths = [function.n_inputs, *(len(biases) for biases in function.biases)]
        numbers = [*function.low, *(1.0 / (function.high - function.low))]
        for weights, biases in zip(function.weights, function.biases, strict=True):
            for neuron in range(len(biases)):
                numbers += [*weights[:, neuron], biases[neuron]]
        numbers += [function.out_low, function.out_high - function.out_low]
        return inference.NETWORK, [len(widths) - 1, *widths, int(function.relu)], numbers, sum(widths)
    if isinstance(function, Sugeno):
        whole = [function.n_inputs, len(function.owner), function.n_rules]
        for owner, bell in zip(function.owner, function.bell, strict=True):
            whole += [int(owner), int(bell)]
        whole += function.rules.astype(int).ravel().tolist()
        with np.errstate(divide="ignore"):
            rules = np.column_stack((np.log(function.weights), function.consequents))
        premises = function.premises.copy()
        premises[:, WIDTH] = 1.0 / premises[:, WIDTH]
        numbers = [*premises.ravel(), *rules.ravel()]
        return inference.SUGENO, whole, numbers, len(function.owner) + function.n_rules
    if isinstance(function, Table):
        kind = inference.NEAREST if function.method == "nearest" else inference.MULTILINEAR
        numbers = [*(node for axis in function.axes for node in axis), *function.values.ravel()]
        return kind, [len(function.axes), *function.values.shape], numbers, 2 * len(function.axes)
    return inference.CONSTANT, [], [float(function)], 0


# -- files ------------------------------------------------------------------------------------------------------------
def save_scheduler(schedule: Schedule, path: str | os.PathLike[str]) -> None:
    """Write a schedule as one JSON file that `load_scheduler` reads back to the bit.

    Raises
    ------
    InvalidInput
        When the provenance holds what JSON cannot.
    StorageError
        When the file cannot be written; an older one at `path` is then untouched.
    """
    content = _encode(schedule)
    try:
        text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError) as error:
        raise InvalidInput(
            f"schedule {schedule.name!r}: its provenance must be text and finite numbers: {error}."
        ) from None
    digest = hashlib.sha256(text.encode()).hexdigest()
    file = {"format": FORMAT, "version": VERSION, "sha256": digest, "content": content}
    write_atomically(path, (json.dumps(file, separators=(",", ":")) + "\n").encode())


def load_scheduler(name_or_path: str | os.PathLike[str]) -> Schedule:
    """The schedule in a file, or one that ships with the package, by name (`list_schedulers`).

    Raises
    ------
    UnknownName
        When no scheduler has the name.
    StorageError
        When the file cannot be read, is damaged, is not a scheduler, or has a version that this program cannot read.
    """
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and path.suffix != ".json" and len(path.parts) == 1:
        path = _DATA / f"{name_or_path}.json"
        if not path.exists():
            raise UnknownName(
                f"no scheduler is named {name_or_path!r}. {did_you_mean(name_or_path, list_schedulers())} "
                "A file is given by its .json path."
            )
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # not UTF-8, or a path that cannot be
        raise StorageError(f"{path}: cannot be read: {error}.") from None
    try:
        file = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: not a scheduler file, or damaged: {error}. Train or copy it again.") from None
    if not isinstance(file, dict) or file.get("format") != FORMAT:
        raise StorageError(f"{path}: not a scheduler file: its format is not {FORMAT!r}.")
    if file.get("version") != VERSION:
        raise StorageError(
            f"{path}: version {file.get('version')!r} of the scheduler format; this program reads {VERSION}. "
            "Train it again, or use the version of adaptrack that wrote it."
        )
    content: Any = file.get("content")
    digest = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    if digest != file.get("sha256"):
        raise StorageError(f"{path}: damaged: its content does not match its checksum. Train or copy it again.")
    try:
        schedule = _decode(content)
        schedule._packed()  # numbers too large for the kernels are found here
    except KeyError as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error} is missing.") from None
    except (InvalidInput, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise StorageError(f"{path}: its content makes no scheduler: {error}.") from None
    return schedule


_DATA = Path(__file__).parent / "data" / "schedulers"


def list_schedulers() -> list[str]:
    """The names of the schedulers that ship with the package."""
    return sorted(path.stem for path in _DATA.glob("*.json"))


def _encode(schedule: Schedule) -> dict[str, Any]:
    guard = schedule.guard
    return {
        "name": schedule.name,
        "inputs": list(schedule.inputs),
        "domain": schedule.domain.tolist(),
        "slots": {
            name: {
                "low": slot.low,
                "high": slot.high,
                "decades": bool(slot.decades),
                "function": _encode_function(slot.function),
            }
            for name, slot in schedule.slots.items()
        },
        "guard": guard
        and {
            "fallback": guard.fallback.as_array().tolist(),
            "rates": list(guard.rates),
            "slack": guard.slack,
            "hold": guard.hold,
            "offset_limit": guard.offset_limit,
            "stability": guard.stability
            and {"limit": guard.stability.limit, "table": _encode_function(guard.stability.table)},
        },
        "provenance": dict(schedule.provenance),
    }


def _encode_function(function: Function) -> dict[str, Any]:
    if isinstance(function, Network):
        return {
            "kind": "network",
            "low": function.low.tolist(),
            "high": function.high.tolist(),
            "weights": [each.tolist() for each in function.weights],
            "biases": [each.tolist() for each in function.biases],
            "out_low": float(function.out_low),
            "out_high": float(function.out_high),
            "relu": bool(function.relu),
        }
    if isinstance(function, Sugeno):
        return {
            "kind": "sugeno",
            "owner": function.owner.tolist(),
            "bell": function.bell.tolist(),
            "premises": function.premises.tolist(),
            "rules": function.rules.tolist(),
            "consequents": function.consequents.tolist(),
            "weights": function.weights.tolist(),
        }
    if isinstance(function, Table):
        return {
            "kind": "table",
            "axes": [axis.tolist() for axis in function.axes],
            "values": function.values.tolist(),
            "method": function.method,
        }
    return {"kind": "number", "value": float(function)}


def _decode(content: Mapping[str, Any]) -> Schedule:
    guard = content["guard"]
    if guard is not None:
        Np, Nc, Q, R = guard["fallback"]
        stability = guard["stability"]
        if stability is not None:
            stability = StabilityMap(_decode_function(stability["table"]), stability["limit"])
        guard = Guard(
            Tuning(int(Np), int(Nc), Q, R), tuple(guard["rates"]), guard["slack"], guard["hold"], stability,
            guard["offset_limit"],
        )  # fmt: skip
    slots = {
        name: Slot(_decode_function(slot["function"]), slot["low"], slot["high"], slot["decades"])
        for name, slot in content["slots"].items()
    }
    return Schedule(
        tuple(content["inputs"]), np.array(content["domain"], float), slots, guard, content["name"],
        content["provenance"],
    )  # fmt: skip


def _decode_function(told: Mapping[str, Any]) -> Any:
    def array(values: Any, kind: Any = np.float64) -> NDArray[Any]:
        given = np.asarray(values)
        return given.astype(kind, casting="safe" if given.size else "unsafe")  # text or fractions for indices: refused

    if told["kind"] == "network":
        return Network(
            array(told["low"]), array(told["high"]), tuple(map(array, told["weights"])),
            tuple(map(array, told["biases"])), real("network", "out_low", told["out_low"]),
            real("network", "out_high", told["out_high"]), bool(told["relu"]),
        )  # fmt: skip
    if told["kind"] == "sugeno":
        owner = array(told["owner"], np.intp)
        return Sugeno(
            owner, array(told["bell"], np.bool_), array(told["premises"]).reshape(len(owner), 3),
            array(told["rules"], np.intp), array(told["consequents"]), array(told["weights"]),
        )  # fmt: skip
    if told["kind"] == "table":
        return Table(tuple(map(array, told["axes"])), array(told["values"]), told["method"])
    if told["kind"] == "number":
        return real("scheduler", "value", told["value"])
    raise InvalidInput(f"unknown kind of function {told['kind']!r}")


# -- the contract -----------------------------------------------------------------------------------------------------
_DOMAIN = {"speed": (3.0, 27.0), "y_ref": (-15.0, 15.0), "friction": (0.5, 0.9), "wind": (-30.0, 30.0),
           "change": (0.0, 10.0), "acceleration": (0.0, 5.0), "offset": (-5.0, 5.0)}  # fmt: skip


def check_scheduler(scheduler: Any, samples: int = 200, seed: int = 0) -> None:
    """Refuse a scheduler that breaks the contract; ours and anybody's pass through the same door.

    It must be callable with a `Condition` and give a `Tuning` or four finite numbers (Np, Nc, Q, R) with
    1 <= Nc <= Np after rounding, Q >= 0 and R > 0, for conditions inside, at the corners of and far outside the paper's
    operating domain; and give the same for the same condition. For a `Schedule`, every slot is also compared with its
    own function evaluated by NumPy: no output can reach another's slot.

    Raises
    ------
    ContractError
        When it breaks one; the message gives the condition and what came back.
    """
    if not callable(scheduler):
        raise ContractError(f"scheduler {scheduler!r}: must be callable, condition -> (Np, Nc, Q, R).")
    rng = np.random.default_rng(seed)
    low, high = np.array([_DOMAIN[name] for name in Condition._fields]).T
    rows = low + (high - low) * rng.uniform(size=(samples, len(low)))
    rows[::7] = np.where(rng.uniform(size=rows[::7].shape) < 0.5, low, high)
    rows[::11] += rng.normal(size=rows[::11].shape) * 3.0 * (high - low)
    for row in rows:
        condition = Condition(*row.tolist())
        given, again = _asked(scheduler, condition), _asked(scheduler, condition)
        Np, Nc, Q, R = given
        if not all(map(math.isfinite, given)):
            raise ContractError(f"scheduler: gave {given} for {condition}: must be finite.")
        if given != again:
            raise ContractError(f"scheduler: gave {given} and then {again} for the same {condition}.")
        if not (1 <= round(Nc) <= round(Np) and Q >= 0.0 and R > 0.0):
            raise ContractError(f"scheduler: gave {given} for {condition}: need 1 <= Nc <= Np, Q >= 0, R > 0.")
    if isinstance(scheduler, Schedule):
        _check_slots(replace(scheduler, guard=None), rows)


def _asked(scheduler: Any, condition: Condition) -> tuple[float, float, float, float]:
    try:
        return astuple(scheduler(condition))
    except Exception as error:
        raise ContractError(f"scheduler: failed for {condition}: {error}") from error


def _check_slots(schedule: Schedule, rows: Array) -> None:
    columns = [Condition._fields.index(name) for name in schedule.inputs]
    x = np.clip(rows[:, columns], *schedule.domain.T)
    planned = Schedule.batch(schedule, rows)  # what compiled runs are given
    called = np.array([astuple(schedule(Condition(*row.tolist()))) for row in rows])
    if (called != planned).any():
        k = int(np.argmax((called != planned).any(axis=1)))
        raise ContractError(f"scheduler: called, it gives {called[k].tolist()}; compiled, {planned[k].tolist()}.")
    for i, name in enumerate(SLOTS):
        slot = schedule.slots[name]
        expected = _evaluate(slot.function, x)
        if slot.decades:
            expected = 10.0**expected
        expected = np.clip(expected, slot.low, slot.high)
        if name == "Nc":
            expected = np.minimum(expected, planned[:, 0])
        off = np.abs(planned[:, i] - expected)
        wrong = off > (0.5 + 1e-9 if i < 2 else 1e-9 * np.abs(expected))  # at .5 rounding may go either way
        if wrong.any():
            k = int(np.argmax(wrong))
            raise ContractError(
                f"scheduler: slot {name} holds {float(planned[k, i])!r} at {Condition(*rows[k].tolist())}, "
                f"where its own function gives {float(expected[k])!r}."
            )


def _evaluate(function: Function, x: Array) -> Array:
    """A slot's function by NumPy at the inputs x (n, D): the reference for the kernels."""
    if isinstance(function, Network | Sugeno):
        return function.predict(x)
    if isinstance(function, Table):
        from scipy.interpolate import RegularGridInterpolator

        x = np.clip(x, *np.array([(axis[0], axis[-1]) for axis in function.axes]).T)  # held beyond the last node
        more = [d for d, axis in enumerate(function.axes) if len(axis) > 1]  # an axis of one node says nothing
        values = function.values.squeeze()
        if not more:
            return np.full(len(x), float(values))
        axes = [function.axes[d] for d in more]
        method = "linear" if function.method == "multilinear" else "nearest"
        return np.asarray(RegularGridInterpolator(axes, values, method)(x[:, more]))
    return np.full(len(x), float(function))
