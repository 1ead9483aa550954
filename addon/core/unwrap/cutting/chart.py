"""Connected parts of a surface that are parameterized as UV islands, and their division along edges.

Corners share a vertex only where their triangles are connected around it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True)
class Chart:
    """A part of a surface with the topology of a disk, possibly with holes.

    vertices: (V, 3) float64, all used by the triangles. triangles: (T, 3) int32, a connected and oriented manifold. density: (T,), above
    0, the desired texels per area relative to each other. polygon_ids: (T,), triangles with the same ID are not to be cut apart.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    density: np.ndarray
    polygon_ids: np.ndarray | None = None


def split_into_components(chart: Chart, halfedges: np.ndarray) -> list[tuple[Chart, np.ndarray]]:
    """Split a chart along all edges except for those of `halfedges` (I, 2), pairs of halfedges 3 t + c.

    Returns:
        the connected components, each a manifold with its own vertices, and the indices of their triangles.
    """
    vertex_indices = split_vertices(chart.triangles, halfedges)
    count = len(chart.triangles)
    total, label = label_components(count, halfedges)
    components = []
    for members in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=total))[:-1]):
        _, corners, indices = np.unique(vertex_indices[members], return_index=True, return_inverse=True)
        vertices = chart.vertices[chart.triangles[members].ravel()[corners]]
        polygon_ids = None if chart.polygon_ids is None else chart.polygon_ids[members]
        components.append((Chart(vertices, indices.reshape(-1, 3).astype(np.int32), chart.density[members], polygon_ids), members))
    return components


def label_components(count: int, halfedges: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the number of components of `count` triangles that are connected across `halfedges` (I, 2), and the one of each triangle."""
    links = coo_array((np.ones(len(halfedges), bool), tuple(halfedges.T // 3)), shape=(count, count))
    return connected_components(links, directed=False)


def split_vertices(triangles: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return new vertex indices (T, 3), equal only for corners that are connected across `halfedges` (I, 2)."""
    first, second = (3 * (side // 3) for side in halfedges.T)
    pairs = [(first + (halfedges[:, 0] % 3 + offset) % 3, second + (halfedges[:, 1] % 3 + 3 - offset) % 3) for offset in (1, 2)]
    first_corners, second_corners = (np.concatenate(corners) for corners in zip(*pairs, strict=True))
    connected = coo_array((np.ones(len(first_corners), bool), (first_corners, second_corners)), shape=(triangles.size,) * 2)
    return connected_components(connected, directed=False)[1].reshape(-1, 3)
