"""The landscape *Lava*: volcanoes with craters, flows of basalt one on another, and rivers and lakes of lava at a height of 0.

Lengths are meters.
"""

import numpy as np

from .hashing import hash_lattice, uniform_random
from .height_noise import Gullies, Heights, carve_gullies, resolve, sum_octaves
from .landscape_parts import GULLIES, MORE, WARPS, Shape, rise, warp

VOLCANOES = 400  # Added to the seed.
CELL, FRACTION = 2_000.0, 0.75  # Side of the square cells in which volcanoes lie, and how many of them have one.
RADII, STEEPNESS = (0.2, 0.55), (0.36, 0.46)  # From the smallest to the largest: of the foot, relative to a cell; height by radius.
JITTER = 0.5  # Of their places, relative to a cell.
CRATERS, FLOOR = (0.17, 0.27), 0.4  # Radii of craters, relative to that of the foot, and of their floors, relative to that.
PROFILE = 2.0  # Exponent of their flanks, which are steeper towards the crater.
OUTLINE_WAVELENGTH, OUTLINE = 420.0, 0.12  # How far noise moves craters and feet, relative to their radii.
PLAIN_WAVELENGTH, PLAIN, PLAIN_HEIGHT = 1_700.0, 20.0, 9.0  # How high the plain is above lava, and how much that varies.
FLOWS = (640.0, 11.0), (270.0, 7.0), (110.0, 4.0)  # Wavelengths and heights of flows.
CRUST_WAVELENGTH, CRUST_HEIGHT, MEAN_CRUST = 22.0, 2.2, 0.25  # Of rough crust. Ridges of noise are as far below their top on average.
RIVER_WIDTH, RIVER_DEPTH = 0.13, 6.0  # In noise, and below 0, before lava fills them.
SHORE = 2.0  # Rounds off the shores of lava.
CONE_FOOT = 18.0  # Height of volcanoes that rivers flow around.


def lava(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return volcanoes on a plain of basalt, with rivers and lakes of lava at 0."""
    seed = shape.seed + MORE
    plain = sum_octaves(x, y, spacing, PLAIN_WAVELENGTH, 4, shape.seed, 0.45).scale(PLAIN)
    plain = plain.map(plain.height + np.float32(PLAIN_HEIGHT), np.float32(1.0))
    cones, molten = find_volcanoes(x, y, spacing, shape)
    ground = plain.add(cones).scale(shape.ruggedness)
    ground = carve_gullies(ground, x, y, spacing, Gullies(240.0, 5, 0.08 * shape.erosion, 0.68, 0.5), shape.seed + GULLIES)
    for number, (wavelength, height) in enumerate(FLOWS):  # They have no gullies, which are deeper than flows are high.
        flow = rise(sum_octaves(x, y, spacing, wavelength, 3, seed + 4 * number, 0.4), 0.12, 0.07)
        ground = ground.add(flow, height * shape.ruggedness)
    ground = ground.add(_find_crust(x, y, spacing, seed + 12), CRUST_HEIGHT * shape.ruggedness)
    rivers = warp(lambda x, y: sum_octaves(x, y, spacing, 2_300.0, 3, seed + 20, 0.35), x, y, spacing, 600.0, 70.0, shape.seed + WARPS)
    valley = np.exp(-((rivers.height / np.float32(RIVER_WIDTH)) ** 2))
    rivers = rivers.map(valley, np.float32(-2.0 / RIVER_WIDTH**2) * rivers.height * valley)
    rivers = rivers.multiply(_invert(rise(cones, CONE_FOOT, 0.5 * CONE_FOOT)))
    ground = ground.multiply(_invert(molten)).multiply(_invert(rivers)).add(rivers, -RIVER_DEPTH)
    root = np.sqrt(ground.height * ground.height + np.float32(SHORE**2))  # Lava fills what is below 0.
    return ground.map(0.5 * (ground.height + root - np.float32(SHORE)), 0.5 + 0.5 * ground.height / root)


def find_volcanoes(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> tuple[Heights, Heights]:
    """Return the heights of volcanoes above the plain, and where lava fills their craters, from 0 to 1."""
    outline = sum_octaves(x, y, spacing, OUTLINE_WAVELENGTH, 2, shape.seed + VOLCANOES, 0.5).scale(OUTLINE)
    outline = outline.map(1.0 + outline.height, np.float32(1.0))
    column, row = (np.floor(positions / CELL).astype(np.int64) for positions in (x, y))
    zeros = np.zeros(x.shape, np.float32)
    cones = molten = Heights(zeros, zeros, zeros)
    for step_x in (-1, 0, 1):
        for step_y in (-1, 0, 1):
            bits = hash_lattice(column + step_x, row + step_y, np.int64(0), shape.seed + VOLCANOES)
            chance, size, steep, wide, *places = (uniform_random(bits, index).astype(np.float32) for index in range(6))
            radius, steepness, crater = (
                low + (high - low) * part for (low, high), part in ((RADII, size), (STEEPNESS, steep), (CRATERS, wide))
            )
            radius *= np.float32(CELL)
            dx, dy = (
                (positions - CELL * (cell + step + 0.5)).astype(np.float32) - np.float32(CELL * JITTER) * (place - np.float32(0.5))
                for positions, cell, step, place in ((x, column, step_x, places[0]), (y, row, step_y, places[1]))
            )
            distance = np.sqrt(dx * dx + dy * dy) + np.float32(1e-3)
            rate = 1.0 / (distance * radius)
            reach = Heights(distance / radius, dx * rate, dy * rate).multiply(outline)
            inside = np.maximum(1.0 - reach.height, np.float32(0.0))
            height = steepness * radius * (chance < FRACTION)
            derivative = np.float32(-PROFILE) * height * inside ** np.float32(PROFILE - 1.0)
            cones = cones.add(reach.map(height * inside ** np.float32(PROFILE), derivative))
            t = np.clip((crater - reach.height) / (crater * np.float32(1.0 - FLOOR)), 0.0, 1.0)
            t *= height > 0.0
            derivative = 6.0 * t * (t - 1.0) / (crater * np.float32(1.0 - FLOOR))
            molten = molten.add(reach.map(t * t * (3.0 - 2.0 * t), derivative).multiply(_invert(molten)))
    return cones, molten


def _find_crust(x: np.ndarray, y: np.ndarray, spacing: float, seed: int) -> Heights:
    """Return ridges of broken crust, in places, with a mean of 0."""
    noise = sum_octaves(x, y, spacing, CRUST_WAVELENGTH, 3, seed, 0.42)
    ridges = noise.map(np.float32(MEAN_CRUST * resolve(CRUST_WAVELENGTH, spacing)) - np.abs(noise.height), -np.sign(noise.height))
    return ridges.multiply(rise(sum_octaves(x, y, spacing, 310.0, 2, seed + 4), 0.12, 0.1))


def _invert(part: Heights) -> Heights:
    """Return 1 where a part is 0, and 0 where it is 1."""
    return part.map(1.0 - part.height, np.float32(-1.0))
