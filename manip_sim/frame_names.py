# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Names of the frames of a model: one rule for TF, URDF, and the headers of messages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco

#: The root of all frames.
ROOT = 'world'
#: End of the names of optical frames.
OPTICAL = '_optical_frame'
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class FrameNames:
    """
    Names of the frames of bodies, cameras and sites, all different.

    Bodies keep their names; then come cameras, their optical frames, sites, frames that are
    placed in the world, and bodies on free joints in the world, which may come and go. Where a
    name is taken, ``_camera``, ``_``, ``_site``, ``_frame`` or ``_body`` is appended.

    :param model: the compiled ``mujoco.MjModel``
    :param placed: names of frames in the world, as :meth:`placed` returned them
    :ivar bodies: by id, like all others
    :ivar cameras: where they look along -z, as in MuJoCo
    :ivar opticals: of the cameras, which look along z there (REP 103)
    :ivar sites: of all sites
    """

    def __init__(self, model: mujoco.MjModel, placed: Iterable[str] = ()) -> None:
        taken = {ROOT, *placed}
        bodies = {body: model.body(body).name or f'body_{body}' for body in range(1, model.nbody)}
        free = {int(model.jnt_bodyid[joint]) for joint in range(model.njnt)
                if int(model.jnt_type[joint]) == _FREE}
        fixed = [body for body in bodies if body not in free]
        names = dict(zip(fixed, _free([bodies[body] for body in fixed], '_body', taken)))
        self.cameras = _free([model.camera(camera).name or f'camera_{camera}'
                              for camera in range(model.ncam)], '_camera', taken)
        self.opticals = _free([name + OPTICAL for name in self.cameras], '_', taken)
        self.sites = _free([model.site(site).name or f'site_{site}'
                            for site in range(model.nsite)], '_site', taken)
        self._lasting = frozenset(taken)
        names.update(zip(sorted(free), _free([bodies[body] for body in sorted(free)], '_body',
                                             taken)))
        self.bodies = [ROOT, *(names[body] for body in bodies)]

    def placed(self, name: str) -> str:
        """Return the name of a further frame in the world, such as that of an odometry."""
        while name in self._lasting:
            name += '_frame'
        return name


def _free(names: Sequence[str], suffix: str, taken: set[str]) -> list[str]:
    """Return names that are not taken, and take them; those that are free go before others."""
    kept = set(names) - taken
    taken |= kept
    unique = []
    for name in names:
        if name not in kept:
            while name in taken:
                name += suffix
            taken.add(name)
        unique.append(name)
    return unique
