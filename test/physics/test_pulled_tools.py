# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Forces on a tool that are no contacts: cables, flexes, thrusters, wind, against Newton."""

import mujoco
import numpy as np
import pytest

from manip_sim.models import compose
from manip_sim.physics.uncollected_forces import UncollectedForces
from manip_sim.simulation import compiled_period, Simulation
from manip_sim.worlds import Worlds

#: Stiffness of the servo of the lift [N/m], damping of its joint [N s/m], what it moves [kg].
STIFFNESS, DAMPING, MOVED = 8000.0, 50.0, 2.0 + 0.5 + 0.04
WEIGHT = MOVED * 9.81

LIFT = """
<mujoco model="lift">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="base"><geom type="box" size="0.05 0.05 0.02"/>
      <site name="anchor" pos="0.3 0 1.5"/><site name="rail" pos="0.02 0 0.5"/>{world}
      <body name="carriage" pos="0 0 1">
        <joint name="lift" type="slide" axis="0 0 1" range="-0.4 0.4" damping="50" armature="1"/>
        <geom type="box" size="0.03 0.03 0.03" mass="2" contype="0" conaffinity="0"/>
        <body name="hand" pos="0 0 -0.05">
          <geom type="box" size="0.02 0.02 0.02" mass="0.5" contype="0" conaffinity="0"/>
          <site name="hook" pos="0.02 0 0"/><site name="inner"/>{tool}
          <body name="left_finger" pos="0 0.02 -0.03">
            <joint name="left_finger" type="slide" axis="0 1 0" range="0 0.02" damping="5"
                   armature="0.05"/>
            <geom size="0.005" mass="0.02" contype="0" conaffinity="0"/><site name="tip"/>
          </body>
          <body name="right_finger" pos="0 -0.02 -0.03">
            <joint name="right_finger" type="slide" axis="0 -1 0" range="0 0.02" damping="5"
                   armature="0.05"/>
            <geom size="0.005" mass="0.02" contype="0" conaffinity="0"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>{tendon}</tendon><deformable>{flex}</deformable><equality>{equality}</equality>
  <actuator>
    <position name="lift" joint="lift" kp="8000" kv="400" inheritrange="1"
              forcerange="-500 500"/>
    <position name="left_finger" joint="left_finger" kp="200" kv="10" inheritrange="1"/>
    <position name="right_finger" joint="right_finger" kp="200" kv="10" inheritrange="1"/>
    {actuator}
  </actuator>
</mujoco>"""
NOTHING = dict.fromkeys(('world', 'tool', 'tendon', 'flex', 'equality', 'actuator'), '')
CABLE = '<site site="anchor"/><site site="hook"/>'
CUP = ('<body name="cup" pos="0 0 -0.05">'
       '<geom name="cup" type="cylinder" size="0.02 0.01" mass="0" margin="0.002"/></body>')
SUCTION = '<adhesion name="pull" body="cup" ctrlrange="0 1" gain="50"/>'
POST = '<site name="post" pos="0.02 0 0.94"/>'
LUG = '<body name="lug" pos="0.02 0 0"/>'
EDGE = ('<flex name="cord" dim="1" body="base lug" vertex="0.3 0 1.5  0 0 0" element="0 1">'
        '<contact contype="0" conaffinity="0"/>{}</flex>')
