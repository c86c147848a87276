# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is drawn for an episode: its distributions, and what it changes in a simulation."""

import json
import pickle
import subprocess
import sys

from hypothesis import given, settings, strategies as st
import mujoco
import numpy as np
import pytest

from manip_sim.errors import ManipSimError, ModelError
from manip_sim.models import compose
from manip_sim.models.randomization import GROUPS, Randomization
from manip_sim.simulation import Simulation
from manip_sim.tasks import create_task, start
from manip_sim.worlds import Worlds

BOX = {'name': 'box', 'shape': 'box', 'size': [0.06, 0.05, 0.04], 'mass': 0.2,
       'position': [0.5, 0.1, 0.02]}
DRAWN = {
    'bodies': {'box': {'mass': {'scale': {'uniform': [0.5, 2.0]}},
                       'position': {'offset': {'uniform': [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.0]]}},
                       'orientation': {'offset': {'normal': [[0, 0, 0], [0, 0, 0.5]]}}},
               'robot0_link*': {'mass': {'scale': {'normal': [1.0, 0.1]}}}},
    'geoms': {'box*': {'friction': {'uniform': [0.5, 1.5]},
                       'size': {'scale': {'uniform': [0.8, 1.2]}}}},
    'joints': {'robot0_joint?': {'damping': {'uniform': [0.5, 2.0]},
                                 'friction': {'log_uniform': [0.01, 1.0]},
                                 'armature': {'scale': {'choice': [0.5, 2.0]}}}},
    'lights': {'key': {'diffuse': {'uniform': [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]}}},
    'cameras': {'frontview': {'position': {'offset': {'normal': [0.0, 0.01]}},
                              'orientation': {'offset': {'normal': [0.0, 0.01]}}}},
    'parameters': {'noise.joint_position': {'log_uniform': [1e-5, 1e-3]},
                   'latency.command': {'uniform': [0.0, 0.05]}}}


@pytest.fixture(scope='module')
def world():
    return compose('Panda', objects=[BOX], seed=0, randomization=DRAWN)


@pytest.fixture(scope='module')
def simulation(world):
    return Simulation(world)


def box_geom(model):
    return model.geom(int(model.body('box').geomadr[0]))


def run(simulation, periods=10):
    robot = simulation.robot
    for number in range(periods):
        robot.apply(robot.parse.action('arm', 0.3 * np.sin(np.arange(7) + number)))
        simulation.advance(10)
    return simulation.digest()


def test_the_model_is_the_one_that_the_compiler_makes_of_what_was_drawn(simulation):
    simulation.reset(3)
    drawn, model = simulation.randomized.drawn, simulation.model
    assert 0.1 <= drawn['bodies/box/mass'] <= 0.4
    spec = compose('Panda', objects=[BOX]).compose(visual=False)
    name = box_geom(model).name
    for key, value in drawn.items():
        group, _, rest = key.partition('/')
        of, _, quantity = rest.rpartition('/')
        if group == 'joints':
            joint = spec.joint(of)
            field = 'frictionloss' if quantity == 'friction' else quantity
            setattr(joint, field, [value, 0.0, 0.0] if np.ndim(getattr(joint, field)) else value)
    spec.geom(name).size = drawn[f'geoms/{name}/size']
    spec.geom(name).mass = drawn['bodies/box/mass']
    spec.geom(name).friction[0] = drawn[f'geoms/{name}/friction']
    compiled = spec.compile()
    geom, other = model.geom(name).id, compiled.geom(name).id
    body, twin = model.body('box').id, compiled.body('box').id
    for field in ('geom_size', 'geom_rbound', 'geom_aabb', 'geom_friction'):
        np.testing.assert_allclose(getattr(model, field)[geom], getattr(compiled, field)[other])
    for field in ('body_mass', 'body_inertia', 'body_invweight0', 'body_subtreemass'):
        np.testing.assert_allclose(getattr(model, field)[body], getattr(compiled, field)[twin],
                                   rtol=1e-9)
    for field in ('dof_armature', 'dof_frictionloss', 'dof_damping'):
        np.testing.assert_allclose(getattr(model, field)[:7], getattr(compiled, field)[:7])
    # MuJoCo's constants belong to the new masses.
    fresh = mujoco.MjModel.__copy__(model)
    mujoco.mj_setConst(fresh, mujoco.MjData(fresh))
    for field in ('dof_M0', 'dof_invweight0', 'body_invweight0', 'actuator_acc0'):
        np.testing.assert_array_equal(getattr(model, field), getattr(fresh, field))


