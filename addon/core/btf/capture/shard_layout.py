"""The arrays that a finished view of a bake must hold: the views of an interrupted bake may come from anyone."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .observations import SUBSAMPLES

ARRAYS = (
    "known",
    "coverage",
    "visible",
    "subsample_counts",
    "radiance",
    "emission",
    "reference_colors",
    "reference_coverage",
    "visibility",
)
HALF_FLOAT_EXPONENT = 0x7C00  # All bits of the exponent are set in infinities and NaN.


@dataclass(frozen=True)
class ShardLayout:
    """What determines the shapes of the arrays of a finished view.

    Attributes:
        texel_count: Number of texels.
        image_count: Number of renders that are stored per texel.
        reference_count: Number of colors of the reference image.
        resolution: Pixels per side of a render.
        view_count: Number of view directions of the whole bake.
        shadow_count: Number of its shadow directions.
    """

    texel_count: int
    image_count: int
    reference_count: int
    resolution: int
    view_count: int
    shadow_count: int

    def matches(self, view: int, arrays: Sequence[np.ndarray]) -> bool:
        """Whether `arrays`, in the order of ARRAYS, have the dtypes, shapes and ranges of those of a view, see `ShardStore.write`."""
        known, coverage, visible, subsample_counts, radiance, emission, reference_colors, reference_coverage, visibility = arrays
        texels, visible_count, side = self.texel_count, visible.size, self.resolution
        shadows_of_view = len(range(view, self.shadow_count, self.view_count))
        expected = (
            (known, np.uint8, (-(-texels // 8),)),
            (coverage, np.uint8, (texels,)),
            (visible, np.int32, (visible_count,)),
            (subsample_counts, np.uint8, (visible_count,)),
            (radiance, np.float16, (self.image_count, visible_count, 3)),
            (emission, np.float16, (visible_count if emission.size else 0, 3)),
            (reference_colors, np.float16, (self.reference_count, side, side, 3)),
            (reference_coverage, np.uint8, (side, side)),
            (visibility, np.uint8, (shadows_of_view, texels)),
        )
        if any(array.dtype != dtype or array.shape != shape for array, dtype, shape in expected):
            return False
        if visible_count and (visible[0] < 0 or visible[-1] >= texels or (np.diff(visible) <= 0).any()):
            return False
        if (subsample_counts > SUBSAMPLES**2).any():
            return False
        return all(_is_finite(array) for array in (radiance, emission, reference_colors))


def _is_finite(values: np.ndarray) -> bool:
    """Whether all `values` float16 are finite. Faster than `np.isfinite`, which converts them."""
    bits = np.ascontiguousarray(values).view(np.uint16)
    return not ((bits & HALF_FLOAT_EXPONENT) == HALF_FLOAT_EXPONENT).any()
