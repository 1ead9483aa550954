"""Moves of texture coordinates that flip no triangle and keep both sides of seams together."""

import numpy as np

from ...geometry.transforms import signed_areas
from ..textured_mesh import TexturedMesh
from .border_curves import BorderCurves, Freedom

MIN_AREA_FRACTION = 0.15  # of its area in UV space that a triangle keeps in one move
MAX_PARTNER_STEP = 4.0  # times the expected step: a farther point on the other side of a seam belongs to another part of it
MAX_HALVINGS = 12
MIN_FRACTION = 0.01  # of a step; a shorter one is not made


def move_uvs(mesh: TexturedMesh, steps: np.ndarray, freedom: Freedom, curves: BorderCurves) -> tuple[np.ndarray, np.ndarray]:
    """Return the texture coordinates (W, 2) after `steps` (V, 2) of the degrees of freedom, and the fractions (V,) of them that were made.

    Steps are halved where triangles would lose most of their area in UV space.
    """
    moves = np.einsum("wij,wj->wi", freedom.directions, steps[mesh.wedge_vertices])
    before = signed_areas(mesh.corner_uvs)
    fractions = np.ones(len(mesh.vertices))
    for _ in range(MAX_HALVINGS):
        scaled = moves * fractions[mesh.wedge_vertices, None]
        uvs = mesh.uvs + scaled
        stays = _slide(mesh, uvs, scaled, freedom, curves)
        fractions[mesh.wedge_vertices[stays]] = 0.0
        after = signed_areas(uvs[mesh.wedge_triangles])
        is_flipped = after * np.sign(before) < MIN_AREA_FRACTION * np.abs(before)
        if not is_flipped.any():
            return uvs, fractions
        vertices = np.unique(mesh.triangles[is_flipped])
        fractions[vertices] = np.where(fractions[vertices] > MIN_FRACTION, 0.5 * fractions[vertices], 0.0)
    return mesh.uvs, np.zeros(len(mesh.vertices))


def _slide(mesh: TexturedMesh, uvs: np.ndarray, moves: np.ndarray, freedom: Freedom, curves: BorderCurves) -> np.ndarray:
    """Put the sliding wedges of `uvs` (W, 2) onto the `curves`, in place. Return those of them that stay because the point on the other
    side of the seam is not near its wedge."""
    is_moving = (moves[freedom.sliding] != 0.0).any(axis=1)
    wedges, partners = freedom.sliding[is_moving], freedom.partners[is_moving]
    if not len(wedges):
        return wedges
    on_border, on_twin = curves.project(uvs[wedges], freedom.islands[is_moving])
    is_paired = partners >= 0
    distances = np.linalg.norm(on_twin - mesh.uvs[partners], axis=1)
    is_near = distances <= MAX_PARTNER_STEP * np.linalg.norm(moves[partners], axis=1) + np.finfo(float).eps
    stays = is_paired & ~is_near  # also where the nearest curve has no other side
    uvs[wedges] = np.where(stays[:, None], mesh.uvs[wedges], on_border)
    paired = partners[is_paired]
    uvs[paired] = np.where(stays[is_paired, None], mesh.uvs[paired], on_twin[is_paired])
    return wedges[stays]