def test_weights_that_were_drawn_are_carried_and_felt(simulation):
    simulation.reset(3)
    model = simulation.model
    masses = [simulation.randomized.drawn[f'bodies/robot0_link{n}/mass'] for n in range(8)]
    np.testing.assert_array_equal(masses, [model.body(f'robot0_link{n}').mass[0]
                                           for n in range(8)])
    before = simulation.data.qpos[:7].copy()
    for _ in range(20):
        simulation.advance(10)
    # Gravity compensation and servos know the masses: the arm stays.
    assert np.abs(simulation.data.qpos[:7] - before).max() < 1e-3


@pytest.mark.full
def test_controllers_know_damping_and_friction_that_were_drawn(simulation):
    for seed in range(3):
        simulation.reset(seed)
        robot = simulation.robot
        robot.sensing.set('latency.command', 0.0)
        start_, goal = simulation.data.qpos[:7].copy(), simulation.data.qpos[:7] + 0.3
        names = robot.joints.names
        times = np.linspace(0.1, 2.0, 20)
        share = 10 * (times / 2)**3 - 15 * (times / 2)**4 + 6 * (times / 2)**5
        robot.apply(robot.parse.trajectory(
            'arm', names, times.tolist(), start_ + share[:, None] * (goal - start_)))
        for number in range(100):
            simulation.advance(10)
            if number == 49:  # In the middle, at full speed, the servos follow without a lag.
                state = robot.controller_state('arm')
                lag = state.reference.position - simulation.data.qpos[:7]
                assert np.abs(lag).max() < 5e-4
        np.testing.assert_allclose(simulation.data.qpos[:7], goal, atol=2e-3)


def test_the_same_seed_draws_the_same_in_any_order_and_other_seeds_others(simulation):
    found = {}
    for seed in (1, 2, 1, 7, 2):
        simulation.reset(seed)
        found.setdefault(seed, []).append((dict(simulation.randomized.drawn), run(simulation)))
    assert found[1][0] == found[1][1] and found[2][0] == found[2][1]
    first, second = found[1][0][0], found[2][0][0]
    assert first.keys() == second.keys()
    assert all(first[key] != second[key] for key in first if 'armature' not in key)


def test_drawn_values_may_be_arrays(simulation):
    for seed in (3, 4):
        colour = 0.1 * seed + np.array([0.2, 0.3, 0.4])
        simulation.reset(seed, {'lights/key/diffuse': colour})
        np.testing.assert_allclose(simulation.model.light('key').diffuse, colour, atol=1e-7)


def test_a_reset_without_a_seed_repeats_the_episode(simulation):
    simulation.reset(5)
    first = simulation.digest()
    run(simulation)
    simulation.reset()
    assert simulation.digest() == first


def test_a_saved_state_holds_what_was_drawn(world, simulation):
    simulation.reset(8)
    run(simulation, 4)
    state = pickle.loads(pickle.dumps(simulation.save()))
    expected = run(simulation)
    for other in (simulation, Simulation(world)):
        other.reset(9)
        other.restore(state)
        assert run(other) == expected
        other.reset()
        assert other.randomized.drawn == state.drawn


def test_what_was_told_gives_the_episode_without_the_file(simulation):
    simulation.reset(4)
    told = json.loads(json.dumps(simulation.randomized.drawn))
    expected = run(simulation)
    other = Simulation(compose('Panda', objects=[BOX], seed=0))
    other.reset(4, told)
    assert run(other) == expected
    # Afterwards, nothing of it is left.
    other.reset(4, {})
    nominal = Simulation(compose('Panda', objects=[BOX], seed=0))
    nominal.reset(4)
    for name in ('noise.joint_position', 'latency.command'):
        other.robot.sensing.set(name, 0.0)
    for field in ('body_mass', 'body_inertia', 'dof_M0', 'geom_size', 'geom_friction',
                  'dof_frictionloss', 'light_diffuse', 'cam_quat', 'bvh_aabb'):
        np.testing.assert_array_equal(
            getattr(other.model, field), getattr(nominal.model, field))
    assert run(other) == run(nominal)


