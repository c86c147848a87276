# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Operational space control in compiled steps: the same bits as interval by interval."""

import mujoco
import numpy as np
import pytest

from manip_sim.control.law.stepping import may_step, notes_of
from manip_sim.models import compose
from manip_sim.simulation import Simulation
from manip_sim.simulation.control_period import ControlPeriods

PERIOD_S, STEPS = 0.02, 10


def pressed(name, periods):
    """Return digests and wrenches of an arm that is led down to a table and along it."""
    simulation = Simulation(compose(name, arena='table', cube=True))
    robot, draw, found, contacts = simulation.robot, np.random.default_rng(0), [], set()
    robot.set_control_mode('arm', 'effort')
    for period in range(periods):
        if period % 3 == 0:
            action = np.clip(0.3 * draw.normal(size=6) - [0, 0, 1.5, 0, 0, 0], -1.0, 1.0)
            robot.apply(robot.parse_cartesian.action('right', action), period_s=PERIOD_S)
        if period % 25 == 20:
            robot.apply(robot.parse.action('right/gripper', [1.0 if period < 50 else -1.0]))
        simulation.advance(STEPS)
        effector = robot.state().end_effectors['right']
        found.append((simulation.digest(), repr(effector.external_wrench)))
        contacts.add(int(simulation.data.ncon))
    return found, contacts


@pytest.mark.parametrize('name', ['Panda', *(
    pytest.param(name, marks=pytest.mark.full) for name in (
        'UR5e', 'Jaco', 'IIWA', 'SO101', 'Sawyer', 'Kinova3', 'XArm7', 'FR3'))])
def test_compiled_steps_are_those_of_ticks_to_the_last_bit(name, monkeypatch):
    taken, exert = [], ControlPeriods._exert

    def count(self, *arguments):
        taken.append(exert(self, *arguments))
        return taken[-1]

    monkeypatch.setattr(ControlPeriods, '_exert', count)
    found, contacts = pressed(name, 90)
    monkeypatch.setattr(ControlPeriods, '_exert', lambda self, *arguments: 0)
    assert found == pressed(name, 90)[0]
    assert taken.count(8) == 90 and len(contacts) > 1
    assert len({wrench for _, wrench in found}) > 5


def turn(simulation):
    robot = simulation.robot
    robot.apply(robot.parse_cartesian.twist('right', [0.1, 0.0, 0.0], np.zeros(3)))


def press(simulation):
    (tool,) = simulation._periods._steps.tools
    simulation.data.xfrc_applied[tool.bodies.start, 2] = -1.0


@pytest.mark.parametrize('act', [turn, press])
def test_what_else_acts_is_not_left_out(act, monkeypatch):
    simulation, taken = Simulation(compose('Panda', arena='table', cube=True)), []
    robot, exert = simulation.robot, ControlPeriods._exert
    monkeypatch.setattr(ControlPeriods, '_exert', lambda self, *of: taken.append(
        exert(self, *of)) or taken[-1])
    robot.set_control_mode('arm', 'effort')
    robot.apply(robot.parse_cartesian.action('right', np.zeros(6)), period_s=PERIOD_S)
    simulation.advance(STEPS)
    assert taken == [8]
    act(simulation)
    simulation.advance(STEPS)
    assert len(taken) > 1 and not any(taken[1:])


def test_data_that_is_nearly_full_is_left_to_python():
    model = mujoco.MjModel.from_xml_string('<mujoco/>')
    data = mujoco.MjData(model)
    assert may_step(data)
    data.maxuse_arena = int(0.6 * data.narena)
    assert not may_step(data)


def test_the_number_of_contacts_is_found():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 .05"><freejoint/>'
        '<geom type="box" size=".1 .1 .1"/></body></worldbody></mujoco>')
    data = mujoco.MjData(model)
    notes = notes_of(data, np.zeros((0, 3), dtype=np.int64), 1)
    assert notes.contacts[0] == 0
    mujoco.mj_forward(model, data)
    assert notes.contacts[0] == data.ncon > 0
