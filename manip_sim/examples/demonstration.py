# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
A node that does a task step by step: it waits for conditions, and prints what it does.

Its arms, each with a gripper, are commanded and observed through their topics.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
import sys
import time
from typing import Any

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import WrenchStamped
import mujoco
import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from manip_sim.algebra import rotation_vector
from manip_sim.arrays import FloatArray
from manip_sim.rclpy_internals import describe_unheard, start_ros

_PATIENCE_S = 10.0
#: Time that a node may take to compile its control laws, on a busy machine [s].
_START_S = 600.0
_MODEL = 'manip_sim/mjcf'
_DAMPING = 1e-3
_ITERATIONS = 500
#: Larger errors are scaled down to this in each iteration [m, rad].
_LARGEST_ERROR = 0.1
_TOLERANCE = 1e-5
#: Average speed of the fastest joint of a motion [rad/s], and the shortest motion [s].
_SPEED, _SHORTEST_S = 0.9, 0.8
#: Distance to its goal that each joint must reach [rad], and greatest delay [s].
_NEAR, _LATE_S = 0.01, 3.0
#: Fingers are still if they move less than this [rad or m], or than a share of the way that they
#: have come, for a duration [s] and a number of states: a program that gets little processor time
#: sees few states. A held object may creep.
_STILL, _STILL_SHARE, _STILL_S, _STILL_STATES = 5e-4, 0.01, 0.3, 20
#: Time for fingers to start moving, in both simulation and wall time [s].
_UNMOVED_S = 2.0
#: The topics that are followed, by name below the robot's.
_ALL, _ARM, _FINGERS, _WRENCH = (
    'joint_states', 'arm/joint_states', 'right/gripper/joint_states', 'right/wrench')
_FOLLOWED = {_ALL: JointState, _ARM: JointState, _FINGERS: JointState, _WRENCH: WrenchStamped}
#: Forces on the gripper below this are its own inertia, or what it carries [N].
_PUSHED_N = 20.0
#: Number of random postures to start from if the present one leads to no solution.
_STARTS = 40


class TaskFailed(Exception):
    """The task could not be done; the message says why."""


class TaskInterrupted(Exception):
    """Somebody has asked the task to end."""


class Demonstration(Node):
    """
    A node that does one task and ends.

    :param name: of the node
    :param start: a command that starts the simulation that the task needs, for error messages
    :ivar is_asked_to_end: is asked while the task waits
    :ivar latest: the newest message of each topic that is followed
    """

    def __init__(self, name: str, start: str) -> None:
        super().__init__(name)
        self._start = start
        self.is_asked_to_end: Callable[[], bool] = lambda: False
        self._mjcf: str | None = None
        self.latest: dict[str, Any] = {}
        latched = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, _MODEL, self._take_mjcf, latched)

    def _take_mjcf(self, message: String) -> None:
        self._mjcf = message.data

    def perform(self) -> None:
        """
        Do the task.

        :raises TaskFailed: if it could not be done
        """
        raise NotImplementedError

    def follow(self, message_type: Any, topic: str) -> None:
        """Keep the newest message of a topic, on which states with a stamp arrive."""
        self.create_subscription(message_type, topic, partial(self.latest.__setitem__, topic), 1)

    @property
    def now_s(self) -> float:
        """
        Simulation time up to which messages of all topics have come [s].

        On a busy machine the states of an instant may come on one topic long after those on
        another.
        """
        stamps = [message.header.stamp for message in self.latest.values()]
        return min((stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps), default=0.0)

    def connect(self, ready: Callable[[], bool]) -> mujoco.MjModel:
        """
        Wait for the simulation.

        :param ready: returns whether all states that the task needs have come
        :returns: the simulation's model
        :raises TaskFailed: if they do not come; the message says how to start the simulation
        """
        start = f"start one with '{self._start}'"
        self._wait_for_model(f'no node answers: {start}')
        self.wait_until(ready, 'the node that answers has no arm with a gripper by the names that '
                        f'this example uses: {start}')
        return mujoco.MjModel.from_xml_string(self._mjcf)

    def _wait_for_model(self, problem: str) -> None:
        try:
            self.wait_until(lambda: self._mjcf is not None, problem)
        except TaskFailed:
            if not self.count_publishers(_MODEL) or describe_unheard(self):
                raise
            print('the node is starting: the first time it compiles control laws', flush=True)
            self.wait_until(
                lambda: self._mjcf is not None or not self.count_publishers(_MODEL),
                'the node is still starting: its log says what it waits for', _START_S)
            self.wait_until(lambda: self._mjcf is not None, problem)

    def wait_until(self, condition: Callable[[], bool], problem: str,
                   patience_s: float | None = None) -> None:
        """
        Wait for a condition.

        :param patience_s: wall time [s]; None: ten seconds
        :raises TaskFailed: with ``problem``, if it is not met by then
        :raises TaskInterrupted: if the task is asked to end
        """
        end = time.monotonic() + (_PATIENCE_S if patience_s is None else patience_s)
        while not condition():
            if self.is_asked_to_end():
                raise TaskInterrupted
            rclpy.spin_once(self, timeout_sec=0.1)
            if time.monotonic() > end:
                raise TaskFailed('; '.join(filter(None, (problem, describe_unheard(self)))))

    def next_state(self) -> None:
        """
        Wait until :attr:`now_s` is later.

        :raises TaskFailed: if it stands still for ten seconds of wall time
        """
        last = self.now_s
        self.wait_until(lambda: self.now_s > last,
                        'the simulation stands still: is it paused, or in lock-step?')

    def wait(self, duration_s: float) -> None:
        """Wait for a duration of simulation time [s]."""
        end = self.now_s + duration_s
        while self.now_s < end:
            self.next_state()

    def say(self, text: str) -> None:
        """Print a line with the simulation time."""
        print(f'{self.now_s:8.2f} s  {text}', flush=True)


