"""Patches as bytes, see `patch_codec`. All patches are encoded together, and only the front is a loop over their vertices."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ...arrays import to_starts
from .patch_codec import HEADER, MAX_GRADIENT, USUAL_FAN, Patch, place_on_grid, predict_gradients
from .rice_codes import encode_integers, to_unsigned

FOLLOWING = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1)])  # the corners of a triangle that follow 0 to 2 turns after a corner


def encode_patches(patches: Sequence[Patch], corners: np.ndarray, is_leaf: bool, gradient_step: float) -> list[bytes]:
    """Return the blocks of patches (P,), whose heights are at most 2**30 steps apart.

    Args:
        corners: (P, 3, 2) int, of the bintree triangles. is_leaf: whether all patches are leaves; otherwise none is one. gradient_step: the
            unit of stored gradients, in steps per cell.
    """
    x, y, z = (np.concatenate([getattr(patch, axis) for patch in patches]).astype(np.int64) for axis in "xyz")
    starts = to_starts(np.array([len(patch.x) for patch in patches]))
    vertices, boundaries = np.diff(starts), np.array([len(patch.boundary) for patch in patches])
    triangles = np.repeat(starts[:-1], [len(patch.triangles) for patch in patches])[:, None]
    triangles = triangles + np.concatenate([patch.triangles for patch in patches])
    boundary = np.repeat(starts[:-1], boundaries) + np.concatenate([patch.boundary for patch in patches])
    if is_leaf:
        first_heights, heights = _predict_leaves(x, y, z, corners, vertices)
        columns, meshes, are_holes = np.zeros(len(patches), np.int64), [b""] * len(patches), [patch.is_hole for patch in patches]
    else:
        fans = _find_fans(x, y, triangles)
        first_heights, heights = z[starts[:-1]], np.delete(z - (z[fans.lowest] + z[fans.highest] >> 1), starts[:-1])
        columns, meshes = _encode_meshes(x, y, fans, corners, starts)
        is_hole = np.concatenate([patch.is_hole for patch in patches])[fans.order]
        are_holes = np.split(is_hole, np.cumsum([len(patch.triangles) for patch in patches])[:-1])
    gradients = np.concatenate([patch.gradients for patch in patches])
    gradients = np.clip(np.rint(gradients / gradient_step), -MAX_GRADIENT, MAX_GRADIENT).astype(np.int64)
    gradients -= predict_gradients(x, y, z, triangles, boundary, gradient_step)
    ends = np.cumsum(boundaries)[:-1]
    derivatives = np.concatenate([part.T.ravel() for part in np.split(gradients, ends)])
    counts = np.stack([vertices - 1, 2 * boundaries], axis=1)
    groups = encode_integers([to_unsigned(heights), to_unsigned(derivatives)], counts)
    headers = [HEADER.pack(*header) for header in zip(columns.tolist(), first_heights.tolist(), strict=True)]
    return [b"".join(parts) for parts in zip(headers, meshes, groups, map(_encode_holes, are_holes), strict=True)]


@dataclass(frozen=True)
class _Fans:
    """The fans of triangles that belong to the vertices of networks.

    Attributes:
        order: (T,) the triangles of the first vertex of all from the lowest to the highest, those of the second one, and so on.
        counts: (V,) triangles of each fan.
        lowest, second, highest: (V,) neighbors of each vertex in the front. Those without a triangle have one neighbor, except for first
            vertices of networks, for which they mean nothing.
    """

    order: np.ndarray
    counts: np.ndarray
    lowest: np.ndarray
    second: np.ndarray
    highest: np.ndarray


def _find_fans(x: np.ndarray, y: np.ndarray, triangles: np.ndarray) -> _Fans:
    """Return the fans of networks with vertices (V,) and triangles (T, 3) int64."""
    is_second = triangles[:, 1] > triangles[:, 0]
    is_last = triangles[:, 2] > triangles[:, :2].max(axis=1)
    turns = FOLLOWING[:, np.where(is_last, 2, is_second)]
    vertices, upper, lower = np.take_along_axis(triangles.T, turns, axis=0)
    with np.errstate(divide="ignore"):
        direction = (y[lower] - y[vertices]) / (x[vertices] - x[lower]).astype(np.float64)
    order = np.lexsort((direction, vertices))
    counts = np.bincount(vertices, minlength=len(x))
    ends = np.cumsum(counts)
    has_fan = counts > 0
    lowest, second, highest = np.zeros((3, len(x)), np.int64)
    lowest[triangles.sum(axis=1) - triangles.min(axis=1) - triangles.max(axis=1)] = triangles.min(axis=1)
    highest[:] = lowest  # the one neighbor of vertices that are not the last one of any triangle
    starts = (ends - counts)[has_fan]
    lowest[has_fan], second[has_fan], highest[has_fan] = lower[order[starts]], upper[order[starts]], upper[order[ends[has_fan] - 1]]
    return _Fans(order, counts, lowest, second, highest)


def _encode_meshes(x: np.ndarray, y: np.ndarray, fans: _Fans, corners: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, list[bytes]]:
    """Return the numbers of columns (P,) and the first groups of networks, whose vertices begin at `starts` (P + 1,)."""
    low, vertices = corners.min(axis=1), np.diff(starts)
    is_first = np.zeros(len(x), bool)
    is_first[starts[:-1]] = True
    is_start = np.diff(x, prepend=x[0]).astype(bool) | is_first
    of_columns = np.flatnonzero(is_start)
    columns = np.diff(np.searchsorted(of_columns, starts))
    steps = np.diff(x[of_columns], prepend=0) - 1
    steps[is_first[of_columns]] = x[starts[:-1]] - low[:, 0]
    places = np.concatenate([_place_in_front(x, y, fans, range(start, end)) for start, end in pairwise(starts.tolist())])
    references = np.append(0, places[:-1])
    references[of_columns[1:]] = places[of_columns[:-1]]
    streams = [
        steps,
        np.diff(of_columns, append=len(x)) - 1,
        np.where(is_start, y - np.repeat(low[:, 1], vertices), np.diff(y, prepend=0) - 1),
        to_unsigned((places - 1 - references)[~is_first]),
        to_unsigned(fans.counts[~is_first] - USUAL_FAN),
    ]
    return columns, encode_integers(streams, np.stack([columns, columns, vertices, vertices - 1, vertices - 1], axis=1))


def _place_in_front(x: np.ndarray, y: np.ndarray, fans: _Fans, vertices: range) -> np.ndarray:
    """Return the places (V,) int64 of the vertices of a network in the front, which are those after their lowest neighbors."""
    rows = slice(vertices.start + 1, vertices.stop)
    front, places, place = [vertices.start], [0], 0
    of_fans = (values[rows].tolist() for values in (fans.counts, fans.lowest, fans.second))
    for vertex, count, neighbor, second in zip(vertices[1:], *of_fans, strict=True):
        if count:
            if front[place : place + 2] != [neighbor, second]:
                place = _find_edge(front, neighbor, second, place)
            front[place + 1 : place + count] = (vertex,)
        else:
            place = front.index(neighbor)
            # Each time that the front comes back to the neighbor, it has been at a vertex that no other one is connected to.
            above_x, above_y = int(x[vertex] - x[neighbor]), int(y[vertex] - y[neighbor])
            for _ in range(front.count(neighbor) - 1):
                inserted = front[place + 1]
                if int(x[inserted] - x[neighbor]) * above_y < int(y[inserted] - y[neighbor]) * above_x:
                    break
                place = front.index(neighbor, place + 1)
            front[place + 1 : place] = (vertex, neighbor)
        place += 1
        places.append(place)
    return np.array(places, np.int64)


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


def _predict_leaves(x: np.ndarray, y: np.ndarray, z: np.ndarray, corners: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the heights (P,) int64 of leaves with vertices (V,) at their right angles, and the differences (V - P,) int64 of their other
    heights to those that are predicted."""
    leaves, columns, rows = place_on_grid(x, y, corners, counts)
    grids = np.zeros((len(counts), columns.max() + 2, rows.max() + 2), np.int64)
    grids[leaves, columns + 1, rows + 1] = z
    differences = np.diff(np.diff(grids, axis=1), axis=2)
    return grids[:, 1, 1], differences[leaves, columns, rows][columns + rows > 0]


def _encode_holes(is_hole: np.ndarray) -> bytes:
    """Return the last part of a block."""
    return bytes([1]) + np.packbits(is_hole, bitorder="little").tobytes() if is_hole.any() else bytes(1)
