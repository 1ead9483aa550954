"""Which materials shine by themselves."""

from collections.abc import Iterable

import bpy

from .node_groups import nodes_in

COLOUR_STRENGTH = {"EMISSION": ("Color", "Strength"), "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength")}


def may_shine(materials: Iterable[bpy.types.Material]) -> bool:
    """Whether any of `materials` has a node, in groups too, that emits light, or would if what is linked to it says so."""
    trees = [material.node_tree for material in materials if material.node_tree is not None]
    return any(_emits(node) for tree in trees for node in nodes_in(tree, muted=False))


def _emits(node: bpy.types.Node) -> bool:
    if node.type not in COLOUR_STRENGTH:
        return False
    colour, strength = (node.inputs[name] for name in COLOUR_STRENGTH[node.type])
    black = not colour.is_linked and not any(colour.default_value[:3])
    return not black and (strength.is_linked or strength.default_value != 0.0)
