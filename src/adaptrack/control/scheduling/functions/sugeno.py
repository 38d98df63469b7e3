"""A first-order Sugeno system: the fuzzy rules that ANFIS learns, and that run online.

The paper's eqs. (24)-(27), one function per layer. The first two layers hand on logarithms: the product of eq. (25) is
then a sum, and eq. (26) stays defined where all memberships underflow, far from every rule.

    layer 1   `fuzzify`     log mu_A(x)
    layer 2   `fire`        log w_r = sum of the log memberships that rule r asks for
    layer 3   `normalise`   w_r / sum of all w
    layer 4   `conclude`    (normalised w_r) (p_r . x + r_r)
    layer 5   `total`       the sum over the rules
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling.functions.function import Array, Function, Packed, read_array, register_function
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.core.scheduling import functions as kernel
from adaptrack.core.scheduling.functions import MAX_DISTANCE_WIDTHS

IndexArray = NDArray[np.intp]

ANY = -1
"""In a rule: this input does not matter."""
BELL_WIDTH, BELL_SLOPE, BELL_CENTRE = range(3)
"""Columns of the premises."""


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

    def shifted(self, by: float) -> Self:
        consequents = self.consequents.copy()
        consequents[:, -1] += by
        return replace(self, consequents=consequents)

    def blended(self, share: float, value: float) -> Self:
        consequents = (1.0 - share) * self.consequents
        consequents[:, -1] += share * value
        return replace(self, consequents=consequents)

    def save(self) -> dict[str, Any]:
        names = ("owner", "bell", "premises", "rules", "consequents", "weights")
        return {name: getattr(self, name).tolist() for name in names}

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
