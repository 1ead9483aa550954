"""The placement of a level's quads in the plane of its atlas, where their textures are captured.

In the atlas plane one atlas is `texel * width` by `texel * height` large and centered on the origin. A quad keeps its size; its u, v and
normal lie along x, y and z. Lengths, and thus the heights of bumps, are the same as in the scene.
"""

from dataclasses import dataclass

import numpy as np

from ...core.billboards.cloud import Level


@dataclass(frozen=True)
class AtlasPlacement:
    """Transforms of Q quads into the atlas plane: p -> scale * axes @ (p - center) + position.

    centers (Q, 3) in world space; axes (Q, 3, 3), rows u, v, n; positions (Q, 3) in the atlas plane, z = 0; scales (Q,), less than 1 only
    where a rectangle is smaller than its quad.
    """

    centers: np.ndarray
    axes: np.ndarray
    positions: np.ndarray
    scales: np.ndarray

    def to_atlas(self, points: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """Transform world points (N, K, 3), K on each of the quads `quads` (N,), to the atlas plane."""
        local = np.einsum("nij,nkj->nki", self.axes[quads], points - self.centers[quads][:, None])
        return self.scales[quads][:, None, None] * local + self.positions[quads][:, None]

    def to_world(self, points: np.ndarray, quads: np.ndarray) -> np.ndarray:
        """Transform `points` (N, 2) of the atlas plane to world positions (N, 3) on the quads `quads` (N,): the inverse of `to_atlas`."""
        local = (points - self.positions[quads, :2]) / self.scales[quads, None]
        return self.centers[quads] + np.einsum("ni,nij->nj", local, self.axes[quads, :2])


def compute_placement(level: Level) -> AtlasPlacement:
    """Compute the placement of every quad of `level`, centered on the rectangles of its atlas."""
    rectangles = level.atlas.rectangles.astype(np.float64)
    rectangle_centers = rectangles[:, :2] + 0.5 * rectangles[:, 2:] - 0.5 * np.array(level.atlas.size, np.float64)
    positions = np.column_stack([level.texel_size * rectangle_centers, np.zeros(len(rectangle_centers))])
    half_texel = 0.5 * level.texel_size  # a quad that is smaller than its one texel is not enlarged
    scales = half_texel * rectangles[:, 2:] / np.maximum(level.quads.half_sizes, half_texel)
    return AtlasPlacement(level.quads.centers, level.quads.frames, positions, np.minimum(scales.min(axis=1), 1.0))


def compute_uvs(level: Level, placement: AtlasPlacement, quad: int, cutout: np.ndarray) -> np.ndarray:
    """Compute the UVs (C, 2) of the points `cutout` (C, 2), in -1..1 of the half sizes of one `quad`."""
    points = placement.positions[quad, :2] + placement.scales[quad] * cutout * level.quads.half_sizes[quad]
    return points / (level.texel_size * np.array(level.atlas.size)) + 0.5
