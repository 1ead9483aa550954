"""Shapes of landscapes that are no heights: halls with columns, holes through fins, and roots. Lengths are meters."""

from dataclasses import dataclass

import numpy as np

from .grids import Grid, smooth_minimum
from .hashing import hash_lattice, uniform_random
from .height_noise import resolve, sum_octaves
from .landscape_parts import Shape, rise
from .landscapes import PLAIN_HEIGHT, Carving, fin_sides, find_fins, find_plain
from .noise import fbm

CAVES = 300  # Added to the seed.
FLOORS = (24.0, 8.0), (-25.0, 6.0)  # Mean heights of floors of halls, and how far they vary.
HALL_HEIGHT, COLUMN_DISTANCE, COLUMN_WIDTH = 12.0, 38.0, 16.0  # Half the height where halls are highest; how much of it columns take.
WALL_ROUGHNESS, WALL_WAVELENGTH = 3.0, 22.0
DRIP_DISTANCE, DRIP_RADII = 8.5, (0.5, 2.3)  # Side of the cells with one dripstone each, and its radius, from the thinnest on.
DRIP_FOOT, DRIP_TIP = 1.5, 0.35  # Radii where they leave the wall and at their tips, relative to the radius.
DRIP_LENGTHS, DRIP_MIN_HEIGHT = (0.05, 0.62), 3.0  # Relative to the height of the hall, half of which is not less.
DRIP_BLEND = 0.8  # Width of their transition to the wall.
ROOF = 4.0, 9.0  # Thickness of the roof at which there are none, and at which they have their length.
HOLE_DISTANCE = 84.0  # Between places for holes along a fin.
HOLE_FRACTION = 0.7  # Of these places.
HOLE_FOOT = 0.1  # Height of their centers above the plain, relative to half their height.
HOLE_MARGIN = 1.0  # Of a fin on both sides of the center of a hole, relative to half its width.
MIN_FIN, MAX_FIN = 0.05, 0.25  # Heights of a fin there, relative to the highest, at which a hole closes, and from which on it is in full.
CLOSED = 9.0  # The distance along a fin, relative to half the width of a hole, where there is none.
HOLE_WIDTHS, HOLE_HEIGHTS = (11.0, 24.0), (16.0, 36.0)  # Half of them, from the smallest to the largest.
COARSEST = 3.0  # Voxels that show roots, relative to their radius. Roots are as thick as a voxel at least, so that they do not break.
HIGHEST = 1.4  # Bound of the noise by which roots rise and sink.
ROOT_CHANGE, ROOT_WARP = 0.4, 0.85  # Of the radius of a root; of the line that it follows, radians.
EDGE, MIN_THICKNESS = 3.0, 1.8  # Rounds off edges; the thickness of walls, voxels.


@dataclass(frozen=True)
class Roots:
    """Roots of one size, meters.

    Attributes:
        radius: mean.
        distance: between the lines that they follow.
        direction: across these lines, radians.
        level: mean height.
        rise: how far they rise and sink.
        arch: length of an arch.
    """

    radius: float
    distance: float
    direction: float
    level: float
    rise: float
    arch: float


ROOTS = Roots(13.0, 340.0, 0.4, 12.0, 75.0, 330.0), Roots(5.5, 200.0, 1.7, 4.0, 34.0, 130.0)


def carve_halls(grid: Grid, density: np.ndarray, surface: np.ndarray, shape: Shape) -> np.ndarray:
    """Carve halls with columns into the ground, on floors one above the other. What voxels cannot resolve is lower, or is left out."""
    shown = resolve(4.0 * HALL_HEIGHT, grid.voxel_size)
    if shown == 0.0:
        return density
    lower = np.float32(HALL_HEIGHT + 2.0 * HALL_HEIGHT * (1.0 - shown) + 0.5 * grid.voxel_size)
    for number, (height, change) in enumerate(FLOORS):
        reach = HALL_HEIGHT + 1.5 * change + 3.0 * WALL_ROUGHNESS
        layers, part = _layers_between(grid, height - reach, height + reach)
        if part is None:
            continue
        x, y, z = part.coordinates()
        x, y = np.broadcast_arrays(x[:, :, 0], y[:, :, 0])
        spacing, seed = grid.voxel_size, shape.seed + CAVES + 20 * number
        center = sum_octaves(x, y, spacing, 330.0, 2, seed + 4).scale(change)
        room = rise(sum_octaves(x, y, spacing, 150.0, 2, seed + 8, 0.4), 0.05, 0.25).scale(2.0 * HALL_HEIGHT)
        room = room.add(rise(sum_octaves(x, y, spacing, COLUMN_DISTANCE, 2, seed + 12, 0.4), 0.5, 0.14), -COLUMN_WIDTH)
        half = room.height - lower
        across = 1.0 / np.sqrt(1.0 + room.steepness**2)
        walls = ((np.abs(z - height - center.height[:, :, None]) - half[:, :, None]) * across[:, :, None]).astype(np.float32)
        walls += fbm(part, WALL_WAVELENGTH, 3, seed, squash=1.5) * np.float32(WALL_ROUGHNESS)
        center_height = np.float32(height) + center.height
        shown = np.clip((surface - center_height - half - ROOF[0]) / np.float32(ROOF[1] - ROOF[0]), 0.0, 1.0)
        add_dripstone(walls, part, center_height, half, shown, seed + 16)
        density[:, :, layers] = carve(density[:, :, layers], walls, spacing)
    return density


