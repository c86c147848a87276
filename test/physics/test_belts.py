# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Belts carry parts at the speed that they are commanded, whatever was computed before."""

import numpy as np
import pytest

from manip_sim.errors import CommandError, ModelError
from manip_sim.models import compose
from manip_sim.models.arenas import create_arena
from manip_sim.models.object_creation import create_described, ObjectModel
from manip_sim.physics.object_spawning import plan_with
from manip_sim.simulation import Simulation
from manip_sim.worlds import Worlds

PART = {'name': 'part', 'shape': 'box', 'size': [0.07, 0.07, 0.05], 'mass': 0.2,
        'position': [0.0, 0.3, 0.825]}


def conveyor(**parameters):
    return compose('Panda', 'none', arena=create_arena('conveyor', **parameters), objects=[PART])


@pytest.fixture(scope='module')
def simulation():
    return Simulation(conveyor())


def run(simulation, speed):
    arena = simulation.surroundings.commands['arena']
    arena.command(arena.checked(['belt'], [], [speed], []))


def advance(simulation, periods):
    for _ in range(periods):
        simulation.advance(5)


def velocity(simulation, body='part', periods=50):
    """Return the mean velocity of a body in some periods [m/s], shape (3,)."""
    before = simulation.data.body(body).xpos.copy()
    advance(simulation, periods)
    return (simulation.data.body(body).xpos - before) / (0.01 * periods)


def test_a_part_rides_at_the_speed_of_the_belt_within_a_hundredth(simulation):
    simulation.reset()
    advance(simulation, 50)
    joint = simulation.surroundings
    for speed in (0.1, 0.3, -0.2, 0.0):
        run(simulation, speed)
        # Friction of 1 takes 20 ms to bring the part to 0.2 m/s more.
        advance(simulation, 20)
        assert velocity(simulation) == pytest.approx(
            [0.0, -speed, 0.0], abs=0.01 * abs(speed) + 1e-5)
        assert joint.state()[1] == pytest.approx(speed, abs=1e-6)
    way = joint.state()[0]
    assert way == pytest.approx(-simulation.data.body('part').xpos[1] + 0.3, abs=0.01)
    simulation.reset()
    assert simulation.data.actuator('belt').ctrl[0] == 0.1


def test_friction_limits_what_a_belt_can_do():
    simulation = Simulation(conveyor(belt_speed_m_s=0.5, friction=0.2))
    simulation.model.geom('part').friction[0] = 0.2
    advance(simulation, 10)
    # From rest, after 0.1 s with 0.2 g.
    assert -simulation.data.body('part').cvel[4] == pytest.approx(0.2 * 9.81 * 0.1, rel=0.05)


def test_a_command_acts_at_once_though_contacts_were_computed_also_when_restored(simulation):
    ends = []
    for restored in (False, True, True):
        simulation.reset()
        advance(simulation, 50)
        run(simulation, 0.4)
        if restored:
            state = simulation.save()
            run(simulation, -0.4)
            advance(simulation, 3)
            simulation.restore(state)
        simulation.advance(1)
        ends.append((simulation.data.body('part').cvel[4], simulation.digest()))
    assert ends[0] == ends[1] == ends[2]
    # Friction in one step of 2 ms.
    assert -0.15 < ends[0][0] < -0.11


def test_belts_of_many_worlds_run_at_speeds_of_their_own(simulation):
    worlds = Worlds(conveyor(), 3)
    for index, one in enumerate(worlds.simulations):
        run(one, 0.1 * index)
    for _ in range(100):
        worlds.advance(5)
    for index, digest in enumerate(worlds.digest()):
        simulation.reset()
        run(simulation, 0.1 * index)
        advance(simulation, 100)
        assert simulation.digest() == digest
        assert simulation.data.body('part').cvel[4] == pytest.approx(-0.1 * index, abs=1e-5)


def test_what_no_belt_can_do_is_rejected_or_clamped(simulation):
    arena = simulation.surroundings.commands['arena']
    assert arena.checked(['belt'], [], [7.0], []) == {'belt': 1.0}
    assert arena.checked(['belt'], [], [np.nan], []) == {}
    for command in (([0.1], [], []), ([], [np.inf], [])):
        with pytest.raises(CommandError, match='takes a velocity, got a position|must be finite'):
            arena.checked(['belt'], *command)
    with pytest.raises(ModelError, match="'belt_speed' of the arena conveyor must be -1 to 1 m/s"):
        create_arena('conveyor', belt_speed=1.5)


def test_a_turntable_in_a_file_turns_with_its_actuator_and_other_surfaces_as_they_are(tmp_path):
    (tmp_path / 'turntable.xml').write_text("""
<mujoco>
  <worldbody>
    <geom name="plate" type="cylinder" size="0.3 0.02" pos="0 0 0.5" surfacevel="0 0 0 0 0 1"/>
    <geom name="treadmill" type="box" size="0.3 0.3 0.02" pos="2 0 0.5"
      surfacevel="0.2 0 0 0 0 0"/>
    <body>
      <inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/><joint name="turn" axis="0 0 1"/>
    </body>
    <body name="walker" pos="2 0 0.54"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
    <body name="rider" pos="0.2 0 0.54"><freejoint/><geom type="box" size="0.02 0.02 0.02"/></body>
  </worldbody>
  <actuator><velocity name="plate" joint="turn" kv="1000" ctrlrange="-2 2"/></actuator>
</mujoco>""")
    simulation = Simulation(compose('Panda', 'none', arena=tmp_path / 'turntable.xml',
                                    position=[-3.0, 0.0, 0.0]))
    advance(simulation, 50)
    assert velocity(simulation, 'rider') == pytest.approx([0.0] * 3, abs=1e-4)
    assert velocity(simulation, 'walker')[0] == pytest.approx(0.2, rel=0.01)
    arena = simulation.surroundings.commands['arena']
    arena.command(arena.checked(['turn'], [], [0.5], []))
    advance(simulation, 50)
    # Its own turn and its way around the middle; friction keeps it there up to that speed.
    assert simulation.data.body('rider').cvel[2] == pytest.approx(0.5, rel=0.01)
    # A model that replaces another one goes on at the same speed.
    simulation.change_objects(plan_with(simulation.plan, create_described(
        {'name': 'late', 'shape': 'box', 'size': [0.04] * 3, 'position': [-0.2, 0.0, 0.54]},
        ObjectModel, 'late')))
    advance(simulation, 50)
    for body in ('rider', 'late'):
        assert simulation.data.body(body).cvel[2] == pytest.approx(0.5, rel=0.01)
