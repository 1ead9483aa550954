"""Alignment of photographs to each other against doubled details: each is warped a little, so that it shows the surface where the mean of
all photographs does.

Matches of blocks (see `matching`) are smoothed over the photograph. A photograph moves by the fraction that the others have in the mean
of all, so that the mean stays where it is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from ...files.scratch import Scratch
from ...jobs.progress import Progress, Steps, subprogress
from ..photographs.consistency import count_cells
from ..photographs.photograph import Photograph
from ..photographs.surface import Surface
from ..photographs.views import View
from .matching import Matches, make_grays, match_others

ROUNDS = 2
CELLS = 128  # along the longer side of a photograph
SMOOTHING = 2.0  # standard deviation in cells of the displacements, about half a block
FADING = 0.02  # confidence that a displacement of zero has everywhere


def align(
    photographs: Sequence[Photograph], views: Sequence[View], gains: np.ndarray, surface: Surface, scratch: Scratch
) -> Steps[list[Photograph]]:
    """Return the photographs with displacements that make them show the surface at the same places.

    gains: (K, 3) that adjust their exposures. `scratch` keeps what belongs to a photograph in its group.
    """
    grays = yield from subprogress(make_grays(photographs, views, gains, scratch), 0.0, 0.1)
    for turn in range(ROUNDS):
        fields = []
        for index, gray in enumerate(grays):
            yield Progress(0.1 + 0.9 * (turn + index / len(grays)) / ROUNDS, "Aligning photographs")
            change = smooth_displacements(match_others(grays, index, surface, scratch), gray.size)
            fields.append(change if gray.displacements is None else gray.displacements + change)
        grays = [replace(gray, displacements=field) for gray, field in zip(grays, fields, strict=True)]
    return [photograph.displace(gray.displacements) for photograph, gray in zip(photographs, grays, strict=True)]


def smooth_displacements(matches: Matches, size: tuple[int, int]) -> np.ndarray:
    """Return displacements (h, w, 2) float32 in pixels for cells that divide a photograph of `size` evenly: the smoothed fractions of those
    of `matches`, and zero far from all of them."""
    columns, rows = count_cells(size, CELLS)
    x, y = np.clip((matches.positions / np.array(size) * (columns, rows)).astype(np.int64), 0, (columns - 1, rows - 1)).T
    weighted = np.column_stack([matches.displacements * matches.fractions[:, None], np.ones(len(x))]) * matches.confidences[:, None]
    sums = [
        gaussian_filter(np.bincount(y * columns + x, values, rows * columns).reshape(rows, columns), SMOOTHING, mode="constant")
        for values in weighted.T
    ]
    peak = 1.0 / (2.0 * np.pi * SMOOTHING**2)  # where one certain match was smoothed
    return (np.stack(sums[:2], axis=-1) / (sums[2] + FADING * peak)[..., None]).astype(np.float32)
