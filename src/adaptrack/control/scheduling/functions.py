"""The functions of a schedule (numbers, tables, networks and fuzzy systems) behind one contract, `Function`.

`core.scheduling.functions` evaluates them in a controller. Sugeno systems are the fuzzy rules that ANFIS learns, the
paper's eqs. (24)-(27), one function per layer. The first two layers hand on logarithms: the product of eq. (25) is then
a sum, and eq. (26) stays defined where all memberships underflow, far from every rule.

    layer 1   `fuzzify`     log mu_A(x)
    layer 2   `fire`        log w_r = sum of the log memberships that rule r asks for
    layer 3   `normalise`   w_r / sum of all w
    layer 4   `conclude`    (normalised w_r) (p_r . x + r_r)
    layer 5   `total`       the sum over the rules
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self, cast

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Finite, checked, real
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.scheduling import functions as kernel
from adaptrack.core.scheduling.functions import MAX_DISTANCE_WIDTHS

IndexArray = NDArray[np.intp]

ANY = -1
"""In a rule: this input does not matter."""
BELL_WIDTH, BELL_SLOPE, BELL_CENTRE = range(3)
"""Columns of the premises."""


class Packed(NamedTuple):
    """A function as the kernels read it, see `core.scheduling.functions`."""

    kind: int
    integers: Sequence[int]
    numbers: Sequence[float]
    scratch: int
    """reals that its evaluation needs"""


class Function(ABC):
    """One entry of a tuning as a function of the schedule's inputs.

    A kind of one's own packs itself as one of the kernels' kinds (most are a table or a rule of a fuzzy system), and
    joins by `register_function`, so that files of schedules can hold it.
    """

    kind: ClassVar[str]
    """its name in files"""

    @property
    @abstractmethod
    def n_inputs(self) -> int | None:
        """The number D of inputs; None when any will do."""

    def predict(self, x: Array) -> Array:
        """(n,) values at the inputs x (n, D)."""
        packed, rows = self.pack(), np.ascontiguousarray(x, dtype=float)
        integers, numbers = np.array(packed.integers, np.int64), np.array(packed.numbers, dtype=float)
        work = np.zeros(packed.scratch)
        return np.array([kernel.evaluate(packed.kind, row, integers, numbers, work) for row in rows])

    @abstractmethod
    def pack(self) -> Packed:
        """The function as the kernels read it."""

    def affine(self, scale: float, offset: float) -> Self:
        """Return the function multiplied by `scale`, with `offset` added everywhere."""
        raise NotImplementedError

    def shifted(self, by: float) -> Self:
        """Return a copy of the function with `by` added everywhere."""
        return self.affine(1.0, by)

    def blended(self, share: float, value: float) -> Self:
        """The function that lies a share of the way from this one to `value` everywhere."""
        return self.affine(1.0 - share, share * value)

    def save(self) -> dict[str, Any]:
        """Return the content of the function's file (text, numbers, lists), which `load` reads back to the bit.

        By default the fields of a dataclass by name.
        """
        return {field.name: _plain(getattr(self, field.name)) for field in fields(cast(Any, self))}

    @classmethod
    @abstractmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        """The function that was saved; raises `KeyError`, `TypeError` or `ValueError` when `saved` holds none."""


def _plain(value: Any) -> Any:
    """A value as JSON holds it: arrays and tuples as lists."""
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


class Pool:
    """Packed functions, one behind the other."""

    def __init__(self) -> None:
        self.integers: list[int] = []
        self.numbers: list[float] = []
        self.scratch = 0

    def add(self, function: Function, row: Any) -> int:
        """Pack a function, write to `row` where it begins; returns its kind."""
        packed = function.pack()
        row.integers, row.numbers = len(self.integers), len(self.numbers)
        self.integers += packed.integers
        self.numbers += packed.numbers
        self.scratch = max(self.scratch, packed.scratch)
        return packed.kind


_KINDS: dict[str, type[Function]] = {}


def register_function(kind: type[Function]) -> type[Function]:
    """Make a kind of function known to the files of schedules; returns it, so that it may stand above a class.

    Raises InvalidInput when another kind has its name.
    """
    if _KINDS.setdefault(kind.kind, kind) is not kind:
        raise InvalidInput(f"register_function: another kind of function is named {kind.kind!r}: choose another name.")
    return kind


def save_function(function: Function) -> dict[str, Any]:
    """A function with the name of its kind."""
    return {"kind": function.kind, **function.save()}


def load_function(saved: Mapping[str, Any]) -> Function:
    """The function that `save_function` saved; InvalidInput when its kind is unknown, or it makes no function."""
    kind = saved["kind"]
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InvalidInput(f"unknown kind of function {kind!r}. {did_you_mean(str(kind), _KINDS)}")
    return _KINDS[kind].load(saved)


def read_array(values: Any, kind: Any = np.float64) -> NDArray[Any]:
    """Numbers of a file as an array; text, or fractions where whole numbers are needed, raise `TypeError`."""
    array = np.asarray(values)
    return array.astype(kind, casting="safe" if array.size else "unsafe")


@register_function
@checked
@dataclass(frozen=True)
class Number(Function):
    """A constant function."""

    value: Finite
    kind = "number"

    @property
    def n_inputs(self) -> None:
        return None

    def pack(self) -> Packed:
        return Packed(kernel.NUMBER, (), (self.value,), 0)

    def affine(self, scale: float, offset: float) -> Self:
        return type(self)(scale * self.value + offset)

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(saved["value"])


@register_function
@dataclass(frozen=True, eq=False)
class Table(Function):
    """Values at the nodes of a grid, held beyond its last nodes.

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
    kind = "table"

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

    @property
    def n_inputs(self) -> int:
        return len(self.axes)

    def pack(self) -> Packed:
        kind = kernel.NEAREST if self.method == "nearest" else kernel.MULTILINEAR
        nodes = np.concatenate(self.axes)
        return Packed(kind, [self.n_inputs, *self.values.shape], [*nodes, *self.values.ravel()], 2 * self.n_inputs)

    def affine(self, scale: float, offset: float) -> Self:
        return replace(self, values=scale * self.values + offset)

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(tuple(map(read_array, saved["axes"])), read_array(saved["values"]), saved["method"])


