# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Clone the scripted expert of the task pick_cube with a small network in NumPy, and evaluate it.

    python3 benchmark/behaviour_cloning.py [--demonstrations 100] [--epochs 200] [--test 100]

It needs ``pip install 'manip_sim[env]'``, no torch. The expert is followed with noise on its
actions while its own actions are the labels, so that the data has mistakes and their corrections
(DART, arXiv:1703.09327). The network is tested on 100 seeds that are not in the data, in as many
worlds side by side.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip_sim.algebra import matrix_of, xyzw_to_wxyz
from manip_sim.arrays import FloatArray
from manip_sim.env import TaskVectorEnv
from manip_sim.experiments import wilson_interval
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, Episode

#: The first seed of the test.
FIRST = 10**6
#: Standard deviation of the noise on actions, of which 1 is 5 cm or 0.5 rad. With twice as much,
#: the expert is seldom within 6 mm of its goals, and goes on from where it is blocked.
_NOISE = 0.08
_HIDDEN, _BATCH, _RATE = 256, 256, 1e-3


def features(observation: dict[str, Any]) -> FloatArray:
    """Return what the network sees of observations with a leading axis, shape (n, 17)."""
    eef, cube = observation['eef_pose'][:, 0], observation['object_pose'][:, 0]
    rows = []
    for one, other, joints in zip(eef, cube, observation['joint_position']):
        hand, box = matrix_of(xyzw_to_wxyz(one[3:])), matrix_of(xyzw_to_wxyz(other[3:]))
        # A cube looks the same after a quarter of a turn.
        yaw = 4.0 * np.arctan2((hand.T @ box)[1, 0], (hand.T @ box)[0, 0])
        rows.append([*(hand.T @ (other[:3] - one[:3]) / 0.1), *(hand[:, 2]), *(hand[:, 0]),
                     np.sin(yaw), np.cos(yaw), one[2] - 0.9, other[2] - 0.825,
                     *(joints[-2:] / 0.04), *((one[:2] - other[:2]) / 0.02)])
    return np.array(rows)


def demonstrate(robot: str, count: int) -> tuple[FloatArray, FloatArray]:
    """Return features and actions of a number of episodes in which the expert succeeds."""
    task = create_task('pick_cube', robot=robot)
    episode = Episode(task, Simulation(task.world))
    expert, random = task.expert(episode.simulation), np.random.default_rng(0)
    seen, labels, seed, kept = [], [], 0, 0
    while kept < count:
        episode.reset(seed)
        expert.reset(seed)
        own_seen, own_labels = [], []
        while not episode.over:
            action = np.clip(expert.act(None), -1.0, 1.0)
            own_seen.append({key: value[None] for key, value in episode.observation.items()})
            own_labels.append(action)
            noise = _NOISE * random.standard_normal(len(action)) * (np.arange(len(action)) < 6)
            episode.step(np.clip(action + noise, -1.0, 1.0))
        if episode.success:
            kept += 1
            seen += [features(observation)[0] for observation in own_seen]
            labels += own_labels
        seed += 1
    return np.array(seen), np.array(labels)