#: MJCF, control of the actuator ``pull``, least force on the tool [N].
CASES = {
    'spring cable': ({'tendon': f'<spatial stiffness="20" springlength="0.1">{CABLE}</spatial>'},
                     None, 5.0),
    'winch': ({'tendon': f'<spatial name="cable">{CABLE}</spatial>',
               'actuator': '<motor name="pull" tendon="cable" ctrlrange="-50 0"/>'}, -20.0, 10.0),
    'winch over a pulley': ({
        'tendon': f'<spatial name="cable"><site site="rail"/><site site="anchor"/>'
                  f'<pulley divisor="2"/>{CABLE}</spatial>',
        'actuator': '<motor name="pull" tendon="cable" ctrlrange="-50 0"/>'}, -40.0, 10.0),
    'winch that is a servo': ({
        'tendon': f'<spatial name="cable">{CABLE}</spatial>',
        'actuator': '<position name="pull" tendon="cable" kp="50" kv="5" ctrlrange="0 1"/>'},
        0.1, 10.0),
    'cable at its end': ({'tendon': f'<spatial range="0 0.6">{CABLE}</spatial>'}, None, 20.0),
    'damped cable': ({'tendon': f'<spatial damping="30">{CABLE}</spatial>'}, None, 0.0),
    'thruster': ({'actuator': '<motor name="pull" site="hook" gear="0 0 1 0 0 0.1" '
                              'ctrlrange="-20 20"/>'}, 10.0, 9.0),
    'thruster against the base': ({
        'actuator': '<motor name="pull" site="rail" refsite="hook" gear="0 0 1 0 0 0" '
                    'ctrlrange="-20 20"/>'}, 10.0, 9.0),
    'slider-crank': ({
        'world': '<site name="slider" pos="0.02 0.1 1.2"/>',
        'actuator': '<motor name="pull" slidersite="slider" cranksite="hook" cranklength="0.5" '
                    'ctrlrange="-20 20"/>'}, 10.0, 5.0),
    'suction': ({'tool': CUP, 'actuator': SUCTION}, 1.0, 4.8),
    'connect': ({'world': POST, 'equality': '<connect site1="hook" site2="post"/>'}, None, 1.0),
    'flex': ({'tool': LUG, 'flex': EDGE.format('<edge stiffness="200"/>')}, None, 3.0),
    'flex of a fixed length': ({'tool': LUG, 'flex': EDGE.format(''),
                                'equality': '<flex flex="cord"/>'}, None, 10.0),
    'wind': ({}, None, 0.5),
}
#: Where the lift goes to, if not to zero [m]; there it is fixed.
GOALS = {'connect': 0.02, 'flex': -0.02, 'flex of a fixed length': -0.02}
FIXED = ('connect', 'flex of a fixed length')
#: The wind blows at the carriage too.
OF_TOOL = [case for case in CASES if case != 'wind']


def simulation_of(tmp_path, case, **options):
    """Return a simulation of a lift, and the index of its control, if it has one."""
    parts, control, _ = CASES[case]
    path = tmp_path / 'lift.xml'
    path.write_text(LIFT.format_map(
        NOTHING | parts))
    load = {'name': 'load', 'shape': 'box', 'size': [0.06, 0.06, 0.02], 'mass': 0.5,
            'position': [0.0, 0.0, 0.8788]}
    simulation = Simulation(compose(str(path), objects=[load] * (case == 'suction'), **options))
    if case == 'wind':
        simulation.model.opt.density, simulation.model.opt.viscosity = 1.2, 0.1
        simulation.model.opt.wind[:] = 3.0, 0.0, -12.0
    found = [index for index in range(simulation.model.nu)
             if simulation.model.actuator(index).name.endswith('pull')]
    if found:
        simulation.data.ctrl[found[0]] = control
    return simulation


def axial(simulation):
    """Return the external force along the lift and the effort of its motor [N]."""
    state = simulation.robot.state()
    names = simulation.robot.joint_names
    return (state.end_effectors['right'].external_wrench.force[2],
            state.effort[[name.endswith('lift') for name in names].index(True)])


@pytest.mark.full
@pytest.mark.parametrize('case', OF_TOOL)
def test_what_pulls_at_a_tool_is_what_bends_the_servo_at_rest(tmp_path, case):
    simulation = simulation_of(tmp_path, case)
    goal = GOALS.get(case, 0.0)
    if goal:
        simulation.robot.apply(*simulation.robot.parse.joint_command(['robot0_lift'], [goal]))
    for _ in range(400):
        simulation.advance(5)
    assert np.abs(simulation.data.joint('robot0_lift').qvel[0]) < 1e-3
    force, effort = axial(simulation)
    felt = STIFFNESS * (simulation.data.joint('robot0_lift').qpos[0] - goal)
    assert force == pytest.approx(felt, abs=0.01 + 0.002 * abs(felt))
    assert abs(force) >= CASES[case][2]
    assert effort == pytest.approx(WEIGHT - felt, abs=0.01 + 0.002 * abs(felt))


