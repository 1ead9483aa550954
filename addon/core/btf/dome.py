"""What an even dome makes of lobes: how much of it comes back from each texel, and how much more at the rim.

A dome is mirrored from all sides at once, by coats and what lies under them, so the rim is broader than under a sun; its shape is found by
trying. Crevices see less of a dome, and light from other surfaces comes in its place: both are one number a texel.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..direction_grids import DirectionGrid
from ..progress import Progress, Steps, scaled
from .alternation import ViewData
from .lobes import SCHLICK, WHITE, Grazing, Lobes

POWERS = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
MOST_GRAZING = 4.0  # times what Schlick's formula has at the rim: coats and what lies under them add up
PRIOR, MOST_OPEN = 0.01, 2.0  # of what a texel tells in the mean; and the light of all other surfaces together with the dome's own


def under_dome(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[Lobes]:
    """`lobes` with the openness and the grazing under a dome that come nearest to what `views` saw, least squares.

    Args:
        views: of the directions of `grid`, under the dome alone, one column a channel. weights: (V, N), what each texel counts.
    """
    grazing = yield from scaled(_fitted_grazing(views, lobes, grid, weights), 0.0, 0.5)
    shaped = replace(lobes, grazing=grazing)
    openness = yield from scaled(_fitted_openness(views, shaped, grid, weights), 0.5, 1.0)
    return replace(shaped, openness=openness)


def _fitted_grazing(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[Grazing]:
    """The power of POWERS, and the strength with it, that leave least error over all texels."""
    matt = replace(lobes, rim=np.zeros_like(lobes.rim))
    shown, full = np.zeros((2, len(POWERS)))
    for place, view in enumerate(views):
        yield Progress(place / len(views), "Looking at the rims")
        direction = grid.directions[place]
        index, values = view.read()
        missing = (_seen(values) - matt.of_dome(direction, index)).mean(axis=1)
        open_rim = lobes.rim[index] if lobes.openness is None else lobes.rim[index] * lobes.openness[index]
        cosines = lobes.surface.towards(direction, index) @ direction
        counting = weights[place, index].astype(np.float64)
        for number, power in enumerate(POWERS):
            shape = open_rim * Grazing(1.0, power)(cosines)
            shown[number] += float(counting @ (shape * missing))
            full[number] += float(counting @ shape**2)
    if not full.all():
        return SCHLICK
    strengths = np.clip(shown / full, 0.0, MOST_GRAZING)
    best = int(np.argmin(strengths * (strengths * full - 2.0 * shown)))
    return Grazing(float(strengths[best]), POWERS[best])


def _fitted_openness(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[np.ndarray]:
    """How much of a dome (N,) float32 comes back."""
    whole = replace(lobes, openness=None)
    shown, full = np.zeros((2, len(lobes.rim)))
    for place, view in enumerate(views):
        yield Progress(place / len(views), "Looking for crevices")
        index, values = view.read()
        made = whole.of_dome(grid.directions[place], index)
        shown[index] += weights[place, index] * (made * _seen(values)).sum(axis=1)
        full[index] += weights[place, index] * (made**2).sum(axis=1)
    prior = PRIOR * full.mean()
    return np.clip((shown + prior) / np.maximum(full + prior, 1e-12), 0.0, MOST_OPEN).astype(np.float32)


def _seen(values: np.ndarray) -> np.ndarray:
    """What texels show (M, 3) of a dome, up to white."""
    return np.clip(values, 0.0, WHITE)
