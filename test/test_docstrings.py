# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Docstrings of what is exported describe each argument; their form is checked by ruff."""

import importlib
import inspect
import pkgutil
import re

import manip_sim


def exported():
    """Yield what the packages export, by the name of its module and its own."""
    for module in pkgutil.walk_packages(manip_sim.__path__, 'manip_sim.'):
        # The packages of the node need ROS.
        if module.ispkg and not module.name.startswith(('manip_sim.ros', 'manip_sim.viewer')):
            package = importlib.import_module(module.name)
            for name in getattr(package, '__all__', ()):
                value = getattr(package, name)
                if getattr(value, '__module__', '').startswith('manip_sim'):
                    yield f'{value.__module__}.{name}', value


def functions():
    """Yield the functions that are exported and the methods, with the docstring that counts."""
    for name, value in exported():
        if inspect.isfunction(value):
            yield name, value, inspect.getdoc(value)
        elif inspect.isclass(value):
            for owner in value.__mro__:
                if owner.__module__.startswith('manip_sim'):
                    yield from methods(owner)


def methods(owner):
    name = f'{owner.__module__}.{owner.__name__}'
    if '__init__' in vars(owner):
        yield name, owner.__init__, inspect.getdoc(owner)
    for method in (m for m in vars(owner) if not m.startswith('_')):
        found = getattr(owner, method)
        if inspect.isfunction(found) or inspect.ismethod(found):
            yield f'{name}.{method}', found, inspect.getdoc(found)


def test_every_argument_of_what_is_exported_is_described():
    # Fields of a dataclass are its instance variables.
    missing = {name: left for name, function, doc in functions()
               if (left := [argument for argument in inspect.signature(function).parameters
                            if argument != 'self' and not argument.startswith('_')
                            and not re.search(rf':(param|ivar) {argument}:', doc or '')])}
    assert missing == {}


def test_there_are_functions_to_look_at():
    names = {name.removeprefix('manip_sim.') for name, _, _ in functions()}
    assert len(names) > 100
    assert {'models.composing.compose', 'models.robots.robot_model.RobotModel.set_joint_attribute',
            'models.robots.robot_model.RobotModel.add_base',
            'simulation.robot.SimulatedRobot.apply'} <= names
