# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
What a physics step of each robot costs, as a ratio.

The measure is robosuite's model of the same robot, with its own gripper, base and options, in the
same process: ``pip install robosuite==1.5.2``. Our models are as the node steps them, without the
shapes that cannot collide; robosuite steps its own with them. Its models compile with new versions
of MuJoCo too, with which its simulation does not run. Without robosuite the measure is a bare
pendulum.

    python3 benchmark/step_cost.py [NAME ...]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import sys
import time

import mujoco
import numpy as np

from manip_sim.errors import describe_choices
from manip_sim.models import compose
from manip_sim.models.robots import robot_names

ROUNDS = 9
STEPS = 500
PENDULUM = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <body><joint axis="0 1 0"/><geom type="capsule" size="0.01" fromto="0 0 0 0 0 -1"/></body>
  </worldbody>
</mujoco>"""


class Stepper:
    """
    A model at rest in the pose that it starts in.

    :param model: a ``mujoco.MjModel``
    :param qpos: where named joints start [rad or m]
    """

    def __init__(self, model, qpos):
        self.model, self.data = model, mujoco.MjData(model)
        for joint, position in qpos.items():
            self.data.joint(joint).qpos = position
        self._hold()
        self.start = self.data.qpos.copy()
        self.costs_us = []

    def _hold(self):
        model, data = self.model, self.data
        for actuator in np.flatnonzero(model.actuator_biasprm[:, 1] < 0.0):
            address = model.jnt_qposadr[model.actuator_trnid[actuator, 0]]
            data.ctrl[actuator] = np.clip(data.qpos[address], *model.actuator_ctrlrange[actuator])
        mujoco.mj_forward(model, data)
        # Motors get what gravity asks for; servos hold by themselves.
        data.qfrc_applied[:] = data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator
        mujoco.mj_step(model, data, STEPS // 5)

    def measure(self):
        """Take the time of some steps once more."""
        self.data.qpos[:], self.data.qvel[:] = self.start, 0.0
        mujoco.mj_forward(self.model, self.data)
        began = time.perf_counter()
        mujoco.mj_step(self.model, self.data, STEPS)
        self.costs_us.append((time.perf_counter() - began) / STEPS * 1e6)

    def cost_us(self):
        """Return the least cost of a step [us]; noise only adds."""
        return min(self.costs_us)


def ours(name):
    """Return our robot with its default base and grippers."""
    world = compose(name)
    return Stepper(world.compile(visual=False), world.init_qpos())


class Robosuite:
    """The same robots as robosuite composes them."""

    what = 'robosuite'

    def __init__(self):
        logging.disable(logging.WARNING)
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            from robosuite.models.arenas import EmptyArena
            from robosuite.models.world import MujocoWorldBase
            from robosuite.robots import ROBOT_CLASS_MAPPING
        self._arena, self._world, self._robots = EmptyArena, MujocoWorldBase, ROBOT_CLASS_MAPPING

    def __call__(self, name):
        """Return the robot, or None if robosuite does not have it."""
        if name not in self._robots:
            return None
        robot = self._robots[name](robot_type=name)
        robot.load_model()
        robot.robot_model.set_base_xpos(robot.robot_model.base_xpos_offset['empty'])
        world = self._world()
        world.merge(self._arena())
        world.merge(robot.robot_model)
        own = robot.robot_model
        return Stepper(world.get_model(mode='mujoco'),
                       dict(zip(own.joints, own.init_qpos)))


class Pendulum:
    """One hinge, the least that can be stepped."""

    what = 'pendulum'

    def __call__(self, name):
        """Return the pendulum for any robot."""
        return Stepper(mujoco.MjModel.from_xml_string(PENDULUM), {})


def measure_of_choice():
    """Return robosuite if it is installed, else the pendulum."""
    try:
        return Robosuite()
    except ImportError as error:
        print(f'robosuite is not there ({error}); the measure is a pendulum', file=sys.stderr)
        return Pendulum()


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0].strip())
    parser.add_argument('name', nargs='*', metavar='NAME', help='robots (default: all)')
    names = parser.parse_args().name or robot_names()
    for name in names:
        if name not in robot_names():
            print(f"unknown robot '{name}': {describe_choices(name, robot_names())}",
                  file=sys.stderr)
            return 1
    other = measure_of_choice()
    print(f'mujoco {mujoco.__version__}, least of {ROUNDS} rounds of {STEPS} steps')
    print(f'{"robot":12} {"ratio":>7} {"ours/us":>9} {other.what + "/us":>13} '
          f'{"shapes":>8} {"contacts":>9}')
    for name in names:
        steppers = ours(name), other(name)
        if steppers[1] is None:
            print(f'{name:12} {"-":>7}  robosuite has no such robot')
            continue
        for _ in range(ROUNDS):
            for stepper in steppers:
                stepper.measure()
        mine, theirs = (stepper.cost_us() for stepper in steppers)
        shapes = np.count_nonzero(steppers[0].model.geom_contype)
        print(f'{name:12} {mine / theirs:7.2f} {mine:9.1f} {theirs:13.1f} {shapes:8} '
              f'{steppers[0].data.ncon:9}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
