"""Detail of the ground below the voxel, down to centimeters: bumps, cracks and layers of rock, stones, and ripples of sand.

Each kind has as many octaves of noise as pixels can show at its distance, so that nothing flickers far away. Each has a Bump node of its
own, whose strength is the fraction of its layer: what is connected to the height of a Bump node is evaluated three times.
"""

import math
from dataclasses import dataclass

import bpy

from .node_builder import NodeBuilder, SocketOrValue

PIXEL = 0.0016  # Size of the smallest details, relative to their distance: about one and a half pixels at a width of 960.
DIFFUSE_PIXEL = 0.1  # The same for light that is scattered to other ground, where details do not show and would take time.
NOISE_RANGE = 0.27  # Makes sums of octaves lie mostly between -0.5 and 0.5.
SOFT_BUMPS = 0.3  # Height of bumps on soil and snow, relative to those on rock.
JOINT_ASPECT, JOINT_COLOR = 0.35, 0.55  # Width of joints of rock by their height, and how much darker they are.
CRACK_ASPECT, CRACK_MEAN = 0.8, 0.9  # Width of cracks by their height, and their mean.
MAX_STEEPNESS_NOISE = 0.3  # How far noise moves the slope from which on ground is rock, at most.
STRATA_OCTAVES, STRATA_HEIGHT, STRATA_WARP = 5, 0.3, 1.0  # Height and warp are relative to the thickness of layers.
STONE_DISTANCE = 0.5  # Meters.
STONE_RADII, STONE_HEIGHT = (0.1, 0.6), 0.45  # The smallest and the largest, and the height of the largest, relative to the distance.
STONE_SEEN = 0.15  # The size in pixels from which on stones are seen in full, relative to the distance.
RIPPLE_WAVELENGTHS, MIN_PIXELS = (0.16, 1.9), 2.2  # Meters, and pixels per wavelength below which there are none.
RIPPLE_HEIGHTS, RIPPLE_SKEW = (0.08, 0.045), 0.6  # Relative to their wavelengths, and how much steeper they are behind their crests.
RIPPLE_CONTRAST = 0.16  # How much darker they are between their crests.
RIPPLE_WARP_WAVELENGTH, RIPPLE_WARP = 16.0, 4.5  # Of the noise that bends their crests, relative to their wavelengths.
MIN_FACING = 0.12  # Cosine of the angle of view: for lower ones, pixels are taken to be no longer.


@dataclass(frozen=True)
class Bumps:
    """Noise that shades the ground.

    Attributes:
        wavelength: of its first octave, relative to its unit.
        height: relative to the unit.
        octaves: their largest number, each half as long as the one before.
        contrast: how much darker hollows are than bumps.
    """

    wavelength: float
    height: float
    octaves: int
    contrast: float


DISTANT, DISTANT_FROM = Bumps(110.0, 20.0, 5, 0.8), 1200.0  # Relative to Bump Size. Nearer than the distance, voxels have that shape.
MEDIUM = Bumps(10.0, 3.0, 4, 0.9)  # Relative to Bump Size.
FINE, FINE_GAIN = Bumps(0.5, 0.09, 5, 2.0), 0.75  # Relative to Meter, and the height of each octave relative to that of the one before.
JOINTS = Bumps(36.0, 7.0, 4, 0.0)  # Relative to Bump Size: ridges of noise.
STONE_ROUGHNESS = Bumps(0.22, 0.4, 1, 0.0)  # Relative to Meter; its height relative to the distance between stones.
CRACKS = Bumps(3.4, 0.3, 7, 0.5)  # Relative to Meter: ridges of all sizes.


