"""Certificates: what is stable passes, what is not is caught and named, with the guard and without."""

import json
from dataclasses import replace

import numpy as np
import pytest

import adaptrack as at
from adaptrack import MPC, ContractError, DualTrack, InvalidInput, Tuning, load_vehicle, published_mpc, rollout_batch
from adaptrack.analysis.certify import OPERATING, certify
from adaptrack.analysis.linearisation import Mismatch, laws, usual_mismatches
from adaptrack.analysis.stability import hard_turn, loop_map, loops
from adaptrack.control.scheduling import StabilityMap, Table
from adaptrack.core.maths.portable import spectral_radius
from adaptrack.results import style, write_result
from adaptrack.results.certificate import certificate_result
from linear_loops import loop_radius
from pictures import pictures

CAR = load_vehicle("paper")
PLANT = DualTrack(CAR, "magic-formula")
PUBLISHED = published_mpc(CAR, period=0.05, preview=True)
SOUND, AGGRESSIVE = Tuning(38, 4, 1.0, 8000.0), Tuning(28, 8, 1.0, 2800.0)
SPEEDS, FRICTIONS, AHEAD = np.linspace(3.0, 30.0, 6), np.array([0.3, 0.6, 1.0]), np.array([0.0, 3.5])
FEW = (6, 2)
"""Levels of speed and friction, for tests."""


def by_speed(ratio):
    """A table over speed, friction and acceleration ahead, with R/Q from log10 values of that shape."""
    tunings = np.empty((*ratio.shape, 4))
    tunings[..., 0], tunings[..., 1], tunings[..., 2], tunings[..., 3] = 38.0, 4.0, 1.0, 10.0**ratio
    return at.Lookup({"speed": SPEEDS, "friction": FRICTIONS, "acceleration": AHEAD}, tunings, name="table")


@pytest.fixture(scope="module")
def sound():
    return by_speed(np.broadcast_to(np.linspace(3.8, 4.1, 6)[:, None, None], (6, 3, 2)))


@pytest.fixture(scope="module")
def scrambled():
    """The table with other numbers in it."""
    return by_speed(np.random.default_rng(0).uniform(1.0, 4.2, (6, 3, 2)))


@pytest.fixture(scope="module")
def guarded(scrambled, stability):
    """The certificate of scrambled numbers with the guard."""
    return certify(at.Guarded(scrambled, SOUND, stability=stability), PLANT, PUBLISHED, "road", levels=FEW)


@pytest.fixture(scope="module")
def stability():
    nodes = ((10, 26, 38, 60), (1, 4, 20), (1.0, 2.0, 3.0, 3.5, 3.8, 4.0, 4.2, 5.0, 6.0))
    axes, values = loop_map(PLANT, PUBLISHED, "road", speed=(3.0, 30.0), nodes=nodes)
    return StabilityMap(Table(axes, values), 0.92)


def test_a_sound_scheduler_passes_with_margins_everywhere(sound):
    certificate = certify(sound, PLANT, PUBLISHED, "road", levels=FEW)
    worst = certificate.counted.straight.worst(certificate.counted.turn)
    assert certificate.passed
    assert certificate.guarded is None
    assert worst.radius.max() < 1.0
    assert worst.gain_up.min() > 1.2
    assert worst.gain_down.max() < 0.9
    assert worst.delay.min() > 0.02
    assert len(certificate.points) == 6 * 2 * 5  # acceleration ahead is the one other input


def test_an_unstable_constant_is_caught_and_the_place_is_named():
    certificate = certify(at.Constant(AGGRESSIVE), PLANT, PUBLISHED, "road", levels=FEW)
    assert not certificate.passed
    summary = certificate.summary()
    assert summary["unstable"] == certificate.counted.unstable.sum() > 0
    assert summary["unstable_in_turn"] == certificate.counted.unstable_in_turn.sum() > summary["unstable"]
    worst = certificate.worst_points(1, driving="turn")[0]
    assert (worst["speed"], worst["driving"]) == (30.0, "turn")
    for driving, turn in (("straight", 0.0), ("turn", hard_turn(30.0, worst["friction"]))):
        worst = certificate.worst_points(1, driving=driving)[0]
        assert worst["driving"] == driving
        assert (worst["Np"], worst["Nc"], worst["R"]) == (28.0, 8.0, 2800.0)
        assert worst["radius"] == pytest.approx(
            loop_radius(
                PLANT, PUBLISHED, worst["speed"], tuning=AGGRESSIVE, friction=worst["friction"], profile="road",
                lateral_acceleration=turn,
            )
        )  # fmt: skip
        assert summary[driving]["worst"] == worst
        assert summary[driving]["radius"] == getattr(certificate.counted, driving).radius.max()


