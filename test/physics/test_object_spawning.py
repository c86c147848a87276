# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of adding objects to a world that runs, and of deleting them."""

import copy
import gc
import math
import weakref

import mujoco
from mujoco.introspect import structs
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.object_creation import create_object, ObjectModel
from manip_sim.physics.object_spawning import (
    carry_over, delete, plan_with, plan_without, plan_world, spawn, start_live)
from manip_sim.simulation import Simulation

FAR = [3.0, 3.0, 5.0]


def box(name='box', position=FAR, **more):
    return create_object({'name': name, 'shape': 'box', 'size': [0.1] * 3, 'mass': 1.0,
                          'position': position, **more})


# ---------------------------------------------------------------------- with a Simulation


def follow_a_sine(simulation, seconds, changes=(), grip=True):
    """
    Let an arm follow a sine at 100 Hz and a gripper close; return all that is published.

    :param changes: what to do before a period, by its number
    :param grip: whether the gripper closes
    """
    joints = list(simulation.robot.parts['arm'].driven_joints)
    middle = np.array([simulation.data.joint(joint).qpos[0] for joint in joints])
    told = []
    for period in range(round(seconds * 100)):
        if period in dict(changes):
            dict(changes)[period]()
        swing = 0.3 * np.sin(np.pi * simulation.time_s)
        simulation.robot.apply(*simulation.robot.parse.joint_command(
            joints, position=(middle + swing).tolist()), period_s=0.01)
        if grip and period == 20:
            simulation.robot.apply(simulation.robot.parse.action('right/gripper', [1.0]))
        simulation.advance(5)
        state = simulation.robot.state()
        arm = state.end_effectors['right']
        told.append(np.concatenate([
            state.position, state.velocity, state.effort, arm.pose.position, arm.pose.quat_xyzw,
            arm.wrench.force, arm.wrench.torque, arm.external_wrench.force]))
    return np.array(told)


def spawned_and_deleted(objects, item, **options):
    """Return what is published without a spawn, and with one at 0.5 s and a delete at 2.5 s."""
    told = []
    for changes in (False, True):
        world = compose('Panda', arena='table', cube=False, objects=objects)
        simulation = Simulation(world)

        def come(simulation=simulation):
            simulation.change_objects(plan_with(simulation.plan, item))

        def go(simulation=simulation):
            simulation.change_objects(plan_without(simulation.plan, item.name))

        told.append(follow_a_sine(simulation, 4.5, {50: come, 250: go} if changes else (),
                                  **options))
    return told


@pytest.mark.full
@pytest.mark.parametrize('place', [FAR, [3.0, 3.0, 0.05]], ids=['falling', 'lying'])
def test_arm_moves_on_bit_for_bit_when_a_box_comes_and_goes(place):
    cube = box('cube', [0.1, 0.1, 0.85])
    alone, with_box = spawned_and_deleted([cube], box(position=place))
    np.testing.assert_array_equal(with_box, alone)