@pytest.mark.full
@pytest.mark.parametrize('case', OF_TOOL)
def test_effort_and_external_force_are_what_moves_the_lift(tmp_path, case):
    simulation = simulation_of(tmp_path, case)
    lift = simulation.data.joint('robot0_lift')
    # With the mass of a compiled model, as a cup of no mass gets a little.
    moved = float(np.ravel(simulation.model.dof_armature)[0]) + float(
        simulation.model.body_subtreemass[simulation.model.body('robot0_carriage').id])
    for _ in range(20):
        simulation.advance(5)
    simulation.robot.apply(*simulation.robot.parse.joint_command(['robot0_lift'], [0.05]))
    speeds, errors = [], []
    for _ in range(250):
        before = lift.qvel[0]
        simulation.advance(1)
        force, effort = axial(simulation)
        needed = moved * (lift.qvel[0] - before) / simulation.timestep_s + WEIGHT + (
            DAMPING * lift.qvel[0])
        errors.append(abs(effort + force - needed))
        speeds.append(abs(lift.qvel[0]))
    assert max(speeds) > (0.001 if case in FIXED else 0.05)
    # A damper of a cable acts with the velocity at the end of a step, MuJoCo tells that before.
    assert max(errors) < (2.0 if case in ('damped cable', 'winch that is a servo') else 0.02)


@pytest.mark.parametrize('tendon', [
    '<spatial stiffness="50" springlength="0.01"><site site="inner"/><site site="tip"/></spatial>',
    '<spatial stiffness="9" springlength="0.1"><site site="rail"/><site site="anchor"/></spatial>',
    '<fixed stiffness="50" springlength="0.01"><joint joint="lift" coef="0"/>'
    '<joint joint="left_finger" coef="1"/></fixed>'])
def test_a_tendon_of_the_tool_or_the_base_alone_is_no_external_force(
        tmp_path, monkeypatch, tendon):
    monkeypatch.setitem(CASES, 'inner', ({'tendon': tendon}, None, 0.0))
    simulation = simulation_of(tmp_path, 'inner')
    for _ in range(100):
        simulation.advance(5)
    wrench = simulation.robot.state().end_effectors['right'].external_wrench
    np.testing.assert_allclose([*wrench.force, *wrench.torque], 0.0, atol=1e-9)


def test_a_tendon_is_the_effort_of_a_joint_without_another_drive(tmp_path):
    compiled_period.load()  # There is no room for compiled code to note such efforts.
    parts = {'tendon': '<spatial name="cord"><site site="inner"/><site site="tip"/></spatial>',
             'actuator': '<motor name="pull" tendon="cord" ctrlrange="-9 0"/>'}
    path = tmp_path / 'hand.xml'
    text = LIFT.format_map(
        NOTHING | parts)
    for driven in (True, False):
        servo = ('<position name="left_finger" joint="left_finger" kp="200" kv="10" '
                 'inheritrange="1"/>')
        path.write_text(text if driven else text.replace(servo, ''))
        simulation = Simulation(compose(str(path)))
        winch = next(index for index in range(simulation.model.nu)
                     if simulation.model.actuator(index).name.endswith('pull'))
        simulation.data.ctrl[winch] = -2.0
        for _ in range(20):
            simulation.advance(5)
        index = [name.endswith('left_finger') for name in simulation.robot.joint_names].index(True)
        effort = simulation.robot.state().effort[index]
        finger = simulation.data.joint(simulation.robot.joint_names[index])
        dof = simulation.model.joint(finger.name).dofadr[0]
        pulled = -simulation.data.ten_J[list(simulation.model.ten_J_colind).index(dof)] * 2.0
        assert abs(pulled) > 0.5
        if driven:
            servo = next(index for index in range(simulation.model.nu)
                         if simulation.model.actuator(index).name.endswith('left_finger'))
            pulled = simulation.data.actuator_force[servo]
        assert effort == pytest.approx(pulled, abs=0.02)


FREE_TOOL = """
<mujoco>
  <option density="1.2" viscosity="0.3" wind="4 -2 1"/>
  <worldbody>
    <site name="post" pos="0.5 0.4 1.3" euler="20 30 40"/>
    <body name="table" pos="0 0 0.6"><geom type="box" size="0.5 0.5 0.05"/></body>
    <body name="tool" pos="0 0 0.72"><freejoint/>
      <geom type="box" size="0.05 0.04 0.065" mass="1" margin="0.02" {fluid}/>
      <site name="ft" pos="0.01 0.02 0.03"/><site name="hook" pos="0.1 0 0.05" euler="10 50 -30"/>
      <body name="finger" pos="0.1 0 0"><joint axis="0 1 0" name="finger"/>
        <geom type="capsule" size="0.01 0.03" mass="0.2" {fluid}/>
        <site name="tip" pos="0 0 0.04"/></body>
    </body>
  </worldbody>
  <actuator>{actuator}</actuator>
</mujoco>"""
GEAR = 'gear="1 -2 3 0.1 0.2 -0.3"'


