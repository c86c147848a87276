# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The main job: a controller in another process picks a cube up and feels its weight."""

from itertools import count
import re
import subprocess
import sys
import time

from geometry_msgs.msg import WrenchStamped
from harness import DOMAIN, END_SIGNALS
import numpy as np
import pytest
import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from manip_sim.examples import pick_cube
from manip_sim.examples.demonstration import Arm, Demonstration, InverseKinematics, TaskFailed
from manip_sim.models import compose

#: Of other hands than the Panda: two jaws that swing, three fingers, one jaw. Experts of tasks
#: grasp with more of them, in the process of the test.
OTHER_HANDS = ('UR5e', 'Jaco', 'SO101')


def test_a_controller_in_another_process_picks_the_cube_up_whatever_the_names(process, client):
    # Nodes of other hands have neither a namespace nor a prefix.
    namespace = ('--ros-args', '-r', '__ns:=/cell/left')
    process(*namespace, '-p', 'arena:=table', '-p', 'real_time_factor:=2.0', '-p', 'prefix:=left_')
    assert client.state('/cell/left/joint_states').name[0] == 'left_joint1'
    wrenches = client.listen(WrenchStamped, '/cell/left/right/wrench')
    fingers = client.listen(JointState, '/cell/left/right/gripper/joint_states')
    controller = process('pick_cube', *namespace, module='manip_sim.examples')
    client.spin_until(lambda: controller.poll() is not None)
    output, errors = controller.communicate(timeout=300.0)
    assert controller.returncode == 0, output + errors
    force = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in wrenches])
    held = force[-100:].mean(axis=0)
    # The hand points down, so the sensor's z does: what it carries pulls towards -z.
    assert abs(held[2] + (0.76 + 0.1) * 9.81) < 0.05 * 0.981
    assert abs(fingers[-1].position[0] - 0.0255) < 1e-3
    added = float(re.search(r'in left_gripper_ft_frame: ([\d.]+) N', output).group(1))
    assert abs(added - 0.981) < 0.05 * 0.981


@pytest.mark.full
@pytest.mark.parametrize('name', OTHER_HANDS)
def test_arms_with_other_hands_pick_it_up_too(name, serve, process):
    serve(robot=name, arena='table', real_time_factor=3.0)
    controller = process('pick_cube', module='manip_sim.examples')
    output, errors = controller.communicate(timeout=300.0)
    assert controller.returncode == 0, output + errors


#: A gripper whose fingers reach 4 cm beyond the grasp point that is inferred.
CLAW = """
<mujoco>
  <compiler autolimits="true"/>
  <worldbody>
    <body name="claw">
      <geom type="cylinder" size="0.045 0.02" pos="0 0 0.02" mass="0.5"/>
      <body name="left_finger" pos="0 0.04 0.045">
        <joint name="left" axis="1 0 0" range="-10 40" armature="0.01" damping="0.5"/>
        <geom type="capsule" size="0.008" fromto="0 0 0 0 0 0.08" mass="0.04"/>
      </body>
      <body name="right_finger" pos="0 -0.04 0.045">
        <joint name="right" axis="-1 0 0" range="-10 40" armature="0.01" damping="0.5"/>
        <geom type="capsule" size="0.008" fromto="0 0 0 0 0 0.08" mass="0.04"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left"/></equality>
  <actuator><position joint="left" kp="40" kv="2" forcerange="-3 3" inheritrange="1"/></actuator>
</mujoco>"""


@pytest.mark.full
def test_fingers_that_press_on_the_table_are_told(tmp_path, serve, process):
    (tmp_path / 'claw.xml').write_text(CLAW)
    serve(robot='UR5e', gripper=str(tmp_path / 'claw.xml'), arena='table', real_time_factor=3.0)
    controller = process('pick_cube', module='manip_sim.examples')
    output, errors = controller.communicate(timeout=300.0)
    assert controller.returncode == 1, output
    assert re.search(r'the arm does not reach its goal: its joints are off by 0.\d+ rad; its '
                     r'gripper presses on something with \d+ N: .* \(grasp_point in docs', errors)


@pytest.mark.full
def test_without_a_node_the_example_says_how_to_start_one(process):
    controller = process('pick_cube', module='manip_sim.examples')
    _, errors = controller.communicate(timeout=300.0)
    assert controller.returncode == 1
    assert 'arena:=table' in errors


@pytest.mark.full
@pytest.mark.parametrize('number', END_SIGNALS)
def test_a_signal_ends_the_example_cleanly(number, process, client):
    controller = process('pick_cube', module='manip_sim.examples')
    client.spin_until(lambda: 'pick_cube' in client.node.get_node_names())
    controller.send_signal(number)
    assert controller.communicate(timeout=300.0) == ('', '')
    assert controller.returncode == 0


@pytest.mark.full
def test_without_a_cube_the_example_says_so(sim_process, process):
    sim_process('arena:=empty')
    controller = process('pick_cube', module='manip_sim.examples')
    _, errors = controller.communicate(timeout=300.0)
    assert controller.returncode == 1
    assert 'there is no cube' in errors


