"""Divides a surface into regions along its creases: flat ones, which are projected, and curved ones, which are cut to disks.

Bevels and fillets belong to the flat region next to them where that distorts them little.
"""

import numpy as np

from ...arrays import TINY
from ...geometry.edges import halfedge_ends
from ...geometry.mesh import face_areas_and_normals, scaled_normals
from ...geometry.transforms import frame_from_normal, normalize
from ...jobs.progress import Progress, Steps
from ..energies.boundary_barrier import overlaps_itself
from .bevels import divide_at_bevels
from .chart import Chart, label_components, split_into_components
from .charts import MAX_EXCESS, CutChart, cut_to_disks
from .creases import find_creases

FLAT_COSINE = np.cos(np.radians(10.0))  # Between the normals of the triangles of a flat region and their mean.
MAX_BEVEL_AREA = 0.25  # Of a bevel, as a fraction of its flat region.
MIN_BEVEL_COSINE = 0.6  # Between normals of a bevel and the mean normal of its flat region.
MAX_FLAT_EXCESS = 0.02  # Of symmetric Dirichlet energy of a projected region, with its bevels.
MAX_CREASED_EXCESS = 0.025  # The same of other regions of creased surfaces, which get seams in any case.
MAX_DENSITY_RATIO, MAX_OTHER_AREA = 1.2, 0.1  # A region gets its mean density if others, up to this ratio, cover no more of it.
MIN_CREASE_LENGTH = (
    0.5  # Of the borders of regions, relative to the square root of the area; smooth surfaces are not divided at fewer creases.
)
MIN_REGION_AREA = 0.003  # Regions with a smaller fraction of the area hardly matter.


