"""Which materials emit light."""

from collections.abc import Iterable

import bpy

from .node_groups import nodes_in

COLOR_AND_STRENGTH = {"EMISSION": ("Color", "Strength"), "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength")}


def has_emission(materials: Iterable[bpy.types.Material]) -> bool:
    """Return whether any of `materials` has a node, also inside groups, that emits light or may do so depending on its links."""
    trees = [material.node_tree for material in materials if material.node_tree is not None]
    return any(_emits(node) for tree in trees for node in nodes_in(tree, muted=False))


def _emits(node: bpy.types.Node) -> bool:
    if node.type not in COLOR_AND_STRENGTH:
        return False
    color, strength = (node.inputs[name] for name in COLOR_AND_STRENGTH[node.type])
    is_black = not color.is_linked and not any(color.default_value[:3])
    return not is_black and (strength.is_linked or strength.default_value != 0.0)
