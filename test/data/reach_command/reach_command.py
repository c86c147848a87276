# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""``manip_sim reach``: the box that end effectors can reach, from random postures."""

import mujoco
import numpy as np

from manip_sim.cli.command_line import add_composition
from manip_sim.cli.composing_options import compose_from
from manip_sim.cli.offered_verbs import Verb
from manip_sim.simulation import Simulation


class Reach(Verb):
    """Print the least and greatest position of each grip_site over random postures."""

    summary = 'print the box that the end effectors reach'

    def add_arguments(self, parser):
        parser.add_argument('--samples', type=int, default=1000, metavar='N',
                            help='number of postures (default: 1000)')
        add_composition(parser)

    def run(self, options):
        simulation = Simulation(compose_from(options).composition.world)
        model, data = simulation.model, simulation.data
        random, hinges = np.random.default_rng(0), model.jnt_limited.astype(bool)
        addresses, (low, high) = model.jnt_qposadr[hinges], model.jnt_range[hinges].T
        sites = [reader.grip_site for robot in simulation.robots.values()
                 for reader in robot.end_effectors.values()]
        places = np.empty((options.samples, len(sites), 3))
        for place in places:
            data.qpos[addresses] = random.uniform(low, high)
            mujoco.mj_kinematics(model, data)
            place[:] = [data.site(site).xpos for site in sites]
        lines = [f'{site}: {np.round(places[:, i].min(axis=0), 2)} to '
                 f'{np.round(places[:, i].max(axis=0), 2)} m' for i, site in enumerate(sites)]
        return '\n'.join(lines), 0
