# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Random requests to spawn objects, and random goals of actions.

The packages of their types have no wheels, so the handlers get plain objects with the same fields,
in this process.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import os
from pathlib import Path
import random
import tempfile
import time
from typing import Any

from builtin_interfaces.msg import Duration
import numpy as np
from random_messages import NUMBERS, random_message, TEXTS
from target import MAX_GROWTH_MB, Row, SoakError
from test_action_messages import Plain, request, tolerance, trajectory, TYPES
from test_standard_services import BALL, MJCF, spawn_request, Standard
from trajectory_msgs.msg import JointTrajectory, MultiDOFJointTrajectory
from usage import Usage

from manip_sim.control.law.loading import load_laws
from manip_sim.errors import SimulationEnded
from manip_sim.models import compose
from manip_sim.ros.action_servers import messages_of
from manip_sim.ros.spawning_services import ResultCode
from manip_sim.runtime import SimulationThread
from manip_sim.runtime.action_goals import ActionGoal, GoalError, GoalTracker
from manip_sim.simulation import Simulation

_OBJECTS = 3
_FILES = {'can.xml': MJCF, 'ball.yaml': BALL, 'not.xml': '<mujoco>', 'self.xml':
          '<mujoco><include file="self.xml"/></mujoco>'}
#: Beside the folder of those files, so that nobody may read them; in PLACE are all folders.
_PRIVATE = {'private.xml': MJCF,
            'private_part.xml': '<mujocoinclude><geom size="0.1"/></mujocoinclude>'}
_URIS = (*_FILES, 'missing.xml', '/etc/passwd', '../can.xml', 'package://no/can.xml',
         'http://host/can.xml', '../private.xml', 'PLACE/private.xml', 'file://PLACE/private.xml',
         'private_link.xml', 'with_private.xml', *TEXTS)
_PARTS = (
    '', '<geom size="0.1"/>', '<geom size="-1"/>', '<joint range="1 0"/>', '<freejoint/>',
    '<geom type="mesh" mesh="m"/>', '<body><geom size="nan"/></body>', '<plugin plugin="p"/>',
    '<replicate count="1000000000"><geom size="1"/></replicate>',
    '<include file="PLACE/private_part.xml"/>', '&a;', '<')


def _grown(before: Usage) -> str:
    after = Usage.of(os.getpid())
    if after.memory_mb - before.memory_mb > MAX_GROWTH_MB:
        raise SoakError(f'growth is {after.since(before)}')
    return after.since(before)


def _mostly(rng: random.Random, right: Any, others: Sequence[Any]) -> Any:
    return right if rng.random() < 0.9 else rng.choice(others)


def _text(rng: random.Random) -> str:
    text = _mostly(rng, rng.choice((BALL, MJCF)), TEXTS)
    if rng.random() < 0.3:
        text = text.replace('<geom', rng.choice(_PARTS) + '<geom').replace(
            '0.1', str(rng.choice((0.1, *NUMBERS))))
    if rng.random() < 0.1 and text:
        place = rng.randrange(len(text))
        text = text[:place] + rng.choice(('', *'<>{}[]"&:\0')) + text[place + 1:]
    return text


def _write_files(place: str) -> Path:
    """Write all files, and return the folder of those that may be read."""
    folder = Path(place, 'roots')
    folder.mkdir()
    for name, text in _FILES.items():
        (folder / name).write_text(text)
    for name, text in _PRIVATE.items():
        Path(place, name).write_text(text)
    (folder / 'private_link.xml').symlink_to(Path(place, 'private.xml'))
    (folder / 'with_private.xml').write_text(MJCF.replace(
        '<geom', '<include file="../private_part.xml"/><geom'))
    return folder


def _spawn(rng: random.Random, number: int, place: str) -> dict[str, Any]:
    uri = rng.choice(_URIS).replace('PLACE', place) if rng.random() < 0.3 else ''
    text = _text(rng).replace('PLACE', place) if not uri or rng.random() < 0.1 else ''
    fields = spawn_request(
        text, uri, name=_mostly(rng, f'o{number}', ('', 'cube', *TEXTS)),
        allow_renaming=rng.random() < 0.5, namespace=_mostly(rng, '', ('/', 'a')),
        frame=_mostly(rng, '', ('world', *TEXTS)), w=_mostly(rng, 1.0, NUMBERS))
    fields['initial_pose'].pose.position.x = _mostly(rng, 0.0, NUMBERS)
    return fields


