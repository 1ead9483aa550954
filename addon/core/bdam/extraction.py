"""View-dependent cuts through the bintrees (BDAM, section 4), found level by level for all patches at once.

A patch is refined if its error, seen from the point of its bounding box nearest to the viewer, is larger than the tolerance. A cut fits
without cracks if the two patches of a diamond are refined together. The paper achieves that by errors and spheres which are nested across
diamonds; here, refinement spreads to the other patches of diamonds instead, which needs fewer patches because bounding boxes stay small.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.viewers import Viewer
from ..jobs.progress import Progress, Steps
from .store.structure import Level
from .store.terrain_store import TerrainStore


@dataclass(frozen=True)
class CutSettings:
    """How a cut is chosen.

    tolerance: pixels. exaggeration: factor of heights. culls: whether patches outside of the view stay coarse. margin: by which the view
    that culls is larger on every side, as a fraction of its size.
    """

    tolerance: float = 1.0
    exaggeration: float = 1.0
    culls: bool = False
    margin: float = 0.0


@dataclass(frozen=True)
class Cut:
    """Patches that cover the terrain once.

    levels, rows: (N,) int64, the patches, see `TerrainStore.levels`. max_error: pixels, the largest error of a patch that could be refined.
    """

    levels: np.ndarray
    rows: np.ndarray
    max_error: float

    def __len__(self) -> int:
        return len(self.levels)


Measure = Callable[[int, np.ndarray], np.ndarray]  # from a level and rows (N,) to the errors (N,) of patches
IsForced = Callable[[int, np.ndarray], np.ndarray]  # from a level and rows (N,) to whether these patches must be refined, (N,) bool


def extract_cut(store: TerrainStore, viewer: Viewer, settings: CutSettings, is_forced: IsForced | None = None) -> Cut:
    """Return the coarsest consistent cut whose errors are at most the tolerance for a viewer in the local frame.

    is_forced: patches that must be refined whatever their error, such as those that are larger than the texture tiles in the same place. If
        it is true of a patch, it should be true of the parent, too: only children of refined patches are asked for.
    """
    measure = ProjectedErrors(store, viewer, settings)
    return _extract(store, measure, settings.tolerance, is_forced)


def extract_union_cut(
    store: TerrainStore, viewers: Sequence[Viewer], settings: CutSettings, are_forced: Sequence[IsForced | None] = ()
) -> Steps[Cut]:
    """Return the coarsest consistent cut whose errors are at most the tolerance for every one of `viewers` in the local frame.

    What any viewer refines is refined. `max_error` is the largest for any viewer.

    Args:
        viewers: at least one. are_forced: see `extract_cut`, for each viewer; empty for none.
    """
    refined = [np.zeros(0, np.int64)] * (len(store.levels) - 1)
    measures = [ProjectedErrors(store, viewer, settings) for viewer in viewers]
    for number, measure in enumerate(measures):
        yield Progress(0.5 * number / len(measures), "Choosing patches")
        wanted = _find_refined(store, measure, settings.tolerance, are_forced[number] if are_forced else None)
        for level, rows in enumerate(wanted):
            refined[level] = np.union1d(refined[level], rows)
    cut = _build_cut(store, _complete_diamonds(store, refined), lambda _level, rows: np.zeros(len(rows)))
    largest = 0.0
    for number, measure in enumerate(measures):
        yield Progress(0.5 + 0.5 * number / len(measures), "Measuring errors")
        largest = max([largest, *(float(measure(level, cut.rows[cut.levels == level]).max()) for level in np.unique(cut.levels).tolist())])
    return replace(cut, max_error=largest)


class ProjectedErrors:
    """The errors in pixels that decide about a cut for a viewer in the local frame; 0 for patches that are culled."""

    def __init__(self, store: TerrainStore, viewer: Viewer, settings: CutSettings) -> None:
        self._store, self._viewer, self._exaggeration = store, viewer, settings.exaggeration
        self._planes = view_planes(viewer, settings.margin) if settings.culls else None

    def __call__(self, level: int, rows: np.ndarray) -> np.ndarray:
        """Return the errors (N,) float64 of patches, given by their level and rows (N,)."""
        patches = self._store.levels[level]
        errors = project_errors(patches, rows, self._viewer, self._exaggeration)
        if self._planes is not None:
            low, high = _boxes(patches, rows, self._exaggeration)
            errors[~are_boxes_visible(low, high, self._planes)] = 0.0
        return errors


def view_planes(viewer: Viewer, margin: float) -> np.ndarray:
    """Return the planes (P, 4), positive inside, of the frustum of an image that is larger on every side by a fraction of its size."""
    if viewer.projection.kind == "panoramic":
        return viewer.frustum_planes()
    left, right, bottom, top = viewer.projection.window
    x, y = margin * (right - left), margin * (top - bottom)
    window = (left - x, right + x, bottom - y, top + y)
    return replace(viewer, projection=replace(viewer.projection, window=window)).frustum_planes()


def extract_uniform_cut(store: TerrainStore, max_error: float) -> Cut:
    """Return the coarsest consistent cut whose patches have an error of at most `max_error` meters everywhere."""
    return _extract(store, lambda level, rows: store.levels[level].errors[rows].astype(np.float64), max_error)


def _extract(store: TerrainStore, measure: Measure, tolerance: float, is_forced: IsForced | None = None) -> Cut:
    """Return the coarsest consistent cut whose patches have at most this error according to `measure(level, rows)`, without forced ones."""
    return _build_cut(store, _complete_diamonds(store, _find_refined(store, measure, tolerance, is_forced)), measure)


def _find_refined(store: TerrainStore, measure: Measure, tolerance: float, is_forced: IsForced | None) -> list[np.ndarray]:
    """Return the rows (N,) int64, at each level from 0, of the patches that a cut must refine because of their own error or force."""
    visited, refined = np.arange(len(store.levels[0].indices)), []
    for level in range(len(store.levels) - 1):
        is_refined = measure(level, visited) > tolerance
        if is_forced is not None:
            is_refined |= is_forced(level, visited)
        refined.append(visited[is_refined])
        children = store.children[level][refined[level]].ravel()
        visited = children[children >= 0]
        if not len(visited):
            break
    return refined


def _build_cut(store: TerrainStore, refined: list[np.ndarray], measure: Measure) -> Cut:
    """Return the cut below patches to be refined, in rows (N,) at each level, that `_complete_diamonds` has completed."""
    levels, rows = [], []
    active = np.arange(len(store.levels[0].indices))
    largest = 0.0
    for level in range(len(store.levels)):
        is_refined = np.isin(active, refined[level]) if level < len(refined) else np.zeros(len(active), bool)
        kept = active[~is_refined]
        levels.append(np.full(len(kept), level))
        rows.append(kept)
        largest = max(largest, float(measure(level, kept).max(initial=0.0)))
        if level < len(refined):
            children = store.children[level][active[is_refined]].ravel()
            active = children[children >= 0]
        if not len(active):
            break
    return Cut(np.concatenate(levels), np.concatenate(rows), largest)


def _complete_diamonds(store: TerrainStore, refined: list[np.ndarray]) -> list[np.ndarray]:
    """Return the rows to refine at each level, such that the parents of refined patches and the other patches of their diamonds are
    refined.

    refined: rows (N,) at each level from 0.
    """
    complete: list[np.ndarray] = [np.zeros(0, np.int64)] * len(refined)
    parents = np.zeros(0, np.int64)
    for level in range(len(refined) - 1, -1, -1):
        rows = np.concatenate([refined[level], parents])
        rows = np.unique(np.concatenate([rows, store.partners[level][rows]]))
        complete[level] = rows
        if level:
            parents = np.searchsorted(store.levels[level - 1].indices, store.levels[level].indices[rows] >> 1)
    return complete


def project_errors(patches: Level, rows: np.ndarray, viewer: Viewer, exaggeration: float) -> np.ndarray:
    """Return upper bounds (N,) in pixels of what the errors of patches, which are vertical, cover anywhere in the image.

    A vertical length at the depth d covers at most k / d pixels, where k is largest in a corner of the image. The depth is at least that
    of the nearest corner of a box, and at least the distance to the box times the cosine of the angle to a corner of the image.
    """
    errors = patches.errors[rows] * exaggeration
    low, high = _boxes(patches, rows, exaggeration)
    offsets = np.maximum(np.maximum(low - viewer.position, viewer.position - high), 0.0)
    distances = np.sqrt((offsets * offsets).sum(axis=1)) / viewer.scale_range[0]
    projection = viewer.projection
    if projection.kind == "panoramic":
        return _scale(errors * viewer.scale_range[1], viewer.pixels_per_unit_at(distances))
    up = viewer.inverse[:3, 2]
    left, right, bottom, top = projection.window
    density = max(projection.pixel_densities)
    if projection.kind == "orthographic":
        return _scale(errors, np.full(len(errors), density * np.hypot(up[0], up[1])))
    corners = np.array([(x, y) for x in (left, right) for y in (bottom, top)])
    largest = density * np.hypot(up[0] + corners[:, 0] * up[2], up[1] + corners[:, 1] * up[2]).max()
    nearest = np.where(viewer.inverse[2, :3] > 0.0, high, low)
    depths = -(nearest @ viewer.inverse[2, :3] + viewer.inverse[2, 3])
    depths = np.maximum(depths, distances / np.sqrt(1.0 + (corners**2).sum(axis=1).max()))
    with np.errstate(divide="ignore"):
        return _scale(errors, largest / depths)


def _scale(errors: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the products, 0 for patches without error wherever they are."""
    return np.multiply(errors, pixels, out=np.zeros(len(errors)), where=errors > 0.0)


def are_boxes_visible(low: np.ndarray, high: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Return whether boxes with the corners `low` and `high` (N, 3) may overlap the frustum with `planes` (P, 4), positive inside."""
    is_visible = np.ones(len(low), bool)
    for plane in planes:
        farthest = np.where(plane[:3] > 0.0, high, low)
        is_visible &= farthest @ plane[:3] + plane[3] >= 0.0
    return is_visible


def _boxes(patches: Level, rows: np.ndarray, exaggeration: float) -> tuple[np.ndarray, np.ndarray]:
    scale = np.array([1.0, 1.0, exaggeration])
    return patches.low[rows] * scale, patches.high[rows] * scale