def divide_at_creases(
    surface: Chart, halfedges: np.ndarray, has_seam: np.ndarray
) -> Steps[tuple[list[tuple[CutChart, np.ndarray]], list[CutChart]]]:
    """Return the flat regions with the uv (V, 2) of each, at the scale of the surface, and the charts of all others.

    Args:
        surface: regions of uneven density are not projected, so that the density can vary inside of them.
        halfedges: (I, 2), 3 t + c, pairs across which triangles are connected.
        has_seam: (T,) bool, triangles at a marked seam; connected components with one are not divided.
    """
    vertices, triangles = surface.vertices, surface.triangles
    total, component = label_components(len(triangles), halfedges)
    is_marked = np.bincount(component, has_seam, total) > 0
    yield Progress(0.0, "Finding creases")
    creases = find_creases(vertices, triangles, halfedges) & ~is_marked[component[halfedges[:, 0] // 3]]
    if surface.polygon_ids is not None:
        creases &= surface.polygon_ids[halfedges[:, 0] // 3] != surface.polygon_ids[halfedges[:, 1] // 3]
    yield Progress(0.0, "Finding creases")
    regions = _absorb_bevels(surface, halfedges, creases)
    regions = divide_at_bevels(surface, halfedges, creases, component, regions)
    yield Progress(0.0, "Finding creases")
    areas, sides = face_areas_and_normals(vertices[triangles])[0], regions[halfedges // 3]
    component_areas, is_border = np.bincount(component, areas, total), sides[:, 0] != sides[:, 1]
    lengths = np.linalg.norm(np.subtract(*vertices[halfedge_ends(triangles, halfedges[:, 0])].transpose(1, 0, 2)), axis=1)
    counts = is_border & (
        np.bincount(regions, areas)[sides].min(axis=1) > MIN_REGION_AREA * component_areas[component[halfedges[:, 0] // 3]]
    )
    border_lengths = np.bincount(component[halfedges[:, 0] // 3], lengths * counts, total)
    is_creased = border_lengths > MIN_CREASE_LENGTH * np.sqrt(component_areas)
    is_border &= is_creased[component[halfedges[:, 0] // 3]]
    flat, curved, done = [], [], 0
    for region, members in split_into_components(surface, halfedges[~is_border]):
        yield Progress(done / len(triangles), "Cutting")
        done += len(members)
        may_be_cut = not is_marked[component[members[0]]]
        is_uniform = _is_uniform(region.density, areas[members])
        uv = _project_flat(region) if may_be_cut and is_uniform else None
        if uv is not None:
            flat.append((CutChart(region, members, may_be_cut), uv))
            continue
        is_small = areas[members].sum() < MIN_REGION_AREA * areas.sum()
        is_limited = is_creased[component[members[0]]] and is_uniform and not is_small
        max_excess = MAX_CREASED_EXCESS if is_limited else MAX_EXCESS
        disks = yield from cut_to_disks(region, may_be_cut)
        curved += [CutChart(disk, members[indices], may_be_cut, max_excess) for disk, indices in disks]
    return flat, curved


def _is_uniform(density: np.ndarray, areas: np.ndarray) -> bool:
    """Return whether the mean of `density` (T,) is right for nearly all of the `areas` (T,)."""
    mean = areas @ density / max(float(areas.sum()), TINY)
    is_other = (density > MAX_DENSITY_RATIO * mean) | (density * MAX_DENSITY_RATIO < mean)
    return bool(areas[is_other].sum() <= MAX_OTHER_AREA * areas.sum())


def _absorb_bevels(surface: Chart, halfedges: np.ndarray, creases: np.ndarray) -> np.ndarray:
    """Return the region (T,) of each triangle, between `creases` (I,) bool; bevels get that of the flat region with the longest border."""
    triangles = surface.triangles
    total, regions = label_components(len(triangles), halfedges[~creases])
    normals = scaled_normals(surface.vertices[triangles])
    areas = np.linalg.norm(normals, axis=1)
    region_areas = np.bincount(regions, areas, total)
    means = normalize(np.stack([np.bincount(regions, axis, total) for axis in normals.T], axis=1))
    is_flat = np.ones(total, bool)
    is_flat[regions[np.einsum("ti,ti->t", normals, means[regions]) < FLAT_COSINE * areas]] = False
    ends = surface.vertices[halfedge_ends(triangles, halfedges[creases, 0])]
    pairs, lengths = regions[halfedges[creases] // 3], np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pairs, lengths = np.concatenate([pairs, pairs[:, ::-1]]), np.concatenate([lengths, lengths])
    is_candidate = is_flat[pairs[:, 0]] & (region_areas[pairs[:, 1]] < MAX_BEVEL_AREA * region_areas[pairs[:, 0]])
    keys, indices = np.unique(pairs[is_candidate].astype(np.int64) @ [total, 1], return_inverse=True)
    borders = np.bincount(indices.ravel(), lengths[is_candidate], len(keys))
    members = np.split(np.argsort(regions, kind="stable"), np.cumsum(np.bincount(regions, minlength=total))[:-1])
    owner, excess = np.arange(total), np.zeros(total)
    for key in keys[np.argsort(-borders, kind="stable")].tolist():
        flat, bevel = divmod(key, total)
        if owner[bevel] != bevel or owner[flat] != flat or excess[bevel] > 0.0:
            continue
        cosines, added = _projection_excess(normals[members[bevel]], means[flat])
        if cosines > MIN_BEVEL_COSINE and excess[flat] + added < MAX_FLAT_EXCESS * region_areas[flat]:
            owner[bevel] = flat
            excess[flat] += added
    return owner[regions]


def _projection_excess(normals: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
    """Return the smallest cosine between `direction` (3,) and `normals` (T, 3), scaled by areas, and the excess of symmetric Dirichlet
    energy, times area, of a projection along `direction`."""
    areas = np.linalg.norm(normals, axis=1)
    has_area = areas > 0.0
    cosines = normals[has_area] @ direction / areas[has_area]
    squares = np.maximum(cosines, 1e-3) ** 2
    return float(cosines.min(initial=1.0)), 0.25 * float(areas[has_area] @ (squares + 1.0 / squares - 2.0))


def _project_flat(chart: Chart) -> np.ndarray | None:
    """Return the uv (V, 2) of a region along its mean normal, without overlaps; None where it is not flat, except for bevels."""
    normals = scaled_normals(chart.vertices[chart.triangles])
    areas = np.linalg.norm(normals, axis=1)
    mean = normalize(normals.sum(axis=0))
    cosine, excess = _projection_excess(normals, mean)
    if not areas.min() > 0.0 or cosine < 0.9 * MIN_BEVEL_COSINE or excess > 1.5 * MAX_FLAT_EXCESS * areas.sum():
        return None
    uv = chart.vertices @ frame_from_normal(mean)[:2].T
    return None if overlaps_itself(uv, chart.triangles) else uv
