"""Rest shapes: the triangles of a surface in their own planes, the reference for stretch."""

from dataclasses import dataclass

import numpy as np

from ...geometry.mesh import scaled_normals

MIN_RELATIVE_HEIGHT = 1e-3  # Triangles flatter than this fraction of their longest side are treated as this high.
MIN_RELATIVE_AREA = 1e-3  # Minimum weight of a triangle, as a fraction of the mean area.


@dataclass(frozen=True)
class RestShapes:
    """Rest shapes of T triangles.

    areas (T,): used as weights, at least `MIN_RELATIVE_AREA` of the mean. gradients (2, 3, T): of the hat function of each corner, along
    two orthogonal directions of the triangle's plane.
    """

    areas: np.ndarray
    gradients: np.ndarray


def compute_rest_shapes(corners: np.ndarray) -> RestShapes:
    """Return the rest shapes of triangles `corners` (T, 3, 3)."""
    normals = scaled_normals(corners)
    areas = 0.5 * np.sqrt(np.einsum("ti,ti->t", normals, normals))
    return RestShapes(np.maximum(areas, MIN_RELATIVE_AREA * areas.mean() or 1.0 / len(areas)), _hat_gradients(corners))


def _hat_gradients(corners: np.ndarray) -> np.ndarray:
    """Return the gradients (2, 3, T) of the hat functions of triangles `corners` (T, 3, 3), with the longest side as the first axis."""
    sides = np.roll(corners, -1, axis=1) - corners
    squares = np.einsum("tij,tij->ti", sides, sides)
    first = squares.argmax(axis=1)
    order = (first[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, order[:, :, None], axis=1)
    to_second, to_third = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    base = np.sqrt(squares.max(axis=1))
    base = np.maximum(base, MIN_RELATIVE_HEIGHT * (base.mean() or 1.0))
    foot = np.clip(np.einsum("ti,ti->t", to_second, to_third) / base, 0.0, base)
    height = np.sqrt(np.einsum("ti,ti->t", *[np.cross(to_second, to_third)] * 2)) / base
    height = np.maximum(height, MIN_RELATIVE_HEIGHT * base)
    second = np.stack([1.0 / base, -foot / (base * height)], axis=1)
    third = np.stack([np.zeros_like(base), 1.0 / height], axis=1)
    gradients = np.empty((len(corners), 3, 2))
    np.put_along_axis(gradients, order[:, :, None], np.stack([-second - third, second, third], axis=1), axis=1)
    return np.ascontiguousarray(gradients.transpose(2, 1, 0))


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
