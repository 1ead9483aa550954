"""Trees with the geometry of every leaf and needle, as arrays: broadleaf trees on the skeleton of the demo, and a spruce.

Lengths are meters, up is +Z, the base of the trunk is at the origin.
"""

from dataclasses import dataclass

import numpy as np

from lib.demo_tree import build_leaf_cards, build_tubes, grow_skeleton

LEAF_LENGTH = 0.6  # Of a leaf, relative to the card for a sprig of the demo.
# A leaf of eight triangles, folded along its rib: positions across, along, and above the base, relative to width and length.
LEAF = np.array(
    [(0, 0, 0), (-0.4, 0.3, 0.1), (0, 0.3, 0.04), (0.4, 0.3, 0.1), (-0.3, 0.7, 0.04), (0, 0.7, 0), (0.3, 0.7, 0.04), (0, 1, -0.12)]
)
LEAF_TRIANGLES = np.array([(0, 2, 1), (0, 3, 2), (1, 2, 5), (1, 5, 4), (2, 3, 6), (2, 6, 5), (4, 5, 7), (5, 6, 7)])
SPRUCE_HEIGHT, WHORLS, BRANCHES, TWIGS, NEEDLES = 14.0, 30, 7, 22, 34
NEEDLE_LENGTH, NEEDLE_WIDTH = 0.065, 0.006


@dataclass(frozen=True)
class Model:
    """A mesh: vertices (V, 3), triangles (T, 3), corner UVs (T, 3, 2), the index of the material of each triangle (T,), and the color of
    each vertex (V, 3), by which materials multiply theirs."""

    vertices: np.ndarray
    triangles: np.ndarray
    uvs: np.ndarray
    materials: np.ndarray
    colors: np.ndarray


def join_models(models: list[Model]) -> Model:
    """Return one mesh of several."""
    offsets = np.cumsum([0, *(len(model.vertices) for model in models[:-1])])
    triangles = np.concatenate([model.triangles + offset for model, offset in zip(models, offsets, strict=True)])
    fields = [np.concatenate([getattr(model, name) for model in models]) for name in ("vertices", "uvs", "materials", "colors")]
    return Model(fields[0], triangles, *fields[1:])


