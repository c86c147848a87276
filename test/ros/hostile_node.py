# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A node with the topics and services of a simulation, whose names and texts try to do harm."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import io
import threading
from typing import Any
from xml.sax.saxutils import quoteattr
import zipfile

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, WrenchStamped
from harness import DOMAIN
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String, UInt8MultiArray
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

from manip_sim.rclpy_internals import RCLError

NAME = 'hostile'
LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = {
    'joint_states': JointState, 'arm/joint_states': JointState, 'right/eef_pose': PoseStamped,
    'right/external_wrench': WrenchStamped, 'objects/cube/pose': PoseStamped,
    'front/color/image_raw': Image, f'{NAME}/markers': MarkerArray,
    '/diagnostics': DiagnosticArray}
SERVICES = {'pause': SetBool, 'step': Trigger, 'reset': Trigger, 'tare_wrench': Trigger}


def archive(xml: str) -> bytes:
    """Return an archive of a model."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, 'w') as written:
        written.writestr('model.xml', xml)
    return buffer.getvalue()


class HostileNode:
    """
    A node in this process.

    :param text: returns what is written in place of a name or text, by what it is
    :ivar text: the same
    """

    def __init__(self, text: Callable[[str], str]) -> None:
        self.text = text
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node(NAME, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.publishers = {topic: self.node.create_publisher(kind, topic, 10)
                           for topic, kind in TOPICS.items()}
        #: The latched topics of the world.
        self.model = self.node.create_publisher(UInt8MultiArray, f'{NAME}/mjcf_archive',
                                                LATCHED)
        self.urdf = self.node.create_publisher(String, 'robot_description', LATCHED)
        #: Commands that have come.
        self.taken: list[Any] = []
        for topic, kind in (('arm/joint_command', JointState), ('right/target_pose', PoseStamped),
                            (f'{NAME}/pull', Marker)):
            self.node.create_subscription(kind, topic, self.taken.append, 10)
        for name, kind in SERVICES.items():
            self.node.create_service(kind, f'{NAME}/{name}', self._answer)
        self.send_world()
        self._timer = self.node.create_timer(0.1, self.send_states)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while self.context.ok():
                try:
                    self.executor.spin_once(timeout_sec=0.1)
                except RCLError:  # Its timer publishes while the context ends.
                    if self.context.ok():
                        raise

    def destroy(self, entity: Publisher | Subscription) -> None:
        """Destroy a publisher or subscription, in the thread that may be waiting for it."""
        kind = 'publisher' if isinstance(entity, Publisher) else 'subscription'
        ended = threading.Event()

        def destroy() -> None:
            getattr(self.node, f'destroy_{kind}')(entity)
            ended.set()
        self.executor.create_task(destroy)
        assert ended.wait(60.0)

    def _answer(self, request: Any, response: Any) -> Any:
        self.taken.append(request)
        response.success, response.message = False, self.text('answer')
        return response

    def send_world(self) -> None:
        """Publish the model and the description of the robot."""
        body, joint, site = (self.text(what) for what in ('body', 'joint', 'site'))
        xml = (f'<mujoco model={quoteattr(self.text("model"))}><worldbody>'
               f'<body name={quoteattr(body)}><joint name={quoteattr(joint)} range="-1 1"/>'
               f'<geom size="0.1"/><site name={quoteattr(site + "grip_site")}/></body>'
               '<body name="cube" pos="0.3 0 0"><freejoint/><geom size="0.05" rgba="1 0 0 1"/>'
               f'</body></worldbody><actuator><position joint={quoteattr(joint)} kp="1"/>'
               '</actuator></mujoco>')
        self.model.publish(UInt8MultiArray(data=archive(xml)))
        self.urdf.publish(String(data=f'<robot name={quoteattr(self.text("robot"))}>'
                                      f'<joint name={quoteattr(joint)}><limit lower="-1" '
                                      'upper="1" velocity="1" effort="1"/></joint></robot>'))

    def states(self) -> dict[str, Any]:
        """Return a message for each topic."""
        now = self.node.get_clock().now().to_msg()
        joints = JointState(name=[self.text('joint')], position=[0.2], velocity=[0.0],
                            effort=[0.0])
        joints.header.stamp = now
        joints.header.frame_id = self.text('frame')
        pose, wrench, image = PoseStamped(), WrenchStamped(), Image(
            height=2, width=2, step=6, encoding='rgb8', data=bytes(12))
        for message in (pose, wrench, image):
            message.header.stamp, message.header.frame_id = now, self.text('frame')
        pose.pose.position.x = 0.3
        statuses = [
            DiagnosticStatus(level=b'\2', name=f'{NAME}: {self.text("name")}',
                             message=self.text('message'), hardware_id=self.text('hardware'),
                             values=[KeyValue(key=self.text('key'), value=self.text('value'))]),
            DiagnosticStatus(name=f'{NAME}: arm', values=[
                KeyValue(key='control_mode', value='position'),
                KeyValue(key='command_interface', value='position'),
                KeyValue(key='accepted', value=self.text('accepted')),
                KeyValue(key='dropped', value=self.text('dropped')),
                KeyValue(key='rate', value=self.text('rate')), KeyValue(key='age', value='1')]),
            DiagnosticStatus(name=f'{NAME}: cameras', values=[
                KeyValue(key=f'{self.text("camera")}.rate', value=self.text('camera rate'))]),
            DiagnosticStatus(name=f'{NAME}: simulation', level=b'\1', values=[
                KeyValue(key='real_time_factor', value=self.text('factor')),
                KeyValue(key='state', value=self.text('state')),
                KeyValue(key='start_defects', value=self.text('defect')),
                KeyValue(key=f'failed_{self.text("failed")}', value='1')])]
        return {'joint_states': joints, 'arm/joint_states': joints, 'right/eef_pose': pose,
                'right/external_wrench': wrench, 'objects/cube/pose': pose,
                'front/color/image_raw': image, f'{NAME}/markers': MarkerArray(),
                '/diagnostics': DiagnosticArray(status=statuses)}

    def send_states(self) -> None:
        """Publish a message on each topic of states."""
        for topic, message in self.states().items():
            self.publishers[topic].publish(message)

    def close(self) -> None:
        """End the node."""
        rclpy.shutdown(context=self.context)
        self._thread.join(timeout=300.0)
        self.executor.shutdown()
        self.node.destroy_node()
