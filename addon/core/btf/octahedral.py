"""Octahedral atlases, the images of octahedral impostors: renders of an object from all directions on a grid.

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
from ..geometry.directions import from_hemi_octahedral, from_octahedral
from ..imaging.metrics import encode_srgb

MIN_FRAMES, MAX_FRAMES = 2, 64  # Per side.
MIN_FRAME_RESOLUTION = 8  # Pixels; smaller frames show nothing.
MAX_UNIFORM_DEVIATION = 1.5 / 255.0  # Roughness and metallic within this of their mean need no image.


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


@dataclass(frozen=True)
class OctahedralAtlas:
    """The frames of one object in one image; frame i * frames_per_side + j is at row i, column j. Row 0 at the bottom.

    With S = frames_per_side * frame_resolution. All maps except alpha have a value in every pixel.

    Attributes:
        grid: Directions of the frames.
        center: (3,) center of all frames, world space.
        half_side: Half the side of a frame, a length.
        frame_resolution: Pixels per side of a frame.
        color: (S, S, 4) float32, scene-linear Rec.709, straight; alpha is the covered fraction of a pixel.
        normal: (S, S, 3) float32, world space, facing the viewer; mean of unit normals, thus shorter where they vary within a pixel.
        height: (S, S) float32, above the plane through the center that faces the viewer, in half sides, -1..1.
        roughness_metallic: (S, S, 2) float32.
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
        """Roughness and metallic (2,) if both hardly vary where the object covers more than half of a pixel, else None."""
        covered = self.roughness_metallic[self.color[..., 3] > 0.5]
        if not len(covered):
            return np.zeros(2, np.float32)
        mean = covered.mean(axis=0)
        return mean if np.abs(covered - mean).max() <= MAX_UNIFORM_DEVIATION else None

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
