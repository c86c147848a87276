# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the viewer learns of a node from its topics, and that it forgets a node that is gone."""

from __future__ import annotations

from geometry_msgs.msg import PoseStamped
from hostile_node import archive, HostileNode, LATCHED, NAME
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import String, UInt8MultiArray

pytest.importorskip('viser', reason='the viewer needs the extra viewer')

from manip_sim.viewer.discovery import Discovery, Readers  # noqa: E402
from manip_sim.viewer.session import CommandSender, NodeRecording  # noqa: E402

#: Of a description; what the viewer takes at most [bytes].
LIMITED = ('<robot name="robot"><joint name="joint"><limit lower="-0.5" upper="0.25" '
           'velocity="3" effort="7"/></joint>{}</robot>')
LARGEST = 2**23


@pytest.fixture
def other():
    """Return a node with a joint, a hand, a cube and a camera."""
    node = HostileNode(lambda what: what)
    yield node
    node.close()


class Finding:
    """What a viewer finds."""

    def __init__(self, client, name):
        self._client = client
        self.readers = Readers(client.node)
        self.discovery = Discovery(client.node, self.readers, name)

    def until(self, condition):
        """Look until something is found, and return the discovery."""
        def met():
            self.discovery.look()
            return condition(self.discovery)
        self._client.spin_until(met)
        return self.discovery

    def whole(self):
        """Wait for all that can be found."""
        return self.until(lambda found: found.layout is not None and found.model is not None)


@pytest.mark.full
def test_robots_and_their_limits_are_those_of_the_node(client, serve):
    node = serve(robots=['left', 'right'], left__robot='UR5e', right__robot='PandaOmron',
                 start_paused=True)
    found = Finding(client, 'manip_sim').whole()
    assert found.base == '/' and found.is_there and found.models == 1
    left, right = found.robots()
    assert (left.space, left.title, left.twist) == ('/left/', 'left', None)
    assert (right.space, right.title) == ('/right/', 'right')
    model = node.simulation.model
    for robot, shown in zip(node.simulation.robots.values(), (left, right)):
        arm = next(part for part in shown.parts if part.name == 'arm')
        assert [joint.name for joint in arm.joints] == list(robot.parts['arm'].joints)
        for joint in arm.joints:
            assert joint.ranges['position'] == pytest.approx(model.joint(joint.name).range)
    base = robot.joints.find(robot.parts['base'].joints)
    assert right.twist == pytest.approx(robot.joints.velocity_limits(base))


@pytest.mark.full
def test_control_modes_are_those_of_the_node_and_are_switched(client, serve):
    node = serve(robots=['left', 'right'], left__robot='UR5e', right__robot='PandaOmron')
    told = []
    sender = CommandSender(client.node, 'manip_sim', {}, told.append)
    sender.prepare({f'{part}/joint_command': JointState for part in (
        '/left/arm', '/left/right/gripper', '/right/arm', '/right/base')})
    parts = [('/left/', 'arm'), ('/right/', 'arm'), ('/right/', 'base')]

    def known():
        sender.send_waiting()
        return all(sender.modes(*part) for part in parts)
    client.spin_until(known)
    client.spin_until(sender._clients['set_parameters'].service_is_ready)
    assert all({'position', 'velocity', 'effort'} <= set(sender.modes(*part)) for part in parts)
    assert not sender.modes('/left/', 'right/gripper')
    left, right = node.simulation.robots.values()

    def modes(robot, part):
        return {*robot.joints.modes_of(robot.joints.indices_of(part))}
    sender.switch_mode('/left/', 'arm', 'effort')
    sender.switch_mode('/right/', 'base', 'position')
    client.spin_until(lambda: modes(left, 'arm') == {'effort'}
                      and modes(right, 'base') == {'position'})
    assert modes(right, 'arm') == {'position'} and told == []
    sender.switch_mode('/left/', 'arm', 'efort')
    client.spin_until(lambda: bool(told))
    assert told[0].startswith('set_parameters: ') and 'efort' in told[0]


