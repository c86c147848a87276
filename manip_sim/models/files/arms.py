# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Find where the arms of a robot end: by names, or as the last body of a chain."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from manip_sim.errors import ModelError
from manip_sim.models.files.hands import FoundHand, hand_below
from manip_sim.models.files.tree import BodyTree, side_of, words_of
from manip_sim.quoting import quoted_names

_END_WORDS = {'tool', 'flange', 'tcp', 'ee', 'eef', 'hand', 'gripper', 'attachment', 'pinch'}
#: A chain of at most this fraction of the joints of the longest one is not an arm.
_ARM_SHARE = 0.5


@dataclass(frozen=True)
class FoundArm:
    """
    Where an arm ends.

    :ivar kind: ``body`` or ``site``
    :ivar name: of that body or site
    :ivar hand: the hand that the arm carries in the same file, or None
    :ivar why: how it was found, for messages
    """

    kind: str
    name: str
    hand: FoundHand | None
    why: str


def find_arms(tree: BodyTree, subsystems: Mapping[int, str], hands: Collection[FoundHand]
              ) -> dict[str, FoundArm]:
    """
    Return the arms by ``right`` and ``left``; a single one is ``right``.

    :param subsystems: by id of the joint
    :raises ModelError: if there are several chains whose sides are not clear
    """
    of_hands = {joint for hand in hands for joint in hand.joints}
    joints = {j for j, part in subsystems.items()
              if part == 'arm' and j not in of_hands and tree.is_scalar(j)}
    tips = _longest_chains(tree, tree.ends(joints), joints)
    hand = _hand_of_chains(tree, tips, joints)
    if hand is not None:
        return {'right': FoundArm('body', tree.name(hand.body), hand, 'fingers hang on it')}
    by_side = _by_side(tree, tips, joints)
    arms = {side: _end_of(tree, tip, hands, len(by_side)) for side, tip in by_side.items()}
    return {side: arms[side] for side in ('right', 'left') if side in arms}


def _longest_chains(tree: BodyTree, tips: Iterable[int], joints: Collection[int]) -> list[int]:
    length = {tip: _length(tree, tip, joints) for tip in tips}
    longest = max(length.values(), default=0)
    return [tip for tip, count in length.items() if count > _ARM_SHARE * longest]


def _hand_of_chains(tree: BodyTree, tips: list[int], joints: Collection[int]
                    ) -> FoundHand | None:
    """Return the hand whose fingers the chains are, if they branch off a longer chain."""
    if len(tips) < 2:
        return None
    carrier = tree.common(tips)
    shared, whole = (_length(tree, body, joints) for body in (carrier, tips[0]))
    return hand_below(tree, carrier) if shared > _ARM_SHARE * whole else None


def _by_side(tree: BodyTree, tips: list[int], joints: Collection[int]) -> dict[str, int]:
    """Return the tip of the longest chain by side, preferring end names; a single one is right."""
    if len(tips) <= 1:
        return dict.fromkeys(['right'], tips[0]) if tips else {}
    found: dict[str | None, list[int]] = {}

    def rank(tip: int) -> tuple[int, bool]:
        return _length(tree, tip, joints), any(
            words_of(tree.name(body)) & _END_WORDS for body in tree.below(tip))

    for tip in sorted(tips, key=rank, reverse=True):
        found.setdefault(side_of(map(tree.name, tree.path(tip))), []).append(tip)
    ambiguous = any(len(of_side) > 1 and rank(of_side[0]) == rank(of_side[1])
                    for of_side in found.values())
    if set(found) != {'right', 'left'} or ambiguous:
        names = quoted_names([tree.name(tip) for tip in tips])
        raise ModelError(f'{len(tips)} chains of joints could be arms, they end at {names}: '
                         "declare 'arms' with the 'mount' of 'right' and 'left' in a YAML file")
    return {side: of_side[0] for side, of_side in found.items() if side is not None}


def _length(tree: BodyTree, body: int, joints: Collection[int]) -> int:
    """Return how many of the given joints move a body."""
    return len(set(tree.joints(tree.path(body))) & set(joints))


def _end_of(tree: BodyTree, tip: int, hands: Collection[FoundHand], count: int) -> FoundArm:
    below = tree.below(tip)
    hand = next((hand for hand in hands if hand.body in below), None)
    if hand is not None:
        return FoundArm('body', tree.name(hand.body), hand, 'it carries a hand')
    model = tree.model
    sites = [str(model.site(i).name) for i in range(model.nsite) if model.site_bodyid[i] in below]
    bodies = [tree.name(body) for body in sorted(below, reverse=True)]
    for kind, names, words in (
            ('body', bodies, {'hand'}), ('site', sites, {'attachment'}),
            ('body', bodies, _END_WORDS), ('site', sites, _END_WORDS)):
        named = [name for name in names if words_of(name) & words]
        exact = [name for name in named if kind == 'body' and name in ('right_hand', 'left_hand')]
        if words == {'hand'}:
            named = exact
        if named:
            return FoundArm(kind, named[0], None, 'by its name')
    leaves = [body for body in below if len(tree.below(body)) == 1]
    if len(leaves) == 1:
        return FoundArm('body', tree.name(leaves[0]), None, 'the last body')
    return FoundArm('body', tree.name(tip), None, 'the last body that moves')
