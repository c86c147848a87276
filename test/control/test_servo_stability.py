# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Gains of a file are kept unless MuJoCo itself oscillates with them; then a note says which."""

import mujoco
import numpy as np
import pytest

from manip_sim.control.servos import stable_gains
from manip_sim.models import compose
from manip_sim.simulation import Simulation

#: A wrist of 0.001 kg m^2 and a slide of 0.1 kg behind a shoulder.
ARM = """
<mujoco model="arm"><compiler angle="radian" autolimits="true"/>
  <worldbody><body name="base"><geom size="0.05"/>
    <body name="link" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0" range="-1 1"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02" mass="0.5"/>
      <body name="tool" pos="0 0 0.22">
        <joint name="wrist" type="{kind}" axis="0 0 1" {range} armature="{armature}"
          damping="0.01"/>
        <geom type="cylinder" size="0.02 0.01" mass="0.1"/>
      </body></body></body></worldbody>
  <actuator><position name="shoulder" joint="shoulder" kp="100" kv="10"/>{servo}</actuator>
</mujoco>"""
#: Servo, kind of joint, armature, the gains at the joint that it has in its file.
KEPT = {
    'position': ('<position joint="wrist" kp="100" kv="9"/>', 'hinge', 0.0005, (100, 9)),
    'position, far beyond the explicit limit': (
        '<position joint="wrist" kp="300" kv="30"/>', 'hinge', 0.0005, (300, 30)),
    'damping ratio': ('<position joint="wrist" kp="350" dampratio="1"/>', 'hinge', 0.001,
                      (350, None)),
    'general': ('<general joint="wrist" biastype="affine" gainprm="150" biasprm="0 -150 -3"/>',
                'hinge', 0.0005, (150, 3)),
    'gear': ('<position joint="wrist" kp="4" kv="0.2" gear="5"/>', 'hinge', 0.0005, (100, 5)),
    'force limit': ('<position joint="wrist" kp="100" kv="0.8" forcerange="-3 3"/>', 'hinge',
                    0.001, (100, 0.8)),
    'slide': ('<position joint="wrist" kp="9000" kv="400"/>', 'slide', 0.1, (9000, 400)),
    'velocity': ('<velocity joint="wrist" kv="2"/>', 'hinge', 0.0005, (None, 2)),
    'integrated velocity': ('<intvelocity joint="wrist" kp="100" kv="4" actrange="-2 2"/>',
                            'hinge', 0.0005, (100, 4)),
}
LOWERED = {
    'damping at the force limit': ('<position joint="wrist" kp="100" kv="3" forcerange="-3 3"/>',
                                   'hinge', 0.001),
    'stiffness at the force limit': (
        '<position joint="wrist" kp="900" kv="9" forcerange="-3 3"/>', 'hinge', 0.0005),
    'velocity at the force limit': ('<velocity joint="wrist" kv="9" forcerange="-3 3"/>',
                                    'hinge', 0.0005),
    'stiffness': ('<position joint="wrist" kp="9000" kv="0.5"/>', 'hinge', 0.0005),
    'stiffness of a slide': ('<position joint="wrist" kp="500000" kv="5"/>', 'slide', 0.1)}


def written(tmp_path, servo, kind, armature):
    """Return the path of the arm with a servo."""
    path = tmp_path / 'arm.xml'
    path.write_text(ARM.format(
        servo=servo, kind=kind, armature=armature,
        range='range="-3 3"' if kind == 'hinge' else 'range="-0.2 0.2"'))
    return path


def gains_of(simulation):
    """Return kp and kv of the wrist, at the joint."""
    model = simulation.model
    index = next(i for i in range(model.nu) if model.actuator_trnid[i, 0] == 1)
    square = model.actuator_gear[index, 0]**2
    return -model.actuator_biasprm[index, 1] * square, -model.actuator_biasprm[index, 2] * square


def slowest_after_kicks(model, data, dof, step):
    """Return the highest velocity of a joint [rad/s] long after kicks, infinite if it diverges."""
    found = []
    for speed in np.geomspace(0.01, 8.0, 12):
        mujoco.mj_resetData(model, data)
        data.qvel[dof] = speed
        for _ in range(1500):
            step()
        before = data.qpos.copy()
        step()
        found.append(np.abs(data.qpos - before).max() / model.opt.timestep)
        if data.warning.number.any():
            return np.inf
    return max(found)


