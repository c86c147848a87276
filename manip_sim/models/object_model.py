# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bodies with a name and a pose that are added to a world: objects, and fixtures of arenas."""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError
from manip_sim.models.loading import compile_spec, name_unnamed_elements
from manip_sim.models.spec_edits import (
    attach_as_is, NAMED_ELEMENTS, rename_body, soften_contacts, TakenNames)
from manip_sim.quoting import quoted

MIN_MASS_KG, MAX_MASS_KG = 1e-5, 1e5
#: By shape: how many numbers are its size, and what they are [m].
SIZES = {
    'box': (3, '[x, y, z], its full extents'),
    'sphere': (1, 'its radius'),
    'cylinder': (2, '[radius, length]'),
    'capsule': (2, '[radius, length without the caps]'),
    'ellipsoid': (3, '[x, y, z], its radii')}
#: The geom of a shape, before it gets the name of the object.
SHAPE_GEOM = 'shape'
_NAME = re.compile(r'[A-Za-z][A-Za-z0-9_]{0,63}')
#: The least version of MuJoCo that deletes elements; those before end the process.
_DELETES = 4000000
_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Elements that spawned models cannot have, by the field of ``mujoco.MjModel`` that counts them.
NOT_SPAWNED = {
    'nflex': 'flexible bodies', 'nskin': 'skins', 'nhfield': 'height fields',
    'nplugin': 'plugins', 'nmocap': 'mocap bodies', 'nhistory': 'delays',
    'nplastic': 'plastic joints'}


def check_object_name(name: str, source: str,
                      owner: str = 'an object, its body and its topics') -> None:
    """Reject a name that a body and topics cannot have."""
    if not _NAME.fullmatch(name) or name == 'world':
        raise ModelError(f'{source}: {quoted(name)} cannot be the name of {owner}: it needs a '
                         'letter, then at most 63 letters, digits and underscores, and must not '
                         "be 'world'")


class PlacedModel:
    """
    A body with a name and a pose in ``world``.

    In a world the geom of a shape has that name too; all other names begin with ``<name>_``.

    :param name: a letter, then at most 63 letters, digits and underscores
    :param spec: a ``mujoco.MjSpec`` with one root body; not copied, and changed in place
    :param origin: where it comes from, for messages
    :raises ModelError: if it cannot have the name or what the spec holds
    :ivar inferred: the inferences, in sentences
    """

    #: Kind of the object, for messages.
    kind = 'body'

    def __init__(self, name: str, spec: mujoco.MjSpec, origin: str = '') -> None:
        self.origin = origin or f'{self.kind} {quoted(name)}'
        check_object_name(name, self.origin)
        self.name = name
        self.inferred: list[str] = []
        self._spec = spec
        self._check_root()
        self._prepare_root()
        name_unnamed_elements(spec)
        self._own_model = compile_spec(spec, self.origin)
        self._check_contents()
        # :meth:`place` sets position and quaternion; nothing else may turn or move the root.
        root, compiled = self._root, self._own_model.body(self._root.name)
        root.pos, root.quat = compiled.pos, compiled.quat
        root.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        root.set_frame(spec.worldbody.add_frame())

    def _check_root(self) -> None:
        world, rule = self._spec.worldbody, f'{self.kind} is one root body'
        rule = f'an {rule}' if self.kind[0] in 'aeiou' else f'a {rule}'
        names = ', '.join(body.name or 'unnamed' for body in world.bodies) or 'none'
        if len(world.bodies) != 1:
            raise ModelError(f'{self.origin}: {rule}, found {len(world.bodies)}: {names}')
        for kind in ('geoms', 'sites', 'cameras', 'lights'):
            if getattr(world, kind):
                raise ModelError(f'{self.origin}: {rule}, found {kind} beside it: put them into '
                                 f'the body {names}')

    def _prepare_root(self) -> None:
        """Check the joints of the root body, or add what it lacks."""

    def _check_contents(self) -> None:
        """Reject what the compiled model must not have."""

    @property
    def _root(self) -> Any:
        return self._spec.worldbody.bodies[0]

    @property
    def _prefix(self) -> str:
        return f'{self.name}_'

    @property
    def spec(self) -> Any:
        """The object's own ``mujoco.MjSpec``, without prefix; :meth:`attach` uses later edits."""
        return self._spec

    @property
    def root_body(self) -> str:
        """Name of the object's root body in a world."""
        return self.name

    @property
    def mass_kg(self) -> float:
        """Mass of the object [kg]."""
        return float(self._own_model.body_subtreemass[1])

    @property
    def dof(self) -> int:
        """Number of degrees of freedom, with the six of the free joint."""
        return int(self._own_model.nv)

    @property
    def position(self) -> FloatArray:
        """Start position in ``world`` [m], shape (3,), a copy."""
        return np.array(self._root.pos)

    @property
    def quat_wxyz(self) -> FloatArray:
        """Start orientation in ``world``, w, x, y, z, shape (4,), a copy."""
        return np.array(self._root.quat)

    def place(self, position: ArrayLike | None = None, quat_wxyz: ArrayLike | None = None) -> None:
        """
        Change the start pose, in worlds that are composed from now on.

        :param position: in ``world`` [m], shape (3,); None keeps it
        :param quat_wxyz: of unit length, shape (4,); None keeps it
        """
        if position is not None:
            self._root.pos = np.asarray(position, dtype=float)
        if quat_wxyz is not None:
            self._root.quat = np.asarray(quat_wxyz, dtype=float)

    def attach(self, spec: mujoco.MjSpec, taken: TakenNames | None = None) -> None:
        """
        Add a copy of the object to a world.

        :param spec: the ``mujoco.MjSpec`` to add to
        :param taken: its names, if more objects are added
        :raises ModelError: if the spec has one of the names already
        """
        kinds = [('body', spec.body), *([('geom', spec.geom)] if self._is_shape else ())]
        for kind, find in kinds:
            if find(self.name) is not None:
                raise ModelError(f"{kind} '{self.name}' already exists, {self.origin} needs "
                                 'another name')
        taken = taken or TakenNames(spec)
        copied = self._spec.copy()
        taken.add(copied, self._prefix, self.origin)
        for key in list(copied.keys):
            copied.delete(key)
        copied.option = spec.option
        soften_contacts(copied, spec.option.timestep)
        attach_as_is(spec, copied, self._prefix, spec.worldbody.add_frame())
        root = self._prefix + self._root.name
        rename_body(spec, spec.body(root), self.name)
        taken.rename('bodies', root, self.name)
        if self._is_shape:
            spec.geom(self._prefix + SHAPE_GEOM).name = self.name
            taken.rename('geoms', self._prefix + SHAPE_GEOM, self.name)

    @property
    def _is_shape(self) -> bool:
        return [geom.name for geom in self._spec.geoms] == [SHAPE_GEOM]

    def compile(self) -> Any:
        """
        Compile the object alone.

        :returns: a new ``mujoco.MjModel``
        """
        spec = mujoco.MjSpec()
        self.attach(spec)
        return compile_spec(spec, self.origin)


