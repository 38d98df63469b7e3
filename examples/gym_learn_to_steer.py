"""Learn to steer: CMA-ES on a linear policy in `adaptrack/PathTracking-v0`, then where it stands on other roads.

python examples/gym_learn_to_steer.py [--generations 150]        # needs adaptrack[gym,bench]
"""

import argparse

import cma
import gymnasium
import numpy as np

import adaptrack as at
import adaptrack.gym
from adaptrack.gym import Task

CARS, POPULATION = 64, 16
SCALE = np.array([0.05, 0.5, 0.1, 0, 0.2, 0.2, 0, *[0.05] * 5, *[3.0] * 5])  # of each observation; speed and age: none
TRAINING, JUDGED = [f"country:{i}" for i in (1, 2, 3, 4)], [f"country:{i}" for i in (11, 12, 14, 17)]


def costs(roads, weights, seed):
    """J (m^2) of each car over one episode, failures as the reward counts them; weights (17,) or (CARS, 17)."""
    envs = gymnasium.make_vec("adaptrack/PathTracking-v0", num_envs=CARS, road=roads, length=400.0)
    observed, _ = envs.reset(seed=[seed + i % (CARS // POPULATION) for i in range(CARS)])  # the same runs for all
    paid, driving, steps = np.zeros(CARS), np.ones(CARS, bool), np.zeros(CARS)
    while driving.any():
        observed, rewards, terminated, truncated, _ = envs.step(np.sum(weights * SCALE * observed, axis=1)[:, None])
        paid, steps = paid - rewards * driving, steps + driving
        driving &= ~(terminated | truncated)
    return paid / steps


def main(generations=150):
    """Learn, judge, and print; J (m^2) of what was learned."""
    search = cma.CMAEvolutionStrategy(np.zeros(len(SCALE)), 0.5, {"popsize": POPULATION, "seed": 1, "verbose": -9})
    for generation in range(generations):
        candidates = np.array(search.ask())
        found = costs(TRAINING, np.repeat(candidates, CARS // POPULATION, axis=0), seed=1000 * generation)
        search.tell(candidates, np.log(found.reshape(POPULATION, -1)).mean(axis=1))
    learned = np.exp(np.log(costs(JUDGED, search.mean, seed=7)).mean())
    print(f"{'linear policy, learned':24} J = {1e4 * learned:8.2f} cm²")
    task, car, profile = Task(road=JUDGED, length=400.0), at.load_vehicle("paper"), at.load_profile("road")
    plant, drives = at.get_plant("dual-track", car), [task.drive(i, car) for i in range(len(JUDGED))]
    for name in ("pure-pursuit", "informed"):
        controller = at.get_controller(name, car, profile=profile, period=profile.period, preview=True)
        runs = at.rollout_batch(
            plant, controller, drives, scenario_indices=[0, 1, 2, 3], profile=profile, seeds=[7, 8, 9, 10]
        )
        print(f"{name:24} J = {1e4 * np.exp(np.log(runs.cost(profile.move_weight)).mean()):8.2f} cm²")
    return learned


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--generations", type=int, default=150)
    main(parser.parse_args().generations)
