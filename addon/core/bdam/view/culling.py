"""Which bounding boxes a viewer sees."""

import numpy as np

from ...geometry.viewers import Viewer


class Culling:
    """Finds boxes that may overlap the frustum of an image that is larger on every side by a fraction of its size.

    A box is invisible if it lies outside of one plane; one near an edge of the frustum may count as visible without being it. A box is
    visible if one inside of it is. Nothing is outside of a panorama.
    """

    def __init__(self, viewer: Viewer, margin: float = 0.0, exaggeration: float = 1.0) -> None:
        """exaggeration: factor of the heights of boxes."""
        planes = viewer.frustum_planes(margin)
        planes[:, 2] *= exaggeration
        self._weights = np.hstack([np.minimum(planes[:, :3], 0.0), np.maximum(planes[:, :3], 0.0)])
        self._offsets = planes[:, 3:]

    def are_visible(self, boxes: np.ndarray) -> np.ndarray:
        """Return whether boxes (6, N) float64, lowest and highest x, y and z without exaggeration, may be visible, (N,) bool."""
        values = self._weights @ boxes
        values += self._offsets
        return (values >= 0.0).all(axis=0)
