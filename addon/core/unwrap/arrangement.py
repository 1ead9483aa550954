"""Arranges charts in a UV map: merges them across common borders, stacks equal ones, turns them upright and packs them."""

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.edges import halfedge_ends
from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from ..geometry.transforms import signed_areas
from ..jobs.progress import Progress, Steps
from .cutting.bisection import bisect_further
from .cutting.boundaries import boundary_edges
from .cutting.chart import Chart, split_into_components
from .cutting.charts import CutChart
from .dividing import divide_long_pieces
from .merging import MergeLimits, merge_islands
from .packing import orient_smallest, pack_charts, turn_upright
from .stacking import Copies, find_copies
from .texture import Texture

MERGE_LIMITS = (  # Tried in turn,
    MergeLimits(1.25),
    MergeLimits(0.9),
    MergeLimits(0.4),
    MergeLimits(1.25, max_growth=1.1),
    MergeLimits(1.25, max_addition=1.25),
)
GOOD_FILL = 0.7  # until so much of the square is used. The next one must use it better by
MIN_FILL_GAIN = 1.08  # at least this factor.
MAX_ISLANDS_FOR_CHOICE = 60  # More islands fit in any case.
POOR_FILL, MAX_CHARTS_TO_HALVE = 0.5, 3  # Up to so many charts that fill less are cut in halves
MIN_HALVING_GAIN = 1.5  # where the fill, over the length of seams, becomes so many times as large.
MAX_SCALE_DIFFERENCE = 0.02  # Between pieces that are sewn together, as a fraction.
MIN_UPRIGHT_FILL = 0.98  # Of the texture with upright islands, relative to the fill with freely turned ones.


@dataclass(frozen=True)
class PackedMap:
    """A packed map of T triangles.

    Attributes:
        charts: All charts.
        uvs: (V, 2) of each before packing.
        corner_uvs: (T, 3, 2), in UDIM tiles of side 1.
        labels: (T,) the chart of each triangle.
        copies: Stacked triangles.
        separate_count: Number of charts that are not stacked.
        tile_count: Number of UDIM tiles.
        is_upright: Whether charts of vertical surfaces are upright.
    """

    charts: list[CutChart]
    uvs: list[np.ndarray]
    corner_uvs: np.ndarray
    labels: np.ndarray
    copies: Copies
    separate_count: int
    tile_count: int
    is_upright: bool = False

    @property
    def fill(self) -> float:
        """Area of the map, counting stacked charts each, per tile."""
        return float(signed_areas(self.corner_uvs).sum()) / self.tile_count


def pack(surface: Chart, charts: list[CutChart], uvs: list[np.ndarray], texture: Texture, stack: bool) -> Steps[PackedMap]:
    """Return the packed map of charts; with `stack`, equal ones get the same place."""
    corner_uvs, labels = _combine(charts, uvs, len(surface.triangles))
    copies = Copies.none(len(labels))
    if stack:
        copies = yield from find_copies(surface.vertices[surface.triangles], labels, surface.density, surface.polygon_ids)
    return (yield from _pack_separate(PackedMap(charts, uvs, corner_uvs, labels, copies, 0, 0), texture))


def _pack_separate(packed: PackedMap, texture: Texture, may_turn: list[bool] | None = None) -> Steps[PackedMap]:
    """Return the packed map of the charts that are not stacked. may_turn: whether each of all charts may be turned, None: all may."""
    separate = [index for index, cut in enumerate(packed.charts) if not packed.copies.is_copy[cut.triangle_indices[0]]]
    charts, uvs = [packed.charts[index] for index in separate], [packed.uvs[index] for index in separate]
    may_turn = None if may_turn is None else [may_turn[index] for index in separate]
    packing = yield from pack_charts(uvs, [cut.chart.triangles for cut in charts], texture, may_turn)
    corner_uvs = np.empty_like(packed.corner_uvs)
    for cut, uv in zip(charts, packing.uvs, strict=True):
        corner_uvs[cut.triangle_indices] = uv[cut.chart.triangles]
    corner_uvs = packed.copies.fill(corner_uvs)
    return replace(
        packed, corner_uvs=corner_uvs, separate_count=len(charts), tile_count=packing.tile_count, is_upright=may_turn is not None
    )


def _find_scales(surface: Chart, labels: np.ndarray) -> np.ndarray:
    """Return lengths in the map over lengths on the surface (T,), from the mean density of each piece, `labels` (T,)."""
    areas = face_areas_and_normals(surface.vertices[surface.triangles])[0]
    sums, weighted = np.bincount(labels, areas), np.bincount(labels, areas * surface.density)
    return np.sqrt(np.divide(weighted, sums, out=np.ones(len(sums)), where=weighted > 0.0))[labels]


def pack_upright(packed: PackedMap, texture: Texture, always: bool) -> Steps[PackedMap]:
    """Return a packed map with charts of vertical surfaces upright, or the map before where that is filled better."""
    upright = [turn_upright(uv, cut.chart.triangles, cut.chart.vertices) for cut, uv in zip(packed.charts, packed.uvs, strict=True)]
    if all(uv is None for uv in upright):
        return packed
    uvs = [before if uv is None else uv for before, uv in zip(packed.uvs, upright, strict=True)]
    turned = yield from _pack_separate(replace(packed, uvs=uvs), texture, [uv is None for uv in upright])
    is_filled = turned.tile_count <= packed.tile_count and turned.fill >= MIN_UPRIGHT_FILL * packed.fill
    return turned if always or is_filled else packed


