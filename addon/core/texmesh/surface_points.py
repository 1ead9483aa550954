"""The points of a surface that the vertices of its levels stand for, for values that levels have at vertices, such as skin weights."""

import numpy as np
from scipy.sparse import csr_array

from ..geometry.mesh import scaled_normals
from .surface_descent import SurfaceDescent
from .textured_mesh import TexturedMesh


def find_vertex_weights(mesh: TexturedMesh, level: TexturedMesh, source_triangles: np.ndarray, source_count: int) -> csr_array:
    """Return the matrix (V, S) that interpolates values at the vertices of the source at the V vertices of a level of `mesh`.

    Each row has the barycentric coordinates of the point of the surface that is nearest to the vertex among those that the vertex's place
    in the source is connected with, so that thin parts and parts that touch keep their own values. Rows sum to 1.

    source_triangles: (T, 3) vertices of the source, which has S = `source_count`. Its corners are what the rows of `mesh.sources` and
        `level.sources` refer to.
    """
    by_source = np.zeros(len(source_triangles), np.int64)
    by_source[mesh.sources[:, 0] // 3] = np.arange(len(mesh.triangles))
    starts = np.zeros(len(level.vertices), np.int64)
    starts[level.triangles] = by_source[level.sources // 3]
    normals = np.zeros((len(level.vertices), 3))
    np.add.at(normals, level.triangles, scaled_normals(level.vertices[level.triangles])[:, None])
    descent = SurfaceDescent(mesh.vertices, mesh.triangles)
    triangles, barycentric = descent.find_nearest(level.vertices, normals, starts)
    rows = mesh.sources[triangles]
    vertices = source_triangles[rows // 3, rows % 3]
    starts = np.arange(0, barycentric.size + 1, 3)
    return csr_array((barycentric.ravel(), vertices.ravel(), starts), shape=(len(level.vertices), source_count))
