# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Which sensors of a model make one instrument, and what it reads."""

import mujoco
import numpy as np
import pytest

from manip_sim.errors import UnknownNameError
from manip_sim.models import compose
from manip_sim.models.grippers import gripper_names
from manip_sim.models.robots import robot_names
from manip_sim.sensing.instruments import find_instruments
from manip_sim.sensing.sensor_noise import InstrumentChannel, SensingSettings
from manip_sim.simulation import Simulation

#: A box that turns about z with 0.5 rad/s, with one sensor of many kinds.
BOX = """
<mujoco>
  <option gravity="0 0 -9.81" magnetic="0 -0.5 0"/>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1"/>
    <body name="imu" pos="0 0 1" gravcomp="1">
      <joint name="turn" axis="0 0 1"/>
      <geom size="0.1" mass="1"/>
      <site name="imu"/>
      <site name="down/1" euler="180 0 0" pos="0 0 -0.2"/>
      <site name="up" pos="0 0 .2"/>
      <site name="flange"/>
    </body>
  </worldbody>
  <sensor>
    <gyro name="gyro" site="imu"/>
    <jointpos name="angle" joint="turn"/>
    <accelerometer name="accelerometer" site="imu"/>
    <framequat name="orientation" objtype="site" objname="imu"/>
    <gyro name="second gyro" site="imu"/>
    <rangefinder name="down/1" site="down/1"/>
    <rangefinder name="down_1" site="up"/>
    <magnetometer name="compass" site="imu"/>
    <torque name="torque" site="flange"/>
    <force name="force" site="flange"/>
    <force name="lone" site="up"/>
    <framequat name="body" objtype="body" objname="imu"/>
    <framequat name="relative" objtype="site" objname="up" reftype="body" refname="imu"/>
    <clock name="clock"/>
  </sensor>
</mujoco>
"""


@pytest.fixture(scope='module')
def box():
    model = mujoco.MjModel.from_xml_string(BOX)
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = np.pi / 2, 0.5
    mujoco.mj_forward(model, data)
    return model, data


def test_sensors_of_one_site_are_one_instrument_and_all_others_stand_alone(box):
    found = {(one.kind, one.topic): one for one in find_instruments(box[0])}
    assert list(found) == [
        ('imu', 'imu'), ('values', 'angle'), ('imu', 'imu_2'), ('range', 'down_1'),
        ('range', 'down_1_2'), ('magnetic_field', 'compass'), ('wrench', 'flange'),
        ('values', 'lone'), ('values', 'body'), ('values', 'relative'), ('values', 'clock')]
    assert found['imu', 'imu'].sensors == ('gyro', 'accelerometer', 'orientation')
    # A body has the name already, and frames are unique.
    assert found['imu', 'imu'].frame == 'imu_site' and found['values', 'body'].frame == 'imu'
    assert found['wrench', 'flange'].frame == 'flange' and found['values', 'angle'].frame == ''