def run(create: Callable[[], Demonstration], arguments: Sequence[str] | None,
        is_asked_to_end: Callable[[], bool]) -> int:
    """
    Run a task as a process.

    :param arguments: the command line, with ROS arguments; None: that of the process
    :param is_asked_to_end: is asked while the task waits
    :returns: the exit code: 1 if the task failed, 0 if it is done or was interrupted
    :raises ManipSimError: if a ROS argument is wrong
    """
    start_ros(arguments)
    task = create()
    task.is_asked_to_end = is_asked_to_end
    try:
        task.perform()
        return 0
    except TaskFailed as error:
        print(f'{task.get_name()}: {error}', file=sys.stderr)
        return 1
    except (KeyboardInterrupt, TaskInterrupted):
        return 0
    finally:
        task.destroy_node()
        rclpy.try_shutdown()


def _obstacle(force_n: float) -> str:
    """Return a remark on the force on a gripper that does not reach its goal [N]."""
    if force_n < _PUSHED_N:
        return ''
    return (f'; its gripper presses on something with {force_n:.0f} N: if the fingers reach far '
            'beyond the grasp point, move that towards their ends (grasp_point in '
            'docs/how_to/add_your_own.md)')


class InverseKinematics:
    """
    Inverse kinematics of one arm.

    :param model: a ``mujoco.MjModel``, such as the one that the node publishes on ``~/mjcf``
    :param joints: names of the arm's joints
    :param site: name of the site that is to reach the pose
    :param others: positions of other joints of the model, by name [rad or m]
    """

    def __init__(self, model: mujoco.MjModel, joints: Sequence[str], site: str,
                 others: Mapping[str, float]) -> None:
        self._model = model
        self._data = mujoco.MjData(model)
        for name, position in others.items():
            self._data.joint(name).qpos[0] = position
        self._qpos = np.array([model.joint(name).qposadr[0] for name in joints])
        self._dofs = np.array([model.joint(name).dofadr[0] for name in joints])
        self._range = np.array([
            joint.range if joint.limited[0] else (-np.inf, np.inf)
            for joint in map(model.joint, joints)])
        #: 2 pi for joints whose whole turns make no difference to a pose [rad].
        self._turn = np.where(np.isfinite(self._range[:, 0]), 0.0, 2.0 * np.pi)
        self._site = model.site(site).id

    @property
    def ranges(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest joint positions, within half a turn either way [rad], shape (n,)."""
        low, high = np.clip(self._range, -np.pi, np.pi).T
        return low, high

    def forward(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return the pose of the site.

        :param positions: of the joints [rad], shape (n,)
        :returns: position in ``world`` [m], shape (3,), and rotation matrix, shape (3, 3), copies
        """
        self._data.qpos[self._qpos] = positions
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        return (self._data.site_xpos[self._site].copy(),
                self._data.site_xmat[self._site].reshape(3, 3).copy())

    def nearest(self, joints: FloatArray, start: FloatArray) -> FloatArray:
        """
        Return joint positions of the same pose with joints without a range nearest to others.

        :param joints: [rad], shape (n,)
        :param start: the others [rad], shape (n,)
        """
        return joints - self._turn * np.rint((joints - start) / (2.0 * np.pi))

    def solve(self, start: FloatArray, position: FloatArray, rotation: FloatArray) -> FloatArray:
        """
        Return joint positions that bring the site to a pose [rad], shape (n,).

        :param start: joint positions to start from [rad], shape (n,)
        :param position: of the site in ``world`` [m], shape (3,)
        :param rotation: rotation matrix of the site in ``world``, shape (3, 3)
        :raises ValueError: if the pose is not reached
        """
        joints = np.array(start, dtype=float)
        jacobian = np.zeros((6, self._model.nv))
        for _ in range(_ITERATIONS):
            here, turned = self.forward(joints)
            error = np.concatenate([position - here, rotation_vector(rotation @ turned.T)])
            if np.abs(error).max() < _TOLERANCE:
                return joints
            mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._site)
            arm = jacobian[:, self._dofs]
            error /= max(1.0, np.abs(error).max() / _LARGEST_ERROR)
            step = arm.T @ np.linalg.solve(arm @ arm.T + _DAMPING * np.eye(6), error)
            joints = np.clip(joints + step, *self._range.T)
        raise ValueError('no joint positions found that bring the end effector to '
                         f'({", ".join(f"{value:.3f}" for value in position)}) m')


