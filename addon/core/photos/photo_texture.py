"""The result of merging photographs."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .photographs.color_correction import ColorCorrection
from .texels.hole_filling import HoleCounts
from .texels.painter import NO_PHOTOGRAPH


class TexturePage(NamedTuple):
    """The images of one page, as in `PhotoTexture`, with as many rows as columns."""

    colors: np.ndarray
    confidence: np.ndarray
    source: np.ndarray
    holes: np.ndarray

    @property
    def texel_count(self) -> int:
        """The number of texels on the surface."""
        return int(np.count_nonzero(self.holes | (self.source != NO_PHOTOGRAPH)))


@dataclass(frozen=True)
class PhotoTexture:
    """The result of `merge`. Images stack the pages, the first at the bottom: H = P * W.

    Attributes:
        colors: (H, W, 3) float32, sRGB-encoded, row 0 at the bottom.
        confidence: (H, W) float32, 0 to 1, the pixels per texel along one axis of the best photograph.
        source: (H, W) int16, the photograph with the largest weight, -1 for none.
        holes: (H, W) bool, covered texels that no photograph shows.
        color_corrections: those of the K photographs.
        labels: (T,) the photograph of each triangle, -1 for none.
        hole_counts: if they were restored.
        seconds: by stage.
        stages: pictures (H, W, 3) by name, if requested: `used NAME` for each photograph, `classes`, `photographed`, `interpolated`.
    """

    colors: np.ndarray
    confidence: np.ndarray
    source: np.ndarray
    holes: np.ndarray
    color_corrections: list[ColorCorrection]
    labels: np.ndarray
    hole_counts: HoleCounts | None
    seconds: dict[str, float]
    stages: dict[str, np.ndarray]

    def page(self, index: int) -> TexturePage:
        """Return the images of one page."""
        size = self.colors.shape[1]
        rows = slice(index * size, (index + 1) * size)
        return TexturePage(self.colors[rows], self.confidence[rows], self.source[rows], self.holes[rows])
