# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Contact forces and grasps of grippers: press, drag, hold and shake, as a table.

    python3 benchmark/contact.py [--topics] [NAME ...]

Each gripper is mounted on a Panda at a table, hands with five fingers on a GR1; each robot has its
own gripper. With ``--topics`` a client of a node in lock-step presses, see ``pressing.py``.

- touch: an admittance controller of 100 Hz lowers the gripper at 20 mm/s until it touches, and
  presses with 5 or 10 N: the greatest force in a step, wherever in a period the touch falls.
- press: then it slides at 30 mm/s: the greatest error of ``external_wrench`` from 1.5 s after the
  touch and after the start of sliding on.
- drag: in effort mode, the target so far below the table that the gripper presses with 8 N, along
  x and y, to and fro, at 5, 20 and 50 mm/s: the share of steps without contact at the worst, and
  where; the friction at the most.
- hold: a cube of 80 % of the payload: how far it creeps in the gripper in a minute, from four
  seconds. Grippers that hold by closing around things hold a cylinder.
- shake: 2 Hz by 5 mm for 2 s, so 0.8 m/s^2: how far it is from where it was in the gripper.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import sys
from typing import Any

import mujoco
import numpy as np

from manip_sim.control.law import stepping
from manip_sim.errors import describe_choices
from manip_sim.models import compose
from manip_sim.models.arenas import TableArena
from manip_sim.models.grippers import gripper_names
from manip_sim.simulation import Simulation

TIMESTEP_S, STEPS = 0.002, 5
PERIOD_S = TIMESTEP_S * STEPS
#: Payload of each gripper [kg], and the edge of the cube [m]; the load is 80 % of it. Where it
#: says so, the figure of the maker could not be checked.
PAYLOADS = {
    # The arm's payload, as Franka Emika states it for the Panda.
    'PandaGripper': (3.0, 0.04),
    # 5 lb: Machine Design, "Baxter: A robot for the rest of us", 16 October 2012.
    'RethinkGripper': (2.3, 0.04),
    # Not checked: 5 kg, 2.5 kg and, with the fingertips, 2.5 kg in Robotiq's manuals.
    'Robotiq85Gripper': (5.0, 0.05), 'Robotiq140Gripper': (2.5, 0.05),
    'RobotiqThreeFingerGripper': (2.5, 0.06), 'RobotiqThreeFingerDexterousGripper': (2.5, 0.06),
    # Not checked: the arm's payload, 1.6 kg in Kinova's data sheet of the Jaco.
    'JacoThreeFingerGripper': (1.6, 0.05), 'JacoThreeFingerDexterousGripper': (1.6, 0.05),
    # Not checked: 2 kg in PAL Robotics' sheet of the TIAGo's gripper. SO-101: no maker's figure.
    'PalGripper': (2.0, 0.04), 'SO101Gripper': (0.3, 0.03)}
#: Robots that are measured with their own grippers; Panda and GR1 are with those that they carry.
ROBOTS = ['UR5e', 'IIWA', 'Sawyer', 'Kinova3', 'Jaco', 'Baxter']
#: Grippers that press through topics: the plainest, and that whose fingers give most.
TOPIC_GRIPPERS = ('PandaGripper', 'JacoThreeFingerGripper')
DIRECTIONS = {'x': (1.0, 0.0), '-x': (-1.0, 0.0), 'y': (0.0, 1.0), '-y': (0.0, -1.0)}


