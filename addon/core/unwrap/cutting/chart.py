"""A connected part of a surface that is parameterized as one UV island."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Chart:
    """A part of a surface with the topology of a disk, possibly with holes.

    vertices: (V, 3) float64, all used by the triangles. triangles: (T, 3) int32, a connected and oriented manifold. density: (T,), above
    0, the desired texels per area relative to each other. polygon_ids: (T,), triangles with the same ID are not to be cut apart.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    density: np.ndarray
    polygon_ids: np.ndarray | None = None