def add_dripstone(walls: np.ndarray, grid: Grid, center: np.ndarray, half: np.ndarray, shown: np.ndarray, seed: int) -> None:
    """Add stalactites and stalagmites to the `walls` of halls, in place; where they meet, they are columns.

    center, half: (X, Y) heights of the centers of halls, and half of the height of halls. shown: (X, Y) from 0 to 1, how long they are.
    """
    spacing = grid.voxel_size
    if 1.1 * spacing > DRIP_RADII[1]:
        return
    x, y, z = grid.coordinates()
    row = np.floor(y[:, :, 0] / DRIP_DISTANCE).astype(np.int64)
    along = x[:, :, 0] / DRIP_DISTANCE + uniform_random(hash_lattice(row, np.int64(0), np.int64(0), seed), 0)
    column = np.floor(along).astype(np.int64)
    bits = hash_lattice(column, row, np.int64(0), seed + 1)
    thick, down, up, place_x, place_y = (uniform_random(bits, index).astype(np.float32) for index in range(5))
    reach = np.float32(0.5 * DRIP_DISTANCE) - np.float32(DRIP_FOOT * DRIP_RADII[1])  # So that all of it is in one cell.
    dx = ((along - column - 0.5) * DRIP_DISTANCE).astype(np.float32) - reach * (2.0 * place_x - 1.0)
    dy = ((y[:, :, 0] / DRIP_DISTANCE - row - 0.5) * DRIP_DISTANCE).astype(np.float32) - reach * (2.0 * place_y - 1.0)
    radius = np.float32(DRIP_RADII[0]) + np.float32(DRIP_RADII[1] - DRIP_RADII[0]) * thick * thick
    away = np.sqrt(dx * dx + dy * dy)
    is_near = (away < DRIP_FOOT * DRIP_RADII[1]) & (half > DRIP_MIN_HEIGHT) & (shown > 0.0) & (radius > np.float32(spacing))
    found = np.nonzero(is_near)
    if not len(found[0]):
        return
    away, radius, center, half, shown = (values[found][:, None] for values in (away, radius, center, half, shown))
    height = z[0, 0] - center
    part = walls[found]
    for lengths, side in ((down, 1.0), (up, -1.0)):  # From the ceiling and from the floor.
        length = 2.0 * half * shown * (DRIP_LENGTHS[0] + (DRIP_LENGTHS[1] - DRIP_LENGTHS[0]) * lengths[found][:, None])
        from_wall = (half - np.float32(side) * height).astype(np.float32)  # Into the hall.
        t = np.clip(from_wall / length, 0.0, 1.0)
        tip = np.maximum(np.float32(DRIP_TIP) * radius, np.float32(0.9 * spacing))
        flare = np.float32(DRIP_FOOT - 1.0) * radius * (1.0 - t) ** 6
        solid = radius + (tip - radius) * t + flare - np.hypot(away, np.maximum(from_wall - length, np.float32(0.0)))
        part = -smooth_minimum(-part, -solid, np.float32(DRIP_BLEND))
    walls[found] = part


def carve(density: np.ndarray, walls: np.ndarray, voxel_size: float) -> np.ndarray:
    """Return densities without what lies in front of `walls` (X, Y, Z), distances into the rock. Rock that is too thin for voxels, with
    air on its other side, is opened: it would have holes as large as voxels."""
    thickness = density + walls - np.float32(MIN_THICKNESS * voxel_size)
    return np.minimum(smooth_minimum(density, walls, np.float32(EDGE)), thickness)


