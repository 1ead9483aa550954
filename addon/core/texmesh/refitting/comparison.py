"""Which of several levels of a mesh is nearest to it where they are farthest: in space, from both sides, and in texture.

Least squares lower the mean; a spike that few samples see can grow meanwhile.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree, bound_hausdorff
from ...geometry.mesh import longest_side
from ..textured_mesh import TexturedMesh
from .correspondence import SurfaceSamples, sample_surface
from .outliers import FineSurface

SAMPLES = 20_000  # Points of the fine mesh.
SPARSE = 16  # One sample of so many is measured first; most of the others are not farther.
QUANTILE = 0.99  # Of the deviations of the texture, since points whose island a level lacks have none.
MAX_RATIO = 1.25  # A level is preferred if its deviations are at most this multiple of those of the others.
MAX_DIFFERENCE_RATIO, MIN_DIFFERENCE = 1.05, 1e-3  # The same for FLIP; differences far below the second number do not count.
FEW_PIECES, MANY_PIECES = 4_000, 40_000  # into which triangles of a level are divided where they may be farthest, at once
PRECISION, BOUND_PRECISION = 0.05, 0.01  # Of the largest distance of levels that are compared, and of the one that is reported.
TOLERANCE = 1e-5  # Relative to the longest side of the mesh; smaller deviations do not count.


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

    def choose(self, levels: Sequence[TexturedMesh], differences: np.ndarray | None = None, preferred_count: int = 1) -> int:
        """Return the index of the level whose deviations, and `differences` (N,) in renders, are the smallest multiples of the least ones
        of all N `levels`. One of the first `preferred_count` is preferred if none is larger than its limit."""
        values = np.array([self.measure(level) for level in levels]) + self._tolerance
        excess = values / values.min(axis=0) / MAX_RATIO
        if differences is not None:
            ratios = (differences + MIN_DIFFERENCE) / (differences.min() + MIN_DIFFERENCE)
            excess = np.column_stack([excess, ratios / MAX_DIFFERENCE_RATIO])
        worst = excess.max(axis=1)
        preferred = int(worst[:preferred_count].argmin())
        return preferred if worst[preferred] <= 1.0 else int(worst.argmin())

    def measure(self, level: TexturedMesh) -> tuple[float, float]:
        """Return the largest distance that is found between the surfaces, from both sides, and the distance of points with equal texture
        coordinates that one in a hundred exceeds."""
        state = self.surface.attach(level, self._samples, normal_weight=1.0)
        deviations, tree = np.linalg.norm(state.residuals, axis=1), TriangleTree(state.corners)
        from_fine = float(tree.find_closest(self._samples.positions[::SPARSE])[0].max())
        rows = np.flatnonzero(deviations > from_fine)  # No distance is larger than that between equal texture coordinates.
        from_fine = max(from_fine, float(tree.find_closest(self._samples.positions[rows], from_fine)[0].max(initial=0.0)))
        largest = self._bound(level, from_fine, FEW_PIECES, PRECISION)[0]
        return largest, float(np.quantile(deviations, QUANTILE))

    def bound_distance(self, level: TexturedMesh) -> float:
        """Return a distance from the fine mesh that no point of `level` exceeds."""
        return self._bound(level, 0.0, MANY_PIECES, BOUND_PRECISION)[1]

    def _bound(self, level: TexturedMesh, minimum: float, max_pieces: int, precision: float) -> tuple[float, float]:
        return bound_hausdorff(level.vertices[level.triangles], self.surface.tree, self._tolerance, minimum, max_pieces, precision)
