# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The TIAGo against the joints of PAL Robotics' URDF, and how its base drives."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.models import compose
from manip_sim.simulation import Simulation

H = np.pi / 2.0
# PAL Robotics, tiago_description 2.3.22, pmb2_description 5.0.16, pal_gripper_description 3.1.0:
# parent, xyz [m] and rpy [rad] of the origin, joint or None if it is fixed.
LINKS = {
    'torso_fixed': ('footprint', (-0.062, 0.0, 0.2915), (0, 0, 0), None),
    'torso_lift': ('torso_fixed', (0.0, 0.0, 0.597), (0, 0, 0), 'torso_lift_joint'),
    'head_1': ('torso_lift', (0.182, 0.0, 0.0), (0, 0, 0), 'head_1_joint'),
    'head_2': ('head_1', (0.005, 0.0, 0.098), (H, 0, 0), 'head_2_joint'),
    'arm_1': ('torso_lift', (0.15505, 0.014, -0.151), (0, 0, -H), 'arm_1_joint'),
    'arm_2': ('arm_1', (0.125, 0.0195, -0.031), (H, 0, 0), 'arm_2_joint'),
    'arm_3': ('arm_2', (0.0895, 0.0, -0.0015), (-H, 0, H), 'arm_3_joint'),
    'arm_4': ('arm_3', (-0.02, -0.027, -0.222), (-H, -H, 0), 'arm_4_joint'),
    'arm_5': ('arm_4', (-0.162, 0.02, 0.027), (H, -H, -H), 'arm_5_joint'),
    'arm_6': ('arm_5', (0.0, 0.0, 0.15), (0, -H, -H), 'arm_6_joint'),
    'arm_7': ('arm_6', (0.0, 0.0, 0.0), (H, 0, H), 'arm_7_joint'),
    'arm_tool': ('arm_7', (0.0, 0.0, 0.046), (H, -H, np.pi), None),
    'wrist_ft': ('arm_tool', (0.00785, 0.0, 0.0), (H, 0, H), None),
    'wrist_ft_tool': ('wrist_ft', (0.0, 0.0, 0.012725), (-H, -H, 0), None),
    'gripper': ('wrist_ft_tool', (0.01, 0.0, 0.0), (H, H, -H), None),
    'right_finger': ('gripper', (0, 0, 0), (0, 0, 0), 'gripper_right_finger_joint'),
    'left_finger': ('gripper', (0, 0, 0), (0, 0, 0), 'gripper_left_finger_joint')}
SLIDES = {'torso_lift_joint': (0, 0, 1), 'gripper_right_finger_joint': (1, 0, 0),
          'gripper_left_finger_joint': (-1, 0, 0)}
BODIES = {'torso_fixed': 'robot0_manipulator_mount', 'gripper': 'robot0_right_hand',
          'right_finger': 'gripper0_right_right_finger',
          'left_finger': 'gripper0_right_left_finger'}
#: From links of the gripper in the URDF to those here.
FLIP = Rotation.from_euler('x', np.pi)


@pytest.fixture(scope='module')
def simulation():
    return Simulation(compose('Tiago'))


def full_name(joint):
    """Return the name of a joint in a world."""
    return ('gripper0_right_' if joint.startswith('gripper') else 'robot0_') + joint


def poses(positions):
    """Return the place and the orientation of each link in the base, from PAL's numbers."""
    found = {'footprint': (np.zeros(3), Rotation.identity())}
    for link, (parent, xyz, rpy, joint) in LINKS.items():
        place, turn = found[parent]
        place, turn = place + turn.apply(xyz), turn * Rotation.from_euler('xyz', rpy)
        if joint in SLIDES:
            place = place + turn.apply(SLIDES[joint]) * positions[joint]
        elif joint is not None:
            turn = turn * Rotation.from_rotvec([0.0, 0.0, positions[joint]])
        found[link] = place, turn
    return found


def test_links_are_where_the_urdf_of_pal_has_them(simulation):
    model, data = simulation.model, mujoco.MjData(simulation.model)
    joints = [joint for _, _, _, joint in LINKS.values() if joint]
    random = np.random.default_rng(0)
    for _ in range(20):
        positions = {}
        for joint in joints:
            positions[joint] = random.uniform(*model.joint(full_name(joint)).range)
            data.joint(full_name(joint)).qpos[0] = positions[joint]
        mujoco.mj_kinematics(model, data)
        foot = data.body('mobilebase0_base').xpos
        for link, (place, turn) in poses(positions).items():
            if link in ('footprint', 'arm_tool', 'wrist_ft', 'wrist_ft_tool'):
                continue
            body = data.body(BODIES.get(link, f'robot0_{link}_link'))
            np.testing.assert_allclose(body.xpos - foot, place, atol=1e-9, err_msg=link)
            if link in ('gripper', 'right_finger', 'left_finger'):
                turn = turn * FLIP
            np.testing.assert_allclose(body.xmat.reshape(3, 3), turn.as_matrix(), atol=1e-9)


@pytest.mark.full
def test_its_base_drives_where_it_looks_and_not_sideways(simulation):
    simulation.reset()
    robot = simulation.robot
    command = robot.parse.twist(0.4, 0.3, 0.0)
    assert command.clamped_example == 'linear.y from 0.3 to 0'
    turned = robot.parse.twist(0.0, 0.0, 1.0)
    robot.apply(turned)
    simulation.advance(round(1.0 / simulation.timestep_s))
    robot.apply(command)
    simulation.advance(round(2.0 / simulation.timestep_s))
    yaw = simulation.data.joint('mobilebase0_joint_mobile_yaw').qpos[0]
    velocity = [simulation.data.joint(f'mobilebase0_joint_mobile_{way}').qvel[0]
                for way in ('forward', 'side')]
    assert yaw > 0.3
    np.testing.assert_allclose(velocity, 0.4 * np.array([np.cos(yaw), np.sin(yaw)]), atol=2e-3)


def test_a_base_from_a_file_says_that_it_does_not_drive_sideways(tmp_path):
    pytest.importorskip('pydantic', reason='descriptions of files need pydantic')
    from manip_sim.models.bases import create_base
    joints = ''.join(
        f'<joint name="joint_mobile_{name}" type="{kind}" axis="{axis}"/>'
        for name, kind, axis in (('forward', 'slide', '1 0 0'), ('side', 'slide', '0 1 0'),
                                 ('yaw', 'hinge', '0 0 1')))
    (tmp_path / 'cart.xml').write_text(
        f'<mujoco><worldbody><body name="cart">{joints}<geom size="0.1" mass="20"/>'
        '<body name="support" pos="0 0 0.2"/></body></worldbody><actuator>' + ''.join(
            f'<velocity joint="joint_mobile_{name}" kv="1000" ctrlrange="-1 1"/>'
            for name in ('forward', 'side', 'yaw')) + '</actuator></mujoco>')
    (tmp_path / 'slow.yaml').write_text('model: cart.xml\nsideways: false\n')
    for file, clamped in (('slow.yaml', 1), ('cart.xml', 0)):
        world = compose('Panda', base=create_base(tmp_path / file))
        robot = Simulation(world).robot
        assert robot.parse.twist(0.4, 0.3, 0.0).clamped == clamped, file
