"""Images of relightable materials: maps of texels and lookup tables, as half floats."""

import bpy
import numpy as np

from ....core.billboards.texels import Texels
from ....core.btf.tables import pack_weights
from ....core.imaging.images import dilate
from ...imaging.images import create_image

DILATION_TEXELS = 3  # Width of the margin around known texels.


def create_half_float_image(name: str, pixels: np.ndarray) -> bpy.types.Image:
    """Create an image of `pixels` (H, W, 4) that renderers read unchanged."""
    return create_image(name, pixels, is_data=True, half_floats=True)


def create_color_image(name: str, colors: np.ndarray, alpha: np.ndarray | None, texels: Texels, known: np.ndarray) -> bpy.types.Image:
    """Create an image of `colors` (N, 3) with `alpha` (N,), 1 if None, dilated around the texels in `known` (H, W)."""
    alpha = np.ones(len(colors), np.float32) if alpha is None else alpha
    return create_half_float_image(name, dilate(texels.to_image(np.column_stack([colors, alpha])), known, DILATION_TEXELS))


def create_weight_images(name: str, weights: np.ndarray) -> list[bpy.types.Image]:
    """Create the images of `weights` (H, W, K), see `pack_weights`."""
    return [create_half_float_image(f"{name} {index}", image) for index, image in enumerate(pack_weights(weights))]
