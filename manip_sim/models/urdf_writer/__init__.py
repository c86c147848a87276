# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Write the URDF of a robot; reading URDF is in ``manip_sim.models.files.urdf``."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree

import mujoco
import numpy as np

from manip_sim.algebra import matrix_of, rpy_of
from manip_sim.arrays import FloatArray
from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models.actuators import (
    declared_velocity, JOINT_TRANSMISSIONS, velocity_of_servos)
from manip_sim.models.loading import compile_spec
from manip_sim.models.robots import RobotModel
from manip_sim.models.couplings import tied_bodies
from manip_sim.models.urdf_writer.links import (
    collides, files_of_meshes, geoms_of_body, is_seen, Joint, KinematicTree, Link,
    MeshFile, rgba_of, robot_tree, Shape, shapes_of, text_of)
from manip_sim.models.world import World
from manip_sim.quoting import quoted

#: Hardware component from apt, which reads and writes joint states.
TOPIC_PLUGIN = 'joint_state_topic_hardware_interface/JointStateTopicSystem'
#: Hardware component of the package in ``hardware/``, which knows lock-step and sensors too.
OWN_PLUGIN = 'manip_sim_hardware/ManipSimSystem'
PLUGINS = (TOPIC_PLUGIN, OWN_PLUGIN)
#: A threshold below zero lets the plugin publish in each cycle; else it is silent while states and
#: commands agree, and a command timeout of the node would stop the robot.
_ALWAYS = '-1'
_STATES = ('position', 'velocity', 'effort')
_WRENCH = tuple(f'{kind}.{axis}' for kind in ('force', 'torque') for axis in 'xyz')
_IMU = (*(f'orientation.{axis}' for axis in 'xyzw'), *(
    f'{kind}.{axis}' for kind in ('angular_velocity', 'linear_acceleration') for axis in 'xyz'))
#: Limit of a prismatic joint without a range, for which URDF requires one [m].
_FAR_M = 1000.0
#: Of a joint without a limit, as in the simulation's servos [rad/s or m/s].
DEFAULT_VELOCITY = float(np.pi)
#: Of a joint whose actuators have no limit [N m or N].
DEFAULT_EFFORT = 1000.0
_EQ = mujoco.mjtEq
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)


@dataclass(frozen=True)
class Urdf:
    """
    A URDF, and how it relates to the model.

    :ivar xml: the URDF
    :ivar tree: its links and joints
    :ivar mimics: how joints follow others, by id of the joint
    :ivar notes: what URDF cannot express and was left out, in sentences
    """

    xml: str
    tree: KinematicTree
    mimics: Mapping[int, Mimic]
    notes: tuple[str, ...]


def write_urdf(model: mujoco.MjModel, robot: RobotModel,
               meshes: Mapping[str, MeshFile] | None = None, hardware: Hardware | None = None,
               lidars: Iterable[str] = ()) -> Urdf:
    """
    Return the URDF of a robot with its base and grippers, in ``world``.

    :param model: the compiled ``mujoco.MjModel`` of a world with the robot
    :param robot: a robot of that world
    :param meshes: files of meshes by name; other meshes are left out
    :param hardware: of the ``<ros2_control>`` tag; None for none
    :param lidars: names of the lidars of the world
    """
    name = robot.name.removesuffix(str(robot.idn))
    return _UrdfWriter(model, robot_tree(model, robot, lidars), name, meshes or {}).write(hardware)


