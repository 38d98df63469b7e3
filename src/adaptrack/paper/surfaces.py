"""Surfaces: one output as a function of the inputs, which can take a step of a weighted regression.

A small network or a fuzzy system. A schedule runs their `function`.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import expit

from adaptrack.control.scheduling.functions import BELL_SLOPE, BELL_WIDTH, Function, Network, Sugeno
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

HIDDEN_NEURONS = (16, 8)
"""As in the paper's networks."""
ADAM_EPOCHS, ADAM_RATE = 100, 0.01
"""Epochs of Adam in one step, and the learning rate of the first one."""
KMEANS_RESTARTS = 2
RULE_NEIGHBOURS, RULE_WIDTH = 3, 0.7
"""A rule's standard deviation is that multiple of its mean distance from so many nearest neighbours."""
CONSEQUENT_HOLD = 0.02
"""Weight of a change of the consequents, relative to the data: rules with few data stay where they are."""


class Surface(ABC):
    """One output as a function of the inputs, which can take a step of a weighted regression."""

    def predict(self, x: Array) -> Array:
        """(n,) output at the inputs x (n, D)."""
        return self.function().predict(x)

    @abstractmethod
    def fit(self, x: Array, target: Array, weight: Array, effort: float = 1.0) -> Self:
        """A surface nearer to `target` (n,) at x (n, D) in the least squares weighted by `weight` (n,).

        effort: share of the full work, 0..1; it falls towards the end of the learning.
        """

    @abstractmethod
    def average(self, surfaces: Sequence[Self]) -> Self:
        """The surface with the mean of the parameters of this one and others."""

    @abstractmethod
    def function(self) -> Function:
        """The function of a schedule's entry."""


@dataclass(frozen=True, eq=False)
class NetworkSurface(Surface):
    """A small network, trained by Adam (D. Kingma, J. Ba, 2015) on all rows at once."""

    network: Network

    @classmethod
    def start(cls, domain: Array, value: float, span: float, seed: int) -> NetworkSurface:
        """A network of random hidden layers whose output is `value` everywhere; `span` is the scale of its changes.

        domain: (D, 2) lowest and highest value of each input.
        """
        rng = np.random.default_rng(seed)
        widths = [len(domain), *HIDDEN_NEURONS, 1]
        weights, biases = [], []
        for layer, (size, out) in enumerate(itertools.pairwise(widths)):
            last = layer == len(widths) - 2
            reach = 8.0 if layer == 0 else 3.0  # over inputs 0..1, then over neurons 0..1
            weights.append(np.zeros((size, out)) if last else rng.normal(size=(size, out)) * reach / math.sqrt(size))
            biases.append(np.zeros(out) if last else rng.normal(size=out) * 1.5 - weights[-1].sum(axis=0) / 2.0)
        network = Network(domain[:, 0], domain[:, 1], tuple(weights), tuple(biases), value, value + span, relu=False)
        return cls(network)

    def fit(self, x: Array, target: Array, weight: Array, effort: float = 1.0) -> Self:
        net = self.network
        z = (x - net.low) / (net.high - net.low)
        y = (target - net.out_low) / (net.out_high - net.out_low)
        share = weight / weight.sum()
        parameters = [array.copy() for pair in zip(net.weights, net.biases, strict=True) for array in pair]
        first, second = [0.0 * p for p in parameters], [0.0 * p for p in parameters]
        for epoch in range(1, ADAM_EPOCHS + 1):
            gradients = _gradients(parameters, z, y, share)
            rate = ADAM_RATE * effort * math.sqrt(1.0 - (epoch - 1) / ADAM_EPOCHS)
            for p, g, m, v in zip(parameters, gradients, first, second, strict=True):
                m += 0.1 * (g - m)
                v += 0.01 * (g * g - v)
                mean, mean_square = m / (1.0 - portable.power(0.9, epoch)), v / (1.0 - portable.power(0.99, epoch))
                p -= rate * mean / (np.sqrt(mean_square) + 1e-10)
        return replace(self, network=replace(net, weights=tuple(parameters[::2]), biases=tuple(parameters[1::2])))

    def average(self, surfaces: Sequence[Self]) -> Self:
        nets = [self.network, *(surface.network for surface in surfaces)]
        weights, biases = (
            tuple(np.mean(layer, axis=0) for layer in zip(*parts, strict=True))
            for parts in ([net.weights for net in nets], [net.biases for net in nets])
        )
        return replace(self, network=replace(self.network, weights=weights, biases=biases))

    def function(self) -> Network:
        return self.network


