"""Every request has an upper bound, and a refusal names value, bound and reason before any work."""

from __future__ import annotations

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base import limits
from adaptrack.paper.campaign_config import CampaignConfig, CampaignPlan
from small_data import small_campaign

LIMITS = [value for value in vars(limits).values() if isinstance(value, limits.RequestLimit)]


def test_a_limit_takes_its_largest_value_and_refuses_more_by_name_with_its_reason():
    for limit in LIMITS:
        limits.check_limit("it", limit.most, limit)
        with pytest.raises(at.InvalidInput) as refused:
            limits.check_limit("it", limit.most + 1, limit)
        assert str(refused.value).startswith(f"it = {limit.most + 1}: at most {limit.most:,}")
        assert limit.reason in str(refused.value)
    for value in (10**400, 1e300, np.inf):
        with pytest.raises(at.InvalidInput) as refused:
            limits.check_limit("it", value, limits.MAX_SPEED)
        assert len(str(refused.value)) < 120


@pytest.mark.parametrize(("words", "make"), [
    ("speed", lambda: at.load_scenario("step", speed=1e15)),
    ("duration", lambda: at.load_scenario("step", duration=1e12)),
    ("duration", lambda: at.Scenario(name="long", duration=1e9, reference=0.0, speed=10.0, friction=0.8)),
    ("periods", lambda: at.load_scenario("step", duration=100.0).sample(1e-6)),
    ("Np", lambda: at.Tuning(Np=10**9)),
    ("Nc", lambda: at.Tuning(Np=1000, Nc=1000)),
    ("terms", lambda: at.Moves("laguerre", terms=10**9)),
    ("longest_horizon", lambda: at.published_mpc(at.load_vehicle("paper"), longest_horizon=10**9)),
    ("most_moves", lambda: at.published_mpc(at.load_vehicle("paper"), most_moves=10**9)),
    ("noise_seeds", lambda: small_campaign(profile="road", noise_seeds=tuple(range(100_000)))),
    ("landscape", lambda: CampaignPlan.of(sobol(10**6, 10_000))),
])  # fmt: skip
def test_what_would_take_hours_or_all_memory_is_refused_where_it_is_said(words, make):
    with pytest.raises(at.InvalidInput, match=words):
        make()


def sobol(points: int, tunings: int) -> CampaignConfig:
    box = {"speed": (5.0, 20.0), "y_ref": (-4.0, 4.0), "friction": (0.5, 0.9), "wind": (-5.0, 5.0)}
    return small_campaign(operating_points={"kind": "sobol", "n": points, "box": box}, library={"size": tunings})