class Bench:
    """
    A gripper on a robot.

    :param name: of a gripper, or of a robot that has its own
    :param arena: where
    :param objects: descriptions of objects
    """

    def __init__(self, name, arena=None, objects=()):
        five_fingers = name.startswith('Fourier')
        self.arm = 'left' if name == 'FourierLeftHand' else 'right'
        robot, gripper = ((name, 'default') if name in ROBOTS else
                          ('GR1' if five_fingers else 'Panda', {self.arm: name}))
        # Nothing else may touch the table.
        table = TableArena(cube=False, table_height_m=1.04 if five_fingers else 0.8)
        self.simulation = Simulation(compose(robot, gripper, arena=arena or table,
                                             timestep_s=TIMESTEP_S, objects=objects))
        self.robot = self.simulation.robot
        self.model, self.data = self.simulation.model, self.simulation.data
        self.reader = self.robot.end_effectors[self.arm]
        self.site = self.data.site(self.reader.grip_site)
        body = self.model.geom_bodyid
        tool = range(self.model.nbody)[self.reader.external.bodies]
        self.geoms = [geom for geom in range(self.model.ngeom)
                      if body[geom] in tool and self.model.geom_contype[geom]]
        pose = self.pose()
        self.position, self.quat_xyzw = pose.position, pose.quat_xyzw

    def pose(self):
        """Return where the gripper is."""
        return self.robot.state().end_effectors[self.arm].pose

    def actuate(self, action):
        """Open (-1) or close (+1) the gripper."""
        part = f'{self.arm}/gripper'
        gripper = self.robot.grippers.get(part)
        if gripper is None or gripper.part.gripper is None or not gripper.part.gripper.dof:
            return
        dof = gripper.part.gripper.dof
        self.robot.apply(self.robot.parse.action(part, np.full(dof, action)))
        for _ in range(round(15.0 / PERIOD_S)):
            self.simulation.advance(STEPS)
            if not gripper.moving:
                break
        self.wait(0.5)

    def wait(self, seconds):
        """Let time go by."""
        for _ in range(round(seconds / PERIOD_S)):
            self.simulation.advance(STEPS)

    def go(self, position):
        """Command the position of the gripper, as it is turned at the start."""
        self.robot.apply(self.robot.parse_cartesian.pose(
            self.arm, list(position), list(self.quat_xyzw)), period_s=PERIOD_S)

    def move(self, along, rise, steps):
        """Let the gripper move along y and z [m/s] for a control period."""
        self.robot.apply(self.robot.parse_cartesian.twist(
            self.arm, [0.0, along, rise], [0.0, 0.0, 0.0]), period_s=steps * TIMESTEP_S)
        self.simulation.advance(steps)

    def gap(self):
        """Return how far the gripper is above the table [m]."""
        table, points = self.model.geom('table_collision').id, np.zeros(6)
        return min(mujoco.mj_geomDistance(self.model, self.data, geom, table, 1.0, points)
                   for geom in self.geoms)

    def approach(self, height_m):
        """Close the gripper and bring it above the table."""
        self.actuate(1.0)
        for _ in range(2):
            self.position = self.position - [0.0, 0.0, self.gap() - height_m]
            self.go(self.position)
            self.wait(1.5)

    def touch(self):
        """Return normal force and friction on the table now [N]."""
        table, force = self.model.geom('table_collision').id, np.zeros(6)
        normal = friction = 0.0
        for index, contact in enumerate(self.data.contact):
            if table in (contact.geom1, contact.geom2):
                mujoco.mj_contactForce(self.model, self.data, index, force)
                normal, friction = normal + force[0], friction + math.hypot(*force[1:3])
        return normal, friction

    def pushed_up(self):
        """Return the vertical component of the published external force [N]."""
        frame = self.data.site(self.reader.ft_frame).xmat.reshape(3, 3)
        return frame[2] @ self.reader.external_wrench(self.data)[:3]


class Admittance:
    """
    Lets a gripper move down as fast as the force that is missing says.

    :param force_n: wanted [N]
    :param period_s: of the controller [s]
    :param damping: of its law [N s/m]
    """

    def __init__(self, force_n: float, period_s: float, damping: float = 2500.0) -> None:
        self._force_n, self._damping = force_n, damping
        # The law of a mass of 10 kg, exactly for a force that holds for a period.
        self._gain = -math.expm1(-damping / 10.0 * period_s)
        self.speed, self.touched = 0.0, False

    def velocity(self, measured_n: float) -> float:
        """Return how fast the gripper shall rise [m/s]."""
        self.touched = self.touched or measured_n > 0.1
        if self.touched:
            wanted = (self._force_n - measured_n) / self._damping
            self.speed += self._gain * (wanted - self.speed)
        else:
            self.speed = 0.02
        self.speed = min(max(self.speed, -0.05), 0.02)
        return -self.speed


