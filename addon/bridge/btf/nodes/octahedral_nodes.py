"""Shader nodes for octahedral maps of directions, with the formulas of `core.geometry.directions`."""

import bpy

from ...shading.node_builder import NodeBuilder, SocketOrValue


def to_octahedral(builder: NodeBuilder, direction: SocketOrValue, upper: bool) -> bpy.types.NodeSocket:
    """Return the position (x, y, 0) in -1..1 of a `direction` of any length on the octahedral map.

    upper: on the hemi-octahedral map; directions below the horizon are projected onto it.
    """
    if upper:
        direction = builder.vector("MAXIMUM", direction, (-1e6, -1e6, 0.0))
    norm = builder.vector("DOT_PRODUCT", builder.vector("ABSOLUTE", direction), (1.0, 1.0, 1.0))
    projected = builder.vector("SCALE", direction, builder.math("DIVIDE", 1.0, builder.math("MAXIMUM", norm, 1e-12)))
    x, y, z = builder.separate(projected)
    if upper:
        return builder.combine(builder.math("ADD", x, y), builder.math("SUBTRACT", x, y), 0.0)
    fold = builder.vector("SCALE", _signs(builder, x, y), _depth_below_horizon(builder, z))
    return builder.vector("ADD", builder.combine(x, y, 0.0), fold)


def from_octahedral(builder: NodeBuilder, x: SocketOrValue, y: SocketOrValue, upper: bool) -> bpy.types.NodeSocket:
    """Return the unit direction at the position x, y in -1..1 of the map. The inverse of `to_octahedral`."""
    if upper:
        x, y = (builder.math("MULTIPLY", builder.math(operation, x, y), 0.5) for operation in ("ADD", "SUBTRACT"))
    norm = builder.math("ADD", builder.math("ABSOLUTE", x), builder.math("ABSOLUTE", y))
    z = builder.math("SUBTRACT", 1.0, norm)
    direction = builder.combine(x, y, builder.math("MAXIMUM", z, 0.0) if upper else z)
    if not upper:
        fold = builder.vector("SCALE", _signs(builder, x, y), _depth_below_horizon(builder, z))
        direction = builder.vector("SUBTRACT", direction, fold)
    return builder.vector("NORMALIZE", direction)


def _depth_below_horizon(builder: NodeBuilder, z: SocketOrValue) -> bpy.types.NodeSocket:
    """Return max(-z, 0): below the horizon the corners of the map fold outwards by this amount."""
    return builder.math("MAXIMUM", builder.math("MULTIPLY", z, -1.0), 0.0)


def _signs(builder: NodeBuilder, x: SocketOrValue, y: SocketOrValue) -> bpy.types.NodeSocket:
    """Return (sign x, sign y, 0), where the sign of 0 is -1."""
    return builder.combine(
        *(builder.math("SUBTRACT", builder.math("MULTIPLY", builder.math("GREATER_THAN", value, 0.0), 2.0), 1.0) for value in (x, y)), 0.0
    )
