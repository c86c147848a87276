# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Tests of what can be set of arenas by name."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import ModelError, UnknownNameError
from manip_sim.models import compose
from manip_sim.models.arenas import (
    Arena, arena_names, arena_parameters, ArenaParameter, BinsArena, create_arena, EmptyArena,
    TableArena)

ALL = [(name, parameter) for name in arena_names() for parameter in arena_parameters(name)]


def model_of(name, **parameters):
    return create_arena(name, **parameters).compile()


@pytest.mark.parametrize(('name', 'parameter'), ALL)
def test_every_parameter_has_a_default_within_its_limits_and_a_description(name, parameter):
    assert parameter.description and parameter.description[0].islower()
    same = model_of(name, **{parameter.name: parameter.default})
    plain = model_of(name)
    assert plain.geom_pos.tobytes() == same.geom_pos.tobytes()
    assert plain.geom_size.tobytes() == same.geom_size.tobytes()
    if not isinstance(parameter.default, bool):
        for value in (parameter.low, parameter.high):
            model_of(name, **{parameter.name: value})


@pytest.mark.parametrize(('name', 'parameter'), ALL)
def test_every_parameter_changes_the_arena(name, parameter):
    other = (not parameter.default if isinstance(parameter.default, bool)
             else (parameter.low + parameter.default) / 2.0)
    assert create_arena(name).to_xml() != create_arena(name, **{parameter.name: other}).to_xml()


@pytest.mark.parametrize(('name', 'parameter'), ALL)
def test_a_value_outside_the_limits_is_rejected(name, parameter):
    wrong = (['yes', 1, None] if isinstance(parameter.default, bool) else
             [parameter.low - 0.01, parameter.high + 0.01, float('nan'), float('inf'), True, '1'])
    for value in wrong:
        with pytest.raises(ModelError, match=f"^parameter '{parameter.name}' of the arena {name} "
                                             f'must be {parameter.limits}, got '):
            create_arena(name, **{parameter.name: value})


@pytest.mark.parametrize('name', arena_names())
def test_no_colour_exceeds_full_intensity(name):
    # As in std_msgs/ColorRGBA; a renderer would cut what is beyond and shift the hue.
    switched_on = {parameter.name: True for parameter in arena_parameters(name)
                   if isinstance(parameter.default, bool)}
    model = model_of(name, **switched_on)
    colours = np.vstack([model.geom_rgba, model.mat_rgba])
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0


def test_a_table_has_the_edges_asked_for_and_legs_below_it():
    model = model_of('table', table_length=1.2, table_width=0.6, table_height=0.5)
    np.testing.assert_allclose(2.0 * model.geom('table_collision').size[:2], [1.2, 0.6])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    assert data.site('table_top').xpos[2] == pytest.approx(0.5)
    for number in range(1, 5):
        leg = data.geom(f'table_leg{number}_visual').xpos
        assert (np.abs(leg[:2]) < [0.6, 0.3]).all()
        assert np.abs(leg[1]) == pytest.approx(0.2)


def test_a_box_slides_off_a_smooth_tilted_table_only():
    slid = []
    for friction in (0.05, 1.0):
        model = compose('Panda', arena='table', friction=friction, objects=[
            {'name': 'puck', 'shape': 'box', 'size': [0.1, 0.1, 0.02], 'friction': 0.0,
             'mass': 0.1, 'position': [0.2, 0.0, 0.81]}]).compile()
        model.opt.gravity[:] = [1.0, 0.0, -9.81]
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 250)
        slid.append(data.body('puck').xpos[0] - 0.2)
    # a = g_x - mu g_z, for half a second.
    assert slid[0] == pytest.approx((1.0 - 0.05 * 9.81) * 0.5**2 / 2.0, rel=0.1)
    assert abs(slid[1]) < 0.005


def test_bins_stand_on_their_legs_at_the_height_asked_for():
    model = model_of('bins', bin_height=0.5, friction=0.4)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in ('bin1', 'bin2'):
        assert data.site(name).xpos[2] == pytest.approx(0.5)
        leg = model.geom(f'{name}_leg1_visual')
        assert data.geom(leg.name).xpos[2] - leg.size[1] == pytest.approx(0.0, abs=1e-9)
        assert data.geom(leg.name).xpos[2] + leg.size[1] == pytest.approx(0.46)
        assert model.geom(f'{name}_floor').friction[0] == 0.4


def test_constructors_check_their_arguments_too():
    with pytest.raises(ModelError, match="^parameter 'table_width' of the arena table must be "
                                         ' ?0.3 to 5 m, got 9$'):
        TableArena(table_width_m=9)
    with pytest.raises(ModelError, match="'bin_height' of the arena bins must be 0.1 to 2 m"):
        BinsArena(bin_height_m=3.0)
    assert TableArena(table_length_m=np.float32(1.0)).table_length_m == 1.0


def test_an_unknown_parameter_tells_the_nearest():
    with pytest.raises(UnknownNameError, match="^unknown parameter of the arena table "
                                               "'table_hight': did you mean 'table_height'"):
        create_arena('table', table_hight=1.0)
    with pytest.raises(UnknownNameError, match="arena empty 'table_height': available: none"):
        create_arena('empty', table_height=1.0)


def test_a_parameter_by_name_and_by_keyword_is_rejected():
    with pytest.raises(ModelError, match="'table_height_m' of the arena table is given twice"):
        create_arena('table', table_height=1.0, table_height_m=1.0)


def test_an_unknown_arena_has_no_parameters():
    assert arena_parameters('empty') == EmptyArena.parameters == ()
    with pytest.raises(UnknownNameError, match="unknown arena 'tabel': did you mean 'table'"):
        arena_parameters('tabel')


def test_the_arena_of_a_user_takes_what_its_constructor_takes(monkeypatch):
    class Shelf(Arena):
        arena_name = 'empty'
        parameters = (ArenaParameter('boards', 3.0, 'number of boards', '', 1.0, 9.0),)

        def __init__(self, boards=3.0, colour='red'):
            super().__init__()
            self.taken = boards, colour

    assert create_arena('empty', boards=4.0, colour='blue').taken == (4.0, 'blue')
    assert Shelf.parameters[0].limits == '1 to 9'


def test_a_camera_is_shifted_without_being_turned_and_a_missing_one_is_left_out():
    before, arena = create_arena('table').compile(), create_arena('table')
    arena.shift_camera('agentview', [0.0, -0.2, 0.1])
    arena.shift_camera('nobody', [1.0, 0.0, 0.0])
    after = arena.compile()
    np.testing.assert_array_equal(after.cam_quat, before.cam_quat)
    moved = after.cam_pos - before.cam_pos
    np.testing.assert_allclose(moved[after.camera('agentview').id], [0.0, -0.2, 0.1])
    assert np.count_nonzero(np.abs(moved).max(axis=1)) == 1
