"""What a plane can show: the primitives within its bounds that hang together with the cluster that gave the plane."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from .patches import members_of
from .primitives import Primitives

PLANES_AT_ONCE = 256


@dataclass(frozen=True)
class Groups:
    """of: (P,) the group of each primitive. members: the primitives of each. neighbours: symmetric adjacency of groups."""

    of: np.ndarray
    members: list[np.ndarray]
    neighbours: csr_matrix


def groups_of(labels: np.ndarray, pairs: np.ndarray) -> Groups:
    """Groups by `labels` (P,), neighbours where `pairs` (E, 2) of primitives join two."""
    return Groups(labels, members_of(labels), _group_graph(labels, pairs))


def _group_graph(groups: np.ndarray, pairs: np.ndarray) -> csr_matrix:
    """Symmetric adjacency of groups."""
    count = int(groups.max()) + 1
    a, b = groups[pairs].T
    ones = np.ones(2 * len(a), bool)
    return coo_matrix((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count)).tocsr()


def grow(
    primitives: Primitives,
    graph: Groups,
    normals: np.ndarray,
    offsets: np.ndarray,
    seeds: list[np.ndarray],
    error: float,
    max_normal_deviation: float,
) -> list[np.ndarray]:
    """For each plane the primitives (K,) it can show that hang together with its seed in the proximity graph."""
    groups, members, neighbours = graph.of, graph.members, graph.neighbours
    count = neighbours.shape[0]
    flat, starts = np.concatenate(members), np.cumsum([0] + [len(member) for member in members])
    regions: list[np.ndarray] = []
    for first in range(0, len(normals), PLANES_AT_ONCE):
        planes = np.arange(first, min(first + PLANES_AT_ONCE, len(normals)))
        seen = np.zeros((len(planes), count), bool)
        valid = np.zeros((len(planes), count), bool)
        for row, plane in enumerate(planes):
            seen[row, groups[seeds[plane]]] = True
        row, group = np.nonzero(seen)
        while len(row):
            keep = _valid(primitives, flat, starts, group, normals[planes[row]], offsets[planes[row]], error, max_normal_deviation)
            row, group = row[keep], group[keep]
            valid[row, group] = True
            row, group = _unseen_neighbours(neighbours, row, group, seen)
        for mask in valid:
            regions.append(np.sort(np.concatenate([members[group] for group in np.flatnonzero(mask)] or [np.empty(0, np.int64)])))
    return regions


def _unseen_neighbours(neighbours: csr_matrix, row: np.ndarray, group: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The neighbours of `group`, plane by plane, that were not looked at yet; they are marked as seen."""
    start, stop = neighbours.indptr[group], neighbours.indptr[group + 1]
    lengths = stop - start
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    keys = np.repeat(row, lengths).astype(np.int64) * seen.shape[1] + neighbours.indices[np.repeat(start, lengths) + within]
    keys = keys[~seen.reshape(-1)[keys]]
    seen.reshape(-1)[keys] = True
    keys = np.unique(keys)
    return keys // seen.shape[1], keys % seen.shape[1]


def _valid(
    primitives: Primitives,
    flat: np.ndarray,
    starts: np.ndarray,
    group: np.ndarray,
    normals: np.ndarray,
    offsets: np.ndarray,
    error: float,
    max_normal_deviation: float,
) -> np.ndarray:
    """Whether each `group` (K,) as a whole lies within the bounds of the plane beside it, (K,) bool."""
    lengths = starts[group + 1] - starts[group]
    ends = np.cumsum(lengths)
    index = flat[np.repeat(starts[group] - (ends - lengths), lengths) + np.arange(ends[-1])]
    which = np.repeat(np.arange(len(group)), lengths)
    fits = shows(primitives, index, normals[which], offsets[which], error, max_normal_deviation)
    return np.logical_and.reduceat(fits, ends - lengths)


def shows(
    primitives: Primitives, index: np.ndarray, normals: np.ndarray, offsets: np.ndarray, error: float, max_normal_deviation: float
) -> np.ndarray:
    """Whether primitive index[i] lies within `error` and the normal bound of plane i: (K,) bool."""
    fits = np.einsum("ki,ki->k", primitives.normals[index], normals) >= np.cos(max_normal_deviation)
    for corner in range(primitives.corners.shape[1]):
        positions = primitives.points[primitives.corners[index, corner]]
        fits &= np.abs(np.einsum("ki,ki->k", positions, normals) - offsets) <= error
    return fits
