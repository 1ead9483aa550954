"""Fit of the reflectance model to captured radiance: bounded linear least squares per texel, with priors from its quad and its level.

The response to a uniform dome is fitted last. A dome is reflected from all directions at once, by coats and the layers below, so the
Fresnel effect is broader than under a sun; its shape is found by trial. Crevices see less of a dome, but receive light from other surfaces
instead: one number per texel covers both.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.directions import DirectionGrid
from ...jobs.chunks import map_ordered, slices
from ...jobs.progress import Progress, Steps, subprogress
from ..factorization.als import ViewData, split_lights
from .disc_lights import DiscLights
from .lobes import CHUNK_TEXELS, DIFFUSE, GRAZING, SCHLICK, SPECULAR, GrazingFresnel, Lobes, TexelSurface, lobe_responses

SUN_OFFSET, DOME_OFFSET = 3, 4  # Coefficients of radiance that no lobe explains, under suns and under the dome; they are dropped.
MAX_COEFFICIENTS = np.array([1.0, 1.0, 1.0, 10.0, 10.0])
MAX_RADIANCE = 1.0  # Captured radiance is clamped to it.
QUAD_PRIOR, LEVEL_PRIOR = 0.1, 1.0  # Weight of the quad for its texels, and of the level for its quads, relative to a mean texel.
MAX_ITERATIONS, TOLERANCE = 60, 1e-6  # They end the coordinate descent.
ROUGHNESS_FACTORS = (0.5, 0.7, 1.0, 1.4)  # Times the roughness in the PBR maps: a coat is smoother, bumps and large texels are rougher.
SAMPLE_TEXELS = 2000  # By which the factor is chosen.
FRESNEL_POWERS = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0)
MAX_FRESNEL_STRENGTH = 4.0  # Relative to Schlick's formula: coats and the layers below add up.
SKY_PRIOR = 0.01  # Weight of full sky visibility, relative to a mean texel.
MAX_SKY_VISIBILITY = 2.0  # Dome and interreflection together.


@dataclass(frozen=True)
class CapturedRadiance:
    """Captured radiance and its weights.

    Attributes:
        views: Columns light by light, the dome last, three channels each.
        grid: The view directions.
        suns: The lights.
        weights: (V, N) of each texel in each view.
        light_weights: (L + 1,).
    """

    views: Sequence[ViewData]
    grid: DirectionGrid
    suns: DiscLights
    weights: np.ndarray
    light_weights: np.ndarray


def fit_lobes(captured: CapturedRadiance, surface: TexelSurface, quad_indices: np.ndarray) -> Steps[Lobes]:
    """Fit lobes to `captured` by least squares, with all coefficients bounded to 0..1.

    Texels that few views show follow their quad (`quad_indices` (N,)), and quads follow the level. The roughness is that of `surface` times
    the one of ROUGHNESS_FACTORS with the least error over all texels.
    """
    count = len(quad_indices)
    sample = np.arange(0, count, max(1, count // SAMPLE_TEXELS))
    candidates = [replace(surface, roughness=factor * surface.roughness) for factor in ROUGHNESS_FACTORS]
    problems = [_NormalEquations(candidate, sample) for candidate in candidates]
    yield from subprogress(_accumulate(problems, captured), 0.0, 0.3)
    errors = [problem.squared_error(problem.solve(quad_indices[sample])) for problem in problems]
    best = candidates[int(np.argmin(errors))]
    problem = _NormalEquations(best, np.arange(count))
    yield from subprogress(_accumulate([problem], captured), 0.3, 1.0)
    solution = problem.solve(quad_indices).astype(np.float32)
    return Lobes(best, solution[:, DIFFUSE], solution[:, SPECULAR], solution[:, GRAZING].mean(axis=1))


def fit_responses(surface: TexelSurface, view: np.ndarray, suns: DiscLights, rows: np.ndarray) -> np.ndarray:
    """Return the radiance (M, L + 1, 5) float32 of `rows` for coefficients of 1: the lobes, SUN_OFFSET and DOME_OFFSET."""
    responses = lobe_responses(surface, view, suns, rows, len(MAX_COEFFICIENTS))
    responses[:, :-1, SUN_OFFSET] = responses[:, -1, DOME_OFFSET] = 1.0
    return responses


def _accumulate(problems: Sequence["_NormalEquations"], captured: CapturedRadiance) -> Steps[None]:
    """Add all captured views to each of `problems`."""

    def compute_terms(view: int) -> list[_Terms]:
        rows, values = captured.views[view].read()
        return [problem.compute_terms(captured, view, rows, values) for problem in problems]

    captured.suns.build_tables()
    for view, terms in enumerate(map_ordered(compute_terms, range(len(captured.views)))):
        yield Progress(view / len(captured.views), "Fitting highlights")
        for problem, problem_terms in zip(problems, terms, strict=True):
            problem.add(problem_terms)


@dataclass(frozen=True)
class _Terms:
    """Terms of one view in the normal equations of the texels `indices` (M,) int: normal (M, K, K) and rhs (M, K, 3) float32, and the
    weighted sum of squared values."""

    indices: np.ndarray
    normal: np.ndarray
    rhs: np.ndarray
    squared_sum: float


class _NormalEquations:
    """Normal equations of the texels `rows` of a surface, accumulated view by view."""

    def __init__(self, surface: TexelSurface, rows: np.ndarray) -> None:
        size = len(MAX_COEFFICIENTS)
        self._surface, self._indices = surface, np.full(len(surface.roughness), -1)
        self._indices[rows] = np.arange(len(rows))
        self._normal, self._rhs = np.zeros((len(rows), size, size)), np.zeros((len(rows), size, 3))
        self._squared_sum = 0.0

    def compute_terms(self, captured: CapturedRadiance, view: int, rows: np.ndarray, values: np.ndarray) -> _Terms:
        """Return the terms of a view with `values` (M, (L + 1) * 3) of the texels `rows` (M,)."""
        direction, weights = captured.grid.directions[view], captured.weights[view]
        used = np.flatnonzero(self._indices[rows] >= 0)
        size, squared_sum = len(MAX_COEFFICIENTS), 0.0
        normal, rhs = np.empty((len(used), size, size), np.float32), np.empty((len(used), size, 3), np.float32)
        for start in range(0, len(used), CHUNK_TEXELS):
            chunk = used[start : start + CHUNK_TEXELS]
            responses = fit_responses(self._surface, direction, captured.suns, rows[chunk])
            radiance = np.clip(split_lights(values[chunk]), 0.0, MAX_RADIANCE)
            chunk_weights = (weights[rows[chunk], None] * captured.light_weights).astype(np.float32)
            weighted = (responses * chunk_weights[..., None]).transpose(0, 2, 1)
            normal[start : start + CHUNK_TEXELS], rhs[start : start + CHUNK_TEXELS] = weighted @ responses, weighted @ radiance
            squared_sum += float((chunk_weights * (radiance**2).sum(axis=2)).sum(dtype=np.float64))
        return _Terms(self._indices[rows[used]], normal, rhs, squared_sum)

    def add(self, terms: _Terms) -> None:
        """Add the terms of a view."""
        self._normal[terms.indices] += terms.normal
        self._rhs[terms.indices] += terms.rhs
        self._squared_sum += terms.squared_sum

    def solve(self, quad_indices: np.ndarray) -> np.ndarray:
        """Return the best coefficients (N, 5, 3)."""
        mean = self._normal.mean(axis=0) + 1e-9 * np.eye(len(MAX_COEFFICIENTS))
        of_level = _solve_bounded(mean[None], self._rhs.mean(axis=0)[None])
        quad_normal, quad_rhs = (_sum_by_quad(values, quad_indices) for values in (self._normal, self._rhs))
        of_quads = _solve_bounded(quad_normal + LEVEL_PRIOR * mean, quad_rhs + LEVEL_PRIOR * (mean @ of_level))
        return _solve_bounded(self._normal + QUAD_PRIOR * mean, self._rhs + QUAD_PRIOR * (mean @ of_quads)[quad_indices])

    def squared_error(self, solution: np.ndarray) -> float:
        """Return the weighted squared error of `solution`."""
        return self._squared_sum + float((solution * (self._normal @ solution - 2.0 * self._rhs)).sum())


def _solve_bounded(normal: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve least-squares problems with normal equations (N, K, K), (N, K, 3) for coefficients (N, K, 3) within 0 and MAX_COEFFICIENTS."""
    chunks = slices(len(normal), CHUNK_TEXELS)
    return np.concatenate([np.zeros((0, *rhs.shape[1:])), *map_ordered(lambda rows: _coordinate_descent(normal[rows], rhs[rows]), chunks)])


