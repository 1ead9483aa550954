"""The contents of a patch as bytes.

Vertices are sorted by x, then y. A sweep in this order adds each vertex v on the right of the triangles so far: the triangles whose last
vertex is v form a fan with neighbors l1, ..., lk of v on its left, from bottom to top. A block contains these streams of integers, all of
it compressed by Zstandard. A stream is one byte with the number of bytes per value, as many as the largest value needs, then the lowest
bytes of all values, the second lowest ones, and so on, which compresses well; signed values have small magnitudes first (zigzag).

1. unsigned: differences of x to the previous vertex, the first one to the lower left corner of the patch's bounding box
2. unsigned: y minus that of the box if x differs, otherwise the difference to the previous vertex, less one
3. unsigned: the number of triangles of each vertex's fan
4. unsigned: v - l1 of vertices with a fan
5. signed: l(i+1) - l(i) of all triangles in the order of vertices
6. signed: differences of heights to the previous vertex, in steps
7. signed: derivatives along x and y at vertices on the boundary of the patch, in units of the store's gradient step
8. one byte: whether any triangle is a hole; if so one bit per triangle, lowest bit first

Leaves contain all samples, so that streams 1 to 5 are left out.
"""

from dataclasses import dataclass

import numpy as np
import zstandard

from ...errors import FileError
from .leaf_grids import LeafGrid

COMPRESSION_LEVEL = 9
MAX_GRADIENT = 2**30  # steps of gradients that are stored; steeper ones, which no longer differ from vertical, become this steep
FOLLOWING = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])  # the corners of a triangle that follow 0 to 2 turns after a corner
MAX_RADIX = 1 << 16
WIDTHS = (0, 1, 2, 4)  # bytes of a value


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


