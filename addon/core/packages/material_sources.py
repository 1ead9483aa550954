"""Materials as packages store them, with their images."""

from dataclasses import dataclass

import numpy as np

from ..imaging.colors import LINEAR_OF_BYTE
from ..imaging.mipmaps import Mipmaps, build_mipmaps
from .shading import DEFAULT_SHADING, Shading

WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class MaterialSource:
    """A material.

    Attributes:
        name: of the material.
        base_color: scene-linear RGBA, multiplied with the images of base color and opacity.
        is_double_sided: whether back faces show.
        images: (H, W, 3) uint8 by role (`manifest.ROLES`), row 0 at the bottom: base_color and emission sRGB-encoded, others as data; of
            these, all but normal have three equal channels.
        shading: its other factors.
    """

    name: str
    base_color: tuple[float, float, float, float]
    is_double_sided: bool
    images: dict[str, np.ndarray]
    shading: Shading = DEFAULT_SHADING


def build_color_mipmaps(image: np.ndarray | None, base_color: tuple[float, float, float, float]) -> Mipmaps | None:
    """Return the mipmaps of the colors that a base color image (H, W, 3) uint8 gives a surface, None without an image."""
    if image is None:
        return None
    mipmaps = build_mipmaps(image, LINEAR_OF_BYTE)
    if base_color[:3] != WHITE:
        np.multiply(mipmaps.texels, np.float32(base_color[:3]), out=mipmaps.texels)
    return mipmaps
