"""Choice of the parts that a level shows as meshes, and the covering that it gets: charts for these, quads for the rest."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.distance import TriangleTree
from ...geometry.mesh import face_areas_and_normals
from ...jobs.progress import Progress, Steps
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
MAX_STEPS = 8  # Samples along each edge of a triangle of the mesh, at most.

Recover = Callable[[np.ndarray], Steps[Covering]]


@dataclass(frozen=True)
class _MeshedPart:
    """The indices (K,) of the primitives of a part, the triangles of the quads that would show it, and its mesh with its charts."""

    members: np.ndarray
    expected: float
    mesh: PartMesh
    charts: list[PlacedChart]


def mesh_parts(
    primitives: Primitives, components: Components, covering: Covering, error: float, parts: dict[int, Part], recover: Recover
) -> Steps[Covering]:
    """Return `covering` with the parts that a mesh shows with about as few triangles replaced by charts of that mesh.

    Args:
        error: length, of the covering.
        parts: parts by the label of their component that were prepared before; more are added.
        recover: returns the covering of the primitives (K,) that lose their quads, in their numbering.
    """
    chosen = yield from _choose(primitives, components, covering, error, parts)
    if not chosen:
        return covering
    is_meshed = np.zeros(len(primitives), bool)
    for item in chosen:
        is_meshed[item.members] = True
    charts: list[tuple[np.ndarray, Covering]] = []
    for item in chosen:
        is_absorbed = _find_absorbed(primitives, components, item, is_meshed, error)
        is_meshed |= is_absorbed
        members = np.concatenate([item.members, np.flatnonzero(is_absorbed)])
        charts.append((members, _cover_with_charts(primitives.subset(members), item, error)))
    kept, orphans = _keep_quads(covering, is_meshed)
    if len(orphans):
        charts.append((orphans, (yield from recover(orphans))))
    merged = merge_coverings([(np.arange(len(primitives)), kept), *charts], len(primitives))
    return merged if _is_light(merged, covering, chosen) else covering


def _is_light(merged: Covering, covering: Covering, chosen: list[_MeshedPart]) -> bool:
    """Return whether the covering with meshes has about as few triangles as the one with quads only."""
    expected = sum(item.expected for item in chosen)
    rest = TRIANGLES_PER_QUAD * len(covering.patches) - expected
    flat = TRIANGLES_PER_QUAD * sum(patch.chart is None for patch in merged.patches)
    count = flat + sum(len(item.mesh.triangles) for item in chosen)
    return count <= MAX_TRIANGLE_RATIO * expected + MAX_REST_RATIO * rest


def _choose(
    primitives: Primitives, components: Components, covering: Covering, error: float, parts: dict[int, Part]
) -> Steps[list[_MeshedPart]]:
    """Choose the parts with meshes."""
    if primitives.corners.shape[1] != 3:
        return []
    expected = _count_triangles(primitives, components, covering)
    expected[np.unique(components.labels[components.sheets])] = 0.0
    labels = np.flatnonzero(expected >= MIN_PART_TRIANGLES)
    members = group_by_label(components.labels, len(expected)) if len(labels) else []
    chosen = []
    for index, label in enumerate(labels):
        yield Progress(index / len(labels), "Simplifying solid parts")
        if label not in parts:
            parts[label] = Part(primitives.positions[members[label]])
        mesh = parts[label].simplify(error, int(MAX_TRIANGLE_RATIO * expected[label]))
        placed = [] if mesh is None else divide_into_charts(mesh)
        if placed and len(placed) <= MAX_CHART_RATIO * len(mesh.triangles):
            chosen.append(_MeshedPart(members[label], expected[label], mesh, placed))
    return chosen


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
    patches = []
    for index, chart in enumerate(placed):
        members = np.union1d(shown[drawn[index]], _find_margin(primitives, chart, error))
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


def _find_margin(primitives: Primitives, chart: PlacedChart, error: float) -> np.ndarray:
    """Return the primitives (N,) that face `chart` and reach into its margin."""
    low, high = (bound(chart.chart.vertices, axis=0) for bound in (np.min, np.max))
    positions, margin = primitives.positions, MARGIN * error
    is_near = ((positions.max(axis=1) >= low - margin) & (positions.min(axis=1) <= high + margin)).all(axis=1)
    candidates = np.flatnonzero(is_near & (primitives.normals @ chart.normal >= MIN_FACING))
    if not len(candidates):
        return candidates
    corners = positions[candidates]
    tree = TriangleTree(chart.chart.vertices[chart.chart.triangles])
    distances = tree.find_closest(corners.reshape(-1, 3), margin)[0].reshape(corners.shape[:2])
    return candidates[distances.min(axis=1) <= margin]


def _to_patch(placed: PlacedChart, drawn: np.ndarray) -> Patch:
    heights = placed.chart.vertices @ placed.normal
    offset = 0.5 * float(heights.min() + heights.max())
    return Patch(placed.normal, offset, placed.axes, placed.rectangle, drawn, drawn, chart=placed.chart)
