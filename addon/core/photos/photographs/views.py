"""What a photograph shows of a surface (Textures Revisited, section 4.1), for points instead of vertices.

A point is visible if it lies inside the frame, faces the camera, is not hidden, and is not near a silhouette, where the registration of the
photograph decides which surface a pixel shows.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from ...errors import FileError
from ...files.scratch import Scratch
from ...geometry.lenses import PhotoCamera
from ...geometry.mesh import TriangleMesh
from ...imaging.images import sample_bilinear
from ...imaging.raster import depth_buffer
from ...jobs.chunks import slices

SILHOUETTE_PIXELS = 2  # points this near to something closer to the camera, or to something behind them, are not visible
MIN_COSINE = 0.1  # between normal and view direction
DEPTH_TOLERANCE = 1e-3  # relative
STEP_FACTOR = 3.0  # how much deeper than the tangent plane a neighbor must be to count as something else behind
MAX_TANGENT = 4.0  # limits the field of view of the depth buffer
MIN_TRUST = 0.4  # the trust of two photographs that contradict each other is 0.5
MAX_FRAME_RATIO = 30.0  # pixels of the pinhole image to those of the photograph: a fisheye lens of 180 degrees reaches 7
BORDER_PIXELS = 32  # weights rise over this distance from the frame or a mask


class Seen(NamedTuple):
    """The points that a photograph shows, in float32.

    Attributes:
        indices: (M,) those of N points.
        positions: (M, 2) in pixels from the lower left corner.
        resolution: (M,) pixels per unit of area.
        cosines: (M,) between normals and view directions.
        quality: (M,) 0 to 1, lower near the frame and masks and where the photograph may show something else.
    """

    indices: np.ndarray
    positions: np.ndarray
    resolution: np.ndarray
    cosines: np.ndarray
    quality: np.ndarray

    @property
    def weights(self) -> np.ndarray:
        """(M,) how well the photograph shows each point: resolution times cosine times quality."""
        return self.resolution * self.cosines * self.quality


class PinholeTriangles(NamedTuple):
    """K triangles in the pinhole image of a view: their indices (K,) in the mesh; corners (K, 3, 2) in pixels; inverse_depths (K, 3) along
    the optical axis; and the width and height of the image."""

    indices: np.ndarray
    corners: np.ndarray
    inverse_depths: np.ndarray
    size: tuple[int, int]


class View:
    """A photograph's depth buffer and mask.

    The buffer is that of a pinhole image, which straightens what the lens distorts; its row 0 is at the top of the photograph.
    """

    def __init__(self, camera: PhotoCamera, mesh: TriangleMesh, mask: np.ndarray | None = None) -> None:
        """Draw the depths of `mesh`; `mask` (H, W) bool is true at usable pixels."""
        self.camera = camera
        self._focal = float(np.mean(camera.lens.focal))
        self._low, self._size = find_frame(camera)
        self._rotation, self._translation = camera.rotation.T.astype(np.float32), camera.translation.astype(np.float32)
        window = 2 * SILHOUETTE_PIXELS - 1  # whose nearest and farthest depths are interpolated over another pixel
        projected = self.project_pinhole(mesh)
        buffer = depth_buffer(projected.corners, -projected.inverse_depths, self._size)
        inverse = np.where(np.isfinite(buffer), -buffer, 0.0).astype(np.float32)  # 0 where there is nothing
        self._nearest, self._farthest = (find(inverse, window, mode="nearest").ravel() for find in (maximum_filter, minimum_filter))
        self._quality = np.zeros(self._size[0] * self._size[1], np.float32)
        border = None if mask is None else distance_transform_edt(mask).astype(np.float32)
        for cells, positions in self._cells():
            self._quality[cells] = _border_quality(positions, camera.lens.size, border)

    def keep_in(self, scratch: Scratch, group: int) -> None:
        """Let `scratch` keep the images."""
        self._nearest, self._farthest, self._quality = (
            scratch.keep(each, group) for each in (self._nearest, self._farthest, self._quality)
        )

    def apply_trust(self, cells: np.ndarray) -> None:
        """Lower the quality by how far (h, w), 0 to 1, each of the cells that divide the photograph evenly shows the surface."""
        rows, columns = cells.shape
        for part, positions in self._cells():
            found = sample_bilinear(cells[..., None], positions / np.array(self.camera.lens.size) * (columns, rows))[:, 0]
            self._quality[part] *= np.where(found > MIN_TRUST, found, 0.0)

    def exclude(self, pixels: np.ndarray) -> None:
        """Do not use `pixels` (H, W) bool of the photograph and what is near them. In contrast to a mask, weights do not rise with the
        distance from them."""
        distances = distance_transform_edt(~pixels)
        for part, positions in self._cells():
            columns, rows = np.clip(positions, 0, np.array(self.camera.lens.size) - 1).astype(np.int64).T
            self._quality[part] *= distances[rows, columns] > SILHOUETTE_PIXELS

    def see(self, points: np.ndarray, normals: np.ndarray) -> Seen:
        """Return how the photograph shows `points` (N, 3) with unit `normals` (N, 3)."""
        local, directions = points.astype(np.float32) @ self._rotation + self._translation, normals.astype(np.float32) @ self._rotation
        planes = -np.einsum("ni,ni->n", local, directions)  # distances of the camera from the tangent planes
        distances = np.sqrt(np.einsum("ni,ni->n", local, local))
        indices = np.flatnonzero((planes > MIN_COSINE * distances) & (local[:, 2] > 0.0))
        local, planes, directions = local[indices], planes[indices], directions[indices]
        inverse = 1.0 / local[:, 2]
        across, up = ((local[:, axis] * inverse - np.float32(self._low[axis])) * np.float32(self._focal) for axis in (0, 1))
        columns, rows = np.floor(across).astype(np.int64), np.floor(up).astype(np.int64)
        kept = np.flatnonzero((columns >= 0) & (columns < self._size[0]) & (rows >= 0) & (rows < self._size[1]))
        cells, inverse = (rows * self._size[0] + columns)[kept], inverse[kept]
        quality = self._quality[cells]
        steepness = np.hypot(directions[kept, 0], directions[kept, 1]) / planes[kept]
        change = steepness * np.float32((SILHOUETTE_PIXELS + 1.0) * np.sqrt(2.0) / self._focal)  # that a window may show
        tolerance = inverse * DEPTH_TOLERANCE + change
        nearest, farthest = self._find_range(across[kept], up[kept])
        shown = (quality > 0.0) & (nearest <= inverse + tolerance) & (farthest >= inverse - STEP_FACTOR * tolerance)
        kept, quality, inverse = kept[shown], quality[shown], inverse[shown]
        positions, is_valid = self.camera.lens.project(local[kept])
        if not is_valid.all():
            kept, quality, inverse, positions = (values[is_valid] for values in (kept, quality, inverse, positions))
        cosines = planes[kept] / distances[indices[kept]]
        resolution = np.float32(self._focal**2) * cosines * np.square(inverse)
        return Seen(indices[kept], positions.astype(np.float32), resolution, cosines, quality)

    def locate(self, points: np.ndarray) -> np.ndarray:
        """Return the positions (N, 2) float32 in pixels of `points` (N, 3), whether visible or not."""
        return self.camera.lens.project(points.astype(np.float32) @ self._rotation + self._translation)[0].astype(np.float32)

    def project_pinhole(self, mesh: TriangleMesh) -> PinholeTriangles:
        """Return the triangles of `mesh` in front of the camera, projected to the pinhole image."""
        points = mesh.vertices @ self.camera.rotation.T + self.camera.translation
        in_front = points[:, 2] > 1e-6 * max(float(np.abs(points[:, 2]).max(initial=0.0)), 1e-12)
        inverse = np.where(in_front, 1.0 / np.where(in_front, points[:, 2], 1.0), 0.0)  # linear in the image
        pixels = (points[:, :2] * inverse[:, None] - self._low) * self._focal
        indices = np.flatnonzero(in_front[mesh.triangles].all(axis=1))
        kept = mesh.triangles[indices]
        return PinholeTriangles(indices, pixels[kept], inverse[kept], self._size)

    def locate_in_pinhole(self, positions: np.ndarray) -> np.ndarray:
        """Return the positions (N, 2) in the pinhole image of `positions` (N, 2) in the photograph, in pixels from the lower left corner;
        negative for those that it does not contain."""
        directions = self.camera.lens.unproject(positions)
        with np.errstate(divide="ignore", invalid="ignore"):
            located = (directions[:, :2] / directions[:, 2:] - self._low) * self._focal
        is_inside = (directions[:, 2] > 0.0) & (located >= 0.0).all(axis=1) & (located < np.array(self._size)).all(axis=1)
        return np.where(is_inside[:, None], located, -1.0)

    def uses(self, located: np.ndarray) -> np.ndarray:
        """Return which positions (N, 2) in the pinhole image lie in it, in a part of the photograph that shows the surface."""
        columns, rows = np.floor(np.maximum(located, 0.0)).astype(np.int64).T
        return (located[:, 0] >= 0.0) & (self._quality[rows * self._size[0] + columns] > 0.0)

    def _find_range(self, across: np.ndarray, up: np.ndarray) -> list[np.ndarray]:
        """Return the nearest and the farthest inverse depths (N,) around positions in the depth buffer (N,), (N,), interpolated between its
        pixels: points of a surface at a grazing angle would otherwise be visible in some pixels and hidden in the next ones."""
        width, height = self._size
        x, y = (np.clip(each - np.float32(0.5), 0, side - 1) for each, side in ((across, width), (up, height)))
        left, low = np.minimum(x.astype(np.int64), width - 2), np.minimum(y.astype(np.int64), height - 2)
        x, y, corner = x - left.astype(np.float32), y - low.astype(np.float32), low * width + left
        result = []
        for values in (self._nearest, self._farthest):
            lower, upper = np.take(values, corner), np.take(values, corner + width)
            lower += x * (np.take(values, corner + 1) - lower)
            upper += x * (np.take(values, corner + width + 1) - upper)
            result.append(lower + y * (upper - lower))
        return result

    def _cells(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield pixels of the depth buffer and the positions (N, 2) in the photograph of their centers, negative outside of the lens."""
        width, height = self._size
        for part in slices(height, 256):
            rows, columns = np.mgrid[part.start : min(part.stop, height), :width]
            tangents = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) / self._focal + self._low
            rays = np.column_stack([tangents, np.ones(len(tangents))]).astype(np.float32)
            positions, is_valid = self.camera.lens.project(rays)
            yield slice(part.start * width, part.start * width + len(rays)), np.where(is_valid[:, None], positions, -1.0)


