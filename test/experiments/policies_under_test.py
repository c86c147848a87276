# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Policies that tests of runs name: good ones, and ones that fail in many ways."""

import os
from pathlib import Path
import signal

import numpy as np

#: A file that the first process deletes before it kills itself.
MARK = 'MANIP_SIM_TEST_MARK'


class Towards:
    """Moves the hand to the goal of reach, as far as observations tell."""

    def reset(self, seed):
        self.periods = 0

    def act(self, observation):
        self.periods += 1
        way = observation['goal'] - observation['eef_pose'][0, :3]
        return np.array([*np.clip(way / 0.05, -1.0, 1.0), 0.0, 0.0, 0.0, 0.0])


class WithoutSeed(Towards):
    def reset(self):
        self.periods = 0


def towards(observation):
    policy = Towards()
    policy.reset(0)
    return policy.act(observation)


class Sometimes(Towards):
    """Fails in its own way in some seeds."""

    def reset(self, seed):
        super().reset(seed)
        self.seed = seed

    def act(self, observation):
        found = super().act(observation)
        if self.seed == 1:
            raise ZeroDivisionError('one')
        if self.seed == 2:
            found[0] = np.nan
        if self.seed == 3:
            return found[:5]
        return found


class Deadly(Towards):
    """Kills its process in seed 2, once."""

    def reset(self, seed):
        super().reset(seed)
        mark = Path(os.environ[MARK])
        if seed == 2 and mark.exists():
            mark.unlink()
            os.kill(os.getpid(), signal.SIGKILL)


class AlwaysDeadly(Towards):
    """Kills its process in seed 2."""

    def reset(self, seed):
        super().reset(seed)
        if seed == 2:
            os.kill(os.getpid(), signal.SIGKILL)


class WithoutAct:
    def reset(self, seed):
        """Do nothing."""


class NeedsArguments:
    def __init__(self, size):
        self.size = size


NUMBER = 7
