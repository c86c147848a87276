# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Docstrings describe arguments that are there, and all of what is exported."""

import ast
import importlib
import inspect
from pathlib import Path
import pkgutil
import re

import manip_sim
import pytest


SOURCES = sorted((Path(__file__).resolve().parents[1] / 'manip_sim').rglob('*.py'))


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


def arguments_of(node):
    """Return the names of the arguments of a function, or of what makes an object of a class."""
    if isinstance(node, ast.ClassDef):
        own = [part for part in node.body if getattr(part, 'name', '') == '__init__']
        return arguments_of(own[0]) if own else {
            part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
    found = node.args
    return {arg.arg for arg in (*found.posonlyargs, *found.args, *found.kwonlyargs,
                                *filter(None, (found.vararg, found.kwarg)))}


def described(path):
    """Yield the name of what has a docstring, the arguments that it describes, and all it has."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names, there = re.findall(
                r':param (\w+):', ast.get_docstring(node) or ''), arguments_of(node)
            # A class without any has those of its base.
            if names and (there or isinstance(node, ast.FunctionDef)):
                yield f'{path.stem}.{node.name}', set(names), there


@pytest.mark.full
def test_every_argument_that_is_described_is_there_in_all_modules():
    found = [entry for path in SOURCES for entry in described(path)]
    assert len(found) > 500
    assert {name: gone for name, names, there in found if (gone := names - there)} == {}


def test_there_are_functions_to_look_at():
    names = {name.removeprefix('manip_sim.') for name, _, _ in functions()}
    assert len(names) > 100
    assert {'models.world.compose', 'models.robots.robot_model.RobotModel.set_joint_attribute',
            'models.robots.robot_model.RobotModel.add_base',
            'simulation.robot.SimulatedRobot.apply'} <= names


_CLAUSE = re.compile(r'(What|How|Whether|Which|Where|When|Why|Who)\b')


def test_a_docstring_begins_with_a_verb_or_a_noun():
    begun = {f'{path.name}: {doc.splitlines()[0]}' for path in SOURCES
             for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
             and _CLAUSE.match(doc := ast.get_docstring(node) or '')}
    assert begun == set()
