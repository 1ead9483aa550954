"""Descents along a surface to the point that is nearest to another point."""

import numpy as np

from farfield.addon.core.geometry.distance import closest_on_mesh
from farfield.addon.core.texmesh.surface_descent import SurfaceDescent
from textured_models import plane


def test_a_descent_ends_at_the_nearest_point():
    x, y = np.meshgrid(np.arange(13.0), np.arange(13.0), indexing="ij")
    mesh = plane(12, 12, 0.01 * x * x + 0.05 * y)
    descent = SurfaceDescent(mesh.vertices, mesh.triangles)
    generator = np.random.default_rng(2)
    points = generator.uniform([1.0, 1.0, 1.0], [11.0, 11.0, 2.0], (200, 3))
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    triangles, barycentric = descent.find_nearest(points, up, generator.integers(0, len(mesh.triangles), len(points)))
    corners = mesh.vertices[mesh.triangles]
    found = np.einsum("ni,nic->nc", barycentric, corners[triangles])
    np.testing.assert_allclose(np.linalg.norm(found - points, axis=1), closest_on_mesh(points, corners)[0], atol=2e-3)
    triangles, _ = descent.find_nearest(points, -up, np.zeros(len(points), np.int64))
    assert (triangles == 0).all(), "no triangle faces that side"
