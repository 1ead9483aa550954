"""Rocks, and houses with every roof tile and shutter, as arrays. Lengths are meters, up is +Z."""

import bmesh
import mathutils
import numpy as np
from distance_plants import Model, join_models, split_quads

ROCK_SUBDIVISIONS = 7  # Of an icosahedron: 81,920 triangles.
WALL, WOOD, TILE, GLASS = range(4)  # Materials of a house.
BOX = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
BOX_QUADS = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
SLATS = 14  # Of a shutter.
TILE_SIDES = 4  # Along the curve of a roof tile.


def rock(seed: int) -> Model:
    """Return a rock with a size of about 2: a ball, broken along planes and worn."""
    random = np.random.default_rng([seed, 5])
    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=ROCK_SUBDIVISIONS, radius=1.0)
    directions = np.array([vertex.co for vertex in shape.verts])
    triangles = np.array([[vertex.index for vertex in face.verts] for face in shape.faces])
    shape.free()
    normals = random.normal(size=(16, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosines = directions @ normals.T
    broken = np.where(cosines > 0.05, random.uniform(0.55, 1.0, 16) / np.maximum(cosines, 0.05), 9.0).min(axis=1)
    offset = mathutils.Vector(random.uniform(0.0, 100.0, 3))
    worn = [mathutils.noise.fractal(2.5 * mathutils.Vector(direction) + offset, 0.8, 2.1, 8) for direction in directions]
    vertices = directions * (np.minimum(broken, 1.1) * (1.0 + 0.07 * np.array(worn)))[:, None] * random.uniform(0.7, 1.2, 3)
    corners = directions[triangles]
    u = np.arctan2(corners[..., 1], corners[..., 0]) / (2.0 * np.pi)
    u = u - np.rint(u - u[:, :1])
    uvs = np.stack([4.0 * u, 2.0 * np.arcsin(np.clip(corners[..., 2], -1.0, 1.0)) / np.pi], axis=-1)
    return Model(vertices, triangles, uvs, np.zeros(len(triangles), int), np.ones((len(vertices), 3)))


def house(seed: int) -> Model:
    """Return a house of two to four floors, with windows, shutters of slats and a gable roof of tiles."""
    random = np.random.default_rng([seed, 6])
    width, depth, floors = random.uniform(9.0, 15.0), random.uniform(8.0, 11.0), int(random.integers(2, 5))
    height = 3.0 * floors
    parts = [_boxes([(0.0, 0.0, 0.5 * height)], [(width, depth, height)], WALL, random)]
    for turn, (length, offset) in enumerate([(width, 0.5 * depth), (depth, 0.5 * width)] * 2):
        columns = int(length / 2.4)
        places = [
            ((column + 0.5) * length / columns - 0.5 * length, 3.0 * floor + 1.7) for column in range(columns) for floor in range(floors)
        ]
        wall = join_models([_window(x, z, random) for x, z in places])
        wall.vertices[:, 1] -= offset
        parts.append(_turned(wall, turn))
    parts += _roof(width + 0.8, depth + 1.0, height, random)
    return join_models(parts)


def _window(x: float, z: float, random: np.random.Generator) -> Model:
    """Return a window in a wall at y = 0 that faces -y: glass, frame, sill and two shutters."""
    glass = _boxes([(x, -0.02, z)], [(1.0, 0.04, 1.5)], GLASS, random)
    bars = [(-0.52, 0.0, 0.08, 1.6), (0.52, 0.0, 0.08, 1.6), (0.0, 0.0, 0.05, 1.5), (0.0, 0.78, 1.1, 0.08), (0.0, -0.78, 1.1, 0.08)]
    bars += [(0.0, 0.25, 1.0, 0.04), (0.0, -0.25, 1.0, 0.04)]
    frame = _boxes([(x + bar[0], -0.05, z + bar[1]) for bar in bars], [(bar[2], 0.08, bar[3]) for bar in bars], WOOD, random)
    sill = _boxes([(x, -0.12, z - 0.86)], [(1.3, 0.24, 0.07)], WALL, random)
    slats = [(x + side * 0.85, -0.06, z - 0.68 + 1.36 * (slat + 0.5) / SLATS) for side in (-1, 1) for slat in range(SLATS)]
    shutters = _boxes(slats, [(0.5, 0.035, 0.085)] * len(slats), WOOD, random, 0.5)
    edges = [(x + side * (0.85 + edge * 0.27), -0.06, z) for side in (-1, 1) for edge in (-1, 1)]
    return join_models([glass, frame, sill, shutters, _boxes(edges, [(0.05, 0.06, 1.5)] * len(edges), WOOD, random)])


def _roof(width: float, depth: float, height: float, random: np.random.Generator) -> list[Model]:
    """Return the gables and the tiles of both slopes."""
    rise = 0.42 * depth
    side_length = np.hypot(0.5 * depth, rise)
    columns, rows = int(width / 0.24), int(side_length / 0.3)
    corners = np.array([(x, y, height + z) for x in (-0.5, 0.5) for y, z in ((-0.5 * depth, 0.0), (0.5 * depth, 0.0), (0.0, rise - 0.05))])
    corners[:, 0] *= width - 0.8
    gable = np.array([(0, 2, 1), (3, 4, 5), (0, 3, 5), (0, 5, 2), (1, 2, 5), (1, 5, 4)])
    parts = [Model(corners, gable, np.zeros((6, 3, 2)), np.full(6, WALL), np.ones((6, 3)))]
    angles = np.pi * np.arange(TILE_SIDES + 1) / TILE_SIDES
    arc = np.column_stack([-0.115 * np.cos(angles), 0.0 * angles, 0.06 * np.sin(angles)])
    tile = np.concatenate([scale * arc + [0.0, y, z] for y, z, scale in ((-0.36, 0.05, 1.0), (0.0, 0.0, 0.85))])
    tile = np.concatenate([tile, tile - [0.0, 0.0, 0.015]])
    count = TILE_SIDES + 1
    side = np.arange(TILE_SIDES)
    quads = [np.stack([side, side + 1, side + 1 + count, side + count], axis=1)]
    quads += [quads[0][:, ::-1] + 2 * count, np.stack([side + 1, side, side + 2 * count, side + 1 + 2 * count], axis=1)]
    quads = np.concatenate(quads)
    x, y = np.meshgrid((np.arange(columns) + 0.5) * width / columns - 0.5 * width, -(np.arange(rows) * 0.3 + 0.02))
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) + random.normal(0.0, 0.006, (x.size, 3))
    flat = tile + places[:, None]
    down, up = np.array([0.5 * depth, -rise]) / side_length, np.array([rise, 0.5 * depth]) / side_length
    across = flat[..., 2:] * up - flat[..., 1:2] * down
    vertices = np.concatenate([-flat[..., :1], across + [0.0, height + rise]], axis=-1)
    brightness = np.repeat(random.uniform(0.6, 1.15, (len(places), 1)), 3, axis=1)
    all_quads = (len(tile) * np.arange(len(places))[:, None, None] + quads).reshape(-1, 4)
    triangles, uvs = split_quads(all_quads, np.zeros((*all_quads.shape, 2)))
    for sign in (1.0, -1.0):
        turned = vertices.reshape(-1, 3) * [sign, sign, 1.0]
        parts.append(Model(turned, triangles, uvs, np.full(len(triangles), TILE), np.repeat(brightness, len(tile), axis=0)))
    return parts


def _boxes(centers: list, sizes: list, material: int, random: np.random.Generator, tilt: float = 0.0) -> Model:
    """Return boxes at `centers` with `sizes`, turned around the x axis by `tilt`."""
    corners = BOX * np.array(sizes)[:, None]
    rotated = corners @ np.array([[1.0, 0.0, 0.0], [0.0, np.cos(tilt), np.sin(tilt)], [0.0, -np.sin(tilt), np.cos(tilt)]])
    vertices = (rotated + np.array(centers)[:, None]).reshape(-1, 3)
    quads = (8 * np.arange(len(centers))[:, None, None] + BOX_QUADS).reshape(-1, 4)
    triangles, uvs = split_quads(quads, np.tile([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], (len(quads), 1, 1)))
    brightness = np.repeat(np.repeat(random.uniform(0.9, 1.0, (len(centers), 1)), 8, axis=0), 3, axis=1)
    return Model(vertices, triangles, uvs, np.full(len(triangles), material), brightness)


def _turned(model: Model, quarters: int) -> Model:
    """Return a mesh turned around the z axis by quarter turns."""
    cosine, sine = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarters]
    rotation = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return Model(model.vertices @ rotation, model.triangles, model.uvs, model.materials, model.colors)
