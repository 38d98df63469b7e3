"""Episodes that a vector environment and single environments drive alike."""

from __future__ import annotations

import numpy as np
import pytest

import adaptrack as at

STEP = at.load_scenario("step").replace(duration=4.0)


def same_as_alone(several, alone, choose):
    """Drive two episodes of each car in both forms and compare all but the action that begins the second one."""
    count, seed = several.num_envs, 11
    observations, infos = several.reset(seed=seed)
    lonely = [alone() for _ in range(count)]
    begun = [env.reset(seed=seed + i) for i, env in enumerate(lonely)]
    assert infos["noise_seed"].tolist() == [info["noise_seed"] for _, info in begun]
    assert np.array_equal(observations, [row for row, _ in begun])
    over, episodes = np.zeros(count, bool), 0
    while episodes < 2 * count:
        actions = np.array([choose(row) for row in observations])
        observations, rewards, terminated, truncated, infos = several.step(actions)
        for i, env in enumerate(lonely):
            if over[i]:
                expected = (env.reset()[0], 0.0, False, False)
            else:
                *expected, info = env.step(actions[i])
                assert ("belief_state" in info) == ("belief_state" in several.names)
                assert "belief_state" not in info or infos["belief_state"][i] == info["belief_state"]
                if expected[2] or expected[3]:
                    assert infos["failed"][i] == info["failed"]
                    assert infos["J"][i] == pytest.approx(info["J"], rel=1e-12)
            assert np.array_equal(observations[i], expected[0])
            assert rewards[i] == expected[1]
            assert (terminated[i], truncated[i]) == tuple(expected[2:])
        over = terminated | truncated
        episodes += int(over.sum())
