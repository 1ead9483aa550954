"""Tests of normals at a scale: what is smaller than it does not change them, and distances stay exact."""

import numpy as np
import pytest

from farfield.addon.core.billboards.build import build_cloud
from farfield.addon.core.billboards.primitives import from_mesh
from farfield.addon.core.billboards.scale_normals import MIN_SAMPLE_LIMIT, _sample, normals_at_scale
from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.geometry.mesh import TriangleMesh, concatenate
from farfield.addon.core.jobs.progress import run_to_end
from shapes import box, random_rotation, soup, sphere

UP = np.array([0.0, 0.0, 1.0])


def plate(thickness=0.01, cuts=1):
    return box((1.0, 1.0, thickness), cuts)


def studded_plate(size=0.02):
    """Return a plate of two triangles a side with four small boxes on it, and which triangles are those of the boxes."""
    base = box((1.0, 1.0, 0.2), 1)
    studs = [box((size, size, size), 1) for _ in range(4)]
    moved = [
        TriangleMesh(stud.vertices + [x, y, 0.1 + 0.5 * size], stud.triangles)
        for stud, (x, y) in zip(studs, [(-0.3, -0.2), (0.3, -0.25), (0.2, 0.3), (-0.25, 0.2)], strict=True)
    ]
    mesh = concatenate([base, *moved])
    return mesh, np.arange(len(mesh.triangles)) >= len(base.triangles)


def build(mesh, **settings):
    return run_to_end(build_cloud(mesh, BillboardSettings(**({"levels": 1, "solid_parts": "quads"} | settings)), "Shape"))


def test_a_radius_of_zero_keeps_the_normals():
    primitives = from_mesh(soup(20))
    assert normals_at_scale(primitives, 0.0, 0.1) is primitives.normals


def test_studs_on_a_plate_have_its_normal():
    mesh, is_stud = studded_plate()
    found = normals_at_scale(from_mesh(mesh), 0.1, 0.1)
    assert (found[is_stud] @ UP).min() > 0.9
    assert (normals_at_scale(from_mesh(mesh), 0.002, 0.1)[is_stud] @ UP).min() < -0.5, "at a smaller scale they have their own"


def test_a_smooth_surface_keeps_its_normals():
    primitives = from_mesh(sphere(24))
    found = normals_at_scale(primitives, 0.3, 0.3)
    assert np.einsum("pi,pi->p", found, primitives.normals).min() > 0.99
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)


def test_both_sides_of_a_thin_plate_have_one_normal():
    mesh = plate(cuts=20)
    inside = np.abs(mesh.corners.mean(axis=1)[:, :2]).max(axis=1) < 0.4
    found = normals_at_scale(from_mesh(mesh), 0.1, 0.1)[inside]
    np.testing.assert_allclose(found, np.broadcast_to(UP, found.shape), atol=1e-6)


def test_a_face_that_extends_beyond_the_error_keeps_its_normal():
    mesh, is_stud = studded_plate(0.09)
    primitives = from_mesh(mesh)
    found = normals_at_scale(primitives, 0.3, 0.02)
    thickness = np.ptp(np.einsum("pci,pi->pc", primitives.positions, found), axis=1)
    assert thickness.max() <= 0.04 + 1e-12
    walls = is_stud & (np.abs(primitives.normals @ UP) < 0.5)
    np.testing.assert_array_equal(found[walls], primitives.normals[walls])


def test_rotation_turns_the_normals():
    mesh, _ = studded_plate()
    rotation = random_rotation(3)
    turned = TriangleMesh(mesh.vertices @ rotation.T, mesh.triangles)
    expected = normals_at_scale(from_mesh(mesh), 0.1, 0.1) @ rotation.T
    assert np.einsum("pi,pi->p", normals_at_scale(from_mesh(turned), 0.1, 0.1), expected).min() > 0.9


@pytest.mark.parametrize("radius", [1e-6, 1e-3, 0.1, 10.0])
def test_samples_divide_the_area_and_are_few(radius):
    primitives = from_mesh(studded_plate()[0])
    owner, positions, areas = _sample(primitives, radius)
    assert len(owner) <= MIN_SAMPLE_LIMIT
    np.testing.assert_allclose(np.bincount(owner, areas), primitives.areas)
    centroids = np.stack([np.bincount(owner, column * areas) for column in positions.T], axis=1) / primitives.areas[:, None]
    np.testing.assert_allclose(centroids, primitives.positions.mean(axis=1), atol=1e-9)


def test_studs_need_no_quads_and_keep_their_distance():
    mesh, is_stud = studded_plate()
    cloud, plain = build(mesh, error=0.04, normal_scale=1.0), build(mesh, error=0.04, normal_scale=0.0)
    assert len(cloud.levels[0].quads) == 6 < len(plain.levels[0].quads)
    assert cloud.max_plane_distance <= 1.0 and cloud.uncovered_faces == 0
    assert plain.faces_beyond_normal_bound == 0 < cloud.faces_beyond_normal_bound <= is_stud.sum()


def test_a_thin_plate_is_one_quad_with_two_sides():
    cloud = build(plate(0.005, cuts=12), error=0.04)
    (level,) = cloud.levels
    assert len(level.quads) == 1 and not level.solid.any()
    assert cloud.max_plane_distance <= 1.0
    assert build(box(), error=0.02).levels[0].solid.all()