def _coordinate_descent(normal: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve a chunk of the problems of `_solve_bounded`."""
    solution = np.clip(np.linalg.solve(normal, rhs), 0.0, MAX_COEFFICIENTS[:, None])
    for _ in range(MAX_ITERATIONS):
        max_change = 0.0
        for index in range(len(MAX_COEFFICIENTS)):
            residual = rhs[:, index] - (normal[:, index, None] @ solution)[:, 0]
            improved = np.clip(solution[:, index] + residual / normal[:, index, index, None], 0.0, MAX_COEFFICIENTS[index])
            max_change = max(max_change, float(np.abs(improved - solution[:, index]).max()))
            solution[:, index] = improved
        if max_change < TOLERANCE:
            break
    return solution


def _sum_by_quad(values: np.ndarray, quad_indices: np.ndarray) -> np.ndarray:
    """Sum `values` (N, ...) over the texels of each quad."""
    sums = np.zeros((int(quad_indices.max()) + 1, *values.shape[1:]))
    np.add.at(sums, quad_indices, values)
    return sums


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
    """Return the power in FRESNEL_POWERS, with its best strength, that has the least error over all texels."""
    without_grazing = replace(lobes, f90_minus_f0=np.zeros_like(lobes.f90_minus_f0))
    correlations, energies = np.zeros((2, len(FRESNEL_POWERS)))
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
        for candidate, power in enumerate(FRESNEL_POWERS):
            response = grazing * GrazingFresnel(1.0, power)(cosines)
            correlations[candidate] += float(row_weights @ (response * residual))
            energies[candidate] += float(row_weights @ response**2)
    if not energies.all():
        return SCHLICK
    strengths = np.clip(correlations / energies, 0.0, MAX_FRESNEL_STRENGTH)
    best = int(np.argmin(strengths * (strengths * energies - 2.0 * correlations)))
    return GrazingFresnel(float(strengths[best]), FRESNEL_POWERS[best])


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
    prior = SKY_PRIOR * energies.mean()
    return np.clip((correlations + prior) / np.maximum(energies + prior, 1e-12), 0.0, MAX_SKY_VISIBILITY).astype(np.float32)


def _clamp_radiance(values: np.ndarray) -> np.ndarray:
    return np.clip(values, 0.0, MAX_RADIANCE)
