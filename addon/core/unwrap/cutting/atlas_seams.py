"""Seams that divide a surface into charts with little stretch, found by xatlas."""

import numpy as np

from ...geometry.edges import find_edges
from ...geometry.mesh import TriangleMesh


def find_atlas_seams(mesh: TriangleMesh, polygon_ids: np.ndarray) -> np.ndarray:
    """Return the vertices (S, 2) of the edges between xatlas's charts of `mesh`, except for edges inside a polygon.

    polygon_ids: (T,) the polygon of each triangle.
    """
    import xatlas  # here, so that importing the core needs only NumPy and SciPy

    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
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