def test_an_imu_that_turns_reads_its_turn_and_the_floor_that_carries_it(box):
    model, data = box
    found = {one.topic: one.read(data) for one in find_instruments(model)}
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        found['imu'], [0, 0, half, half, 0, 0, 0.5, 0, 0, 9.81], atol=1e-9)
    np.testing.assert_allclose(found['down_1'], [0.8], atol=1e-9)
    np.testing.assert_allclose(found['down_1_2'], [-1.0])
    # The field points along -y of the world, which is -x of the site.
    np.testing.assert_allclose(found['compass'], [-0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(found['angle'], [np.pi / 2])
    np.testing.assert_allclose(found['imu_2'][4:7], [0, 0, 0.5])
    assert not found['imu_2'][:4].any() and not found['imu_2'][7:].any()


def test_force_comes_before_torque_whatever_the_order_in_the_file(box):
    model, data = box
    wrench = next(one for one in find_instruments(model) if one.topic == 'flange')
    np.testing.assert_array_equal(wrench.read(data), np.concatenate(
        [data.sensor('force').data, data.sensor('torque').data]))


@pytest.mark.parametrize('name', robot_names())
def test_each_gripper_and_base_of_the_catalogue_has_an_imu_that_feels_gravity(name):
    simulation = Simulation(compose(name))
    imus = [one for one in simulation.sensors.instruments if one.kind == 'imu']
    robot = simulation.robot.robot_model
    assert len(imus) == len(simulation.robot.end_effectors) + (robot.base is not None)
    for imu in imus:
        reading = imu.read(simulation.data)
        np.testing.assert_allclose(np.linalg.norm(reading[:4]), 1.0)
        site = simulation.data.site(imu.elements[0])
        specific = site.xmat.reshape(3, 3) @ reading[7:]
        velocity, acceleration = np.empty(6), np.empty(6)
        mujoco.mj_objectVelocity(simulation.model, simulation.data, mujoco.mjtObj.mjOBJ_SITE,
                                 site.id, velocity, 0)
        mujoco.mj_objectAcceleration(simulation.model, simulation.data,
                                     mujoco.mjtObj.mjOBJ_SITE, site.id, acceleration, 0)
        np.testing.assert_allclose(specific, acceleration[3:], atol=1e-9)
        assert abs(specific[2] - 9.81) < 1.5, imu.name


@pytest.mark.parametrize('name', [name for name in gripper_names() if name not in (
    'NullGripper', 'VacuumGripper', 'WipingGripper')])
def test_each_finger_pad_of_the_catalogue_has_a_touch_sensor_that_encloses_it(name):
    simulation = Simulation(compose('Panda', name))
    gripper = simulation.robot.robot_model.grippers['right']
    pads = {pad for role in ('left_fingerpad', 'right_fingerpad')
            for pad in gripper.important_geoms[role]}
    touches = [one for one in simulation.sensors.instruments if one.types == ('touch',)]
    assert len(touches) == len(pads)
    places = simulation.data.geom_xpos[[simulation.model.geom(pad).id for pad in pads]]
    for touch in touches:
        site = simulation.data.site(touch.elements[0]).xpos
        assert np.linalg.norm(places - site, axis=1).min() < 1e-5


def test_pads_that_grasp_a_cube_feel_the_force_between_them():
    cube = {'name': 'cube', 'shape': 'box', 'size': [0.04, 0.04, 0.04], 'mass': 0.01,
            'position': [0.0, 0.0, 3.0]}
    simulation = Simulation(compose('Panda', objects=[cube]))
    robot = simulation.robot
    for _ in range(30):  # Hold it between the fingers until they have closed.
        simulation.data.joint('cube_joint').qpos[:3] = robot.end_effectors['right'].pose(
            simulation.data)[:3]
        mujoco.mju_mat2Quat(simulation.data.joint('cube_joint').qpos[3:], simulation.data.site(
            robot.end_effectors['right'].grip_site).xmat)
        simulation.data.joint('cube_joint').qvel[:] = 0.0
        robot.apply(robot.parse.action('right/gripper', [1.0]))
        simulation.advance(5)
    left, right = (float(simulation.sensors[f'gripper0_right_finger{n}_pad_touch'][0])
                   for n in (1, 2))
    assert left > 10.0
    assert right == pytest.approx(left, rel=0.2)


def test_sensors_are_read_by_name_and_an_unknown_name_is_an_error():
    simulation = Simulation(compose('Panda'))
    sensors = simulation.sensors
    assert set(sensors) == {simulation.model.sensor(n).name
                            for n in range(simulation.model.nsensor)}
    assert len(sensors) == simulation.model.nsensor
    for name, value in sensors.items():
        np.testing.assert_array_equal(value, simulation.data.sensor(name).data)
        assert not np.shares_memory(value, simulation.data.sensordata)
    with pytest.raises(UnknownNameError, match="unknown sensor 'robot0_right_imu_gryo'"):
        sensors['robot0_right_imu_gryo']


def test_own_noise_is_only_where_an_instrument_has_a_sensor():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody><body><geom size="0.1"/><site name="imu"/></body></worldbody>
        <sensor><accelerometer site="imu"/></sensor></mujoco>""")
    (found,) = find_instruments(model)
    channel = InstrumentChannel(found, model, 0.5)
    channel.adapt(SensingSettings())
    measured = channel.measure(np.zeros(10), 3, 0.002)
    assert not measured[:7].any()
    assert measured[7:].all()


@pytest.mark.parametrize('sensor, quantity', [
    ('jointpos', 'position'), ('jointvel', 'velocity'), ('jointactuatorfrc', 'effort')])
@pytest.mark.parametrize('joint, kind', [('hinge', 'joint'), ('slide', 'slide')])
def test_a_sensor_of_a_joint_has_the_noise_of_joints_of_its_kind(sensor, quantity, joint, kind):
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><worldbody><body><geom size="0.1"/><joint name="hinge"/></body>
        <body><geom size="0.1"/><joint name="slide" type="slide"/></body></worldbody>
        <sensor><clock/><{sensor} joint="{joint}"/></sensor></mujoco>""")
    channel = InstrumentChannel(find_instruments(model)[1], model)
    settings = SensingSettings()
    for number, other in enumerate(('joint', 'slide'), start=1):
        settings.set(f'noise.{other}_{quantity}', 0.1 * number)
    channel.adapt(settings)
    assert channel.sd.tolist() == [0.1 if kind == 'joint' else 0.2]
