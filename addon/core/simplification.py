"""Meshes of fewer triangles by collapses of least quadric error (Garland and Heckbert, 1997), by the package fast-simplification."""

import numpy as np

from .errors import FarfieldError


def simplified(vertices: np.ndarray, triangles: np.ndarray, target: int) -> tuple[np.ndarray, np.ndarray]:
    """About `target` triangles: vertices (V, 3) float64, some of which may be unused, and triangles (T, 3) int32.

    Raises:
        FarfieldError: when the package that does it is not installed.
    """
    try:
        import fast_simplification
    except ImportError:
        raise FarfieldError(
            "This needs the package fast-simplification, which this Python lacks; install Farfield from its zip, which brings it along."
        ) from None
    coarse, faces = fast_simplification.simplify(vertices, triangles, target_count=target, agg=7)
    return np.asarray(coarse, np.float64), np.asarray(faces, np.int32)
