"""The material of landscapes: shader nodes that choose rock, soil, sand or snow by the normal and the height, with noise of all sizes.

All colors and numbers are inputs of one node group, which the terrains of all tools share. Rock, soil and sand are shaders of their own,
since Cycles skips what only belongs to a shader whose part of a mix is 0. So nothing of rock is computed on a meadow, and hardly anything
for light that other ground scatters, where details do not show.
"""

from collections.abc import Mapping

import bpy

from .ground_detail import GroundBumps, Layer, add_rock
from .ground_noise import GroundNoise, add_noise, between, invert, ramp
from .ground_sand import add_sand
from .ground_shore import add_shore
from .ground_stones import COBBLES, PEBBLES, add_stones
from .ground_turf import add_turf
from .node_builder import NodeBuilder, SocketOrValue, ensure_shared_group

GROUP_NAME = "Farfield Ground"
GROUP_VERSION = 6
NO_WATER = -1e6  # scene units

BREAKUP = 0.35  # How much bumps move the borders between layers, relative to the variation by noise.
WET_COLOR, WET_ROUGHNESS = 0.45, 0.35  # Of wet ground, relative to dry ground.
SOFT_BUMPS = 0.3  # Height of bumps on soil, sand and snow, relative to those on rock.
# Contrast of bumps on each kind of ground; rock has cracks, too.
ROCK_CONTRAST, SOIL_CONTRAST, SAND_CONTRAST, SNOW_CONTRAST = 0.55, 0.8, 0.45, 0.35
DEBRIS_SHADE, DEBRIS_CONTRAST = 0.7, 1.5  # Brightness of the ground between the stones of rock debris, and contrast of its bumps.
DEBRIS_ROCK, DEBRIS_NOISE = 0.5, 0.25  # Most of the color of rock in debris, and bumps at which there is half of it.
BARE_STONES = 0.06  # Fraction of stones on bare soil.
FOAM_COLOR = (0.72, 0.75, 0.76)
# Bands with pebbles: meters, the noise at their borders, and how many pebbles there are between them.
TRACK_WAVELENGTH, TRACK_WIDTH, BETWEEN_TRACKS = 11.0, 0.5, 0.12
INPUTS = (
    ("Position", "Vector"), ("Normal", "Vector"), ("Rock", "Color"), ("Strata", "Color"), ("Scree", "Color"), ("Grass", "Color"),
    ("Undergrowth", "Color"), ("Dry Grass", "Color"), ("Sand", "Color"), ("Snow", "Color"), ("Water", "Color"), ("Rock Slope", "Float"),
    ("Scree Width", "Float"), ("Snow Height", "Float"), ("Sand Height", "Float"), ("Water Height", "Float"), ("Clarity", "Float"),
    ("Size", "Float"), ("Height Blend", "Float"), ("Height Noise", "Float"), ("Slope Blend", "Float"), ("Slope Noise", "Float"),
    ("Noise Scale", "Float"), ("Strata Scale", "Float"), ("Color Noise", "Float"), ("Roughness", "Float"), ("Bump Size", "Float"),
    ("Bump Strength", "Float"), ("Distant Bumps", "Float"), ("Meter", "Float"), ("Middle Height", "Float"), ("Moisture", "Float"),
    ("Stones", "Float"), ("Pebbles", "Float"), ("Blades", "Float"), ("Ripples", "Float"),
)  # fmt: skip
OUTPUTS = ("Shader", "Shader"), ("Color", "Color")
LAYERS = ("Rock", "Strata", "Scree", "Grass", "Undergrowth", "Dry Grass", "Sand", "Snow")  # The inputs that are colors of the ground.
DEFAULTS = {
    "Rock": (0.17, 0.14, 0.115, 1.0),
    "Strata": (0.26, 0.225, 0.18, 1.0),
    "Scree": (0.2, 0.175, 0.15, 1.0),
    "Grass": (0.075, 0.095, 0.028, 1.0),
    "Undergrowth": (0.034, 0.048, 0.016, 1.0),
    "Dry Grass": (0.15, 0.14, 0.05, 1.0),
    "Sand": (0.36, 0.27, 0.16, 1.0),
    "Snow": (0.8, 0.83, 0.88, 1.0),
    "Rock Slope": 0.72,  # z of the normal below which the ground is rock
    "Scree Width": 0.1,  # how much larger z is where rock debris ends and soil begins
    "Water Height": NO_WATER,  # below it and a little above, the ground is wet
    "Water": (0.006, 0.035, 0.045, 1.0),  # color of deep water
    "Clarity": 4.0,  # depth at which 63 % of the color is that of deep water
    "Height Blend": 0.02,  # half the width of the blends at Sand Height and Snow Height, relative to Size
    "Height Noise": 0.7,  # variation of these heights, relative to Size
    "Slope Blend": 0.015,  # half the width of the blend at Rock Slope
    "Slope Noise": 0.35,  # variation of Rock Slope
    "Noise Scale": 6.0,  # noise features per Size
    "Strata Scale": 9.0,  # layers of rock per Size
    "Color Noise": 0.8,  # variation of the brightness by noise
    "Roughness": 0.9,
    "Bump Size": 1.0,  # length of bumps that shading adds between the voxels
    "Bump Strength": 1.0,
    "Distant Bumps": 1.0,  # how much of the large bumps there is, where distant ground has fewer samples
    "Meter": 1.0,  # length of a meter, of which stones, cracks and ripples have their sizes
    "Stones": 0.03,  # fraction of the stones of rock debris that also lie on level ground
    "Middle Height": 0.0,  # where the ground is neither moist as valleys nor dry as summits
    "Moisture": 0.0,  # from -1, where all grass is dry, to 1, where all is undergrowth
    "Pebbles": 0.0,  # fraction of places with pebbles, in bands on sand and soil
    "Blades": 1.0,  # how far blades of grass are seen nearby
    "Ripples": 0.0,  # height of ripples that the wind makes of sand
}


