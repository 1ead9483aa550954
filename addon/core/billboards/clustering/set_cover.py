"""Greedy weighted set cover with rectangles, then shrinking rectangles and removing redundant ones."""

import heapq
from dataclasses import replace

import numpy as np

from ...geometry.transforms import frames_from_normals
from ..primitives import Primitives
from .patches import Patch
from .planes import Planes
from .rectangles import (
    approximate_min_area_axes,
    bounds_of_corners,
    compute_bounds,
    crop_rectangle,
    enclosing_rectangle,
    fit_rectangle,
    is_inside,
    rectangle_area,
)

ROUNDING = 1e-9  # Relative difference that counts as equal.
MAX_SHRINK_PASSES = 3


class _Candidate:
    """A candidate plane: the primitives that it could show, their points in the plane, and the rectangle that it last proposed."""

    def __init__(self, primitives: Primitives, axes: np.ndarray, region: np.ndarray) -> None:
        self.axes, self.region = axes, region
        points = primitives.find_points(region)
        self.corners = np.searchsorted(points, primitives.corners[region])
        self.local = primitives.points[points] @ axes.T
        self.areas = primitives.areas[region]
        self.uncovered_count = -1
        self.worth, self.rotation, self.rectangle = 0.0, np.eye(2), np.zeros(4)

    def propose(self, uncovered: np.ndarray, quad_cost: float) -> bool:
        """Find the rectangle with the most uncovered area per cost. Returns False if nothing is left to cover."""
        is_uncovered = uncovered[self.region]
        count = int(is_uncovered.sum())
        if count in (0, self.uncovered_count):  # Covered primitives stay covered: an equal count means an equal set.
            return count > 0
        self.uncovered_count = count
        corners = self.corners[is_uncovered]
        is_used = np.zeros(len(self.local), bool)
        is_used[corners] = True
        self.rotation = approximate_min_area_axes(self.local[is_used])
        bounds = bounds_of_corners((self.local @ self.rotation.T)[corners])
        self.worth, kept = crop_rectangle(bounds, self.areas[is_uncovered], quad_cost)
        self.rectangle = enclosing_rectangle(bounds[kept])
        return True

    def covered(self) -> np.ndarray:
        """Return the primitives of the region inside the proposed rectangle."""
        return self.region[is_inside(bounds_of_corners((self.local @ self.rotation.T)[self.corners]), self.rectangle)]


def choose_rectangles(
    primitives: Primitives, planes: Planes, regions: list[np.ndarray], uncovered: np.ndarray, quad_cost: float
) -> list[Patch]:
    """Choose rectangles by newly covered area per cost, best first, until none covers anything new.

    Args:
        regions: per plane the primitives that it could show. uncovered: (P,) bool, updated in place.
        quad_cost: of one more quad, as an area.
    """
    axes = frames_from_normals(planes.normals)[:, :2]
    candidates = [_Candidate(primitives, plane_axes, region) for plane_axes, region in zip(axes, regions, strict=True)]
    queue = [(-candidate.worth, index) for index, candidate in enumerate(candidates) if candidate.propose(uncovered, quad_cost)]
    heapq.heapify(queue)
    patches = []
    while queue:
        _, index = heapq.heappop(queue)
        candidate = candidates[index]
        if not candidate.propose(uncovered, quad_cost):
            continue
        # Worth only decreases as others cover primitives: a proposal that is worth more than the next one's previous worth is the best.
        if not queue or candidate.worth >= -queue[0][0] * (1.0 - ROUNDING):
            drawn = candidate.covered()
            uncovered[drawn] = False
            normal, offset, rotated = planes.normals[index], float(planes.offsets[index]), candidate.rotation @ candidate.axes
            patches.append(Patch(normal, offset, rotated, candidate.rectangle, drawn, candidate.region))
        heapq.heappush(queue, (-candidate.worth, index))
    return patches


def shrink_patches(primitives: Primitives, patches: list[Patch], quad_cost: float, passes: int = MAX_SHRINK_PASSES) -> list[Patch]:
    """Shrink every rectangle to the primitives that no other one shows, worst first, and remove patches without such primitives."""
    count = np.zeros(len(primitives), np.int32)
    for patch in patches:
        count[patch.drawn] += 1
    fitted_to: dict[int, np.ndarray] = {}
    for _ in range(passes):
        patches = sorted(patches, key=lambda patch: primitives.areas[patch.drawn].sum() / (quad_cost + rectangle_area(patch.rectangle)))
        kept = []
        for patch in patches:
            exclusive = patch.drawn[count[patch.drawn] == 1]
            if len(exclusive) and np.array_equal(exclusive, fitted_to.get(id(patch))):
                kept.append(patch)
                continue
            count[patch.drawn] -= 1
            if len(exclusive):
                kept.append(_fit_rectangle(primitives, patch, exclusive))
                fitted_to[id(kept[-1])] = exclusive
                count[kept[-1].drawn] += 1
        if len(kept) == len(patches) and all(new is old for new, old in zip(kept, patches, strict=True)):
            break
        patches = kept
    return patches


def _fit_rectangle(primitives: Primitives, patch: Patch, required: np.ndarray) -> Patch:
    """Return `patch` with the smallest rectangle around the primitives `required`, showing all primitives of its region inside."""
    axes, rectangle = fit_rectangle(primitives.points[primitives.find_points(required)], patch.axes)
    if rectangle_area(rectangle) >= rectangle_area(patch.rectangle) * (1.0 - ROUNDING):
        return patch
    drawn = patch.region[is_inside(compute_bounds(primitives.positions[patch.region], axes), rectangle)]
    return replace(patch, axes=axes, rectangle=rectangle, drawn=drawn)
