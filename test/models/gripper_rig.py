# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A test bench: a gripper that points down, on a vertical slide above a table, and a part."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.models.arenas import EmptyArena
from manip_sim.models.grippers import create_gripper
from manip_sim.models.robots import ManipulatorModel
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

from catalogue import colliding_geoms, DATA, support

PERIOD_S = 0.01
CARRIAGE_SPEED = 0.3
PARK_HEIGHT_M = 0.5
PART_MASS_KG = 0.1
FRICTION = [1.0, 0.005, 0.0001]


def cube(edge_m, x_m=0.0, y_m=0.0, yaw=0.0):
    """Return a part that stands on the table, a cube."""
    def add(spec):
        body = spec.worldbody.add_body(name='part', pos=[x_m, y_m, edge_m / 2.0],
                                       quat=[np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])
        body.add_freejoint()
        body.add_geom(name='part', type=mujoco.mjtGeom.mjGEOM_BOX, size=[edge_m / 2.0] * 3,
                      mass=PART_MASS_KG, friction=FRICTION)
    return add


def plate(width_m, position_m, yaw):
    """Return a part in the air without weight, 2 cm high and deep."""
    def add(spec):
        body = spec.worldbody.add_body(name='part', pos=position_m, gravcomp=1.0,
                                       quat=[np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)])
        body.add_freejoint()
        body.add_geom(name='part', type=mujoco.mjtGeom.mjGEOM_BOX, mass=PART_MASS_KG,
                      size=[width_m / 2.0, 0.01, 0.01], friction=FRICTION)
    return add


def cylinder(diameter_m, length_m, position_m, axis):
    """Return a part in the air, a cylinder."""
    def add(spec):
        quat_wxyz = np.empty(4)
        mujoco.mju_quatZ2Vec(quat_wxyz, np.asarray(axis, dtype=float))
        body = spec.worldbody.add_body(name='part', pos=position_m, quat=quat_wxyz)
        body.add_freejoint()
        body.add_geom(name='part', type=mujoco.mjtGeom.mjGEOM_CYLINDER, mass=PART_MASS_KG,
                      size=[diameter_m / 2.0, length_m / 2.0, 0.0], friction=FRICTION)
    return add


class Carriage(ManipulatorModel, registered=False):
    """An arm of one vertical slide."""

    arm_type = 'single'
    default_gripper = {'right': None}
    default_base = None
    default_controller_config = {}
    base_xpos_offset = {}

    @property
    def init_qpos(self):
        """The slide high above the table [m], shape (1,)."""
        return np.array([PARK_HEIGHT_M])


