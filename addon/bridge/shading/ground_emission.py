"""Lava in the material of landscapes: below a height, dark plates of crust with cracks between them that glow.

Colors and numbers are inputs of a node group of its own, since a surface that may emit light costs time.
"""

from collections.abc import Mapping

import bpy

from .ground_noise import PIXEL, add_noise, between, ramp
from .node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

GROUP_NAME, GROUP_VERSION = "Farfield Lava", 1
INPUTS = (
    ("Position", "Vector"), ("Normal", "Vector"), ("Color", "Color"), ("Hot Color", "Color"), ("Strength", "Float"), ("Height", "Float"),
    ("Plates", "Float"), ("Meter", "Float"),
)  # fmt: skip
DEFAULTS = {
    "Color": (1.0, 0.08, 0.004, 1.0),
    "Hot Color": (1.0, 0.32, 0.03, 1.0),
    "Strength": 4.0,  # emission of the hottest lava
    "Height": 0.0,  # z below which there is lava
    "Plates": 11.0,  # mean size of plates of crust, meters
    "Meter": 1.0,
}
SIZES = 1.0, 0.31  # Of plates, relative to Plates.
CRACKS = 0.006, 0.07  # Widths of cracks where lava is cool and hot, relative to the plates.
HEAT_WAVELENGTH, WARP_WAVELENGTH, WARP = 6.0, 0.7, 0.45  # Relative to Plates.
CRACKED, MOLTEN = (0.02, 0.12), (0.27, 0.06)  # Heat at which crust cracks, and at which there is none; half the widths of transitions.
SHORE = 0.5  # Meters.
LEVEL = 0.9, 0.06  # z of the normal of ground that is level enough for lava, and half the width of the transition.


def add_emission(
    builder: NodeBuilder,
    position: bpy.types.NodeSocket,
    normal: bpy.types.NodeSocket,
    values: Mapping[str, SocketOrValue],
    shader: bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """Return a `shader` that also emits the light of lava, at a `position` relative to the terrain, with a `normal` in world space.

    values: of the inputs, other than `DEFAULTS`.
    """
    group = ensure_shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, (("Emission", "Color"),), _fill_group)
    node = builder.node("ShaderNodeGroup", {"node_tree": group, "width": 200.0})
    for socket, value in (DEFAULTS | dict(values)).items():
        builder.connect(value, node.inputs[socket])
    builder.connect(position, node.inputs["Position"])
    builder.connect(normal, node.inputs["Normal"])
    emission, total = builder.node("ShaderNodeEmission"), builder.node("ShaderNodeAddShader")
    builder.connect(node.outputs["Emission"], emission.inputs["Color"])
    builder.connect(shader, total.inputs[0])
    builder.connect(emission.outputs[0], total.inputs[1])
    return total.outputs[0]


def _fill_group(builder: NodeBuilder) -> None:
    inputs = builder.node("NodeGroupInput").outputs
    plates = builder.math("MULTIPLY", inputs["Plates"], inputs["Meter"])
    scaled = builder.vector("SCALE", inputs["Position"], builder.math("DIVIDE", 1.0, plates))
    heat = add_noise(builder, scaled, 1.0 / HEAT_WAVELENGTH, 4.0)
    shift = builder.node("ShaderNodeTexNoise")
    shift.inputs["Scale"].default_value, shift.inputs["Detail"].default_value = 1.0 / WARP_WAVELENGTH, 1.0
    builder.connect(scaled, shift.inputs["Vector"])
    warped = builder.vector("ADD", scaled, builder.vector("SCALE", shift.outputs["Color"], WARP))
    is_cracked = ramp(builder, heat, *CRACKED)
    width = between(builder, is_cracked, *CRACKS)
    distance = builder.node("ShaderNodeCameraData").outputs["View Distance"]
    pixel = builder.math("DIVIDE", builder.math("MULTIPLY", distance, PIXEL), plates)
    molten = ramp(builder, heat, *MOLTEN)
    for size in SIZES:
        cells = builder.node("ShaderNodeTexVoronoi", {"voronoi_dimensions": "2D", "feature": "DISTANCE_TO_EDGE"})
        cells.inputs["Scale"].default_value = 1.0 / size
        builder.connect(warped, cells.inputs["Vector"])
        # Cracks that are narrower than pixels are as wide as pixels, and darker.
        seen = builder.math("MAXIMUM", width, builder.math("DIVIDE", pixel, size))
        crack = builder.math("SUBTRACT", 1.0, builder.math("DIVIDE", cells.outputs["Distance"], seen), True)
        crack = builder.math("MULTIPLY", crack, builder.math("MULTIPLY", builder.math("DIVIDE", width, seen), size**0.5))
        molten = builder.math("MAXIMUM", molten, builder.math("MULTIPLY", crack, is_cracked))
    z = builder.math("ADD", builder.separate(inputs["Position"])[2], builder.math("MULTIPLY", heat, inputs["Meter"]))
    above = ramp(builder, z, inputs["Height"], builder.math("MULTIPLY", inputs["Meter"], SHORE))
    normal_z = builder.separate(builder.vector_transform(inputs["Normal"], "NORMAL", "WORLD", "OBJECT"))[2]
    molten = builder.math("MULTIPLY", molten, ramp(builder, normal_z, *LEVEL))
    heat = builder.math("MULTIPLY", molten, builder.math("SUBTRACT", 1.0, above))
    color = builder.mix(heat, inputs["Color"], inputs["Hot Color"])
    strength = builder.math("MULTIPLY", builder.math("POWER", heat, 1.5), inputs["Strength"])
    builder.connect(builder.vector("SCALE", color, strength), builder.node("NodeGroupOutput").inputs["Emission"])
