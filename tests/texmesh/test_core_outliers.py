"""Outliers of refit levels: places far from the fine mesh get nearer to it, and nothing else moves much."""

from dataclasses import replace

import numpy as np
import pytest
from texmesh_deviation import make_refit_levels, measure_geometric_deviation

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.geometry.mesh import TriangleMesh, face_areas_and_normals
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.refitting.correspondence import sample_surface
from farfield.addon.core.texmesh.refitting.level_state import LevelState, attach
from farfield.addon.core.texmesh.refitting.outlier_repair import approach, avoid_folds, flip_outliers, unfold
from farfield.addon.core.texmesh.refitting.outliers import ATTRACTED_FRACTION, FineSurface, gather_points, measure_distances
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import sheet

HEIGHT = 0.3
MAX_PEAK = 8.0  # times the root mean squared distance of a level


def build_sheet(side: int) -> TexturedMesh:
    mesh = sheet(side, lambda x, y: 0.02 * np.sin(6.0 * x) + 0.0 * y)
    return build_textured_mesh(mesh, mesh.vertices[mesh.triangles][:, :, :2])


def build_ball(generator: np.random.Generator, rings: int = 16) -> TexturedMesh:
    """Return a closed, bumpy ball with one seam, whose texture coordinates are longitude and latitude."""
    polar, azimuth = np.meshgrid(np.linspace(0.0, np.pi, rings + 1), np.linspace(0.0, 2.0 * np.pi, 2 * rings + 1), indexing="ij")
    waves = zip((2, 3, 5), generator.uniform(0.0, 6.0, 3), strict=True)
    radii = 1.0 + 0.08 * np.sin(polar) ** 2 * sum(np.sin(order * azimuth + phase) * np.sin(order * polar) for order, phase in waves)
    points = np.stack([radii * np.sin(polar) * np.cos(azimuth), radii * np.sin(polar) * np.sin(azimuth), radii * np.cos(polar)], axis=2)
    points[:, -1] = points[:, 0]
    points[[0, -1]] = points[[0, -1], :1]
    uvs = np.stack([azimuth / (2.0 * np.pi), 1.0 - polar / np.pi], axis=2).reshape(-1, 2)
    columns = 2 * rings + 1
    first = (np.arange(rings)[:, None] * columns + np.arange(columns - 1)).ravel()
    corners = np.concatenate(
        [np.stack([first, first + columns, first + columns + 1], axis=1), np.stack([first, first + columns + 1, first + 1], axis=1)]
    )
    vertices, inverse = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[corners]
    is_proper = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return build_textured_mesh(TriangleMesh(vertices, triangles[is_proper].astype(np.int32)), uvs[corners[is_proper]])


def attach_level(fine: TexturedMesh, level: TexturedMesh) -> tuple[LevelState, FineSurface]:
    samples = sample_surface(fine, find_islands(fine), 4000, np.random.default_rng(0))
    return attach(level, find_islands(level), samples, 1.0), FineSurface(fine, find_islands(fine))


def find_center(level: TexturedMesh) -> int:
    return int(np.abs(level.vertices - [0.5, 0.5, 0.0]).sum(axis=1).argmin())


@pytest.fixture(scope="module")
def fine() -> TexturedMesh:
    return build_sheet(24)


@pytest.fixture
def spiked(fine) -> tuple[LevelState, FineSurface]:
    level = build_sheet(12)
    vertices = level.vertices.copy()
    vertices[find_center(level), 2] += HEIGHT
    return attach_level(fine, replace(level, vertices=vertices))


def test_a_spike_gets_lower(fine, spiked):
    state, surface = spiked
    spike = find_center(build_sheet(12))
    measured = measure_distances(state, surface)
    assert measured.at_vertices.argmax() == spike and measured.at_vertices[spike] > measured.limit
    result = approach(state, surface, measured, 1.0)
    distances, _ = closest_on_mesh(result.mesh.vertices, fine.vertices[fine.triangles])
    assert distances.max() < 0.5 * HEIGHT
    assert result.costs.sum() < state.costs.sum()


def test_a_level_without_outliers_stays(fine):
    state, surface = attach_level(fine, build_sheet(24))
    measured = measure_distances(state, surface)
    assert not len(measured.distances)
    assert approach(state, surface, measured, 1.0) is state and flip_outliers(state, surface, measured) is state


def test_distances_near_the_limit_are_measured_and_others_are_not_above_it(spiked):
    state, surface = spiked
    measured = measure_distances(state, surface)
    for _ in range(2):
        found = np.concatenate([measured.at_vertices, measured.at_edges.ravel()])
        exact = surface.measure_distances(gather_points(state.mesh.vertices, measured.edges))
        is_far = exact > ATTRACTED_FRACTION * measured.limit
        assert is_far.any() and np.allclose(found[is_far], exact[is_far])
        assert (found[~is_far] <= measured.limit).all()
        state = state.move(state.mesh.vertices + np.random.default_rng(1).normal(scale=0.01, size=state.mesh.vertices.shape))
        measured = measure_distances(state, surface, measured)


@pytest.mark.parametrize("seed", range(4))
def test_no_step_makes_the_largest_distance_larger(fine, seed):
    level = build_sheet(12)
    generator = np.random.default_rng(seed)
    offsets = generator.standard_t(1.5, size=(len(level.vertices), 1)) * 0.01
    state, surface = attach_level(fine, replace(level, vertices=level.vertices + np.clip(offsets, -0.2, 0.2) * [0.3, 0.3, 1.0]))
    measured = measure_distances(state, surface)
    for _ in range(4):
        highest = max(measured.at_vertices.max(), measured.at_edges.max(), measured.limit)
        state = approach(state, surface, measured, 1.0)
        measured = measure_distances(state, surface, measured)
        assert max(measured.at_vertices.max(), measured.at_edges.max()) <= highest * (1.0 + 1e-9)


def test_triangles_turn_over_only_toward_the_fine_surface(fine):
    level = build_sheet(12)
    state, surface = attach_level(fine, level)
    folded = level.vertices.copy()
    center = find_center(level)
    folded[center, 0] += 0.3
    assert (avoid_folds(state, folded) == level.vertices).all(axis=1)[center]
    assert (unfold(state, folded, surface) == level.vertices).all(axis=1)[center]
    back = state.move(folded)
    assert (avoid_folds(back, level.vertices) == folded).all(axis=1)[center]
    assert np.array_equal(unfold(back, level.vertices, surface), level.vertices)


def test_positions_and_normals_are_those_with_the_same_texture_coordinates(fine):
    _, surface = attach_level(fine, build_sheet(6))
    generator = np.random.default_rng(5)
    uvs, islands = generator.uniform(0.05, 0.95, (50, 2)), np.zeros(50, np.int32)
    points = surface.find_positions(generator.normal(size=(50, 3)), uvs, islands)
    assert np.allclose(points[:, :2], uvs)
    distances, triangles = surface.find_closest(points)
    assert distances.max() < 1e-9
    _, normals = face_areas_and_normals(fine.vertices[fine.triangles])
    assert np.allclose(surface.find_normals(points, uvs, islands), normals[triangles], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.exhaustive)])
def test_no_place_of_a_level_of_a_closed_mesh_is_much_farther_than_the_others(seed):
    ball = build_ball(np.random.default_rng(seed))
    targets = [len(ball.triangles) // 2, len(ball.triangles) // 8]
    for level in run_to_end(make_refit_levels(ball, targets, TexmeshSettings())):
        deviation = measure_geometric_deviation(ball, level, 20_000)
        for side in (deviation.from_fine, deviation.from_level):
            assert side.max <= MAX_PEAK * side.rms
