"""Images as packages store them, with 8 bits per channel, each read once."""

from collections.abc import Callable

import bpy
import numpy as np

from ...core.imaging.colors import LINEAR_OF_BYTE, encode_signed_srgb
from ...core.packages.textures.texture_errors import COLOR_ROLES
from ..imaging.color_spaces import SRGB, read_linear_pixels
from ..imaging.images import check_pixels, read_pixels
from ..shading.color_products import CHANNELS
from ..shading.texture_uses import TextureUse
from ..texmesh.color_images import MAX_SIDE as MAX_ANALYZED_SIDE
from ..texmesh.color_images import read_color_image, scaled_copy

MAX_SIDE = 8192  # pixels; larger images are scaled down


class PackageImages:
    """The images of the materials of an object. Materials that share an image get the same array, which packages then code once.

    All methods raise FileError if an image has no pixels, for instance because its file is missing.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], np.ndarray] = {}

    def read_colors(self, image: bpy.types.Image) -> np.ndarray:
        """Return the colors (H, W, 3) uint8 of an image, sRGB-encoded, row 0 at the bottom."""
        return self._keep(image, "colors", _read_colors)

    def read_analyzed(self, image: bpy.types.Image) -> tuple[np.ndarray, bool]:
        """Return what `read_color_image` returns, rounded like the image of the package if they have the same size."""
        if max(image.size) > MAX_ANALYZED_SIDE:
            return read_color_image(image)
        return LINEAR_OF_BYTE[self.read_colors(image)], False

    def read_role(self, role: str, use: TextureUse) -> np.ndarray:
        """Return the image (H, W, 3) uint8 that a material uses in a role of packages, row 0 at the bottom."""
        if role in COLOR_ROLES:
            return self.read_colors(use.image)
        if role == "normal":
            return self._keep(use.image, "data", _read_data)
        return self._keep(use.image, use.channel, lambda image: _repeat_channel(self._keep(image, "data", _read_data), image, use.channel))

    def _keep(self, image: bpy.types.Image, kind: str, read: Callable[[bpy.types.Image], np.ndarray]) -> np.ndarray:
        key = image.name_full, kind
        if key not in self._found:
            self._found[key] = read(image)
        return self._found[key]


def _read_colors(image: bpy.types.Image) -> np.ndarray:
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        if source.colorspace_settings.name == SRGB and not source.is_float:
            return _to_bytes(read_pixels(source)[..., :3])
        return _to_bytes(encode_signed_srgb(read_linear_pixels(source)[..., :3]))


def _read_data(image: bpy.types.Image) -> np.ndarray:
    check_pixels(image)
    with scaled_copy(image, MAX_SIDE) as source:
        return _to_bytes(read_linear_pixels(source)[..., :3])


def _repeat_channel(pixels: np.ndarray, image: bpy.types.Image, channel: str) -> np.ndarray:
    """Return a channel three times, or the mean of the colors. pixels: (H, W, 3) uint8 of the image."""
    if channel in CHANNELS:
        values = pixels[..., CHANNELS.index(channel)]
    elif channel == "Alpha":
        with scaled_copy(image, MAX_SIDE) as source:
            values = _to_bytes(read_pixels(source)[..., 3])
    else:
        values = np.rint(pixels.mean(axis=2)).astype(np.uint8)
    return np.repeat(values[..., None], 3, axis=2)


def _to_bytes(values: np.ndarray) -> np.ndarray:
    """Return values of 0 to 1 as bytes, a few rows at a time."""
    result = np.empty(values.shape, np.uint8)
    for source, target in zip(values, result, strict=True):
        target[:] = np.rint(255.0 * np.clip(source, 0.0, 1.0))
    return result