@pytest.mark.full
def test_arm_that_is_alone_moves_on_but_for_rounding():
    # MuJoCo solves the constraints of a world with one tree at once, else island by island.
    alone, with_box = spawned_and_deleted([], box(), grip=False)
    np.testing.assert_array_equal(with_box[:50], alone[:50])
    joints = slice(0, 18)  # Position and velocity of nine joints.
    np.testing.assert_allclose(with_box[:, joints], alone[:, joints], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(with_box, alone, rtol=0.0, atol=1e-9)


def test_a_lying_can_that_was_spawned_does_not_creep():
    simulation = Simulation(compose(arena='table', cube=False))
    can = create_object({'name': 'can', 'shape': 'cylinder', 'size': [0.03, 0.06], 'mass': 0.3,
                         'position': [0.1, 0.1, 0.831], 'rpy': [math.pi / 2.0, 0.0, 0.3]})
    simulation.change_objects(plan_with(simulation.plan, can))
    simulation.advance(1000)
    before = simulation.data.body('can').xpos.copy()
    simulation.advance(1000)
    creep_m_per_min = 30.0 * np.linalg.norm(simulation.data.body('can').xpos - before)
    assert creep_m_per_min < 1e-4


def test_an_object_that_was_spawned_goes_back_to_its_place_with_a_reset():
    world = compose('Panda', arena='table', cube=False)
    simulation = Simulation(world)
    simulation.change_objects(plan_with(simulation.plan, box(position=[3.0, 3.0, 1.0])))
    for _ in range(50):
        simulation.advance(5)
    assert simulation.data.body('box').xpos[2] < 0.5
    simulation.reset()
    np.testing.assert_array_equal(simulation.data.body('box').xpos, [3.0, 3.0, 1.0])


def test_nothing_keeps_the_model_of_before_in_memory():
    simulation = Simulation(compose('Panda', arena='table', cube=False))
    simulation.advance(5)
    before = weakref.ref(simulation.model)
    simulation.change_objects(plan_with(simulation.plan, box()))
    gc.collect()
    assert before() is None


def test_what_a_simulation_set_in_its_model_is_carried():
    world = compose('Panda', arena='table', cube=False)
    simulation = Simulation(world)
    simulation.robot.set_control_mode('arm', 'effort')
    simulation.robot.apply(*simulation.robot.parse.joint_command(
        list(simulation.robot.parts['arm'].driven_joints), effort=[0.0] * 7))
    simulation.advance(5)
    before = simulation.model
    edited = [name for name, old, new in arrays(simulation.plan.compiled, before)
              if old.tobytes() != new.tobytes()]
    assert 'actuator_gainprm' in edited
    simulation.change_objects(plan_with(simulation.plan, box()))
    assert simulation.model is not before
    for name in edited:
        new, old = getattr(simulation.model, name), getattr(before, name)
        np.testing.assert_array_equal(new[:len(old)], old, err_msg=name)
    assert simulation.model.opt.disableflags == before.opt.disableflags
    assert before.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


# ---------------------------------------------------------------------- with a world by hand

WORLD = """
<mujoco>
  <option gravity="0 0 -1"/>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="0 0 1"/>
    <body name="hand" mocap="true" pos="1 1 2"><geom size="0.05" contype="0"/></body>
    <body name="arm" pos="0 0 1">
      <joint name="hinge" axis="0 1 0" damping="0.1"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/>
      <body name="wrist" pos="0.3 0 0">
        <joint name="ball" type="ball"/><geom size="0.04" pos="0.05 0 0"/><site name="tip"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <weld name="held" body1="wrist" body2="hand" active="false"/><joint joint1="hinge"/>
  </equality>
  <tendon><fixed><joint joint="hinge" coef="2"/></fixed></tendon>
  <actuator>
    <motor name="push" joint="hinge"/>
    <general name="slow" joint="hinge" dyntype="filter" dynprm="0.5" gainprm="2"/>
  </actuator>
  <sensor><force site="tip"/></sensor>
</mujoco>"""


#: An object with what a spec can have beside shapes.
CART = """
<mujoco>
  <default><default class="wheel"><geom size="0.05" rgba="1 0 0 1"/></default></default>
  <asset>
    <material name="red" rgba="1 0 0 1"/>
    <mesh name="wedge" vertex="0 0 0 0.1 0 0 0 0.1 0 0 0 0.1"/>
  </asset>
  <worldbody>
    <body name="cart"><geom type="mesh" mesh="wedge" material="red"/>
      <body name="front" pos="0.2 0 0"><joint axis="0 1 0"/><geom class="wheel"/><site/></body>
    </body>
  </worldbody>
  <contact><exclude body1="cart" body2="front"/></contact>
</mujoco>"""


def arrays(*models):
    """Yield the name of each array of models and the arrays."""
    for field in structs.STRUCTS['mjModel'].fields:
        found = [getattr(model, field.name, None) for model in models]
        if all(isinstance(array, np.ndarray) for array in found):
            yield (field.name, *found)


@pytest.fixture
def live():
    """Return a world of an arm and two boxes in which everything is something else than zero."""
    plan = plan_world(mujoco.MjSpec.from_string(WORLD),
                      (box('first', [2.0, 0.0, 2.0]), box('second', [-2.0, 0.0, 2.0])))
    live = start_live(plan)
    model, data = live.model, live.data
    model.actuator_gainprm[1, 0] = 3.0
    model.geom('second').friction[0] = 0.3
    model.tendon_stiffness[0] = 0.7
    model.opt.gravity[:] = [0.1, 0.2, -3.0]
    model.vis.map.znear = 0.02
    data.ctrl[:] = [0.3, 0.4]
    data.eq_active[:] = [1, 0]
    data.mocap_pos[0] = [0.9, 1.1, 2.0]
    data.qfrc_applied[:] = np.linspace(0.1, 0.2, model.nv)
    data.body('second').xfrc_applied[:] = [0.3, 0.2, 0.1, 0.0, 0.1, 0.2]
    mujoco.mj_step(model, data, 100)
    mujoco.mj_forward(model, data)
    data.warning[0].number = 2
    return live


def state_of(live, *bodies):
    """Return everything of the state that belongs to the arm and to some free bodies."""
    model, data = live.model, live.data
    joints = ['hinge', 'ball', *(f'{name}_joint' for name in bodies)]
    numbers = [getattr(data.joint(joint), field) for joint in joints for field in (
        'qpos', 'qvel', 'qfrc_applied', 'qacc_warmstart', 'qacc')]
    numbers += [data.body(name).xfrc_applied for name in ('wrist', *bodies)]
    numbers += [data.act, data.ctrl, data.eq_active, data.mocap_pos, [data.time],
                [data.warning[0].number], model.opt.gravity, [model.vis.map.znear],
                model.actuator_gainprm[:, 0], model.tendon_stiffness, data.sensordata,
                [model.stat.meaninertia, model.stat.extent]]
    numbers += [model.geom(name).friction for name in bodies]
    return np.concatenate([np.ravel(number).astype(float) for number in numbers])


def test_deleting_one_object_leaves_the_next_one_in_motion(live):
    before = copy.copy(live.data)
    left = delete(live, 'first')
    assert left.plan.object_names == ['second']
    np.testing.assert_array_equal(state_of(left, 'second'), state_of(live, 'second'))
    with pytest.raises(KeyError):
        left.model.body('first')
    # What was given is as it was.
    assert live.model.body('first').id and live.data.qpos.tobytes() == before.qpos.tobytes()


def test_a_new_object_comes_last_and_starts_at_its_place(live):
    grown = spawn(live, box('third', [0.0, 2.0, 1.0]))
    assert grown.model.body('third').id == live.model.nbody
    np.testing.assert_array_equal(state_of(grown, 'first', 'second'),
                                  state_of(live, 'first', 'second'))
    np.testing.assert_array_equal(grown.data.joint('third_joint').qpos, [0, 2, 1, 1, 0, 0, 0])
    assert not grown.data.joint('third_joint').qvel.any()


def test_rows_of_what_was_there_are_the_same_in_every_array_of_a_grown_model(live):
    moved = {  # What counts or sums over the world, and where names are.
        'body_subtreemass', 'dof_simplenum', 'light_poscom0', 'names_map'}
    grown = spawn(live, box('third', [0.0, 2.0, 1.0])).model
    for name, old, new in arrays(live.model, grown):
        if name in moved or name.startswith(('name_', 'B_', 'body_bvh', 'bvh_', 'key_')):
            continue
        np.testing.assert_array_equal(new[:len(old)], old, err_msg=name)


@pytest.mark.parametrize('robot', ['Panda', 'Sawyer'])
def test_what_mujoco_derives_of_a_robot_is_not_rounded_in_another_way(robot):
    live = start_live(plan_world(compose(robot, arena='table', cube=False).compose(), ()))
    grown = spawn(live, box())
    for name in ('body_invweight0', 'dof_invweight0', 'actuator_acc0'):
        old = getattr(live.model, name)
        assert getattr(grown.model, name)[:len(old)].tobytes() == old.tobytes(), name


def test_a_world_is_as_before_after_an_object_came_and_went(live):
    back = delete(spawn(live, box('third')), 'third')
    for name, old, new in arrays(live.model, back.model):
        np.testing.assert_array_equal(new, old, err_msg=name)
    assert back.plan.spec.to_xml() == live.plan.spec.to_xml()
    for _ in range(100):
        mujoco.mj_step(live.model, live.data)
        mujoco.mj_step(back.model, back.data)
    assert back.data.qpos.tobytes() == live.data.qpos.tobytes()


def test_a_world_that_grew_is_the_one_that_is_composed_at_once(live):
    kinds = (('sphere', 0.1), ('cylinder', [0.1, 0.2]), ('box', [0.1, 0.2, 0.3]))
    more = [create_object({'name': f'more{number}', 'shape': shape, 'size': size,
                           'position': [0.0, number, 3.0], 'friction': [0.7, 0.1]})
            for number, (shape, size) in enumerate(kinds)]
    more.append(ObjectModel('cart', mujoco.MjSpec.from_string(CART)))
    grown = live
    for item in more:
        grown = spawn(grown, item)
    whole = plan_world(live.plan.base, (*live.plan.objects, *more))
    assert grown.plan.spec.to_xml() == whole.spec.to_xml()
    for name, old, new in arrays(grown.plan.compiled, whole.compiled):
        np.testing.assert_array_equal(old, new, err_msg=name)


def test_a_name_that_an_object_gives_its_body_is_taken_for_those_after_it(live):
    named = create_object({'name': 'a_b', 'shape': 'sphere', 'size': 0.1})
    other = ObjectModel('a', mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="c"><freejoint/><geom size="1" name="b"/></body>'
        '</worldbody></mujoco>'))
    for spawned in (lambda: spawn(spawn(live, named), other),
                    lambda: plan_world(live.plan.base, (named, other))):
        with pytest.raises(ModelError, match="geom 'a_b' already exists"):
            spawned()


