# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The model of a running world and its data, which all that simulates asks for here."""

from __future__ import annotations

from collections.abc import Callable

import mujoco

from manip_sim.simulation.spawning import carry_over, LiveWorld, start_live, WorldPlan


class Physics:
    """
    What MuJoCo simulates; nothing else keeps a model, because another one may replace it.

    Robots come first in every model, so their names, ids and addresses stay as they are. What
    depends on the number of other elements, such as arrays of shape (nv,), and views of arrays are
    made anew by what was registered with :meth:`on_change`.

    :param plan: the world at its start
    :ivar plan: what :attr:`model` was compiled from
    :ivar model: the ``mujoco.MjModel``
    :ivar data: its ``mujoco.MjData``
    :ivar qpos: view of its field, as the others are, so that it need not be fetched each time
    :ivar qvel: of ``qvel``
    :ivar act: of ``act``
    :ivar ctrl: of ``ctrl``
    :ivar bias: of ``qfrc_bias``
    :ivar gravcomp: of ``qfrc_gravcomp``
    """

    def __init__(self, plan: WorldPlan) -> None:
        self._adapt: list[Callable[[], None]] = []
        self._take(start_live(plan))

    def _take(self, live: LiveWorld) -> None:
        self.plan: WorldPlan = live.plan
        self.model: mujoco.MjModel = live.model
        data = self.data = live.data
        self.qpos, self.qvel, self.act, self.ctrl = data.qpos, data.qvel, data.act, data.ctrl
        self.bias, self.gravcomp = data.qfrc_bias, data.qfrc_gravcomp
        for adapt in self._adapt:
            adapt()

    def on_change(self, adapt: Callable[[], None]) -> None:
        """Call a function now, and each time the model and its data were replaced."""
        self._adapt.append(adapt)
        adapt()

    def change(self, plan: WorldPlan) -> None:
        """Replace the model by that of another plan, and carry the state and edits over."""
        self._take(carry_over(LiveWorld(self.plan, self.model, self.data), plan))
