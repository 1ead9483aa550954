"""Octahedral impostors: an object as a grid of small pictures from all sides, and what a ray sees in the three pictures around it.

After Brucks, "Octahedral Impostors" (2018). The pictures ("frames") stand at the vertices of a grid over the octahedral map of all
directions, or over the hemi-octahedral map of those above the horizon; so the middle of the map's sides and its corners have frames of
their own. On the map of the whole sphere a border vertex and its mirror image are one direction, and the four corners are all straight
down; each has its own frame all the same, as is usual. Every cell of the grid is cut into two triangles along the diagonal that runs
beside the fold of its quarter of the map, which makes them nearly equilateral on the sphere. A direction takes the three frames of its
triangle with barycentric weights.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..direction_grids import DirectionGrid
from ..directions import from_hemi_octahedral, from_octahedral
from ..errors import SettingsError
from ..images import EMPTY, bilinear
from ..metrics import encode_srgb
from .texels import View

FEWEST_FRAMES, MOST_FRAMES = 2, 64
FEWEST_PIXELS = 8  # along a frame; fewer show nothing
STEPS = 2  # of the search for the surface along a ray; the first starts on the plane through the centre
LEAST_COSINE = 0.1  # between a ray and the direction of a frame; a flatter ray counts as this flat
SURFACE_VARIES = 1.5 / 255.0  # roughness or metallic within this of their mean need no map


@dataclass(frozen=True)
class FrameGrid:
    """frames x frames directions at the vertices of a grid over the octahedral map (`upper`: the hemi-octahedral one).

    Number i * frames + j is row i (y), column j (x) of the map, from (-1, -1) on.

    Raises:
        SettingsError: when there are too few or too many frames.
    """

    frames: int
    upper: bool = False

    def __post_init__(self) -> None:
        if not FEWEST_FRAMES <= self.frames <= MOST_FRAMES:
            raise SettingsError(
                f"An octahedral atlas has {FEWEST_FRAMES} to {MOST_FRAMES} frames a side, not {self.frames}; 12 is the usual number."
            )

    def __len__(self) -> int:
        return self.frames**2

    @cached_property
    def directions(self) -> np.ndarray:
        """(N, 3) float64 unit vectors towards the viewer."""
        ticks = np.linspace(-1.0, 1.0, self.frames)
        points = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        return from_hemi_octahedral(points) if self.upper else from_octahedral(points)

    def around(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The three frames around each of `directions` (M, 3): numbers (M, 3) int32 and weights (M, 3) that sum to 1.

        On the upper half, what lies below the horizon counts as on it.
        """
        cells = self.frames - 1
        places = 0.5 * (DirectionGrid(self.frames, self.upper).places(directions) + 1.0) * cells
        low = np.clip(np.floor(places), 0, cells - 1)
        share = places - low
        from_middle = low + 0.5 - 0.5 * cells
        mirrored = from_middle[:, 0] * from_middle[:, 1] > 0.0
        x, y = np.where(mirrored, 1.0 - share[:, 0], share[:, 0]), share[:, 1]
        rightwards = x > y
        ones = np.ones_like(rightwards)
        columns = np.stack([~ones, ones, rightwards], axis=1) ^ mirrored[:, None]
        rows = np.stack([~ones, ones, ~rightwards], axis=1)
        numbers = (low[:, 1:] + rows) * self.frames + low[:, :1] + columns
        weights = np.stack([1.0 - np.maximum(x, y), np.minimum(x, y), np.abs(x - y)], axis=1)
        return numbers.astype(np.int32), weights


@dataclass(frozen=True)
class Atlas:
    """The frames of one object side by side; number i * frames + j of the grid stands in row i, column j. Row 0 at the bottom.

    center (3,): what all frames look at, world space. half_side: half the side of a frame, as a length. pixels: P along a frame; with
    S = frames * P, all float32:
    colour (S, S, 4): scene-linear Rec.709, straight; alpha is the share of a pixel that is covered.
    normal (S, S, 3): world space, on the side of the viewer; the mean of unit normals, so shorter where they differ within a pixel.
    height (S, S): of the surface above the plane through the centre that faces the viewer, in half sides, -1..1.
    surface (S, S, 2): roughness and metallic.
    All but alpha have a value in every pixel.
    """

    grid: FrameGrid
    center: np.ndarray
    half_side: float
    pixels: int
    colour: np.ndarray
    normal: np.ndarray
    height: np.ndarray
    surface: np.ndarray

    def view(self, number: int) -> View:
        """The picture that frame `number` was rendered as."""
        return View(self.grid.directions[number], self.center, self.pixels, 2.0 * self.half_side / self.pixels)

    def tile(self, number: int) -> tuple[slice, slice]:
        """Rows and columns of frame `number`."""
        row, column = divmod(number, self.grid.frames)
        return slice(row * self.pixels, (row + 1) * self.pixels), slice(column * self.pixels, (column + 1) * self.pixels)

    @property
    def plain_surface(self) -> np.ndarray | None:
        """Roughness and metallic (2,) where they are the same all over what is covered, else None."""
        return uniform_surface(self.surface, self.colour[..., 3])

    def encoded(self) -> dict[str, np.ndarray]:
        """What the images hold, values 0..1 of 8 bits, (S, S, 4): `colour` (sRGB, straight alpha), `normal_height` (normal and height
        moved from -1..1 to 0..1), and, unless one value says it all, `surface` (roughness, metallic, 0, 1)."""
        colour = np.concatenate([encode_srgb(self.colour[..., :3]), self.colour[..., 3:]], axis=2)
        images = {"colour": colour, "normal_height": 0.5 + 0.5 * np.concatenate([self.normal, self.height[..., None]], axis=2)}
        if self.plain_surface is None:
            rest = np.broadcast_to(np.float32([0.0, 1.0]), self.surface.shape)
            images["surface"] = np.concatenate([self.surface, rest], axis=2)
        return images


