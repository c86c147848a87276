# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The bases of the catalogue; their numbers are in ``assets/bases``."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel, MountModel
from manip_sim.models.catalogue_model import CatalogueModel, FromYaml


class _CatalogueBase(CatalogueModel):
    _kind = 'bases'
    _top_offset = FromYaml('top', (0.0, 0.0, 0.0))
    _horizontal_radius = FromYaml('radius', 0.0)


class _CatalogueMobileBase(_CatalogueBase, MobileBaseModel, registered=False):
    sideways = FromYaml('sideways', True)


class NoActuationBase(_CatalogueMobileBase, folder='no_actuation_base'):
    """A fixed frame without mass or shape, for robots that stand on their own feet."""


class NullMobileBase(_CatalogueMobileBase, folder='null_mobile_base'):
    """Forward, side and yaw joints without mass, so the robot's root must have mass."""


class NullMount(_CatalogueBase, MountModel, folder='null_mount'):
    """A frame without mass or shape at the robot's foot, for robots that stand on the floor."""


class OmronMobileBase(_CatalogueMobileBase, folder='omron_mobile_base'):
    """Vehicle that drives forward and sideways, turns, lifts the robot from 0.7 m to 1.04 m."""


class PMB2Base(_CatalogueMobileBase, folder='pmb2_base'):
    """Round vehicle of PAL Robotics that drives forward and turns, 0.29 m to the torso's foot."""


class RethinkMinimalMount(_CatalogueBase, MountModel, folder='rethink_minimal_mount'):
    """Baxter's pedestal, without controller box, 0.862 m from the floor to the robot's foot."""


class RethinkMount(_CatalogueBase, MountModel, folder='rethink_mount'):
    """Sawyer's pedestal, with controller box, 0.912 m from the floor to the arm's foot."""