@pytest.mark.parametrize('fluid', ['', 'fluidshape="ellipsoid"'])
@pytest.mark.parametrize('actuator', [
    f'<general site="tip" {GEAR}/>', '<general site="hook" refsite="post" gear="1 -2 3 0 0 0"/>',
    '<general site="post" refsite="hook" gear="0 0 0 0.1 0.2 -0.3"/>',
    f'<general site="tip" refsite="hook" {GEAR}/>',
    '<general cranksite="hook" slidersite="post" cranklength="0.7" gear="2"/>',
    '<general cranksite="post" slidersite="tip" cranklength="1.2" gear="2"/>',
    '<general cranksite="post" slidersite="tip" cranklength="0.1" gear="2"/>',
    '<adhesion body="tool" ctrlrange="0 1" gain="7"/>',
    '<adhesion body="table" ctrlrange="0 1" gain="7"/>', ''])
def test_what_mujoco_does_not_collect_is_what_it_projects_on_a_free_tool(actuator, fluid):
    model = mujoco.MjModel.from_xml_string(FREE_TOOL.format(actuator=actuator, fluid=fluid))
    data = mujoco.MjData(model)
    generator = np.random.default_rng(3)
    for trial in range(5):
        data.qpos[:3] = [0.0, 0.0, 0.72] + 0.001 * generator.normal(size=3)
        data.qpos[3:7] = [1.0, 0.0, 0.0, 0.0] if trial == 0 else generator.normal(size=4)
        mujoco.mju_normalize4(data.qpos[3:7])
        data.qvel[:] = generator.normal(size=model.nv)
        data.ctrl[:] = 1.0
        mujoco.mj_forward(model, data)
        if 'adhesion' in actuator and trial == 0:
            assert data.ncon
        tool = UncollectedForces.of(model, slice(2, 4))
        wrench = tool.wrench(model, data)
        wanted = data.qfrc_fluid + data.qfrc_actuator
        at_tool = wrench.copy()
        at_tool[3:] -= np.cross(data.body('tool').xpos, wrench[:3])
        at_tool[3:] = data.body('tool').xmat.reshape(3, 3).T @ at_tool[3:]
        np.testing.assert_allclose(at_tool, wanted[:6], atol=1e-9)
    assert np.abs(data.qfrc_fluid[:3]).max() > 0.01


@pytest.mark.full
def test_many_worlds_feel_what_one_does_to_the_last_bit(tmp_path):
    for case in ('winch', 'thruster', 'suction', 'wind'):
        one = simulation_of(tmp_path, case)
        many = Worlds(one.world, 3)
        for world in many.simulations:
            world.data.ctrl[:], world.model.opt.wind[:] = one.data.ctrl, one.model.opt.wind
            world.model.opt.density = one.model.opt.density
            world.model.opt.viscosity = one.model.opt.viscosity
        for _ in range(30):
            one.advance(5)
            many.advance(5)
        end = one.robot.state().end_effectors['right'].external_wrench
        ends = many.robot.state().end_effectors['right'].external_wrench
        assert end.force.any()
        for force, torque in zip(ends.force, ends.torque):
            assert (force.tobytes(), torque.tobytes()) == (
                end.force.tobytes(), end.torque.tobytes())


FLEX_CONTACTS = {
    'a strip of the tool on a shelf': (
        {'world': '<geom name="shelf" type="box" size="0.1 0.1 0.01" pos="0 0 0.85"/>',
         'tool': '<flexcomp name="strip" type="grid" count="4 1 1" spacing="0.02 0.02 0.02"'
                 ' dim="1" pos="0 0 -0.06" mass="1" radius="0.004"><pin id="0"/>'
                 '<edge equality="true"/><contact selfcollide="none"/></flexcomp>'}, ''),
    'the tool on a cloth': (
        {'tool': '<geom size="0.02" mass="0"/>'},
        '<body name="frame" pos="0 0 0.92"><flexcomp name="cloth" type="grid" count="3 3 1"'
        ' dim="2" spacing="0.1 0.1 0.1" mass="0.2" radius="0.004"><edge equality="true"/>'
        '<pin id="0 2 6 8"/><contact selfcollide="none"/></flexcomp></body>')}


