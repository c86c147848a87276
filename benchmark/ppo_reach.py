# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Train the PPO of stable-baselines3 on the task reach, and draw how its success rises.

    python3 benchmark/ppo_reach.py [--periods 20000] [--minutes 10] [--seed 0] [--curve FILE.svg]

It needs ``pip install 'manip_sim[env]' stable-baselines3 matplotlib``. The observation is the way
from the end effector to the point. A row is printed for each rollout: wall time, CPU time, control
periods, and the share of the last 100 episodes that succeeded; at the end, the share of 100 seeds
that were not trained on, with the deterministic policy.
"""

from __future__ import annotations

import argparse
from collections import deque
from pathlib import Path
import time
from typing import Any

import gymnasium
import numpy as np

from manip_sim.env import TaskEnv
from manip_sim.experiments import wilson_interval

SEEDS_OF_TEST = range(10**6, 10**6 + 100)
_ENVIRONMENTS, _STEPS = 4, 128
#: Control periods of a rollout.
_ROLLOUT = _ENVIRONMENTS * _STEPS


class Way(gymnasium.ObservationWrapper):
    """The way from the end effector to the goal in units of 5 cm, what one action covers."""

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)

    def observation(self, observation: Any) -> Any:
        return ((observation['goal'] - observation['eef_pose'][0, :3]) / 0.05).astype(np.float32)


def make() -> Any:
    """Return an environment whose actions are where the end effector moves."""
    env = gymnasium.wrappers.TransformAction(
        Way(TaskEnv('reach')), lambda action: np.concatenate([action, np.zeros(4)]),
        gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32))
    # Rewards are below 1 before success, so minus 1 makes every period cost something.
    return gymnasium.wrappers.TransformReward(env, lambda reward: float(reward) - 1.0)


class Curve:
    """A callback that notes the success after each rollout, and ends training in time."""

    def __init__(self, minutes: float) -> None:
        self._end = time.monotonic() + 60.0 * minutes
        self._begin = time.monotonic(), time.process_time()
        self._last: deque[bool] = deque(maxlen=100)
        self.rows: list[tuple[float, float, int, float]] = []

    def __call__(self, local: dict[str, Any], _: dict[str, Any]) -> bool:
        """Take a step of all environments; return whether training goes on."""
        self._last += [info['success'] for info, done in
                       zip(local['infos'], local['dones']) if done]
        periods = local['self'].num_timesteps
        if self._last and not periods % _ROLLOUT:
            row = (time.monotonic() - self._begin[0], time.process_time() - self._begin[1],
                   periods, float(np.mean(self._last)))
            self.rows.append(row)
            print('| {:.0f} s | {:.0f} s | {} | {:.0f} % |'.format(*row[:3], 100.0 * row[3]),
                  flush=True)
        return time.monotonic() < self._end


def success_of(model: Any) -> int:
    """Return how many of the seeds of the test succeed."""
    env, found = make(), 0
    for seed in SEEDS_OF_TEST:
        observation, _ = env.reset(seed=seed)
        ended = False
        while not ended:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action)
            ended = terminated or truncated
        found += terminated
    return found


def draw(rows: list[tuple[float, float, int, float]], file: Path) -> None:
    """Draw the success over the number of control periods."""
    from matplotlib import pyplot
    figure, axes = pyplot.subplots(figsize=(6.0, 3.0), layout='constrained')
    axes.plot([row[2] for row in rows], [100.0 * row[3] for row in rows])
    axes.set(xlabel='control periods', ylabel='success of the last 100 [%]', ylim=(0, 102))
    figure.savefig(file)


def main() -> None:
    """Train, print and draw."""
    parser = argparse.ArgumentParser(description='PPO on the task reach.')
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--periods', type=int, default=20_000)
    parser.add_argument('--curve', type=Path)
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env
    model = PPO('MlpPolicy', make_vec_env(make, _ENVIRONMENTS, seed=options.seed), n_steps=_STEPS,
                batch_size=128, gamma=0.95, learning_rate=1e-3, seed=options.seed, device='cpu')
    curve = Curve(options.minutes)
    print('| wall time | CPU time | periods | success |\n|---|---|---|---|')
    model.learn(options.periods, callback=curve)
    successes = success_of(model)
    low, high = (100.0 * limit for limit in wilson_interval(successes, len(SEEDS_OF_TEST)))
    print(f'\n{successes} of {len(SEEDS_OF_TEST)} seeds, 95 % interval {low:.0f} to {high:.0f} %')
    if options.curve is not None:
        draw(curve.rows, options.curve)


if __name__ == '__main__':
    main()
