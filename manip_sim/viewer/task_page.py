# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A page that shows the world of a task, and on which a person drags end effectors."""

from __future__ import annotations

import os
import time
from typing import Any

import mujoco
import numpy as np

from manip_sim.algebra import matrix_of
from manip_sim.errors import ModelError
from manip_sim.experiments.demonstrations import Device, EVENTS, external_force, Reading
from manip_sim.simulation.snapshots import VisibleWorld
from manip_sim.tasks import Episode
from manip_sim.tasks.episode_actions import PoseActions
from manip_sim.viewer.page.interaction import Aiming, Events
from manip_sim.viewer.page.latest import Line, PlainText
from manip_sim.viewer.page.model_scene import Kinematics, Scene
from manip_sim.viewer.page.server import Access, close_server, open_server, page_address, set_theme

#: Time between two looks at the page before an episode begins [s].
_PERIOD_S = 1.0 / 30.0
_SCALE = 0.18


class TaskPage:
    """
    A page with the world of a task, the time, and the external force.

    :param port: 0 takes one that is free
    :raises ManipSimError: if it cannot listen there
    """

    def __init__(self, episode: Episode, listen: str, port: int) -> None:
        self._episode = episode
        # The simulation's own model has no shapes that only show something.
        self._posture = Kinematics(VisibleWorld(episode.simulation.plan).model)
        access = Access.of(os.environ)
        self.server: Any = open_server(listen, port, access)
        self.address = page_address(self.server, listen, access)
        set_theme(self.server, dark=False)
        self._text = PlainText(self.server.gui)
        self._scene = Scene(self.server, self._posture.model, self._posture.data)
        self._aiming = Aiming(self.server)
        self._aiming.begin(self._posture)

    def update(self) -> None:
        """Show the present state."""
        episode, shown = self._episode, self._posture.data
        data = episode.simulation.data
        shown.qpos[:], shown.mocap_pos[:] = data.qpos, data.mocap_pos
        shown.mocap_quat[:] = data.mocap_quat
        self._posture.compute()
        self._scene.update(shown)
        self._aiming.update(self._posture)
        self._text.show([
            Line(episode.task.instruction),
            Line(f'{episode.periods * episode.period_s:.1f} s of '
                 f'{episode.most_periods * episode.period_s:.1f}', 'Time'),
            Line(f'{external_force(episode):.1f} N', 'External force')])

    def close(self) -> None:
        """Close the page."""
        close_server(self.server)


class PageDevice(Device):
    """
    A page with a target for each end effector, which moves there.

    An episode begins as soon as a person does something.

    :param episode: whose actions are ``osc_pose``
    :param port: 0 takes one that is free
    :raises ModelError: if the actions are others
    :raises ManipSimError: if it cannot listen there
    """

    gives_actions = True

    def __init__(self, episode: Episode, listen: str, port: int) -> None:
        if not isinstance(episode.actions, PoseActions):
            raise ModelError('a person drags end effectors, so the actions must be osc_pose')
        self._episode, self._actions = episode, episode.actions
        self._page = TaskPage(episode, listen, port)
        self.help = f'drag the end effector on {self._page.address}'
        self._events, self._event, self._acted = Events(), '', False
        gui = self._page.server.gui
        several = len(self._actions.arms) > 1
        self._targets, self._grippers = [], []
        for item in self._actions.arms:
            name = f'{item.robot.name}/{item.arm}'
            target = self._page.server.scene.add_transform_controls(
                f'/targets/{name}', scale=_SCALE, depth_test=False, opacity=0.85)
            target.on_update(lambda event: self._act(event.phase == 'start'))
            self._targets.append(target)
            box = gui.add_checkbox(f'Close {item.arm} gripper' if several else 'Close gripper',
                                   False)
            # Without a browser, this program changed it.
            box.on_update(lambda event: self._act(event.client_id is not None))
            self._grippers.append(box)
        self._buttons = gui.add_button_group('Demonstration',
                                             [name.capitalize() for name in EVENTS])
        self._buttons.on_click(lambda event: self._events.add(
            lambda: self._begin(event.target.value.lower())))

    def _act(self, by_a_person: bool) -> None:
        if by_a_person:
            self._events.add(self._begin)

    def _begin(self, event: str = '') -> None:
        self._acted, self._event = True, event or self._event

    def read(self) -> Reading:
        """Return the actions towards the targets; before the first one, wait for the person."""
        if self._episode.periods == 0:
            self._wait()
        self._update()
        action = np.zeros(self._actions.size)
        for item, target, box in zip(self._actions.arms, self._targets, self._grippers):
            action[item.goals] = self._actions.towards(
                item, np.array(target.position), matrix_of(np.array(target.wxyz)))
            action[item.gripper] = 1.0 if box.value else -1.0
        event, self._event = self._event, ''
        return Reading(action, event=event)

    def _wait(self) -> None:
        """Show the start, with the targets at the end effectors, until a person acts."""
        self._events.run()
        self._acted, self._event = False, ''
        for box in self._grippers:
            box.value = False
        self._update()
        while not self._acted:
            # A drag that began in the last episode may still go on.
            for item, target in zip(self._actions.arms, self._targets):
                position, rotation = item.chain.tip.pose(self._episode.simulation.data)
                quat = np.empty(4)
                mujoco.mju_mat2Quat(quat, rotation.ravel())
                if not np.allclose([*target.position, *target.wxyz], [*position, *quat]):
                    target.position, target.wxyz = position, quat
            time.sleep(_PERIOD_S)
            self._update()

    def _update(self) -> None:
        """Show the present state, and do what the person asked for."""
        self._events.run()
        self._page.update()

    def close(self) -> None:
        """Close the page."""
        self._page.close()
