"""Seams that divide a surface into charts with little stretch, found by xatlas."""

import numpy as np

from ...geometry.edges import find_edges
from ...geometry.mesh import TriangleMesh, longest_side
from .welding import pair_doubled_edges

XATLAS_SIDE = 10.0  # Longest side of what xatlas gets: it drops faces with areas below 1e-7, and never ends where squares are infinite.


def find_atlas_seams(mesh: TriangleMesh, polygon_ids: np.ndarray) -> np.ndarray:
    """Return the vertices (S, 2) of the edges between xatlas's charts of `mesh`, of any size, except for edges inside a polygon.

    polygon_ids: (T,) the polygon of each triangle.
    """
    import xatlas  # Here, so that importing the core needs only NumPy and SciPy.

    atlas = xatlas.Atlas()
    atlas.add_mesh(_scale_for_xatlas(mesh), mesh.triangles.astype(np.uint32))
    atlas.generate()
    _, triangles, uvs = atlas.get_mesh(0)
    corner_uvs = uvs[triangles.reshape(-1).astype(np.int64)]
    edges = find_edges(mesh.triangles, len(mesh.vertices))
    halfedges = np.concatenate([edges.interior_halfedges, pair_doubled_edges(mesh.vertices, mesh.triangles, edges)])
    starts, ends = (3 * (halfedges // 3) + (halfedges % 3 + offset) % 3 for offset in (1, 2))
    is_equal = mesh.triangles.reshape(-1)[starts[:, 0]] == mesh.triangles.reshape(-1)[starts[:, 1]]  # Where both have the same winding.
    ends_of_other = np.where(is_equal[:, None], np.stack([starts[:, 1], ends[:, 1]], 1), np.stack([ends[:, 1], starts[:, 1]], 1))
    is_cut = (corner_uvs[np.stack([starts[:, 0], ends[:, 0]], 1)] != corner_uvs[ends_of_other]).any(axis=(1, 2))
    is_cut &= polygon_ids[halfedges[:, 0] // 3] != polygon_ids[halfedges[:, 1] // 3]
    return edges.ends[edges.face_edges.reshape(-1)[halfedges[is_cut, 0]]]


def _scale_for_xatlas(mesh: TriangleMesh) -> np.ndarray:
    """Return the vertices (V, 3) float32 of `mesh`, centered and with XATLAS_SIDE; those that no triangle uses are at the center."""
    used = np.unique(mesh.triangles)
    points = mesh.vertices[used]
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scaled = np.zeros((len(mesh.vertices), 3), np.float32)
    scaled[used] = (points - center) * (XATLAS_SIDE / (longest_side(points) or 1.0))
    return scaled
