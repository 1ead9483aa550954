"""Nodes that find how much of a sun reaches a texel; see `core.btf.shadows`."""

from collections.abc import Callable

import bpy

from ..core.btf.shadows import PENUMBRA
from ..core.btf.tables import Tables
from .node_groups import new_group
from .table_nodes import paired, pairs, place_node, sum_of_numbers, weight_sockets, weight_textures
from .wiring import Operand, Wiring

SHADOW_WEIGHTS, SHADOW_BASIS = "Shadow Weights", "Shadow Basis"  # labels of image nodes; of weights there are several, numbered from 0


def shadow_finder(
    wiring: Wiring, name: str, tables: Tables, weight_images: list[bpy.types.Image], height: int, basis: bpy.types.Image | None
) -> Callable[[Operand, str], Operand] | None:
    """What adds nodes for how much of a sun reaches the texel, 0..1, with a label; None where there are no shadows.

    height: of a block of `weight_images`.
    """
    if tables.shadow is None:
        return None
    weights = weight_textures(wiring, weight_images, SHADOW_WEIGHTS, height)
    group = new_group(f"{name} Shadow", [("Sun", "Vector"), *weight_sockets(len(weights))], [("Reached", "Float")])
    inner = Wiring(group)
    direction, *rest = list(inner.node("NodeGroupInput").outputs)[:-1]
    place = place_node(inner, tables.shadows_upper, direction)
    angle = sum_of_numbers(inner, basis, SHADOW_BASIS, tables.shadow, place, paired(rest))
    reached = inner.math("ADD", inner.math("MULTIPLY", angle, 1.0 / PENUMBRA), 0.5, clamp=True)
    inner.connect(reached, inner.node("NodeGroupOutput").inputs[0])
    inner.arrange()

    def found(sun: Operand, label: str) -> Operand:
        node = wiring.node("ShaderNodeGroup", {"node_tree": group, "label": label})
        for operand, target in zip((sun, *pairs(weights)), node.inputs, strict=True):
            wiring.connect(operand, target)
        return node.outputs[0]

    return found
