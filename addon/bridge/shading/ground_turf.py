"""Soil with grass: its color follows the moisture, and nearby it has blades, without geometry."""

import bpy

from .ground_detail import GroundBumps, Layer
from .ground_noise import NOISE_RANGE, GroundNoise, add_raw_noise, invert, ramp

PATCH_WAVELENGTH, PATCH_OCTAVES, PATCH_GAIN = 240.0, 6, 0.7  # Of moist and dry places, meters.
PATCH_MOISTURE, FINE_MOISTURE, NOISE_MOISTURE = 1.3, 0.22, 0.3  # By how much noise of all sizes changes the moisture.
HEIGHT_MOISTURE, NORTH_MOISTURE, STEEPNESS_MOISTURE = -0.3, 0.7, -0.5  # By height relative to Size, y of the normal, and 1 - z of it.
DRY, WET, SOFTNESS = -0.22, 0.24, 0.2  # The moisture at which grass is half dry, and half undergrowth; half the width of these borders.
WETTEST = 0.75  # How much undergrowth there is at most.
# Patches of bare soil, and of plants of other hues: meters. Dry soil is bare where this noise is high and tussocks are low.
WEAR_WAVELENGTH, WEAR_OCTAVES, WEAR_GAIN = 60.0, 4, 0.7
BARE, BARE_SOFTNESS, BARE_DRYNESS, BARE_TUSSOCKS, BAREST = 0.22, 0.07, 0.27, 0.6, 0.85
EARTH = (0.62, 0.48, 0.36)  # Color of bare soil, relative to that of rock debris.
COLOR_FACTORS, COLOR_RANGE = ((0.8, 0.92, 0.88), (1.24, 1.08, 0.8)), 0.2  # Factors of colors of plants, and noise at which they are these.
# Tufts: the wavelength of the largest in meters, and their octaves; the taps along a blade, and the length between them on the ground.
TUFT_WAVELENGTH, TUFT_OCTAVES, TUFT_GAIN, TAPS, TAP_LENGTH = 0.1, 4, 0.75, 4, 0.036
ROOT_SHADE, TIP_SHADE = 0.58, 1.6
BLADE_LIMITS, BLADE_SHARPNESS = (-0.45, 0.35), 1.8  # Noise above which there are blades, at the lowest and at the highest tap.
DRY_TIPS = 0.2
# Tussocks, which are seen where blades are too small: meters, octaves, and their contrast and height by noise between -0.5 and 0.5.
TUSSOCK_WAVELENGTH, TUSSOCK_OCTAVES, TUSSOCK_GAIN, TUSSOCK_CONTRAST, TUSSOCK_HEIGHT = 3.0, 5, 0.7, 0.9, 0.5


