# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""What all tests share: MJCF files of a few lines, small robots and the Panda in an arena."""

from collections import Counter, defaultdict
import functools
import gc
import importlib
import importlib.util
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

from manip_sim.startup import use_one_blas_thread
from manip_sim.testing.domains import reserve_domain

if 'numpy' not in sys.modules:
    # As in the programs of the package: idle threads of workers and of what they start busy-wait,
    # which takes a fifth of the processor time of tests that compute.
    use_one_blas_thread()
import numpy as np
from operators import Operator
import pytest
from robot_kinds import KINDS
from sampling import whole_robot

from manip_sim.control.modes import LAWS
from manip_sim.models.arenas import ARENAS
from manip_sim.models.bases import BASES, RethinkMount
from manip_sim.models.grippers import GripperModel, GRIPPERS, PandaGripper
from manip_sim.models.robots import ManipulatorModel, Panda, RobotModel
from manip_sim.models.robots.robot_model import ROBOTS
from manip_sim.models.world import World
from manip_sim.simulation import Simulation

if importlib.util.find_spec('hypothesis'):
    from hypothesis import HealthCheck, settings

    # The same examples each time: a failure is that of the change that is tested.
    for profile, examples in (('repeatable', 100), ('fast', 20)):
        settings.register_profile(profile, derandomize=True, database=None, deadline=None,
                                  max_examples=examples, suppress_health_check=list(HealthCheck))
    settings.load_profile('repeatable')

ARM_WORLDBODY = """
<body name="base">
  <geom size="0.05" mass="1"/>
  <body name="link1" pos="0 0 1">
    <joint name="joint1" axis="0 1 0" range="-2 2" damping="0.5"/>
    <geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.02" mass="1"/>
    <body name="right_hand" pos="0.5 0 0"/>
  </body>
</body>
"""
MOTOR = '<motor name="torq_j1" joint="joint1" ctrlrange="-30 30"/>'


#: Files with much to do, in the order in which they begin. With a few workers and a file for one
#: of them, a long file that comes last keeps one worker busy and the others waiting for it. Those
#: of processes that wait for each other take turns with those that compute.
LONGEST = (
    'ros/test_documentation.py', 'experiments/test_runs.py', 'ros/test_viewer.py',
    'env/test_env.py', 'testing/test_sim_node.py', 'models/test_untrusted_models.py',
    'ros/test_process.py', 'control/test_control_figures.py', 'ros/test_diagnostics.py',
    'test_contact_bench.py', 'ros/test_pick_cube.py', 'test_bench.py', 'ros/test_graph_monitor.py',
    'cli/test_cli_identify.py', 'ros/test_soak.py', 'models/test_catalogue_grasps.py',
    'ros/test_node_records.py', 'worlds/test_worlds.py', 'testing/test_plugin.py',
    'tasks/test_tasks.py', 'ros/test_start.py', 'worlds/test_planned_periods.py',
    'ros/test_ros_commands.py', 'moveit/test_control_package.py', 'ros/test_parameters.py',
    'control/test_user_laws.py', 'models/test_add_your_own.py', 'control/test_law.py',
    'ros/test_viewer_discovery.py', 'test_gallery.py', 'ros/test_viewer_layout.py',
    'records/test_hostile_records.py', 'ros/test_hand_over.py', 'cli/test_cli_main.py',
    'ros/test_hostile_viewer.py', 'cli/test_cli_render.py', 'ros/test_camera_topics.py',
    'experiments/test_comparison.py', 'ros/test_spawned_robots.py',
    'models/test_archive_bounds.py', 'ros/test_spawned_files.py',
    'simulation/test_saved_states.py', 'ros/test_journal.py', 'models/test_requested_robots.py',
    'ros/test_spawned_by_strangers.py', 'control/test_servos.py', 'experiments/test_ros_policy.py',
    'control/test_cartesian_impedance.py', 'ros/test_security_policy.py',
    'physics/test_pulled_tools.py', 'ros/test_viewer_readers.py', 'test_parameter_properties.py',
    'ros/test_task_node.py', 'records/test_node_replay.py', 'ros/test_watch_only.py',
    'moveit/test_moveit_package.py', 'ros/test_pressing.py', 'control/test_cartesian.py',
    'viewer/test_task_page.py', 'simulation/test_other_processors.py', 'ros/test_lockstep.py',
    'test_glossary.py', 'ros/test_sensors.py', 'simulation/test_compiled_periods.py',
    'ros/test_live_parameters.py', 'control/test_setpoints.py', 'ros/test_laws.py',
    'models/test_urdf_writer.py', 'test_install.py', 'models/test_catalogue_motion.py',
    'test_typing.py', 'cli/test_cli_params_file.py', 'records/test_playback.py',
    'simulation/test_every_robot.py', 'control/test_streams.py', 'simulation/test_payloads.py',
    'simulation/test_serialization.py')


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Let the collector of garbage never look at what thousands of tests are made of."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


