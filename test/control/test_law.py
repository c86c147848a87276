# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The compiled laws of control: the bits of plain Python, kept where the user may write."""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import threading
import time

import manip_sim
import mujoco
import numpy as np
import pytest

from manip_sim.control.law import kept, loading
from manip_sim.control.law.compiling import compiled, kept_in
from manip_sim.control.law.operational_space import exert
from manip_sim.control.law.records import Goal, Motion, Spring
from manip_sim.control.law.small_matrices import rotation_vector
from manip_sim.models import compose
from manip_sim.simulation import Simulation

#: Print what the laws write for arms near and far from bounds, singularities and goals.
SCRIPT = """
import hashlib
import numpy as np
from manip_sim.control.law.inverse_kinematics import displace, limit_rate
from manip_sim.control.law.operational_space import accelerate
from manip_sim.control.law.records import Spring
from manip_sim.control.law.small_matrices import rotation_vector
draw, digest, bounded = np.random.default_rng(7), hashlib.sha256(), 0
for number in range(60):
    count = 6 + number % 2
    jacobian = draw.normal(size=(6, count))
    jacobian[0] *= draw.uniform(0.001, 1.0)
    error, along = draw.uniform(0.0, 0.5) * draw.normal(size=6), draw.normal(size=6)
    low, high = -draw.uniform(0.01, 1.0, count), draw.uniform(0.01, 1.0, count)
    velocity, away, result = draw.normal(size=(3, count))
    held, limit, turn = np.zeros(count, dtype=bool), draw.uniform(0.2, 2.0, count), np.zeros(6)
    flags = accelerate(jacobian, error, along, Spring(150.0, 24.0, 1.0, 3.2), limit, low, high,
                       away, velocity, number % 3 == 0, held, result)
    rotation_vector(np.linalg.qr(draw.normal(size=(3, 3)))[0], turn)
    rate = limit_rate(jacobian, velocity, limit, 2.0)
    bounded += held.any()
    digest.update(result.tobytes() + held.tobytes() + turn.tobytes())
    digest.update(repr((*map(bool, flags), float(rate))).encode())
assert 10 < bounded < 50, bounded
from manip_sim.models import compose
from manip_sim.worlds import Worlds
worlds = Worlds(compose('Panda'), 1, 1)
for _ in range(4):  # By Python, and where there is compiled code by itself.
    worlds.advance(5)
digest.update(worlds.digest()[0].encode())
from manip_sim.simulation import Simulation
simulation = Simulation(compose('Panda', arena='table', cube=True))
robot = simulation.robot
joints = robot.joints.names[:7]
place = simulation.data.qpos[:7] + 0.1
robot.apply(*robot.parse.joint_command(joints, place), robot.parse.action('right/gripper', [1.0]))
for period in range(20):
    if period == 10:
        robot.apply(robot.parse.trajectory(
            'arm', joints, [0.05, 0.09], [place, place - 0.01], now_ns=simulation.time_ns))
    if period == 15:
        robot.apply(robot.parse_cartesian.action('right', [0.2, 0.0, 0.1, 0.0, 0.3, 0.0]))
    simulation.advance(10)
digest.update(simulation.digest().encode())
print(type(accelerate).__name__, digest.hexdigest())
"""


def run(script, **environment):
    return subprocess.run([sys.executable, '-c', script], env=os.environ | environment, check=True,
                          capture_output=True, text=True)


@pytest.mark.full
def test_a_compiled_law_gives_the_bits_of_the_same_law_as_plain_python():
    results = [run(SCRIPT, NUMBA_DISABLE_JIT=plain).stdout.split() for plain in '01']
    assert [kind for kind, _ in results] == ['CPUDispatcher', 'function']
    assert len({digest for _, digest in results}) == 1


def test_neither_import_nor_simulation_imports_numba_before_a_command():
    run('import sys\nfrom manip_sim.models import compose\n'
        'from manip_sim.simulation import Simulation\n'
        'simulation = Simulation(compose("Panda"))\nsimulation.advance(5)\n'
        'assert "numba" not in sys.modules\n')


LOADING = ('import logging\nlogging.basicConfig(format="%(message)s")\n'
           'from manip_sim.control.law.compiling import compiled\n'
           'import manip_sim.control.law.small_matrices as law, numpy as np\n'
           'law.rotation_vector(np.eye(3), np.zeros(6))\n')


