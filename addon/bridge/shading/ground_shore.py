"""The shore in the material of landscapes: a beach, wet ground and foam at the height of water, and the color of the depth below it."""

from dataclasses import dataclass

import bpy

from .ground_detail import GroundBumps
from .ground_noise import NOISE_RANGE, GroundNoise, ramp

# Meters above the water at which each ends, half the width of its border, and how far bumps move it.
BEACH, BEACH_BORDER, BEACH_NOISE = 1.9, 0.12, 1.3
WET, WET_BORDER, WET_NOISE = 0.65, 0.25, 0.5
# The line of foam: meters above the water, half its width and its borders, how far bumps move it, and the fine noise at which it is broken.
FOAM, FOAM_WIDTH, FOAM_BORDER, FOAM_NOISE, FOAM_GAPS = 0.1, 0.05, 0.03, 0.6, (0.04, 0.08)


@dataclass(frozen=True)
class Shore:
    """Numbers from 0 to 1 at the position that is shaded.

    Attributes:
        is_beach: part of sand or gravel that waves leave, on and below the shore.
        is_dry: 0 where the ground is wet.
        foam: part of foam.
        passed: light that the water above lets through, seen from above.
    """

    is_beach: bpy.types.NodeSocket
    is_dry: bpy.types.NodeSocket
    foam: bpy.types.NodeSocket
    passed: bpy.types.NodeSocket


def add_shore(noise: GroundNoise, bumps: GroundBumps, uneven: bpy.types.NodeSocket) -> Shore:
    """Return the shore. uneven: variation by position, mean 0."""
    builder, meter = noise.builder, noise.inputs["Meter"]
    z = builder.math("SUBTRACT", builder.separate(noise.position)[2], noise.inputs["Water Height"])
    passed = builder.attenuate(
        builder.math("DIVIDE", builder.math("MAXIMUM", builder.math("MULTIPLY", z, -1.0), 0.0), noise.inputs["Clarity"])
    )
    height = builder.math("DIVIDE", z, meter)
    is_beach = ramp(builder, builder.multiply_add(uneven, BEACH_NOISE, height), BEACH, BEACH_BORDER, 1.0, 0.0)
    is_dry = ramp(builder, builder.multiply_add(bumps.pattern, WET_NOISE, height), WET, WET_BORDER)
    from_line = builder.math("ABSOLUTE", builder.math("SUBTRACT", builder.multiply_add(bumps.pattern, FOAM_NOISE, height), FOAM))
    line = ramp(builder, from_line, FOAM_WIDTH, FOAM_BORDER, 1.0, 0.0)
    start, width = (part / NOISE_RANGE for part in FOAM_GAPS)
    foam = builder.math("MULTIPLY", line, ramp(builder, bumps.fine, start, width))
    return Shore(is_beach, is_dry, foam, passed)