class StreamReader:
    """Reads the streams of one block from the beginning."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self._position = 0

    def read_bytes(self, count: int) -> np.ndarray:
        """Return the next `count` bytes, uint8.

        Raises:
            FileError: the block ends before.
        """
        end = self._position + count
        if end > len(self._content):
            raise FileError("a block is shorter than its contents.")
        start, self._position = self._position, end
        return np.frombuffer(self._content, np.uint8, count, start)

    def read_unsigned(self, count: int) -> np.ndarray:
        """Return the next stream of `count` integers, int64."""
        width = int(self.read_bytes(1)[0])
        if width not in WIDTHS:
            raise FileError("a block contains a stream of an unknown width.")
        planes = self.read_bytes(width * count)
        if not width:
            return np.zeros(count, np.int64)
        values = planes[:count].astype(np.int64)
        for plane in range(1, width):
            values |= planes[plane * count : (plane + 1) * count].astype(np.int64) << 8 * plane
        return values

    def read_signed(self, count: int) -> np.ndarray:
        """Return the next stream of `count` signed integers, int64."""
        values = self.read_unsigned(count)
        return (values >> 1) ^ -(values & 1)


def write_unsigned(values: np.ndarray) -> bytes:
    """Encode integers (N,) from 0 to 2**32 - 1: one byte with the width, then the planes from the lowest byte to the highest."""
    largest = int(values.max(initial=0))
    width = next(width for width in WIDTHS if largest < 1 << 8 * width)
    planes = values.astype("<u4").view(np.uint8).reshape(-1, 4).T[:width]
    return bytes([width]) + planes.tobytes()


def write_signed(values: np.ndarray) -> bytes:
    """Encode integers (N,) from -2**31 to 2**31 - 1, with small magnitudes first (zigzag)."""
    values = values.astype(np.int64)
    return write_unsigned(np.where(values < 0, -2 * values - 1, 2 * values))


def encode_patch(patch: Patch, corner: np.ndarray, is_leaf: bool, gradient_step: float) -> bytes:
    """Return the block of a patch, whose heights are at most 2**30 steps apart.

    Args:
        corner: (2,) int, lower left corner of its bounding box. gradient_step: the unit of stored gradients, in steps per cell.
    """
    streams, is_hole = [], patch.is_hole
    if not is_leaf:
        order, vertices, lower, upper = _sort_fans(patch)
        is_hole = is_hole[order]
        steps = _difference(patch.x, corner[0])
        is_new_column = (steps > 0) | (np.arange(len(steps)) == 0)
        is_first = _difference(vertices, -1) != 0
        streams = [
            write_unsigned(steps),
            write_unsigned(np.where(is_new_column, patch.y - corner[1], _difference(patch.y, 0) - 1)),
            write_unsigned(np.bincount(vertices, minlength=len(patch.x))),
            write_unsigned((vertices - lower)[is_first]),
            write_signed(upper - lower),
        ]
    streams.append(write_signed(_difference(patch.z, 0)))
    gradients = np.clip(np.rint(patch.gradients / gradient_step), -MAX_GRADIENT, MAX_GRADIENT)
    streams.append(write_signed(gradients.T.ravel()))
    streams.append(bytes([int(is_hole.any())]))
    if is_hole.any():
        streams.append(np.packbits(is_hole, bitorder="little").tobytes())
    return zstandard.ZstdCompressor(level=COMPRESSION_LEVEL).compress(b"".join(streams))


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
    reader = StreamReader(_decompress(content, _max_size(vertex_count, triangle_count)))
    if leaf is None:
        x, y, triangles = _read_mesh(reader, corners.min(axis=0), corners.max(axis=0), vertex_count, triangle_count)
    else:
        x, y, triangles = leaf.x, leaf.y, leaf.triangles
    z = np.cumsum(reader.read_signed(len(x)))
    boundary = find_boundary(x, y, corners)
    gradients = reader.read_signed(2 * len(boundary)).reshape(2, -1).T * gradient_step
    is_hole = np.zeros(len(triangles), bool)
    if reader.read_bytes(1)[0]:
        is_hole = np.unpackbits(reader.read_bytes(-(-len(triangles) // 8)), count=len(triangles), bitorder="little").astype(bool)
    return Patch(x, y, z.astype(np.int32), boundary, gradients.astype(np.float32), triangles, is_hole)


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


def _decompress(content: bytes, max_size: int) -> bytes:
    """Return the streams of a block. Raises FileError if it is damaged or claims more than `max_size` bytes, before these are allocated."""
    try:
        if zstandard.frame_content_size(content) > max_size:
            raise FileError("a block claims to be longer than its patch.")
        return zstandard.ZstdDecompressor().decompress(content, max_output_size=max_size)
    except zstandard.ZstdError as error:
        raise FileError(f"a block cannot be decompressed: {error}.") from error


def _read_mesh(
    reader: StreamReader, corner: np.ndarray, opposite: np.ndarray, vertex_count: int, triangle_count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    steps, offsets, counts = (reader.read_unsigned(vertex_count) for _ in range(3))
    x = corner[0] + np.cumsum(steps)
    is_column_start = steps > 0
    is_column_start[:1] = True
    columns = np.flatnonzero(is_column_start)
    offsets += ~is_column_start
    sums = np.cumsum(offsets)
    y = sums + np.repeat(corner[1] - (sums - offsets)[columns], np.diff(columns, append=vertex_count))
    if vertex_count and (x[-1] > opposite[0] or y.min() < corner[1] or y.max() > opposite[1]):
        raise FileError("a block contains vertices outside of its patch.")
    fan_vertices = np.flatnonzero(counts)
    fan_counts = counts[fan_vertices]
    ends = np.cumsum(fan_counts)
    if (int(ends[-1]) if len(ends) else 0) != triangle_count:
        raise FileError("a block contains another number of triangles than its header says.")
    lower = fan_vertices - reader.read_unsigned(len(fan_vertices))
    widths = reader.read_signed(triangle_count)
    sums = np.cumsum(widths)
    starts = ends - fan_counts
    triangles = np.empty((triangle_count, 3), np.int64)
    triangles[:, 0] = np.repeat(fan_vertices, fan_counts)
    triangles[:, 1] = sums + np.repeat(lower - (sums - widths)[starts], fan_counts)
    np.subtract(triangles[:, 1], widths, out=triangles[:, 2])
    if triangle_count and triangles.view(np.uint64).max() >= vertex_count:
        raise FileError("a block contains triangles of vertices that do not exist.")
    return x.astype(np.int32), y.astype(np.int32), triangles.astype(np.int32)


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


def _difference(values: np.ndarray, first: int) -> np.ndarray:
    """Return the differences (N,) int64 of values (N,) to the value before, that of the first one to `first`."""
    result = values.astype(np.int64)
    result[1:] -= values[:-1]
    result[:1] -= first
    return result


def _max_size(vertex_count: int, triangle_count: int) -> int:
    """Return the largest size in bytes of the streams of a patch; a damaged block cannot claim more memory."""
    return 64 + 4 * (7 * vertex_count + 2 * triangle_count)
