# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what all grippers share, and of the Franka hand's abstract actions."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.models.grippers import PandaGripper
from manip_sim.models.robots import Panda
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

STANDARD_SITES = ['grip_site', 'grip_site_cylinder', 'ee', 'ee_x', 'ee_y', 'ee_z', 'ft_frame']
TURNED = """
<body name="palm" euler="0.3 0 0"><geom name="finger" size="0.1"/>
  <body euler="0 0.5 0">
    <frame euler="0.7 0 0"><body name="eef" pos="0 0 0.2" euler="0 0 0.9"/></frame>
  </body>
</body>
"""


def product(*quats_wxyz):
    """Return the Hamilton product of quaternions."""
    result = np.array([1.0, 0.0, 0.0, 0.0])
    for w, x, y, z in quats_wxyz:
        a, b, c, d = result
        result = np.array([a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
                           a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])
    return result


def turn(axis, angle):
    """Return the rotation about a coordinate axis, w, x, y, z."""
    quat = np.zeros(4)
    quat[0], quat[1 + 'xyz'.index(axis)] = np.cos(angle / 2), np.sin(angle / 2)
    return quat


def test_gripper_that_is_written_for_the_reference_works(gripper_class, gripper_file):
    gripper = gripper_class(gripper_file, idn=3)
    assert gripper.naming_prefix == 'gripper3_'
    assert gripper.dof == 1
    np.testing.assert_array_equal(gripper.current_action, [0.0])
    np.testing.assert_allclose(gripper.format_action([0.4]), [0.1])
    assert gripper.important_geoms['left_finger'] == ['gripper3_finger']
    assert gripper.important_geoms['right_finger'] == []


def test_standard_sites_and_sensors_are_added_where_they_are_missing(gripper_class, gripper_file):
    gripper = gripper_class(gripper_file)
    model = gripper.compile()
    assert sorted(gripper.sites) == sorted(f'gripper0_{name}' for name in STANDARD_SITES)
    assert gripper.important_sites == {
        'grip_site': 'gripper0_grip_site', 'grip_cylinder': 'gripper0_grip_site_cylinder',
        'ee': 'gripper0_ee', 'ee_x': 'gripper0_ee_x', 'ee_y': 'gripper0_ee_y',
        'ee_z': 'gripper0_ee_z'}
    assert gripper.important_sensors == {'force_ee': 'gripper0_force_ee',
                                         'torque_ee': 'gripper0_torque_ee'}
    eef, palm = model.body('gripper0_eef').id, model.body('gripper0_palm').id
    assert model.site('gripper0_grip_site').bodyid[0] == eef
    ft_frame = model.site('gripper0_ft_frame')
    assert ft_frame.bodyid[0] == palm
    for name, kind in (('force_ee', mujoco.mjtSensor.mjSENS_FORCE),
                       ('torque_ee', mujoco.mjtSensor.mjSENS_TORQUE)):
        sensor = model.sensor(f'gripper0_{name}')
        assert int(sensor.type[0]) == int(kind)
        assert sensor.objid[0] == ft_frame.id


def test_sites_and_sensors_of_the_file_are_kept(gripper_class, mjcf):
    gripper = gripper_class(mjcf(
        '<body name="palm"><geom name="finger" size="0.1"/><site name="ft_frame" pos="0 0 0.3"/>'
        '<body name="eef"><site name="grip_site" pos="0 0 0.07"/></body></body>',
        '<sensor><torque name="torque_ee" site="ft_frame"/></sensor>'))
    model = gripper.compile()
    np.testing.assert_allclose(model.site('gripper0_grip_site').pos, [0, 0, 0.07])
    np.testing.assert_allclose(model.site('gripper0_ft_frame').pos, [0, 0, 0.3])
    assert sorted(gripper.sensors) == ['gripper0_force_ee', 'gripper0_torque_ee']


