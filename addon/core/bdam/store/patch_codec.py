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
from .rice_codes import encode_integers, to_unsigned

HEADER = struct.Struct("<Hi")
USUAL_FAN = 2  # triangles
MAX_GRADIENT = 2**30  # steps of gradients that are stored; steeper ones, which no longer differ from vertical, become this steep
MAX_HEIGHT = 2**31 - 1  # steps
FOLLOWING = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])  # the corners of a triangle that follow 0 to 2 turns after a corner
MAX_RADIX = 1 << 16


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


def encode_patch(patch: Patch, corners: np.ndarray, is_leaf: bool, gradient_step: float) -> bytes:
    """Return the block of a patch, whose heights are at most 2**30 steps apart.

    Args:
        corners: (3, 2) int, of the bintree triangle. gradient_step: the unit of stored gradients, in steps per cell.
    """
    is_hole, columns, mesh = patch.is_hole, 0, b""
    if is_leaf:
        first_height, heights = _predict_leaf(patch.x, patch.y, patch.z, corners)
    else:
        order, vertices, lower, upper = _sort_fans(patch)
        is_hole = is_hole[order]
        counts = np.bincount(vertices, minlength=len(patch.x))
        starts = np.cumsum(counts) - counts
        first = _find_single_neighbors(patch.triangles, len(patch.x))
        last, has_fan = first.copy(), counts > 0
        first[has_fan], last[has_fan] = lower[starts[has_fan]], upper[(starts + counts)[has_fan] - 1]
        first_height = int(patch.z[0])
        heights = patch.z[1:].astype(np.int64) - (patch.z[first[1:]].astype(np.int64) + patch.z[last[1:]] >> 1)
        is_start = np.diff(patch.x, prepend=patch.x[0] - 1) > 0
        starts_of_columns = np.flatnonzero(is_start)
        columns = len(starts_of_columns)
        places = _place_in_front(patch, counts, first, upper, starts)
        mesh = encode_integers(
            [
                np.diff(patch.x[is_start], prepend=int(corners[:, 0].min()) - 1) - 1,
                np.diff(starts_of_columns, append=len(patch.x)) - 1,
                np.where(is_start, patch.y - corners[:, 1].min(), np.diff(patch.y, prepend=0) - 1),
                to_unsigned(_count_moves(places, is_start)),
                to_unsigned(counts[1:] - USUAL_FAN),
            ]
        )
    gradients = np.clip(np.rint(patch.gradients / gradient_step), -MAX_GRADIENT, MAX_GRADIENT).astype(np.int64)
    gradients -= predict_gradients(patch.x, patch.y, patch.z, patch.triangles, patch.boundary, gradient_step)
    group = encode_integers([to_unsigned(heights), to_unsigned(gradients.T.ravel())])
    holes = bytes([1]) + np.packbits(is_hole, bitorder="little").tobytes() if is_hole.any() else bytes(1)
    return HEADER.pack(columns, first_height) + mesh + group + holes


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


def _sort_fans(patch: Patch) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the order of the sweep (T,), and in this order the last vertices of the triangles and their lower and upper neighbors."""
    rows = np.arange(len(patch.triangles))
    corners = patch.triangles.T
    is_second = corners[1] > corners[0]
    is_last = corners[2] > np.maximum(corners[0], corners[1])
    first = np.where(is_last, 2, is_second)
    vertices, upper, lower = (patch.triangles.reshape(-1).take(3 * rows + FOLLOWING[turns].take(first)) for turns in range(3))
    with np.errstate(divide="ignore"):
        direction = (patch.y.take(lower) - patch.y.take(vertices)) / (patch.x.take(vertices) - patch.x.take(lower)).astype(np.float64)
    order = np.argsort(direction)  # equal ones belong to different vertices
    numbers = vertices.take(order)
    if len(patch.x) <= MAX_RADIX:
        numbers = numbers.astype(np.uint16)  # NumPy sorts short integers by their digits, in linear time
    order = order.take(np.argsort(numbers, kind="stable"))
    return order, vertices.take(order), lower.take(order), upper.take(order)


def _find_single_neighbors(triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """Return for vertices that are not the last ones of any triangle (T, 3) their only neighbor before them, (V,) int64."""
    neighbors = np.zeros(vertex_count, np.int64)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    neighbors[triangles.sum(axis=1) - low - high] = low
    return neighbors


def _place_in_front(patch: Patch, counts: np.ndarray, first: np.ndarray, upper: np.ndarray, starts: np.ndarray) -> list[int]:
    """Return the places in the front of the lowest neighbors `first` (V,) of all vertices but the first one.

    counts, starts: (V,) triangles of the fans, and the place of the first one in `upper` (T,), the upper neighbors.
    """
    x, y = patch.x.tolist(), patch.y.tolist()
    seconds = upper.take(np.minimum(starts, len(upper) - 1))[1:].tolist()
    front, places, place = [0], [], 0
    for vertex, count, neighbor, second in zip(range(1, len(x)), counts[1:].tolist(), first[1:].tolist(), seconds, strict=True):
        if count:
            if front[place : place + 2] != [neighbor, second]:
                place = _find_edge(front, neighbor, second, place)
            front[place + 1 : place + count] = (vertex,)
        else:
            place = front.index(neighbor)
            # Each time that the front comes back to the neighbor, it has been at a vertex that no other one is connected to.
            above_x, above_y = x[vertex] - x[neighbor], y[vertex] - y[neighbor]
            for _ in range(front.count(neighbor) - 1):
                inserted = front[place + 1]
                if (x[inserted] - x[neighbor]) * above_y < (y[inserted] - y[neighbor]) * above_x:
                    break
                place = front.index(neighbor, place + 1)
            front[place + 1 : place] = (vertex, neighbor)
        places.append(place)
        place += 1
    return places


def _find_edge(front: list[int], vertex: int, following: int, start: int) -> int:
    """Return the place of `vertex` before the vertex `following` in the front, which is probably soon after `start`."""
    try:
        while True:
            start = front.index(vertex, start)
            if front[start + 1] == following:
                return start
            start += 1
    except (IndexError, ValueError):
        return _find_edge(front, vertex, following, 0)


def _count_moves(places: list[int], is_start: np.ndarray) -> np.ndarray:
    """Return the differences (V - 1,) int64 between places of vertices in the front and those that they are told from."""
    own = np.append(0, np.array(places, np.int64) + 1)
    references = np.append(0, own[:-1])
    columns = np.flatnonzero(is_start)
    references[columns[1:]] = own[columns[:-1]]
    return own[1:] - 1 - references[1:]


def _predict_leaf(x: np.ndarray, y: np.ndarray, z: np.ndarray, corners: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the height of a leaf at the right angle, and the differences (V - 1,) int64 of its other heights, of `z` (V,), to those that
    are predicted."""
    columns, rows = _place_on_grid(x, y, corners)
    grid = np.zeros((columns.max() + 2, rows.max() + 2), np.int64)
    grid[columns + 1, rows + 1] = z
    differences = np.diff(np.diff(grid, axis=0), axis=1)
    is_other = columns + rows > 0
    return int(grid[1, 1]), differences[columns[is_other], rows[is_other]]


def _place_on_grid(x: np.ndarray, y: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows (V,) of the samples of a leaf, counted from its right angle or, where the field ends before, from there."""
    columns, rows = np.abs(x - corners[2, 0]), np.abs(y - corners[2, 1])
    return columns - columns.min(), rows - rows.min()


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