#: Of tests that are repeated over a catalogue, ``make test`` runs the cases of these.
REPRESENTATIVES = {'Panda', 'Tiago', 'GR1', 'PandaGripper', 'PalGripper', 'InspireRightHand'}
CATALOGUE = {*ROBOTS.names(), *GRIPPERS.names()}
#: Of the others it runs as many cases, spread over all: 402 s of CPU time in all on two cores.
MOST_CASES = 4
#: A test whose cases name at least as many of them, or each kind of robot, is repeated over it.
REPEATED = 9


def is_fast_tier(config):
    return config.getoption('markexpr') == 'not full'


def pytest_configure(config):
    if is_fast_tier(config) and importlib.util.find_spec('hypothesis'):
        settings.load_profile('fast')


def mark_full(config, items):
    """Mark the cases that only ``make test-full`` runs because others are like them."""
    named = {item: CATALOGUE.intersection(re.split(r'[\[\]-]', item.name)) for item in items}
    tests = defaultdict(list)
    for item in items:
        tests[item.path, getattr(item, 'originalname', None)].append(item)
    for cases in tests.values():
        names = set().union(*(named[item] for item in cases))
        if len(names) >= REPEATED or names >= set(KINDS):
            for item in cases:
                if not named[item] <= REPRESENTATIVES:
                    item.add_marker('full')
        left = [item for item in cases if item.get_closest_marker('full') is None]
        step = max(len(left) / MOST_CASES, 1.0)
        kept = {int(number * step) for number in range(MOST_CASES)}
        for number, item in enumerate(left):
            # Of properties, the other tier tries more examples.
            is_property = getattr(getattr(item, 'obj', None), 'is_hypothesis_test', False)
            if number not in kept or is_property and not is_fast_tier(config):
                item.add_marker('full')


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Let several workers begin with the longest files, then go on with those of most tests."""
    mark_full(config, items)
    if not hasattr(config, 'workerinput'):
        return
    here = Path(__file__).parent
    rank = {here / name: place for place, name in enumerate(LONGEST)}
    count = Counter(item.path for item in items)
    items.sort(key=lambda item: (rank.get(item.path, len(rank)), -count[item.path],
                                 str(item.path)))


@pytest.fixture(scope='session')
def install_example(tmp_path_factory):
    """Return a function that installs a package of ``test/data`` by pip, and returns where."""
    @functools.cache
    def install(name):
        folder = tmp_path_factory.mktemp(name)
        # The build writes into the source.
        shutil.copytree(Path(__file__).parent / 'data' / name, folder / 'source')
        done = subprocess.run(
            [sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--no-index',
             '--no-build-isolation', '--target', str(folder / 'site'), str(folder / 'source')],
            capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return str(folder / 'site')
    return install


@pytest.fixture
def package_on_path(tmp_path, monkeypatch):
    """Return a function that puts a package with entry points of one group on the path."""
    def make(group, name, code, points):
        (tmp_path / f'{name}.py').write_text(code)
        info = tmp_path / f'{name}-1.2.dist-info'
        info.mkdir()
        (info / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n')
        (info / 'entry_points.txt').write_text(f'[{group}]\n' + '\n'.join(
            f'{point} = {name}:{found}' for point, found in points.items()))
    monkeypatch.syspath_prepend(str(tmp_path))
    return make


@pytest.fixture(autouse=True)
def _own_registries_and_folder(monkeypatch, tmp_path):
    """Forget classes and laws that a test defines, and keep MuJoCo's log out of the tree."""
    for registry in (ARENAS, BASES, GRIPPERS, ROBOTS):
        monkeypatch.setattr(registry, '_classes', dict(registry._classes))
    monkeypatch.setattr(LAWS, '_laws', dict(LAWS._laws))  # They are control modes, too.
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def mjcf(tmp_path):
    """Return a function that writes an MJCF file and returns its path."""
    def write(worldbody='', sections='', angle='radian', name='model'):
        path = Path(tmp_path, f'{name}.xml')
        path.write_text(f'<mujoco><compiler angle="{angle}"/>'
                        f'<worldbody>{worldbody}</worldbody>{sections}</mujoco>')
        return path
    return write


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a file of parameters and returns its path."""
    def write(text):
        file = tmp_path / 'parameters.yaml'
        file.write_text(text)
        return file
    return write


@pytest.fixture
def arm_class():
    """Return a robot class with one arm that starts at zero; instances take a file."""
    class Arm(ManipulatorModel):
        arm_type = 'single'
        default_gripper = {'right': 'PandaGripper'}
        default_base = 'RethinkMount'
        default_controller_config = {}
        base_xpos_offset = {}

        @property
        def init_qpos(self):
            return np.zeros(self.dof)

    return Arm


@pytest.fixture
def robot_class():
    """Return a robot class without arms; instances take a file."""
    class Robot(RobotModel):
        default_base = None
        default_controller_config = {}
        base_xpos_offset = {}

        @property
        def init_qpos(self):
            return np.zeros(self.dof)

    return Robot


@pytest.fixture
def one_joint_arm(arm_class, mjcf):
    """Return a function that makes an arm with one joint and the actuators given."""
    def make(actuators=MOTOR, worldbody=ARM_WORLDBODY, sections='', idn=0):
        return arm_class(mjcf(worldbody, f'<actuator>{actuators}</actuator>{sections}'), idn)
    return make


@pytest.fixture
def gripper_class():
    """Return a gripper as a user of robosuite writes it; instances take a file."""
    class MyGripper(GripperModel):
        speed = 0.1

        def format_action(self, action):
            assert len(action) == self.dof
            self.current_action = np.clip(
                self.current_action + self.speed * np.sign(action), -1.0, 1.0)
            return self.current_action

        @property
        def init_qpos(self):
            return np.array([0.01])

        @property
        def _important_geoms(self):
            return {'left_finger': ['finger'], 'right_finger': [], 'left_fingerpad': ['finger'],
                    'right_fingerpad': []}

    return MyGripper


@pytest.fixture
def gripper_file(mjcf):
    """Return the file of a gripper with one finger and no site or sensor."""
    return mjcf("""
        <body name="palm">
          <geom size="0.02" mass="0.1"/>
          <body name="slider" pos="0 0 0.05">
            <joint name="slide" type="slide" axis="0 1 0" range="-0.02 0.03"/>
            <geom name="finger" size="0.01" mass="0.05"/>
          </body>
          <body name="eef" pos="0 0 0.1"/>
        </body>""", """
        <actuator>
          <position name="close" joint="slide" kp="200" kv="10" ctrlrange="-0.02 0.03"/>
        </actuator>""", name='gripper')


@pytest.fixture
def fingers_class():
    """Return the class of a gripper that moves all its commands by one action; takes a file."""
    class OneActionGripper(GripperModel):
        speed = 0.2

        def __init__(self, fname, idn=0):
            super().__init__(fname, idn)
            self.current_action = np.zeros(len(self.actuators))

        @property
        def dof(self):
            return 1

        def format_action(self, action):
            return self._integrate(-self.speed * np.sign(self._checked(action)))

        @property
        def init_qpos(self):
            return [0.02, 0.02]

    return OneActionGripper


@pytest.fixture
def fingers_sim(one_joint_arm, fingers_class, mjcf):
    """
    Return a function that makes a simulation of a gripper with two sliding fingers.

    The fingers ``left`` and ``right`` go from 0, closed, to 0.04 m at 0.05 m/s.
    """
    def make(actuators, sections='', coupled=True, before=None):
        equality = '<equality><joint joint1="right" joint2="left"/></equality>' if coupled else ''
        fingers = ''.join(f"""
            <body name="{side}" pos="0 {sign}0.005 0.05">
              <joint name="{side}" type="slide" axis="0 {sign}1 0" range="0 0.04" user="0.05"
                armature="0.1" damping="10" solreflimit="0.004 1" solimplimit="0.99 0.99 0.001"/>
              <geom name="{side}_pad" type="box" size="0.01 0.005 0.01" mass="0.02"
                contype="0" conaffinity="0"/>
            </body>""" for side, sign in (('left', ''), ('right', '-')))
        gripper = fingers_class(mjcf(
            f'<body name="palm"><geom size="0.01" mass="0.2"/>{fingers}<body name="eef"/></body>',
            f'{sections}{equality}<actuator>{actuators}</actuator>', name='gripper'))
        robot = one_joint_arm()
        robot.add_gripper(gripper)
        if before is not None:
            before(gripper)
        return Simulation(World([robot]))
    return make


@pytest.fixture
def benchmark_module(monkeypatch):
    """Return the function that imports a script of ``benchmark/`` by its name."""
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[1] / 'benchmark'))
    return importlib.import_module


@pytest.fixture(scope='session')
def renderer():
    """Skip where MuJoCo itself, in a process of its own, renders nothing without a screen."""
    bare = ('import mujoco; mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"))'
            '.render()')
    done = subprocess.run([sys.executable, '-c', bare], capture_output=True, text=True,
                          env={'MUJOCO_GL': 'egl', **os.environ}, check=False)
    if done.returncode:
        pytest.skip(f'MuJoCo cannot render here: {done.stderr.strip().splitlines()[-1]}')


@pytest.fixture
def gl(renderer, monkeypatch):
    """Skip where nothing can be rendered, and render without a screen."""
    monkeypatch.setenv('MUJOCO_GL', os.environ.get('MUJOCO_GL', 'egl'))


@pytest.fixture
def domain():
    """Return a ROS domain that nobody else uses."""
    domain, lock = reserve_domain()
    yield domain
    os.close(lock)


@pytest.fixture
def node(domain):
    """Return a bare node of rclpy in the domain."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS 2')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('node', context=context)
    yield node
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture(scope='session')
def reference():
    """Return what robosuite gives for the Panda and its gripper."""
    return json.loads((Path(__file__).parent / 'data' / 'panda_reference.json').read_text())


@pytest.fixture
def panda():
    """Return a Panda on its pedestal with its gripper, named as the node names them."""
    robot = Panda()
    robot.add_base(RethinkMount())
    robot.add_gripper(PandaGripper(idn='0_right'))
    return robot


@pytest.fixture
def panda_sim(panda):
    """Return a simulation of the Panda on an empty floor."""
    return Simulation(World([panda]))


@pytest.fixture
def run():
    """Return a function that advances a simulation by seconds, in periods of 10 ms."""
    def advance(simulation, seconds, each_period=None):
        for _ in range(round(seconds * 100)):
            simulation.advance(5)
            if each_period is not None:
                each_period()
    return advance


@pytest.fixture
def panda_op(panda_sim):
    """Return an operator of the Panda."""
    return Operator(panda_sim)


@pytest.fixture
def operator_of():
    """Return a function that makes an operator of a robot of the catalogue."""
    return lambda name, **options: Operator(whole_robot(name, **options))
