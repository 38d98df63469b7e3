"""One tuning for every car, or one that follows from what is known of the car: regrets on random cars.

    python benchmarks/population.py [--cars 100] [--profile road] [--known exactly] [--costs FILE]

Random cars (`identification.random_cars`): the paper's and the saloon, log-uniform about them, with their own steering
and noise. `exactly`: the controller is told the car, in a world without steering bias. `within`: of a car whose
logarithms (or seconds) differ by d from the middle of the ranges it believes the middle plus (1 - k) d, and is told an
uncertainty of k half ranges; k, uniform in 0.25-1, is drawn for each car, and 1 for every fourth.

Each car drives with a grid of constants, 11 weights about the profile's own and 4 pairs of horizons: DRIVES random
drives of 30 s for choosing, DRIVES others for judging. J = mean e^2 + w mean (change of command)^2; a failed drive
counts 25 m^2. A car's own best constant is chosen on the first and judged on the second, as all others are; regret is
the geometric mean of J over it, by 10-fold cross-validation: whatever is learned is learned on other cars. Between the
weights of the grid log J is interpolated; horizons are the pair of the grid that is nearest. What is learned is
the weight over the profile's own and Np, in logarithms (Nc goes with Np in the grid).
"""

from __future__ import annotations

import argparse
import json
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.linear_model import RidgeCV
from sklearn.preprocessing import StandardScaler

import adaptrack as at
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers import Learning, Uncertainty
from adaptrack.drive.batch import rollout_batch
from adaptrack.identification.random_cars import CarRanges, RandomCar, random_car
from adaptrack.paper import ANFIS, MLP
from adaptrack.scenario import random_drive
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]

DRIVES, SECONDS, FAILED, FOLDS, FIRST = 6, 30.0, 25.0, 10, 31_000_000
PAIRS = ((14, 4), (20, 6), (30, 10), (45, 15))
USUAL = 2
"""The pair that `informed_tuning` has at a period of 0.05 s with preview."""
WEIGHTS = np.arange(-5, 6) * 0.375
"""log10 of R over the profile's own"""
SPEED = 15.0
"""m/s, of the yaw gain"""
FEATURES = ("lag / T", "dead time / T", "understeer", "log yaw gain", "log noise", "uncertainty / T")
YAW_GAIN, NOISE = 3, 4
KNOWN = ("exactly", "within")


class Told(NamedTuple):
    """What a controller is told of a car."""

    vehicle: Vehicle
    steering: Steering
    uncertainty: Uncertainty


def told(car: RandomCar, share: float) -> Told:
    """What is believed of a car whose difference from the middle of the ranges is unknown by a share of it (0 to 1)."""
    ranges, true, base = CarRanges(), car.vehicle, at.load_vehicle(car.base)
    mass, stiffness = (math.sqrt(low * high) for low, high in (ranges.mass, ranges.stiffness))
    middles = {
        "mass": base.mass * mass, "yaw_inertia": base.yaw_inertia * mass,
        "stiffness_front": base.stiffness_front * stiffness, "stiffness_rear": base.stiffness_rear * stiffness,
    }  # fmt: skip
    numbers = {name: getattr(true, name) ** (1.0 - share) * value**share for name, value in middles.items()}
    delays, halves, actuator = {}, {}, car.profile.steering
    for name, (low, high) in (("lag", ranges.lag), ("dead_time", ranges.dead_time)):
        delays[name] = (1.0 - share) * getattr(actuator, name) + share * (low + high) / 2.0
        halves[name] = share * (high - low) / 2.0
    unsure = Uncertainty(
        **halves, stiffness=math.sqrt(ranges.stiffness[1] / ranges.stiffness[0]) ** share,
        mass=math.sqrt(ranges.mass[1] / ranges.mass[0]) ** share - 1.0,
    )  # fmt: skip
    return Told(true.replace(**numbers), Steering(**delays, rate=actuator.rate, limit=actuator.limit), unsure)


