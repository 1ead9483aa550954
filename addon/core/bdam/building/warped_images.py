"""Images in another projection than the field: read as if their pixels lay along the axes of the field.

The grid of these pixels has the resolution of the image where that is finest. Their colors are interpolated bilinearly, in linear light and
with premultiplied alpha, at the exact position of each; those outside of the image are transparent.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from ...geometry.placements import Placement
from ...geometry.reprojection import find_projection, reproject
from ..textures.resampling import ImageSource, to_premultiplied

OUTLINE_POINTS = 65  # along each side, for the extent of an image on the field
RESOLUTION_POINTS = 5  # along each side, where sizes of pixels are compared
OFFSET = 1e-3  # part of the extent, for their differences
MARGIN = 0.01  # part of the extent, for what lies between the points
BLOCK = 256  # pixels along the sides of blocks that are warped at once
Numbers = tuple[float, float]


@dataclass(frozen=True)
class Warp:
    """Where the pixels of an image in another projection lie. It consists of types of JSON, for the tasks of a build.

    Attributes:
        image, field: placements; of the image, only the coordinate reference system counts.
        image_corner, image_step: position of the outer corner of pixel (row 0, column 0) on the map of the image, and steps along x and y.
        image_longitude, field_longitude: degrees, of the centers of both.
        corner, step: position on the field of the grid along its axes, see `PlacedImage`.
        shape: rows and columns of that grid.
    """

    image: Placement
    field: Placement
    image_corner: Numbers
    image_step: Numbers
    image_longitude: float
    field_longitude: float
    corner: Numbers = (0.0, 0.0)
    step: Numbers = (1.0, 1.0)
    shape: tuple[int, int] = (1, 1)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Warp":
        """Return a warp from its fields, as `dataclasses.asdict` and JSON give them."""
        return cls(**values | {"image": Placement(**values["image"]), "field": Placement(**values["field"])})

    def to_field(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the grid coordinates on the field, float64, of positions on the image in pixels from the corner."""
        position = tuple(self.image_corner[axis] + self.image_step[axis] * value for axis, value in enumerate((x, y)))
        position = reproject(position, find_projection(self.image), find_projection(self.field), self.field_longitude)
        return tuple((position[axis] - self.field.first[axis]) / self.field.step[axis] for axis in range(2))

    def to_image(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions on the image in pixels from its corner, float64, of grid coordinates on the field."""
        position = tuple(self.field.first[axis] + self.field.step[axis] * value for axis, value in enumerate((x, y)))
        position = reproject(position, find_projection(self.field), find_projection(self.image), self.image_longitude)
        return tuple((position[axis] - self.image_corner[axis]) / self.image_step[axis] for axis in range(2))


def plan_warp(
    image: Placement, corner: Numbers, step: Numbers, size: tuple[int, int], field: Placement, shape: tuple[int, int]
) -> Warp | None:
    """Return how an image with rows and columns `size` lies on a field with rows and columns `shape`, None if it lies outside.

    The projections of both must be known. corner, step: `image_corner` and `image_step` of `Warp`.
    """
    center = corner[0] + 0.5 * size[1] * step[0], corner[1] + 0.5 * size[0] * step[1]
    field_center = field.position((shape[1] - 1) / 2.0, (shape[0] - 1) / 2.0)
    longitudes = (float(find_projection(placed).unproject(*position)[0]) for placed, position in ((image, center), (field, field_center)))
    warp = Warp(image, field, corner, step, *longitudes)
    with np.errstate(all="ignore"):
        x, y = np.meshgrid(np.linspace(0.0, size[1], OUTLINE_POINTS), np.linspace(0.0, size[0], OUTLINE_POINTS))
        points = np.stack(warp.to_field(x, y))
        low, high = points.min(axis=(1, 2)), points.max(axis=(1, 2))
        margin = MARGIN * (high - low)
        low, high = np.maximum(low - margin, 0.0), np.minimum(high + margin, (shape[1] - 1, shape[0] - 1))
        if not (low < high).all():  # NaN is outside, too
            return None
        counts = [_count_pixels(warp, low, high, axis) for axis in range(2)]
    steps = (high - low) / counts
    return replace(warp, corner=tuple(low.tolist()), step=tuple(steps.tolist()), shape=(counts[1], counts[0]))


def _count_pixels(warp: Warp, low: np.ndarray, high: np.ndarray, axis: int) -> int:
    """Return how many pixels along an axis of the field are as small as those of the image, between `low` and `high` (2,)."""
    x, y = np.meshgrid(*(np.linspace(low[side], high[side], RESOLUTION_POINTS) for side in range(2)))
    offset = OFFSET * (high[axis] - low[axis])
    ahead, behind = (warp.to_image(x + sign * offset * (axis == 0), y + sign * offset * (axis == 1)) for sign in (0.5, -0.5))
    lengths = np.hypot(ahead[0] - behind[0], ahead[1] - behind[1])
    return max(int(np.ceil(np.fmax.reduce(lengths, axis=None) / OFFSET)), 1)


class WarpedPixels:
    """An image source: the pixels of another one on the grid of a `Warp`."""

    def __init__(self, source: ImageSource, warp: Warp) -> None:
        self.shape = (*warp.shape, 4)
        self._source, self._warp = source, warp

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 4) float32, scene-linear with straight alpha. Raises FileError."""
        window = np.zeros((rows.stop - rows.start, columns.stop - columns.start, 4), np.float32)
        for top, left in product(range(rows.start, rows.stop, BLOCK), range(columns.start, columns.stop, BLOCK)):
            bottom, right = min(top + BLOCK, rows.stop), min(left + BLOCK, columns.stop)
            block = self._read_block(slice(top, bottom), slice(left, right))
            window[top - rows.start : bottom - rows.start, left - columns.start : right - columns.start] = block
        return window

    def _read_block(self, rows: slice, columns: slice) -> np.ndarray:
        x, y = np.meshgrid(*(np.arange(part.start, part.stop) + 0.5 for part in (columns, rows)))
        corner, step = self._warp.corner, self._warp.step
        across, down = self._warp.to_image(corner[0] + step[0] * x, corner[1] + step[1] * y)
        height, width = self._source.shape[:2]
        is_inside = (across >= 0.0) & (across <= width) & (down >= 0.0) & (down <= height)
        result = np.zeros((*x.shape, 4), np.float32)
        if not is_inside.any():
            return result
        across, down = (np.clip(value[is_inside] - 0.5, 0.0, size - 1.0) for value, size in ((across, width), (down, height)))
        left, top = across.astype(np.int64), down.astype(np.int64)
        right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        first_row, first_column = int(top.min()), int(left.min())
        pixels = to_premultiplied(self._source.read(slice(first_row, int(bottom.max()) + 1), slice(first_column, int(right.max()) + 1)))
        part_x, part_y = ((value - start).astype(np.float32)[:, None] for value, start in ((across, left), (down, top)))
        above, below = (
            pixels[row - first_row, left - first_column] * (1.0 - part_x) + pixels[row - first_row, right - first_column] * part_x
            for row in (top, bottom)
        )
        colors = above * (1.0 - part_y) + below * part_y
        alpha = colors[:, 3:]
        colors[:, :3] = np.divide(colors[:, :3], alpha, out=np.zeros_like(colors[:, :3]), where=alpha > 0.0)
        result[is_inside] = colors
        return result
