# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The thread that runs the simulation: how it ends for those who ask it something."""

from concurrent.futures import ThreadPoolExecutor
import re
import sys
from threading import Event
import time

import numpy as np
import pytest

from manip_sim.control.commands import Status
from manip_sim.errors import CommandError, ModelError, SimulationEnded, UnknownNameError
from manip_sim.models import World
from manip_sim.models.robots import Panda, UR5e
from manip_sim.runtime import simulation_thread, SimulationThread
from manip_sim.runtime.simulation_thread import Observers
from manip_sim.simulation import Simulation


@pytest.fixture
def thread():
    return SimulationThread(Simulation(World([Panda()])), steps=5)


def test_a_call_after_the_end_is_rejected(thread):
    thread.stop()
    with pytest.raises(SimulationEnded, match='the simulation has ended'):
        thread.call(lambda: None)


def test_a_call_before_the_start_is_answered_at_once(thread):
    assert thread.call(lambda: 7) == 7
    thread.set_real_time_factor(2.0)
    assert thread.real_time_factor == 2.0


def test_the_pace_begins_again_when_a_pause_ends_and_at_no_other_time(thread):
    due_s = thread._pacer.deadline_s
    for paused in (False, False, True, True):
        # Who says again and again that it shall run must not hold it up.
        thread.pause(paused)
        assert thread.paused is paused
        assert thread._pacer.deadline_s == due_s
    thread.pause(False)
    assert thread._pacer.deadline_s > due_s


def test_a_state_that_is_held_is_shown_again_after_a_tenth_of_a_second(thread):
    thread._show()
    assert thread._repeat_at - thread.progress.wall_s == pytest.approx(0.1)


def test_a_call_that_waits_is_rejected_at_the_end():
    published, released = Event(), Event()

    def publish(_):
        published.set()
        released.wait(10.0)

    thread = SimulationThread(Simulation(World([Panda()])), steps=5)
    thread.observe(publish)
    thread.start()
    assert published.wait(10.0)
    with ThreadPoolExecutor(2) as pool:
        waiting = pool.submit(thread.call, lambda: None)
        wait_until(lambda: thread._calls)
        ending = pool.submit(thread.stop)
        wait_until(lambda: thread._stopping)
        released.set()
        with pytest.raises(SimulationEnded, match='the simulation has ended'):
            waiting.result(timeout=300.0)
        ending.result(timeout=300.0)


def test_a_call_to_a_paused_simulation_does_not_wait_until_the_state_is_repeated(
        free, monkeypatch):
    monkeypatch.setattr(simulation_thread, '_REPEAT_S', 1e6)
    thread = free(paused=True)
    thread.start()
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(thread.call, lambda: 7)
        try:
            assert asked.result(timeout=30.0) == 7
        finally:
            thread.stop()


def wait_until(condition):
    end = time.monotonic() + 300.0
    while not condition():
        assert time.monotonic() < end, 'timed out'
        time.sleep(1e-3)  # The thread that is waited for needs Python's lock.


def test_a_call_that_ends_the_thread_keeps_no_other_waiting(thread):
    def leave():
        raise SystemExit('over')
    begun = Event()
    with ThreadPoolExecutor(3) as pool:
        thread.start()
        first = pool.submit(thread.call, lambda: begun.wait(60.0))
        while not thread._showing and first.running() and thread._calls:
            time.sleep(0.001)
        others = [pool.submit(thread.call, function) for function in (leave, leave)]
        deadline = time.monotonic() + 60.0
        while len(thread._calls._waiting) < 2 and time.monotonic() < deadline:
            time.sleep(0.001)
        begun.set()
        assert first.result(60.0)
        for other in others:
            with pytest.raises(SystemExit, match='over'):
                other.result(60.0)
    thread.stop()
    assert isinstance(thread.error, SystemExit)


def test_a_command_that_fails_is_told_and_the_simulation_goes_on():
    simulation, told = Simulation(World([Panda()])), []
    thread = SimulationThread(
        simulation, steps=5, paused=True,
        report_failure=lambda what, error: told.append((what, str(error))))
    command = simulation.robot.parse.action('arm', [0.0] * 7)

    def fail(*_, **__):
        raise RuntimeError('broken')
    simulation.robot.joints.apply = fail
    thread.start()
    (handle,) = thread.submit([command])
    thread.step()
    thread.step()
    thread.stop()
    assert told == [('arm', 'broken')]
    assert (handle.status, handle.reason) == (Status.ABORTED, 'broken')
    assert thread.error is None


