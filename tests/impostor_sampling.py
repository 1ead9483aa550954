"""Reference implementation of the shader of octahedral impostors: rays sample the three nearest frames of an atlas."""

from dataclasses import dataclass

import numpy as np

from farfield.addon.core.btf.octahedral import FrameGrid, OctahedralAtlas
from farfield.addon.core.geometry.directions import DirectionGrid
from farfield.addon.core.imaging.images import MIN_ALPHA, sample_bilinear

PARALLAX_STEPS = 2  # Those of `lib.impostor_rays`, which needs Blender.
MIN_COSINE = 0.1


@dataclass(frozen=True)
class RaySample:
    """Samples of M rays.

    color (M, 4): premultiplied; darker where normals vary, since not all of them can face a light. normal (M, 3): unit, or 0 where nothing
    is hit. distances (M,): from the ray's point to the surface, towards the viewer.
    """

    color: np.ndarray
    normal: np.ndarray
    distances: np.ndarray


def surrounding_frames(grid: FrameGrid, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the three frames of `grid` around each of `directions` (M, 3): indices (M, 3) int32 and weights (M, 3) that sum to 1.

    On the upper half, directions below the horizon are moved to the horizon.
    """
    cells = grid.frames_per_side - 1
    positions = 0.5 * (DirectionGrid(grid.frames_per_side, grid.upper).to_map(directions) + 1.0) * cells
    low = np.clip(np.floor(positions), 0, cells - 1)
    fraction = positions - low
    from_center = low + 0.5 - 0.5 * cells
    is_mirrored = from_center[:, 0] * from_center[:, 1] > 0.0
    x, y = np.where(is_mirrored, 1.0 - fraction[:, 0], fraction[:, 0]), fraction[:, 1]
    is_lower_right = x > y
    ones = np.ones_like(is_lower_right)
    columns = np.stack([~ones, ones, is_lower_right], axis=1) ^ is_mirrored[:, None]
    rows = np.stack([~ones, ones, ~is_lower_right], axis=1)
    indices = (low[:, 1:] + rows) * grid.frames_per_side + low[:, :1] + columns
    weights = np.stack([1.0 - np.maximum(x, y), np.minimum(x, y), np.abs(x - y)], axis=1)
    return indices.astype(np.int32), weights


def sample_rays(atlas: OctahedralAtlas, points: np.ndarray, direction: np.ndarray) -> RaySample:
    """Sample the rays through `points` (M, 3), world space, that run opposite to the unit `direction` (3,), which points to the viewer.

    In each of the three frames, the ray is intersected with the frame's heights (parallax mapping, PARALLAX_STEPS steps from the plane
    through the center), so that the frames agree before they are blended.
    """
    indices, weights = surrounding_frames(atlas.grid, direction[None])
    color, normal, distances = np.zeros((len(points), 4)), np.zeros((len(points), 3)), np.zeros(len(points))
    for index, frame_weight in zip(indices[0], weights[0], strict=True):
        values, frame_distances = _sample_frame(atlas, int(index), points - atlas.center, direction)
        weight = frame_weight * values[:, 3]
        color += weight[:, None] * np.column_stack([values[:, :3], np.ones(len(points))])
        normal += weight[:, None] * values[:, 4:7]
        distances += weight * frame_distances
    lengths = np.linalg.norm(normal, axis=1, keepdims=True)
    coverage = np.maximum(color[:, 3:], MIN_ALPHA)
    color[:, :3] *= lengths / coverage
    return RaySample(color, normal / np.maximum(lengths, MIN_ALPHA), distances / coverage[:, 0])


def _sample_frame(atlas: OctahedralAtlas, index: int, points: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return color, alpha and normal (M, 7) where rays hit the surface in frame `index`, and the distances (M,) along the rays."""
    view, tile = atlas.view(index), atlas.tile(index)
    cosine = max(float(view.direction @ direction), MIN_COSINE)
    height = np.zeros(len(points))
    for _ in range(PARALLAX_STEPS + 1):
        distances = (height - points @ view.direction) / cosine
        hits = points + distances[:, None] * direction
        pixels = np.stack([hits @ view.right, hits @ view.up], axis=1) / view.pixel_size + 0.5 * view.resolution
        height = atlas.half_side * sample_bilinear(atlas.height[tile][..., None], pixels)[:, 0]
    values = sample_bilinear(np.concatenate([atlas.color[tile], atlas.normal[tile]], axis=2), pixels)
    values[:, 3] *= ((pixels >= 0.0) & (pixels <= view.resolution)).all(axis=1)
    return values, distances
