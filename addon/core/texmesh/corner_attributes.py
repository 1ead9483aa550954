"""Attributes of the corners of levels, such as normals and colors, fitted to those of the fine mesh by least squares.

A level has few corners, and the normals of the fine mesh at their places may be those of a narrow bevel. So each triangle gets the linear
function that is nearest to the attributes of the fine surface that it stands for. Corners around a vertex whose values are nearly equal
then share their mean, so that smooth surfaces stay smooth and hard edges hard.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ..arrays import TINY, concatenate_ranges
from ..geometry.edges import find_edges
from ..geometry.mesh import face_areas_and_normals
from ..geometry.proximity import counting_argsort
from ..geometry.transforms import normalize
from .corner_normals import fill_flat, sum_faces
from .refitting.correspondence import sample_surface
from .refitting.outliers import FineSurface
from .textured_mesh import TexturedMesh, divide_wedges, group_by_texture

SAMPLES_PER_TRIANGLE, MIN_SAMPLES, MAX_SAMPLES = 8, 8_000, 200_000
STABILITY = 0.02  # Weight of the values at the vertices, relative to that of the samples of a triangle.
MIN_FACING_COSINE = 0.2  # between the faces of a sample and of its corresponding point, which may be on the other side of a thin sheet
MIN_SMOOTH_COSINE = np.cos(np.radians(10.0))  # between normals of corners that become one
MAX_STEP = 0.1  # between other values of corners that become one


@dataclass(frozen=True, eq=False)
class CornerAttributes:
    """The attributes of a fine mesh, for its levels, which have been made without them.

    fine: the mesh with attributes. surface: of the mesh without them, see `merge_wedges`.
    """

    fine: TexturedMesh
    surface: FineSurface

    def add_to(self, level: TexturedMesh) -> TexturedMesh:
        """Return `level` with attributes that fit those of the fine mesh.

        level: its `sources` are rows of corners of the fine mesh with nearly its vertices and texture coordinates.
        """
        if not self.fine.attributes.shape[1] or not len(level.triangles):
            return level
        values, weights = self._fit(level)
        clusters = _cluster(level, values, self.fine.has_normals)
        count = int(clusters.max()) + 1
        total = np.bincount(clusters, weights, count)
        attributes = np.stack(
            [np.bincount(clusters, weights * column, count) / total for column in values.reshape(len(clusters), -1).T], axis=1
        )
        if self.fine.has_normals:
            attributes[:, :3] = normalize(attributes[:, :3])
        wedge_triangles, own, cluster = divide_wedges(level.wedge_triangles, clusters.reshape(-1, 3), count)
        return replace(
            level,
            wedge_triangles=wedge_triangles,
            wedge_vertices=level.wedge_vertices[own],
            uvs=level.uvs[own],
            attributes=attributes[cluster].astype(np.float32),
            has_normals=self.fine.has_normals,
        )

    @property
    def source_normals(self) -> np.ndarray | None:
        """(S, 3) normals at the corners that the fine mesh was built from, zero on flat faces; None if all is flat."""
        return self.fine.attributes[self._source_wedges, :3].astype(np.float64) if self.fine.has_normals else None

    @cached_property
    def _fine_values(self) -> np.ndarray:
        """(T, 3, A) attributes of the corners of the fine mesh."""
        values = self.fine.attributes[self.fine.wedge_triangles].astype(np.float64)
        if self.fine.has_normals:
            fill_flat(values, self._faces)
        return values

    @cached_property
    def _faces(self) -> np.ndarray:
        """(T, 3) unit normals of the triangles of the fine mesh."""
        return face_areas_and_normals(self.surface.corners)[1]

    def _fit(self, level: TexturedMesh) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (T, 3, A) of the corners of a level, and how much each counts, (3 T,)."""
        number = int(np.clip(SAMPLES_PER_TRIANGLE * len(level.triangles), MIN_SAMPLES, MAX_SAMPLES))
        samples = sample_surface(self.surface.mesh, self.surface.islands, number, np.random.default_rng(0), triangle_fraction=0.5)
        state = self.surface.attach(level, samples, normal_weight=1.0)
        areas, faces = state.areas_and_normals
        triangles, barycentric, count = state.found.triangles, state.found.barycentric, len(level.triangles)
        is_used = np.einsum("ni,ni->n", self._faces[samples.triangles], faces[triangles]) > MIN_FACING_COSINE
        weights = np.where(is_used, samples.weights, 0.0)
        stability = STABILITY * (np.bincount(triangles, weights, count) + 1e-3 * areas + TINY) / 3.0
        values = np.einsum("ni,nia->na", samples.barycentric, self._fine_values[samples.triangles])
        products = stability[:, None, None] * np.eye(3)
        sums = stability[:, None, None] * self._find_values_at_vertices(level, faces)
        for row in range(3):
            weighted = weights * barycentric[:, row]
            for column in range(3):
                products[:, row, column] += np.bincount(triangles, weighted * barycentric[:, column], count)
            for column in range(values.shape[1]):
                sums[:, row, column] += np.bincount(triangles, weighted * values[:, column], count)
        fitted = np.linalg.solve(products, sums)
        low, high = values.min(axis=0), values.max(axis=0)
        return np.clip(fitted, low, high), np.einsum("tii->ti", products).ravel()

    def _find_values_at_vertices(self, level: TexturedMesh, faces: np.ndarray) -> np.ndarray:
        """Return the attributes (T, 3, A) of the fine mesh at the vertices of a level with `faces` (T, 3), unit normals. Of several, as at
        hard edges, they are those of the faces that look most in the same direction."""
        groups, starts, members = self._groups
        own = groups[self._source_wedges[level.sources.ravel()]]
        counts = starts[own + 1] - starts[own]
        chosen = members[starts[own]]
        corners = np.flatnonzero(counts > 1)
        if len(corners):
            rows = np.repeat(corners, counts[corners])
            wedges = members[concatenate_ranges(starts[own[corners]], counts[corners])]
            order = np.lexsort((np.einsum("ni,ni->n", self._wedge_faces[wedges], faces[rows // 3]), rows))
            chosen[rows[order]] = wedges[order]  # The last of several assignments stays.
        values = self.fine.attributes[chosen].reshape(len(level.triangles), 3, -1).astype(np.float64)
        if self.fine.has_normals:
            fill_flat(values, faces)
        return values

    @cached_property
    def _groups(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The group (W,) of each wedge, where the wedges of each group begin (G + 1,), and the wedges (W,) by group."""
        groups = group_by_texture(self.fine, has_colors=True)
        count = int(groups.max()) + 1
        return groups, np.concatenate([[0], np.cumsum(np.bincount(groups, minlength=count))]), counting_argsort(groups, count)

    @cached_property
    def _wedge_faces(self) -> np.ndarray:
        """(W, 3) mean normals of the faces of each wedge."""
        return sum_faces(self.fine)

    @cached_property
    def _source_wedges(self) -> np.ndarray:
        """The wedge of each corner that the fine mesh was built from, 0 for corners that it lacks."""
        wedges = np.zeros(int(self.fine.sources.max()) + 1, np.int32)
        wedges[self.fine.sources] = self.fine.wedge_triangles
        return wedges


def _cluster(level: TexturedMesh, values: np.ndarray, has_normals: bool) -> np.ndarray:
    """Return the number (3 T,) of the cluster of each corner: corners of a vertex with nearly equal `values` (T, 3, A) at common edges."""
    first, second = find_edges(level.triangles, len(level.vertices)).interior_halfedges.T
    flat, vertices = values.reshape(-1, values.shape[2]), level.triangles.ravel()
    pairs = []
    for step, other_step in ((1, 1), (1, 2), (2, 1), (2, 2)):
        corners = 3 * (first // 3) + (first + step) % 3, 3 * (second // 3) + (second + other_step) % 3
        is_same = vertices[corners[0]] == vertices[corners[1]]
        pairs.append(np.stack(corners)[:, is_same])
    one, other = np.concatenate(pairs, axis=1)
    is_near = np.ones(len(one), bool)
    start = 3 if has_normals else 0
    if has_normals:
        normals = normalize(flat[:, :3])
        is_near &= np.einsum("ni,ni->n", normals[one], normals[other]) >= MIN_SMOOTH_COSINE
    is_near &= (np.abs(flat[one, start:] - flat[other, start:]) <= MAX_STEP).all(axis=1)
    one, other = one[is_near], other[is_near]
    return connected_components(coo_array((np.ones(len(one), bool), (one, other)), shape=(len(flat),) * 2), directed=False)[1]
