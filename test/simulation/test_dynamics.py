# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""With the URDF, what a robot says of its joints gives the torques of the simulation."""

import mujoco
import numpy as np
import pytest

from sampling import Driven, whole_robot

from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.models.urdf_writer import urdf_of
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

pin = pytest.importorskip('pinocchio', reason='pin is a tool of the extra test')


@pytest.mark.parametrize('name', robot_names())
def test_torques_from_the_urdf_and_the_dynamics_are_those_of_the_physics(name):
    simulation, random = whole_robot(name), np.random.default_rng(3)
    joints, model = Driven(simulation), simulation.model
    dynamics = simulation.robot.dynamics()
    links = pin.buildModelFromXML(urdf_of(compose(name)).xml)
    address = {joint: links.joints[links.getJointId(joint)].idx_v for joint in dynamics}
    for joint, found in dynamics.items():
        links.armature[address[joint]] = found.armature
    own = [address[joint] for joint in joints.names]
    damping = np.array([dynamics[joint].damping for joint in joints.names])
    data, tree = mujoco.MjData(model), links.createData()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    for _ in range(3):
        low = np.clip(joints.position - 0.5, joints.low, joints.high)
        high = np.clip(joints.position + 0.5, joints.low, joints.high)
        data.qpos[:], data.qvel[:], data.qacc[:] = simulation.data.qpos, 0.0, 0.0
        for field, lowest, highest in (('qpos', low, high), ('qvel', -1.0, 1.0),
                                       ('qacc', -3.0, 3.0)):
            place = joints.qpos if field == 'qpos' else joints.dofs
            getattr(data, field)[place] = random.uniform(lowest, highest, len(place))
        numbers = {joint: (data.joint(joint).qpos[0], data.joint(joint).qvel[0],
                           data.joint(joint).qacc[0]) for joint in dynamics}
        displacement, velocity, acceleration = np.zeros((3, links.nv))
        for joint, values in numbers.items():
            (displacement[address[joint]], velocity[address[joint]],
             acceleration[address[joint]]) = values
        position = pin.integrate(links, pin.neutral(links), displacement)
        torque = pin.rnea(links, tree, position, velocity, acceleration)[own]
        mujoco.mj_inverse(model, data)
        needed = data.qfrc_inverse[joints.dofs]
        np.testing.assert_allclose(torque + damping * velocity[own], needed, rtol=1e-6, atol=1e-5)


def test_what_a_joint_says_is_what_its_file_says(sim_of_joint):
    joint = sim_of_joint.robot.dynamics()['robot0_joint1']
    assert (joint.armature, joint.damping, joint.friction_loss) == (0.3, 1.5, 0.2)
    assert (joint.stiffness, joint.spring_position) == (4.0, 0.1)
    assert (joint.position_range, joint.effort_range) == ((-1.0, 2.0), (-7.0, 9.0))
    assert (joint.velocity_limit, joint.acceleration_limit) == (0.8, 5.0)


@pytest.fixture
def sim_of_joint(one_joint_arm):
    arm = one_joint_arm('<motor name="motor" joint="joint1" gear="1"/>', """
<body name="base">
  <body name="right_hand">
    <joint name="joint1" axis="0 1 0" range="-1 2" armature="0.3" damping="1.5" stiffness="4"
      frictionloss="0.2" springref="0.1" actuatorfrcrange="-7 9" user="0.8 5"/>
    <geom size="0.1" mass="1"/>
  </body>
</body>
""")
    return Simulation(World([arm]))


def test_what_has_no_limit_says_none():
    dynamics = whole_robot('Kinova3').robot.dynamics()
    assert next(iter(dynamics.values())).position_range is None
    fingers = [joint for name, joint in dynamics.items() if name.startswith('gripper')]
    assert fingers and all(joint.acceleration_limit is None for joint in fingers)
