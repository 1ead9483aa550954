"""Which of two levels of a mesh is nearer to it where they are farthest: in space, from both sides, and in texture.

Least squares lower the mean; a spike that few samples see can grow meanwhile.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import longest_side
from ..textured_mesh import TexturedMesh
from .correspondence import SurfaceSamples, sample_surface
from .outliers import FineSurface, gather_points

SAMPLES = 20_000  # Points of the fine mesh.
QUANTILE = 0.99  # Of the deviations of the texture, since points whose island a level lacks have none.
MAX_RATIO = 1.25  # A level is not worse if its deviations are at most this multiple of those of the other,
TOLERANCE = 1e-4  # or this fraction of the longest side of the mesh.


@dataclass(frozen=True)
class LevelComparison:
    """A fine mesh that levels are compared with."""

    surface: FineSurface

    @cached_property
    def _samples(self) -> SurfaceSamples:
        return sample_surface(self.surface.mesh, self.surface.islands, SAMPLES, np.random.default_rng(0), triangle_fraction=0.5)

    def is_worse(self, level: TexturedMesh, other: TexturedMesh) -> bool:
        """Return whether `level` is farther from the fine mesh than `other` by one of `measure`."""
        tolerance = TOLERANCE * longest_side(self.surface.mesh.vertices)
        return bool((self.measure(level) > np.maximum(MAX_RATIO * self.measure(other), tolerance)).any())

    def measure(self, level: TexturedMesh) -> np.ndarray:
        """Return the largest distance between the surfaces, from both sides, and the distance of points with equal texture coordinates that
        one in a hundred exceeds, (2,) float64."""
        samples = self._samples
        state = self.surface.attach(level, samples, normal_weight=1.0)
        from_level = self.surface.measure_distances(gather_points(level.vertices, state.edges)).max()
        from_fine = TriangleTree(state.corners).find_closest(samples.positions)[0].max()
        return np.array([max(from_level, from_fine), np.quantile(np.linalg.norm(state.residuals, axis=1), QUANTILE)])
