# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim identify``: hidden parameters of our own arms, with noise, and what it rejects."""

import contextlib
from dataclasses import replace
import io
import itertools
import json
import sqlite3

import mujoco
import numpy as np
import pytest
import yaml

from manip_sim.interface.composition import compose_world
from manip_sim.interface.parameter_spec import GivenParameters, read_parameters
from manip_sim.simulation import Simulation

pytest.importorskip('mcap_ros2', reason='needs the extra records')
from manip_sim.identification.least_squares import identify, KINDS, RigidModel  # noqa: E402
from manip_sim.identification.recorded_motion import (  # noqa: E402
    bag_messages, find_excitation, read_motion, record_excitation, RecordedMotion, Stretch)
from manip_sim.records.record_file import definition, encoded, full_name, RecordFile  # noqa: E402

KIND = 'sensor_msgs/JointState'
#: Noise of positions [rad] and of efforts [N m].
NOISE = 5e-4, 0.2


def rewritten(source, target, change=lambda message: message, count=None):
    """Write a record again, each message as a function returns it, as many as a count."""
    with contextlib.closing(RecordFile(target, overwrite=True)) as file:
        for topic, time_ns, message in itertools.islice(bag_messages(source, KIND), count):
            file.write(file.channel(topic, full_name(KIND), definition(KIND)), time_ns,
                       encoded(KIND, change(message)))
    return target


def hidden(robot, path, friction=0.0):
    """Write parameters other than those of the model; return them by joint, shape (3, n)."""
    simulation = Simulation(compose_world(GivenParameters({'robot': robot})).world)
    known, joints = simulation.robot.dynamics(), simulation.robot.parts['arm'].joints
    random = np.random.default_rng(len(joints))
    values = np.array([
        [known[joint].armature, known[joint].damping,
         max(friction, 0.01 * known[joint].effort_range[1])]
        for joint in joints]).T * random.uniform(0.7, 1.6, (3, len(joints)))
    armature, viscous, coulomb = values.tolist()
    path.write_text(yaml.safe_dump({'/**': {'ros__parameters': {
        'robot': robot, 'armature.arm': str(armature),
        'friction.arm': str({'coulomb': coulomb, 'viscous': viscous})}}}))
    return values


@pytest.fixture(scope='module')
def excited(tmp_path_factory):
    """Return a short record of SO101, whose joints have hidden parameters, and these."""
    from manip_sim.cli.main import main
    folder = tmp_path_factory.mktemp('identify')
    values = hidden('SO101', folder / 'hidden.yaml')
    assert main(['identify', '--excite', str(folder / 'so101.mcap'), '--duration', '12',
                 '--params-file', str(folder / 'hidden.yaml')]) == 0
    return folder / 'so101.mcap', values


def values_in(output):
    """Return a report, and the values that it has by joint, shape (3, n)."""
    found = json.loads(output)
    return found, np.array([[joint['values'][kind]['value'] for joint in found['joints']]
                            for kind in ('armature', 'damping', 'frictionloss')])


def identified(here, *arguments):
    code, output, errors = here('identify', *arguments, '--json')
    assert (code, errors) == (0, '')
    return values_in(output)


@pytest.fixture(scope='module')
def clean(excited):
    """Return what is identified from the record, and a file with it."""
    from manip_sim.cli.main import main
    file = excited[0].with_name('identified.yaml')
    with contextlib.redirect_stdout(io.StringIO()) as output:
        assert main(['identify', str(excited[0]), '--robot', 'SO101', '--out', str(file), '--json']
                    ) == 0
    return *values_in(output.getvalue()), file


