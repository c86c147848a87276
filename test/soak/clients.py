# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Clients in processes of their own: ``flood TOPIC`` until SIGINT, and ``vanish``."""

import signal
import sys
import time

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

MESSAGES = {'arm/command': Float64MultiArray(data=[0.0] * 7),
            'joint_command': JointState(name=['robot0_joint1'], position=[0.1]),
            'invalid joint_command': JointState(name=["x'y'z\n"], position=[0.1])}


def flood(what: str) -> None:
    """Publish as fast as possible, and print how many messages a second that was."""
    node = rclpy.create_node('flood')
    message = MESSAGES[what]
    publisher = node.create_publisher(type(message), what.split()[-1], 1)
    stopped: list[int] = []
    signal.signal(signal.SIGINT, lambda *_: stopped.append(1))
    begin, sent = time.monotonic(), 0
    while not stopped:
        publisher.publish(message)
        sent += 1
    print(f'{sent / (time.monotonic() - begin):.0f}')


def vanish() -> None:
    """Ask, publish and listen, and take no answer, until killed."""
    node = rclpy.create_node('vanishing')
    clients = [node.create_client(Trigger, f'manip_sim/{name}')
               for name in ('reset', 'tare_wrench', 'step')]
    node.create_subscription(JointState, 'joint_states', print, 10)
    publisher = node.create_publisher(JointState, 'joint_command', 10)
    for client in clients:
        client.wait_for_service()
    for _ in range(30):
        for client in clients:
            client.call_async(Trigger.Request())
        publisher.publish(MESSAGES['joint_command'])
    print('asked', flush=True)
    time.sleep(1000.0)


if __name__ == '__main__':
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    flood(*sys.argv[2:]) if sys.argv[1] == 'flood' else vanish()
