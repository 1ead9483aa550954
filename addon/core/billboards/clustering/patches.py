"""Patches: the planned quads of a level, before they become arrays, and the ownership of primitives."""

from dataclasses import dataclass, replace

import numpy as np

from ..cloud import Chart, Quads
from ..primitives import Primitives
from .rectangles import compute_bounds

# Extension of the patches of one surface over each other, in errors: quads that meet at an edge with a bevel leave a gap of up to about
# MAX_MARGIN. Narrow patches are extended by less, at least MIN_MARGIN, since a column would become thicker.
MIN_MARGIN, MAX_MARGIN = 0.25, 0.5
MARGIN_FRACTION = 1.0 / 16.0  # Of the shorter side.


@dataclass(frozen=True)
class Patch:
    """A planned quad in the plane normal . x = offset.

    Attributes:
        normal: (3,) unit vector.
        offset: Offset of the plane.
        axes: (2, 3) unit u and v in the plane, u x v = normal.
        rectangle: (4,) u_min, u_max, v_min, v_max along the axes.
        drawn: (K,) primitives drawn on it.
        region: (R,) primitives that it could show within its bounds.
        outline: (C, 2) polygon in the rectangle, in -1..1 of its half sizes, if the method determines it; otherwise None.
        chart: The part of a mesh that is shown in its place, if any.
        is_crossed: It crosses another patch that shows the same, so that they must not shade each other.
    """

    normal: np.ndarray
    offset: float
    axes: np.ndarray
    rectangle: np.ndarray
    drawn: np.ndarray
    region: np.ndarray
    outline: np.ndarray | None = None
    chart: Chart | None = None
    is_crossed: bool = False

    @property
    def is_fixed(self) -> bool:
        """Whether its outline is given, so that nothing is added to it."""
        return self.outline is not None or self.chart is not None


@dataclass(frozen=True)
class Covering:
    """The patches of one level, and the patch (P,) int32 that owns each primitive."""

    patches: list[Patch]
    owner: np.ndarray


def group_by_label(labels: np.ndarray, count: int = 0) -> list[np.ndarray]:
    """Return the members of every label 0..max, ascending; up to `count` - 1 if that is more, with empty members."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.cumsum(np.bincount(labels, minlength=count))[:-1])


def best_facing_patch(primitives: Primitives, patches: list[Patch]) -> np.ndarray:
    """Find the patch (P,) int32 with the smallest angle to each primitive among those that show it; -1 if none does."""
    owner = np.full(len(primitives), -1, np.int32)
    best = np.full(len(primitives), -np.inf)
    for index, patch in enumerate(patches):
        cosines = primitives.normals[patch.drawn] @ patch.normal
        better = cosines > best[patch.drawn]
        owner[patch.drawn[better]] = index
        best[patch.drawn[better]] = cosines[better]
    return owner


def assign_groups(primitives: Primitives, patches: list[Patch], groups: np.ndarray) -> np.ndarray:
    """Assign whole groups to patches: the patch (P,) int32 that owns each primitive shows most of the area of its group."""
    count = int(groups.max()) + 1
    best, owner = np.zeros(count), np.full(count, -1, np.int32)
    for index, patch in enumerate(patches):
        drawn_areas = np.bincount(groups[patch.drawn], primitives.areas[patch.drawn], count)
        better = drawn_areas > best
        owner[better] = index
        best[better] = drawn_areas[better]
    return owner[groups]


def merge_coverings(parts: list[tuple[np.ndarray, Covering]], count: int) -> Covering:
    """Merge coverings of subsets of `count` primitives. Each part has the indices (K,) of its primitives among all."""
    patches: list[Patch] = []
    owner = np.full(count, -1, np.int32)
    for indices, covering in parts:
        owner[indices] = covering.owner + len(patches)
        patches += [replace(patch, drawn=indices[patch.drawn], region=indices[patch.region]) for patch in covering.patches]
    return Covering(patches, owner)


def extend_overlaps(primitives: Primitives, covering: Covering, shared: np.ndarray, error: float) -> Covering:
    """Choose what is drawn on every patch, so that no crack opens between two quads of one surface.

    Each patch of a connected surface with several quads is extended, by at most MAX_MARGIN of `error`, a length, and also draws the
    adjacent primitives within its bounds. Other components, such as leaves, are drawn on one quad only: a second image would blur their
    outline. Patches with an outline or a chart do not change; patches without drawn primitives are removed.

    Args:
        shared: (P,) bool from `find_shared_surfaces`.
    """
    single_patch = _find_single_patch(primitives, covering)
    patches = []
    for index, patch in enumerate(covering.patches):
        if patch.is_fixed:
            patches.append(patch)
            continue
        rectangle = patch.rectangle
        if shared[patch.drawn].any():
            margin = np.clip(MARGIN_FRACTION * np.ptp(rectangle.reshape(2, 2), axis=1).min(), MIN_MARGIN * error, MAX_MARGIN * error)
            rectangle = rectangle + margin * np.array([-1.0, 1.0, -1.0, 1.0])
        bounds = compute_bounds(primitives.positions[patch.region], patch.axes)
        overlaps = (
            (bounds[:, 0] < rectangle[1]) & (bounds[:, 1] > rectangle[0]) & (bounds[:, 2] < rectangle[3]) & (bounds[:, 3] > rectangle[2])
        )
        candidates = np.union1d(patch.region[overlaps], patch.drawn)
        drawn = candidates[shared[candidates] | (single_patch[candidates] == index)]
        patches.append(replace(patch, rectangle=rectangle, drawn=drawn))
    is_kept = np.array([len(patch.drawn) > 0 for patch in patches])
    new_index = np.cumsum(is_kept, dtype=np.int32) - 1
    return Covering([patch for patch, keep in zip(patches, is_kept, strict=True) if keep], new_index[covering.owner])


def _find_single_patch(primitives: Primitives, covering: Covering) -> np.ndarray:
    """Find the patch (P,) int32 that draws a primitive if only one may: its owner, or the best facing one of those that show it.

    A coarse quad owns whole clusters of the finer level, and the rest of such a cluster may be outside its rectangle.
    """
    single_patch = best_facing_patch(primitives, covering.patches)
    for index, patch in enumerate(covering.patches):
        single_patch[patch.drawn[covering.owner[patch.drawn] == index]] = index
    return single_patch


def to_quads(patches: list[Patch], owner: np.ndarray) -> Quads:
    """Convert the patches to arrays."""
    frames = np.array([np.vstack([patch.axes, patch.normal]) for patch in patches]).reshape(-1, 3, 3)
    rectangles = np.array([patch.rectangle for patch in patches]).reshape(-1, 2, 2)
    local_centers = np.column_stack([rectangles.mean(axis=2), [patch.offset for patch in patches]])
    return Quads(
        centers=np.einsum("qi,qij->qj", local_centers, frames),
        frames=frames,
        half_sizes=0.5 * np.ptp(rectangles, axis=2),
        drawn_offsets=np.cumsum([0] + [len(patch.drawn) for patch in patches]).astype(np.int32),
        drawn=np.concatenate([np.sort(patch.drawn) for patch in patches]).astype(np.int32),
        owner=owner.astype(np.int32),
    )
