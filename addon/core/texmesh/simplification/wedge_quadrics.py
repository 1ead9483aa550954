"""Quadrics of position and texture coordinates, one per wedge, and the quadrics of positions that they give at vertices.

With the texture coordinates that the wedges of a vertex have, their quadrics add up to one of its position. It is evaluated where the
vertex stays, or at its minimum, as Garland and Heckbert do, "Surface Simplification Using Quadric Error Metrics", 1997, section 4.
"""

import numpy as np

from ...geometry.mesh import face_areas_and_normals, longest_side
from ...jobs.chunks import slices
from ..textured_mesh import TexturedMesh
from .engine import Copies, WedgeMoves
from .topology import Collapses, find_islands

ROWS, COLUMNS = np.triu_indices(6)
POSITION_ROWS, POSITION_COLUMNS = np.triu_indices(4)
CHUNK_COLLAPSES = 1 << 12
LOST_DISTANCE = 0.05  # The texture of an island that vanishes counts as so far away, relative to the longest side of the mesh.
RIDGE = 1e-3  # Relative to the mean of the eigenvalues; keeps vertices in place along planes.
UNCERTAINTY = 0.05  # This part of what a move saves is not relied on, since the move may be refused: it would fold the surface.


class WedgeQuadrics:
    """The part that costs of collapses have in common. A subclass adds quadrics (W, 21) and areas (W,) of wedges, then calls `finish`."""

    def __init__(self, mesh: TexturedMesh, points: np.ndarray, plane_weights: np.ndarray, moves_vertices: bool) -> None:
        """points: (W, 5), positions and texture coordinates of wedges, scaled alike. plane_weights: (T,), of squared distances from the
        planes of triangles. moves_vertices: whether kept vertices move to the minima of their quadrics."""
        self._wedge_vertices, self.moves_vertices = mesh.wedge_vertices, moves_vertices
        self._points = points.copy()
        self._positions = np.zeros((len(mesh.vertices), 3))
        self._positions[mesh.wedge_vertices] = points[:, :3]
        areas, normals = face_areas_and_normals(self._positions[mesh.triangles])
        self._island_costs = np.bincount(find_islands(mesh), areas) * (LOST_DISTANCE * longest_side(self._positions)) ** 2
        self._quadrics = np.zeros((len(points), len(ROWS)))
        self._areas = np.zeros(len(points))
        self._planes = self._sum_planes(mesh, normals, plane_weights)
        self._vertex_planes = np.zeros((len(mesh.vertices), len(POSITION_ROWS)))  # see `drop_wedges`

    def finish(self) -> None:
        """Sum the quadrics of vertices."""
        self._at_vertices = np.zeros_like(self._vertex_planes)
        np.add.at(self._at_vertices, self._wedge_vertices, fix_uvs(self._quadrics, self._points[:, 3:]))

    def merge(self, collapses: Collapses, moves: WedgeMoves) -> None:
        """See `CollapseCost`."""
        np.add.at(self._at_vertices, collapses.kept, self._sum_removed(collapses, moves))
        np.add.at(self._vertex_planes, collapses.kept, self._vertex_planes[collapses.removed])
        is_moved = moves.removed == moves.kept
        self.merge_wedges(moves.removed[~is_moved], moves.kept[~is_moved])
        self._points[moves.removed[is_moved], :3] = self._positions[collapses.kept[moves.owners[is_moved]]]

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """See `CollapseCost`. The planes that the wedges stand for stay with the vertices."""
        planes = self._planes[wedges]
        np.add.at(self._vertex_planes, vertices, planes)
        np.add.at(self._at_vertices, vertices, planes - fix_uvs(self._quadrics[wedges], self._points[wedges, 3:]))

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`. Copies of wedges stand for the same triangles."""
        columns = (self._positions, self._at_vertices, self._vertex_planes)
        self._positions, self._at_vertices, self._vertex_planes = (np.concatenate([values, values[copies.vertices]]) for values in columns)
        points = np.column_stack([self._positions[copies.homes], self._points[copies.wedges, 3:]])
        self._points = np.concatenate([self._points, points])
        factor = 0.0 if copies.is_blank else 1.0
        columns = (self._quadrics, self._planes, self._areas)
        self._quadrics, self._planes, self._areas = (np.concatenate([values, factor * values[copies.wedges]]) for values in columns)

    def merge_wedges(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """Add the quadrics of wedges (N,) to those that take their place."""
        np.add.at(self._quadrics, kept, self._quadrics[removed])
        np.add.at(self._planes, kept, self._planes[removed])
        np.add.at(self._areas, kept, self._areas[removed])

    def find_steps(self, vertices: np.ndarray, limits: np.ndarray) -> np.ndarray:
        """See `VertexPlacement`."""
        return _find_minima(self._at_vertices[vertices], self._positions[vertices], limits)[0]

    def move(self, vertices: np.ndarray, steps: np.ndarray, owners: np.ndarray, wedges: np.ndarray) -> None:
        """See `VertexPlacement`."""
        self._positions[vertices] += steps
        self._points[wedges, :3] = self._positions[vertices[owners]]

    def evaluate_wedges(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """Return the costs (N,) of the kept vertices after `collapses`, not negative."""
        quadrics = self._at_vertices[collapses.kept] + self._sum_removed(collapses, moves)
        positions, costs = self._positions[collapses.kept], np.empty(len(quadrics))
        for chunk in slices(len(quadrics), CHUNK_COLLAPSES):  # in parts that stay in the cache
            costs[chunk] = evaluate_quadrics(quadrics[chunk], positions[chunk])
            if self.moves_vertices:
                lengths = np.linalg.norm(positions[chunk] - self._positions[collapses.removed[chunk]], axis=1)
                costs[chunk] -= (1.0 - UNCERTAINTY) * _find_minima(quadrics[chunk], positions[chunk], lengths)[1]
        for islands in moves.lost_islands:
            costs += np.where(islands >= 0, self._island_costs[islands], 0.0)
        return np.maximum(costs, 0.0)

    def _sum_removed(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """Return what the removed vertices add to the quadrics of the kept ones, (N, 10)."""
        added = np.empty((len(moves.removed), len(POSITION_ROWS)))
        for chunk in slices(len(added), CHUNK_COLLAPSES):
            added[chunk] = fix_uvs(self._quadrics.take(moves.removed[chunk], axis=0), self._points[moves.kept[chunk], 3:])
        starts = np.searchsorted(moves.owners, np.arange(len(collapses.removed)))
        return self._vertex_planes[collapses.removed] + np.add.reduceat(added, starts, axis=0)

    def _sum_planes(self, mesh: TexturedMesh, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return quadrics (W, 10) of squared distances from the planes of the triangles at wedges, with `weights` (T,)."""
        planes = np.column_stack([normals, -np.einsum("ti,ti->t", normals, self._positions[mesh.triangles[:, 0]])])
        terms = planes[:, POSITION_ROWS] * planes[:, POSITION_COLUMNS] * (weights / 3.0)[:, None]
        quadrics = np.zeros((len(mesh.uvs), len(POSITION_ROWS)))
        for corner in range(3):
            np.add.at(quadrics, mesh.wedge_triangles[:, corner], terms)
        return quadrics


def fix_uvs(quadrics: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Return the quadrics of positions (N, 10) that `quadrics` (N, 21) are with texture coordinates `uvs` (N, 2)."""
    xx, xy, xz, xu, xv, x1, yy, yz, yu, yv, y1, zz, zu, zv, z1, uu, uv, u1, vv, v1, one = quadrics.T
    u, v = uvs.T
    constant = one + u * (u * uu + 2.0 * (v * uv + u1)) + v * (v * vv + 2.0 * v1)
    linear = [u * along_u + v * along_v + rest for along_u, along_v, rest in ((xu, xv, x1), (yu, yv, y1), (zu, zv, z1))]
    return np.stack([xx, xy, xz, linear[0], yy, yz, linear[1], zz, linear[2], constant], axis=1)


def evaluate_quadrics(quadrics: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return the values (N,) of quadrics (N, 10) at `positions` (N, 3)."""
    homogeneous = np.column_stack([positions, np.ones(len(positions))])
    products = homogeneous[:, POSITION_ROWS] * homogeneous[:, POSITION_COLUMNS]
    return np.einsum("nk,nk->n", quadrics, products * np.where(POSITION_ROWS == POSITION_COLUMNS, 1.0, 2.0))


def _find_minima(quadrics: np.ndarray, positions: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the moves (N, 3) from `positions` (N, 3) to the minima of quadrics (N, 10), at most as long as `limits` (N,), and how much
    smaller the quadrics are there, (N,)."""
    matrices = quadrics[:, [[0, 1, 2], [1, 4, 5], [2, 5, 7]]]
    gradients = np.einsum("nij,nj->ni", matrices, positions) + quadrics[:, [3, 6, 8]]
    ridges = RIDGE / 3.0 * np.trace(matrices, axis1=1, axis2=2) + np.finfo(float).tiny
    moves = -np.linalg.solve(matrices + ridges[:, None, None] * np.eye(3), gradients[:, :, None])[:, :, 0]
    lengths = np.linalg.norm(moves, axis=1)
    moves *= np.divide(limits, lengths, out=np.ones_like(lengths), where=lengths > limits)[:, None]
    changes = 2.0 * np.einsum("ni,ni->n", gradients, moves) + np.einsum("ni,nij,nj->n", moves, matrices, moves)
    return moves, -changes
