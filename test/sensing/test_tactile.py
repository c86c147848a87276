# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tactile sensors on the pads of grippers."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError
from manip_sim.models import compose
from manip_sim.models.archive import load_archive
from manip_sim.models.grippers import create_gripper, gripper_names
from manip_sim.simulation import Simulation
from manip_sim.tasks import Setting

BALL_RADIUS_M, DEPTH_M = 0.03, 0.0006
WITH_PADS = [name for name in gripper_names()
             if name not in ('NullGripper', 'VacuumGripper', 'WipingGripper')]
FINGER = 'gripper0_finger1_pad'


def with_ball(gripper):
    """Return the model of a gripper beside a ball that floats, and its data."""
    spec = mujoco.MjSpec()
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_GRAVITY
    gripper.attach_to(spec, spec.worldbody.add_frame(pos=[0.1, 0.2, 0.3], euler=[20, 40, 60]))
    ball = spec.worldbody.add_body(name='ball', pos=[5, 0, 0])
    ball.add_freejoint(name='ball')
    ball.add_geom(name='ball', type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_RADIUS_M, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    for joint, position in zip(gripper.joints, np.broadcast_to(
            0.0 if gripper.init_qpos is None else gripper.init_qpos, len(gripper.joints))):
        data.qpos[model.joint(joint).qposadr[0]] = position
    mujoco.mj_forward(model, data)
    return model, data


def put_ball(model, data, position, velocity=(0, 0, 0)):
    """Move the ball, and evaluate all sensors."""
    joint = model.joint('ball')
    data.qpos[joint.qposadr[0]:][:3] = position
    data.qvel[joint.dofadr[0]:][:3] = velocity
    mujoco.mj_forward(model, data)


def points_of(model, data, name):
    """Return the points of a sensor in the world, from the mesh in its shape [m], shape (n, 3)."""
    geom = model.geom(name).id
    mesh = model.geom_dataid[geom]
    points = model.mesh_vert[model.mesh_vertadr[mesh]:][:model.mesh_vertnum[mesh]]
    return points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]


