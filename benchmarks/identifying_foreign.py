"""Whether the intervals of `identify` are true on logs made by a plant that is not the model of the fit.

    python benchmarks/identifying_foreign.py [--logs 300] [--seed 50000] [--as-believed] [--flags] [--rows FILE]
    python benchmarks/identifying_foreign.py --factors FILE [--rows FILE]

The plant has four wheels with load transfer, tyres of a brush or a curved Magic Formula with relaxation, stiffness that
grows less than the load, a gust of one of three spectra (smooth of second order, Ornstein-Uhlenbeck, bursts of
1 - cos) with one of three ratios of turning moment to side force (0, 1, 2.5 times the believed one), bank to 6 %,
in half of the logs partly with the bends, white yaw acceleration. A driver who looks ahead steers it for 120 s along
bends and lane changes. Angles and yaw rate are quantised; the inertial unit is late by 0 to 0.3 s against a wheel
angle, and in half of the logs with a command alone. A log holds a command, a wheel angle, or both; lateral velocity
(at a place of its own, turned a little) and acceleration in some.

`--as-believed` gives the same logs a gust as the model believes it (smooth, ratio 1) and no bank: for the widths.
`--flags` asks `identify` whether a log is consistent. `--factors` reads rows of training logs and
prints how often intervals hold in each spectrum, ratio, tyre, set of signals by factors found on the others.

Judged: seeds from 50000; `calibration.CORRECTIONS` was found on seeds from 40000, the method on seeds from 45000.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numba
import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.identification import RandomCar, calibration, random_car
from adaptrack.identification.from_log import fitted, prepare, reported

SPECTRA, LEVERS, TYRES, SIGNALS = (
    ("smooth", "ou", "bursts"),
    (0.0, 1.0, 2.5),
    ("brush", "magic"),
    ("command", "both", "wheel"),
)
DURATION, STEP, GRAVITY = 120.0, 0.005, 9.80665
NEAR_DELAY, HALF, NORMAL_90 = 0.03, 0.5, 1.6448536269514722
"""s; share of the spread before; half width of 90 %."""
WITHOUT = {
    name: calibration.Correction(1.0, *each[1:]) for name, each in getattr(calibration, "CORRECTIONS", {}).items()
}
"""Corrections without their factors."""
GROUPS = ("spectrum", "lever", "tyre", "signals")


# -- the plant --------------------------------------------------------------------------------------------------------
@numba.njit
def _tyre(law: int, slip: float, load: float, stiffness: float, friction: float) -> float:
    peak = friction * load
    if law == 0:  # brush: Pacejka, Tire and Vehicle Dynamics, 3rd ed., eq. 3.11
        theta = min(stiffness * abs(slip) / (3.0 * peak), 1.0)
        return math.copysign(peak * (3.0 * theta - 3.0 * theta**2 + theta**3), slip)
    shape, curvature = 1.5, -0.8
    b = stiffness / (shape * peak) * slip
    return peak * math.sin(shape * math.atan(b - curvature * (b - math.atan(b))))


class Undriven(Exception):
    """A drive that left the road or slid: it gives no log."""


@numba.njit
def _slope(x, d, law, p, v, push, load_side, load_turn, target, curvature):
    """Of v_y, yaw rate, four slips, felt a_y, wheel angle, yaw, lateral error, heading error."""
    mass, inertia, lf, lr, front, rear, relaxation, friction, height, track, share, lag, rate = p
    wheelbase = lf + lr
    transfer = mass * x[6] * height / track
    force_front = force_rear = 0.0
    for wheel in range(4):
        ahead, side = (lf if wheel < 2 else -lr), (0.5 * track if wheel % 2 == 0 else -0.5 * track)
        angle = x[7] if wheel < 2 else 0.0
        slip = angle - math.atan2(x[0] + ahead * x[1], max(v - side * x[1], 1.0))
        d[2 + wheel] = v / relaxation * (slip - x[2 + wheel])
        static = 0.5 * mass * GRAVITY * (lr if wheel < 2 else lf) / wheelbase
        moved = transfer * (share if wheel < 2 else 1.0 - share)
        load = max(static - math.copysign(1.0, side) * moved, 50.0)
        stiffness = (front if wheel < 2 else rear) * (load / static) ** 0.75
        force = _tyre(law, x[2 + wheel], load, stiffness, friction)
        if wheel < 2:
            force_front += force * math.cos(x[7])
        else:
            force_rear += force
    felt = (force_front + force_rear + load_side) / mass
    d[0] = felt + push - v * x[1]
    d[1] = (lf * force_front - lr * force_rear + load_turn) / inertia
    d[6] = (felt - x[6]) / 0.12
    d[7] = min(max((target - x[7]) / lag, -rate), rate)
    d[8] = x[1]
    d[9] = x[0] + v * x[10]
    d[10] = x[1] - v * curvature
    return felt


@numba.njit
def _driven(law, p, speed, curvature, aside, wind, bank, jolt, air, dead, bias, every, ahead, gradient, delay, turn):
    """(n, 13): the state, the acceleration felt at the centre of mass and the command, at every step."""
    side, moment, limit = air
    steps = speed.size
    out, x, command = np.zeros((steps, 13)), np.zeros(11), 0.0
    d = np.zeros((4, 11))
    wheelbase, late = p[2] + p[3], round(dead / STEP)
    for k in range(steps):
        v = speed[k]
        if k % every == 0:
            reach = v * ahead
            there = min(k + int(ahead * 0.5 / STEP), steps - 1)
            seen = x[9] - aside[there] + reach * x[10]
            foreseen = curvature[min(k + int(delay / STEP), steps - 1)]
            command = (wheelbase + gradient * v * v) * (foreseen - 2.0 * seen / reach**2)
            command = round(command / turn) * turn
        out[k, 12] = command
        delayed = out[max(k - late, 0), 12] + bias
        w = wind[k]
        angle = math.atan2(w - x[0], v)
        angle = min(max(angle, -limit), limit)
        pressure = v * v + w * w
        push = GRAVITY * bank[k]
        felt = _slope(
            x, d[0], law, p, v, push, side * pressure * angle, moment * pressure * angle, delayed, curvature[k]
        )
        out[k, :11], out[k, 11] = x, felt
        for i, h in ((1, 0.5), (2, 0.5), (3, 1.0)):
            _slope(x + h * STEP * d[i - 1], d[i], law, p, v, push, side * pressure * angle, moment * pressure * angle,
                   delayed, curvature[k])  # fmt: skip
        x = x + STEP / 6.0 * (d[0] + 2.0 * d[1] + 2.0 * d[2] + d[3])
        x[1] += jolt[k]
    return out


# -- what acts on it --------------------------------------------------------------------------------------------------
def _ornstein_uhlenbeck(rng: np.random.Generator, n: int, tau: float) -> np.ndarray:
    """Of variance 1."""
    from scipy.signal import lfilter

    kept = math.exp(-STEP / tau)
    return lfilter(
        [math.sqrt(1.0 - kept**2)], [1.0, -kept], np.append(rng.standard_normal(), rng.standard_normal(n - 1))
    )


def gust(rng: np.random.Generator, spectrum: str, n: int) -> np.ndarray:
    """(n,) of standard deviation about 1."""
    from scipy.signal import lfilter

    tau = rng.uniform(0.3, 1.5)
    if spectrum == "ou":
        return _ornstein_uhlenbeck(rng, n, tau)
    if spectrum == "smooth":
        kept = math.exp(-STEP / tau)
        return math.sqrt(2.0) * lfilter([1.0 - kept], [1.0, -kept], _ornstein_uhlenbeck(rng, n, tau))
    wind, at_time, t = np.zeros(n), 0.0, STEP * np.arange(n)
    while at_time < DURATION:
        length = rng.uniform(0.5, 3.0)
        inside = (t >= at_time) & (t < at_time + length)
        wind[inside] += rng.normal(0.0, 2.0) * 0.5 * (1.0 - np.cos(math.tau * (t[inside] - at_time) / length))
        at_time += rng.exponential(2.0)
    return wind


def _smooth_noise(rng: np.random.Generator, n: int, tau: float) -> np.ndarray:
    """Slow, of standard deviation 1."""
    from scipy.ndimage import gaussian_filter1d

    values = gaussian_filter1d(rng.standard_normal(n + 8 * int(tau / STEP)), tau / STEP)[4 * int(tau / STEP) :][:n]
    return values / values.std()


def _bend(rng: np.random.Generator, n: int, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (1/m) of at most 2.5 m/s^2, and lane changes (m)."""
    from scipy.ndimage import gaussian_filter1d

    curvature = 0.012 * rng.uniform(0.4, 1.0) * _smooth_noise(rng, n, rng.uniform(1.0, 2.5))
    curvature = np.clip(curvature, -2.5 / speed**2, 2.5 / speed**2)
    lane, at_time = np.zeros(n), rng.uniform(2.0, 8.0)
    while at_time < DURATION:
        lane[int(at_time / STEP) :] = rng.choice([-3.5, 0.0, 3.5])
        at_time += rng.uniform(5.0, 12.0)
    return gaussian_filter1d(curvature, 0.4 / STEP), gaussian_filter1d(lane, rng.uniform(0.8, 1.6) / STEP)