@pytest.mark.full
def test_hidden_parameters_are_found_through_noise(tmp_path):
    robot = 'UR5e'
    values = hidden(robot, tmp_path / 'hidden.yaml', 0.3)
    simulation = Simulation(compose_world(GivenParameters(
        read_parameters(tmp_path / 'hidden.yaml'))).world)
    joints = simulation.robot.parts['arm'].joints
    record_excitation(simulation, find_excitation(simulation, 'arm', 24.0, 0), 'arm',
                      tmp_path / 'clean.mcap')
    known = Simulation(compose_world(GivenParameters({'robot': robot})).world)
    motion = read_motion(tmp_path / 'clean.mcap', joints, known.robot.joint_names)
    random = np.random.default_rng(1)
    (stretch,) = motion.stretches
    noisy = replace(motion, stretches=[Stretch(
        5.0 * stretch.interval_s,
        {name: column[::5] + 2e-3 * random.normal(size=len(column[::5]))
         for name, column in stretch.positions.items()},
        {name: column[::5] for name, column in stretch.efforts.items()})])
    for of, size in ((stretch.positions, NOISE[0]), (stretch.efforts, NOISE[1])):
        for column in of.values():
            column += size * random.normal(size=len(column))
    model = RigidModel(known.model, known.data.qpos, joints, known.robot.robot_model.eef_name)
    found = identify(motion, model)
    told = np.array([[joint.values[kind].value for joint in found.joints] for kind in KINDS[:3]])
    assert np.abs(told[[0, 2]] / values[[0, 2]] - 1.0).max() < 0.05
    assert np.abs(told[1] / values[1] - 1.0).max() < 0.1
    for joint in found.joints:
        assert joint.explained > 0.98 and joint.held_out < 0.5 * joint.held_out_before
    assert found.hints == []
    # Noise of positions would make all that moves seem lighter, by tens of percents of a rotor.
    coarse = identify(noisy, model)
    errors = [joint.values['armature'].value / value - 1.0
              for joint, value in zip(coarse.joints, values[0])]
    assert np.abs(np.mean(errors)) < 0.1


def test_the_written_file_composes_the_robot_that_was_recorded(here, excited, clean):
    bag, values = excited
    found, told, file = clean
    assert np.abs(told / values - 1.0).max() < 0.05
    simulation = Simulation(compose_world(GivenParameters(read_parameters(file))).world)
    dynamics = simulation.robot.dynamics()
    assert np.allclose(told.T, [(dynamics[joint['name']].armature, dynamics[joint['name']].damping,
                                 dynamics[joint['name']].friction_loss)
                                for joint in found['joints']], rtol=1e-5)
    assert found['hints'] == [] and 0.0 < found['lag_s'] < 0.005
    # The written values explain the efforts without any further fit.
    again, _ = identified(here, bag, '--params-file', file)
    for before, after in zip(found['joints'], again['joints']):
        assert after['held_out_before'] < 0.1 * before['held_out_before']


@pytest.mark.full
def test_a_joint_that_did_not_move_gets_no_number(here, excited, tmp_path):
    stiff = 'robot0_shoulder_lift'

    def hold(message):
        message.position[message.name.index(stiff)] = 0.3
        return message
    bag = rewritten(excited[0], tmp_path / 'held.mcap', hold)
    code, output, _ = here('identify', bag, '--robot', 'SO101', '--out', tmp_path / 'held.yaml')
    assert code == 0
    assert ('not observable: armature, damping, frictionloss, offset of '
            f'{stiff}: it moves') in output
    row = next(line for line in output.splitlines() if line.split()[:1] == [stiff])
    assert row.split()[1:] == ['-'] * 8
    # The file keeps what the model has.
    found = yaml.safe_load(read_parameters(tmp_path / 'held.yaml')['armature.arm'])
    dynamics = Simulation(compose_world(GivenParameters({'robot': 'SO101'})).world
                          ).robot.dynamics()
    assert found[1] == pytest.approx(dynamics[stiff].armature)


@pytest.mark.full
def test_another_load_than_that_of_the_model_is_told_and_identified(here, excited):
    code, output, _ = here('identify', excited[0], '--robot', 'SO101', '--gripper', 'none')
    assert code == 0 and 'the efforts fit a payload of 0.' in output
    code, output, _ = here('identify', excited[0], '--robot', 'SO101', '--gripper', 'none',
                           '--payload')
    mass = float(output.split('payload of right: ')[1].split()[0])
    whole, bare = (Simulation(compose_world(GivenParameters(
        {'robot': 'SO101', 'gripper': gripper})).world).model.body_mass.sum()
        for gripper in ('default', 'none'))
    assert mass == pytest.approx(whole - bare, rel=0.05)


