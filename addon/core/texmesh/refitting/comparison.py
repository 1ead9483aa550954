"""Which of several levels of a mesh is nearest to it where they are farthest: in space, from both sides, and in texture.

Least squares lower the mean; a spike that few samples see can grow meanwhile.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree, one_sided_hausdorff
from ...geometry.mesh import longest_side
from ..textured_mesh import TexturedMesh
from .correspondence import SurfaceSamples, sample_surface
from .outliers import FineSurface

SAMPLES = 20_000  # Points of the fine mesh.
QUANTILE = 0.99  # Of the deviations of the texture, since points whose island a level lacks have none.
MAX_RATIO = 1.25  # A level is preferred if its deviations are at most this multiple of those of the others.
MAX_DIFFERENCE_RATIO, MIN_DIFFERENCE = 1.05, 1e-3  # The same for FLIP; differences far below the second number do not count.
PRECISION = 0.05  # Of the largest distance, relative to that of the samples of the fine mesh.
TOLERANCE = 1e-5  # Relative to the longest side of the mesh; smaller deviations do not count.


@dataclass(frozen=True)
class Deviations:
    """How far a level is from its fine mesh.

    Attributes:
        distance: no point of the level is farther from the fine mesh, and none of many samples of the fine mesh is from the level.
        texture: the distance of points with equal texture coordinates that one in a hundred exceeds.
    """

    distance: float
    texture: float


@dataclass(frozen=True)
class LevelComparison:
    """A fine mesh that levels are compared with."""

    surface: FineSurface

    @cached_property
    def _samples(self) -> SurfaceSamples:
        return sample_surface(self.surface.mesh, self.surface.islands, SAMPLES, np.random.default_rng(0), triangle_fraction=0.5)

    @cached_property
    def _tolerance(self) -> float:
        return TOLERANCE * longest_side(self.surface.mesh.vertices)

    def choose(self, levels: Sequence[TexturedMesh], differences: np.ndarray | None = None) -> tuple[int, Deviations]:
        """Return the index of the level whose deviations, and `differences` (N,) in renders, are small multiples of the least ones of all
        N `levels`, and its deviations. The first one is preferred if none is larger than its limit."""
        deviations = [self.measure(level) for level in levels]
        values = np.array([[item.distance, item.texture] for item in deviations]) + self._tolerance
        excess = values / values.min(axis=0) / MAX_RATIO
        if differences is not None:
            ratios = (differences + MIN_DIFFERENCE) / (differences.min() + MIN_DIFFERENCE)
            excess = np.column_stack([excess, ratios / MAX_DIFFERENCE_RATIO])
        worst = excess.max(axis=1)
        best = 0 if worst[0] <= 1.0 else int(worst.argmin())
        return best, deviations[best]

    def measure(self, level: TexturedMesh) -> Deviations:
        """Return how far `level` is from the fine mesh."""
        state = self.surface.attach(level, self._samples, normal_weight=1.0)
        from_fine = float(TriangleTree(state.corners).find_closest(self._samples.positions)[0].max())
        largest = one_sided_hausdorff(state.corners, self.surface.tree, max(PRECISION * from_fine, 0.1 * self._tolerance), from_fine)
        return Deviations(largest, float(np.quantile(np.linalg.norm(state.residuals, axis=1), QUANTILE)))
