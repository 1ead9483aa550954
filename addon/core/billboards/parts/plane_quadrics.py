"""The cost of collapses of parts: squared distances from planes, after Garland and Heckbert, 1997, without any texture."""

import numpy as np

from ...geometry.edges import find_edges
from ...geometry.mesh import face_areas_and_normals
from ...texmesh.simplification.engine import WedgeMoves
from ...texmesh.simplification.topology import Collapses
from ...texmesh.simplification.wedge_quadrics import COLUMNS, POSITION_COLUMNS, POSITION_ROWS, ROWS, WedgeQuadrics
from ...texmesh.textured_mesh import TexturedMesh

LENGTH_WEIGHT = 1e-6  # Weight of the squared length of a collapse, which decides in flat parts.
BOUNDARY_WEIGHT = 1.0  # Of squared distances from boundary edges, times their squared length.
HOMOGENEOUS = np.array([0, 1, 2, 5])  # Of x, y, z and 1 among x, y, z, u, v and 1.


class PlaneQuadrics(WedgeQuadrics):
    """A `CollapseCost`: squared distances from the planes of triangles, by area, and from boundaries; kept vertices move to the minima."""

    def __init__(self, mesh: TexturedMesh) -> None:
        points = np.column_stack([mesh.vertices[mesh.wedge_vertices], np.zeros((len(mesh.wedge_vertices), 2))])
        points[:, :3] -= points[:, :3].mean(axis=0)
        areas, normals = face_areas_and_normals(mesh.vertices[mesh.triangles])
        super().__init__(mesh, points, areas, moves_vertices=True)
        self._areas = np.bincount(mesh.wedge_triangles.ravel(), np.repeat(areas, 3) / 3.0, len(points))
        quadrics = self._planes
        self._add_boundaries(mesh, normals, quadrics)
        column_of = {pair: column for column, pair in enumerate(zip(ROWS.tolist(), COLUMNS.tolist(), strict=True))}
        pairs = zip(HOMOGENEOUS[POSITION_ROWS].tolist(), HOMOGENEOUS[POSITION_COLUMNS].tolist(), strict=True)
        self._quadrics[:, [column_of[pair] for pair in pairs]] = quadrics
        self.finish()

    def evaluate(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """See `CollapseCost`."""
        (removed, _), (kept, _) = collapses.removed_wedges, collapses.kept_wedges
        lengths = ((self._points[removed, :3] - self._points[kept, :3]) ** 2).sum(axis=1)
        return self.evaluate_wedges(collapses, moves) + LENGTH_WEIGHT * self._areas[removed] * lengths

    def _add_boundaries(self, mesh: TexturedMesh, normals: np.ndarray, quadrics: np.ndarray) -> None:
        """Add the planes through boundary edges that are perpendicular to their triangles to `quadrics` (W, 10)."""
        edges = find_edges(mesh.triangles)
        faces, corners = np.nonzero(edges.face_counts[edges.face_edges] == 1)
        start, end = (mesh.wedge_triangles[faces, (corners + step) % 3] for step in (1, 2))
        direction = self._points[end, :3] - self._points[start, :3]
        across = np.cross(direction, normals[faces])  # as long as the edge, which weights its squared distance
        planes = np.column_stack([across, -np.einsum("ni,ni->n", across, self._points[start, :3])])
        terms = BOUNDARY_WEIGHT * planes[:, POSITION_ROWS] * planes[:, POSITION_COLUMNS]
        np.add.at(quadrics, start, terms)
        np.add.at(quadrics, end, terms)
