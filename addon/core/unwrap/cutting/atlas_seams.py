"""Seams that divide a surface into charts with little stretch, found by xatlas."""

import numpy as np

from ...geometry.edges import find_edges
from ...geometry.mesh import TriangleMesh, longest_side

XATLAS_SIDE = 10.0  # Longest side of what xatlas gets: it drops faces with areas below 1e-7, and never ends where squares are infinite.


def find_atlas_seams(mesh: TriangleMesh, polygon_ids: np.ndarray) -> np.ndarray:
    """Return the vertices (S, 2) of the edges between xatlas's charts of `mesh`, of any size, except for edges inside a polygon.

    polygon_ids: (T,) the polygon of each triangle.
    """
    import xatlas  # Here, so that importing the core needs only NumPy and SciPy.

    atlas = xatlas.Atlas()
    atlas.add_mesh(_scale_for_xatlas(mesh), mesh.triangles.astype(np.uint32))
    atlas.generate()
    _, triangles, _ = atlas.get_mesh(0)
    atlas_corners = triangles.reshape(-1).astype(np.int64)
    edges = find_edges(mesh.triangles, len(mesh.vertices))
    halfedges = edges.interior_halfedges
    starts, ends = (3 * (halfedges // 3) + (halfedges % 3 + offset) % 3 for offset in (1, 2))
    halfedge_ends = np.sort(np.stack([atlas_corners[starts], atlas_corners[ends]], axis=2), axis=2)
    is_cut = (halfedge_ends[:, 0] != halfedge_ends[:, 1]).any(axis=1)
    is_cut &= polygon_ids[halfedges[:, 0] // 3] != polygon_ids[halfedges[:, 1] // 3]
    return edges.ends[edges.interior[is_cut]]


def _scale_for_xatlas(mesh: TriangleMesh) -> np.ndarray:
    """Return the vertices (V, 3) float32 of `mesh`, centered and with XATLAS_SIDE; those that no triangle uses are at the center."""
    used = np.unique(mesh.triangles)
    points = mesh.vertices[used]
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    scaled = np.zeros((len(mesh.vertices), 3), np.float32)
    scaled[used] = (points - center) * (XATLAS_SIDE / (longest_side(points) or 1.0))
    return scaled
