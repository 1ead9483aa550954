"""Stones and pebbles that lie on the ground, partly buried: one per cell of a Voronoi pattern."""

from dataclasses import dataclass

import bpy

from .ground_detail import Layer
from .ground_noise import GroundNoise, add_raw_noise, between, clamp, ramp
from .node_builder import SocketOrValue

ROUGHNESS_WAVELENGTH, ROUGHNESS = 0.4, 0.13  # Of outlines, relative to the distance between stones.
SEEN_PIXELS = 3.3  # The distance between stones in pixels from which on they are seen in full.
SHADES, FOOT_SHADE = (0.55, 1.15), 0.5  # Brightness of stones, and the factor of it where they meet the ground.
CONTACT, CONTACT_SHADE = 1.4, 0.55  # How far the darkening of the ground around stones reaches, relative to their radius, and its factor.


@dataclass(frozen=True)
class Stones:
    """Stones of one size.

    Attributes:
        distance: between them, relative to Meter.
        radii: of the smallest and the largest, relative to the distance.
        height: of the largest, relative to the distance.
    """

    distance: float
    radii: tuple[float, float]
    height: float


COBBLES = Stones(0.5, (0.1, 0.5), 0.3)
PEBBLES = Stones(0.1, (0.08, 0.46), 0.24)


def add_stones(
    noise: GroundNoise,
    ground: Layer,
    kind: Stones,
    color: bpy.types.NodeSocket,
    density: bpy.types.NodeSocket,
    largest_density: SocketOrValue = 1.0,
) -> Layer:
    """Return ground on which stones of a color lie.

    density: part of all stones that are there, from 0 to 1. largest_density: anywhere; with 0, Cycles leaves out the nodes of stones.
    """
    builder, length = noise.builder, noise.builder.math("MULTIPLY", noise.inputs["Meter"], kind.distance)
    cells = builder.node("ShaderNodeTexVoronoi", {"voronoi_dimensions": "2D", "feature": "F1"})
    builder.connect(noise.position, cells.inputs["Vector"])
    builder.connect(builder.math("DIVIDE", 1.0, length), cells.inputs["Scale"])
    size, random, tone = builder.separate_color(cells.outputs["Color"])
    outline = add_raw_noise(builder, noise.position, builder.math("MULTIPLY", length, ROUGHNESS_WAVELENGTH), 1.0).outputs[0]
    from_center = builder.multiply_add(outline, ROUGHNESS, cells.outputs["Distance"])
    from_center = builder.math("DIVIDE", from_center, between(builder, size, *kind.radii))
    dome = builder.math("SQRT", builder.math("SUBTRACT", 1.0, builder.math("MULTIPLY", from_center, from_center)))

    weight = builder.math("SIGN", largest_density)
    seen = builder.math("DIVIDE", builder.math("DIVIDE", length, SEEN_PIXELS), noise.pixel)
    is_there = ramp(builder, builder.math("ADD", random, density), 1.04, 0.04)
    is_there = builder.math("MULTIPLY", builder.math("MULTIPLY", is_there, clamp(builder, seen)), weight)
    height = builder.math("MULTIPLY", builder.math("MULTIPLY", length, kind.height), weight)
    rise = builder.math("MULTIPLY", builder.math("MULTIPLY", dome, size), height)

    contact = ramp(builder, from_center, 0.5 * (1.0 + CONTACT), 0.5 * (CONTACT - 1.0), CONTACT_SHADE - 1.0, 0.0)
    contact = builder.math("ADD", builder.math("MULTIPLY", contact, is_there), 1.0)
    shade = ramp(builder, dome, 0.35, 0.35, FOOT_SHADE, 1.0)
    stone = builder.vector("SCALE", color, builder.math("MULTIPLY", shade, between(builder, tone, *SHADES)))
    cover = builder.math("MULTIPLY", builder.math("MULTIPLY", dome, 5.0), is_there)
    mixed = builder.mix(cover, builder.vector("SCALE", ground.color, contact), stone)
    return Layer(mixed, (*ground.bumps, (rise, is_there)))
