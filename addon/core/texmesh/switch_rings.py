"""Where levels switch around an object: the lines in a horizontal plane from which its bounding box has a given distance."""

import math

import numpy as np


def ring_around_box(low: np.ndarray, high: np.ndarray, distance: float, corner_segments: int = 16) -> np.ndarray:
    """Return a closed line (4 (S + 1), 3) float64 at `distance` from the box from `low` (3,) to `high` (3,), at half its height.

    Levels switch by the distance to the box, so the line is a rectangle with rounded corners, of S `corner_segments` each. It starts at the
    corner with the largest x and y, and runs counterclockwise seen from above.
    """
    angles = np.linspace(0.0, 0.5 * math.pi, corner_segments + 1)
    corners = [(high[0], high[1]), (low[0], high[1]), (low[0], low[1]), (high[0], low[1])]
    arcs = []
    for quarter, (x, y) in enumerate(corners):
        turned = angles + 0.5 * math.pi * quarter
        arcs.append(np.column_stack([x + distance * np.cos(turned), y + distance * np.sin(turned)]))
    ring = np.concatenate(arcs)
    return np.column_stack([ring, np.full(len(ring), 0.5 * (low[2] + high[2]))])
