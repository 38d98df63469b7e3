"""Each signal is defined once: faces of the tables agree with them."""

import inspect
import re
from pathlib import Path

import adaptrack
import adaptrack as at
from adaptrack.control.recording import LOG_COLUMNS, LOG_NAMES
from adaptrack.control.speed_control import SpeedCommand, SpeedLimit, SpeedState
from adaptrack.control.tracker import Tracked
from adaptrack.core.estimators.learning import LEARNED, QUANTITIES_BOUNDED
from adaptrack.core.kernel import fields_of
from adaptrack.core.speed.speed_control import SPEED_MEMORY, SPEED_REQUEST
from adaptrack.core.tracker.signals import STATUS, TRACKED, TRACKER_SAMPLE

OF_SCHEDULES = {"friction", "wind"}
"""A `Tracker` takes no controller with a schedule."""
ARGUMENTS = inspect.signature(at.Tracker.step).parameters.keys() - {"self"}


def test_a_step_takes_the_signals_of_the_table():
    assert set(TRACKER_SAMPLE._fields) == ARGUMENTS | OF_SCHEDULES


def test_the_bound_of_a_belief_is_described_by_the_bounded_quantities():
    words = [f"{i + 1} {name.replace('_', ' ')}" for i, name in enumerate(QUANTITIES_BOUNDED)]
    assert ", ".join(words) in TRACKED.field_settings["belief_at_bound"].meaning


def test_a_step_answers_the_signals_of_the_table_and_its_statuses():
    assert Tracked._fields[:5] == TRACKED._fields[:5]
    assert tuple(status.replace("-", "_") for status in at.Status) == STATUS._fields[:-1]


def test_a_request_is_that_of_the_table_and_begins_the_memory():
    names = ["speed_state" if name == "state" else name for name in SpeedCommand._fields]
    assert tuple(names[: len(SPEED_REQUEST)]) == SPEED_REQUEST._fields
    assert SPEED_MEMORY._fields[: SPEED_REQUEST.friction_low] == SPEED_REQUEST._fields[: SPEED_REQUEST.friction_low]


def test_whole_numbers_of_a_request_are_described_one_by_one():
    for name, members in (("speed_state", SpeedState), ("limited_by", SpeedLimit)):
        words = [f"{i} {member}" for i, member in enumerate(members)]
        assert SPEED_REQUEST.field_settings[name].meaning == ", ".join(words)


def test_the_page_on_the_tracker_lists_every_signal_with_its_unit():
    page = Path(adaptrack.__file__).parents[2] / "docs" / "tracker.md"
    rows = re.findall(r"^\| (`.*?) \| (.*?) ?\| ", page.read_text(encoding="utf-8"), re.MULTILINE)
    units = {name: unit for names, unit in rows for name in re.findall(r"`(\w+)`", names)}
    for field in fields_of(TRACKER_SAMPLE):
        assert field.name in OF_SCHEDULES or units[field.name] == field.unit, field.name


def test_a_log_has_the_signals_of_a_sample_but_those_of_schedules_and_of_the_speed_control():
    logged = {LOG_NAMES.get(name, name) for name in ARGUMENTS} & set(LOG_COLUMNS)
    assert logged == {"x", "y", "yaw", "speed", "yaw_rate", "vy", "acceleration", "wheel"}


def test_a_learned_car_holds_learned_quantities_with_their_units():
    for field in fields_of(LEARNED):
        if field.bounds:
            described = at.LearnedCar.model_fields[field.name].description
            assert described.startswith(f"{field.unit or '-'}, ")
            assert f"{field.name}_sigma" in at.LearnedCar.model_fields