def test_an_operation_of_a_period_that_fails_is_told_and_the_simulation_goes_on():
    simulation, told, done = Simulation(World([Panda()])), [], []
    thread = SimulationThread(
        simulation, steps=5, paused=True,
        report_failure=lambda what, error: told.append((what, str(error))))

    def fail():
        raise KeyError('gone')
    thread.changes.operations._named = {
        'fail': fail, 'note': lambda: done.append(simulation.step_count - begin)}
    thread.start()
    begin = simulation.step_count
    thread.changes.at_next_period('pull/cube', 'fail')
    thread.changes.at_next_period('arena/door', 'note')
    thread.step()
    thread.stop()
    assert told == [('pull/cube', "'gone'")] and done == [0]
    assert thread.error is None and simulation.step_count == begin + 5


def test_a_reset_that_cannot_draw_its_start_changes_nothing():
    thread = SimulationThread(Simulation(World([Panda()])), steps=5, paused=True)

    def fail(seed):
        raise ModelError(f'no room with {seed}')
    thread.changes.operations.restart = fail
    thread.start()
    thread.next_seed = 3
    command = thread._simulation.robot.parse.action('arm', [0.1] * 7)
    (handle,) = thread.submit([command])
    done = []
    operations = thread.changes.operations
    operations._named = {**operations._named, 'note': lambda: done.append(1)}
    thread.changes.at_next_period('pull/cube', 'note')
    with pytest.raises(ModelError, match='no room with 3'):
        thread.reset()
    assert handle.is_active
    thread.step()
    thread.stop()
    assert done == [1] and handle.status is not Status.ABORTED


@pytest.fixture
def free():
    """Return a function that makes a thread for some robots, ended after the test."""
    threads = []

    def start(*robots, **arguments):
        threads.append(SimulationThread(Simulation(World(robots or [Panda()])), steps=5,
                                        **arguments))
        return threads[-1]
    yield start
    for thread in threads:
        thread.stop()


