"""Refit levels: positions and texture coordinates that minimize the deviation from the fine mesh."""

from dataclasses import dataclass

import numpy as np

from ...jobs.progress import Progress, Steps
from ..textured_mesh import TexturedMesh
from .border_curves import find_border_curves, find_freedom
from .correspondence import compute_uv_scale, match_islands
from .edge_flips import flip_edges
from .least_squares import Linearization, compute_moments
from .level_state import attach
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
    curves = find_border_curves(fine, find_islands(fine))
    damping = 0.1
    cost = state.compute_costs().sum()
    for index in range(settings.iterations):
        yield Progress(index / settings.iterations, "Refitting")
        state = flip_edges(state, 2)
        cost = state.compute_costs().sum()
        freedom = find_freedom(state, uv_scale)
        directions = freedom.directions
        step = Linearization(state, compute_moments(state), directions, damping).solve(uv_scale)
        uvs, fraction = move_uvs(state, step, freedom, curves)
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


MIN_AREA_FRACTION = 0.15
MAX_PARTNER_STEP = 4.0  # times the expected step, of the other side of a seam


def move_uvs(state, step, freedom, curves):
    mesh = state.mesh
    moves = np.einsum("wij,wj->wi", freedom.directions, step[mesh.wedge_vertices, 3:])
    before = _areas(mesh.corner_uvs)
    fraction = np.ones(len(mesh.vertices))
    sliding, partners = freedom.sliding, freedom.partners
    for _ in range(12):
        uvs = mesh.uvs + moves * fraction[mesh.wedge_vertices, None]
        if len(sliding):
            is_moving = fraction[mesh.wedge_vertices[sliding]] > 0.0
            rows, others = sliding[is_moving], partners[is_moving]
            on_border, on_twin = curves.project(uvs[rows], freedom.islands[is_moving])
            paired = others >= 0
            is_bad = paired & (~np.isfinite(on_twin).all(axis=1))
            gap = np.linalg.norm(on_twin[paired] - mesh.uvs[others[paired]], axis=1)
            is_bad[paired] |= ~(
                gap
                <= MAX_PARTNER_STEP * np.linalg.norm(moves[others[paired]], axis=1) * fraction[mesh.wedge_vertices[others[paired]]] + 1e-9
            )
            uvs[rows] = on_border
            uvs[others[paired]] = on_twin[paired]
            bad = rows[is_bad]
            fraction[mesh.wedge_vertices[bad]] = 0.0
            uvs[bad] = mesh.uvs[bad]
            bad = others[is_bad]
            uvs[bad] = mesh.uvs[bad]
            still = ~is_moving
            uvs[sliding[still]] = mesh.uvs[sliding[still]]
        after = _areas(uvs[mesh.wedge_triangles])
        is_flipped = after * np.sign(before) < MIN_AREA_FRACTION * np.abs(before)
        if not is_flipped.any():
            return uvs, fraction
        corners = mesh.triangles[is_flipped]
        fraction[corners] = np.where(fraction[corners] > 0.01, fraction[corners] * 0.5, 0.0)
    return mesh.uvs, np.zeros(len(mesh.vertices))


def _areas(uvs):
    a, b = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