def add_ground(
    builder: NodeBuilder, position: bpy.types.NodeSocket, normal: bpy.types.NodeSocket, values: Mapping[str, SocketOrValue]
) -> bpy.types.NodeSocket:
    """Add the ground at a `position` relative to the terrain, with a `normal` in world space. Returns its shader.

    values: of its inputs, other than `DEFAULTS`.
    """
    group = builder.node("ShaderNodeGroup", {"node_tree": _ensure_ground_group(), "width": 200.0})
    for socket, value in (DEFAULTS | dict(values)).items():
        builder.connect(value, group.inputs[socket])
    builder.connect(position, group.inputs["Position"])
    builder.connect(normal, group.inputs["Normal"])
    return group.outputs["Shader"]


def _ensure_ground_group() -> bpy.types.NodeTree:
    return ensure_shared_group(GROUP_NAME, GROUP_VERSION, INPUTS, OUTPUTS, _fill_ground_group)


def _fill_ground_group(builder: NodeBuilder) -> None:
    for item in builder.tree.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name in DEFAULTS:
            item.default_value = DEFAULTS[item.name]
    ground = GroundGroup(builder)
    soil, sand, rock = ground.add_soil(), ground.add_sand(), ground.add_rock()
    output = builder.node("NodeGroupOutput")
    color = builder.mix(ground.is_rock, builder.mix(ground.is_sand, soil.color, sand.color), rock.color)
    builder.connect(color, output.inputs["Color"])
    surface = ground.mix_shaders(ground.is_sand, ground.shade(soil), ground.shade(sand))
    surface = ground.mix_shaders(ground.is_rock, surface, ground.shade(rock))
    is_diffuse = builder.node("ShaderNodeLightPath").outputs["Is Diffuse Ray"]
    builder.connect(ground.mix_shaders(is_diffuse, surface, ground.add_plain()), output.inputs["Shader"])


