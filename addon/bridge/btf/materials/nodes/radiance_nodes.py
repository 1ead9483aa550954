"""Shader nodes that decode the radiance of a texel under a Sun light; see `core.btf.tables`."""

import bpy

from .....core.btf.tables import LookupTables
from ....shading.node_builder import NodeBuilder, SocketOrValue, create_group
from .table_nodes import BLACK, map_uv, offset_to_cluster, split_pairs, split_weights, weight_sockets, weighted_sum

BASIS = "Basis"  # Label of image nodes.


def build_sun_group(name: str, tables: LookupTables, basis: bpy.types.Image, block_count: int, is_clustered: bool) -> bpy.types.NodeTree:
    """Create the group that decodes a texel's radiance under one Sun of unit irradiance. is_clustered: it has the input Cluster Offset."""
    cluster_input = [("Cluster Offset", "Float")] if is_clustered else []
    group = create_group(
        f"{name} Sun", [("View", "Vector"), ("Sun", "Vector"), *weight_sockets(block_count), *cluster_input], [("Color", "Color")]
    )
    builder = NodeBuilder(group)
    view, sun, *weights = list(builder.node("NodeGroupInput").outputs)[:-1]  # The last output is the virtual socket.
    cluster_offset = weights.pop() if is_clustered else None
    light = map_uv(builder, tables.lights_upper, sun)
    radiance = _decode_radiance(builder, tables, basis, split_pairs(weights), view, light, cluster_offset)
    builder.connect(radiance, builder.node("NodeGroupOutput").inputs[0])
    builder.arrange()
    return group


def _decode_radiance(
    builder: NodeBuilder,
    tables: LookupTables,
    image: bpy.types.Image,
    weights: list[tuple[SocketOrValue, SocketOrValue]],
    view: SocketOrValue,
    light: SocketOrValue,
    cluster_offset: SocketOrValue | None,
) -> SocketOrValue:
    """Return the sum over the components of weight times basis, interpolated between the surrounding views and lights."""
    scalar_weights = split_weights(builder, weights, tables.components)
    cell = builder.vector("ADD", builder.vector("SCALE", view, float(tables.views_per_side)), (0.5, 0.5, 0.0))
    low = builder.vector("FLOOR", cell)
    t_x, t_y, _ = builder.separate(builder.vector("SUBTRACT", cell, low))
    light_uv = builder.vector("ADD", builder.vector("MULTIPLY", light, tables.light_scale), tables.light_offset)
    uv_in_tile = offset_to_cluster(builder, light_uv, cluster_offset)
    total: SocketOrValue = BLACK
    for right, up in ((0, 0), (1, 0), (0, 1), (1, 1)):
        factor = builder.math(
            "MULTIPLY",
            t_x if right else builder.math("SUBTRACT", 1.0, t_x),
            t_y if up else builder.math("SUBTRACT", 1.0, t_y),
        )
        tile = builder.vector("MULTIPLY", builder.vector("ADD", low, (float(right), float(up), 0.0)), tables.tile_scale)
        uv = builder.vector("ADD", tile, uv_in_tile)
        radiance = weighted_sum(builder, image, BASIS, uv, tables.component_step, scalar_weights)
        total = builder.add_scaled(total, factor, radiance)
    return total
