"""Covering all primitives with few rectangles on candidate planes: a weighted set cover with overlapping quads.

A plane can show every primitive within its bounds. `grow_regions` collects these, starting from the clusters that the planes were fitted
to; `choose_rectangles` repeatedly adds the rectangle with the most newly covered area per cost; `shrink_patches` then shrinks each
rectangle to the primitives that no other shows and removes those without any. The sets of primitives on the chosen quads give better planes
for the next round.
"""

from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Progress, Steps, subprogress
from ..primitives import Primitives
from .patches import Patch, best_facing_patch, group_by_label
from .planes import PlaneBounds, Planes, fit_planes
from .rectangles import rectangle_area
from .region_growing import PrimitiveGroups, build_groups, grow_regions
from .set_cover import choose_rectangles, shrink_patches

MIN_GAIN = 0.005  # A smaller relative gain of the cost ends the rounds.
FITS_PER_ROUND = 2  # Planes are fitted to the candidate sets, then to their uncovered rest.


@dataclass(frozen=True)
class CoverSettings:
    """bounds: of every quad. quad_cost: of one more quad, as an area. max_rounds: of fitting, growing and choosing."""

    bounds: PlaneBounds
    quad_cost: float
    max_rounds: int


def cover_with_rectangles(
    primitives: Primitives,
    labels: np.ndarray,
    fallback: Planes,
    pairs: np.ndarray,
    candidates: list[np.ndarray],
    settings: CoverSettings,
) -> Steps[list[Patch]]:
    """Find patches that together show every primitive.

    Args:
        labels: (P,) int32 group of each primitive. A plane shows a primitive only if it could show its whole group, so that a group can be
            owned by any quad that shows part of it.
        fallback: per group a plane that is known to show all of it.
        pairs: (E, 2) proximity graph of the primitives.
        candidates: sets of primitives to fit planes to.
    """
    groups = build_groups(labels, pairs)
    best: list[Patch] = []
    best_cost = np.inf
    for index in range(settings.max_rounds):
        yield Progress(index / settings.max_rounds, f"Covering, round {index + 1} of {settings.max_rounds}")
        steps = _cover_once(primitives, groups, fallback, candidates, settings)
        patches = yield from subprogress(steps, index / settings.max_rounds, (index + 1) / settings.max_rounds)
        cost = total_cost(patches, settings.quad_cost)
        gain = 1.0 - cost / best_cost
        if gain > 0.0:
            best, best_cost = patches, cost
        if gain < MIN_GAIN:
            break
        candidates = [members for members in group_by_label(best_facing_patch(primitives, patches)) if len(members)]
    return shrink_patches(primitives, best, settings.quad_cost)


def total_cost(patches: list[Patch], quad_cost: float) -> float:
    """Return the area of all rectangles plus the cost of the quads."""
    return sum(rectangle_area(patch.rectangle) for patch in patches) + quad_cost * len(patches)


def _cover_once(
    primitives: Primitives, groups: PrimitiveGroups, fallback: Planes, candidates: list[np.ndarray], settings: CoverSettings
) -> Steps[list[Patch]]:
    """Run one round: planes of the `candidates`, then of their uncovered rest, then of each group that none of these could show."""
    patches: list[Patch] = []
    uncovered = np.ones(len(primitives), bool)
    for _ in range(FITS_PER_ROUND):
        candidates = [rest for rest in (members[uncovered[members]] for members in candidates) if len(rest)]
        if candidates:
            planes = fit_planes(primitives, candidates)
            regions = grow_regions(primitives, groups, planes, candidates, settings.bounds)
            yield Progress(0.5, f"Covering, {len(candidates)} candidate planes")
            patches += choose_rectangles(primitives, planes, regions, uncovered, settings.quad_cost)
    missing = np.unique(groups.labels[uncovered])
    if len(missing):
        planes = fallback.subset(missing)
        seeds = [groups.members[group] for group in missing]
        regions = grow_regions(primitives, groups, planes, seeds, settings.bounds)
        patches += choose_rectangles(primitives, planes, regions, uncovered, settings.quad_cost)
    assert not uncovered.any(), "a fallback plane does not show its group"
    yield Progress(0.9, f"Covering, {len(patches)} quads")
    return shrink_patches(primitives, patches, settings.quad_cost, passes=1)
