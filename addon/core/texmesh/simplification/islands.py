"""UV islands and connected components of textured meshes."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..textured_mesh import TexturedMesh


def find_islands(mesh: TexturedMesh) -> np.ndarray:
    """Return the number (T,) of the UV island of each triangle. Triangles of an island are connected by wedges."""
    return label_connected(mesh.wedge_triangles, len(mesh.uvs))


def label_connected(triangles: np.ndarray, count: int) -> np.ndarray:
    """Return the number (T,) of the connected component of each of `triangles` (T, 3) into `count` vertices or wedges."""
    first, second, third = triangles.T
    ones = np.ones(2 * len(triangles), bool)
    graph = coo_array((ones, (np.concatenate([first, first]), np.concatenate([second, third]))), shape=(count, count))
    labels = connected_components(graph, directed=False)[1][first]
    return np.unique(labels, return_inverse=True)[1].reshape(-1)
