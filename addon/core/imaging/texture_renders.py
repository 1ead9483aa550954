"""Images of textured meshes without shading, by rasterization in NumPy."""

import numpy as np

from .images import sample_bilinear
from .raster import draw_ids


def render_texture(
    corners: np.ndarray, depths: np.ndarray, corner_uvs: np.ndarray, texture: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return an image (H, W, C) of triangles with a texture, and where (H, W) bool there is a triangle.

    Args:
        corners: (T, 3, 2) float64 in pixels of the image. depths: (T, 3) distances along the optical axis, positive. corner_uvs: (T, 3, 2).
        texture: (H', W', C) float32, row 0 at the bottom. size: width and height of the image.
    """
    owners, _ = draw_ids(corners, -1.0 / depths, size)
    covered = owners >= 0
    triangles = owners[covered]
    rows, columns = np.nonzero(covered)
    offsets = corners[triangles] - (np.stack([columns, rows], axis=1) + 0.5)[:, None]
    areas = np.stack(
        [_cross(offsets[:, 1], offsets[:, 2]), _cross(offsets[:, 2], offsets[:, 0]), _cross(offsets[:, 0], offsets[:, 1])], axis=1
    )
    weights = areas / depths[triangles]  # perspective-correct
    weights /= weights.sum(axis=1, keepdims=True)
    uvs = np.einsum("ni,nic->nc", weights, corner_uvs[triangles])
    image = np.zeros((size[1], size[0], texture.shape[2]), np.float32)
    image[covered] = sample_bilinear(texture, uvs * texture.shape[1::-1])
    return image, covered


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
