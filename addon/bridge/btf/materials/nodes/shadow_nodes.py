"""Shader nodes for the visibility of a Sun light from a texel; see `core.btf.reflectance.shadows`."""

from collections.abc import Callable

import bpy

from .....core.btf.reflectance.shadows import PENUMBRA_ANGLE
from .....core.btf.tables import LookupTables
from ....shading.node_builder import NodeBuilder, SocketOrValue, create_group
from .table_nodes import call_group, flatten_pairs, map_uv, sample_weights, split_pairs, weight_sockets, weighted_scalar_sum

SHADOW_WEIGHTS, SHADOW_BASIS = "Shadow Weights", "Shadow Basis"  # Labels of image nodes; weights have several, indexed from 0.


def build_visibility_lookup(
    builder: NodeBuilder, name: str, tables: LookupTables, weight_images: list[bpy.types.Image], height: int, basis: bpy.types.Image | None
) -> Callable[[SocketOrValue, str], SocketOrValue] | None:
    """Return a function that adds a labeled node for the visibility, 0..1, of a Sun direction. None if there is no shadow table.

    height: of a block of `weight_images` in pixels.
    """
    if tables.shadow is None:
        return None
    weights = sample_weights(builder, weight_images, SHADOW_WEIGHTS, height)
    group = create_group(f"{name} Shadow", [("Sun", "Vector"), *weight_sockets(len(weights))], [("Visibility", "Float")])
    inner = NodeBuilder(group)
    direction, *weight_outputs = list(inner.node("NodeGroupInput").outputs)[:-1]
    sun_uv = map_uv(inner, tables.shadows_upper, direction)
    angle = weighted_scalar_sum(inner, basis, SHADOW_BASIS, tables.shadow, sun_uv, split_pairs(weight_outputs))
    visibility = inner.math("ADD", inner.math("MULTIPLY", angle, 1.0 / PENUMBRA_ANGLE), 0.5, clamp=True)
    inner.connect(visibility, inner.node("NodeGroupOutput").inputs[0])
    inner.arrange()
    return lambda sun, label: call_group(builder, group, (sun, *flatten_pairs(weights)), label)
