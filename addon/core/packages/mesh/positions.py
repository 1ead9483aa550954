"""Predictions of positions from texture coordinates.

In a small neighborhood, positions are nearly an affine function of texture coordinates. A vertex is predicted by the function that fits its
known neighbors best in the least-squares sense, evaluated at its own texture coordinates: a weighted mean of their positions. Page and
Python get the same bits: all sums of texture coordinates are integers below 2^53, and the rest is done in the same order.
"""

from dataclasses import dataclass

import numpy as np

MAX_VALUE = 65535
# Determinant of the covariance of the neighbors, divided by its squared trace; with less, they are nearly on a line.
MIN_DETERMINANT = 1e-3


@dataclass(frozen=True)
class AffineWeights:
    """Weights of known neighbors.

    starts: (N + 1,) where those of each of N vertices begin. neighbors: (K,) vertices. weights: (K,) float64, which add up to 1. is_valid:
    (N,) whether the neighbors determine an affine function.
    """

    starts: np.ndarray
    neighbors: np.ndarray
    weights: np.ndarray
    is_valid: np.ndarray


def find_affine_weights(
    triangles: np.ndarray, wedge_vertices: np.ndarray, uvs: np.ndarray, known_count: int, vertex_count: int, has_later: bool = False
) -> AffineWeights:
    """Return the weights for the vertices from `known_count` up to `vertex_count`.

    Neighbors are those of smaller number in `triangles` (T, 3) at the first wedge of the vertex, once for each triangle.

    Args:
        wedge_vertices: (W,). uvs: (W, 2) integers, 0 to 65535. has_later: whether neighbors of larger number count, too.
    """
    first_wedges = np.full(vertex_count, -1)
    first_wedges[wedge_vertices[::-1]] = np.arange(len(wedge_vertices))[::-1]
    wedges = np.repeat(triangles.reshape(-1), 2)
    others = np.stack([np.roll(triangles, -1, axis=1), np.roll(triangles, -2, axis=1)], axis=2).reshape(-1)
    vertices, neighbors = wedge_vertices[wedges], wedge_vertices[others]
    rows = np.flatnonzero((vertices >= known_count) & (first_wedges[vertices] == wedges) & ((neighbors < vertices) | has_later))
    rows = rows[np.argsort(vertices[rows], kind="stable")]
    owners, count = vertices[rows] - known_count, vertex_count - known_count
    u, v = (uvs[others[rows]].astype(np.float64) - uvs[wedges[rows]]).T
    number, sum_u, sum_v, sum_uu, sum_uv, sum_vv = (
        np.bincount(owners, values, count) for values in (np.ones(len(rows)), u, v, u * u, u * v, v * v)
    )
    uu, uv, vv = number * sum_uu - sum_u * sum_u, number * sum_uv - sum_u * sum_v, number * sum_vv - sum_v * sum_v
    determinant, trace = uu * vv - uv * uv, uu + vv
    is_valid = determinant > MIN_DETERMINANT * (trace * trace)
    divisor = np.where(is_valid, determinant, np.inf)
    gradient_u, gradient_v = (vv * sum_u - uv * sum_v) / divisor, (uu * sum_v - uv * sum_u) / divisor
    n = number[owners]
    weights = (1.0 - gradient_u[owners] * (n * u - sum_u[owners]) - gradient_v[owners] * (n * v - sum_v[owners])) / n
    starts = np.concatenate([[0], np.cumsum(np.bincount(owners, minlength=count))])
    return AffineWeights(starts, neighbors[rows], weights, is_valid)


def predict(affine: AffineWeights, positions: np.ndarray, parallelograms: np.ndarray) -> np.ndarray:
    """Return predictions (N, 3) int64 from `positions` (V, 3), with `parallelograms` (N, 3) where there is no affine function."""
    owners = np.repeat(np.arange(len(affine.is_valid)), np.diff(affine.starts))
    sums = [np.bincount(owners, affine.weights * column, len(affine.is_valid)) for column in positions[affine.neighbors].T]
    rounded = np.floor(np.stack(sums, axis=1) + 0.5).astype(np.int64)
    return np.where(affine.is_valid[:, None], rounded, parallelograms)
