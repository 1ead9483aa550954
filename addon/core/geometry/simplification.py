"""Quadric edge-collapse decimation (Garland and Heckbert, 1997) by the package fast-simplification."""

import numpy as np

from ..errors import FarfieldError


def quadric_decimation(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate to about `target` triangles: return vertices (V, 3) float64, some possibly unused, and triangles (T, 3) int32.

    Raises:
        FarfieldError: the package is not installed.
    """
    try:
        import fast_simplification
    except ImportError:
        raise FarfieldError(
            "This needs the package fast-simplification, which this Python lacks; install Farfield from its zip, which contains it."
        ) from None
    coarse, faces = fast_simplification.simplify(vertices, triangles, target_count=target, agg=7)
    return np.asarray(coarse, np.float64), np.asarray(faces, np.int32)
