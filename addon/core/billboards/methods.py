"""The three methods that find the quads of a level, one function each: from primitives to coverings, finest level first.

All take the same arguments. `errors`: lengths, of all levels. `finished`: coverings of the finest levels for the same errors, returned
unchanged. `reference_area`: area against which the cost of a quad is weighed, for primitives that are part of a larger whole; by default
that of the primitives.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.proximity import nearest_pairs
from ..geometry.transforms import frames_from_normals
from ..jobs.parallel_steps import run_in_parallel
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .clustering.absorption import absorb_small_patches, complete_regions
from .clustering.cover import CoverSettings, cover_with_rectangles
from .clustering.hierarchy import ClusterBounds, merge_in_rounds
from .clustering.patches import Covering, Patch, assign_groups, best_facing_patch, group_by_label, merge_coverings
from .clustering.planes import PlaneBounds, Planes
from .clustering.rectangles import fit_rectangle
from .clustering.refits import refit_planes
from .decimation.triangle_patches import build_triangle_patches, cover_flat_surfaces
from .primitives import Components, Primitives
from .scale_normals import at_scale
from .settings import BillboardSettings

REGION_NEIGHBORS = 12  # Per primitive, in the graph over which the region of a quad grows.
QUAD_COST = 3.5  # Cost of one more quad, in mean areas of a cluster.
MAX_COVER_ROUNDS = 4
MAX_NESTED_COVER_ROUNDS = 2  # Of levels that start from the quads of the finer one.
NEIGHBORS_FRACTION = 0.1  # The proximity graph takes this fraction of the progress bar of `cover_by_clustering`.
UNASSIGNED_FRACTION = 0.1  # Clustering unassigned faces takes this fraction of the progress of a level of `cover_by_decimation`.


def cover_by_clustering(
    primitives: Primitives,
    components: Components,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    finished: Sequence[Covering] = (),
    reference_area: float | None = None,
) -> Steps[list[Covering]]:
    """Generalized hierarchical face clustering (section 4.3), then the fewest overlapping quads that cover all primitives.

    Every level is clustered from the primitives, on its own, and levels side by side. With *Nested Levels* a coarser level merges the
    clusters of the finer one instead, and each of its quads owns whole clusters. Loose sheets and other surfaces, such as leaves and
    trunk, never share a quad.
    """
    yield Progress(0.0, "Finding neighbors")
    with clock.stage("neighbors"):
        pairs, distances = primitives.proximity_graph
        same_kind = components.sheets[pairs[:, 0]] == components.sheets[pairs[:, 1]]
        pairs, distances = pairs[same_kind], distances[same_kind]
        near = pairs[nearest_pairs(pairs, distances, len(primitives), REGION_NEIGHBORS)] if len(pairs) else pairs
    clustering = _Clustering(primitives, components, settings, clock, (pairs, distances), near, reference_area)
    if not settings.keeps_all_levels:
        levels = run_in_parallel([clustering.cover(error, []) for error in errors[len(finished) :]])
        return [*finished, *(yield from subprogress(levels, NEIGHBORS_FRACTION, 1.0))]
    coverings = list(finished)
    for level, start, stop in _progress_spans(len(finished), len(errors), NEIGHBORS_FRACTION):
        coverings.append((yield from subprogress(clustering.cover(errors[level], coverings, errors[0]), start, stop)))
    return coverings


@dataclass(frozen=True)
class _Clustering:
    """The input of `cover_by_clustering` for every level.

    Attributes:
        primitives: The primitives.
        components: Their components.
        settings: The settings.
        clock: Measures the stages.
        graph: Pairs (E, 2) of primitives of one kind and their distances (E,).
        near: (F, 2) the pairs over which the region of a quad grows.
        reference_area: See `cover_by_clustering`.
    """

    primitives: Primitives
    components: Components
    settings: BillboardSettings
    clock: StageClock
    graph: tuple[np.ndarray, np.ndarray]
    near: np.ndarray
    reference_area: float | None

    def cover(self, error: float, finer: list[Covering], finest_error: float | None = None) -> Steps[Covering]:
        """Cover the primitives within `error`, a length. finer: coverings that this one nests with, with errors from `finest_error` on."""
        settings, sheets = self.settings, self.components.sheets
        scale = finest_error or error
        with self.clock.stage("normals"):
            scaled = at_scale(self.primitives, settings.normal_scale * scale, scale)
        groups, fallback = _initial_groups(scaled, finer)
        bounds = ClusterBounds(scale, settings.max_normal_deviation, settings.max_texture_waste)
        with self.clock.stage("clusters"):
            labels = yield from subprogress(merge_in_rounds(scaled, groups, *self.graph, bounds, len(finer)), 0.0, 0.5)
        candidates = group_by_label(labels) + [patch.drawn for covering in finer[-1:] for patch in covering.patches]
        max_rounds = MAX_NESTED_COVER_ROUNDS if finer else MAX_COVER_ROUNDS
        quad_cost = QUAD_COST * (self.reference_area or float(scaled.areas.sum())) / (int(labels.max()) + 1)
        plane_bounds = PlaneBounds(error, float(np.cos(settings.max_normal_deviation)))
        steps = cover_with_rectangles(scaled, groups, fallback, self.near, candidates, CoverSettings(plane_bounds, quad_cost, max_rounds))
        with self.clock.stage("cover"):
            patches = yield from subprogress(steps, 0.5, 1.0)
            if settings.normal_scale > 0.0:
                if not settings.keeps_all_levels:  # The next level must be able to show what each quad owns within the same limits.
                    patches = absorb_small_patches(scaled, sheets, patches, error)
                    patches = refit_planes(scaled, patches, plane_bounds)
                patches = complete_regions(self.primitives, sheets, patches, error)
        owner = assign_groups(scaled, patches, groups) if finer else best_facing_patch(scaled, patches)
        return Covering(patches, owner)


def _progress_spans(first: int, count: int, start: float) -> list[tuple[int, float, float]]:
    """Return the levels from `first` to the last of `count`, each with its part of the progress from `start` to 1."""
    step = (1.0 - start) / max(count - first, 1)
    return [(level, start + step * (level - first), start + step * (level - first + 1)) for level in range(first, count)]


def _initial_groups(primitives: Primitives, coverings: list[Covering]) -> tuple[np.ndarray, Planes]:
    """Return the groups (P,) int32 from which the level above `coverings` starts, and for each a plane that shows it.

    These are the clusters of the finer level with the planes of their owners, or single primitives for the finest level.
    """
    if not coverings:
        heights = np.einsum("pci,pi->pc", primitives.positions, primitives.normals)
        offsets = 0.5 * (heights.min(axis=1) + heights.max(axis=1))
        return np.arange(len(primitives), dtype=np.int32), Planes(primitives.normals, offsets)
    owners, groups = np.unique(coverings[-1].owner, return_inverse=True)
    patches = [coverings[-1].patches[index] for index in owners]
    planes = Planes(np.array([patch.normal for patch in patches]), np.array([patch.offset for patch in patches]))
    return groups.reshape(-1).astype(np.int32), planes


def cover_by_hough(
    primitives: Primitives,
    _components: Components,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    finished: Sequence[Covering] = (),
    _reference_area: float | None = None,
) -> Steps[list[Covering]]:
    """Greedy planes in Hough space (section 4.1), each level independently."""
    tasks = [_cover_in_hough_space(primitives, error, settings, clock) for error in errors[len(finished) :]]
    return [*finished, *(yield from run_in_parallel(tasks))]


def _cover_in_hough_space(primitives: Primitives, error: float, settings: BillboardSettings, clock: StageClock) -> Steps[Covering]:
    """Cover `primitives` within `error`, a length."""
    from .hough.hough import find_planes

    steps = find_planes(primitives.positions, primitives.areas, primitives.normals, error, settings.seed)
    with clock.stage("planes"):
        planes = yield from steps
    frames = frames_from_normals(planes.normals)
    patches = []
    for normal, offset, frame, drawn in zip(planes.normals, planes.offsets, frames, planes.drawn, strict=True):
        points = primitives.points[primitives.find_points(drawn)]
        patches.append(Patch(normal, float(offset), *fit_rectangle(points, frame[:2]), drawn, drawn))
    return Covering(patches, planes.owner)


def cover_by_decimation(
    primitives: Primitives,
    components: Components,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    finished: Sequence[Covering] = (),
    _reference_area: float | None = None,
) -> Steps[list[Covering]]:
    """Edge collapse with a measured error (section 4.2), each level independently.

    Every triangle of the result becomes a quad; triangles in one plane share a quad. Unassigned faces are clustered. Flat surfaces are not
    decimated.
    """
    tasks = [_cover_with_decimation(primitives, components, error, settings, clock) for error in errors[len(finished) :]]
    return [*finished, *(yield from run_in_parallel(tasks))]


def _cover_with_decimation(
    primitives: Primitives, components: Components, error: float, settings: BillboardSettings, clock: StageClock
) -> Steps[Covering]:
    """Cover `primitives` within `error`, a length."""
    bounds = PlaneBounds(error, float(np.cos(settings.max_normal_deviation)))
    flat, covering = cover_flat_surfaces(primitives, components, bounds, QUAD_COST)
    if len(flat):
        yield Progress(0.0, "Covering flat surfaces")
    parts = [(flat, covering)]
    rest = np.setdiff1d(np.arange(len(primitives)), flat)
    if len(rest):
        parts.append((rest, (yield from _decimate(primitives.subset(rest), components.subset(rest), bounds, settings, clock))))
    return merge_coverings(parts, len(primitives))


def _decimate(
    primitives: Primitives, components: Components, bounds: PlaneBounds, settings: BillboardSettings, clock: StageClock
) -> Steps[Covering]:
    """Cover `primitives` with the triangles of a decimated mesh, and the faces that these do not approximate with clusters."""
    from .decimation.decimate import decimate_to_error

    steps = decimate_to_error(primitives.points, primitives.corners, bounds.error, settings.max_normal_deviation)
    with clock.stage("decimate"):
        result = yield from subprogress(steps, 0.0, 1.0 - UNASSIGNED_FRACTION)
    parts = [build_triangle_patches(primitives, result, bounds, QUAD_COST)]
    if len(result.unassigned):
        unassigned = primitives.subset(result.unassigned), components.subset(result.unassigned)
        steps = cover_by_clustering(*unassigned, [bounds.error], settings, clock)
        parts.append((result.unassigned, (yield from subprogress(steps, 1.0 - UNASSIGNED_FRACTION, 1.0))[0]))
    return merge_coverings(parts, len(primitives))
