# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
An arena with robots and objects: one ``mujoco.MjModel`` and the start of its joints.

:func:`compose` is the one place that composes them from names, files or objects.

MuJoCo's ``gravcomp`` compensates the weight of a body at all joints between it and the world, so
also at a free joint: the robot would float. So the actuators of arms, torso and head of a robot
with a free root carry the parts beyond them, and the root and the legs carry that weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import copy
from os import PathLike
from typing import Any, Union

import mujoco
from numpy.typing import ArrayLike

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.archive import pack, to_binary
from manip_sim.models.arenas import Arena, create_arena, EmptyArena
from manip_sim.models.asset_files import LostShape
from manip_sim.models.bases import create_base, RobotBaseModel
from manip_sim.models.cameras import Camera, create_camera, create_lidar, LidarLike
from manip_sim.models.faults import FaultPlan, FaultsLike
from manip_sim.models.grippers import create_gripper, GripperModel
from manip_sim.models.loading import compile_spec
from manip_sim.models.mjcf import MujocoXMLModel
from manip_sim.models.object_creation import (
    check_object_names, create_objects, Description, ObjectModel)
from manip_sim.models.randomization import (
    check_placed, checked_seed, InitializationNoise, Randomization, RandomizationLike)
from manip_sim.models.robots import create_robot, ManipulatorModel, RobotModel
from manip_sim.models.spec_edits import fit_couplings, soften_contacts, TakenNames
from manip_sim.models.user_files import parse_yaml
from manip_sim.quoting import format_value, quoted
from manip_sim.validation import check_kind, flag, listed, start_by_joint, whole_nanoseconds

#: Ratio of frictional to normal constraint impedance: friction gives less than the contact. From
#: 500 on, MuJoCo's solver needs twice as many iterations for rounded fingers.
_IMPRATIO = 300.0
#: Iterations after the solver that take the rest of that out, so that grasped objects do not creep
#: (mujoco.readthedocs.io, modeling, "Preventing slip"), and when they may end sooner. Grasps need
#: up to five, arms that press with several links at hundreds of newtons up to forty.
_NOSLIP_ITERATIONS, _NOSLIP_TOLERANCE = 50, 1e-10
#: Tolerance of collisions of convex shapes [m]. With MuJoCo's, the points where a cylinder touches
#: jump by millimetres from step to step, and what presses on it never rests.
_CCD_TOLERANCE = 1e-12


def keyframe_names(parts: Iterable[MujocoXMLModel | ObjectModel]) -> list[str]:
    """Return the names of the keyframes of the files of some parts, each once."""
    return list(dict.fromkeys(name for part in parts if isinstance(part, MujocoXMLModel)
                              for name in part.keyframes))


def _checked_robots(robots: Sequence[RobotModel]) -> list[RobotModel]:
    robots = listed(robots, 'robots')
    for robot in robots:
        check_kind(robot, RobotModel, 'each of the robots', 'a RobotModel')
    prefixes = [robot.naming_prefix for robot in robots]
    if len({robot.name_in_world for robot in robots}) != len(prefixes):
        apart = 'underscores at the end apart, ' * (len(set(prefixes)) == len(prefixes))
        raise ModelError(f'robots in one world need different idn or prefix, {apart}got '
                         + ', '.join(prefixes))
    return robots


