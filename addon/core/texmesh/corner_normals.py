"""Normals at the corners of textured meshes."""

import numpy as np

from ..arrays import concatenate_ranges
from ..geometry.mesh import face_areas_and_normals, scaled_normals, vertex_normals
from ..geometry.transforms import normalize
from .textured_mesh import TexturedMesh

MIN_SMOOTH_COSINE = np.cos(np.radians(40.0))  # between a face and the normal of a vertex; a sharper vertex is shaded flat
MAX_TURN = np.radians(30.0)  # A normal may turn so much against the surface when a mesh is simplified.


def find_corner_normals(mesh: TexturedMesh, fine: TexturedMesh | None = None) -> np.ndarray:
    """Return normals (T, 3, 3) float32 of corners: those of the mesh. Without any it is shaded flat, and they are those of the faces.

    fine: the mesh that `mesh` is a level of, None for none.
    """
    _, faces = face_areas_and_normals(mesh.vertices[mesh.triangles])
    if mesh.has_normals:
        corners = mesh.attributes[mesh.wedge_triangles, :3] if fine is None else repair_normals(fine, mesh)
        fill_flat(corners, faces)
        return corners.astype(np.float32)
    return np.broadcast_to(faces[:, None], mesh.triangles.shape + (3,)).astype(np.float32)


def repair_normals(fine: TexturedMesh, level: TexturedMesh) -> np.ndarray:
    """Return the normals of a level, but mean normals of its faces where a normal came to faces that it does not fit, as where a seam
    between the normals of a hard edge was dissolved.

    Args:
        fine: the mesh that the level was made from, with normals, zero on flat faces. level: its `sources` are rows of the corners of
            `fine`.

    Returns:
        (T, 3, 3) float32, of the corners of the level.
    """
    fine_normals, normals = fine.attributes[:, :3], level.attributes[:, :3]
    angles = np.zeros(int(fine.sources.max()) + 1)
    angles[fine.sources] = _angles_to(sum_faces(fine), fine_normals)[fine.wedge_triangles]
    around = vertex_normals(level.vertices, level.triangles)[level.wedge_vertices]
    turned = np.minimum(_angles_to(sum_faces(level), normals), _angles_to(around, normals))
    is_wrong = turned[level.wedge_triangles] > angles[level.sources] + MAX_TURN
    result = normals[level.wedge_triangles]
    result[is_wrong] = _smooth_by_angle(level, np.flatnonzero(is_wrong))
    return result


def fill_flat(values: np.ndarray, faces: np.ndarray) -> None:
    """Replace normals without length, the first columns of `values` (T, 3, A), by those of `faces` (T, 3), in place."""
    normals = values[..., :3]
    is_flat = (normals == 0.0).all(axis=2)
    normals[is_flat] = np.broadcast_to(faces[:, None], normals.shape)[is_flat]


def _smooth_by_angle(mesh: TexturedMesh, corners: np.ndarray) -> np.ndarray:
    """Return the mean normals (N, 3) at `corners` (N,) of the faces around the vertex whose normals deviate by at most 40 degrees."""
    faces = scaled_normals(mesh.vertices[mesh.triangles])
    units, order = normalize(faces), np.argsort(mesh.triangles.ravel(), kind="stable")
    counts = np.bincount(mesh.triangles.ravel(), minlength=len(mesh.vertices))
    vertices = mesh.triangles.ravel()[corners]
    rows = np.repeat(np.arange(len(corners)), counts[vertices])
    around = order[concatenate_ranges((np.cumsum(counts) - counts)[vertices], counts[vertices])] // 3
    is_near = np.einsum("ni,ni->n", units[corners[rows] // 3], units[around]) >= MIN_SMOOTH_COSINE
    sums = [np.bincount(rows[is_near], column, len(corners)) for column in faces[around[is_near]].T]
    return normalize(np.stack(sums, axis=1)).astype(np.float32)


def sum_faces(mesh: TexturedMesh) -> np.ndarray:
    """Return the mean normals (W, 3) of the faces of wedges, unit vectors."""
    faces, wedges = np.repeat(scaled_normals(mesh.vertices[mesh.triangles]), 3, axis=0), mesh.wedge_triangles.ravel()
    return normalize(np.stack([np.bincount(wedges, column, len(mesh.uvs)) for column in faces.T], axis=1))


def _angles_to(directions: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the angles (W,) in radians between unit vectors (W, 3) each; 0 where a normal has length zero."""
    angles = np.arccos(np.clip(np.einsum("wi,wi->w", directions, normals), -1.0, 1.0))
    return np.where((normals == 0.0).all(axis=1), 0.0, angles)
