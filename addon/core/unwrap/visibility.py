"""Visible area of each triangle in a camera's image, with occlusion."""

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import maximum_filter

from ..arrays import TINY
from ..geometry.cameras import CameraProjection
from ..geometry.mesh import TriangleMesh
from ..geometry.transforms import signed_areas
from ..imaging.raster import depth_buffer

BARYCENTRIC_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
DEPTH_TOLERANCE = 1e-4  # Samples no farther behind the nearest surface than this fraction of the depth range are visible.
MAX_DEPTH_BUFFER_SIZE = 2048  # Pixels along the longer side.


def visible_pixel_areas(mesh: TriangleMesh, camera: CameraProjection, occluders: Iterable[TriangleMesh] = ()) -> np.ndarray:
    """Return the visible area (T,) in pixels of each triangle of `mesh`, from either side; 0 where hidden or outside the view.

    occluders: other meshes that may hide it, in world space like `mesh`.
    """
    size = tuple(max(int(side * min(1.0, MAX_DEPTH_BUFFER_SIZE / max(camera.size))), 1) for side in camera.size)
    in_front, corners, depths = _project(mesh, camera, size)
    pixel_areas = np.zeros(len(mesh.triangles))
    if in_front.any():
        buffer = depth_buffer(corners, depths, size)
        for occluder in occluders:
            _, occluder_corners, occluder_depths = _project(occluder, camera, size)
            buffer = np.minimum(buffer, depth_buffer(occluder_corners, occluder_depths, size))
        areas = np.abs(signed_areas(corners)) * (camera.size[0] * camera.size[1]) / (size[0] * size[1])
        pixel_areas[in_front] = _visible_fractions(corners, depths, buffer) * areas
    return pixel_areas


def _project(mesh: TriangleMesh, camera: CameraProjection, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project the triangles between the clipping planes into an image of `size`.

    Returns:
        (T,) bool, triangles that lie completely in front of the camera; of these the corners (D, 3, 2) in pixels and depths (D, 3),
        smaller where nearer.
    """
    clip = np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]) @ camera.projection.T
    is_inside = (clip[:, 3] > 1e-9 * np.abs(clip[:, 3]).max(initial=TINY)) & (np.abs(clip[:, 2]) <= clip[:, 3])
    projected = clip[:, :3] / np.where(is_inside, clip[:, 3], 1.0)[:, None]
    in_front = is_inside[mesh.triangles].all(axis=1)
    corners = projected[mesh.triangles[in_front]]
    return in_front, 0.5 * (corners[:, :, :2] + 1.0) * size, corners[:, :, 2]


def _visible_fractions(corners: np.ndarray, depths: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Return the visible fraction (T,) of triangles (T, 3, 2), in pixels, by the sample points with nothing nearer around their pixel.

    buffer: (H, W), the smallest depth per pixel.
    """
    size = buffer.shape[::-1]
    deepest = maximum_filter(np.where(np.isfinite(buffer), buffer, -np.inf), 3, mode="nearest")
    positions, sample_depths = np.einsum("si,tij->tsj", BARYCENTRIC_SAMPLES, corners), depths @ BARYCENTRIC_SAMPLES.T
    pixels = np.floor(positions).astype(np.int64)
    in_image = ((pixels >= 0) & (pixels < size)).all(axis=2)
    x, y = np.clip(pixels, 0, np.array(size) - 1).transpose(2, 0, 1)
    nearest = deepest[y, x]  # -inf where triangles are too small to cover a pixel center: nothing hides them.
    tolerance = DEPTH_TOLERANCE * max(float(np.ptp(depths)), 1e-12)
    return (in_image & ((sample_depths <= nearest + tolerance) | ~np.isfinite(nearest))).mean(axis=1)