class World:
    """
    Robots in an arena.

    :param robots: robots with their mounted parts; the arena places one that was not placed by
        ``set_base_xpos``
    :param arena: the arena, :class:`EmptyArena` by default
    :param timestep_s: of a physics step [s], a whole number of nanoseconds
    :param gravity_compensation: make the joints' actuators carry the weight of all links and
        grippers, as the controller of a real arm does; it counts as actuator force. The model has
        none for a robot whose root has a free joint, which falls and stands by its weight;
        :class:`Simulation` makes its arms, torso and head carry what hangs on them
    :param objects: free bodies, as for :func:`create_objects`; they come after the arena's objects
    :param initialization_noise: added to the start of the robots' own joints, see
        :class:`InitializationNoise`; None for none
    :param seed: of that noise, for which None draws one, and of the noise of sensors
    :param cameras: in addition to the cameras of robots and arena, as for :func:`create_camera`
    :param lidars: as for :func:`create_lidar`
    :param keyframe: of the file of a part: its joints start there; empty for their usual start
    :ivar lidars: as :class:`LidarModel`
    :ivar keyframe: where joints start
    :param randomization: distributions that are drawn at each reset with a seed, as a YAML file or
        a mapping, see :class:`Randomization`; None for none
    :param faults: that are planned for each episode, as a YAML file or a list, see
        :class:`FaultPlan`
    :ivar faults: the planned faults
    :ivar cameras: those in addition to robots and arena, as :class:`CameraModel`
    :ivar objects: all objects, in the order of the compiled world
    :ivar noise: the noise with its seed, or None
    :ivar seed: of the noise of sensors, 0 by default
    :ivar randomization: distributions to draw from at each reset with a seed, with the arena's,
        or None
    """

    def __init__(self, robots: Sequence[RobotModel], arena: Arena | None = None,
                 timestep_s: float = 0.002, gravity_compensation: bool = True, *,
                 objects: Iterable[Description] = (),
                 initialization_noise: Mapping[str, Any] | None = None,
                 seed: int | None = None, cameras: Iterable[Camera] = (),
                 lidars: Iterable[LidarLike] = (),
                 keyframe: str = '',
                 randomization: RandomizationLike | None = None,
                 faults: FaultsLike = ()) -> None:
        self.robots = _checked_robots(robots)
        self.arena = EmptyArena() if arena is None else arena
        check_kind(self.arena, Arena, 'arena', 'a name, a file or an Arena')
        self.timestep_s = whole_nanoseconds(timestep_s)
        self.gravity_compensation = flag(gravity_compensation, 'gravity_compensation')
        self.objects: list[ObjectModel] = [*self.arena.objects, *create_objects(objects)]
        check_object_names(self.objects)
        self.cameras = [create_camera(camera) for camera in listed(cameras, 'cameras')]
        self.lidars = [create_lidar(lidar) for lidar in listed(lidars, 'lidars')]
        self.keyframe = self.checked_keyframe(keyframe)
        self.randomization = (None if randomization is None else Randomization(randomization))
        if self.arena.placements:
            self.randomization = Randomization(randomization or {}).with_placements(
                self.arena.placements)
        if self.randomization is not None:
            check_placed(self.randomization.placements, self.objects)
        self.faults = FaultPlan(faults).faults
        self.noise = (None if initialization_noise is None
                      else InitializationNoise(initialization_noise, seed))
        if self.noise is not None:
            self.seed = self.noise.seed
        else:
            self.seed = 0 if seed is None else checked_seed(seed)

    @property
    def name(self) -> str:
        """Names of the robots, for messages."""
        return ' and '.join(robot.name for robot in self.robots)

    @property
    def keyframes(self) -> list[str]:
        """Names of the keyframes of all parts."""
        return keyframe_names(self._parts())

    def checked_keyframe(self, keyframe: str) -> str:
        """
        Return the name of a keyframe.

        :param keyframe: of one or several parts; empty for none
        :raises UnknownNameError: if no part has it
        """
        check_kind(keyframe, str, 'keyframe', 'a name')
        known = self.keyframes
        if keyframe and keyframe not in known:
            raise UnknownNameError('keyframe', keyframe, known)
        return keyframe

    @property
    def gripper_actuators(self) -> list[str]:
        """Names of the actuators of all grippers."""
        return [actuator for robot in self.robots if isinstance(robot, ManipulatorModel)
                for gripper in robot.grippers.values() for actuator in gripper.actuators]

    def compose(self, visual: bool = True, objects: bool = True) -> mujoco.MjSpec:
        """
        Return a new spec of the whole world: the robots, then the contents of the arena.

        The root of the first robot is the first body, and the addresses of the robots' joints do
        not depend on the arena. Objects are last, so that no address of a robot depends on them.

        :param visual: with the shapes that cannot collide; without them, a step takes less time
            and gives the same states
        :param objects: with :attr:`objects`
        :raises ModelError: if two parts have a name in common, or a camera or lidar cannot be
            added
        """
        spec = self.arena.empty_spec()
        spec.modelname = '_'.join([self.arena.arena_name, *(r.name for r in self.robots)])
        spec.option.timestep = self.timestep_s
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = _IMPRATIO
        self._set_contact_options(spec)
        for robot in self.robots:
            place = None if robot.is_placed else self.arena.robot_position(robot)
            robot.attach_to(spec, spec.worldbody.add_frame(), place)
        self.arena.attach_to(spec, spec.worldbody.add_frame())
        spec = spec.copy()  # That leaves behind what MuJoCo warns of when names have no prefix.
        if self.gravity_compensation:
            compensate_mounted_robots(spec, self.robots)
        for camera in self.cameras:
            camera.attach(spec)
        for lidar in self.lidars:
            lidar.attach(spec)
        soften_contacts(spec, self.timestep_s)
        fit_couplings(spec, self.timestep_s)
        spec.compiler.discardvisual = not visual
        if objects and self.objects:
            taken = TakenNames(spec)
            for item in self.objects:
                item.attach(spec, taken)
        return spec

    def _set_contact_options(self, spec: mujoco.MjSpec) -> None:
        """
        Let contacts rest and friction hold, unless the file of a part has options for that.

        The defaults of MuJoCo count as no options.
        """
        options = [part._spec.option for part in self._parts()]
        slip = max(options, key=lambda option: option.noslip_iterations)
        spec.option.noslip_iterations, spec.option.noslip_tolerance = (
            (slip.noslip_iterations, slip.noslip_tolerance) if slip.noslip_iterations
            else (_NOSLIP_ITERATIONS, _NOSLIP_TOLERANCE))
        tolerances = {option.ccd_tolerance for option in options}
        tolerances.discard(mujoco.MjSpec().option.ccd_tolerance)
        spec.option.ccd_tolerance = min(tolerances, default=_CCD_TOLERANCE)

    def _parts(self) -> Iterator[Arena | MujocoXMLModel | ObjectModel]:
        """Yield what the world is made of."""
        yield self.arena
        yield from self.objects
        for robot in self.robots:
            yield from (robot, *robot.models)

    def with_objects(self, objects: Iterable[ObjectModel]) -> World:
        """
        Return a world that differs in its objects; robots, arena and cameras are shared.

        :param objects: the objects of the new world
        """
        other: World = copy.copy(self)
        other.objects = list(objects)
        return other

    def with_robots(self, robots: Sequence[RobotModel]) -> World:
        """
        Return a world that differs in its robots; arena, objects and cameras are shared.

        :param robots: the robots of the new world
        :raises ModelError: if two of them have the same name
        """
        other: World = copy.copy(self)
        other.robots = _checked_robots(robots)
        return other

    def compile(self, visual: bool = True) -> mujoco.MjModel:
        """
        Compile the world.

        :param visual: as for :meth:`compose`
        :raises ModelError: with MuJoCo's message
        """
        return compile_spec(self.compose(visual), self.name)

    def to_xml(self) -> str:
        """
        Return the MJCF of the world; the root of the first robot is its first body.

        It names mesh and texture files by absolute paths, so with such files it loads only on
        this machine; :meth:`to_archive` loads on any.

        :raises ModelError: with MuJoCo's message
        """
        return self._written()[0]

    def to_archive(self) -> bytes:
        """
        Return the world with its mesh and texture files, as a zip that loads on any machine.

        Load it with ``mujoco.MjSpec.from_zip(io.BytesIO(archive)).compile()``; unpacked, its
        ``model.xml`` with ``mujoco.MjModel.from_xml_path``; as a file ``world.mjz``, with
        ``mujoco.MjSpec.from_file`` of newer versions of MuJoCo.

        :raises ModelError: with MuJoCo's message, or if a file cannot be read
        """
        return pack(*self._written())

    def to_xml_and_archive(self) -> tuple[str, bytes]:
        """
        Return what :meth:`to_xml` and :meth:`to_archive` do, composed once.

        :raises ModelError: as they do
        """
        xml, assets = self._written()
        return xml, pack(xml, assets)

    def to_binary(self) -> bytes:
        """
        Return the compiled world as a file ``.mjb`` of MuJoCo, exact to the last bit.

        Only the same release of MuJoCo reads it: ``mujoco.MjModel.from_binary_path``. MJCF, which
        any release reads, rounds numbers to the digits of its text.

        :raises ModelError: with MuJoCo's message
        """
        return to_binary(self.compile())

    def _written(self) -> tuple[str, Mapping[str, bytes | str]]:
        """Return the XML and the files, by their names in it, that are not on the disk."""
        spec = self.compose()
        # Parts may differ in compiler settings for masses that no file gives; the XML has one set.
        spec.compiler.saveinertial = True
        compile_spec(spec, self.name)
        return spec.to_xml(), spec.assets or {}

    def init_qpos(self, seed: int | None = None, keyframe: str | None = None
                  ) -> dict[str, float]:
        """
        Return start positions by name of the joint of robots, bases and grippers [rad or m].

        With a keyframe, they include the joints of the arena. A root with a free joint stands
        where it does without one.

        :param seed: of the noise on them; None for that of the world
        :param keyframe: that replaces the usual start; None for that of the world
        :raises UnknownNameError: if no part has the keyframe
        :raises ModelError: if the seed is not a whole number from 0
        """
        if seed is not None:
            checked_seed(seed)
        start = self.exact_qpos(keyframe)
        if self.noise is None:
            return start
        noise = self.noise.with_seed(seed)
        for number, robot in enumerate(self.robots):
            ranges = {name: range_ for name, range_ in robot.joint_ranges.items() if name in start}
            noisy = noise.added([start[name] for name in ranges], list(ranges.values()), number)
            start.update(zip(ranges, noisy.tolist()))
        return start

    def exact_qpos(self, keyframe: str | None = None) -> dict[str, float]:
        """
        Return the start positions of :meth:`init_qpos` without noise.

        :param keyframe: that replaces the usual start; None for that of the world
        :raises UnknownNameError: if no part has the keyframe
        """
        start: dict[str, float] = {}
        for robot in self.robots:
            starts: list[tuple[MujocoXMLModel, Any]] = [(robot, robot.init_qpos)]
            if robot.base is not None:
                starts.append((robot.base, robot.init_base_qpos))
            if isinstance(robot, ManipulatorModel):
                starts += [(gripper, gripper.init_qpos) for gripper in robot.grippers.values()]
            for part, qpos in starts:
                start.update(start_by_joint(part.name, part.joints, qpos))
        keyframe = self.checked_keyframe(self.keyframe if keyframe is None else keyframe)
        for source in self._parts():
            places = {} if isinstance(source, ObjectModel) else source.keyframes.get(keyframe, {})
            of_arena = source is self.arena
            # A hand of the file may have been taken off.
            start.update({joint: at for joint, at in places.items() if joint in start or of_arena})
        return start