def foreign_log(seed: int, as_believed: bool) -> tuple[RandomCar, dict[str, Any], dict[str, float], dict[str, Any]]:
    """A car, its log, the truth by the names of the estimates, and of what kind the log is."""
    car, rng, place = random_car(seed), np.random.default_rng((0xF0E1, seed)), 7 * seed  # all kinds in 54 seeds
    kind: dict[str, Any] = {
        "spectrum": SPECTRA[place % 3], "lever": LEVERS[place // 3 % 3], "tyre": TYRES[place // 9 % 2],
        "signals": SIGNALS[place // 18 % 3], "vy": bool(rng.random() < 0.35), "acceleration": bool(rng.random() < 0.35),
    }  # fmt: skip
    true, steering, n = car.vehicle, car.profile.steering, round(DURATION / STEP)
    speed = 18.0 + rng.uniform(-7.0, 7.0) + rng.uniform(1.0, 4.0) * _smooth_noise(rng, n, 6.0)
    speed = np.clip(speed, 5.0, 33.0)
    curvature, aside = _bend(rng, n, speed)
    lift = rng.uniform(0.0, 0.15) * (rng.random() < 0.5)
    bank = np.clip(
        rng.uniform(0.0, 0.03) * _smooth_noise(rng, n, 3.0) + lift * speed**2 * curvature / GRAVITY, -0.06, 0.06
    )
    strength, mean = rng.uniform(0.5, 6.0), rng.uniform(-4.0, 4.0)
    blow = gust(np.random.default_rng((seed, 7)), "smooth" if as_believed else kind["spectrum"], n)
    wind = np.clip(mean + strength * blow, -30.0, 30.0)
    jolt = 0.01 * rng.uniform(0.0, 2.0) * math.sqrt(STEP) * rng.standard_normal(n)
    dense = 0.5 * true.air_density * true.frontal_area
    lever = 1.0 if as_believed else kind["lever"]
    air = (dense * true.side_force_slope, dense * true.yaw_moment_slope * true.wheelbase * lever, true.wind_angle_limit)
    inertia = true.mass * true.lf * true.lr * math.exp(0.08 * rng.standard_normal())
    relaxation, friction = rng.uniform(0.15, 0.7), rng.uniform(0.6, 1.0)
    p = (true.mass, inertia, true.lf, true.lr, true.stiffness_front, true.stiffness_rear, relaxation, friction,
         0.3 * true.lf + 0.2, 1.5, rng.uniform(0.45, 0.65), steering.lag, rng.uniform(0.4, 0.9))  # fmt: skip
    delay = car.delay
    rate = 20.0 if rng.random() < 0.9 else 50.0
    every = round(1.0 / (rate * STEP))
    turn = math.radians(10 ** rng.uniform(-1.7, -0.8))  # rad, step of angles: 0.02 to 0.16 deg
    out = _driven(
        TYRES.index(kind["tyre"]), p, speed, curvature, aside, wind, 0.0 * bank if as_believed else bank, jolt, air,
        car.profile.dead_time, steering.bias, every, 0.9 + 1.5 * delay, max(true.understeer_gradient, 0.0), delay, turn,
    )  # fmt: skip
    if not np.isfinite(out).all() or np.abs(out[:, 9]).max() > 25.0 or np.abs(out[:, 0] / speed).max() > 0.25:
        raise Undriven("the drive failed")
    late = rng.uniform(0.0, 0.3) * (kind["signals"] != "command" or rng.random() < 0.5)
    return car, *_sensed(rng, car, kind, out, speed, late, turn, every, inertia, relaxation)


def _sensed(
    rng: np.random.Generator, car: RandomCar, kind: dict[str, Any], out: np.ndarray, speed: np.ndarray, late: float,
    turn: float, every: int, inertia: float, relaxation: float,
) -> tuple[dict[str, Any], dict[str, float], dict[str, Any]]:  # fmt: skip
    """What sensors give of a drive, and the truth."""
    rows = np.arange(round(1.0 / STEP), speed.size, every)
    t, noise = STEP * rows, car.profile
    before = STEP * np.arange(speed.size)

    def at_unit(values: np.ndarray) -> np.ndarray:
        return np.interp(t - late, before, values)

    def rounded(values: np.ndarray, step: float) -> np.ndarray:
        return np.round(values / step) * step

    def noisy(values: np.ndarray, spread: float) -> np.ndarray:
        return values + spread * rng.standard_normal(values.size)

    offset, place, turned = rng.uniform(-0.003, 0.003), rng.uniform(-1.5, 1.5), rng.uniform(-0.01, 0.01)
    log: dict[str, Any] = {"time": t, "speed": noisy(speed[rows], 0.05)}
    yaw_rate = noisy(at_unit(out[:, 1]), noise.noise_yaw_rate) + offset
    log["yaw_rate"] = rounded(yaw_rate, math.radians(10 ** rng.uniform(-1.7, -0.6)))
    if kind["signals"] != "wheel":
        log["command"] = out[rows, 12]
    wheel_offset = rng.uniform(-0.01, 0.01)
    if kind["signals"] != "command":
        log["wheel"] = rounded(noisy(out[rows, 7], 0.0005) + wheel_offset, turn)
    if kind["vy"]:
        log["vy"] = noisy(at_unit(out[:, 0] + place * out[:, 1] + turned * speed), noise.noise_vy)
    if kind["acceleration"]:
        log["acceleration"] = noisy(at_unit(out[:, 11]), 0.1 * car.noise) + rng.uniform(-0.1, 0.1)
    true, steering, dead = car.vehicle, noise.steering, STEP * round(noise.dead_time / STEP)
    truth = {
        "understeer_gradient": true.understeer_gradient, "front": 2.0 * true.stiffness_front,
        "rear": 2.0 * true.stiffness_rear, "gyro_offset": offset, "relaxation": relaxation,
    }  # fmt: skip
    if kind["signals"] == "wheel":
        truth |= {"offset": -wheel_offset, "lateness": late}
    else:
        seen = late if kind["signals"] == "command" else 0.0
        truth |= {"delay": dead + steering.lag + seen, "lag": steering.lag, "dead_time": dead + seen,
                  "offset": steering.bias}  # fmt: skip
    if kind["signals"] == "both":
        truth["lateness"] = late
    if kind["vy"]:
        truth["vy_ahead"] = place
    return log, truth, kind | {"late": late}


# -- the judge --------------------------------------------------------------------------------------------------------
def told(car: RandomCar) -> at.Vehicle:
    """What `identify` is told: mass and geometry, the stiffness of the shipped car, I_z = m l_f l_r."""
    shipped, true = at.load_vehicle(car.base), car.vehicle
    return shipped.replace(mass=true.mass, yaw_inertia=true.mass * true.lf * true.lr, steering=None)


def judge(seed: int, as_believed: bool, flags: bool) -> dict[str, Any]:
    """Estimates beside the truth, of one log."""
    try:
        car, log, truth, kind = foreign_log(seed, as_believed)
    except Undriven as error:
        return {"seed": seed, "undriven": str(error)}
    begun = time.process_time()
    try:
        likelihood = prepare(log, told(car))
        fit = fitted(likelihood)
    except InvalidInput as error:
        return {"seed": seed, "refused": str(error)} | kind
    row: dict[str, Any] = {"seed": seed, "time": time.process_time() - begun} | kind
    estimates = reported(likelihood, *fit)
    with_factors, calibration.CORRECTIONS = calibration.CORRECTIONS, WITHOUT
    plain = reported(likelihood, *fit)
    calibration.CORRECTIONS = with_factors
    if flags:
        row["consistent"] = getattr(at.identify(log, told(car)), "consistent", None)
    row["estimates"] = {
        name: {
            "true": truth[name], "value": each.value, "low": each.low, "high": each.high, "left": each.spread_left,
            "plain": (plain[name].low, plain[name].high),
            "positive": bool(each.low > 0.0 and abs(each.low * each.high - each.value**2) < 1e-6 * each.value**2),
        }
        for name, each in estimates.items()
        if name in truth
    }  # fmt: skip
    return row


def _standing(each: dict[str, Any]) -> tuple[float, float]:
    """Error and standard error without a factor, in the scale of the interval."""
    value, (low, high), true = each["value"], each["plain"], each["true"]
    if each["positive"]:
        return math.log(value / max(true, 1e-3)), math.log(high / low) / (2.0 * NORMAL_90)
    return value - true, (high - low) / (2.0 * NORMAL_90)


def _each(rows: Iterable[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Of every quantity, the estimates of which the data left less than half of the prior's spread."""
    found: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        for name, each in row["estimates"].items():
            if each["left"] < HALF:
                found.setdefault(name, []).append(each)
    return found


def _share(each: Iterable[bool]) -> float:
    all_of = list(each)
    return sum(all_of) / len(all_of) if all_of else math.nan


def coverage(rows: list[dict[str, Any]]) -> dict[str, float]:
    """By quantity."""
    return {
        name: float(np.mean([e["low"] <= e["true"] <= e["high"] for e in told])) for name, told in _each(rows).items()
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What is judged."""
    made = [row for row in rows if "undriven" not in row]
    refused = [row["seed"] for row in made if "refused" in row]
    rows = [row for row in made if "refused" not in row]
    sharp = [row["estimates"]["delay"] for row in rows if "delay" in row["estimates"]]
    narrow = [e for e in sharp if 0.5 * (e["high"] - e["low"]) <= NEAR_DELAY]
    asked = [row["consistent"] for row in rows if row.get("consistent") is not None]
    told = _each(rows)
    return {
        "logs": len(rows), "refused": refused, "time": float(np.median([row["time"] for row in rows])),
        "narrow": len(narrow) / max(len(sharp), 1),
        "near": _share(abs(e["value"] - e["true"]) <= NEAR_DELAY for e in narrow),
        "near_all": _share(abs(e["value"] - e["true"]) <= NEAR_DELAY for e in sharp),
        "flagged": float(np.mean([not each for each in asked])) if asked else None,
        "count": {name: len(each) for name, each in told.items()},
        "coverage": coverage(rows),
        "width": {name: float(np.median([e["high"] - e["low"] for e in each])) for name, each in told.items()},
        "error": {name: float(np.median([abs(e["value"] - e["true"]) for e in each])) for name, each in told.items()},
        "factor": {
            name: float(np.quantile([abs(d) / max(s, 1e-12) for d, s in map(_standing, each)], 0.9) / NORMAL_90)
            for name, each in told.items()
        },
    }  # fmt: skip


def left_out(rows: list[dict[str, Any]], train: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Coverage in each group, by factors found on the other groups of training rows."""
    found = {}
    for group in GROUPS:
        for which in sorted({str(row[group]) for row in rows if group in row}):
            others = [row for row in train if "estimates" in row and str(row[group]) != which]
            factors = summary(others)["factor"]
            inside: dict[str, list[bool]] = {}
            for name, each in _each(r for r in rows if "estimates" in r and str(r[group]) == which).items():
                inside[name] = [
                    abs(d) <= NORMAL_90 * max(factors.get(name, 1.0), 1.0) * s for d, s in map(_standing, each)
                ]
            found[f"{group} {which}"] = {name: float(np.mean(each)) for name, each in inside.items()}
    return found


def kept_rows(path: Path | None) -> list[dict[str, Any]]:
    """The rows that a file holds; none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path is not None and path.exists() else []


def _print(found: dict[str, Any]) -> None:
    print(f"{found['logs']} logs; refused: {found['refused'] or 'none'}; {found['time']:.2f} s a log (median)")
    near, narrow = (f"{found[key]:.3f}" for key in ("near", "narrow"))
    print(f"delay within {NEAR_DELAY} s: {found['near_all']:.3f}; of narrower intervals ({narrow} of all): {near}")
    if found["flagged"] is not None:
        print(f"not consistent: {found['flagged']:.3f}")
    for name, each in found["coverage"].items():
        count, factor, error, width = (found[key][name] for key in ("count", "factor", "error", "width"))
        print(
            f"{name:20s} told {count:4d}  interval holds {each:.3f}  factor {factor:.2f}  median error {error:.3g}  "
            f"width {width:.3g}"
        )
    print(f"mean over quantities {np.mean(list(found['coverage'].values())):.3f}")


def main() -> None:
    """Print the shares over all logs."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--logs", type=int, default=300)
    ask.add_argument("--seed", type=int, default=50000)
    ask.add_argument("--as-believed", action="store_true")
    ask.add_argument("--flags", action="store_true")
    ask.add_argument("--factors", type=Path, help="rows of training logs, for the groups left out")
    ask.add_argument("--rows", type=Path, help="file of JSON lines that rows are kept in")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    wanted = range(given.seed, given.seed + given.logs)
    rows = [row for row in kept_rows(given.rows) if row["seed"] in wanted]
    for seed in sorted(set(wanted) - {row["seed"] for row in rows}):
        rows.append(judge(seed, given.as_believed, given.flags))
        if given.rows is not None:
            with given.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    found = summary(rows)
    if given.factors is not None:
        found["left_out"] = left_out(rows, kept_rows(given.factors))
    if given.json:
        print(json.dumps(found))
        return
    _print(found)
    for which, each in found.get("left_out", {}).items():
        print(f"left out {which:16s} " + "  ".join(f"{name} {share:.2f}" for name, share in each.items()))


if __name__ == "__main__":
    main()
