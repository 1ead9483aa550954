"""Refit levels: positions and texture coordinates that minimize the deviation from the fine mesh."""

from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Progress, Steps
from ..textured_mesh import TexturedMesh
from .correspondence import compute_uv_scale, match_islands
from .edge_flips import flip_edges
from .least_squares import Linearization, compute_moments
from .level_state import LevelState, attach
from .sampling import find_islands, sample_surface


@dataclass(frozen=True)
class RefitSettings:
    samples_per_triangle: int = 12
    min_samples: int = 40_000
    iterations: int = 12
    normal_weight: float = 4.0


def refit(fine: TexturedMesh, level: TexturedMesh, settings: RefitSettings) -> Steps[TexturedMesh]:
    state = yield from _prepare(fine, level, settings)
    uv_scale = compute_uv_scale(fine)
    damping = 0.1
    cost = state.compute_costs().sum()
    for index in range(settings.iterations):
        yield Progress(index / settings.iterations, "Refitting")
        state = flip_edges(state, 2)
        cost = state.compute_costs().sum()
        directions = find_directions(state)
        step = Linearization(state, compute_moments(state), directions, damping).solve(uv_scale)
        uvs, fraction = move_uvs(state, step, directions)
        moved = state.move(state.mesh.vertices + step[:, :3] * fraction[:, None], uvs)
        fixed = Linearization(moved, compute_moments(moved), np.zeros_like(directions), damping).solve(uv_scale)
        moved = moved.move(moved.mesh.vertices + fixed[:, :3])
        new = moved.compute_costs().sum()
        if new < cost:
            if new > 0.995 * cost:
                state = moved
                break
            state, cost, damping = moved, new, max(damping * 0.5, 1e-3)
        else:
            damping *= 8.0
    return state.mesh


def _prepare(fine, level, settings):
    generator = np.random.default_rng(0)
    count = max(settings.samples_per_triangle * len(level.triangles), settings.min_samples)
    fine_islands = find_islands(fine)
    samples = sample_surface(fine, fine_islands, count, generator)
    yield Progress(0.0, "Refitting")
    islands = match_islands(samples, fine.materials[samples.triangles], level, compute_uv_scale(fine))
    return attach(level, islands, samples, settings.normal_weight)


def find_directions(state: LevelState) -> np.ndarray:
    mesh = state.mesh
    edges = state.find_edges()
    fixed = edges.boundary_vertices.copy()
    fixed[edges.ends[mesh.find_seams(edges)]] = True
    counts = np.bincount(mesh.wedge_vertices, minlength=len(mesh.vertices))
    fixed |= counts != 1
    return np.where(fixed[mesh.wedge_vertices][:, None, None], 0.0, np.eye(2))


MIN_AREA_FRACTION = 0.15


def move_uvs(state: LevelState, step: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mesh = state.mesh
    moves = np.einsum("wij,wj->wi", directions, step[mesh.wedge_vertices, 3:])
    before = _areas(mesh.corner_uvs)
    fraction = np.ones(len(mesh.vertices))
    for _ in range(12):
        uvs = mesh.uvs + moves * fraction[mesh.wedge_vertices, None]
        after = _areas(uvs[mesh.wedge_triangles])
        bad = after * np.sign(before) < MIN_AREA_FRACTION * np.abs(before)
        if not bad.any():
            return uvs, fraction
        fraction[mesh.triangles[bad]] *= 0.5
    fraction[:] = 0.0
    return mesh.uvs, fraction


def _areas(uvs):
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