_FREE = int(mujoco.mjtJoint.mjJNT_FREE)
#: Subsystems with gravity compensation; what carries a robot, such as legs, has none.
_CARRIED = ('arm', 'torso', 'head')


def compensate_mounted_robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel]) -> None:
    """Let actuators of robots without a free root carry their links, and parts mounted on them."""
    for _, bodies in _robots(spec, robots, free=False):
        for body in bodies:
            if body.gravcomp:  # Not the actuators carry it, but what the file stands for.
                continue
            body.gravcomp = 1.0
            for joint in body.joints:
                joint.actgravcomp = True


def compensate_free_robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel]) -> None:
    """
    Let actuators of robots with a free root carry the parts beyond them.

    :param spec: the ``mujoco.MjSpec`` of a world, changed in place; its model needs
        ``FloatingBases`` in each step
    """
    driven = {actuator.target for actuator in spec.actuators}
    for robot, bodies in _robots(spec, robots, free=True):
        carried = {name for subsystem in _CARRIED for name in robot.joints_of(subsystem)} & driven
        for body in bodies:
            if any(joint.name in carried for joint in body.joints):
                for hanging in (body, *body.find_all(mujoco.mjtObj.mjOBJ_BODY)):
                    hanging.gravcomp = 1.0
                    for joint in hanging.joints:
                        joint.actgravcomp = True