class GripperRig:
    """
    A gripper on a carriage that moves up and down, in a simulation as the node runs it.

    :param name: name of a gripper
    :param part: adds a part to the ``mujoco.MjSpec``, such as :func:`cube` returns
    :param mount_quat_wxyz: how the gripper hangs on the carriage, by default upside down
    """

    def __init__(self, name, part=None, mount_quat_wxyz=(0.0, 1.0, 0.0, 0.0)):
        robot, arena = Carriage(DATA / 'carriage.xml'), EmptyArena()
        robot.spec.body('right_hand').quat = mount_quat_wxyz
        robot.add_gripper(create_gripper(name))
        if part is not None:
            part(arena.spec)
        self.gripper = robot.grippers['right']
        self.simulation = Simulation(World([robot], arena))
        self.model, self.data = self.simulation.model, self.simulation.data
        self.fingers = self.simulation.robot.grippers['right/gripper']
        self.height_m, self.action = PARK_HEIGHT_M, None
        self._geoms = {role: [self.model.geom(geom).id for geom in geoms]
                       for role, geoms in self.gripper.important_geoms.items()}
        own = {self.model.body(name).id for name in self.gripper.bodies}
        self._colliding = [(geom, self.model.geom_bodyid[geom])
                           for geom in colliding_geoms(self.model)
                           if self.model.geom_bodyid[geom] in own]

    def apply(self, action):
        """
        Start an action, if it is not the present one.

        :param action: one number for all fingers, or one for each of the gripper's dof
        """
        if self.action is None or not np.array_equal(action, self.action):
            self.action = np.array(action)
            self.simulation.robot.apply(self.simulation.robot.parse.action(
                'right/gripper', np.broadcast_to(self.action, (self.gripper.dof,))))

    def command(self, positions):
        """Command finger joints, by name [rad or m]."""
        self.action = None
        self.simulation.robot.apply(*self.simulation.robot.parse.joint_command(
            list(positions), list(positions.values()), [], []))

    def advance(self, action, duration_s):
        """Let an action last for some time."""
        self.apply(action)
        self.wait(duration_s)

    def wait(self, duration_s):
        """Let time go by."""
        for _ in range(round(duration_s / PERIOD_S)):
            self.simulation.advance(round(PERIOD_S / self.simulation.timestep_s))

    def actuate(self, action, limit_s=15.0, settle_s=0.5):
        """Apply an action until nothing is left to be done, then let things settle."""
        self.advance(action, PERIOD_S)
        for _ in range(round(limit_s / PERIOD_S)):
            if not self.fingers.moving:
                break
            self.advance(action, PERIOD_S)
        self.advance(action, settle_s)

    def move(self, height_m, action):
        """Move the carriage, applying an action meanwhile."""
        self.simulation.robot.apply(*self.simulation.robot.parse.joint_command(
            ['robot0_carriage'], [height_m], [], []))
        duration_s = abs(height_m - self.height_m) / CARRIAGE_SPEED + 0.3
        self.height_m = height_m
        self.advance(action, duration_s)

    def carriage_height(self):
        """Return how high the carriage is [m]."""
        return self.data.joint('robot0_carriage').qpos[0]

    def deepest_contact(self):
        """Return how deep the gripper and something else are in each other at the most [m]."""
        bodies = {self.model.body(name).id for name in self.gripper.bodies}
        return max([-contact.dist for contact in self.data.contact
                    if bodies & set(self.model.geom_bodyid[contact.geom])], default=0.0)

    def geoms(self, role):
        """Return the ids of the gripper's geoms of a role, such as ``left_fingerpad``."""
        return self._geoms[role]

    def pad_gap(self):
        """Return how far the pads of both sides are apart [m]."""
        mujoco.mj_kinematics(self.model, self.data)
        return min(mujoco.mj_geomDistance(self.model, self.data, left, right, 1.0, None)
                   for left in self.geoms('left_fingerpad')
                   for right in self.geoms('right_fingerpad'))

    def pads(self):
        """Return the middles of the left and the right pads in the world [m], shape (2, 3)."""
        return np.array([self.data.geom_xpos[self.geoms(f'{side}_fingerpad')].mean(axis=0)
                         for side in ('left', 'right')])

    def lowest_point(self):
        """Return the height of the gripper's lowest collision shape [m]."""
        heights = []
        for geom, body in self._colliding:
            down = -self.data.xmat[body].reshape(3, 3)[2]
            heights.append(self.data.xpos[body, 2] - support(self.model, geom, down))
        return min(heights)

    def force_on_part(self, role):
        """Return the force that the bodies of a role's geoms exert on the part [N], shape (3,)."""
        bodies = {int(self.model.geom_bodyid[geom]) for geom in self.geoms(role)}
        part, total = self.model.geom('part').id, np.zeros(3)
        for index, contact in enumerate(self.data.contact):
            pair = [contact.geom1, contact.geom2]
            if part not in pair:
                continue
            other = pair[1 - pair.index(part)]
            if int(self.model.geom_bodyid[other]) not in bodies:
                continue
            wrench = np.zeros(6)
            mujoco.mj_contactForce(self.model, self.data, index, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += force if pair[1] == part else -force
        return total
