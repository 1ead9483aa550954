"""Images as glTF wants them: PNG or JPEG with sRGB-encoded colors, or data."""

from pathlib import Path

import bpy
import numpy as np

from ...core.imaging.coded_images import encode
from ...core.imaging.colors import encode_signed_srgb
from ...core.imaging.images import to_bytes, unpremultiply
from ..imaging.color_spaces import SRGB, read_linear_pixels
from ..imaging.images import INDEPENDENT_ALPHA, check_pixels, read_pixels

STORED = {"PNG", "JPEG"}  # file formats that glTF has


class GlbImages:
    """Images of materials, and the converted ones, each once."""

    def __init__(self) -> None:
        self._converted: dict[tuple[str, bool, bool], bpy.types.Image] = {}

    def prepare(self, image: bpy.types.Image, is_color: bool, is_opaque: bool = False) -> bpy.types.Image:
        """Return an image whose file Blender's exporter stores as glTF prescribes: the same one, or a converted one until `remove`.

        is_color: whether it has colors instead of data. is_opaque: whether its alpha must not be stored.

        Raises:
            FileError: it has no pixels, for instance because its file is missing, or cannot be read.
        """
        check_pixels(image)
        is_opaque = is_opaque and bool((read_pixels(image)[..., 3] < 1.0).any())
        if not is_opaque and _is_stored(image, is_color):
            return image
        key = image.name_full, is_color, is_opaque
        if key not in self._converted:
            self._converted[key] = _convert(image, is_color, is_opaque)
        return self._converted[key]

    def remove(self) -> None:
        """Remove the converted images."""
        bpy.data.batch_remove(list(self._converted.values()))
        self._converted.clear()


def _is_stored(image: bpy.types.Image, is_color: bool) -> bool:
    """Return whether Blender's exporter stores the values of an image that renders see, encoded as glTF prescribes."""
    if image.source not in ("FILE", "GENERATED") or (is_color and image.colorspace_settings.name != SRGB):
        return False
    return image.file_format in STORED if image.source == "FILE" else not image.is_float


def _convert(image: bpy.types.Image, is_color: bool, is_opaque: bool) -> bpy.types.Image:
    """Return a packed PNG file of the first frame or tile of an image."""
    result = bpy.data.images.new(Path(image.name).stem, 1, 1)
    pixels = _read_colors(image) if is_color else read_pixels(image)
    content = encode(to_bytes(pixels if (pixels[..., 3] < 1.0).any() and not is_opaque else pixels[..., :3]), "png")
    result.pack(data=content, data_len=len(content))
    result.source = "FILE"
    result.colorspace_settings.name = SRGB if is_color else "Non-Color"
    return result


def _read_colors(image: bpy.types.Image) -> np.ndarray:
    """Return the pixels (H, W, 4) of an image with sRGB-encoded colors that are not multiplied with alpha."""
    if not image.is_float and image.colorspace_settings.name == SRGB:
        return read_pixels(image)
    pixels = read_linear_pixels(image)
    if image.is_float and image.alpha_mode not in INDEPENDENT_ALPHA:
        pixels = unpremultiply(pixels)
    return np.concatenate([encode_signed_srgb(pixels[..., :3]), pixels[..., 3:]], axis=2)