@register_function
@dataclass(frozen=True, eq=False)
class Network(Function):
    """D inputs, hidden layers of sigmoid neurons, one output: eqs. (21)-(23) of the paper.

    H^1 = f(W^1 z), H^2 = f(W^2 H^1), O = g(W^3 H^2), each with a bias; f the sigmoid, g the ReLU, z the inputs scaled
    so that `low` and `high` become 0 and 1; the target is out_low + (out_high - out_low) O.

    Raises
    ------
    InvalidInput
        When the arrays do not fit each other, or a number is not finite.
    """

    low: Array
    """(D,) input that becomes 0"""
    high: Array
    """(D,) input that becomes 1"""
    weights: tuple[Array, ...]
    """of each layer, (inputs, neurons)"""
    biases: tuple[Array, ...]
    """of each layer, (neurons,)"""
    out_low: float
    """target at O = 0"""
    out_high: float
    """target at O = 1"""
    relu: bool = True
    """whether g is the ReLU, else the identity"""
    kind = "network"

    def __post_init__(self) -> None:
        for name in ("out_low", "out_high"):
            object.__setattr__(self, name, real("Network", name, getattr(self, name)))
        width = len(self.low)
        fits = self.low.shape == self.high.shape == (width,) and len(self.weights) == len(self.biases) > 0
        for weights, biases in zip(self.weights, self.biases, strict=False):
            fits = fits and weights.shape == (width, len(biases)) and biases.ndim == 1
            width = len(biases)
        if not fits or width != 1:
            raise InvalidInput(
                "Network: the arrays do not fit each other; see the shapes in the class's documentation."
            )
        numbers = (self.low, self.high, *self.weights, *self.biases, np.array([self.out_low, self.out_high]))
        if not all(np.isfinite(array).all() for array in numbers):
            raise InvalidInput("Network: a weight, bias or scale is not finite.")
        if not (self.high > self.low).all():
            raise InvalidInput("Network: need low < high for every input.")

    @property
    def n_inputs(self) -> int:
        return len(self.low)

    @property
    def n_parameters(self) -> int:
        """Number of learned numbers: weights and biases."""
        return sum(array.size for array in (*self.weights, *self.biases))

    def predict(self, x: Array) -> Array:
        h = (x - self.low) / (self.high - self.low)
        for weights, biases in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = portable.logistic(product(h, weights) + biases)
        out = (product(h, self.weights[-1]) + self.biases[-1])[:, 0]
        if self.relu:
            out = np.maximum(out, 0.0)
        return self.out_low + (self.out_high - self.out_low) * out

    def pack(self) -> Packed:
        widths = [self.n_inputs, *map(len, self.biases)]
        numbers = [self.out_low, self.out_high - self.out_low, *self.low, *(1.0 / (self.high - self.low))]
        for weights, biases in zip(self.weights, self.biases, strict=True):
            numbers += np.vstack((weights, biases)).T.ravel().tolist()
        return Packed(kernel.NETWORK, [int(self.relu), len(self.biases), *widths], numbers, sum(widths))

    def affine(self, scale: float, offset: float) -> Self:
        return replace(self, out_low=scale * self.out_low + offset, out_high=scale * self.out_high + offset)

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        return cls(
            read_array(saved["low"]), read_array(saved["high"]), tuple(map(read_array, saved["weights"])),
            tuple(map(read_array, saved["biases"])), saved["out_low"], saved["out_high"], bool(saved["relu"]),
        )  # fmt: skip


