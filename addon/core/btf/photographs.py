"""What an original looks like from a view as a whole: its silhouette, and colours under broad lights. Textures are refined by it."""

from dataclasses import dataclass

import numpy as np

from ..direction_grids import DirectionGrid
from .texels import Picture


@dataclass(frozen=True)
class Photograph:
    """The original from one view. colours (M, H, W, 3) float32: premultiplied, under M broad lights; coverage (H, W) float32."""

    colours: np.ndarray
    coverage: np.ndarray


def broad_lights(grid: DirectionGrid) -> np.ndarray:
    """Five broad lights (L + 1, 5) as sums over the suns of `grid` and the dome, which hardly have noise.

    All suns together, suns by how far they stand towards x, y and z (negative ones subtract), and the dome.
    """
    made = np.zeros((len(grid) + 1, 5), np.float32)
    made[:-1, :4] = grid.solid_angles[:, None] * np.column_stack([np.ones(len(grid)), grid.directions])
    made[-1, 4] = 1.0
    return made


def photograph_of(picture: Picture, lights: np.ndarray) -> Photograph:
    """`picture` under `lights`, see `broad_lights`."""
    return Photograph(np.einsum("lhwc,lm->mhwc", picture.radiance, lights, optimize=True), picture.coverage)
