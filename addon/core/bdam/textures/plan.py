"""The plan of a build of texture tiles."""

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ...errors import SettingsError
from ...imaging.coded_images import DEFAULT_QUALITY, ImageFormat
from ...json_values import integer, numbers, parse_json, text
from .grid import MAX_LEVELS, TextureGrid

MAX_SIZE = 2**30  # cells along the side of the root square
MIN_SPACING, MAX_SPACING = 1e-15, 1e9  # meters

# The overlap of WebP tiles, unlike that of JPEG tiles, is coded differently in each; below 95 the seams exceed 8/255 in photographs.
DEFAULT_QUALITIES = {"jpeg": DEFAULT_QUALITY, "webp": 95, "raw": DEFAULT_QUALITY, "lossless": DEFAULT_QUALITY}


@dataclass(frozen=True)
class TexturePlan:
    """What a build of the quadtree does: the same plan and the same images give the same bytes.

    Attributes:
        grid: the tiles.
        image_format: coding of tiles: jpeg, webp, raw, or lossless, which is WebP without loss.
        quality: 1 to 100, for jpeg and webp; None for that of DEFAULT_QUALITIES.
        error: error of a tile by itself: `magnification`, the size of its texels, or `feature`, the same only where replacing the
            texels of the next finer level loses visible detail; the largest size of the features that the tile loses.
    """

    grid: TextureGrid
    image_format: ImageFormat = "jpeg"
    quality: int | None = None
    error: str = "magnification"

    @property
    def coding_quality(self) -> int:
        """The quality that tiles are coded with."""
        return DEFAULT_QUALITIES[self.image_format] if self.quality is None else self.quality

    def to_json(self) -> bytes:
        """Return the plan as JSON text."""
        return json.dumps(asdict(self), indent=1).encode()


def parse_plan(content: bytes) -> TexturePlan:
    """Return the plan that JSON text describes.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: it describes none, or one out of range.
    """
    values = parse_json(content)
    values["grid"] = _parse_grid(values["grid"])
    plan = TexturePlan(**values)
    if plan.image_format not in tuple(DEFAULT_QUALITIES):
        raise ValueError("the format is unknown")
    if plan.quality is not None:
        integer(plan.quality, "quality", 1, 100)
    text(plan.error, "error")
    try:
        check_plan(plan)
    except SettingsError as error:
        raise ValueError("a setting is out of range") from error
    return plan


def _parse_grid(values: dict[str, Any]) -> TextureGrid:
    grid = TextureGrid(**values)
    for name in ("columns", "rows", "size"):
        integer(getattr(grid, name), name, 2, MAX_SIZE)
    integer(grid.level_count, "level_count", 1, MAX_LEVELS)
    return replace(grid, spacing=numbers(grid.spacing, "spacing", 2, MIN_SPACING, MAX_SPACING))


def check_plan(plan: TexturePlan) -> None:
    """Check the settings of a plan.

    Raises:
        SettingsError: one is out of range.
    """
    if plan.image_format not in DEFAULT_QUALITIES:
        raise SettingsError(f'Texture Format is "{plan.image_format}"; choose jpeg, webp, raw or lossless.', ("image_format",))
    if not 1 <= plan.coding_quality <= 100:
        raise SettingsError(f"Texture Quality is {plan.quality}; choose 1 to 100.", ("quality",))
    if plan.error not in ("magnification", "feature"):
        raise SettingsError(f'Texture Error is "{plan.error}"; choose magnification or feature.', ("error",))
    grid = plan.grid
    counts = (grid.columns, grid.rows, grid.size, grid.level_count)
    if not all(isinstance(count, int) for count in counts) or min(grid.extent) < 1 or max(grid.extent) > grid.size:
        raise SettingsError(f"A field of {grid.columns} x {grid.rows} samples does not fit into a square of {grid.size} cells.")
    if not 1 <= grid.level_count <= MAX_LEVELS or not all(0.0 < spacing < np.inf for spacing in grid.spacing):
        raise SettingsError(f"Texture cannot have {grid.level_count} levels at a spacing of {grid.spacing} m; check the field.")