@pytest.mark.parametrize('name', WITH_PADS)
def test_each_pad_of_the_catalogue_feels_a_ball_where_it_is(name):
    gripper = create_gripper(name)
    added = gripper.add_tactile_sensors()
    assert len(added) == sum('touch' in sensor for sensor in gripper.sensors) > 1
    model, data = with_ball(gripper)
    for sensor in added:
        points = points_of(model, data, sensor)
        # A ball whose centre lies off the middle point, towards the grasp frame.
        place = points[len(points) // 3]
        centre = points.mean(axis=0)
        away = data.body(gripper.correct_naming('eef')).xpos - centre
        if 'pad' not in sensor:  # All around a phalanx: outward from its axis.
            away = place - centre
        centre = place + away / np.linalg.norm(away) * (BALL_RADIUS_M - DEPTH_M)
        put_ball(model, data, centre)
        depths = data.sensor(sensor).data.reshape(3, -1)[0]
        wanted = np.maximum(BALL_RADIUS_M - np.linalg.norm(points - centre, axis=1), 0.0)
        assert depths == pytest.approx(wanted, abs=1e-9)
        assert depths.max() >= DEPTH_M - 1e-9
    put_ball(model, data, [5, 0, 0])
    assert not any(data.sensor(sensor).data.any() for sensor in added)


@pytest.mark.parametrize('name', [name for name in WITH_PADS if not name.startswith('Fourier')])
def test_points_lie_in_a_grid_on_the_surface_of_the_pad(name):
    gripper = create_gripper(name)
    added = gripper.add_tactile_sensors()
    model, data = with_ball(gripper)
    for sensor in added:
        # Independent of the mesh: the pad is where the touch sensor is.
        site = data.site(sensor.replace('tactile', 'touch'))
        pads = [geom for geom in range(model.ngeom) if model.geom_contype[geom]
                and np.allclose(data.geom_xpos[geom], site.xpos, atol=3e-4)]
        assert len(pads) == 1
        local = (points_of(model, data, sensor) - data.geom_xpos[pads[0]]) @ (
            data.geom_xmat[pads[0]].reshape(3, 3))
        normal = int(np.argmin(np.ptp(local, axis=0)))
        half = model.geom_size[pads[0]]
        assert np.abs(local[:, normal]) == pytest.approx(half[normal], abs=1e-7)
        way = data.body(gripper.correct_naming('eef')).xpos - data.geom_xpos[pads[0]]
        inward = way @ data.geom_xmat[pads[0]].reshape(3, 3)
        assert (local[:, normal] * inward[normal] > 0.0).all()
        for axis in {0, 1, 2} - {normal}:
            lines = np.unique(local[:, axis].round(6))
            assert lines.mean() == pytest.approx(0.0, abs=1e-6)
            pitch = np.diff(lines)
            assert pitch == pytest.approx(2 * half[axis] / len(lines), abs=2e-6)
            assert 0.002 < pitch[0] < 0.006 or len(lines) == 2
        # Neighbours in the list are neighbours on the pad: rows, one after the other.
        second = max({0, 1, 2} - {normal})
        assert local[1, second] - local[0, second] > 1e-4


@pytest.mark.parametrize('velocity', [(0.1, 0.0, 0.0), (0.0, 0.0, -0.2), (0.03, 0.0, 0.04)])
def test_a_ball_that_slides_is_felt_along_both_tangents_of_the_pad(velocity):
    gripper = create_gripper('PandaGripper')
    gripper.add_tactile_sensors()
    model, data = with_ball(gripper)
    pad = data.geom('gripper0_finger1_pad_collision')
    rotation = pad.xmat.reshape(3, 3)
    put_ball(model, data, pad.xpos + rotation @ [0, -0.004 - BALL_RADIUS_M + DEPTH_M, 0],
             rotation @ velocity)
    depths, first, second = data.sensor(f'{FINGER}_tactile').data.reshape(3, -1)
    assert depths.any()
    assert first[depths > 0] == pytest.approx(abs(velocity[0]), abs=1e-6)
    assert second[depths > 0] == pytest.approx(abs(velocity[2]), abs=1e-6)


@pytest.mark.full
def test_a_grasp_is_felt_and_is_to_the_bit_the_same_without_tactile_sensors():
    states = []
    for composition in ({}, {'tactile': True}):
        episode = Setting('pick_cube', 'Panda', composition=composition).create_episode()
        assert episode.run(episode.task.expert(episode.simulation), 2)
        states.append(np.concatenate([episode.simulation.data.qpos, episode.simulation.data.qvel]))
    assert np.array_equal(*states)
    for finger in 'finger1', 'finger2':
        read = episode.simulation.sensors[f'gripper0_right_{finger}_pad_tactile'].reshape(3, 16)
        # The pad is in the cube as far as MuJoCo's contacts are, and does not slide.
        data = episode.simulation.data
        assert read[0].max() == pytest.approx(-data.contact.dist[:data.ncon].min(), abs=1e-4)
        assert read[0].min() > 0.0
        assert read[1:].max() < 0.01


def test_a_second_call_adds_nothing_and_a_copy_has_the_sensors():
    gripper = create_gripper('Robotiq85Gripper')
    names, sensors = gripper.add_tactile_sensors(), gripper.sensors
    assert len(names) == 2
    assert gripper.add_tactile_sensors() == names
    assert gripper.sensors == sensors
    twin = gripper.clone(1)
    assert len(twin.add_tactile_sensors()) == 2
    assert with_ball(twin)[0].nsensor == with_ball(gripper)[0].nsensor


@pytest.mark.full
def test_the_archive_of_a_world_has_the_same_points():
    world = compose('Panda', tactile=True)
    model, again = world.compile(), load_archive(world.to_archive())
    assert again.nsensordata == model.nsensordata
    assert again.mesh_vert == pytest.approx(model.mesh_vert, abs=1e-7)


def test_a_robot_on_two_arms_feels_with_both_hands():
    simulation = Simulation(compose('Baxter', tactile=True))
    assert sum(name.endswith('_tactile') for name in simulation.sensors) == 4


def test_a_gripper_that_has_the_sensors_already_is_as_good():
    gripper = create_gripper('PandaGripper')
    gripper.add_tactile_sensors()
    simulation = Simulation(compose('Panda', gripper, tactile=True))
    assert sum(name.endswith('_tactile') for name in simulation.sensors) == 2


@pytest.mark.parametrize(('parts', 'who'), [
    (('Panda', 'WipingGripper'), 'WipingGripper'), (('Panda', 'none'), 'Panda')])
def test_grippers_without_pads_are_rejected(parts, who):
    with pytest.raises(ModelError, match=rf"^'tactile' needs a gripper with .* {who}\S* has none"):
        compose(*parts, tactile=True)


HEIGHT_FIELD = """
<mujoco>
<asset><hfield name="hills" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 1 1 0"/></asset>
<worldbody><geom name="ground" type="hfield" hfield="hills"/></worldbody></mujoco>"""
FLEX = """
<mujoco><worldbody>
<flexcomp name="rope" type="grid" count="3 1 1" spacing=".1 .1 .1" mass=".1" dim="1" pos="2 0 1">
<edge equality="true"/></flexcomp></worldbody></mujoco>"""


@pytest.mark.parametrize(('text', 'shape'), [
    (HEIGHT_FIELD, "height field 'ground'"), (FLEX, "flex 'rope'")])
def test_worlds_with_shapes_that_tactile_sensors_cannot_feel_are_rejected(tmp_path, text, shape):
    file = tmp_path / 'place.xml'
    file.write_text(text)
    assert compose('Panda', arena=file).compile().nsensor
    with pytest.raises(ModelError, match=f'tactile sensors such as .* cannot feel {shape}'):
        compose('Panda', arena=file, tactile=True).compile()
