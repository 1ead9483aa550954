"""Spikes of refit levels: vertices and edges far from the fine mesh go back to it, and nothing else moves."""

from dataclasses import replace

import numpy as np
import pytest

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.texmesh.refitting.level_state import attach
from farfield.addon.core.texmesh.refitting.sampling import sample_surface
from farfield.addon.core.texmesh.refitting.spikes import FineSurface, remove_spikes
from farfield.addon.core.texmesh.simplification.islands import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import sheet

HEIGHT = 0.3


def build_sheet(side: int) -> TexturedMesh:
    mesh = sheet(side, lambda x, y: 0.02 * np.sin(6.0 * x) + 0.0 * y)
    return build_textured_mesh(mesh, mesh.vertices[mesh.triangles][:, :, :2])


@pytest.fixture(scope="module")
def fine() -> TexturedMesh:
    return build_sheet(24)


def attach_level(fine: TexturedMesh, level: TexturedMesh):
    samples = sample_surface(fine, find_islands(fine), 4000, np.random.default_rng(0))
    return attach(level, find_islands(level), samples, 1.0), FineSurface(fine, find_islands(fine))


def test_a_spike_gets_lower_and_other_vertices_stay(fine):
    level = build_sheet(12)
    spike = int(np.abs(level.vertices - [0.5, 0.5, 0.0]).sum(axis=1).argmin())
    vertices = level.vertices.copy()
    vertices[spike, 2] += HEIGHT
    state, surface = attach_level(fine, replace(level, vertices=vertices))
    result = remove_spikes(state, surface)
    moved = (result.mesh.vertices != vertices).any(axis=1)
    assert np.flatnonzero(moved).tolist() == [spike]
    distances, _ = closest_on_mesh(result.mesh.vertices, fine.vertices[fine.triangles])
    assert distances.max() < 0.5 * HEIGHT
    assert result.costs.sum() < state.costs.sum()


def test_a_level_without_spikes_stays(fine):
    level = build_sheet(12)
    state, surface = attach_level(fine, level)
    assert np.array_equal(remove_spikes(state, surface).mesh.vertices, level.vertices)


def test_positions_are_those_with_the_same_texture_coordinates(fine):
    _, surface = attach_level(fine, build_sheet(6))
    generator = np.random.default_rng(5)
    uvs = generator.uniform(0.05, 0.95, (50, 2))
    points = surface.find_positions(generator.normal(size=(50, 3)), uvs, np.zeros(50, np.int32))
    assert np.allclose(points[:, :2], uvs)
    assert surface.measure_distances(points).max() < 1e-9