@register_function
@dataclass(frozen=True)
class Sugeno(Function):
    """A first-order Sugeno system: D inputs, M membership functions, R rules, one output.

    Raises
    ------
    InvalidInput
        When the arrays do not fit each other, or a number is not finite or out of its range.
    """

    owner: IndexArray
    """(M,) the input that each membership function reads"""
    bell: NDArray[np.bool_]
    """(M,) True: generalised bell 1/(1 + |(x - c)/a|^(2b)); False: Gaussian exp(-(x - c)^2/(2 sigma^2))"""
    premises: Array
    """(M, 3) width (sigma or a > 0), slope (b > 0, no meaning for a Gaussian), centre c; in the input's unit"""
    rules: IndexArray
    """(R, D) the membership function that each rule asks of each input, or `ANY`"""
    consequents: Array
    """(R, D + 1) slopes p along the inputs, then the constant r"""
    weights: Array
    """(R,) factor of each rule's firing strength, 0..1"""
    kind = "sugeno"

    def __post_init__(self) -> None:
        rules, inputs = self.rules.shape
        functions = len(self.owner)
        fits = self.bell.shape == (functions,) and self.premises.shape == (functions, 3)
        fits = fits and self.consequents.shape == (rules, inputs + 1) and self.weights.shape == (rules,) and rules > 0
        if not fits:
            raise InvalidInput("Sugeno: the arrays do not fit each other; see the shapes in the class's documentation.")
        if not all(np.isfinite(array).all() for array in (self.premises, self.consequents, self.weights)):
            raise InvalidInput("Sugeno: a premise, consequent or weight is not finite.")
        if (self.premises[:, :BELL_CENTRE] <= 0.0).any():
            raise InvalidInput("Sugeno: the widths and slopes of membership functions must be positive.")
        if (self.weights < 0.0).any() or (self.weights > 1.0).any() or not self.weights.any():
            raise InvalidInput("Sugeno: rule weights must be 0..1, and not all zero.")
        if functions and not (self.owner.min() >= 0 and self.owner.max() < inputs):
            raise InvalidInput(f"Sugeno: a membership function reads an input that is not one of {inputs}.")
        used = self.rules != ANY
        function, reader = self.rules[used], np.nonzero(used)[1]
        if (function < 0).any() or (function >= functions).any() or (self.owner[function] != reader).any():
            raise InvalidInput("Sugeno: a rule asks an input for a membership function that the input does not have.")

    @property
    def n_inputs(self) -> int:
        return self.rules.shape[1]

    @property
    def n_rules(self) -> int:
        return self.rules.shape[0]

    @property
    def n_parameters(self) -> int:
        """Two for a Gaussian, three for a bell, D + 1 for the consequent of a rule."""
        return 2 * len(self.bell) + int(self.bell.sum()) + self.consequents.size

    def predict(self, x: Array) -> Array:
        return total(conclude(self.strengths(x), x, self.consequents))

    def strengths(self, x: Array) -> Array:
        """(n, R) normalised firing strengths at the inputs x (n, D): layers 1 to 3."""
        return normalise(fire(fuzzify(x, self), self))

    def mass(self, x: Array) -> Array:
        """(R,) share of each rule in all that fires at the inputs x (n, D); the shares sum to one."""
        return self.strengths(x).mean(axis=0)

    def keep(self, rules: NDArray[np.bool_]) -> Sugeno:
        """The system with only the marked `rules` (R,), and only the membership functions that they ask for."""
        used = np.unique(self.rules[rules])
        used = used[used != ANY]
        number = np.full(len(self.owner) + 1, ANY)  # the last one is found by ANY itself
        number[used] = np.arange(len(used))
        return Sugeno(
            owner=self.owner[used],
            bell=self.bell[used],
            premises=self.premises[used],
            rules=number[self.rules[rules]],
            consequents=self.consequents[rules],
            weights=self.weights[rules],
        )

    def pack(self) -> Packed:
        integers = [self.n_inputs, len(self.owner), self.n_rules]
        integers += [*self.owner.tolist(), *self.bell.astype(int).tolist(), *self.rules.ravel().tolist()]
        with np.errstate(divide="ignore"):  # a rule of weight zero never fires
            log_weights = portable.log(self.weights)
        parts = (
            1.0 / self.premises[:, BELL_WIDTH],
            self.premises[:, BELL_SLOPE],
            self.premises[:, BELL_CENTRE],
            log_weights,
        )
        numbers = np.concatenate((*parts, self.consequents[:, :-1].ravel(), self.consequents[:, -1]))
        return Packed(kernel.SUGENO, integers, numbers.tolist(), len(self.owner) + self.n_rules)

    def affine(self, scale: float, offset: float) -> Self:
        consequents = scale * self.consequents
        consequents[:, -1] += offset
        return replace(self, consequents=consequents)

    @classmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        owner = read_array(saved["owner"], np.intp)
        return cls(
            owner, read_array(saved["bell"], np.bool_), read_array(saved["premises"]).reshape(len(owner), 3),
            read_array(saved["rules"], np.intp), read_array(saved["consequents"]), read_array(saved["weights"]),
        )  # fmt: skip