@pytest.fixture(scope='module')
def cache(tmp_path_factory):
    """Return a folder with old laws, then with a new one too, and what was logged of that."""
    folder = tmp_path_factory.mktemp('cache')
    parent = folder / 'manip_sim/laws'
    for number in range(16):
        (parent / f'{number:016x}').mkdir(parents=True)
        os.utime(parent / f'{number:016x}', (number, number))
    (parent / 'mine').mkdir()
    return folder, run(LOADING, XDG_CACHE_HOME=str(folder)).stderr


def test_copies_of_the_sources_share_what_is_compiled_once_and_that_is_logged(cache, tmp_path):
    folder, logged = cache
    assert 'Compiling control laws' in logged and str(folder) in logged
    shutil.copytree(Path(manip_sim.__file__).parent, tmp_path / 'copy/manip_sim',
                    ignore=shutil.ignore_patterns('__pycache__'))
    for path in (Path(manip_sim.__file__).parents[1], tmp_path / 'copy'):
        done = run(f'import sys\nsys.path.insert(0, {str(path)!r})\n' + LOADING + (
            'print(law.__file__, sum(law.rotation_vector.stats.cache_hits.values()))\n'),
            XDG_CACHE_HOME=str(folder))
        file, hits = done.stdout.split()
        assert file.startswith(str(path)) and hits == '1' and done.stderr == ''


def test_others_wait_while_one_compiles(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, 'laws_folder', lambda: tmp_path)
    entered = []

    def enter():
        with kept.alone():
            entered.append(kept.all_are_kept())
    other = threading.Thread(target=enter)
    with kept.alone():
        other.start()
        time.sleep(0.2)
        assert not entered
        kept.note_that_all_are_kept()
    other.join(10.0)
    assert entered == [True]
    with kept.alone():
        enter()  # Once all are there, nobody waits.
    assert entered == [True, True]


USING = """
import sys
from manip_sim.control.law.loading import load_laws
from manip_sim.models import compose
from manip_sim.simulation import Simulation
load_laws()
laws = {f'{name}.{law}': found for name, room in list(sys.modules.items())
        if name.startswith('manip_sim.control.law.')
        for law, found in vars(room).items() if hasattr(found, 'signatures')}
before = {name: law.signatures for name, law in laws.items()}
simulation = Simulation(compose('Panda'))
robot, names = simulation.robot, simulation.robot.joint_names[:7]
for mode in ('effort', 'position'):
    robot.set_control_mode('arm', mode)
    for _ in range(4):
        robot.apply(robot.parse_cartesian.action('right', [0.1] * 6), period_s=0.02)
        simulation.advance(10)
    robot.apply(robot.parse_cartesian.twist('right', [0.1] * 3, [0.1] * 3), period_s=0.02)
    simulation.advance(10)
for _ in range(4):
    robot.apply(*robot.parse.joint_command(names, position=robot.measured('arm')[:7]),
                period_s=0.02)
    simulation.advance(10)
later = {name: law.signatures for name, law in laws.items() if law.signatures != before[name]}
assert not later, later
"""


@pytest.mark.full
def test_loaded_laws_are_those_that_commands_need():
    run(USING)


def test_laws_of_old_versions_do_not_pile_up(cache):
    kept = {folder.name for folder in (cache[0] / 'manip_sim/laws').iterdir()}
    assert len(kept) == 14 and kept > {f'{number:016x}' for number in range(4, 16)} | {'mine'}


def test_laws_are_kept_elsewhere_where_the_usual_folder_cannot_be_written(tmp_path):
    (tmp_path / 'manip_sim').write_text('not a folder')
    importing = LOADING.rpartition('law.rotation_vector')[0]  # Compiles nothing.
    found = run(importing, XDG_CACHE_HOME=str(tmp_path), TMPDIR=str(tmp_path)).stderr
    assert str(tmp_path / f'manip_sim-{os.getuid()}') in found


def test_what_others_compile_is_kept_where_it_was_before(tmp_path):
    from numba.core import config
    before = config.CACHE_DIR
    with kept_in(tmp_path):
        assert str(tmp_path) == config.CACHE_DIR
    assert before == config.CACHE_DIR
    compiled(lambda number: number)
    assert before == config.CACHE_DIR


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-9])
def test_a_rotation_vector_of_the_law_is_that_of_mujoco(angle):
    draw = np.random.default_rng(3)
    for _ in range(20):
        axis, quat, matrix, error = draw.normal(size=3), np.empty(4), np.empty(9), np.zeros(6)
        axis /= np.linalg.norm(axis)
        mujoco.mju_axisAngle2Quat(quat, axis, angle)
        mujoco.mju_quat2Mat(matrix, quat)
        rotation_vector(matrix.reshape(3, 3), error)
        np.testing.assert_allclose(error[3:], angle * axis, atol=1e-7)
        np.testing.assert_array_equal(error[:3], 0.0)


