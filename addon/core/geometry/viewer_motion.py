"""Where a viewer will be soon."""

from dataclasses import replace

import numpy as np

from .viewers import Viewer

MAX_PAUSE = 1.0  # seconds between two views; after a longer one, a viewer is not expected to go on


class ViewerMotion:
    """The last two views of a viewer, and where it will be if it keeps its velocity and direction of view."""

    def __init__(self) -> None:
        self._last: tuple[Viewer, float] | None = None
        self._velocity: np.ndarray | None = None

    def record(self, viewer: Viewer, time: float) -> None:
        """Take note of a view at a time in seconds."""
        last, self._last, self._velocity = self._last, (viewer, time), None
        if last is not None and 0.0 < time - last[1] <= MAX_PAUSE and viewer.projection.kind == last[0].projection.kind:
            velocity = (viewer.position - last[0].position) / (time - last[1])
            self._velocity = velocity if np.isfinite(velocity).all() and velocity.any() else None

    def predict(self, seconds: float) -> Viewer | None:
        """Return the viewer `seconds` after the last view, None unless it moves."""
        if self._last is None or self._velocity is None:
            return None
        viewer = self._last[0]
        matrix = viewer.matrix.copy()
        matrix[:3, 3] += seconds * self._velocity
        return replace(viewer, matrix=matrix)