def _robots(spec: mujoco.MjSpec, robots: Iterable[RobotModel], free: bool
            ) -> Iterator[tuple[RobotModel, list[mujoco.MjsBody]]]:
    """Yield robots with a free root, or without, and all bodies below their roots."""
    for robot in robots:
        root = spec.body(robot.root_body)
        # Also bodies that composing added.
        bodies = [root, *root.find_all(mujoco.mjtObj.mjOBJ_BODY)]
        if any(int(joint.type) == _FREE for body in bodies for joint in body.joints) == free:
            yield robot, bodies


def inferred_by_model(world: World, robot: RobotModel | None = None
                      ) -> Iterator[tuple[str, list[str]]]:
    """
    Yield the name of each model of a world, and sentences on the inferences about it.

    :param robot: whose models are meant; None: the whole world
    """
    robots = world.robots if robot is None else [robot]
    models: list[Any] = [*([world.arena, *world.objects] if robot is None else ()), *robots]
    for model in (*models, *(part for robot in robots for part in robot.models)):
        yield model.name, getattr(model, 'inferred', None) or []


def skipped_geoms(world: World, robot: RobotModel | None = None) -> list[str]:
    """
    Return which shapes the models of a world lack because their files cannot be read.

    :param robot: whose models are meant; None: the whole world
    """
    return [f'{name}: {sentence}' for name, sentences in inferred_by_model(world, robot)
            for sentence in sentences if isinstance(sentence, LostShape)]


