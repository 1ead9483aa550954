"""Inner boxes subdivided from the surface of the next coarser box (section 3.7, Figure 12): quads split in four, new vertices displaced.

Whether an edge is split depends only on its ends, so the quads on both sides of it agree, whichever block they are in: it is split if both
ends lie in the finer box or on its boundary. A quad with all four corners there is split into four. A quad with one edge there gets the
edge's midpoint as an additional corner. A new vertex is displaced along its normal by a random number hashed from its lattice position and
the seed.
"""

from dataclasses import dataclass, replace

import numpy as np

from ...geometry.proximity import decode_pairs, encode_pairs
from ...geometry.transforms import normalize
from ..layout import IntBox
from ..terrains.hashing import hash_lattice, uniform_random
from .triangulation import polygon_normals

CYCLE_STRIDE = 4  # more than the cycles of a corner: a midpoint is identified by the cycles of both ends


@dataclass(frozen=True)
class PatchVertices:
    """The vertices of a surface.

    corners (V, 3) int64: corner in the lattice of level 0. cycles (V,) int8. positions (V, 3) float64 in voxels of level 0. normals (V, 3)
    float32.
    """

    corners: np.ndarray
    cycles: np.ndarray
    positions: np.ndarray
    normals: np.ndarray


def subdivide(
    vertices: PatchVertices, quads: np.ndarray, boxes: list[IntBox], roughness: float, seed: int
) -> tuple[PatchVertices, np.ndarray, np.ndarray]:
    """Split `quads` (F, 4) in the finer `boxes`, which are ordered from the outermost inwards; the last one is that of level 0.

    roughness: maximum displacement of new vertices, relative to the voxel size of their level.

    Returns the vertices including new ones, polygons (P, 8) as in `triangulation.triangulate_fans`, and the source quad (P,) of each.
    """
    finished, finished_sources, sources = [], [], np.arange(len(quads))
    for index, box in enumerate(boxes):
        scale = 1 << (len(boxes) - 1 - index)
        inside = IntBox(box.low * scale, box.high * scale).contains_corners(vertices.corners)
        split = inside[quads] & inside[np.roll(quads, -1, axis=1)]
        vertices, midpoints = _add_midpoints(vertices, quads, split, roughness * scale, seed, is_first=index == 0)
        polygons = np.full((len(quads), 8), -1, np.int64)
        polygons[:, 0::2], polygons[:, 1::2] = quads, midpoints
        is_inner = inside[quads].all(axis=1)
        finished.append(polygons[~is_inner])
        finished_sources.append(sources[~is_inner])
        vertices, centers = _add_centers(vertices, quads[is_inner], roughness * scale, seed)
        corners, midpoints = quads[is_inner], midpoints[is_inner]
        quarters = [np.stack([corners[:, side], midpoints[:, side], centers, midpoints[:, side - 1]], axis=1) for side in range(4)]
        quads, sources = np.concatenate(quarters), np.tile(sources[is_inner], 4)
    finest = np.full((len(quads), 8), -1, np.int64)
    finest[:, 0::2] = quads
    polygons = np.concatenate([*finished, finest])
    outermost = IntBox(boxes[0].low * (1 << (len(boxes) - 1)), boxes[0].high * (1 << (len(boxes) - 1)))
    on_boundary = ((vertices.corners == outermost.low) | (vertices.corners == outermost.high)).any(axis=1)
    inside = outermost.contains_corners(vertices.corners) & ~on_boundary
    normals = np.where(inside[:, None], polygon_normals(vertices.positions, polygons), vertices.normals)
    return replace(vertices, normals=normals), polygons, np.concatenate([*finished_sources, sources])


def _add_midpoints(
    vertices: PatchVertices, quads: np.ndarray, split: np.ndarray, max_displacement: float, seed: int, *, is_first: bool
) -> tuple[PatchVertices, np.ndarray]:
    """Add the midpoints of the edges that are `split` (F, 4). Also returns the vertex index (F, 4) of each midpoint, -1 for none."""
    ends = np.stack([quads[split], np.roll(quads, -1, axis=1)[split]], axis=1)
    ends.sort(axis=1)
    edges, edge_indices = np.unique(encode_pairs(*ends.T, len(vertices.corners)), return_inverse=True)
    midpoints = np.full(quads.shape, -1, np.int64)
    midpoints[split] = len(vertices.corners) + edge_indices.reshape(-1)
    first, second = decode_pairs(edges, len(vertices.corners)).T
    swapped = _is_lexicographically_greater(vertices.corners[first], vertices.corners[second])
    first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    if is_first:
        cycles = vertices.cycles[first] * CYCLE_STRIDE + vertices.cycles[second]
    else:
        cycles = np.maximum(vertices.cycles[first], vertices.cycles[second])
    return _add_vertices(vertices, (first, second), cycles, max_displacement, seed), midpoints


def _add_centers(vertices: PatchVertices, quads: np.ndarray, max_displacement: float, seed: int) -> tuple[PatchVertices, np.ndarray]:
    """Add the centers of `quads` (F, 4). Also returns the vertex index (F,) of each center."""
    centers = len(vertices.corners) + np.arange(len(quads))
    lowest = np.argmin(vertices.corners.sum(axis=1)[quads], axis=1)  # a quad has only one lowest corner
    corners = np.take_along_axis(quads, (lowest[:, None] + np.arange(4)) % 4, axis=1)
    corners[:, [1, 3]] = _sort_pairs(vertices, corners[:, [1, 3]])
    return _add_vertices(vertices, tuple(corners.T), np.zeros(len(quads), np.int8), max_displacement, seed), centers


def _sort_pairs(vertices: PatchVertices, pairs: np.ndarray) -> np.ndarray:
    """Sort pairs of vertices (P, 2) by their corners, so that sums over them do not depend on the orientation of a quad."""
    swapped = _is_lexicographically_greater(vertices.corners[pairs[:, 0]], vertices.corners[pairs[:, 1]])
    return np.where(swapped[:, None], pairs[:, ::-1], pairs)


def _add_vertices(
    vertices: PatchVertices, parents: tuple[np.ndarray, ...], cycles: np.ndarray, max_displacement: float, seed: int
) -> PatchVertices:
    """Add vertices at the means of their `parents`, each displaced along its normal by up to `max_displacement`."""
    corners = sum(vertices.corners[parent] for parent in parents) // len(parents)
    normals = normalize(sum(vertices.normals[parent] for parent in parents)).astype(np.float32)
    random = 2.0 * uniform_random(hash_lattice(*corners.T, seed) + cycles.astype(np.uint32), 0) - 1.0
    positions = sum(vertices.positions[parent] for parent in parents) / len(parents) + (max_displacement * random)[:, None] * normals
    return PatchVertices(
        np.concatenate([vertices.corners, corners]),
        np.concatenate([vertices.cycles, cycles.astype(np.int8)]),
        np.concatenate([vertices.positions, positions]),
        np.concatenate([vertices.normals, normals]),
    )


def _is_lexicographically_greater(corners: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return whether `corners` (N, 3) come after `others` (N, 3) when sorted by x, then y, then z."""
    first = np.argmax(corners != others, axis=1)[:, None]
    return (np.take_along_axis(corners, first, axis=1) > np.take_along_axis(others, first, axis=1))[:, 0]