class _UrdfWriter:
    """Writer of the URDF of one robot."""

    def __init__(self, model: mujoco.MjModel, tree: KinematicTree, name: str,
                 meshes: Mapping[str, MeshFile]) -> None:
        self._model, self._tree, self._meshes = model, tree, meshes
        self._robot = ElementTree.Element('robot', name=name)
        self._materials: dict[str, str] = {}
        self._actuators = actuated_joints(model)
        self._scalar = [joint.id for joint in tree.joints
                        if joint.id is not None and joint.axis is not None]
        self._mimics, self._notes = find_mimics(model, self._scalar, self._actuators)
        geoms = [g for body in tree.link_of_body for g in geoms_of_body(model, body)]
        #: Without visual geoms, those that collide are shown.
        self._shows_all = not any(is_seen(model, geom) for geom in geoms)
        bodies, kinds = set(tree.link_of_body), (int(_EQ.mjEQ_CONNECT), int(_EQ.mjEQ_WELD))
        loops = [e for e in range(model.neq) if int(model.eq_type[e]) in kinds
                 and model.eq_active0[e] and bodies.issuperset(tied_bodies(model, e))]
        if loops:
            self._notes.append(f'{len(loops)} constraints between bodies close loops: a URDF is a '
                               'tree')

    def write(self, hardware: Hardware | None) -> Urdf:
        """Write the URDF and return it."""
        joint_of = {joint.child: joint for joint in self._tree.joints}
        for link in self._tree.links:
            if link.name in joint_of:
                self._add_joint(joint_of[link.name])
            self._add_link(link)
        for place, (rgba, name) in enumerate(self._materials.items()):
            material = ElementTree.Element('material', name=name)
            ElementTree.SubElement(material, 'color', rgba=rgba)
            self._robot.insert(place, material)
        if hardware is not None:
            names = [self._model.joint(joint).name for joint in self._scalar]
            add_hardware(self._robot, hardware, names,
                         [self._model.joint(joint).name for joint in self._mimics])
        ElementTree.indent(self._robot)
        xml = ElementTree.tostring(self._robot, encoding='unicode')
        return Urdf(f'<?xml version="1.0"?>\n{xml}\n', self._tree, self._mimics,
                    tuple(dict.fromkeys(self._notes)))

    # ------------------------------------------------------------------ joints

    def _add_joint(self, joint: Joint) -> None:
        element = ElementTree.SubElement(self._robot, 'joint', name=joint.name, type=joint.kind)
        ElementTree.SubElement(element, 'parent', link=joint.parent)
        ElementTree.SubElement(element, 'child', link=joint.child)
        _add_origin(element, joint.position, joint.rotation)
        if joint.axis is None or joint.id is None:
            return
        ElementTree.SubElement(element, 'axis', xyz=text_of(joint.axis))
        model, number = self._model, joint.id
        limits = {
            'effort': effort_limit(model, number, self._actuators.get(number, [])),
            'velocity': velocity_limit(model, number, self._mimics, self._actuators),
            **dict(zip(('lower', 'upper'), model.jnt_range[number] if model.jnt_limited[number]
                       else () if joint.kind == 'continuous' else (-_FAR_M, _FAR_M)))}
        ElementTree.SubElement(element, 'limit',
                               {key: text_of(value) for key, value in limits.items()})
        dof = int(model.jnt_dofadr[number])
        # Newer versions of MuJoCo have coefficients for higher powers of the velocity too.
        damping = np.atleast_1d(model.dof_damping[dof])[0]
        ElementTree.SubElement(element, 'dynamics', damping=text_of(damping),
                               friction=text_of(model.dof_frictionloss[dof]))
        if number in self._mimics:
            mimic = self._mimics[number]
            ElementTree.SubElement(
                element, 'mimic', joint=model.joint(mimic.leader).name,
                multiplier=text_of(mimic.multiplier), offset=text_of(mimic.offset))

    # ------------------------------------------------------------------ links

    def _add_link(self, link: Link) -> None:
        element = ElementTree.SubElement(self._robot, 'link', name=link.name)
        if link.body is None:
            return
        _add_inertial(element, self._model, link.body)
        for geom in geoms_of_body(self._model, link.body):
            touches = collides(self._model, geom)
            seen = is_seen(self._model, geom) or (touches and self._shows_all)
            shapes = list(shapes_of(self._model, geom, self._meshes)) if seen or touches else []
            if (seen or touches) and not shapes:
                kind = mujoco.mjtGeom(int(self._model.geom_type[geom])).name
                self._notes.append(f'{link.name}: a {kind.rpartition("_")[2].lower()} is left out')
            if seen:
                self._add_shapes(element, 'visual', geom, shapes)
            if touches:
                self._add_shapes(element, 'collision', geom, shapes)

    def _add_shapes(self, link: ElementTree.Element, tag: str, geom: int, shapes: list[Shape]
                    ) -> None:
        for shape in shapes:
            element = ElementTree.SubElement(link, tag)
            _add_origin(element, shape.position, shape.rotation)
            geometry = ElementTree.SubElement(element, 'geometry')
            ElementTree.SubElement(geometry, shape.tag, dict(shape.attributes))
            if tag == 'visual':
                rgba = text_of([round(float(part), 4) for part in rgba_of(self._model, geom)])
                name = self._materials.setdefault(rgba, f'colour_{len(self._materials)}')
                ElementTree.SubElement(element, 'material', name=name)


def _add_origin(element: ElementTree.Element, position: FloatArray, rotation: FloatArray) -> None:
    ElementTree.SubElement(element, 'origin', xyz=text_of(position), rpy=text_of(rpy_of(rotation)))


