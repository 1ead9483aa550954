"""Pixels of Blender images for the restoration: stored values to display values with straight alpha, and back.

Stored values are those of `Image.pixels`. Colors of float images are scene-linear and premultiplied, all others are what the file holds.
"""

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.imaging.images import MIN_ALPHA

LINEAR_LIMIT, ENCODED_LIMIT = 0.0031308, 0.04045  # of the linear part of the sRGB curve
LUMINANCE = np.float32([0.2126, 0.7152, 0.0722])  # Rec.709


@dataclass(frozen=True)
class PixelFormat:
    """How an image stores its pixels.

    is_float: 32 or 16 bits per channel, otherwise 8. is_data: values are no colors. is_linear: colors are scene-linear. is_premultiplied:
    colors are multiplied by alpha.
    """

    is_float: bool
    is_data: bool
    is_linear: bool
    is_premultiplied: bool


def read_format(image: bpy.types.Image) -> PixelFormat:
    """Return how `image` stores its pixels; they must have been loaded."""
    is_data = image.colorspace_settings.is_data
    is_linear = image.is_float and not is_data
    return PixelFormat(image.is_float, is_data, is_linear, is_linear and image.alpha_mode in {"STRAIGHT", "PREMUL"})


def read_stored(image: bpy.types.Image) -> np.ndarray:
    """Return the stored values (H, W, 4) float32 of an image, or of its first tile, row 0 at the bottom.

    Gray becomes RGB, and missing alpha 1.
    """
    width, height = image.size
    channels = image.channels
    pixels = np.empty(width * height * channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, channels)
    if channels == 4:
        return pixels
    colors = pixels[..., :3] if channels == 3 else pixels[..., :1].repeat(3, axis=2)
    alpha = pixels[..., 1:] if channels == 2 else np.ones((height, width, 1), np.float32)
    return np.concatenate([colors, alpha], axis=2)


def to_display(stored: np.ndarray, pixel_format: PixelFormat) -> np.ndarray:
    """Return stored values (H, W, 4) as sRGB-encoded colors, or data, with straight alpha."""
    display = stored.copy()
    colors = display[..., :3]
    if pixel_format.is_premultiplied:
        alpha = display[..., 3:]
        colors /= np.where(alpha > MIN_ALPHA, alpha, 1.0)
    if pixel_format.is_linear:
        colors[...] = encode_signed_srgb(colors)
    return display


def to_stored(display: np.ndarray, pixel_format: PixelFormat) -> np.ndarray:
    """Invert `to_display`, for pixels (..., 4)."""
    stored = display.copy()
    if pixel_format.is_linear:
        stored[..., :3] = decode_signed_srgb(stored[..., :3])
    if pixel_format.is_premultiplied:
        stored[..., :3] *= stored[..., 3:]
    return stored


def encode_signed_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB values of scene-linear ones. The curve continues above 1 and is mirrored below 0, so that no value is lost."""
    size = np.abs(linear)
    return np.copysign(np.where(size <= LINEAR_LIMIT, 12.92 * size, 1.055 * size ** (1.0 / 2.4) - 0.055), linear).astype(np.float32)


def decode_signed_srgb(encoded: np.ndarray) -> np.ndarray:
    """Invert `encode_signed_srgb`."""
    size = np.abs(encoded)
    return np.copysign(np.where(size <= ENCODED_LIMIT, size / 12.92, ((size + 0.055) / 1.055) ** 2.4), encoded).astype(np.float32)


def is_bright(stored: np.ndarray, threshold: float) -> np.ndarray:
    """Return where (H, W) bool the luminance of stored values (H, W, 4) is above `threshold`. Transparent pixels are dark."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is too bright for a float is bright
        return (stored[..., :3] @ LUMINANCE) * stored[..., 3] > threshold


def has_color(display: np.ndarray, color: tuple[float, float, float], tolerance: float) -> np.ndarray:
    """Return where (H, W) bool every channel of display values (H, W, 4) differs from `color` by `tolerance` at most.

    Half a step of 8 bits is added, so that a tolerance of 0 finds the color that an 8-bit image rounds to.
    """
    return (np.abs(display[..., :3] - np.float32(color)) <= tolerance + 0.5 / 255.0).all(axis=2)
