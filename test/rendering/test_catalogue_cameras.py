# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What the cameras of the robots see: the fingers and the cube, and the robot or its table."""

import pytest

from manip_sim.models import compose
from manip_sim.models.robots import robot_names
from manip_sim.rendering import OffscreenRenderer
from manip_sim.simulation import Simulation

WIDTH, HEIGHT = 160, 120
#: Of the hidden shapes.
HIDDEN = 5


def eyes(simulation):
    """Return the eye in hand of each arm."""
    arms = list(simulation.robot.robot_model.grippers)
    found = [simulation.model.camera(i).name for i in range(simulation.model.ncam)]
    found = [name for name in found if 'eye_in_' in name]
    return {arm: next(name for name in found if len(arms) == 1 or arm in name) for arm in arms}


def fingers(model, gripper):
    """Return all shapes of the bodies that have the fingers' important shapes."""
    named = [geom for key, geoms in gripper.important_geoms.items() if 'finger' in key
             for geom in geoms]
    bodies = {int(model.geom_bodyid[model.geom(name).id]) for name in named}
    return [geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in bodies]


def seen(renderer, simulation, camera):
    return renderer.render(simulation.data, camera, WIDTH, HEIGHT)


def changed_by(renderer, simulation, camera, geoms):
    """Return how many pixels change when shapes are hidden."""
    before = seen(renderer, simulation, camera).rgb
    groups = simulation.model.geom_group.copy()
    simulation.model.geom_group[geoms] = HIDDEN
    after = seen(renderer, simulation, camera).rgb
    simulation.model.geom_group[:] = groups
    return int((before != after).any(axis=-1).sum())


@pytest.mark.full
@pytest.mark.parametrize('name', robot_names())
def test_every_eye_in_hand_sees_its_fingers_and_the_cube_and_each_view_the_cube(name, gl):
    simulation = Simulation(compose(name, arena='table', cube=True), visual=True)
    model = simulation.model
    renderer = OffscreenRenderer(model, WIDTH, HEIGHT)
    cube = [geom for geom in range(model.ngeom)
            if model.body(int(model.geom_bodyid[geom])).name == 'cube']
    for arm, camera in eyes(simulation).items():
        gripper = simulation.robot.robot_model.grippers[arm]
        assert changed_by(renderer, simulation, camera, fingers(model, gripper)) > 50, camera
        assert changed_by(renderer, simulation, camera, cube) > 50, camera
    prefix = simulation.robot.robot_model.naming_prefix
    of_robot = [geom for geom in range(model.ngeom)
                if model.body(int(model.geom_bodyid[geom])).name.startswith((prefix, 'gripper'))]
    for camera in ('frontview', 'birdview', 'sideview'):
        assert changed_by(renderer, simulation, camera, of_robot) > 80, camera
    model.geom_group[of_robot] = HIDDEN  # A hand may be between a camera and the cube.
    for camera in (f'{prefix}robotview', 'frontview', 'birdview', 'agentview', 'sideview'):
        assert changed_by(renderer, simulation, camera, cube) > 5, camera
    renderer.close()
