# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Small models as other people write them, for the tests of files."""

from pathlib import Path

ARM = """<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <light name="top" pos="0 0 2"/>
    <camera name="wide" pos="0 -2 1"/>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="base" pos="0 0 0.02">
      <geom name="foot" type="cylinder" size="0.05 0.02"/>
      <body name="link1" pos="0 0 0.1">
        <joint name="turn" axis="0 0 1" range="-1.5 1.5" armature="0.1"/>
        <geom type="capsule" fromto="0 0 0.03 0 0 0.17" size="0.02" mass="0.5"/>
        <body name="link2" pos="0 0 0.2">
          <joint name="lift" axis="0 1 0" range="-1.5 1.5" armature="0.1"/>
          <geom type="capsule" fromto="0 0 0.03 0 0 0.17" size="0.02" mass="0.5"/>
          <body name="link3" pos="0 0 0.2" euler="0 0 0.5">
            <joint name="bend" axis="0 1 0" range="0 1" armature="0.1"/>
            <geom type="capsule" fromto="0 0 0.03 0 0 0.07" size="0.02" mass="0.3"/>
            <site name="attachment_site" pos="0 0.01 0.1" euler="0 0 0.7"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="900" kv="60" ctrlrange="-1.5 1.5"/>
    <position name="lift" joint="lift" kp="900" kv="60" ctrlrange="-1.5 1.5"/>
    <position name="bend" joint="bend" kp="900" kv="60" ctrlrange="0 1"/>
  </actuator>
  <keyframe><key name="home" qpos="0.1 0.2 0.3" ctrl="0.1 0.2 0.3"/></keyframe>
</mujoco>
"""

#: Two fingers on one tendon, on a palm without joint.
_HAND = """<body name="palm" pos="0 0 0.12">
  <geom name="palm" type="box" size="0.03 0.04 0.01" mass="0.2"/>
  <body name="left_tip" pos="0 0 0.05">
    <joint name="left_finger" type="slide" axis="0 1 0" range="0 0.03" armature="0.05"
      damping="5"/>
    <geom name="left_pad" type="box" size="0.01 0.004 0.02" pos="0 0.004 0" mass="0.02"/>
  </body>
  <body name="right_tip" pos="0 0 0.05">
    <joint name="right_finger" type="slide" axis="0 -1 0" range="0 0.03" armature="0.05"
      damping="5"/>
    <geom name="right_pad" type="box" size="0.01 0.004 0.02" pos="0 -0.004 0" mass="0.02"/>
  </body>
</body>"""
_HAND_DRIVE = """<tendon><fixed name="split"><joint joint="left_finger" coef="0.5"/>
    <joint joint="right_finger" coef="0.5"/></fixed></tendon>
  <equality><joint joint1="left_finger" joint2="right_finger"/></equality>
"""
_PULL = """<general name="pull" tendon="split" ctrlrange="0 255" forcerange="-50 50"
      gainprm="1.5" biastype="affine" biasprm="0 -12750 -100"/>
  </actuator>"""

ARM_WITH_HAND = (
    ARM.replace('<site name="attachment_site" pos="0 0.01 0.1" euler="0 0 0.7"/>', _HAND)
    .replace('<actuator>', f'{_HAND_DRIVE}<actuator>').replace('</actuator>', _PULL)
    .replace('qpos="0.1 0.2 0.3" ctrl="0.1 0.2 0.3"',
             'qpos="0.1 0.2 0.3 0.01 0.01" ctrl="0.1 0.2 0.3 85"'))

HAND = f"""<mujoco model="hand">
  <compiler angle="radian" autolimits="true"/>
  <worldbody><light pos="0 0 1"/>{_HAND.replace('pos="0 0 0.12"', 'quat="0 1 0 1"')}</worldbody>
  {_HAND_DRIVE}<actuator>{_PULL}
</mujoco>
"""


def arm_of(side, y):
    """Return the MJCF of an arm with a hand; its elements are named after its side."""
    return f"""<body name="{side}/base" pos="0 {y} 0"><geom size="0.02"/>
      <body name="{side}/upper" pos="0 0 0.1"><joint name="{side}/waist" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02"/>
        <body name="{side}/lower" pos="0 0 0.15"><joint name="{side}/elbow" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02"/>
          <body name="{side}/palm" pos="0 0 0.15"><geom size="0.01"/>
            <body name="{side}/tip"><joint name="{side}/left_finger" type="slide" axis="0 1 0"
              range="0 0.02"/><geom size="0.01" pos="0 0.02 0.05"/></body>
          </body></body></body></body>"""


TWO_ARMS = f"""<mujoco model="pair"><compiler angle="radian" autolimits="true"/>
  <worldbody>{arm_of('left', 0.4)}{arm_of('right', -0.4)}</worldbody>
  <actuator>{''.join(f'<position joint="{side}/{joint}" kp="50" kv="5"/>'
                     for side in ('left', 'right') for joint in ('waist', 'elbow'))}
    <position joint="left/left_finger" kp="50" ctrlrange="0 0.02"/>
    <position joint="right/left_finger" kp="50" ctrlrange="0 0.02"/></actuator>
</mujoco>
"""


def write(file: Path, text: str) -> Path:
    """Write a file and return its path."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file
