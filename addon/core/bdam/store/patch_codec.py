"""The contents of a patch as bytes.

Vertices are sorted by x, then y. A sweep in this order adds each vertex v on the right of the triangles so far. Their right side is the
front, a list of vertices from bottom to top, each connected with the next one by an edge. The triangles whose last vertex is v form a fan
with neighbors in the front, from l1 to lk, between which v replaces the others. If v has one neighbor only, v and the neighbor are inserted
after it: the front leads there and back.

A block begins with the number of columns, uint16, 0 for a leaf, and the height of the first vertex in steps, int32, little-endian. Groups
of Rice codes follow, see `rice_codes`; signed values have small magnitudes first. The first group describes the mesh:

1. steps along x to each column of vertices, less one; the first one from the left side of the patch's bounding box, not less one
2. the number of vertices of each column, less one
3. y of each vertex: from the lower side of the box at the beginning of a column, otherwise from the vertex before, less one
4. signed, without the first vertex: the place of l1 in the front, from that of the vertex before, or at the beginning of a column from that
   of the first vertex of the column before
5. signed, without the first vertex: the number of triangles of the fan, less two

The second group:

1. signed: heights in steps without that of the first vertex, from the mean of l1 and lk, rounded down
2. signed: derivatives along x and y at vertices on the boundary of the patch, in units of the store's gradient step, from the mean of the
   derivatives of their triangles in the patch, weighted by area

One byte says whether any triangle is a hole. If so, one bit per triangle follows, lowest bit first.

Leaves contain all samples, so that the first group is left out. Their first height is that at the right angle. Others are predicted from
three neighbors that are closer to it: by the sum of the one on the same row and the one on the same column, less the one between these.
Where the field ends before the right angle, rows and columns begin at its border.
"""

import struct
from dataclasses import dataclass

import numpy as np

from ...arrays import to_starts
from ..height_meshes import sum_gradients

HEADER = struct.Struct("<Hi")
USUAL_FAN = 2  # triangles
MAX_GRADIENT = 2**30  # steps of gradients that are stored; steeper ones, which no longer differ from vertical, become this steep
MAX_HEIGHT = 2**31 - 1  # steps


@dataclass(frozen=True)
class Patch:
    """The contents of a patch.

    Attributes:
        x, y, z: (V,) int32, grid coordinates and heights in steps.
        boundary: (B,) int32, the vertices on the edges of the bintree triangle.
        gradients: (B, 2) float32, derivatives at these vertices along x and y in steps per cell.
        triangles: (T, 3) int32, counterclockwise.
        is_hole: (T,) bool, triangles without any known sample.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    boundary: np.ndarray
    gradients: np.ndarray
    triangles: np.ndarray
    is_hole: np.ndarray


def find_boundaries(x: np.ndarray, y: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (B,) int64 that lie on the edges of their bintree triangles, and where those of each triangle begin, (P + 1,).

    Args:
        x, y: (V,) int, the vertices of the first triangle, of the second one, and so on. corners: (P, 3, 2) int64, of the triangles.
        counts: (P,), the numbers of their vertices.
    """
    is_on_edge = np.zeros(len(x), bool)
    for edge in range(3):
        start_x, start_y = corners[:, edge].T
        along_x, along_y = (corners[:, (edge + 1) % 3] - corners[:, edge]).T
        offset = along_x * start_y - along_y * start_x
        is_on_edge |= np.repeat(along_x, counts) * y - np.repeat(along_y, counts) * x == np.repeat(offset, counts)
    boundary = np.flatnonzero(is_on_edge)
    return boundary, np.searchsorted(boundary, to_starts(counts))


def place_on_grid(x: np.ndarray, y: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the leaves, columns and rows (V,) int64 of the samples of leaves, counted from their right angles or, where the field ends
    before, from there.

    Args:
        x, y, corners, counts: see `find_boundaries`.
    """
    starts = to_starts(counts)[:-1]
    places = (np.abs(axis - np.repeat(corners[:, 2, number], counts)) for number, axis in enumerate((x, y)))
    columns, rows = (place - np.repeat(np.minimum.reduceat(place, starts), counts) for place in places)
    return np.repeat(np.arange(len(counts)), counts), columns, rows


def predict_gradients(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, triangles: np.ndarray, boundary: np.ndarray, gradient_step: float
) -> np.ndarray:
    """Return the derivatives (B, 2) int64 that are expected at vertices `boundary` (B,), in units of `gradient_step`.

    The sums are those of integers, and therefore exact and the same everywhere.
    """
    is_boundary = np.zeros(len(x), bool)
    is_boundary[boundary] = True
    near = triangles[is_boundary.take(triangles).any(axis=1)]
    along_x, along_y, area = sum_gradients(np.stack([x, y, z]).astype(np.float64), near.T.astype(np.intp))
    gradients = np.stack([along_x, along_y], axis=1)[boundary] / (np.maximum(area[boundary], 1.0) * gradient_step)[:, None]
    return np.clip(np.rint(gradients), -MAX_GRADIENT, MAX_GRADIENT).astype(np.int64)
