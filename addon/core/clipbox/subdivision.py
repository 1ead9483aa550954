"""Inner boxes made from the surface around them instead of from voxels (section 3.7, Figure 12): each quad in four, moved at random.

Whether an edge is split depends on its ends alone, so the quads on both sides of it agree, whichever block they are in: it is where both
ends lie in the finer box or on its border. A quad with all four corners there is split into four; one with an edge there gets the edge's
middle as a further corner. A new vertex is moved along its normal by a random number that belongs to its place and the seed.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..spatial import keys_of, split_keys
from .hashing import fractions, hashed_lattice
from .layout import Cuboid
from .polygons import polygon_normals

FIRST_RINGS = 4  # more rings than a corner has: a middle of two corners is told from others at its place by both corners' rings


@dataclass(frozen=True)
class Patch:
    """Vertices by their corner in level 0's lattice, (V, 3) int64, and ring (V,) int8; vertices (V, 3) float64 in voxels of level 0;
    normals (V, 3) float32."""

    corners: np.ndarray
    rings: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray


def subdivided(patch: Patch, quads: np.ndarray, boxes: list[Cuboid], roughness: float, seed: int) -> tuple[Patch, np.ndarray, np.ndarray]:
    """Quads (F, 4) split in the finer `boxes`, given from the outermost inwards, the last one of level 0.

    roughness: how far new vertices are moved at most, as a share of the voxels of the level that they belong to.

    Returns the patch with its new vertices, polygons (P, 8) as `polygons.fans` takes them, and the quad (P,) that each came from.
    """
    done, sources, source = [], [], np.arange(len(quads))
    for number, box in enumerate(boxes):
        scale = 1 << (len(boxes) - 1 - number)
        within = Cuboid(box.low * scale, box.high * scale).touches(patch.corners)
        split = within[quads] & within[np.roll(quads, -1, axis=1)]
        patch, middles = _with_middles(patch, quads, split, roughness * scale, seed, first=number == 0)
        polygons = np.full((len(quads), 8), -1, np.int64)
        polygons[:, 0::2], polygons[:, 1::2] = quads, middles
        inner = within[quads].all(axis=1)
        done.append(polygons[~inner])
        sources.append(source[~inner])
        patch, centres = _with_centres(patch, quads[inner], roughness * scale, seed)
        corners, middles = quads[inner], middles[inner]
        parts = [np.stack([corners[:, turn], middles[:, turn], centres, middles[:, turn - 1]], axis=1) for turn in range(4)]
        quads, source = np.concatenate(parts), np.tile(source[inner], 4)
    finest = np.full((len(quads), 8), -1, np.int64)
    finest[:, 0::2] = quads
    polygons = np.concatenate([*done, finest])
    outermost = Cuboid(boxes[0].low * (1 << (len(boxes) - 1)), boxes[0].high * (1 << (len(boxes) - 1)))
    inside = outermost.touches(patch.corners) & ~((patch.corners == outermost.low) | (patch.corners == outermost.high)).any(axis=1)
    normals = np.where(inside[:, None], polygon_normals(patch.vertices, polygons), patch.normals)
    return replace(patch, normals=normals), polygons, np.concatenate([*sources, source])


def _with_middles(patch: Patch, quads: np.ndarray, split: np.ndarray, reach: float, seed: int, *, first: bool) -> tuple[Patch, np.ndarray]:
    """The patch with the middles of the edges that are `split` (F, 4), and which vertex each is, (F, 4), -1 for none."""
    ends = np.stack([quads[split], np.roll(quads, -1, axis=1)[split]], axis=1)
    ends.sort(axis=1)
    edges, numbers = np.unique(keys_of(*ends.T, len(patch.corners)), return_inverse=True)
    middles = np.full(quads.shape, -1, np.int64)
    middles[split] = len(patch.corners) + numbers.reshape(-1)
    one, other = split_keys(edges, len(patch.corners)).T
    swapped = _comes_after(patch.corners[one], patch.corners[other])
    one, other = np.where(swapped, other, one), np.where(swapped, one, other)
    rings = patch.rings[one] * FIRST_RINGS + patch.rings[other] if first else np.maximum(patch.rings[one], patch.rings[other])
    return _extended(patch, (one, other), rings, reach, seed), middles


def _with_centres(patch: Patch, quads: np.ndarray, reach: float, seed: int) -> tuple[Patch, np.ndarray]:
    """The patch with the centres of `quads` (F, 4), and which vertex each is."""
    centres = len(patch.corners) + np.arange(len(quads))
    first = np.argmin(patch.corners.sum(axis=1)[quads], axis=1)  # only one corner of a quad is the lowest
    around = np.take_along_axis(quads, (first[:, None] + np.arange(4)) % 4, axis=1)
    around[:, [1, 3]] = _sorted_pair(patch, around[:, [1, 3]])
    return _extended(patch, tuple(around.T), np.zeros(len(quads), np.int8), reach, seed), centres


def _sorted_pair(patch: Patch, pairs: np.ndarray) -> np.ndarray:
    """Pairs of vertices (P, 2) in the order of their corners, so that sums over them do not depend on how a quad is turned."""
    swapped = _comes_after(patch.corners[pairs[:, 0]], patch.corners[pairs[:, 1]])
    return np.where(swapped[:, None], pairs[:, ::-1], pairs)


def _extended(patch: Patch, around: tuple[np.ndarray, ...], rings: np.ndarray, reach: float, seed: int) -> Patch:
    """The patch with a vertex in the middle of the vertices `around`, moved along its normal by up to `reach`."""
    corners = sum(patch.corners[each] for each in around) // len(around)
    normals = sum(patch.normals[each] for each in around)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = (normals / np.where(lengths > 0.0, lengths, 1.0)).astype(np.float32)
    chance = 2.0 * fractions(hashed_lattice(*corners.T, seed) + rings.astype(np.uint32), 0) - 1.0
    vertices = sum(patch.vertices[each] for each in around) / len(around) + (reach * chance)[:, None] * normals
    both = ((patch.corners, corners), (patch.rings, rings.astype(np.int8)), (patch.vertices, vertices), (patch.normals, normals))
    return Patch(*(np.concatenate(pair) for pair in both))


def _comes_after(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Whether corners (N, 3) come after others in the order of x, then y, then z."""
    first = np.argmax(one != other, axis=1)[:, None]
    return (np.take_along_axis(one, first, axis=1) > np.take_along_axis(other, first, axis=1))[:, 0]