@pytest.mark.full
@pytest.mark.parametrize(('parameters', 'problem'), [
    ({'gripper': 'none'}, 'the node that answers has no arm with a gripper'),
    ({'start_paused': True}, 'the simulation stands still: is it paused, or in lock-step?')])
def test_the_example_tells_what_is_wrong_with_a_node_that_answers(
        parameters, problem, serve, client, monkeypatch, capsys):
    monkeypatch.setattr('manip_sim.examples.demonstration._PATIENCE_S', 6.0)
    serve(arena='table', **parameters)
    client.state()
    assert pick_cube.main([]) == 1
    assert problem in capsys.readouterr().err


@pytest.fixture
def arm_with_fingers():
    """Return a function that makes an arm with fingers where a function of the period says."""
    rclpy.init(domain_id=DOMAIN)
    task = Demonstration('task', 'sim_node')

    def make(position, silence=()):
        arm = Arm(task)
        topics = [task.create_publisher(JointState, f'{part}/joint_states', 1)
                  for part in ('arm', 'right/gripper')]
        periods = count(1)

        def publish():
            period = next(periods)
            state = JointState(name=['joint'], position=[position(period)])
            state.header.stamp.sec = period // 100
            state.header.stamp.nanosec = period % 100 * 10_000_000
            topics[0].publish(state)
            if period not in silence:
                topics[1].publish(state)
        task.wait_until(lambda: all(t.get_subscription_count() for t in topics), 'alone')
        timer = task.create_timer(0.005, publish)
        task.wait_until(lambda: len(task.latest) == 2, 'nothing heard')
        return arm, timer
    yield make
    task.destroy_node()
    rclpy.shutdown()


@pytest.mark.full
@pytest.mark.parametrize(('begin', 'silence'), [(0, range(11, 60)), (120, ())])
def test_fingers_that_are_seen_late_or_commanded_late_are_not_taken_for_still(
        begin, silence, arm_with_fingers):
    arm, _ = arm_with_fingers(lambda period: min(max(0.001 * (period - begin), 0.0), 0.06),
                              silence)
    arm.close()
    assert arm.fingers == pytest.approx([0.06])


def test_fingers_that_creep_on_what_they_hold_are_still(arm_with_fingers):
    arm, _ = arm_with_fingers(lambda period: min(0.02 * period, 1.0 + 1e-4 * period))
    arm.close()
    assert 1.0 < arm.fingers[0] < 1.03


@pytest.mark.full
def test_fingers_that_need_not_move_are_waited_for_two_seconds_by_both_clocks(arm_with_fingers):
    arm, _ = arm_with_fingers(lambda _: 0.04)
    begin_s, begin = arm._task.now_s, time.monotonic()
    arm.open()
    assert min(arm._task.now_s - begin_s, time.monotonic() - begin) >= 2.0


def test_states_that_end_while_the_gripper_closes_are_told(arm_with_fingers, monkeypatch):
    monkeypatch.setattr('manip_sim.examples.demonstration._PATIENCE_S', 0.5)
    arm, timer = arm_with_fingers(lambda _: 0.04)
    timer.cancel()
    with pytest.raises(TaskFailed, match='^the simulation stands still'):
        arm.close()


def test_a_node_that_compiles_its_laws_is_waited_for(arm_with_fingers, monkeypatch, capsys):
    monkeypatch.setattr('manip_sim.examples.demonstration._PATIENCE_S', 0.3)
    task = arm_with_fingers(lambda _: 0.04)[0]._task
    with pytest.raises(TaskFailed, match='^no node answers: start one with'):
        task.connect(lambda: True)
    model = task.create_publisher(String, 'manip_sim/mjcf', QoSProfile(
        depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL))
    task.create_timer(0.9, lambda: model.publish(String(data='<mujoco/>')))
    assert task.connect(lambda: True).nbody == 1
    assert 'the node is starting' in capsys.readouterr().out


def test_inverse_kinematics_keep_the_turns_of_joints_without_a_range():
    model = compose('Kinova3').compile()
    joints = [f'robot0_Actuator{number}' for number in range(1, 8)]
    kinematics = InverseKinematics(model, joints, 'gripper0_right_grip_site', {})
    start = np.array([0.0, 0.4, 2.0, 1.2, 0.3, -0.9, 1.0])
    turned = start + 2.0 * np.pi * np.array([2, 0, -1, 0, 0, 0, 3])
    position, rotation = kinematics.forward(start)
    found = kinematics.nearest(kinematics.solve(start + 0.1, position, rotation), turned)
    np.testing.assert_allclose(kinematics.forward(found)[0], position, atol=1e-3)
    assert np.abs(found - turned).max() < 0.5


@pytest.mark.parametrize('program', ['pick_cube', 'hand_over'])
def test_an_argument_that_an_example_does_not_use_is_rejected(program):
    done = subprocess.run(
        [sys.executable, '-m', 'manip_sim.examples', program, '--robot', 'UR5e', '--ros-args',
         '-r', '__ns:=/left'], capture_output=True, text=True, timeout=300.0)
    assert done.returncode == 2
    assert done.stderr == (
        f"{program}: unknown argument '--robot': it uses the robot of the node that runs, as "
        'started by sim_node --ros-args -p robot:=NAME; see --help\n')
