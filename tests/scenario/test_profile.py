"""Profiles: what the shipped ones stand for, and what a profile of one's own may say."""

from __future__ import annotations

import math

import pytest

import adaptrack as at

PAPER, ROAD = at.load_profile("paper"), at.load_profile("road")
PRODUCTION, BUS = at.load_profile("production"), at.load_profile("production-bus")


def test_the_paper_profile_is_ideal_and_the_road_profile_is_not():
    assert PAPER.noise == (0.0, 0.0, 0.0, 0.0)
    assert (PAPER.delay, PAPER.preview, PAPER.move_weight, PAPER.period) == (0.0, False, 0.0, 0.1)
    assert PAPER.steering == at.SteeringActuator.ideal()
    assert ROAD.noise == (0.05, 0.003, 0.01, 0.03)
    assert (ROAD.delay, ROAD.preview, ROAD.move_weight, ROAD.period) == (1.0, True, 3.0, 0.05)
    assert ROAD.steering == at.SteeringActuator(lag=0.15, rate=0.5, limit=math.pi / 6)
    assert at.load_profile(ROAD) is ROAD


def test_shipped_profiles_have_the_name_of_their_file_and_read_back_equal(tmp_path):
    assert at.list_profiles() == ["paper", "production", "production-bus", "road"]
    for name in at.list_profiles():
        profile = at.load_profile(name)
        assert profile.name == name
        assert profile.description
        profile.to_toml(tmp_path / "copy.toml")
        assert at.load_profile(tmp_path / "copy.toml") == profile.replace(name="copy")


def test_the_profile_of_a_bus_is_production_with_all_samples_late():
    late = {"station_age": 0.1, "motion_age": 0.1, "motion_age_spread": 0.02, "speed_age": 0.1}
    assert PRODUCTION.replace(name=BUS.name, description=BUS.description, **late) == BUS
    assert BUS.oldest == 0.1 + 0.02
    assert BUS.without_sample_ages == PRODUCTION.without_sample_ages.replace(name=BUS.name, description=BUS.description)
    assert BUS.without_sample_ages.oldest == 0.0


@pytest.mark.parametrize(("make", "error", "words"), [
    (lambda: at.load_profile("papper"), at.UnknownName, r"no profile is named 'papper'. Did you mean 'paper'\?"),
    (lambda: at.load_profile(3), at.InvalidInput, "not by 3"),
    (lambda: at.load_profile("absent.toml"), at.StorageError, "cannot be read"),
    (lambda: at.Profile(name="own", delay=0.5), at.InvalidInput, "or 1 .* give the delay of the steering as dead"),
    *(
        (lambda field=field, value=value: at.Profile(name="own", **{field: value}), at.InvalidInput, field)
        for field in (
            "noise_y", "bias_yaw_rate", "pose_age", "missing", "move_weight", "delay", "noise_station",
            "speed_resolution", "speed_dead_zone", "speed_age", "motion_age_spread",
        )
        for value in (-0.1, math.nan, True)
    ),
    (lambda: at.Profile(name="own", motion_age=0.01, motion_age_spread=0.02), at.InvalidInput,
     "not exceed motion_age = 0.01"),
    (lambda: BUS.replace(speed_age=0.01), at.InvalidInput, "speed_age = 0.01 s: must be 0, or at least motion_age_spr"),
    (lambda: BUS.replace(station_age=0.01), at.InvalidInput, "station_age = 0.01 s: must be 0, or at least pose_age_s"),
])  # fmt: skip
def test_impossible_profiles_are_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_a_file_makes_a_profile_named_after_it(tmp_path):
    path = tmp_path / "lorry.toml"
    path.write_text("delay = 1\nmove_weight = 2\n[steering]\nlag = 0.3\nrate = 0.2\n")
    lorry = at.load_profile(path)
    assert lorry == at.load_profile(str(path))
    assert (lorry.name, lorry.delay, lorry.period) == ("lorry", 1.0, 0.1)
    assert lorry.steering == at.SteeringActuator(lag=0.3, rate=0.2)


@pytest.mark.parametrize(("text", "message"), [
    ("noise_yy = 0.1", r"own.toml: noise_yy: unknown key. Did you mean 'noise_y'\?"),
    ("period = 0", r"own.toml: period = 0: must be a finite number > 0 and <= 10 \(s, "),
    ("delay = 1.5", r"own.toml: delay = 1.5: must be 0 "),
    ("[steering]\nrate = 0.5", r"own.toml: steering.rate = 0.5: a rate limit acts on the lag"),
    ("period 3", r"own.toml, line 1, column \d+: not valid TOML"),
])  # fmt: skip
def test_an_impossible_file_is_refused_with_file_key_and_remedy(tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(text)
    with pytest.raises(at.ConfigError, match=message):
        at.load_profile(path)