def fuzzify(x: Array, system: Sugeno) -> Array:
    """Layer 1, eq. (24): (n, M) logarithms of the memberships of the inputs x (n, D)."""
    distances = distance(x, system)
    log_mu = -0.5 * (distances * distances)
    bell = system.bell
    if bell.any():
        exponent = bell_exponent(distances[:, bell], system.premises[bell, BELL_SLOPE])
        log_mu[:, bell] = -(np.maximum(exponent, 0.0) + portable.log1p(portable.exp(-np.abs(exponent))))
    return log_mu


def fire(log_mu: Array, system: Sugeno) -> Array:
    """Layer 2, eq. (25): (n, R) logarithms of the firing strengths from those of the memberships (n, M)."""
    with np.errstate(divide="ignore"):  # a rule of weight zero never fires
        log_w = np.repeat(portable.log(system.weights)[np.newaxis], len(log_mu), axis=0)
    padded = np.column_stack((log_mu, np.zeros(len(log_mu))))  # its last column is what ANY finds: membership one
    for functions in system.rules.T:
        log_w += padded[:, functions]
    return log_w


def normalise(log_w: Array) -> Array:
    """Layer 3, eq. (26): (n, R) firing strengths, each row divided by its sum."""
    w = portable.exp(log_w - log_w.max(axis=1, keepdims=True))
    return w / w.sum(axis=1, keepdims=True)


def conclude(strengths: Array, x: Array, consequents: Array) -> Array:
    """Layer 4, eq. (27): (n, R) what each rule contributes, its normalised strength times p . x + r."""
    return strengths * (product(x, consequents[:, :-1].T) + consequents[:, -1])


def total(contributions: Array) -> Array:
    """Layer 5, the paper's second eq. (27): (n,) the sum over the rules."""
    return contributions.sum(axis=1)


def distance(x: Array, system: Sugeno) -> Array:
    """(n, M) signed distance of each input from each centre, in widths."""
    raw = (x[:, system.owner] - system.premises[:, BELL_CENTRE]) / system.premises[:, BELL_WIDTH]
    return np.clip(raw, -MAX_DISTANCE_WIDTHS, MAX_DISTANCE_WIDTHS)


def bell_exponent(distance: Array, slope: Array) -> Array:
    """log |distance|^(2 slope), finite at the centre too."""
    return 2.0 * slope * portable.log(np.maximum(np.abs(distance), 1.0 / MAX_DISTANCE_WIDTHS))
