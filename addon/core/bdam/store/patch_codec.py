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
from itertools import chain

import numpy as np

from ...errors import FileError
from ..height_meshes import sum_gradients
from .leaf_grids import LeafGrid
from .rice_codes import decode_integers, encode_integers, to_signed, to_unsigned

HEADER = struct.Struct("<Hi")
USUAL_FAN = 2  # triangles
MAX_GRADIENT = 2**30  # steps of gradients that are stored; steeper ones, which no longer differ from vertical, become this steep
MAX_HEIGHT = 2**31 - 1  # steps
OUT_OF_RANGE = "a block contains heights out of range."
NO_VERTICES = "a block contains triangles of vertices that do not exist."
FOLLOWING = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])  # the corners of a triangle that follow 0 to 2 turns after a corner
MAX_RADIX = 1 << 16
MAX_BYTES = 5  # The largest mean size of the coded integers of a chunk.


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
    gradients -= _predict_gradients(patch.x, patch.y, patch.z, patch.triangles, patch.boundary, gradient_step)
    group = encode_integers([to_unsigned(heights), to_unsigned(gradients.T.ravel())])
    holes = bytes([1]) + np.packbits(is_hole, bitorder="little").tobytes() if is_hole.any() else bytes(1)
    return HEADER.pack(columns, first_height) + mesh + group + holes


def decode_patch(
    content: bytes, corners: np.ndarray, vertex_count: int, triangle_count: int, leaf: LeafGrid | None, gradient_step: float
) -> Patch:
    """Return the patch of a block.

    Args:
        corners: (3, 2) int, of the bintree triangle. leaf: its samples, None unless it is a leaf. gradient_step: see
            `encode_patch`.

    Raises:
        FileError: the block is damaged.
    """
    if leaf is not None and (len(leaf.x), len(leaf.triangles)) != (vertex_count, triangle_count):
        raise FileError("a leaf has another number of vertices or triangles than its place has samples.")
    if len(content) > _max_size(vertex_count, triangle_count):
        raise FileError("a block is longer than its patch.")
    if len(content) < HEADER.size:
        raise FileError("a block is shorter than its contents.")
    columns, first_height = HEADER.unpack_from(content)
    if leaf is None:
        x, y, is_start, moves, counts, position = _read_mesh(content, corners, columns, vertex_count)
    else:
        x, y, position = leaf.x, leaf.y, HEADER.size
    boundary = find_boundary(x, y, corners)
    (heights, gradients), position = decode_integers(content, position, [vertex_count - 1, 2 * len(boundary)])
    heights = to_signed(heights)
    if leaf is None:
        z, triangles = _sweep(is_start, moves, counts, first_height, heights, triangle_count)
    else:
        z, triangles = _restore_leaf(x, y, first_height, heights, corners), leaf.triangles
    steps = to_signed(gradients).reshape(2, -1).T + _predict_gradients(x, y, z, triangles, boundary, gradient_step)
    return Patch(x, y, z, boundary, (steps * gradient_step).astype(np.float32), triangles, _read_holes(content, position, triangle_count))


