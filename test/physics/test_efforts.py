# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Published efforts are those that moved the joints: a user identifies the inertia from them."""

import mujoco
import numpy as np
import pytest
from robot_kinds import all_and_kinds
from sampling import Driven, whole_robot

from manip_sim.models.object_creation import create_object
from manip_sim.models.world import World
from manip_sim.physics.efforts import _explicit_at_limits, compute
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation

#: How long joints swing in each mode [s], and how often they are commanded [Hz].
SWING_S, COMMAND_HZ = 0.4, 100
#: Share of the acceleration limit that they swing with.
SHARE = 0.3


class Identification:
    """
    Least squares of the inertia of each joint, from what is published at each step.

    Bias forces and what the other joints take are those of the model at the beginning of a step,
    damping that of its end, as in the integrator.
    """

    def __init__(self, joints):
        self.joints, self.robot = joints, joints.simulation.robot
        self._before = mujoco.MjData(joints.simulation.model)
        self._order = [self.robot.joint_names.index(name) for name in joints.names]
        self._sums = np.zeros((2, len(joints.names)))

    def begin_step(self):
        data = self.joints.simulation.data
        self._before.qpos[:], self._before.qvel[:] = data.qpos, data.qvel

    def end_step(self):
        simulation, before, dofs = self.joints.simulation, self._before, self.joints.dofs
        model = simulation.model
        _, velocity, effort = self.robot.measured().reshape(3, -1)[:, self._order]
        change = velocity - before.qvel[dofs]
        before.qacc[:] = (simulation.data.qvel - before.qvel) / simulation.timestep_s
        mujoco.mj_inverse(model, before)
        needed = before.qfrc_inverse[dofs] + self.joints.damping * change
        inertia = np.zeros((model.nv, model.nv))
        for row, unit in zip(inertia, np.eye(model.nv)):
            mujoco.mj_mulM(model, before, row, unit)
        own = np.diag(inertia)[dofs] * before.qacc[dofs]
        self._sums += (effort - needed + own) * own, own * own

    @property
    def ratio(self):
        """The identified inertia over that of the model, by joint."""
        return self._sums[0] / self._sums[1]


def start_of_swing(joints):
    """Move the joints from their start into their ranges; return where they are."""
    room = np.minimum(0.2, (joints.high - joints.low) / 4.0)
    data = joints.simulation.data
    data.qpos[joints.qpos] = np.clip(joints.position, joints.low + room, joints.high - room)
    mujoco.mj_forward(joints.simulation.model, data)
    for robot in joints.simulation.robots.values():
        robot.reset()
    return joints.position


@pytest.mark.full
@pytest.mark.parametrize(('name', 'timestep_s'), all_and_kinds(
    0.005, 0.001, kinds=('Panda', 'Jaco')))
def test_inertia_identified_from_published_effort_is_that_of_the_model(name, timestep_s):
    simulation = whole_robot(name, timestep_s=timestep_s)
    joints, robot = Driven(simulation), simulation.robot
    limit = robot.joints.acceleration_limits(np.arange(len(joints.names)))
    frequency = 2.0 * np.pi * np.linspace(3.0, 5.0, len(joints.names))
    steps = round(1.0 / (COMMAND_HZ * timestep_s))
    inertia = np.array([simulation.model.dof_M0[dof] for dof in joints.dofs])
    for mode in 'position', 'velocity', 'effort':
        simulation.reset()
        start = start_of_swing(joints)
        for part in robot.parts:
            if part not in robot.grippers:
                robot.set_control_mode(part, mode)
        identification = Identification(joints)
        for period in range(round(SWING_S * COMMAND_HZ)):
            angle = frequency * period / COMMAND_HZ
            joints.command(mode, {
                'position': start + SHARE * limit / frequency**2 * (1.0 - np.cos(angle)),
                'velocity': SHARE * limit / frequency * np.sin(angle),
                'effort': SHARE * limit * inertia * np.cos(angle)}[mode])
            for step in range(steps):
                identification.begin_step()
                simulation.advance(1)
                if step % 3 == 0:
                    identification.end_step()
        np.testing.assert_allclose(identification.ratio, 1.0, atol=0.02, err_msg=mode)


