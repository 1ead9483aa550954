"""Mean value coordinates (Floater: Mean value coordinates, 2003)."""

import numpy as np


def half_angle_tangents(
    first: np.ndarray,
    second: np.ndarray,
    first_lengths: np.ndarray,
    second_lengths: np.ndarray,
    double_areas: np.ndarray,
    epsilon: float,
) -> np.ndarray:
    """Return tan(angle / 2) (N,) of the angles between the vectors `first` and `second` (N, 3).

    The mean value weight of a neighbor is the sum of these tangents of its two triangles over its distance.

    Args:
        first_lengths, second_lengths: (N,) above 0.
        double_areas: (N,) lengths of the cross products.
        epsilon: angles near 180 degrees are limited to those with 1 + cos(angle) = epsilon.
    """
    dots = np.einsum("ti,ti->t", first, second)
    return double_areas / np.maximum(first_lengths * second_lengths + dots, epsilon * first_lengths * second_lengths)
