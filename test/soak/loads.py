# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What is done to the node: each function does one kind of load and returns what was seen."""

from __future__ import annotations

from pathlib import Path
import random
import signal
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist, Vector3
import numpy as np
from random_messages import damaged
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from target import Row, SoakError, Target, wait_for_handlers
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

_CLIENTS = str(Path(__file__).parent / 'clients.py')
#: What ends the node; with nohup it does not end by SIGHUP.
_SIGNALS = [number for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
            if signal.getsignal(number) != signal.SIG_IGN]
#: Malformed messages after which caches are filled and growth counts.
_WARM = 2_000
#: Messages in one burst, no more than the node takes until the next one; places of the queue of a
#: topic; and what all places can hold of messages of 20 kB, as four long names make them [MB].
_BURST, _PLACES, _MALFORMED_MB = 80, 80, 12.0
_NUMBERS = (0.0, 1.0, -1.0, 1e308, -1e308, 5e-324, float('nan'), float('inf'), -float('inf'))
_NAMES = ('robot0_joint1', 'robot0_joint2', '', 'elbow', "x'y'z", 'a\nb', '\x1b[2J', 'j' * 5000,
          'gripper0_right_finger_joint1')
_TOPICS = {'arm/command': Float64MultiArray, 'right/gripper/command': Float64MultiArray,
           'arm/joint_command': JointState, 'right/gripper/joint_command': JointState,
           'joint_command': JointState, 'arm/joint_trajectory': JointTrajectory,
           'base/cmd_vel': Twist}


def _numbers(rng: random.Random, most: int = 9) -> list[float]:
    return rng.choices(_NUMBERS, k=rng.randint(0, most))


def random_message(rng: random.Random, message_type: Any) -> Any:
    """Return a message that is most often invalid."""
    if message_type is Float64MultiArray:
        return Float64MultiArray(data=_numbers(rng))
    if message_type is Twist:
        return Twist(linear=Vector3(x=rng.choice(_NUMBERS), z=rng.choice(_NUMBERS)))
    names = rng.choices(_NAMES, k=rng.randint(0, 4))
    if message_type is JointState:
        message = JointState(name=names, position=_numbers(rng, 4), velocity=_numbers(rng, 2),
                             effort=_numbers(rng, 1))
    else:
        message = JointTrajectory(joint_names=names)
        for _ in range(rng.randint(0, 3)):
            point = JointTrajectoryPoint(positions=_numbers(rng, 4), velocities=_numbers(rng, 2))
            point.time_from_start.sec = rng.randint(-2, 5)
            message.points.append(point)
    message.header.stamp.sec = rng.choice((0, 0, 1, -(2 ** 31), 2 ** 31 - 1))
    return message


def _parameter(rng: random.Random) -> Parameter:
    name = rng.choice(('real_time_factor', 'robot', '', 'qos_overrides', 'x' * 3000,
                       'use_sim_time'))
    return Parameter(name=name, value=ParameterValue(
        type=rng.choice((0, 1, 2, 3, 4, 5, 9, 10, 99, 255)), double_value=rng.choice(_NUMBERS),
        integer_value=rng.choice((0, 2 ** 62, -1)), string_value='\n\x1b'))


