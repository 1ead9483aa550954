"""The tasks of a build that make texture tiles, and the files of the work folder that they need."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...files.sealed_files import read_sealed, write_sealed
from ...files.segment_cache import SegmentCache
from ..textures.build import build_tiles
from ..textures.images import PlacedImage
from ..textures.plan import read_plan
from .ground_images import GroundImage, open_image
from .height_grid import HeightGrid
from .work_folder import ADVICE, WorkFolder

TEXTURE_TASK = "texture"  # first element of the items of these tasks
IMAGES_FILE, TEXTURES_FOLDER = "images.json", "textures"
CACHE_BYTES = 48 << 20  # of decoded parts of TIFF files, per worker


class KnownSamples:
    """An image source: a pixel per sample of a field, (rows, columns, 4) uint8, whose alpha is 0 where the height is unknown, else 255."""

    def __init__(self, grid: HeightGrid) -> None:
        self.shape, self._grid = (grid.rows, grid.columns, 4), grid

    def read(self, rows: slice, columns: slice) -> np.ndarray:
        """Return a window (h, w, 4) uint8. Raises FileError."""
        _, is_known = self._grid.read(rows, columns)
        pixels = np.zeros((*is_known.shape, 4), np.uint8)
        pixels[..., 3] = np.where(is_known, 255, 0)
        return pixels


@dataclass(frozen=True)
class TextureTasks:
    """Builds texture tiles of a build in its work folder."""

    folder: WorkFolder

    def run(self, level: int, tiles: Sequence[Sequence[int]]) -> None:
        """Build the tiles [i, j] of a level of the quadtree; all tiles of the finer level must be built.

        Raises:
            FileError: an image cannot be read, or a file cannot be written.
        """
        textures = textures_folder(self.folder)
        is_finest = level == read_plan(textures).grid.level_count - 1
        images, mask = self._images if is_finest else ([], None)
        build_tiles(textures, level, np.array(tiles), images, mask)

    @cached_property
    def _images(self) -> tuple[list[PlacedImage], PlacedImage | None]:
        """The images, and the mask of known heights, None where all are known."""
        content = json.loads(read_sealed(self.folder.path / IMAGES_FILE, ADVICE))
        cache = SegmentCache(CACHE_BYTES)
        images = [open_image(GroundImage(**image), self.folder.path, cache) for image in content["images"]]
        mask = PlacedImage(KnownSamples(self.folder.grid), (-0.5, -0.5), (1.0, 1.0)) if content["has_holes"] else None
        return images, mask


def write_images_file(folder: WorkFolder, images: Sequence[GroundImage], has_holes: bool) -> None:
    """Write what the tasks need to know about the images. Raises FileError."""
    content = {"images": [asdict(image) for image in images], "has_holes": has_holes}
    write_sealed(folder.path / IMAGES_FILE, json.dumps(content, sort_keys=True).encode())


def textures_folder(folder: WorkFolder) -> Path:
    """Return the folder of the texture tiles of a build."""
    return folder.path / TEXTURES_FOLDER