class Arm:
    """
    An arm with a gripper.

    :param task: the node that commands it
    :param name: of the robot; empty where the simulation has one robot without a name
    """

    def __init__(self, task: Demonstration, name: str = '') -> None:
        self.name = name
        self._task = task
        self._space = f'{name}/' if name else ''
        for topic, message_type in _FOLLOWED.items():
            task.follow(message_type, self._space + topic)
        self._trajectory = task.create_publisher(
            JointTrajectory, f'{self._space}arm/joint_trajectory', 1)
        self._gripper = task.create_publisher(
            Float64MultiArray, f'{self._space}right/gripper/command', 1)

    def _latest(self, topic: str) -> Any:
        return self._task.latest[self._space + topic]

    @property
    def is_seen(self) -> bool:
        """True if a message has come on every topic."""
        return all(self._space + topic in self._task.latest for topic in _FOLLOWED)

    def connect(self, model: mujoco.MjModel) -> None:
        """
        Wait until the node subscribes to commands, and use its model; needs :attr:`is_seen`.

        :raises TaskFailed: if it does not subscribe
        """
        self._task.wait_until(lambda: min(self._trajectory.get_subscription_count(),
                                          self._gripper.get_subscription_count()) > 0,
                              'the node does not subscribe to commands')
        others = self._latest(_ALL)
        # The sites of a gripper have the same prefix, whatever the robot's names begin with.
        site = self.sensor_frame.removesuffix('ft_frame') + 'grip_site'
        self._kinematics = InverseKinematics(
            model, self._latest(_ARM).name, site, dict(zip(others.name, others.position)))

    # ------------------------------------------------------------------ measured state

    @property
    def joints(self) -> FloatArray:
        """Positions of the arm's joints [rad], shape (n,), a copy."""
        return np.array(self._latest(_ARM).position)

    @property
    def fingers(self) -> FloatArray:
        """Positions of the gripper's joints [rad or m], shape (n,), a copy."""
        return np.array(self._latest(_FINGERS).position)

    @property
    def grip(self) -> tuple[FloatArray, FloatArray]:
        """Pose of the grip site in ``world``: position [m] and rotation matrix, copies."""
        return self._kinematics.forward(self.joints)

    @property
    def force(self) -> FloatArray:
        """Force that the wrist exerts on the gripper [N], in :attr:`sensor_frame`, a copy."""
        force = self._latest(_WRENCH).wrench.force
        return np.array([force.x, force.y, force.z])

    @property
    def sensor_frame(self) -> str:
        """The name of the frame of the force/torque sensor."""
        return str(self._latest(_WRENCH).header.frame_id)

    # ------------------------------------------------------------------ motion

    def posture(self, position: FloatArray, rotations: Sequence[FloatArray],
                start: FloatArray | None = None) -> FloatArray:
        """
        Return joint positions for a pose: of those found, the ones that are nearest to ``start``.

        :param position: of the grip site in ``world`` [m], shape (3,)
        :param rotations: acceptable rotation matrices of the grip site in ``world``
        :param start: joint positions before the motion [rad], shape (n,); by default the present
        :raises TaskFailed: if no joint positions are found
        """
        start = self.joints if start is None else start
        low, high = self._kinematics.ranges
        random = np.random.default_rng(0)
        solutions: list[FloatArray] = []
        for number in range(1 + _STARTS):
            begin = start if number == 0 else random.uniform(low, high)
            for rotation in rotations:
                try:
                    solutions.append(self._kinematics.solve(begin, position, rotation))
                except ValueError as error:
                    problem = error
            if number == 0 and solutions:
                break
        if not solutions:
            raise TaskFailed(f'{self.name}: {problem}' if self.name else str(problem))
        solutions = [self._kinematics.nearest(joints, start) for joints in solutions]
        return min(solutions, key=lambda joints: float(np.abs(joints - start).max()))

    def move(self, goal: FloatArray) -> None:
        """
        Move the joints along a quintic polynomial, and wait until they reach the goal.

        :param goal: joint positions [rad], shape (n,)
        :raises TaskFailed: if they do not get there
        """
        way = float(np.abs(goal - self.joints).max())
        duration_s = max(_SHORTEST_S, way / _SPEED)
        at_rest = [0.0] * len(goal)
        point = JointTrajectoryPoint(
            positions=goal.tolist(), velocities=at_rest, accelerations=at_rest,
            time_from_start=Duration(sec=int(duration_s), nanosec=int(duration_s % 1.0 * 1e9)))
        self._trajectory.publish(JointTrajectory(joint_names=self._latest(_ARM).name,
                                                 points=[point]))
        end_s, force = self._task.now_s + duration_s, self.force
        while self._task.now_s < end_s or np.abs(self.joints - goal).max() > _NEAR:
            if self._task.now_s > end_s + _LATE_S:
                raise TaskFailed(f'{self.name or "the arm"} does not reach its goal: its '
                                 f'joints are off by {np.abs(self.joints - goal).max():.3f} rad'
                                 + _obstacle(float(np.linalg.norm(self.force - force))))
            self._task.next_state()

    def open(self) -> None:
        """Open the gripper, and wait until the fingers are still."""
        self._grip(-1.0)

    def close(self) -> None:
        """Close the gripper, and wait until the fingers are still."""
        self._grip(1.0)

    def _grip(self, action: float) -> None:
        start = self.fingers
        end_s, end = self._task.now_s + _UNMOVED_S, time.monotonic() + _UNMOVED_S
        while self._way(start) < _STILL and (
                self._task.now_s < end_s or time.monotonic() < end):
            self._send_to_gripper(action)
        last, since_s, states = self.fingers, self._task.now_s, 0
        while self._task.now_s < since_s + _STILL_S or states < _STILL_STATES:
            self._send_to_gripper(action)
            states += 1
            if self._way(last) > max(_STILL, _STILL_SHARE * self._way(start)):
                last, since_s, states = self.fingers, self._task.now_s, 0

    def _send_to_gripper(self, action: float) -> None:
        """Send a command, again because a new subscriber may miss one, and wait for a state."""
        self._gripper.publish(Float64MultiArray(data=[action]))
        self._task.next_state()

    def _way(self, start: FloatArray) -> float:
        """Return how far the finger that has moved most is from where it was [rad or m]."""
        return float(np.abs(self.fingers - start).max())
