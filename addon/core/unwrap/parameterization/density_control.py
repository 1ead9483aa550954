"""Controls the texel density: finds stretch weights that give the requested densities.

For an isolated triangle the texel density grows with the square root of its weight; inside a connected chart it grows more slowly,
depending on the chart. The exponent from requested density to weight is therefore adapted to the densities reached on every level.
"""

import numpy as np

from ...arrays import TINY
from ...geometry.mesh import face_areas_and_normals
from ...geometry.transforms import signed_areas
from ..cutting.chart import Chart
from ..energies.rest_shapes import compute_rest_shapes

ISOLATED_EXPONENT = 2.0  # Gives isolated triangles the requested density.
MAX_EXPONENT = 6.0  # Beyond it weights differ by so much that the energy is badly conditioned, for little gain in density.
MAX_EXPONENT_STEP = 1.5  # Largest factor of change at once.
FILLED_HOLE_WEIGHT = 0.01  # Filled holes get this fraction of the smallest weight, since they may stretch.


class DensityWeights:
    """Stretch weights of a `chart`. Only its first `surface_count` vertices are surface; the others fill holes."""

    def __init__(self, chart: Chart, surface_count: int) -> None:
        self._chart, self._surface_count = chart, surface_count
        areas = np.maximum(compute_rest_shapes(chart.vertices[chart.triangles]).areas, TINY)
        is_surface = (chart.triangles < surface_count).all(axis=1)
        corners, corner_areas = chart.triangles[is_surface].ravel(), np.repeat(areas[is_surface], 3)
        total = np.bincount(corners, corner_areas, len(chart.vertices))
        self._log_density = np.log(chart.density / chart.density[is_surface].min())
        weighted = np.bincount(corners, corner_areas * np.repeat(self._log_density[is_surface], 3), len(chart.vertices))
        self._vertex_log_density = np.divide(weighted, total, out=np.zeros(len(total)), where=total > 0.0)
        self._area_fractions = areas / areas.sum()
        self._exponent = ISOLATED_EXPONENT
        self._log_ratio = np.log(_split_density_ratio(areas * np.exp(self._log_density), areas, self._log_density) or 1.0)

    @property
    def is_uniform(self) -> bool:
        """Whether all weights are equal."""
        return self._log_ratio == 0.0

    def for_triangles(self, triangles: np.ndarray) -> np.ndarray:
        """Return the weights (T,) of a level's `triangles`, scaled so that the best area of the map is about that of the chart."""
        weights = np.exp(self._exponent * self._triangle_log_density(triangles))
        weights[(triangles >= self._surface_count).any(axis=1)] *= FILLED_HOLE_WEIGHT
        return weights / self._scale

    def for_vertices(self) -> np.ndarray:
        """Return the mean weights (V,) around every vertex."""
        return np.exp(self._exponent * self._vertex_log_density) / self._scale

    def adapt_exponent(self, uv: np.ndarray, triangles: np.ndarray, tolerance: float) -> bool:
        """Adapt the exponent to the densities that `uv` (V, 2) of a level's `triangles` has reached; return whether it changed.

        tolerance: difference of the logarithms of reached and requested density ratio that is accepted.
        """
        if self.is_uniform:
            return False
        is_surface = (triangles < self._surface_count).all(axis=1)
        log_density, triangles = self._triangle_log_density(triangles)[is_surface], triangles[is_surface]
        areas, _ = face_areas_and_normals(self._chart.vertices[triangles])
        ratio = _split_density_ratio(signed_areas(uv[triangles]), areas, log_density)
        if ratio == 0.0 or abs(np.log(ratio) - self._log_ratio) < tolerance:
            return False
        change = self._log_ratio / np.log(ratio) if ratio > 1.0 else MAX_EXPONENT_STEP
        change = float(np.clip(change, 1.0 / MAX_EXPONENT_STEP, MAX_EXPONENT_STEP))
        previous, self._exponent = self._exponent, min(self._exponent * change, MAX_EXPONENT)
        return self._exponent != previous

    @property
    def _scale(self) -> float:
        return float(self._area_fractions @ np.exp(0.5 * self._exponent * self._log_density)) ** 2

    def _triangle_log_density(self, triangles: np.ndarray) -> np.ndarray:
        is_finest = len(triangles) == len(self._chart.triangles)
        return self._log_density.copy() if is_finest else self._vertex_log_density[triangles].mean(axis=1)


def _split_density_ratio(uv_areas: np.ndarray, areas: np.ndarray, log_density: np.ndarray) -> float:
    """Return `compute_density_ratio` for triangles split at half of the largest `log_density`, (T,) each."""
    return compute_density_ratio(uv_areas, areas, log_density / log_density.max()) if log_density.max(initial=0.0) > 0.0 else 0.0


def compute_density_ratio(uv_areas: np.ndarray, areas: np.ndarray, importance: np.ndarray) -> float:
    """Return the texel density of triangles with an importance above 0.5 over that of the others; 0 where either set has no area.

    uv_areas, areas (surface), importance: (T,) each.
    """
    is_important = importance > 0.5
    denominator = areas[is_important].sum() * uv_areas[~is_important].sum()
    if not denominator > 0.0 or not areas[~is_important].sum() > 0.0:
        return 0.0
    return float(uv_areas[is_important].sum() * areas[~is_important].sum() / denominator)
