# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Stop a part that is too fast, exerts too much or is pushed too hard, as arms of today do.

What stops it, and which commands it refuses afterwards, is not decided here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from manip_sim.arrays import FloatArray
from manip_sim.errors import UnknownNameError


@dataclass(frozen=True)
class ReflexLimits:
    """
    What a part may do before it is stopped; 0 is no limit.

    :ivar velocity: of any joint, as a multiple of its velocity limit
    :ivar effort: of any joint, as a multiple of its effort limit
    :ivar force: magnitude of the external force on the tool [N]
    :ivar torque: magnitude of the external torque on the tool [N m]
    """

    velocity: float = 0.0
    effort: float = 0.0
    force: float = 0.0
    torque: float = 0.0

    @property
    def any(self) -> bool:
        """Whether there is any limit."""
        return any(getattr(self, field.name) for field in fields(self))


class Reflexes:
    """
    The limits of each part, and which parts were stopped.

    :param parts: names of parts that do not overlap
    :ivar tripped: why each part was stopped that refuses commands
    :ivar counts: how often each part was stopped
    """

    def __init__(self, parts: Iterable[str]) -> None:
        self._limits = dict.fromkeys(parts, ReflexLimits())
        self.tripped: dict[str, str] = {}
        self.counts = dict.fromkeys(self._limits, 0)
        self.armed: tuple[str, ...] = ()

    def set(self, part: str, quantity: str, limit: float) -> None:
        """
        Change a limit of a part.

        :param quantity: a field of :class:`ReflexLimits`
        :raises UnknownNameError: if there is no such quantity
        """
        known = [field.name for field in fields(ReflexLimits)]
        if quantity not in known:
            raise UnknownNameError('quantity of a reflex', quantity, known)
        self._limits[part] = replace(self._limits[part], **{quantity: limit})
        self.armed = tuple(name for name, limits in self._limits.items() if limits.any)

    def trip(self, part: str, reason: str) -> None:
        """Remember that a part was stopped."""
        self.tripped = {**self.tripped, part: reason}
        self.counts[part] += 1

    def reset(self) -> None:
        """Let all parts take commands again."""
        self.tripped = {}

    def excess(self, part: str, shares: Mapping[str, FloatArray], names: list[str],
               wrench: FloatArray | None) -> str | None:
        """
        Return what a part does too much, in words, or None.

        :param shares: ``velocity`` and ``effort`` of the joints over their limits, shape (n,)
        :param names: of the joints
        :param wrench: external force [N] and torque [N m] on its tool, shape (6,), or None
        """
        limits = self._limits[part]
        for quantity, share in shares.items():
            limit = getattr(limits, quantity)
            if limit and share.max(initial=0.0) > limit:
                worst = int(share.argmax())
                return (f"the {quantity} of joint '{names[worst]}' is {share[worst]:.3g} times "
                        f'its limit, allowed is {limit:g}')
        if wrench is None:
            return None
        for quantity, vector, unit in (('force', wrench[:3], 'N'), ('torque', wrench[3:], 'N m')):
            limit, size = getattr(limits, quantity), float(np.sqrt((vector**2).sum()))
            if limit and size > limit:
                return (f'the external {quantity} is {size:.3g} {unit}, allowed is {limit:g} '
                        f'{unit}')
        return None
