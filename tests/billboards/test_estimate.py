"""Estimates: cheap, steady under moving and scaling, within a factor of two of what is then built."""

from itertools import pairwise

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build
from farfield.addon.core.billboards.estimate import estimate, take_sample
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import GeometryError
from farfield.addon.core.mesh import PointCloud, TriangleMesh
from farfield.addon.core.points import splat_radii
from farfield.addon.core.progress import finish


def sphere(rings=40, radius=1.0):
    """A closed sphere of 2 * rings * (rings - 1) * 2 triangles."""
    polar = np.linspace(0.0, np.pi, rings + 1)
    around = np.arange(2 * rings) * np.pi / rings
    vertices = np.array([[np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)] for p in polar for a in around]) * radius
    ring, step = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    right = (step + 1) % (2 * rings)
    a, b, c, d = (2 * rings * ring + step, 2 * rings * (ring + 1) + step, 2 * rings * (ring + 1) + right, 2 * rings * ring + right)
    upper, lower = np.stack([a, b, c], -1)[:-1], np.stack([a, c, d], -1)[1:]
    return TriangleMesh(vertices, np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)]).astype(np.int32))


def leaves(count=1500, seed=3):
    """Small cards at random in a ball."""
    random = np.random.default_rng(seed)
    centers = random.normal(size=(count, 3)) * 0.4
    across, along = random.normal(size=(2, count, 3)) * 0.03
    vertices = np.stack([centers - across, centers + along, centers + across, centers - along], axis=1).reshape(-1, 3)
    corner = 4 * np.arange(count)
    halves = [np.stack([corner, corner + second, corner + third], axis=-1) for second, third in ((1, 2), (2, 3))]
    return TriangleMesh(vertices, np.concatenate(halves).astype(np.int32))


def figures(mesh, **how):
    """Quads and texels of each level."""
    return [(level.quads, level.texels) for level in estimate(take_sample(mesh, "mesh"), BillboardSettings(**how))]


@pytest.mark.parametrize("mesh", [sphere(), leaves()], ids=["sphere", "leaves"])
def test_scaling_and_moving_change_nothing_but_the_error(mesh):
    moved = TriangleMesh(mesh.vertices * 1000.0 + [1e4, 0.0, -1e4], mesh.triangles)
    assert np.allclose(figures(mesh), figures(moved), rtol=0.1, atol=2)  # rounding may draw other faces of equal chance
    errors = [estimate(take_sample(each, "mesh"), BillboardSettings())[0].error for each in (mesh, moved)]
    assert errors[1] == pytest.approx(1000.0 * errors[0])


def test_coarser_levels_take_less():
    levels = figures(sphere(), error=0.005, levels=4)
    for finer, coarser in pairwise(levels):
        assert coarser[0] < finer[0] and coarser[1] < finer[1]


def test_a_plane_is_one_quad_and_its_area_in_texels():
    grid = np.linspace(0.0, 1.0, 30)
    x, y = (values.ravel() for values in np.meshgrid(grid, grid))
    corner = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    triangles = np.concatenate([np.stack([corner, corner + 1, corner + 31], -1), np.stack([corner, corner + 31, corner + 30], -1)])
    plane = TriangleMesh(np.column_stack([x, y, np.zeros(900)]), triangles.astype(np.int32))
    ((quads, texels),) = figures(plane, error=0.01, levels=1)
    assert quads <= 3
    assert 0.5 < texels / (1.0 / 0.005) ** 2 < 2.0


def test_budgets_are_kept():
    sample = take_sample(sphere(), "sphere")
    assert 100 <= estimate(sample, BillboardSettings(quads=200))[0].quads <= 200
    total = sum(level.bytes for level in estimate(sample, BillboardSettings(texture_mb=2.0)))
    assert 1.5e6 <= total <= 2.0e6


@pytest.mark.parametrize("error", [0.01, 0.04])
@pytest.mark.parametrize("mesh", [sphere(rings=24), leaves(count=400)], ids=["sphere", "leaves"])
def test_what_is_built_is_within_a_factor_of_two(mesh, error):
    settings = BillboardSettings(error=error, levels=1)
    (level,) = finish(build(mesh, settings, "mesh")).levels
    (expected,) = estimate(take_sample(mesh, "mesh"), settings)
    assert 0.5 < expected.quads / len(level.quads) < 2.0
    assert 0.5 < expected.texels / level.atlas.texels < 2.0


def test_without_textures_there_are_no_bytes():
    assert [level.bytes for level in estimate(take_sample(sphere(), "s"), BillboardSettings(textures=False))] == [0, 0, 0]


def test_points_are_estimated_like_the_surface_they_lie_on():
    mesh = sphere(rings=60)
    points = mesh.corners.mean(axis=1)
    cloud = PointCloud(points, points / np.linalg.norm(points, axis=1, keepdims=True), splat_radii(points))
    for of_points, of_mesh in zip(figures(cloud), figures(mesh), strict=True):
        assert 0.5 < of_points[0] / of_mesh[0] < 2.0
        assert 0.5 < of_points[1] / of_mesh[1] < 2.0


def test_nothing_cannot_be_estimated():
    with pytest.raises(GeometryError, match="Bare"):
        take_sample(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "Bare")
