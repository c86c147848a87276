# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Mocap bodies in the files of robots, and the welds by which they hold them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose, load_base, load_gripper, load_robot
from manip_sim.simulation import Simulation

FILE = Path(__file__).resolve().parents[1] / 'data/files/pulled_arm.xml'


def described(tmp_path, text, edits=()):
    """Write the robot with a YAML file and edits of its text; return the YAML file."""
    xml = FILE.read_text()
    for old, new in edits:
        assert old in xml
        xml = xml.replace(old, new)
    (tmp_path / 'arm.xml').write_text(xml)
    (tmp_path / 'arm.yaml').write_text(f'model: arm.xml\n{text}')
    return tmp_path / 'arm.yaml'


def advance(simulation, seconds):
    for _ in range(round(seconds * 100)):
        simulation.advance(5)


def hand(simulation):
    body = simulation.data.body('robot0_hand')
    return np.concatenate([body.xpos, body.xquat])


def test_the_robot_starts_at_rest_where_its_weld_has_it():
    robot = load_robot(FILE)
    assert ("welds pull 'hand' to mocap bodies, against commands of joints; 'mocap: false' in a "
            'YAML file leaves these bodies out') in robot.inferred
    simulation = Simulation(compose(robot))
    assert simulation.surroundings.mocap_names == ('robot0_target', 'robot0_goal_1')
    assert not any('nothing holds' in defect for defect in simulation.start_defects)
    before = hand(simulation)
    advance(simulation, 2.0)
    np.testing.assert_allclose(hand(simulation), before, atol=1e-5)


@pytest.mark.parametrize('place', [{}, {'position': [1.0, 2.0, 0.5],
                                        'orientation': [0.0, 0.0, 0.7]}])
def test_the_hand_follows_its_mocap_body(place):
    simulation = Simulation(compose(FILE, **place))
    before, pose = hand(simulation), simulation.surroundings.pose('robot0_target')
    # Towards the base, which is within the reach of the arm.
    goal = 0.15 * (simulation.data.body('robot0_base').xpos - before[:3])
    goal[2] = 0.0
    simulation.surroundings.set_target('robot0_target', pose[:3] + goal, pose[3:])
    advance(simulation, 2.0)
    np.testing.assert_allclose(hand(simulation)[:3] - before[:3], goal, atol=5e-3)


def test_other_mocap_bodies_move_with_the_place_of_the_robot():
    simulation = Simulation(compose(FILE, position=[1.0, 2.0, 0.0],
                                    orientation=[0.0, 0.0, np.pi / 2.0]))
    base = simulation.data.body('robot0_base').xpos
    np.testing.assert_allclose(simulation.surroundings.pose('robot0_goal_1')[:3] - base,
                               [-0.2, 0.4, 0.4], atol=1e-9)


def test_a_keyframe_says_where_mocap_bodies_start(tmp_path):
    file = described(tmp_path, '', [('</mujoco>', """<keyframe>
    <key name="home" qpos="0 0 1 0 0" mpos="0.1 0.2 0.3 0.4 0.5 0.6"/></keyframe></mujoco>""")])
    surroundings = Simulation(compose(file)).surroundings
    np.testing.assert_allclose(surroundings.pose('robot0_target')[:3], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(surroundings.pose('robot0_goal_1')[:3], [0.4, 0.5, 0.6])


@pytest.mark.parametrize('bodies', [('target', 'hand'), ('hand', 'target')])
@pytest.mark.parametrize('weld', [
    '', 'anchor="0.02 0.01 0.03"', 'relpose="0.1 0.05 -0.2 0.7 0.1 0.2 -0.3"'])
def test_a_weld_is_at_rest_at_the_start_whatever_it_says(tmp_path, bodies, weld):
    file = described(tmp_path, 'start: {yaw: 0.4, shoulder: 0.3, elbow: 0.8}', [(
        'body1="target" body2="hand"', f'body1="{bodies[0]}" body2="{bodies[1]}" {weld}')])
    simulation = Simulation(compose(file))
    data = simulation.data
    weld_rows = data.efc_type[:data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    assert weld_rows.sum() == 6
    np.testing.assert_allclose(data.efc_pos[:data.nefc][weld_rows], 0.0, atol=1e-9)


def test_two_roots_and_a_mocap_body_are_one_robot(tmp_path):
    file = described(tmp_path, '', [(
        '<body name="base"', '<body name="rack" pos="0.5 0 0.5"><joint name="rack" axis="1 0 0"/>'
        '<geom type="sphere"/></body><body name="base"')])
    simulation = Simulation(compose(file))
    assert simulation.model.body('robot0_root').id == 1
    before = hand(simulation)
    advance(simulation, 1.0)
    np.testing.assert_allclose(hand(simulation), before, atol=1e-5)


def test_a_yaml_file_leaves_mocap_bodies_out(tmp_path):
    robot = load_robot(described(tmp_path, 'mocap: false'))
    assert "left out: mocap bodies 'target', 'goal:1'" in robot.inferred
    simulation = Simulation(compose(robot))
    assert simulation.surroundings.mocap_names == () and simulation.model.neq == 0


def test_mocap_bodies_bring_what_they_show_and_no_more():
    model = Simulation(compose(FILE), visual=True).model
    materials = [model.material(i).name for i in range(model.nmat)]
    assert sorted(m for m in materials if 'checker' in m or 'plain' in m) == [
        'robot0_checker', 'robot0_mocap_checker', 'robot0_plain']
    geom = model.body('robot0_target').geomadr[0]
    assert materials[model.geom_matid[geom]] == 'robot0_mocap_checker'
    assert mujoco.MjModel.from_xml_string(compose(FILE).to_xml()).nmocap == 2


def test_without_a_place_in_the_world_they_are_left_out(tmp_path):
    robot = load_robot(FILE)
    assert compose(robot, base='OmronMobileBase').compile().nmocap == 0
    assert [said for said in robot.inferred if 'mocap' in said] == [
        "left out: mocap bodies 'target', 'goal:1', as the robot stands on a mobile base"]
    (tmp_path / 'stand.xml').write_text(
        '<mujoco><worldbody><body name="marker" mocap="true"><geom size="0.1"/></body>'
        '<body name="stand"><geom size="0.1"/></body></worldbody></mujoco>')
    for load in (load_base, load_gripper):
        assert "left out: mocap bodies 'marker'" in load(tmp_path / 'stand.xml').inferred


@pytest.mark.parametrize('constraint', [
    '<connect body1="target" body2="hand" anchor="0 0 0"/>',
    '<connect site1="goal" site2="at_hand"/>', '<weld site1="at_hand" site2="goal"/>'])
def test_a_constraint_that_mocap_bodies_do_not_keep_is_told(tmp_path, constraint):
    robot = load_robot(described(tmp_path, '', [
        ('<weld name="pull" body1="target" body2="hand" solref="0.01 1"/>', constraint),
        ('<body name="hand"',
         '<body name="before"><site name="at_hand"/></body><body name="hand"'),
    ]))
    body = 'before' if 'at_hand' in constraint else 'hand'
    assert ('left out: constraints other than welds of bodies that tie '
            f"'{body}' to mocap bodies") in robot.inferred
    assert not any('left out: constraints' in said for said in load_robot(FILE).inferred)
