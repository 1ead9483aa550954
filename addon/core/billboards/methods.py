"""The three ways to find the quads of a level: one function each, from primitives to coverings, finest level first.

`errors` are those of all levels; levels that are `standing` already, with the same errors, are handed back as they are. `area` is what a
quad is weighed against, instead of the area of the primitives, where these are part of something larger.
"""

from collections.abc import Sequence

import numpy as np

from ..progress import Progress, StageClock, Steps, scaled
from ..spatial import nearest_pairs
from .cover import CoverBounds, SafePlanes, cover
from .hierarchy import ClusterBounds, merge_in_rounds
from .patches import Covering, Patch, members_of, owners_of_groups, squarest, union
from .planes import frames_of
from .primitives import Primitives
from .rectangles import around, bounds_of, smallest_rectangle
from .settings import BillboardSettings
from .surfaces import Surfaces
from .triangles import patches_of_triangles

REGION_NEIGHBOURS = 12  # through which a quad's region grows
QUAD_COST = 4.0  # what one more quad is worth, in mean areas of a cluster
ROUNDS = 4
COARSE_ROUNDS = 2


def clusters(
    primitives: Primitives,
    surfaces: Surfaces,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    standing: Sequence[Covering] = (),
    area: float | None = None,
) -> Steps[list[Covering]]:
    """Generalised hierarchical face clustering (section 4.3), then the fewest overlapping quads that cover everything.

    Ownership is settled at the finest level; a coarser quad owns whole clusters of the finer level, so levels nest. Loose parts and
    connected surfaces, leaves and trunk, never meet on one quad.
    """
    yield Progress(0.0, "Looking for neighbours")
    with clock.stage("neighbours"):
        pairs, distances = primitives.neighbours
        alike = surfaces.loose[pairs[:, 0]] == surfaces.loose[pairs[:, 1]]
        pairs, distances = pairs[alike], distances[alike]
        near = pairs[nearest_pairs(pairs, distances, len(primitives), REGION_NEIGHBOURS)] if len(pairs) else pairs
    bounds = ClusterBounds(errors[0], settings.max_normal_deviation, settings.max_texture_waste)
    coverings = list(standing)
    for level, start, stop in _spans(len(standing), len(errors), 0.1):
        groups, safe = _groups_to_merge(primitives, coverings)
        merging = merge_in_rounds(primitives, groups, pairs, distances, bounds, level)
        with clock.stage("clusters"):
            labels = yield from scaled(merging, start, 0.5 * (start + stop))
        sets = members_of(labels) + [patch.shown for covering in coverings[-1:] for patch in covering.patches]
        rounds = ROUNDS if level == 0 else COARSE_ROUNDS
        quad_cost = QUAD_COST * (area or float(primitives.areas.sum())) / (int(labels.max()) + 1)
        cover_bounds = CoverBounds(errors[level], settings.max_normal_deviation, quad_cost, rounds)
        steps = cover(primitives, groups, safe, near, sets, cover_bounds)
        with clock.stage("cover"):
            patches = yield from scaled(steps, 0.5 * (start + stop), stop)
        owner = squarest(primitives, patches) if level == 0 else owners_of_groups(primitives, patches, groups)
        coverings.append(Covering(patches, owner))
    return coverings


def _spans(first: int, count: int, start: float) -> list[tuple[int, float, float]]:
    """The levels from `first` to the last of `count`, each with its part of the fractions from `start` to 1."""
    step = (1.0 - start) / max(count - first, 1)
    return [(level, start + step * (level - first), start + step * (level - first + 1)) for level in range(first, count)]


def _groups_to_merge(primitives: Primitives, coverings: list[Covering]) -> tuple[np.ndarray, SafePlanes]:
    """Where the level above `coverings` starts: the clusters (P,) int32 of the level below, each with the plane of the quad that owns it;
    every primitive by itself where there is none."""
    if not coverings:
        offsets = np.einsum("pi,pi->p", primitives.normals, primitives.positions[:, 0])
        return np.arange(len(primitives), dtype=np.int32), SafePlanes(primitives.normals, offsets)
    owning, groups = np.unique(coverings[-1].owner, return_inverse=True)
    patches = [coverings[-1].patches[number] for number in owning]
    planes = SafePlanes(np.array([patch.normal for patch in patches]), np.array([patch.offset for patch in patches]))
    return groups.reshape(-1).astype(np.int32), planes


def hough(
    primitives: Primitives,
    _surfaces: Surfaces,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    standing: Sequence[Covering] = (),
    _area: float | None = None,
) -> Steps[list[Covering]]:
    """Greedy planes in Hough space (section 4.1), each level on its own."""
    from .hough import find_planes

    coverings = list(standing)
    for level, start, stop in _spans(len(standing), len(errors), 0.0):
        steps = find_planes(primitives.positions, primitives.areas, primitives.normals, errors[level], settings.seed)
        with clock.stage("planes"):
            planes = yield from scaled(steps, start, stop)
        frames = frames_of(planes.normals)
        patches = []
        for normal, offset, frame, shown in zip(planes.normals, planes.offsets, frames, planes.covers, strict=True):
            positions = primitives.positions[shown]
            axes = smallest_rectangle(positions.reshape(-1, 3) @ frame[:2].T) @ frame[:2]
            patches.append(Patch(normal, float(offset), axes, around(bounds_of(positions, axes)), shown, shown))
        coverings.append(Covering(patches, planes.owner))
    return coverings


def decimate(
    primitives: Primitives,
    surfaces: Surfaces,
    errors: list[float],
    settings: BillboardSettings,
    clock: StageClock,
    standing: Sequence[Covering] = (),
    _area: float | None = None,
) -> Steps[list[Covering]]:
    """Edge collapse with a measured error (section 4.2), each level on its own; every triangle of the result becomes a quad, and those in
    one plane become one together. Faces that no triangle stands for are clustered."""
    from .decimate import decimate_to_error

    coverings = list(standing)
    for level, start, stop in _spans(len(standing), len(errors), 0.0):
        error = errors[level]
        steps = decimate_to_error(primitives.points, primitives.corners, error, settings.max_normal_deviation)
        with clock.stage("decimate"):
            result = yield from scaled(steps, start, 0.1 * start + 0.9 * stop)
        parts = [patches_of_triangles(primitives, result, error, settings.max_normal_deviation, QUAD_COST)]
        if len(result.apart):
            rest = clusters(primitives.subset(result.apart), surfaces.subset(result.apart), [error], settings, clock)
            parts.append((result.apart, (yield from scaled(rest, 0.1 * start + 0.9 * stop, stop))[0]))
        coverings.append(union(parts, len(primitives)))
    return coverings