@pytest.mark.full
@pytest.mark.parametrize('case', KEPT)
def test_gains_of_a_file_are_kept_where_mujoco_is_stable_with_them(tmp_path, case):
    servo, kind, armature, (stiffness, damping) = KEPT[case]
    path = written(tmp_path, servo, kind, armature)
    simulation = Simulation(compose(str(path)))
    kp, kv = gains_of(simulation)
    assert simulation.lowered_gains == []
    assert stiffness is None or kp == pytest.approx(stiffness)
    assert damping is None or kv == pytest.approx(damping)
    # What MuJoCo itself does with the file in steps of the world, without limits of the joint.
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.gravity[:], model.jnt_limited[:] = 0.0, 0
    data = mujoco.MjData(model)
    assert slowest_after_kicks(model, data, 1, lambda: mujoco.mj_step(model, data)) < 1e-3
    if stiffness is not None:
        dof, load = simulation.model.joint('robot0_wrist').dofadr[0], 0.01 * stiffness
        simulation.data.qfrc_applied[dof] = min(load, 2.0)
        start = simulation.data.joint('robot0_wrist').qpos[0]
        for _ in range(400):
            simulation.advance(5)
        assert simulation.data.joint('robot0_wrist').qpos[0] - start == pytest.approx(
            min(load, 2.0) / stiffness, rel=1e-3)


@pytest.mark.full
@pytest.mark.parametrize('case', LOWERED)
def test_gains_that_are_not_stable_are_lowered_and_a_note_says_from_what_to_what(
        tmp_path, case):
    servo, kind, armature = LOWERED[case]
    path = written(tmp_path, servo, kind, armature)
    simulation = Simulation(compose(str(path)))
    note, = simulation.lowered_gains
    assert note.startswith("servo of joint 'robot0_wrist': ")
    for value in gains_of(simulation):
        assert f' to {value:.4g}' in note or case.startswith(('damping', 'velocity')) or (
            'damping' not in note)
    model = simulation.model
    model.opt.gravity[:], model.jnt_limited[:] = 0.0, 0
    alone = mujoco.MjData(model)
    dof = int(model.joint('robot0_wrist').dofadr[0])
    assert slowest_after_kicks(model, alone, dof, lambda: mujoco.mj_step(model, alone)) < 1e-3
    # With the gains of the file it never rests.
    original = mujoco.MjModel.from_xml_path(str(path))
    original.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    original.opt.gravity[:], original.jnt_limited[:] = 0.0, 0
    data = mujoco.MjData(original)
    assert slowest_after_kicks(original, data, 1, lambda: mujoco.mj_step(original, data)) > 0.1


def test_a_stiff_servo_loses_damping_before_stiffness(tmp_path):
    path = written(tmp_path, *LOWERED['damping at the force limit'])
    simulation = Simulation(compose(str(path)))
    assert gains_of(simulation)[0] == pytest.approx(100.0)
    assert 'stiffness' not in simulation.lowered_gains[0]


@pytest.mark.parametrize('timestep_s', [0.0005, 0.002, 0.005])
@pytest.mark.parametrize('limited', [False, True])
def test_lowered_gains_are_within_the_eigenvalues_of_a_step(timestep_s, limited):
    generator = np.random.default_rng(0)
    inertia, passive = 10.0**generator.uniform(-4, 1, 500), 10.0**generator.uniform(-4, 1, 500)
    stiffness = 10.0**generator.uniform(0, 6, 500)
    damping = 10.0**generator.uniform(-3, 4, 500)
    kp, kv = stable_gains(stiffness, damping, inertia, passive, np.full(500, limited), timestep_s)
    assert (kp <= stiffness).all() and (kv <= damping * (1.0 + 1e-12)).all()

    def radius(kp, kv, explicit):
        """Return the spectral radius of a step of each joint: v' = v + h a, q' = q + h v'."""
        held = inertia + timestep_s * (passive + (0.0 if explicit else kv))
        kept = inertia - timestep_s * (kv if explicit else 0.0)
        matrix = np.array([[kept / held, -timestep_s * kp / held],
                           [timestep_s * kept / held, 1.0 - timestep_s**2 * kp / held]])
        return np.abs(np.linalg.eigvals(matrix.transpose(2, 0, 1))).max(axis=1)

    lowered = (kp < stiffness) | (kv < damping)
    assert 20 < np.count_nonzero(lowered) < 480
    assert (radius(kp, kv, limited) < 1.0 + 1e-9).all()
    assert (radius(stiffness, damping, limited)[lowered] > 1.0 - 1e-9).all()
    # Lowered ones use three quarters of the range, as the condition of the module has it.
    explicit, implicit = (timestep_s * kv, 0.0) if limited else (0.0, timestep_s * kv)
    share = (timestep_s**2 * kp / 2.0 + explicit) / (
        2.0 * inertia + timestep_s * passive + implicit)
    np.testing.assert_allclose(share[lowered], 0.75, rtol=1e-9)