def test_a_plan_may_be_older_than_the_state_that_is_carried_over(live):
    plan = plan_with(live.plan, box('third'))
    mujoco.mj_step(live.model, live.data, 10)
    grown = carry_over(live, plan)
    assert grown.data.time == live.data.time
    np.testing.assert_array_equal(grown.data.joint('hinge').qpos, live.data.joint('hinge').qpos)


@pytest.mark.parametrize('name', ['first', 'arm'])
def test_a_name_that_is_taken_is_rejected_and_nothing_changes(live, name):
    before, xml = state_of(live, 'first', 'second'), live.plan.spec.to_xml()
    with pytest.raises(ModelError, match=f"'{name}'"):
        spawn(live, box(name))
    assert live.plan.object_names == ['first', 'second']
    assert live.plan.spec.to_xml() == xml
    np.testing.assert_array_equal(state_of(live, 'first', 'second'), before)


def test_an_object_that_does_not_compile_is_rejected_and_nothing_changes(live):
    item = box('third')
    item.spec.geoms[0].size[:] = 0.0
    with pytest.raises(ModelError, match="^the world with 'third' does not compile: .*size"):
        spawn(live, item)
    mujoco.mj_step(live.model, live.data)
    assert spawn(live, box('third')).plan.object_names == ['first', 'second', 'third']


