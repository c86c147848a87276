# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Laws of users: their inputs, what they exert, what they remember, and how they fail."""

import functools
import logging
import math
import pickle
import subprocess
import sys

import mujoco
import numba
import numpy as np
import pytest
from robot_kinds import KINDS

from manip_sim.channels.kinds import controller_numbers
from manip_sim.control.commands import Status
from manip_sim.control.modes import ARGUMENTS, law_of, LAWS
from manip_sim.control.seats import _EXIT_CODE
from manip_sim.errors import CommandError, ModelError, UnknownNameError
from manip_sim.laws import Law, law
from manip_sim.models import compose_robot, World
from manip_sim.models.arenas import create_arena
from manip_sim.models.object_creation import create_object
from manip_sim.models.robots import robot_names
from manip_sim.physics.object_spawning import plan_with, plan_without
from manip_sim.simulation import Simulation
from manip_sim.simulation.robot_spawning import plan_in_arena

ARM = [f'robot0_joint{n}' for n in range(1, 8)]


@law(parameters={'stiffness': 200.0, 'damping': 30.0}, memory=2)
def spring(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    memory[0] += 1.0
    memory[1] = t
    for i in range(len(q)):
        effort[i] = bias[i]
        for j in range(len(q)):
            effort[i] += mass[i, j] * (setpoint[j, 2] + parameters[0] * (setpoint[j, 0] - q[j])
                                       + parameters[1] * (setpoint[j, 1] - v[j]))


def stream(simulation, periods, first=0):
    """Command the arm of a Panda as a stream, and push it now and then."""
    robot = simulation.robot
    for period in range(first, first + periods):
        goal = 0.3 * math.sin(0.1 * period)
        robot.apply(*robot.parse.joint_command(ARM[:2], position=[goal, 0.5 - goal]),
                    period_s=0.02)
        simulation.data.qfrc_applied[3] = 5.0 * (period % 3 == 0)
        simulation.advance(10)


def recorded(simulation, steps, part='arm'):
    """Return the arguments of a law of a part in each step of one period."""
    seen = []

    def record(*arguments):
        seen.append([np.array(argument) for argument in arguments])
        arguments[-1][:] = arguments[3]
    simulation.robot.set_law(part, record)
    simulation.advance(steps)
    return [dict(zip(ARGUMENTS, arguments)) for arguments in seen]


def test_a_compiled_law_and_plain_python_give_the_same_bits(panda_sim):
    other = Simulation(panda_sim.world)
    panda_sim.robot.set_law('arm', spring)
    other.robot.set_law('arm', spring, compiled=False)
    for simulation in (panda_sim, other):
        stream(simulation, 30)
    assert panda_sim.digest() == other.digest()
    assert np.abs(panda_sim.robot.state().position[:2]).max() > 0.05


def test_arguments_that_cost_something_are_computed_for_laws_that_mention_them(panda_sim):
    def weightless(t, q, v, bias, m, jacobian, w, setpoint, parameters, memory, effort):
        effort[:] = bias
        if memory[0] > 1.0:
            (lambda: jacobian)()

    def wrapped(*arguments):
        weightless(*arguments)
    lazy, other = Law(weightless, memory=1), Simulation(panda_sim.world)
    assert lazy.reads.tolist() == [False, True, False]
    assert Law(spring.function).reads.tolist() == [True, False, False]
    assert Law(wrapped).reads.all()
    assert not HOLDING.reads.any()
    for simulation, is_compiled in ((panda_sim, True), (other, False)):
        simulation.robot.set_law('arm', HOLDING, compiled=is_compiled)
        tool = simulation.model.site(simulation.robot.end_effectors['right'].grip_site).bodyid[0]
        simulation.data.xfrc_applied[tool, 0] = 5.0
        simulation.advance(5)
        seats = simulation.robot.joints.seats
        (part,) = seats.of
        mass, jacobian, wrench = seats._room(part).of['arguments'][4:7]
        # Plain Python may look at them in a debugger.
        assert mass.any() == jacobian.any() == wrench.any() == (not is_compiled)
    assert panda_sim.digest() == other.digest()


def holding_alone(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    effort[:] = bias - 5.0 * v


#: It is compiled once for all tests.
HOLDING = Law(holding_alone)


def test_a_law_that_computes_the_torque_follows_a_stream_closely(panda_sim):
    panda_sim.robot.set_law('arm', spring, stiffness=900.0, damping=60.0)
    robot = panda_sim.robot
    for period in range(100):
        robot.apply(*robot.parse.joint_command(ARM[:1], position=[0.2 * math.sin(0.05 * period)]),
                    period_s=0.02)
        panda_sim.advance(10)
        now = robot.controller_state('arm')
        # What is left is the damping of the joints, which this law leaves out.
        assert np.abs(now.reference.position - now.position).max() < 2.5e-3
    assert abs(now.reference.velocity[0]) > 0.1


@pytest.mark.parametrize('name', [pytest.param(name, marks=[pytest.mark.full] * (
    name not in KINDS[:2])) for name in robot_names()])
def test_what_a_law_gets_is_what_mujoco_has(name):
    simulation = Simulation(World([compose_robot(name)]))
    robot, model = simulation.robot, simulation.model
    arm = next(part for part in ('arm', 'right') if robot.parts.get(part) is not None
               and robot.parts[part].atomic == (part,))
    simulation.data.qfrc_applied[:] = 1.0
    simulation.advance(20)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = simulation.data.qpos, simulation.data.qvel
    mujoco.mj_forward(model, data)
    time_s = simulation.time_s
    got = recorded(simulation, 1, arm)[0]
    indices = robot.joints.indices_of(arm)
    dofs = robot.joints.dofs(indices)
    mass, jacobian = np.zeros((model.nv, model.nv)), np.zeros((6, model.nv))
    for row, unit in zip(mass, np.eye(model.nv)):
        mujoco.mj_mulM(model, data, row, unit)
    (end, *_) = [reader for key, reader in robot.end_effectors.items() if key in (arm, 'right')]
    mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site(end.grip_site).id)
    qpos = model.jnt_qposadr[model.dof_jntid[dofs]]
    assert got['t'] == pytest.approx(time_s, abs=1e-12)
    for key, wanted in (('q', data.qpos[qpos]), ('v', data.qvel[dofs]),
                        ('bias', (data.qfrc_bias - data.qfrc_gravcomp)[dofs]),
                        ('mass', mass[np.ix_(dofs, dofs)]), ('jacobian', jacobian[:, dofs]),
                        ('effort', np.zeros(len(dofs)))):
        np.testing.assert_allclose(got[key], wanted, rtol=1e-9, atol=1e-9, err_msg=key)
    assert np.abs(got['v']).max() > 0.0


def test_the_setpoints_of_a_law_go_on_in_each_step(panda_sim):
    setpoints = []

    def record(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        setpoints.append(setpoint[0].copy())
        effort[:] = bias + 20.0 * (setpoint[:, 1] - v)
    panda_sim.robot.set_law('arm', record)
    panda_sim.robot.apply(*panda_sim.robot.parse.joint_command(ARM[:1], position=[1.0]))
    panda_sim.advance(60)
    position, velocity, _ = np.array(setpoints).T
    assert len(setpoints) == 60 and velocity.max() > 0.1
    step_s = panda_sim.timestep_s
    # Each position follows from the velocities before and after it.
    np.testing.assert_allclose(np.diff(position), 0.5 * step_s * (velocity[1:] + velocity[:-1]),
                               atol=1e-4)


@pytest.mark.parametrize('command', ['pose', 'twist', 'action', 'until_contact'])
def test_cartesian_commands_move_the_setpoints_of_a_law_as_those_of_servos(command, panda_sim):
    other = Simulation(panda_sim.world)
    panda_sim.robot.set_law('arm', spring, stiffness=900.0, damping=60.0)
    start = panda_sim.robot.state().end_effectors['right'].pose
    for simulation in (panda_sim, other):
        parse = simulation.robot.parse_cartesian
        made = {'pose': lambda parse=parse: parse.pose(
                    'right', start.position + [0.05, 0.02, 0.0], start.quat_xyzw),
                'twist': lambda parse=parse: parse.twist('right', [0.3, 0.0, 0.1], [0.0] * 3),
                'action': lambda parse=parse: parse.action('right', [1.0, 0.5, 0.0, 0, 0, 0.5]),
                'until_contact': lambda parse=parse: parse.until_contact(
                    'right', [0.1, 0.0, 0.0], [0.0] * 3, force=9.0, distance=9.0,
                    duration_s=0.4)}[command]()
        simulation.robot.apply(made, period_s=0.01)
    for _ in range(100):
        panda_sim.advance(5)
        other.advance(5)
        law_gets, servo_gets = (simulation.robot.controller_state('arm').reference
                                for simulation in (panda_sim, other))
        # The end effector itself is elsewhere, where a motion until contact ends.
        np.testing.assert_allclose(law_gets.position, servo_gets.position, atol=(
            2e-3 if command == 'until_contact' else 1e-5))
    moved = panda_sim.robot.state().end_effectors['right'].pose.position - start.position
    assert moved[0] > 0.02 and abs(moved[0] - (
        other.robot.state().end_effectors['right'].pose.position - start.position)[0]) < 2e-3


def test_the_reference_that_is_published_of_a_law_is_its_setpoint(panda_sim):
    robot = panda_sim.robot
    robot.set_law('arm', spring, stiffness=20.0)
    robot.apply(*robot.parse.joint_command(ARM[:1], position=[0.5]))
    panda_sim.advance(150)
    rows = controller_numbers(robot.controller_state('arm')).reshape(9, 7)
    setpoints = robot.joints.setpoints
    for row, expected in zip(rows, (setpoints.position, setpoints.velocity)):
        np.testing.assert_array_equal(row, expected[:7])
    assert rows[7, 0] == rows[0, 0] - panda_sim.data.qpos[0] > 0.01
    assert not robot.controller_state('arm').reference.gives_effort.any()
    robot.set_control_mode('arm', 'effort')
    robot.apply(*robot.parse.joint_command(ARM[:1], effort=[1.0]))
    panda_sim.advance(1)
    assert robot.controller_state('arm').reference.gives_effort.tolist() == [True] + [False] * 6


def test_a_law_feels_what_touches_its_tool():
    simulation = Simulation(World([compose_robot('Panda')]))
    simulation.robot.set_law('arm', spring)
    simulation.advance(1)
    reader = simulation.robot.end_effectors['right']
    body = int(simulation.model.site(reader.grip_site).bodyid[0])
    simulation.data.xfrc_applied[body, :3] = 0.0, 3.0, -4.0
    simulation.advance(20)
    got = recorded(simulation, 2)[1]['wrench']
    assert np.linalg.norm(got[:3]) == pytest.approx(5.0, rel=1e-3)
    told = simulation.robot.state().end_effectors['right'].external_wrench
    np.testing.assert_allclose(got[:3], told.force, atol=0.05)


@pytest.mark.parametrize('compensated', [True, False])
def test_bias_holds_the_arm_with_and_without_gravity_compensation(compensated):
    simulation = Simulation(World([compose_robot('Panda')], gravity_compensation=compensated))
    start = simulation.robot.controller_state('arm').position
    simulation.robot.set_law('arm', HOLDING)
    simulation.advance(500)
    assert np.abs(simulation.robot.controller_state('arm').position - start).max() < 1e-3


def test_efforts_are_clamped_to_the_limits_of_the_joints():
    @law
    def strong(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        effort[:] = 1e6
    simulation = Simulation(World([compose_robot('Panda')], gravity_compensation=False))
    simulation.robot.set_law('arm', strong)
    simulation.advance(1)
    assert simulation.robot.state().effort[:7].tolist() == [87.0] * 4 + [12.0] * 3


def test_parameters_are_read_and_changed_by_name_and_act_from_the_next_step_on(panda_sim):
    robot = panda_sim.robot
    robot.set_law('arm', spring, stiffness=100.0)
    parameters = robot.law_parameters('arm')
    assert dict(parameters) == {'stiffness': 100.0, 'damping': 30.0}
    parameters['stiffness'] = 300
    assert robot.settings['law.arm.stiffness'] == parameters['stiffness'] == 300.0
    assert recorded_parameters(panda_sim) == [300.0, 30.0]


def recorded_parameters(simulation):
    return simulation.robot.joints.seats.of['arm'].parameters.tolist()


@pytest.mark.parametrize(('change', 'error', 'text'), [
    (lambda p: p.__setitem__('stiffness', math.nan), ModelError, 'stiffness must be a finite'),
    (lambda p: p.__setitem__('stiffness', 'high'), ModelError, 'stiffness must be a finite'),
    (lambda p: p.__setitem__('stiffness', 10**400), ModelError, 'stiffness must be a finite'),
    (lambda p: p.__setitem__('stifness', 1.0), UnknownNameError, "'stifness': did you mean 'stif"),
    (lambda p: p['damp'], UnknownNameError, "'damp': did you mean 'damping'"),
    (lambda p: p.__delitem__('damping'), TypeError, 'cannot be deleted')])
def test_what_no_parameter_can_be_is_rejected_and_changes_nothing(change, error, text, panda_sim):
    panda_sim.robot.set_law('arm', spring)
    parameters = panda_sim.robot.law_parameters('arm')
    before = dict(parameters)
    with pytest.raises(error, match=text):
        change(parameters)
    assert dict(parameters) == before


@pytest.mark.parametrize(('act', 'error', 'text'), [
    (lambda robot: robot.set_law('arm', spring, mass=1.0), UnknownNameError, "'mass'"),
    (lambda robot: robot.set_law('arm', spring, damping=math.inf), ModelError, 'damping must be'),
    (lambda robot: robot.set_law('leg', spring), UnknownNameError, "'leg'"),
    (lambda robot: robot.set_law('right/gripper', spring), CommandError, 'is a gripper'),
    (lambda robot: robot.set_law('arm', 'spring'), ModelError, 'must be a function'),
    (lambda robot: robot.set_law('arm', lambda *_: None), ModelError, 'function with a name'),
    (lambda robot: robot.set_law('arm', math.sin), ModelError, 'must take 11 arguments'),
    (lambda robot: robot.law_parameters('arm'), ModelError, 'control mode is position'),
    (lambda robot: robot.law_parameters('leg'), UnknownNameError, "'leg'")])
def test_what_no_law_can_be_is_rejected_and_changes_nothing(act, error, text, panda_sim):
    digest = panda_sim.digest()
    with pytest.raises(error, match=text):
        act(panda_sim.robot)
    assert panda_sim.digest() == digest and not panda_sim.robot.laws


def test_arguments_of_a_law_may_have_other_names_but_not_those_of_one_another():
    def renamed(t, position, v, bias, m, jacobian, wrench, setpoint, numbers, memory, effort):
        """Do nothing."""

    def swapped(t, v, q, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        """Do nothing."""

    assert law(renamed).name == 'renamed'
    with pytest.raises(ModelError, match="'v' is in the place of 'q'"):
        law(swapped)


@pytest.mark.parametrize(('arguments', 'text'), [
    ({'parameters': [1.0]}, 'parameters must be a dict'),
    ({'parameters': {'two words': 1.0}}, 'must be a word'),
    ({'parameters': {'where': 1.0}}, "cannot be named 'where'"),
    ({'parameters': {'gain': None}}, 'gain must be a finite number'),
    ({'parameters': {'gain': 10**400}}, 'gain must be a finite number'),
    ({'parameters': 0}, 'parameters must be a dict'),
    ({'parameters': np.zeros(2)}, 'parameters must be a dict'),
    ({'memory': -1}, 'memory must be a whole number from 0'),
    ({'memory': 1.5}, 'memory must be a whole number from 0'),
    ({'memory': 10**9}, 'memory must be a whole number from 0')])
def test_a_law_that_cannot_be_is_rejected_where_it_is_written(arguments, text):
    with pytest.raises(ModelError, match=text):
        law(**arguments)(spring.function)


@pytest.mark.full
def test_a_function_that_numba_has_decorated_is_a_compiled_law(panda_sim, caplog):
    other = Simulation(panda_sim.world)
    decorated = numba.njit(holding_alone)
    assert law_of(decorated).is_compiled and law(memory=2)(decorated).memory == 2
    panda_sim.robot.set_law('arm', decorated)
    assert not caplog.messages
    other.robot.set_law('arm', holding_alone)
    assert 'runs as plain Python' in caplog.text
    for simulation in (panda_sim, other):
        stream(simulation, 5)
    assert panda_sim.digest() == other.digest()


def test_an_object_with_a_state_of_its_own_is_a_law_in_plain_python(panda_sim):
    class Counting:
        calls = 0

        def __call__(self, t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory,
                     effort):
            self.calls += 1
            effort[:] = bias

    counting = Counting()
    panda_sim.robot.set_law('arm', counting)
    panda_sim.advance(10)
    assert panda_sim.robot.laws == {'arm': 'Counting'} and counting.calls == 10


def test_a_law_that_returns_efforts_is_rejected_or_stopped_as_they_would_be_lost(panda_sim):
    @law
    def returning(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        return bias
    robot = panda_sim.robot
    with pytest.raises(ModelError, match=r"law 'returning' returns a value, array\(float64.*"
                                         r'fill effort'):
        robot.set_law('arm', returning)
    assert not robot.laws
    robot.set_law('arm', returning, compiled=False)
    panda_sim.advance(5)
    assert 'it returns a value, ndarray: it must' in robot.reflexes.tripped['arm']


def test_a_law_that_assigns_to_effort_is_rejected_and_one_that_adds_to_it_is_not(panda_sim):
    def lost(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, torque):
        torque = bias - 5.0 * v
        memory[0] = torque[0]

    def both(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        gain, effort = 5.0, bias
        effort[:] = -gain * v

    def added(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        damping = 5.0 * v
        effort += bias
        effort -= damping

    for wrong in (lost, both):
        with pytest.raises(ModelError, match='gives its last argument another value.*fill effort'):
            law(memory=1)(wrong)
    panda_sim.robot.set_law('arm', law(compiled=False)(added))
    panda_sim.advance(20)
    assert not panda_sim.robot.reflexes.tripped
    assert np.abs(panda_sim.robot.state().velocity).max() < 1e-9


def test_a_law_that_cannot_be_compiled_says_why_in_one_line(panda_sim):
    @law
    def opening(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        effort[0] = len(open('log'))  # noqa: SIM115
    with pytest.raises(ModelError, match="^law 'opening' cannot be compiled: .*open.*compiled=F"
                       ) as error:
        panda_sim.robot.set_law('arm', opening)
    assert '\n' not in str(error.value) and not panda_sim.robot.laws


def test_no_law_acts_with_an_integrator_that_has_no_halves(panda_sim):
    panda_sim.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    with pytest.raises(ModelError, match='RK4'):
        panda_sim.robot.set_law('arm', spring)


def test_memory_and_parameters_are_a_part_of_the_state(panda_sim):
    robot = panda_sim.robot
    robot.set_law('arm', spring, stiffness=150.0)
    stream(panda_sim, 10)
    state, digest = pickle.loads(pickle.dumps(panda_sim.save())), panda_sim.digest()
    robot.law_parameters('arm')['stiffness'] = 50.0
    assert panda_sim.digest() != digest
    stream(panda_sim, 5, 10)
    other = Simulation(panda_sim.world)
    for simulation in (panda_sim, other):
        simulation.restore(state)
        assert simulation.digest() == digest
        assert dict(simulation.robot.law_parameters('arm')) == {
            'stiffness': 150.0, 'damping': 30.0}
        assert simulation.robot.joints.seats.of['arm'].memory[0] == 100.0
        stream(simulation, 5, 10)
    assert panda_sim.digest() == other.digest()
    assert other.robot.joints.seats.of['arm'].memory[0] == 150.0
    panda_sim.reset()
    assert panda_sim.robot.joints.seats.of['arm'].memory.tolist() == [0.0, 0.0]


def test_a_state_of_a_law_with_another_memory_is_rejected(panda_sim):
    panda_sim.robot.set_law('arm', spring)
    state = pickle.dumps(panda_sim.save())
    LAWS.add(Law(spring.function, spring.defaults, memory=3))
    with pytest.raises(ModelError, match="saved with another law 'spring'"):
        panda_sim.restore(pickle.loads(state))


def not_finite(parameters, memory):
    return math.nan


def out_of_bounds(parameters, memory):
    return memory[int(parameters[1])]


def raising(parameters, memory):
    if parameters[1] > 0.0:
        raise ValueError('a tool is missing')
    return 0.0


FAILURES = {not_finite: 'effort that is not finite', out_of_bounds: 'IndexError',
            raising: 'ValueError: a tool is missing'}


@functools.cache
def failing(failure):
    """Return a law that holds its arm until a time, and then fails."""
    fail = numba.njit(failure, boundscheck=True)

    @law(parameters={'end': 0.05, 'index': 1e4}, memory=1)
    def own(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
        for i in range(len(q)):
            effort[i] = bias[i] + 100.0 * (setpoint[i, 0] - q[i]) - 20.0 * v[i]
        if t > parameters[0]:
            effort[0] += fail(parameters, memory)
    return own


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('failure', FAILURES)
def test_a_law_that_fails_is_stopped_by_a_reflex_and_begins_anew_when_told(
        failure, compiled, panda_sim):
    robot, own = panda_sim.robot, failing(failure)
    robot.set_law('arm', own, compiled=compiled)
    panda_sim.advance(20)
    assert not robot.reflexes.tripped
    panda_sim.advance(20)
    assert FAILURES[failure] in robot.reflexes.tripped['arm']
    assert "the law 'own'" in robot.reflexes.tripped['arm']
    (refused,) = robot.parse.joint_command(ARM[:1], position=[0.1])
    robot.apply(refused)
    assert refused.handle.status is Status.ABORTED
    held = robot.state().position
    for _ in range(10):
        panda_sim.advance(20)
    assert robot.reflexes.counts['arm'] == 1
    assert np.abs(robot.state().position - held).max() < 1e-3
    robot.law_parameters('arm')['end'] = 10.0
    robot.reset_reflexes()
    panda_sim.advance(20)
    assert not robot.reflexes.tripped and robot.joints.seats.of['arm'].acts
    assert robot.laws == {'arm': 'own'}


def test_a_law_that_begins_while_a_reflex_stops_its_arm_waits_for_the_reset(panda_sim):
    robot = panda_sim.robot
    robot.set_law('arm', failing(not_finite))
    panda_sim.advance(50)
    robot.set_control_mode('arm', 'position')
    robot.set_law('arm', spring)
    panda_sim.advance(20)
    assert robot.joints.seats.of['arm'].memory[0] == 0.0
    robot.reset_reflexes()
    panda_sim.advance(20)
    assert robot.joints.seats.of['arm'].memory[0] == 20.0


def test_a_law_of_one_arm_that_fails_leaves_the_other_arm_its_law():
    simulation = Simulation(World([compose_robot('Baxter')]))
    robot = simulation.robot
    robot.set_law('right', failing(not_finite))
    robot.set_law('left', spring)
    simulation.advance(100)
    assert {*robot.reflexes.tripped} == {'right'}
    assert robot.joints.seats.of['left'].memory[0] == 100.0
    assert robot.laws == {'right': 'own', 'left': 'spring'}


def test_a_law_of_both_arms_has_one_memory_and_one_set_of_parameters_for_each():
    simulation = Simulation(World([compose_robot('Baxter')]))
    simulation.robot.set_law('arm', spring)
    simulation.robot.law_parameters('arm')['stiffness'] = 90.0
    simulation.robot.law_parameters('left')['stiffness'] = 80.0
    simulation.advance(10)
    of = simulation.robot.joints.seats.of
    assert {part: seat.parameters[0] for part, seat in of.items()} == {'right': 90.0, 'left': 80.0}
    assert of['left'].memory is not of['right'].memory


def test_any_other_control_mode_ends_a_law_within_the_limits_of_the_joints(panda_sim):
    robot, joints = panda_sim.robot, panda_sim.robot.joints
    robot.set_law('arm', spring)
    robot.apply(*robot.parse.joint_command(ARM[:1], position=[1.5]))
    panda_sim.advance(200)
    indices = joints.indices_of('arm')
    before = joints.measured(indices, panda_sim.data)[1][0]
    assert before > 0.3
    robot.set_control_mode('arm', 'position')
    limit = joints.acceleration_limits(indices)[0] * panda_sim.timestep_s
    for _ in range(300):
        panda_sim.advance(1)
        now = joints.measured(indices, panda_sim.data)[1][0]
        assert abs(now - before) <= 1.5 * limit
        before = now
    assert abs(now) < 1e-3 and not robot.laws
    assert robot.settings['control_mode.arm'] == 'position'


def test_a_law_that_runs_as_python_says_that_it_is_slow(panda_sim, caplog):
    caplog.set_level(logging.WARNING, logger='manip_sim.control')
    panda_sim.robot.set_law('arm', spring.function)
    (record,) = caplog.records
    assert 'plain Python' in record.getMessage() and 'slow' in record.getMessage()


def test_a_law_is_a_control_mode_by_its_name(panda_sim):
    LAWS.add(spring)
    panda_sim.robot.set_control_mode('arm', 'law:spring')
    stream(panda_sim, 2)
    assert panda_sim.robot.joints.seats.of['arm'].memory[0] == 20.0
    with pytest.raises(UnknownNameError, match="'law:sprin': did you mean 'law:spring'"):
        panda_sim.robot.set_control_mode('arm', 'law:sprin')


@pytest.mark.full
def test_a_compiled_law_that_never_returns_is_named_before_the_process_ends(tmp_path):
    script = tmp_path / 'endless.py'
    script.write_text(
        'import logging\n'
        'import manip_sim.control.seats as seats\n'
        'from manip_sim.laws import law\n'
        'from manip_sim.models import compose_robot, World\n'
        'from manip_sim.simulation import Simulation\n'
        'logging.basicConfig()\n'
        'seats._PATIENCE_S = 2\n'
        '@law(memory=1)\n'
        f'def endless({", ".join(ARGUMENTS)}):\n'
        '    while t > 0.02:\n'
        '        memory[0] += 1.0\n'
        "simulation = Simulation(World([compose_robot('Panda')]))\n"
        "simulation.robot.set_law('arm', endless)\n"
        'for _ in range(100):\n'
        '    simulation.advance(10)\n')
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert ended.returncode == _EXIT_CODE
    assert "the law 'endless' of arm has not returned for 2 s: the process ends" in ended.stderr


def changed_worlds(simulation):
    """Change the world in three ways, one after the other; yield after each."""
    ball = create_object({'name': 'ball', 'shape': 'sphere', 'size': [0.05], 'mass': 1.0,
                          'position': [2.0, 0.0, 0.1]})
    simulation.change_objects(plan_with(simulation.plan, ball))
    yield
    simulation.change_objects(plan_without(simulation.plan, 'ball'))
    yield
    simulation.change_robots(plan_in_arena(simulation, create_arena('bins')))
    yield


def test_a_law_outlasts_changes_of_the_world(panda_sim):
    other = Simulation(panda_sim.world)
    for simulation, compiled in ((panda_sim, True), (other, False)):
        robot = simulation.robot
        robot.set_law('arm', spring, compiled=compiled, stiffness=150.0)
        stream(simulation, 5)
        for number, _ in enumerate(changed_worlds(simulation)):
            stream(simulation, 5, 5 * number + 5)
        assert robot.joints.seats.of['arm'].memory[0] == 200.0
        assert dict(robot.law_parameters('arm')) == {'stiffness': 150.0, 'damping': 30.0}
    assert panda_sim.digest() == other.digest()


def test_an_impedance_and_an_emergency_stop_outlast_changes_of_the_world(panda_sim):
    robot = panda_sim.robot
    robot.set_control_mode('arm', 'impedance')
    robot.apply(*robot.parse.joint_impedance(ARM, effort=[5.0, *[0.0] * 6], stiffness=100.0,
                                             damping=20.0))
    for _ in changed_worlds(panda_sim):
        panda_sim.advance(1000)
        assert robot.state().position[0] == pytest.approx(0.05, rel=0.02)
    robot.emergency_stop()
    for _ in changed_worlds(panda_sim):
        panda_sim.advance(10)
        assert robot.safety_state == 'emergency_stop'


def test_setpoints_of_a_law_come_to_rest_after_a_timeout(panda_sim):
    robot = panda_sim.robot
    robot.set_law('arm', spring)
    robot.set_command_timeout('arm', 0.1)
    (command,) = robot.parse.joint_command(ARM[:1], position=[2.0])
    robot.apply(command)
    for _ in range(300):
        panda_sim.advance(5)
    reference = robot.controller_state('arm').reference
    assert 0.0 < reference.position[0] < 1.0 and reference.velocity[0] == 0.0
    assert command.handle.status is Status.ABORTED
