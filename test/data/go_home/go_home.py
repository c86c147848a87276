# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The service ``~/go_home``: all arms move to their start."""

from std_srvs.srv import Trigger

from manip_sim.errors import ManipSimError
from manip_sim.interface.parameter_spec import ParameterSpec
from manip_sim.ros.feature import Feature


class GoHome(Feature):
    """Moves arms to their start, along splines, within a time."""

    parameters = [ParameterSpec('go_home.duration', 3.0, 'Duration of the motion.', unit='s',
                                live=True, minimum=0.1, maximum=60.0)]

    def __init__(self, context):
        self._context = context
        context.node.create_service(Trigger, '~/go_home', self._answer)

    def _answer(self, request, response):
        try:
            self._context.thread.call(self._go)
            response.success = True
        except ManipSimError as error:
            response.message = str(error)
        return response

    def _go(self):
        simulation = self._context.simulation
        duration_s = self._context.parameters.value('go_home.duration')
        for name, robot in simulation.robots.items():
            if 'arm' in robot.parts:
                joints = robot.parts['arm'].joints
                start = [simulation.start[joint] for joint in joints]
                command = robot.parse.trajectory('arm', joints, [duration_s], [start])
                self._context.thread.submit([command], robot=name)
