# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A plain loop of rclpy and MuJoCo, as written in an afternoon: the baseline for the node.

usage: python3 plain_loop.py MODEL EVERY REALTIME [prepared]

MODEL is an XML file, or an MJB file with the start beside it; a state is published after
EVERY steps, as fast as possible or, if REALTIME is 1, in real time. The loop runs in the main
thread and the executor in another; it keeps absolute deadlines, and copies nothing it need not.

With ``prepared`` it publishes the bytes of its first messages again and again, with other stamps:
physics and publication alone, the bound of whatever does both in one thread.
"""

import contextlib
import signal
import struct
import sys
import threading
import time

from geometry_msgs.msg import WrenchStamped
import mujoco
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState


class PlainLoop(Node):
    """Steps a model and publishes joint states and a wrench."""

    def __init__(self, path, every, realtime, prepared):
        super().__init__('plain_loop')
        load = mujoco.MjModel
        self.model = (load.from_xml_path if path.endswith('.xml') else load.from_binary_path)(path)
        self.data = mujoco.MjData(self.model)
        if path.endswith('.mjb'):
            mujoco.mj_setState(self.model, self.data, np.fromfile(path.replace('.mjb', '.state')),
                               mujoco.mjtState.mjSTATE_INTEGRATION)
        self.every, self.realtime = every, realtime
        model, joints = self.model, range(self.model.njnt)
        self.names = [model.joint(j).name for j in joints]
        self.qpos, self.qvel = model.jnt_qposadr.copy(), model.jnt_dofadr.copy()
        self.actuators = {model.joint(model.actuator_trnid[a, 0]).name: a for a in range(model.nu)}
        sensors = {model.sensor(s).name: model.sensor_adr[s] for s in range(model.nsensor)}
        self.force = next(a for name, a in sensors.items() if name.endswith('force_ee'))
        self.torque = next(a for name, a in sensors.items() if name.endswith('torque_ee'))
        self.states = self.create_publisher(JointState, 'joint_states', 10)
        self.wrench = self.create_publisher(WrenchStamped, 'right/wrench', 10)
        self.create_subscription(JointState, 'arm/joint_command', self.command, 10)
        self.running = True
        self.prepared = [bytearray(serialize_message(message)) for message in self.messages()
                         ] if prepared else []

    def command(self, message):
        """Take efforts."""
        for name, effort in zip(message.name, message.effort):
            self.data.ctrl[self.actuators[name]] = effort

    def publish(self):
        """Publish the present state."""
        publishers = self.states, self.wrench
        if self.prepared:
            seconds = int(self.data.time)
            for publisher, content in zip(publishers, self.prepared):
                # Behind the four bytes that tell the encoding.
                struct.pack_into('<iI', content, 4, seconds, int((self.data.time - seconds) * 1e9))
                publisher.publish(bytes(content))
        else:
            for publisher, message in zip(publishers, self.messages()):
                publisher.publish(message)

    def messages(self):
        """Return the messages of the present state."""
        data, message, wrench = self.data, JointState(), WrenchStamped()
        seconds = int(data.time)
        message.header.stamp.sec = seconds
        message.header.stamp.nanosec = int((data.time - seconds) * 1e9)
        message.name = self.names
        message.position = data.qpos[self.qpos].tolist()
        message.velocity = data.qvel[self.qvel].tolist()
        message.effort = data.qfrc_actuator[self.qvel].tolist()
        wrench.header.stamp = message.header.stamp
        wrench.header.frame_id = 'right_hand'
        force, torque = wrench.wrench.force, wrench.wrench.torque
        force.x, force.y, force.z = data.sensordata[self.force:self.force + 3].tolist()
        torque.x, torque.y, torque.z = data.sensordata[self.torque:self.torque + 3].tolist()
        return message, wrench

    def run(self):
        """Step until the end."""
        period = self.every * self.model.opt.timestep
        deadline = time.monotonic()
        while self.running:
            mujoco.mj_step(self.model, self.data, self.every)
            self.publish()
            if self.realtime:
                deadline += period
                delay = deadline - time.monotonic()
                if delay > 0.0:
                    time.sleep(delay)
                elif delay < -0.1:
                    deadline = time.monotonic()


def main():
    """Run the loop until SIGINT."""
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    loop = PlainLoop(
        sys.argv[1], int(sys.argv[2]), sys.argv[3] == '1', 'prepared' in sys.argv[4:])

    def end(*_):
        loop.running = False
    signal.signal(signal.SIGINT, end)

    def spin():
        with contextlib.suppress(ExternalShutdownException):
            rclpy.spin(loop)
    spinner = threading.Thread(target=spin)
    spinner.start()
    loop.run()
    rclpy.shutdown()
    spinner.join()


if __name__ == '__main__':
    main()
