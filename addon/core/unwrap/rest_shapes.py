"""The triangles of a surface as they are in space: what a layout is held against."""

from dataclasses import dataclass

import numpy as np

from ..mesh import scaled_normals

LOWEST = 1e-3  # of its longest side: a triangle that is lower than that is taken as this high
LEAST_AREA = 1e-3  # of the mean: what a triangle counts at least


@dataclass(frozen=True)
class RestShapes:
    """T triangles of a surface.

    areas (T,): what each counts, a little more than it has where that is next to nothing. gradients (2, 3, T): of the hat function of each
    corner, along two orthogonal directions of the triangle's plane.
    """

    areas: np.ndarray
    gradients: np.ndarray


def rest_shapes(corners: np.ndarray) -> RestShapes:
    """Rest shapes of triangles `corners` (T, 3, 3)."""
    normals = scaled_normals(corners)
    areas = 0.5 * np.sqrt(np.einsum("ti,ti->t", normals, normals))
    return RestShapes(np.maximum(areas, LEAST_AREA * areas.mean() or 1.0 / len(areas)), _gradients(corners))


def _gradients(corners: np.ndarray) -> np.ndarray:
    """Gradients (2, 3, T) of the hat functions of triangles `corners` (T, 3, 3), each seen with its longest side as the base."""
    sides = np.roll(corners, -1, axis=1) - corners
    squares = np.einsum("tij,tij->ti", sides, sides)
    first = squares.argmax(axis=1)
    turned = (first[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turned[:, :, None], axis=1)
    along, up = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    base = np.sqrt(squares.max(axis=1))
    base = np.maximum(base, LOWEST * (base.mean() or 1.0))
    foot = np.clip(np.einsum("ti,ti->t", along, up) / base, 0.0, base)
    height = np.maximum(np.sqrt(np.einsum("ti,ti->t", *[np.cross(along, up)] * 2)) / base, LOWEST * base)
    second = np.stack([1.0 / base, -foot / (base * height)], axis=1)
    third = np.stack([np.zeros_like(base), 1.0 / height], axis=1)
    gradients = np.empty((len(corners), 3, 2))
    np.put_along_axis(gradients, turned[:, :, None], np.stack([-second - third, second, third], axis=1), axis=1)
    return np.ascontiguousarray(gradients.transpose(2, 1, 0))