def _combine(charts: list[CutChart], uvs: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the corner UVs (count, 3, 2) of all triangles, and their chart (count,)."""
    corner_uvs, labels = np.empty((count, 3, 2)), np.empty(count, np.int64)
    for index, (cut, uv) in enumerate(zip(charts, uvs, strict=True)):
        corner_uvs[cut.triangle_indices], labels[cut.triangle_indices] = uv[cut.chart.triangles], index
    return corner_uvs, labels


def merge_and_pack(
    surface: Chart, charts: list[CutChart], uvs: list[np.ndarray], halfedges: np.ndarray, texture: Texture, stack: bool
) -> Steps[PackedMap]:
    """Return the packed map of charts that are merged across common borders: to smaller ones if they fill the texture better than they
    add seams."""
    corner_uvs, labels = _combine(charts, uvs, len(surface.triangles))
    mesh = TriangleMesh(surface.vertices, surface.triangles)
    scales = _find_scales(surface, labels)
    connected, halfedges = halfedges, halfedges[np.abs(np.log(np.divide(*scales[halfedges // 3].T))) <= MAX_SCALE_DIFFERENCE]
    labels = divide_long_pieces(mesh, surface.polygon_ids, corner_uvs, labels, halfedges, scales)
    sides = labels[halfedges // 3]
    if (sides[:, 0] == sides[:, 1]).all():  # There is nothing to merge.
        packed = yield from pack(surface, charts, uvs, texture, stack)
        return (yield from _halve_while_filled_poorly(packed, surface, connected, texture, stack))
    lengths = np.linalg.norm(np.subtract(*mesh.vertices[halfedge_ends(mesh.triangles, halfedges[:, 0])].transpose(1, 0, 2)), axis=1)
    best, best_seam, tried = None, np.inf, []
    for limits in MERGE_LIMITS:
        placed, is_sewn = yield from merge_islands(mesh, corner_uvs, labels, halfedges, scales, limits)
        if any(np.array_equal(placed, other) for other in tried):
            continue
        tried.append(placed)
        merged, merged_uvs = [], []
        for chart, members in split_into_components(surface, halfedges[is_sewn]):
            merged_uvs.append(_average_corners(chart, placed[members]))
            merged.append(CutChart(chart, members, True))
        yield Progress(1.0, "Packing")
        packed = yield from pack(surface, merged, merged_uvs, texture, stack)
        seam = float(lengths[~is_sewn].sum())
        if best is None or packed.fill > best.fill * max(MIN_FILL_GAIN, seam / best_seam):
            best, best_seam = packed, seam
        if best.fill > GOOD_FILL or len(merged) > MAX_ISLANDS_FOR_CHOICE:
            break
    return (yield from _halve_while_filled_poorly(best, surface, connected, texture, stack))


def _halve_while_filled_poorly(packed: PackedMap, surface: Chart, halfedges: np.ndarray, texture: Texture, stack: bool) -> Steps[PackedMap]:
    """Return the map of a few charts, the longest of which are cut across where they fill the texture better than they add seams."""
    best = packed
    while packed.fill < POOR_FILL and len(packed.charts) <= MAX_CHARTS_TO_HALVE:
        index = int(np.argmax([np.ptp(orient_smallest(uv)[:, 0]) for uv in packed.uvs]))
        cut, uv = packed.charts[index], packed.uvs[index]
        pieces = (yield from bisect_further(cut, uv)) if cut.may_be_cut else [cut]
        if len(pieces) == 1:
            break
        corner_uvs = np.empty((len(surface.triangles), 3, 2))
        corner_uvs[cut.triangle_indices] = uv[cut.chart.triangles]
        charts = [*packed.charts[:index], *packed.charts[index + 1 :], *pieces]
        uvs = [*packed.uvs[:index], *packed.uvs[index + 1 :]]
        uvs += [_average_corners(piece.chart, corner_uvs[piece.triangle_indices]) for piece in pieces]
        packed = yield from pack(surface, charts, uvs, texture, stack)
        seams = [_seam_length(surface, halfedges, each.charts) for each in (best, packed)]
        if packed.fill * seams[0] > MIN_HALVING_GAIN * best.fill * seams[1]:
            best = packed
    return best


def _seam_length(surface: Chart, halfedges: np.ndarray, charts: list[CutChart]) -> float:
    """Return the length of the seams between and inside of charts, where triangles are connected across `halfedges` (I, 2)."""
    corners = surface.vertices[surface.triangles]
    lengths = np.linalg.norm(np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1), axis=2)  # Opposite to each corner.
    boundary = float(lengths.sum() - lengths.ravel()[halfedges].sum())
    perimeters = [cut.chart.vertices[boundary_edges(cut.chart.triangles)] for cut in charts]
    return 0.5 * (sum(float(np.linalg.norm(np.subtract(*ends.transpose(1, 0, 2)), axis=1).sum()) for ends in perimeters) - boundary)


def _average_corners(chart: Chart, corner_uvs: np.ndarray) -> np.ndarray:
    """Return the uv (V, 2) of a chart, the mean of `corner_uvs` (T, 3, 2) at each vertex."""
    corners = chart.triangles.ravel()
    sums = np.stack([np.bincount(corners, axis) for axis in corner_uvs.reshape(-1, 2).T], axis=1)
    return sums / np.bincount(corners)[:, None]