@pytest.mark.parametrize('name', ['Panda', 'Baxter', 'PandaOmron'])
def test_jacobian_and_inertia_of_the_law_are_those_of_mujoco(name):
    simulation = Simulation(compose(name))
    model, data, robot = simulation.model, simulation.data, simulation.robot
    draw = np.random.default_rng(0)
    data.qvel[:] = 0.3 * draw.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    center, turn = np.array([0.02, 0.03, 0.08]), [0.03, 0.002, 0.001, 0.02, 0.003, 0.015]
    robot.set_payload('right', 1.5, center, turn)
    arms = robot.joints.cartesian._arms
    for name, chain in robot.joints.cartesian._chains.items():
        indices = robot.joints.indices_of(name)
        arm, count = arms.arm(chain.tip, indices), len(indices)
        motion = Motion(np.zeros(count), np.zeros(6), np.zeros(6), np.zeros(count, dtype=bool))
        joints = arm.joints.copy()
        joints['weakest'], joints['strongest'] = -np.inf, np.inf
        arm = arm._replace(joints=joints)
        jacobian = chain.tip.jacobian(model, data, joints['dof'])
        position, rotation = chain.tip.pose(data)
        efforts = []
        for along in (np.zeros(6), 0.02 * draw.normal(size=6)):
            exert(robot._physics.arrays, robot.joints.payloads.loads, arm, position, rotation,
                  Goal(position, rotation, np.zeros(3), np.eye(3), along),
                  robot.joints.cartesian.posture, Spring(150.0, 24.0, 9.0, 9.0), False, motion)
            efforts.append(motion.efforts.copy())
        np.testing.assert_allclose(motion.twist, jacobian @ data.qvel[joints['dof']], atol=1e-12)
        np.testing.assert_allclose(motion.error, 0.0, atol=1e-12)
        # Efforts for a velocity of the end effector: damping times it, by Newton's second law.
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, inertia)
        if name == 'right':  # The arm that holds something.
            site = data.site(robot.end_effectors[name].ft_frame)
            jacobians = np.zeros((6, model.nv))
            mujoco.mj_jac(model, data, jacobians[:3], jacobians[3:], site.xpos + site.xmat.reshape(
                3, 3) @ center, model.site_bodyid[site.id])
            turned = site.xmat.reshape(3, 3).T @ jacobians[3:]
            inertia += 1.5 * jacobians[:3].T @ jacobians[:3] + (
                turned.T @ robot.payload('right').inertia_matrix @ turned)
        own = inertia[np.ix_(joints['dof'], joints['dof'])]
        gained = jacobian @ np.linalg.solve(own, efforts[1] - efforts[0])
        np.testing.assert_allclose(gained, 24.0 * along, atol=1e-3 * 24.0 * np.abs(along).max())


def test_a_long_compilation_is_reported_again_and_again(monkeypatch, caplog):
    monkeypatch.setattr(loading, '_REPORT_S', 0.05)
    monkeypatch.setattr(loading, '_call_all', lambda: time.sleep(0.3))
    for are_kept in (True, False):
        monkeypatch.setattr(loading, 'all_are_kept', lambda value=are_kept: value)
        monkeypatch.setattr(kept, 'all_are_kept', lambda: True)
        loading.load_laws()
        assert len([r for r in caplog.records if 'still being compiled' in r.message]) > 2 or (
            are_kept and not caplog.records)


@pytest.mark.parametrize(('release', 'count'), [('0.61.2', 2), ('0.62.0', 1), ('1.0', 1)])
def test_copies_are_kept_apart_where_numba_does_so(release, count, monkeypatch, tmp_path):
    monkeypatch.setattr(kept, '_version_of_numba', lambda: release)
    monkeypatch.setattr(kept, 'takes_locators', kept.takes_locators.__wrapped__)
    folders = set()
    for place in ('one', 'other'):
        (tmp_path / place / 'physics').mkdir(parents=True)
        (tmp_path / place / 'physics' / 'physics.py').touch()
        monkeypatch.setattr(
            kept, '__file__', str(tmp_path / place / 'control' / 'law' / 'kept.py'))
        folders.add(kept._version())
    assert len(folders) == count
