"""Charts that lie in a plane already: their layout is their own shape."""

import numpy as np

from .border_barrier import crosses_itself
from .borders import border_edges
from .chart import Chart
from .plane import signed_areas

FLAT = 1e-6  # of its extent: a chart that leaves its plane by no more is flat


def flat_layout(chart: Chart) -> np.ndarray | None:
    """The layout (V, 2) of a chart of even density that is flat and nowhere over itself, without any stretch; None of others."""
    if np.ptp(chart.density) > 0.0:
        return None
    middle = chart.vertices.mean(axis=0)
    _, extents, axes = np.linalg.svd(chart.vertices - middle, full_matrices=False)
    places = (chart.vertices - middle) @ axes.T
    if np.abs(places[:, 2]).max() > FLAT * extents[0]:
        return None
    layout = places[:, :2]
    areas = signed_areas(layout[chart.triangles])
    if areas.sum() < 0.0:
        layout, areas = layout * [1.0, -1.0], -areas
    return layout if areas.min() > 0.0 and not crosses_itself(layout, border_edges(chart.triangles)) else None
