"""Divides surfaces into charts by the settings of an unwrap, and combines the charts of several surfaces for one texture."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...geometry.mesh import TriangleMesh, concatenate
from ...jobs.progress import Steps, subprogress
from ..settings import UnwrapSettings
from .atlas_seams import find_atlas_seams
from .chart import Chart
from .charts import CutChart, connect_triangles, cut_into_charts
from .regions import divide_at_creases


@dataclass(frozen=True)
class Division:
    """The charts of a surface.

    Attributes:
        surface: That they are parts of.
        flat: Charts that are flat, with the uv (V, 2) of each, at the scale of the surface.
        others: All other charts.
        halfedges: (I, 2), 3 t + c, pairs across which triangles may be connected; none unless charts follow creases.
    """

    surface: Chart
    flat: list[tuple[CutChart, np.ndarray]]
    others: list[CutChart]
    halfedges: np.ndarray


def divide(surface: Chart, seams: np.ndarray, settings: UnwrapSettings) -> Steps[Division]:
    """Return the charts of a surface, which has no triangles or is as `cut_into_charts` describes. seams: (S, 2) vertices of edges."""
    no_halfedges = np.zeros((0, 2), np.int64)
    if len(surface.triangles) == 0:
        return Division(surface, [], [], no_halfedges)
    if settings.islands == "atlas":
        atlas_seams = find_atlas_seams(TriangleMesh(surface.vertices, surface.triangles), surface.polygon_ids)
        seams = np.concatenate([np.reshape(seams, (-1, 2)), atlas_seams])
    if not settings.follows_creases:
        return Division(surface, [], (yield from cut_into_charts(surface, seams, settings.further_cuts)), no_halfedges)
    halfedges, has_seam = yield from subprogress(connect_triangles(surface, seams), 0.0, 0.0)
    flat, others = yield from divide_at_creases(surface, halfedges, has_seam)
    return Division(surface, flat, others, halfedges)


def combine_surfaces(surfaces: Sequence[Chart]) -> Chart:
    """Return one surface of several, which are not connected."""
    mesh = concatenate([TriangleMesh(surface.vertices, surface.triangles) for surface in surfaces])
    first_ids = np.cumsum([0, *(int(surface.polygon_ids.max(initial=-1)) + 1 for surface in surfaces[:-1])])
    polygon_ids = [surface.polygon_ids + first for surface, first in zip(surfaces, first_ids, strict=True)]
    return Chart(mesh.vertices, mesh.triangles, np.concatenate([surface.density for surface in surfaces]), np.concatenate(polygon_ids))


def combine_divisions(divisions: Sequence[Division]) -> Division:
    """Return the charts of several surfaces as those of one surface."""
    firsts = np.cumsum([0, *(len(division.surface.triangles) for division in divisions[:-1])]).tolist()
    pairs = list(zip(divisions, firsts, strict=True))
    return Division(
        combine_surfaces([division.surface for division in divisions]),
        [(_shift(cut, first), uv) for division, first in pairs for cut, uv in division.flat],
        [_shift(cut, first) for division, first in pairs for cut in division.others],
        np.concatenate([division.halfedges + 3 * first for division, first in pairs]),
    )


def _shift(cut: CutChart, first: int) -> CutChart:
    """Return a chart of a surface whose triangles begin at index `first` of a larger one."""
    return replace(cut, triangle_indices=cut.triangle_indices + first)
