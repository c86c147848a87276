# Copyright 2026 The manip_sim developers
# SPDX-License-Identifier: Apache-2.0

"""Objects from texts of somebody who is not trusted: MJCF or YAML, which name no files."""

from __future__ import annotations

from collections.abc import Callable

from manip_sim.models.held_models import hold_model
from manip_sim.models.objects import create_object, object_from_model, ObjectModel
from manip_sim.models.regular_files import OneText
from manip_sim.models.strict_yaml import MAX_REQUESTED, parse_yaml

#: Name of an object that has none.
UNNAMED = 'object'


def object_from_text(text: OneText) -> tuple[bool, Callable[[], ObjectModel]]:
    """
    Return whether an object is quickly made for sure, and return what makes it.

    :param text: MJCF, or a description in YAML
    """
    if not text.content.startswith(b'<'):
        values = parse_yaml(text.read(text.file, 'YAML', MAX_REQUESTED), str(text.file))
        return True, lambda: create_object({'name': UNNAMED, **values}, text)
    model = hold_model(text.file, text)
    return model.is_light, lambda: named_by_itself(object_from_model(model, UNNAMED))


def named_by_itself(item: ObjectModel) -> ObjectModel:
    """Return an object with the name of its root body."""
    item.name = item.spec.worldbody.bodies[0].name or UNNAMED
    return item
