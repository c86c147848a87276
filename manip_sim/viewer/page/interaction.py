# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands that people give on the page, by panels or the pointer; saved poses, aimed cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import itertools
import json
import math
from pathlib import Path
import queue
import random
import re
import time
from typing import Any, Protocol

import mujoco
import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import ManipSimError
from manip_sim.quoting import quoted
from manip_sim.viewer.page.latest import Latest, Robot, ShownJoint, ShownPart
from manip_sim.viewer.page.model_scene import FIELD_OF_VIEW, FIRST, first_view, Kinematics, Scene

#: Least time for which a request of a person is shown [s]; also until nothing moves.
_HOLD_S = 1.0


class PageCommands(Protocol):
    """A receiver of the commands of people, called in one thread; without one, a page shows."""

    def move_joints(self, space: str, part: str, field: str, goals: Mapping[str, float]) -> None:
        """
        Command joints of a part.

        :param space: namespace of the robot's topics, such as ``/left/``
        :param goals: by joint [rad or m, rad/s or m/s, N m or N]
        """

    def act(self, space: str, part: str, action: float) -> None:
        """Send an action in [-1, 1], the same for all fingers of a gripper; +1 closes."""

    def drive(self, space: str, twist: tuple[float, float, float]) -> None:
        """Send a velocity of a mobile base along its x and y and about z [m/s, m/s, rad/s]."""

    def reach(self, space: str, arm: str, position: FloatArray, quat_wxyz: FloatArray) -> None:
        """Send a target pose of an end effector in ``world``; the position in [m]."""

    def pull(self, body: str, number: int, point: FloatArray, target: FloatArray) -> None:
        """
        Pull a body for a moment.

        :param number: of the drag; while it stays the same, the point does not count again
        :param point: of the body, in ``world`` [m], shape (3,)
        :param target: where the point is pulled to, in ``world`` [m], shape (3,)
        """

    def let_go(self, body: str) -> None:
        """End the pull of a body."""

    def modes(self, space: str, part: str) -> Sequence[str]:
        """Return the control modes that a part can be switched to; none if it has no choice."""

    def switch_mode(self, space: str, part: str, mode: str) -> None:
        """Switch the control mode of a part."""

    def record(self, wanted: bool) -> None:
        """Begin or end a record of the node."""

    def pause(self, paused: bool) -> None:
        """Pause the simulation, or let it go on."""

    def step(self) -> None:
        """Advance a paused simulation by one control period."""

    def reset(self) -> None:
        """Bring the simulation back to its start."""

    def tare(self) -> None:
        """Tare the external wrenches: let them read zero now."""