def test_roles_that_a_class_leaves_out_are_the_standard_ones(gripper_class, gripper_file):
    class Partial(gripper_class, registered=False):
        _important_geoms = {'left_finger': ['finger'], 'tips': ['finger']}
        _important_sites = {'tip': 'grip_site'}
        _important_sensors = {}

    gripper = Partial(gripper_file)
    assert gripper.important_geoms == {
        'left_finger': ['gripper0_finger'], 'right_finger': [], 'left_fingerpad': [],
        'right_fingerpad': [], 'tips': ['gripper0_finger']}
    assert gripper.important_sites['tip'] == gripper.important_sites['grip_site']
    assert gripper.important_sensors == {'force_ee': 'gripper0_force_ee',
                                         'torque_ee': 'gripper0_torque_ee'}
    robot = Panda()
    robot.add_gripper(gripper)
    end_effector = Simulation(World([robot])).robot.state().end_effectors['right']
    assert end_effector.wrench.force @ end_effector.wrench.force > 1.0  # Its own weight.


def test_a_standard_sensor_of_another_kind_is_rejected(gripper_class, mjcf):
    file = mjcf('<body name="palm"><geom name="finger" size="0.1"/>'
                '<body name="eef"><site name="pad"/></body></body>',
                '<sensor><touch name="force_ee" site="pad"/></sensor>')
    with pytest.raises(ModelError, match=r"^sensor 'force_ee' of gripper .*model\.xml must be of "
                                         r'the kind force, not touch$'):
        gripper_class(file)


def test_what_a_class_declares_may_depend_on_what_its_constructor_sets_last(
        gripper_class, gripper_file):
    class Late(gripper_class, registered=False):
        def __init__(self, file, finger):
            super().__init__(file)
            self.finger = finger

        @property
        def _important_geoms(self):
            return {'left_finger': [self.finger]}

    assert Late(gripper_file, 'finger').important_geoms['left_finger'] == ['gripper0_finger']
    with pytest.raises(UnknownNameError, match=r"^unknown geom of Late0 in .* 'fingr'"):
        Late(gripper_file, 'fingr').compile()
    robot = Panda()
    robot.add_gripper(Late(gripper_file, 'fingr'))
    with pytest.raises(UnknownNameError, match=r"^unknown geom of Late0 in .* 'fingr'"):
        World([robot]).compile()


def test_a_free_joint_of_the_root_is_left_out(gripper_class, mjcf):
    gripper = gripper_class(mjcf('<body name="palm"><freejoint name="loose"/>'
                                 '<geom name="finger" size="0.1"/><body name="eef"/></body>',
                                 '<sensor><framepos name="at" objtype="body" objname="palm"/>'
                                 '</sensor>'))
    assert 'gripper0_at' in gripper.sensors
    robot = Panda()
    robot.add_gripper(gripper)
    assert robot.compile().nv == robot.dof


def test_missing_grasp_frame_is_named(gripper_class, mjcf):
    with pytest.raises(UnknownNameError, match=r"^unknown body of gripper .*model\.xml 'eef': .*"
                                               r'available: palm$'):
        gripper_class(mjcf('<body name="palm"><geom name="finger" size="0.1"/></body>'))


def test_missing_declared_geom_is_named(gripper_class, mjcf):
    with pytest.raises(UnknownNameError, match=r"^unknown geom of MyGripper0 in .* 'finger': did "
                                               r"you mean 'fingr'\? available: fingr$"):
        gripper_class(mjcf('<body name="palm"><geom name="fingr" size="0.1"/>'
                           '<body name="eef"/></body>'))


def test_gripper_needs_exactly_one_root_body(gripper_class, mjcf):
    with pytest.raises(ModelError, match='must have exactly one root body, found 2: palm, eef'):
        gripper_class(mjcf('<body name="palm"><geom name="finger" size="0.1"/></body>'
                           '<body name="eef"/>'))


def test_rotation_offset_is_the_product_of_all_bodies_up_to_eef(gripper_class, mjcf):
    gripper = gripper_class(mjcf(TURNED))
    w, x, y, z = product(turn('x', 0.3), turn('y', 0.5), turn('x', 0.7), turn('z', 0.9))
    np.testing.assert_allclose(gripper.rotation_offset, [x, y, z, w], atol=1e-12)


def test_rotation_offset_follows_the_mount_pose_also_where_the_file_uses_euler(gripper_class,
                                                                               mjcf):
    gripper = gripper_class(mjcf(TURNED))
    gripper.set_mount_pose(quat_wxyz=turn('z', 0.2))
    w, x, y, z = product(turn('z', 0.2), turn('y', 0.5), turn('x', 0.7), turn('z', 0.9))
    np.testing.assert_allclose(gripper.rotation_offset, [x, y, z, w], atol=1e-12)