def _add_inertial(link: ElementTree.Element, model: mujoco.MjModel, body: int) -> None:
    if not model.body_mass[body] > 0.0:
        return
    turn = matrix_of(model.body_iquat[body])
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    element = ElementTree.SubElement(link, 'inertial')
    _add_origin(element, model.body_ipos[body], np.eye(3))
    ElementTree.SubElement(element, 'mass', value=text_of(model.body_mass[body]))
    ElementTree.SubElement(element, 'inertia', {
        f'i{"xyz"[row]}{"xyz"[column]}': text_of(inertia[row, column])
        for row in range(3) for column in range(row, 3)})


def urdfs_of(world: World, hardware: Mapping[str, Hardware] | None = None) -> dict[str, Urdf]:
    """
    Return the URDF of each robot by its name in the world.

    :param world: with one robot or more
    :param hardware: by name of the robot, for those with a ``<ros2_control>`` tag
    :raises ModelError: if the world does not compile
    """
    spec = world.compose(objects=False)
    model = compile_spec(spec, world.name)
    held = {robot.naming_prefix + name: file for robot in world.robots
            for name, file in robot.held_files.items()}
    meshes, hardware_of = files_of_meshes(spec, model, held), hardware or {}
    return {robot.name_in_world:
            write_urdf(model, robot, meshes, hardware_of.get(robot.name_in_world),
                       [lidar.name for lidar in world.lidars])
            for robot in world.robots}


def urdf_of(world: World, robot: str | None = None, hardware: Hardware | None = None) -> Urdf:
    """
    Return the URDF of one robot.

    :param world: with the robot
    :param robot: what its names begin with, without the underscore that follows, such as
        ``robot0``; None for the only one
    :param hardware: of the ``<ros2_control>`` tag; None for none
    :raises ModelError: if there are several robots and none is named, or the world does not
        compile
    :raises UnknownNameError: if the robot is unknown
    """
    name = choose_robot(world, robot).name_in_world
    return urdfs_of(world, {} if hardware is None else {name: hardware})[name]


def choose_robot(world: World, name: str | None = None) -> RobotModel:
    """
    Return the robot of a name, or the only one; raises as :func:`urdf_of` does.

    :param world: with one robot or more
    :param name: of the robot, as for :func:`urdfs_of`; None for the only one
    """
    robots = {robot.name_in_world: robot for robot in world.robots}
    if name is None:
        if len(robots) != 1:
            raise ModelError('a URDF describes one robot: name one of '
                             + (', '.join(robots) or 'none'))
        return next(iter(robots.values()))
    if name not in robots:
        raise UnknownNameError('robot', name, robots)
    return robots[name]


__all__ = ['choose_robot', 'Hardware', 'OWN_PLUGIN', 'PLUGINS', 'TOPIC_PLUGIN', 'Urdf', 'urdf_of',
           'urdfs_of', 'write_urdf']


@dataclass(frozen=True)
class Hardware:
    """
    Content of the ``<ros2_control>`` tag of a robot.

    :ivar interfaces: ``position``, ``velocity`` or ``effort`` by name of the joint with commands
    :ivar states_topic: where the joint states come from
    :ivar commands_topic: where the joint commands go to
    :ivar plugin: one of :data:`PLUGINS`; what follows is for the second one alone
    :ivar node: name of the node whose parameters select control modes, with its namespace
    :ivar mode_parameters: the parameter ``control_mode.<part>`` of each joint that has one
    :ivar wrench_topics: topics of wrenches, by name of the sensor
    :ivar lockstep: whether the physics waits for commands
    :ivar imu_topics: topics of IMUs, by name of the sensor
    :ivar rates_hz: of the sensors that measure less often than joint states come, by name [Hz]
    """

    interfaces: Mapping[str, str]
    states_topic: str = '/robot_joint_states'
    commands_topic: str = '/robot_joint_commands'
    plugin: str = TOPIC_PLUGIN
    node: str = '/manip_sim'
    mode_parameters: Mapping[str, str] = field(default_factory=dict)
    wrench_topics: Mapping[str, str] = field(default_factory=dict)
    lockstep: bool = False
    imu_topics: Mapping[str, str] = field(default_factory=dict)
    rates_hz: Mapping[str, float] = field(default_factory=dict)


