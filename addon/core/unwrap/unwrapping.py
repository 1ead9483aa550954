"""A surface in, its UV map out: charts, their layouts, the packing, and what all of it is worth."""

import time
from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError
from ..mesh import TriangleMesh, check_points, face_areas_and_normals
from ..progress import Progress, Steps, scaled
from .atlas_seams import atlas_seams
from .chart import Chart
from .chart_layout import Border, chart_layout
from .charts import Piece, pieces_of
from .measures import Measures, Stretches, measured, stretches_of
from .packing import packed
from .plane import signed_areas
from .settings import UnwrapSettings
from .unfolding import unfolded

CUTTING, LAYING, PACKING = 0.1, 0.9, 0.95  # shares of the bar when each is done
SPECK = 1e-7  # of the whole: the least area that a chart gets


@dataclass(frozen=True)
class Unwrapped:
    """A UV map. corners: (T, 3, 2) float64 in the unit square. stretches: of every triangle. charts: their number. seconds: by stage."""

    corners: np.ndarray
    stretches: Stretches
    measures: Measures
    charts: int
    seconds: dict[str, float]


def unwrap(
    mesh: TriangleMesh, faces: np.ndarray, seams: np.ndarray, importance: np.ndarray, settings: UnwrapSettings, name: str = "mesh"
) -> Steps[Unwrapped]:
    """The UV map of `mesh`, in world space.

    faces: (T,), which triangles make up a face and are never cut apart. seams: (S, 2), vertices joined by edges that are cut in any case.
    importance: (T,), 0 to 1, of every triangle.

    Raises:
        GeometryError: when the mesh is empty, not finite, or has a part of which no layout can be begun.
    """
    clock, started = {}, time.perf_counter()
    _check(mesh, name)
    yield Progress(0.0, "Cutting")
    if settings.chart == "atlas":
        seams = np.concatenate([np.reshape(seams, (-1, 2)), atlas_seams(mesh, faces)])
    density = settings.density_ratio**importance
    surface = Chart(mesh.vertices, mesh.triangles, density, faces)
    pieces = yield from scaled(pieces_of(surface, seams, settings.further_cuts), 0.0, CUTTING)
    clock["cut"], started = time.perf_counter() - started, time.perf_counter()
    layouts = yield from scaled(_layouts(pieces, settings), CUTTING, LAYING)
    clock["layout"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(LAYING, "Packing")
    layouts = packed(layouts, [piece.chart.triangles for piece in pieces], settings.margin)
    corners = np.empty((len(mesh.triangles), 3, 2))
    for piece, layout in zip(pieces, layouts, strict=True):
        corners[piece.triangles] = layout[piece.chart.triangles]
    clock["pack"], started = time.perf_counter() - started, time.perf_counter()
    yield Progress(PACKING, "Measuring")
    stretches = yield from scaled(stretches_of(mesh, corners), PACKING, PACKING)
    yield Progress(PACKING, "Measuring")
    figures = yield from scaled(measured(mesh, corners, stretches, importance), PACKING, 1.0)
    clock["measure"] = time.perf_counter() - started
    return Unwrapped(corners, stretches, figures, len(pieces), clock)


def _check(mesh: TriangleMesh, name: str) -> None:
    if len(mesh.triangles) == 0:
        raise GeometryError(f'"{name}" has no faces to unwrap.')
    check_points(mesh.vertices[np.unique(mesh.triangles)], name)


def _layouts(pieces: list[Piece], settings: UnwrapSettings) -> Steps[list[np.ndarray]]:
    """A layout of every piece, with the areas that importance gives them."""
    total, done, layouts = sum(len(piece.triangles) for piece in pieces), 0, []
    border = Border(settings.boundary)
    for number, piece in enumerate(pieces):
        share = len(piece.triangles) / total
        yield Progress(done, f"Laying out chart {number + 1} of {len(pieces)}")
        layout = (yield from scaled(unfolded(piece.chart), done, done)) if border is Border.FREE else None
        if layout is None:
            layout = yield from scaled(chart_layout(piece.chart, border, settings.min_shape), done, done + share)
        layouts.append(layout)
        done += share
    yield Progress(1.0, "Packing")
    return _sized(layouts, [piece.chart for piece in pieces])


def _sized(layouts: list[np.ndarray], charts: list[Chart]) -> list[np.ndarray]:
    """Layouts scaled to the areas that their charts' triangles should have, `density` times their own, or next to none."""
    wanted = np.array([float(face_areas_and_normals(chart.vertices[chart.triangles])[0] @ chart.density) for chart in charts])
    wanted = np.maximum(wanted, SPECK * wanted.sum() or 1.0)
    has = [float(signed_areas(layout[chart.triangles]).sum()) for layout, chart in zip(layouts, charts, strict=True)]
    return [layout * scale for layout, scale in zip(layouts, np.sqrt(wanted / has), strict=True)]