class GroundDetail:
    """The sockets of the detail at the position that is shaded.

    Attributes:
        pattern: bumps of all sizes, about -1 to 1, mean 0.
        fine: the smallest of them.
        shade: how much brighter bumps are, mean 0.
        strata: layers of rock, mean 0.
        rock_shade: factor of the brightness of rock, less than 1 in joints and cracks.
        ripple_shade: how much brighter the crests of ripples of sand are, mean 0.
        is_steep: whether the ground may be rock.
        stone_height: of stones, from 0 to 1; 0 between them.
        stone_random: of each stone, from 0 to 1.
    """

    def __init__(self, builder: NodeBuilder, inputs: bpy.types.bpy_prop_collection) -> None:
        self._builder, self._inputs = builder, inputs
        self._distance = builder.node("ShaderNodeCameraData").outputs["View Distance"]
        is_diffuse = builder.node("ShaderNodeLightPath").outputs["Is Diffuse Ray"]
        pixel = between(builder, is_diffuse, PIXEL, DIFFUSE_PIXEL)
        self._pixel = builder.math("MAXIMUM", builder.math("MULTIPLY", self._distance, pixel), 1e-6)
        self._log_pixel = builder.math("LOGARITHM", self._pixel, 2.0)
        self._add_bumps()
        self._add_rock()
        self._add_stones()
        self._add_ripples()

    def noise(
        self,
        wavelength: float,
        octaves: int,
        unit: bpy.types.NodeSocket,
        position: bpy.types.NodeSocket | None = None,
        kind: str = "FBM",
        gain: float = 0.5,
        part: bpy.types.NodeSocket | None = None,
    ) -> bpy.types.NodeSocket:
        """Return noise whose octaves fade where pixels cannot show them; its mean is 0 if its `kind` is "FBM".

        wavelength: of the first octave, relative to `unit`. gain: height of each octave relative to that of the one before. part: of the
        octaves; 0 where the noise is not used, to save time.
        """
        builder = self._builder
        noise = builder.node("ShaderNodeTexNoise", {"noise_type": kind, "normalize": False})
        scale = builder.math("DIVIDE", 1.0 / wavelength, unit)
        builder.connect(builder.vector("SCALE", position or self._inputs["Position"], scale), noise.inputs["Vector"])
        noise.inputs["Scale"].default_value, noise.inputs["Roughness"].default_value = 1.0, gain
        shown, seen = self._count_octaves(builder.math("MULTIPLY", unit, wavelength), octaves)
        builder.connect(shown if part is None else builder.math("MULTIPLY", shown, part), noise.inputs["Detail"])
        if kind == "FBM":
            seen = builder.math("MULTIPLY", seen, NOISE_RANGE)
        return builder.math("MULTIPLY", noise.outputs[0], seen)

    def add_normal(
        self, is_rock: bpy.types.NodeSocket, is_stone: bpy.types.NodeSocket, has_ripples: bpy.types.NodeSocket
    ) -> bpy.types.NodeSocket:
        """Return the normal of the ground. is_rock, is_stone, has_ripples: from 0 to 1."""
        strength = self._inputs["Bump Strength"]
        normal = self._inputs["Normal"]
        softness = between(self._builder, is_rock, SOFT_BUMPS)
        for height, fraction in (
            (self._height, softness),
            (self._rock_height, is_rock),
            (self._stone_length, is_stone),
            (self._ripple_height, has_ripples),
        ):
            bump = self._builder.node("ShaderNodeBump")
            self._builder.connect(self._builder.math("MULTIPLY", strength, fraction), bump.inputs["Strength"])
            self._builder.connect(height, bump.inputs["Height"])
            bump.inputs["Distance"].default_value = 1.0
            self._builder.connect(normal, bump.inputs["Normal"])
            normal = bump.outputs["Normal"]
        return normal

    def _add_bumps(self) -> None:
        builder, size, meter = self._builder, self._inputs["Bump Size"], self._inputs["Meter"]
        self.fine = self.noise(FINE.wavelength, FINE.octaves, meter, gain=FINE_GAIN)
        near = builder.math("DIVIDE", self._distance, builder.math("MULTIPLY", size, DISTANT_FROM), True)
        distant = self.noise(DISTANT.wavelength, DISTANT.octaves, size, part=builder.math("MULTIPLY", near, 10.0, True))
        distant = builder.math("MULTIPLY", distant, builder.math("MULTIPLY", near, self._inputs["Distant Bumps"]))
        medium = self.noise(MEDIUM.wavelength, MEDIUM.octaves, size)
        self._height, self.pattern, self.shade = 0.0, 0.0, 0.0
        for bumps, noise, unit in ((DISTANT, distant, size), (MEDIUM, medium, size), (FINE, self.fine, meter)):
            self._height = builder.math("ADD", builder.math("MULTIPLY", noise, builder.math("MULTIPLY", unit, bumps.height)), self._height)
            self.pattern = builder.math("ADD", noise, self.pattern)
            self.shade = builder.math("ADD", builder.math("MULTIPLY", noise, bumps.contrast), self.shade)

    def _add_rock(self) -> None:
        builder, position, size, meter = self._builder, self._inputs["Position"], self._inputs["Bump Size"], self._inputs["Meter"]
        normal_z = builder.separate(builder.vector_transform(self._inputs["Normal"], "NORMAL", "WORLD", "OBJECT"))[2]
        self.is_steep = builder.math("LESS_THAN", normal_z, builder.math("ADD", self._inputs["Rock Slope"], MAX_STEEPNESS_NOISE))
        stretched = builder.vector("MULTIPLY", position, (1.0, 1.0, JOINT_ASPECT))
        noise = self.noise(JOINTS.wavelength, JOINTS.octaves, size, stretched, part=self.is_steep)
        joints = builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", builder.math("ABSOLUTE", noise), 5.0), True)
        stretched = builder.vector("MULTIPLY", position, (1.0, 1.0, CRACK_ASPECT))
        cracks = self.noise(CRACKS.wavelength, CRACKS.octaves, meter, stretched, "RIDGED_MULTIFRACTAL", part=self.is_steep)

        thickness = builder.math("DIVIDE", self._inputs["Size"], self._inputs["Strata Scale"])
        warp = builder.math("MULTIPLY", noise, builder.math("MULTIPLY", thickness, STRATA_WARP))
        layers = builder.node("ShaderNodeTexNoise", {"noise_dimensions": "1D", "normalize": False})
        z = builder.math("ADD", builder.separate(position)[2], warp)
        builder.connect(builder.math("DIVIDE", z, thickness), layers.inputs["W"])
        layers.inputs["Scale"].default_value = 1.0
        builder.connect(self._count_octaves(thickness, STRATA_OCTAVES)[0], layers.inputs["Detail"])
        self.strata = builder.math("MULTIPLY", layers.outputs[0], NOISE_RANGE)

        height = builder.math("MULTIPLY", self.strata, builder.math("MULTIPLY", thickness, STRATA_HEIGHT))
        height = builder.math("SUBTRACT", height, builder.math("MULTIPLY", joints, builder.math("MULTIPLY", size, JOINTS.height)))
        self._rock_height = builder.math(
            "SUBTRACT", height, builder.math("MULTIPLY", cracks, builder.math("MULTIPLY", meter, CRACKS.height))
        )
        self.rock_shade = builder.math(
            "MULTIPLY",
            builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", joints, JOINT_COLOR)),
            builder.math("SUBTRACT", 1.0 + CRACK_MEAN * CRACKS.contrast, builder.math("MULTIPLY", cracks, CRACKS.contrast)),
        )

    def _add_stones(self) -> None:
        builder, meter = self._builder, self._inputs["Meter"]
        cells = builder.node("ShaderNodeTexVoronoi", {"voronoi_dimensions": "2D", "feature": "F1"})
        scale = builder.math("DIVIDE", 1.0 / STONE_DISTANCE, meter)
        builder.connect(builder.vector("SCALE", self._inputs["Position"], scale), cells.inputs["Vector"])
        cells.inputs["Scale"].default_value = 1.0
        size, self.stone_random, _ = builder.separate_color(cells.outputs["Color"])
        uneven = builder.math("MULTIPLY", self.noise(STONE_ROUGHNESS.wavelength, STONE_ROUGHNESS.octaves, meter), STONE_ROUGHNESS.height)
        from_center = builder.math("MAXIMUM", builder.math("ADD", cells.outputs["Distance"], uneven), 0.0)
        from_center = builder.math("DIVIDE", from_center, between(builder, size, *STONE_RADII))
        seen = builder.math("DIVIDE", builder.math("MULTIPLY", meter, STONE_SEEN * STONE_DISTANCE), self._pixel, True)
        dome = builder.math("SUBTRACT", 1.0, builder.math("POWER", from_center, 3.0), True)
        self.stone_height = builder.math("MULTIPLY", dome, seen)
        length = builder.math("MULTIPLY", size, builder.math("MULTIPLY", meter, STONE_HEIGHT * STONE_DISTANCE))
        self._stone_length = builder.math("MULTIPLY", self.stone_height, length)

    def _add_ripples(self) -> None:
        """Add ripples of sand, whose crests lie across the x axis."""
        builder, meter = self._builder, self._inputs["Meter"]
        x = builder.math("DIVIDE", builder.separate(self._inputs["Position"])[0], meter)
        geometry = builder.node("ShaderNodeNewGeometry").outputs
        facing = builder.math("ABSOLUTE", builder.vector("DOT_PRODUCT", geometry["Incoming"], geometry["Normal"]))
        footprint = builder.math("DIVIDE", self._pixel, builder.math("MAXIMUM", facing, MIN_FACING))
        height, shade = 0.0, 0.0
        for wavelength, relative in zip(RIPPLE_WAVELENGTHS, RIPPLE_HEIGHTS, strict=True):
            warp = self.noise(RIPPLE_WARP_WAVELENGTH * wavelength, 3, meter)
            moved = builder.math("ADD", x, builder.math("MULTIPLY", warp, RIPPLE_WARP * wavelength))
            phase = builder.math("MULTIPLY", moved, 2.0 * math.pi / wavelength)
            phase = builder.math("ADD", phase, builder.math("MULTIPLY", builder.math("SINE", phase), RIPPLE_SKEW))
            resolved = builder.math("DIVIDE", builder.math("MULTIPLY", meter, wavelength / MIN_PIXELS), footprint)
            seen = builder.math("SUBTRACT", resolved, 1.0, True)
            wave = builder.math("MULTIPLY", builder.math("SINE", phase), seen)
            height = builder.math("ADD", builder.math("MULTIPLY", wave, relative * wavelength), height)
            shade = builder.math("ADD", builder.math("MULTIPLY", wave, RIPPLE_CONTRAST), shade)
        self._ripple_height = builder.math("MULTIPLY", height, builder.math("MULTIPLY", meter, self._inputs["Ripples"]))
        self.ripple_shade = builder.math("MULTIPLY", shade, self._inputs["Ripples"])

    def _count_octaves(self, length: bpy.types.NodeSocket, octaves: int) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
        """Return how many octaves after the first, with a wavelength of `length`, pixels show, and how much of the first, from 0 to 1."""
        resolved = self._builder.math("SUBTRACT", self._builder.math("LOGARITHM", length, 2.0), self._log_pixel)
        clamp = self._builder.node("ShaderNodeClamp")
        self._builder.connect(resolved, clamp.inputs["Value"])
        clamp.inputs["Max"].default_value = octaves - 1.0
        return clamp.outputs[0], self._builder.math("ADD", resolved, 0.0, True)


def add_noise(builder: NodeBuilder, position: bpy.types.NodeSocket, scale: SocketOrValue, octaves: float) -> bpy.types.NodeSocket:
    """Return noise with a mean of 0 at a position."""
    noise = builder.node("ShaderNodeTexNoise")
    builder.connect(builder.vector("SCALE", position, scale), noise.inputs["Vector"])
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.0, octaves
    return builder.math("SUBTRACT", noise.outputs[0], 0.5)


def between(builder: NodeBuilder, fraction: bpy.types.NodeSocket, low: float, high: float = 1.0) -> bpy.types.NodeSocket:
    """Return a number between `low` and `high`."""
    return builder.math("ADD", builder.math("MULTIPLY", fraction, high - low), low)


def ramp(builder: NodeBuilder, value: SocketOrValue, center: SocketOrValue, half_width: SocketOrValue) -> bpy.types.NodeSocket:
    """Return a linear ramp from 0 at `center` - `half_width` to 1 at `center` + `half_width`."""
    width = builder.math("MULTIPLY", half_width, 2.0)
    return builder.math("ADD", builder.math("DIVIDE", builder.math("SUBTRACT", value, center), width), 0.5, True)
