"""Region growing: the primitives that a plane can show and that are connected to the cluster of the plane."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...arrays import concatenate_ranges
from ..primitives import Primitives
from .patches import group_by_label
from .planes import PlaneBounds, Planes

PLANES_PER_BATCH = 256  # Bounds the memory of the flags per plane and group.


@dataclass(frozen=True)
class PrimitiveGroups:
    """Groups of primitives. labels (P,): group of each primitive. members: primitives of each group. adjacency: symmetric, of groups."""

    labels: np.ndarray
    members: list[np.ndarray]
    adjacency: csr_matrix


def build_groups(labels: np.ndarray, pairs: np.ndarray) -> PrimitiveGroups:
    """Build groups from `labels` (P,); groups are adjacent if one of the `pairs` (E, 2) of primitives joins them."""
    count = int(labels.max()) + 1
    a, b = labels[pairs].T
    ones = np.ones(2 * len(a), bool)
    adjacency = coo_matrix((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count)).tocsr()
    return PrimitiveGroups(labels, group_by_label(labels), adjacency)


def grow_regions(
    primitives: Primitives, groups: PrimitiveGroups, planes: Planes, seeds: list[np.ndarray], bounds: PlaneBounds
) -> list[np.ndarray]:
    """Find per plane the primitives (K,) that it can show and that are connected to its seeds in the proximity graph.

    Whole groups are shown or not. `seeds`: primitives per plane.
    """
    members, group_count = groups.members, groups.adjacency.shape[0]
    flat_members = np.concatenate(members), np.cumsum([0] + [len(member) for member in members])
    regions: list[np.ndarray] = []
    for first in range(0, len(planes), PLANES_PER_BATCH):
        batch = np.arange(first, min(first + PLANES_PER_BATCH, len(planes)))
        is_visited = np.zeros((len(batch), group_count), bool)
        is_valid = np.zeros((len(batch), group_count), bool)
        for row, plane in enumerate(batch):
            is_visited[row, groups.labels[seeds[plane]]] = True
        row, group = np.nonzero(is_visited)
        while len(row):
            accepted = _test_groups(primitives, flat_members, group, planes.subset(batch[row]), bounds)
            row, group = row[accepted], group[accepted]
            is_valid[row, group] = True
            row, group = _visit_neighbors(groups.adjacency, row, group, is_visited)
        for mask in is_valid:
            regions.append(np.sort(np.concatenate([members[group] for group in np.flatnonzero(mask)] or [np.empty(0, np.int64)])))
    return regions


def _visit_neighbors(adjacency: csr_matrix, row: np.ndarray, group: np.ndarray, is_visited: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unvisited neighbors of `group` (K,) for the planes `row` (K,), and mark them as visited."""
    start, stop = adjacency.indptr[group], adjacency.indptr[group + 1]
    lengths = stop - start
    keys = np.repeat(row, lengths).astype(np.int64) * is_visited.shape[1] + adjacency.indices[concatenate_ranges(start, lengths)]
    keys = keys[~is_visited.reshape(-1)[keys]]
    is_visited.reshape(-1)[keys] = True
    keys = np.unique(keys)
    return keys // is_visited.shape[1], keys % is_visited.shape[1]


def _test_groups(
    primitives: Primitives, flat_members: tuple[np.ndarray, np.ndarray], group: np.ndarray, planes: Planes, bounds: PlaneBounds
) -> np.ndarray:
    """Test whether all primitives of each `group` (K,) satisfy the bounds of the plane in the same row: (K,) bool.

    flat_members: the primitives of all groups one after the other, and the index of the first one of each group.
    """
    members, starts = flat_members
    lengths = starts[group + 1] - starts[group]
    first_rows = np.cumsum(lengths) - lengths
    index = members[concatenate_ranges(starts[group], lengths)]
    row = np.repeat(np.arange(len(group)), lengths)
    fits = bounds.contain(primitives.positions[index], primitives.normals[index], planes.normals[row], planes.offsets[row])
    return np.logical_and.reduceat(fits, first_rows)
