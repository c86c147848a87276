# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The top of the page: the state of the simulation, and buttons to pause, step and reset it."""

from __future__ import annotations

from typing import Any

from manip_sim.viewer.page.commands import Commands, Events
from manip_sim.viewer.page.plain_text import Line, PlainText

_COLORS = {'running': '#2f9e44', 'paused': '#f08c00', 'waiting': '#868e96', 'gone': '#e03131',
           'trouble': '#e8590c'}


class SimulationPanel:
    """
    A line of state and the buttons of the whole simulation.

    :param gui: ``viser.ViserServer.gui``
    :param commands: receives what people command; None: there are no buttons
    :param events: queue to the thread that updates the page
    """

    def __init__(self, gui: Any, commands: Commands | None, events: Events) -> None:
        self._paused = False
        self._buttons: Any = None
        self._state = PlainText(gui)
        if commands is not None:
            self._add_buttons(gui, commands, events)

    def _add_buttons(self, gui: Any, commands: Commands, events: Events) -> None:
        self._buttons = gui.add_button_group(
            'Simulation', ('Pause', 'Step'),
            hint='Step: one control period of a paused simulation')
        self._again = gui.add_button_group(
            'Start again', ('Reset', 'Tare'),
            hint='Reset: back to the start. Tare: let the external wrenches read zero now')

        def pressed(event: Any) -> None:
            what = event.target.value
            if what == 'Step':
                events.add(commands.step)
            elif what in ('Pause', 'Resume'):
                events.add(lambda: commands.pause(what == 'Pause'))
        self._buttons.on_click(pressed)
        again = {'Reset': commands.reset, 'Tare': commands.tare}
        self._again.on_click(lambda event: events.add(
            again.get(event.target.value, lambda: None)))

    def show(self, state: str, text: str, paused: bool | None = None) -> None:
        """
        Show the state of the simulation.

        :param state: ``running``, ``paused``, ``trouble``, ``waiting`` or ``gone``
        :param text: the details
        :param paused: whether it is paused, so that the button resumes it; None if not known
        """
        self._state.show([Line(text, color=_COLORS[state])])
        if paused is not None and paused != self._paused:
            self._paused = paused
            if self._buttons is not None:
                self._buttons.options = ('Resume' if paused else 'Pause', 'Step')
