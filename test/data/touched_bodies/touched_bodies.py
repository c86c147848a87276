# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The names of all bodies in contact, on ``~/touched``; published when they change."""

from manip_sim.interface.offered_sensors import TopicSource
from manip_sim.interface.topics import PUBLISHED, Topic


class TouchedBodies(TopicSource):
    """Pairs of bodies that touch, one in a line."""

    topic = Topic('~/touched', 'std_msgs/String', PUBLISHED, 'pairs of bodies that touch',
                  rate='on change', depth=1, latched=True)
    last = None

    def write(self, message, simulation):
        model, geoms = simulation.model, simulation.data.contact.geom
        pairs = {tuple(sorted(model.body(model.geom_bodyid[geom]).name for geom in pair))
                 for pair in geoms}
        message.data = '\n'.join(f'{one} {other}' for one, other in sorted(pairs))
        changed, self.last = message.data != self.last, message.data
        return changed
