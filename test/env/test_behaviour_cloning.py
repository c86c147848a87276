# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The example of behaviour cloning, with few demonstrations."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('gymnasium', reason="needs the extra 'env'")

FILE = Path(__file__).parents[2] / 'benchmark' / 'behaviour_cloning.py'


@pytest.fixture
def example():
    spec = importlib.util.spec_from_file_location('behaviour_cloning', FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.full
def test_the_example_learns_from_demonstrations_and_is_tested_in_worlds(example):
    seen, labels = example.demonstrate('Panda', 3)
    assert len(seen) == len(labels) and seen.shape[1:] == (17,) and np.isfinite(seen).all()
    # The noise keeps the expert from no goal: with too much, it waited until it gave up.
    assert len(seen) < 3 * 55
    network = example.Network((17, labels.shape[1]))
    network.mean, network.scale = seen.mean(axis=0), seen.std(axis=0) + 1e-3
    errors = [network.learn(seen, labels) for _ in range(150)]
    assert errors[-1] < 0.1 * errors[0]
    # A network that does nothing reaches nothing; one that knows is asked for each world.
    assert example.success('Panda', lambda inputs: np.zeros((len(inputs), 7)), 2).tolist() == [
        False, False]


@pytest.mark.full
def test_gradients_of_the_network_are_those_of_differences(example):
    random = np.random.default_rng(3)
    inputs, wanted = random.standard_normal((5, 4)), random.standard_normal((5, 2))
    network, step = example.Network((4, 2)), 1e-6
    weights = network._layers[0][0]
    before = weights.copy()

    def loss():
        return float(((network(inputs) - wanted)**2).mean())
    slopes = []
    for place in [(0, 0), (3, 200), (1, 77)]:
        weights[place] += step
        above = loss()
        weights[place] -= 2.0 * step
        slopes.append((above - loss()) / (2.0 * step))
        weights[place] += step
    network.learn(inputs, wanted)
    first, _ = network._moments[0]
    np.testing.assert_allclose([10.0 * first[p] for p in [(0, 0), (3, 200), (1, 77)]], slopes,
                               atol=1e-6)
    assert (weights != before).any()
