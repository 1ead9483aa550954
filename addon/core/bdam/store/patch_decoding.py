"""Patches from their bytes, see `patch_codec`. All patches are decoded together, and only the front is a loop over their vertices."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...arrays import concatenate_ranges, to_starts
from ...errors import FileError
from .leaf_grids import LeafGrid
from .patch_codec import HEADER, MAX_HEIGHT, USUAL_FAN, Patch, find_boundaries, place_on_grid, predict_gradients
from .rice_codes import RiceReader, to_signed

MAX_BYTES = 5  # The largest mean size of the coded integers of a chunk.


@dataclass(frozen=True)
class CodedPatch:
    """The block of a patch, and what is known of it from elsewhere.

    Attributes:
        content: the block.
        corners: (3, 2) int, of the bintree triangle.
        vertex_count: of the patch.
        triangle_count: of the patch.
        leaf: its samples, None unless it is a leaf.
    """

    content: bytes
    corners: np.ndarray
    vertex_count: int
    triangle_count: int
    leaf: LeafGrid | None


def decode_patches(coded: Sequence[CodedPatch], gradient_step: float) -> list[Patch]:
    """Return the patches of blocks. gradient_step: see `encode_patches`.

    Raises:
        FileError: one of the blocks is damaged.
    """
    patches = {}
    for is_leaf in (False, True):
        alike = {number: patch for number, patch in enumerate(coded) if (patch.leaf is not None) == is_leaf}
        if alike:
            patches.update(zip(alike, _decode_alike(list(alike.values()), is_leaf, gradient_step), strict=True))
    return [patches[number] for number in range(len(coded))]


def _decode_alike(coded: list[CodedPatch], is_leaf: bool, gradient_step: float) -> list[Patch]:
    """Decode networks, or leaves."""
    for patch in coded:
        _check_size(patch)
    columns, first_heights = np.array([HEADER.unpack_from(patch.content) for patch in coded]).T
    vertices, triangles = np.array([(patch.vertex_count, patch.triangle_count) for patch in coded]).T
    corners = np.array([patch.corners for patch in coded])
    reader = RiceReader([patch.content for patch in coded], HEADER.size)
    if is_leaf:
        x, y = (np.concatenate([getattr(patch.leaf, axis) for patch in coded]) for axis in "xy")
    else:
        x, y, places, fans = _read_mesh(reader, columns, vertices, triangles, corners)
    boundary, boundary_starts = find_boundaries(x, y, corners, vertices)
    starts, boundary_counts = to_starts(vertices), np.diff(boundary_starts)
    of_first = np.repeat(starts[:-1].astype(np.int32), triangles)[:, None]
    heights, gradients = (to_signed(values) for values in reader.read(np.stack([vertices - 1, 2 * boundary_counts], axis=1)))
    if is_leaf:
        z = _restore_leaves(x, y, corners, vertices, first_heights, heights)
        of_all = np.concatenate([patch.leaf.triangles for patch in coded]) + of_first
    else:
        z, of_all = _sweep(starts, places, fans, first_heights, heights)
    if np.abs(z).max() > MAX_HEIGHT:
        raise FileError("a block contains heights out of range.")
    along_x = concatenate_ranges(2 * boundary_starts[:-1], boundary_counts)
    steps = gradients[np.stack([along_x, along_x + np.repeat(boundary_counts, boundary_counts)], axis=1)]
    steps += predict_gradients(x, y, z, of_all, boundary, gradient_step)
    parts = (
        *(_split(axis.astype(np.int32), starts) for axis in (x, y, z)),
        _split((boundary - np.repeat(starts[:-1], boundary_counts)).astype(np.int32), boundary_starts),
        _split((steps * gradient_step).astype(np.float32), boundary_starts),
        [patch.leaf.triangles for patch in coded] if is_leaf else _split(of_all - of_first, to_starts(triangles)),
        [_read_holes(patch, position) for patch, position in zip(coded, reader.find_bytes(), strict=True)],
    )
    return [Patch(*arrays) for arrays in zip(*parts, strict=True)]


def _read_mesh(
    reader: RiceReader, columns: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what the first group says about networks (P,).

    Returns:
        x and y (V,) int64; the places (V,) int64 of the lowest neighbors in the front, and the numbers of triangles (V,) int64 of the fans.
        For the first vertex of each network both are 0.

    Raises:
        FileError: it is impossible.
    """
    steps, sizes, offsets, moves, fans = reader.read(np.stack([columns, columns, vertices, vertices - 1, vertices - 1], axis=1))
    sizes += 1
    of_columns, of_vertices, starts = to_starts(columns), to_starts(vertices), to_starts(sizes)
    if not np.array_equal(starts[of_columns], of_vertices):
        raise FileError("a block contains columns with another number of vertices than its header says.")
    x = np.repeat(_accumulate(steps + 1, of_columns), sizes) + np.repeat(corners[..., 0].min(axis=1) - 1, vertices)
    is_start, is_first = np.zeros((2, len(offsets)), bool)
    is_start[starts[:-1]], is_first[of_vertices[:-1]] = True, True
    y = _accumulate(offsets + ~is_start, starts) + np.repeat(corners[..., 1].min(axis=1), vertices)
    if (x > np.repeat(corners[..., 0].max(axis=1), vertices)).any() or (y > np.repeat(corners[..., 1].max(axis=1), vertices)).any():
        raise FileError("a block contains vertices outside of its patch.")
    counts, places = np.zeros((2, len(offsets)), np.int64)
    counts[~is_first] = to_signed(fans) + USUAL_FAN
    if counts.min() < 0 or not np.array_equal(to_starts(counts)[of_vertices], to_starts(triangles)):
        raise FileError("a block contains another number of triangles than its header says.")
    # Places are told from that of a vertex before, which is one more than that of its lowest neighbor.
    places[~is_first] = to_signed(moves) + 1
    places[is_start] = _accumulate(places[is_start], of_columns)
    return x, y, _accumulate(places, starts) - ~is_first, counts