def touch_down(name, force_n=10.0):
    """Return the greatest force in a step, wherever in a control period the touch falls [N]."""
    bench = Bench(name)
    bench.approach(0.01)
    forces = [0.0]
    record, may_step = bench.reader.external.record, stepping.may_step

    def record_and_look():
        record()
        forces.append(bench.touch()[0])
    # That is called in each step with contact, if Python runs the steps.
    monitor: Any = bench.reader.external
    monitor.record, stepping.may_step = record_and_look, lambda data: False
    for part in range(4):
        bench.go(bench.position + [0.0, 0.0, 0.02 * PERIOD_S * part / 4.0])
        bench.wait(1.0)
        controller, since = Admittance(force_n, PERIOD_S), 0
        while since < 30:
            bench.move(0.0, controller.velocity(bench.pushed_up()), STEPS)
            since += controller.touched
    stepping.may_step = may_step
    return max(forces)


def press(name, force_n=10.0, rate_hz=100.0, slide=0.03, seconds=3.0, settle=1.5):
    """Return the greatest errors still and sliding [N]."""
    bench = Bench(name)
    bench.approach(0.01)
    steps = round(1.0 / rate_hz / TIMESTEP_S)
    controller = Admittance(force_n, steps * TIMESTEP_S)
    count = round(seconds * rate_hz)
    measured: list[float] = []
    for _ in range(round(10.0 * rate_hz)):
        rise = controller.velocity(bench.pushed_up())
        bench.move(slide if len(measured) > count else 0.0, rise, steps)
        if controller.touched:
            measured.append(bench.pushed_up())
    errors = np.abs(np.array(measured) - force_n)
    late = round(settle * rate_hz)
    return errors[late:count].max(), errors[count + late:2 * count].max()


def drag(name, speeds=(0.005, 0.02, 0.05), seconds=0.5):
    """Return the greatest share of steps without contact, where that was, and the friction."""
    bench = Bench(name)
    bench.approach(0.003)
    touching = bench.position - [0.0, 0.0, bench.gap()]
    bench.robot.set_control_mode(bench.arm, 'effort')
    bench.go(touching - [0.0, 0.0, 0.005])
    bench.wait(1.0)
    depth = min(0.005 * 8.0 / max(bench.touch()[0], 0.1), 0.04)
    below = touching - [0.0, 0.0, depth]
    rows = []
    for axis, direction in DIRECTIONS.items():
        for speed in speeds:
            for height in (depth + 0.003, 0.0):
                bench.go(below + [0.0, 0.0, height])
                bench.wait(0.5)
            forces = []
            for period in range(round((0.3 + seconds) / PERIOD_S)):
                way = speed * PERIOD_S * period
                bench.go(below + [way * direction[0], way * direction[1], 0.0])
                for _ in range(STEPS):
                    bench.simulation.advance(1)
                    forces.append(bench.touch())
            normal, friction = np.array(forces)[round(0.3 / TIMESTEP_S):].T
            rows.append((np.mean(normal < 0.05), f'{speed * 1e3:g} mm/s {axis}',
                         friction.sum() / max(normal.sum(), 1e-9)))
    lost, where, _ = max(rows, key=lambda row: row[0])
    return lost, where, max(row[2] for row in rows)


