# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Policies that tests of runs name: good ones, and ones that fail in many ways."""

import multiprocessing
import os
from pathlib import Path
import random
import signal
import sys
import threading
import time

import numpy as np
import contextlib

#: A file that the first process deletes before it kills itself.
MARK = 'MANIP_SIM_TEST_MARK'


class Towards:
    """Moves the end effector to the goal of reach, as far as observations tell."""

    def reset(self, seed):
        self.periods = 0

    def act(self, observation):
        self.periods += 1
        way = observation['goal'] - observation['eef_pose'][0, :3]
        return np.array([*np.clip(way / 0.05, -1.0, 1.0), 0.0, 0.0, 0.0, 0.0])


class Draws(Towards):
    """Draws from the generators of Python and NumPy, which it does not seed."""

    def act(self, observation):
        found = super().act(observation)
        found[0] += np.random.normal(0.0, 0.2)  # noqa: NPY002, as policies do
        found[1] += random.gauss(0.0, 0.2)
        return found


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


class OnceInSeedTwo(Towards):
    """Does something else in the third period of seed 2."""

    def reset(self, seed):
        super().reset(seed)
        self.seed = seed

    def act(self, observation):
        found = super().act(observation)
        if self.seed == 2 and self.periods == 3:
            other = self.otherwise()
            return found if other is None else other
        return found


class Interrupts(OnceInSeedTwo):
    def otherwise(self):
        raise KeyboardInterrupt


class InterruptsAtReset(Towards):
    def reset(self, seed):
        super().reset(seed)
        if seed == 2:
            raise KeyboardInterrupt


class Exits(OnceInSeedTwo):
    def otherwise(self):
        sys.exit(0)


class Speechless(OnceInSeedTwo):
    class Error(Exception):
        def __str__(self):
            raise RuntimeError

    def otherwise(self):
        raise self.Error


class Lies(OnceInSeedTwo):
    def __array__(self, *_, **__):
        raise RuntimeError('not an array')

    def __repr__(self):
        raise RuntimeError('no text')

    def otherwise(self):
        return self


class Hangs(OnceInSeedTwo):
    def otherwise(self):
        threading.Event().wait()


class HangsWhateverIsRaised(OnceInSeedTwo):
    def otherwise(self):
        while True:
            with contextlib.suppress(BaseException):
                threading.Event().wait()


class HangsAfterStoppingItself(OnceInSeedTwo):
    def otherwise(self):
        os.kill(os.getpid(), signal.SIGSTOP)


class HangsWithoutAlarms(OnceInSeedTwo):
    def otherwise(self):
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        threading.Event().wait()


class HangsWithATimerOfItsOwn(OnceInSeedTwo):
    def otherwise(self):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        threading.Event().wait()


class HangsInTheSecondProcess(Towards):
    def __init__(self):
        if multiprocessing.parent_process() is not None:
            threading.Event().wait()


class DiesBesideACopy(OnceInSeedTwo):
    def otherwise(self):
        if os.fork():
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(20)  # With what was open.
        os._exit(0)


class Forks(OnceInSeedTwo):
    def otherwise(self):
        os.fork()


class Moves(Towards):
    """Changes the working directory wherever it can."""

    def __init__(self):
        os.chdir(os.environ[MARK])

    def reset(self, seed):
        os.chdir(os.environ[MARK])
        super().reset(seed)


class Writes(Towards):
    """Overwrites what it is given."""

    def act(self, observation):
        found = super().act(observation)
        for array in observation.values():
            array[...] = 9
        return found


class Leaks(Towards):
    """Keeps 64 MiB of each episode from the second on, and has none left in the third."""

    kept = []

    def reset(self, seed):
        super().reset(seed)
        if len(self.kept) == 2:
            raise MemoryError
        self.kept.append(np.ones(2**23))


class FailsWhileMarked(OnceInSeedTwo):
    def otherwise(self):
        if Path(os.environ[MARK]).exists():
            raise RuntimeError('marked')


class NeverHasMemory(OnceInSeedTwo):
    def otherwise(self):
        raise MemoryError


class ExitsAtOnce:
    def __init__(self):
        sys.exit(0)


class WithAReset(Towards):
    @property
    def reset(self):
        raise RuntimeError('no reset')


class WithoutAct:
    def reset(self, seed):
        """Do nothing."""


class NeedsArguments:
    def __init__(self, size):
        self.size = size


NUMBER = 7


class StopsInTheThirdPeriod(Towards):
    """Does nothing from the third action on."""

    def act(self, observation):
        found = super().act(observation)
        return found if self.periods < 3 else 0.0 * found


class Thinks(Towards):
    """Takes 10 ms for an answer, and 40 ms for the second one."""

    def act(self, observation):
        time.sleep(0.04 if self.periods == 1 else 0.01)
        return super().act(observation)


class Chunks(Towards):
    """Returns five actions at once, each a part of the way."""

    def act(self, observation):
        found = super().act(observation)
        return np.array([found * 0.6**i for i in range(5)])


class Together:
    """Moves the end effectors of several episodes, and knows how often each has asked."""

    def __init__(self):
        self.asked = {}

    def reset(self, seed):
        self.asked[seed] = 0

    def act(self, observations, seeds):
        for seed in seeds:
            self.asked[seed] += 1
        ways = observations['goal'] - observations['eef_pose'][:, 0, :3]
        return np.concatenate([np.clip(ways / 0.05, -1.0, 1.0), np.zeros((len(ways), 4))], axis=1)


class TogetherSometimes(Together):
    """Fails for a seed, for all or by ending the process."""

    def act(self, observations, seeds):
        answers = super().act(observations, seeds)
        if 2 in seeds:
            answers[list(seeds).index(2)] = np.nan
        if 5 in seeds:
            raise ZeroDivisionError('five')
        if 8 in seeds:
            return answers[0]
        if 10 in seeds:
            os._exit(3)
        return answers
