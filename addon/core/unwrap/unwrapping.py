"""Unwraps a surface: cuts it into charts, parameterizes and arranges them, and measures the resulting UV map."""

import time
from dataclasses import dataclass, replace

import numpy as np

from ..errors import GeometryError
from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals, has_area
from ..geometry.transforms import signed_areas
from ..jobs.progress import Progress, Steps, subprogress
from .arrangement import merge_and_pack, pack, pack_upright
from .cutting.atlas_seams import find_atlas_seams
from .cutting.bisection import bisect_further
from .cutting.chart import Chart, label_components
from .cutting.charts import MAX_EXCESS, CutChart, connect_triangles, cut_further, cut_into_charts
from .cutting.cuts import POOR_EXCESS
from .cutting.regions import divide_at_creases
from .distortion import DistortionMetrics, Stretches, compute_stretches, measure_distortion
from .parameterization.developable import unfold_developable
from .parameterization.mild import flatten_mild
from .parameterization.parameterize import Balance, Boundary, DistortionError, parameterize
from .settings import UnwrapSettings
from .stacking import Copies, find_copies

CUTTING_END, PARAMETERIZATION_END, PACKING_END = 0.1, 0.9, 0.95  # Fractions of the progress bar.
MAX_CUT_ROUNDS = 2  # In each a chart is cut towards all its most distorted parts; in the second one only where it is poor or has needles.
MAX_BISECTIONS, MAX_BISECTIONS_WHILE_POOR = 3, 8  # Then a chart is divided in halves so many times, one after the other.
COARSE_EXCESS = 1.1  # A chart is divided at once if its coarsest mesh has an excess so many times the limit.
MAX_NEEDLES = 0.003  # As a fraction of a chart's map, above which it is cut further.
MIN_CHART_AREA = 1e-7  # As a fraction of the total area.


@dataclass(frozen=True)
class UnwrapResult:
    """A UV map.

    Attributes:
        corner_uvs: (T, 3, 2) float64 in UDIM tiles of side 1, the first one at the origin.
        stretches: Stretch of each triangle.
        metrics: Quality of the map.
        chart_count: Number of charts, with stacked ones.
        stacked_count: Number of charts in the place of another one.
        tile_count: Number of UDIM tiles.
        is_upright: Whether islands of vertical surfaces are turned so that up in the world is up in the map.
        seconds: Run time per stage.
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
    seconds, started = {}, time.perf_counter()
    check_surface(mesh, name)
    yield Progress(0.0, "Cutting")
    density = settings.density_ratio**importance
    parts, copies = np.zeros(len(density), np.int64), Copies.none(len(density))
    if settings.stack_equal_islands:
        parts, copies = yield from subprogress(_find_equal_parts(mesh, density, polygon_ids, seams), 0.0, 0.0)
    kept = np.flatnonzero(~copies.is_copy)
    surface = Chart(mesh.vertices, mesh.triangles[kept], density[kept], polygon_ids[kept])
    if settings.islands == "atlas":
        atlas_seams = find_atlas_seams(TriangleMesh(surface.vertices, surface.triangles), surface.polygon_ids)
        seams = np.concatenate([np.reshape(seams, (-1, 2)), atlas_seams])
    follows_creases = _follows_creases(settings)
    regions, halfedges = [], np.zeros((0, 2), np.int64)
    if follows_creases:
        halfedges, has_seam = yield from subprogress(connect_triangles(surface, seams), 0.0, CUTTING_END)
        regions, charts = yield from subprogress(divide_at_creases(surface, halfedges, has_seam), 0.0, CUTTING_END)
    else:
        charts = yield from subprogress(cut_into_charts(surface, seams, settings.further_cuts), 0.0, CUTTING_END)
    seconds["cut"], started = time.perf_counter() - started, time.perf_counter()
    charts, uvs = yield from subprogress(_parameterize_charts(charts, settings), CUTTING_END, PARAMETERIZATION_END)
    charts, uvs = [cut for cut, _ in regions] + charts, [uv for _, uv in regions] + uvs
    uvs = _scale_to_density(uvs, [cut.chart for cut in charts])
    seconds["parameterize"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(PARAMETERIZATION_END, "Packing")
    texels_per_unit = settings.texel_density * unit_length / float(np.sqrt(_mean_density(charts, uvs)))
    texture = replace(settings.texture, density=texels_per_unit)
    steps = pack(surface, charts, uvs, texture, settings.stack_equal_islands)
    if follows_creases:
        steps = merge_and_pack(surface, charts, uvs, halfedges, texture, settings.stack_equal_islands)
    packed = yield from subprogress(steps, PARAMETERIZATION_END, PACKING_END)
    if settings.orientation != "fill":
        steps = pack_upright(packed, texture, settings.orientation == "upright")
        packed = yield from subprogress(steps, PACKING_END, PACKING_END)
    corner_uvs, labels = np.empty((len(mesh.triangles), 3, 2)), np.empty(len(mesh.triangles), np.int64)
    corner_uvs[kept], labels[kept] = packed.corner_uvs, packed.labels
    corner_uvs, labels = copies.fill(corner_uvs), labels[copies.sources]
    is_stacked = copies.is_copy
    is_stacked[kept] = packed.copies.is_copy
    chart_count = len(np.unique(parts * len(labels) + labels))
    seconds["pack"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(PACKING_END, "Measuring")
    stretches = yield from subprogress(compute_stretches(mesh, corner_uvs * texture.aspect), PACKING_END, PACKING_END)
    yield Progress(PACKING_END, "Measuring")
    steps = measure_distortion(mesh, corner_uvs, stretches, importance, texture, unit_length, packed.tile_count, is_stacked)
    metrics = yield from subprogress(steps, PACKING_END, 1.0)
    seconds["measure"] = time.perf_counter() - started
    stacked_count = chart_count - packed.separate_count
    return UnwrapResult(corner_uvs, stretches, metrics, chart_count, stacked_count, packed.tile_count, packed.is_upright, seconds)


def _find_equal_parts(
    mesh: TriangleMesh, density: np.ndarray, polygon_ids: np.ndarray, seams: np.ndarray
) -> Steps[tuple[np.ndarray, Copies]]:
    """Return the connected part (T,) of each triangle, and which are copies of parts that are equal, also in their seams."""
    surface = Chart(mesh.vertices, mesh.triangles, density)
    halfedges, has_seam = yield from connect_triangles(surface, seams)
    _, parts = label_components(len(mesh.triangles), halfedges)
    copies = yield from find_copies(mesh.corners, parts, density, polygon_ids)
    is_equal = np.bincount(parts, has_seam != has_seam[copies.sources]) == 0
    sources = np.where(is_equal[parts], copies.sources, np.arange(len(parts)))
    return parts, Copies(sources, np.where(is_equal[parts], copies.turns, 0))


def _follows_creases(settings: UnwrapSettings) -> bool:
    """Return whether surfaces are divided along creases."""
    return settings.islands == "creases" and settings.further_cuts and settings.boundary == "free"


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
    if uv is None and is_uniform and cut.may_be_cut and _follows_creases(settings):
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
