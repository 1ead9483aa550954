"""Meshes far from their origin: what they are computed relative to, and what is said about rounding."""

import numpy as np
import pytest

import shapes
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.geometry.precision import choose_local_origin, describe_rounding
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.texmesh.level_chain import make_levels
from farfield.addon.core.texmesh.settings import TexmeshSettings
from farfield.addon.core.texmesh.textured_mesh import build_textured_mesh

UTM = np.array([500_000.0, 4_500_000.0, 120.0])


@pytest.mark.parametrize(
    ("size", "position", "spacing"), [(15.0, UTM, "0.5"), (15.0, 0.2 * UTM, "0.0625"), (1.0, np.array([0.0, 0.0, 1e6]), "0.0625")]
)
def test_visible_rounding_is_said(size, position, spacing):
    mesh = shapes.sphere(12)
    text = describe_rounding("Scan", (size * mesh.vertices + position).astype(np.float32), mesh.triangles)
    assert text.startswith('The vertices of "Scan" are so far from its origin') and f"rounds them to {spacing};" in text


@pytest.mark.parametrize(("size", "position"), [(1.0, np.zeros(3)), (1e-6, np.zeros(3)), (1.0, np.full(3, 100.0)), (1e4, UTM)])
def test_ordinary_meshes_are_not_mentioned(size, position):
    mesh = shapes.sphere(12)
    assert describe_rounding("Scan", (size * mesh.vertices + position).astype(np.float32), mesh.triangles) == ""


def test_origins_are_zero_near_the_origin_and_exact_far_from_it():
    points = np.random.default_rng(0).normal(size=(100, 3)).astype(np.float32)
    assert not choose_local_origin(points + np.float32(500.0)).any()
    assert not choose_local_origin(np.full((2, 3), np.inf, np.float32)).any()
    far = (points.astype(np.float64) + 10.0 * UTM).astype(np.float32)
    origin = choose_local_origin(far)
    assert np.abs(origin - 10.0 * UTM).max() < 5.0
    assert np.array_equal((far - origin) + origin, far)


def test_levels_far_from_the_origin_are_those_near_it():
    mesh = shapes.sphere(10)
    near = np.rint(512.0 * mesh.vertices)  # which single precision stores exactly also far from the origin
    corner_uvs = (0.5 + near[:, :2] / 1100.0)[mesh.triangles]
    settings = TexmeshSettings(vertices="original", views=1, max_image=32, levels="ratios", ratios="0.4")
    levels = []
    for offset in (np.zeros(3), np.array([524_288.0, 4_194_304.0, 0.0])):
        points = (near + offset).astype(np.float32)
        origin = choose_local_origin(points)
        assert origin.any() == offset.any()
        textured = build_textured_mesh(TriangleMesh(points - origin, mesh.triangles), corner_uvs)
        levels.append(run_to_end(make_levels(textured, [], settings)).levels[1].mesh.vertices + origin - offset)
    assert np.array_equal(*levels)