def _gradients(parameters: list[Array], z: Array, y: Array, share: Array) -> list[Array]:
    """Gradients of half the weighted mean square error of a sigmoid network, by weights and biases in turn."""
    layers = [z]
    for k in range(0, len(parameters) - 2, 2):
        layers.append(expit(layers[-1] @ parameters[k] + parameters[k + 1]))
    delta = (share * ((layers[-1] @ parameters[-2])[:, 0] + parameters[-1][0] - y))[:, None]
    gradients: list[Array] = []
    for k in range(len(parameters) - 2, -1, -2):
        below = layers[k // 2]
        gradients[:0] = [below.T @ delta, delta.sum(axis=0)]
        if k:
            delta = (delta @ parameters[k].T) * below * (1.0 - below)
    return gradients


@dataclass(frozen=True, eq=False)
class FuzzySurface(Surface):
    """A Sugeno system of fixed premises; its consequents are least squares, held near where they were."""

    system: Sugeno
    scale: Array
    """(D,) half range of each input, the unit of a consequent's slope"""
    hold: float = CONSEQUENT_HOLD

    @classmethod
    def start(cls, rows: Array, value: float, rules: int, seed: int) -> FuzzySurface:
        """Gaussian rules around the centres of `rules` clusters of the inputs `rows` (n, D); `value` everywhere.

        Scatter partitioning by k-means. Distances are in half ranges of the inputs.
        """
        from sklearn.cluster import KMeans

        low, high = rows.min(axis=0), rows.max(axis=0)
        half = np.where(high > low, (high - low) / 2.0, 1.0)
        z = (rows - low) / half
        centres = KMeans(rules, n_init=KMEANS_RESTARTS, random_state=seed).fit(z).cluster_centers_
        distances = np.sort(np.sqrt(portable.square(centres[:, None] - centres[None]).sum(axis=2)), axis=1)
        near = distances[:, 1 : min(RULE_NEIGHBOURS + 1, rules)].mean(axis=1) if rules > 1 else np.ones(1)
        inputs = rows.shape[1]
        premises = np.empty((rules * inputs, 3))
        premises[:, BELL_WIDTH] = (near[:, None] * half * RULE_WIDTH).ravel()
        premises[:, BELL_SLOPE] = 1.0
        premises[:, 2] = (centres * half + low).ravel()
        system = Sugeno(
            owner=np.tile(np.arange(inputs), rules),
            bell=np.zeros(rules * inputs, dtype=bool),
            premises=premises,
            rules=np.arange(rules * inputs).reshape(rules, inputs),
            consequents=np.zeros((rules, inputs + 1)),
            weights=np.ones(rules),
        )
        return cls(system, half).level(value)

    def level(self, value: float) -> FuzzySurface:
        """Return these rules with the output `value` everywhere."""
        consequents = np.zeros_like(self.system.consequents)
        consequents[:, -1] = value
        return replace(self, system=replace(self.system, consequents=consequents))

    def fit(self, x: Array, target: Array, weight: Array, effort: float = 1.0) -> Self:
        strengths = self.system.strengths(x)
        extended = np.column_stack((x / self.scale, np.ones(len(x))))
        a = (strengths[:, :, None] * extended[:, None, :]).reshape(len(x), -1)
        share = weight / weight.sum()
        gram = (a * share[:, None]).T @ a
        gram[np.diag_indices_from(gram)] += self.hold / effort * np.trace(gram) / len(gram)
        change = np.linalg.solve(gram, (a * share[:, None]).T @ (target - self.predict(x)))
        moved = change.reshape(self.system.consequents.shape) / np.append(self.scale, 1.0)
        return replace(self, system=replace(self.system, consequents=self.system.consequents + moved))

    def average(self, surfaces: Sequence[Self]) -> Self:
        consequents = np.mean([self.system.consequents, *(surface.system.consequents for surface in surfaces)], axis=0)
        return replace(self, system=replace(self.system, consequents=consequents))

    def function(self) -> Sugeno:
        return self.system