def test_each_observer_sees_the_periods_that_are_multiples_of_its_divider(free):
    thread, seen = free(paused=True), {1: [], 3: [], 4: []}
    for every, times in seen.items():
        thread.observe(lambda simulation, times=times: times.append(simulation.time_ns), every)
    thread.start()
    for _ in range(12):
        thread.step()
    thread.stop()
    # Beside these, the present state is repeated while nothing moves it on.
    stepped = {every: list(dict.fromkeys(times))[1:] for every, times in seen.items()}
    period_ns = 10_000_000
    assert stepped[1] == [period_ns * n for n in range(2, 14)]
    for every in (3, 4):
        multiples = [t for t in stepped[1] if t // period_ns % every == 0]
        assert set(multiples) <= set(stepped[every])
    assert len(stepped[4]) < len(stepped[3]) < 12


def test_observers_see_a_reset_whatever_their_divider(free):
    thread, seen = free(paused=True), []
    thread.observe(lambda simulation: seen.append(simulation.time_ns), every=1000)
    thread.start()
    thread.call(lambda: None)
    before = thread.progress.time_ns
    thread.reset()
    assert before + 10_000_000 in seen


def test_a_divider_below_one_is_rejected(free):
    with pytest.raises(ValueError, match='divider of an observer must be 1 or more, got 0'):
        free().observe(lambda simulation: None, every=0)


def test_an_observer_that_fails_ends_the_thread_and_is_told(free):
    thread = free()

    def fail(_):
        raise RuntimeError('broken')
    thread.observe(fail)
    thread.start()
    wait_until(lambda: thread.error is not None)
    assert str(thread.error) == 'broken'
    with pytest.raises(SimulationEnded):
        thread.call(lambda: None)


def test_each_of_two_robots_gets_its_own_commands(free):
    panda, ur5e = Panda(), UR5e(idn=1)
    ur5e.set_base_xpos([0.0, 2.0, 0.0])
    thread = free(panda, ur5e, paused=True)
    simulation = thread._simulation
    start = {name: robot.state().position.copy() for name, robot in simulation.robots.items()}
    goal = start['robot1'][:6] + 0.01
    thread.start()
    command = simulation.robots['robot1'].parse.joint_command(
        simulation.robots['robot1'].joints.names, goal)
    (handle,) = thread.submit(command, robot='robot1')
    for _ in range(100):
        thread.step()
    thread.stop()
    assert handle.status is Status.DONE
    np.testing.assert_allclose(simulation.robots['robot1'].state().position[:6], goal, atol=1e-3)
    np.testing.assert_allclose(simulation.robots['robot0'].state().position, start['robot0'],
                               atol=1e-3)


@pytest.mark.parametrize('begin_again', [SimulationThread.reset, SimulationThread.restore])
def test_commands_that_wait_are_aborted_by_a_new_beginning(free, begin_again):
    thread = free(UR5e(), paused=True)
    robot = thread._simulation.robot
    thread.start()
    thread.change('save')
    start = robot.state().position.copy()
    (handle,) = thread.submit(robot.parse.joint_command(['robot0_shoulder_pan_joint'], [0.3]))
    begin_again(thread)
    assert handle.status is Status.ABORTED
    assert re.fullmatch('the simulation was reset|a saved state was restored', handle.reason)
    for _ in range(20):
        thread.step()
    thread.stop()
    np.testing.assert_allclose(robot.state().position, start, atol=1e-3)


def test_a_restored_state_is_no_start(free):
    thread = free(UR5e(), paused=True)
    thread.start()
    thread.change('save')
    thread.reset()
    assert thread.at_start
    thread.restore()
    assert not thread.at_start
    thread.stop()


def test_commands_are_taken_by_the_robot_that_they_were_made_for_alone(free):
    aside = Panda(idn=1)
    aside.set_base_xpos([0.0, 2.0, 0.0])
    thread = free(Panda(), aside, paused=True)
    robots = thread._simulation.robots
    (own,) = robots['robot0'].parse.joint_command(['robot0_joint1'], [0.3])
    (other,) = robots['robot1'].parse.joint_command(['robot1_joint1'], [0.3])
    with pytest.raises(CommandError, match=r"^a command for robot 'robot1' cannot be applied to "
                                           r"robot 'robot0' of this simulation$"):
        thread.submit([own, other], robot='robot0')
    with pytest.raises(UnknownNameError, match=r"^unknown robot 'robot2': .*robot0, robot1$"):
        thread.submit([own], robot='robot2')
    thread.start()
    for _ in range(20):
        thread.step()
    assert own.handle.status is other.handle.status is Status.WAITING
    assert all(abs(robot.state().position[0]) < 1e-6 for robot in robots.values())


def test_lockstep_waits_for_the_arena_only_if_it_is_told_to():
    for waits in ({}, {'waits_for_arena': True}):
        thread = SimulationThread(Simulation(World([Panda()])), 5, 'lockstep',
                                  lockstep_parts={'robot0': ['arm']}, **waits)
        thread.submit([thread._simulation.robot.parse.action('arm', [0.0] * 7)])
        assert thread.changes.missing == ({'arena': ['arena']} if waits else {})
        thread.changes.at_next_period('arena/door', lambda: None)
        assert thread.changes.missing == {}


def test_operations_may_come_while_lockstep_looks_for_those_of_the_arena():
    thread = SimulationThread(Simulation(World([Panda()])), 5, 'lockstep',
                              lockstep_parts={}, waits_for_arena=True)
    numbers = iter(range(3_000))
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(1) as pool:
            adding = pool.submit(lambda: [
                thread.changes.at_next_period(f'other/{n}', 'reset') for n in numbers])
            while not adding.done():
                assert not thread.changes.complete
    finally:
        sys.setswitchinterval(interval)
    assert len(thread.changes._waiting) == 3_000


def test_lockstep_waits_for_the_parts_of_every_robot(free):
    thread = free(Panda(), UR5e(idn=1), stepping='lockstep',
                  lockstep_parts={'robot0': ['arm'], 'robot1': ['arm']})
    simulation = thread._simulation
    thread.start()
    stamp = thread.call(lambda: simulation.time_ns)
    answers = {name: [robot.parse.action('arm', np.zeros(len(robot.joints.names)))]
               for name, robot in simulation.robots.items()}
    thread.submit(answers['robot0'], stamp, 'robot0')
    time.sleep(0.05)
    assert thread.call(lambda: simulation.time_ns) == stamp
    thread.submit(answers['robot1'], stamp, 'robot1')
    wait_until(lambda: thread.progress.time_ns == stamp + 10_000_000)
    with pytest.raises(CommandError, match='the present state is that of'):
        thread.submit(answers['robot1'], stamp, 'robot1')


def test_a_reset_that_comes_with_the_last_command_of_lockstep_leaves_no_period_due(free):
    thread, resets = free(stepping='lockstep', lockstep_parts={'robot0': ['arm']}), []
    simulation, wait = thread._simulation, thread._wait
    with ThreadPoolExecutor(1) as pool:
        def wait_and_reset():
            is_due = wait()
            if is_due and not resets:
                resets.append(pool.submit(thread.reset))
                wait_until(lambda: thread._calls)
            return is_due
        thread._wait = wait_and_reset
        thread.start()
        stamp = thread.call(lambda: simulation.time_ns)
        thread.submit([simulation.robot.parse.action('arm', [0.0] * 7)], stamp)
        wait_until(lambda: resets)
        resets[0].result(timeout=300.0)
        # That of the start, which comes a period later and waits for the next command.
        assert thread.call(lambda: simulation.time_ns) == stamp + 10_000_000


def test_periods_that_nobody_sees_follow_each_other_at_once_and_what_comes_ends_that(free):
    thread, rounds, seen = free(stepping='free'), [], []
    simulation = thread._simulation
    advance, period, advanced = simulation.advance, thread._period, []

    def one(steps):
        advanced.append(steps)
        advance(steps)

    def several(most=1):
        advanced.clear()
        rounds.append(0)
        period(most)
        rounds[-1] = len(advanced)
    simulation.advance, thread._period = one, several
    looked = Event()
    thread.observe(lambda _: seen.append(len(rounds)), look=looked.is_set)
    thread.start()
    wait_until(lambda: max(rounds, default=0) > 1)
    assert not seen
    # A command is followed period by period, in the periods after it has come.
    command = simulation.robot.parse.action('arm', [0.5] * 7)
    begin = len(rounds)
    (handle,) = thread.submit([command])
    wait_until(lambda: handle.status is Status.DONE)
    assert rounds[begin + 1:].count(1) > 50
    wait_until(lambda: max(rounds[-2:]) > 1)
    looked.set()
    wait_until(lambda: len(seen) > 50)
    # From the first look on each period is seen.
    assert seen[:50] == list(range(seen[0], seen[0] + 50))
    assert set(rounds[seen[0]:seen[0] + 49]) == {1}
    thread.pause(True)
    paused = thread.progress.time_ns
    thread.step()
    assert thread.progress.time_ns == paused + 10_000_000


@pytest.mark.parametrize('stepping', ['realtime', 'lockstep'])
def test_periods_that_are_due_one_by_one_are_never_run_at_once(free, stepping):
    thread = free(stepping=stepping, real_time_factor=10.0)
    period = thread._period

    def at_most_one(most=1):
        assert most == 1
        period(most)
    thread._period = at_most_one
    thread.start()
    wait_until(lambda: thread.progress.time_ns > 500_000_000)
    assert thread.error is None


def test_a_reader_that_comes_is_seen_within_the_interval_of_the_looks_and_costs_nothing_before():
    observers, looks, seen, there = Observers(), [], [], []

    def look():
        looks.append(1)
        return bool(there)
    observers.add(seen.append, 1, look)
    assert not observers.absent
    observers.show('first', 0, 100.0, look=False)
    assert observers.absent and (len(looks), seen) == (1, [])
    there.append('reader')
    for n in range(19):
        observers.show(f'state {n}', n, 100.0 + 0.001 * n, look=False)
    assert (len(looks), seen) == (1, [])
    observers.show('due', 0, 100.021, look=False)
    assert not observers.absent and (len(looks), seen) == (2, ['due'])
    there.clear()
    observers.show('held', 0, 100.022, look=True)
    assert observers.absent and (len(looks), seen) == (3, ['due'])
    there.append('reader')
    observers.refresh()
    assert not observers.absent
    observers.show('asked for', 0, 100.023, look=False)
    assert seen == ['due', 'asked for']


def test_an_observer_without_a_look_is_always_called(free):
    observers, seen = Observers(), []
    observers.add(seen.append, 2, None)
    for n in range(5):
        observers.show(n, n, 100.0, look=False)
        assert not observers.absent
    assert seen == [0, 2, 4]


@pytest.mark.parametrize('stepping', ['realtime', 'free', 'lockstep'])
def test_an_observer_may_pause_and_resume_the_simulation_that_waits_for_it(free, stepping):
    thread, paused_at = free(stepping=stepping, real_time_factor=10.0), []

    def pause(simulation):
        if not paused_at and simulation.time_s > 0.2:
            thread.pause(False)
            thread.pause(True)
            paused_at.append(simulation.time_ns)
    thread.observe(pause)
    thread.start()
    wait_until(lambda: paused_at)
    assert thread.paused
    assert thread.call(lambda: thread.progress.time_ns) == paused_at[0]
    thread.pause(False)
    wait_until(lambda: thread.progress.time_ns > paused_at[0])


def test_a_reset_by_an_observer_is_shown_after_the_present_state(free):
    thread, seen = free(paused=True), []

    def start_again(simulation):
        if simulation.time_ns == 30_000_000:
            thread.reset(restart_time=True)
            assert thread.at_start
    thread.observe(start_again)
    # Of the instant that ends so, the observers that follow see what has become of it.
    thread.observe(lambda simulation: seen.append((simulation.time_ns, thread.at_start)))
    thread.start()
    thread.step()
    thread.step()
    wait_until(lambda: seen.count((10_000_000, True)) >= 3)
    assert list(dict.fromkeys(seen)) == [(10_000_000, True), (20_000_000, False)]
    assert thread.progress.time_ns == 10_000_000
    assert thread.error is None


def test_a_reset_by_an_observer_is_shown_before_the_simulation_goes_on(free):
    thread, seen = free(stepping='free'), []

    def start_again(simulation):
        seen.append(simulation.time_ns // 10_000_000)
        if seen[-1] == 3:
            thread.reset(restart_time=True)
    thread.observe(start_again)
    thread.start()
    wait_until(lambda: len(seen) > 100)
    assert seen[:99] == [1, 2, 3] * 33


def test_an_observer_that_resets_every_state_keeps_nobody_waiting(free):
    thread = free(stepping='free')
    thread.observe(lambda _: thread.reset())
    thread.start()
    assert thread.call(lambda: 7) == 7


def test_an_observer_cannot_step_the_simulation(free):
    thread, told = free(paused=True), []

    def step(_):
        with pytest.raises(CommandError, match='an observer cannot step the simulation'):
            thread.step()
        told.append(1)
    thread.observe(step)
    thread.start()
    wait_until(lambda: told)
    assert thread.call(lambda: thread.progress.time_ns) == 10_000_000


@pytest.mark.parametrize('stepping', ['realtime', 'free'])
def test_the_simulation_pauses_when_it_reaches_a_time(stepping):
    thread = SimulationThread(Simulation(World([UR5e()])), steps=5, stepping=stepping,
                              real_time_factor=10.0, paused=True)
    seen, held = [], Event()

    def watch(simulation):
        seen.append(simulation.time_ns)
        if thread.paused and len(seen) > 1 and seen[-1] == seen[-2]:
            held.set()

    thread.observe(watch)
    thread.start()
    try:
        # Between two periods, exactly at one, and a time that has passed.
        for time_s, end_ns in ((0.055, 60_000_000), (0.1, 100_000_000)):
            thread.pause_at(time_s)
            thread.pause(False)
            held.clear()
            assert held.wait(300.0)
            assert (seen[-1], thread.paused) == (end_ns, True)
        thread.pause_at(0.05)
        passed = Event()
        thread.observe(lambda simulation: simulation.time_ns > 300_000_000 and passed.set())
        thread.pause(False)
        assert passed.wait(300.0)
        assert not thread.paused
    finally:
        thread.stop()
    assert sorted(set(seen)) == list(range(10_000_000, max(seen) + 1, 10_000_000))


def test_the_simulation_pauses_in_time_where_many_periods_run_at_once():
    simulation = Simulation(World([UR5e()]))
    thread = SimulationThread(simulation, steps=5, stepping='free', paused=True)
    thread.start()
    try:
        for time_s in (2.005, 4.0):
            thread.pause_at(time_s)
            thread.pause(False)
            while not thread.paused:
                thread.call(lambda: None)
            assert simulation.time_ns == round(time_s * 100 + 0.25) * 10_000_000
        # It is at that time now, which does not stop it again.
        thread.pause(False)
        while simulation.time_ns < 5_000_000_000:
            thread.call(lambda: None)
            assert not thread.paused
    finally:
        thread.stop()
