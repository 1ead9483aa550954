"""How cuts avoid damaged patches without cracks.

A damaged patch that has children is refined wherever a cut reaches it. Instead of a damaged leaf its parent is shown, together with the
other patch of the parent's diamond. Patches stay that coarse around it as far as a cut without cracks needs it.
"""

from dataclasses import dataclass

import numpy as np

from .patch_links import NO_PATCH, PatchLinks


@dataclass(frozen=True)
class PatchLimits:
    """Which patches a cut must refine, and which it cannot, by number.

    is_required: (N,) bool, damaged patches. is_blocked: (N,) bool, patches above leaves below which there is no consistent cut without
    damaged patches. If it is true of a patch, it is true of the other patch of its diamond and of its descendants above leaves.
    """

    is_required: np.ndarray
    is_blocked: np.ndarray


def find_limits(links: PatchLinks, is_damaged: np.ndarray) -> PatchLimits:
    """Return the limits of cuts for damaged patches, (N,) bool. Cuts then contain none but roots for which there is no replacement."""
    is_leaf = (links.children == NO_PATCH).all(axis=1)
    is_blocked = is_leaf.copy()
    while True:
        shown = np.flatnonzero(is_damaged & is_blocked & (links.parents != NO_PATCH))
        parents = links.parents[shown]
        added = parents[~is_blocked[parents]]
        if not len(added):
            return PatchLimits(is_damaged & ~is_blocked, is_blocked & ~is_leaf)
        is_blocked[added] = True
        _spread(links, is_blocked)


def _spread(links: PatchLinks, is_blocked: np.ndarray) -> None:
    """Block the other patches of diamonds, and children."""
    for level, (start, stop) in enumerate(zip(links.starts[:-1], links.starts[1:], strict=True)):
        part = slice(int(start), int(stop))
        if level:
            is_blocked[part] |= is_blocked[links.parents[part]]
        is_blocked[part] |= is_blocked[links.partners[part]]
