# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Sort the joints of third-party models into arm, base, torso, head and legs, by names."""

from __future__ import annotations

from collections.abc import Collection, Mapping
import re

from manip_sim.models.files.body_tree import BodyTree, words_of
from manip_sim.models.robots.subsystems import classify

#: Words for a subsystem besides those of ``classify``, in the order in which they are tried.
_WORDS = {
    'base': {'wheel', 'wheels', 'caster', 'castor'},
    'head': {'neck', 'eye', 'eyes', 'camera', 'cam'},
    'legs': {'leg', 'legs', 'hip', 'knee', 'ankle', 'ank', 'foot', 'toe', 'thigh', 'calf', 'shin',
             'shank', 'tarsus', 'plantar', 'achilles', 'abduction', 'hx', 'hy', 'kn', 'haa', 'hfe',
             'kfe', 'ffe', 'faa', 'hr'},
    'torso': {'waist', 'spine', 'abdomen', 'lift', 'trunk', 'chest', 'column'}}
#: Words of an arm, also beside those above, as in ``shoulder_lift``.
_OF_ARM = {'shoulder', 'elbow', 'wrist'}
#: Joints of a root that moves in the plane are named after an axis: x, y, theta.
_AXIS = re.compile(r'(?:^|_)(x|y|th|theta)$')


def classify_joints(tree: BodyTree, declared: Mapping[str, str], fingers: Collection[int]
                    ) -> dict[int, str]:
    """
    Return the subsystems of joints by id, without free joints.

    A joint that is torso by a word of :data:`_WORDS` is arm if it moves at most one limb, as the
    waist of an arm on a table does.

    :param declared: subsystems by name of the joint, which take precedence
    :param fingers: ids of the joints of hands
    """
    model = tree.model
    found: dict[int, str] = {}
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) == 0:
            continue
        name = str(model.joint(joint).name)
        found[joint] = declared.get(name) or _by_name(name)
    _correct_base(tree, found, declared)
    _correct_torso(tree, found, declared, fingers)
    return found


def _by_name(name: str) -> str:
    subsystem = classify(name)
    if subsystem != 'arm':
        return subsystem
    words = words_of(name)
    if words & _OF_ARM:
        return 'arm'
    return next((part for part, known in _WORDS.items() if words & known), 'arm')


def _correct_base(tree: BodyTree, found: dict[int, str], declared: Mapping[str, str]) -> None:
    """Assign the joints of a root to the base if all are named after the axes of a plane."""
    model = tree.model
    for root in (body for body in range(1, model.nbody) if tree.parent(body) == 0):
        axes = [(joint, _AXIS.search(str(model.joint(joint).name)))
                for joint in tree.joints([root]) if tree.is_scalar(joint)]
        if len(axes) >= 2 and all(match for _, match in axes):
            found.update({joint: 'base' for joint, _ in axes
                          if str(model.joint(joint).name) not in declared})


def _correct_torso(tree: BodyTree, found: dict[int, str], declared: Mapping[str, str],
                   fingers: Collection[int]) -> None:
    for joint, subsystem in list(found.items()):
        name = str(tree.model.joint(joint).name)
        if subsystem != 'torso' or name in declared or classify(name) == 'torso':
            continue
        below = set(tree.joints(tree.below(int(tree.model.jnt_bodyid[joint]))))
        limbs = {j for j in below - set(fingers) if found.get(j) in ('arm', 'head', 'legs')}
        if len(tree.ends(limbs)) < 2:
            found[joint] = 'arm'