def test_without_a_file_nothing_differs():
    plain = Simulation(compose('Panda', objects=[BOX], seed=0))
    empty = Simulation(compose('Panda', objects=[BOX], seed=0, randomization={}))
    for seed in (0, 1):
        plain.reset(seed)
        empty.reset(seed)
        assert run(plain) == run(empty)


@pytest.mark.full
def test_each_of_many_worlds_has_draws_and_sizes_of_its_own(world):
    seeds = [11, 12, 13]
    with Worlds(world, 3, threads=2) as worlds:
        worlds.reset(seeds)
        for number in range(10):
            action = np.tile(0.3 * np.sin(np.arange(7) + number), (3, 1))
            worlds.robot.command.action('arm', action)
            worlds.advance(10)
        found = worlds.digest()
    expected = []
    for seed in seeds:
        simulation = Simulation(world)
        simulation.reset(seed)
        expected.append(run(simulation))
    assert found == expected and len(set(found)) == 3


def test_a_pose_that_a_task_draws_gets_the_offset_too():
    offset = {'bodies': {'cube': {'position': {'offset': {'choice': [[0.01, 0.02, 0.0]]}}}}}
    poses = []
    for randomization in (None, offset):
        task = create_task('pick_cube', randomization=randomization)
        simulation = Simulation(task.world)
        start(task, simulation, 6)
        poses.append(simulation.entities.pose(simulation.data, 'cube'))
    np.testing.assert_allclose(poses[1][:3] - poses[0][:3], [0.01, 0.02, 0.0], atol=1e-12)
    assert simulation.randomized.drawn['bodies/cube/position'] == poses[1][:3].tolist()


@pytest.mark.full
def test_distributions_have_the_moments_that_they_say():
    def draws(spec, count=20_000):
        rule, = Randomization({'bodies': {'*': {'mass': spec}}}).rules
        return np.array([rule.draw(seed, 'bodies/a/mass')[0] for seed in range(count)])
    uniform = draws({'uniform': [1.0, 3.0]}, 4000)
    assert uniform.min() >= 1.0 and uniform.max() <= 3.0
    assert abs(uniform.mean() - 2.0) < 5 * np.sqrt(1 / 3 / 4000)
    normal = draws({'normal': [2.0, 0.5]}, 4000)
    assert abs(normal.mean() - 2.0) < 5 * 0.5 / np.sqrt(4000)
    assert abs(normal.std() - 0.5) < 5 * 0.5 / np.sqrt(8000)
    log = np.log(draws({'log_uniform': [0.1, 10.0]}, 4000))
    assert abs(log.mean()) < 5 * np.log(100) / np.sqrt(12 * 4000)
    counts = np.bincount(draws({'choice': [1, 2, 3]}, 3000).astype(int))[1:]
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(3000 * 2 / 9)


