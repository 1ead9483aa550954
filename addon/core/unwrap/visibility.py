"""How large a camera shows each triangle, what stands before it taken into account."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ..mesh import TriangleMesh
from ..raster import nearest
from .plane import signed_areas

SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric, within a triangle
BEHIND = 1e-4  # of the range of depths: nearer to what is seen than that counts as seen
LARGEST = 2048  # pixels along the longer side for which what hides what is looked up


@dataclass(frozen=True)
class Shot:
    """What a camera takes. projection: (4, 4), world to clip space, in which -w..w is seen in every axis. size: pixels of its picture."""

    projection: np.ndarray
    size: tuple[int, int]


def shown_pixels(mesh: TriangleMesh, shot: Shot, others: Iterable[TriangleMesh] = ()) -> np.ndarray:
    """Pixels (T,) that each triangle of `mesh` shows in `shot`, from either side; 0 of those behind or beside the camera, or hidden.

    others: what may hide it besides itself, in world space as well.
    """
    size = tuple(max(int(side * min(1.0, LARGEST / max(shot.size))), 1) for side in shot.size)
    drawn, corners, depths = _projected(mesh, shot, size)
    pixels = np.zeros(len(mesh.triangles))
    if drawn.any():
        buffer = nearest(corners, depths, size)
        for other in others:
            _, before, distances = _projected(other, shot, size)
            buffer = np.minimum(buffer, nearest(before, distances, size))
        areas = np.abs(signed_areas(corners)) * (shot.size[0] * shot.size[1]) / (size[0] * size[1])
        pixels[drawn] = _shares_seen(corners, depths, buffer) * areas
    return pixels


def _projected(mesh: TriangleMesh, shot: Shot, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which triangles (T,) bool are drawn, all that are wholly before the camera, and of these the corners (D, 3, 2) in pixels of a
    picture of `size`, and depths (D, 3), smaller where nearer."""
    clip = np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]) @ shot.projection.T
    before = (clip[:, 3] > 1e-9 * np.abs(clip[:, 3]).max(initial=1e-300)) & (np.abs(clip[:, 2]) <= clip[:, 3])
    placed = clip[:, :3] / np.where(before, clip[:, 3], 1.0)[:, None]
    drawn = before[mesh.triangles].all(axis=1)
    corners = placed[mesh.triangles[drawn]]
    return drawn, 0.5 * (corners[:, :, :2] + 1.0) * size, corners[:, :, 2]


def _shares_seen(corners: np.ndarray, depths: np.ndarray, buffer: np.ndarray) -> np.ndarray:
    """Share (T,) of points in triangles (T, 3, 2), in pixels, that lie in the picture with nothing nearer around their pixel.

    buffer: (H, W), what is nearest in every pixel.
    """
    size = buffer.shape[::-1]
    deepest = maximum_filter(np.where(np.isfinite(buffer), buffer, -np.inf), 3, mode="nearest")
    points, depth = np.einsum("si,tij->tsj", SAMPLES, corners), depths @ SAMPLES.T
    pixels = np.floor(points).astype(np.int64)
    within = ((pixels >= 0) & (pixels < size)).all(axis=2)
    x, y = np.clip(pixels, 0, np.array(size) - 1).transpose(2, 0, 1)
    there = deepest[y, x]  # -inf where triangles are too small to meet the middle of a pixel: nothing hides them
    tolerance = BEHIND * max(float(np.ptp(depths)), 1e-12)
    return (within & ((depth <= there + tolerance) | ~np.isfinite(there))).mean(axis=1)
