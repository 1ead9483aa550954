"""Levels that deviate least from a fine mesh, and how far a level deviates: in space, and between equal texture coordinates."""

from dataclasses import dataclass

import numpy as np

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.jobs.progress import Steps, subprogress
from farfield.addon.core.texmesh import TexmeshSettings
from farfield.addon.core.texmesh.refitting.correspondence import (
    SurfaceSamples,
    compute_uv_scale,
    find_correspondence,
    match_islands,
    sample_surface,
)
from farfield.addon.core.texmesh.refitting.outliers import FineSurface
from farfield.addon.core.texmesh.refitting.refit import TUNING, make_starts, refit_starts
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

DEFAULT_SAMPLES = 100_000
MIN_LABEL_SAMPLES = 20_000  # that tell which island a triangle of a level belongs to


@dataclass(frozen=True)
class Deviation:
    """Distances as fractions of the diagonal of the fine mesh's bounding box.

    mean, rms, max: of the distances between points. uncovered_fraction: of the area whose texture coordinates the other mesh does not
    have in the same UV island; the distance counts to its point with the nearest ones there. 0 for distances in space.
    """

    mean: float
    rms: float
    max: float
    uncovered_fraction: float


@dataclass(frozen=True)
class SymmetricDeviation:
    """Deviations of the level from points of the fine mesh, and of the fine mesh from points of the level."""

    from_fine: Deviation
    from_level: Deviation


def measure_texture_deviation(fine: TexturedMesh, level: TexturedMesh, count: int = DEFAULT_SAMPLES, seed: int = 0) -> SymmetricDeviation:
    """Measure the distances in space between points of `fine` and `level` with equal texture coordinates.

    The points are uniform on the surface of the first mesh, `count` of them. Only points of the same UV island count, so that islands may
    overlap; where an island overlaps itself, the nearest point in space counts. Texture deviation of Cohen, Olano and Manocha,
    "Appearance-Preserving Simplification", 1998, section 4.
    """
    generator = np.random.default_rng(seed)
    fine_islands = find_islands(fine)
    samples = sample_surface(fine, fine_islands, max(count, MIN_LABEL_SAMPLES, 4 * len(fine.triangles)), generator)
    level_islands = match_islands(samples, fine.materials[samples.triangles], level, compute_uv_scale(fine))
    diagonal = _diagonal(fine)
    from_fine = _measure_one_side(sample_surface(fine, fine_islands, count, generator), level, level_islands, diagonal)
    from_level = _measure_one_side(sample_surface(level, level_islands, count, generator), fine, fine_islands, diagonal)
    return SymmetricDeviation(from_fine, from_level)


def measure_geometric_deviation(fine: TexturedMesh, level: TexturedMesh, count: int = DEFAULT_SAMPLES, seed: int = 0) -> SymmetricDeviation:
    """Measure the distances from points of each mesh, uniform on its surface, to the nearest point of the other one."""
    generator = np.random.default_rng(seed)
    results = []
    for source, target in ((fine, level), (level, fine)):
        samples = sample_surface(source, np.zeros(len(source.triangles), np.int32), count, generator)
        distances, _ = closest_on_mesh(samples.positions, target.vertices[target.triangles])
        results.append(_summarize(distances / _diagonal(fine), 0.0))
    return SymmetricDeviation(*results)


def _measure_one_side(samples: SurfaceSamples, other: TexturedMesh, islands: np.ndarray, diagonal: float) -> Deviation:
    corners = other.vertices[other.triangles]
    found = find_correspondence(samples, corners, other.corner_uvs, islands)
    points = np.einsum("ni,nic->nc", found.barycentric, corners[found.triangles])
    distances = np.linalg.norm(points - samples.positions, axis=1) / diagonal
    return _summarize(distances, float((~found.is_covered).mean()))


def _summarize(distances: np.ndarray, uncovered_fraction: float) -> Deviation:
    return Deviation(float(distances.mean()), float(np.sqrt((distances**2).mean())), float(distances.max()), uncovered_fraction)


def _diagonal(mesh: TexturedMesh) -> float:
    return float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))


def make_refit_levels(
    fine: TexturedMesh, targets: list[int], settings: TexmeshSettings, iterations: int = TUNING.iterations
) -> Steps[list[TexturedMesh]]:
    """Make a level of `fine` for each of the `targets`, triangle counts that descend, with the smallest deviation found.

    Levels start as subset levels by `DeviationQuadrics`, a little below their target, are refitted, and gain triangles where they deviate
    most. A level has more triangles than its target only where the constraints of the simplification stop it.

    Raises:
        SettingsError: the targets do not descend or are not positive.
    """
    _, starts = yield from subprogress(make_starts(fine, None, targets, settings), 0.0, TUNING.simplification_fraction)
    return (yield from subprogress(refit_starts(FineSurface.of(fine), starts, iterations), TUNING.simplification_fraction, 1.0))
