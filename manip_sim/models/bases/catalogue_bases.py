# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""The bases of the catalogue; their numbers are in ``assets/bases``."""

from __future__ import annotations

from manip_sim.models.bases.robot_base_model import MobileBaseModel, MountModel
from manip_sim.models.catalogue_part import CataloguePart, FromPart


class _CatalogueBase(CataloguePart):
    _kind = 'bases'
    _top_offset = FromPart('top', (0.0, 0.0, 0.0))
    _horizontal_radius = FromPart('radius', 0.0)


class _CatalogueMobileBase(_CatalogueBase, MobileBaseModel, registered=False):
    sideways = FromPart('sideways', True)


class NoActuationBase(_CatalogueMobileBase):
    """A fixed frame without mass or shape, for robots that stand on their own feet."""

    _folder = 'no_actuation_base'


class NullMobileBase(_CatalogueMobileBase):
    """Forward, side and yaw joints without mass, so the robot's root must have mass."""

    _folder = 'null_mobile_base'


class NullMount(_CatalogueBase, MountModel):
    """A frame without mass or shape at the robot's foot, for robots that stand on the floor."""

    _folder = 'null_mount'


class OmronMobileBase(_CatalogueMobileBase):
    """Vehicle that drives forward and sideways, turns, lifts the robot from 0.7 m to 1.04 m."""

    _folder = 'omron_mobile_base'


class PMB2Base(_CatalogueMobileBase):
    """Round vehicle of PAL Robotics that drives forward and turns, 0.29 m to the torso's foot."""

    _folder = 'pmb2_base'


class RethinkMinimalMount(_CatalogueBase, MountModel):
    """Baxter's pedestal, without controller box, 0.862 m from the floor to the robot's foot."""

    _folder = 'rethink_minimal_mount'


class RethinkMount(_CatalogueBase, MountModel):
    """Sawyer's pedestal, with controller box, 0.912 m from the floor to the arm's foot."""

    _folder = 'rethink_mount'
