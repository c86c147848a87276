# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Networks that tests of policies save as TorchScript; they need torch."""

import torch


class OfDictionary(torch.nn.Module):
    """Moves the end effector to the goal of reach; takes observations by key."""

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        way = (seen['goal'] - seen['eef_pose'][:, 0, :3]) / 0.05
        return torch.cat([way.clamp(-1.0, 1.0), torch.zeros(1, 4)], 1)


class OfArray(torch.nn.Module):
    """As the other one; takes eef_pose, eef_twist, external_wrench, goal, joints in one array."""

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        way = (seen[:, 19:22] - seen[:, 0:3]) / 0.05
        return torch.cat([way.clamp(-1.0, 1.0), torch.zeros(1, 4)], 1)


class Draws(torch.nn.Module):
    """As the other one, and adds what the generator of torch draws."""

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        way = (seen[:, 19:22] - seen[:, 0:3]) / 0.05 + 0.2 * torch.randn(1, 3)
        return torch.cat([way.clamp(-1.0, 1.0), torch.zeros(1, 4)], 1)
