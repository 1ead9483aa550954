"""From candidate planes to few rectangles that cover everything: a weighted set cover with overlapping quads.

A plane can show every primitive that lies within the error of it and within the normal bound. Starting from the clusters that gave the
planes, `grow` collects those; `choose` takes, again and again, the rectangle with the most newly covered area per cost; `shrink` then
cuts each rectangle to what no other shows and drops those with nothing of their own. The chosen sets give better planes for the next
round.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ..progress import Progress, Steps
from .patches import Patch, members_of, squarest
from .planes import fit_planes, frames_of
from .primitives import Primitives
from .rectangles import area, around, bounds_of, inside, nearly_smallest_rectangle, smallest_rectangle, worthwhile_part

PLANES_AT_ONCE = 256
LEAST_GAIN = 0.005  # of the cost, that makes another round worth its time


@dataclass(frozen=True)
class SafePlanes:
    """For each of G groups a plane within whose bounds it lies as a whole: normals (G, 3), offsets (G,)."""

    normals: np.ndarray
    offsets: np.ndarray


@dataclass(frozen=True)
class Groups:
    """of: (P,) the group of each primitive. members: the primitives of each. neighbours: symmetric adjacency of groups."""

    of: np.ndarray
    members: list[np.ndarray]
    neighbours: csr_matrix


@dataclass(frozen=True)
class CoverBounds:
    """error: length. max_normal_deviation: radians. quad_cost: what one more quad is worth, as an area. rounds: of fit, grow, choose."""

    error: float
    max_normal_deviation: float
    quad_cost: float
    rounds: int


def cover(
    primitives: Primitives, groups: np.ndarray, safe: SafePlanes, pairs: np.ndarray, sets: list[np.ndarray], bounds: CoverBounds
) -> Steps[list[Patch]]:
    """Patches that together show every primitive.

    Args:
        groups: (P,) int32 number of the group that each primitive belongs to; a plane shows a primitive only if it could show its
            whole group, so that a group can be owned by any quad that shows part of it.
        safe: for each group a plane that surely shows it whole.
        pairs: (E, 2) proximity graph between primitives. sets: candidate clusters, primitives each.
    """
    graph = Groups(groups, members_of(groups), _group_graph(groups, pairs))
    best: list[Patch] = []
    best_cost = np.inf
    for number in range(bounds.rounds):
        yield Progress(number / bounds.rounds, f"Covering, round {number + 1} of {bounds.rounds}")
        patches = yield from _cover_all(primitives, graph, safe, sets, bounds)
        cost = total_cost(patches, bounds.quad_cost)
        gain = 1.0 - cost / best_cost
        if gain > 0.0:
            best, best_cost = patches, cost
        if gain < LEAST_GAIN:
            break
        sets = [shown for shown in members_of(squarest(primitives, patches)) if len(shown)]
    return best


def total_cost(patches: list[Patch], quad_cost: float) -> float:
    """Area of all rectangles plus what the number of quads is worth."""
    return sum(area(patch.rectangle) for patch in patches) + quad_cost * len(patches)


def _cover_all(primitives: Primitives, graph: Groups, safe: SafePlanes, sets: list[np.ndarray], bounds: CoverBounds) -> Steps[list[Patch]]:
    """One round: planes through `sets`, then through what is left of them, and through each group that none of those could show."""
    patches: list[Patch] = []
    uncovered = np.ones(len(primitives), bool)
    for _ in range(2):
        sets = [left for left in (members[uncovered[members]] for members in sets) if len(left)]
        if sets:
            normals, offsets = fit_planes(primitives, sets)
            regions = grow(primitives, graph, normals, offsets, sets, bounds)
            yield Progress(0.5, f"Covering, {len(sets)} candidate planes")
            patches += choose(primitives, normals, offsets, regions, uncovered, bounds.quad_cost)
    lost = np.unique(graph.of[uncovered])
    if len(lost):
        normals, offsets = safe.normals[lost], safe.offsets[lost]
        regions = grow(primitives, graph, normals, offsets, [graph.members[group] for group in lost], bounds)
        patches += choose(primitives, normals, offsets, regions, uncovered, bounds.quad_cost)
    assert not uncovered.any(), "a safe plane does not show its group"
    yield Progress(0.9, f"Covering, {len(patches)} quads")
    return shrink(primitives, patches, bounds.quad_cost)


def _group_graph(groups: np.ndarray, pairs: np.ndarray) -> csr_matrix:
    """Symmetric adjacency of groups."""
    count = int(groups.max()) + 1
    a, b = groups[pairs].T
    ones = np.ones(2 * len(a), bool)
    return coo_matrix((ones, (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(count, count)).tocsr()


def grow(
    primitives: Primitives, graph: Groups, normals: np.ndarray, offsets: np.ndarray, seeds: list[np.ndarray], bounds: CoverBounds
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
            keep = _valid(primitives, flat, starts, group, normals[planes[row]], offsets[planes[row]], bounds)
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
    bounds: CoverBounds,
) -> np.ndarray:
    """Whether each `group` (K,) as a whole lies within the bounds of the plane beside it, (K,) bool."""
    lengths = starts[group + 1] - starts[group]
    ends = np.cumsum(lengths)
    index = flat[np.repeat(starts[group] - (ends - lengths), lengths) + np.arange(ends[-1])]
    which = np.repeat(np.arange(len(group)), lengths)
    fits = shows(primitives, index, normals[which], offsets[which], bounds.error, bounds.max_normal_deviation)
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


def choose(
    primitives: Primitives, normals: np.ndarray, offsets: np.ndarray, regions: list[np.ndarray], uncovered: np.ndarray, quad_cost: float
) -> list[Patch]:
    """Greedy weighted set cover: rectangles by newly covered area per cost. `uncovered` (P,) bool is updated."""
    axes = frames_of(normals)[:, :2]

    known: dict[int, tuple[int, tuple[float, np.ndarray, np.ndarray]]] = {}

    def proposal(plane: int) -> tuple[float, np.ndarray, np.ndarray] | None:
        new = regions[plane][uncovered[regions[plane]]]
        if len(new) == 0:
            return None
        if plane in known and known[plane][0] == len(new):
            return known[plane][1]
        positions = primitives.positions[new]
        turned = nearly_smallest_rectangle(positions.reshape(-1, 3) @ axes[plane].T) @ axes[plane]
        bounds = bounds_of(positions, turned)
        worth, kept = worthwhile_part(bounds, primitives.areas[new], quad_cost)
        known[plane] = len(new), (worth, turned, around(bounds[kept]))
        return known[plane][1]

    queue = []
    for plane in range(len(normals)):
        first = proposal(plane)
        if first is not None:
            queue.append((-first[0], plane))
    heapq.heapify(queue)
    patches = []
    while queue:
        _, plane = heapq.heappop(queue)
        current = proposal(plane)
        if current is None:
            continue
        # A worth only falls as others cover; the proposal is the best if it still stands before the next one's old worth.
        if queue and current[0] < -queue[0][0] * (1.0 - 1e-9):
            heapq.heappush(queue, (-current[0], plane))
            continue
        _, turned, rectangle = current
        region = regions[plane]
        shown = region[inside(bounds_of(primitives.positions[region], turned), rectangle)]
        uncovered[shown] = False
        patches.append(Patch(normals[plane], float(offsets[plane]), turned, rectangle, shown, region))
        heapq.heappush(queue, (-current[0], plane))
    return patches


def shrink(primitives: Primitives, patches: list[Patch], quad_cost: float, passes: int = 3) -> list[Patch]:
    """Cut every rectangle to what only it shows, worst first, and drop patches that show nothing of their own."""
    count = np.zeros(len(primitives), np.int32)
    for patch in patches:
        count[patch.shown] += 1
    fitted_to: dict[int, np.ndarray] = {}
    for _ in range(passes):
        patches.sort(key=lambda patch: primitives.areas[patch.shown].sum() / (quad_cost + area(patch.rectangle)))
        kept = []
        for patch in patches:
            alone = patch.shown[count[patch.shown] == 1]
            if len(alone) and np.array_equal(alone, fitted_to.get(id(patch))):
                kept.append(patch)
                continue
            count[patch.shown] -= 1
            if len(alone):
                kept.append(_fitted(primitives, patch, alone))
                fitted_to[id(kept[-1])] = alone
                count[kept[-1].shown] += 1
        if len(kept) == len(patches) and all(new is old for new, old in zip(kept, patches, strict=True)):
            break
        patches = kept
    return patches


def _fitted(primitives: Primitives, patch: Patch, needed: np.ndarray) -> Patch:
    """`patch` with the smallest rectangle around `needed`, showing all of its region that lies within."""
    positions = primitives.positions[needed]
    turned = smallest_rectangle(positions.reshape(-1, 3) @ patch.axes.T) @ patch.axes
    rectangle = around(bounds_of(positions, turned))
    if area(rectangle) >= area(patch.rectangle) * (1.0 - 1e-9):
        return patch
    shown = patch.region[inside(bounds_of(primitives.positions[patch.region], turned), rectangle)]
    return Patch(patch.normal, patch.offset, turned, rectangle, shown, patch.region)
