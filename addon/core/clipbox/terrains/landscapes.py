"""Landscapes: heights of the ground as nature shapes it, with rock faces that overhang.

Lengths are meters at the scale 1. The ground is a function of x and y with its gradient, from which the distance to the surface follows. On
steep ground, noise in three dimensions breaks it into ledges and overhangs.
"""

from collections.abc import Callable

import numpy as np

from ..settings import ClipboxSettings
from .grids import DensityFunction, Grid
from .height_noise import Gullies, Heights, carve_gullies, resolve, sum_octaves
from .landscape_parts import BUMPS, GULLIES, LEDGES, MORE, WARPS, Shape, add_layers, cut, rise, warp
from .lava import lava
from .noise import fbm

SEEDS = 128  # Of each terrain.
ROCK_STEEPNESS, ROCK_BLEND = 0.75, 0.5  # The length of the gradient from which on ground is rock, and how much steeper all of it is.
LEVEL_AT_0 = "coast", "karst", "arches", "alien", "lava"  # Whose sea, plain or lava is at a height of 0.
LEDGES_OF_ROCK = {"alps": (84.0, 6, 12.0)}  # Wavelength, octaves and depth, where they are not those of SMALL_LEDGES.
SMALL_LEDGES = 18.0, 4, 3.6
OVERHANG = 0.4  # How far ledges stand out, relative to how far they go back: more floats above the ground.
MAX_STEEPNESS = 5.0  # The length of the gradient from which on ledges become less deep, since they would float above the ground.
BUMP_WAVELENGTH, BUMP_OCTAVES, BUMP_HEIGHT = 24.0, 5, 0.6  # Everywhere.
DUNES = (240.0, 17.0), (75.0, 2.6)  # Wavelengths and heights of large and small ones.
DUNE_WARP = 2.4  # Of their crests, in radians of their waves.
FIN_DISTANCE, FIN_HEIGHT, PLAIN_HEIGHT, FIN_WARP = 62.0, 62.0, 9.0, 2.6  # Lengths, and radians of waves across fins.
SPIRE_HEIGHT, SPIRE_SHARPNESS = 1.1, 3.9  # Of the noise at 0, and per unit of noise.
DUNE_SKEW = 0.75  # From symmetric waves, 0, to vertical slip faces, 1.

Ground = Callable[[np.ndarray, np.ndarray, float, Shape], Heights]  # Of positions (X, Y) and the spacing of samples.
# Of a grid, its densities, and the heights (X, Y) of the ground. Returns the densities with what is no height. In meters.
Carving = Callable[[Grid, np.ndarray, np.ndarray, Shape], np.ndarray]


