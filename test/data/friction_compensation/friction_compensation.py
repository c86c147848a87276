# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Joint impedance that also overcomes the dry friction of the joints."""

import numpy as np

from manip_sim.laws import law


@law(parameters={'stiffness': 300.0, 'damping': 30.0, 'friction': 0.0, 'slowest': 0.01})
def compensated(t, q, v, bias, mass, jacobian, wrench, setpoint, parameters, memory, effort):
    """
    Pull joints to their setpoints as springs with dampers, and add the friction of their motion.

    :param parameters: stiffness [N m/rad], damping [N m s/rad], Coulomb friction [N m], and the
        velocity [rad/s] below which only a part of it is added
    """
    stiffness, damping, friction, slowest = parameters
    for i in range(len(q)):
        effort[i] = (bias[i] + stiffness * (setpoint[i, 0] - q[i])
                     + damping * (setpoint[i, 1] - v[i])
                     + friction * np.tanh(setpoint[i, 1] / slowest))
        for j in range(len(q)):
            effort[i] += mass[i, j] * setpoint[j, 2]
