"""Which triangles a photograph shows completely or not at all.

Most triangles are small, and their vertices and centers decide for all of their texels; only the texels of the others are looked up in the
depth buffer one by one.
"""

from typing import NamedTuple

import numpy as np

from ...files.scratch import Scratch
from ...geometry.mesh import face_areas_and_normals
from ...jobs.progress import Progress, Steps
from ..photographs.surface import Surface
from ..photographs.views import MIN_COSINE, Seen, View
from .texel_map import TexelTile

HIDDEN, VISIBLE, MIXED = 0, 1, 2
MAX_PIXELS = 12.0  # longest edge of triangles that are decided as one


class SeenTexels(NamedTuple):
    """The texels of a tile that a photograph shows: indices (M,), positions (M, 2) in pixels, resolution (M,) in pixels per unit of area,
    and weights (M,), all float32."""

    indices: np.ndarray
    positions: np.ndarray
    resolution: np.ndarray
    weights: np.ndarray


class ShownSurface:
    """A surface for visibility, in float32.

    Attributes:
        vertices, vertex_normals: (V, 3).
        corners, corner_normals: (T, 3, 3), ordered by corner.
        corner_vertices: (3, T) indices of vertices.
    """

    def __init__(self, surface: Surface) -> None:
        mesh = surface.mesh
        self.vertices, self.vertex_normals = mesh.vertices.astype(np.float32), surface.normals.astype(np.float32)
        self.corners, self.corner_normals = order_by_corner(mesh.corners), order_by_corner(surface.corner_normals)
        self.corner_vertices = np.ascontiguousarray(mesh.triangles.T)


def order_by_corner(values: np.ndarray) -> np.ndarray:
    """Return `values` (T, 3, C) as float32, with those of all first corners next to each other, then those of all second ones."""
    return np.ascontiguousarray(values.transpose(1, 0, 2), np.float32).transpose(1, 0, 2)


class FaceVisibility:
    """What a photograph shows of the triangles of a surface.

    status: (T,) uint8, one of HIDDEN, VISIBLE and MIXED.
    """

    def __init__(self, view: View, surface: ShownSurface, *, is_cosine: bool) -> None:
        """Look at all triangles; `is_cosine`: whether weights are the cosine between normal and view direction alone, and triangles are
        shown if all of their vertices are, as in the paper."""
        self._view, self._surface, self._is_cosine = view, surface, is_cosine
        centers = surface.corners.mean(axis=1)
        _, face_normals = face_areas_and_normals(surface.corners)
        at_vertices, at_centers = view.see(surface.vertices, surface.vertex_normals), view.see(centers, face_normals)
        self._weights = np.zeros(len(surface.vertices), np.float32)
        self._weights[at_vertices.indices] = self._weigh(at_vertices)
        self._resolution = np.zeros(len(centers), np.float32)
        self._resolution[at_centers.indices] = at_centers.resolution
        corners_shown = (self._weights > 0.0)[surface.corner_vertices]
        if is_cosine:
            self.status = np.where(corners_shown.all(axis=0), VISIBLE, HIDDEN).astype(np.uint8)
            return
        is_small = self._is_small(centers)
        self.status = np.full(len(centers), MIXED, np.uint8)
        self.status[is_small & corners_shown.all(axis=0) & (self._resolution > 0.0)] = VISIBLE
        self.status[(is_small & ~corners_shown.any(axis=0) & (self._resolution == 0.0)) | self._faces_away(centers, face_normals)] = HIDDEN

    def keep_in(self, scratch: Scratch, group: int) -> None:
        """Let `scratch` keep what was found."""
        self._weights, self._resolution, self.status = (
            scratch.keep(each, group) for each in (self._weights, self._resolution, self.status)
        )

    def see(self, tile: TexelTile, points: np.ndarray, rows: np.ndarray) -> SeenTexels:
        """Return how the photograph shows the texels `rows` (R,) of a tile at `points` (N, 3)."""
        status = np.take(self.status, tile.triangles[rows])
        visible, mixed = rows[status == VISIBLE], rows[status == MIXED]
        triangles, barycentric = tile.triangles[visible], tile.barycentric[visible]
        weights = np.zeros(len(visible), np.float32)
        for corner, vertices in enumerate(self._surface.corner_vertices):
            weights += barycentric[:, corner] * np.take(self._weights, np.take(vertices, triangles))
        positions, resolution = self._view.locate(points[visible]), np.take(self._resolution, triangles)
        if not len(mixed):
            return SeenTexels(visible, positions, resolution, weights)
        part = tile.select(mixed)
        normals = part.interpolate(self._surface.corner_normals)
        normals /= np.maximum(np.sqrt(np.einsum("nc,nc->n", normals, normals)), 1e-12)[:, None]
        seen = self._view.see(points[mixed], normals)
        return SeenTexels(
            np.concatenate([visible, mixed[seen.indices]]),
            np.concatenate([positions, seen.positions]),
            np.concatenate([resolution, seen.resolution]),
            np.concatenate([weights, self._weigh(seen)]),
        )

    def _weigh(self, seen: Seen) -> np.ndarray:
        return seen.cosines if self._is_cosine else seen.weights

    def _is_small(self, centers: np.ndarray) -> np.ndarray:
        """Return which triangles (T,) have edges of at most MAX_PIXELS in the photograph."""
        corners, camera = self._surface.corners, self._view.camera
        squares = [np.square(corners[:, a] - corners[:, b]).sum(axis=1) for a, b in ((0, 1), (1, 2), (2, 0))]
        lengths = np.sqrt(np.max(squares, axis=0))
        depths = centers @ camera.rotation[2].astype(np.float32) + np.float32(camera.translation[2]) - lengths
        return lengths * np.float32(max(camera.lens.focal)) < MAX_PIXELS * depths

    def _faces_away(self, centers: np.ndarray, face_normals: np.ndarray) -> np.ndarray:
        """Return which triangles (T,) show their back, even if their normals are interpolated."""
        position = self._view.camera.position.astype(np.float32)
        result = np.einsum("tc,tc->t", position - centers, face_normals) <= 0.0
        for corner in range(3):
            to_camera, normals = position - self._surface.corners[:, corner], self._surface.corner_normals[:, corner]
            distances = np.sqrt(np.einsum("tc,tc->t", to_camera, to_camera))
            result &= np.einsum("tc,tc->t", to_camera, normals) <= MIN_COSINE * distances
        return result


def find_visible_faces(views: list[View], surface: ShownSurface, scratch: Scratch, *, is_cosine: bool) -> Steps[list[FaceVisibility]]:
    """Return what each photograph shows of the triangles of a surface; `scratch` keeps it in the group of its index.

    is_cosine: see `FaceVisibility`.
    """
    found = []
    for index, view in enumerate(views):
        yield Progress(index / len(views), "Finding visible faces")
        found.append(FaceVisibility(view, surface, is_cosine=is_cosine))
        found[-1].keep_in(scratch, index)
        scratch.release(index)
    return found