def features(known: Told, car: RandomCar, period: float) -> list[float]:
    """`FEATURES` of what is known of a car and its sensors."""
    v = known.vehicle
    front, rear = 2.0 * v.stiffness_front, 2.0 * v.stiffness_rear
    length = v.lf + v.lr
    understeer = v.mass * (v.lr * rear - v.lf * front) / (length * front * rear)  # rad s^2/m
    gain = SPEED / (length + understeer * SPEED**2)  # 1/s
    unsure = math.hypot(known.uncertainty.lag, known.uncertainty.dead_time)
    lag, dead_time = known.steering.lag or 0.0, known.steering.dead_time or 0.0
    return [
        lag / period, dead_time / period, understeer * 100.0,
        math.log10(max(gain, 0.1)), math.log10(car.noise), unsure / period,
    ]  # fmt: skip


def unknown(number: int, known: str) -> float:
    """The share of a car that is unknown."""
    drawn = float(np.random.default_rng((7, number)).uniform(0.25, 1.0))
    return 0.0 if known == "exactly" else 1.0 if number % 4 == 3 else drawn


def costs(number: int, profile: str, known: str) -> tuple[Array, Array, list[float], float]:
    """J (horizons, weights, 2 DRIVES) of a car, J (2 DRIVES,) of learning, its features, the share that is unknown."""
    car, share = random_car(number, profile=profile), unknown(number, known)
    world, belief = car.profile, told(car, share)
    if known == "exactly":
        world = world.replace(steering=world.steering.replace(bias=0.0))
    given: dict[str, Any] = {"profile": world, "belief": belief.steering, "uncertainty": belief.uncertainty}
    mpc = at.MPC(belief.vehicle, **given)
    grid = [(np_, nc, 1.0, mpc.tuning.R * 10.0**each) for np_, nc in PAIRS for each in WEIGHTS]
    cost = driven(car, world, mpc, np.array(grid)).reshape(len(PAIRS), len(WEIGHTS), -1)
    learning = np.full(2 * DRIVES, math.nan)
    if known != "exactly":
        mpc = at.MPC(belief.vehicle, **given, learning=Learning())
        learning = driven(car, world, mpc, mpc.tuning.as_array()[None])
    return cost, learning, features(belief, car, world.period), share


def driven(car: RandomCar, world: Profile, mpc: at.MPC, tunings: Array) -> Array:
    """J (tunings * 2 DRIVES,) of a car with each tuning on each drive."""
    drives = [random_drive(FIRST + 100 * car.seed + i, SECONDS) for i in range(2 * DRIVES)]
    which = np.tile(np.arange(2 * DRIVES), len(tunings))
    run = rollout_batch(
        at.DualTrack(car.vehicle, car.tyre), mpc, drives, np.repeat(tunings, 2 * DRIVES, axis=0),
        scenario_indices=which,
        profile=world, seeds=which + 1000 * car.seed,
    )  # fmt: skip
    lost = np.array([reason is not None for reason in run.failed])
    return np.where(lost, FAILED, run.mse + world.move_weight * run.mean_squared_move)


class Cars(NamedTuple):
    """What the cars cost."""

    choosing: Array
    """(cars, horizons, weights) log J on the drives for choosing"""
    judging: Array
    features: Array
    """(cars, FEATURES)"""
    caution: Array
    """(cars,) log10 of the profile's weight with the caution of its uncertainty, over that without"""
    learning: Array
    """(cars,) log J on the drives for judging of the controller that learns; NaN where there is nothing to learn"""

    def best(self) -> Array:
        """(cars, 2) each car's own constant: horizons, weight, both as grid numbers."""
        flat = self.choosing.reshape(len(self.choosing), -1).argmin(axis=1)
        return np.stack(np.unravel_index(flat, self.choosing.shape[1:]), axis=1)

    def targets(self) -> Array:
        """(cars, 2) log10 weight and log10 Np to learn: means over what costs next to nothing more than the best.

        The minimum of a few drives is flat and noisy, so the best grid point alone is a poor target.
        """
        likely = np.exp(-(self.choosing - self.choosing.min(axis=(1, 2), keepdims=True)) / 0.03)
        likely /= likely.sum(axis=(1, 2), keepdims=True)
        lengths = np.log10([pair[0] for pair in PAIRS])
        return np.stack([likely.sum(axis=1) @ WEIGHTS, likely.sum(axis=2) @ lengths], axis=1)