class GroundGroup:
    """The kinds of ground at the position that is shaded, and how much there is of each.

    Attributes:
        is_rock: part of rock.
        is_sand: part of sand of what is not rock.
    """

    def __init__(self, builder: NodeBuilder) -> None:
        self._builder = builder
        self._inputs = inputs = builder.node("NodeGroupInput").outputs
        self._noise = noise = GroundNoise(builder, inputs)
        self._bumps = bumps = GroundBumps(noise)
        variation = add_noise(builder, inputs["Position"], builder.math("DIVIDE", inputs["Noise Scale"], inputs["Size"]), 3.0)
        # What is higher reaches farther beyond the border of its layer.
        self._uneven = builder.multiply_add(bumps.pattern, BREAKUP, variation)
        self._z = builder.separate(inputs["Position"])[2]
        height = builder.multiply_add(self._uneven, builder.math("MULTIPLY", inputs["Size"], inputs["Height Noise"]), self._z)
        blend = builder.math("MULTIPLY", inputs["Size"], inputs["Height Blend"])
        self._normal_z = builder.multiply_add(self._uneven, inputs["Slope Noise"], noise.normal[2])
        self._is_snow = ramp(builder, height, inputs["Snow Height"], blend)
        self.is_rock = ramp(builder, self._normal_z, inputs["Rock Slope"], inputs["Slope Blend"], 1.0, 0.0)
        self._tone = builder.multiply_add(variation, inputs["Color Noise"], 1.0)
        self._shore = shore = add_shore(noise, bumps, self._uneven)
        self.is_sand = builder.math("MAXIMUM", ramp(builder, height, inputs["Sand Height"], blend, 1.0, 0.0), shore.is_beach)
        self._wetness = between(builder, shore.is_dry, WET_COLOR)
        self._roughness = builder.math("MULTIPLY", inputs["Roughness"], between(builder, shore.is_dry, WET_ROUGHNESS))

    def add_rock(self) -> Layer:
        """Return rock."""
        rock = add_rock(self._noise, self._bumps)
        return Layer(self._finish(rock.color, ROCK_CONTRAST), rock.bumps)

    def add_sand(self) -> Layer:
        """Return sand with ripples, pebbles and stones; gravel on beaches whose sand is darker."""
        builder, sand = self._builder, add_sand(self._noise)
        color = builder.mix(self._shore.is_beach, sand.color, builder.vector("MAXIMUM", sand.color, self._inputs["Scree"]))
        sand = self._scatter(Layer(color, (self._soft_bumps(), *sand.bumps)))
        return Layer(self._finish(sand.color, SAND_CONTRAST), sand.bumps)

    def add_soil(self) -> Layer:
        """Return soil with grass, snow and stones."""
        builder = self._builder
        turf, is_bare = add_turf(self._noise, self._bumps, self._uneven)
        bumps = [(height, builder.math("MULTIPLY", invert(builder, self._is_snow), strength)) for height, strength in turf.bumps]
        soil = Layer(builder.mix(self._is_snow, turf.color, self._inputs["Snow"]), (self._soft_bumps(), *bumps))
        soil = self._scatter(soil, builder.math("MULTIPLY", is_bare, BARE_STONES))
        return Layer(self._finish(soil.color, between(builder, self._is_snow, SOIL_CONTRAST, SNOW_CONTRAST)), soil.bumps)

    def add_plain(self) -> bpy.types.NodeSocket:
        """Return the shader of all ground without details."""
        builder, inputs = self._builder, self._inputs
        blend = builder.math("MULTIPLY", inputs["Size"], 0.1)
        ground = builder.mix(ramp(builder, self._z, inputs["Sand Height"], blend), inputs["Sand"], inputs["Grass"])
        ground = builder.mix(ramp(builder, self._z, inputs["Snow Height"], blend), ground, inputs["Snow"])
        ground = builder.mix(ramp(builder, self._noise.normal[2], inputs["Rock Slope"], 0.1), inputs["Rock"], ground)
        diffuse = builder.node("ShaderNodeBsdfDiffuse")
        builder.connect(builder.mix(self._shore.passed, inputs["Water"], ground), diffuse.inputs["Color"])
        return diffuse.outputs[0]

    def _soft_bumps(self) -> tuple[bpy.types.NodeSocket, float]:
        return self._bumps.height, SOFT_BUMPS

    def _scatter(self, ground: Layer, loose: SocketOrValue = 0.0) -> Layer:
        """Return ground with pebbles, stones of rock debris near rock, and loose stones in clumps, where the ground is uneven.

        loose: fraction of the stones of rock debris that are there anyway.
        """
        builder, inputs, noise = self._builder, self._inputs, self._noise
        is_free = invert(builder, self._is_snow)
        tracks = noise.noise(builder.math("MULTIPLY", inputs["Meter"], TRACK_WAVELENGTH), 4, dimensions="2D")
        tracks = ramp(builder, builder.math("ABSOLUTE", tracks), 0.5 * TRACK_WIDTH, 0.5 * TRACK_WIDTH, 1.0, BETWEEN_TRACKS)
        density = builder.math("MULTIPLY", builder.math("MULTIPLY", tracks, is_free), inputs["Pebbles"])
        ground = add_stones(noise, ground, PEBBLES, inputs["Scree"], density, inputs["Pebbles"])
        width = builder.math("MULTIPLY", inputs["Scree Width"], 0.5)
        start = builder.math("ADD", inputs["Rock Slope"], builder.math("MULTIPLY", inputs["Scree Width"], 0.75))
        is_scree = builder.math("MULTIPLY", ramp(builder, self._normal_z, start, width, 1.0, 0.0), is_free)
        rocky = ramp(builder, self._bumps.pattern, 0.0, DEBRIS_NOISE, 0.0, DEBRIS_ROCK)
        shade = builder.multiply_add(self._bumps.shade, DEBRIS_SHADE * DEBRIS_CONTRAST, DEBRIS_SHADE)
        debris = builder.vector("SCALE", builder.mix(rocky, inputs["Scree"], inputs["Rock"]), shade)
        ground = Layer(builder.mix(ramp(builder, is_scree, 0.5, 0.25), ground.color, debris), ground.bumps)
        clumps = builder.math("MULTIPLY", ramp(builder, self._uneven, 0.1, 0.25), is_free)
        density = builder.math("MAXIMUM", is_scree, builder.multiply_add(clumps, inputs["Stones"], loose))
        return add_stones(noise, ground, COBBLES, inputs["Scree"], density)

    def _finish(self, color: bpy.types.NodeSocket, contrast: SocketOrValue) -> bpy.types.NodeSocket:
        """Return a color that varies with position, darker in the hollows of bumps and where it is wet, with foam at the shore and
        that of water below it."""
        builder = self._builder
        brightness = builder.multiply_add(self._bumps.shade, contrast, 1.0)
        brightness = builder.math("MULTIPLY", builder.math("MULTIPLY", brightness, self._tone), self._wetness)
        color = builder.mix(self._shore.foam, builder.vector("SCALE", color, brightness), FOAM_COLOR)
        return builder.mix(self._shore.passed, self._inputs["Water"], color)

    def shade(self, layer: Layer) -> bpy.types.NodeSocket:
        """Return the shader of a layer."""
        builder, normal = self._builder, self._inputs["Normal"]
        for height, strength in layer.bumps:
            bump = builder.node("ShaderNodeBump")
            bump.inputs["Distance"].default_value = 1.0
            builder.connect(builder.math("MULTIPLY", self._inputs["Bump Strength"], strength), bump.inputs["Strength"])
            builder.connect(height, bump.inputs["Height"])
            builder.connect(normal, bump.inputs["Normal"])
            normal = bump.outputs["Normal"]
        principled = builder.node("ShaderNodeBsdfPrincipled")
        builder.connect(layer.color, principled.inputs["Base Color"])
        builder.connect(self._roughness, principled.inputs["Roughness"])
        builder.connect(normal, principled.inputs["Normal"])
        return principled.outputs[0]

    def mix_shaders(
        self, fraction: bpy.types.NodeSocket, first: bpy.types.NodeSocket, second: bpy.types.NodeSocket
    ) -> bpy.types.NodeSocket:
        """Return (1 - fraction) of the first shader and `fraction` of the second."""
        mix = self._builder.node("ShaderNodeMixShader")
        for operand, target in zip((fraction, first, second), mix.inputs, strict=True):
            self._builder.connect(operand, target)
        return mix.outputs[0]
