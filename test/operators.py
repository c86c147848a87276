# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Commands in a few words, for tests of what becomes of them."""


class Operator:
    """
    Commands a simulation and lets it run in periods of 10 ms.

    :ivar simulation: that is commanded
    """

    def __init__(self, simulation):
        self.simulation = simulation

    def joints_of(self, part):
        """Return the names of a part's driven joints."""
        return list(self.simulation.robot.parts[part].driven_joints)

    def where(self, *joints):
        """Return where joints are [rad or m]."""
        return [float(self.simulation.data.joint(joint).qpos[0]) for joint in joints]

    def speed(self, joint):
        """Return how fast a joint moves [rad/s or m/s]."""
        return float(self.simulation.data.joint(joint).qvel[0])

    def go(self, joints, mode='position', **parse):
        """Apply goals by joint in a mode; return the handles."""
        commands = self.simulation.robot.parse.joint_command(
            list(joints), **{mode: list(joints.values())}, **parse)
        self.simulation.robot.apply(*commands, period_s=0.01)
        return [command.handle for command in commands]

    def follow(self, part, joints, times_s, positions, *derivatives, start_ns=0):
        """Apply a trajectory; return the command."""
        command = self.simulation.robot.parse.trajectory(
            part, joints, times_s, positions, *derivatives, start_ns=start_ns,
            now_ns=self.simulation.time_ns)
        self.simulation.robot.apply(command, period_s=0.01)
        return command

    def run(self, seconds, each_period=None):
        """Advance; call a function after each period."""
        for _ in range(round(seconds * 100)):
            self.simulation.advance(5)
            if each_period is not None:
                each_period()
