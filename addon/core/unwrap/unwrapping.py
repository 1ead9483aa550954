"""Unwraps a surface: cuts it into charts, parameterizes and packs them, and measures the resulting UV map."""

import time
from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError
from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals, has_area
from ..geometry.transforms import signed_areas
from ..jobs.progress import Progress, Steps, subprogress
from .cutting.atlas_seams import find_atlas_seams
from .cutting.chart import Chart
from .cutting.charts import CutChart, cut_further, cut_into_charts
from .cutting.cuts import POOR_EXCESS
from .distortion import DistortionMetrics, Stretches, compute_stretches, measure_distortion
from .packing import pack_charts
from .parameterization.developable import unfold_developable
from .parameterization.parameterize import Balance, Boundary, parameterize
from .settings import UnwrapSettings

CUTTING_END, PARAMETERIZATION_END, PACKING_END = 0.1, 0.9, 0.95  # Fractions of the progress bar.
MAX_CUT_ROUNDS = 2  # In each a chart is cut towards all its most distorted parts; in the second one only where it is poor or has needles.
MAX_EXCESS = 0.3  # Of symmetric Dirichlet energy over 4: charts with more in one piece are cut further.
MAX_NEEDLES = 0.003  # As a fraction of a chart's map, above which it is cut further.
MIN_CHART_AREA = 1e-7  # As a fraction of the total area.


@dataclass(frozen=True)
class UnwrapResult:
    """A UV map.

    Attributes:
        corner_uvs: (T, 3, 2) float64 in the unit square.
        stretches: Stretch of each triangle.
        metrics: Quality of the map.
        chart_count: Number of charts.
        seconds: Run time per stage.
    """

    corner_uvs: np.ndarray
    stretches: Stretches
    metrics: DistortionMetrics
    chart_count: int
    seconds: dict[str, float]