@pytest.mark.full
def test_a_record_of_the_node_is_written_until_it_is_ended(client, serve, tmp_path):
    serve()
    told = []
    recording = NodeRecording('/manip_sim', tmp_path, lambda *report: told.append(report))
    recording.record(False)
    assert not recording.is_running
    recording.record(True)
    recording.record(True)  # A second press is no second record.
    client.spin_until(lambda: any(file.stat().st_size > 100_000 for file in tmp_path.iterdir()))
    recording.update()
    assert recording.is_running and told == []
    recording.record(False)

    def ended():
        recording.update()
        return not recording.is_running
    client.spin_until(ended)
    ((text, written),) = told
    (file,) = tmp_path.glob('manip_sim_*.mcap')
    assert written and file.name in text, told
    assert file.read_bytes()[-8:] == b'\x89MCAP0\r\n'  # It is complete.
    # The end of the page ends the record too; errors of writing are reported.
    recording.record(True)
    recording.close()
    assert not recording.is_running
    missing = NodeRecording('/manip_sim', tmp_path / 'missing', recording._report)
    missing.record(True)
    client.spin_until(lambda: missing.update() or not missing.is_running)
    assert told[-1][1] is False and 'missing' in told[-1][0]


def test_limits_are_those_of_the_description(client, other):
    finding = Finding(client, NAME)
    other.urdf.publish(String(data=LIMITED.format('')))
    ((robot),) = finding.whole().robots()
    ((part),) = robot.parts
    assert (robot.title, robot.end_effectors) == ('', ('right',))
    assert (robot.twist, part.name) == (None, 'arm')
    assert part.joints[0].ranges == {
        'position': (-0.5, 0.25), 'velocity': (-3.0, 3.0), 'effort': (-7.0, 7.0)}


def test_a_description_up_to_its_greatest_size_is_taken_and_a_greater_one_rejected(client, other):
    finding = Finding(client, NAME)
    other.urdf.publish(String(data=LIMITED.format(f'<!--{"x" * LARGEST}-->')))
    finding.until(lambda _: finding.readers.rejected == 1)
    assert finding.discovery.layout is None
    room = LARGEST - len(LIMITED) - 100
    other.urdf.publish(String(data=LIMITED.format(f'<!--{"x" * room}-->')))
    finding.whole()
    assert finding.readers.rejected == 1


@pytest.mark.parametrize('text', ['<robot', '<robot><joint><limit lower="x"/></joint></robot>',
                                  '<robot><joint><limit upper="inf"/></joint></robot>'])
def test_a_description_that_cannot_be_read_is_told_and_the_next_one_taken(client, other, text):
    finding = Finding(client, NAME)
    lines = client.log()
    other.urdf.publish(String(data=text))
    finding.until(lambda _: any('/robot_description: the URDF cannot be read: ' in line
                                for line in lines))
    assert finding.discovery.layout is None and finding.readers.rejected >= 1
    other.send_world()
    finding.whole()


def test_a_model_that_cannot_be_used_is_told_and_the_one_before_stays(client, other):
    finding = Finding(client, NAME)
    found = finding.whole()
    first = found.model
    other.model.publish(UInt8MultiArray(data=b'garbage'))
    finding.until(lambda _: finding.readers.rejected == 1)
    assert found.model is first and found.models == 1
    other.model.publish(UInt8MultiArray(data=archive('<mujoco model="next"/>')))
    finding.until(lambda found: found.models == 2)
    assert found.model is not first and found.model.njnt == 0


def test_a_node_that_is_gone_is_forgotten_but_its_picture_stays(client, other):
    finding = Finding(client, NAME)
    found = finding.whole()
    other.destroy(other.model)
    finding.until(lambda found: not found.is_there)
    assert found.layout is None and found.model is not None
    # It comes again with other joints.
    other.text = lambda what: f'other_{what}'
    other.model = other.node.create_publisher(UInt8MultiArray, f'{NAME}/mjcf_archive', LATCHED)
    other.send_world()
    finding.until(lambda found: found.models == 2 and found.layout is not None)
    (joint,) = found.robots()[0].parts[0].joints
    assert (joint.name, joint.ranges['position']) == ('other_joint', (-1.0, 1.0))
    # The names of joints do not change any more; another description may come.
    finding.until(lambda _: not client.node.count_subscribers('/arm/joint_states'))
    assert client.node.count_subscribers('/robot_description') == 1