def moved(simulation):
    """Return a Panda that accelerates in position mode, in the middle of a motion."""
    joints = Driven(simulation, 'arm')
    joints.command('position', joints.position + 0.3)
    simulation.advance(30)
    return joints


def test_effort_is_that_of_the_last_step_whatever_comes_after_it(panda_sim):
    joints = moved(panda_sim)
    effort = panda_sim.robot.state().effort
    panda_sim.robot.set_control_mode('arm', 'effort')
    joints.command('effort', np.zeros(7))
    np.testing.assert_array_equal(panda_sim.robot.state().effort, effort)


def test_everything_that_tells_an_effort_tells_the_same(panda_sim):
    moved(panda_sim)
    robot = panda_sim.robot
    arm = robot.indices_of['arm']
    effort = robot.state().effort[arm]
    assert np.abs(effort - panda_sim.data.qfrc_actuator[arm]).max() > 0.1
    np.testing.assert_array_equal(robot.controller_state('arm').effort, effort)
    np.testing.assert_array_equal(robot.measured('arm')[14:], effort)


@pytest.mark.full
@pytest.mark.parametrize('other', [
    '<adhesion name="cup" body="right_hand" ctrlrange="0 1"/>',
    '<motor name="jet" site="tip" gear="0 1 0 0 0 0"/>'])
def test_effort_of_a_servo_does_not_depend_on_actuators_of_no_joint(one_joint_arm, other):
    worldbody = """
    <body name="base"><geom size="0.05" mass="1"/>
      <body name="link1" pos="0 0 1"><joint name="joint1" axis="0 1 0" range="-2 2"/>
        <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
        <body name="right_hand" pos="0.5 0 0"><geom size="0.01" mass="0.1"/>
          <site name="tip"/></body>
      </body>
    </body>"""
    servo = '<position name="turn" joint="joint1" kp="200" kv="20" forcerange="-90 90"/>'
    efforts = []
    for actuators in (servo, other + servo):
        simulation = Simulation(World([one_joint_arm(actuators, worldbody)]))
        simulation.robot.apply(*simulation.robot.parse.joint_command(
            ['robot0_joint1'], position=[0.8]))
        found = []
        for _ in range(60):
            simulation.advance(5)
            found.append(simulation.robot.state().effort[0])
        efforts.append(found)
    assert np.ptp(efforts[0]) > 1.0
    np.testing.assert_array_equal(efforts[1], efforts[0])


LIMITED = """
    <body name="base"><geom size="0.05" mass="1"/>
      <body name="link1" pos="0 0 1"><joint name="joint1" axis="0 1 0" range="-2 2"
        actuatorfrcrange="-2 2"/>
        <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
        <body name="right_hand" pos="0.5 0 0"><geom size="0.01" mass="0.1"/>
          <site name="tip"/></body>
      </body>
    </body>"""


def test_efforts_computed_together_are_those_of_each_world_alone(one_joint_arm):
    servo = '<position name="turn" joint="joint1" kp="200" kv="20" forcerange="-90 90"/>'
    jet = '<motor name="jet" site="tip" gear="0 1 0 0 0 0"/>'
    found = []
    for together in (False, True):
        simulations = [
            Simulation(World([one_joint_arm(actuators, LIMITED)]))
            for actuators in (servo, servo, jet + servo, servo, jet + servo)]
        simulations[1].model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        simulations[3].model.jnt_actfrclimited[:] = False
        for number, simulation in enumerate(simulations):
            simulation.model.jnt_actfrcrange[:] *= 1.0 + number
            simulation.robot.apply(*simulation.robot.parse.joint_command(
                ['robot0_joint1'], position=[0.8 - 0.3 * number]))
            for _ in range(3 + number):
                simulation.advance(5)
        if together:
            compute(simulation.efforts for simulation in reversed(simulations))
        found.append([simulation.efforts.values for simulation in simulations])
    assert len({values.tobytes() for values in found[0]}) == 5
    for alone, one in zip(*found):
        np.testing.assert_array_equal(one, alone)


