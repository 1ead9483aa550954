"""Clouds in the sky of a World: a layer of noise at one height, which the Sun lights.

The layer is a plane above the viewer, and directions near the horizon meet it far away. Where the noise is above a threshold that the
cover sets, there is cloud. Its light follows from the noise a little farther towards the Sun: what lies behind more cloud is darker.
"""

import bpy

from .shading.node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

CLOUD_GROUP, CLOUD_VERSION = "Farfield Clouds", 1
CLOUD_INPUTS = ("Sky", "Color"), ("Sunlight", "Color"), ("Direction", "Vector"), ("Cover", "Float"), ("Sun X", "Float"), ("Sun Y", "Float")
CURVATURE = 0.13  # Added to the z of a direction, so that the layer ends at the horizon as over a round planet.
CLOUD_SCALE = 1.7  # Of the noise on a layer at a height of one.
TOWARDS_SUN = 0.16  # Distance to the noise that shadows a cloud.
HAZY, CLEAR = 0.02, 0.2  # The z of directions in which clouds are lost in haze, and in which they are clear.


def ensure_cloud_group() -> bpy.types.NodeTree:
    """Return the node group that puts clouds before the color of a sky."""
    return ensure_shared_group(CLOUD_GROUP, CLOUD_VERSION, CLOUD_INPUTS, (("Sky", "Color"),), _fill_cloud_group)


def _fill_cloud_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    x, y, z = builder.separate(inputs["Direction"])
    slant = builder.math("ADD", builder.math("MAXIMUM", z, 0.0), CURVATURE)
    place = builder.combine(builder.math("DIVIDE", x, slant), builder.math("DIVIDE", y, slant), 0.0)
    # By the measured quantiles of the noise, this fraction of it is within 0.03 of the cover, between 0.05 and 0.9.
    threshold = builder.multiply_add(inputs["Cover"], -0.26, 0.575)
    thickness = builder.math("SUBTRACT", _noise(builder, place, 9.0), threshold)
    towards = builder.vector("SCALE", builder.combine(inputs["Sun X"], inputs["Sun Y"], 0.0), TOWARDS_SUN)
    behind = builder.math("SUBTRACT", _noise(builder, builder.vector("ADD", place, towards), 4.0), threshold)
    opacity = _smooth(builder, thickness, 0.0, 0.11)
    seen = _smooth(builder, z, HAZY, CLEAR)
    light = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", _smooth(builder, behind, -0.05, 0.22), 0.75))
    base = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", _smooth(builder, thickness, 0.02, 0.3), 0.45))
    lit = builder.vector("SCALE", inputs["Sunlight"], builder.math("MULTIPLY", light, base))
    # The sky behind a cloud lights it from all sides.
    color = builder.vector("ADD", lit, builder.vector("SCALE", inputs["Sky"], 0.6))
    mixed = builder.mix(builder.math("MULTIPLY", opacity, seen), inputs["Sky"], color)
    builder.connect(mixed, builder.node("NodeGroupOutput").inputs["Sky"])


def _noise(builder: NodeBuilder, place: SocketOrValue, octaves: float) -> bpy.types.NodeSocket:
    """Return the noise of clouds at a place on their layer."""
    node = builder.node("ShaderNodeTexNoise", {"noise_dimensions": "2D"})
    builder.connect(place, node.inputs["Vector"])
    for name, value in (("Scale", CLOUD_SCALE), ("Detail", octaves), ("Roughness", 0.56), ("Distortion", 0.15)):
        node.inputs[name].default_value = value
    return node.outputs[0]


def _smooth(builder: NodeBuilder, value: SocketOrValue, low: float, high: float) -> bpy.types.NodeSocket:
    """Return 0 below `low` and 1 above `high`, with a smooth step between them."""
    node = builder.node("ShaderNodeMapRange", {"interpolation_type": "SMOOTHSTEP"})
    for operand, target in zip((value, low, high), node.inputs, strict=False):
        builder.connect(operand, target)
    return node.outputs[0]
