"""Unwraps a surface: cuts it into charts, parameterizes and arranges them, and measures the resulting UV map."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GeometryError
from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals, has_area
from ..geometry.transforms import signed_areas
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .arrangement import PackedMap, merge_and_pack, pack, pack_upright
from .cutting.bisection import bisect_further
from .cutting.chart import Chart, label_components
from .cutting.charts import MAX_EXCESS, CutChart, connect_triangles, cut_further
from .cutting.cuts import POOR_EXCESS
from .cutting.divisions import Division, combine_divisions, combine_surfaces, divide
from .distortion import DistortionMetrics, Stretches, compute_stretches, measure_distortion
from .parameterization.developable import unfold_developable
from .parameterization.mild import flatten_mild
from .parameterization.parameterize import Balance, Boundary, DistortionError, parameterize
from .settings import UnwrapSettings
from .stacking import Copies, find_copies
from .texture import Texture

CUTTING_END, PARAMETERIZATION_END, PACKING_END = 0.1, 0.9, 0.95  # Fractions of the progress bar.
MAX_CUT_ROUNDS = 2  # In each a chart is cut towards all its most distorted parts; in the second one only where it is poor or has needles.
MAX_BISECTIONS, MAX_BISECTIONS_WHILE_POOR = 3, 8  # Then a chart is divided in halves so many times, one after the other.
COARSE_EXCESS = 1.1  # A chart is divided at once if its coarsest mesh has an excess so many times the limit.
MAX_NEEDLES = 0.003  # As a fraction of a chart's map, above which it is cut further.
MIN_CHART_AREA = 1e-7  # As a fraction of the total area.


@dataclass(frozen=True)
class UnwrapInput:
    """A mesh to unwrap.

    Attributes:
        mesh: T triangles, in world space.
        polygon_ids: (T,) the polygon of each triangle; polygons are never cut.
        seams: (S, 2) vertices of edges that are always cut.
        importance: (T,) 0 to 1.
        name: Of the object, for errors.
    """

    mesh: TriangleMesh
    polygon_ids: np.ndarray
    seams: np.ndarray
    importance: np.ndarray
    name: str = "mesh"


@dataclass(frozen=True)
class UnwrapResult:
    """A UV map.

    Attributes:
        corner_uvs: (T, 3, 2) float64 in UDIM tiles of side 1, the first one at the origin.
        stretches: Stretch of each triangle.
        metrics: Quality of the map. Its fill is that of the whole texture, also where this has several meshes.
        chart_count: Number of charts, with stacked ones.
        stacked_count: Number of charts in the place of another one.
        tile_count: Number of UDIM tiles of the texture.
        is_upright: Whether islands of vertical surfaces are turned so that up in the world is up in the map.
        seconds: Run time per stage, shared by several meshes in one texture in proportion to their triangles.
    """

    corner_uvs: np.ndarray
    stretches: Stretches
    metrics: DistortionMetrics
    chart_count: int
    stacked_count: int
    tile_count: int
    is_upright: bool
    seconds: dict[str, float]

    @property
    def counts(self) -> dict[str, int]:
        """The counts, as reports and custom properties name them."""
        return {"islands": self.chart_count, "stacked": self.stacked_count, "tiles": self.tile_count}


def unwrap(
    mesh: TriangleMesh,
    polygon_ids: np.ndarray,
    seams: np.ndarray,
    importance: np.ndarray,
    settings: UnwrapSettings,
    name: str = "mesh",
    unit_length: float = 1.0,
) -> Steps[UnwrapResult]:
    """Return the UV map of `mesh`, in world space.

    Args:
        polygon_ids: (T,) the polygon of each triangle; polygons are never cut.
        seams: (S, 2) vertices of edges that are always cut.
        importance: (T,) 0 to 1.
        name: of the object, for errors.
        unit_length: of a unit of `mesh`, in meters.

    Raises:
        GeometryError: see `check_surface`; or a part cannot be parameterized.
    """
    [result] = yield from unwrap_together([UnwrapInput(mesh, polygon_ids, seams, importance, name)], settings, unit_length)
    return result


def unwrap_together(inputs: Sequence[UnwrapInput], settings: UnwrapSettings, unit_length: float = 1.0) -> Steps[list[UnwrapResult]]:
    """Return the UV maps of several meshes in one texture. Each mesh is cut as it would be alone; all get the same texel density.

    unit_length: of a unit of the meshes, in meters.

    Raises:
        GeometryError: see `check_surface`; or a part cannot be parameterized.
    """
    clock, ends = StageClock(), np.cumsum([len(each.mesh.triangles) for each in inputs])
    for each in inputs:
        check_surface(each.mesh, each.name)
    with clock.stage("cut"):
        division, parts, copies = yield from subprogress(_divide_all(inputs, settings), 0.0, CUTTING_END)
    with clock.stage("parameterize"):
        charts, uvs = yield from subprogress(_parameterize_charts(division.others, settings), CUTTING_END, PARAMETERIZATION_END)
        charts, uvs = [cut for cut, _ in division.flat] + charts, [uv for _, uv in division.flat] + uvs
        uvs = _scale_to_density(uvs, [cut.chart for cut in charts])
    with clock.stage("pack"):
        yield Progress(PARAMETERIZATION_END, "Packing")
        texels_per_unit = settings.texel_density * unit_length / float(np.sqrt(_mean_density(charts, uvs)))
        texture = replace(settings.texture, density=texels_per_unit)
        packed = yield from subprogress(_pack(division, charts, uvs, texture, settings), PARAMETERIZATION_END, PACKING_END)
        kept, is_stacked = np.flatnonzero(~copies.is_copy), copies.is_copy
        corner_uvs, labels = np.empty((len(parts), 3, 2)), np.empty(len(parts), np.int64)
        corner_uvs[kept], labels[kept], is_stacked[kept] = packed.corner_uvs, packed.labels, packed.copies.is_copy
        corner_uvs, labels = copies.fill(corner_uvs), parts * len(parts) + labels[copies.sources]
    results, start = [], PACKING_END
    with clock.stage("measure"):
        for each, *arrays in zip(inputs, *(np.split(values, ends[:-1]) for values in (corner_uvs, labels, is_stacked)), strict=True):
            stop = start + (1.0 - PACKING_END) * len(each.mesh.triangles) / ends[-1]
            results.append((yield from subprogress(_measure(each, *arrays, packed, texture, unit_length), start, stop)))
            start = stop
    fill = sum(result.metrics.fill for result in results)
    fractions = [len(each.mesh.triangles) / ends[-1] for each in inputs]
    return [
        replace(
            result,
            metrics=replace(result.metrics, fill=fill),
            seconds={stage: duration * fraction for stage, duration in clock.seconds.items()},
        )
        for result, fraction in zip(results, fractions, strict=True)
    ]


def _divide_all(inputs: Sequence[UnwrapInput], settings: UnwrapSettings) -> Steps[tuple[Division, np.ndarray, Copies]]:
    """Return the charts of all meshes, without those of equal parts that share a place; the part (T,) of each of all triangles, and which
    are copies."""
    yield Progress(0.0, "Cutting")
    surfaces = [
        Chart(each.mesh.vertices, each.mesh.triangles, settings.density_ratio**each.importance, each.polygon_ids) for each in inputs
    ]
    ends = np.cumsum([len(surface.triangles) for surface in surfaces])
    parts, copies = np.zeros(ends[-1], np.int64), Copies.none(ends[-1])
    if settings.stack_equal_islands:
        parts, copies = yield from subprogress(_find_equal_parts(surfaces, [each.seams for each in inputs]), 0.0, 0.0)
    divisions, start = [], 0.0
    for each, surface, kept in zip(inputs, surfaces, np.split(~copies.is_copy, ends[:-1]), strict=True):
        own = Chart(surface.vertices, surface.triangles[kept], surface.density[kept], surface.polygon_ids[kept])
        stop = start + len(kept) / ends[-1]
        divisions.append((yield from subprogress(divide(own, each.seams, settings), start, stop)))
        start = stop
    return combine_divisions(divisions), parts, copies


def _find_equal_parts(surfaces: Sequence[Chart], seams: Sequence[np.ndarray]) -> Steps[tuple[np.ndarray, Copies]]:
    """Return the connected part (T,) of each triangle of all surfaces, and which are copies of parts that are equal, also in their `seams`
    (S, 2)."""
    halfedges, has_seam, first = [], [], 0
    for surface, own_seams in zip(surfaces, seams, strict=True):
        own_halfedges, own_has_seam = yield from connect_triangles(surface, own_seams)
        halfedges.append(own_halfedges + 3 * first)
        has_seam.append(own_has_seam)
        first += len(surface.triangles)
    surface, has_seam = combine_surfaces(surfaces), np.concatenate(has_seam)
    _, parts = label_components(first, np.concatenate(halfedges))
    copies = yield from find_copies(surface.vertices[surface.triangles], parts, surface.density, surface.polygon_ids)
    is_equal = np.bincount(parts, has_seam != has_seam[copies.sources]) == 0
    sources = np.where(is_equal[parts], copies.sources, np.arange(len(parts)))
    return parts, Copies(sources, np.where(is_equal[parts], copies.turns, 0))


def _pack(
    division: Division, charts: list[CutChart], uvs: list[np.ndarray], texture: Texture, settings: UnwrapSettings
) -> Steps[PackedMap]:
    """Return the packed map of charts with `uvs` (V, 2) of each."""
    stack = settings.stack_equal_islands
    steps = pack(division.surface, charts, uvs, texture, stack)
    if settings.follows_creases:
        steps = merge_and_pack(division.surface, charts, uvs, division.halfedges, texture, stack)
    packed = yield from subprogress(steps, 0.0, 1.0)
    if settings.orientation != "fill":
        packed = yield from subprogress(pack_upright(packed, texture, settings.orientation == "upright"), 1.0, 1.0)
    return packed


def _measure(
    each: UnwrapInput,
    corner_uvs: np.ndarray,
    labels: np.ndarray,
    is_stacked: np.ndarray,
    packed: PackedMap,
    texture: Texture,
    unit_length: float,
) -> Steps[UnwrapResult]:
    """Return the map (T, 3, 2) of one mesh, with its own fill and without times. labels: (T,) the chart of each triangle."""
    yield Progress(0.0, "Measuring")
    stretches = yield from subprogress(compute_stretches(each.mesh, corner_uvs * texture.aspect), 0.0, 0.0)
    yield Progress(0.0, "Measuring")
    steps = measure_distortion(each.mesh, corner_uvs, stretches, each.importance, texture, unit_length, packed.tile_count, is_stacked)
    metrics = yield from steps
    counts = [len(np.unique(chosen)) for chosen in (labels, labels[is_stacked])]
    return UnwrapResult(corner_uvs, stretches, metrics, *counts, packed.tile_count, packed.is_upright, {})


def check_surface(mesh: TriangleMesh, name: str) -> None:
    """Raise GeometryError when `mesh`, of the object `name`, has no faces, is not finite, or has no face with an area."""
    if len(mesh.triangles) == 0:
        raise GeometryError(f'"{name}" has no faces to unwrap; choose an object with faces.')
    check_points(mesh.vertices[np.unique(mesh.triangles)], name)
    if not has_area(mesh.corners).any():
        raise GeometryError(f'Every face of "{name}" has zero area; choose an object with a surface.')


def _parameterize_charts(charts: list[CutChart], settings: UnwrapSettings) -> Steps[tuple[list[CutChart], list[np.ndarray]]]:
    """Return the charts, cut further where necessary, and the uv (V, 2) of each, at any scale."""
    total, done, maps = sum(len(cut.triangle_indices) for cut in charts), 0, []
    for index, cut in enumerate(charts):
        fraction = len(cut.triangle_indices) / total
        yield Progress(done, f"Unwrapping UV island {index + 1} of {len(charts)}")
        maps += yield from subprogress(_parameterize_chart(cut, settings, MAX_CUT_ROUNDS), done, done + fraction)
        done += fraction
    yield Progress(1.0, "Packing")
    return [cut for cut, _ in maps], [uv for _, uv in maps]


def _parameterize_chart(cut: CutChart, settings: UnwrapSettings, rounds_left: int) -> Steps[list[tuple[CutChart, np.ndarray]]]:
    """Return a chart with its uv (V, 2), or the charts into which it is cut because it is strongly distorted in one piece."""
    boundary, balance = Boundary(settings.boundary), Balance(settings.balance)
    uv = (yield from subprogress(unfold_developable(cut.chart), 0.0, 0.0)) if boundary is Boundary.FREE else None
    is_uniform = settings.min_quality == 0.0 and float(np.ptp(cut.chart.density)) == 0.0
    if uv is None and is_uniform and cut.may_be_cut and settings.follows_creases:
        uv = flatten_mild(cut.chart)
    if uv is not None:
        return [(cut, uv)]
    if boundary is not Boundary.FREE or not cut.may_be_cut:
        return [(cut, (yield from parameterize(cut.chart, boundary, settings.min_quality, balance)))]
    is_limited, is_last = cut.max_excess < MAX_EXCESS, rounds_left <= -MAX_BISECTIONS
    max_cut_excess = MAX_EXCESS if rounds_left == MAX_CUT_ROUNDS else POOR_EXCESS
    max_excess = COARSE_EXCESS * cut.max_excess if is_limited and not is_last else max_cut_excess
    uv, needles, excess = None, 0.0, np.inf
    try:
        uv = yield from subprogress(parameterize(cut.chart, boundary, settings.min_quality, balance, max_excess), 0.0, 0.5)
        needles, excess = yield from subprogress(_measure_chart(cut.chart, uv), 0.5, 0.5)
    except DistortionError as error:
        excess = error.excess
    except GeometryError:
        pass
    has_needles = needles > MAX_NEEDLES
    if uv is not None and (is_last or not (has_needles or (is_limited and excess > cut.max_excess))):
        return [(cut, uv)]
    pieces = [cut]
    if rounds_left > 0 and (has_needles or excess > max_cut_excess):
        pieces = yield from subprogress(cut_further(cut), 0.5, 0.5)
    if _is_uncut(pieces, cut) and rounds_left > -MAX_BISECTIONS_WHILE_POOR:
        pieces = yield from subprogress(bisect_further(cut, uv), 0.5, 0.5)
        rounds_left = min(rounds_left, 1)
    if _is_uncut(pieces, cut):
        return [(cut, (yield from parameterize(cut.chart, boundary, settings.min_quality, balance)) if uv is None else uv)]
    maps, done = [], 0.5
    for piece in pieces:
        stop = done + 0.5 * len(piece.triangle_indices) / len(cut.triangle_indices)
        steps = _parameterize_chart(piece, settings, rounds_left - 1)
        maps += yield from subprogress(steps, done, stop)
        done = stop
    return maps


def _is_uncut(pieces: list[CutChart], cut: CutChart) -> bool:
    return len(pieces) == 1 and len(pieces[0].chart.vertices) == len(cut.chart.vertices)


def _measure_chart(chart: Chart, uv: np.ndarray) -> Steps[tuple[float, float]]:
    """Return the fraction of the map `uv` (V, 2) in needles, and the excess of its symmetric Dirichlet energy."""
    corner_uvs, mesh = uv[chart.triangles], TriangleMesh(chart.vertices, chart.triangles)
    stretches = yield from compute_stretches(mesh, corner_uvs)
    areas, weights = signed_areas(corner_uvs), face_areas_and_normals(mesh.corners)[0]
    has_area = weights > 0.0
    weights, largest, smallest = weights[has_area], stretches.max_stretch[has_area] ** 2, stretches.min_stretch[has_area] ** 2
    with np.errstate(divide="ignore"):
        products = (weights @ (largest + smallest)) * (weights @ (1.0 / largest + 1.0 / smallest))
    excess = 0.5 * float(np.sqrt(products) / weights.sum()) - 1.0
    return float(areas[stretches.is_needle].sum() / areas.sum()), excess


def _mean_density(charts: list[CutChart], uvs: list[np.ndarray]) -> float:
    """Return the area of the `uvs` (V, 2) of charts over that of the surface."""
    areas = [float(face_areas_and_normals(cut.chart.vertices[cut.chart.triangles])[0].sum()) for cut in charts]
    return sum(float(signed_areas(uv[cut.chart.triangles]).sum()) for cut, uv in zip(charts, uvs, strict=True)) / sum(areas)


def _scale_to_density(uvs: list[np.ndarray], charts: list[Chart]) -> list[np.ndarray]:
    """Scale each of `uvs` to the chart's surface area times `density`, but at least to `MIN_CHART_AREA`."""
    wanted = np.array([float(face_areas_and_normals(chart.vertices[chart.triangles])[0] @ chart.density) for chart in charts])
    wanted = np.maximum(wanted, MIN_CHART_AREA * wanted.sum() or 1.0)
    areas = [float(signed_areas(uv[chart.triangles]).sum()) for uv, chart in zip(uvs, charts, strict=True)]
    return [uv * scale for uv, scale in zip(uvs, np.sqrt(wanted / areas), strict=True)]
