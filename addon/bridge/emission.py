"""Which materials shine by themselves."""

from collections.abc import Iterable

import bpy

COLOUR_STRENGTH = {"EMISSION": ("Color", "Strength"), "BSDF_PRINCIPLED": ("Emission Color", "Emission Strength")}


def may_shine(materials: Iterable[bpy.types.Material]) -> bool:
    """Whether any of `materials` has a node, in groups too, that emits light, or would if what is linked to it says so."""
    return any(material.node_tree is not None and _shines(material.node_tree, set()) for material in materials)


def _shines(tree: bpy.types.NodeTree, met: set[str]) -> bool:
    if tree.name in met:
        return False
    met.add(tree.name)
    return any(not node.mute and _emits(node, met) for node in tree.nodes)


def _emits(node: bpy.types.Node, met: set[str]) -> bool:
    if node.type == "GROUP":
        return node.node_tree is not None and _shines(node.node_tree, met)
    if node.type not in COLOUR_STRENGTH:
        return False
    colour, strength = (node.inputs[name] for name in COLOUR_STRENGTH[node.type])
    black = not colour.is_linked and not any(colour.default_value[:3])
    return not black and (strength.is_linked or strength.default_value != 0.0)
