# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Inertia and weight about the hinge of a URDF against the sum of its links by Steiner."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip_sim.models import compose
from manip_sim.simulation import Simulation

H = np.pi / 2
GRAVITY = 9.81


def text_of(numbers):
    return ' '.join(f'{number!r}' for number in np.asarray(numbers, float).tolist())


def link(name, mass, tensor, xyz=(0, 0, 0), rpy=(0, 0, 0)):
    """Return a link, and the parameters of its inertial frame for the closed form."""
    pairs = {a + b: float(tensor[i][j]) for i, a in enumerate('xyz')
             for j, b in enumerate('xyz') if i <= j}
    numbers = ' '.join(f'i{pair}="{number!r}"' for pair, number in pairs.items())
    return (f'<link name="{name}"><inertial><origin xyz="{text_of(xyz)}" rpy="{text_of(rpy)}"/>'
            f'<mass value="{mass!r}"/><inertia {numbers}/></inertial></link>',
            (mass, np.asarray(tensor, float), np.asarray(xyz, float), np.asarray(rpy, float)))


def joint(name, kind, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=(1, 0, 0)):
    limit = '<limit lower="-3" upper="3" effort="200" velocity="50"/>'
    return (f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{text_of(xyz)}" rpy="{text_of(rpy)}"/><axis xyz="{text_of(axis)}"/>'
            f'{limit if kind == "revolute" else ""}</joint>')


def about_hinge(axis, links):
    """
    Return inertia about an axis through the origin, and the moment of mass, in the arm.

    :param links: parameters of the inertial frame, and pose (xyz, rpy) of the link in the arm
    """
    inertia, moment = 0.0, np.zeros(3)
    for (mass, tensor, centre, rpy), (place, turn) in links:
        rotation = Rotation.from_euler('xyz', turn).as_matrix()
        own = rotation @ Rotation.from_euler('xyz', rpy).as_matrix()
        arm = np.asarray(place, float) + rotation @ centre
        inertia += axis @ own @ tensor @ own.T @ axis + mass * np.square(np.cross(axis, arm)).sum()
        moment += mass * arm
    return inertia, moment


def random_tensor(random):
    """Return the inertia of six point masses, turned anyhow [kg m^2]."""
    points = random.normal(size=(6, 3)) * [0.1, 0.2, 0.35]
    turned = points @ Rotation.random(random_state=int(random.integers(1000))).as_matrix()
    return sum(np.eye(3) * (p @ p) - np.outer(p, p) for p in turned)


def pendulum(seed):
    """Return the parts of a URDF of an arm on a hinge with tools fixed on it, and the oracle."""
    random = np.random.default_rng(seed)
    poses = [(random.normal(size=3) * 0.2, random.uniform(-3, 3, 3)) for _ in range(6)]
    axis = Rotation.random(random_state=seed).as_matrix()[0]
    links = [link(name, float(random.uniform(0.5, 3.0)), random_tensor(random), *pose)
             for name, pose in zip(('base', 'arm', 'tool', 'tip'), poses)]
    # The frame of the hinge in the base may be turned anyhow; the tip is fixed on a fixed tool.
    joints = [joint('hinge', 'revolute', 'base', 'arm', *poses[3], axis=axis),
              joint('flange', 'fixed', 'arm', 'tool', *poses[4]),
              joint('end', 'fixed', 'tool', 'tip', *poses[5])]
    (_, arm), (_, tool), (_, tip) = links[1:]
    turn = Rotation.from_euler('xyz', poses[4][1])
    at_tip = (poses[4][0] + turn.apply(poses[5][0]),
              (turn * Rotation.from_euler('xyz', poses[5][1])).as_euler('xyz'))
    carried = [(arm, (np.zeros(3), np.zeros(3))), (tool, poses[4]), (tip, at_tip)]
    return ''.join([text for text, _ in links] + joints), axis, carried


def hinge_of(model, name):
    """Return the data at the start, and the inertia about a hinge, without its rotor [kg m^2]."""
    data = mujoco.MjData(model)
    model.body_gravcomp[:] = 0.0
    mujoco.mj_forward(model, data)
    dof = int(model.joint(name).dofadr[0])
    unit, column = np.zeros(model.nv), np.empty(model.nv)
    unit[dof] = 1.0
    mujoco.mj_mulM(model, data, column, unit)
    return data, column[dof] - model.dof_armature[dof], data.qfrc_bias[dof]


