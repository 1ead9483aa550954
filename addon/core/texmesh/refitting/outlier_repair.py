"""Repair of outliers of a level: flips of edges, and moves of vertices that bring the farthest places nearer to the fine mesh.

Vertices stay where moves would turn triangles over.
"""

from dataclasses import dataclass

import numpy as np

from ...arrays import find_last_positions
from ...geometry.mesh import face_areas_and_normals, scaled_normals
from .correspondence import Correspondence, SurfaceSamples
from .edge_flips import find_quads, flip_quads, select_flips
from .least_squares import Linearization, compute_moments
from .level_state import LevelState
from .outliers import EDGE_FRACTIONS, FineSurface, LevelDistances, gather_some_points


@dataclass(frozen=True)
class Tuning:
    """Numbers of the method."""

    # Weight of an outlier at the limit, relative to all samples of a triangle; it grows with the fourth power of the distance.
    attraction: float = 0.5
    max_attraction: float = 30.0
    max_flipped_fraction: float = 0.7  # A flipped edge has at most this fraction of the distance of the edge.
    max_withdrawals: int = 6
    halvings: int = 2  # Withdrawals that leave a part of a step, before the others leave nothing.
    withdrawn_fraction: float = 0.5
    accepted_fraction: float = 0.8  # A point may get farther, up to this fraction of the largest distance nearby, while that is lowered.
    peak_rings: int = 2
    max_rounds: int = 6  # Rounds in which vertices stay because of those that stayed before.


TUNING = Tuning()


def flip_outliers(state: LevelState, surface: FineSurface, measured: LevelDistances) -> LevelState:
    """Return the level with outlying edges flipped where the flipped edge is much nearer to the fine mesh."""
    peaks = measured.peaks
    quads = find_quads(state, peaks > measured.limit)
    if not len(quads.triangles):
        return state
    peaks = peaks[measured.edges.between(quads.vertices[:, 1], quads.vertices[:, 3])]
    first, second = (state.mesh.vertices[quads.vertices[:, corner]] for corner in (0, 2))
    points = first[:, None] + EDGE_FRACTIONS[:, None] * (second - first)[:, None]
    after = surface.measure_distances(points.reshape(-1, 3)).reshape(-1, len(EDGE_FRACTIONS)).max(axis=1)
    gains = np.where(after < TUNING.max_flipped_fraction * peaks, peaks - after, 0.0)
    return flip_quads(state, quads, select_flips(state, quads, gains))


def approach(state: LevelState, surface: FineSurface, measured: LevelDistances, uv_scale: float) -> LevelState:
    """Return the level after a step of positions in which outliers count more. No vertex moves that would make an outlier.

    measured: of `state`. uv_scale: length of a unit of UV space on the surface.
    """
    if not len(measured.distances):
        return state
    attracted = _attract(state, measured)
    step = Linearization(attracted, compute_moments(attracted), None, 0.0).solve(uv_scale)
    vertices = unfold(state, state.mesh.vertices + step, surface)
    return state.move(_withdraw(state, vertices, surface, measured))


