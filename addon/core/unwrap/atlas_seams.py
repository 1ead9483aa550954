"""Where a surface is cut into charts that hardly stretch, as xatlas finds them."""

import numpy as np

from ..edges import edges_of
from ..mesh import TriangleMesh


def atlas_seams(mesh: TriangleMesh, faces: np.ndarray) -> np.ndarray:
    """Vertices (S, 2) joined by the edges along which xatlas parts the charts of `mesh`, but for those within one of its
    `faces` (T,)."""
    import xatlas  # here, so that importing the core needs only NumPy and SciPy

    atlas = xatlas.Atlas()
    atlas.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    atlas.generate()
    _, triangles, _ = atlas.get_mesh(0)
    made = triangles.reshape(-1, 3).astype(np.int64)
    edges = edges_of(mesh.triangles, len(mesh.vertices))
    sides = edges.inner_sides
    starts, ends = (3 * (sides // 3) + (sides % 3 + turn) % 3 for turn in (1, 2))
    along = np.sort(np.stack([made.ravel()[starts], made.ravel()[ends]], axis=2), axis=2)
    parted = (along[:, 0] != along[:, 1]).any(axis=1)
    parted &= faces[sides[:, 0] // 3] != faces[sides[:, 1] // 3]
    return edges.ends[edges.inner[parted]]