def test_what_damping_adds_to_the_inertia_in_each_step_is_no_rotor():
    # Half a step of damping is 4 % of this rotor.
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/><worldbody>
          <body><joint name="hinge" axis="0 0 1" armature="0.05" damping="2"/>
            <geom type="box" size="0.1 0.05 0.05" pos="0.1 0 0" mass="1"/></body></worldbody>
        </mujoco>""")
    data, positions = mujoco.MjData(model), []
    times = model.opt.timestep * np.arange(6000)
    efforts = sum(np.sin(2.0 * np.pi * (hz * times + hz**2)) for hz in (0.3, 0.5, 0.8, 1.3, 1.9))
    for effort in efforts:
        data.qfrc_applied[0] = effort
        mujoco.mj_step(model, data)
        positions.append(data.qpos[0])
    motion = RecordedMotion('', [Stretch(model.opt.timestep, {'hinge': np.array(positions)},
                                         {'hinge': efforts})], [], [])
    (joint,) = identify(motion, RigidModel(model, data.qpos, ['hinge'], {})).joints
    assert joint.values['armature'].value == pytest.approx(0.05, rel=0.01)
    assert joint.values['damping'].value == pytest.approx(2.0, rel=0.01)
    # The values of the model are those of the arm that was recorded.
    assert joint.held_out_before < 1e-3


def noised(bag, target, size):
    """Write a record again with noise of its positions [rad], and of its efforts in proportion."""
    random = np.random.default_rng(3)

    def add(message):
        message.position = list(message.position + size * random.normal(
            size=len(message.position)))
        message.effort = list(message.effort + 20.0 * size * random.normal(
            size=len(message.effort)))
        return message
    return rewritten(bag, target, add)


@pytest.mark.full
def test_a_record_that_is_too_short_says_which_length_suffices(here, excited, clean, tmp_path):
    bag, values = excited
    assert clean[0]['suffices_s'] < 12.0
    assert not any('the record is short' in note for note in clean[0]['notes'])
    lengths = []
    for size in (1e-3, 2e-3):
        noisy, told = identified(
            here, noised(bag, tmp_path / f'{size}.mcap', size), '--robot', 'SO101')
        lengths.append(noisy['suffices_s'])
        (note,) = [note for note in noisy['notes'] if 'the record is short' in note]
        assert f'{np.ceil(lengths[-1] / 10.0) * 10:.0f} s of this motion would suffice' in note
        within = np.array([[joint['values'][kind]['within'] for joint in noisy['joints']]
                           for kind in KINDS[:3]])
        assert (np.abs(told - values) < within).mean() > 0.9
    # The effect of noise falls with the square root of the time.
    assert lengths[0] > 12.0 and lengths[1] / lengths[0] == pytest.approx(4.0, rel=0.5)


def as_sqlite(source, folder):
    """Write the joint states of a record as rosbag2 stores them in SQLite."""
    folder.mkdir()
    from mcap.reader import make_reader
    with sqlite3.connect(folder / 'bag_0.db3') as bag, open(source, 'rb') as file:
        bag.execute('CREATE TABLE topics (id INTEGER PRIMARY KEY, name TEXT, type TEXT)')
        bag.execute('CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id INTEGER, '
                    'timestamp INTEGER, data BLOB)')
        bag.execute('INSERT INTO topics VALUES (1, ?, ?)', ('/joint_states', full_name(KIND)))
        bag.executemany('INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)', [
            (message.log_time, message.data)
            for _, _, message in make_reader(file).iter_messages()])
    return folder


@pytest.mark.full
def test_a_bag_in_sqlite_gives_the_same_and_other_joint_names_are_asked_for(
        here, excited, clean, tmp_path):
    bag = as_sqlite(excited[0], tmp_path / 'bag')
    assert np.array_equal(identified(here, bag, '--robot', 'SO101')[1], clean[1])
    code, _, errors = here('identify', bag, '--robot', 'SO101', '--prefix', 'so_')
    assert code == 1 and errors.endswith("it fits with --prefix 'robot0_'\n")
    code, _, errors = here('identify', bag, '--robot', 'UR5e')
    assert code == 1 and "has no joint 'robot0_shoulder_pan_joint': did you mean" in errors
    code, _, errors = here('identify', bag, '--robot', 'SO101', '--names', 'a,b')
    assert code == 1 and '--names has 2 names, and arm has 5 joints' in errors
    code, output, _ = here('identify', bag, '--robot', 'SO101', '--prefix', 'so_', '--names',
                           'robot0_shoulder_pan,robot0_shoulder_lift,robot0_elbow_flex,'
                           'robot0_wrist_flex,robot0_wrist_roll')
    assert code == 0 and 'so_shoulder_pan' in output and 'not in the bag' in output


def broken(change):
    """Return a function that changes every message in place."""
    def changed(message):
        change(message)
        return message
    return changed


def effortless(message):
    message.effort = []


def zero_effort(message):
    message.effort = [0.0] * len(message.name)


def unequal(message):
    message.effort = message.effort[:2]


def still(message):
    message.position = [0.1] * len(message.name)


@pytest.mark.parametrize(('change', 'text'), [
    (effortless, "has no efforts of 'robot0_shoulder_pan'"),
    (zero_effort, "has no efforts of 'robot0_shoulder_pan'"),
    (unequal, 'a message has arrays of different lengths'),
    (still, 'the robot stands still')], ids=lambda value: getattr(value, '__name__', ''))
def test_records_that_tell_nothing_are_rejected(here, excited, tmp_path, change, text):
    bag = rewritten(excited[0], tmp_path / 'broken.mcap', broken(change),
                    None if change is still else 100)
    code, output, errors = here('identify', bag, '--robot', 'SO101', '--out', tmp_path / 'x.yaml')
    assert (code, output) == (1, '') and text in errors and errors.count('\n') == 1
    assert not (tmp_path / 'x.yaml').exists()


@pytest.mark.full
def test_states_that_are_not_finite_are_left_out_and_a_short_rest_is_rejected(
        here, excited, tmp_path):
    count = 0

    def spoil(message):
        nonlocal count
        count += 1
        if count % 2000 == 0:
            message.position[0] = np.nan
        return message
    code, output, _ = here('identify', rewritten(excited[0], tmp_path / 'some.mcap', spoil,
                                                 4999), '--robot', 'SO101')
    assert code == 0 and '2 states with numbers that are not finite left out' in output
    short = rewritten(excited[0], tmp_path / 'short.mcap', count=1000)
    code, _, errors = here('identify', short, '--robot', 'SO101')
    assert code == 1 and 'the record is too short: ' in errors


@pytest.mark.parametrize(('arguments', 'code', 'text'), [
    ((), 2, 'give either a BAG, or --excite FILE'),
    (('bag', '--excite', 'x.mcap'), 2, 'give either a BAG, or --excite FILE'),
    (('bag', '--robot', 'SO102'), 1, "unknown value 'SO102'"),
    (('no_bag', '--robot', 'SO101'), 1, 'no_bag: No such file'),
    ((__file__, '--robot', 'SO101'), 1, 'no MCAP file'),
    (('bag', '--robot', 'SO101', '--part', 'leg'), 1, "unknown part of robot0 'leg'"),
    (('bag', '--robot', 'SO101', '--out', 'nowhere/x.yaml'), 1, 'no such folder: nowhere'),
    (('--excite', 'x.mcap', '--robot', 'SO101', '--duration', '3'), 1, 'takes 10 to 600 s'),
    (('--excite', __file__, '--robot', 'SO101', '--duration', '10'), 1, 'is not overwritten')])
def test_wrong_arguments_are_told_in_one_line(here, arguments, code, text):
    found = here('identify', *arguments)
    assert found[0] == code and text in found[2] and found[2].count('\n') == 1
