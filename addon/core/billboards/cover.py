"""From candidate planes to few rectangles that cover everything: a weighted set cover with overlapping quads.

A plane can show every primitive that lies within the error of it and within the normal bound. Starting from the clusters that gave the
planes, `grow` collects those; `choose` takes, again and again, the rectangle with the most newly covered area per cost; `shrink` then
cuts each rectangle to what no other shows and drops those with nothing of their own. The chosen sets give better planes for the next
round.
"""

from dataclasses import dataclass

import numpy as np

from ..progress import Progress, Steps, scaled
from .growth import Groups, groups_of, grow
from .patches import Patch, members_of, squarest
from .planes import fit_planes
from .primitives import Primitives
from .rectangles import area
from .selection import choose, shrink

LEAST_GAIN = 0.005  # of the cost, that makes another round worth its time


@dataclass(frozen=True)
class SafePlanes:
    """For each of G groups a plane within whose bounds it lies as a whole: normals (G, 3), offsets (G,)."""

    normals: np.ndarray
    offsets: np.ndarray


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
    graph = groups_of(groups, pairs)
    best: list[Patch] = []
    best_cost = np.inf
    for number in range(bounds.rounds):
        yield Progress(number / bounds.rounds, f"Covering, round {number + 1} of {bounds.rounds}")
        covering = _cover_all(primitives, graph, safe, sets, bounds)
        patches = yield from scaled(covering, number / bounds.rounds, (number + 1) / bounds.rounds)
        cost = total_cost(patches, bounds.quad_cost)
        gain = 1.0 - cost / best_cost
        if gain > 0.0:
            best, best_cost = patches, cost
        if gain < LEAST_GAIN:
            break
        sets = [shown for shown in members_of(squarest(primitives, patches)) if len(shown)]
    return shrink(primitives, best, bounds.quad_cost)


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
            regions = grow(primitives, graph, normals, offsets, sets, bounds.error, bounds.max_normal_deviation)
            yield Progress(0.5, f"Covering, {len(sets)} candidate planes")
            patches += choose(primitives, normals, offsets, regions, uncovered, bounds.quad_cost)
    lost = np.unique(graph.of[uncovered])
    if len(lost):
        normals, offsets = safe.normals[lost], safe.offsets[lost]
        seeds = [graph.members[group] for group in lost]
        regions = grow(primitives, graph, normals, offsets, seeds, bounds.error, bounds.max_normal_deviation)
        patches += choose(primitives, normals, offsets, regions, uncovered, bounds.quad_cost)
    assert not uncovered.any(), "a safe plane does not show its group"
    yield Progress(0.9, f"Covering, {len(patches)} quads")
    return shrink(primitives, patches, bounds.quad_cost, passes=1)
