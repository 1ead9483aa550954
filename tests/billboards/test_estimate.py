"""Tests of the estimates: invariant under translation and scaling, and within a factor of two of the result."""

from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.estimate import estimate_levels, sample_geometry
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.geometry.mesh import PointCloud, TriangleMesh
from farfield.addon.core.geometry.points import splat_radii
from farfield.addon.core.jobs.progress import run_to_end


def sphere(rings=24, radius=1.0):
    """Return a closed sphere of 2 * rings * (rings - 1) * 2 triangles."""
    polar = np.linspace(0.0, np.pi, rings + 1)
    azimuth = np.arange(2 * rings) * np.pi / rings
    vertices = np.array([[np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)] for p in polar for a in azimuth]) * radius
    ring, step = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    right = (step + 1) % (2 * rings)
    a, b, c, d = (2 * rings * ring + step, 2 * rings * (ring + 1) + step, 2 * rings * (ring + 1) + right, 2 * rings * ring + right)
    upper, lower = np.stack([a, b, c], -1)[:-1], np.stack([a, c, d], -1)[1:]
    return TriangleMesh(vertices, np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)]).astype(np.int32))


def leaves(count=1500, seed=3):
    """Return small rhombi at random positions in a ball."""
    random = np.random.default_rng(seed)
    centers = random.normal(size=(count, 3)) * 0.4
    first, second = random.normal(size=(2, count, 3)) * 0.03
    vertices = np.stack([centers - first, centers + second, centers + first, centers - second], axis=1).reshape(-1, 3)
    corner = 4 * np.arange(count)
    halves = [np.stack([corner, corner + b, corner + c], axis=-1) for b, c in ((1, 2), (2, 3))]
    return TriangleMesh(vertices, np.concatenate(halves).astype(np.int32))


def estimate_sizes(mesh, **settings):
    """Return the estimated quads and texels of each level."""
    return [(level.quads, level.texels) for level in estimate_levels(sample_geometry(mesh, "mesh"), BillboardSettings(**settings))]


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [sphere(), leaves()], ids=["sphere", "leaves"])
def test_scaling_and_translation_change_only_the_error(mesh):
    moved = TriangleMesh(mesh.vertices * 1000.0 + [1e4, 0.0, -1e4], mesh.triangles)
    assert np.allclose(estimate_sizes(mesh), estimate_sizes(moved), rtol=0.1, atol=2)  # rounding may change which faces are drawn
    errors = [estimate_levels(sample_geometry(each, "mesh"), BillboardSettings())[0].error for each in (mesh, moved)]
    assert errors[1] == pytest.approx(1000.0 * errors[0])


def test_coarser_levels_are_smaller():
    levels = estimate_sizes(sphere(), error=0.005, levels=4)
    for finer, coarser in pairwise(levels):
        assert coarser[0] < finer[0] and coarser[1] < finer[1]


def test_plane_is_one_quad_with_its_area_in_texels():
    grid = np.linspace(0.0, 1.0, 30)
    x, y = (values.ravel() for values in np.meshgrid(grid, grid))
    corner = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    triangles = np.concatenate([np.stack([corner, corner + 1, corner + 31], -1), np.stack([corner, corner + 31, corner + 30], -1)])
    plane = TriangleMesh(np.column_stack([x, y, np.zeros(900)]), triangles.astype(np.int32))
    ((quads, texels),) = estimate_sizes(plane, error=0.01, levels=1)
    assert quads <= 3
    assert 0.5 < texels / (1.0 / 0.005) ** 2 < 2.0


@pytest.mark.slow
def test_budgets_are_kept():
    sample = sample_geometry(sphere(), "sphere")
    assert 100 <= estimate_levels(sample, BillboardSettings(quads=200))[0].quads <= 200
    total = sum(level.bytes for level in estimate_levels(sample, BillboardSettings(texture_mb=2.0)))
    assert 1.5e6 <= total <= 2.0e6


@pytest.mark.slow
@pytest.mark.parametrize("error", [pytest.param(0.01, marks=pytest.mark.exhaustive), 0.04])
@pytest.mark.parametrize("mesh", [sphere(rings=16), leaves(count=200)], ids=["sphere", "leaves"])
def test_result_is_within_a_factor_of_two(mesh, error):
    settings = BillboardSettings(error=error, levels=1, solid_parts="quads")
    (level,) = run_to_end(build_cloud(mesh, settings, "mesh")).levels
    (expected,) = estimate_levels(sample_geometry(mesh, "mesh"), settings)
    assert 0.5 < expected.quads / len(level.quads) < 2.0
    assert 0.5 < expected.texels / level.atlas.texel_count < 2.0


def test_clouds_without_textures_have_no_bytes():
    assert [level.bytes for level in estimate_levels(sample_geometry(sphere(), "s"), BillboardSettings(textures=False))] == [0, 0, 0]


def test_points_are_estimated_like_their_surface():
    mesh = sphere(rings=60)
    points = mesh.corners.mean(axis=1)
    cloud = PointCloud(points, points / np.linalg.norm(points, axis=1, keepdims=True), splat_radii(points))
    for point_level, mesh_level in zip(estimate_sizes(cloud), estimate_sizes(mesh), strict=True):
        assert 0.5 < point_level[0] / mesh_level[0] < 2.0
        assert 0.5 < point_level[1] / mesh_level[1] < 2.0


def test_rejects_empty_mesh():
    with pytest.raises(GeometryError, match="Bare"):
        sample_geometry(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "Bare")
