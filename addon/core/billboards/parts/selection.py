"""Choice of the parts that a level shows as meshes, and the covering that it gets: charts for these, quads for the rest."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import face_areas_and_normals
from ...jobs.parallel_steps import run_in_parallel
from ...jobs.progress import Progress, Steps, subprogress
from ..clustering.patches import Covering, Patch, group_by_label, merge_coverings
from ..primitives import Components, Primitives
from .charts import PlacedChart, divide_into_charts
from .part_meshes import Part, PartMesh, find_closest_facing

MAX_TRIANGLE_RATIO = 1.3  # Triangles of the mesh of a part over those of the quads that would show it.
MAX_REST_RATIO = 1.1  # The same for all other parts, whose quads change where they were shared.
MAX_CHART_RATIO = 0.6  # Charts of a part over its triangles; a box has half as many. Fragments have one each, and gain nothing.
MIN_PART_TRIANGLES = 12  # Of the quads that would show a part; a part with fewer stays quads.
TRIANGLES_PER_QUAD = 2.2
MARGIN = 1.5  # In errors: what lies within this distance of a chart is drawn on it, for the filter at its border.
MIN_FACING = 0.1  # Cosine between a chart and what is drawn in its margin.
SAMPLE_WEIGHTS = np.array([[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9], [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0]])
PREPARED, SIMPLIFIED = 0.4, 0.8  # Fractions of the progress.
MAX_STEPS = 8  # Samples along each edge of a triangle of the mesh, at most.

Recover = Callable[[np.ndarray, float], Steps[Covering]]


@dataclass(frozen=True)
class _MeshedPart:
    """The indices (K,) of the primitives of a part, the triangles of the quads that would show it, and its mesh with its charts."""

    members: np.ndarray
    expected: float
    mesh: PartMesh
    charts: list[PlacedChart]


def mesh_parts(
    primitives: Primitives,
    components: Components,
    coverings: Sequence[Covering],
    errors: Sequence[float],
    parts: dict[int, Part],
    recover: Recover,
) -> Steps[list[Covering]]:
    """Return `coverings` with the parts that a mesh shows with about as few triangles replaced by charts of that mesh.

    Levels have the meshes that parts are simplified to in common. These are made first, then levels and parts are independent.

    Args:
        errors: lengths, of the coverings.
        parts: parts by the label of their component that were prepared before; more are added.
        recover: returns the covering of the primitives (K,) that lose their quads, in their numbering, within an error.
    """
    if primitives.corners.shape[1] != 3:
        return list(coverings)
    expected = np.array([_count_triangles(primitives, components, covering) for covering in coverings])
    expected[:, np.unique(components.labels[components.sheets])] = 0.0
    expected[expected < MIN_PART_TRIANGLES] = 0.0
    labels = np.flatnonzero(expected.any(axis=0))
    if not len(labels):
        return list(coverings)
    members = group_by_label(components.labels, expected.shape[1])
    for label in labels:
        if label not in parts:
            parts[label] = Part(primitives.positions[members[label]])
    limits = (MAX_TRIANGLE_RATIO * expected).astype(np.int64)
    steps = run_in_parallel([_prepare(parts[label], limits[:, label]) for label in labels])
    yield from subprogress(steps, 0.0, PREPARED, "Solid parts: ")
    pairs = np.argwhere(expected > 0.0)
    steps = run_in_parallel([_simplify(parts[label], members[label], expected[level, label], errors[level]) for level, label in pairs])
    meshed = yield from subprogress(steps, PREPARED, SIMPLIFIED)
    chosen = [[item for item, (other, _) in zip(meshed, pairs, strict=True) if item and other == level] for level in range(len(errors))]
    levels = zip(coverings, errors, chosen, strict=True)
    steps = run_in_parallel([_replace_quads(primitives, components, *level, recover) for level in levels])
    return (yield from subprogress(steps, SIMPLIFIED, 1.0))


def _prepare(part: Part, limits: np.ndarray) -> Steps[None]:
    """Prepare `part` for levels with up to `limits` (L,) triangles, as one after the other would."""
    for limit in limits:
        yield from part.prepare(int(limit))


def _simplify(part: Part, members: np.ndarray, expected: float, error: float) -> Steps[_MeshedPart | None]:
    """Return the mesh of `part`, whose primitives are `members` (K,), if it has about as few triangles as `expected`."""
    mesh = yield from part.simplify(error, int(MAX_TRIANGLE_RATIO * expected))
    charts = [] if mesh is None else divide_into_charts(mesh)
    is_chosen = charts and len(charts) <= MAX_CHART_RATIO * len(mesh.triangles)
    return _MeshedPart(members, expected, mesh, charts) if is_chosen else None


def _replace_quads(
    primitives: Primitives, components: Components, covering: Covering, error: float, chosen: list[_MeshedPart], recover: Recover
) -> Steps[Covering]:
    """Return `covering` with the quads of the parts `chosen` replaced by charts of their meshes, if that is light."""
    if not chosen:
        return covering
    is_meshed = np.zeros(len(primitives), bool)
    for item in chosen:
        is_meshed[item.members] = True
    charts: list[tuple[np.ndarray, Covering]] = []
    for index, item in enumerate(chosen):
        yield Progress(index / len(chosen), "Dividing solid parts")
        is_absorbed = _find_absorbed(primitives, components, item, is_meshed, error)
        is_meshed |= is_absorbed
        members = np.concatenate([item.members, np.flatnonzero(is_absorbed)])
        charts.append((members, _cover_with_charts(primitives.subset(members), item, error)))
    kept, orphans = _keep_quads(covering, is_meshed)
    if len(orphans):
        charts.append((orphans, (yield from recover(orphans, error))))
    merged = merge_coverings([(np.arange(len(primitives)), kept), *charts], len(primitives))
    return merged if _is_light(merged, covering, chosen) else covering


def _is_light(merged: Covering, covering: Covering, chosen: list[_MeshedPart]) -> bool:
    """Return whether the covering with meshes has about as few triangles as the one with quads only."""
    expected = sum(item.expected for item in chosen)
    rest = TRIANGLES_PER_QUAD * len(covering.patches) - expected
    flat = TRIANGLES_PER_QUAD * sum(patch.chart is None for patch in merged.patches)
    count = flat + sum(len(item.mesh.triangles) for item in chosen)
    return count <= MAX_TRIANGLE_RATIO * expected + MAX_REST_RATIO * rest


def _count_triangles(primitives: Primitives, components: Components, covering: Covering) -> np.ndarray:
    """Return about how many triangles the quads of each component have; those of several count for each by area."""
    count = int(components.labels.max()) + 1
    keys, rows = np.unique(covering.owner.astype(np.int64) * count + components.labels, return_inverse=True)
    areas = np.bincount(rows.reshape(-1), primitives.areas)
    totals = np.bincount(covering.owner, primitives.areas, len(covering.patches))
    return TRIANGLES_PER_QUAD * np.bincount(keys % count, areas / totals[keys // count], count)


def _find_absorbed(primitives: Primitives, components: Components, item: _MeshedPart, is_meshed: np.ndarray, error: float) -> np.ndarray:
    """Return which primitives (P,) belong to other solid parts that lie within `error` of a mesh altogether, such as bolts."""
    low, high = (bound(item.mesh.vertices, axis=0) for bound in (np.min, np.max))
    positions = primitives.positions
    is_near = ((positions.min(axis=1) >= low - error) & (positions.max(axis=1) <= high + error)).all(axis=1)
    is_near &= ~is_meshed & ~components.sheets
    candidates = np.flatnonzero(is_near)
    is_absorbed = np.zeros(len(primitives), bool)
    if not len(candidates):
        return is_absorbed
    tree = TriangleTree(item.mesh.vertices[item.mesh.triangles])
    corners = positions[candidates]
    distances = tree.find_closest(corners.reshape(-1, 3), error)[0].reshape(corners.shape[:2]).max(axis=1)
    is_absorbed[candidates[distances <= error]] = True
    labels = components.labels
    is_partial = np.bincount(labels, ~is_absorbed, int(labels.max()) + 1) > 0
    return is_absorbed & ~is_partial[labels]


def _keep_quads(covering: Covering, is_meshed: np.ndarray) -> tuple[Covering, np.ndarray]:
    """Return the quads that show no primitive of a mesh, and the primitives (K,) that lose theirs."""
    is_kept = np.array([not is_meshed[patch.drawn].any() for patch in covering.patches])
    index = np.where(is_kept, np.cumsum(is_kept) - 1, -1)
    owner = np.where(is_meshed, -1, index[covering.owner]).astype(np.int32)
    patches = [
        replace(patch, region=patch.region[~is_meshed[patch.region]]) for patch, keep in zip(covering.patches, is_kept, strict=True) if keep
    ]
    return Covering(patches, owner), np.flatnonzero((owner < 0) & ~is_meshed)


def _cover_with_charts(primitives: Primitives, item: _MeshedPart, error: float) -> Covering:
    """Return the covering of `primitives` with the charts of the mesh of `item`."""
    placed = item.charts
    corners = item.mesh.vertices[item.mesh.triangles]
    chart_of = np.empty(len(corners), np.int32)
    for index, chart in enumerate(placed):
        chart_of[chart.members] = index
    normals = face_areas_and_normals(corners)[1]
    positions = np.einsum("sc,pci->psi", SAMPLE_WEIGHTS, primitives.positions).reshape(-1, 3)
    own_normals = np.repeat(primitives.normals, len(SAMPLE_WEIGHTS), axis=0)
    shown_on = chart_of[find_closest_facing(corners, normals, positions, own_normals, 2.0 * error)].reshape(len(primitives), -1)
    owner = shown_on[:, -1]
    pairs = [(shown_on[:, sample], np.arange(len(primitives))) for sample in range(shown_on.shape[1])]
    points, triangles = _sample_triangles(corners, error)
    nearest = find_closest_facing(primitives.positions, primitives.normals, points, normals[triangles], 2.0 * error)
    facing = np.einsum("ni,ni->n", np.array([chart.normal for chart in placed])[chart_of[triangles]], primitives.normals[nearest]) > 0.0
    pairs.append((chart_of[triangles][facing], nearest[facing]))
    quads, shown = (np.concatenate(values) for values in zip(*pairs, strict=True))
    drawn = group_by_label(quads, len(placed))
    bounds = primitives.positions.min(axis=1), primitives.positions.max(axis=1)
    patches = []
    for index, chart in enumerate(placed):
        members = np.union1d(shown[drawn[index]], _find_margin(primitives, bounds, chart, error))
        patches.append(_to_patch(chart, members))
    return Covering(patches, owner.astype(np.int32))


def _sample_triangles(corners: np.ndarray, error: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) on triangles (T, 3, 3), about an error apart, and their triangles (N,)."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    steps = np.clip(np.ceil(longest / error), 1, MAX_STEPS).astype(np.int64)
    points, owners = [], []
    for step in np.unique(steps):
        rows = np.flatnonzero(steps == step)
        i, j = np.meshgrid(np.arange(step), np.arange(step), indexing="ij")
        first = (np.stack([i, j], axis=-1)[i + j < step] + 1.0 / 3.0) / step
        weights = np.column_stack([1.0 - first.sum(axis=1), first])
        points.append(np.einsum("sc,tci->tsi", weights, corners[rows]).reshape(-1, 3))
        owners.append(np.repeat(rows, len(weights)))
    return np.concatenate(points), np.concatenate(owners)


def _find_margin(primitives: Primitives, bounds: tuple[np.ndarray, np.ndarray], chart: PlacedChart, error: float) -> np.ndarray:
    """Return the primitives (N,) that face `chart` and reach into its margin. bounds: low and high corners (P, 3) of the primitives."""
    low, high = (bound(chart.chart.vertices, axis=0) for bound in (np.min, np.max))
    margin = MARGIN * error
    candidates = np.flatnonzero(primitives.normals @ chart.normal >= MIN_FACING)
    for axis in range(3):
        lows, highs = (bound[candidates, axis] for bound in bounds)
        candidates = candidates[(highs >= low[axis] - margin) & (lows <= high[axis] + margin)]
    if not len(candidates):
        return candidates
    corners = primitives.positions[candidates]
    tree = TriangleTree(chart.chart.vertices[chart.chart.triangles])
    distances = tree.find_closest(corners.reshape(-1, 3), margin)[0].reshape(corners.shape[:2])
    return candidates[distances.min(axis=1) <= margin]


def _to_patch(placed: PlacedChart, drawn: np.ndarray) -> Patch:
    heights = placed.chart.vertices @ placed.normal
    offset = 0.5 * float(heights.min() + heights.max())
    return Patch(placed.normal, offset, placed.axes, placed.rectangle, drawn, drawn, chart=placed.chart)
