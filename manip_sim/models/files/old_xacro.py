# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Read xacro as it was written before ROS 2, where it can have only one meaning.

Tags of xacro had no prefix, nor had calls of macros, which could precede the definition.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.dom import minidom
from xml.parsers.expat import ExpatError

from manip_sim.models.xml_check import declared_first

#: Tags that xacro had without prefix, the attributes of which one is needed, and all they have.
_TAGS: Mapping[str, tuple[frozenset[str], frozenset[str]]] = {
    tag: (frozenset(needed), frozenset((*needed, *others))) for tag, needed, others in (
        ('include', ('filename',), ('ns', 'optional')),
        ('property', ('name',), ('value', 'default', 'scope')),
        ('macro', ('name',), ('params',)), ('arg', ('name', 'default'), ()),
        ('if', ('value',), ()), ('unless', ('value',), ()), ('insert_block', ('name',), ()))}
#: Elements whose content is of another format, which has tags of these names, too.
_OTHERS = ('gazebo', 'plugin', 'sdf')
#: Elements of URDF, which are never calls of macros without prefix.
_URDF = frozenset((
    'actuator', 'axis', 'bounce', 'box', 'calibration', 'capsule', 'child', 'collision', 'color',
    'cylinder', 'dynamics', 'gazebo', 'geometry', 'hardware', 'inertia', 'inertial', 'joint',
    'limit', 'link', 'mass', 'material', 'mesh', 'mimic', 'origin', 'param', 'parent', 'robot',
    'ros2_control', 'safety_controller', 'sensor', 'sphere', 'texture', 'transmission', 'visual'))


def parsed(parse: Callable[..., Any], text: Any, filename: Any = None) -> Any:
    """
    Return the document of a file with the tags that xacro has now.

    :param parse: xacro's function, with the other parameters
    """
    try:
        document = parse(text, filename)
    except ExpatError:
        content = None if filename is None else Path(filename).read_bytes()
        if content is None or declared_first(content) == content:
            raise
        document = minidom.parseString(declared_first(content))  # noqa: S318
    root = document.documentElement
    if root is not None:
        for element in list(_elements(root)):
            _prefix(element)
            if element.tagName == 'xacro:property' and not element.getAttribute('name'):
                element.parentNode.removeChild(element)  # Nothing can use it.
            if element.tagName == 'xacro:arg' and not element.hasAttribute('default'):
                # Thus xacro says that it is undefined, unless it is given.
                element.setAttribute('default', f'$(arg {element.getAttribute("name")})')
    return document


def called(handle: Callable[..., bool], grab: Callable[..., None], resolve: Callable[..., Any],
           node: Any, macros: Any, symbols: Any) -> bool:
    """
    Expand a node if it calls a macro, also without prefix or before the definition.

    :param handle: xacro's function of the last parameters
    :param grab: xacro's function that takes a definition out of a document
    :param resolve: xacro's function that returns a macro
    """
    name = node.tagName.removeprefix('xacro:')
    is_prefixed = node.tagName != name
    if name == 'call' or (not is_prefixed and (name in _URDF or ':' in name)):
        return handle(node, macros, symbols)
    try:
        resolve(name, macros, symbols)
    except (AttributeError, KeyError, NameError, TypeError):
        later = [element for element in _elements(node.ownerDocument.documentElement)
                 if element.tagName == 'xacro:macro' and element.getAttribute('name') == name]
        if len(later) != 1:
            return handle(node, macros, symbols)
        # xacro goes on with the definition itself, so it stays where it is.
        copy = later[0].parentNode.insertBefore(later[0].cloneNode(deep=True), later[0])
        grab(copy, macros)
    if not is_prefixed:
        node.tagName = node.nodeName = f'xacro:{name}'
    return handle(node, macros, symbols)


def _elements(root: Any) -> Iterator[Any]:
    """Yield an element and those below it, but not those of other formats."""
    left = [root]
    while left:
        element = left.pop()
        yield element
        if element.tagName not in _OTHERS:
            left += [child for child in reversed(element.childNodes)
                     if child.nodeType == child.ELEMENT_NODE]


def _prefix(element: Any) -> None:
    """Give a tag of xacro the prefix that it lacks."""
    needed, known = _TAGS.get(element.tagName, (frozenset(), frozenset()))
    attributes = set(element.attributes.keys())
    if needed and needed <= attributes <= known:
        element.tagName = element.nodeName = f'xacro:{element.tagName}'