def unwrap(
    mesh: TriangleMesh, polygon_ids: np.ndarray, seams: np.ndarray, importance: np.ndarray, settings: UnwrapSettings, name: str = "mesh"
) -> Steps[UnwrapResult]:
    """Return the UV map of `mesh`, in world space.

    Args:
        polygon_ids: (T,) the polygon of each triangle; polygons are never cut.
        seams: (S, 2) vertices of edges that are always cut.
        importance: (T,) 0 to 1.

    Raises:
        GeometryError: see `check_surface`; or a part cannot be parameterized.
    """
    seconds, started = {}, time.perf_counter()
    check_surface(mesh, name)
    yield Progress(0.0, "Cutting")
    if settings.islands == "atlas":
        seams = np.concatenate([np.reshape(seams, (-1, 2)), find_atlas_seams(mesh, polygon_ids)])
    density = settings.density_ratio**importance
    surface = Chart(mesh.vertices, mesh.triangles, density, polygon_ids)
    charts = yield from subprogress(cut_into_charts(surface, seams, settings.further_cuts), 0.0, CUTTING_END)
    seconds["cut"], started = time.perf_counter() - started, time.perf_counter()
    charts, uvs = yield from subprogress(_parameterize_charts(charts, settings), CUTTING_END, PARAMETERIZATION_END)
    seconds["parameterize"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(PARAMETERIZATION_END, "Packing")
    uvs = pack_charts(uvs, [cut.chart.triangles for cut in charts], settings.margin)
    corner_uvs = np.empty((len(mesh.triangles), 3, 2))
    for cut, uv in zip(charts, uvs, strict=True):
        corner_uvs[cut.triangle_indices] = uv[cut.chart.triangles]
    seconds["pack"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(PACKING_END, "Measuring")
    stretches = yield from subprogress(compute_stretches(mesh, corner_uvs), PACKING_END, PACKING_END)
    yield Progress(PACKING_END, "Measuring")
    metrics = yield from subprogress(measure_distortion(mesh, corner_uvs, stretches, importance), PACKING_END, 1.0)
    seconds["measure"] = time.perf_counter() - started
    return UnwrapResult(corner_uvs, stretches, metrics, len(charts), seconds)


def check_surface(mesh: TriangleMesh, name: str) -> None:
    """Raise GeometryError when `mesh`, of the object `name`, has no faces, is not finite, or has no face with an area."""
    if len(mesh.triangles) == 0:
        raise GeometryError(f'"{name}" has no faces to unwrap; choose an object with faces.')
    check_points(mesh.vertices[np.unique(mesh.triangles)], name)
    if not has_area(mesh.corners).any():
        raise GeometryError(f'Every face of "{name}" has zero area; choose an object with a surface.')


def _parameterize_charts(charts: list[CutChart], settings: UnwrapSettings) -> Steps[tuple[list[CutChart], list[np.ndarray]]]:
    """Return the charts, cut further where necessary, and the uv (V, 2) of each, scaled by its density."""
    total, done, maps = sum(len(cut.triangle_indices) for cut in charts), 0, []
    for index, cut in enumerate(charts):
        fraction = len(cut.triangle_indices) / total
        yield Progress(done, f"Unwrapping UV island {index + 1} of {len(charts)}")
        maps += yield from subprogress(_parameterize_chart(cut, settings, MAX_CUT_ROUNDS), done, done + fraction)
        done += fraction
    yield Progress(1.0, "Packing")
    charts, uvs = [cut for cut, _ in maps], [uv for _, uv in maps]
    return charts, _scale_to_density(uvs, [cut.chart for cut in charts])


def _parameterize_chart(cut: CutChart, settings: UnwrapSettings, rounds_left: int) -> Steps[list[tuple[CutChart, np.ndarray]]]:
    """Return a chart with its uv (V, 2), or the charts into which it is cut because it is strongly distorted in one piece."""
    boundary, balance = Boundary(settings.boundary), Balance(settings.balance)
    uv = (yield from subprogress(unfold_developable(cut.chart), 0.0, 0.0)) if boundary is Boundary.FREE else None
    if uv is not None:
        return [(cut, uv)]
    if boundary is not Boundary.FREE or not cut.may_be_cut or rounds_left == 0:
        return [(cut, (yield from parameterize(cut.chart, boundary, settings.min_quality, balance)))]
    is_first_round = rounds_left == MAX_CUT_ROUNDS
    max_excess = MAX_EXCESS if is_first_round else POOR_EXCESS
    try:
        uv = yield from subprogress(parameterize(cut.chart, boundary, settings.min_quality, balance, max_excess), 0.0, 0.5)
    except GeometryError:
        uv = None
    if uv is not None and (yield from subprogress(_needle_fraction(cut.chart, uv), 0.5, 0.5)) <= MAX_NEEDLES:
        return [(cut, uv)]
    pieces = yield from subprogress(cut_further(cut, uv is None and not is_first_round), 0.5, 0.5)
    is_uncut = len(pieces) == 1 and len(pieces[0].chart.vertices) == len(cut.chart.vertices)
    if is_uncut and uv is not None:
        return [(cut, uv)]
    maps, done = [], 0.5
    for piece in pieces:
        stop = done + 0.5 * len(piece.triangle_indices) / len(cut.triangle_indices)
        steps = _parameterize_chart(piece, settings, rounds_left - 1)
        maps += yield from subprogress(steps, done, stop)
        done = stop
    return maps


def _needle_fraction(chart: Chart, uv: np.ndarray) -> Steps[float]:
    """Return the fraction of the map `uv` (V, 2) in needles."""
    corner_uvs = uv[chart.triangles]
    stretches = yield from compute_stretches(TriangleMesh(chart.vertices, chart.triangles), corner_uvs)
    areas = signed_areas(corner_uvs)
    return float(areas[stretches.is_needle].sum() / areas.sum())


def _scale_to_density(uvs: list[np.ndarray], charts: list[Chart]) -> list[np.ndarray]:
    """Scale each of `uvs` to the chart's surface area times `density`, but at least to `MIN_CHART_AREA`."""
    wanted = np.array([float(face_areas_and_normals(chart.vertices[chart.triangles])[0] @ chart.density) for chart in charts])
    wanted = np.maximum(wanted, MIN_CHART_AREA * wanted.sum() or 1.0)
    areas = [float(signed_areas(uv[chart.triangles]).sum()) for uv, chart in zip(uvs, charts, strict=True)]
    return [uv * scale for uv, scale in zip(uvs, np.sqrt(wanted / areas), strict=True)]
