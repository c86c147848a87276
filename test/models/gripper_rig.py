# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""A test bench: a gripper that points down, on a vertical slide above a table, and a part."""

from __future__ import annotations

import mujoco
import numpy as np

from manip_sim.models.grippers import create_gripper

from catalogue import colliding_geoms, support

ACTION_RATE_HZ = 20
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


class GripperRig:
    """
    A gripper on a carriage that a servo moves up and down.

    Actions go through ``format_action`` at 20 Hz; commands then move no faster than the joints'
    velocity limits, as on the real gripper. The simulation does so with joint commands only: there
    the time of an action is that of ``speed`` alone.

    :param name: name of a gripper
    :param part: adds a part to the ``mujoco.MjSpec``, such as :func:`cube` returns
    :param mount_quat_wxyz: how the gripper hangs on the carriage, by default upside down
    """

    def __init__(self, name, part=None, mount_quat_wxyz=(0.0, 1.0, 0.0, 0.0)):
        self.gripper = create_gripper(name)
        self.model = self._compile(part, mount_quat_wxyz)
        self.data = mujoco.MjData(self.model)
        self.lift = self.model.actuator('carriage').id
        self.ids = np.array([self.model.actuator(a).id for a in self.gripper.actuators])
        self.range = self.model.actuator_ctrlrange[self.ids]
        self.reach = self._velocity_limit() * PERIOD_S
        self.periods = 0
        self.carriage_goal = self.data.ctrl[self.lift] = PARK_HEIGHT_M
        self.data.joint('carriage').qpos = PARK_HEIGHT_M
        start = self.gripper.init_qpos
        for joint, position in zip(self.gripper.joints, [] if start is None else start):
            self.data.joint(joint).qpos = position
        self.goal = np.clip(self._driven_positions(), *self.range.T)
        self.data.ctrl[self.ids] = self.goal
        mujoco.mj_forward(self.model, self.data)

    def _compile(self, part, mount_quat_wxyz):
        spec = mujoco.MjSpec()
        spec.option.timestep = 0.002
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = 10.0
        spec.worldbody.add_geom(name='table', type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
        carriage = spec.worldbody.add_body(name='carriage', mass=1.0, inertia=[0.01] * 3)
        carriage.add_joint(name='carriage', type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        self.gripper.attach_to(spec, carriage.add_frame(quat=mount_quat_wxyz))
        servo = spec.add_actuator(name='carriage', target='carriage',
                                  trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=20000.0, kv=400.0)
        if part is not None:
            part(spec)
        return spec.compile()

    def _velocity_limit(self):
        joints = self.model.actuator_trnid[self.ids, 0]
        if not self.model.nuser_jnt:
            return np.full(len(self.ids), np.inf)
        limit = self.model.jnt_user[joints, 0]
        return np.where(limit > 0.0, limit, np.inf)

    def _driven_positions(self):
        joints = self.model.actuator_trnid[self.ids, 0]
        return self.data.qpos[self.model.jnt_qposadr[joints]]

    def advance(self, action, duration_s):
        """
        Apply an action for some time.

        :param action: one number for all fingers, or one for each of the gripper's dof
        """
        action = np.broadcast_to(np.asarray(action, dtype=float), (self.gripper.dof,))
        for _ in range(round(duration_s / PERIOD_S)):
            if self.periods % round(1.0 / (ACTION_RATE_HZ * PERIOD_S)) == 0:
                out = np.clip(self.gripper.format_action(action), -1.0, 1.0)
                low, high = self.range.T
                self.goal = (low + high) / 2.0 + (high - low) / 2.0 * out
            self.periods += 1
            ctrl = self.data.ctrl
            ctrl[self.ids] += np.clip(self.goal - ctrl[self.ids], -self.reach, self.reach)
            step = CARRIAGE_SPEED * PERIOD_S
            ctrl[self.lift] += np.clip(self.carriage_goal - ctrl[self.lift], -step, step)
            mujoco.mj_step(self.model, self.data,
                           round(PERIOD_S / self.model.opt.timestep))

    def actuate(self, action, limit_s=15.0, settle_s=0.5):
        """Apply an action until the commands do not change any more, then let things settle."""
        last, unchanged = None, 0
        for _ in range(round(limit_s * ACTION_RATE_HZ)):
            self.advance(action, 1.0 / ACTION_RATE_HZ)
            now = self.data.ctrl[self.ids].copy()
            unchanged = unchanged + 1 if last is not None and np.array_equal(now, last) else 0
            if unchanged >= 3:
                break
            last = now
        self.advance(action, settle_s)

    def move(self, height_m, action):
        """Move the carriage, applying an action meanwhile."""
        self.carriage_goal = height_m
        distance = abs(height_m - self.data.ctrl[self.lift])
        self.advance(action, distance / CARRIAGE_SPEED + 0.3)

    def geoms(self, role):
        """Return the ids of the gripper's geoms of a role, such as ``left_fingerpad``."""
        return [self.model.geom(geom).id for geom in self.gripper.important_geoms[role]]

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
        for geom in colliding_geoms(self.model):
            body = self.model.geom_bodyid[geom]
            if self.model.body(body).name not in self.gripper.bodies:
                continue
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
