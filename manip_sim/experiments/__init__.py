# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Success rates of policies: episodes of many seeds, in processes or on Ray."""

from manip_sim.experiments.experiment import (
    Experiment, parse_seeds, parse_shard, wilson_interval, Worker)
from manip_sim.experiments.run_folder import RunFolder

__all__ = ['Experiment', 'RunFolder', 'Worker', 'parse_seeds', 'parse_shard', 'wilson_interval']
