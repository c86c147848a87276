# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Edits of a spec for which MuJoCo has no function."""

import mujoco
import pytest

from manip_sim.models.spec_edits import delete_elements, weld_joints


@pytest.fixture
def tied_joints():
    """Return the spec of a free body and two joints, with all that may refer to these."""
    return mujoco.MjSpec.from_string("""<mujoco><worldbody><body><freejoint name="root"/>
      <geom size="1"/><body><joint name="j1"/><geom size="1"/><body name="tip"><joint name="j2"/>
      <geom size="1"/></body></body></body></worldbody>
      <tendon><fixed name="both"><joint joint="j1" coef="1"/><joint joint="j2" coef="1"/></fixed>
      <fixed name="one"><joint joint="j2" coef="1"/></fixed></tendon>
      <equality><joint joint1="j1" joint2="j2"/><tendon tendon1="both"/><joint joint1="j2"/>
      </equality><actuator><motor joint="j1"/><motor joint="j2"/><motor tendon="both"/>
      <motor tendon="one"/></actuator><sensor><jointpos joint="j1"/>
      <framepos name="place" objtype="body" objname="tip"/>
      <framequat name="tip" objtype="body" objname="tip"/></sensor></mujoco>""")


def test_what_refers_to_a_welded_joint_goes_with_it(tied_joints):
    weld_joints(tied_joints, {'j2'})
    model = tied_joints.compile()
    assert (model.nv, model.ntendon, model.neq, model.nu, model.nsensor) == (1, 1, 1, 2, 2)


def test_what_refers_to_another_element_of_the_same_name_is_not_deleted():
    spec = mujoco.MjSpec.from_string("""<mujoco><worldbody>
        <body name="x"><joint name="x"/><geom name="x" size="1"/><site name="x"/></body>
        <body name="y"><geom name="y" size="1"/></body></worldbody>
        <contact><pair geom1="x" geom2="y"/></contact>
        <sensor><framepos name="of_body" objtype="body" objname="x"/>
        <framepos name="of_site" objtype="site" objname="x"/>
        <jointpos name="of_joint" joint="x"/>
        <framepos name="to_geom" objtype="body" objname="y" reftype="geom" refname="x"/></sensor>
        </mujoco>""")
    delete_elements(spec, [spec.joint('x')])
    assert [sensor.name for sensor in spec.sensors] == ['of_body', 'of_site', 'to_geom']
    assert len(spec.pairs) == 1
    delete_elements(spec, [spec.geom('x')])
    assert [sensor.name for sensor in spec.sensors] == ['of_body', 'of_site']
    assert not spec.pairs
