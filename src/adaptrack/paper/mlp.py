"""Networks that learn: the paper's section IV A as a scikit-learn regressor.

`MLP` finds the weights of a `Network` with scikit-learn's `MLPRegressor`. That knows no ReLU at its output, so the
output is linear while it learns targets scaled to [0, 1], and the ReLU comes in when the network runs. No gradient
vanishes in a dead output this way, wherever the weights start; how often the ReLU then bites is counted
(`dead_share_`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits

from adaptrack.base.checked import Count, Positive
from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling import Network
from adaptrack.core.maths.portable import Array
from adaptrack.paper.regressor import Regressor, Samples

MLP_SOLVERS = {"momentum": "sgd", "adam": "adam", "lbfgs": "lbfgs"}
"""Our names, and scikit-learn's."""
LEARNING_RATES = {"momentum": 0.5, "adam": 0.01, "lbfgs": 1.0}
"""Fast and still steady over 1000 epochs of batches of 200 rows; of no meaning for "lbfgs"."""
LBFGS_ROUND = 50
"""Iterations of "lbfgs" after which its error is looked at."""
FLATTEST = 1e-6
"""Where "lbfgs" stops: largest derivative of half the mean squared error of the scaled target."""


@dataclass(eq=False, repr=False)
class MLP(Regressor):
    """Feed-forward network with sigmoid hidden layers, trained on the mean squared error. The defaults are the paper's.

    Inputs are scaled to [-1, 1], the target to [0, 1]. (With inputs in [0, 1] less is learned in as many epochs.)

    Parameters
    ----------
    hidden : sequence of int
        Neurons of each hidden layer.
    solver : "momentum", "adam" or "lbfgs"
        Gradient descent with momentum (0.9, not Nesterov's); two that learn faster. "lbfgs" takes all rows at once.
    learning_rate : float or None
        None: 0.5 for "momentum", 0.01 for "adam".
    batch_size : int
        Rows of each gradient step, shuffled in each epoch.
    epochs : int
        Passes through the data, or iterations of "lbfgs".
    relu : bool
        ReLU at the output; the least target is then the least output.
    early_stopping : bool
        Hold out `validation_fraction` of the rows, keep the epoch that is best on them, and stop after `patience`
        epochs without a better one. Without it all epochs are made, and the one that is best on all rows is kept.
    random_state : int, RandomState or None
        Start of the weights, order of the rows, and the rows that are held out. A number makes training repeatable.

    Attributes
    ----------
    network_ : Network
        What was learned, for inputs and output in the units of the data.
    history_ : dict of str to array
        "epoch", 1, 2, ... (for "lbfgs" the iterations, one entry per 50), and after each the "train_rmse" and, with
        early stopping, the "validation_rmse", in the unit of the target.
    best_epoch_ : int
        The epoch whose network was kept.
    n_iter_ : int
        Epochs made.
    dead_share_ : float
        Share of the rows trained on at which the ReLU changes the output.

    Raises
    ------
    InvalidInput
        From `fit`, when training diverges (a ValueError, as scikit-learn wants it).
    """

    hidden: Annotated[Sequence[Count], Field(min_length=1)] = (16, 8)
    _: KW_ONLY
    solver: Literal["momentum", "adam", "lbfgs"] = "momentum"
    learning_rate: Positive | None = None
    batch_size: Count = 200
    epochs: Count = 1000
    relu: bool = True
    early_stopping: bool = False
    validation_fraction: Annotated[Positive, Field(lt=1.0)] = 0.2
    patience: Count = 50
    random_state: Any = None

    def fit(self, X: ArrayLike, y: ArrayLike, sample_weight: ArrayLike | None = None) -> Self:
        """Learn from the inputs X (n, D) and the target y (n,); `sample_weight` (n,): how much each row counts.

        With all rows in one batch a weight of 2 is a row given twice, and of 0 one left out; smaller batches, and the
        rows held out, are drawn from the rows whatever their weights are.
        """
        _, rows, checks, rng = self._samples(X, y, sample_weight)
        with threadpool_limits(limits=1), np.errstate(over="ignore", invalid="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # the number of epochs is the recipe
            warnings.filterwarnings("error", "Training interrupted by user")  # else Ctrl-C would end an epoch only
            self.network_, self.history_ = self._train(_scales(rows.x, rows.y, self.relu), rows, checks, rng)
        decisive = self.history_["validation_rmse" if len(checks.y) else "train_rmse"]
        self.best_epoch_ = int(self.history_["epoch"][np.argmin(decisive)])
        self.n_iter_ = int(self.history_["epoch"][-1])
        linear = replace(self.network_, relu=False)
        is_dead = self.network_.predict(rows.x) != linear.predict(rows.x)
        self.dead_share_ = float(np.average(is_dead, weights=rows.weight))
        return self

    def predict(self, X: ArrayLike) -> Array:
        """(n,) output of the network at the inputs X (n, D)."""
        check_is_fitted(self, "network_")
        x = validate_data(self, X, dtype=np.float64, reset=False)
        with np.errstate(over="ignore"):  # of a sigmoid that is 0
            return self.network_.predict(x)

    def _learner(self, rows: int, rng: np.random.RandomState) -> MLPRegressor:
        learning_rate = self.learning_rate
        return MLPRegressor(
            hidden_layer_sizes=tuple(self.hidden),
            activation="logistic",
            solver=MLP_SOLVERS[self.solver],
            alpha=0.0,
            batch_size=min(self.batch_size, rows),
            learning_rate_init=LEARNING_RATES[self.solver] if learning_rate is None else learning_rate,
            momentum=0.9,
            nesterovs_momentum=False,
            tol=FLATTEST,
            warm_start=True,
            random_state=rng,
        )

    def _train(
        self, scales: Network, rows: Samples, checks: Samples, rng: np.random.RandomState
    ) -> tuple[Network, dict[str, Array]]:
        """The best network of all epochs, and the history; `scales` is a network of which only the scales are used."""
        x, y, weight = rows
        z = (x - scales.low) / (scales.high - scales.low)
        v = (y - scales.out_low) / ((scales.out_high - scales.out_low) or 1.0)
        learner = self._learner(len(y), rng)
        stride, further = (LBFGS_ROUND, learner.fit) if self.solver == "lbfgs" else (1, learner.partial_fit)
        history: dict[str, list[float]] = {"epoch": [], "train_rmse": [], "validation_rmse": []}
        decisive = history["validation_rmse" if len(checks.y) else "train_rmse"]
        epoch, best_epoch, lowest, best = 0, 0, math.inf, scales
        while epoch < self.epochs and (epoch - best_epoch < self.patience or not len(checks.y)):
            learner.max_iter = min(stride, self.epochs - epoch)
            try:
                further(z, v, weight)
            except ValueError:  # weights that are not finite
                raise InvalidInput(f"MLP: diverged after {epoch} epochs: take a lower learning_rate.") from None
            except UserWarning:
                raise KeyboardInterrupt from None
            epoch += learner.n_iter_
            weights, biases = (
                tuple(array.copy() for array in layers) for layers in (learner.coefs_, learner.intercepts_)
            )
            network = replace(scales, weights=weights, biases=biases)
            history["epoch"].append(epoch)
            history["train_rmse"].append(rows.rmse(network))
            if len(checks.y):
                history["validation_rmse"].append(checks.rmse(network))
            if decisive[-1] < lowest:
                lowest, best_epoch, best = decisive[-1], epoch, network
            if learner.n_iter_ < learner.max_iter:
                break  # converged
        return best, {name: np.array(values) for name, values in history.items() if values}


def _scales(x: Array, y: Array, relu: bool) -> Network:
    """A network of zeros that scales the inputs x to [-1, 1] and the target y to [0, 1]."""
    half = np.ptp(x, axis=0) / 2.0
    middle = x.min(axis=0) + half
    return Network(
        low=middle,
        high=middle + np.where(half > 0.0, half, np.maximum(1.0, np.abs(middle))),
        weights=(np.zeros((x.shape[1], 1)),),
        biases=(np.zeros(1),),
        out_low=float(y.min()),
        out_high=float(y.max()),
        relu=relu,
    )
