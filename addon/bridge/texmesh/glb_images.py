"""Images for glTF files: the files that they come from, or PNG files with the colors and the opacity that a material uses."""

from pathlib import Path

import bpy
import numpy as np

from ...core.files.file_access import is_file, read_file
from ...core.files.glb import IMAGE_TYPES
from ...core.imaging.coded_images import encode
from ...core.imaging.colors import LUMINANCE, encode_signed_srgb
from ...core.imaging.images import sample_bilinear, to_bytes, unpremultiply
from ..imaging.color_spaces import SRGB, read_linear_pixels
from ..imaging.images import INDEPENDENT_ALPHA, check_pixels, find_path, read_pixels
from ..shading.color_products import CHANNELS
from ..shading.texture_uses import TextureUse


def read_used_image(color: TextureUse | None, alpha: TextureUse | None, is_opaque: bool) -> bytes:
    """Return an image with the colors of `color` and the opacity of `alpha` as PNG or JPEG; white or opaque where one is None.

    is_opaque: whether the material is, so that alpha in the file does no harm.

    Raises:
        FileError: see `read_coded_image`.
    """
    is_stored = color is not None and color.channel == "Color" and (is_opaque if alpha is None else _is_own_alpha(color, alpha))
    if is_stored:
        return read_coded_image(color.image)
    images = [use.image for use in (color, alpha) if use is not None]
    for image in images:
        check_pixels(image)
    width, height = (max(image.size[axis] for image in images) for axis in (0, 1))
    result = np.full((height, width, 4), 255, np.uint8)
    if color is not None:
        result[..., :3] = to_bytes(_read_colors(color, (width, height)))
    if alpha is not None:
        result[..., 3] = to_bytes(_read_opacity(alpha, (width, height)))
    return encode(result[..., :3] if alpha is None else result, "png")


def read_coded_image(image: bpy.types.Image) -> bytes:
    """Return an image as PNG or JPEG: as it is packed or on the disk if it is one with sRGB colors, otherwise converted to PNG.

    Raises:
        FileError: it has no pixels, for instance because its file is missing, or cannot be read.
    """
    check_pixels(image)
    if image.source == "FILE" and not image.is_dirty and image.colorspace_settings.name == SRGB:
        content = _read_content(image)
        if any(content.startswith(start) for start in IMAGE_TYPES):
            return content
    pixels = _read_encoded(image)
    has_alpha = bool((pixels[..., 3] < 1.0).any())
    return encode(to_bytes(pixels if has_alpha else pixels[..., :3]), "png")


def _is_own_alpha(color: TextureUse, alpha: TextureUse) -> bool:
    """Return whether the file of an image has its colors, not multiplied with its opacity, and the opacity of `alpha`."""
    image = color.image
    return image == alpha.image and alpha.channel == "Alpha" and image.alpha_mode != "NONE" and not image.is_float


def _read_content(image: bpy.types.Image) -> bytes:
    """Return the file of an image, b"" if there is none although it has pixels."""
    if image.packed_files:
        return image.packed_files[0].packed_file.data
    path = Path(find_path(image))
    return read_file(path) if is_file(path) else b""


def _read_encoded(image: bpy.types.Image) -> np.ndarray:
    """Return the pixels (H, W, 4) of an image with sRGB-encoded colors."""
    if not image.is_float and image.colorspace_settings.name == SRGB:
        return read_pixels(image)
    pixels = read_linear_pixels(image)
    return np.concatenate([encode_signed_srgb(pixels[..., :3]), pixels[..., 3:]], axis=2)


def _read_colors(use: TextureUse, size: tuple[int, int]) -> np.ndarray:
    """Return sRGB-encoded colors (H, W, 3) of an image that is scaled to a size, not multiplied with its opacity."""
    if use.channel == "Color" and not use.image.is_float:
        return _resize(_read_encoded(use.image)[..., :3], size)
    pixels = read_linear_pixels(use.image)
    if use.image.is_float and use.image.alpha_mode not in INDEPENDENT_ALPHA:
        pixels = unpremultiply(pixels)
    colors = pixels[..., :3] if use.channel == "Color" else np.repeat(_pick(pixels, use.channel)[..., None], 3, axis=2)
    return encode_signed_srgb(_resize(colors, size))


def _read_opacity(use: TextureUse, size: tuple[int, int]) -> np.ndarray:
    """Return the values (H, W) of a channel of an image that is scaled to a size."""
    if use.channel == "Alpha" and use.image.alpha_mode == "NONE":
        return np.ones(size[::-1], np.float32)
    return _resize(_pick(read_linear_pixels(use.image), use.channel)[..., None], size)[..., 0]


def _resize(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return an image (H, W, C) enlarged to a size, by bilinear samples."""
    if values.shape[1::-1] == size:
        return values
    columns, rows = ((np.arange(count) + 0.5) * old / count for count, old in zip(size, values.shape[1::-1], strict=True))
    positions = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return sample_bilinear(values, positions).reshape(size[1], size[0], values.shape[2])


def _pick(pixels: np.ndarray, channel: str) -> np.ndarray:
    """Return a channel (H, W) of linear pixels (H, W, 4), or their luminance."""
    if channel == "Color":
        return pixels[..., :3] @ LUMINANCE
    return pixels[..., 3 if channel == "Alpha" else CHANNELS.index(channel)]
