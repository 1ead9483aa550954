"""Bumps of the ground below the voxel, down to centimeters, and what is made of them on steep ground: joints, cracks and layers of rock.

What is connected to the height of a Bump node is computed three times. So each kind of bumps has a node of its own, whose strength is not.
"""

from dataclasses import dataclass

import bpy

from .ground_noise import NOISE_RANGE, GroundNoise, ramp
from .node_builder import SocketOrValue


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
MEDIUM = Bumps(10.0, 3.0, 4, 0.9)  # Relative to Bump Size; it has more octaves where voxels are much larger than a meter.
FINE, FINE_GAIN = Bumps(0.5, 0.09, 5, 2.0), 0.75  # Relative to Meter, and the height of each octave relative to that of the one before.
JOINTS, JOINT_ASPECT, JOINT_COLOR = (
    Bumps(36.0, 7.0, 4, 0.0),
    0.35,
    0.55,
)  # Ridges of noise, with units and octaves as MEDIUM; width by height.
JOINT_SHARPNESS = 1.35
# Ridges of all sizes, relative to Meter or to four times Bump Size, whichever is larger. Width by height, and their mean.
CRACKS, CRACK_ASPECT, CRACK_MEAN, CRACK_VOXELS = Bumps(3.4, 0.12, 8, 0.65), 0.6, 0.9, 4.0
STRATA_OCTAVES, STRATA_HEIGHT, STRATA_WARP = 5, 0.45, 1.0  # Height and warp are relative to the thickness of layers.
STREAK_WAVELENGTH, STREAK_ASPECT, STREAK_COLOR = 5.0, 0.07, 1.1  # Of stains that run down rock: meters, width by height, contrast.


@dataclass(frozen=True)
class Layer:
    """One kind of ground.

    Attributes:
        color: its color.
        bumps: heights of bumps in scene units, each with how strong they are here, from 0 to 1.
    """

    color: bpy.types.NodeSocket
    bumps: tuple[tuple[bpy.types.NodeSocket, SocketOrValue], ...]


class GroundBumps:
    """Bumps that all ground has.

    Attributes:
        pattern: bumps of all sizes, about -1 to 1, mean 0.
        fine: the smallest of them.
        shade: how much brighter bumps are, mean 0.
        height: of bumps, scene units.
        gap: octaves by which a voxel is longer than a meter.
    """

    def __init__(self, noise: GroundNoise) -> None:
        builder, size, meter = noise.builder, noise.inputs["Bump Size"], noise.inputs["Meter"]
        self.fine = noise.noise(builder.math("MULTIPLY", meter, FINE.wavelength), FINE.octaves, gain=FINE_GAIN)
        near = builder.math("DIVIDE", noise.distance, builder.math("MULTIPLY", size, DISTANT_FROM))
        near = builder.math("MINIMUM", near, 1.0)
        octaves = builder.multiply_add(near, 10.0 * DISTANT.octaves, 1.0)  # Few where they are not seen, to save time.
        distant = noise.noise(builder.math("MULTIPLY", size, DISTANT.wavelength), octaves)
        distant = builder.math("MULTIPLY", distant, builder.math("MULTIPLY", near, noise.inputs["Distant Bumps"]))
        self.gap = builder.math("MAXIMUM", builder.math("LOGARITHM", builder.math("DIVIDE", size, meter), 2.0), 0.0)
        octaves = builder.math("ADD", self.gap, float(MEDIUM.octaves))
        medium = noise.noise(builder.math("MULTIPLY", size, MEDIUM.wavelength), octaves)
        self.height, self.pattern, self.shade = 0.0, 0.0, 0.0
        for bumps, value, unit in ((DISTANT, distant, size), (MEDIUM, medium, size), (FINE, self.fine, meter)):
            self.height = builder.multiply_add(value, builder.math("MULTIPLY", unit, NOISE_RANGE * bumps.height), self.height)
            self.pattern = builder.multiply_add(value, NOISE_RANGE, self.pattern)
            self.shade = builder.multiply_add(value, NOISE_RANGE * bumps.contrast, self.shade)


def add_rock(noise: GroundNoise, bumps: GroundBumps) -> Layer:
    """Return rock with layers, joints, cracks and stains."""
    builder, position, size, meter = noise.builder, noise.position, noise.inputs["Bump Size"], noise.inputs["Meter"]
    stretched = builder.vector("MULTIPLY", position, (1.0, 1.0, JOINT_ASPECT))
    octaves = builder.math("ADD", bumps.gap, float(JOINTS.octaves))
    folds = noise.noise(builder.math("MULTIPLY", size, JOINTS.wavelength), octaves, stretched)
    joints = builder.multiply_add(builder.math("ABSOLUTE", folds), -JOINT_SHARPNESS, 1.0)
    joints = builder.math("MAXIMUM", joints, 0.0)
    stretched = builder.vector("MULTIPLY", position, (1.0, 1.0, CRACK_ASPECT))
    length = builder.math("MAXIMUM", builder.math("MULTIPLY", meter, CRACKS.wavelength), builder.math("MULTIPLY", size, CRACK_VOXELS))
    cracks = noise.noise(length, CRACKS.octaves, stretched, "RIDGED_MULTIFRACTAL")

    thickness = builder.math("DIVIDE", noise.inputs["Size"], noise.inputs["Strata Scale"])
    warp = builder.math("MULTIPLY", thickness, NOISE_RANGE * STRATA_WARP)
    z = builder.multiply_add(folds, warp, builder.separate(position)[2])
    strata = noise.noise(thickness, STRATA_OCTAVES, z, dimensions="1D")

    height = builder.multiply_add(strata, builder.math("MULTIPLY", thickness, NOISE_RANGE * STRATA_HEIGHT), bumps.height)
    height = builder.multiply_add(joints, builder.math("MULTIPLY", size, -JOINTS.height), height)
    height = builder.multiply_add(cracks, builder.math("MULTIPLY", length, -CRACKS.height), height)

    shade = builder.multiply_add(cracks, -CRACKS.contrast, 1.0 + CRACK_MEAN * CRACKS.contrast)
    shade = builder.math("MULTIPLY", shade, builder.multiply_add(joints, -JOINT_COLOR, 1.0))
    streaks = builder.vector("MULTIPLY", position, (1.0, 1.0, STREAK_ASPECT))
    streaks = noise.noise(builder.math("MULTIPLY", meter, STREAK_WAVELENGTH), 3, streaks)
    shade = builder.math("MULTIPLY", shade, builder.multiply_add(streaks, NOISE_RANGE * STREAK_COLOR, 1.0))
    rock = builder.mix(ramp(builder, strata, 0.0, 0.1 / NOISE_RANGE), noise.inputs["Rock"], noise.inputs["Strata"])
    return Layer(builder.vector("SCALE", rock, shade), ((height, 1.0),))