def find_boundary(x: np.ndarray, y: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the vertices (B,) int32 that lie on the edges of a bintree triangle with `corners` (3, 2) int."""
    is_on_edge = np.zeros(len(x), bool)
    points = corners.tolist()
    for (start_x, start_y), (end_x, end_y) in zip(points, points[1:] + points[:1], strict=True):
        if start_x == end_x:
            is_on_edge |= x == start_x
        elif start_y == end_y:
            is_on_edge |= y == start_y
        elif (start_x < end_x) == (start_y < end_y):
            is_on_edge |= x - y == start_x - start_y
        else:
            is_on_edge |= x + y == start_x + start_y
    return np.flatnonzero(is_on_edge).astype(np.int32)


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


def _sweep(
    is_start: np.ndarray, moves: np.ndarray, counts: np.ndarray, first_height: int, heights: np.ndarray, triangle_count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights (V,) int32 and the triangles (T, 3) int32 of a network. Raises FileError."""
    if counts.min() < 0 or int(counts.sum()) != triangle_count:
        raise FileError("a block contains another number of triangles than its header says.")
    front, fans, z = [0], [], [first_height]
    place = column = 0
    try:
        for vertex, starts_column, move, count, height in zip(
            range(1, len(is_start)), is_start[1:].tolist(), moves.tolist(), counts.tolist(), heights.tolist(), strict=True
        ):
            if starts_column:
                place = column + move
                column = place + 1
            else:
                place += move
            fan = front[place : place + count + 1]
            fans.append(fan)
            z.append(height + (z[fan[0]] + z[fan[-1]] >> 1))
            front[place + 1 : place + count] = (vertex,) if count else (vertex, fan[0])
            place += 1
    except IndexError as error:
        raise FileError(NO_VERTICES) from error
    if max(map(abs, z)) > MAX_HEIGHT:
        raise FileError(OUT_OF_RANGE)
    if sum(map(len, fans)) != triangle_count + len(fans):
        raise FileError(NO_VERTICES)
    neighbors = np.fromiter(chain.from_iterable(fans), np.int32, triangle_count + len(fans))
    is_last = np.zeros(len(neighbors), bool)
    is_last[np.cumsum(counts + 1) - 1] = True
    lower = np.flatnonzero(~is_last)
    vertices = np.repeat(np.arange(1, len(counts) + 1, dtype=np.int32), counts)
    return np.array(z, np.int32), np.stack([vertices, neighbors[lower + 1], neighbors[lower]], axis=1)


def _read_mesh(
    content: bytes, corners: np.ndarray, columns: int, vertex_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Return x and y (V,) int32, whether vertices begin a column (V,), moves and numbers of triangles (V - 1,), and the position of the
    second group. Raises FileError."""
    lengths = [columns, columns, vertex_count, vertex_count - 1, vertex_count - 1]
    (steps, sizes, offsets, moves, counts), position = decode_integers(content, HEADER.size, lengths)
    sizes += 1
    if int(sizes.sum()) != vertex_count:
        raise FileError("a block contains columns with another number of vertices than its header says.")
    (left, bottom), (right, top) = corners.min(axis=0), corners.max(axis=0)
    x = np.repeat(left - 1 + np.cumsum(steps + 1), sizes)
    starts = np.cumsum(sizes) - sizes
    is_start = np.zeros(vertex_count, bool)
    is_start[starts] = True
    offsets += ~is_start
    sums = np.cumsum(offsets)
    y = sums + np.repeat(bottom - (sums - offsets)[starts], sizes)
    if x[-1] > right or y.min() < bottom or y.max() > top:
        raise FileError("a block contains vertices outside of its patch.")
    return x.astype(np.int32), y.astype(np.int32), is_start, to_signed(moves), to_signed(counts) + USUAL_FAN, position


def _predict_leaf(x: np.ndarray, y: np.ndarray, z: np.ndarray, corners: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the height of a leaf at the right angle, and the differences (V - 1,) int64 of its other heights, of `z` (V,), to those that
    are predicted."""
    columns, rows = _place_on_grid(x, y, corners)
    grid = np.zeros((columns.max() + 2, rows.max() + 2), np.int64)
    grid[columns + 1, rows + 1] = z
    differences = np.diff(np.diff(grid, axis=0), axis=1)
    is_other = columns + rows > 0
    return int(grid[1, 1]), differences[columns[is_other], rows[is_other]]


def _restore_leaf(x: np.ndarray, y: np.ndarray, first_height: int, differences: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the heights (V,) int32 of a leaf, see `_predict_leaf`. Raises FileError if they are out of range."""
    columns, rows = _place_on_grid(x, y, corners)
    grid = np.zeros((columns.max() + 1, rows.max() + 1), np.int64)
    is_other = columns + rows > 0
    grid[0, 0], grid[columns[is_other], rows[is_other]] = first_height, differences
    heights = np.cumsum(np.cumsum(grid, axis=0), axis=1)[columns, rows]
    if np.abs(heights).max() > MAX_HEIGHT:
        raise FileError(OUT_OF_RANGE)
    return heights.astype(np.int32)


def _place_on_grid(x: np.ndarray, y: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows (V,) of the samples of a leaf, counted from its right angle or, where the field ends before, from there."""
    columns, rows = np.abs(x - corners[2, 0]), np.abs(y - corners[2, 1])
    return columns - columns.min(), rows - rows.min()


def _predict_gradients(
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


def _read_holes(content: bytes, position: int, triangle_count: int) -> np.ndarray:
    """Return which triangles are holes, (T,) bool. Raises FileError."""
    size = -(-triangle_count // 8) if content[position : position + 1] == b"\1" else 0
    if len(content) != position + 1 + size:
        raise FileError("a block has another length than its contents.")
    if not size:
        return np.zeros(triangle_count, bool)
    return np.unpackbits(np.frombuffer(content, np.uint8, size, position + 1), count=triangle_count, bitorder="little").astype(bool)


def _max_size(vertex_count: int, triangle_count: int) -> int:
    """Return the largest size in bytes of the block of a patch; a damaged one cannot take more memory."""
    return 64 + 8 * MAX_BYTES * vertex_count + triangle_count
