"""Refit levels: less deviation, seams that stay closed, and no flipped triangles."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from texmesh_deviation import make_refit_levels, measure_geometric_deviation, measure_texture_deviation

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.edges import find_edges, halfedge_ends
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.geometry.transforms import signed_areas
from farfield.addon.core.jobs.progress import Progress, run_to_end
from farfield.addon.core.texmesh import level_chain
from farfield.addon.core.texmesh.refitting import refit as refitting
from farfield.addon.core.texmesh.refitting.border_curves import find_border_curves, find_border_halfedges
from farfield.addon.core.texmesh.refitting.comparison import LevelComparison
from farfield.addon.core.texmesh.refitting.correspondence import sample_surface
from farfield.addon.core.texmesh.refitting.edge_flips import flip_edges
from farfield.addon.core.texmesh.refitting.edge_splits import split_edges
from farfield.addon.core.texmesh.refitting.least_squares import Linearization, compute_moments
from farfield.addon.core.texmesh.refitting.level_state import LevelState, attach
from farfield.addon.core.texmesh.refitting.outliers import FineSurface
from farfield.addon.core.texmesh.refitting.refit import refit, sum_costs
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification import levels
from farfield.addon.core.texmesh.simplification.levels import extract_level, simplify_by_cost
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import cylinder, sheet
from textured_levels import checkered, textured_sphere

SIDE = 24
BOUNDARY_TOLERANCE = 1e-6


def build_hill(side: int = SIDE) -> TexturedMesh:
    """Return a wavy sheet of two islands, with a seam at x = 0.5, whose texture coordinates are distorted."""
    mesh = sheet(side, lambda x, y: 0.15 * np.sin(5.0 * x) * np.cos(4.0 * y))
    corners = mesh.vertices[mesh.triangles]
    is_right = corners[:, :, 0].mean(axis=1) > 0.5
    x, y = corners[:, :, 0], corners[:, :, 1]
    uvs = np.stack([x + 0.1 * x * y + 2.0 * is_right[:, None], y + 0.1 * np.sin(3.0 * x)], axis=2)
    return build_textured_mesh(mesh, uvs)


def simplify(fine: TexturedMesh, target: int) -> TexturedMesh:
    simplified = run_to_end(simplify_by_cost(fine, None, [target], TexmeshSettings()))
    return extract_level(fine, simplified.levels[0])


def attach_level(fine: TexturedMesh, level: TexturedMesh, islands: np.ndarray, count: int = 6000) -> LevelState:
    samples = sample_surface(fine, find_islands(fine), count, np.random.default_rng(0))
    return attach(level, islands, samples, 1.0)


@pytest.fixture(scope="module")
def fine() -> TexturedMesh:
    return build_hill()


@pytest.fixture(scope="module")
def level(fine) -> TexturedMesh:
    return simplify(fine, 120)


@pytest.fixture(scope="module")
def refitted(fine, level) -> TexturedMesh:
    return run_to_end(refit(fine, level))


@pytest.mark.slow
def test_both_deviations_get_smaller(fine, level, refitted):
    before, after = (measure_texture_deviation(fine, mesh, 8000) for mesh in (level, refitted))
    assert after.from_fine.mean < 0.7 * before.from_fine.mean and after.from_level.mean < 0.7 * before.from_level.mean
    before, after = (measure_geometric_deviation(fine, mesh, 8000) for mesh in (level, refitted))
    assert after.from_fine.mean < 0.7 * before.from_fine.mean
    assert len(refitted.triangles) == len(level.triangles)


def add_spike(mesh: TexturedMesh, height: float = 0.5) -> TexturedMesh:
    """Return a mesh with one vertex moved outwards."""
    vertices = mesh.vertices.copy()
    vertices[0] += height * np.array([0.3, 0.4, 0.8])
    return replace(mesh, vertices=vertices)


@pytest.mark.slow
def test_a_level_with_a_spike_or_a_texture_that_slides_is_not_chosen(fine, level, refitted):
    comparison = LevelComparison(FineSurface.of(fine))
    assert comparison.choose([refitted, level]) == 0 and comparison.choose([fine, fine, level]) == 0
    assert comparison.choose([add_spike(refitted), add_spike(level, 2.0), level]) == 2
    assert comparison.choose([replace(refitted, uvs=refitted.uvs + [0.0, 0.2]), level]) == 1


@pytest.mark.slow
def test_a_level_that_looks_worse_is_not_chosen(fine, level, refitted):
    comparison = LevelComparison(FineSurface.of(fine))
    assert comparison.choose([refitted, level], np.array([0.03, 0.03])) == 0
    assert comparison.choose([refitted, level], np.array([0.3, 0.03])) == 1


def test_no_point_of_a_level_is_farther_than_its_distance(fine, level, refitted):
    comparison = LevelComparison(FineSurface.of(fine))
    for mesh in (level, refitted, add_spike(refitted)):
        points = sample_surface(mesh, find_islands(mesh), 50_000, np.random.default_rng(5)).positions
        largest = closest_on_mesh(points, fine.vertices[fine.triangles])[0].max()
        assert largest <= comparison.bound_distance(mesh) <= 1.25 * largest


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize("is_spiked", [pytest.param(False, marks=pytest.mark.exhaustive), True])
def test_levels_that_the_refit_made_worse_are_those_of_the_simplification(monkeypatch, is_spiked):
    def refit_starts(*arguments):
        moved = yield from refit_as_usual(*arguments)
        return [add_spike(mesh) if is_spiked else mesh for mesh in moved]

    refit_as_usual = level_chain.refit_starts
    monkeypatch.setattr(level_chain, "refit_starts", refit_starts)
    mesh = textured_sphere(12)
    settings = TexmeshSettings(levels="ratios", ratios="0.4", views=1, max_image=16)
    chain = run_to_end(level_chain.make_levels(mesh, [checkered(16)], settings))
    assert chain.levels[1].is_moved != is_spiked
    assert np.linalg.norm(chain.levels[1].mesh.vertices, axis=1).max() < 1.1


def test_levels_whose_refit_stays_at_its_start_have_all_triangles(monkeypatch, fine):
    def stay(_fine, level, *_others):
        yield Progress(0.0, "Refitting")
        return level

    monkeypatch.setattr(refitting, "refit", stay)
    _, (start,) = run_to_end(refitting.make_starts(fine, None, [200], TexmeshSettings()))
    (level,) = run_to_end(refitting.refit_starts(FineSurface.of(fine), [start]))
    assert len(start.start.triangles) < len(level.triangles) == len(start.full.triangles)


@pytest.mark.slow
@pytest.mark.usefixtures("few_samples")
@pytest.mark.parametrize(("order", "count"), [("visibility", 1), pytest.param("scale", 2, marks=pytest.mark.exhaustive)])
def test_optimized_levels_of_large_meshes_are_simplified_once(monkeypatch, order, count):
    engines = []
    monkeypatch.setattr(level_chain, "MAX_RENDERED", 100)
    make_engine = levels.CollapseEngine
    monkeypatch.setattr(levels, "CollapseEngine", lambda *values, **named: engines.append(make_engine(*values, **named)) or engines[-1])
    settings = TexmeshSettings(levels="ratios", ratios="0.4", views=1, max_image=16, removal_order=order)
    mesh = textured_sphere(6)
    chain = run_to_end(level_chain.make_levels(mesh, [checkered(16)], settings))
    assert len(engines) == count
    assert len(chain.levels) == 2 and len(chain.levels[1].mesh.triangles) <= round(0.4 * len(mesh.triangles))


def test_levels_without_texture_coordinates_are_refitted_in_space():
    sphere = textured_sphere(24)
    fine = build_textured_mesh(TriangleMesh(sphere.vertices, sphere.triangles), np.zeros((len(sphere.triangles), 3, 2)))
    coarse = simplify(fine, 100)
    deviations = [measure_geometric_deviation(fine, mesh, 4000).from_fine.mean for mesh in (coarse, run_to_end(refit(fine, coarse, 100)))]
    assert deviations[1] < 0.6 * deviations[0]


def test_no_triangle_is_flipped_in_texture_space(refitted):
    assert (signed_areas(refitted.corner_uvs) > 0.0).all()


def test_both_sides_of_seams_and_boundaries_stay_on_the_curves_of_the_fine_mesh(fine, refitted):
    curves = find_border_curves(fine, np.zeros(len(fine.triangles), np.int32))
    halfedges, twins = find_border_halfedges(refitted)
    starts = refitted.uvs[halfedge_ends(refitted.wedge_triangles, halfedges)[:, 0]]
    on_border, on_twin = curves.project(starts, np.zeros(len(starts), np.int32))
    assert np.abs(on_border - starts).max() < BOUNDARY_TOLERANCE
    has_twin = twins >= 0
    ends = refitted.uvs[halfedge_ends(refitted.wedge_triangles, twins[has_twin])[:, 1]]
    expected, is_corner = on_twin[has_twin], ~np.isfinite(on_twin[has_twin]).all(axis=1)
    assert has_twin.any() and (np.abs(expected - ends).max(axis=1)[~is_corner] < BOUNDARY_TOLERANCE).all()


def test_topology_stays_that_of_a_disk(refitted):
    edges = find_edges(refitted.triangles)
    assert edges.face_counts.max() == 2
    assert len(refitted.vertices) - len(edges.ends) + len(refitted.triangles) == 1


def test_levels_reach_their_targets(fine):
    targets = [400, 100]
    levels = run_to_end(make_refit_levels(fine, targets, TexmeshSettings(), iterations=6))
    assert [abs(len(level.triangles) - target) <= 2 for level, target in zip(levels, targets, strict=True)] == [True, True]
    for level in levels:
        assert (signed_areas(level.corner_uvs) > 0.0).all()
        assert np.isfinite(level.vertices).all() and level.sources.shape == level.triangles.shape


def test_a_level_without_deviation_stays(fine):
    result = run_to_end(refit(fine, fine, iterations=2))
    assert measure_texture_deviation(fine, result, 4000).from_fine.mean < 1e-6


def test_levels_of_overlapping_islands_stay_separate():
    tube = cylinder(sides=24, cuts=8)
    both = concatenate([tube, type(tube)(tube.vertices + [4.0, 0.0, 0.0], tube.triangles)])
    angles = np.arctan2(tube.vertices[:, 1], tube.vertices[:, 0]) / (2.0 * np.pi)
    uvs = np.tile(np.stack([angles, 0.3 * tube.vertices[:, 2]], axis=1), (2, 1))[both.triangles]
    low = uvs[:, :, 0].max(axis=1, keepdims=True) - uvs[:, :, 0] > 0.5
    uvs[:, :, 0] += low
    mesh = build_textured_mesh(both, uvs)
    levels = run_to_end(make_refit_levels(mesh, [160], TexmeshSettings(), iterations=4))
    assert measure_texture_deviation(mesh, levels[0], 4000).from_fine.max < 0.1


def test_gradient_and_curvature_agree_with_finite_differences(fine):
    coarse = build_hill(4)
    state = attach_level(fine, coarse, find_islands(coarse))
    directions = np.zeros((len(coarse.uvs), 2, 2))
    linearization = Linearization(state, compute_moments(state), directions, 0.0)
    generator = np.random.default_rng(3)
    step = np.zeros((len(coarse.vertices), 5))
    step[:, :3] = generator.normal(size=(len(coarse.vertices), 3))
    derivative = float((linearization.gradient() * step).sum())
    curvature = float((linearization.apply(step) * step).sum())
    size = 1e-3
    cost, moved = state.costs.sum(), state.move(coarse.vertices + size * step[:, :3]).costs.sum()
    assert 0.5 * (moved - cost) == pytest.approx(size * derivative + 0.5 * size**2 * curvature, rel=1e-6)


def test_one_solution_of_positions_is_the_minimum(fine):
    coarse = build_hill(4)
    state = attach_level(fine, coarse, find_islands(coarse))
    directions = np.zeros((len(coarse.uvs), 2, 2))
    for _ in range(8):
        step = Linearization(state, compute_moments(state), directions, 1.0).solve(1.0)
        state = state.move(state.mesh.vertices + step[:, :3])
    cost = state.costs.sum()
    generator = np.random.default_rng(4)
    for _ in range(5):
        other = state.mesh.vertices + 1e-3 * generator.normal(size=state.mesh.vertices.shape)
        assert state.move(other).costs.sum() > cost


def test_flips_lower_the_cost_and_keep_seams(fine):
    coarse = build_hill(6)
    state = attach_level(fine, coarse, find_islands(coarse))
    flipped = flip_edges(state, 5)
    assert flipped.costs.sum() < state.costs.sum()
    seams = [mesh.find_seams(find_edges(mesh.triangles)).sum() for mesh in (coarse, flipped.mesh)]
    assert seams[0] == seams[1] > 0
    points = np.einsum("ni,nic->nc", flipped.found.barycentric, flipped.mesh.corner_uvs[flipped.found.triangles])
    assert np.abs(points - state.samples.uvs)[flipped.found.is_covered].max() < 1e-6


def test_splits_add_two_triangles_each_and_change_no_surface(fine):
    coarse = build_hill(6)
    state = attach_level(fine, coarse, find_islands(coarse))
    split = split_edges(state, 5)
    assert len(split.mesh.triangles) == len(coarse.triangles) + 10
    assert split.costs.sum() == pytest.approx(state.costs.sum())
    assert find_edges(split.mesh.triangles).face_counts.max() == 2
    assert (signed_areas(split.mesh.corner_uvs) > 0.0).all()


def test_a_sample_that_jumps_does_not_decide():
    costs = np.random.default_rng(4).random(5000)
    better = 0.9 * costs
    better[7] = 1000.0 * costs.sum()
    cost, new_cost = sum_costs(SimpleNamespace(costs=costs), SimpleNamespace(costs=better))
    assert cost == pytest.approx(costs.sum()) and new_cost < 0.91 * cost
