"""Texture deviation: known distances between surfaces with equal texture coordinates."""

from dataclasses import replace

import numpy as np
import pytest
from texmesh_deviation import measure_geometric_deviation, measure_texture_deviation

from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.texmesh.refitting.correspondence import (
    UNTEXTURED,
    compute_uv_scale,
    find_correspondence,
    find_textured_islands,
    match_islands,
    sample_surface,
)
from farfield.addon.core.texmesh.simplification.topology import find_islands
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh, build_textured_mesh
from tests.shapes import sheet

COUNT = 4000


def build_sheet(side: int = 6, height=lambda x, y: 0.0 * (x + y), shift: float = 0.0) -> TexturedMesh:
    """Return a sheet whose texture coordinates are x and y, with u moved by `shift`."""
    mesh = sheet(side, height)
    uvs = mesh.vertices[:, :2] + [shift, 0.0]
    return build_textured_mesh(mesh, uvs[mesh.triangles])


def test_a_mesh_does_not_deviate_from_itself():
    mesh = build_sheet(5, lambda x, y: x * y)
    result = measure_texture_deviation(mesh, mesh, COUNT)
    assert result.from_fine.max < 1e-12 and result.from_level.max < 1e-12
    assert result.from_fine.uncovered_fraction == 0.0


def test_distance_along_the_normal_counts_in_space_and_in_texture():
    fine, level = build_sheet(8), build_sheet(2)
    level = replace(level, vertices=level.vertices + [0.0, 0.0, 0.1])
    for measure in (measure_texture_deviation, measure_geometric_deviation):
        result = measure(fine, level, COUNT)
        for side in (result.from_fine, result.from_level):
            assert side.mean == pytest.approx(0.1 / np.sqrt(2.0)) and side.max == pytest.approx(0.1 / np.sqrt(2.0))


def test_a_texture_that_slides_deviates_although_the_surface_does_not():
    shift = 0.05
    fine, level = build_sheet(4), build_sheet(4, shift=shift)
    assert measure_geometric_deviation(fine, level, COUNT).from_fine.max < 1e-12
    result = measure_texture_deviation(fine, level, COUNT).from_fine
    # The strip of u < shift is not covered: its distance is that to the border, where the level begins.
    assert result.uncovered_fraction == pytest.approx(shift, abs=0.01)
    assert result.max == pytest.approx(shift / np.sqrt(2.0), rel=1e-6)
    assert result.mean == pytest.approx((shift - 0.5 * shift**2) / np.sqrt(2.0), rel=0.02)


def test_islands_that_overlap_in_texture_space_are_distinguished():
    near, far = sheet(4), sheet(4)
    both = concatenate([near, TriangleMesh(far.vertices + [0.0, 0.0, 3.0], far.triangles)])
    uvs = both.vertices[:, :2]
    fine = build_textured_mesh(both, uvs[both.triangles])
    assert measure_texture_deviation(fine, fine, COUNT).from_fine.max < 1e-12
    # Without the far island its samples are uncovered, and measured to the nearest texture coordinates that there are.
    level = build_textured_mesh(near, near.vertices[near.triangles, :2])
    result = measure_texture_deviation(fine, level, COUNT).from_fine
    assert result.uncovered_fraction == pytest.approx(0.5, abs=0.01)
    assert result.max == pytest.approx(3.0 / np.sqrt(11.0))


def test_samples_are_uniform_by_area_and_lie_on_their_triangles():
    mesh = build_sheet(3, lambda x, y: 2.0 * x + 0.0 * y)
    samples = sample_surface(mesh, find_islands(mesh), COUNT, np.random.default_rng(1))
    counts = np.bincount(samples.triangles, minlength=len(mesh.triangles))
    assert np.abs(counts - COUNT / len(mesh.triangles)).max() <= 1.0
    assert np.allclose(samples.positions[:, 2], 2.0 * samples.positions[:, 0])
    assert np.allclose(samples.positions[:, :2], samples.uvs)
    assert samples.weights.sum() == pytest.approx(np.sqrt(5.0))
    assert samples.positions[:, :2].mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.01)


def test_corresponding_points_have_the_texture_coordinates_of_the_samples():
    fine, level = build_sheet(7, lambda x, y: np.sin(3.0 * x) + 0.0 * y), build_sheet(3)
    samples = sample_surface(fine, find_islands(fine), COUNT, np.random.default_rng(2))
    islands = match_islands(samples, fine.materials[samples.triangles], level, compute_uv_scale(fine))
    found = find_correspondence(samples, level.vertices[level.triangles], level.corner_uvs, islands)
    uvs = np.einsum("ni,nic->nc", found.barycentric, level.corner_uvs[found.triangles])
    assert found.is_covered.all() and np.allclose(uvs, samples.uvs)


def test_samples_without_texture_correspond_to_the_nearest_points():
    """One sheet has no area in texture space, the other one's texture has moved far away in the level."""
    fine = build_textured_mesh(sheet(4), np.zeros((32, 3, 2)))
    samples = sample_surface(fine, find_textured_islands(fine), COUNT, np.random.default_rng(3))
    assert (samples.islands == UNTEXTURED).all()
    level = replace(fine, vertices=fine.vertices + [0.0, 0.0, 0.1])
    for mesh, moved in ((fine, level), (build_sheet(4), build_sheet(4, shift=7.0))):
        samples = sample_surface(mesh, find_textured_islands(mesh), COUNT, np.random.default_rng(3))
        corners = level.vertices[level.triangles]
        found = find_correspondence(samples, corners, moved.corner_uvs, find_textured_islands(moved))
        points = np.einsum("ni,nic->nc", found.barycentric, corners[found.triangles])
        assert found.is_spatial.mean() > 0.9 and not found.is_covered.any()
        np.testing.assert_allclose((points - samples.positions)[found.is_spatial], [[0.0, 0.0, 0.1]] * found.is_spatial.sum(), atol=1e-12)
