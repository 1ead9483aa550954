"""Reference images of the source: silhouettes, and colors under low-order lights. Silhouettes are refined against them."""

from dataclasses import dataclass

import numpy as np

from ...geometry.direction_grids import DirectionGrid
from .observations import ViewRender

LOW_ORDER_LIGHTS = 5  # The constant and the three linear spherical harmonics of the suns, and the dome.


@dataclass(frozen=True)
class ReferenceImage:
    """The source from one view. colors (M, H, W, 3) float32: premultiplied, under M low-order lights. coverage (H, W) float32."""

    colors: np.ndarray
    coverage: np.ndarray


def low_order_lights(grid: DirectionGrid) -> np.ndarray:
    """Return five lights (L + 1, 5) as weights of the suns of `grid` and of the dome. Such sums hardly contain noise.

    The columns are the constant and the three linear spherical harmonics of the suns (negative weights subtract), and the dome.
    """
    lights = np.zeros((len(grid) + 1, LOW_ORDER_LIGHTS), np.float32)
    lights[:-1, :4] = grid.solid_angles[:, None] * np.column_stack([np.ones(len(grid)), grid.directions])
    lights[-1, 4] = 1.0
    return lights


def compute_reference_image(render: ViewRender, lights: np.ndarray) -> ReferenceImage:
    """Return `render` under `lights` (L, M), weights of its images; see `low_order_lights`."""
    return ReferenceImage(np.einsum("lhwc,lm->mhwc", render.radiance, lights, optimize=True), render.coverage)