@pytest.mark.parametrize('limit', ['none', 'actuator', 'joint'])
@pytest.mark.parametrize('integrator', ['EULER', 'IMPLICITFAST'])
def test_efforts_that_compiled_code_computes_are_those_of_python_to_the_last_bit(
        one_joint_arm, limit, integrator):
    arm = one_joint_arm('<position name="turn" joint="joint1" kp="200" kv="20"/>')
    simulation = Simulation(World([arm]))
    simulation.model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator}')
    if limit == 'actuator':
        simulation.model.actuator_forcelimited[:] = True
        simulation.model.actuator_forcerange[:] = -3.0, 3.0
    if limit == 'joint':
        simulation.model.jnt_actfrclimited[:] = True
        simulation.model.jnt_actfrcrange[:] = -2.0, 2.0
    robot, efforts = simulation.robot, simulation.efforts
    robot.apply(*robot.parse.joint_command(['robot0_joint1'], position=[0.8]))
    for _ in range(20):
        simulation.advance(5)
        assert not efforts.stale[0]
        by_laws = efforts.values.tobytes()
        efforts.stale[0] = True
        assert efforts.values.tobytes() == by_laws


def test_effort_outlasts_a_change_of_the_objects(panda_sim):
    moved(panda_sim)
    effort = panda_sim.robot.state().effort
    ball = create_object({'name': 'ball', 'shape': 'sphere', 'size': [0.05], 'mass': 1.0,
                          'position': [2.0, 0.0, 0.1]})
    panda_sim.change_objects(plan_with(panda_sim.plan, ball))
    np.testing.assert_array_equal(panda_sim.robot.state().effort, effort)
    panda_sim.change_objects(plan_without(panda_sim.plan, 'ball'))
    np.testing.assert_array_equal(panda_sim.robot.state().effort, effort)


def test_effort_after_a_reset_is_that_at_rest(panda_sim):
    resting = panda_sim.robot.state().effort
    moved(panda_sim)
    panda_sim.reset()
    np.testing.assert_array_equal(panda_sim.robot.state().effort, resting)


@pytest.mark.parametrize('limit', ['actuator', 'joint'])
@pytest.mark.parametrize('integrator', ['EULER', 'IMPLICITFAST'])
def test_effort_of_a_saturated_servo_is_what_the_equations_of_motion_need(
        one_joint_arm, limit, integrator):
    arm = one_joint_arm('<position name="servo" joint="joint1" kp="100" kv="20"/>')
    simulation = Simulation(World([arm], gravity_compensation=False, timestep_s=0.005))
    model, data = simulation.model, simulation.data
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f'mjINT_{integrator}')
    model.opt.gravity[:] = 0.0
    dof = int(model.joint('robot0_joint1').dofadr[0])
    if limit == 'joint':
        model.jnt_actfrcrange[0], model.jnt_actfrclimited[0] = (-2.0, 2.0), 1
    else:
        model.actuator_forcerange[0], model.actuator_forcelimited[0] = (-2.0, 2.0), 1
    simulation.robot.apply(*simulation.robot.parse.joint_command(
        ['robot0_joint1'], position=[1.0]))
    saturated = 0
    for _ in range(60):
        velocity = data.qvel.copy()
        inertia = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertia, np.eye(model.nv)[dof])
        simulation.advance(1)
        needed = inertia[dof] * (data.qvel[dof] - velocity[dof]) / 0.005
        needed += float(np.ravel(model.dof_damping)[dof]) * data.qvel[dof]
        effort = simulation.robot.state().effort[0]
        assert effort == pytest.approx(needed, abs=1e-9)
        saturated += abs(data.actuator_force[0]) >= 2.0
    assert saturated > 3


def test_a_callback_set_after_the_start_sees_only_the_steps_of_the_simulation(one_joint_arm):
    _explicit_at_limits.cache_clear()
    simulation, seen = Simulation(World([one_joint_arm('<motor joint="joint1"/>')])), []
    mujoco.set_mjcb_control(lambda model, _: seen.append(bytes(model.names)))
    try:
        simulation.advance(3)
        simulation.robot.state()
    finally:
        mujoco.set_mjcb_control(None)
    assert len(seen) >= 3 and set(seen) == {bytes(simulation.model.names)}
