# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Compose robot, gripper, base and arena from names, files or objects: the one place that does."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from typing import Any, Union

from numpy.typing import ArrayLike

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.arenas import Arena, create_arena
from manip_sim.models.bases import create_base, RobotBaseModel
from manip_sim.models.cameras import Camera, LidarLike
from manip_sim.models.faults import FaultsLike
from manip_sim.models.grippers import create_gripper, GripperModel
from manip_sim.models.object_creation import Description
from manip_sim.models.randomization import RandomizationLike
from manip_sim.models.robots import create_robot, ManipulatorModel, RobotModel
from manip_sim.models.user_files import parse_yaml
from manip_sim.models.world import World
from manip_sim.quoting import format_value, quoted

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
    if isinstance(robot, (str, PathLike)):
        robot = create_robot(robot, idn=idn, prefix=prefix)
    elif prefix:
        robot.set_naming_prefix(prefix)
    _add_base(robot, base, idn)
    if isinstance(robot, ManipulatorModel):
        _add_grippers(robot, gripper, idn)
    if tactile:
        _add_tactile_sensors(robot)
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


def _add_tactile_sensors(robot: RobotModel) -> None:
    grippers = [part for part in robot.models if isinstance(part, GripperModel)]
    if not any([gripper.add_tactile_sensors() for gripper in grippers]):
        names = ' and '.join(dict.fromkeys(gripper.name for gripper in grippers))
        raise ModelError("'tactile' needs a gripper with pads, which are boxes or capsules that "
                         f'touch sensors enclose, and {names or robot.name} has none')


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
