# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Bases: what a robot stands on. Every module here is imported, which registers its bases."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

from manip_sim.models.mjcf import CatalogueModel, FromYaml, MujocoXMLModel
from manip_sim.models.registry import import_submodules, Registry


class RobotBaseModel(MujocoXMLModel):
    """
    A base of a robot; a subclass of one of the kinds below declares its offsets.

    :attr:`bottom_offset`, the position of the root body in the file, is the position of the floor
    in the frame of the base; the robot stands at :attr:`top_offset`.
    """

    #: The subsystem of joints whose names contain no keyword.
    subsystem_of_others = 'arm'


BASES: Registry[RobotBaseModel] = Registry('base', RobotBaseModel)
RobotBaseModel.registry = BASES


class MountModel(RobotBaseModel, registered=False):
    """
    A mount without joints; it is attached below the robot's root body.

    Prefix ``fixed_mount{idn}_``.
    """

    _prefix_word = 'fixed_mount'


class MobileBaseModel(RobotBaseModel, registered=False):
    """
    A base that may have joints and carries the robot on its body ``support``.

    Prefix ``mobilebase{idn}_``.
    """

    _prefix_word = 'mobilebase'
    subsystem_of_others = 'base'
    #: The body that the robot is mounted on.
    support_body = 'support'
    #: True if it drives sideways; else twists along y are clamped to zero.
    sideways: bool = True


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


import_submodules(__name__, __path__)


def base_names() -> list[str]:
    """Return the names that :func:`create_base` takes, also those in the user's folders."""
    return BASES.all_names()


def create_base(name: str | PathLike[str], idn: int | str = 0) -> RobotBaseModel:
    """
    Create a base by its name, that of its class or of an entry point, or from a file.

    :param name: of the catalogue, or what ``manip_sim.models.registry.find_source`` takes
    :param idn: number or word in the prefix
    :raises UnknownNameError: if the base is unknown, naming the nearest ones
    :raises ModelError: if a file cannot be used, or the base of another package cannot be imported
    """
    return BASES.create_or_load(name, idn=idn)


if not TYPE_CHECKING:
    def __getattr__(name: str) -> type[RobotBaseModel]:
        return BASES.attribute(__name__, name)


__all__ = [
    'MobileBaseModel', 'MountModel', 'NoActuationBase', 'NullMobileBase', 'NullMount',
    'OmronMobileBase', 'PMB2Base', 'RethinkMinimalMount', 'RethinkMount',
    'RobotBaseModel', 'base_names', 'create_base']
