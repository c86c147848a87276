# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Remedies for defects of a start, in the format of the file that a part is from."""

from __future__ import annotations


class MjcfRemedies:
    """Remedies in an MJCF file."""

    #: Where the pose at the start is written.
    pose = 'init_qpos, or the keyframe'

    def shape(self, geom: str, body: str) -> str:
        """Return what a geom is called."""
        return f"geom '{geom}' of body '{body}'"

    def exclusion(self, one: str, other: str) -> str:
        """Return how two bodies are kept from colliding."""
        return f'write <exclude body1="{one}" body2="{other}"/> into <contact>'

    def drive(self, joints: list[str]) -> str:
        """Return how joints get what they lack, an actuator."""
        return (f'write <motor joint="{joints[0]}" ctrlrange="-LIMIT LIMIT"/> into <actuator>, '
                'with the torque limit [N m or N]'
                + ('' if len(joints) == 1 else ', and so for each of them')
                + '; a body that must not move needs no <joint>')

    def limit(self, effort: float) -> str:
        """
        Return how a joint gets a higher effort limit.

        :param effort: that is enough [N m or N]
        """
        return (f'write a higher limit, such as actuatorfrcrange="{-effort:g} {effort:g}" on the '
                'joint, and so forcerange or ctrlrange of the actuator where they are lower')

    def wider_range(self) -> str:
        """Return how a joint gets a wider range."""
        return 'give the joint a wider range'


class UrdfRemedies(MjcfRemedies):
    """Remedies in a URDF file, or in the SRDF and the YAML file beside it."""

    pose = "init_qpos, or 'start' in the YAML file"

    def shape(self, geom: str, body: str) -> str:
        """Return what a geom is called: shapes of a URDF have no names."""
        return f"a collision shape of link '{body}'"

    def exclusion(self, one: str, other: str) -> str:
        """Return how two links are kept from colliding."""
        return (f'write <disable_collisions link1="{one}" link2="{other}" reason="Never"/> into '
                'the SRDF of the same name beside the URDF')

    def drive(self, joints: list[str]) -> str:
        """Return what joints without an actuator are to be: a URDF has none."""
        return ('write type="fixed" if the joint must not move, or <mimic joint="..."/> if '
                'another one drives it')

    def limit(self, effort: float) -> str:
        """Return how a joint gets a higher effort limit."""
        return (f'write a higher limit, such as <limit effort="{effort:g}" .../>, for the joint; '
                'efforts: guess in the YAML file replaces limits that are placeholders')

    def wider_range(self) -> str:
        """Return how a joint gets a wider range."""
        return 'give the joint a wider range, by lower and upper of its <limit>'


def remedies_for(name: str, urdf: tuple[str, ...]) -> MjcfRemedies:
    """
    Return the remedies for an element.

    :param urdf: what the names of elements from URDF files begin with
    """
    return UrdfRemedies() if urdf and name.startswith(urdf) else MjcfRemedies()