def _sweep(
    starts: np.ndarray, places: np.ndarray, counts: np.ndarray, first_heights: np.ndarray, heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights (V,) int64 and the triangles (T, 3) int32 of networks, which begin at the vertices `starts` (P + 1,); see
    `_read_mesh`. Raises FileError.

    Their fronts follow each other in one list.
    """
    is_first = np.zeros(len(places), bool)
    is_first[starts[:-1]] = True
    lengths = _accumulate(np.where(is_first, 1, 2 - counts), starts)  # Of the front after each vertex.
    if ((places < 0) | (places + 3 > lengths))[~is_first].any():
        raise FileError("a block contains triangles of vertices that do not exist.")
    places = places + np.repeat(to_starts(lengths[starts[1:] - 1])[:-1], np.diff(starts))
    fan_lengths = np.where(is_first, 0, counts + 1)
    front: list[int] = []
    neighbors: list[int] = []
    slices = (places, places + fan_lengths, places + ~is_first, places + counts)
    for vertex, start, stop, inner_start, inner_stop in zip(range(len(places)), *(ends.tolist() for ends in slices), strict=True):
        fan = front[start:stop]
        neighbors += fan
        front[inner_start:inner_stop] = (vertex,) if inner_start <= inner_stop else (vertex, fan[0])
    corners = np.array(neighbors, np.int32)
    ends = np.cumsum(fan_lengths)[~is_first]
    is_last = np.zeros(len(corners), bool)
    is_last[ends - 1] = True
    lower = np.flatnonzero(~is_last)
    vertices = np.repeat(np.arange(len(places), dtype=np.int32), counts)
    triangles = np.stack([vertices, corners[lower + 1], corners[lower]], axis=1)
    first, last, steps = np.zeros((3, len(places)), np.int64)
    steps[is_first], steps[~is_first] = first_heights, heights
    first[~is_first], last[~is_first] = corners[ends - fan_lengths[~is_first]] + 1, corners[ends - 1] + 1
    z = [0]  # what the first heights are told from
    for step, lowest, highest in zip(steps.tolist(), first.tolist(), last.tolist(), strict=True):
        z.append(step + (z[lowest] + z[highest] >> 1))
    return np.array(z[1:], np.int64), triangles


def _restore_leaves(
    x: np.ndarray, y: np.ndarray, corners: np.ndarray, vertices: np.ndarray, first_heights: np.ndarray, differences: np.ndarray
) -> np.ndarray:
    """Return the heights (V,) int64 of leaves with `vertices` (P,), see `patch_encoding`."""
    leaves, columns, rows = place_on_grid(x, y, corners, vertices)
    grids = np.zeros((len(vertices), columns.max() + 1, rows.max() + 1), np.int64)
    is_other = columns + rows > 0
    grids[:, 0, 0], grids[leaves[is_other], columns[is_other], rows[is_other]] = first_heights, differences
    return np.cumsum(np.cumsum(grids, axis=1), axis=2)[leaves, columns, rows]


def _accumulate(values: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Return the cumulative sums (N,) of values within ranges that begin at `starts` (R + 1,) and are not empty."""
    sums = np.cumsum(values)
    return sums - np.repeat((sums - values)[starts[:-1]], np.diff(starts))


def _split(values: np.ndarray, starts: np.ndarray) -> list[np.ndarray]:
    """Return copies of the parts of an array that begin at `starts` (P + 1,), so that each can be kept without the others."""
    return [values[start:end].copy() for start, end in pairwise(starts.tolist())]


def _check_size(patch: CodedPatch) -> None:
    """Raise FileError if a block has another size than its patch can have, so that a damaged one cannot take more memory."""
    leaf = patch.leaf
    if leaf is not None and (len(leaf.x), len(leaf.triangles)) != (patch.vertex_count, patch.triangle_count):
        raise FileError("a leaf has another number of vertices or triangles than its place has samples.")
    if len(patch.content) > 64 + 8 * MAX_BYTES * patch.vertex_count + patch.triangle_count:
        raise FileError("a block is longer than its patch.")
    if len(patch.content) < HEADER.size:
        raise FileError("a block is shorter than its contents.")


def _read_holes(patch: CodedPatch, position: int) -> np.ndarray:
    """Return which triangles are holes, (T,) bool. Raises FileError."""
    content, count = patch.content, patch.triangle_count
    size = -(-count // 8) if content[position : position + 1] == b"\1" else 0
    if len(content) != position + 1 + size:
        raise FileError("a block has another length than its contents.")
    if not size:
        return np.zeros(count, bool)
    return np.unpackbits(np.frombuffer(content, np.uint8, size, position + 1), count=count, bitorder="little").astype(bool)