def add_moisture(noise: GroundNoise, bumps: GroundBumps, uneven: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the moisture of the ground, about -1 to 1: hollows and slopes to the north (y) are moist, ridges and steep ground are dry.

    uneven: variation by position, mean 0.
    """
    builder, normal = noise.builder, noise.normal
    height = builder.math("SUBTRACT", builder.separate(noise.position)[2], noise.inputs["Middle Height"])
    moisture = ramp(builder, height, 0.0, noise.inputs["Size"], -HEIGHT_MOISTURE, HEIGHT_MOISTURE)
    moisture = builder.multiply_add(normal[1], NORTH_MOISTURE, moisture)
    base = builder.math("ADD", noise.inputs["Moisture"], STEEPNESS_MOISTURE)
    moisture = builder.math("ADD", builder.multiply_add(normal[2], -STEEPNESS_MOISTURE, base), moisture)
    length = builder.math("MULTIPLY", noise.inputs["Meter"], PATCH_WAVELENGTH)
    patches = noise.noise(length, PATCH_OCTAVES, gain=PATCH_GAIN, dimensions="2D")
    for value, factor in ((patches, NOISE_RANGE * PATCH_MOISTURE), (bumps.fine, NOISE_RANGE * FINE_MOISTURE), (uneven, NOISE_MOISTURE)):
        moisture = builder.multiply_add(value, factor, moisture)
    return moisture


def add_turf(noise: GroundNoise, bumps: GroundBumps, uneven: bpy.types.NodeSocket) -> tuple[Layer, bpy.types.NodeSocket]:
    """Return soil with what grows on it, and how much of it is bare. uneven: variation by position, mean 0."""
    builder, inputs = noise.builder, noise.inputs
    moisture = add_moisture(noise, bumps, uneven)
    color = builder.mix(ramp(builder, moisture, DRY, SOFTNESS), inputs["Dry Grass"], inputs["Grass"])
    color = builder.mix(ramp(builder, moisture, WET, SOFTNESS, 0.0, WETTEST), color, inputs["Undergrowth"])
    wear = noise.noise(builder.math("MULTIPLY", inputs["Meter"], WEAR_WAVELENGTH), WEAR_OCTAVES, gain=WEAR_GAIN, dimensions="2D")
    color = builder.vector("MULTIPLY", color, builder.mix(ramp(builder, wear, 0.0, COLOR_RANGE / NOISE_RANGE), *COLOR_FACTORS))
    shade, tips = _add_blades(noise)
    color = builder.mix(builder.math("MULTIPLY", tips, DRY_TIPS), color, inputs["Dry Grass"])
    tussocks = noise.noise(
        builder.math("MULTIPLY", inputs["Meter"], TUSSOCK_WAVELENGTH), TUSSOCK_OCTAVES, gain=TUSSOCK_GAIN, dimensions="2D"
    )
    contrast = builder.math("MULTIPLY", inputs["Blades"], NOISE_RANGE * TUSSOCK_CONTRAST)
    shade = builder.math("MULTIPLY", shade, builder.multiply_add(tussocks, contrast, 1.0))
    bareness = builder.multiply_add(tussocks, -NOISE_RANGE * BARE_TUSSOCKS, builder.math("MULTIPLY", wear, NOISE_RANGE))
    is_bare = ramp(builder, builder.multiply_add(moisture, -BARE_DRYNESS, bareness), BARE, BARE_SOFTNESS, 0.0, BAREST)
    color = builder.mix(is_bare, builder.vector("SCALE", color, shade), builder.vector("MULTIPLY", inputs["Scree"], EARTH))
    height = builder.math("MULTIPLY", inputs["Meter"], builder.math("MULTIPLY", inputs["Blades"], NOISE_RANGE * TUSSOCK_HEIGHT))
    return Layer(color, ((builder.math("MULTIPLY", tussocks, height), invert(builder, is_bare)),)), is_bare


def _add_blades(noise: GroundNoise) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Return the brightness of blades, 1 on average, and how far their tips are seen.

    A blade that stands upright hides the ground behind it. So noise is read along the view, towards the camera: the highest blade on the
    way is seen, dark at the root and bright at the tip.
    """
    builder, meter = noise.builder, noise.inputs["Meter"]
    incoming = builder.node("ShaderNodeNewGeometry").outputs["Incoming"]
    towards = builder.vector("MULTIPLY", builder.vector_transform(incoming, "NORMAL", "WORLD", "OBJECT"), (1.0, 1.0, 0.0))
    towards = builder.vector("SCALE", towards, builder.math("MULTIPLY", meter, TAP_LENGTH))
    length = builder.math("MULTIPLY", meter, TUFT_WAVELENGTH)
    shown, seen = noise.count_octaves(length, TUFT_OCTAVES)
    position, shade, blade = noise.position, ROOT_SHADE, 0.0
    for tap in range(TAPS):
        part = tap / (TAPS - 1)
        value = add_raw_noise(builder, position, length, shown, gain=TUFT_GAIN, dimensions="2D").outputs[0]
        position = builder.vector("ADD", position, towards)
        limit = BLADE_LIMITS[0] + part * (BLADE_LIMITS[1] - BLADE_LIMITS[0])
        blade = ramp(builder, value, limit + 0.5 / BLADE_SHARPNESS, 0.5 / BLADE_SHARPNESS)
        brightness = ROOT_SHADE + (part + 0.3) / 1.3 * (TIP_SHADE - ROOT_SHADE)
        shade = builder.multiply_add(blade, builder.math("SUBTRACT", brightness, shade), shade)
    blades = builder.math("MULTIPLY", seen, noise.inputs["Blades"])
    shade = builder.math("MULTIPLY", builder.math("SUBTRACT", shade, 1.0), blades)  # Cycles leaves out factors of a constant 0.
    return builder.math("ADD", shade, 1.0), builder.math("MULTIPLY", blade, blades)
