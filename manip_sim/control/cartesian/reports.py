# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Causes that keep an end effector from its target: counted, and described in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
import math
from typing import ClassVar, NamedTuple

from manip_sim.algebra import length
from manip_sim.arrays import FloatArray
from manip_sim.control.law.records import ASIDE, NEARER

#: A target is unreachable if the end effector misses it, and comes no nearer for this time [s].
_STALLED_S = 0.3


class Contact(NamedTuple):
    """
    The end of a motion until contact.

    :ivar cause: ``contact``, ``distance`` or ``time``
    :ivar time_s: simulation time of it since the last reset [s]
    :ivar position: of ``grip_site`` in the world then [m], shape (3,)
    :ivar wrench: external force and torque on the tool, in ``ft_frame`` [N, N m], shape (6,)
    :ivar distance: from where the motion began [m]
    :ivar duration_s: since it began, simulation time [s]
    """

    cause: str
    time_s: float
    position: FloatArray
    wrench: FloatArray
    distance: float
    duration_s: float


@dataclass
class CartesianReport:
    """
    Counts of what keeps an end effector from its target, each counted when it begins.

    :ivar arm: whose end effector
    :ivar contact: the end of the last motion until contact, or None before the first
    :ivar unreachable: targets that were not reached
    :ivar joint_limit: how often the range of a joint shortened a motion
    :ivar singular: how often the end effector could hardly move in the wanted direction
    :ivar slowed: how often limits of joints slowed down a twist or a stream of poses
    :ivar aside: how often the end effector left the straight line to a pose by more than 1 cm
    :ivar texts: what happened last, in words, by counter
    :ivar seen_s: simulation time when the end effector was checked last [s]
    """

    #: Only reported, never used.
    remembered: ClassVar[tuple[str, ...]] = ('contact', 'unreachable', 'joint_limit', 'singular',
                                             'slowed', 'aside', 'texts', '_active', 'seen_s',
                                             '_stalled_s')
    undigested: ClassVar[tuple[str, ...]] = remembered

    arm: str
    contact: Contact | None = None
    unreachable: int = 0
    joint_limit: int = 0
    singular: int = 0
    slowed: int = 0
    aside: int = 0
    texts: dict[str, str] = field(default_factory=dict)
    seen_s: float = -math.inf
    _active: set[str] = field(default_factory=set)
    #: Simulation time since when the end effector has come no nearer to its target [s].
    _stalled_s: float = 0.0

    @property
    def counts(self) -> dict[str, int]:
        """The five counts by name."""
        return {kind: getattr(self, kind)
                for kind in ('unreachable', 'joint_limit', 'singular', 'slowed', 'aside')}

    @property
    def active(self) -> frozenset[str]:
        """The counters of what keeps the end effector from its target now."""
        return frozenset(self._active)

    def keep_seen(self, now_s: float) -> None:
        """
        Record that the end effector has come nearer to its target until now.

        :param now_s: simulation time [s]
        """
        if now_s > self.seen_s:
            self.seen_s = self._stalled_s = now_s

    def reset(self) -> None:
        """Begin to look anew; counts stay."""
        self._active.clear()
        self.seen_s, self._stalled_s = -math.inf, 0.0

    def see_motion(self, what: str, held: Sequence[str], singular: bool, slowed: bool) -> None:
        """
        Record what limits a motion.

        :param what: the motion, in words
        :param held: names of the joints that are at the end of their range
        :param singular: whether the end effector can hardly move in the wanted direction
        :param slowed: whether limits of joints slow a twist or a stream of poses down
        """
        if not (held or singular or slowed or self._active):
            return
        self._note('joint_limit', bool(held),
                   lambda: f'{what} is limited by the range of {", ".join(held)}')
        self._note('singular', singular,
                   lambda: f'{what} leads to a singularity, where the end effector can hardly '
                           'move')
        self._note('slowed', slowed,
                   lambda: f'{what} is slowed down to keep to the limits of the joints')

    def see_target(self, error: FloatArray, close: bool, progress: float, now_s: float) -> None:
        """
        Record whether the end effector comes nearer to its target; a stream counts as one.

        :param error: translation [m] and rotation vector [rad] to the target, shape (6,)
        :param close: whether that misses the target by no more than reports allow
        :param progress: share of the wanted motion that is made
        :param now_s: simulation time [s]
        """
        first = now_s - self.seen_s > _STALLED_S
        if first or progress > NEARER or close:
            self._stalled_s = now_s
        self.seen_s = now_s
        stalled = now_s - self._stalled_s >= _STALLED_S
        if not (stalled or self._active):
            return
        self._note('unreachable', stalled,
                   lambda: f'the target is not reached, {length(error[:3]):.3f} m and '
                   f'{length(error[3:]):.3f} rad are left{self._causes()}')

    def _causes(self) -> str:
        return ''.join(f', {text}' for kind, text in (
            ('joint_limit', 'a joint is at the end of its range'),
            ('singular', 'the arm is at a singularity')) if kind in self._active)

    def see_way(self, distance: float) -> None:
        """
        Record how far the end effector is from the straight line to its target.

        :param distance: [m]
        """
        if distance <= ASIDE and not self._active:
            return
        self._note('aside', distance > ASIDE,
                   lambda: f'the end effector is more than {ASIDE:g} m off the straight line '
                           'to its target')

    def _note(self, kind: str, active: bool, text: Callable[[], str]) -> None:
        if not active:
            self._active.discard(kind)
        elif kind not in self._active:
            self._active.add(kind)
            setattr(self, kind, getattr(self, kind) + 1)
            self.texts[kind] = f'{self.arm}: {text()}'
