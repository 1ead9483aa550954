"""Quadrics of texture deviation, one per wedge: with those of shading normals, the cost of collapses for levels that are refitted.

A triangle of the fine mesh, extended to all of UV space, is an affine map S_t from texture coordinates to space. A vertex at x with
texture coordinates u deviates from it by x - S_t(u), between equal texture coordinates. The cost of a vertex is the integral of the
squared deviation over the triangles that it stands for: a quadric of (x, u), summed like those of Garland and Heckbert, "Surface
Simplification Using Quadric Error Metrics", 1997. In contrast to the distance from planes in 5-D it does not get smaller where a vertex
slides along the surface and its texture coordinates do not.

Quadrics of the lines through short edges hardly resist when a long edge swings around one of its ends, and a corner of a window or the rim
of a wheel arch is cut off. So each removed vertex of a border is compared with the edge that takes its place.
"""

import numpy as np

from ...arrays import TINY
from ...geometry.edges import halfedge_ends
from ...geometry.mesh import face_areas_and_normals, longest_side
from ...geometry.transforms import signed_areas
from ..simplification.engine import Copies, WedgeMoves
from ..simplification.topology import Collapses
from ..simplification.wedge_quadrics import COLUMNS, ROWS, WedgeQuadrics
from ..textured_mesh import TexturedMesh
from .border_curves import find_border_halfedges
from .correspondence import compute_uv_scale
from .normal_quadrics import NormalQuadrics

CURVE_WEIGHT = 1.0  # Weight of squared distances from an edge of a border in UV space, times its squared length.
DEVIATION_WEIGHT = 0.5  # Weight of squared deviations of edges on borders in space, times their squared length.
SHADING_LENGTH = 0.01  # A shading normal that is wrong by a radian costs like this distance, relative to the longest side of the mesh.
MIN_UV_LENGTH = 1e-9  # Of an edge in UV space, relative to the one in space; shorter ones give no direction.
LENGTH_WEIGHT = 1e-6  # Weight of the squared length of a collapse, which decides where the map is affine.


