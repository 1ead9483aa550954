"""What a photograph sees of a surface (Textures Revisited, section 4.1), for points instead of vertices.

A point is visible if it lies inside the frame, faces the camera, is not hidden, and is not near a silhouette, where the registration of the
photograph decides which surface a pixel shows.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from ..geometry.lenses import PhotoCamera
from ..geometry.mesh import TriangleMesh
from ..imaging.images import sample_bilinear
from ..imaging.raster import draw_ids

SILHOUETTE_PIXELS = 2  # points this near to something closer to the camera, or to something behind them, are not visible
MIN_COSINE = 0.1  # of the angle between normal and view direction
DEPTH_TOLERANCE = 1e-3  # relative
STEP_FACTOR = 3.0  # how much deeper than the tangent plane a neighbor must be to count as something else behind
MAX_TANGENT = 4.0  # of the field of view of the depth buffer
MIN_TRUST = 0.4  # the trust of two photographs that contradict each other is 0.5
BORDER_PIXELS = 32  # weights rise over this distance from the frame or a mask


@dataclass(frozen=True)
class Seen:
    """How a photograph sees points: positions (N, 2) in pixels; visible: (N,) bool; resolution: (N,) float32, pixels per unit of area;
    weights: (N,) float32, resolution times cosine, lower near the frame and masks, 0 where not visible."""

    positions: np.ndarray
    visible: np.ndarray
    resolution: np.ndarray
    weights: np.ndarray


class View:
    """A photograph's depth buffer and mask.

    trust: (h, w) float32, how far each of the cells that divide the photograph shows the surface, 0 to 1; see `consistency`.
    """

    def __init__(self, camera: PhotoCamera, mesh: TriangleMesh, mask: np.ndarray | None = None) -> None:
        """Draw the depths of `mesh`; `mask` (H, W) bool is true at usable pixels."""
        self.camera = camera
        self._focal = float(np.mean(camera.lens.focal))
        self._low, self._size = _frame(camera)
        inverse = self._draw(mesh)
        self._nearest, self._farthest = (
            filter_window(inverse, 2 * SILHOUETTE_PIXELS + 1, mode="nearest") for filter_window in (maximum_filter, minimum_filter)
        )
        width, height = camera.lens.size
        usable = np.zeros((height + 2, width + 2), bool)
        usable[1:-1, 1:-1] = True if mask is None else mask
        self.trust = np.ones((1, 1), np.float32)
        self._border = np.minimum(distance_transform_edt(usable)[1:-1, 1:-1], BORDER_PIXELS).astype(np.float32)

    def see(self, points: np.ndarray, normals: np.ndarray) -> Seen:
        """Return how the photograph sees `points` (N, 3) with unit `normals` (N, 3)."""
        positions, depths, is_valid = self.camera.project(points)
        to_camera = self.camera.position - points
        distances = np.linalg.norm(to_camera, axis=1)
        cosines = np.einsum("ni,ni->n", to_camera, normals) / np.maximum(distances, 1e-12)
        visible = is_valid & (cosines > MIN_COSINE)
        visible[visible] = self._is_unhidden(points[visible], normals[visible])
        columns, rows = np.floor(np.nan_to_num(positions)).astype(np.int64).T
        width, height = self.camera.lens.size
        visible &= (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        border = np.zeros(len(points), np.float32)
        border[visible] = self._border[rows[visible], columns[visible]]
        visible &= border > SILHOUETTE_PIXELS
        trust = np.zeros(len(points), np.float32)
        trust[visible] = self.find_trust(positions[visible])
        visible &= trust > MIN_TRUST
        resolution = np.where(visible, self._focal**2 * cosines / np.maximum(depths, 1e-12) ** 2, 0.0)
        weights = resolution * cosines * (border / BORDER_PIXELS) ** 2 * trust
        return Seen(positions, visible, resolution.astype(np.float32), weights.astype(np.float32))

    def find_trust(self, positions: np.ndarray) -> np.ndarray:
        """Return the trust (N,) float32 at `positions` (N, 2) in pixels."""
        rows, columns = self.trust.shape
        return sample_bilinear(self.trust[..., None], positions / np.array(self.camera.lens.size) * (columns, rows))[:, 0]

    def _draw(self, mesh: TriangleMesh) -> np.ndarray:
        """Return the depths (H, W) float32 of a pinhole image, which straightens what the lens distorts."""
        points = mesh.vertices @ self.camera.rotation.T + self.camera.translation
        in_front = points[:, 2] > 1e-6 * max(float(np.abs(points[:, 2]).max(initial=0.0)), 1e-12)
        pixels = self._to_pixels(points, in_front)
        kept = mesh.triangles[in_front[mesh.triangles].all(axis=1)]
        inverse = np.where(in_front, -1.0 / np.where(in_front, points[:, 2], 1.0), 0.0)  # linear in the image, smaller is nearer
        _, buffer = draw_ids(pixels[kept], inverse[kept], self._size)
        return np.where(np.isfinite(buffer), -buffer, np.float32(0.0))

    def _is_unhidden(self, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return whether (N,) bool nothing nearer or much deeper than the tangent plane is drawn around `points` (N, 3)."""
        local, directions = points @ self.camera.rotation.T + self.camera.translation, normals @ self.camera.rotation.T
        pixels = np.floor(self._to_pixels(local, local[:, 2] > 0.0)).astype(np.int64)
        inside = ((pixels >= 0) & (pixels < self._size)).all(axis=1)
        columns, rows = np.clip(pixels, 0, np.array(self._size) - 1).T
        inverse = 1.0 / np.maximum(local[:, 2], 1e-12)
        plane = np.maximum(np.abs(np.einsum("ni,ni->n", directions, local)), 1e-12)
        gradient = np.linalg.norm(directions[:, :2], axis=1) / plane  # of inverse depths in the image, per unit of focal length
        change = gradient * (SILHOUETTE_PIXELS + 1.0) * np.sqrt(2.0) / self._focal
        is_front = self._nearest[rows, columns] <= inverse * (1.0 + DEPTH_TOLERANCE) + change
        is_inner = self._farthest[rows, columns] >= inverse * (1.0 - STEP_FACTOR * DEPTH_TOLERANCE) - STEP_FACTOR * change
        return inside & is_front & is_inner

    def _to_pixels(self, points: np.ndarray, in_front: np.ndarray) -> np.ndarray:
        tangents = points[:, :2] / np.where(in_front, points[:, 2], 1.0)[:, None]
        return (tangents - self._low) * self._focal


def _frame(camera: PhotoCamera) -> tuple[np.ndarray, tuple[int, int]]:
    """Return the smallest tangents (2,) of what the photograph shows, and the size in pixels of a pinhole image of it."""
    width, height = camera.lens.size
    x, y = np.linspace(0.0, width, 65), np.linspace(0.0, height, 65)
    outline = np.concatenate([np.stack(np.broadcast_arrays(a, b), axis=1) for a, b in ((x, 0.0), (x, height), (0.0, y), (width, y))])
    directions = camera.lens.unproject(outline)
    tangents = np.clip(directions[:, :2] / np.maximum(directions[:, 2:], 1.0 / MAX_TANGENT**2), -MAX_TANGENT, MAX_TANGENT)
    low, high = tangents.min(axis=0), tangents.max(axis=0)
    size = np.ceil((high - low) * float(np.mean(camera.lens.focal))).astype(int) + 1
    return low, (int(size[0]), int(size[1]))
