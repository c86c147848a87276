# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What a session tells the page of a node that comes, changes, falls silent and goes."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='the session needs ROS 2')
pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.errors import MessageError  # noqa: E402
from manip_sim.viewer import session  # noqa: E402
from manip_sim.viewer.discovery import Layout, Readers, RobotTopics  # noqa: E402
from manip_sim.viewer.page.latest import JointStates, Latest, ShownStatus  # noqa: E402
from manip_sim.viewer.session import States  # noqa: E402

ROBOT = RobotTopics('/', ('arm', 'right/gripper'), ('right',), True)
OTHER = RobotTopics('/left/', ('arm',), (), False)


class Keeper:
    """Takes any call and keeps the arguments of the last one of each name."""

    def __init__(self, *_, **properties):
        self.calls, self.counts = {}, {}
        self.__dict__.update(properties)

    def __getattr__(self, name):
        def call(*arguments):
            self.calls[name] = arguments
            self.counts[name] = self.counts.get(name, 0) + 1
            return ()
        return call


@pytest.fixture
def seen(monkeypatch):
    """Return a session, what it knows of a node, and its page."""
    parts = SimpleNamespace(
        discovery=Keeper(is_there=False, layout=None, model=None, models=0, checking=None,
                         base='/'),
        states=Keeper(latest=Latest(), frames={}), sender=Keeper(),
        page=Keeper(is_watched=False, wants_markers=False))
    for name, part in (('Discovery', parts.discovery), ('States', parts.states),
                       ('CommandSender', parts.sender), ('Page', parts.page)):
        monkeypatch.setattr(session, name, lambda *_, part=part: part)
    parts.session = session.Session(None, SimpleNamespace(rejected=0), 'sim', None, False)

    def update(now_s):
        parts.session.update(now_s)
        return parts.page.calls['show_state']
    parts.update = update
    return parts


def appear(seen, *robots):
    seen.discovery.__dict__.update(is_there=True, layout=Layout(robots), model='model', models=1)


def send_states(seen, now_s):
    seen.states.latest.joints['/'] = JointStates(['a'], np.zeros(1), np.zeros(1), np.zeros(1), 7.0)
    seen.states.latest.joints_s = now_s


def test_a_node_is_waited_for_at_first_and_gone_only_after_it_was_there(seen):
    assert seen.update(1.0) == ('waiting', 'waiting for the node /sim', None)
    appear(seen, ROBOT)
    assert seen.update(2.0) == ('waiting', 'waiting for the states of /sim', None)
    seen.discovery.__dict__.update(is_there=False)
    assert seen.update(3.0) == ('gone', '/sim is gone; waiting for it to come back', None)


def test_a_node_runs_until_it_says_that_something_is_wrong(seen):
    appear(seen, ROBOT)
    send_states(seen, 1.0)
    assert seen.update(1.0) == ('running', '7.0 s', False)
    seen.session._diagnosed([ShownStatus(1, 'simulation', 'slow', {'state': 'free'})])
    send_states(seen, 2.0)
    assert seen.update(2.0)[0] == 'trouble'


def test_a_node_is_silent_by_the_age_of_its_last_states(seen):
    appear(seen, ROBOT)
    send_states(seen, 100.0)
    assert seen.update(100.0)[0] == 'running'
    assert seen.update(102.0)[0] == 'running'
    assert seen.update(105.0) == ('trouble', 'no states for 5 s', None)


def test_the_topics_of_a_layout_are_listened_to_once_and_those_of_another_one_instead(seen):
    appear(seen, ROBOT)
    seen.update(1.0)
    assert seen.states.calls['listen'] == (Layout((ROBOT,)),)
    assert seen.sender.calls['prepare'][0].keys() >= {
        '/arm/joint_command', '/right/gripper/joint_command', '/right/gripper/command',
        '/right/target_pose', '/base/cmd_vel', '/sim/pull'}
    seen.update(2.0)
    assert seen.states.counts['listen'] == 1
    appear(seen, ROBOT, OTHER)
    seen.update(3.0)
    assert seen.states.calls['listen'] == (Layout((ROBOT, OTHER)),)
    assert seen.states.counts['listen'] == 2


def test_the_panels_are_those_of_another_robot_with_the_same_topics(seen):
    appear(seen, ROBOT)
    seen.discovery.robots = lambda: ['UR5e']
    seen.update(1.0)
    assert seen.page.calls['show_robots'] == (['UR5e'], ())
    seen.discovery.__dict__.update(robots=lambda: ['Panda'], models=2)
    seen.update(2.0)
    assert seen.page.calls['show_robots'] == (['Panda'], ())
    seen.update(3.0)
    assert (seen.page.counts['show_robots'], seen.page.counts['show_model']) == (2, 2)


def test_states_of_robots_that_are_gone_are_forgotten(node):
    states = States(node, Readers(node), 'sim', '/')
    states.listen(Layout((ROBOT, OTHER), ('cube',)))
    latest, key = states.latest, ('/left/', 'right')
    latest.joints.update({'/': 'here', '/left/': 'gone'})
    latest.end_effectors[key] = latest.wrenches[key] = states.frames[key] = 'gone'
    latest.end_effectors['/', 'right'] = latest.objects['cube'] = 'here'
    states.listen(Layout((ROBOT,), ('cube',)))
    assert (latest.joints, latest.end_effectors, latest.wrenches, states.frames) == (
        {'/': 'here'}, {('/', 'right'): 'here'}, {}, {})
    assert latest.objects == {'cube': 'here'}


def test_messages_that_are_rejected_are_counted_and_told_beside_what_the_node_tells(seen, node):
    readers = Readers(node)
    seen.session._readers = readers
    running = ShownStatus(0, 'simulation', 'running', {'state': 'free'})
    seen.session._diagnosed([running])
    assert seen.page.calls['show_diagnostics'] == ([running],)
    readers.reject('/joint_states', MessageError('position: nan cannot be drawn'))
    seen.session._diagnosed([running])
    (told,) = seen.page.calls['show_diagnostics']
    assert [status.message for status in told] == [
        'running', '1 message rejected, see its log']
