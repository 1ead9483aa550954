"""Triangulation, smoothing and normals of meshes of quads and larger polygons."""

import numpy as np

MAX_VALENCE = 7  # faces of a vertex, and so neighbors: six directions, one of them twice in a few cases


def split_quads(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Split each of `quads` (Q, 4) along its shorter diagonal, the first one where they are equal: triangles (2 Q, 3) int32."""
    first, second = (((vertices[quads[:, end]] - vertices[quads[:, end + 2]]) ** 2).sum(axis=1) for end in (0, 1))
    rotated = np.where((second < first)[:, None], quads[:, [1, 2, 3, 0]], quads)
    return rotated[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)


def triangulate_fans(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangulate quads with edge midpoints.

    polygons (F, 8) have their corners in the even columns. The odd column after a corner is the midpoint of the next edge where it was
    split, otherwise -1. Triangles fan out from a midpoint, so that none is degenerate.

    Returns triangles (T, 3) int32, and the polygon (T,) of each.
    """
    first_midpoint = 1 + 2 * np.argmax(polygons[:, 1::2] >= 0, axis=1)
    rotated = np.take_along_axis(polygons, (first_midpoint[:, None] + np.arange(8)) % 8, axis=1)
    order = np.argsort(rotated < 0, axis=1, kind="stable")
    rotated, counts = np.take_along_axis(rotated, order, axis=1), (rotated >= 0).sum(axis=1)
    sources = [np.flatnonzero(counts > last) for last in range(2, 8)]
    triangles = [rotated[rows][:, [0, last - 1, last]] for last, rows in enumerate(sources, 2)]
    return np.concatenate(triangles).astype(np.int32), np.concatenate(sources)


def vertex_neighbors(quads: np.ndarray, count: int) -> np.ndarray:
    """Return the neighbors (V, 7) int32 of `count` vertices along edges of `quads` (Q, 4), -1 where there are fewer.

    Each is the next corner of one face, in the order of the faces. Vertices on the boundary lack one of their neighbors.
    """
    vertices, next_corners = quads.ravel(), np.roll(quads, -1, axis=1).ravel().astype(np.int32)
    order = np.argsort(vertices, kind="stable")
    sorted_vertices = vertices[order]
    starts = np.searchsorted(sorted_vertices, np.arange(count))
    neighbors = np.full((count, MAX_VALENCE), -1, np.int32)
    neighbors[sorted_vertices, np.arange(len(sorted_vertices)) - starts[sorted_vertices]] = next_corners[order]
    return neighbors


def smooth(vertices: np.ndarray, quads: np.ndarray, fixed: np.ndarray, iterations: int) -> np.ndarray:
    """Move `vertices` (V, 3) halfway to the mean of their neighbors, except those that are `fixed` (V,) (section 3.7 of the paper)."""
    neighbors = vertex_neighbors(quads, len(vertices))
    is_neighbor = neighbors >= 0
    counts = is_neighbor.sum(axis=1)
    moving = np.flatnonzero((counts > 0) & ~fixed)
    neighbors, is_neighbor, counts = neighbors[moving], is_neighbor[moving, :, None], counts[moving, None]
    vertices = vertices.copy()
    for _ in range(iterations):
        mean = np.where(is_neighbor, vertices[neighbors], 0.0).sum(axis=1) / counts
        vertices[moving] = 0.5 * vertices[moving] + 0.5 * mean
    return vertices


def polygon_normals(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Return unit vertex normals (V, 3) float32: area-weighted means over the polygons (F, 4) or (F, 8) of each vertex.

    Normals point up where a vertex has no polygon. Of polygons with edge midpoints, see `triangulate_fans`, only the four corners count.
    """
    quads = polygons[:, :: polygons.shape[1] // 4]
    area_normals = np.cross(vertices[quads[:, 2]] - vertices[quads[:, 0]], vertices[quads[:, 3]] - vertices[quads[:, 1]])
    is_corner = polygons >= 0
    corners, area_normals = polygons[is_corner], np.repeat(area_normals, is_corner.sum(axis=1), axis=0)
    sums = np.stack([np.bincount(corners, area_normals[:, axis], len(vertices)) for axis in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1)
    sums[lengths == 0.0], lengths[lengths == 0.0] = (0.0, 0.0, 1.0), 1.0
    return (sums / lengths[:, None]).astype(np.float32)
