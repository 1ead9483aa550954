"""Quadrics of position and texture coordinates, one per wedge, that are evaluated where the wedge moves."""

import numpy as np

from ...geometry.mesh import face_areas_and_normals, longest_side
from ...jobs.chunks import slices
from ..textured_mesh import TexturedMesh
from .engine import Copies, WedgeMoves
from .topology import Collapses, find_islands

ROWS, COLUMNS = np.triu_indices(6)
PLANE_ROWS, PLANE_COLUMNS = np.triu_indices(4)
CHUNK_COLLAPSES = 1 << 13
LOST_DISTANCE = 0.05  # The texture of an island that vanishes counts as so far away, relative to the longest side of the mesh.


class WedgeQuadrics:
    """The part that costs of collapses have in common. A subclass adds quadrics (W, 21) and areas (W,) of wedges, then calls `finish`."""

    def __init__(self, mesh: TexturedMesh, points: np.ndarray, positions: np.ndarray, plane_weights: np.ndarray) -> None:
        """points: (W, 5), positions and texture coordinates of wedges, scaled alike. positions: (V, 3), of the vertices of `mesh`.
        plane_weights: (T,), of squared distances from the planes of triangles."""
        areas = face_areas_and_normals(positions[mesh.triangles])[0]
        self._island_costs = np.bincount(find_islands(mesh), areas) * (LOST_DISTANCE * longest_side(positions)) ** 2
        self._points, self._positions = points.copy(), positions
        self._monomials = _list_monomials(points)
        self._quadrics = np.zeros((len(points), len(ROWS)))
        self._areas = np.zeros(len(points))
        self._planes = _plane_quadrics(mesh, positions, plane_weights)
        self._vertex_planes, self._has_vertex_planes = np.zeros((len(positions), len(PLANE_ROWS))), False  # see `drop_wedges`

    def finish(self) -> None:
        """Compute the costs of wedges that stay where they are."""
        self._own_costs = np.einsum("wk,wk->w", self._quadrics, self._monomials)

    def merge(self, collapses: Collapses, moves: WedgeMoves) -> None:
        """See `CollapseCost`."""
        np.add.at(self._vertex_planes, collapses.kept, self._vertex_planes[collapses.removed])
        is_moved = moves.removed == moves.kept
        self.merge_wedges(moves.removed[~is_moved], moves.kept[~is_moved])
        moved = moves.removed[is_moved]
        self._points[moved, :3] = self._positions[collapses.kept[moves.owners[is_moved]]]
        self._monomials[moved] = _list_monomials(self._points[moved])
        self._own_costs[moved] = np.einsum("wk,wk->w", self._quadrics[moved], self._monomials[moved])

    def drop_wedges(self, wedges: np.ndarray, vertices: np.ndarray) -> None:
        """See `CollapseCost`. The planes that the wedges stand for stay with the vertices."""
        np.add.at(self._vertex_planes, vertices, self._planes[wedges])
        self._has_vertex_planes |= len(wedges) > 0

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`. Copies of wedges stand for the same triangles."""
        vertices, wedges = copies.vertices, copies.wedges
        self._positions, self._vertex_planes = (
            np.concatenate([values, values[vertices]]) for values in (self._positions, self._vertex_planes)
        )
        points = np.column_stack([self._positions[copies.homes], self._points[wedges, 3:]])
        self._points = np.concatenate([self._points, points])
        self._monomials = np.concatenate([self._monomials, _list_monomials(points)])
        columns = (self._quadrics, self._planes, self._areas, self._own_costs)
        factor = 0.0 if copies.is_blank else 1.0
        self._quadrics, self._planes, self._areas, self._own_costs = (
            np.concatenate([values, factor * values[wedges]]) for values in columns
        )

    def merge_wedges(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """Add the quadrics of wedges (N,) to those that take their place."""
        np.add.at(self._quadrics, kept, self._quadrics[removed])
        np.add.at(self._planes, kept, self._planes[removed])
        np.add.at(self._areas, kept, self._areas[removed])
        self._own_costs[kept] = np.einsum("wk,wk->w", self._quadrics[kept], self._monomials[kept])

    def evaluate_wedges(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """Return the costs (N,) of moving the wedges of `collapses`, with those of the wedges that they move onto, not negative."""
        costs = np.bincount(moves.owners, self._evaluate(moves.removed, moves.kept), len(collapses.removed)).astype(np.float64)
        moved = np.flatnonzero(moves.removed == moves.kept)
        if len(moved):
            wedges, owners = moves.removed[moved], moves.owners[moved]
            points = self._points[wedges]
            points[:, :3] = self._positions[collapses.kept[owners]]
            rest = np.einsum("wk,wk->w", self._quadrics[wedges], _list_monomials(points)) - self._own_costs[wedges]
            costs += np.bincount(owners, rest, len(costs))
        first, second = collapses.kept_wedges
        costs += self._own_costs[first] + np.where((second >= 0) & (second != first), self._own_costs[second], 0.0)
        for islands in moves.lost_islands:
            costs += np.where(islands >= 0, self._island_costs[islands], 0.0)
        if self._has_vertex_planes:
            planes = self._vertex_planes[collapses.removed] + self._vertex_planes[collapses.kept]
            costs += np.einsum("nk,nk->n", planes, _list_products(self._positions[collapses.kept], PLANE_ROWS, PLANE_COLUMNS))
        return np.maximum(costs, 0.0)

    def _evaluate(self, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
        costs = np.empty(len(removed))
        for chunk in slices(len(removed), CHUNK_COLLAPSES):  # in parts that stay in the cache
            quadrics, monomials = self._quadrics.take(removed[chunk], axis=0), self._monomials.take(kept[chunk], axis=0)
            np.einsum("wk,wk->w", quadrics, monomials, out=costs[chunk])
        return costs


def _list_monomials(points: np.ndarray) -> np.ndarray:
    """Return the products (W, 21) by which quadrics are evaluated at `points` (W, 5)."""
    return _list_products(points, ROWS, COLUMNS)


def _list_products(points: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return products of homogeneous coordinates of `points` (N, D), for each pair of `rows` and `columns` (K,): (N, K)."""
    homogeneous = np.column_stack([points, np.ones(len(points))])
    return homogeneous[:, rows] * homogeneous[:, columns] * np.where(rows == columns, 1.0, 2.0)


def _plane_quadrics(mesh: TexturedMesh, positions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return quadrics (W, 10) of squared distances of positions from the planes of the triangles at wedges, with `weights` (T,)."""
    _, normals = face_areas_and_normals(positions[mesh.triangles])
    planes = np.column_stack([normals, -np.einsum("ti,ti->t", normals, positions[mesh.triangles[:, 0]])])
    terms = planes[:, PLANE_ROWS] * planes[:, PLANE_COLUMNS] * (weights / 3.0)[:, None]
    quadrics = np.zeros((len(mesh.uvs), len(PLANE_ROWS)))
    for corner in range(3):
        np.add.at(quadrics, mesh.wedge_triangles[:, corner], terms)
    return quadrics
