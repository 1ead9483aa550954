"""What a UV map is worth: stretch, flips, overlaps, shapes, how much of the square it fills, and where its texels are."""

from dataclasses import dataclass

import numpy as np

from ..mesh import TriangleMesh, face_areas_and_normals
from ..progress import Progress, Steps
from .overlaps import overlap_count
from .plane import signed_areas
from .rest_shapes import rest_shapes
from .shape_barrier import least_ratios
from .stretch_energy import jacobians
from .weights import density_ratio

SPECKS = 1e-9  # of the mean area: triangles with less have no stretch that could be told
PERCENTILES = 95.0, 99.0
QUARTERS = 4


@dataclass(frozen=True)
class Stretches:
    """T triangles in a UV map that is scaled so that it has the area of the surface.

    largest, smallest (T,): how much longer than in the map lengths on the surface are, at most and at least; infinite where the map has no
    area. flipped (T,) bool: which are mirrored in the map, of those that have an area there.
    """

    largest: np.ndarray
    smallest: np.ndarray
    flipped: np.ndarray


@dataclass(frozen=True)
class Measures:
    """A UV map in figures. An isometry has 1 in the stretches and 4 in symmetric_dirichlet.

    l2: geometric stretch (Sander et al. 2001, section 3). linf: the largest. p95, p99: what 95 and 99 % of the surface are below. flips,
    overlaps: of triangles, and of pairs of them. min_shape: least height over base of a triangle in the map. fill: share of the unit
    square. densities: of texels, over their mean, where importance is in the first, second, third and last quarter of its range; 0 where
    nothing is. density_ratio: texels for its area of what matters more than half, over those of what matters less; 0 where there is only
    one.
    """

    l2: float
    linf: float
    p95: float
    p99: float
    symmetric_dirichlet: float
    flips: int
    overlaps: int
    min_shape: float
    fill: float
    densities: tuple[float, ...]
    density_ratio: float


def stretches_of(mesh: TriangleMesh, corners: np.ndarray) -> Steps[Stretches]:
    """Stretch of every triangle of `mesh` in a UV map with `corners` (T, 3, 2)."""
    flat = corners.reshape(-1, 2)
    shapes = rest_shapes(mesh.corners)
    yield Progress(0.0, "Measuring")
    at = jacobians(shapes, np.arange(len(flat)).reshape(-1, 3), flat)
    determinants = at.determinants
    areas, _ = face_areas_and_normals(mesh.corners)
    yield Progress(0.0, "Measuring")
    scale = np.sqrt(areas @ np.abs(determinants) / areas.sum())
    half = np.sqrt(np.maximum(at.squares**2 - 4.0 * determinants**2, 0.0))
    large, small = np.sqrt(0.5 * (at.squares + half)), np.abs(determinants)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Stretches(
            np.where(small > 0.0, scale * large / small, np.inf), np.where(large > 0.0, scale / large, np.inf), determinants < 0.0
        )


def measured(mesh: TriangleMesh, corners: np.ndarray, found: Stretches, importance: np.ndarray) -> Steps[Measures]:
    """All figures of the UV map `corners` (T, 3, 2) of `mesh`, whose stretches were `found`; importance: (T,), 0 to 1."""
    areas, _ = face_areas_and_normals(mesh.corners)
    told = areas > SPECKS * areas.mean()
    weights, largest, smallest = areas[told] / areas[told].sum(), found.largest[told], found.smallest[told]
    squares = largest**2 + smallest**2
    order = np.argsort(largest)
    ranks = 100.0 * np.cumsum(weights[order])
    p95, p99 = (float(largest[order[min(int(np.searchsorted(ranks, level)), len(order) - 1)]]) for level in PERCENTILES)
    with np.errstate(divide="ignore"):
        dirichlet = float(weights @ (squares + 1.0 / largest**2 + 1.0 / smallest**2))
    texels = np.abs(signed_areas(corners))
    yield Progress(0.0, "Measuring")
    overlaps = yield from overlap_count(corners)
    return Measures(
        l2=float(np.sqrt(0.5 * weights @ squares)),
        linf=float(largest.max()),
        p95=p95,
        p99=p99,
        symmetric_dirichlet=dirichlet,
        flips=int(found.flipped.sum()),
        overlaps=overlaps,
        min_shape=float(least_ratios(corners).min()),
        fill=float(texels.sum()),
        densities=_densities(texels, areas, importance),
        density_ratio=density_ratio(texels, areas, importance),
    )


def _densities(texels: np.ndarray, areas: np.ndarray, importance: np.ndarray) -> tuple[float, ...]:
    """`texels` for their `areas` by quarters of importance, (T,) each, over those of all."""
    quarter = np.clip((QUARTERS * importance).astype(int), 0, QUARTERS - 1)
    there, has = (np.bincount(quarter, each, QUARTERS) for each in (areas, texels))
    return tuple((np.divide(has, there, out=np.zeros(QUARTERS), where=there > 0.0) * areas.sum() / texels.sum()).tolist())
