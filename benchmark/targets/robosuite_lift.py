# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Steps of robosuite's Lift per second of CPU time, for each number of seconds that comes as a line.

robosuite and the MuJoCo that it needs are in an environment of their own, without manip_sim.
"""

import sys
import time

import numpy as np
import robosuite

lift = robosuite.make(
    'Lift', robots='Panda', has_renderer=False, has_offscreen_renderer=False,
    use_camera_obs=False, control_freq=20, ignore_done=True)
lift.reset()
lift.step(np.zeros(lift.action_dim))
print('ready', flush=True)
number = 0
for line in sys.stdin:
    begin, first = time.process_time(), number
    while (now := time.process_time()) - begin < float(line):
        lift.step(0.2 * np.sin(0.1 * number + np.arange(lift.action_dim)))
        number += 1
    print((number - first) / (now - begin), flush=True)
