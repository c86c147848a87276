# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A gripper of the catalogue, declared by folder and start, with one command per actuator."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.models.grippers.gripper_model import GripperModel
from manip_sim.resources import asset_path


class CatalogueGripper(GripperModel, registered=False):
    """
    A gripper from ``assets/grippers``.

    :param idn: number or word in the prefix ``gripper{idn}_``
    """

    #: The folder of its file, in ``assets/grippers``.
    _folder: ClassVar[str]
    #: Start positions of its joints [rad or m]; None if it has none.
    _start: ClassVar[tuple[float, ...] | None]

    def __init__(self, idn: int | str = 0) -> None:
        super().__init__(asset_path('grippers', self._folder), idn=idn)

    def format_action(self, action: ArrayLike) -> FloatArray:
        """
        Return the action itself.

        :param action: a command for each actuator, in [-1, 1], shape (n,)
        :returns: a copy, shape (n,)
        :raises CommandError: if the length is wrong or a number is not finite
        """
        return self._checked(action).copy()

    @property
    def init_qpos(self) -> FloatArray | None:
        """Start of the joints in the order of the file [rad or m], shape (n,), a copy, or None."""
        return None if self._start is None else np.array(self._start)
