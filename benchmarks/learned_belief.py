"""Networks and ANFIS as estimators of what a car is, beside the filters that learn while driving.

    python benchmarks/learned_belief.py [--train 600] [--test 200] [--profile road] [--signals FILE] [--drive CARS]

Random cars (`identification.random_cars`), of which the controller believes the middle of the ranges and learns
(`MPC(..., learning=Learning())`), drive for 60 s (random_drive); the drives that fail are left out. All estimators see
the same drives: the commands, the speed and what the profile's sensors give (yaw rate, lateral velocity or lateral
acceleration), with noise of that car's size. What is estimated: delay of the steering (s, lag and dead time, with the
computation), logarithm of the stiffness over the mass as a factor on what is believed, logarithm of the friction at
that time.

What a network sees of a window: how well each of 65 hypotheses explains it. A hypothesis is the believed car with its
stiffness times one of STIFFNESS and one of DELAYS, half of it lag; its linear single-track model answers the commands,
and the logarithm of the mean squared residual (constant removed) over that of the best hypothesis is a feature, for
each sensor; beside that the least residual over the noise, the excitation, speeds and forces. So a window of any length
gives as many features, a model for each length is learned on the other cars.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sklearn.decomposition import PCA
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import adaptrack as at
from adaptrack.cars.vehicle import Steering, Vehicle
from adaptrack.control.controllers import Learning, Uncertainty
from adaptrack.core.controllers.mpc import MPC_ANSWER
from adaptrack.core.estimators.learning import BELIEF_COLUMNS
from adaptrack.core.plants.contract import PLANT_STATE
from adaptrack.drive.batch import Batch
from adaptrack.identification.random_cars import CarRanges, random_car
from adaptrack.paper import ANFIS
from adaptrack.scenario import random_drive
from adaptrack.scenario.profile import Profile, load_profile

Array = NDArray[np.float64]

SECONDS, BLOCK, FIRST = 60.0, 2.0, 31_000_000
STIFFNESS = np.exp(np.linspace(-1.6, 1.6, 5))
"""-, factors on what is believed"""
DELAYS = np.arange(0.1, 0.701, 0.05)
"""s"""
DRIVEN = ("filters", "network", "network and filters", "network that corrects the filters", "the truth")
TARGETS = ("delay", "stiffness", "friction")
LEAST_SPEED = 2.0
"""m/s, of the model"""


class Drives(NamedTuple):
    """Signals of drives, and what is true of them."""

    command: Array
    """(drives, n) rad"""
    speed: Array
    """(drives, n) m/s"""
    measured: Array
    """(drives, sensors, n) yaw rate (rad/s), then lateral velocity (m/s) or acceleration (m/s^2)"""
    noise: Array
    """(drives, sensors) standard deviation"""
    car: Array
    """(drives, 6) believed m, I_z, l_f, l_r, C_f, C_r, of axles"""
    truth: Array
    """(drives, blocks, targets) at the end of each block"""
    filters: Array
    """(drives, blocks, targets) what the learning filters say then"""
    number: Array
    """(drives,) of the car"""


def believed(base: Vehicle) -> Vehicle:
    """The middle of the ranges."""
    ranges = CarRanges()
    mass, stiffness = (math.sqrt(low * high) for low, high in (ranges.mass, ranges.stiffness))
    return base.replace(
        mass=base.mass * mass, yaw_inertia=base.yaw_inertia * mass, stiffness_front=base.stiffness_front * stiffness,
        stiffness_rear=base.stiffness_rear * stiffness,
    )  # fmt: skip


def drive(number: int, profile: Profile) -> tuple[Array, ...] | None:
    """The parts of `Drives` of one car; None where it fails."""
    ranges, car = CarRanges(), random_car(number, profile=profile)
    vehicle, middle = believed(at.load_vehicle(car.base)), {}
    half = {}
    for name, (low, high) in (("lag", ranges.lag), ("dead_time", ranges.dead_time)):
        middle[name], half[name] = (low + high) / 2.0, (high - low) / 2.0
    unsure = Uncertainty(**half, stiffness=math.sqrt(5.0), mass=math.sqrt(ranges.mass[1] / ranges.mass[0]) - 1.0)
    mpc = at.MPC(vehicle, profile=profile, belief=Steering(**middle), uncertainty=unsure, learning=Learning())
    batch = Batch(at.DualTrack(car.vehicle, car.tyre), mpc, [random_drive(FIRST + number, SECONDS)], car.profile)
    run = batch.run(np.zeros(1, np.int64), batch.tuning[None], np.array([number]), 1, traced=True)
    if run.has_failed[0]:
        return None
    world, signals, n = car.profile, batch.signals[0], round(SECONDS / profile.period)
    state, answer, seen = run.trace.state[0, :n], run.trace.answer[0, :n], run.trace.signals[0, :n]
    rng = np.random.default_rng((11, number))
    has_vy = math.isfinite(world.noise_vy)
    sensors = [(state[:, PLANT_STATE.yaw_rate], world.noise_yaw_rate)]
    sensors.append(
        (state[:, PLANT_STATE.vy], world.noise_vy) if has_vy else (seen[:, 0], world.noise_lateral_acceleration)
    )
    measured = [values + noise * rng.standard_normal(n) for values, noise in sensors]
    measured[0] += world.bias_yaw_rate * rng.uniform(-1.0, 1.0)
    v = vehicle
    own = [v.mass, v.yaw_inertia, v.lf, v.lr, 2.0 * v.stiffness_front, 2.0 * v.stiffness_rear]
    ends = np.arange(1, round(SECONDS / BLOCK) + 1) * round(BLOCK / profile.period) - 1
    true = np.sqrt(car.vehicle.stiffness_front * car.vehicle.stiffness_rear) / car.vehicle.mass
    told = np.sqrt(v.stiffness_front * v.stiffness_rear) / v.mass
    friction = np.log(signals.friction[ends].mean(axis=1))
    truth = np.stack([np.full(len(ends), car.delay), np.full(len(ends), math.log(true / told)), friction], axis=1)
    beliefs = answer[ends, len(MPC_ANSWER) : len(MPC_ANSWER) + len(BELIEF_COLUMNS)]
    filters = np.stack(
        [beliefs[:, BELIEF_COLUMNS.belief_delay] + world.dead_time - world.steering.dead_time,
         np.log(beliefs[:, BELIEF_COLUMNS.belief_stiffness]),
         np.log(beliefs[:, BELIEF_COLUMNS.belief_friction])], axis=1,
    )  # fmt: skip
    noises = np.array([noise for _, noise in sensors])
    command = answer[:, MPC_ANSWER.command].copy()  # not a view that keeps the whole trace
    return command, signals.speed[:n], np.array(measured), noises, np.array(own), truth, filters, np.array(number)


def answers(drives: Drives, period: float, vy_measured: bool) -> Array:
    """(drives, sensors, stiffness, delays, n) what each hypothesis says of the sensors.

    The single-track model by the trapezoidal rule; lag and dead time, half of the delay each, act on its output.
    """
    count, n = drives.command.shape
    m, inertia, lf, lr, cf, cr = (each[:, None] for each in drives.car.T)
    cf, cr = cf * STIFFNESS, cr * STIFFNESS  # (drives, stiffness)
    lag, dead = DELAYS / 2.0, DELAYS / 2.0 / period
    keep = np.exp(-period / lag)
    vy, rate = np.zeros((count, len(STIFFNESS))), np.zeros((count, len(STIFFNESS)))
    slow = np.zeros((2, count, len(STIFFNESS), len(DELAYS)))
    before = np.zeros((2, count, len(STIFFNESS), 1))
    found = np.empty((count, 2, len(STIFFNESS), len(DELAYS), n), np.float32)
    for k in range(n):
        v = np.maximum(drives.speed[:, k, None], LEAST_SPEED)
        a, b = -(cf + cr) / (m * v), -(lf * cf - lr * cr) / (m * v) - v
        c, d = -(lf * cf - lr * cr) / (inertia * v), -(lf**2 * cf + lr**2 * cr) / (inertia * v)
        push, turn = cf / m * drives.command[:, k, None], lf * cf / inertia * drives.command[:, k, None]
        now = np.stack([rate, vy if vy_measured else a * vy + (b + v) * rate + push])[..., None]
        slow, before = keep * slow + (1.0 - keep) * 0.5 * (before + now), now
        found[..., k] = slow.transpose(1, 0, 2, 3)
        h = period / 2.0
        right = vy + h * (a * vy + b * rate) + period * push, rate + h * (c * vy + d * rate) + period * turn
        det = (1.0 - h * a) * (1.0 - h * d) - h * h * b * c
        vy, rate = (
            ((1.0 - h * d) * right[0] + h * b * right[1]) / det,
            ((1.0 - h * a) * right[1] + h * c * right[0]) / det,
        )
    for j, shift in enumerate(dead):
        whole, part = int(shift), shift - int(shift)
        late = np.pad(found[..., j, :], [(0, 0)] * 3 + [(whole + 1, 0)])
        found[..., j, :] = (1.0 - part) * late[..., 1 : n + 1] + part * late[..., :n]
    return found


def moments(drives: Drives, period: float, vy_measured: bool) -> tuple[Array, Array]:
    """Sums of each block: (drives, blocks, sensors, stiffness, delays, 2) of residual, its square; (drives, blocks, .).

    The others: the sum and the square of each sensor, speed, its square, absolute lateral acceleration, command^2.
    """
    size = round(BLOCK / period)
    residual, plain = [], []
    for first in range(0, len(drives.command), 20):
        some = Drives(*(part[first : first + 20] for part in drives))
        off = some.measured[:, :, None, None] - answers(some, period, vy_measured)
        blocks = off.reshape(*off.shape[:-1], -1, size)
        sums = np.stack([blocks.sum(axis=-1), (blocks**2).sum(axis=-1)], axis=-1)
        residual.append(np.moveaxis(sums, 4, 1))
    for command, speed, measured in zip(drives.command, drives.speed, drives.measured, strict=True):
        pull = np.abs(speed * measured[0])
        rows = [*measured, *measured**2, speed, speed**2, pull, command**2]
        plain.append(np.array(rows).reshape(len(rows), -1, size).sum(axis=2).T)
    return np.concatenate(residual), np.array(plain)


def features(residual: Array, plain: Array, drives: Drives, window: tuple[int, int], period: float) -> Array:
    """(drives, features) of the blocks window[0] .. window[1]."""
    cut = slice(*window)
    n = (window[1] - window[0]) * round(BLOCK / period)
    sums, rest = residual[:, cut].sum(axis=1) / n, plain[:, cut].sum(axis=1) / n
    error = sums[..., 1] - sums[..., 0] ** 2 + 0.1 * (drives.noise**2)[:, :, None, None]
    count = len(error)
    flat = np.log(error.reshape(count, error.shape[1], -1))
    least = flat.min(axis=2, keepdims=True)
    sharp = np.exp(-(flat - least) * min(n / 10.0, 20.0))  # about a likelihood
    sharp /= sharp.sum(axis=2, keepdims=True)
    grid = np.stack(np.meshgrid(np.log(STIFFNESS), DELAYS, indexing="ij"), axis=-1).reshape(-1, 2)
    joint = np.exp(-(flat - least).sum(axis=1) * min(n / 10.0, 20.0))
    middle = (joint / joint.sum(axis=1, keepdims=True)) @ grid
    sensors = drives.measured.shape[1]
    variance = rest[:, sensors : 2 * sensors] - rest[:, :sensors] ** 2
    own = drives.car
    understeer = own[:, 0] * (own[:, 3] * own[:, 5] - own[:, 2] * own[:, 4]) / (own[:, 4] * own[:, 5])
    parts = [
        middle, (sharp @ grid).reshape(count, -1), least[:, :, 0] - 2.0 * np.log(drives.noise),
        np.log(variance / drives.noise**2 + 1.0), np.log(drives.noise), rest[:, -4:-1] / [10.0, 200.0, 1.0],
        plain[:, cut, -2].max(axis=1, keepdims=True) / round(BLOCK / period), np.log(rest[:, -1:] + 1e-7),
        understeer[:, None],
        np.tanh((flat - least) / 2.0).reshape(count, -1),
    ]  # fmt: skip
    return np.concatenate(parts, axis=1)


def network(seed: int) -> Any:
    """The network."""
    return make_pipeline(
        StandardScaler(),
        MLPRegressor(
            hidden_layer_sizes=(48, 24),
            alpha=0.3,
            early_stopping=True,
            max_iter=300,
            random_state=seed,
            n_iter_no_change=15,
        ),
    )


def anfis() -> Any:
    """ANFIS on six principal components."""
    return make_pipeline(
        StandardScaler(), PCA(6, random_state=0),
        ANFIS("subtractive", influence=0.8, ridge=1e-2, epochs=10, random_state=0),
    )  # fmt: skip


def collected(given: argparse.Namespace, profile: Profile) -> Drives:
    """The drives that did not fail, those for training first."""
    if given.signals is not None and given.signals.exists():
        return Drives(**np.load(given.signals))
    found = [drive(number, profile) for number in range(given.train + given.test)]
    kept = Drives(*(np.array(part) for part in zip(*(each for each in found if each is not None), strict=True)))
    if given.signals is not None:
        np.savez(given.signals, **kept._asdict())
    return kept


Half = tuple[Drives, tuple[Array, Array]]
"""Drives, and their `moments`."""


class Learned(NamedTuple):
    """Estimators of the targets, of windows of one length."""

    networks: list[Any]
    fuzzy: list[Any]
    middle: Array
    scale: Array

    def estimates(self, x: Array) -> dict[str, Array]:
        """(drives, targets) of the networks' mean and of ANFIS."""
        mean = np.mean([each.predict(x) for each in self.networks], axis=0)
        fuzzy = np.clip(np.stack([each.predict(x) for each in self.fuzzy], axis=1), -2.5, 2.5)
        return {name: self.middle + self.scale * z for name, z in (("network", mean), ("ANFIS", fuzzy))}


