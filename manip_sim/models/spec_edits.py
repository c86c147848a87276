# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Edits of a ``mujoco.MjSpec`` that it has no call for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

_OF_THE_ELEMENT = frozenset(('classname', 'compiler', 'id', 'info', 'plugin', 'signature'))


def rename_body(spec: Any, body: Any, name: str) -> None:
    """
    Rename a body, also where other elements refer to it.

    :param spec: the ``mujoco.MjSpec`` that has the body
    :param body: the body
    :param name: its new name
    """
    for element, attribute in _references_to_bodies(spec):
        if getattr(element, attribute) == body.name:
            setattr(element, attribute, name)
    body.name = name


def _references_to_bodies(spec: Any) -> Iterator[tuple[Any, str]]:
    bodies = (int(mujoco.mjtObj.mjOBJ_BODY), int(mujoco.mjtObj.mjOBJ_XBODY))
    for exclude in spec.excludes:
        yield exclude, 'bodyname1'
        yield exclude, 'bodyname2'
    for watcher in [*spec.cameras, *spec.lights]:
        yield watcher, 'targetbody'
    for equality in spec.equalities:
        if int(equality.objtype) in bodies:
            yield equality, 'name1'
            yield equality, 'name2'
    for actuator in spec.actuators:
        if int(actuator.trntype) == int(mujoco.mjtTrn.mjTRN_BODY):
            yield actuator, 'target'
    for sensor in spec.sensors:
        if int(sensor.objtype) in bodies:
            yield sensor, 'objname'
        if int(sensor.reftype) in bodies:
            yield sensor, 'refname'


def delete_elements(spec: Any, elements: list[Any]) -> None:
    """
    Delete elements that are no bodies, and the sensors that look at them.

    :param spec: the ``mujoco.MjSpec`` that has them
    """
    names = {element.name for element in elements if element.name}
    for sensor in [s for s in spec.sensors if s.objname in names or s.refname in names]:
        spec.delete(sensor)
    for element in elements:
        spec.delete(element)


def rotate_actuators(actuators: list[Any], count: int) -> None:
    """
    Let the first of some consecutive actuators of a spec come last.

    Elements of a spec cannot move, so their contents do.

    :param actuators: the actuators
    :param count: how many of them go to the end
    """
    contents = [_content(actuator) for actuator in actuators]
    for actuator in actuators:
        actuator.name = ''  # A name may be there only once at any time.
    for actuator, content in zip(actuators, contents[count:] + contents[:count]):
        for field, value in content.items():
            setattr(actuator, field, value)


def _content(actuator: Any) -> dict[str, Any]:
    fields = (field for field in dir(actuator) if field not in _OF_THE_ELEMENT
              and not field.startswith(('_', 'set_to_')))
    content = {field: getattr(actuator, field) for field in fields}
    content['userdata'] = list(content['userdata'])
    return {field: value.copy() if isinstance(value, np.ndarray) else value
            for field, value in content.items()}
