"""What of a surface of quads touches what, as index arrays (section 3.2 and Figure 4 of the paper); -1 where there is nothing.

Surface to vertex is the array of quads itself.
"""

import numpy as np

from .surface import Surface

MOST = 7  # faces, and so neighbours, that a vertex has: six directions, one of them twice in a few patterns


def vertex_faces(quads: np.ndarray, count: int) -> np.ndarray:
    """Vertex to surface: the faces (V, 7) int32 about each of `count` vertices, in rising order."""
    return _by_vertex(quads, np.repeat(np.arange(len(quads), dtype=np.int32), 4), count)


def vertex_vertices(quads: np.ndarray, count: int) -> np.ndarray:
    """Vertex to vertex: the neighbours (V, 7) int32 along edges, each the next corner of one face; so inner vertices have all of theirs."""
    return _by_vertex(quads, np.roll(quads, -1, axis=1).ravel().astype(np.int32), count)


def face_faces(quads: np.ndarray) -> np.ndarray:
    """Surface to surface: the face (F, 4) int32 beyond the edge from each corner to the next one."""
    starts, ends = quads.ravel().astype(np.int64), np.roll(quads, -1, axis=1).ravel().astype(np.int64)
    count = int(quads.max(initial=0)) + 1
    forward, backward = starts * count + ends, ends * count + starts
    order = np.argsort(forward)
    found = np.minimum(np.searchsorted(forward[order], backward), len(order) - 1)
    there = order[found]
    return np.where(forward[there] == backward, there // 4, -1).reshape(-1, 4).astype(np.int32) if len(quads) else quads.astype(np.int32)


def corner_vertices(made: Surface, shape: tuple[int, int, int]) -> np.ndarray:
    """Voxel to vertex: the first vertex (X + 1, Y + 1, Z + 1) int32 at each corner of a volume of this `shape`."""
    found = np.full(tuple(side + 1 for side in shape), -1, np.int32)
    found[tuple(made.corners[::-1].T)] = np.arange(len(made.corners), dtype=np.int32)[::-1]
    return found


def _by_vertex(quads: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """What belongs to the corners of quads, (4 F,), gathered by vertex (V, 7) in rising order of the faces."""
    vertices = quads.ravel()
    order = np.argsort(vertices, kind="stable")
    ordered = vertices[order]
    starts = np.searchsorted(ordered, np.arange(count))
    table = np.full((count, MOST), -1, np.int32)
    table[ordered, np.arange(len(ordered)) - starts[ordered]] = values[order]
    return table
