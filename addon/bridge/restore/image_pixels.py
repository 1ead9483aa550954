"""Pixels of Blender images for the restoration: stored values to display values with straight alpha, and back.

Stored values are those of `Image.pixels`. Colors of float images are scene-linear and premultiplied, all others are what the file holds.
"""

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.imaging.colors import LUMINANCE, decode_signed_srgb, encode_signed_srgb
from ...core.imaging.images import MIN_ALPHA


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


def is_bright(stored: np.ndarray, threshold: float) -> np.ndarray:
    """Return where (H, W) bool the luminance of stored values (H, W, 4) is above `threshold`. Transparent pixels are dark."""
    with np.errstate(over="ignore", invalid="ignore"):  # what is too bright for a float is bright
        return (stored[..., :3] @ LUMINANCE) * stored[..., 3] > threshold


def has_color(display: np.ndarray, color: tuple[float, float, float], tolerance: float) -> np.ndarray:
    """Return where (H, W) bool every channel of display values (H, W, 4) differs from `color` by `tolerance` at most.

    Half a step of 8 bits is added, so that a tolerance of 0 finds the color that an 8-bit image rounds to.
    """
    return (np.abs(display[..., :3] - np.float32(color)) <= tolerance + 0.5 / 255.0).all(axis=2)