def test_a_loop_that_is_unstable_in_a_turn_only_passes_and_the_count_is_in_the_verdict():
    certificate = certify(at.Constant(AGGRESSIVE), PLANT, PUBLISHED, "road", levels=FEW, domain={"speed": (10.0, 24.0)})
    turn = int(certificate.counted.unstable_in_turn.sum())
    assert certificate.passed
    assert turn > 0
    assert f"stable at all {len(certificate.points)} points" in certificate.verdict
    assert f"unstable at {turn} of them in a hard turn" in certificate.verdict
    summary = certificate.summary()
    assert summary["verdict"] == certificate.verdict
    assert summary["straight"]["radius"] < 1.0 < summary["turn"]["radius"]
    rows = certificate.rows()
    assert sum(row["unstable"] for row in rows if row["driving"] == "straight") == 0
    assert sum(row["unstable"] for row in rows if row["driving"] == "turn") == turn


@pytest.mark.compiled
def test_with_the_guard_scrambled_numbers_fail_in_no_drive(scrambled, stability):
    drives = [at.random_drive(seed) for seed in range(900, 908)]
    failed = {}
    for schedule in (scrambled, at.Guarded(scrambled, SOUND, stability=stability)):
        mpc = published_mpc(CAR, period=0.05, preview=True, scheduler=schedule)
        runs = rollout_batch(PLANT, mpc, drives, profile="road", seeds=np.arange(8))
        failed[schedule.name] = sum(failure is not None for failure in runs.failed)
    assert failed["table"] > 4
    assert failed["table (guarded)"] == 0


def test_the_guard_leaves_a_sound_scheduler_alone(sound, stability):
    certificate = certify(at.Guarded(sound, SOUND, stability=stability), PLANT, PUBLISHED, "road", levels=FEW)
    assert certificate.passed
    assert certificate.fallback.mean() < 0.05


# -- any scheduler, any domain ----------------------------------------------------------------------------------------
def test_a_plain_function_is_asked_over_all_scheduling_variables():
    calls = []

    def careful(variables):
        calls.append(variables)
        return 38.0, 4.0, 1.0, 8000.0

    certificate = certify(careful, PLANT, PUBLISHED, "road", levels=FEW)
    scheduled = np.array(calls)
    for i, name in enumerate(at.SchedulingVariables._fields):
        assert (scheduled[:, i].min(), scheduled[:, i].max()) == OPERATING[name]
    assert certificate.scheduler == "careful"
    assert certificate.passed


@pytest.mark.parametrize("nonsense", [(30, 5, 1.0, 0.0), (30, 5, -1.0, 1.0), (30, np.nan, 1.0, 1.0), (30, 5), None])
def test_a_function_that_gives_no_tuning_is_refused_with_the_point(nonsense):
    with pytest.raises(ContractError, match=r"SchedulingVariables\(speed=3\.0"):
        certify(lambda variables: nonsense, PLANT, PUBLISHED, "road", levels=FEW)


def test_the_domain_is_where_scheduler_and_driving_overlap_unless_told(sound):
    narrow = at.Lookup({"speed": [8.0, 60.0]}, [[38, 4, 1.0, 8000.0], [38, 4, 1.0, 9000.0]])
    certificate = certify(narrow, PLANT, PUBLISHED, "road", levels=FEW)
    assert (certificate.speeds[0], certificate.speeds[-1]) == (8.0, 30.0)
    assert (certificate.frictions[0], certificate.frictions[-1]) == OPERATING["friction"]
    bounded = certify(
        sound, PLANT, PUBLISHED, "road", levels=FEW, domain={"speed": (10.0, 12.0), "friction": (0.5, 0.5)}
    )
    assert (bounded.speeds[0], bounded.speeds[-1], *bounded.frictions) == (10.0, 12.0, 0.5)


@pytest.mark.parametrize("domain", [
    {"colour": (0.0, 1.0)},
    {"speed": (9.0, 5.0)},
    {"friction": (0.0, 1.0)},
    {"speed": (1.0, np.inf)},
    {"speed": (5.0, 1e9)},
])  # fmt: skip
def test_a_domain_that_makes_no_sense_is_refused(sound, domain):
    with pytest.raises(InvalidInput, match="certify"):
        certify(sound, PLANT, PUBLISHED, "road", levels=FEW, domain=domain)


# -- the controller that knows its car --------------------------------------------------------------------------------
INFORMED = MPC(CAR, profile="road")


def test_the_informed_constant_is_stable_everywhere_and_its_margins_are_those_of_its_loop():
    certificate = certify(INFORMED.tuning, PLANT, INFORMED, "road", levels=FEW)
    assert certificate.passed
    assert (certificate.model, certificate.estimator) == ("path", "kalman")
    assert "model path, estimator kalman" in certificate.verdict
    i = int(np.argmax(certificate.counted.straight.radius))
    speed, friction = certificate.points[i, 0], certificate.points[i, at.SchedulingVariables._fields.index("friction")]
    expected = loop_radius(PLANT, INFORMED, speed, friction=friction, profile="road")
    assert certificate.counted.straight.radius[i] == pytest.approx(expected)


