"""Perceived lightness of the textures of a mesh, at the resolution of its triangles."""

from collections.abc import Sequence

import numpy as np

from ...geometry.transforms import signed_areas
from ...imaging.colors import LUMINANCE
from ...imaging.mipmaps import build_mipmaps, sample_mipmaps
from ..textured_mesh import TexturedMesh

POINTS = np.full((3, 3), 1.0 / 6.0) + 0.5 * np.eye(3)  # barycentric coordinates of samples, one near each corner
CUBE_ROOT_LIMIT, LINE_SCALE = (6.0 / 29.0) ** 3, 9.0329  # of CIE L*, as a fraction of white


def sample_lightness(mesh: TexturedMesh, textures: Sequence[np.ndarray | None]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lightness (T, 3) float32, 0 to 1, near each corner of the triangles of `mesh`, and which triangles (T,) bool have a
    texture.

    A sample is the mean over texels of about a third of its triangle, from a level of mipmaps, so that detail finer than the mesh
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
        texels = np.abs(signed_areas(corner_uvs)) * (texture.shape[0] * texture.shape[1] / len(POINTS))
        positions = np.einsum("pc,tcx->tpx", POINTS, corner_uvs).reshape(-1, 2)
        mipmaps = build_mipmaps(_luminance_of(texture)[..., None])
        luminance = sample_mipmaps(mipmaps, positions, np.repeat(np.sqrt(texels), len(POINTS)))
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