class Events:
    """A queue of calls, from threads of the server to the thread that updates the page."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def add(self, event: Callable[[], None]) -> None:
        """Queue a call for the next :meth:`run`."""
        self._waiting.put(event)

    def run(self) -> None:
        """Make the queued calls, in the order in which they came."""
        for _ in range(self._waiting.qsize()):
            self._waiting.get()()


class Following:
    """
    The choice whether an input shows the measured or the requested value.

    A goal that is not reached, such as one behind an obstacle, is given up when all is still.
    """

    def __init__(self) -> None:
        self._until_s: float | None = None

    def asked(self, now_s: float) -> None:
        """Note that a person has changed the input; ``now_s`` is wall time [s]."""
        self._until_s = now_s + _HOLD_S

    def follows(self, now_s: float, moving: bool) -> bool:
        """Tell whether to show the measured value, which moves or cannot in a pause; time [s]."""
        if self._until_s is None:
            return True
        if moving:
            self._until_s = max(self._until_s, now_s + 0.2 * _HOLD_S)
        if now_s > self._until_s:
            self._until_s = None
        return self._until_s is None


_NAME = re.compile(r'\w[\w -]{0,39}')
#: Number of poses, and size of their file [bytes], at most.
_MOST, _MAX_BYTES = 100, 2**20
_NONE = '(none saved)'
_POSITION = 'position'


class Poses:
    """
    Joint positions [rad or m] by joint, by the name of the pose.

    :param file: keeps them in JSON, and is written at each change; None keeps them in memory
    :raises ManipSimError: if the file cannot be read, or holds anything else
    """

    def __init__(self, file: Path | None = None) -> None:
        self._file = file
        self._poses: dict[str, dict[str, float]] = {} if file is None else _read(file)

    @property
    def names(self) -> list[str]:
        return sorted(self._poses)

    def get(self, name: str) -> dict[str, float]:
        """Return the positions by joint; empty if the pose is unknown."""
        return dict(self._poses.get(name, {}))

    def save(self, name: str, joints: Mapping[str, float]) -> None:
        """
        Add a pose, or replace the one of this name.

        :raises ManipSimError: if the name cannot be used, there are too many poses, or the file
            cannot be written; nothing changes then
        """
        if not _NAME.fullmatch(name):
            raise ManipSimError(f'{quoted(name)} cannot name a pose: use 1 to 40 letters, '
                                'digits, spaces, _ or -')
        if name not in self._poses and len(self._poses) >= _MOST:
            raise ManipSimError(f'there are {_MOST} poses already: delete one first')
        self._change({**self._poses, name: dict(joints)})

    def delete(self, name: str) -> None:
        """Delete a pose, if it is there; raises as :meth:`save`."""
        self._change({other: joints for other, joints in self._poses.items() if other != name})

    def _change(self, poses: dict[str, dict[str, float]]) -> None:
        if self._file is not None:
            new = self._file.with_name(f'{self._file.name}.new')
            try:
                new.write_text(json.dumps(poses, indent=1) + '\n')
                new.replace(self._file)
            except OSError as error:
                raise ManipSimError(
                    f'cannot write {self._file}: {error.strerror or error}') from error
        self._poses = poses


def _read(file: Path) -> dict[str, dict[str, float]]:
    try:
        with file.open('rb') as stream:
            poses = json.loads(stream.read(_MAX_BYTES))
    except FileNotFoundError:
        if file.parent.is_dir():
            return {}
        raise ManipSimError(f'no such folder: {file.parent}') from None
    except OSError as error:
        raise ManipSimError(f'cannot read {file}: {error.strerror or error}') from error
    except (ValueError, RecursionError) as error:
        raise ManipSimError(f'{file} is not JSON: {error}') from error
    if not (isinstance(poses, dict) and len(poses) <= _MOST and all(
            _NAME.fullmatch(name) and isinstance(pose, dict) and all(
                type(position) in (int, float) and abs(position) < math.inf
                for position in pose.values()) for name, pose in poses.items())):
        raise ManipSimError(f'{file} holds no poses: expected at most {_MOST} names, each with '
                            'finite positions by joint')
    return poses


class PosePanel:
    """A folder that saves the positions of all sliders under a name, and moves there again."""

    def __init__(self, gui: Any, poses: Poses, robots: Sequence[Robot], commands: PageCommands,
                 events: Events, notify: Callable[[str], None]) -> None:
        self._poses, self._robots = poses, robots
        self._commands, self._notify = commands, notify
        self._latest, self._fields = Latest(), dict[str, str]()
        with gui.add_folder('Poses', expand_by_default=False, order=-2.0):
            self._choice = gui.add_dropdown('Pose', self._options)
            gui.add_button_group('Saved', ('Go to pose', 'Delete')).on_click(
                lambda event: events.add(
                    self._delete if event.target.value == 'Delete' else self._go))
            self._name = gui.add_text('Name', '', hint='of the pose to save')
            gui.add_button('Save pose').on_click(
                lambda _: events.add(self._save))

    def update(self, latest: Latest, fields: Mapping[str, str]) -> None:
        """Take the newest states, and by part the field that its commands use."""
        self._latest, self._fields = latest, dict(fields)

    @property
    def _options(self) -> tuple[str, ...]:
        return tuple(self._poses.names) or (_NONE,)

    def _parts(self) -> Iterator[tuple[Robot, ShownPart, str]]:
        """Yield robots and parts that have sliders, with the fields of their commands."""
        for robot in self._robots:
            for part in robot.parts:
                if part.joints:
                    yield robot, part, self._fields.get(
                        robot.status_name(part.name), _POSITION)

    def _save(self) -> None:
        joints = {}
        for robot, part, field in self._parts():
            states = self._latest.joints.get(robot.space)
            if states is not None and field == _POSITION:
                measured = dict(zip(states.names, states.position))
                joints.update({joint.name: _within(joint, float(measured[joint.name]))
                               for joint in part.joints if joint.name in measured})
        name = str(self._name.value).strip()
        if not joints:
            self._notify('no pose saved: no part takes position commands')
        elif self._done(lambda: self._poses.save(name, joints)):
            self._choice.options = self._options
            self._choice.value = name
            self._name.value = ''

    def _delete(self) -> None:
        if self._done(lambda: self._poses.delete(str(self._choice.value))):
            self._choice.options = self._options

    def _go(self) -> None:
        pose = self._poses.get(str(self._choice.value))
        moved = False
        for robot, part, field in self._parts():
            goals = {joint.name: _within(joint, pose[joint.name]) for joint in part.joints
                     if joint.name in pose}
            if goals and field != _POSITION:
                self._notify(f'{robot.titled(part.name)} takes {field} commands: a pose needs '
                             'position commands')
            elif goals:
                self._commands.move_joints(robot.space, part.name, _POSITION, goals)
            moved = moved or bool(goals)
        if pose and not moved:
            self._notify('this pose has no joint of these robots')

    def _done(self, change: Callable[[], None]) -> bool:
        try:
            change()
        except ManipSimError as error:
            self._notify(str(error))
            return False
        return True


def _within(joint: ShownJoint, position: float) -> float:
    low, high = joint.ranges[_POSITION]
    return min(max(position, low), high)


#: Width of the panel, and of the widest window that has it below.
_PANEL_PIXELS, _PHONE_PIXELS = 400, 576
#: Share of its height that the open panel of a phone covers; the page's style says so.
_SHEET = 0.45
#: Aspect ratio of the first view until a browser has sent the size of its window.
_ASPECT = 1.4
#: Directions of view, by their names in the menu; x is forward, y to the left.
VIEWS = {'Home': FIRST, 'Front': (1.0, 0.0, 0.2), 'Left': (0.0, 1.0, 0.2),
         'Top': (-0.02, 0.0, 1.0)}
#: Cameras that are nearer to one another are the same [m].
_SAME_M = 0.01


@dataclass(frozen=True)
class _Aimed:
    """The place and the target of a camera that was aimed, for a window of a size [pixels]."""

    position: FloatArray
    look_at: FloatArray
    size: tuple[int, int]
    direction: tuple[float, float, float]


class Aiming:
    """
    The cameras of browsers.

    The server gives every new browser the same first view, whatever the shape of its window. A
    slow browser may apply that view after its camera was aimed, and the button that resets the
    view always does; so any camera found at the first view is aimed again. So is one that nobody
    has moved since, in a window of another size, such as that of a phone that was turned.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._aimed: dict[int, _Aimed] = {}
        self._world: object = None

    def begin(self, posture: Kinematics) -> None:
        """
        Set the first view of browsers that come; in another world, that of all browsers.

        Objects that come and go leave the world the same.
        """
        model = posture.model  # The bodies that never move: the arena, and where robots stand.
        world = set(posture.scalar_joints), {
            (model.body(i).name, *model.body_pos[i].round(3).tolist())
            for i in range(model.nbody) if model.body_weldid[i] == 0}
        if world != self._world:
            self._world = world
            self._aimed.clear()
        camera = self._server.initial_camera
        camera.fov = FIELD_OF_VIEW
        camera.position, camera.look_at = first_view(model, posture.data, _ASPECT)

    def update(self, posture: Kinematics) -> None:
        """Aim the cameras that are new or at the first view, after :meth:`begin`."""
        clients = self._server.get_clients()
        self._aimed = {number: aimed for number, aimed in self._aimed.items() if number in clients}
        for number, client in clients.items():
            camera, aimed = client.camera, self._aimed.get(number)
            if aimed is None or _is_at(camera, self._server.initial_camera):
                self._aimed[number] = _aim(camera, posture, FIRST)
            elif aimed.size != _size(camera) and _is_at(camera, aimed):
                self._aimed[number] = _aim(camera, posture, aimed.direction)

    def look(self, number: int | None, view: str, posture: Kinematics) -> None:
        """Aim the camera of a browser, by its number, if it is there, at one of :data:`VIEWS`."""
        client = self._server.get_clients().get(number)
        if number is not None and client is not None and view in VIEWS:
            self._aimed[number] = _aim(client.camera, posture, VIEWS[view])


