# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bytes in which numbers are replaced are those that rclpy makes of the messages."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace as Plain

from geometry_msgs.msg import PoseStamped
import numpy as np
import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from manip_sim.channels import contents
from manip_sim.channels.contents import Channel, ROWS
from manip_sim.channels.kinds import clock_channel, controller_numbers
from manip_sim.control.controlled_joints import ControllerState, JointReference
from manip_sim.interface.topics import BY_NAME
from manip_sim.physics.robot_frames import TreeFrame
from manip_sim.ros import channel_publishers, messages, visualization_topics
from manip_sim.ros.channel_publishers import ChannelPublishers
from manip_sim.ros.feature import Output
from manip_sim.ros.messages import SerializedMessage
from manip_sim.ros.sim_node import SimNode

NAMES = [f'robot0_joint{n}' for n in range(1, 8)]
FRAMES = [TreeFrame('link1', 'world'), TreeFrame('link2', 'link1'), TreeFrame('ball', 'world')]
#: Where each number of a message is told by how many names and frames there are before it.
PREFIXES = ['', 'left/', 'a', 'ab', 'abc', 'rücken_']


def maker(kind, make, frame=''):
    """Return what makes messages of the fields that a channel has."""
    def message(stamp, numbers):
        channel = Channel(None, None, make, len(numbers), frame)
        return messages.message_of(kind, channel.fields(messages.nanoseconds_of(stamp), numbers))
    return message


def joints(names):
    return maker('sensor_msgs/JointState', contents.joint_state(names))


def controllers(names):
    kind = messages.CONTROLLER_TYPE
    return maker(kind, contents.controller_state(names, kind))


KINDS = {
    'clock': (lambda prefix: maker('rosgraph_msgs/Clock', contents.clock), 0),
    'joint_state': (lambda prefix: joints([prefix + name for name in NAMES]), 3 * len(NAMES)),
    'joint_state_of_one': (lambda prefix: joints([prefix + 'finger']), 3),
    'joint_state_of_none': (lambda prefix: joints([]), 0),
    'wrench': (lambda prefix: maker(
        'geometry_msgs/WrenchStamped', contents.wrench, prefix + 'ft_frame'), 6),
    'pose': (lambda prefix: maker(
        'geometry_msgs/PoseStamped', contents.pose, prefix + 'world'), 7),
    'twist': (lambda prefix: maker(
        'geometry_msgs/TwistStamped', contents.twist, prefix + 'world'), 6),
    'odometry': (lambda prefix: maker(
        'nav_msgs/Odometry', contents.odometry(prefix + 'base'), prefix + 'odom'), 13),
    'controller_state': (lambda prefix: controllers([prefix + name for name in NAMES]),
                         ROWS * len(NAMES)),
    'controller_state_of_one': (lambda prefix: controllers([prefix + 'x']), ROWS)}
if visualization_topics.TFMessage is not None:
    KINDS['transforms'] = (lambda prefix: partial(visualization_topics.transforms, FRAMES, prefix),
                           7 * len(FRAMES))
TIMES_NS = [0, 1, 999_999_999, 1_000_000_000, 123_456_789_012, (2**31 - 1) * 10**9 + 999_999_999]


def meaning(data, kind):
    """Return which bytes mean something: rclpy leaves those between aligned numbers alone."""
    found, message = np.zeros(len(data), dtype=bool), deserialize_message(data, kind)
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 0x55
        try:
            found[place] = place < 4 or deserialize_message(bytes(changed), kind) != message
        except Exception:
            found[place] = True
    return found