@pytest.mark.parametrize('text, message', [
    ('body:\n  box: {mass: {uniform: [1, 2]}}', "line 1: unknown group 'body': did you mean"),
    ('bodies:\n  box:\n    mas: {uniform: [1, 2]}',
     "line 3: unknown quantity of bodies 'mas': did you mean 'mass'"),
    ('bodies:\n  box:\n    mass: {unifrm: [1, 2]}',
     "line 3: unknown distribution 'unifrm': did you mean 'uniform'"),
    ('bodies:\n  bux:\n    mass: {uniform: [1, 2]}',
     "line 3: no body matches 'bux': did you mean 'box'"),
    ('bodies:\n  box:\n    mass: {uniform: [2, 1]}', 'line 3: mass, uniform: low must not be'),
    ('bodies:\n  box:\n    mass: {uniform: [-1, 1]}', 'line 3: mass, uniform: values must be'),
    ('bodies:\n  box:\n    mass: {log_uniform: [0, 1]}', 'low must be above 0, got 0'),
    ('bodies:\n  box:\n    mass: {normal: [1, -0.1]}', 'a standard deviation must be at least 0'),
    ('bodies:\n  box:\n    mass: {choice: []}', 'choice needs a list with choices'),
    ('bodies:\n  box:\n    mass: {uniform: [1, .nan]}', 'needs numbers within 1e+10, got nan'),
    ('bodies:\n  box:\n    mass: {normal: [1, 1.0e+308]}', 'within 1e+10, got 1e+308'),
    (f'bodies:\n  box:\n    mass: {{uniform: [1, 1{"0" * 30}]}}', 'have at most 64 bits'),
    ('bodies:\n  box:\n    mass: {uniform: [1]}', 'uniform needs [low, high], got [1]'),
    ('bodies:\n  box:\n    mass: {uniform: [true, 2]}', 'needs numbers within 1e+10, got True'),
    ('bodies:\n  box:\n    mass: {uniform: [1, 2], normal: [0, 1]}', 'mass needs one distrib'),
    ('bodies:\n  box:\n    mass: 3', 'mass needs one distribution: uniform, normal'),
    ('bodies:\n  box:\n    orientation: {uniform: [0, 1]}', 'can be drawn as offset, not as abs'),
    ('bodies:\n  box:\n    position: {uniform: [[0, 0], [1, 1]]}', "'box' has 3 numbers, got 2"),
    ('bodies:\n  box:\n    mass: {scale: {uniform: [-1, 2]}}', 'factors must be at least 0'),
    ('geoms:\n  floor:\n    size: {scale: {uniform: [1, 2]}}', "geom 'floor' is a plane"),
    ('parameters:\n  noise.joint_positon: {uniform: [0, 1]}',
     "line 2: unknown parameter 'noise.joint_positon': did you mean 'noise.joint_position'"),
    ('parameters:\n  latency.state: {scale: {uniform: [0, 1]}}', 'as absolute, not as scale'),
    ('parameters:\n  latency.state: {uniform: [0, 11]}', 'values must be from 0 to 10, got 11'),
    ('- a', 'must hold keys and values'),
    ('bodies: &a {}', 'anchors and aliases are not read'),
    ('bodies:\n  "*":\n    mass: {uniform: [1, 2]}\n  "*":\n    mass: {uniform: [1, 2]}',
     "'*' appears twice, again in line 4")])
def test_what_makes_no_sense_is_rejected_in_one_line(text, message, tmp_path, simulation):
    file = tmp_path / 'file.yaml'
    file.write_text(text)
    with pytest.raises(ModelError) as caught:
        Simulation(compose('Panda', objects=[BOX], randomization=file))
    assert message in str(caught.value) and str(file) in str(caught.value)
    assert '\n' not in str(caught.value)


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(ModelError, match='no such YAML file'):
        compose('Panda', randomization=tmp_path / 'none.yaml')


def test_told_values_of_what_there_is_not_are_rejected(simulation):
    with pytest.raises(ModelError, match='nothing that is drawn is called'):
        simulation.reset(1, {'bodies/box/weight': 1.0})


_LEAVES = st.none() | st.booleans() | st.integers(-3, 3) | st.floats() | st.text(max_size=5)
_LISTS = st.lists(_LEAVES | st.lists(_LEAVES, max_size=4), max_size=4)


@pytest.mark.full
@settings(max_examples=150, deadline=None)
@given(st.dictionaries(
    st.sampled_from([*GROUPS, 'x']), st.dictionaries(
        st.sampled_from(['box', '*', 'latency.state', '[', 'floor']), st.dictionaries(
            st.sampled_from(['mass', 'size', 'friction', 'position', 'uniform', 'scale', 'y']),
            st.dictionaries(st.sampled_from(['uniform', 'normal', 'log_uniform', 'choice', 'scale',
                                             'offset']), _LISTS | st.just({'uniform': [0, 1]}),
                            max_size=2) | _LEAVES, max_size=2) | _LEAVES, max_size=2) | _LEAVES,
    max_size=2))
def test_any_mapping_is_either_distributions_or_an_error_in_one_line(simulation, given):
    try:
        rules = Randomization(given).rules
    except ManipSimError as error:
        assert '\n' not in str(error) and len(str(error)) < 1000
        return
    for rule in rules:
        assert np.isfinite(rule.draw(1, 'a')).all()


@pytest.mark.full
def test_another_process_draws_the_same(tmp_path, simulation):
    simulation.reset(21)
    code = ('import json, sys\n'
            'from manip_sim.models import compose\n'
            'from manip_sim.simulation import Simulation\n'
            'box, drawn = json.load(sys.stdin)\n'
            "s = Simulation(compose('Panda', objects=[box], seed=0, randomization=drawn))\n"
            's.reset(21)\n'
            'print(s.digest())\n')
    done = subprocess.run([sys.executable, '-c', code], input=json.dumps([BOX, DRAWN]), text=True,
                          capture_output=True, check=True)
    assert done.stdout.strip() == simulation.digest()
