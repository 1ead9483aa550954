"""Estimates of the levels of a cloud by a trial: the cloud of a mesh of nearly the same shape with few triangles.

The trial takes every step of a real build, so it knows whatever decides there: levels that are left out, specks, budgets. Neighboring
vertices become one, until few triangles are left. Where that would remove much of the surface, as of a dense crown of small leaves, and for
methods other than face clustering, the estimate is that of `estimate_levels`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.mesh import PointCloud, TriangleMesh, connected_components, drop_degenerate, longest_side
from ..jobs.progress import Steps
from .budget import read_budget
from .build import build_cloud
from .estimate import BYTES_PER_TEXEL, LevelEstimate, SurfaceSample, estimate_levels, sample_geometry
from .settings import BillboardSettings

MAX_PRIMITIVES = 4000  # Triangles or points of a trial; its build takes one to four seconds.
FIRST_CELL, CELL_GROWTH = 1e-3, 1.2  # Cells in which vertices become one: the first size over the longest side, and the next over the last.
MIN_AREA_FRACTION = 0.5  # Of the area of the source that a trial must keep.


@dataclass(frozen=True)
class Trial:
    """A source with at most `MAX_PRIMITIVES` for estimates with any settings.

    Attributes:
        geometry: The reduced source; None if no trial is possible.
        scale: Longest side of the source over that of `geometry`.
        name: Of the source, for messages.
        sample: Sample of the complete source.
    """

    geometry: TriangleMesh | PointCloud | None
    scale: float
    name: str
    sample: SurfaceSample


def prepare_trial(geometry: TriangleMesh | PointCloud, name: str) -> Trial:
    """Reduce `geometry` for any number of estimates.

    Raises:
        GeometryError: `geometry` is unusable; the message contains `name`.
    """
    sample = sample_geometry(geometry, name)
    reduced = _thin_points(geometry) if isinstance(geometry, PointCloud) else _merge_vertices(drop_degenerate(geometry, name)[0])
    if reduced is None:
        return Trial(None, 1.0, name, sample)
    points = reduced.points if isinstance(reduced, PointCloud) else reduced.vertices[np.unique(reduced.triangles)]
    return Trial(reduced, sample.longest_side / longest_side(points), name, sample)


def estimate_by_trial(trial: Trial, settings: BillboardSettings) -> Steps[list[LevelEstimate]]:
    """Estimate the levels that a build with `settings` keeps, finest first; on ordinary models within 1.5 times of the result.

    Raises:
        SettingsError: see `build_cloud`.
    """
    if trial.geometry is None or settings.method != "clusters":
        return estimate_levels(trial.sample, settings)
    if read_budget(settings) is None:
        settings = replace(settings, error=settings.error * trial.scale)
    cloud = yield from build_cloud(trial.geometry, settings, trial.name)
    bytes_per_texel = BYTES_PER_TEXEL if settings.textures else 0
    return [
        LevelEstimate(
            error=level.error,
            triangles=level.triangle_count,
            mesh_triangles=level.chart_triangle_count,
            quads=len(level.quads),
            texels=level.texel_count,
            bytes=math.prod(level.atlas.size) * bytes_per_texel,
        )
        for level in cloud.levels
    ]


def _merge_vertices(mesh: TriangleMesh) -> TriangleMesh | None:
    """Return `mesh` with the vertices of each cell of a grid merged, as fine as `MAX_PRIMITIVES` allow; None if it loses much area."""
    parts = np.zeros(len(mesh.vertices), np.int64)
    parts[mesh.triangles] = connected_components(mesh.vertices, mesh.triangles)[:, None]
    cell, reduced = FIRST_CELL * longest_side(mesh.vertices), mesh
    while len(reduced.triangles) > MAX_PRIMITIVES:
        reduced = _merge_in_cells(mesh, parts, cell)
        cell *= CELL_GROWTH
    return reduced if reduced is mesh or _area(reduced) >= MIN_AREA_FRACTION * _area(mesh) else None


def _merge_in_cells(mesh: TriangleMesh, parts: np.ndarray, cell: float) -> TriangleMesh:
    """Return `mesh` with the vertices of one of the `parts` (V,) in a cube of side `cell` merged to their mean, without collapsed and
    equal triangles."""
    cells = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / cell).astype(np.int64)
    keys = np.ravel_multi_index((*cells.T, parts), (*cells.max(axis=0) + 1, int(parts.max()) + 1))
    _, merged, counts = np.unique(keys, return_inverse=True, return_counts=True)
    merged = merged.reshape(-1)
    vertices = np.stack([np.bincount(merged, column) for column in mesh.vertices.T], axis=1) / counts[:, None]
    triangles = merged[mesh.triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)[1]
    return TriangleMesh(vertices, triangles[np.sort(first)].astype(np.int32))


def _area(mesh: TriangleMesh) -> float:
    """Return the area of `mesh`."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _thin_points(cloud: PointCloud) -> PointCloud:
    """Return at most `MAX_PRIMITIVES` random points of `cloud`, with discs of the same total area."""
    if len(cloud.points) <= MAX_PRIMITIVES:
        return cloud
    kept = np.sort(np.random.default_rng(0).choice(len(cloud.points), MAX_PRIMITIVES, replace=False))
    radii = cloud.radii[kept] * math.sqrt(len(cloud.points) / MAX_PRIMITIVES)
    return PointCloud(cloud.points[kept], cloud.normals[kept], radii)