@pytest.mark.parametrize('prefix', PREFIXES)
@pytest.mark.parametrize('kind', KINDS)
def test_the_bytes_are_those_of_rclpy_for_any_numbers(kind, prefix):
    of_prefix, count = KINDS[kind]
    make, random = of_prefix(prefix), np.random.default_rng(0)
    message = SerializedMessage(make, count)
    assert message.patches
    kind = type(make(messages.stamp_of(1), np.ones(count)))
    means = meaning(message.at(1, np.ones(count)), kind)
    special = [0.0, -0.0, 5e-324, 1.7e308, -1.7e308, 1 / 3]
    for time_ns in TIMES_NS:
        for numbers in (random.normal(size=count), random.choice(special, size=count)):
            data = message.at(time_ns, numbers)
            assert isinstance(data, bytes)
            expected = serialize_message(make(messages.stamp_of(time_ns), numbers))
            # rclpy appends what happens to be in memory.
            assert means[-1] and len(data) <= len(expected)
            given = np.frombuffer(data, np.uint8)
            wanted = np.frombuffer(expected, np.uint8)[:len(data)]
            np.testing.assert_array_equal(given[means], wanted[means])


@pytest.mark.parametrize('kind', KINDS)
def test_readers_that_allow_nothing_behind_a_message_read_the_bytes(kind):
    typesys = pytest.importorskip('rosbags.typesys', reason='rosbags is not installed')
    of_prefix, count = KINDS[kind]
    make = of_prefix('left/')
    made = make(messages.stamp_of(7), np.arange(float(count)))
    data = SerializedMessage(make, count).at(7, np.arange(float(count)))
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    if type(made).__module__.split('.')[0] not in {name.split('/')[0] for name in store.fielddefs}:
        pytest.skip('rosbags does not know the package of this type')
    name = f'{type(made).__module__.split(".")[0]}/msg/{type(made).__name__}'
    assert bytes(store.serialize_cdr(store.deserialize_cdr(data, name), name))[:4] == data[:4]


def test_bytes_that_were_given_out_do_not_change():
    message = SerializedMessage(KINDS['pose'][0](''), 7)
    first = message.at(1, np.arange(7.0))
    message.at(2, np.ones(7))
    pose = deserialize_message(first, PoseStamped)
    assert messages.nanoseconds_of(pose.header.stamp) == 1
    assert pose.pose.orientation.w == 6.0


@pytest.mark.parametrize('change', [
    lambda numbers: np.round(numbers, 3), lambda numbers: numbers[::-1] + 1.0,
    lambda numbers: np.minimum(numbers, 2.0)])
def test_where_numbers_are_not_taken_as_they_are_the_message_itself_is_returned(change):
    def make(stamp, numbers):
        return KINDS['twist'][0]('')(stamp, change(numbers))

    message = SerializedMessage(make, 6)
    assert not message.patches
    numbers = np.linspace(0.0, 1.0, 6)
    assert message.at(7, numbers) == make(messages.stamp_of(7), numbers)


@pytest.mark.parametrize('kind', ['wrench', 'joint_state'])
def test_where_the_encoding_is_another_one_the_message_itself_is_returned(kind, monkeypatch):
    # As in XCDR2, where doubles are aligned to four bytes. Taken for CDR, these bytes are another
    # wrench, and no joint state at all, whose reading fails.
    monkeypatch.setattr('manip_sim.ros.messages.serialize_message',
                        lambda message: b'\0\7\0\0\0\0\0\0' + serialize_message(message)[4:])
    of_prefix, count = KINDS[kind]
    make = of_prefix('')
    message = SerializedMessage(make, count)
    assert not message.patches
    assert message.at(7, np.ones(count)) == make(messages.stamp_of(7), np.ones(count))


def test_what_is_no_message_is_made_each_time():
    message = SerializedMessage(lambda stamp, numbers: (stamp.nanosec, numbers.tolist()), 2)
    assert not message.patches
    assert message.at(5, np.ones(2)) == (5, [1.0, 1.0])


class Listeners:
    """A publisher in place of rclpy's."""

    def __init__(self):
        self.count, self.asked, self.published = 0, 0, []

    def get_subscription_count(self):
        self.asked += 1
        return self.count

    def publish(self, message):
        self.published.append(message)


class Instant:
    """What a topic sees of a simulation."""

    time_ns = 7


