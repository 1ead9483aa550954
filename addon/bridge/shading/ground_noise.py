"""Noise for the ground, with as many octaves as pixels can show, so that nothing flickers far away and nothing is computed in vain.

Each node takes time for every sample of a render, like half an octave of noise. So lengths are computed from inputs only, which Cycles
does once, and noise is scaled by its consumers.
"""

import bpy

from .node_builder import NodeBuilder, SocketOrValue

PIXEL = 0.0016  # Size of the smallest details, relative to their distance: about one and a half pixels at a width of 960.
NOISE_RANGE = 0.27  # Makes sums of octaves lie mostly between -0.5 and 0.5.
MIN_FACING = 0.12  # Cosine of the angle of view: for lower ones, pixels are taken to be no longer.


class GroundNoise:
    """Adds noise at the position that is shaded.

    Attributes:
        builder: of the group of nodes.
        inputs: of the group, by name.
        position: relative to the terrain.
        normal: the three components of the normal, relative to the terrain.
        distance: to the camera.
        pixel: the length on the ground that a pixel shows, seen from above.
    """

    def __init__(self, builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection) -> None:
        self.builder, self.inputs, self.position = builder, inputs, inputs["Position"]
        self.normal = builder.separate(builder.vector_transform(inputs["Normal"], "NORMAL", "WORLD", "OBJECT"))
        self.distance = builder.node("ShaderNodeCameraData").outputs["View Distance"]
        self.pixel = builder.math("MULTIPLY", self.distance, PIXEL)
        self._log_pixel = builder.math("LOGARITHM", self.pixel, 2.0)

    def noise(
        self,
        length: SocketOrValue,
        octaves: SocketOrValue,
        position: bpy.types.NodeSocket | None = None,
        kind: str = "FBM",
        gain: float = 0.5,
        dimensions: str = "3D",
    ) -> bpy.types.NodeSocket:
        """Return noise whose octaves fade where pixels cannot show them; the sum of octaves of 1, `gain`, ..., not scaled.

        length: of the first octave. octaves: how many there are at most. dimensions: "3D", "2D" for ground that is not steep, which takes
        half the time, or "1D" for a `position` that is a number.
        """
        shown, seen = self.count_octaves(length, octaves)
        noise = add_raw_noise(self.builder, position or self.position, length, shown, kind, gain, dimensions)
        return self.builder.math("MULTIPLY", noise.outputs[0], seen)

    def count_octaves(self, length: SocketOrValue, octaves: SocketOrValue) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
        """Return how many octaves after the first, with a wavelength of `length`, pixels show, and how much of the first, from 0 to 1.

        The former may be negative, which Noise Texture nodes take for 0.
        """
        builder = self.builder
        resolved = builder.math("SUBTRACT", builder.math("LOGARITHM", length, 2.0), self._log_pixel)
        return builder.math("MINIMUM", resolved, builder.math("SUBTRACT", octaves, 1.0)), clamp(builder, resolved)

    def add_footprint(self) -> bpy.types.NodeSocket:
        """Return the length on the ground that a pixel shows, along the view."""
        geometry = self.builder.node("ShaderNodeNewGeometry").outputs
        facing = self.builder.math("ABSOLUTE", self.builder.vector("DOT_PRODUCT", geometry["Incoming"], geometry["Normal"]))
        return self.builder.math("DIVIDE", self.pixel, self.builder.math("MAXIMUM", facing, MIN_FACING))


def add_raw_noise(
    builder: NodeBuilder,
    position: bpy.types.NodeSocket,
    length: SocketOrValue,
    detail: SocketOrValue = 0.0,
    kind: str = "FBM",
    gain: float = 0.5,
    dimensions: str = "3D",
) -> bpy.types.Node:
    """Return a Noise Texture node with features of a length, whose octaves are added without scaling them to 0..1.

    detail: the number of octaves after the first. position: a number if `dimensions` is "1D".
    """
    noise = builder.node("ShaderNodeTexNoise", {"noise_type": kind, "normalize": False, "noise_dimensions": dimensions})
    builder.connect(position, noise.inputs["W" if dimensions == "1D" else "Vector"])
    builder.connect(builder.math("DIVIDE", 1.0, length), noise.inputs["Scale"])
    builder.connect(detail, noise.inputs["Detail"])
    noise.inputs["Roughness"].default_value = gain
    return noise


def add_noise(builder: NodeBuilder, position: bpy.types.NodeSocket, scale: SocketOrValue, octaves: float) -> bpy.types.NodeSocket:
    """Return noise with a mean of 0 at a position."""
    noise = builder.node("ShaderNodeTexNoise")
    builder.connect(position, noise.inputs["Vector"])
    builder.connect(scale, noise.inputs["Scale"])
    noise.inputs["Detail"].default_value = octaves
    return builder.math("SUBTRACT", noise.outputs[0], 0.5)


def clamp(builder: NodeBuilder, value: SocketOrValue) -> bpy.types.NodeSocket:
    """Return a number between 0 and 1."""
    node = builder.node("ShaderNodeClamp")
    builder.connect(value, node.inputs["Value"])
    return node.outputs[0]


def between(builder: NodeBuilder, fraction: bpy.types.NodeSocket, low: float, high: float = 1.0) -> bpy.types.NodeSocket:
    """Return a number between `low` and `high`."""
    return builder.multiply_add(fraction, high - low, low)


def invert(builder: NodeBuilder, fraction: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return 1 - fraction."""
    return builder.math("SUBTRACT", 1.0, fraction)


def ramp(
    builder: NodeBuilder, value: SocketOrValue, center: SocketOrValue, half_width: SocketOrValue, low: float = 0.0, high: float = 1.0
) -> bpy.types.NodeSocket:
    """Return a linear ramp from `low` at `center` - `half_width` to `high` at `center` + `half_width`."""
    node = builder.node("ShaderNodeMapRange")
    ends = builder.math("SUBTRACT", center, half_width), builder.math("ADD", center, half_width)
    for name, operand in zip(("Value", "From Min", "From Max", "To Min", "To Max"), (value, *ends, low, high), strict=True):
        builder.connect(operand, node.inputs[name])
    return node.outputs[0]