def add_hardware(robot: ElementTree.Element, hardware: Hardware, joints: Sequence[str],
                 mimics: Sequence[str]) -> None:
    """
    Add the tag to a URDF: joints with commands first, as the hardware requires, then the others.

    Mimic joints have no command interface, because ros2_control rejects that. With the second
    plugin the joints of a part have the interfaces of all modes, of which controllers claim one.

    :param joints: names of all scalar joints
    :param mimics: names of those that follow another one
    """
    tag = ElementTree.SubElement(robot, 'ros2_control', name=robot.get('name', ''), type='system')
    system = ElementTree.SubElement(tag, 'hardware')
    ElementTree.SubElement(system, 'plugin').text = hardware.plugin
    is_own_plugin = hardware.plugin == OWN_PLUGIN
    parameters = {'joint_states_topic': hardware.states_topic,
                  'joint_commands_topic': hardware.commands_topic}
    if is_own_plugin:
        parameters |= {'node': hardware.node, 'lockstep': str(hardware.lockstep).lower()}
    else:
        parameters['trigger_joint_command_threshold'] = _ALWAYS
    for name, value in parameters.items():
        ElementTree.SubElement(system, 'param', name=name).text = value
    driven = [name for name in joints if name in hardware.interfaces and name not in mimics]
    for name in [*driven, *(name for name in joints if name not in driven)]:
        joint = ElementTree.SubElement(tag, 'joint', name=name)
        parameter = hardware.mode_parameters.get(name) if is_own_plugin else None
        if name in driven:
            if parameter is not None:
                ElementTree.SubElement(joint, 'param', name='mode_parameter').text = parameter
            for command in _STATES if parameter else [hardware.interfaces[name]]:
                ElementTree.SubElement(joint, 'command_interface', name=command)
        for state in _STATES:
            ElementTree.SubElement(joint, 'state_interface', name=state)
    for topics, interfaces in ((hardware.wrench_topics, _WRENCH), (hardware.imu_topics, _IMU)):
        for name, topic in topics.items() if is_own_plugin else ():
            sensor = ElementTree.SubElement(tag, 'sensor', name=name)
            ElementTree.SubElement(sensor, 'param', name='topic').text = topic
            if name in hardware.rates_hz:
                rate = repr(float(hardware.rates_hz[name]))
                ElementTree.SubElement(sensor, 'param', name='rate').text = rate
            for interface in interfaces:
                ElementTree.SubElement(sensor, 'state_interface', name=interface)


@dataclass(frozen=True)
class Mimic:
    """
    Coupling of a joint to another one.

    :ivar leader: id of a joint that follows none
    """

    leader: int
    multiplier: float
    offset: float


@dataclass(frozen=True)
class _Coupling:
    follower: int
    leader: int
    multiplier: float
    offset: float
    linear: bool

    def seen_from(self, joint: int, mimic: Mimic) -> tuple[int, Mimic]:
        """Return the other joint, and how it follows the leader that the given joint follows."""
        if joint == self.leader:
            return self.follower, Mimic(mimic.leader, self.multiplier * mimic.multiplier,
                                        self.multiplier * mimic.offset + self.offset)
        return self.leader, Mimic(mimic.leader, mimic.multiplier / self.multiplier,
                                  (mimic.offset - self.offset) / self.multiplier)


def find_mimics(model: mujoco.MjModel, joints: Collection[int], actuated: Iterable[int]
                ) -> tuple[dict[int, Mimic], list[str]]:
    """
    Return the linear couplings among some joints, from the active equality constraints.

    Of coupled joints one leads and all others follow it: the joint with the first actuator or,
    without actuators, one that follows none in the constraints.

    :param joints: ids of scalar joints
    :param actuated: ids of the joints with actuators, in the order of the actuators
    :returns: by id of the joint, and a sentence for each coupling that URDF cannot express
    """
    couplings = [coupling for equality in range(model.neq)
                 if (coupling := _coupling(model, equality)) is not None
                 and coupling.follower in joints and coupling.leader in joints]
    notes = [f'{_name(model, c.follower)} follows {_name(model, c.leader)} by a curve: no mimic'
             for c in couplings if not c.linear]
    linear = [coupling for coupling in couplings if coupling.linear]
    followers = {coupling.follower for coupling in linear}
    candidates = [*actuated, *(c.leader for c in linear if c.leader not in followers), *joints]
    mimics: dict[int, Mimic] = {}
    used: list[_Coupling] = []
    for head in candidates:
        if head not in mimics and head in joints:
            _spread(head, linear, mimics, used)
    notes += [f'{_name(model, c.follower)} follows two joints: one mimic'
              for c in linear if not any(c is other for other in used)]
    return {joint: mimic for joint, mimic in mimics.items() if mimic.leader != joint}, notes