@pytest.fixture
def publish(monkeypatch):
    """Return a function that publishes a channel, with a publisher in place of rclpy's."""
    def start(channel):
        publisher = Listeners()
        monkeypatch.setattr(channel_publishers, 'create_output',
                            lambda *_: Output(publisher, None))
        context = Plain(robots={}, table=[], thread=Plain(observe=lambda *_: None),
                        is_built=True, inbox=None)
        return publisher, ChannelPublishers(context, lambda _: [[channel]])
    return start


def test_a_topic_is_read_and_published_while_somebody_listens_and_asked_at_a_look_only(publish):
    reads = []

    def read(simulation):
        reads.append(simulation)
        return np.ones(6)
    row = BY_NAME['<arm>/eef_twist']
    publisher, topics = publish(Channel(row, read, contents.twist, 6, 'world'))
    assert not topics.look()
    publisher.count = 1
    topics.publish(Instant())
    assert (publisher.asked, reads, publisher.published) == (1, [], [])
    assert topics.look()
    for _ in range(5):
        topics.publish(Instant())
    expected = serialize_message(KINDS['twist'][0]('')(messages.stamp_of(7), np.ones(6)))
    assert (publisher.asked, publisher.published) == (2, [expected] * 5)
    publisher.count = 0
    assert not topics.look()
    topics.publish(Instant())
    assert len(publisher.published) == len(reads) == 5


def test_a_topic_whose_messages_change_has_the_new_ones_on_the_same_publisher(publish):
    row = BY_NAME['actuators/states']
    present = [Channel(row, lambda _: np.arange(3.0), contents.joint_state(['a']), 3)]
    publisher, topics = publish(present[0])
    publisher.count = 1
    topics._channels = lambda _: [present]
    for names in (['a'], ['b'], ['b', 'c']):
        count = 3 * len(names)
        present[0] = replace(present[0], read=lambda _, n=count: np.arange(float(n)), count=count,
                             make=contents.joint_state(names))
        topics.world_changed()
        assert topics.look()
        topics.publish(Instant())
        message = deserialize_message(publisher.published[-1], JointState)
        assert list(message.name) == names and len(message.position) == len(names)


def test_a_topic_that_has_nothing_to_tell_publishes_nothing(publish):
    publisher, topics = publish(replace(clock_channel(), read=lambda _: None))
    publisher.count = 1
    assert topics.look()
    topics.publish(Instant())
    assert publisher.published == []


def test_a_joint_without_a_setpoint_has_no_error_and_its_effort_as_the_reference():
    reference = JointReference(np.array([0.1, 0.2]), np.array([1.0, 2.0]), np.array([3.0, 4.0]),
                               np.array([0.0, 9.0]), np.array([False, True]))
    state = ControllerState(('a', 'b'), reference, np.array([0.4, 0.5]), np.array([0.6, 0.7]),
                            np.array([0.8, 0.9]))
    np.testing.assert_allclose(controller_numbers(state).reshape(ROWS, 2), [
        [0.1, 0.5], [1.0, 0.7], [3.0, 0.0], [0.0, 9.0],
        [0.4, 0.5], [0.6, 0.7], [0.8, 0.9], [-0.3, 0.0], [0.4, 0.0]])


def test_messages_are_prepared_after_the_first_state_and_as_topics_come(client):
    node = SimNode(context=client.context)

    def prepared():
        """Return which topics have a message that takes no time in addition."""
        return {name: '_patched' in vars(publication._present[1])
                for feature in node.shared.features if isinstance(feature, ChannelPublishers)
                for name, publication in feature._all.items()}
    try:
        assert {'joint_states', 'right/wrench', '/clock'} <= prepared().keys()
        assert not any(prepared().values())
        node.start()
        assert all(prepared().values())
        node.set_parameters([Parameter('noise.joint_position', value=0.01)])
        assert 'truth/joint_states' in prepared() and all(prepared().values())
    finally:
        node.destroy_node()