class ObjectModel(PlacedModel):
    """
    A free body with the name of the object, or a visual body.

    A free joint without a name is called ``<name>_joint``. A visual body is a mocap body: it
    stays where it is put, and touches nothing.

    :param name: a letter, then at most 63 letters, digits and underscores
    :param spec: a ``mujoco.MjSpec`` with one root body; not copied, and changed in place
    :param origin: where it comes from, for messages
    :param visual: whether it is only seen
    :raises ModelError: if an object cannot have the name or what the spec holds
    :ivar visual: whether it is only seen
    """

    kind = 'object'

    def __init__(self, name: str, spec: mujoco.MjSpec, origin: str = '', visual: bool = False
                 ) -> None:
        self.visual = visual
        super().__init__(name, spec, origin)

    def _prepare_root(self) -> None:
        joints = self._root.joints
        if self.visual:
            if joints:
                raise ModelError(f"{self.origin}: an object that is only seen has no joint, found "
                                 f"'{joints[0].name}' on its root body")
            only_seen(self._spec)
            self._root.mocap = True
        elif not joints:
            self._root.add_freejoint().name = 'joint'
        elif len(joints) > 1 or int(joints[0].type) != _FREE:
            raise ModelError(f"{self.origin}: the root body of an object must be free, found "
                             f"joint '{joints[0].name}': remove the joint")
        elif not joints[0].name:
            joints[0].name = 'joint'

    def _check_contents(self) -> None:
        for size, kind in NOT_SPAWNED.items():
            if getattr(self._own_model, size, 0) > (size == 'nmocap' and self.visual):
                raise ModelError(f'{self.origin}: an object cannot have {kind}')
        if not self.visual and not MIN_MASS_KG <= self.mass_kg <= MAX_MASS_KG:
            raise ModelError(f'{self.origin} weighs {self.mass_kg:g} kg, it must be '
                             f'{MIN_MASS_KG:g} to {MAX_MASS_KG:g} kg')

    @property
    def free_joint(self) -> str:
        """Name of the object's free joint in a world."""
        return self._prefix + str(self._root.joints[0].name)

    def detach(self, spec: mujoco.MjSpec, taken: TakenNames) -> bool:
        """
        Delete the copy that :meth:`attach` added, if it is a single body of one shape.

        :param spec: the ``mujoco.MjSpec`` that has it
        :param taken: its names
        :returns: whether it was; anything else has elements that refer to each other, and MuJoCo 3
            may end the process in a deletion: then the world has to be composed without it
        """
        others = (getattr(self._spec, elements) for elements in NAMED_ELEMENTS.values()
                  if elements not in ('bodies', 'joints', 'geoms'))
        if (mujoco.mj_version() < _DELETES or not self._is_shape or len(self._spec.bodies) != 2
                or any(others)):
            return False
        frame, default = spec.body(self.name).frame, spec.find_default(f'{self._prefix}main')
        while frame.frame is not None:
            frame = frame.frame
        # The outermost frame holds the additions of :meth:`attach`, and a deletion takes long.
        spec.delete(frame)
        if default is not None:
            spec.delete(default)
        taken.discard('bodies', self.name)
        taken.discard('geoms', self.name)
        for joint in self._root.joints:
            taken.discard('joints', self._prefix + str(joint.name))
        return True


class FixtureModel(PlacedModel):
    """
    Furniture that is welded to an arena, such as a shelf, or a door with its hinge.

    Its joints and actuators belong to the arena.

    :param name: a letter, then at most 63 letters, digits and underscores
    :param spec: a ``mujoco.MjSpec`` with one root body; not copied, and changed in place
    :param origin: where it comes from, for messages
    :param visual: whether it is only seen
    :raises ModelError: if a fixture cannot have the name or what the spec holds
    """

    kind = 'fixture'

    def __init__(self, name: str, spec: mujoco.MjSpec, origin: str = '', visual: bool = False
                 ) -> None:
        if visual:
            only_seen(spec)
        super().__init__(name, spec, origin)

    def _prepare_root(self) -> None:
        if self._root.joints:
            raise ModelError(f"{self.origin}: the root body of a fixture is welded to the world, "
                             f"found joint '{self._root.joints[0].name}': put it into a body "
                             "below the root, or list it below 'objects'")


def only_seen(spec: mujoco.MjSpec) -> None:
    """Let nothing touch the shapes of a spec."""
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0