def test_another_car_than_told_is_analysed_beside_and_named():
    mismatches = (Mismatch(lag=0.1), Mismatch(dead_time=-0.05))
    certificate = certify(INFORMED.tuning, PLANT, INFORMED, "road", levels=(4, 2), mismatches=mismatches)
    late, prompt = (certificate.mismatched[mismatch.name] for mismatch in mismatches)
    assert certificate.passed
    assert (late.radius > 1.0).any()
    assert (prompt.radius < 1.0).all()
    assert f"Unstable with lag +0.1 s: {(late.radius >= 1.0).sum()}." in certificate.verdict
    law = laws(INFORMED, 30.0, INFORMED.tuning.as_array())
    body = mismatches[0].sampled(PLANT, 0.05, 30.0, friction=1.0, profile="road")
    assert late.radius[-1] == pytest.approx(spectral_radius(loops(body, law))[0])
    rows = json.loads(json.dumps(certificate.summary(), allow_nan=False))["mismatched"]
    assert [row["mismatch"] for row in rows] == ["lag +0.1 s", "dead time -0.05 s"]
    assert rows[0]["unstable"] == (late.radius >= 1.0).sum()


def test_a_cautious_tuning_bears_every_usual_mismatch():
    """Moves at every step are weighed as the errors are: R/Q of 3 bears few of them, one move over 3 s all."""
    cautious = Tuning(60, 1, 1.0, 100.0)
    certificate = certify(cautious, PLANT, INFORMED, "road", levels=(4, 2), mismatches=usual_mismatches(0.05))
    assert len(certificate.mismatched) == 8
    assert min(stability.modulus_margin.min() for stability in certificate.mismatched.values()) > 0.2
    assert certificate.verdict.endswith("Of 8 mismatches none makes it unstable.")


# -- what is told -----------------------------------------------------------------------------------------------------
def test_rows_hold_the_worst_of_every_speed_and_friction_as_json(guarded):
    rows = json.loads(json.dumps({"summary": guarded.summary(), "rows": guarded.rows()}, allow_nan=False))["rows"]
    assert len(rows) == 2 * 2 * 6 * 2
    for driving, unstable in (("straight", guarded.bare.unstable), ("turn", guarded.bare.unstable_in_turn)):
        bare = [row for row in rows if not row["guard"] and row["driving"] == driving]
        assert sum(row["unstable"] for row in bare) == unstable.sum()
        assert max(row["radius"] for row in bare) == pytest.approx(getattr(guarded.bare, driving).radius.max())
        assert {(row["speed"], row["friction"]) for row in bare} == {
            (v, mu) for v in guarded.speeds for mu in guarded.frictions
        }


def test_the_page_shows_the_verdict_the_maps_and_the_worst_points(guarded, scrambled, monkeypatch, tmp_path):
    monkeypatch.setattr(style, "PNG_DPI", 20)
    bare = certify(scrambled, PLANT, PUBLISHED, "road", levels=FEW)
    result = replace(certificate_result(guarded), command="adaptrack certify mine.json")
    text = write_result(tmp_path / "guarded", result).read_text()
    assert "Passed" in text
    assert "adaptrack certify mine.json" in text
    assert "Without the guard" in text
    assert guarded.verdict in text
    assert {path.name for path in (tmp_path / "guarded").glob("*.png")} == {
        "margins.png", "margins-turn.png", "margins-bare.png", "margins-bare-turn.png", "tunings.png",
    }  # fmt: skip
    bare = replace(bare, mismatched={"lag +0.1 s": bare.bare.turn})
    with pictures(drawn=True):
        text = write_result(tmp_path / "bare", certificate_result(bare)).read_text()
    assert "Another car" in text
    assert "lag +0.1 s" in text
    assert "Failed" in text
    assert "A cross marks" in text
    assert not (tmp_path / "bare" / "margins-bare.png").exists()


def test_changing_ages_are_certified_at_the_mean_and_the_largest_and_said():
    profile = at.load_profile("production")
    mpc = MPC(CAR, profile=profile)
    options = {"domain": {"speed": (8.0, 24.0), "friction": (0.6, 0.6)}, "levels": (3, 1)}
    changing = certify(mpc.tuning, PLANT, mpc, profile, **options)
    constant = [certify(mpc.tuning, PLANT, mpc, world, **options) for world in profile.with_constant_ages]
    worst = constant[0].counted.straight.worst(constant[1].counted.straight)
    for name in ("radius", "gain_up", "gain_down", "delay", "modulus_margin"):
        np.testing.assert_array_equal(getattr(changing.counted.straight, name), getattr(worst, name))
    assert "the pose is 0.1 s old; ages that change by up to 0.02 s (pose) were analysed" in changing.verdict
    assert constant[0].sample_ages == "On arrival the pose is 0.1 s old."


def test_a_late_pose_takes_margin_from_the_loop():
    profile = at.load_profile("production")
    mpc = MPC(CAR, profile=profile)
    options = {"domain": {"speed": (8.0, 24.0), "friction": (0.6, 0.6)}, "levels": (3, 1)}
    late, prompt = (
        certify(mpc.tuning, PLANT, mpc, world, **options).counted.straight.modulus_margin
        for world in (profile.with_constant_ages[0], profile.without_sample_ages)
    )
    assert (late < prompt).all()
