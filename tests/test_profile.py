"""Profiles: what the shipped ones stand for, and what a profile of one's own may say."""

from __future__ import annotations

import math

import pytest

from adaptrack.base.errors import ConfigError, InvalidInput, StorageError, UnknownName
from adaptrack.cars.vehicle import SteeringActuator
from adaptrack.scenario.profile import Profile, list_profiles, load_profile

PAPER, ROAD = load_profile("paper"), load_profile("road")


def test_the_paper_profile_is_ideal_and_the_road_profile_is_not():
    assert PAPER.noise == (0.0, 0.0, 0.0, 0.0)
    assert (PAPER.delay, PAPER.preview, PAPER.move_weight, PAPER.period) == (0.0, False, 0.0, 0.1)
    assert PAPER.steering == SteeringActuator.ideal()
    assert ROAD.noise == (0.05, 0.003, 0.01, 0.03)
    assert (ROAD.delay, ROAD.preview, ROAD.move_weight, ROAD.period) == (1.0, True, 3.0, 0.05)
    assert ROAD.steering == SteeringActuator(lag=0.15, rate=0.5, limit=math.pi / 6)
    assert load_profile(ROAD) is ROAD


def test_the_steering_of_the_road_lies_within_the_published_range():
    assert 0.1 <= ROAD.steering.lag <= 0.27
    assert 0.4 <= ROAD.steering.rate <= 5.0
    assert ROAD.steering.limit == math.pi / 6


def test_every_shipped_profile_has_the_name_of_its_file_and_a_description():
    assert list_profiles() == ["paper", "production", "road"]
    for name in list_profiles():
        assert load_profile(name).name == name
        assert load_profile(name).description


def test_a_misspelt_profile_is_answered_with_the_nearest():
    with pytest.raises(UnknownName, match=r"no profile is named 'papper'. Did you mean 'paper'\?"):
        load_profile("papper")
    with pytest.raises(InvalidInput, match="not by 3"):
        load_profile(3)


@pytest.mark.parametrize(
    "field", ["noise_y", "noise_speed", "bias_yaw_rate", "pose_age", "missing", "move_weight", "delay"]
)
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf, "0", True, None])
def test_a_profile_refuses_what_is_no_standard_deviation_weight_or_delay(field, value):
    with pytest.raises(InvalidInput, match=field):
        Profile(name="own", **{field: value})


@pytest.mark.parametrize("delay", [0.5, 2])
def test_a_delay_other_than_none_or_one_period_is_refused_with_the_remedy(delay):
    with pytest.raises(InvalidInput, match=r"must be 0 .* or 1 .* what the steering adds is its dead_time"):
        Profile(name="own", delay=delay)


def test_a_file_makes_a_profile_named_after_it(tmp_path):
    path = tmp_path / "lorry.toml"
    path.write_text("delay = 1\nmove_weight = 2\n[steering]\nlag = 0.3\nrate = 0.2\n")
    lorry = load_profile(path)
    assert lorry == load_profile(str(path))
    assert (lorry.name, lorry.delay, lorry.period) == ("lorry", 1.0, 0.1)
    assert lorry.steering == SteeringActuator(lag=0.3, rate=0.2)


@pytest.mark.parametrize("name", list_profiles())
def test_a_written_profile_reads_back_equal_under_the_name_of_its_file(name, tmp_path):
    load_profile(name).to_toml(tmp_path / "copy.toml")
    assert load_profile(tmp_path / "copy.toml") == load_profile(name).replace(name="copy")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("noise_yy = 0.1", r"own.toml: noise_yy: unknown key. Did you mean 'noise_y'\?"),
        ("move_price = 3", r"own.toml: move_price: unknown key. Known: .*'move_weight'"),
        ("period = 0", r"own.toml: period = 0: must be a finite number > 0 and <= 10 \(s, "),
        ("delay = 1.5", r"own.toml: delay = 1.5: must be 0 "),
        ("[steering]\nrate = 0.5", r"own.toml: steering.rate = 0.5: a rate limit acts on the lag"),
        ("[steering]\nlagg = 0.5", r"own.toml: steering.lagg: unknown key. Did you mean 'lag'\?"),
        ("period 3", r"own.toml, line 1, column \d+: not valid TOML"),
    ],
)
def test_an_impossible_file_is_refused_with_file_key_and_remedy(tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_profile(path)


def test_a_file_that_cannot_be_read_is_a_storage_error(tmp_path):
    with pytest.raises(StorageError, match="cannot be read"):
        load_profile(tmp_path / "absent.toml")


def test_every_number_says_its_unit_and_every_field_its_meaning():
    for name, field in Profile.model_fields.items():
        assert field.description, name
        if field.annotation is float:
            unit, comma, meaning = field.description.partition(", ")
            assert unit in {"s", "-", "m/s", "m/s^2", "rad", "rad/s", "m", "m^2/rad^2"}, name
            assert comma
            assert meaning
