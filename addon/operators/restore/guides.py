"""Mask images of a restoration, as arrays per tile or frame."""

from dataclasses import dataclass

import bpy
import numpy as np

from ...bridge.imaging.images import read_pixels
from ...bridge.objects import find_by_uid
from ...bridge.restore.image_pixels import has_color, is_bright, read_format, to_display
from ...bridge.restore.image_sources import check_image, find_image, list_frames, load_frame, read_tiles, tile_sizes
from ...core.errors import FarfieldError, ImageError
from ...core.restore.settings import MaskSettings

UNTILED = 0  # the number of an image without tiles among tiles
BRIGHT = 0.5  # luminance above which a pixel of a source or barrier mask counts


@dataclass(frozen=True)
class Guides:
    """The masks of one image, tile or frame, (H, W) bool: the missing pixels (None: marked by the image itself), where texture may be
    copied from, and what diffusion does not cross."""

    mask: np.ndarray | None
    source_mask: np.ndarray | None = None
    barriers: np.ndarray | None = None


class MaskReader:
    """Reads one mask image.

    name: of the image. label: of its setting. threshold: of the luminance. source: the image that is restored; if that has tiles, the mask
    needs tiles as well. Raises ImageError or FileError.
    """

    def __init__(self, name: str, label: str, threshold: float, source: bpy.types.Image) -> None:
        image = find_image(name, label)
        check_image(image)
        if (image.source == "TILED") != (source.source == "TILED"):
            tiled, other = (source, image) if source.source == "TILED" else (image, source)
            raise ImageError(
                f'"{tiled.name}" has UDIM tiles, but "{other.name}" has none; choose another image for {label}, with the same tiles.'
            )
        self.name, self._label, self._threshold, self._uid = name, label, threshold, image.session_uid
        self._frames = list_frames(image) if image.source == "SEQUENCE" else {}
        self._tiles = {} if self._frames else {number: is_bright(tile, threshold) for number, tile in read_tiles(image).items()}

    def read(self, number: int, shape: tuple[int, int], part: str) -> np.ndarray | None:
        """Return the mask (H, W) bool for the tile or frame `number` with `shape` (H, W), None if there is none. Not in a thread.

        part: names the tile or frame in messages. Raises ImageError or FileError.
        """
        mask = self._tiles.get(number, self._tiles.get(UNTILED))
        if number in self._frames:
            image = find_by_uid(bpy.data.images, self._uid)
            if image is None:
                raise ImageError(f'The image "{self.name}" was removed while it was in use; nothing was changed.')
            with load_frame(image, self._frames[number]) as frame:
                mask = is_bright(read_pixels(frame), self._threshold)
        if mask is not None and mask.shape != shape:
            sizes = [f"{width} x {height}" for height, width in (mask.shape, shape)]
            raise ImageError(f'{self._label} "{self.name}" has {sizes[0]} pixels, but {part} has {sizes[1]}; scale one of them.')
        return mask


class GuideReader:
    """Reads all masks that `settings` name for the image `source`. Raises ImageError or FileError."""

    def __init__(self, settings: MaskSettings, source: bpy.types.Image) -> None:
        self._name = source.name
        self._mask = None
        if settings.mask == "image":
            if not settings.mask_image:
                raise ImageError(f'Choose a mask image for "{source.name}", or create one with Create Mask.')
            self._mask = MaskReader(settings.mask_image, "Mask Image", settings.threshold, source)
        self._source_mask = MaskReader(settings.source_mask, "Source Mask", BRIGHT, source) if settings.source_mask else None
        self._barriers = MaskReader(settings.barriers, "Barriers", BRIGHT, source) if settings.barriers else None

    def read(self, number: int, shape: tuple[int, ...], part: str = "") -> Guides | None:
        """Return the masks for the tile or frame `number` of the pixels `shape` (H, W, C), None if no mask marks missing pixels there.

        part: names the tile or frame in messages, by default the image.
        """
        part = f'{part} of "{self._name}"' if part else f'"{self._name}"'
        masks = [
            None if reader is None else reader.read(number, shape[:2], part) for reader in (self._mask, self._source_mask, self._barriers)
        ]
        return None if masks[0] is None and self._mask is not None else Guides(*masks)


def find_missing(stored: np.ndarray, display: np.ndarray, settings: MaskSettings) -> np.ndarray:
    """Return the pixels (H, W) bool of an image, as stored and as display values (H, W, 4), that the image itself marks as missing."""
    if settings.mask == "alpha":
        return stored[..., 3] < settings.threshold
    return has_color(display, settings.mask_color, settings.color_tolerance)


def find_shown_masks(image: bpy.types.Image, settings: MaskSettings) -> dict[int, np.ndarray]:
    """Return the missing pixels (H, W) bool of an image by tile number, as far as the mask fits the image. For an image sequence, those of
    the frame that is loaded, if there is one mask for all frames."""
    if 0 in image.size:
        return {}
    try:
        if settings.mask == "image":
            reader = MaskReader(settings.mask_image, "Mask Image", settings.threshold, image)
            masks = {number: reader.read(number, size[::-1], "the image") for number, size in tile_sizes(image).items()}
            return {number: mask for number, mask in masks.items() if mask is not None}
        tiles, pixel_format = read_tiles(image), read_format(image)
        return {number: find_missing(stored, to_display(stored, pixel_format), settings) for number, stored in tiles.items()}
    except FarfieldError:
        return {}  # the panel shows why