#: In place of a name: the default of the robot, and none at all.
DEFAULT, NONE = 'default', 'none'
Robot = Union[str, PathLike[str], RobotModel]
Gripper = Union[str, PathLike[str], GripperModel, None]
Grippers = Mapping[str, Gripper]
Base = Union[str, PathLike[str], RobotBaseModel, None]


def compose_robot(robot: Robot = 'Panda', gripper: Gripper | Grippers = DEFAULT,
                  base: Base = DEFAULT, *, idn: int | str = 0, prefix: str = '',
                  tactile: bool = False) -> RobotModel:
    """
    Return a robot with its base and a gripper on every arm.

    :param robot: a name of the catalogue, a file, or a robot that has neither base nor gripper yet
    :param gripper: a name or file, ``default`` for the robot's own, ``none`` or None for no
        gripper, a gripper, a mapping of these by arm, or the text of one as for
        :func:`read_gripper`; an arm that is not named gets the robot's own
    :param base: a name or file, ``default`` for the robot's own, ``none`` or None for the floor,
        or a base
    :param idn: number or word in names, as in ``robot0_joint1``; also for grippers and a base that
        are given by name
    :param prefix: what all names begin with, in place of a prefix with the idn
    :param tactile: with :meth:`GripperModel.add_tactile_sensors` of its grippers
    :raises UnknownNameError: if a name is not known
    :raises ModelError: if the parts do not fit together, or no gripper has pads for such sensors
    """
    check_kind(prefix, str, 'prefix', 'a word')
    check_kind(robot, (str, PathLike, RobotModel), 'robot', 'a name, a file or a RobotModel')
    if isinstance(robot, (str, PathLike)):
        robot = create_robot(robot, idn=idn, prefix=prefix)
    elif prefix:
        robot.set_naming_prefix(prefix)
    _add_base(robot, base, idn)
    if isinstance(robot, ManipulatorModel):
        _add_grippers(robot, gripper, idn)
    if flag(tactile, 'tactile'):
        grippers = [part for part in robot.models if isinstance(part, GripperModel)]
        if not any([gripper.add_tactile_sensors() for gripper in grippers]):
            names = ' and '.join(dict.fromkeys(gripper.name for gripper in grippers))
            raise ModelError("'tactile' needs a gripper with pads, which are boxes or capsules "
                             f'that touch sensors enclose, and {names or robot.name} has none')
    return robot


def read_gripper(text: str, source: str = 'gripper') -> str | dict[str, str]:
    """
    Parse grippers by arm from a text such as ``{right: PandaGripper, left: none}``.

    :param text: YAML if it begins with a brace, else a name or file, which is returned as it is
    :raises ModelError: if it is not YAML of names by arm
    """
    if not text.lstrip().startswith('{'):
        return text
    by_arm = parse_yaml(text, source)
    for arm, choice in by_arm.items():
        if not isinstance(choice, str):
            raise ModelError(f'{source}: the gripper of arm {quoted(arm)} must be a name or a '
                             f'file, got {format_value(choice)}')
    return by_arm


def _add_base(robot: RobotModel, base: Base, idn: int | str) -> None:
    check_kind(base, (str, PathLike, RobotBaseModel, type(None)), 'base',
               'a name, a file, a base or None')
    choice = robot.default_base if base == DEFAULT else base
    if choice is None or choice == NONE:
        return
    if isinstance(choice, (str, PathLike)):
        with _naming_its_robot(robot, 'base', base == DEFAULT):
            choice = create_base(choice, idn=idn)
    robot.add_base(choice)


@contextmanager
def _naming_its_robot(robot: RobotModel, kind: str, is_default: bool) -> Iterator[None]:
    """Let an error about an unknown part say which robot has it by default."""
    try:
        yield
    except UnknownNameError as error:
        if not is_default:
            raise
        raise ModelError(f'the default {kind} of {robot.name}: {error}; parts of your own are '
                         'found in the folders of MANIP_SIM_PATH') from error