def _border_quality(positions: np.ndarray, size: tuple[int, int], border: np.ndarray | None) -> np.ndarray:
    """Return the quality (N,) of `positions` (N, 2), which rises with the distance from the frame and from masked pixels, whose distances
    are `border` (H, W)."""
    distances = np.minimum(positions, np.array(size) - positions).min(axis=1)
    if border is not None:
        columns, rows = np.clip(positions, 0, np.array(size) - 1).astype(np.int64).T
        distances = np.minimum(distances, border[rows, columns])
    return np.where(distances > SILHOUETTE_PIXELS, np.square(np.minimum(distances / BORDER_PIXELS, 1.0)), 0.0)


def find_frame(camera: PhotoCamera) -> tuple[np.ndarray, tuple[int, int]]:
    """Return the smallest tangents (2,) of what the photograph shows, and the size in pixels of a pinhole image of it. Raises FileError if
    it would be much larger than the photograph, which no lens causes."""
    width, height = camera.lens.size
    x, y = np.linspace(0.0, width, 65), np.linspace(0.0, height, 65)
    outline = np.concatenate([np.stack(np.broadcast_arrays(a, b), axis=1) for a, b in ((x, 0.0), (x, height), (0.0, y), (width, y))])
    directions = camera.lens.unproject(outline)
    tangents = np.clip(directions[:, :2] / np.maximum(directions[:, 2:], 1.0 / MAX_TANGENT**2), -MAX_TANGENT, MAX_TANGENT)
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    size = np.ceil((high - low) * float(np.mean(camera.lens.focal))) + 1.0
    if not size.prod() <= MAX_FRAME_RATIO * (width + 1) * (height + 1):
        raise FileError(f'The lens of the photograph "{camera.name}" has numbers that no lens has; export the cameras again.')
    return low, (max(int(size[0]), 2), max(int(size[1]), 2))
