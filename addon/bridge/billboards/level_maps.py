"""The texture maps of one level of a cloud, as arrays."""

from dataclasses import dataclass

import numpy as np

from ...core.billboards.cloud import Level
from ...core.imaging.images import MIN_ALPHA, grow_silhouette, mean_over_coverage


@dataclass(frozen=True)
class PbrMaps:
    """The PBR maps of one side of the quads, in the layout of the level's atlas. All float32, row 0 at the bottom.

    color (H, W, 4): scene-linear Rec.709, premultiplied; alpha is the covered fraction of the texel.
    normal (H, W, 3): unit, in world axes at the time of capture, on the viewer's side.
    roughness_metallic_depth (H, W, 3): depth is the height above the quad's plane along its normal, -1..1 as a fraction of the level's
    error. This map and `normal` have a value in every texel.
    """

    color: np.ndarray
    normal: np.ndarray
    roughness_metallic_depth: np.ndarray


@dataclass(frozen=True)
class LevelTextures:
    """Both sides of the quads of one level. Both lie in the atlas as seen from the side of the quads' normals."""

    front: PbrMaps
    back: PbrMaps


def compute_maps(
    color: np.ndarray, normal: np.ndarray, roughness_metallic_depth: np.ndarray, level: Level, continuation: np.ndarray
) -> PbrMaps:
    """Compute the maps of one side from its three renders (H, W, 4): premultiplied, with normal and depth encoded in 0..1.

    continuation: mask (H, W) bool of the texels into which silhouettes grow, because the surface continues there (see `silhouettes`).
    """
    radius = level.atlas.gutter // 2 + 1
    directions = mean_over_coverage(normal, radius) * 2.0 - 1.0
    lengths = np.linalg.norm(directions, axis=2, keepdims=True)
    directions = np.where(lengths > MIN_ALPHA, directions / np.maximum(lengths, MIN_ALPHA), np.float32([0.0, 0.0, 1.0]))
    parameters = mean_over_coverage(roughness_metallic_depth, radius)
    parameters[..., 2] = parameters[..., 2] * 2.0 - 1.0
    return PbrMaps(grow_silhouette(np.clip(color, 0.0, None), continuation, radius), directions.astype(np.float32), parameters)