def _is_at(camera: Any, other: Any) -> bool:
    """Return whether a camera is where another one is, and looks at the same."""
    return bool(np.abs(camera.position - other.position).max() < _SAME_M
                and np.abs(camera.look_at - other.look_at).max() < _SAME_M)


def _size(camera: Any) -> tuple[int, int]:
    """Return width and height of the window of a camera [pixels]."""
    return camera.image_width, max(1, camera.image_height)


def _aim(camera: Any, posture: Kinematics, direction: tuple[float, float, float]) -> _Aimed:
    width, height = _size(camera)
    # On a phone the panel is below the picture.
    phone = width <= _PHONE_PIXELS
    position, target = first_view(
        posture.model, posture.data, width / height,
        0.0 if phone else min(0.5, _PANEL_PIXELS / width), _SHEET if phone else 0.0,
        direction)
    camera.fov = FIELD_OF_VIEW
    camera.position = position
    camera.look_at = target
    return _Aimed(position, target, (width, height), direction)


_SCALE = 0.18
#: An end effector that moves less between two calls [m] is still.
_STILL_M = 2e-4
_SAME = 1e-4


class EndEffectorTarget:
    """The target of one end effector."""

    def __init__(self, scene: Any, space: str, arm: str, commands: PageCommands) -> None:
        self._space, self._arm, self._commands = space, arm, commands
        self._following = Following()
        self._asked = False
        self._last = np.zeros(3)
        self._dragged = False
        self._control = scene.add_transform_controls(
            f'/targets{space}{arm}', scale=_SCALE, visible=False, depth_test=False, opacity=0.85)
        self._control.on_update(self._moved)

    def _moved(self, event: Any) -> None:
        self._dragged = event.phase != 'end'
        self._following.asked(time.monotonic())
        if event.phase == 'update':
            self._asked = True

    def show(self, shown: bool) -> None:
        self._control.visible = shown

    def send(self) -> None:
        """Send its pose if it has been dragged since the last call."""
        if self._asked:
            self._asked = False
            self._commands.reach(self._space, self._arm, np.array(self._control.position),
                                 np.array(self._control.wxyz))

    def follow(self, now_s: float, position: FloatArray, quat_wxyz: FloatArray,
               paused: bool) -> None:
        """
        Move the target to the end effector, unless the end effector is on its way to the target.

        :param now_s: wall time [s]
        :param position: of the end effector in ``world`` [m]
        """
        # In a pause, what is on its way cannot move.
        moving = paused or self._dragged or np.linalg.norm(position - self._last) > _STILL_M
        self._last = position
        if not self._control.visible or not self._following.follows(now_s, bool(moving)):
            return
        if np.abs(position - self._control.position).max() > _SAME:
            self._control.position = position
        if 1.0 - abs(float(quat_wxyz @ self._control.wxyz)) > _SAME ** 2:
            self._control.wxyz = quat_wxyz

    def remove(self) -> None:
        self._control.remove()