@pytest.mark.parametrize('name', ['minus20', 'mixed20', 'plus20'])
def test_franka_hand_formats_actions_as_the_reference(reference, name):
    hand, expected = PandaGripper(), reference['gripper']['format_action'][name]
    outputs = [hand.format_action([a]) for a in reference['gripper']['action_sequences'][name]]
    np.testing.assert_allclose(outputs, expected, atol=1e-12)


def test_franka_hand_has_the_names_and_numbers_of_the_reference(reference):
    hand, expected = PandaGripper(), reference['gripper']
    for name in ('joints', 'actuators', 'important_geoms', 'important_sites',
                 'important_sensors', 'speed', 'dof'):
        assert getattr(hand, name) == expected[name], name
    assert sorted(hand.bodies) == sorted(expected['bodies'])
    np.testing.assert_allclose(hand.init_qpos, expected['init_qpos'])
    np.testing.assert_allclose(hand.rotation_offset, expected['rotation_offset'], atol=1e-6)


@pytest.mark.parametrize(('action', 'message'), [
    ([], r'^an action of PandaGripper must have 1 number, got 0$'),
    ([1.0, 1.0], r'^an action of PandaGripper must have 1 number, got 2$'),
    (1.0, r'^an action of PandaGripper must have 1 number, got the shape \(\)$'),
    ([np.nan], r'^an action of PandaGripper must be finite, got nan at index 0$'),
    ([-np.inf], r'^an action of PandaGripper must be finite, got -inf at index 0$'),
    (['shut'], r"^an action of PandaGripper must be numbers, got \['shut'\]$")])
def test_action_that_does_not_fit_changes_nothing(action, message):
    hand = PandaGripper()
    hand.format_action([1.0])
    with pytest.raises(CommandError, match=message):
        hand.format_action(action)
    np.testing.assert_allclose(hand.format_action([0.0]), [-0.2, 0.2])


def test_commands_are_copies_of_the_state():
    hand = PandaGripper()
    hand.format_action([1.0])[:] = 7.0
    np.testing.assert_allclose(hand.format_action([0.0]), [-0.2, 0.2])


def test_an_action_without_steps_is_the_command_of_each_actuator():
    class EachFinger(PandaGripper):
        _action = {'steps': False}

    hand = EachFinger()
    action = np.array([0.3, -0.4])
    assert hand.dof == 2
    np.testing.assert_array_equal(hand.format_action(action), action)
    assert hand.format_action(action) is not action
    with pytest.raises(CommandError, match='EachFinger must have 2 numbers, got 1$'):
        hand.format_action([1.0])


@pytest.mark.parametrize('command', [[0.04, -0.04], [-1.0, 1.0], [0.7, -0.7]])
def test_idle_action_after_start_at_is_that_command(command):
    hand = PandaGripper()
    hand.start_at(command)
    np.testing.assert_allclose(hand.format_action([0.0]), command)
    np.testing.assert_allclose(hand.format_action([0.0]), command)


def test_start_at_finds_the_state_of_a_gripper_that_keeps_one_number_for_two_actuators(
        gripper_class, gripper_file):
    class Mirrored(gripper_class):
        dof = 1

        def format_action(self, action):
            step = self.speed * np.sign(action)
            self.current_action = np.clip(self.current_action + step, -1.0, 1.0)
            return np.concatenate([self.current_action, -self.current_action])

    hand = Mirrored(gripper_file)
    hand.start_at([0.5, -0.5])
    np.testing.assert_allclose(hand.format_action([1.0]), [0.6, -0.6])


def test_clone_has_its_own_name_state_and_spec(gripper_class, gripper_file):
    gripper = gripper_class(gripper_file)
    gripper.format_action([1.0])
    twin = gripper.clone('0_left')
    assert type(twin) is gripper_class
    assert twin.joints == ['gripper0_left_slide']
    np.testing.assert_array_equal(twin.current_action, [0.0])
    twin.spec.geom('finger').size[0] = 0.05
    twin.format_action([-1.0])
    assert gripper.compile().geom('gripper0_finger').size[0] == 0.01
    np.testing.assert_allclose(gripper.current_action, [0.1])
