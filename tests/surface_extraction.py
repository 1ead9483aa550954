"""Surfaces of whole volumes, extracted as the engine of nested boxes extracts those of blocks."""

from dataclasses import dataclass

import numpy as np

from farfield.addon.core.clipbox.meshing import surface_nets
from farfield.addon.core.clipbox.meshing.case_table import DIRECTIONS


@dataclass(frozen=True)
class SurfaceNet:
    """The surface of a volume.

    Attributes:
        corners: (V, 3) int32, lattice corner of each vertex.
        vertices: (V, 3) float64, in voxels.
        normals: (V, 3) float32, or None for blocky surfaces.
        quads: (F, 4) int32, counter-clockwise as seen from outside.
    """

    corners: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray | None
    quads: np.ndarray


def extract_surface(densities: np.ndarray, blocky: bool = False) -> SurfaceNet:
    """Extract the surface of `densities` (X, Y, Z), which are positive where solid. Voxel (0, 0, 0) fills the unit cube.

    The surface is open at the boundary of the volume. With `blocky`, vertices are the lattice corners (cuberille). Otherwise they are the
    means of the zero crossings between the pairs of octants of their cycle.
    """
    padded = np.pad(densities > 0 if blocky else densities, 1, mode="edge")
    solid = surface_nets.is_solid(padded)
    faces = surface_nets.find_faces(solid, surface_nets.interior_mask(padded.shape))
    used, rows = surface_nets.compact_indices(faces.corners, padded.size)
    strides = np.array(surface_nets.voxel_strides(padded.shape))
    cases = surface_nets.resolve_non_manifold_edges(
        _gather_cases(solid, used), lambda corners, directions: _gather_cases(solid, used[corners] + DIRECTIONS[directions] @ strides)
    )
    corner_vertices = surface_nets.find_corner_vertices(cases)
    quads = surface_nets.face_vertices(corner_vertices, cases, rows.take(faces.corners), faces.pairs)
    corners = (surface_nets.unravel_indices(used, padded.shape) - 1).take(corner_vertices.corners, axis=0)
    if blocky:
        return SurfaceNet(corners, corners.astype(np.float64), None, quads)
    values = surface_nets.gather_octants(padded, used)
    vertices = corners + surface_nets.vertex_offsets(corner_vertices, cases, values)
    return SurfaceNet(corners, vertices, surface_nets.corner_normals(values)[corner_vertices.corners], quads)


def _gather_cases(solid: np.ndarray, corners: np.ndarray) -> np.ndarray:
    return surface_nets.case_indices(surface_nets.gather_octants(solid, corners))