@dataclass(frozen=True)
class Seen:
    """What M rays see. colour (M, 4): premultiplied, less bright where normals differ, since not all of them can face a light.

    normal (M, 3): unit, or 0 where nothing is seen. along (M,): from the ray's point towards the viewer to the surface.
    """

    colour: np.ndarray
    normal: np.ndarray
    along: np.ndarray


def uniform_surface(surface: np.ndarray, alpha: np.ndarray) -> np.ndarray | None:
    """The mean (2,) of `surface` (H, W, 2) over what `alpha` (H, W) covers when all of it is nearly that, else None."""
    values = surface[alpha > 0.5]
    if not len(values):
        return np.zeros(2, np.float32)
    mean = values.mean(axis=0)
    return mean if np.abs(values - mean).max() <= SURFACE_VARIES else None


def frame_pixels(total_bytes: int, frames: int, images: int) -> int:
    """Pixels along a frame so that so many `images` of four bytes a pixel take at most, and nearly, `total_bytes` without compression.

    Raises:
        SettingsError: when that leaves a frame too few pixels.
    """
    pixels = int((total_bytes / (4.0 * images)) ** 0.5 / frames)
    if pixels < FEWEST_PIXELS:
        raise SettingsError(
            f"{total_bytes:,} bytes leave the {frames} x {frames} frames of an octahedral atlas {pixels} pixels a side; "
            f"{4 * images * (FEWEST_PIXELS * frames) ** 2:,} bytes are the fewest that show something."
        )
    return pixels


def look_up(atlas: Atlas, points: np.ndarray, direction: np.ndarray) -> Seen:
    """What the rays through `points` (M, 3), world space, see that run against the unit `direction` (3,), which points to the viewer.

    In each of the three frames the ray is followed to the frame's own heights (parallax mapping, STEPS steps from the plane through the
    centre), so that the frames agree about what they show before they are blended. The shader does the same, ray by ray.
    """
    numbers, weights = atlas.grid.around(direction[None])
    colour, normal, along = np.zeros((len(points), 4)), np.zeros((len(points), 3)), np.zeros(len(points))
    for number, weight in zip(numbers[0], weights[0], strict=True):
        seen, reach = _look_into(atlas, int(number), points - atlas.center, direction)
        share = weight * seen[:, 3]
        colour += share[:, None] * np.column_stack([seen[:, :3], np.ones(len(points))])
        normal += share[:, None] * seen[:, 4:7]
        along += share * reach
    lengths = np.linalg.norm(normal, axis=1, keepdims=True)
    covered = np.maximum(colour[:, 3:], EMPTY)
    colour[:, :3] *= lengths / covered
    return Seen(colour, normal / np.maximum(lengths, EMPTY), along / covered[:, 0])


def _look_into(atlas: Atlas, number: int, points: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colour, alpha and normal (M, 7) where rays meet the surface that frame `number` shows, and how far along (M,) that is."""
    view, tile = atlas.view(number), atlas.tile(number)
    cosine = max(float(view.direction @ direction), LEAST_COSINE)
    height = np.zeros(len(points))
    for _ in range(STEPS + 1):
        along = (height - points @ view.direction) / cosine
        hit = points + along[:, None] * direction
        places = np.stack([hit @ view.right, hit @ view.up], axis=1) / view.pixel + 0.5 * view.side
        height = atlas.half_side * bilinear(atlas.height[tile][..., None], places)[:, 0]
    seen = bilinear(np.concatenate([atlas.colour[tile], atlas.normal[tile]], axis=2), places)
    seen[:, 3] *= ((places >= 0.0) & (places <= view.side)).all(axis=1)
    return seen, along