@pytest.mark.parametrize('case', FLEX_CONTACTS)
def test_contacts_with_flexes_push_at_a_tool(tmp_path, case):
    parts, arena = FLEX_CONTACTS[case]
    (tmp_path / 'lift.xml').write_text(LIFT.format_map(NOTHING | parts))
    (tmp_path / 'arena.xml').write_text(f'<mujoco><worldbody>{arena}</worldbody></mujoco>')
    simulation = Simulation(compose(str(tmp_path / 'lift.xml'), arena=str(tmp_path / 'arena.xml'),
                                    timestep_s=0.001))
    simulation.robot.apply(*simulation.robot.parse.joint_command(['robot0_lift'], [-0.08]))
    for _ in range(200):
        simulation.advance(5)
    lift = simulation.data.joint('robot0_lift')
    assert simulation.data.ncon and abs(lift.qvel[0]) < 1e-3
    felt = STIFFNESS * (lift.qpos[0] + 0.08)
    force, _ = axial(simulation)
    assert felt > 4.0
    assert force == pytest.approx(felt, abs=0.01 + 0.002 * felt)


def test_forces_within_a_flex_of_the_tool_are_no_external_force(tmp_path):
    strip = FLEX_CONTACTS['a strip of the tool on a shelf'][0]['tool']
    (tmp_path / 'lift.xml').write_text(LIFT.format_map(NOTHING | {'tool': strip}))
    simulation = Simulation(compose(str(tmp_path / 'lift.xml'), timestep_s=0.001))
    for _ in range(100):
        simulation.advance(5)
    wrench = simulation.robot.state().end_effectors['right'].external_wrench
    np.testing.assert_allclose([*wrench.force, *wrench.torque], 0.0, atol=1e-9)


TRIANGLE = """
<mujoco>
  <worldbody>
    <body name="tool" pos="0 0 1"><freejoint/>
      <geom size="0.01" mass="1" contype="0" conaffinity="0"/></body>
    <body pos="0.1 0 1"><freejoint/><geom size="0.01" contype="0" conaffinity="0"/>
      <body name="second"/></body>
    <body name="third" pos="0 0.1 1"><freejoint/>
      <geom size="0.01" contype="0" conaffinity="0"/></body>
    <body pos="0.03 0.04 1.018"><freejoint/><geom size="0.015" mass="0.2"/></body>
  </worldbody>
  <deformable>
    <flex name="patch" dim="2" body="tool second third" radius="0.005"
          vertex="0.01 0 0  0 0 0  0 0 0" element="0 1 2"><contact selfcollide="none"/></flex>
    <flex name="cord" dim="1" body="third tool" vertex="0 0 0  0 0.01 0" element="0 1">
      <edge stiffness="50" damping="2"/><contact contype="0" conaffinity="0"/></flex>
  </deformable>
  <equality><flex flex="patch"/></equality>
</mujoco>"""


def test_what_a_flex_does_is_what_mujoco_projects_on_a_free_tool():
    model = mujoco.MjModel.from_xml_string(TRIANGLE)
    data, generator = mujoco.MjData(model), np.random.default_rng(3)
    for _ in range(5):
        mujoco.mj_resetData(model, data)
        data.qpos[:2] += 0.005 * generator.normal(size=2)
        data.qvel[:] = 0.1 * generator.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        assert data.ncon and (data.contact.elem >= 0).any()
        wrench = UncollectedForces.of(model, slice(1, 2)).wrench(model, data)
        place, rotation = data.body('tool').xpos, data.body('tool').xmat.reshape(3, 3)
        at_tool = [*wrench[:3], *(rotation.T @ (wrench[3:] - np.cross(place, wrench[:3])))]
        wanted = (data.qfrc_constraint + data.qfrc_spring + data.qfrc_damper)[:6]
        assert np.abs(data.qfrc_spring[:3]).max() > 0.01
        np.testing.assert_allclose(at_tool, wanted, atol=1e-9)