def _add_grippers(robot: ManipulatorModel, gripper: Gripper | Grippers, idn: int | str) -> None:
    if isinstance(gripper, GripperModel):
        robot.add_gripper(gripper)
        return
    if isinstance(gripper, str):
        gripper = read_gripper(gripper)
    by_arm: dict[str, Gripper] = dict.fromkeys(robot.arms, DEFAULT)
    if isinstance(gripper, Mapping):
        by_arm.update({robot.arm_of(name): choice for name, choice in gripper.items()})
    else:
        by_arm = dict.fromkeys(robot.arms, gripper)
    for arm, choice in by_arm.items():
        check_kind(choice, (str, PathLike, GripperModel, type(None)), 'gripper',
                   'a name, a file, a gripper, None or a mapping of these by arm')
        is_default = choice == DEFAULT
        if is_default:
            if arm in robot.own_hands and arm not in robot.declared_grippers:
                continue
            choice = robot.declared_grippers.get(arm)
        robot.take_off_hand(arm)
        if choice is None or choice == NONE:
            continue
        if isinstance(choice, (str, PathLike)):
            with _naming_its_robot(robot, 'gripper', is_default):
                choice = create_gripper(choice, idn=f'{idn}_{arm}')
        robot.add_gripper(choice, arm)


def compose(robot: Robot = 'Panda', gripper: Gripper | Grippers = DEFAULT,
            base: Base = DEFAULT, arena: str | PathLike[str] | Arena = 'empty', *,
            idn: int | str = 0, prefix: str = '', position: ArrayLike | None = None,
            orientation: ArrayLike | None = None, timestep_s: float = 0.002,
            gravity_compensation: bool = True, objects: Iterable[Description] = (),
            initialization_noise: Mapping[str, Any] | None = None, seed: int | None = None,
            cameras: Iterable[Camera] = (), lidars: Iterable[LidarLike] = (), keyframe: str = '',
            randomization: RandomizationLike | None = None, tactile: bool = False,
            faults: FaultsLike = (), **arena_parameters: Any) -> World:
    """
    Return a world with one robot.

    :param robot: a name of the catalogue, a file, or a robot that has neither base nor gripper yet
    :param gripper: a name or file, ``default``, ``none``, a gripper, or a mapping of these by arm,
        as for :func:`compose_robot`
    :param base: a name or file, ``default``, ``none``, or a base
    :param arena: a name of the catalogue, a file, or an arena
    :param idn: number or word in names, as in ``robot0_joint1``
    :param prefix: what all names begin with, in place of a prefix with the idn
    :param position: of the floor below the robot's root, in the world [m], shape (3,); None: where
        the arena places the robot
    :param orientation: roll, pitch, yaw of the root in the world [rad], shape (3,)
    :param timestep_s: of a physics step [s], a whole number of nanoseconds
    :param gravity_compensation: make the joints' actuators carry the weight, see :class:`World`
    :param objects: free bodies: objects, mappings, MJCF files or YAML files, see :class:`World`
    :param initialization_noise: noise of the start positions, see :class:`World`
    :param seed: of the noise; None draws one
    :param cameras: in addition to the cameras of robot and arena, see :class:`World`
    :param lidars: of the world, see :class:`World`
    :param keyframe: of a file, that joints start from, see :class:`World`
    :param randomization: distributions to draw from at each reset with a seed, see :class:`World`
    :param tactile: with tactile sensors on the pads of the grippers, see :func:`compose_robot`
    :param faults: that are planned for each episode, see :class:`World`
    :param arena_parameters: parameters of an arena that is given by name, such as ``table_height``
    :raises UnknownNameError: if a name is not known
    :raises ModelError: if the parts do not fit together
    """
    whole = compose_robot(robot, gripper, base, idn=idn, prefix=prefix, tactile=tactile)
    if orientation is not None:
        whole.set_base_ori(orientation)
    if position is not None:
        whole.set_base_xpos(position)
    if isinstance(arena, (str, PathLike)):
        arena = create_arena(arena, **arena_parameters)
    elif arena_parameters:
        raise ModelError('parameters are for an arena that is given by name, '
                         f'got {", ".join(arena_parameters)}')
    return World([whole], arena, timestep_s, gravity_compensation, objects=objects,
                 initialization_noise=initialization_noise, seed=seed, cameras=cameras,
                 lidars=lidars, keyframe=keyframe, randomization=randomization, faults=faults)