def _spread(head: int, couplings: list[_Coupling], mimics: dict[int, Mimic],
            used: list[_Coupling]) -> None:
    """Record how joints that are coupled to a leader follow it, and the couplings used."""
    mimics[head] = Mimic(head, 1.0, 0.0)
    waiting = [head]
    while waiting:
        joint = waiting.pop(0)
        for coupling in couplings:
            if joint in (coupling.follower, coupling.leader):
                other, mimic = coupling.seen_from(joint, mimics[joint])
                if other not in mimics:
                    mimics[other] = mimic
                    used.append(coupling)
                    waiting.append(other)


def _coupling(model: mujoco.MjModel, equality: int) -> _Coupling | None:
    """Return the active coupling of two joints by an equality, in positions, or None."""
    if (int(model.eq_type[equality]) != int(_EQ.mjEQ_JOINT)
            or not model.eq_active0[equality] or int(model.eq_obj2id[equality]) < 0):
        return None
    follower, leader = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    data = model.eq_data[equality]
    # MuJoCo's polynomial relates the joints' displacements from qpos0.
    zero, leader_zero = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader))
    slope = float(data[1])
    return _Coupling(follower, leader, slope, zero + float(data[0]) - slope * leader_zero,
                     bool(slope) and not data[2:5].any())


def _name(model: mujoco.MjModel, joint: int) -> str:
    return quoted(model.joint(joint).name)


def actuated_joints(model: mujoco.MjModel) -> dict[int, list[tuple[int, float]]]:
    """Return by id of the joint its actuators' ids, and the effort at the joint per force."""
    actuators: dict[int, list[tuple[int, float]]] = {}
    for actuator in range(model.nu):
        gear = float(model.actuator_gear[actuator, 0])
        kind, target = int(model.actuator_trntype[actuator]), model.actuator_trnid[actuator, 0]
        if kind in JOINT_TRANSMISSIONS:
            terms = [(int(target), 1.0)]
        elif kind == _TENDON:
            first = int(model.tendon_adr[target])
            terms = [(int(model.wrap_objid[w]), float(model.wrap_prm[w]))
                     for w in range(first, first + int(model.tendon_num[target]))
                     if int(model.wrap_type[w]) == int(mujoco.mjtWrap.mjWRAP_JOINT)]
        else:
            terms = []
        for joint, coefficient in terms:
            actuators.setdefault(joint, []).append((actuator, abs(gear * coefficient)))
    return actuators


def effort_limit(model: mujoco.MjModel, joint: int, actuators: list[tuple[int, float]]) -> float:
    """
    Return the greatest effort of the actuators at a joint [N m or N]; zero without actuators.

    :param actuators: of the joint, as :func:`actuated_joints` returns them
    """
    effort = sum(_force_limit(model, actuator) * per_force for actuator, per_force in actuators)
    if actuators and model.jnt_actfrclimited[joint]:
        effort = min(effort, float(np.abs(model.jnt_actfrcrange[joint]).max()))
    return effort if np.isfinite(effort) else DEFAULT_EFFORT


def _force_limit(model: mujoco.MjModel, actuator: int) -> float:
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    motor = (int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_NONE)
             and int(model.actuator_gaintype[actuator]) == int(mujoco.mjtGain.mjGAIN_FIXED))
    if motor and model.actuator_ctrllimited[actuator]:
        return float(np.abs(model.actuator_ctrlrange[actuator]).max()
                     * abs(model.actuator_gainprm[actuator, 0]))
    return float(np.inf)


def velocity_limit(model: mujoco.MjModel, joint: int, mimics: Mapping[int, Mimic],
                   actuators: Mapping[int, list[tuple[int, float]]]) -> float:
    """
    Return the velocity limit of a joint [rad/s or m/s].

    It is that of the joint or its velocity servo, or that of what the joint follows.

    :param actuators: as :func:`actuated_joints` returns
    """
    servos = velocity_of_servos(model, [number for number, _ in actuators.get(joint, [])])
    limit = min(float(declared_velocity(model, joint)), float(servos.min(initial=np.inf)))
    if np.isfinite(limit):
        return limit
    if joint in mimics:
        mimic = mimics[joint]
        return abs(mimic.multiplier) * velocity_limit(model, mimic.leader, {}, actuators)
    return DEFAULT_VELOCITY