def learned(windows: list[tuple[int, int]], half: Half, period: float) -> Learned:
    """Networks and ANFIS of these windows of the drives."""
    x, y = stacked(windows, half, period)
    middle, scale = y.mean(axis=0), y.std(axis=0)
    z = (y - middle) / scale
    networks = [network(seed).fit(x, z) for seed in range(3)]
    return Learned(networks, [anfis().fit(x, target) for target in z.T], middle, scale)


def stacked(windows: list[tuple[int, int]], half: Half, period: float) -> tuple[Array, Array]:
    """Features and targets of all windows of all drives."""
    drives, sums = half
    x = np.concatenate([features(*sums, drives, each, period) for each in windows])
    return x, np.concatenate([drives.truth[:, each[1] - 1] for each in windows])


def all_estimates(models: dict[str, Learned], half: Half, blocks: int, period: float) -> dict[str, Array]:
    """Estimator -> (drives, targets) after so many blocks. Friction changes: it is that of the last 10 s."""
    drives, sums = half
    longest = "60 s" if blocks > 5 else "10 s"
    found = models[longest].estimates(features(*sums, drives, (0, blocks), period))
    recent = models["10 s"].estimates(features(*sums, drives, (blocks - 5, blocks), period))
    for name, values in found.items():
        values[:, 2] = recent[name][:, 2]
    found["filters"] = drives.filters[:, blocks - 1]
    return found


