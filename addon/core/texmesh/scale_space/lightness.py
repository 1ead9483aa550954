"""Perceived lightness of the textures of a mesh, at the resolution of its triangles."""

from collections.abc import Sequence

import numpy as np

from ...imaging.colors import LUMINANCE
from ..textured_mesh import TexturedMesh

POINTS = np.full((3, 3), 1.0 / 6.0) + 0.5 * np.eye(3)  # barycentric coordinates of samples, one near each corner
CUBE_ROOT_LIMIT, LINE_SCALE = (6.0 / 29.0) ** 3, 9.0329  # of CIE L*, as a fraction of white


def sample_lightness(mesh: TexturedMesh, textures: Sequence[np.ndarray | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lightness (T, 3) float32, 0 to 1, near each corner of the triangles of `mesh`, and which triangles (T,) bool have a
    texture.

    A sample is the mean over texels of about a third of its triangle, from a level of an image pyramid, so that detail finer than the mesh
    does not alias. Textures repeat outside 0..1. Triangles without a texture are 0.

    textures: per material an image (H, W, 3) float32, scene-linear, or None; further channels are ignored.
    """
    lightness = np.zeros(mesh.triangles.shape, np.float32)
    has_texture = np.zeros(len(mesh.triangles), bool)
    for material, texture in enumerate(textures):
        rows = np.flatnonzero(mesh.materials == material)
        if texture is None or texture.size == 0 or not len(rows):
            continue
        has_texture[rows] = True
        corner_uvs = mesh.corner_uvs[rows]
        sides = corner_uvs[:, 1:] - corner_uvs[:, :1]
        uv_areas = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        texels = uv_areas * (texture.shape[0] * texture.shape[1] / len(POINTS))
        levels = 0.5 * np.log2(np.maximum(texels, 1.0))
        positions = np.einsum("pc,tcx->tpx", POINTS, corner_uvs).reshape(-1, 2)
        luminance = _sample_pyramid(_luminance_of(texture), positions, np.repeat(levels, len(POINTS)))
        lightness[rows] = encode_lightness(luminance).reshape(-1, 3)
    return lightness, has_texture


def encode_lightness(luminance: np.ndarray) -> np.ndarray:
    """Return the CIE lightness L* as a fraction, 0 to 1, of relative `luminance`, scene-linear, of any shape."""
    clipped = np.clip(luminance, 0.0, 1.0)
    return np.where(clipped <= CUBE_ROOT_LIMIT, LINE_SCALE * clipped, 1.16 * np.cbrt(clipped) - 0.16)


def _luminance_of(texture: np.ndarray) -> np.ndarray:
    """Return the luminance (H, W) float32 of a scene-linear `texture` (H, W, C), within 0 to 1, so that no highlight outshines a level."""
    values = texture[..., :3] @ LUMINANCE if texture.shape[2] >= 3 else texture[..., 0]
    limited = np.fmin(values, np.float32(1.0))  # fmin and fmax replace what is not a number
    return np.fmax(limited, np.float32(0.0), out=limited)


def _sample_pyramid(image: np.ndarray, positions: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Return samples (N,) of a repeating `image` (H, W) at `positions` (N, 2) in texture coordinates, trilinearly between the `levels`
    (N,) of its pyramid."""
    result = np.zeros(len(positions), np.float32)
    wrapped = positions - np.floor(positions)
    level = 0
    while True:
        is_last = max(image.shape) == 1
        weights = 1.0 - np.abs(levels - level) if not is_last else np.clip(1.0 - (level - levels), 0.0, 1.0)
        used = np.flatnonzero(weights > 0.0)
        result[used] += weights[used] * _sample_repeating(image, wrapped[used])
        if is_last or levels.max() <= level:
            return result
        image, level = _halve(image), level + 1


def _halve(image: np.ndarray) -> np.ndarray:
    """Return means over 2 x 2 pixels of `image` (H, W); an odd last row or column is repeated."""
    even = np.pad(image, [(0, size % 2) for size in image.shape], mode="edge")
    return 0.25 * (even[0::2, 0::2] + even[1::2, 0::2] + even[0::2, 1::2] + even[1::2, 1::2])


def _sample_repeating(image: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Return bilinear samples (N,) of `image` (H, W) at `positions` (N, 2), 0 to 1."""
    height, width = image.shape
    x, y = positions[:, 0] * width - 0.5, positions[:, 1] * height - 0.5
    low_x, low_y = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fraction_x, fraction_y = x - low_x, y - low_y
    left, right = low_x % width, (low_x + 1) % width
    lower, upper = (low_y % height) * width, ((low_y + 1) % height) * width
    flat = image.ravel()
    low = (1.0 - fraction_x) * flat[lower + left] + fraction_x * flat[lower + right]
    high = (1.0 - fraction_x) * flat[upper + left] + fraction_x * flat[upper + right]
    return (1.0 - fraction_y) * low + fraction_y * high
