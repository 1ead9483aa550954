"""How much stretch has to count so that texels are as dense as wanted. Of a triangle alone a weight buys its root in texels; where a chart
hangs together it buys less, and how much less depends on the chart. So the power of the wanted density that weighs is found on the way,
from what the layout of every level gets."""

import numpy as np

from ..mesh import face_areas_and_normals
from .chart import Chart
from .plane import signed_areas
from .rest_shapes import rest_shapes

ALONE = 2.0  # the power by which triangles alone would get what is wanted
MOST = 6.0
STRIDE = 1.5  # times larger or smaller at most the power gets at once
FILLING = 0.01  # of the least weight: what the stretch of a filled hole counts


class Weights:
    """Weights of a `chart`, of which only the first `own` vertices are surface; the rest fill holes."""

    def __init__(self, chart: Chart, own: int) -> None:
        self._chart, self._own = chart, own
        areas = np.maximum(rest_shapes(chart.vertices[chart.triangles]).areas, 1e-300)
        real = (chart.triangles < own).all(axis=1)
        corners, shares = chart.triangles[real].ravel(), np.repeat(areas[real], 3)
        total = np.bincount(corners, shares, len(chart.vertices))
        self._wanted = np.log(chart.density / chart.density[real].min())
        around = np.bincount(corners, shares * np.repeat(self._wanted[real], 3), len(chart.vertices))
        self._wanted_of_vertices = np.divide(around, total, out=np.zeros(len(total)), where=total > 0.0)
        self._areas = areas / areas.sum()
        self._power = ALONE
        self._ratio = np.log(_split_ratio(areas * np.exp(self._wanted), areas, self._wanted) or 1.0)

    @property
    def even(self) -> bool:
        """Whether everything counts the same."""
        return self._ratio == 0.0

    def on(self, triangles: np.ndarray) -> np.ndarray:
        """Weights (T,) of a level's `triangles`, such that the best area of the whole is about that of the chart."""
        made = np.exp(self._power * self._on(triangles))
        made[(triangles >= self._own).any(axis=1)] *= FILLING
        return made / self._scale

    def of_vertices(self) -> np.ndarray:
        """Weights (V,) of what is around every vertex."""
        return np.exp(self._power * self._wanted_of_vertices) / self._scale

    def adjusted(self, layout: np.ndarray, triangles: np.ndarray, near: float) -> bool:
        """Change the power by what a `layout` (V, 2) of a level's `triangles` has got, where that is not `near` to what is wanted (in
        logarithms of the ratio); whether it was changed."""
        if self.even:
            return False
        triangles, wanted = (each[(triangles < self._own).all(axis=1)] for each in (triangles, self._on(triangles)))
        areas, _ = face_areas_and_normals(self._chart.vertices[triangles])
        reached = _split_ratio(signed_areas(layout[triangles]), areas, wanted)
        if reached == 0.0 or abs(np.log(reached) - self._ratio) < near:
            return False
        change = self._ratio / np.log(reached) if reached > 1.0 else STRIDE
        before, self._power = self._power, min(self._power * float(np.clip(change, 1.0 / STRIDE, STRIDE)), MOST)
        return self._power != before

    @property
    def _scale(self) -> float:
        return float(self._areas @ np.exp(0.5 * self._power * self._wanted)) ** 2

    def _on(self, triangles: np.ndarray) -> np.ndarray:
        whole = len(triangles) == len(self._chart.triangles)
        return self._wanted.copy() if whole else self._wanted_of_vertices[triangles].mean(axis=1)


def _split_ratio(texels: np.ndarray, areas: np.ndarray, wanted: np.ndarray) -> float:
    """`density_ratio` of what wants more than half of the largest logarithm of a density, (T,) each."""
    return density_ratio(texels, areas, wanted / wanted.max()) if wanted.max(initial=0.0) > 0.0 else 0.0


def density_ratio(texels: np.ndarray, areas: np.ndarray, importance: np.ndarray) -> float:
    """`texels` for their `areas` of triangles with an importance above one half over those of the others, (T,) each; 0 where one of the
    two has no area."""
    much = importance > 0.5
    if not areas[much].sum() > 0.0 or not texels[~much].sum() > 0.0:
        return 0.0
    return float((texels[much].sum() / areas[much].sum()) / (texels[~much].sum() / areas[~much].sum()))
