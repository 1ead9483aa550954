"""How large a camera shows each triangle, what stands before it taken into account."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from ..mesh import TriangleMesh
from ..raster import nearest

SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric, within a triangle
BEHIND = 1e-4  # of the range of depths: nearer to what is seen than that counts as seen
LARGEST = 2048  # pixels along the longer side for which what hides what is looked up


@dataclass(frozen=True)
class Shot:
    """What a camera takes. projection: (4, 4), world to clip space, in which -w..w is seen in every axis. size: pixels of its picture."""

    projection: np.ndarray
    size: tuple[int, int]


def shown_pixels(mesh: TriangleMesh, shot: Shot) -> np.ndarray:
    """Pixels (T,) that each triangle of `mesh` shows in `shot`, from either side; 0 of those behind or beside the camera, or hidden."""
    clip = np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))]) @ shot.projection.T
    before = (clip[:, 3] > 1e-9 * np.abs(clip[:, 3]).max(initial=1e-300)) & (np.abs(clip[:, 2]) <= clip[:, 3])
    placed = clip[:, :3] / np.where(before, clip[:, 3], 1.0)[:, None]
    drawn = before[mesh.triangles].all(axis=1)
    corners, depths = placed[mesh.triangles[drawn]][:, :, :2], placed[mesh.triangles[drawn]][:, :, 2]
    width, height = (max(int(side * min(1.0, LARGEST / max(shot.size))), 1) for side in shot.size)
    corners = 0.5 * (corners + 1.0) * [width, height]
    shares = _shares_seen(corners, depths, (width, height))
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    pixels = np.zeros(len(mesh.triangles))
    pixels[drawn] = shares * 0.5 * np.abs(ax * by - ay * bx) * (shot.size[0] * shot.size[1]) / (width * height)
    return pixels


def _shares_seen(corners: np.ndarray, depths: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Share (T,) of points in triangles (T, 3, 2), in pixels, that lie in the picture with nothing nearer around their pixel."""
    if not len(corners):
        return np.zeros(0)
    buffer = nearest(corners, depths, size)
    deepest = maximum_filter(np.where(np.isfinite(buffer), buffer, -np.inf), 3, mode="nearest")
    points, depth = np.einsum("si,tij->tsj", SAMPLES, corners), depths @ SAMPLES.T
    pixels = np.floor(points).astype(np.int64)
    within = ((pixels >= 0) & (pixels < size)).all(axis=2)
    x, y = np.clip(pixels, 0, np.array(size) - 1).transpose(2, 0, 1)
    there = deepest[y, x]  # -inf where triangles are too small to meet the middle of a pixel: nothing hides them
    tolerance = BEHIND * max(float(np.ptp(depths)), 1e-12)
    return (within & ((depth <= there + tolerance) | ~np.isfinite(there))).mean(axis=1)
