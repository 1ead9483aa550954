"""Materials as packages store them, with their images."""

from dataclasses import dataclass

import numpy as np

from ...imaging.colors import decode_signed_srgb
from ...imaging.mipmaps import Mipmaps, build_mipmaps

LINEAR_OF_BYTE = decode_signed_srgb(np.arange(256) / 255.0).astype(np.float32)


@dataclass(frozen=True, eq=False)
class MaterialSource:
    """A material.

    base_color: scene-linear RGBA, multiplied with the base color image. images: (H, W, 3) uint8 by role (`manifest.ROLES`), row 0 at the
    bottom: base_color and emission sRGB-encoded, others as data; roughness, metallic and occlusion have three equal channels.
    """

    name: str
    base_color: tuple[float, float, float, float]
    is_double_sided: bool
    images: dict[str, np.ndarray]


def decode_colors(image: np.ndarray) -> np.ndarray:
    """Return the scene-linear colors float32 of an sRGB-encoded `image` uint8 of any shape."""
    return LINEAR_OF_BYTE[image]


def build_color_mipmaps(image: np.ndarray | None, base_color: tuple[float, float, float, float]) -> Mipmaps | None:
    """Return the mipmaps of the colors that a base color image gives a surface, None without an image."""
    return None if image is None else build_mipmaps(decode_colors(image) * np.float32(base_color[:3]))