def hold(gripper, seconds=6.0):
    """Return the load [kg], its creep [m/s], and how far it moves when shaken [m]."""
    payload_kg, edge_m = PAYLOADS[gripper]
    load_kg = 0.8 * payload_kg
    bench = Bench(gripper, 'empty', [{'name': 'load', 'shape': 'box', 'size': [edge_m] * 3,
                                      'mass': load_kg, 'position': [2.0, 0.0, 1.0]}])
    bench.actuate(-1.0)
    gravity = bench.model.opt.gravity.copy()
    bench.model.opt.gravity[:] = 0.0
    joint, quat = bench.data.joint('load_joint'), np.empty(4)
    mujoco.mju_mat2Quat(quat, bench.site.xmat)
    joint.qpos[:], joint.qvel[:] = [*bench.site.xpos, *quat], 0.0
    bench.actuate(1.0)
    bench.model.opt.gravity[:] = gravity
    load = bench.data.body('load')

    def in_gripper():
        return bench.site.xmat.reshape(3, 3).T @ (load.xpos - bench.site.xpos)
    bench.wait(4.0)
    begin = in_gripper()
    bench.wait(seconds)
    creep = np.linalg.norm(in_gripper() - begin) / seconds
    if np.linalg.norm(in_gripper()) > 0.1:
        return load_kg, math.nan, math.nan
    begin, there = in_gripper(), bench.pose().position
    for period in range(round(2.0 / PERIOD_S)):
        bench.go(there + [0.0, 0.0, 0.005 * math.sin(4.0 * math.pi * PERIOD_S * period)])
        bench.simulation.advance(STEPS)
    return load_kg, creep, np.linalg.norm(in_gripper() - begin)


def row(name):
    """Return a row of the table."""
    light, peak = touch_down(name, 5.0), touch_down(name, 10.0)
    still, sliding = press(name)
    lost, where, friction = drag(name)
    cells = [f'`{name}`', f'{light:.1f}', f'{peak:.1f}', f'{still:.2f}', f'{sliding:.2f}',
             f'{100.0 * lost:.1f}' + (f' ({where})' if lost else ''), f'{friction:.2f}']
    if name in PAYLOADS:
        load_kg, creep, shaken = hold(name)
        cells += [f'{load_kg:.2f}', f'{creep * 60e3:.4f}', f'{shaken * 1e3:.3f}']
    else:
        cells += ['-', '-', '-']
    return f'| {" | ".join(cells)} |'


HEADER = """\
| gripper or robot | touch, 5 N [N] | touch, 10 N [N] | press, still [N] | press, sliding [N] | no contact [%] | friction | load [kg] | creep [mm/min] | shake [mm] |
|---|---|---|---|---|---|---|---|---|---|"""  # noqa: E501
TOPICS_HEADER = """\
| gripper | force [N] | rate [Hz] | press, still [N] | press, sliding [N] |
|---|---|---|---|---|"""


def press_over_topics():
    """Print a row for each force and rate: a client presses, a node in another process answers."""
    from manip_sim.testing.domains import reserve_domain
    os.environ.update(ROS_DOMAIN_ID=str(reserve_domain()[0]),
                      ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
    import pressing
    import rclpy
    from targets.processes import start_node
    rclpy.init()
    node = rclpy.create_node('pressing')

    def spin_until(condition):
        while not condition():
            rclpy.spin_once(node, timeout_sec=0.1)
    print(TOPICS_HEADER)
    for gripper, force_n, rate_hz in itertools.product(
            TOPIC_GRIPPERS, (5.0, 10.0, 20.0), (100.0, 500.0)):
        parameters = {**pressing.PARAMETERS, 'gripper': gripper, 'publish_rate': rate_hz}
        with start_node(*(f'{name}:={value}' for name, value in parameters.items())):
            still, sliding = pressing.press(node, spin_until, force_n, rate_hz)
        print(f'| `{gripper}` | {force_n:g} | {rate_hz:g} | {still:.2f} | {sliding:.2f} |',
              flush=True)
    rclpy.shutdown()


def main():
    """Measure and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [*(name for name in gripper_names() if name != 'NullGripper'), *ROBOTS]
    parser.add_argument('--topics', action='store_true', help='press through topics instead')
    parser.add_argument('name', nargs='*', metavar='NAME',
                        help=f'grippers, or robots of {", ".join(ROBOTS)} (default: all)')
    options = parser.parse_args()
    if options.topics:
        press_over_topics()
        return 0
    for name in options.name:
        if name not in names:
            print(f"unknown gripper or robot '{name}': {describe_choices(name, names)}",
                  file=sys.stderr)
            return 1
    print(HEADER)
    for name in options.name or names:
        print(row(name), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