#: A pull of the node ends 0.2 s after it was last asked for; time between two requests [s].
_PERIOD_S = 0.05
#: So that the pulls of two pages are two.
_FIRST = 2**30


@dataclass
class _Drag:
    """
    A body that a person drags.

    :ivar begin: where it was taken hold of, in ``world`` [m], shape (3,)
    :ivar target: where the mouse is, in ``world`` [m], shape (3,)
    :ivar held: where it was taken hold of, in the frame of the body; None until it is known
    """

    number: int
    body: str
    begin: FloatArray
    target: FloatArray
    held: FloatArray | None = None


class Pulling:
    """A box to tick, and while it is ticked, bodies that can be dragged."""

    def __init__(self, gui: Any, commands: PageCommands, events: Events) -> None:
        self._commands, self._events = commands, events
        self._scene: Scene | None = None
        self._drag: _Drag | None = None
        self._numbers = itertools.count(random.randrange(_FIRST))
        self._sent_s = 0.0
        self._box = gui.add_checkbox('Pull', False, hint='drag objects and links: a spring pulls '
                                     'them to the mouse. Beside them, the mouse turns the view')
        self._box.on_update(lambda _: events.add(self._apply))

    def attach(self, scene: Scene) -> None:
        """Let the bodies of this scene be dragged from now on."""
        self._scene = scene
        self._apply()

    def _apply(self) -> None:
        self.release()
        if self._scene is not None:
            self._scene.let_drag(self._dragged if self._box.value else None)

    def _dragged(self, body: str, phase: str, begin: Any, end: Any) -> None:
        """Queue what the mouse does; called by the server, with what a browser sent."""
        try:
            ends = np.array([begin, end], dtype=float)
        except (TypeError, ValueError):
            return
        if ends.shape == (2, 3) and np.isfinite(ends).all():
            self._events.add(lambda: self._follow(body, phase, ends))

    def _follow(self, body: str, phase: str, ends: FloatArray) -> None:
        if phase == 'end':
            self.release()
        elif not self._box.value:
            return
        elif phase == 'start':
            self.release()
            self._drag = _Drag(next(self._numbers), body, ends[0], ends[1])
        elif self._drag is not None:
            self._drag.target = ends[1]

    def release(self) -> None:
        if self._drag is not None:
            self._commands.let_go(self._drag.body)
            self._drag = None

    def send(self, now_s: float) -> None:
        """Ask for the pull again if it is due; ``now_s`` is wall time [s]."""
        drag = self._drag
        if drag is not None and now_s >= self._sent_s + _PERIOD_S:
            self._sent_s = now_s
            self._commands.pull(drag.body, drag.number, drag.begin, drag.target)

    def arrow(self, posture: Kinematics) -> FloatArray:
        """Return the spring as an arrow in ``world`` [m], (1, 2, 3), or none, (0, 2, 3)."""
        drag = self._drag
        body = -1 if drag is None else mujoco.mj_name2id(
            posture.model, mujoco.mjtObj.mjOBJ_BODY, drag.body)
        if drag is None or body < 0:
            return np.zeros((0, 2, 3))
        rotation, origin = posture.data.xmat[body].reshape(3, 3), posture.data.xpos[body]
        if drag.held is None:
            drag.held = rotation.T @ (drag.begin - origin)
        return np.array([[origin + rotation @ drag.held, drag.target]])