def split(half: Half, cut: slice) -> Half:
    """Some of the drives."""
    drives, sums = half
    return Drives(*(part[cut] for part in drives)), (sums[0][cut], sums[1][cut])


def corrected(fit: Half, some: Half, blocks: int, period: float) -> Array:
    """(drives, targets): the filters' estimates, and what a network adds that sees the window and the filters."""

    def seen(half: Half) -> Array:
        drives, sums = half
        return np.concatenate([features(*sums, drives, (0, blocks), period), drives.filters[:, blocks - 1]], axis=1)

    off = fit[0].truth[:, blocks - 1] - fit[0].filters[:, blocks - 1]
    scale = off.std(axis=0)
    small = [
        make_pipeline(
            StandardScaler(),
            PCA(20, random_state=0),
            StandardScaler(),
            MLPRegressor(hidden_layer_sizes=(12,), alpha=3.0, early_stopping=True, max_iter=500, random_state=seed),
        ).fit(seen(fit), np.clip(off / scale, -3.0, 3.0))
        for seed in range(5)
    ]
    added = np.mean([each.predict(seen(some)) for each in small], axis=0)
    return np.asarray(some[0].filters[:, blocks - 1] + scale * added)


def judged(given: Half, test: int, period: float) -> tuple[list[dict[str, Any]], dict[float, Any]]:
    """RMS errors on the last `test` drives, and what was estimated; the others are learned from.

    A seventh of the others tells what to trust.
    """
    count = len(given[0].command) - test
    fit, held, unseen = (split(given, cut) for cut in (slice(0, count * 6 // 7), slice(count * 6 // 7, count),
                                                       slice(count, None)))  # fmt: skip
    windows = {
        "10 s": [(i, i + 5) for i in range(0, 26, 3)],
        "60 s": [(a, b) for a in (0, 4, 8) for b in (26, 30)],
    }
    models = {name: learned(each, fit, period) for name, each in windows.items()}
    rows, estimated = [], {}
    for blocks in (5, 30):
        known, found = (all_estimates(models, half, blocks, period) for half in (held, unseen))
        before, truth = held[0].truth[:, blocks - 1], unseen[0].truth[:, blocks - 1]
        errors = {name: ((each - before) ** 2).mean(axis=0) for name, each in known.items()}
        pair = ("network", "filters")
        share = np.array([1.0 / errors[name] for name in pair])
        found["network and filters"] = sum(
            one * found[name] for one, name in zip(share / share.sum(axis=0), pair, strict=True)
        )
        found["network that corrects the filters"] = corrected(fit, unseen, blocks, period)
        found["nothing (mean of the training cars)"] = np.tile(fit[0].truth[:, blocks - 1].mean(axis=0), (test, 1))
        for name, values in found.items():
            off = values - truth
            rms, median = np.sqrt((off**2).mean(axis=0)).tolist(), np.median(np.abs(off), axis=0).tolist()
            row = {"after": blocks * BLOCK, "estimator": name, "drives": test}
            row |= dict(zip(TARGETS, rms, strict=True))
            rows.append(row | {f"{target}_median": value for target, value in zip(TARGETS, median, strict=True)})
        estimated[blocks * BLOCK] = {**found, "the truth": truth}
    return rows, estimated


def driven(numbers: Array, estimated: dict[str, Array], profile: Profile) -> dict[str, Array]:
    """Estimator -> (cars,) J of another drive of 60 s whose controller believes the estimate, and learns nothing.

    Two fifths of what is estimated of lag and dead time are dead time, for all; a failed drive counts 25 m^2. The cars
    have no steering bias, which is not estimated here.
    """
    found: dict[str, list[float]] = {name: [] for name in estimated}
    for i, number in enumerate(numbers.tolist()):
        car = random_car(number, profile=profile)
        world = car.profile.replace(steering=car.profile.steering.replace(bias=0.0))
        middle, trip = believed(at.load_vehicle(car.base)), random_drive(FIRST + 500_000 + number, SECONDS)
        computation = world.dead_time - world.steering.dead_time
        for name, values in estimated.items():
            delay, factor = max(values[i, 0] - computation, 0.03), math.exp(values[i, 1])
            stiffness = {end: factor * getattr(middle, end) for end in ("stiffness_front", "stiffness_rear")}
            belief = Steering(lag=0.6 * delay, dead_time=0.4 * delay)
            unsure = Uncertainty(lag=0.015, dead_time=0.015, stiffness=1.1)
            mpc = at.MPC(middle.replace(**stiffness), profile=profile, belief=belief, uncertainty=unsure)
            batch = Batch(at.DualTrack(car.vehicle, car.tyre), mpc, [trip], world)
            run = batch.run(np.zeros(1, np.int64), batch.tuning[None], np.array([number]), 1).summary()
            cost = run.mse[0] + world.move_weight * run.mean_squared_move[0]
            found[name].append(25.0 if run.failed[0] is not None else float(cost))
    return {name: np.array(each) for name, each in found.items()}


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as text."""
    lines = ["RMS error (median of the absolute error): delay s, log stiffness, log friction"]
    for row in rows:
        if "believed" in row:
            lines.append(
                f"believed after {row['after']:2.0f} s  {row['believed']:36s} J x{row['J']:.3f}, {row['failed']} failed"
            )
            continue
        numbers = "  ".join(f"{row[name]:.3f} ({row[name + '_median']:.3f})" for name in TARGETS)
        lines.append(f"after {row['after']:2.0f} s  {row['estimator']:36s} {numbers}")
    return "\n".join(lines)


def main() -> None:
    """Drive, learn, judge; print a row for each estimator and time."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--train", type=int, default=600)
    ask.add_argument("--test", type=int, default=200)
    ask.add_argument("--profile", default="road")
    ask.add_argument("--signals", type=Path, default=None, help="file to keep the drives in, or to read them from")
    ask.add_argument("--drive", type=int, default=0, help="cars whose J is told of a controller that believes each")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.ERROR)  # a belief that is wrong is the point here
    profile = load_profile(given.profile)
    everything = collected(given, profile)
    data = moments(everything, profile.period, math.isfinite(profile.noise_vy))
    test = round(len(everything.command) * given.test / (given.train + given.test))
    rows, estimated = judged((everything, data), test, profile.period)
    for after, each in estimated.items() if given.drive else ():
        some = {name: each[name][-given.drive :] for name in DRIVEN}
        costs = driven(everything.number[-given.drive :], some, profile)
        for name, cost in costs.items():
            ratio = float(np.exp(np.log(cost / costs["the truth"]).mean()))
            rows.append({"after": after, "believed": name, "J": ratio, "failed": int((cost >= 25.0).sum())})
    print(json.dumps(rows) if given.json else table(rows))


if __name__ == "__main__":
    main()