def test_what_is_no_object_cannot_be_deleted(live):
    with pytest.raises(UnknownNameError, match="unknown object 'frist': did you mean 'first'"):
        delete(live, 'frist')
    with pytest.raises(UnknownNameError, match="unknown object 'arm': .*available: first, second"):
        delete(live, 'arm')


def test_a_name_can_be_used_again_with_another_object(live):
    other = create_object({'name': 'first', 'shape': 'sphere', 'size': 0.2, 'mass': 3.0,
                           'position': [0.0, 3.0, 2.0]})
    again = spawn(delete(live, 'first'), other)
    assert again.model.body('first').mass[0] == pytest.approx(3.0)
    assert again.model.geom('first').type[0] == int(mujoco.mjtGeom.mjGEOM_SPHERE)


@pytest.mark.full
def test_a_hundred_objects_come_and_go_without_a_trace(live):
    now, xml = live, live.plan.spec.to_xml()
    for number in range(100):
        now = delete(spawn(now, box(f'box{number}')), f'box{number}')
    assert now.plan.spec.to_xml() == xml
    assert len(now.plan.spec.frames) == len(live.plan.spec.frames)
    assert now.data.qpos.tobytes() == live.data.qpos.tobytes()


@pytest.mark.skipif(mujoco.mj_version() < 4000000, reason='MuJoCo 3 does not delete elements')
def test_objects_that_stay_are_not_attached_again(live, monkeypatch):
    grown = plan_with(live.plan, box('third'))

    def attach(*_):
        raise AssertionError('another object was attached')

    monkeypatch.setattr(ObjectModel, 'attach', attach)
    less = plan_without(grown, 'second')
    assert less.object_names == ['first', 'third']
    monkeypatch.undo()
    assert less.spec.to_xml() == plan_with(plan_without(live.plan, 'second'), box('third')
                                           ).spec.to_xml()


def test_an_object_to_be_seen_comes_again_after_it_was_deleted(live):
    ghost = create_object({'name': 'ghost', 'shape': 'sphere', 'size': 0.1, 'visual': True})
    plan = live.plan
    for _ in range(2):
        plan = plan_with(plan, ghost)
        plan = plan_without(plan, 'ghost')
    assert plan.object_names == live.plan.object_names


def test_names_are_collected_once(live, monkeypatch):
    item = box('third')
    monkeypatch.delattr('manip_sim.models.spec_edits.TakenNames.__init__')
    grown = plan_with(live.plan, item)
    item.spec.bodies[1].name = 'arm'
    with pytest.raises(ModelError, match="'third'"):
        plan_with(grown, item)


@pytest.mark.parametrize('name', ['first', 'second', 'cart'])
def test_a_world_that_shrank_is_the_one_that_is_composed_at_once(live, name):
    grown = live
    for item in (ObjectModel('cart', mujoco.MjSpec.from_string(CART)), box('last')):
        grown = spawn(grown, item)
    left = delete(grown, name).plan
    whole = plan_world(live.plan.base, left.objects)
    assert left.spec.to_xml() == whole.spec.to_xml()
    for field, old, new in arrays(left.compiled, whole.compiled):
        np.testing.assert_array_equal(old, new, err_msg=field)