class Network:
    """
    Two hidden layers, trained by Adam on the squared error.

    :param sizes: of inputs and outputs
    """

    def __init__(self, sizes: tuple[int, int]) -> None:
        random, widths = np.random.default_rng(0), (sizes[0], _HIDDEN, _HIDDEN, sizes[1])
        self._layers = [[random.standard_normal((a, b)) * np.sqrt(2.0 / a), np.zeros(b)]
                        for a, b in zip(widths, widths[1:])]
        self._moments = [[np.zeros_like(p), np.zeros_like(p)] for layer in self._layers
                         for p in layer]
        self._steps = 0
        self.mean, self.scale = np.zeros(sizes[0]), np.ones(sizes[0])

    def _forward(self, inputs: FloatArray) -> list[FloatArray]:
        values = [(inputs - self.mean) / self.scale]
        for number, (weights, bias) in enumerate(self._layers):
            value = values[-1] @ weights + bias
            values.append(np.maximum(value, 0.0) if number < len(self._layers) - 1 else value)
        return values

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return actions, shape (n, size)."""
        return self._forward(inputs)[-1]

    def learn(self, inputs: FloatArray, wanted: FloatArray) -> float:
        """Make a step with a batch; return its mean squared error before."""
        values = self._forward(inputs)
        error = values[-1] - wanted
        slope, gradients = 2.0 * error / error.size, list[FloatArray]()
        for number in range(len(self._layers) - 1, -1, -1):
            gradients[:0] = [values[number].T @ slope, slope.sum(axis=0)]
            slope = (slope @ self._layers[number][0].T) * (values[number] > 0.0)
        self._steps += 1
        parameters = [p for layer in self._layers for p in layer]
        for parameter, gradient, (first, second) in zip(parameters, gradients, self._moments):
            first += 0.1 * (gradient - first)
            second += 1e-3 * (gradient**2 - second)
            parameter -= _RATE * (first / (1.0 - 0.9**self._steps)) / (
                np.sqrt(second / (1.0 - 0.999**self._steps)) + 1e-8)
        return float((error**2).mean())


def trained(seen: FloatArray, labels: FloatArray, epochs: int) -> Network:
    """Return a network that has learned from demonstrations; print its error and the time."""
    begin, losses = time.process_time(), []
    network, random = Network((seen.shape[1], labels.shape[1])), np.random.default_rng(1)
    network.mean, network.scale = seen.mean(axis=0), seen.std(axis=0) + 1e-3
    for _ in range(epochs):
        order = random.permutation(len(seen))
        losses = [network.learn(seen[batch], labels[batch])
                  for batch in np.array_split(order, max(1, len(order) // _BATCH))]
    print(f'{epochs} epochs, squared error {np.mean(losses):.4f}: '
          f'{time.process_time() - begin:.0f} s of CPU')
    return network


def success(robot: str, network: Network, count: int) -> NDArray[np.bool_]:
    """Return which seeds of the test succeed, shape (count,)."""
    env = TaskVectorEnv('pick_cube', count, robot=robot, autoreset_mode='Disabled')
    observation, _ = env.reset(seed=list(range(FIRST, FIRST + count)))
    ended, succeeded = np.zeros((2, count), dtype=bool)
    while not ended.all():
        actions = np.clip(network(features(observation)), -1.0, 1.0)
        observation, _, terminated, truncated, _ = env.step(actions)
        succeeded |= terminated & ~ended
        over = terminated | truncated
        ended |= over
        if over.any() and not ended.all():  # The episodes that begin there do not count.
            observation, _ = env.reset(options={'reset_mask': over})
    env.close()
    return succeeded


def main() -> None:
    """Demonstrate, train and evaluate; print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n\n')[0])
    parser.add_argument('--demonstrations', type=int, default=100)
    parser.add_argument('--epochs', type=int, default=200)
    parser.add_argument('--test', type=int, default=100, help='number of seeds')
    parser.add_argument('--robot', default='Panda')
    options = parser.parse_args()
    begin = time.process_time()
    seen, labels = demonstrate(options.robot, options.demonstrations)
    print(f'{options.demonstrations} demonstrations, {len(seen)} actions: '
          f'{time.process_time() - begin:.0f} s of CPU')
    network = trained(seen, labels, options.epochs)
    begin = time.process_time()
    succeeded = success(options.robot, network, options.test)
    low, high = wilson_interval(int(succeeded.sum()), len(succeeded))
    print(f'success {succeeded.mean():.0%} of {len(succeeded)} seeds ({low:.0%} to {high:.0%}): '
          f'{time.process_time() - begin:.0f} s of CPU')


if __name__ == '__main__':
    main()
