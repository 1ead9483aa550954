"""View-dependent cuts through the bintrees (BDAM, section 4), found level by level for all patches at once.

A patch is refined if its error covers more pixels than the tolerance, see `projected_errors`. A cut fits without cracks
if the two patches of a diamond are refined together. The paper achieves that by errors and spheres which are nested across diamonds; here,
refinement spreads to the other patches of diamonds instead, which needs fewer patches because bounding boxes stay small.

Cuts avoid patches that could not be read, see `store.patch_links`. Their errors may then be larger than the tolerance.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ...geometry.viewers import Viewer
from ...jobs.progress import Progress, Steps
from ..store.patch_links import NO_PATCH
from ..store.terrain_store import TerrainStore
from .projected_errors import CutSettings, ProjectedErrors


@dataclass(frozen=True)
class Cut:
    """Patches that cover the terrain once.

    Attributes:
        levels, rows: (N,) int64, the patches, see `TerrainStore.levels`.
        is_outline: (N,) bool, patches of which only the outline is shown, because the view culls all of them.
        max_error: pixels, the largest error of a patch that could be refined.
    """

    levels: np.ndarray
    rows: np.ndarray
    is_outline: np.ndarray
    max_error: float

    def __len__(self) -> int:
        return len(self.levels)

    def list_patches(self) -> list[tuple[int, int, bool]]:
        """Return the level and row of each patch, and whether its outline is shown."""
        return list(zip(self.levels.tolist(), self.rows.tolist(), self.is_outline.tolist(), strict=True))

    def count_triangles(self, store: TerrainStore) -> np.ndarray:
        """Return the number of triangles of each patch as it is shown, holes included, (N,) int64."""
        counts = np.empty(len(self), np.int64)
        for level in np.unique(self.levels).tolist():
            is_level = self.levels == level
            counts[is_level] = store.levels[level].counts[self.rows[is_level], np.where(self.is_outline[is_level], 2, 1)]
        return counts


Measure = Callable[[np.ndarray], np.ndarray]  # from numbers (N,) of patches, see `store.patch_links`, to their errors (N,)
AreVisible = Callable[[np.ndarray], np.ndarray]  # from numbers (N,) of patches to whether more than their outlines is shown, (N,) bool
IsForced = Callable[[int, np.ndarray], np.ndarray]  # from a level and rows (N,) to whether these patches must be refined, (N,) bool


def extract_cut(store: TerrainStore, viewer: Viewer, settings: CutSettings, is_forced: IsForced | None = None) -> Cut:
    """Return the coarsest consistent cut whose errors are at most the tolerance for a viewer in the local frame.

    is_forced: patches that must be refined whatever their error, such as those that are larger than the texture tiles in the same place. If
        it is true of a patch, it should be true of the parent, too: only children of refined patches are asked for.
    """
    measure = ProjectedErrors(store, viewer, settings)
    return _extract(store, measure, settings.tolerance, is_forced, measure.are_surfaces_visible)


def extract_union_cut(
    store: TerrainStore, viewers: Sequence[Viewer], settings: CutSettings, is_forced: IsForced | None = None
) -> Steps[Cut]:
    """Return the coarsest consistent cut whose errors are at most the tolerance for every one of `viewers` in the local frame.

    What any viewer refines is refined. `max_error` is the largest for any viewer. is_forced: see `extract_cut`.
    """
    refined = [np.zeros(0, np.int64)] * (len(store.levels) - 1)
    measures = [ProjectedErrors(store, viewer, settings) for viewer in viewers]
    for number, measure in enumerate(measures):
        yield Progress(0.5 * number / len(measures), "Choosing patches")
        wanted = _find_refined(store, measure, settings.tolerance, is_forced)
        for level, patches in enumerate(wanted):
            refined[level] = np.union1d(refined[level], patches)
    cut = _build_cut(store, _complete(store, refined), lambda patches: np.zeros(len(patches)))
    patches, largest = cut.rows + store.links.starts[cut.levels], 0.0
    for number, measure in enumerate(measures):
        yield Progress(0.5 + 0.5 * number / len(measures), "Measuring errors")
        largest = max(largest, float(measure(patches).max()))
    return replace(cut, max_error=largest)


def extract_uniform_cut(store: TerrainStore, max_error: float) -> Cut:
    """Return the coarsest consistent cut whose patches have an error of at most `max_error` meters everywhere."""
    return _extract(store, lambda patches: store.bounds[patches, 6].astype(np.float64), max_error)


def _extract(
    store: TerrainStore, measure: Measure, tolerance: float, is_forced: IsForced | None = None, are_visible: AreVisible | None = None
) -> Cut:
    """Return the coarsest consistent cut whose patches have at most this error according to `measure`, without forced ones."""
    return _build_cut(store, _complete(store, _find_refined(store, measure, tolerance, is_forced)), measure, are_visible)


def _find_refined(store: TerrainStore, measure: Measure, tolerance: float, is_forced: IsForced | None) -> list[np.ndarray]:
    """Return the numbers (N,), at each level from 0, of the patches that a cut must refine because of their own error or force."""
    starts, children, limits = store.links.starts, store.links.children, store.limits
    visited, refined = np.arange(starts[1]), []
    for level in range(len(store.levels) - 1):
        is_refined = measure(visited) > tolerance
        if is_forced is not None:
            is_refined |= is_forced(level, visited - starts[level])
        if limits is not None:
            is_refined = (is_refined | limits.is_required[visited]) & ~limits.is_blocked[visited]
        refined.append(visited[is_refined])
        visited = _list_children(children, refined[level])
        if not len(visited):
            break
    return refined


def _complete(store: TerrainStore, refined: list[np.ndarray]) -> np.ndarray:
    """Return which patches must be refined, (N,) bool by number; see `_complete_diamonds`. If that reaches damaged patches, these are
    refined, too."""
    is_refined, limits, starts = _complete_diamonds(store, refined), store.limits, store.links.starts
    while limits is not None:
        is_reached = (store.links.parents == NO_PATCH) | is_refined[store.links.parents]
        added = limits.is_required & is_reached & ~is_refined
        if not added.any():
            break
        is_refined |= added
        parts = [slice(int(start), int(stop)) for start, stop in pairwise(starts[:-1])]
        is_refined = _complete_diamonds(store, [np.flatnonzero(is_refined[part]) + part.start for part in parts])
    return is_refined


def _complete_diamonds(store: TerrainStore, refined: list[np.ndarray]) -> np.ndarray:
    """Return which patches must be refined, (N,) bool by number, such that the other patches of the diamonds of refined patches are
    refined, too, and all of their ancestors.

    refined: numbers (N,) at each level from 0, where the parents of all of them are refined, too.
    """
    parents, partners = store.links.parents, store.links.partners
    is_refined = np.zeros(len(parents), bool)
    for patches in refined:
        is_refined[patches] = True
    above = np.zeros(0, np.int32)  # ancestors of partners that were added at finer levels
    for level in range(len(refined) - 1, -1, -1):
        added = above[~is_refined[above]]
        is_refined[added] = True
        others = partners.take(np.concatenate([refined[level], added]))
        others = others[~is_refined[others]]
        is_refined[others] = True
        above = parents.take(np.concatenate([added, others])) if level else above
    return is_refined


def _build_cut(store: TerrainStore, is_refined: np.ndarray, measure: Measure, are_visible: AreVisible | None = None) -> Cut:
    """Return the cut below patches to be refined, (N,) bool by number."""
    starts, children = store.links.starts, store.links.children
    active, kept = np.arange(starts[1]), []
    while len(active):
        is_active_refined = is_refined[active]
        kept.append(active[~is_active_refined])
        active = _list_children(children, active[is_active_refined])
    patches, counts = np.concatenate(kept), [len(part) for part in kept]
    levels = np.repeat(np.arange(len(kept)), counts)
    is_outline = np.zeros(len(patches), bool) if are_visible is None else ~are_visible(patches)
    return Cut(levels, patches - np.repeat(starts[: len(kept)], counts), is_outline, float(measure(patches).max(initial=0.0)))


def _list_children(children: np.ndarray, patches: np.ndarray) -> np.ndarray:
    """Return the numbers (N,) of the children of patches, in ascending order."""
    numbers = children.take(patches, axis=0).ravel()
    return numbers[numbers != NO_PATCH].astype(np.intp)