def at_weights(cost: Array, pair: Array, weight: Array) -> Array:
    """(cars,) log J of cost (cars, horizons, weights), at horizons (cars,) and log10 weights over the profile's own."""
    return np.array(
        [np.interp(w, WEIGHTS, of_car[p]) for of_car, p, w in zip(cost, pair, weight, strict=True)], dtype=float
    )


def shifted(train: Cars, shift: Array) -> tuple[int, float]:
    """Horizons and weight that cost least on the training cars whose weights are shifted."""
    found = []
    for pair in range(len(PAIRS)):
        for weight in np.arange(-2.0, 2.01, 0.125):
            cost = at_weights(train.choosing, np.full(len(shift), pair), weight + shift)
            found.append((float(cost.mean()), pair, float(weight)))
    _, pair, weight = min(found)
    return pair, weight


def by_rule(train: Cars, test: Cars, shift: Callable[[Cars], Array]) -> tuple[Array, Array]:
    """One constant for all, times a rule."""
    pair, weight = shifted(train, shift(train))
    return np.full(len(test.features), pair), weight + shift(test)


def scaled(train: Cars, test: Cars) -> tuple[Array, Array]:
    """Features of both, standardised; nothing is asked outside what was learned from."""
    scale = StandardScaler().fit(train.features)
    x, z = (scale.transform(each.features) for each in (train, test))
    varying = np.ptp(x, axis=0) > 1e-9
    return x[:, varying], np.clip(z, x.min(axis=0), x.max(axis=0))[:, varying]


def by_best(train: Cars, test: Cars, make: Callable[[], Any]) -> tuple[Array, Array]:
    """Learned: what is best for a car."""
    x, z = scaled(train, test)
    found = [make().fit(x, target).predict(z) for target in train.targets().T]
    lengths = np.log10([pair[0] for pair in PAIRS])
    return np.abs(found[1][:, None] - lengths).argmin(axis=1), found[0]


def of_noise(cars: Cars) -> Cars:
    """The cars of whom only the noise of the sensors is known."""
    return cars._replace(features=cars.features[:, NOISE : NOISE + 1])


def linear() -> Any:
    """A linear map."""
    return RidgeCV(np.geomspace(0.1, 100.0, 7))


def network() -> Any:
    """The network."""
    return MLP((6,), solver="lbfgs", epochs=300, relu=False, early_stopping=True, random_state=0)


def anfis() -> Any:
    """ANFIS with few rules."""
    return ANFIS("subtractive", influence=1.0, ridge=1.0, epochs=10, random_state=0)


def zero(cars: Cars) -> Array:
    """Nothing is added."""
    return np.zeros(len(cars.features))


CONTENDERS: dict[str, Callable[[Cars, Cars], tuple[Array, Array]]] = {
    "the profile's constant": lambda train, test: (np.full(len(test.features), USUAL), zero(test)),
    "one constant for all": lambda train, test: by_rule(train, test, lambda cars: -cars.caution),
    "one, times the caution": lambda train, test: by_rule(train, test, zero),
    "... times yaw gain^2": lambda train, test: by_rule(train, test, lambda cars: 2.0 * cars.features[:, YAW_GAIN]),
    "... times noise": lambda train, test: by_rule(train, test, lambda cars: cars.features[:, NOISE]),
    "linear, of the best": lambda train, test: by_best(train, test, linear),
    "linear in the noise": lambda train, test: by_best(of_noise(train), of_noise(test), linear),
    "network, of the best": lambda train, test: by_best(train, test, network),
    "ANFIS, of the best": lambda train, test: by_best(train, test, anfis),
}