@pytest.mark.parametrize('how', ['robot', 'gripper'])
@pytest.mark.parametrize('seed', range(4))
def test_links_with_turned_inertial_frames_weigh_about_a_hinge_as_by_steiner(tmp_path, seed, how):
    parts, axis, carried = pendulum(seed)
    file = tmp_path / 'pendulum.urdf'
    file.write_text(f'<robot name="pendulum">{parts}</robot>')
    world = compose(str(file)) if how == 'robot' else compose('UR5e', gripper=str(file))
    model = world.compile(visual=False)
    name = next(model.joint(i).name for i in range(model.njnt)
                if model.joint(i).name.endswith('hinge'))
    data, inertia, held = hinge_of(model, name)
    expected, moment = about_hinge(axis, carried)
    assert inertia == pytest.approx(expected, rel=1e-6)
    rotation = data.xmat[model.joint(name).bodyid[0]].reshape(3, 3)
    upward = rotation.T @ [0, 0, GRAVITY]
    assert held == pytest.approx(axis @ np.cross(moment, upward), abs=1e-6)


def test_the_inertia_of_a_free_root_is_that_of_its_turned_frame(tmp_path):
    tensor = np.array([[1.0, 0.3, 0.1], [0.3, 2.0, 0.2], [0.1, 0.2, 2.5]])
    root, _ = link('body', 2.0, tensor, rpy=(0.4, -0.7, 1.9))
    arm, _ = link('arm', 0.5, np.eye(3) * 0.01)
    file = tmp_path / 'walker.urdf'
    file.write_text(f'<robot name="walker"><link name="world"/>{root}{arm}'
                    f'{joint("free", "floating", "world", "body")}'
                    f'{joint("hinge", "revolute", "body", "arm", xyz=(0, 0, 0.1))}</robot>')
    model = compose(str(file)).compile(visual=False)
    body = next(i for i in range(model.nbody) if model.body(i).name.endswith('_body'))
    frame = np.empty(9)
    mujoco.mju_quat2Mat(frame, model.body_iquat[body])
    frame, own = frame.reshape(3, 3), Rotation.from_euler('xyz', (0.4, -0.7, 1.9)).as_matrix()
    assert frame @ np.diag(model.body_inertia[body]) @ frame.T == pytest.approx(
        own @ tensor @ own.T, abs=1e-9)


def test_a_torque_accelerates_a_tool_with_a_turned_inertial_frame_by_its_inertia(tmp_path):
    base, arm = '<link name="base"/>', link('arm', 1.0, np.eye(3) * 0.5)[0]
    tool = link('tool', 2.0, np.diag([0.1, 0.1, 0.05]), xyz=(0.1, 0, 0), rpy=(0, H, 0))[0]
    file = tmp_path / 'arm.urdf'
    file.write_text(f'<robot name="arm">{base}{arm}{tool}'
                    + joint('hinge', 'revolute', 'base', 'arm', axis=(0, 0, 1))
                    + joint('flange', 'fixed', 'arm', 'tool', (0, 0.3, 0), (0, 0, H)) + '</robot>')
    simulation = Simulation(compose(str(file)))
    robot, (name,) = simulation.robot, simulation.robot.joint_names
    robot.set_control_mode('arm', 'effort')
    dof = int(simulation.model.joint(name).dofadr[0])
    rotor, drag = simulation.model.dof_armature[dof], simulation.model.dof_damping[dof].max()
    speeds = []
    for _ in range(2):
        robot.apply(*robot.parse.joint_command([name], effort=[1.0]))
        simulation.advance(5)
        speeds.append(robot.state().velocity[0])
    # Turned about y by a right angle, the tool has 0.1 about z; its centre is at 0, 0.4, 0.
    inertia = 0.5 + 0.1 + 2.0 * 0.4 ** 2
    gained = (speeds[1] - speeds[0]) / 0.01
    assert gained * (inertia + rotor) + drag * np.mean(speeds) == pytest.approx(1.0, rel=1e-3)