def split_quads(quads: np.ndarray, uvs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (2 Q, 3) of quadrilaterals (Q, 4), and their UVs."""
    return quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3), uvs[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 2)


def broadleaf_tree(seed: int, leaves: int, scale: tuple[float, float, float]) -> Model:
    """Return a tree with `leaves` leaves; material 0 is bark, 1 are leaves. scale: of its crown along the axes."""
    skeleton = grow_skeleton(seed)
    vertices, quads, uvs = build_tubes(skeleton)
    triangles, uvs = split_quads(quads, uvs)
    bark = Model(vertices * scale, triangles, uvs, np.zeros(len(triangles), int), np.ones((len(vertices), 3)))
    cards, _, _, colors = build_leaf_cards(skeleton, leaves, seed)
    cards = cards.reshape(leaves, 4, 3)
    base = cards[:, :2].mean(axis=1)
    along, across = cards[:, 2:].mean(axis=1) - base, cards[:, 1] - cards[:, 0]
    above = np.cross(across, along) / np.linalg.norm(along, axis=1, keepdims=True)
    frames = LEAF_LENGTH * np.stack([0.7 * across, along, above], axis=1)
    positions = (base * scale)[:, None] + np.einsum("lk,nki->nli", LEAF, frames)
    return join_models([bark, _repeat(positions, LEAF_TRIANGLES, LEAF[:, :2] + [0.5, 0.0], colors[::4, :3])])


def _repeat(positions: np.ndarray, triangles: np.ndarray, uvs: np.ndarray, colors: np.ndarray) -> Model:
    """Return a mesh of N equal parts with the positions (N, K, 3), each with `triangles`, UVs (K, 2), material 1 and a color (N, 3)."""
    count, size = positions.shape[:2]
    all_triangles = (size * np.arange(count)[:, None, None] + triangles).reshape(-1, 3)
    all_uvs = np.tile(uvs[triangles], (count, 1, 1))
    return Model(positions.reshape(-1, 3), all_triangles, all_uvs, np.ones(len(all_triangles), int), np.repeat(colors, size, axis=0))


def spruce(seed: int) -> Model:
    """Return a spruce; material 0 is bark, 1 are needles."""
    random = np.random.default_rng(seed)
    heights = np.repeat(np.linspace(1.2, 0.97 * SPRUCE_HEIGHT, WHORLS), BRANCHES) + random.normal(0.0, 0.1, WHORLS * BRANCHES)
    reach = 0.28 * (SPRUCE_HEIGHT - heights) * random.uniform(0.8, 1.1, len(heights)) + 0.25
    angles = np.tile(np.arange(BRANCHES), WHORLS) * (2.0 * np.pi / BRANCHES) + np.repeat(random.uniform(0.0, 6.3, WHORLS), BRANCHES)
    outward = np.column_stack([np.cos(angles), np.sin(angles), random.uniform(-0.25, 0.05, len(angles))])
    starts = np.column_stack([np.zeros((len(heights), 2)), heights])

    def at(fractions: np.ndarray) -> np.ndarray:
        """Return positions along all branches (B, F, 3), which droop."""
        points = starts[:, None] + (fractions[:, None] * reach[:, None, None]) * outward[:, None]
        points[..., 2] -= 0.18 * reach[:, None] * fractions**2
        return points

    trunk = _tubes(np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, SPRUCE_HEIGHT], 24)[None], np.linspace(0.22, 0.01, 24)[None], 12)
    branches = _tubes(at(np.linspace(0.0, 1.0, 7)), np.outer(0.012 * reach + 0.004, np.linspace(1.0, 0.2, 7)), 5)
    fractions = np.linspace(0.12, 1.0, TWIGS)
    bases, sides = at(fractions), np.cross(outward, [0.0, 0.0, 1.0])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    sign = np.where(np.arange(TWIGS) % 2, 1.0, -1.0)[:, None]
    direction = 0.75 * outward[:, None] + sign * sides[:, None] + random.normal(0.0, 0.15, bases.shape) - [0.0, 0.0, 0.12]
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    lengths = (0.33 * reach[:, None] * (1.05 - fractions))[..., None] + 0.12
    bases, direction, lengths = bases.reshape(-1, 3), direction.reshape(-1, 3), lengths.reshape(-1, 1)
    twigs = _tubes(np.stack([bases, bases + lengths * direction], axis=1), np.tile([0.005, 0.002], (len(bases), 1)), 3)
    needles = _needles(bases, direction, lengths, random)
    return join_models([trunk, branches, twigs, needles])


def _needles(bases: np.ndarray, direction: np.ndarray, lengths: np.ndarray, random: np.random.Generator) -> Model:
    """Return needles around twigs."""
    shape = (len(bases), NEEDLES, 3)
    roots = bases[:, None] + random.random((*shape[:2], 1)) * lengths[:, None] * direction[:, None]
    along = 0.8 * direction[:, None] + 0.6 * random.normal(size=shape)
    along *= NEEDLE_LENGTH / np.linalg.norm(along, axis=2, keepdims=True)
    across = np.cross(along, random.normal(size=shape))
    across *= NEEDLE_WIDTH / np.linalg.norm(across, axis=2, keepdims=True)
    corners = np.stack([roots, roots + 0.5 * (along + across), roots + along, roots + 0.5 * (along - across)], axis=2).reshape(-1, 4, 3)
    colors = np.repeat(random.uniform(0.7, 1.2, (corners.shape[0], 1)), 3, axis=1)
    uvs = np.array([(0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5)])
    return _repeat(corners, np.array([(0, 1, 2), (0, 2, 3)]), uvs, colors)


def _tubes(points: np.ndarray, radii: np.ndarray, sides: int) -> Model:
    """Return tubes around polylines (N, P, 3) with radii (N, P), of bark."""
    count, rings = radii.shape
    tangents = points[:, -1] - points[:, 0]
    first = np.cross(tangents, np.eye(3)[np.abs(tangents).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(tangents, first) / np.linalg.norm(tangents, axis=1, keepdims=True)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    vertices = points[:, :, None] + radii[:, :, None, None] * circle[:, None]
    side = np.arange(sides)
    ring = np.stack([side, (side + 1) % sides, (side + 1) % sides + sides, side + sides], axis=1)
    starts = sides * (rings * np.arange(count)[:, None] + np.arange(rings - 1)).reshape(-1)
    quads = (starts[:, None, None] + ring).reshape(-1, 4)
    u, v = np.stack([side, side + 1, side + 1, side], axis=1) / sides, np.array([0.0, 0.0, 1.0, 1.0])
    uvs = np.tile(np.stack([u, np.broadcast_to(v, u.shape)], axis=-1), (len(starts), 1, 1))
    triangles, uvs = split_quads(quads, uvs)
    vertices = vertices.reshape(-1, 3)
    return Model(vertices, triangles, uvs, np.zeros(len(triangles), int), np.ones((len(vertices), 3)))