def test_another_robot_takes_the_place_of_one_that_still_counts_as_present(client, other):
    finding = Finding(client, NAME)
    found = finding.whole()
    layout = found.layout
    # It says at first what the former one said.
    other._timer.cancel()
    former = other.states()['arm/joint_states']
    other.text = lambda what: f'other_{what}'
    other.send_world()
    finding.until(lambda found: found.models == 2)
    for _ in range(3):
        other.publishers['arm/joint_states'].publish(former)
        finding.discovery.look()
        assert found.layout is None
    new = other.states()['arm/joint_states']

    def arrived(_):
        other.publishers['arm/joint_states'].publish(new)
        return found.layout is not None
    finding.until(arrived)
    assert [joint.name for joint in found.robots()[0].parts[0].joints] == ['other_joint']
    assert found.layout == layout
    # The same joints with other limits.
    other.urdf.publish(String(data=LIMITED.replace('"joint"', '"other_joint"').format('')))
    finding.until(lambda _: found.robots()[0].parts[0].joints[0].ranges['position']
                  == (-0.5, 0.25))


def test_the_former_parts_stay_until_all_is_known_of_other_ones(client, other):
    finding = Finding(client, NAME)
    found = finding.whole()
    (robot,) = found.robots()
    other.node.create_subscription(JointState, 'torso/joint_command', print, 10)
    (arm,) = [each for each in other.node.subscriptions if each.topic_name == '/arm/joint_command']
    other.destroy(arm)
    finding.until(lambda found: [part for each in found._seen.robots for part in each.parts]
                  == ['torso'])
    for _ in range(3):
        finding.discovery.look()
    assert found.robots() == [robot]
    states = other.node.create_publisher(JointState, 'torso/joint_states', 10)

    def arrived(_):
        states.publish(other.states()['arm/joint_states'])
        return [part.name for part in found.robots()[0].parts] == ['torso']
    finding.until(arrived)
    assert found._joints.keys() == {'/torso'}


def test_parts_of_a_killed_node_that_still_counts_as_present_are_left_out(client, other):
    # A torso, a left arm and a robot of a killed node: topics of commands, and nobody publishes.
    torso = other.node.create_publisher(JointState, 'torso/joint_states', 10)
    other.node.create_publisher(String, 'ghost/robot_description', LATCHED).publish(
        String(data=LIMITED.format('')))
    for topic in ('torso/joint_command', 'left/joint_command', 'ghost/arm/joint_command'):
        other.node.create_subscription(JointState, topic, print, 10)
    other.node.create_subscription(PoseStamped, 'left/target_pose', print, 10)
    finding = Finding(client, NAME)
    finding.whole()
    finding.until(lambda found: found._silent == {'/torso', '/left', '/ghost/arm'}
                  and [robot.end_effectors for robot in found.layout.robots] == [('right',)])
    (robot,) = finding.discovery.robots()
    assert (robot.space, robot.end_effectors) == ('/', ('right',))
    assert [part.name for part in robot.parts] == ['arm']

    # One that was only late is shown as soon as it has states.
    def arrived(found):
        torso.publish(other.states()['arm/joint_states'])
        return found.layout and len(found.robots()[0].parts) == 2
    found = finding.until(arrived)
    assert [part.name for part in found.robots()[0].parts] == ['arm', 'torso']
    # It is gone with the next model, at once if its joints are not there.
    other.text = lambda what: f'other_{what}'
    other.send_world()
    finding.until(lambda found: found.models == 2)
    assert found.layout is None
    finding.until(lambda found: found.layout is not None)
    assert [part.name for part in found.robots()[0].parts] == ['arm']


def test_a_part_without_usable_names_of_joints_is_waited_for(client, other):
    finding = Finding(client, NAME)
    other._timer.cancel()
    publisher = other.publishers['arm/joint_states']
    finding.until(lambda found: any(robot.parts for robot in found._seen.robots))

    def rejected(_):
        publisher.publish(JointState(name=['a', 'a'], position=[0.0, 0.0]))
        return finding.readers.rejected > 0
    finding.until(rejected)
    for _ in range(5):
        finding.discovery.look()
    assert finding.discovery.layout is None
    # If the node goes meanwhile, nothing of it is listened to any more.
    other.destroy(other.model)
    finding.until(lambda _: publisher.get_subscription_count() == 0)
    other.model = other.node.create_publisher(UInt8MultiArray, f'{NAME}/mjcf_archive', LATCHED)
    other.send_world()

    def whole(found):
        publisher.publish(other.states()['arm/joint_states'])
        return found.layout is not None
    finding.until(whole)