def spawns(count: int, seed: int) -> Row:
    """Ask for anything to be spawned and deleted; each request gets an answer."""
    rng, codes = random.Random(seed), Counter[str]()
    with tempfile.TemporaryDirectory() as place:
        served = Standard(_write_files(place))
        try:
            begin, before = time.monotonic(), Usage.of(os.getpid())
            for number in range(count):
                if number == count // 10:
                    before = Usage.of(os.getpid())
                fields = _spawn(rng, number, place)
                answer = served.call('spawn_entity', **fields)
                uri, text = fields['uri'], fields['resource_string']
                if answer.entity_name and ('private' in uri or '<include' in text):
                    raise SoakError(f'a private file was read: {uri}{text}')
                codes['spawned' if answer.entity_name else 'rejected'] += 1
                if not answer.entity_name and not answer.result.error_message.isprintable():
                    raise SoakError(f'the reason is no line: {answer.result.error_message!r}')
                if rng.random() < 0.1:
                    served.code('delete_entity', entity=rng.choice(TEXTS))
                names = [name for name in served.simulation.plan.object_names if name != 'cube']
                if len(names) > _OBJECTS:
                    code, reason = served.code('delete_entity', entity=rng.choice(names))
                    if code != ResultCode.RESULT_OK:
                        raise SoakError(f'what was spawned cannot be deleted: {reason}')
            rate, growth = count / (time.monotonic() - begin), _grown(before)
            served.thread.call(lambda: served.simulation.reset())
            served.thread.call(lambda: served.simulation.advance(10))
            if not np.isfinite(served.simulation.data.qpos).all():
                raise SoakError('the state is not finite')
        finally:
            served.thread.stop()
    if min(codes['spawned'], codes['rejected']) == 0:
        raise SoakError(f'only {dict(codes)}')
    return {'load': 'random spawns', 'amount': f'{count} requests', 'growth': growth,
            'result': f"{rate:.0f}/s, {codes['spawned']} spawned, {codes['rejected']} rejected; "
                      'alive'}


def _request(rng: random.Random, kind: str, names: list[str]) -> Any:
    """Return a goal that is right, or wrong in some fields."""
    number = _mostly(rng, 0.02, NUMBERS)
    if kind == 'gripper_cmd':
        return Plain(command=Plain(position=number, max_effort=_mostly(rng, 0.0, NUMBERS)))
    if kind == 'parallel_gripper_cmd':
        return Plain(command=Plain(
            position=[number] * rng.choice((1, 1, 0, 2)), name=rng.choice(([], [], names[:1])),
            velocity=[rng.choice(NUMBERS)] * rng.choice((0, 0, 1)),
            effort=[rng.choice(NUMBERS)] * rng.choice((0, 0, 1))))
    asked = rng.sample(names, rng.randint(1, len(names)))
    goal = request(trajectory=trajectory(asked, [rng.uniform(-0.5, 0.5) for _ in asked]))
    wrong = rng.random()
    if wrong < 0.2:
        goal.trajectory = random_message(rng, JointTrajectory)
    elif wrong < 0.3:
        goal.trajectory.points[0].positions[0] = rng.choice(NUMBERS)
    elif wrong < 0.4:
        goal.multi_dof_trajectory = random_message(rng, MultiDOFJointTrajectory)
    elif wrong < 0.6:
        setattr(goal, rng.choice(('path_tolerance', 'goal_tolerance')), [tolerance(
            rng.choice((asked[0], *TEXTS)), rng.choice(NUMBERS), rng.choice(NUMBERS))])
        goal.goal_time_tolerance = random_message(rng, Duration)
    return goal


def actions(count: int, seed: int) -> Row:
    """Send goals of all actions, and cancel some; each that is accepted ends."""
    rng = random.Random(seed)
    simulation = Simulation(compose('Panda'))
    thread = SimulationThread(simulation, steps=5, stepping='free')
    ended = Counter[str]()

    def count_end(goal: ActionGoal) -> None:
        ended[goal.robot.name] += 1
    tracker = GoalTracker(thread, simulation, count_end)
    offered = list(messages_of(TYPES, simulation.robot, lambda: thread.progress.time_ns))
    started = rejected = 0
    load_laws()  # They stay for good, and are no growth.
    thread.start()
    try:
        begin, before = time.monotonic(), Usage.of(os.getpid())
        for number in range(count):
            if number == count // 10:
                before = Usage.of(os.getpid())
            messages = rng.choice(offered)
            part = simulation.robot.parts[messages.part]
            try:
                goal = messages.goal_of(_request(rng, messages.name, list(part.joints)))
            except GoalError as error:
                rejected += 1
                if not str(error):
                    raise SoakError('a goal was rejected without a reason') from error
                continue
            tracker.start(goal)
            started += 1
            messages.feedback_of(goal)
            if rng.random() < 0.3:
                tracker.cancel(goal)
            messages.result_of(goal)
        rate = count / (time.monotonic() - begin)
        tracker.abort_all('the load ends')
        finite = thread.call(lambda: bool(np.isfinite(simulation.data.qpos).all()))
    except SimulationEnded as error:
        raise SoakError(f'the simulation ended: {error}') from error
    finally:
        thread.stop()
    if ended.total() != started or not finite or not started or not rejected:
        raise SoakError(f'{started} goals started and {ended.total()} ended, {rejected} rejected; '
                        f'the state is {"" if finite else "not "}finite')
    return {'load': 'random goals of actions', 'amount': f'{count} goals, {len(offered)} actions',
            'result': f'{rate:.0f}/s, {rejected} rejected, all others ended; state finite',
            'growth': _grown(before)}
