"""Octahedral impostors: renders of an object from all directions on a grid, and the sampling of rays from the three nearest ones.

After Brucks, "Octahedral Impostors" (2018). The renders ("frames") are at the vertices of a grid over the octahedral map of all directions,
or over the hemi-octahedral map of those above the horizon, so the edge midpoints and corners of the map have frames too. On the full map, a
boundary vertex and its mirror image are the same direction, and all four corners point straight down; each of them still has its own
frame, as usual. Every grid cell is split into two triangles along the diagonal parallel to the fold of its quadrant, which makes them
nearly equilateral on the sphere. A direction uses the three frames of its triangle with barycentric weights.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import SettingsError
from ..geometry.cameras import OrthographicView
from ..geometry.direction_grids import DirectionGrid
from ..geometry.directions import from_hemi_octahedral, from_octahedral
from ..imaging.images import MIN_ALPHA, sample_bilinear
from ..imaging.metrics import encode_srgb

MIN_FRAMES, MAX_FRAMES = 2, 64  # per side
MIN_FRAME_RESOLUTION = 8  # pixels; smaller frames show nothing
PARALLAX_STEPS = 2  # of the search for the surface along a ray; the first starts at the plane through the center
MIN_COSINE = 0.1  # between a ray and the direction of a frame; smaller cosines are clamped
MAX_UNIFORM_DEVIATION = 1.5 / 255.0  # roughness and metallic within this of their mean need no image


@dataclass(frozen=True)
class FrameGrid:
    """frames_per_side x frames_per_side directions at the vertices of a grid over the octahedral map (`upper`: the hemi-octahedral map).

    Index i * frames_per_side + j is row i (y), column j (x) of the map, starting at (-1, -1).

    Raises:
        SettingsError: there are too few or too many frames.
    """

    frames_per_side: int
    upper: bool = False

    def __post_init__(self) -> None:
        if not MIN_FRAMES <= self.frames_per_side <= MAX_FRAMES:
            raise SettingsError(
                f"An octahedral atlas has {MIN_FRAMES} to {MAX_FRAMES} frames per side, not {self.frames_per_side}; 12 is the usual number."
            )

    def __len__(self) -> int:
        return self.frames_per_side**2

    @cached_property
    def directions(self) -> np.ndarray:
        """(N, 3) float64 unit vectors towards the viewer."""
        ticks = np.linspace(-1.0, 1.0, self.frames_per_side)
        points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        return from_hemi_octahedral(points) if self.upper else from_octahedral(points)

    def surrounding_frames(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the three frames around each of `directions` (M, 3): indices (M, 3) int32 and weights (M, 3) that sum to 1.

        On the upper half, directions below the horizon are moved to the horizon.
        """
        cells = self.frames_per_side - 1
        positions = 0.5 * (DirectionGrid(self.frames_per_side, self.upper).to_map(directions) + 1.0) * cells
        low = np.clip(np.floor(positions), 0, cells - 1)
        fraction = positions - low
        from_center = low + 0.5 - 0.5 * cells
        is_mirrored = from_center[:, 0] * from_center[:, 1] > 0.0
        x, y = np.where(is_mirrored, 1.0 - fraction[:, 0], fraction[:, 0]), fraction[:, 1]
        is_lower_right = x > y
        ones = np.ones_like(is_lower_right)
        columns = np.stack([~ones, ones, is_lower_right], axis=1) ^ is_mirrored[:, None]
        rows = np.stack([~ones, ones, ~is_lower_right], axis=1)
        indices = (low[:, 1:] + rows) * self.frames_per_side + low[:, :1] + columns
        weights = np.stack([1.0 - np.maximum(x, y), np.minimum(x, y), np.abs(x - y)], axis=1)
        return indices.astype(np.int32), weights


