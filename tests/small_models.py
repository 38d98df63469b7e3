"""Functions for the entries of schedules: random ones of every kind, and some that are easy to reckon with."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from adaptrack.control.scheduling import Network, Number, StabilityMap, Sugeno, Table
from adaptrack.control.scheduling.functions import ANY
from adaptrack.paper.surfaces import Surface


def random_network(rng, inputs, relu=True):
    widths = [inputs, *rng.integers(1, 20, rng.integers(0, 4)), 1]
    low = rng.normal(size=inputs)
    return Network(
        low, low + rng.uniform(0.1, 30.0, inputs),
        tuple(rng.normal(size=pair) * 2.0 for pair in itertools.pairwise(widths)),
        tuple(rng.normal(size=width) for width in widths[1:]),
        float(rng.normal()), float(rng.normal() * 50.0), relu,
    )  # fmt: skip


def random_sugeno(rng, inputs, kind="mixed"):
    """A system whose rules share functions, skip inputs, and have weights from 0 to 1."""
    functions, rules = int(rng.integers(inputs, 4 * inputs + 1)), int(rng.integers(1, 30))
    owner = np.concatenate([np.arange(inputs), rng.integers(0, inputs, functions - inputs)])
    bell = {"gaussian": np.zeros(functions, bool), "bell": np.ones(functions, bool)}.get(kind)
    inputs_of_rules = np.array([[rng.choice(np.flatnonzero(owner == d)) for d in range(inputs)] for _ in range(rules)])
    inputs_of_rules[rng.uniform(size=inputs_of_rules.shape) < 0.25] = ANY
    weights = rng.uniform(size=rules) * (rng.uniform(size=rules) < 0.8)
    weights[0] = 1.0
    premises = np.column_stack(
        [rng.uniform(0.05, 2.0, functions), rng.uniform(0.5, 4.0, functions), rng.normal(size=functions)]
    )
    consequents = rng.normal(size=(rules, inputs + 1)) * 10.0
    bell = rng.uniform(size=functions) < 0.5 if bell is None else bell
    return Sugeno(owner, bell, premises, inputs_of_rules, consequents, weights)


def random_table(rng, inputs, method):
    axes = tuple(np.cumsum(rng.uniform(0.1, 3.0, rng.integers(1, 6))) for _ in range(inputs))
    return Table(axes, rng.normal(size=tuple(map(len, axes))), method)


def line(low, high, at_low, at_high):
    """A function of one input that is a straight line between two points."""
    return Table((np.array([low, high]),), np.array([at_low, at_high]))


def stability_map(radius):
    """A map whose value at a node is radius(speed, friction, Np, Nc, log10 R/Q)."""
    axes = tuple(np.array(axis, float) for axis in ((0, 10, 20), (0.3, 0.9), (10, 30, 60), (1, 20), (-3, 0, 3)))
    return StabilityMap(Table(axes, np.vectorize(radius)(*np.meshgrid(*axes, indexing="ij"))), limit=0.99)


@dataclass(frozen=True)
class Level(Surface):
    """A surface with one value everywhere."""

    value: float

    def fit(self, x, target, weight, effort=1.0):
        return replace(self, value=float(np.average(target, weights=weight)))

    def average(self, surfaces):
        return replace(self, value=float(np.mean([self.value, *(surface.value for surface in surfaces)])))

    def function(self):
        return Number(self.value)