class DeviationQuadrics(WedgeQuadrics):
    """A `CollapseCost`: squared texture deviations, integrated over the triangles that wedges stand for. Deviations along the normal count
    `normal_weight` times. With `moves_vertices`, kept vertices move to where they cost least."""

    def __init__(
        self, mesh: TexturedMesh, normal_weight: float, source_normals: np.ndarray | None = None, moves_vertices: bool = True
    ) -> None:
        """source_normals: (S, 3) for shading, zero on flat faces, at the corners that the mesh was built from; None if all is flat."""
        uv_scale = compute_uv_scale(mesh)
        points = np.column_stack([mesh.vertices[mesh.wedge_vertices], uv_scale * mesh.uvs])
        center = points.mean(axis=0)
        areas, normals = face_areas_and_normals(mesh.vertices[mesh.triangles])
        weights = _weigh_triangles(areas)
        super().__init__(mesh, points - center, normal_weight * weights, moves_vertices)
        self._areas = np.bincount(mesh.wedge_triangles.ravel(), np.repeat(weights, 3) / 3.0, len(points))
        rows = _deviation_rows(self._points[mesh.wedge_triangles], normals, normal_weight)
        terms = np.einsum("tik,til->tkl", rows, rows)[:, ROWS, COLUMNS] * (weights / 3.0)[:, None]
        for corner in range(3):
            np.add.at(self._quadrics, mesh.wedge_triangles[:, corner], terms)
        self._add_borders(mesh, normals)
        self._borders, self._shading = BorderDeviations(mesh, self._points), None
        if source_normals is not None:
            weights = weights * (SHADING_LENGTH * longest_side(mesh.vertices)) ** 2
            self._shading = NormalQuadrics(self._positions, mesh.triangles, source_normals[mesh.sources], weights)
        self.finish()

    def evaluate(self, collapses: Collapses, moves: WedgeMoves) -> np.ndarray:
        """See `CollapseCost`."""
        (removed, _), (kept, _) = collapses.removed_wedges, collapses.kept_wedges
        costs = self.evaluate_wedges(collapses, moves)
        costs += DEVIATION_WEIGHT * self._borders.evaluate(removed, kept)
        if self._shading is not None:
            costs += self._shading.evaluate(collapses.removed, collapses.kept, self._positions[collapses.kept])
        lengths = ((self._points[removed, :3] - self._points[kept, :3]) ** 2).sum(axis=1)
        return costs + LENGTH_WEIGHT * self._areas[removed] * lengths

    def merge(self, collapses: Collapses, moves: WedgeMoves) -> None:
        """See `CollapseCost`."""
        super().merge(collapses, moves)
        if self._shading is not None:
            self._shading.merge(collapses.removed, collapses.kept)

    def merge_wedges(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """See `WedgeQuadrics`."""
        self._borders.merge(removed, kept)
        super().merge_wedges(removed, kept)

    def append(self, copies: Copies) -> None:
        """See `RemovalOrder`."""
        super().append(copies)
        if self._shading is not None:
            self._shading.append(copies.vertices)
        self._borders.append(len(copies.wedges), self._points)

    def _add_borders(self, mesh: TexturedMesh, normals: np.ndarray) -> None:
        """Add the squared distances from the edges of islands in UV space, which cover all between the edge and a vertex next to it;
        where edges have no length there, those from the planes through them that are perpendicular to the triangles. normals: (T, 3)."""
        halfedges, _ = find_border_halfedges(mesh)
        faces, corners = halfedges // 3, halfedges % 3
        start, end = (mesh.wedge_triangles[faces, (corners + step) % 3] for step in (1, 2))
        edges = self._points[end] - self._points[start]
        lengths, uv_lengths = np.linalg.norm(edges[:, :3], axis=1), np.linalg.norm(edges[:, 3:], axis=1)
        has_length = uv_lengths > MIN_UV_LENGTH * lengths
        scales = np.divide(lengths, uv_lengths, out=np.zeros_like(lengths), where=has_length)
        rows = np.zeros((len(start), 6))
        rows[:, 3:5] = np.column_stack([-edges[:, 4], edges[:, 3]]) * scales[:, None] ** 2
        rows[~has_length, :3] = np.cross(edges[:, :3], normals[faces])[~has_length]
        rows[:, 5] = -np.einsum("nk,nk->n", rows[:, :5], self._points[start])
        terms = rows[:, ROWS] * rows[:, COLUMNS] * (0.5 * CURVE_WEIGHT)
        np.add.at(self._quadrics, start, terms)
        np.add.at(self._quadrics, end, terms)


def _weigh_triangles(areas: np.ndarray) -> np.ndarray:
    """Return weights (T,) of triangles with `areas` (T,) in proportion to their square roots, with the same sum.

    Small triangles count more than by area: they are where the shape has detail, and where limbs end, which would get shorter otherwise,
    since the planes along a limb do not resist.
    """
    roots = np.sqrt(areas)
    return roots * (areas.sum() / max(roots.sum(), TINY))


def _deviation_rows(corners: np.ndarray, normals: np.ndarray, normal_weight: float) -> np.ndarray:
    """Return matrices (T, 3, 6) that map homogeneous (x, u) to x - S_t(u), with its component along the normal scaled.

    corners: (T, 3, 5). Triangles without area in UV space give the deviation from their plane alone.
    """
    origin = corners[:, 0]
    edges = np.stack([corners[:, 1, 3:] - origin[:, 3:], corners[:, 2, 3:] - origin[:, 3:]], axis=2)
    sides = np.stack([corners[:, 1, :3] - origin[:, :3], corners[:, 2, :3] - origin[:, :3]], axis=2)
    determinants = 2.0 * signed_areas(corners[:, :, 3:])
    squares = (edges**2).sum(axis=(1, 2))
    is_flat = np.abs(determinants) <= 1e-9 * squares
    edges[is_flat] = np.eye(2)
    inverses = np.stack([edges[:, 1, 1], -edges[:, 0, 1], -edges[:, 1, 0], edges[:, 0, 0]], axis=1).reshape(-1, 2, 2)
    jacobians = sides @ (inverses / np.where(is_flat, 1.0, determinants)[:, None, None])
    rows = np.zeros((len(corners), 3, 6))
    rows[:, :, :3] = np.eye(3)
    rows[:, :, 3:5] = -jacobians
    rows[:, :, 5] = -origin[:, :3] + np.einsum("tij,tj->ti", jacobians, origin[:, 3:])
    project = normals[:, :, None] * normals[:, None, :]
    metric = np.eye(3) + (np.sqrt(normal_weight) - 1.0) * project
    metric[is_flat] = np.sqrt(normal_weight) * project[is_flat]
    return metric @ rows


class BorderDeviations:
    """For each wedge on a border its neighbors there, and the largest distance of removed vertices from the edges at it.

    Wedges are those of the fine mesh. Wedges where borders cross or end have no neighbors.
    """

    def __init__(self, mesh: TexturedMesh, points: np.ndarray) -> None:
        """points: (W, 3 or more), whose first columns are the positions of the wedges, which may change."""
        halfedges, _ = find_border_halfedges(mesh)
        starts, ends = halfedge_ends(mesh.wedge_triangles, halfedges).T
        count = len(mesh.uvs)
        self._points = points[:, :3]
        self._following, self._preceding = np.full(count, -1), np.full(count, -1)
        self._following[starts], self._preceding[ends] = ends, starts
        is_crossing = (np.bincount(starts, minlength=count) > 1) | (np.bincount(ends, minlength=count) > 1)
        self._following[is_crossing] = self._preceding[is_crossing] = -1
        self._errors = np.zeros(count)

    def evaluate(self, removed: np.ndarray, kept: np.ndarray) -> np.ndarray:
        """Return the squared deviation (N,) of the new edge if the wedges `removed` (N,) move onto `kept` (N,), times its squared length;
        0 where that is not along a border."""
        costs = np.zeros(len(removed))
        rows, others = self._find_others(removed, kept)
        squares = ((self._points[others] - self._points[kept[rows]]) ** 2).sum(axis=1)
        costs[rows] = squares * self._deviate(removed[rows], kept[rows], others) ** 2
        return costs

    def merge(self, removed: np.ndarray, kept: np.ndarray) -> None:
        """Take note that the wedges `removed` (N,) have moved onto `kept` (N,)."""
        rows, others = self._find_others(removed, kept)
        removed, kept = removed[rows], kept[rows]
        errors = self._deviate(removed, kept, others)
        np.maximum.at(self._errors, kept, errors)
        np.maximum.at(self._errors, others, errors)
        is_forward = self._following[removed] == kept
        first, second = np.where(is_forward, others, kept), np.where(is_forward, kept, others)
        self._following[first], self._preceding[second] = second, first

    def append(self, count: int, points: np.ndarray) -> None:
        """Append `count` wedges that are on no border. points: of all wedges, see `BorderDeviations`."""
        self._points = points[:, :3]
        self._following, self._preceding = (np.append(values, np.full(count, -1)) for values in (self._following, self._preceding))
        self._errors = np.append(self._errors, np.zeros(count))

    def _find_others(self, removed: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the rows (R,) of moves along a border, and the neighbors (R,) of the removed wedges on the other side."""
        is_forward, is_backward = self._following[removed] == kept, self._preceding[removed] == kept
        others = np.where(is_forward, self._preceding[removed], self._following[removed])
        rows = np.flatnonzero((is_forward != is_backward) & (others >= 0))
        return rows, others[rows]

    def _deviate(self, removed: np.ndarray, kept: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Return an upper bound of the distance (N,) between the edges from `others` to `kept`, and what they replace."""
        start, end, point = self._points[others], self._points[kept], self._points[removed]
        along = end - start
        fraction = np.einsum("ni,ni->n", point - start, along) / np.maximum(np.einsum("ni,ni->n", along, along), np.finfo(float).tiny)
        nearest = start + np.clip(fraction, 0.0, 1.0)[:, None] * along
        return np.linalg.norm(point - nearest, axis=1) + self._errors[removed]
