"""Which rectangles to take: a greedy weighted set cover, then cut to what is needed."""

import heapq
from dataclasses import replace

import numpy as np

from .patches import Patch
from .planes import frames_of
from .primitives import Primitives
from .rectangles import area, around, bounds_of, inside, nearly_smallest_rectangle, smallest_rectangle, worthwhile_part


class _Plane:
    """One candidate: what it could show, where that lies in the plane, and the rectangle that it last proposed."""

    def __init__(self, primitives: Primitives, axes: np.ndarray, region: np.ndarray) -> None:
        self.axes, self.region = axes, region
        self.local = primitives.positions[region] @ axes.T
        self.areas = primitives.areas[region]
        self.left = -1
        self.worth, self.turn, self.rectangle = 0.0, np.eye(2), np.zeros(4)

    def propose(self, uncovered: np.ndarray, quad_cost: float) -> bool:
        """Look for the rectangle with the most uncovered area per cost; False when nothing is left to cover."""
        new = uncovered[self.region]
        left = int(new.sum())
        if left in (0, self.left):  # what is covered stays so: an equal count means an equal set
            return left > 0
        local = self.local[new]
        self.left = left
        self.turn = nearly_smallest_rectangle(local.reshape(-1, 2))
        bounds = bounds_of(local, self.turn)
        self.worth, kept = worthwhile_part(bounds, self.areas[new], quad_cost)
        self.rectangle = around(bounds[kept])
        return True

    def shown(self) -> np.ndarray:
        """The primitives of the region within the proposed rectangle."""
        return self.region[inside(bounds_of(self.local, self.turn), self.rectangle)]


def choose(
    primitives: Primitives, normals: np.ndarray, offsets: np.ndarray, regions: list[np.ndarray], uncovered: np.ndarray, quad_cost: float
) -> list[Patch]:
    """Rectangles by newly covered area per cost, best first, until none covers anything new. `uncovered` (P,) bool is updated."""
    axes = frames_of(normals)[:, :2]
    planes = [_Plane(primitives, own, region) for own, region in zip(axes, regions, strict=True)]
    queue = [(-plane.worth, number) for number, plane in enumerate(planes) if plane.propose(uncovered, quad_cost)]
    heapq.heapify(queue)
    patches = []
    while queue:
        _, number = heapq.heappop(queue)
        plane = planes[number]
        if not plane.propose(uncovered, quad_cost):
            continue
        # A worth only falls as others cover; the proposal is the best if it still stands before the next one's old worth.
        if not queue or plane.worth >= -queue[0][0] * (1.0 - 1e-9):
            shown = plane.shown()
            uncovered[shown] = False
            patches.append(Patch(normals[number], float(offsets[number]), plane.turn @ plane.axes, plane.rectangle, shown, plane.region))
        heapq.heappush(queue, (-plane.worth, number))
    return patches


def shrink(primitives: Primitives, patches: list[Patch], quad_cost: float, passes: int = 3) -> list[Patch]:
    """Cut every rectangle to what only it shows, worst first, and drop patches that show nothing of their own."""
    count = np.zeros(len(primitives), np.int32)
    for patch in patches:
        count[patch.shown] += 1
    fitted_to: dict[int, np.ndarray] = {}
    for _ in range(passes):
        patches = sorted(patches, key=lambda patch: primitives.areas[patch.shown].sum() / (quad_cost + area(patch.rectangle)))
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
    return replace(patch, axes=turned, rectangle=rectangle, shown=shown)
