"""Episodes: runs that are driven a few periods at a time, and what a learning agent observes of them.

Each slot of a batch has its own clock and restarts independently. Between two calls Python decides: it is asked before
each step of a controller (`run.Features.asks`), and writes the commands, or the tunings of an MPC. An agent observes
what the sensors give, and the road ahead.
"""

from __future__ import annotations

import math

from ..estimators.learning import BELIEF_NAMES, BELIEFS_OFFSET
from ..kernel import Place, columns, exported, float64, inlined, matrix, record, rows, vector, void
from ..maths.exact import clip
from ..models.contract import MEASUREMENT
from ..roads.road import line_of, point_at
from ..scheduling.functions import VARIABLE_COLUMNS
from .run import RunRecord, begin_slot, roll_on
from .world import ANSWERED, RUNNING, SIGNAL, value_at

OBSERVATION = columns(
    "offset",  # m, measured y less y_ref
    "heading_error", "yaw_rate", "speed", "wheel_angle",  # rad, rad/s, m/s, rad, as measured
    "command",  # rad, the last one
    "pose_age",  # s, how old offset and heading error are
)  # fmt: skip
"""Columns of an observation; then, at each distance ahead, by how much (m) the reference will have moved to the left
when the car comes there at its present speed, and the curvature (1/m) of the road there."""
MIN_APPROACH_SPEED = 1.0
"""m/s, the speed at least with which the car is taken to come to what lies ahead."""

ObservationSpace = record("ObservationSpace", (("distances", vector), ("low", vector), ("high", vector)))
"""Distances (m) of the preview; bounds of all columns, to which an observation is clipped."""

EPISODE = record(
    "Episode",
    (
        "over",  # EPISODE_RUNS, or why the episode is over
        "renewed",  # 1: `renew` begins it anew
        "cost",  # m^2, of the periods of the last call
        "total",  # m^2, of all since the beginning
    ),
    integers=("over", "renewed"),
)  # fmt: skip
"""Where each slot is in its run."""
EPISODE_RUNS, EPISODE_FAILED, EPISODE_ARRIVED = range(3)
"""Whether an episode is over: by a failure, or because the run has come to its end."""

Episodes = record(
    "Episodes",
    (
        ("run", RunRecord), ("states", rows(EPISODE)), ("space", ObservationSpace), ("observations", matrix),
        ("failure_cost", float64),
    ),
)  # fmt: skip
"""The batch; of each slot: where it is (slots,); the space of observations, and the observation of each slot
(slots, columns) within its bounds; what each instant costs that a failed run does not drive (m^2)."""


# -- observations -----------------------------------------------------------------------------------------------------
@inlined
def _keep(value, row, column):
    """Write a value unless it is missing."""
    if math.isfinite(value):
        row[column] = value


@inlined
def _clip_row(row, space):
    """Clip a row to its bounds."""
    for j in range(row.size):
        row[j] = clip(row[j], space.low[j], space.high[j])


@inlined
def _write_observation(slot, run, space, row):
    """Write the observation of a slot, from its measurements, to the row with its previous one (at first zeros)."""
    drive, scenario, period = run.memory.drives[slot], run.inputs.scenario[slot], run.settings.period
    measured = run.measured[slot]
    references, road = run.inputs.signals[scenario, SIGNAL.y_ref], run.inputs.roads.of[scenario]
    k = drive.instant
    y_ref = references[k]
    posed = math.isfinite(measured[MEASUREMENT.y]) and math.isfinite(measured[MEASUREMENT.yaw])
    row[OBSERVATION.pose_age] = measured[MEASUREMENT.pose_age] if posed else row[OBSERVATION.pose_age] + period
    _keep(measured[MEASUREMENT.y] - y_ref, row, OBSERVATION.offset)
    _keep(measured[MEASUREMENT.yaw], row, OBSERVATION.heading_error)
    _keep(measured[MEASUREMENT.yaw_rate], row, OBSERVATION.yaw_rate)
    _keep(measured[MEASUREMENT.wheel_angle], row, OBSERVATION.wheel_angle)
    _keep(drive.speed, row, OBSERVATION.speed)
    row[OBSERVATION.command] = drive.command
    count = space.distances.size
    for j in range(count):
        instant = k + space.distances[j] / (max(row[OBSERVATION.speed], MIN_APPROACH_SPEED) * period)
        row[len(OBSERVATION) + j] = value_at(instant, references) - y_ref
        curvature = 0.0
        if road >= 0:
            _, _, _, curvature = point_at(drive.station_estimate + space.distances[j], line_of(road, run.inputs.roads))
        _keep(curvature, row, len(OBSERVATION) + count + j)
    _clip_row(row, space)


@exported(void(Place(RunRecord), Place(ObservationSpace), vector))
def write_one_observation(run, space, row):
    """Write the observation of the only slot."""
    _write_observation(0, run, space, row)


# -- episodes ---------------------------------------------------------------------------------------------------------
@inlined
def _conclude(slot, episodes):
    """Add the cost of the last period; note whether the run is over."""
    episode, run = episodes.states[slot], episodes.run
    drive, periods = run.memory.drives[slot], run.inputs.periods[slot]
    episode.cost += drive.cost
    if drive.ended == RUNNING and drive.instant < periods:
        return
    episode.over = EPISODE_ARRIVED if drive.ended == RUNNING else EPISODE_FAILED
    episode.cost += (periods - drive.instant) * episodes.failure_cost


@exported(void(Place(Episodes)))
def drive_on(episodes):
    """Drive a period with the commands or tunings that the caller has written; slots whose episode is over stand."""
    slots = episodes.states.size
    for slot in range(slots):
        if episodes.states[slot].over == EPISODE_RUNS:
            episodes.run.memory.drives[slot].caller_state = ANSWERED
    roll_on(2, slots, episodes.run)  # until all have come to their next instant
    for slot in range(slots):
        if episodes.states[slot].over == EPISODE_RUNS:
            _conclude(slot, episodes)


@exported(void(Place(Episodes)))
def renew(episodes):
    """Put the slots that are marked as renewed at the first instant of their scenarios."""
    slots = episodes.states.size
    for slot in range(slots):
        episode = episodes.states[slot]
        if episode.renewed > 0:
            episode.over, episode.cost, episode.total = EPISODE_RUNS, 0.0, 0.0
            episodes.observations[slot, :] = 0.0
            begin_slot(slot, episodes.run)
    roll_on(1, slots, episodes.run)
    for slot in range(slots):
        if episodes.states[slot].renewed > 0:
            episodes.states[slot].renewed = 0
            _conclude(slot, episodes)


@exported(void(Place(Episodes)))
def write_observations(episodes):
    """Write the observation of each slot (`OBSERVATION`)."""
    for slot in range(episodes.states.size):
        _write_observation(slot, episodes.run, episodes.space, episodes.observations[slot])


@exported(void(Place(Episodes)))
def write_variables(episodes):
    """Write the scheduling variables of each slot, and behind them what its MPC has learned."""
    run = episodes.run
    for slot in range(episodes.states.size):
        row, variables = episodes.observations[slot], run.variables[slot]
        for j in range(len(VARIABLE_COLUMNS)):
            _keep(variables[j], row, j)
        _keep(-variables[VARIABLE_COLUMNS.offset], row, VARIABLE_COLUMNS.offset)  # of the car, positive to the left
        if run.controller.beliefs > 0:
            learned = run.controller.mpc.informed.learned[slot]
            for j in range(len(BELIEF_NAMES)):
                _keep(learned[BELIEFS_OFFSET + j], row, len(VARIABLE_COLUMNS) + j)
        _clip_row(row, episodes.space)
