"""Sand with ripples that the wind makes."""

import math

import bpy

from .ground_detail import Layer
from .ground_noise import GroundNoise, add_raw_noise, clamp, ramp

WAVELENGTHS, MIN_PIXELS = (0.16, 1.9), 2.2  # Of ripples in meters, and pixels per wavelength below which there are none.
HEIGHTS, SKEW = (0.08, 0.05), 0.6  # Relative to their wavelengths, and how much steeper they are behind their crests.
CONTRAST = 0.24  # How much darker they are between their crests.
# The wind turns slowly: noise moves the crests along it, much longer along the wind (x) than across. Meters.
TURN_WAVELENGTH, TURN_ASPECT, TURN = 70.0, 0.3, 16.0
FORK_WAVELENGTH = 6.0  # Of the noise whose zeros are forks of crests, relative to their wavelength.
FORK_CALM = 2.6  # How fast ripples become higher away from forks.
STEEPNESS = 0.8  # z of the normal below which the wind makes no ripples.
LEE = 0.25  # Strength of ripples behind the crests of dunes, relative to that on the side of the wind.
CALM_WAVELENGTH, CALM = 30.0, 0.3  # Strength of ripples in some patches, relative to that in others; meters.


def add_sand(noise: GroundNoise) -> Layer:
    """Return sand with ripples, without other bumps."""
    builder, meter = noise.builder, noise.inputs["Meter"]
    turned = builder.vector("MULTIPLY", noise.position, (TURN_ASPECT, 1.0, 0.0))
    turn = add_raw_noise(builder, turned, builder.math("MULTIPLY", meter, TURN_WAVELENGTH), 1.0, dimensions="2D").outputs[0]
    x = builder.multiply_add(turn, builder.math("MULTIPLY", meter, TURN), builder.separate(noise.position)[0])
    footprint, strength = noise.add_footprint(), builder.math("MULTIPLY", _add_strength(noise), noise.inputs["Ripples"])
    has_ripples = builder.math("SIGN", noise.inputs["Ripples"])  # Cycles leaves out a Bump node whose height is a constant 0.
    bumps, shade = [], 1.0
    for wavelength, relative in zip(WAVELENGTHS, HEIGHTS, strict=True):
        length = builder.math("MULTIPLY", meter, wavelength)
        wave = _add_waves(noise, x, length)
        resolved = builder.math("DIVIDE", builder.math("DIVIDE", length, MIN_PIXELS), footprint)
        seen = builder.math("MULTIPLY", clamp(builder, builder.math("SUBTRACT", resolved, 1.0)), strength)
        height = builder.math("MULTIPLY", builder.math("MULTIPLY", length, relative), has_ripples)
        bumps.append((builder.math("MULTIPLY", wave, height), seen))
        shade = builder.multiply_add(builder.math("MULTIPLY", wave, seen), CONTRAST, shade)
    return Layer(builder.vector("SCALE", noise.inputs["Sand"], shade), tuple(bumps))


def _add_waves(noise: GroundNoise, x: bpy.types.NodeSocket, length: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return waves across x, from -1 to 1. Their phase has the argument of a complex noise added, so that crests fork at its zeros."""
    builder = noise.builder
    forks = add_raw_noise(builder, noise.position, builder.math("MULTIPLY", length, FORK_WAVELENGTH), dimensions="2D")
    real, imaginary, _ = builder.separate_color(forks.outputs["Color"])
    squared = builder.multiply_add(real, real, builder.math("MULTIPLY", imaginary, imaginary))
    amplitude = builder.math("MULTIPLY", builder.math("SQRT", squared), FORK_CALM)
    phase = builder.multiply_add(x, builder.math("DIVIDE", 2.0 * math.pi, length), builder.math("ARCTAN2", imaginary, real))
    phase = builder.multiply_add(builder.math("SINE", phase), SKEW, phase)
    return builder.math("MULTIPLY", builder.math("SINE", phase), builder.math("MINIMUM", amplitude, 1.0))


def _add_strength(noise: GroundNoise) -> bpy.types.NodeSocket:
    """Return the strength of ripples: little in calm patches and behind crests, none on steep slopes."""
    builder = noise.builder
    calm = noise.noise(builder.math("MULTIPLY", noise.inputs["Meter"], CALM_WAVELENGTH), 3, dimensions="2D")
    strength = builder.math("MULTIPLY", ramp(builder, calm, 0.0, 0.3, CALM, 1.0), ramp(builder, noise.normal[0], 0.1, 0.25, 1.0, LEE))
    return builder.math("MULTIPLY", strength, ramp(builder, noise.normal[2], STEEPNESS + 0.05, 0.05))
