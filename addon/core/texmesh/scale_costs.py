"""Costs of collapses that keep the features of coarse scales longer."""

import numpy as np

from .scale_space.scale_map import ScaleMap
from .simplification.collapse_fans import CollapseFans
from .simplification.texture_quadrics import TextureQuadrics
from .simplification.topology import Collapses
from .textured_mesh import TexturedMesh

WEIGHT_PER_SCALE = 1.15  # factor of the cost of a vertex per scale at which it is a feature: 1.1 to 1.25 gave the least visible levels


class ScaleWeightedQuadrics:
    """Texture quadrics, weighted by the last scale at which the removed vertex is a feature; a `CollapseCost`."""

    def __init__(self, mesh: TexturedMesh, scale_map: ScaleMap) -> None:
        self._quadrics = TextureQuadrics(mesh)
        self._weights = WEIGHT_PER_SCALE ** scale_map.last_scales.astype(np.float64)

    def evaluate(self, collapses: Collapses) -> np.ndarray:
        """See `CollapseCost`."""
        return self._quadrics.evaluate(collapses) * self._weights[collapses.removed]

    def merge(self, collapses: Collapses, fans: CollapseFans) -> None:
        """See `CollapseCost`."""
        self._quadrics.merge(collapses, fans)
