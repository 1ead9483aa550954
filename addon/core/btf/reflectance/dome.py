"""Fit of the lobes' response to a uniform dome: sky visibility per texel, and the Fresnel shape of the level.

A dome is reflected from all directions at once, by coats and the layers below, so the Fresnel effect is broader than under a sun; its shape
is found by trial. Crevices see less of a dome, but receive light from other surfaces instead: one number per texel covers both.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...geometry.direction_grids import DirectionGrid
from ...jobs.progress import Progress, Steps, subprogress
from ..factorization.als import ViewData
from .lobe_fit import MAX_RADIANCE
from .lobes import SCHLICK, GrazingFresnel, Lobes

POWERS = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
MAX_STRENGTH = 4.0  # Relative to Schlick's formula: coats and the layers below add up.
PRIOR = 0.01  # Weight of full sky visibility, relative to a mean texel.
MAX_SKY_VISIBILITY = 2.0  # Dome and interreflection together.


def fit_dome(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[Lobes]:
    """Return `lobes` with the sky visibility and dome Fresnel shape that fit `views` best, by least squares.

    Args:
        views: captured from the directions of `grid` under the dome alone, one column per channel. weights: (V, N) weight of each texel.
    """
    dome_fresnel = yield from subprogress(_fit_fresnel(views, lobes, grid, weights), 0.0, 0.5)
    lobes = replace(lobes, dome_fresnel=dome_fresnel)
    sky_visibility = yield from subprogress(_fit_sky_visibility(views, lobes, grid, weights), 0.5, 1.0)
    return replace(lobes, sky_visibility=sky_visibility)


def _fit_fresnel(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[GrazingFresnel]:
    """Return the power in POWERS, with its best strength, that has the least error over all texels."""
    without_grazing = replace(lobes, f90_minus_f0=np.zeros_like(lobes.f90_minus_f0))
    correlations, energies = np.zeros((2, len(POWERS)))
    for index, view in enumerate(views):
        yield Progress(index / len(views), "Fitting grazing reflection")
        direction = grid.directions[index]
        rows, values = view.read()
        residual = (_clamp_radiance(values) - without_grazing.radiance_under_dome(direction, rows)).mean(axis=1)
        grazing = lobes.f90_minus_f0[rows]
        if lobes.sky_visibility is not None:
            grazing = grazing * lobes.sky_visibility[rows]
        cosines = lobes.surface.normals_facing(direction, rows) @ direction
        row_weights = weights[index, rows].astype(np.float64)
        for candidate, power in enumerate(POWERS):
            response = grazing * GrazingFresnel(1.0, power)(cosines)
            correlations[candidate] += float(row_weights @ (response * residual))
            energies[candidate] += float(row_weights @ response**2)
    if not energies.all():
        return SCHLICK
    strengths = np.clip(correlations / energies, 0.0, MAX_STRENGTH)
    best = int(np.argmin(strengths * (strengths * energies - 2.0 * correlations)))
    return GrazingFresnel(float(strengths[best]), POWERS[best])


def _fit_sky_visibility(views: Sequence[ViewData], lobes: Lobes, grid: DirectionGrid, weights: np.ndarray) -> Steps[np.ndarray]:
    """Return the reflected fraction (N,) float32 of the dome."""
    unoccluded = replace(lobes, sky_visibility=None)
    correlations, energies = np.zeros((2, len(lobes.f90_minus_f0)))
    for index, view in enumerate(views):
        yield Progress(index / len(views), "Fitting sky visibility")
        rows, values = view.read()
        radiance = unoccluded.radiance_under_dome(grid.directions[index], rows)
        correlations[rows] += weights[index, rows] * (radiance * _clamp_radiance(values)).sum(axis=1)
        energies[rows] += weights[index, rows] * (radiance**2).sum(axis=1)
    prior = PRIOR * energies.mean()
    return np.clip((correlations + prior) / np.maximum(energies + prior, 1e-12), 0.0, MAX_SKY_VISIBILITY).astype(np.float32)


def _clamp_radiance(values: np.ndarray) -> np.ndarray:
    return np.clip(values, 0.0, MAX_RADIANCE)
