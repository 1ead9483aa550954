"""Divides long thin pieces of a map, such as the rim of a plate, which would otherwise determine the scale of the whole map."""

import numpy as np

from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from .packing import orient_smallest

MAX_LENGTH = 0.8  # Of a thin piece, relative to the square root of the area of the surface.
MAX_THINNESS = 0.25  # A piece is thin if its area is a smaller fraction of its squared length.
MIN_BENT_LENGTH, MAX_BENT_FILL = 0.3, 0.25  # Shorter ones are cut, too, if they fill a smaller fraction of their bounding boxes.
MAX_COST = 1.5  # A cut may be so many times as long as the shortest one, if the bounding boxes are smaller then.
CENTER_PREFERENCE = 0.1  # How much larger the boxes count of a cut at an end than of one in the middle.
SEWN_TOLERANCE = 1e-7  # Distance of corners at the same position, relative to the extent.
INSIDE_POLYGON = 1e6  # Length of edges inside a polygon, relative to the maximum length of a piece.
MARGIN = 0.3  # A piece is not cut closer to its ends than this fraction of its length.


def divide_long_pieces(
    mesh: TriangleMesh, polygon_ids: np.ndarray, corner_uvs: np.ndarray, labels: np.ndarray, halfedges: np.ndarray, scales: np.ndarray
) -> np.ndarray:
    """Return the piece (T,) of each triangle after cutting long thin pieces across, where that cut is shortest.

    Args:
        mesh: T triangles. polygon_ids: (T,); polygons are not cut.
        corner_uvs: (T, 3, 2).
        labels: (T,) pieces before.
        halfedges: (I, 2), 3 t + c, pairs across which triangles are connected.
        scales: (T,) lengths in the map over lengths on the surface, the same in a piece.
    """
    labels, areas = labels.copy(), face_areas_and_normals(mesh.corners)[0] * scales**2
    side = square_side(corner_uvs, labels)
    halfedges = halfedges[_is_sewn(corner_uvs, halfedges)]
    faces = halfedges // 3
    max_length = MAX_LENGTH * side
    ends = [mesh.vertices[mesh.triangles[faces[:, 0], (halfedges[:, 0] + offset) % 3]] for offset in (1, 2)]
    lengths = np.linalg.norm(np.subtract(*ends), axis=1)
    lengths[polygon_ids[faces[:, 0]] == polygon_ids[faces[:, 1]]] = INSIDE_POLYGON * max_length
    order = np.argsort(labels, kind="stable")
    waiting = np.split(order, np.cumsum(np.bincount(labels))[:-1])
    link_owners = np.where(labels[faces[:, 0]] == labels[faces[:, 1]], labels[faces[:, 0]], -1)
    link_order = np.argsort(link_owners, kind="stable")
    bounds = np.searchsorted(link_owners[link_order], np.arange(labels.max() + 2))
    waiting = [(members, link_order[first:last]) for members, first, last in zip(waiting, bounds, bounds[1:], strict=False)]
    position, next_label = np.zeros(len(labels)), int(labels.max()) + 1
    while waiting:
        members, links = waiting.pop()
        uv = orient_smallest(corner_uvs[members].reshape(-1, 2)).reshape(-1, 3, 2)
        length = float(np.ptp(uv[..., 0]))
        area, box = float(areas[members].sum()), length * float(np.ptp(uv[..., 1]))
        is_bent = length > MIN_BENT_LENGTH * side and area < MAX_BENT_FILL * box
        is_bent = is_bent and _has_no_hole(uv, len(links), length)  # Other islands fit into a ring.
        if (length <= max_length and not is_bent) or area > MAX_THINNESS * length**2 or len(members) == 1:
            continue
        position[members] = (uv[..., 0].mean(axis=1) - uv[..., 0].min()) / length
        low, high = np.sort(position[faces[links]], axis=1).T
        candidates = np.unique(position[members])[1:]
        is_central = (candidates > MARGIN) & (candidates < 1.0 - MARGIN)
        candidates = candidates[is_central] if is_central.any() else candidates
        if len(candidates) == 0:
            continue
        costs = _sum_between(low, high, lengths[links], candidates)
        if costs.min() >= 0.5 * INSIDE_POLYGON * max_length:
            continue
        is_cheap = costs <= MAX_COST * costs.min()
        boxes = _split_boxes(uv, position[members], candidates) * (1.0 + CENTER_PREFERENCE * np.abs(candidates - 0.5))
        is_second = position[members] >= candidates[int(np.where(is_cheap, boxes, np.inf).argmin())]
        labels[members[is_second]] = next_label
        next_label += 1
        sides = labels[faces[links]]
        for part in (members[~is_second], members[is_second]):
            waiting.append((part, links[(sides == labels[part[0]]).all(axis=1)]))
    return labels


def square_side(corner_uvs: np.ndarray, labels: np.ndarray) -> float:
    """Return the side of a square with the area of the bounding boxes of all pieces, `labels` (T,), of a map `corner_uvs` (T, 3, 2)."""
    order = np.argsort(labels, kind="stable")
    members = np.split(order, np.cumsum(np.bincount(labels))[:-1])
    return float(np.sqrt(sum(np.ptp(orient_smallest(corner_uvs[piece].reshape(-1, 2)), axis=0).prod() for piece in members)))


def _is_sewn(corner_uvs: np.ndarray, halfedges: np.ndarray) -> np.ndarray:
    """Return at which of `halfedges` (I, 2) the map (T, 3, 2) is continuous, (I,) bool."""
    (first, second), corners = (halfedges // 3).T, halfedges % 3
    distances = [corner_uvs[first, (corners[:, 0] + k) % 3] - corner_uvs[second, (corners[:, 1] + 3 - k) % 3] for k in (1, 2)]
    return (np.abs(distances) <= SEWN_TOLERANCE * np.abs(corner_uvs).max()).all(axis=(0, 2))


def _has_no_hole(uv: np.ndarray, link_count: int, length: float) -> bool:
    """Return whether triangles uv (T, 3, 2), connected across so many pairs of halfedges, have the Euler characteristic of a disk."""
    vertex_count = len(np.unique(np.round(uv.reshape(-1, 2) / (SEWN_TOLERANCE * length)), axis=0))
    return vertex_count - (3 * len(uv) - link_count) + len(uv) >= 1


def _split_boxes(uv: np.ndarray, position: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return the areas (N,) of the bounding boxes of both parts of uv (T, 3, 2), split at each of the ascending `thresholds` (N,) of
    `position` (T,)."""
    order = np.argsort(position, kind="stable")
    first = np.searchsorted(position[order], thresholds)
    total = np.zeros(len(thresholds))
    for corners, counts in ((uv[order], first), (uv[order][::-1], len(order) - first)):
        low, high = np.minimum.accumulate(corners.min(axis=1)), np.maximum.accumulate(corners.max(axis=1))
        total += (high - low).prod(axis=1)[counts - 1]
    return total


def _sum_between(low: np.ndarray, high: np.ndarray, values: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """Return for each of the ascending `thresholds` (N,) the sum of `values` (I,) with low < threshold <= high."""
    starts = np.searchsorted(thresholds, low, side="right")
    stops = np.searchsorted(thresholds, high, side="right")
    changes = np.bincount(starts, values, len(thresholds) + 1) - np.bincount(stops, values, len(thresholds) + 1)
    return np.cumsum(changes)[: len(thresholds)]