def pull_back(state: LevelState, surface: FineSurface, measured: LevelDistances) -> LevelState:
    """Return the level with outlying vertices, and ends of outlying edges, where the fine mesh has their texture coordinates, as far as
    that makes no other outlier.

    measured: of `state`.
    """
    mesh = state.mesh
    is_far = measured.at_vertices > measured.limit
    is_far[measured.edges.ends[(measured.at_edges > measured.limit).any(axis=1)]] = True
    corners = find_last_positions(mesh.triangles.ravel(), len(mesh.vertices))
    far = np.flatnonzero(is_far)
    if not len(far):
        return state
    vertices = mesh.vertices.copy()
    uvs = mesh.uvs[mesh.wedge_triangles.ravel()[corners[far]]]
    vertices[far] = surface.find_positions(mesh.vertices[far], uvs, state.islands[corners[far] // 3])
    return state.move(_withdraw(state, unfold(state, vertices, surface), surface, measured))


def _attract(state: LevelState, measured: LevelDistances) -> LevelState:
    """Return the level with samples added that attract the outliers."""
    count = len(measured.distances)
    areas, _ = state.areas_and_normals
    size = np.maximum(areas[measured.triangles], areas.mean())
    weights = size * np.minimum(TUNING.attraction * (measured.distances / measured.limit) ** 4, TUNING.max_attraction)
    samples, found = state.samples, state.found
    blank = np.zeros(count)
    added = (blank, measured.barycentric, measured.targets, np.zeros((count, 2)), blank, weights)
    values = (samples.triangles, samples.barycentric, samples.positions, samples.uvs, samples.islands, samples.weights)
    joined = SurfaceSamples(*(np.concatenate([value, extra]) for value, extra in zip(values, added, strict=True)))
    return LevelState(
        state.mesh,
        state.islands,
        joined,
        Correspondence(
            np.concatenate([found.triangles, measured.triangles]),
            np.concatenate([found.barycentric, measured.barycentric]),
            np.concatenate([found.is_covered, np.ones(count, bool)]),
            np.concatenate([found.is_spatial, np.ones(count, bool)]),
        ),
        state.normal_weight,
    )


def _withdraw(state: LevelState, vertices: np.ndarray, surface: FineSurface, measured: LevelDistances) -> np.ndarray:
    """Return `vertices` (V, 3), but those stay where they are in `state` that would make an outlier, unless a larger one next to it
    gets smaller."""
    ends, result = measured.edges.ends, vertices.copy()
    before = np.concatenate([measured.at_vertices, measured.at_edges.ravel()])
    peaks = _find_peaks_around(measured)
    around = np.concatenate([peaks, np.repeat(peaks[ends].min(axis=1), len(EDGE_FRACTIONS))])
    allowed = np.maximum(np.maximum(before, measured.limit), TUNING.accepted_fraction * around)
    has_changed = np.ones(len(vertices), bool)
    _, planes = _measure_planes(state, state.mesh.vertices, has_changed)
    corner_peaks = peaks[state.mesh.triangles].min(axis=1)[state.found.triangles]
    allowed_planes = np.maximum(np.maximum(planes, measured.limit), TUNING.accepted_fraction * corner_peaks)
    for attempt in range(TUNING.max_withdrawals):
        moves = np.linalg.norm(result - state.mesh.vertices, axis=1)
        bounds = before + np.concatenate([moves, np.repeat(moves[ends].max(axis=1), len(EDGE_FRACTIONS))])
        is_open = np.concatenate([has_changed, np.repeat(has_changed[ends].any(axis=1), len(EDGE_FRACTIONS))])
        rows = np.flatnonzero((bounds > allowed) & (bounds > before) & is_open)
        points = gather_some_points(result, measured.edges, rows)
        worse = rows[surface.measure_distances(points, allowed[rows]) > allowed[rows]]
        is_vertex = worse < len(vertices)
        samples, distances = _measure_planes(state, result, has_changed)
        missed = samples[distances > allowed_planes[samples]]
        missing = np.unique(state.found.triangles[missed])
        at_edges = ends[(worse[~is_vertex] - len(vertices)) // len(EDGE_FRACTIONS)]
        stays = np.unique(np.concatenate([worse[is_vertex], at_edges.ravel(), state.mesh.triangles[missing].ravel()]))
        stays = stays[moves[stays] > 0.0]
        if not len(stays):
            break
        fraction = TUNING.withdrawn_fraction if attempt < TUNING.halvings else 0.0
        result[stays] = state.mesh.vertices[stays] + fraction * (result[stays] - state.mesh.vertices[stays])
        has_changed[:] = False
        has_changed[stays] = True
    return result


def _find_peaks_around(measured: LevelDistances) -> np.ndarray:
    """Return the largest distances (V,) around the vertices."""
    ends, peaks = measured.edges.ends, measured.at_vertices.copy()
    for _ in range(TUNING.peak_rings):
        highest = np.maximum(measured.peaks, peaks[ends].max(axis=1))
        np.maximum.at(peaks, ends.ravel(), np.repeat(highest, 2))
    return peaks


def _measure_planes(state: LevelState, vertices: np.ndarray, is_used: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples (N,) of triangles with vertices that `is_used` (V,) bool, and their distances (N,) from the planes of these
    triangles if the vertices are at `vertices` (V, 3)."""
    first, second, third = state.mesh.triangles.T
    used = np.flatnonzero(is_used[first] | is_used[second] | is_used[third])
    rows = np.full(len(state.islands), -1)
    rows[used] = np.arange(len(used))
    rows = rows[state.found.triangles]
    samples = np.flatnonzero(rows >= 0)
    rows = rows[samples]
    corners = vertices[state.mesh.triangles[used]]
    _, normals = face_areas_and_normals(corners)
    offsets = np.einsum("ti,ti->t", normals, corners[:, 0])
    return samples, np.abs(np.einsum("ni,ni->n", normals[rows], state.samples.positions[samples]) - offsets[rows])


def avoid_folds(state: LevelState, vertices: np.ndarray) -> np.ndarray:
    """Return `vertices` (V, 3), but those of triangles that would turn over stay where they are in `state`."""
    before = scaled_normals(state.corners)
    is_folded = np.einsum("ti,ti->t", before, scaled_normals(vertices[state.mesh.triangles])) < 0.0
    result = vertices.copy()
    stays = state.mesh.triangles[is_folded]
    result[stays] = state.mesh.vertices[stays]
    return result


def unfold(state: LevelState, vertices: np.ndarray, surface: FineSurface) -> np.ndarray:
    """Return `vertices` (V, 3), but those of triangles stay that would turn away from the fine surface, or would turn over without turning
    toward it."""
    mesh, result = state.mesh, vertices.copy()
    before = scaled_normals(state.corners)
    for _ in range(TUNING.max_rounds):
        after = scaled_normals(result[mesh.triangles])
        rows = np.flatnonzero(np.einsum("ti,ti->t", before, after) < 0.0)
        if not len(rows):
            break
        normals = surface.find_normals(state.corners[rows].mean(axis=1), mesh.corner_uvs[rows].mean(axis=1), state.islands[rows])
        stays = mesh.triangles[rows[np.einsum("ti,ti->t", normals, after[rows]) < 0.0]]
        if not len(stays):
            break
        result[stays] = mesh.vertices[stays]
    return result