def alps(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return high mountains with valleys that branch into gullies."""
    massifs = warp(lambda x, y: sum_octaves(x, y, spacing, 30_000.0, 3, shape.seed), x, y, spacing, 12_000.0, 1_270.0, shape.seed + WARPS)
    gullies = Gullies(7_000.0, 9, 0.052 * shape.erosion, 0.96, 0.2)
    return carve_gullies(massifs.scale(680.0 * shape.ruggedness), x, y, spacing, gullies, shape.seed + GULLIES)


def hills(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return rounded hills with brooks between them."""
    ground = warp(lambda x, y: sum_octaves(x, y, spacing, 9_600.0, 5, shape.seed, 0.5), x, y, spacing, 2_500.0, 177.0, shape.seed + WARPS)
    gullies = Gullies(1_200.0, 5, 0.034 * shape.erosion, 0.6, 0.25)
    return carve_gullies(ground.scale(185.0 * shape.ruggedness), x, y, spacing, gullies, shape.seed + GULLIES)


def canyon(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return a plateau that rivers have cut into in two steps, down through layers of hard and soft rock, and brooks on their way there."""
    plateau = sum_octaves(x, y, spacing, 3_000.0, 4, shape.seed, 0.45).scale(42.0 * shape.ruggedness)
    seed = shape.seed + MORE
    rivers = warp(lambda x, y: sum_octaves(x, y, spacing, 5_200.0, 3, seed, 0.3), x, y, spacing, 2_600.0, 300.0, shape.seed + WARPS)
    inner, outer = cut(rivers, 0.22), cut(rivers, 0.42)
    brooks = cut(sum_octaves(x, y, spacing, 1_700.0, 2, seed + 8, 0.4), 0.2).multiply(cut(rivers, 0.75))
    brooks = brooks.multiply(inner.map(1.0 - inner.height, np.float32(-1.0)))
    ground = plateau.add(inner, -250.0 * shape.ruggedness).add(outer, -90.0 * shape.ruggedness).add(brooks, -130.0 * shape.ruggedness)
    ground = carve_gullies(ground, x, y, spacing, Gullies(700.0, 6, 0.11 * shape.erosion, 0.8, 0.35), shape.seed + GULLIES)
    return add_layers(add_layers(ground, 90.0, 0.8), 23.0, 0.6)


def mesas(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return table mountains with cliffs above scree."""
    places = warp(lambda x, y: sum_octaves(x, y, spacing, 1_500.0, 4, shape.seed, 0.45), x, y, spacing, 900.0, 92.0, shape.seed + WARPS)
    tables = cut(places.map(places.height - np.float32(0.64), np.float32(1.0)), 0.71)
    plain = sum_octaves(x, y, spacing, 2_000.0, 3, shape.seed + MORE, 0.45).scale(10.0)
    ground = plain.add(tables, 130.0 * shape.ruggedness)
    ground = carve_gullies(ground, x, y, spacing, Gullies(260.0, 5, 0.09 * shape.erosion, 0.8, 0.5), shape.seed + GULLIES)
    return add_layers(add_layers(ground, 65.0, 0.95), 11.0, 0.5)


def coast(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return land that falls to the sea in cliffs or beaches, with stacks of rock before the cliffs. The sea is at 0."""
    land = warp(lambda x, y: sum_octaves(x, y, spacing, 3_000.0, 5, shape.seed, 0.4), x, y, spacing, 700.0, 80.0, shape.seed + WARPS)
    inland = sum_octaves(x, y, spacing, 1_400.0, 4, shape.seed + MORE, 0.45).scale(22.0)
    inland_rise = rise(land, 0.3, 0.3).scale(70.0).add(rise(land, -0.16, 0.16), 30.0)
    cliffs = inland_rise.add(rise(land, -0.01, 0.012), 46.0)
    cliffs = cliffs.multiply(inland.map(1.0 + inland.height / np.float32(60.0), np.float32(1.0 / 60.0)))
    beaches = inland_rise.add(rise(land, 0.05, 0.16), 48.0)
    kinds = sum_octaves(x, y, spacing, 1_100.0, 2, shape.seed + MORE + 8)
    ground = beaches.add(cliffs.add(beaches, -1.0).multiply(rise(kinds, -0.1, 0.14)))
    ground = ground.map((ground.height - np.float32(39.0)) * np.float32(shape.ruggedness), np.float32(shape.ruggedness))
    ground = carve_gullies(ground, x, y, spacing, Gullies(420.0, 6, 0.045 * shape.erosion, 0.8, 0.35), shape.seed + GULLIES)
    stacks = sum_octaves(x, y, spacing, 150.0, 3, shape.seed + MORE + 12, 0.4)
    near_shore = cut(land.map(land.height + np.float32(0.07), np.float32(1.0)), 0.085)
    return ground.add(rise(stacks, 0.42, 0.07).multiply(near_shore), 58.0 * shape.ruggedness)


def dunes(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return dunes across the wind, which blows along x: gentle on its side and steep behind."""
    ground = sum_octaves(x, y, spacing, 1_300.0, 2, shape.seed, 0.4).scale(11.3 * shape.ruggedness)
    for number, (wavelength, height) in enumerate(DUNES):
        crests = sum_octaves(x, y, spacing, 2.6 * wavelength, 3, shape.seed + MORE + 4 * number, 0.42).scale(DUNE_WARP)
        rate = np.float32(2.0 * np.pi / wavelength)
        phase = Heights(crests.height + (rate * x).astype(np.float32), crests.gradient_x + rate, crests.gradient_y)
        skewed = phase.height + np.float32(DUNE_SKEW) * np.sin(phase.height)
        waves = phase.map(np.cos(skewed), -np.sin(skewed) * (1.0 + np.float32(DUNE_SKEW) * np.cos(phase.height)))
        ground = ground.add(waves, height * shape.ruggedness * resolve(wavelength, spacing))
    return ground


def karst(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return towers of limestone on a plain with sinkholes, part of which lies below 0."""
    places = warp(lambda x, y: sum_octaves(x, y, spacing, 310.0, 3, shape.seed, 0.45), x, y, spacing, 170.0, 22.0, shape.seed + WARPS)
    sizes = sum_octaves(x, y, spacing, 900.0, 2, shape.seed + MORE, 0.5)
    sizes = sizes.map(0.75 + 0.35 * sizes.height, np.full_like(sizes.height, 0.35))
    towers = rise(places, 0.2, 0.06).scale(38.0).add(rise(places, 0.42, 0.16), 75.0).multiply(sizes)
    plain = sum_octaves(x, y, spacing, 420.0, 3, shape.seed + MORE + 4, 0.5).scale(5.5)
    ground = plain.add(towers, shape.ruggedness)
    ground = carve_gullies(ground, x, y, spacing, Gullies(90.0, 5, 0.1 * shape.erosion, 0.8, 0.7), shape.seed + GULLIES)
    sinkholes = sum_octaves(x, y, spacing, 240.0, 3, shape.seed + MORE + 8, 0.35)
    return ground.add(rise(sinkholes, 0.62, 0.045), -36.0 * shape.ruggedness)


def arches(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return fins: walls of rock side by side on a plain."""
    sides = fin_sides(x, y, spacing, shape)
    walls = rise(sides.map(np.sin(sides.height), np.cos(sides.height)), 0.5, 0.13)
    tops = sum_octaves(x, y, spacing, 120.0, 3, shape.seed + MORE, 0.5)
    tall = find_fins(x, y, spacing, shape).multiply(tops.map(1.0 + 0.3 * tops.height, np.full_like(tops.height, 0.3)))
    plain = find_plain(x, y, spacing, shape)
    ground = plain.add(walls.multiply(tall), FIN_HEIGHT * shape.ruggedness)
    ground = carve_gullies(ground, x, y, spacing, Gullies(60.0, 4, 0.06 * shape.erosion, 0.8, 0.7), shape.seed + GULLIES)
    return add_layers(ground, 13.0, 0.45)


def find_fins(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return where the fins of *Arches* are: from 0 to 1."""
    return rise(sum_octaves(x, y, spacing, 380.0, 3, shape.seed, 0.5), -0.02, 0.13)


def fin_sides(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return the phase of waves across the fins of *Arches*, whose crests they are."""
    warps = sum_octaves(x, y, spacing, 520.0, 3, shape.seed + WARPS, 0.45).scale(FIN_WARP)
    rate = np.float32(2.0 * np.pi / FIN_DISTANCE)
    return Heights((rate * x).astype(np.float32) + warps.height, warps.gradient_x + rate, warps.gradient_y)


def find_plain(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return the plain between the fins of *Arches*."""
    return sum_octaves(x, y, spacing, 700.0, 3, shape.seed + MORE + 4, 0.45).scale(PLAIN_HEIGHT)


def alien(x: np.ndarray, y: np.ndarray, spacing: float, shape: Shape) -> Heights:
    """Return plains with domes and spires."""
    ground = warp(lambda x, y: sum_octaves(x, y, spacing, 900.0, 4, shape.seed, 0.42), x, y, spacing, 500.0, 60.0, shape.seed + WARPS)
    spires = sum_octaves(x, y, spacing, 260.0, 2, shape.seed + MORE, 0.3)
    regions = rise(sum_octaves(x, y, spacing, 1_100.0, 2, shape.seed + MORE + 4, 0.4), 0.1, 0.2)  # Where there are spires.
    peaks = np.exp(np.float32(SPIRE_SHARPNESS) * spires.height)
    spires = spires.map(peaks, np.float32(SPIRE_SHARPNESS) * peaks).multiply(regions)
    ground = ground.scale(26.0).add(spires, SPIRE_HEIGHT)
    ground = ground.scale(shape.ruggedness)
    return carve_gullies(ground, x, y, spacing, Gullies(130.0, 5, 0.1 * shape.erosion, 0.8, 0.35), shape.seed + GULLIES)


LANDSCAPES: dict[str, Ground] = {
    "alps": alps,
    "hills": hills,
    "canyon": canyon,
    "mesas": mesas,
    "coast": coast,
    "dunes": dunes,
    "karst": karst,
    "arches": arches,
    "alien": alien,
    "lava": lava,
}


def read_shape(source: ClipboxSettings) -> Shape:
    """Return what the settings say about a landscape."""
    return Shape(SEEDS * source.seed, source.ruggedness, source.erosion)


def find_base(terrain: str, shape: Shape) -> float:
    """Return the height of a landscape that is at z = 0: that of the sea or of its plain, or of the ground at x = y = 0."""
    origin = np.zeros((1, 1))
    return 0.0 if terrain in LEVEL_AT_0 else float(LANDSCAPES[terrain](origin, origin, 1.0, shape).height[0, 0])


def build_landscape(source: ClipboxSettings, carve: Carving | None) -> DensityFunction:
    """Build the landscape that the settings name. At x = y = 0, its ground is about at z = 0; the sea of *Coast* is at z = 0.

    carve: adds caves and other shapes that are no heights.
    """
    ground, shape, scale = LANDSCAPES[source.terrain], read_shape(source), source.scale
    base = np.float32(find_base(source.terrain, shape))
    wavelength, octaves, depth = LEDGES_OF_ROCK.get(source.terrain, SMALL_LEDGES)

    def densities(scaled: Grid) -> np.ndarray:
        grid = Grid(scaled.origin, scaled.shape, scaled.voxel_size / scale)
        x, y, z = grid.coordinates()
        x, y = np.broadcast_arrays(x[:, :, 0], y[:, :, 0])
        bumps = sum_octaves(x, y, grid.voxel_size, BUMP_WAVELENGTH, BUMP_OCTAVES, shape.seed + BUMPS)
        heights = ground(x, y, grid.voxel_size, shape).add(bumps, BUMP_HEIGHT)
        steepness = heights.steepness
        across = np.float32(1.0) / np.sqrt(1.0 + steepness * steepness)
        surface = heights.height - base
        density = np.empty(grid.shape, np.float32)
        for layer, line, factor in zip(density, surface, across, strict=True):  # layers stay in the CPU cache
            np.multiply(line[:, None] - z[0], factor[:, None], out=layer, casting="same_kind")
        rock = np.clip((steepness - np.float32(ROCK_STEEPNESS)) / np.float32(ROCK_BLEND), 0.0, 1.0)
        if rock.any():
            ledges = fbm(grid, wavelength, octaves, shape.seed + LEDGES, squash=1.5)
            rock *= np.minimum(np.float32(depth), np.float32(depth * MAX_STEEPNESS) / np.maximum(steepness, np.float32(1.0)))
            for layer, ledge, factor in zip(density, ledges, rock, strict=True):
                np.multiply(ledge, np.float32(OVERHANG), out=ledge, where=ledge > 0.0)
                ledge *= factor[:, None]
                layer += ledge
        if carve is not None:
            density = carve(grid, density, surface, shape)
        density *= np.float32(scale)
        return density

    return densities
