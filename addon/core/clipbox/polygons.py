"""Triangles out of quads and larger polygons, and smoothing over quads."""

import numpy as np

from .adjacency import vertex_vertices


def split_quads(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Two triangles (2 Q, 3) int32 for each of `quads` (Q, 4), split along the shorter diagonal, the first one where they are equal."""
    first, second = (((vertices[quads[:, end]] - vertices[quads[:, end + 2]]) ** 2).sum(axis=1) for end in (0, 1))
    turned = np.where((second < first)[:, None], quads[:, [1, 2, 3, 0]], quads)
    return turned[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)


def fans(polygons: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (T, 3) int32 of polygons (F, 8), and which of these (T,) each is from.

    Polygons are quads whose corners stand at even places, and where an edge was split its middle at the odd place after it, else -1. They
    fan out from a middle, so that no triangle is flat.
    """
    begin = 1 + 2 * np.argmax(polygons[:, 1::2] >= 0, axis=1)
    turned = np.take_along_axis(polygons, (begin[:, None] + np.arange(8)) % 8, axis=1)
    order = np.argsort(turned < 0, axis=1, kind="stable")
    turned, counts = np.take_along_axis(turned, order, axis=1), (turned >= 0).sum(axis=1)
    sources = [np.flatnonzero(counts > last) for last in range(2, 8)]
    made = [turned[rows][:, [0, last - 1, last]] for last, rows in enumerate(sources, 2)]
    return np.concatenate(made).astype(np.int32), np.concatenate(sources)


def smoothed(vertices: np.ndarray, quads: np.ndarray, fixed: np.ndarray, times: int) -> np.ndarray:
    """`vertices` (V, 3) moved half way to the mean of their neighbours so many `times`, but for those `fixed` (V,) (section 3.7)."""
    neighbours = vertex_vertices(quads, len(vertices))
    there = neighbours >= 0
    counts = there.sum(axis=1)
    moving = np.flatnonzero((counts > 0) & ~fixed)
    neighbours, there, counts = neighbours[moving], there[moving, :, None], counts[moving, None]
    vertices = vertices.copy()
    for _ in range(times):
        mean = np.where(there, vertices[neighbours], 0.0).sum(axis=1) / counts
        vertices[moving] = 0.5 * vertices[moving] + 0.5 * mean
    return vertices


def polygon_normals(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3) float32 of vertices: of the polygons (F, 4) or (F, 8) about them, by area; up where there are none.

    Of polygons with corners that stand for the middles of edges, see `fans`, the four corners at even places are looked at.
    """
    quads = polygons[:, :: polygons.shape[1] // 4]
    across = np.cross(vertices[quads[:, 2]] - vertices[quads[:, 0]], vertices[quads[:, 3]] - vertices[quads[:, 1]])
    there = polygons >= 0
    ends, across = polygons[there], np.repeat(across, there.sum(axis=1), axis=0)
    sums = np.stack([np.bincount(ends, across[:, axis], len(vertices)) for axis in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1)
    sums[lengths == 0.0], lengths[lengths == 0.0] = (0.0, 0.0, 1.0), 1.0
    return (sums / lengths[:, None]).astype(np.float32)