def judged(cars: Cars) -> dict[str, Array]:
    """Contender -> (cars,) log regret to the car's own best constant."""
    own = cars.best()
    rows = np.arange(len(own))
    floor = cars.judging[rows, own[:, 0], own[:, 1]]
    folds = np.random.default_rng(0).permutation(len(own)) % FOLDS
    found = {name: np.zeros(len(own)) for name in CONTENDERS}
    for fold in range(FOLDS):
        out = folds == fold
        train, test = (Cars(*(part[mask] for part in cars)) for mask in (~out, out))
        for name, choose in CONTENDERS.items():
            found[name][out] = at_weights(test.judging, *choose(train, test)) - floor[out]
    if np.isfinite(cars.learning).all():
        found["learning while driving"] = cars.learning - floor
    return found


def collected(given: argparse.Namespace) -> tuple[Cars, Array, int]:
    """The cars, the share of each that is unknown, and how many drives the profile's constant fails."""
    if given.costs is not None and given.costs.exists():
        file = np.load(given.costs)
        cost, learning, rows, share = (file[name] for name in ("cost", "learning", "features", "share"))
    else:
        each = [costs(number, given.profile, given.known) for number in range(given.cars)]
        cost, learning, rows, share = (np.array(part) for part in zip(*each, strict=True))
        if given.costs is not None:
            np.savez(given.costs, cost=cost, learning=learning, features=rows, share=share)
    logs = np.log(cost)
    unsure = [told(random_car(number), each).uncertainty.caution for number, each in enumerate(share)]
    cars = Cars(
        logs[..., :DRIVES].mean(axis=3), logs[..., DRIVES:].mean(axis=3), rows, np.log10(unsure),
        np.log(learning[:, DRIVES:]).mean(axis=1),
    )  # fmt: skip
    return cars, share, int((cost[:, USUAL, len(WEIGHTS) // 2] >= FAILED).sum())


def main() -> None:
    """Drive the cars, judge the contenders, print a row each."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--cars", type=int, default=100)
    ask.add_argument("--profile", default="road")
    ask.add_argument("--known", choices=KNOWN, default="exactly")
    ask.add_argument("--costs", type=Path, default=None, help="file to keep the costs in, or to read them from")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.ERROR)  # a belief that is wrong is the point here
    cars, share, lost = collected(given)
    found = judged(cars)
    rng = np.random.default_rng(0)
    rows = []
    for name, regret in found.items():
        means = regret[rng.integers(0, len(regret), (2000, len(regret)))].mean(axis=1)
        low, high = np.exp(np.quantile(means, (0.025, 0.975)))
        rows.append({"contender": name, "regret": float(np.exp(regret.mean())), "low": float(low), "high": float(high),
                     "p90": float(np.exp(np.quantile(regret, 0.9))), "worst": float(np.exp(regret.max()))})  # fmt: skip
    if given.json:
        print(json.dumps({"profile": given.profile, "known": given.known, "cars": len(share), "rows": rows}))
    else:
        print(f"{given.profile}, known {given.known}, {len(share)} cars; the profile's constant fails {lost} drives of "
              f"{len(share) * 2 * DRIVES}")  # fmt: skip
        for row in rows:
            print(
                f"{row['contender']:26s} x{row['regret']:.3f} [{row['low']:.3f}, {row['high']:.3f}]  "
                f"p90 {row['p90']:.2f}  worst {row['worst']:.2f}"
            )
        own = cars.best()
        quantiles = np.quantile(WEIGHTS[own[:, 1]], (0.0, 0.1, 0.5, 0.9, 1.0)).round(3).tolist()
        print("own best:", dict(zip(PAIRS, np.bincount(own[:, 0], minlength=len(PAIRS)).tolist(), strict=True)),
              "of the horizons; log10 weight, quantiles 0, 10, 50, 90, 100 %:", quantiles)  # fmt: skip


if __name__ == "__main__":
    main()