def carve_holes(grid: Grid, density: np.ndarray, _surface: np.ndarray, shape: Shape) -> np.ndarray:
    """Carve holes through the fins of *Arches*."""
    layers, part = _layers_between(grid, -2.0 * PLAIN_HEIGHT, 2.0 * PLAIN_HEIGHT + 1.2 * HOLE_HEIGHTS[1])
    if part is None:
        return density
    x, y, z = part.coordinates()
    x, y = np.broadcast_arrays(x[:, :, 0], y[:, :, 0])
    plain, sides = find_plain(x, y, grid.voxel_size, shape).height, fin_sides(x, y, grid.voxel_size, shape).height
    fins = np.floor(sides / np.float32(2.0 * np.pi) + np.float32(0.25)).astype(np.int64)
    shifted = y / HOLE_DISTANCE + uniform_random(hash_lattice(fins, np.int64(0), np.int64(0), shape.seed + CAVES), 0)
    places = np.floor(shifted).astype(np.int64)
    bits = hash_lattice(fins, places, np.int64(0), shape.seed + CAVES + 1)
    width, height = (low + (high - low) * uniform_random(bits, index) for index, (low, high) in enumerate((HOLE_WIDTHS, HOLE_HEIGHTS)))
    margin = HOLE_WIDTHS[1] / HOLE_DISTANCE
    center = margin + (1.0 - 2.0 * margin) * uniform_random(bits, 2)
    offset = (shifted - places - center) * HOLE_DISTANCE
    ends = [find_fins(x, y - offset + side * HOLE_MARGIN * width, grid.voxel_size, shape).height for side in (-1.0, 1.0)]
    size = np.clip((np.minimum(*ends) - MIN_FIN) / (MAX_FIN - MIN_FIN), 1e-3, 1.0)  # Holes narrow where fins end.
    width, height = size * width, size * height
    is_open = (uniform_random(bits, 3) < HOLE_FRACTION) & (np.minimum(width, height) > grid.voxel_size)
    along = np.where(is_open, offset / width, CLOSED)
    up = (z - (plain + HOLE_FOOT * height)[:, :, None]) / height[:, :, None]
    walls = ((np.sqrt(along[:, :, None] ** 2 + up**2) - 1.0) * np.minimum(width, height)[:, :, None]).astype(np.float32)
    walls += fbm(part, WALL_WAVELENGTH, 3, shape.seed + CAVES, squash=1.5) * np.float32(0.7 * WALL_ROUGHNESS)
    floor = (plain[:, :, None] - z).astype(np.float32)  # Holes end at the plain.
    density[:, :, layers] = carve(density[:, :, layers], np.maximum(walls, floor), grid.voxel_size)
    return density


def add_roots(grid: Grid, density: np.ndarray, _surface: np.ndarray, shape: Shape) -> np.ndarray:
    """Add roots that wind through the ground and the air. Each follows a line in the plane, up and down, so that none ends in the air."""
    for number, roots in enumerate(ROOTS):
        reach = HIGHEST * roots.rise + 2.0 * max(roots.radius, grid.voxel_size)
        layers, part = _layers_between(grid, roots.level - reach, roots.level + reach)
        if part is None or grid.voxel_size > COARSEST * roots.radius:
            continue
        x, y, z = part.coordinates()
        x, y = np.broadcast_arrays(x[:, :, 0], y[:, :, 0])
        spacing, seed = grid.voxel_size, shape.seed + CAVES + 20 * number
        # Waves whose gradient is nowhere 0, so that their crests are lines without an end.
        rate, warps = 2.0 * np.pi / roots.distance, sum_octaves(x, y, spacing, 1.6 * roots.distance, 2, seed, 0.3).scale(ROOT_WARP)
        along_x, along_y = rate * np.cos(roots.direction), rate * np.sin(roots.direction)
        phase = along_x * x + along_y * y + warps.height
        steepness = np.hypot(warps.gradient_x + along_x, warps.gradient_y + along_y)
        across = (phase - 2.0 * np.pi * np.round(phase / (2.0 * np.pi))) / steepness
        height = sum_octaves(x, y, spacing, roots.arch, 2, seed + 8, 0.3)
        width = sum_octaves(x, y, spacing, 1.7 * roots.arch, 1, seed + 16).height
        radius = np.maximum(np.float32(roots.radius) * (1.0 + np.float32(ROOT_CHANGE) * width), np.float32(spacing))
        up = (z - np.float32(roots.level) - np.float32(roots.rise) * height.height[:, :, None]) / np.sqrt(
            1.0 + (np.float32(roots.rise) * height.steepness[:, :, None]) ** 2
        )
        distance = np.hypot(across[:, :, None], up)
        solid = (radius[:, :, None] - distance).astype(np.float32)
        density[:, :, layers] = -smooth_minimum(-density[:, :, layers], -solid, np.float32(0.6 * roots.radius))
    return density


def _layers_between(grid: Grid, low: float, high: float) -> tuple[slice, Grid | None]:
    """Return the layers of a grid between two heights, and a grid of them, None if there are none."""
    first, last = np.searchsorted(grid.coordinates_along(2), (low, high)).tolist()
    if first == last:
        return slice(0, 0), None
    return slice(first, last), Grid((*grid.origin[:2], grid.origin[2] + first), (*grid.shape[:2], last - first), grid.voxel_size)


CARVINGS: dict[str, Carving] = {"karst": carve_halls, "arches": carve_holes, "alien": add_roots}
