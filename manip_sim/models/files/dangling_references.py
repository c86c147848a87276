# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Leave out of a file what refers to elements of others, such as the scene that includes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import mujoco

from manip_sim.quoting import counted, quoted, quoted_names

_OBJ, _EQ = mujoco.mjtObj, mujoco.mjtEq
#: Elements that an equality constraint ties, by its tag, unless ``objtype`` names others.
_TIED = {int(_EQ.mjEQ_JOINT): _OBJ.mjOBJ_JOINT, int(_EQ.mjEQ_TENDON): _OBJ.mjOBJ_TENDON}
_OF_OBJTYPE = (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD))
#: Number of positions of a joint by its type, one for others.
_POSITIONS = {int(mujoco.mjtJoint.mjJNT_FREE): 7, int(mujoco.mjtJoint.mjJNT_BALL): 4}
#: Remedy for a missing name.
_INCLUDED = 'if another file includes this one, load that'


def leave_out_dangling(spec: mujoco.MjSpec) -> list[str]:
    """
    Leave out what refers to elements that a file lacks, and keyframes of another size.

    That are sensors, equality constraints, excluded collisions, lights that follow a body, and
    materials. Cameras that follow one keep their pose. Actuators and tendons are not left out, as
    a robot does not move without them.

    :returns: a sentence for each kind
    """
    lacks = _Lacking(spec)
    cameras = [camera for camera in spec.cameras if lacks.body(camera.targetbody)]
    notes: list[str] = []
    for what, elements, missing in (
            ('exclude', spec.excludes, lambda e: lacks.bodies(e.bodyname1, e.bodyname2)),
            ('equality constraint', spec.equalities, lacks.of_equality),
            ('sensor', spec.sensors, lacks.of_sensor),
            ('camera target', cameras, lambda e: lacks.bodies(e.targetbody)),
            ('light', spec.lights, lambda e: lacks.bodies(e.targetbody)),
            ('material', [*spec.geoms, *spec.sites],
             lambda e: lacks.materials(e.material))):
        notes += _left_out(spec, what, list(elements), missing)
    return notes + _left_out_keyframes(spec)


class _Lacking:
    """The names that elements of a spec refer to and that it lacks."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        bodies = {body.name for body in spec.bodies}
        self._names = {int(kind): names for kind, names in (
            (_OBJ.mjOBJ_BODY, bodies), (_OBJ.mjOBJ_XBODY, bodies),
            (_OBJ.mjOBJ_MATERIAL, {material.name for material in spec.materials}),
            (_OBJ.mjOBJ_JOINT, {joint.name for joint in spec.joints}),
            (_OBJ.mjOBJ_GEOM, {geom.name for geom in spec.geoms}),
            (_OBJ.mjOBJ_SITE, {site.name for site in spec.sites}),
            (_OBJ.mjOBJ_CAMERA, {camera.name for camera in spec.cameras}),
            (_OBJ.mjOBJ_TENDON, {tendon.name for tendon in spec.tendons}),
            (_OBJ.mjOBJ_ACTUATOR, {actuator.name for actuator in spec.actuators}))}

    def _among(self, kind: Any, *names: str) -> list[str]:
        known = self._names.get(int(kind))
        return [name for name in names if known is not None and name and name not in known]

    def body(self, name: str) -> bool:
        """Return whether there is no body of a name."""
        return bool(self.bodies(name))

    def bodies(self, *names: str) -> list[str]:
        """Return the names of bodies that there are not."""
        return self._among(_OBJ.mjOBJ_BODY, *names)

    def materials(self, *names: str) -> list[str]:
        """Return the names of materials that there are not."""
        return self._among(_OBJ.mjOBJ_MATERIAL, *names)

    def of_equality(self, equality: Any) -> list[str]:
        """Return the names that an equality constraint refers to and that are missing."""
        kind = int(equality.type)
        tied = equality.objtype if kind in _OF_OBJTYPE else _TIED.get(kind, _OBJ.mjOBJ_UNKNOWN)
        return self._among(tied, equality.name1, equality.name2)

    def of_sensor(self, sensor: Any) -> list[str]:
        """Return the names that a sensor refers to and that are missing."""
        return (self._among(sensor.objtype, sensor.objname)
                + self._among(sensor.reftype, sensor.refname))


def _left_out(spec: mujoco.MjSpec, what: str, elements: list[Any],
              missing: Callable[[Any], list[str]]) -> Iterator[str]:
    """Leave out what refers to missing elements, and yield a sentence if there is any."""
    found = [(element, names) for element in elements if (names := missing(element))]
    if not found:
        return
    named = {name for _, of_element in found for name in of_element}
    yield (f'left out: {counted(len(found), what)} with a reference to what is not in the file: '
           f'{quoted_names(sorted(named))}; {_INCLUDED}, else correct the name')
    for element, _ in found:
        if what == 'material':
            element.material = ''
        elif what == 'camera target':
            element.targetbody, element.mode = '', mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        else:
            spec.delete(element)


def _left_out_keyframes(spec: mujoco.MjSpec) -> list[str]:
    """Leave out keyframes with the positions, and controls, of other joints or actuators."""
    positions = sum(_POSITIONS.get(int(joint.type), 1) for joint in spec.joints)
    notes = []
    for key in list(spec.keys):
        if len(key.qpos) not in (0, positions):
            notes.append(f'left out: keyframe {quoted(key.name)}, which has {len(key.qpos)} '
                         f'positions where the file has {positions}; {_INCLUDED}, or write '
                         "'start' in a YAML file")
            spec.delete(key)
        elif len(key.ctrl) not in (0, len(spec.actuators)):
            notes.append(f'left out: {len(key.ctrl)} controls of keyframe {quoted(key.name)}, as '
                         f'the file has {counted(len(spec.actuators), "actuator")}')
            key.ctrl = []
    return notes
