"""A piece of surface that can be laid out in the plane."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Chart:
    """A piece of surface that is a disk, or one with holes.

    vertices: (V, 3) float64, all of which the triangles use. triangles: (T, 3) int32, a connected and oriented manifold. density: (T,),
    above 0, how many texels the triangles should get for their area beside each other. faces: (T,), those with the same number are not
    to be cut apart.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    density: np.ndarray
    faces: np.ndarray | None = None