@dataclass(frozen=True)
class OctahedralAtlas:
    """The frames of one object in one image; frame i * frames_per_side + j is at row i, column j. Row 0 at the bottom.

    center (3,): center of all frames, world space. half_side: half the side of a frame, a length. frame_resolution: pixels per side of a
    frame. With S = frames_per_side * frame_resolution, all float32:
    color (S, S, 4): scene-linear Rec.709, straight; alpha is the covered fraction of a pixel.
    normal (S, S, 3): world space, facing the viewer; the mean of unit normals, thus shorter where they vary within a pixel.
    height (S, S): of the surface above the plane through the center that faces the viewer, in half sides, -1..1.
    roughness_metallic (S, S, 2).
    All except alpha have a value in every pixel.
    """

    grid: FrameGrid
    center: np.ndarray
    half_side: float
    frame_resolution: int
    color: np.ndarray
    normal: np.ndarray
    height: np.ndarray
    roughness_metallic: np.ndarray

    def view(self, index: int) -> OrthographicView:
        """Return the view of frame `index`."""
        pixel_size = 2.0 * self.half_side / self.frame_resolution
        return OrthographicView(self.grid.directions[index], self.center, self.frame_resolution, pixel_size)

    def tile(self, index: int) -> tuple[slice, slice]:
        """Return the rows and columns of frame `index`."""
        row, column = divmod(index, self.grid.frames_per_side)
        size = self.frame_resolution
        return slice(row * size, (row + 1) * size), slice(column * size, (column + 1) * size)

    @property
    def uniform_roughness_metallic(self) -> np.ndarray | None:
        """Roughness and metallic (2,) if both are uniform where the object covers the image, else None."""
        return find_uniform_value(self.roughness_metallic, self.color[..., 3])

    def encode(self) -> dict[str, np.ndarray]:
        """Return the images (S, S, 4) to store, with values 0..1 for 8 bits per channel.

        `color` (sRGB, straight alpha), `normal_height` (normal and height mapped from -1..1 to 0..1), and `roughness_metallic` (roughness,
        metallic, 0, 1) unless both are uniform.
        """
        color = np.concatenate([encode_srgb(self.color[..., :3]), self.color[..., 3:]], axis=2)
        images = {"color": color, "normal_height": 0.5 + 0.5 * np.concatenate([self.normal, self.height[..., None]], axis=2)}
        if self.uniform_roughness_metallic is None:
            blue_alpha = np.broadcast_to(np.float32([0.0, 1.0]), self.roughness_metallic.shape)
            images["roughness_metallic"] = np.concatenate([self.roughness_metallic, blue_alpha], axis=2)
        return images


@dataclass(frozen=True)
class RaySample:
    """Samples of M rays.

    color (M, 4): premultiplied; darker where normals vary, since not all of them can face a light. normal (M, 3): unit, or 0 where nothing
    is hit. distances (M,): from the ray's point to the surface, towards the viewer.
    """

    color: np.ndarray
    normal: np.ndarray
    distances: np.ndarray


def find_uniform_value(values: np.ndarray, alpha: np.ndarray) -> np.ndarray | None:
    """Return the mean (2,) of `values` (H, W, 2) where `alpha` (H, W) is above one half if they hardly deviate from it, else None."""
    covered = values[alpha > 0.5]
    if not len(covered):
        return np.zeros(2, np.float32)
    mean = covered.mean(axis=0)
    return mean if np.abs(covered - mean).max() <= MAX_UNIFORM_DEVIATION else None


def compute_frame_resolution(total_bytes: int, frames_per_side: int, image_count: int) -> int:
    """Return the largest frame resolution with which `image_count` images, four bytes per pixel, uncompressed, fit into `total_bytes`.

    Raises:
        SettingsError: the frames would be too small.
    """
    resolution = int((total_bytes / (4.0 * image_count)) ** 0.5 / frames_per_side)
    if resolution < MIN_FRAME_RESOLUTION:
        raise SettingsError(
            f"{total_bytes:,} bytes are too few for an octahedral atlas of {frames_per_side} x {frames_per_side} frames: each would have "
            f"{resolution} pixels per side. Use at least {4 * image_count * (MIN_FRAME_RESOLUTION * frames_per_side) ** 2:,} bytes."
        )
    return resolution


def sample_rays(atlas: OctahedralAtlas, points: np.ndarray, direction: np.ndarray) -> RaySample:
    """Sample the rays through `points` (M, 3), world space, that run opposite to the unit `direction` (3,), which points to the viewer.

    In each of the three frames, the ray is intersected with the frame's heights (parallax mapping, PARALLAX_STEPS steps from the plane
    through the center), so that the frames agree before they are blended. This is the reference implementation of the shader, for tests.
    """
    indices, weights = atlas.grid.surrounding_frames(direction[None])
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
