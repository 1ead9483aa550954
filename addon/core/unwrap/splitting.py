"""Charts cut apart along edges: corners share a vertex only where triangles hang together around it."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .chart import Chart


def apart(chart: Chart, sides: np.ndarray) -> list[tuple[Chart, np.ndarray]]:
    """The connected parts of a chart's triangles that `sides` (I, 2) join, each a manifold with vertices of its own, and the numbers of
    their triangles."""
    numbers = _split(chart.triangles, sides)
    count = len(chart.triangles)
    first, second = sides.T // 3
    total, label = connected_components(coo_array((np.ones(len(sides), bool), (first, second)), shape=(count, count)), directed=False)
    parts = []
    for members in np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=total))[:-1]):
        _, place, own = np.unique(numbers[members], return_index=True, return_inverse=True)
        vertices = chart.vertices[chart.triangles[members].ravel()[place]]
        faces = None if chart.faces is None else chart.faces[members]
        parts.append((Chart(vertices, own.reshape(-1, 3).astype(np.int32), chart.density[members], faces), members))
    return parts


def _split(triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Numbers (T, 3) of vertices, of which corners share one only where they hang together across `sides` (I, 2)."""
    first, second = (3 * (side // 3) for side in sides.T)
    ends = [(first + (sides[:, 0] % 3 + turn) % 3, second + (sides[:, 1] % 3 + 3 - turn) % 3) for turn in (1, 2)]
    ones, others = (np.concatenate(each) for each in zip(*ends, strict=True))
    joined = coo_array((np.ones(len(ones), bool), (ones, others)), shape=(triangles.size,) * 2)
    return connected_components(joined, directed=False)[1].reshape(-1, 3)
