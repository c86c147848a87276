# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``ros2 launch`` of a package that ``manip_sim export --ros2-control`` writes."""

import os
import signal
import subprocess

from controller_manager_msgs.srv import ListControllers
import pytest
import rclpy
import yaml

from manip_sim.cli.main import main
from manip_sim.testing.domains import reserve_domain

OWN = 'manip_sim_hardware/ManipSimSystem'
FROM_APT = 'joint_state_topic_hardware_interface/JointStateTopicSystem'


@pytest.fixture
def launched(tmp_path, monkeypatch):
    """Return a function that exports a package, installs and launches it, and its domain."""
    running = []

    def start(parameters, *arguments):
        domain, lock = reserve_domain()
        file = tmp_path / 'node.yaml'
        file.write_text(yaml.safe_dump({'/**': {'ros__parameters': parameters}}))
        share = tmp_path / 'prefix' / 'share'
        # What colcon installs of a package without code.
        index = share / 'ament_index' / 'resource_index' / 'packages'
        index.mkdir(parents=True)
        assert main(['export', '--ros2-control', str(share / 'panda_control'),
                     '--params-file', str(file)]) == 0
        (index / 'panda_control').touch()
        monkeypatch.setenv('AMENT_PREFIX_PATH', os.pathsep.join([
            str(tmp_path / 'prefix'), os.environ['AMENT_PREFIX_PATH']]))
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
        process = subprocess.Popen(['ros2', 'launch', 'panda_control', 'bringup.launch.py',
                                    *arguments], start_new_session=True)
        running.append((process, lock))
        return process, domain

    yield start
    for process, lock in running:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        os.close(lock)


def controllers(domain, process):
    """Yield the states of the controllers by name, again and again while the launch runs."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain, args=[])
    node = rclpy.create_node('test_of_a_launch', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    client = node.create_client(ListControllers, 'controller_manager/list_controllers')
    try:
        while process.poll() is None:
            if not client.wait_for_service(1.0):
                continue
            answer = client.call_async(ListControllers.Request())
            executor.spin_until_future_complete(answer, 1.0)
            if answer.done():
                yield {one.name: one.state for one in answer.result().controller}
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.mark.parametrize('parameters, mode, arguments', [
    ({'ros2_control_plugin': FROM_APT}, 'position', ()),
    ({'ros2_control_plugin': OWN, 'stepping': 'lockstep'}, 'effort', ('mode:=effort',))],
    ids=['from apt', 'own'])
def test_a_package_is_launched_and_all_its_controllers_are_active(
        launched, parameters, mode, arguments):
    process, domain = launched(parameters, *arguments)
    wanted = {'joint_state_broadcaster', f'arm_{mode}_controller', 'right_gripper_controller'}
    found = controllers(domain, process)
    assert any(wanted <= {name for name, state in now.items() if state == 'active'}
               for now in found), 'the launch has ended'
    found.close()
    process.send_signal(signal.SIGINT)
    process.wait(120.0)
