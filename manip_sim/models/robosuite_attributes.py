# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""
Attributes of robosuite's models that models do not have here.

robosuite keeps an ElementTree where there is a MjSpec here.
"""

#: What to use instead, by name.
REPLACEMENTS = {
    'root': 'use spec (a mujoco.MjSpec), or parse to_xml()',
    'tree': 'use spec (a mujoco.MjSpec), or parse to_xml()',
    'worldbody': 'use spec.worldbody',
    'asset': 'use spec.meshes, spec.textures and spec.materials',
    'actuator': 'use spec.actuators',
    'sensor': 'use spec.sensors',
    'equality': 'use spec.equalities',
    'tendon': 'use spec.tendons',
    'contact': 'use spec.pairs and spec.excludes',
    'default': 'use spec.default',
    'merge': 'use manip_sim.models.compose or World, which put parts together',
    'merge_assets': 'use manip_sim.models.compose or World, which put parts together',
    'get_element_names': 'use joints, bodies, actuators, sites, sensors, contact_geoms or '
                         'visual_geoms',
    'contact_geom_rgba': 'use rgba of spec.geom(name) for the names in contact_geoms',
    'grasp_qpos': 'use format_action, whose +1 closes, and init_qpos',
    'init_torso_qpos': 'use init_qpos, which has all joints, or init_base_qpos',
    'resolve_asset_dependency': 'files are found by the paths in the MJCF file',
    'exclude_from_prefixing': 'override correct_naming',
}
