"""Patches: quads to be, as the methods find them, and who owns what."""

from dataclasses import dataclass, replace

import numpy as np

from .cloud import Quads
from .primitives import Primitives
from .rectangles import bounds_of


@dataclass(frozen=True)
class Patch:
    """One quad to be.

    normal (3,) unit and offset: the plane normal . x = offset. axes (2, 3): unit u and v in it, u x v = normal. rectangle (4,): u_min,
    u_max, v_min, v_max along them. shown (K,): the primitives drawn on it. region (R,): those it could show within its bounds.
    outline: (C, 2) polygon in the rectangle, in -1..1 of its half sides, where the method knows it; else None.
    """

    normal: np.ndarray
    offset: float
    axes: np.ndarray
    rectangle: np.ndarray
    shown: np.ndarray
    region: np.ndarray
    outline: np.ndarray | None = None


@dataclass(frozen=True)
class Covering:
    """The patches of one level, and the patch (P,) int32 that owns each primitive."""

    patches: list[Patch]
    owner: np.ndarray


def members_of(labels: np.ndarray, count: int = 0) -> list[np.ndarray]:
    """The members of every label, ascending: of 0..max, and on up to `count` - 1 where nothing has these."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.cumsum(np.bincount(labels, minlength=count))[:-1])


def squarest(primitives: Primitives, patches: list[Patch]) -> np.ndarray:
    """The patch (P,) int32 that each primitive faces most squarely among those that show it; -1 where none does."""
    owner = np.full(len(primitives), -1, np.int32)
    best = np.full(len(primitives), -np.inf)
    for number, patch in enumerate(patches):
        facing = primitives.normals[patch.shown] @ patch.normal
        better = facing > best[patch.shown]
        owner[patch.shown[better]] = number
        best[patch.shown[better]] = facing[better]
    return owner


def owners_of_groups(primitives: Primitives, patches: list[Patch], groups: np.ndarray) -> np.ndarray:
    """The patch (P,) int32 that owns each primitive when groups are owned whole: the one that shows most of the group's area."""
    count = int(groups.max()) + 1
    best, owner = np.zeros(count), np.full(count, -1, np.int32)
    for number, patch in enumerate(patches):
        shown = np.bincount(groups[patch.shown], primitives.areas[patch.shown], count)
        better = shown > best
        owner[better] = number
        best[better] = shown[better]
    return owner[groups]


def union(parts: list[tuple[np.ndarray, Covering]], count: int) -> Covering:
    """One covering of `count` primitives of coverings of some of them: each part names its primitives (K,) in the numbering of all."""
    patches: list[Patch] = []
    owner = np.full(count, -1, np.int32)
    for index, covering in parts:
        owner[index] = covering.owner + len(patches)
        patches += [replace(patch, shown=index[patch.shown], region=index[patch.region]) for patch in covering.patches]
    return Covering(patches, owner)


def overlapping(primitives: Primitives, covering: Covering, shared: np.ndarray, margin: float) -> Covering:
    """The patches with all that should be drawn on them, so that no crack opens between two quads of one surface.

    Where a connected surface is shared by quads, each reaches `margin` (a length) farther and also draws what comes in from beside
    within its bounds. Other parts, such as leaves, are drawn on one quad alone: a second picture of one would blur its outline.
    Patches with an outline of their own stay as they are; those that are left with nothing to draw go.

    Args:
        shared: (P,) bool from `surfaces.shared_surfaces`.
    """
    alone_on = _only_pictures(primitives, covering)
    drawn = []
    for number, patch in enumerate(covering.patches):
        if patch.outline is not None:
            drawn.append(patch)
            continue
        rectangle = patch.rectangle
        if shared[patch.shown].any():
            rectangle = rectangle + margin * np.array([-1.0, 1.0, -1.0, 1.0])
        bounds = bounds_of(primitives.positions[patch.region], patch.axes)
        reaching = (
            (bounds[:, 0] < rectangle[1]) & (bounds[:, 1] > rectangle[0]) & (bounds[:, 2] < rectangle[3]) & (bounds[:, 3] > rectangle[2])
        )
        candidates = np.union1d(patch.region[reaching], patch.shown)
        shown = candidates[shared[candidates] | (alone_on[candidates] == number)]
        drawn.append(replace(patch, rectangle=rectangle, shown=shown))
    needed = np.array([len(patch.shown) > 0 for patch in drawn])
    number = np.cumsum(needed, dtype=np.int32) - 1
    return Covering([patch for patch, keep in zip(drawn, needed, strict=True) if keep], number[covering.owner])


def _only_pictures(primitives: Primitives, covering: Covering) -> np.ndarray:
    """The patch (P,) int32 that draws each primitive where only one may: its owner, or the squarest of the others that show it.

    A coarse quad owns whole clusters of the finer level, and the rest of such a cluster may lie beyond its rectangle.
    """
    alone_on = squarest(primitives, covering.patches)
    for number, patch in enumerate(covering.patches):
        alone_on[patch.shown[covering.owner[patch.shown] == number]] = number
    return alone_on


def to_quads(patches: list[Patch], owner: np.ndarray) -> Quads:
    """The patches as arrays."""
    frames = np.array([np.vstack([patch.axes, patch.normal]) for patch in patches]).reshape(-1, 3, 3)
    rectangles = np.array([patch.rectangle for patch in patches]).reshape(-1, 2, 2)
    middles = np.column_stack([rectangles.mean(axis=2), [patch.offset for patch in patches]])
    return Quads(
        centers=np.einsum("qi,qij->qj", middles, frames),
        frames=frames,
        half_sizes=0.5 * np.ptp(rectangles, axis=2),
        drawn_offsets=np.cumsum([0] + [len(patch.shown) for patch in patches]).astype(np.int32),
        drawn=np.concatenate([np.sort(patch.shown) for patch in patches]).astype(np.int32),
        owner=owner.astype(np.int32),
    )
