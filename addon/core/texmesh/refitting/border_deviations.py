"""How far the borders of islands of a level are from those of the fine mesh, while their vertices are removed one after the other.

Quadrics of the lines through short edges hardly resist when a long edge swings around one of its ends, and a corner of a window or the rim
of a wheel arch is cut off. Here each removed vertex is compared with the edge that takes its place.
"""

import numpy as np

from ...geometry.edges import halfedge_ends
from ..textured_mesh import TexturedMesh
from .border_curves import find_border_halfedges


class BorderDeviations:
    """For each wedge on a border its neighbors there, and the largest distance of removed vertices from the edges beside it.

    Wedges are those of the fine mesh. Wedges where borders cross or end have no neighbors.
    """

    def __init__(self, mesh: TexturedMesh) -> None:
        halfedges, _ = find_border_halfedges(mesh)
        starts, ends = halfedge_ends(mesh.wedge_triangles, halfedges).T
        count = len(mesh.uvs)
        self._points = mesh.vertices[mesh.wedge_vertices]
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