def malformed(count: int, seed: int) -> Row:
    """Send messages that are random or damaged on all topics, and bad parameter requests."""
    rng = random.Random(seed)
    # The queues hold what one burst sends, so that all messages come to the callbacks. Fast DDS
    # keeps room for the largest message so far in each place of a queue: memory grows, ever
    # slower, up to the number of places times the largest message, and no further.
    queues = [f'qos_overrides./{topic}.subscription.depth:={_PLACES}' for topic in _TOPICS]
    with Target('robot:=PandaOmron', *queues) as target:
        client = target.client
        publishers = [(client.publisher(kind, topic), kind) for topic, kind in _TOPICS.items()]
        arrays = client.listen(DiagnosticArray, '/diagnostics', 10)
        parameters = client.node.create_client(SetParameters, 'manip_sim/set_parameters')
        sent, begin, warm = 0, time.monotonic(), False
        while sent < count:
            if not warm and sent >= min(_WARM, count // 10):
                target.mark()
                warm = True
            for _ in range(min(_BURST, count - sent)):
                publisher, kind = rng.choice(publishers)
                message = random_message(rng, kind)
                publisher.publish(message if rng.random() < 0.5
                                  else damaged(rng, serialize_message(message)))
                sent += 1
            if rng.random() < 0.2:
                future = parameters.call_async(SetParameters.Request(parameters=[_parameter(rng)]))
                parameters.remove_pending_request(future)
                sent += 1
            # Between two answers the node takes one message of each topic at least.
            for _ in range(12):
                target.latency_ms()
            client.executor.spin_once(timeout_sec=0.0)
            del arrays[:-1]
        elapsed_s = time.monotonic() - begin
        seen = _handled(client, arrays)
        growth = target.checked_growth(_MALFORMED_MB)
        target.check()
        target.stop()
    return {'load': 'malformed messages', 'amount': f'{sent} sent, {seen} came to a callback',
            'result': f'{sent / elapsed_s:.0f}/s, alive, obeys', 'growth': growth}


def _handled(client: Any, arrays: list[Any]) -> int:
    del arrays[:]
    client.spin_until(lambda: bool(arrays))
    total = 0
    for status in arrays[-1].status:
        values = {pair.key: pair.value for pair in status.values}
        total += sum(int(values.get(key, 0)) for key in (
            'accepted', 'dropped', 'failed_callbacks', 'failed_takes'))
    return total


def floods(duration_s: float) -> list[Row]:
    """Publish as fast as a process can, valid and invalid commands, while services are called."""
    rows = []
    with Target() as target:
        target.watch_clock()
        for what in ('arm/command', 'joint_command', 'invalid joint_command'):
            flooder = subprocess.Popen([sys.executable, _CLIENTS, 'flood', what],
                                       stdout=subprocess.PIPE, text=True)
            latencies: list[float] = []
            try:
                target.client.spin_until(
                    lambda w=what: target.client.node.count_publishers(w.split()[-1]) > 0)
                target.real_time_factor()
                end = time.monotonic() + duration_s
                while time.monotonic() < end:
                    latencies.append(target.latency_ms())
                factor = target.real_time_factor()
            finally:
                flooder.send_signal(signal.SIGINT)
                sent = flooder.communicate(timeout=300.0)[0].strip()
            p50, p99 = np.percentile(latencies, [50, 99])
            rows.append({
                'load': f'flood of {what}', 'amount': f'{sent} messages/s for {duration_s:g} s',
                'result': f'real-time factor {factor:.3f}; service p50 {p50:.1f} ms, '
                          f'p99 {p99:.1f} ms, longest {max(latencies):.1f} ms',
                'growth': target.growth()})
        target.check()
        target.stop()
    return rows


def vanishing_clients(count: int) -> Row:
    """Let clients ask, publish and listen, and kill them at once; stop every fourth one before."""
    with Target() as target:
        # The first ones make caches grow that do not grow any more.
        for n in range(count):
            client = subprocess.Popen([sys.executable, _CLIENTS, 'vanish'],
                                      stdout=subprocess.PIPE, text=True)
            client.stdout.readline()
            if n % 4 == 0:
                client.send_signal(signal.SIGSTOP)
                target.latency_ms()
            client.kill()
            client.communicate()
        # What is dead is forgotten after 20 s.
        end = time.monotonic() + 25.0
        target.client.spin_until(lambda: time.monotonic() > end)
        target.check()
        growth = target.growth()
        target.stop()
    return {'load': 'clients killed', 'amount': str(count), 'result': 'alive, obeys',
            'growth': growth}


def stops(count: int, seed: int) -> Row:
    """End the node by a signal at random moments, with commands and requests arriving."""
    rng = random.Random(seed)
    kinds = ([], ['stepping:=free'], ['stepping:=lockstep'], ['robot:=GR1'],
             ['start_paused:=true'], ['publish_rate:=500'])
    longest_s = 0.0
    for _ in range(count):
        target = Target(*rng.choice(kinds))
        client = target.client
        publisher = client.node.create_publisher(Float64MultiArray, 'arm/command', 10)
        services = [client.node.create_client(Trigger, f'manip_sim/{name}')
                    for name in ('reset', 'tare_wrench', 'step')]

        def traffic() -> None:
            publisher.publish(Float64MultiArray(data=[0.1] * 7))  # noqa: B023
            for service in services:  # noqa: B023
                if service.service_is_ready():
                    service.call_async(Trigger.Request())
        client.node.create_timer(0.002, traffic)
        try:
            wait_for_handlers(target.process)
            end = time.monotonic() + rng.uniform(0.0, 2.5)
            client.spin_until(lambda e=end: time.monotonic() > e)
            longest_s = max(longest_s, target.stop(rng.choice(_SIGNALS)))
        finally:
            target.__exit__()
    return {'load': 'stops under traffic', 'amount': str(count),
            'result': f'exit code 0, no traceback, longest {longest_s:.2f} s', 'growth': ''}


def starts(count: int, seed: int) -> Row:
    """End ``sim_node`` and ``sim_view`` at random moments of their start, by a signal or many."""
    rng = random.Random(seed)
    programs = (['manip_sim'], ['manip_sim', '--ros-args', '-p', 'robot:=GR1'],
                ['manip_sim.viewer', '--port', '0'])
    longest_s = 0.0
    for number in range(count):
        program = subprocess.Popen([sys.executable, '-m', *rng.choice(programs)], text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        wait_for_handlers(program)
        # Most of a start passes in its first moments, as far as signals are concerned.
        time.sleep(rng.uniform(0.0, rng.choice((0.03, 3.0))))
        begin, many = time.monotonic(), rng.random() < 0.5
        program.send_signal(rng.choice(_SIGNALS))
        while many and program.poll() is None and time.monotonic() < begin + 10.0:
            time.sleep(rng.uniform(0.0, 0.02))
            program.send_signal(rng.choice(_SIGNALS))
        try:
            _, errors = program.communicate(timeout=300.0)
        except subprocess.TimeoutExpired:
            program.kill()
            program.communicate()
            raise SoakError(f'start {number}: {program.args} did not end') from None
        if program.returncode != 0 or 'Traceback' in errors:
            raise SoakError(f'start {number}: {program.args} ended with {program.returncode}: '
                            f'{errors[-2000:]}')
        longest_s = max(longest_s, time.monotonic() - begin)
    return {'load': 'stops during the start', 'amount': str(count),
            'result': f'exit code 0, no traceback, longest {longest_s:.2f} s', 'growth': ''}


def simulated_time(hours: float, seed: int) -> Row:
    """Simulate as fast as possible, with new goals for all joints all the time."""
    rng = random.Random(seed)
    with Target('stepping:=free', 'arena:=table', 'publish_rate:=10') as target:
        client, states = target.client, []
        client.node.create_subscription(JointState, 'joint_states', states.append, 10)
        client.spin_until(lambda: bool(states))
        arm = [name for name in states[-1].name if name.startswith('robot0')]
        begin, first_s = time.monotonic(), states[-1].header.stamp.sec
        publisher = client.publisher(JointState, 'joint_command', 10)
        warm = None
        while states[-1].header.stamp.sec - first_s < hours * 3600.0:
            publisher.publish(JointState(name=arm, position=[rng.uniform(-2.0, 2.0) for _ in arm]))
            del states[:-1]
            client.spin_until(lambda: len(states) > 5)
            state = states[-1]
            if not np.isfinite([*state.position, *state.velocity, *state.effort]).all():
                raise SoakError(f'the state is not finite: {state}')
            if warm is None and time.monotonic() - begin > 10.0:
                warm = target.mark()
        speed = (states[-1].header.stamp.sec - first_s) / (time.monotonic() - begin)
        growth = target.growth()
        target.check()
        target.stop()
    return {'load': 'simulated time', 'amount': f'{hours:g} h',
            'result': f'{speed:.0f} times real time, all states finite, obeys', 'growth': growth}
