# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Sliders for the joints of a part; they follow the robot while nobody moves them."""

from __future__ import annotations

from collections.abc import Mapping
import math
import time
from typing import Any

from manip_sim.viewer.page.page_commands import Events, Following, PageCommands
from manip_sim.viewer.page.plain_text import plain
from manip_sim.viewer.page.robots import Robot, ShownJoint, ShownPart

#: Steps of a slider, the least of them [rad or m ...], and its decimal digits.
_STEPS, _RESOLUTION, _DIGITS = 500, 1e-4, 4
#: A joint that is slower is still [steps of the slider per second].
_STILL = 2.0
#: Time after which velocities and efforts other than zero are sent again [s]; the timeouts of the
#: node are longer.
_REPEAT_S = 0.1


def rounded_inward(low: float, high: float) -> tuple[float, float]:
    """Return a range of few digits inside another: what a slider sends is within the limits."""
    inner = (round(math.ceil(low / _RESOLUTION) * _RESOLUTION, _DIGITS),
             round(math.floor(high / _RESOLUTION) * _RESOLUTION, _DIGITS))
    return inner if inner[0] < inner[1] else (low, high)


class JointPanel:
    """
    A folder with a slider for each joint of a part.

    :param robot: the robot that has the part
    :param part: the part, with its joints
    :param field: that its commands use, such as ``position``
    :param folded: whether it begins folded up
    :param order: place among the folders
    """

    def __init__(self, gui: Any, robot: Robot, part: ShownPart, field: str, commands: PageCommands,
                 events: Events, folded: bool = False, order: float = 0.0) -> None:
        self.field = field
        self._robot, self._part = robot, part
        self._commands, self._events = commands, events
        self._sliders: dict[str, Any] = {}
        self._following: dict[str, Following] = {}
        self._asked: dict[str, float] = {}
        self._repeat_s = 0.0
        units = {joint.unit(field) for joint in part.joints}
        self._unit_shown = len(units) > 1
        title = robot.titled(part.name.replace('/', ' '))
        if field != 'position':
            title = f'{title} {field}'
        self.folder = gui.add_folder(f'{title} [{units.pop()}]' if len(units) == 1 else title,
                                     expand_by_default=not folded, order=order)
        with self.folder:
            if part.is_gripper:
                self._add_actions(gui)
            for joint in part.joints:
                self._add_slider(gui, joint)
            if field != 'position':
                gui.add_button('Stop').on_click(lambda _: events.add(self.stop))

    def _add_actions(self, gui: Any) -> None:
        group = gui.add_button_group('Fingers', ('Open', 'Close'),
                                     hint='an action of -1 or +1 on all fingers')
        group.on_click(lambda event: self._act(event.target.value))

    def _act(self, value: str) -> None:
        self._events.add(lambda: self._commands.act(
            self._robot.space, self._part.name, 1.0 if value == 'Close' else -1.0))

    def _add_slider(self, gui: Any, joint: ShownJoint) -> None:
        low, high = rounded_inward(*joint.ranges[self.field])
        unit = joint.unit(self.field)
        slider = gui.add_slider(
            f'{joint.label} [{unit}]' if self._unit_shown else joint.label, min=low, max=high,
            step=max(_RESOLUTION, round((high - low) / _STEPS, _DIGITS)),
            initial_value=min(max(0.0, low), high),
            marks=((low, f'{low:.3g}'), (high, f'{high:.3g}')),
            hint=f'{self.field} of {plain(joint.name)} [{unit}]')
        self._sliders[joint.name], self._following[joint.name] = slider, Following()

        def moved(event: Any) -> None:
            if event.client_id is not None:  # Otherwise this program changed it.
                self._following[joint.name].asked(time.monotonic())
                self._events.add(lambda: self._ask(joint.name))
        slider.on_update(moved)

    def _ask(self, name: str) -> None:
        self._asked[name] = float(self._sliders[name].value)

    def stop(self) -> None:
        """Command zero for all joints."""
        for name, slider in self._sliders.items():
            slider.value = 0.0
            self._asked[name] = 0.0

    def send(self, now_s: float) -> None:
        """Send what people have requested since the last call; wall time [s]."""
        asked, self._asked = self._asked, {}
        if self.field != 'position' and now_s > self._repeat_s + _REPEAT_S:
            asked = {**{name: float(slider.value) for name, slider in self._sliders.items()
                        if slider.value != 0.0}, **asked}
        if asked:
            self._repeat_s = now_s
            self._commands.move_joints(self._robot.space, self._part.name, self.field, asked)

    def show(self, now_s: float, positions: Mapping[str, float], velocities: Mapping[str, float],
             paused: bool) -> None:
        """
        Let the sliders follow the measured positions, if these are commanded.

        :param now_s: wall time [s]
        :param positions: by joint [rad or m]
        :param velocities: by joint [rad/s or m/s]
        :param paused: whether the simulation is paused, so that nothing can move
        """
        if self.field != 'position':
            return
        for name, slider in self._sliders.items():
            if name not in positions:
                continue
            moving = paused or abs(velocities.get(name, 0.0)) > _STILL * slider.step
            if not self._following[name].follows(now_s, moving):
                continue
            steps = round((positions[name] - slider.min) / slider.step)
            value = round(slider.min + steps * slider.step, _DIGITS)
            value = min(max(value, slider.min), slider.max)
            if abs(value - slider.value) > 0.5 * slider.step:
                slider.value = value

    def remove(self) -> None:
        """Remove the folder."""
        self.folder.remove()


class DrivePanel:
    """
    Sliders for the velocity of a mobile base in its own frame.

    :param robot: the robot that has the base
    """

    def __init__(self, gui: Any, robot: Robot, commands: PageCommands, events: Events) -> None:
        assert robot.twist is not None
        self._robot, self._commands = robot, commands
        self._stopped = True
        self._sent_s = 0.0
        self.folder = gui.add_folder(robot.titled('base'), order=-1.0)
        with self.folder:
            self._sliders = [gui.add_slider(
                f'{label} [{unit}]', min=-limit, max=limit, step=limit / 50.0, initial_value=0.0,
                marks=((-limit, f'{-limit:.3g}'), (limit, f'{limit:.3g}')),
                hint=f'velocity of the base {what} [{unit}]')
                for label, what, unit, limit in zip(
                    ('forward', 'left', 'turn'),
                    ('along its x', 'along its y', 'about its z, to the left'),
                    ('m/s', 'm/s', 'rad/s'), robot.twist)]
            gui.add_button('Stop').on_click(lambda _: events.add(self.stop))

    def stop(self) -> None:
        """Command zero."""
        for slider in self._sliders:
            slider.value = 0.0

    def send(self, now_s: float) -> None:
        """Send the velocity again while it is not zero, and zero once; wall time [s]."""
        x, y, yaw = (float(slider.value) for slider in self._sliders)
        still = x == y == yaw == 0.0
        if still and self._stopped or not still and now_s < self._sent_s + _REPEAT_S:
            return
        self._stopped, self._sent_s = still, now_s
        self._commands.drive(self._robot.space, (x, y, yaw))

    def remove(self) -> None:
        """Remove the folder."""
        self.folder.remove()
